"""Assessment: what the results of a record mean now.

Every channel with its caveats, what has changed, the grade of each sensor, and what prevents a grade: motion,
an axis that never changes, a sensor that repeats its values, a record that is mostly excluded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace

from imumon.messages import excluded_text
from imumon.noise.grading import grade_sensor
from imumon.noise.stretches.change import compare_with_report
from imumon.pipeline import report_builder
from imumon.pipeline.accumulators import Accumulators
from imumon.pipeline.analysis import Analysis
from imumon.report import UNGRADED_SHARE, Change, Channel, ChannelGrade, Report, SensorGrade
from imumon.samples import sensor_of
from imumon.units import share_text

NOTED_SHARE = 0.1
"""Share of the samples from which exclusions, or missing ones, are a caveat of the record."""


def record_caveats(record: Accumulators, analysis: Analysis, *, guarded: bool) -> tuple[str, ...]:
    """Return the caveats that hold for the whole record."""
    holds = {
        "not_at_rest": not record.guard.at_rest,
        "disturbed": record.excluded_share > NOTED_SHARE,
        "saturated": "clipped" in record.excluded_by,
        "stuck": record.stuck,
        "gaps": record.missing_share > NOTED_SHARE,
        "warming_up": guarded and analysis.warming_up,
    }
    return tuple(caveat for caveat, true in holds.items() if true)


def no_grade_reason(record: Accumulators) -> str | None:
    """Return why nothing of this record can be graded; None if it can."""
    if record.stuck or record.stuck_share > UNGRADED_SHARE:
        return f"{share_text(record.stuck_share)} of the samples repeat: stuck"
    if record.excluded_share > UNGRADED_SHARE:
        return excluded_text(record.excluded_share, record.excluded_by)
    if not record.guard.at_rest:
        return "the sensor is not at rest"
    return None


def constant_channels(analysis: Analysis) -> tuple[str, ...]:
    """Return the channels that should show noise and never changed: dead, stuck, or not measured."""
    shapes = zip(analysis.fits, analysis.shapes, strict=False)
    return tuple(name for name, shape in shapes if shape is not None and shape.constant)


def detect_changes(
    record: Accumulators, analysis: Analysis, baseline: Report | None
) -> dict[int, tuple[Change, ...]]:
    """Return what differs from the time before and from a saved baseline, by column."""
    changes = {column: list(each) for column, each in record.statistics.noise.changes().items()}
    for column, (name, fit) in enumerate(analysis.fits.items()):
        own = changes.setdefault(column, [])
        if fit.step is not None:
            own.append(fit.step)
        if baseline is not None:
            own += compare_with_report(baseline, name, fit)
    return {column: tuple(own) for column, own in changes.items() if own}


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
    means = {name: each.mean for name, each in zip(record.channels, moments.channels, strict=True)}
    correlations: dict[str, dict[str, float]] = {}
    for group, covariance in enumerate(moments.covariance):
        axes = [name for name, own in zip(record.channels, record.groups, strict=True) if own == group]
        correlations |= report_builder.correlations(axes, covariance)
    constant, channels = constant_channels(analysis), {}
    noisy = record.guard.noisy_outliers
    for column, name in enumerate(record.channels):
        channel, fit, shape = analysis.channels[name], fits.get(name), analysis.shapes[column]
        own = moments.channels[column]
        caveats: tuple[str, ...] = ()
        if fit is not None:
            robust = analysis.robust.get(name)
            holds = {
                "outliers": bool(noisy[column]) or (robust is not None and robust.disagrees),
                "constant": name in constant,
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
            report_builder.effective_samples(channel.allan, own.std, own.count),
        )
        channels[name] = replace(
            channel,
            **asdict(own),
            distribution=report_builder.with_bias(distribution, name, means, fit, record.elapsed_s),
            grade=ChannelGrade() if channel.grade is not None and no_grade else channel.grade,
            changes=changes.get(column, ()) if fit is not None else (),
            caveats=tuple(dict.fromkeys(caveats)),
        )
    return channels


def sensor_grades(
    analysis: Analysis, channels: Mapping[str, Channel], no_grade: str | None
) -> dict[str, SensorGrade]:
    """Return the headline of each sensor, without a grade if the record or a constant axis prevents it.

    Parameters
    ----------
    channels : of the report, with their combined limits: a grade is certain within these.
    no_grade : why nothing of the record can be graded; None if it can.
    """
    constant, grades = constant_channels(analysis), {}
    for sensor in analysis.grades:
        axes = [name.partition("/")[2] for name in constant if sensor_of(name) == sensor]
        if no_grade is not None:
            grades[sensor] = SensorGrade(reason=no_grade)
        elif axes:
            reason = f"{', '.join(axes)} never changed: dead, stuck or not measured"
            grades[sensor] = SensorGrade(reason=reason)
        else:
            fitted = {n.partition("/")[2]: c for n, c in channels.items() if sensor_of(n) == sensor and c.fit}
            grades[sensor] = grade_sensor(sensor, {axis: c.coefficients for axis, c in fitted.items()})
    return grades
