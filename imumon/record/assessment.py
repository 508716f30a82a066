"""Assessment: what the results of a record mean now.

Every channel with its caveats, what has changed, the grade of each sensor, and what prevents a grade: motion,
an axis that never changes, a sensor that repeats its values, a record that is mostly excluded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace

from imumon.model.grading import grade_sensor
from imumon.model.messages import excluded_text
from imumon.model.report import UNGRADED_SHARE, Change, Channel, ChannelGrade, Report, SensorGrade
from imumon.model.samples import UNITS, sensor_of
from imumon.model.units import share_text
from imumon.record import report_builder
from imumon.record.accumulators import Accumulators
from imumon.record.analysis import Analysis
from imumon.record.changes import compare_with_report
from imumon.record.report_builder import step_change

NOTED_SHARE = 0.1
"""Share of the samples from which exclusions, or missing ones, are a caveat of the record."""


def record_caveats(record: Accumulators, analysis: Analysis, *, guarded: bool) -> tuple[str, ...]:
    """Return the caveats that hold for the whole record."""
    holds = {
        "not_at_rest": not record.guard.at_rest,
        "disturbed": record.excluded_share > NOTED_SHARE,
        # a single sample beyond the range counts: the setting is wrong, and the next motion shows it again
        "saturated": "clipped" in record.excluded_by,
        "stuck": record.stuck,
        "gaps": record.missing_share > NOTED_SHARE,
        "warming_up": guarded and analysis.warming_up,
    }
    return tuple(caveat for caveat, true in holds.items() if true)


def no_grade_reason(record: Accumulators) -> str | None:
    """Return why nothing of this record can be graded; None if it can."""
    # A sensor that hangs now would be graded by its past, so the present counts, not the share alone.
    if record.stuck or record.stuck_share > UNGRADED_SHARE:
        return f"{share_text(record.stuck_share)} of the samples repeat: stuck"
    if record.excluded_share > UNGRADED_SHARE:
        return excluded_text(record.excluded_share, record.excluded_by)
    if not record.guard.at_rest:
        return "the sensor is not at rest"
    return None


def constant_channels(analysis: Analysis) -> tuple[str, ...]:
    """Return the channels that should show noise and never changed: dead, stuck, or not measured."""
    # `fits` are the leading channels, those with a curve: a temperature that never changes is no fault
    shapes = zip(analysis.fits, analysis.shapes, strict=False)
    return tuple(name for name, shape in shapes if shape is not None and shape.constant)


def clipped_channels(record: Accumulators, analysis: Analysis) -> dict[str, tuple[float, ...]]:
    """Return the channels whose values end at a limit of their range, with these values, channel unit."""
    extremes = zip(analysis.fits.items(), analysis.shapes, record.statistics.extremes.result(), strict=False)
    limits = {
        name: of_channel.clipped_at(shape)
        for (name, fit), shape, of_channel in extremes
        # where the resolution hides the noise, nearly all values are at one level
        if shape is not None and of_channel is not None and fit.N.status != "pending"
    }
    return {name: values for name, values in limits.items() if values}


def detect_changes(analysis: Analysis, baseline: Report | None) -> dict[int, tuple[Change, ...]]:
    """Return the steps of the bias, and what differs from a saved baseline, by column.

    Changes between hours are not among them: the samples show those where they happen, in `Happened.ended`.
    """
    changes = {}
    for column, (name, fit) in enumerate(analysis.fits.items()):
        of_channel = [] if fit.step is None else [step_change(fit.step)]
        if baseline is not None:
            of_channel += compare_with_report(baseline, name, fit)
        if of_channel:
            changes[column] = tuple(of_channel)
    return changes


def merged(*changes: Mapping[int, tuple[Change, ...]]) -> dict[int, tuple[Change, ...]]:
    """Return changes of several kinds together, by column."""
    columns = dict.fromkeys(column for kind in changes for column in kind)
    return {
        column: tuple(change for kind in changes for change in kind.get(column, ())) for column in columns
    }


def assess_channels(
    record: Accumulators,
    analysis: Analysis,
    record_caveats: tuple[str, ...],
    changes: Mapping[int, tuple[Change, ...]],
    no_grade: str | None,
) -> dict[str, Channel]:
    """Return every channel of the report.

    Parameters
    ----------
    record_caveats : caveats that hold for all channels.
    changes : by column.
    no_grade : why nothing of the record can be graded; None if it can.
    """
    fits, moments, recent = analysis.fits, record.statistics.noise.moments(), record.envelope.recent()
    means = {name: channel.mean for name, channel in zip(record.channels, moments.channels, strict=True)}
    correlations: dict[str, dict[str, float]] = {}
    for group, covariance in enumerate(moments.covariance):
        axes = [
            name for name, of_sensor in zip(record.channels, record.groups, strict=True) if of_sensor == group
        ]
        correlations |= report_builder.correlations(axes, covariance)
    constant, clipped, channels = constant_channels(analysis), clipped_channels(record, analysis), {}
    noisy = record.guard.noisy_outliers
    for column, name in enumerate(record.channels):
        channel, fit, shape = analysis.channels[name], fits.get(name), analysis.shapes[column]
        statistics = moments.channels[column]
        # A temperature has no caveats: those of the record are about noise.
        caveats: tuple[str, ...] = ()
        if fit is not None:
            robust = analysis.robust.get(name)
            holds = {
                # the guard sees them while they pass; the robust deviation in the whole record, also without a guard
                "outliers": bool(noisy[column]) or (robust is not None and robust.disagrees),
                "constant": name in constant,
                "clipped": name in clipped,
                "changed": column in changes,
                "temperature": fit.follows_temperature,
            }
            caveats = (
                *record_caveats,
                *fit.caveats,
                *(caveat for caveat, true in holds.items() if true),
            )
        distribution = report_builder.distribution(
            shape,
            (float(recent.mean[column]), float(recent.std[column])),
            correlations[name],
            report_builder.effective_samples(channel.allan, statistics.std, statistics.count),
        )
        channels[name] = replace(
            channel,
            **asdict(statistics),
            distribution=report_builder.with_bias(distribution, name, means, fit, record.elapsed_s),
            # a sensor without grades keeps None: it has none, while this one has lost its grade
            grade=ChannelGrade() if channel.grade is not None and no_grade else channel.grade,
            changes=changes.get(column, ()) if fit is not None else (),
            caveats=tuple(dict.fromkeys(caveats)),  # record and fit may name the same one
        )
    return channels


def sensor_grades(
    record: Accumulators, analysis: Analysis, channels: Mapping[str, Channel], no_grade: str | None
) -> dict[str, SensorGrade]:
    """Return the headline of each sensor, without a grade if the record or a constant axis prevents it.

    Parameters
    ----------
    channels : of the report, with their combined limits: a grade is certain within these.
    no_grade : why nothing of the record can be graded; None if it can.
    """
    constant, clipped, grades = constant_channels(analysis), clipped_channels(record, analysis), {}
    for sensor in analysis.grades:
        axes = [name.partition("/")[2] for name in constant if sensor_of(name) == sensor]
        ends = [
            f"{name.partition('/')[2]} is clipped at {' and '.join(f'{value:.4g}' for value in values)} {UNITS[sensor]}"
            for name, values in clipped.items()
            if sensor_of(name) == sensor
        ]
        # A reason of the record takes precedence: it says what to do first.
        if no_grade is not None:
            grades[sensor] = SensorGrade(reason=no_grade)
        elif axes:
            reason = f"{', '.join(axes)} never changed: dead, stuck or not measured"
            grades[sensor] = SensorGrade(reason=reason)
        elif ends:
            grades[sensor] = SensorGrade(reason=f"{', '.join(ends)}: a range is too small")
        else:
            axes_with_fit = {
                name.partition("/")[2]: channel.coefficients
                for name, channel in channels.items()
                if sensor_of(name) == sensor and channel.fit
            }
            grades[sensor] = grade_sensor(sensor, axes_with_fit)
    return grades
