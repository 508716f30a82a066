"""Verdict: what may be said of a record now.

Every figure of a channel with its caveats, what has changed, the grade of each sensor, and what stands in a
grade's way: motion, an axis that never changes, a source that repeats itself, a record that is mostly cut
out, holes, a warm-up that is not over.
"""

from __future__ import annotations

from collections.abc import Mapping

from imumon.noise.fit import ChannelFit
from imumon.noise.statistics.histogram import DistributionShape
from imumon.pipeline import report_builder
from imumon.pipeline.accumulators import Accumulators
from imumon.pipeline.analysis import Analysis
from imumon.pipeline.trends import against_baseline
from imumon.report import Change, Channel, ChannelGrade, Report, SensorGrade
from imumon.samples import sensor_of

ROUNDED = 0.3
"""Step of the values against the Allan deviation at the shortest time from which rounding may show in it."""
STRONG = 0.05
"""Share of the variance from which a spectral line bends the curve."""
DISTURBED, MOSTLY = 0.1, 0.5
"""Share of the record cut out above which it is called disturbed, and above which nothing is graded."""


def caveats(record: Accumulators, *, guarded: bool) -> tuple[str, ...]:
    """Words that stand for the whole record."""
    repeating = record.repeating
    words = {
        "not_at_rest": not record.at_rest,
        "disturbed": record.excluded_share > DISTURBED,
        "saturated": "clipped" in record.excluded_by,
        "stuck": repeating == "stuck",
        "loop": repeating == "loop",
        "gaps": record.missing_share > DISTURBED,
        "warming_up": guarded and record.warming(),
    }
    return tuple(word for word, stands in words.items() if stands)


def bent(
    fit: ChannelFit, made: Channel, shape: DistributionShape | None, std: float | None
) -> tuple[str, ...]:
    """Caveats of a fit, what bends its shortest octaves by its right name; `std` is the channel's deviation.

    The curve alone cannot tell a line from rounding or a filter; the spectrum and the steps of values can.
    """
    lines = made.spectrum.lines if made.spectrum is not None else ()
    shakes = any(0.5 * line.amplitude**2 > STRONG * (std or 0.0) ** 2 for line in lines)
    step = shape.step if shape is not None else None
    sigma = made.allan.sigma if made.allan is not None else ()
    rounded = step is not None and len(sigma) > 0 and step > ROUNDED * sigma[0]
    other = "vibration" if shakes else "correlated"
    names = {"correlated": other, "quantised": "quantised" if rounded else other}
    return tuple(names.get(word, word) for word in fit.caveats)


def obstacle(record: Accumulators) -> str | None:
    """Why nothing of this record can be graded, None where nothing stands in the way."""
    if not record.at_rest:
        return "the sensor is not at rest"
    repeating = record.repeating
    if repeating or record.repeated_share > MOSTLY:
        what = "stuck" if repeating == "stuck" else "stuck or replayed"
        return f"{record.repeated_share:.0%} of the samples repeat: {what}"
    if record.excluded_share > MOSTLY:
        return f"{record.excluded_share:.0%} of the record was cut out: was it moved?"
    return None


def constants(findings: Analysis) -> tuple[str, ...]:
    """Channels that should show noise and have not changed once: dead, stuck, or never measured."""
    return tuple(
        name
        for name, shape in zip(findings.fits, findings.shapes, strict=False)
        if shape is not None and shape.constant
    )


def changes(
    record: Accumulators, findings: Analysis, baseline: Report | None
) -> dict[int, tuple[Change, ...]]:
    """What differs from the time before, and from a saved baseline, by column."""
    fits = findings.fits
    found: dict[int, list[Change]] = {}
    for moved in record.history.moved():
        found.setdefault(moved.column, []).append(report_builder.change(moved.change, "hours before"))
    for column in range(len(fits)):
        step = findings.step(column)
        if step is not None and not any(change.quantity == "bias" for change in found.get(column, ())):
            found.setdefault(column, []).append(report_builder.step(step))
    if baseline is not None:
        for column, (name, fit) in enumerate(fits.items()):
            for change in against_baseline(baseline, name, fit, record.elapsed_s):
                found.setdefault(column, []).append(report_builder.change(change, "baseline"))
    return {column: tuple(of_channel) for column, of_channel in found.items()}


def channels(
    record: Accumulators,
    findings: Analysis,
    whole: tuple[str, ...],
    changed: Mapping[int, tuple[Change, ...]],
    hindered: str | None,
) -> dict[str, Channel]:
    """Every channel; `whole` are the caveats that stand for all of them, `hindered` the record's obstacle."""
    fits, running, recent = findings.fits, record.history.running(), record.strip.recent()
    means = {name: each.mean for name, each in zip(record.channels, running.channels, strict=True)}
    correlations: dict[str, dict[str, float]] = {}
    for group, covariance in enumerate(running.covariance):
        axes = [name for name, own in zip(record.channels, record.groups, strict=True) if own == group]
        correlations |= report_builder.correlations(axes, covariance)
    dead, shown = constants(findings), {}
    for column, name in enumerate(record.channels):
        found, fit, shape = findings.channels[name], fits.get(name), findings.shapes[column]
        words: tuple[str, ...] = ()
        if fit is not None:
            own = {
                "constant": name in dead,
                "changed": column in changed,
                "temperature": found.drift is not None and found.drift.steady_N is not None,
                "warming_up": findings.settling(column),
            }
            words = (
                *whole,
                *bent(fit, found, shape, running.channels[column].std),
                *(word for word, stands in own.items() if stands),
            )
        shown[name] = report_builder.running(
            found,
            running.channels[column],
            distribution=report_builder.distribution(
                shape,
                (float(recent.mean[column]), float(recent.std[column])),
                report_builder.bias(name, means, fit, record.elapsed_s),
                correlations[name],
                report_builder.effective_samples(
                    found.allan, running.channels[column].std, running.channels[column].count
                ),
            ),
            grade=ChannelGrade() if found.grade is not None and hindered else found.grade,
            changes=changed.get(column, ()) if fit is not None else (),
            caveats=tuple(dict.fromkeys(words)),
        )
    return shown


def grades(findings: Analysis, hindered: str | None) -> dict[str, SensorGrade]:
    """Headlines; none of a record with an obstacle, nor of a sensor with an axis that never changes."""
    dead, made = constants(findings), {}
    for sensor, grade in findings.grades.items():
        still = [name.partition("/")[2] for name in dead if sensor_of(name) == sensor]
        if hindered is not None:
            made[sensor] = SensorGrade(reason=hindered)
        elif still:
            made[sensor] = SensorGrade(
                reason=f"{', '.join(still)} never changed: dead, stuck or not measured"
            )
        else:
            made[sensor] = grade
    return made
