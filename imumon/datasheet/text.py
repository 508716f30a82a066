"""Table of a report for a terminal or a pipe: plain text, one line a channel."""

from __future__ import annotations

import math

from imumon.report import COEFFICIENTS, Channel, Coefficient, Report
from imumon.samples import sensor_of
from imumon.units import duration, figures, pretty

WIDTH = 28
WHY = {"constant": "never changes", "resolution": "hidden by rounding"}
"""Why a coefficient is not known, in a few letters, by a word of its reason; else the record is too short."""


def table(made: Report) -> str:
    """The whole report as lines of text."""
    return "\n".join([*_head(made), "", *_rows(made), "", *_grades(made), *_caveats(made)])


def coefficient(found: Coefficient | None) -> str:
    """N, B or K with its limits in readable units: ``0.358 (0.353 to 0.364)``, ``< 8.72``.

    A coefficient that is not known yet says so.
    """
    if found is None:
        return ""
    shown = found.readable
    if found.status == "measured" and shown.value is not None:
        if shown.low is None or shown.high is None:
            return figures(shown.value)
        many = digits(shown.value, shown.high - shown.low)
        return " ".join(
            (figures(shown.value, many), f"({figures(shown.low, many)} to {figures(shown.high, many)})")
        )
    if found.status == "upper_bound" and shown.high is not None:
        return f"< {figures(shown.high)}"
    return next((short for word, short in WHY.items() if word in (found.reason or "")), "too short")


def digits(value: float, width: float) -> int:
    """Significant digits that show an interval of that width about a value, three or four.

    >>> digits(0.21, 0.02), digits(0.21, 0.0004), digits(0.21, 0.0)
    (3, 4, 4)
    """
    if width <= 0.0 or value <= 0.0:
        return 4
    return min(max(3, 1 - math.floor(math.log10(width / value))), 4)


def _head(made: Report) -> list[str]:
    device, session = made.device, made.session
    who = " ".join(part for part in (device.model, device.serial) if part) or device.id
    rate = f"{device.sample_rate_hz:g} Hz" if device.sample_rate_hz else "rate not known"
    lines = [
        f"{who}  {device.source or ''} {device.stream or ''}  {rate}  {made.state}",
        f"{duration(session.elapsed_s)}, {session.samples:,} samples, {session.missing:,} missing in "
        f"{session.gaps:,} gaps, {session.bad_checksums:,} bad checksums, "
        f"{session.discarded_bytes:,} bytes discarded",
    ]
    if session.disturbances or session.excluded_s:
        reasons = ", ".join(f"{why} {seconds:.1f} s" for why, seconds in session.excluded_by.items())
        lines.append(
            f"{session.disturbances:,} disturbances, {session.excluded_s:.1f} s cut out"
            + (f" ({reasons})" if reasons else "")
        )
    if session.warmup_s:
        lines.append(f"warm-up of {duration(session.warmup_s)} cut out")
    return lines


def _rows(made: Report) -> list[str]:
    lines, before = [], ""
    for name, channel in made.channels.items():
        sensor = sensor_of(name)
        if sensor != before:
            before = sensor
            lines.append(_heading(sensor, channel))
        cells = [f"{name:<12}", _number(channel.mean), _number(channel.std)]
        cells += [f"{coefficient(getattr(channel, letter)):<{WIDTH}}" for letter in COEFFICIENTS]
        grade = channel.grade.nearest if channel.grade else None
        lines.append(" ".join([*cells, grade or ""]).rstrip())
    return lines


def _heading(sensor: str, channel: Channel) -> str:
    cells = [f"{'':<12}", f"{'mean':>11}", f"{'std':>11}"]
    for letter in COEFFICIENTS:
        found: Coefficient | None = getattr(channel, letter)
        cells.append(f"{f'{letter} in {pretty(found.readable.unit)}' if found else '':<{WIDTH}}")
    return " ".join(cells).rstrip() + f"   ({sensor} in {pretty(channel.unit)})"


def _number(value: float | None) -> str:
    return f"{value:>11.4e}" if value is not None else f"{'':>11}"


def _grades(made: Report) -> list[str]:
    lines = []
    for sensor, grade in made.grade.items():
        if grade.nearest is None:
            lines.append(f"{sensor}: no grade{f', {grade.reason}' if grade.reason else ''}")
            continue
        by = (
            f", decided by {grade.decided_by.coefficient} of {grade.decided_by.axis}"
            if grade.decided_by
            else ""
        )
        meets = f", meets {grade.meets or 'none'}" if grade.meets != grade.nearest else ""
        maybe = f" (provisional: {grade.reason})" if grade.provisional and grade.reason else ""
        lines.append(f"{sensor}: {grade.nearest}{by}{meets}{maybe}")
    return lines


def _caveats(made: Report) -> list[str]:
    by_caveat: dict[str, list[str]] = {}
    for name, channel in made.channels.items():
        for word in channel.caveats:
            by_caveat.setdefault(word, []).append(name)
    noisy = sum(1 for channel in made.channels.values() if channel.allan is not None)
    return [
        f"caveat {word}: {'all' if len(names) == noisy else ', '.join(names)}"
        for word, names in by_caveat.items()
    ]
