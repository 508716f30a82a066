"""Table of a report for a terminal or a pipe: plain text, one line a channel."""

from __future__ import annotations

import math
from dataclasses import dataclass

from imumon.messages import (
    FILTER_NOT_KNOWN,
    caveats,
    exclusions,
    filter_not_known,
    joined,
    line,
    no_value_text,
    uncertainty,
    within,
)
from imumon.report import COEFFICIENTS, Channel, Coefficient, DeviceDescription, Report
from imumon.samples import sensor_of
from imumon.units import counted, duration, figures, measured, pretty


@dataclass(frozen=True, slots=True)
class Form:
    """How a line of the table is laid out.

    Attributes
    ----------
    cell : cells of a coefficient.
    limits : with its 95 % limits, else with their half-width in percent, or where they are wide their factor.
    std : with the standard deviation.
    """

    cell: int
    limits: bool
    std: bool

    @property
    def width(self) -> int:
        """Cells of the whole line."""
        return NAME + (NUMBER + 1) * (1 + self.std) + (self.cell + 1) * len(COEFFICIENTS) + 1 + GRADE


NAME, NUMBER, GRADE = 12, 11, 10
FULL = Form(28, limits=True, std=True)
FORMS = (FULL, Form(15, limits=False, std=True), Form(14, limits=False, std=False))
"""From the fullest to the narrowest."""


def table(made: Report, width: int | None = None) -> str:
    """The whole report as lines of text.

    Parameters
    ----------
    width : cells of the terminal; None where it does not go to one: then everything is told.
    """
    form = FULL if width is None else next((form for form in FORMS if form.width <= width), FORMS[-1])
    signs = [uncertainty()] if made.channels and not form.limits else []
    return "\n".join([*_head(made), "", *_rows(made, form), *signs, "", *_grades(made), *_caveats(made)])


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
    return no_value_text(found) or "too short"


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
    named = " ".join(part for part in (device.model, device.serial) if part)
    who = f"{device.id}: {named}" if named and device.id != "replay" else named or device.id
    rate = f"{device.sample_rate_hz:g} Hz" if device.sample_rate_hz else "rate not known"
    lines = [
        f"{who}  {device.source or ''} {device.stream or ''}  {rate}  {made.state}",
        f"{duration(session.elapsed_s)}, {counted(session.samples, 'sample')}, {session.missing:,} missing "
        f"in {counted(session.gaps, 'gap')}, {counted(session.bad_checksums, spoilt(device))}, "
        f"{counted(session.discarded_bytes, 'byte')} discarded",
    ]
    left_out = exclusions(made, lambda seconds: f"{seconds:.1f} s")
    if session.disturbances or left_out:
        cut = f"cut out {' and '.join(left_out)}" if left_out else "nothing cut out"
        lines.append(f"{counted(session.disturbances, 'disturbance')}, {cut}")
    if session.warmup_s:
        lines.append(f"warm-up of {duration(session.warmup_s)} cut out")
    return lines


def spoilt(device: DeviceDescription) -> str:
    """What `bad_checksums` counts: messages that failed their check, or rows of a table."""
    table = (device.source or "").startswith(("csv", "npz", "bag"))
    return "incomplete row" if table else "bad checksum"


def _rows(made: Report, form: Form) -> list[str]:
    lines, before = [], ""
    for name, channel in made.channels.items():
        sensor = sensor_of(name)
        if sensor != before:
            before = sensor
            lines.append(_heading(sensor, channel, form))
        cells = [f"{name:<{NAME}}", _number(channel.mean), *([_number(channel.std)] if form.std else [])]
        for letter in COEFFICIENTS:
            found: Coefficient | None = getattr(channel, letter)
            text = coefficient(found) if form.limits else _shorter(found)
            cells.append(f"{text:<{form.cell}}")
        grade = channel.grade.nearest if channel.grade else None
        lines.append(" ".join([*cells, grade or ""]).rstrip())
    return lines


def _shorter(found: Coefficient | None) -> str:
    """N, B or K with the half-width of its limits or their factor: ``0.358 ±1.5%``, ``3.5 ×÷2.1``."""
    if found is not None and found.status == "measured" and found.readable.value is not None:
        return measured(found.readable.value, found.readable.low, found.readable.high)
    return coefficient(found)


def _heading(sensor: str, channel: Channel, form: Form) -> str:
    unit = pretty(channel.unit)
    cells = [f"{'' if form.limits else f'in {unit}':<{NAME}}", f"{'mean':>{NUMBER}}"]
    cells += [f"{'std':>{NUMBER}}"] if form.std else []
    for letter in COEFFICIENTS:
        found: Coefficient | None = getattr(channel, letter)
        named = f"{letter} in " if form.limits else f"{letter} "
        cells.append(f"{f'{named}{pretty(found.readable.unit)}' if found else '':<{form.cell}}")
    return " ".join(cells).rstrip() + (f"   ({sensor} in {unit})" if form.limits else "")


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
        maybe = f" (provisional: {grade.reason})" if grade.provisional and grade.reason else ""
        lines.append(f"{sensor}: nearest grade {grade.nearest}{by}; {within(grade.meets)}{maybe}")
    return lines


def _caveats(made: Report) -> list[str]:
    """Each caveat by its word, with the channels it holds for and what it means."""
    noisy = sum(1 for channel in made.channels.values() if channel.allan is not None)
    lines = [
        f"caveat {word}{f' ({joined(names)})' if 0 < len(names) < noisy else ''}: {line(word)}"
        for word, names in caveats(made).items()
    ]
    warning = filter_not_known(made)
    return lines if warning is None else [*lines, f"{FILTER_NOT_KNOWN}: {warning}"]
