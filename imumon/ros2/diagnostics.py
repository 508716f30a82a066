"""Reports as ``diagnostic_msgs/msg/DiagnosticArray``, and the covariances that a report has measured.

There is one status for the stream and one for each sensor with a curve. The level follows `imumon check`: a sensor
that is gone is an error; an alarm, a stuck or constant axis or a change is a warning. A caveat that only limits what
the numbers mean, such as an unknown compensation, leaves the level at OK and is listed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum

from imumon.model.coefficients import Estimate
from imumon.model.messages import grade_text, line, loss_text
from imumon.model.report import Channel, Report, SensorGrade
from imumon.model.samples import AXES, ChannelName
from imumon.model.units import figures
from imumon.ros2.ros_messages import DIAGNOSTIC_ARRAY, encode, header, message


class DiagnosticLevel(IntEnum):
    """Level of a DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


DIAGNOSTICS = "/diagnostics"
WARNINGS = (
    "changed",
    "stuck",
    "constant",
    "clipped",
    "other_sender",
    "not_at_rest",
    "saturated",
    "disturbed",
    "truncated",
)
"""Caveats that make a warning."""
STATES: Mapping[str, tuple[int, str]] = {
    "starting": (DiagnosticLevel.STALE, "no sample yet"),
    "running": (DiagnosticLevel.OK, "running"),
    "waiting": (DiagnosticLevel.ERROR, "the sensor is disconnected or silent"),
    "stopped": (DiagnosticLevel.STALE, "stopped"),
}
"""Level and text of a state."""


def diagnostics(report: Report, stamp_ns: int, node: str) -> bytes:
    """Return a report as the bytes of a DiagnosticArray.

    Parameters
    ----------
    stamp_ns : ns since the Unix epoch, time of the report.
    node : name of the node, with which the name of each status begins.
    """
    device = report.device
    statuses = [
        message(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level,
            name=f"{node}: {name}",
            message=text,
            hardware_id=device.serial or device.id,
            values=[message("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values],
        )
        for name, level, text, values in (_stream(report), *_sensors(report))
    ]
    return encode(message(DIAGNOSTIC_ARRAY, header=header(stamp_ns), status=statuses))


def _stream(report: Report) -> tuple[str, int, str, list[tuple[str, str]]]:
    """Return name, level, message and values of the status of the stream."""
    session, device = report.session, report.device
    level, message = STATES[report.state]
    if level == DiagnosticLevel.OK and session.recent_loss is not None and report.is_lossy:
        level, message = DiagnosticLevel.WARN, loss_text(session.recent_loss)
    rate = device.sample_rate_hz
    return (
        "stream",
        level,
        message,
        [
            ("state", report.state),
            ("device", device.id),
            ("source", device.source or "unknown"),
            ("sample_rate_hz", "unknown" if rate is None else f"{rate:.6g}"),
            ("elapsed_s", f"{session.elapsed_s:.3f}"),
            ("samples", str(session.samples)),
            ("missing", str(session.missing)),
            ("gaps", str(session.gaps)),
            ("overruns", str(session.overruns)),
            ("restarts", str(session.restarts)),
            ("excluded_s", f"{session.excluded_s:.3f}"),
            ("caveats", ", ".join(report.caveats) or "none"),
        ],
    )


def _sensors(report: Report) -> Iterator[tuple[str, int, str, list[tuple[str, str]]]]:
    """Yield name, level, message and values of the status of each sensor."""
    for sensor, grade in report.grade.items():
        axes = {name: channel for name, channel in report.channels.items() if name.sensor == sensor}
        if not axes:
            continue
        caveats = list(dict.fromkeys(caveat for channel in axes.values() for caveat in channel.caveats))
        warnings = [line(caveat) for caveat in WARNINGS if caveat in caveats]
        level = DiagnosticLevel.WARN if warnings else STATES[report.state][0]
        message = "; ".join(warnings) or grade.meets or grade.reason or "no grade yet"
        yield (
            sensor,
            level,
            message,
            [*_grade(grade), ("caveats", ", ".join(caveats) or "none"), *_axes(axes)],
        )


def _grade(grade: SensorGrade) -> Iterator[tuple[str, str]]:
    yield "grade", grade.meets or "none"
    yield "provisional", str(grade.provisional).lower()
    yield "summary", grade_text(grade)
    if grade.reason:
        yield "reason", grade.reason


def _axes(axes: Mapping[ChannelName, Channel]) -> Iterator[tuple[str, str]]:
    """Yield the coefficients and the drift of each axis."""
    for name, channel in axes.items():
        for letter, coefficient in channel.estimates.items():
            yield f"{letter} {name.axis}", _coefficient(coefficient)
        drift = channel.drift
        if drift is not None and drift.per_hour is not None:
            yield f"drift {name.axis}", f"{figures(drift.per_hour)} {channel.unit}/h"


def _coefficient(coefficient: Estimate) -> str:
    """Return a coefficient with its 95 % limits, in the readable unit."""
    shown = coefficient.readable

    def value(value: float, low: float | None, high: float | None) -> str:
        limits = "" if high is None else f" ({figures(low or 0.0)} to {figures(high)})"
        return f"{figures(value)}{limits} {shown.unit}"

    pending = f"pending: {coefficient.reason}" if coefficient.reason else "pending"
    return shown.text(value, lambda high: f"< {figures(high)} {shown.unit}", pending)


def sample_variances(report: Report, sensor: str) -> Sequence[float] | None:
    """Return the variance of one sample of x, y and z: N^2 times the rate. None: not all of them are measured.

    White noise of the density N, averaged over 1 / rate or sampled at that rate, has this variance (IEEE Std 952,
    annex C). A bound is no measurement.
    """
    rate = report.device.sample_rate_hz
    variances: list[float] = []
    for axis in AXES:
        channel = report.channels.get(ChannelName(f"{sensor}/{axis}"))
        n = None if channel is None else channel.estimates.get("N")
        if rate is None or n is None or n.status != "measured" or n.value is None:
            return None
        variances.append(n.value**2 * rate)
    return variances
