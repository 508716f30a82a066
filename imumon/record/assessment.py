"""Assessment: what the results of a record mean now.

Every channel with its caveats, what has changed, the grade of each sensor, and what prevents a grade: motion,
an axis that never changes, a sensor that repeats its values, a record that is mostly excluded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

from imumon.model.grading import grade_sensor
from imumon.model.messages import excluded_text
from imumon.model.report import UNGRADED_SHARE, Change, Channel, ChannelGrade, Report, SensorGrade
from imumon.model.samples import UNITS, ChannelName, Stream
from imumon.model.units import share_text
from imumon.noise.fit import ChannelFit
from imumon.noise.statistics.envelope import RecentStatistics
from imumon.noise.stretches import Sums
from imumon.record import report_builder
from imumon.record.changes import FIRST_HALF, HOURS_BEFORE, changes_by_column, compare_with_report
from imumon.record.counts import Counts
from imumon.record.fits import Fits
from imumon.record.report_builder import step_change

NOTED_SHARE = 0.1
"""Share of the samples from which exclusions, or missing ones, are a caveat of the record."""


class Assessment:
    """What the results of a record mean.

    Parameters
    ----------
    fits, sums, counts : of the record.
    recent : statistics of the last minute.
    baseline : an earlier report of the sensor to compare with; None: there is none.

    Attributes
    ----------
    caveats : that hold for the whole record.
    no_grade : why nothing of the record can be graded; None if it can.
    constant : channels that should show noise and never changed: dead, stuck, or not measured.
    changes : steps of the bias and differences from the baseline, by column. The samples have shown those between hours
        where they happened.
    """

    def __init__(
        self,
        fits: Fits,
        sums: Sums,
        counts: Counts,
        recent: RecentStatistics,
        baseline: Report | None,
    ) -> None:
        self._fits, self._sums, self._counts, self._recent = fits, sums, counts, recent
        self.caveats, self.no_grade = _record_caveats(counts, fits), _no_grade_reason(counts)
        # `fits` are the leading channels, those with a curve: a temperature that never changes is no fault
        shapes = zip(fits.fits, fits.shapes, strict=False)
        self.constant = tuple(name for name, shape in shapes if shape is not None and shape.constant)
        self.changes = _changes(fits, baseline)
        self._clipped = _clipped(fits, sums)

    def channels(self, caveats: Sequence[str]) -> dict[ChannelName, Channel]:
        """Return every channel of the report; `caveats` are those of the stream and the settings of the sensor."""
        fits, moments = self._fits, self._sums.moments()
        means = {
            name: channel.mean for name, channel in zip(fits.stream.channels, moments.channels, strict=True)
        }
        correlations: dict[str, dict[str, float]] = {}
        for axes, covariance in zip(_by_sensor(fits.stream), moments.covariance, strict=True):
            correlations |= report_builder.correlations(axes, covariance)
        between_hours, channels = changes_by_column(self._sums.changes(), HOURS_BEFORE), {}
        for column, name in enumerate(fits.stream.channels):
            channel, fit, statistics = fits.channels[name], fits.fits.get(name), moments.channels[column]
            changes = (*between_hours.get(column, ()), *self.changes.get(column, ()))
            distribution = report_builder.distribution(
                fits.shapes[column],
                (float(self._recent.mean[column]), float(self._recent.std[column])),
                correlations[name],
                report_builder.effective_samples(channel.allan, statistics.std, statistics.count),
            )
            # A temperature has no caveats: those of the record are about noise.
            of_channel = (
                () if fit is None else self._channel_caveats(column, name, fit, changed=bool(changes))
            )
            channels[name] = replace(
                channel,
                **{part.name: getattr(statistics, part.name) for part in fields(statistics)},
                distribution=report_builder.with_bias(distribution, name, means, fit, self._counts.elapsed_s),
                # a sensor without grades keeps None: it has none, while this one has lost its grade
                grade=ChannelGrade() if channel.grade is not None and self.no_grade else channel.grade,
                changes=changes if fit is not None else (),
                # record and fit may name the same one
                caveats=() if fit is None else tuple(dict.fromkeys((*caveats, *self.caveats, *of_channel))),
            )
        return channels

    def _channel_caveats(
        self, column: int, name: ChannelName, fit: ChannelFit, *, changed: bool
    ) -> tuple[str, ...]:
        """Return the caveats of one channel."""
        robust = self._fits.robust.get(name)
        holds = {
            # the guard sees them while they pass; the robust deviation in the whole record, also without a guard
            "outliers": bool(self._counts.noisy[column]) or (robust is not None and robust.disagrees),
            "constant": name in self.constant,
            "clipped": name in self._clipped,
            "changed": changed,
            "temperature": fit.follows_temperature,
        }
        return (*fit.caveats, *(caveat for caveat, true in holds.items() if true))

    def sensor_grades(self, channels: Mapping[ChannelName, Channel]) -> dict[str, SensorGrade]:
        """Return the headline of each sensor, without a grade if the record or a constant axis prevents it.

        Parameters
        ----------
        channels : of the report, with their combined limits: a grade is certain within these.
        """
        grades = {}
        for sensor in self._fits.grades:
            of_sensor = [name for name in self._fits.stream.channels if name.sensor == sensor]
            axes = [name.axis for name in of_sensor if name in self.constant]
            ends = [
                f"{name.axis} is clipped at {' and '.join(map('{:.4g}'.format, self._clipped[name]))} {UNITS[sensor]}"
                for name in of_sensor
                if name in self._clipped
            ]
            # A reason of the record takes precedence: it says what to do first.
            if self.no_grade is not None:
                grades[sensor] = SensorGrade(reason=self.no_grade)
            elif axes:
                reason = f"{', '.join(axes)} never changed: dead, stuck or not measured"
                grades[sensor] = SensorGrade(reason=reason)
            elif ends:
                grades[sensor] = SensorGrade(reason=f"{', '.join(ends)}: a range is too small")
            else:
                axes_with_fit = {
                    name.axis: channels[name].coefficients for name in of_sensor if channels[name].fit
                }
                grades[sensor] = grade_sensor(sensor, axes_with_fit)
        return grades


def _record_caveats(counts: Counts, fits: Fits) -> tuple[str, ...]:
    """Return the caveats that hold for the whole record."""
    holds = {
        "not_at_rest": not counts.at_rest,
        "disturbed": counts.excluded_share > NOTED_SHARE,
        # a single sample beyond the range counts: the setting is wrong, and the next motion shows it again
        "saturated": "clipped" in counts.excluded,
        "stuck": counts.stuck,
        "gaps": counts.missing_share > NOTED_SHARE,
        "warming_up": fits.warming_up,
    }
    return tuple(caveat for caveat, true in holds.items() if true)


def _no_grade_reason(counts: Counts) -> str | None:
    """Return why nothing of a record can be graded; None if it can."""
    # A sensor that hangs now would be graded by its past, so the present counts, not the share alone.
    if counts.stuck or counts.stuck_share > UNGRADED_SHARE:
        return f"{share_text(counts.stuck_share)} of the samples repeat: stuck"
    if counts.excluded_share > UNGRADED_SHARE:
        return excluded_text(counts.excluded_share, counts.excluded_by)
    if not counts.at_rest:
        return "the sensor is not at rest"
    return None


def _clipped(fits: Fits, sums: Sums) -> dict[str, tuple[float, ...]]:
    """Return the channels whose values end at a limit of their range, with these values, channel unit."""
    extremes = zip(fits.fits.items(), fits.shapes, sums.extremes.result(), strict=False)
    limits = {
        name: of_channel.clipped_at(shape)
        for (name, fit), shape, of_channel in extremes
        # where the resolution hides the noise, nearly all values are at one level
        if shape is not None and of_channel is not None and fit.N.status != "pending"
    }
    return {name: values for name, values in limits.items() if values}


def _changes(fits: Fits, baseline: Report | None) -> dict[int, tuple[Change, ...]]:
    """Return the steps of the bias, and what differs from the first half or from a saved baseline, by column."""
    changes, halves = {}, changes_by_column(fits.half_changes, FIRST_HALF)
    for column, (name, fit) in enumerate(fits.fits.items()):
        of_channel = [*([] if fit.step is None else [step_change(fit.step)]), *halves.get(column, ())]
        if baseline is not None:
            of_channel += compare_with_report(baseline, name, fit)
        if of_channel:
            changes[column] = tuple(of_channel)
    return changes


def _by_sensor(stream: Stream) -> list[list[str]]:
    """Return the channels of each sensor."""
    sensors: dict[str, list[str]] = {}
    for sensor, name in zip(stream.sensors, stream.channels, strict=True):
        sensors.setdefault(sensor, []).append(name)
    return list(sensors.values())
