"""Table of a report as plain text, for a terminal or a pipe, and the texts that other forms share with it."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from imumon.alarms import known
from imumon.devices import registry
from imumon.messages import (
    FILTER_NOT_KNOWN,
    GRADE_WORDS,
    caveats,
    exclusions,
    filter_not_known,
    grade_text,
    joined,
    line_with_size,
    no_value_text,
    uncertainty,
)
from imumon.report import COEFFICIENTS, NOISE, Allan, Channel, DeviceDescription, Estimate, Report
from imumon.samples import ALIASED, AXES, sensor_of
from imumon.units import counted, duration, figures, measured, pretty

SHOWN_EVENTS = 30
"""Most events in a text or a document."""

SENSOR_TITLES = {"gyro": "Gyroscope", "accel": "Accelerometer", "mag": "Magnetometer"}


def sensor_title(report: Report) -> str:
    """Return the sensor by model and serial number, else by the name of its device or of its recording."""
    device = report.device
    if title := " ".join(part for part in (device.model, device.serial) if part):
        return title
    if device.id == "replay" and device.port:
        return device.port.rpartition("/")[2]
    return device.id


def record_title(report: Report) -> str:
    """Return the length, stream and rate of the record."""
    device = report.device
    rate = f" at {device.sample_rate_hz:g} Hz" if device.sample_rate_hz else ""
    return f"{duration(report.session.elapsed_s)} of {stream_noun(device)}{rate}"


def record_line(report: Report) -> str:
    """Return sensor, record and date in one line."""
    started = report.session.started
    date = f"from {started}" if started else f"date of the record unknown, report of {report.time}"
    return f"{sensor_title(report)}: {record_title(report)}, {date}"


def stream_noun(device: DeviceDescription) -> str:
    """Return what the samples are, in words."""
    if device.stream in (None, "unknown"):
        return "samples"
    return "deltas" if device.stream == "deltas" else f"{device.stream} samples"


def sensor_axes(report: Report, sensor: str) -> Iterator[tuple[str, Channel]]:
    """Yield the axes of a sensor that the report has."""
    for axis in AXES:
        if (channel := report.channels.get(f"{sensor}/{axis}")) is not None:
            yield axis, channel


def axis_grades(channel: Channel) -> tuple[str, str]:
    """Return the grade that an axis meets and the nearest one; empty texts without a grade."""
    grade = channel.grade
    return (grade.meets or "nothing", grade.nearest) if grade and grade.nearest else ("", "")


def readable_curves(report: Report, sensor: str) -> dict[str, Allan]:
    """Return the Allan deviations of a sensor by axis, in readable units, those that have points."""
    factor = COEFFICIENTS["B"].units[sensor].factor

    def scaled(values: Sequence[float | None]) -> tuple[float | None, ...]:
        return tuple(None if v is None else v * factor for v in values)

    curves = {}
    for axis, channel in sensor_axes(report, sensor):
        if (allan := channel.allan) is not None and allan.tau_s:
            sigma = tuple(s * factor for s in allan.sigma)
            low, high, model, noise = map(scaled, (allan.low, allan.high, allan.model, allan.noise))
            curves[axis] = replace(allan, sigma=sigma, low=low, high=high, model=model, noise=noise)
    return curves


# ---------------------------------------------------------------- text


@dataclass(frozen=True, slots=True)
class TableLayout:
    """Layout of a row of the text table."""

    cell: int  # width of a coefficient
    limits: bool  # whether to show 95 % limits and both grades; else half-width or factor, and one grade
    std: bool  # whether to show the standard deviation

    def width(self, letters: int) -> int:
        """Return the width of a row with this number of coefficients, in cells."""
        numbers, grades = 1 + self.std, 1 + self.limits
        return NAME + (NUMBER + 1) * numbers + (self.cell + 1) * letters + (GRADE + 1) * grades


NAME, NUMBER, GRADE = 12, 11, 10  # widths of columns in cells
FULL = TableLayout(28, limits=True, std=True)
LAYOUTS = (FULL, TableLayout(15, limits=False, std=True), TableLayout(14, limits=False, std=False))
"""From the widest to the narrowest."""


def report_table(report: Report, width: int | None = None) -> str:
    """Return the whole report as lines of text.

    Parameters
    ----------
    width : cells of the terminal; None if the output is no terminal: nothing is abbreviated.
    """
    parts = [
        *_header(report),
        "",
        *channel_rows(report, width),
        "",
        *grade_lines(report),
        *_grade_words(report, width),
        *_goals(report),
    ]
    parts += [*_caveats(report), *_events(report)]
    return "\n".join(parts)


def shown_letters(channels: Iterable[Channel]) -> tuple[str, ...]:
    """Return the coefficients to show of channels: those that each has, and others where one has them."""
    known = {letter for channel in channels for letter in channel.coefficients}
    return tuple(letter for letter in COEFFICIENTS if letter in NOISE or letter in known)


def coefficient_text(coefficient: Estimate | None) -> str:
    """Return a coefficient with the limits that documents state, in readable units: ``0.358 (0.353 to 0.364)``."""
    if coefficient is None:
        return ""
    shown = coefficient.stated.readable
    if coefficient.status == "measured" and shown.value is not None:
        if shown.low is None or shown.high is None:
            return figures(shown.value)
        count = significant_digits(shown.value, shown.high - shown.low)
        low, high = figures(shown.low, count), figures(shown.high, count)
        return f"{figures(shown.value, count)} ({low} to {high})"
    if coefficient.status == "upper_bound" and shown.high is not None:
        return f"< {figures(shown.high)}"
    return no_value_text(coefficient) or "too short"


def without_aliasing(report: Report, name: str, part: Estimate | None) -> Estimate | None:
    """Return N of a channel over the nominal alias factor of the sensor; None: none is known, or it is 1."""
    factor = report.device.alias_factor or 1.0
    if part is None or factor <= ALIASED or sensor_of(name) not in ("gyro", "accel"):
        return None
    return part.scaled(1.0 / factor, part.unit)


def significant_digits(value: float, width: float) -> int:
    """Return how many digits of a value show an interval of that width, three or four.

    >>> significant_digits(0.21, 0.02), significant_digits(0.21, 0.0004), significant_digits(0.21, 0.0)
    (3, 4, 4)
    """
    ratio = width / value if value > 0.0 else 0.0
    if ratio <= 0.0:
        return 4
    return 3 if ratio > 1.0 else min(max(3, 1 - math.floor(math.log10(ratio))), 4)


def _header(report: Report) -> list[str]:
    device, session = report.device, report.session
    title = " ".join(part for part in (device.model, device.serial) if part)
    name = f"{device.id}: {title}" if title and device.id != "replay" else title or device.id
    rate = f"{device.sample_rate_hz:g} Hz" if device.sample_rate_hz else "rate unknown"
    lines = [
        f"{name}  {device.source or ''} {stream_noun(device)}  {rate}  {report.state}",
        f"{duration(session.elapsed_s)}, {counted(session.samples, 'sample')}, {session.missing:,} missing "
        f"in {counted(session.gaps, 'gap')}, {counted(session.bad_checksums, invalid_noun(device))}, "
        f"{counted(session.discarded_bytes, 'byte')} discarded",
    ]
    lines += [alarm.text(value) for alarm, value, _ in known(report) if value]
    excluded = exclusions(report, lambda seconds: f"{seconds:.1f} s")
    if session.disturbances or excluded:
        text = f"{' and '.join(excluded)} excluded" if excluded else "nothing excluded"
        lines.append(f"{counted(session.disturbances, 'disturbance')}, {text}")
    if session.warmup_s:
        lines.append(f"warm-up of {duration(session.warmup_s)} excluded")
    return lines


def invalid_noun(device: DeviceDescription) -> str:
    """Return what `bad_checksums` counts: messages that failed their check, or rows of a table."""
    return "bad checksum" if device.driver else "invalid row"


def channel_rows(report: Report, width: int | None) -> list[str]:
    """Return a line per channel below a heading per sensor, in the widest layout that fits."""
    letters = shown_letters(report.channels.values())
    if width is not None and LAYOUTS[-1].width(len(letters)) > width:
        letters = NOISE
    fitting = (layout for layout in LAYOUTS if width is None or layout.width(len(letters)) <= width)
    layout = next(fitting, LAYOUTS[-1])
    lines, before = [], ""
    for name, channel in report.channels.items():
        if (sensor := sensor_of(name)) != before:
            before = sensor
            axes = [c for n, c in report.channels.items() if sensor_of(n) == sensor]
            lines.append(_heading(axes, layout, letters))
        cells = [f"{name:<{NAME}}", _number(channel.mean), *([_number(channel.std)] if layout.std else [])]
        for letter in letters:
            coefficient = channel.coefficients.get(letter)
            text = coefficient_text(coefficient) if layout.limits else _abbreviated(coefficient)
            cells.append(f"{text:<{layout.cell}}")
        meets, nearest = axis_grades(channel)
        cells += [f"{meets:<{GRADE}}"] if layout.limits else []
        cells.append(nearest)
        lines.append(" ".join(cells).rstrip())
    return [*lines, uncertainty()] if lines and not layout.limits else lines


def _abbreviated(coefficient: Estimate | None) -> str:
    """Return a coefficient with the half-width of its limits or their factor: ``0.358 ±1.5%``, ``3.5 ×÷2.1``."""
    shown = Estimate() if coefficient is None else coefficient.stated.readable
    if shown.status != "measured" or shown.value is None:
        return coefficient_text(coefficient)
    return measured(shown.value, shown.low, shown.high)


def _heading(axes: Sequence[Channel], layout: TableLayout, letters: Sequence[str]) -> str:
    channel = axes[0]
    cells = [f"{f'in {pretty(channel.unit)}':<{NAME}}", f"{'mean':>{NUMBER}}"]
    cells += [f"{'std':>{NUMBER}}"] if layout.std else []
    for letter in letters:
        known = next((each.coefficients[letter] for each in axes if letter in each.coefficients), None)
        name = f"{letter} in " if layout.limits else f"{letter} "
        title = f"{name}{pretty(known.readable.unit)}" if known else ""
        cells.append(f"{title:<{layout.cell}}")
    if channel.grade:
        cells += [f"{'meets':<{GRADE}}"] if layout.limits else []
        cells.append("nearest")
    return " ".join(cells).rstrip()


def _number(value: float | None) -> str:
    return f"{value:>11.4e}" if value is not None else f"{'':>11}"


def grade_lines(report: Report, *, reasons: bool = True) -> list[str]:
    """Return the headline grade of each sensor with what decides it, and why it is provisional."""
    lines = []
    for sensor, grade in report.grade.items():
        decided = grade.decided_by
        by = f"; decided by {decided.coefficient} of {decided.axis}" if decided else ""
        reason = f"; {grade.reason}" if grade.reason and (reasons or not decided) else ""
        lines.append(f"{sensor}: {grade_text(grade)}{by}{reason}")
    return lines


def _grade_words(report: Report, width: int | None) -> list[str]:
    """Return the meaning of both grades, if there are some."""
    graded = any(grade.nearest for grade in report.grade.values())
    return textwrap.wrap(GRADE_WORDS, width or len(GRADE_WORDS)) if graded else []


def _goals(report: Report) -> list[str]:
    """Return how long N, B and K of each axis take until the configured precision, of a record that grows."""
    lines = []
    for letter, share in report.precision.items() if report.state == "running" else ():
        times = {name: (c.time_to or {}).get(letter) for name, c in report.channels.items() if c.grade}
        ahead = [f"{name} in {duration(seconds)}" for name, seconds in times.items() if seconds]
        if ahead:
            lines.append(f"{letter} within ±{100.0 * share:g}%: {', '.join(ahead)}")
    return lines


def _caveats(report: Report) -> list[str]:
    """Return each caveat by its name, with its channels and its meaning."""
    with_curve = sum(1 for channel in report.channels.values() if channel.allan is not None)
    lines = [
        f"caveat {caveat}{f' ({joined(names)})' if 0 < len(names) < with_curve else ''}: "
        + line_with_size(report, caveat)
        for caveat, names in caveats(report).items()
    ]
    warning = filter_warning(report)
    return lines if warning is None else [*lines, f"{FILTER_NOT_KNOWN}: {warning}"]


FILTER_CURE = "For a recording, --filter names it."


def filter_warning(report: Report) -> str | None:
    """Return a warning about samples of a sensor whose filter is unknown; None if there is nothing to warn of."""
    warning = filter_not_known(report)
    return warning and " ".join(filter(None, (warning, driver_advice(report, "unknown"), FILTER_CURE)))


def driver_advice(report: Report, about: str) -> str:
    """Return what the driver of the sensor says about its filter; empty if the driver is unknown."""
    device = report.device
    driver = registry.installed(device.driver)
    return driver.filter_advice(device.sample_rate_hz).get(about, "") if driver is not None else ""


def event_rows(report: Report) -> Iterator[tuple[str, str]]:
    """Yield time and text of the first events of a record; of many, gaps are left out, whose sum the record has."""
    timed = [event for event in report.events if event.elapsed_s is not None]
    shown = timed if len(timed) <= SHOWN_EVENTS else [event for event in timed if event.kind != "gap"]
    for event in shown[:SHOWN_EVENTS]:
        yield f"{event.elapsed_s:,.1f} s", event.text
    if (more := len(timed) - min(len(shown), SHOWN_EVENTS)) > 0:
        yield "", f"{more} more: the forms json and csv list them"


def _events(report: Report) -> list[str]:
    lines = [f"{at:>14}  {text}" for at, text in event_rows(report)]
    return ["", "events, by the time since the first sample", *lines] if lines else []
