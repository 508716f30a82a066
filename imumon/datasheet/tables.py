"""Tables of a report as plain text, for a terminal or a pipe, and the texts that other forms share with them."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from imumon.coefficients import COEFFICIENTS, NOISE, Estimate, mean_unit
from imumon.devices import registry
from imumon.ledger import RECEIVED, SAMPLES, ledger_text
from imumon.messages import (
    FILTER_NOT_KNOWN,
    GRADE_WORDS,
    caveats,
    exclusions,
    filter_not_known,
    grade_text,
    grade_word,
    has_indistinct,
    joined,
    line_with_size,
    loss_text,
    no_value_text,
    uncertainty,
)
from imumon.report import Allan, Channel, DeviceDescription, Report
from imumon.samples import ALIASED, AXES, INERTIAL, sensor_of
from imumon.units import counted, duration, figures, measured, pretty, share_text

MOST_OF_A_KIND = 12
"""Events of one kind that are listed one by one; the forms json and csv have all."""

NUMBER = 11
"""Cells of a mean, such as -1.2345e-03."""
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
    """Return the grade of an axis and the nearest one; empty texts without a grade."""
    grade = channel.grade
    return (grade_word(grade.meets, grade.nearest), grade.nearest) if grade and grade.nearest else ("", "")


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


def report_table(report: Report, width: int | None = None, *, verbose: bool = False) -> str:
    """Return the whole report as lines of text.

    Parameters
    ----------
    width : cells of the terminal; None if the output is no terminal: nothing is abbreviated.
    verbose : with what became of everything that was received, and of every column.
    """
    parts = [
        *_header(report, verbose=verbose),
        "",
        *channel_rows(report, width),
        "",
        *grade_lines(report),
        *_grade_words(report, width),
    ]
    for goal, ahead in goals(report):
        parts.append(f"{goal}: {', '.join(f'{name} in {duration(s)}' for name, s in ahead.items())}")
    return "\n".join([*parts, *_caveats(report), *_events(report)])


def status_table(report: Report, width: int, late: str | None) -> str:
    """Return one report on one screen: the state first, then the grades, and one line per channel.

    It fits a terminal of 80 x 24 cells for a sensor of nine axes; a wider one shows the limits of each coefficient.

    Parameters
    ----------
    width : cells of the terminal.
    late : why the numbers are not current; None: they are.
    """
    device = report.device
    where = f" on {device.port}" if device.port else ""
    lines = [
        f"{report.state}: {device.id}, {sensor_title(report)}{where}",
        *([late] if late else []),
        f"{record_title(report)}{_temperature(report)}",
        counters_text(report),
        *(device.remarks if not report.session.samples else ()),
    ]
    facts = [loss_text(report.session.recent_loss)] if report.session.recent_loss else []
    if excluded := exclusions(report, duration):
        facts.append(f"{' and '.join(excluded)} excluded")
    lines += ["; ".join(facts)] if facts else []
    lines += grade_lines(report, reasons=False)
    if names := [caveat.replace("_", " ") for caveat in caveats(report)]:
        lines.append(f"caveats: {', '.join(names)} (--verbose explains them)")
    noise = {name: channel for name, channel in report.channels.items() if channel.estimates}
    rows = channel_rows(replace(report, channels=noise), width) if noise else []
    if slowest := [f"{goal} in {duration(max(ahead.values()))}" for goal, ahead in goals(report)]:
        lines.append(f"still to come: {', '.join(slowest)}")
    return "\n".join([*lines, *rows])


def _temperature(report: Report) -> str:
    channel = report.channels.get("temperature")
    return f", {channel.last:.1f} °C" if channel is not None and channel.last is not None else ""


def shown_letters(channels: Iterable[Channel]) -> tuple[str, ...]:
    """Return the coefficients to show of channels: those that each has, and others where one has them."""
    known = {letter for channel in channels for letter in channel.estimates}
    return tuple(letter for letter in COEFFICIENTS if letter in NOISE or letter in known)


def coefficient_text(coefficient: Estimate | None, *, short: bool = False) -> str:
    """Return a coefficient with the limits that documents state, in readable units: ``0.358 (0.353 to 0.364)``.

    Parameters
    ----------
    short : with the half-width of its limits or their factor instead: ``0.358 ±1.5 %``, ``3.5 ×÷2.1``.
    """
    if coefficient is None:
        return ""
    pending = no_value_text(coefficient) or "too short"
    value = measured if short else with_limits
    return coefficient.stated.readable.text(value, lambda high: f"< {figures(high)}", pending)


def without_aliasing(report: Report, name: str, part: Estimate | None) -> Estimate | None:
    """Return N of a channel over the nominal alias factor of the sensor; None: none is known, or it is 1."""
    factor = report.device.alias_factor or 1.0
    if part is None or factor <= ALIASED or sensor_of(name) not in INERTIAL:
        return None
    return part.scaled(1.0 / factor, part.unit)


def with_limits(value: float, low: float | None, high: float | None) -> str:
    """Return a value with its limits, with as many digits, three or four, as show their width.

    >>> with_limits(0.21, 0.20, 0.22), with_limits(0.21, 0.2098, 0.2102), with_limits(0.21, None, None)
    ('0.210 (0.200 to 0.220)', '0.2100 (0.2098 to 0.2102)', '0.210')
    """
    if low is None or high is None:
        return figures(value)
    digits = 4 if high - low < 0.01 * value else 3
    return f"{figures(value, digits)} ({figures(low, digits)} to {figures(high, digits)})"


def _header(report: Report, *, verbose: bool = False) -> list[str]:
    """Return sensor, stream, length and counters, and what was excluded."""
    device, session = report.device, report.session
    title = " ".join(part for part in (device.model, device.serial) if part)
    name = f"{device.id}: {title}" if title and device.id != "replay" else title or device.id
    rate = f"{device.sample_rate_hz:g} Hz" if device.sample_rate_hz else "rate unknown"
    lines = [
        f"{name}  {device.source or ''} {stream_noun(device)}  {rate}  {report.state}",
        f"{duration(session.elapsed_s)}, {counters_text(report)}, "
        f"{counted(session.discarded_bytes, 'byte')} discarded",
    ]
    if session.recent_loss:
        lines.append(loss_text(session.recent_loss))
    excluded = exclusions(report, lambda seconds: f"{seconds:.1f} s")
    if session.disturbances or excluded:
        text = f"{' and '.join(excluded)} excluded" if excluded else "nothing excluded"
        lines.append(f"{counted(session.disturbances, 'disturbance')}, {text}")
    if session.warmup_s:
        lines.append(f"warm-up of {duration(session.warmup_s)} excluded")
    return [*lines, *account_lines(report, verbose=verbose)]


EXPECTED = {RECEIVED, SAMPLES, "header", "comment", "blank", "other_message", "part", "start", "pending"}
"""What the ledger of a good record has: with nothing else in it, its line is not printed."""


def account_lines(report: Report, *, verbose: bool = False) -> Iterator[str]:
    """Yield which column is the time, and what became of what was received unless all of it are samples.

    Parameters
    ----------
    verbose : with every column, and the ledger in any case.
    """
    columns = report.recording.columns if report.recording is not None else ()
    if report.recording is not None and not verbose:
        yield from (f"time from {name}" for name in report.recording.times)
    ledger = report.session.ledger
    if verbose or ledger.keys() - EXPECTED:
        yield from filter(None, [ledger_text(ledger)])
    for column in columns if verbose else ():
        yield f"column {column.name}: {column.use or f'not used, {column.reason}'}"


def counters_text(report: Report) -> str:
    """Return how many samples arrived, and how many did not."""
    session = report.session
    return (
        f"{counted(session.samples, 'sample')}, {session.missing:,} missing in {counted(session.gaps, 'gap')}, "
        f"{counted(session.bad_checksums, invalid_noun(report.device))}"
    )


def excluded_sentence(report: Report) -> str:
    """Return what was excluded from the record, in one sentence."""
    excluded = [f"{text} as disturbed" for text in exclusions(report, _length)]
    if warmup_s := report.session.warmup_s:
        excluded.append(f"a warm-up of {_length(warmup_s)}")
    return f"Excluded: {'; '.join(excluded)}." if excluded else "Nothing is excluded."


def _length(seconds: float) -> str:
    return duration(seconds) if seconds >= 60.0 else f"{seconds:.1f} s"


def invalid_noun(device: DeviceDescription) -> str:
    """Return what `bad_checksums` counts: messages that failed their check, or rows of a table."""
    return "bad checksum" if device.driver else "invalid row"


def channel_rows(report: Report, width: int | None) -> list[str]:
    """Return a line per channel below a heading per sensor, with as much as fits into `width` cells.

    The widest form has 95 % limits, both grades and the standard deviation, others the half-width or factor of the
    limits, the narrowest N, B and K alone.
    """
    lines: list[str] = []
    signs = uncertainty(indistinct=has_indistinct(report))
    for letters in (shown_letters(report.channels.values()), NOISE):
        for limits, std in ((True, True), (False, True), (False, False)):
            rows = list(_channel_cells(report, letters, limits=limits, std=std))
            widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
            lines = [
                " ".join(f"{cell:<{n}}" for cell, n in zip(row, widths, strict=True)).rstrip() for row in rows
            ]
            if width is None or max(map(len, lines), default=0) <= width:
                return [*lines, *([] if limits or not lines else [signs])]
    return [*lines, signs]


def _channel_cells(
    report: Report, letters: Sequence[str], *, limits: bool, std: bool
) -> Iterator[tuple[str, ...]]:
    """Yield the cells of each line of `channel_rows`: for each sensor its heads, then its channels."""
    statistics, before, factor = ("mean", "std")[: 1 + std], "", 1.0
    for name, channel in report.channels.items():
        if (sensor := sensor_of(name)) != before:
            before = sensor
            factor, unit = mean_unit(sensor, channel.unit)
            heads = [f"in {pretty(unit)}", *(f"{statistic:>{NUMBER}}" for statistic in statistics)]
            heads += _letter_heads(report, sensor, letters, limits=limits)
            yield (*heads, *(("grade", "nearest") if channel.grade else ("", ""))[: 1 + limits])
        numbers = (_number(getattr(channel, statistic), factor) for statistic in statistics)
        noise = (coefficient_text(channel.estimates.get(letter), short=not limits) for letter in letters)
        yield (name, *numbers, *noise, *axis_grades(channel)[: 1 + limits])


def _letter_heads(report: Report, sensor: str, letters: Sequence[str], *, limits: bool) -> Iterator[str]:
    """Yield the letter and the unit of each coefficient of a sensor; empty if no axis has it."""
    axes = [channel for name, channel in report.channels.items() if sensor_of(name) == sensor]
    for letter in letters:
        known = next((axis.estimates[letter] for axis in axes if letter in axis.estimates), None)
        unit = f"{' in' if limits else ''} {pretty(known.readable.unit)}" if known else ""
        yield f"{letter}{unit}" if known else ""


def _number(value: float | None, factor: float) -> str:
    return "" if value is None else f"{factor * value:>{NUMBER}.4e}"


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


def goals(report: Report) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield each precision that is still to come of a record that grows, with the time until then, s, by axis."""
    for letter, share in report.precision.items() if report.state == "running" else ():
        times = {name: (c.time_to or {}).get(letter) for name, c in report.channels.items() if c.grade}
        if ahead := {name: seconds for name, seconds in times.items() if seconds}:
            yield f"{letter} within ±{share_text(share)}", ahead


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
    """Yield time and text of the events of a record; many of one kind are one row."""
    timed = [(event.elapsed_s, event) for event in report.events if event.elapsed_s is not None]
    counts = Counter(event.kind for _, event in timed)
    summed: set[str] = set()
    for begin_s, event in timed:
        if counts[event.kind] <= MOST_OF_A_KIND:
            yield f"{begin_s:,.1f} s", event.text
        elif event.kind not in summed:
            summed.add(event.kind)
            same = [(other_s, other) for other_s, other in timed if other.kind == event.kind]
            length_s = sum(other.length_s or 0.0 for _, other in same)
            whole = f", {length_s:,.1f} s in all" if length_s else ""
            count = counted(len(same), event.kind.replace("_", " "))
            yield f"{begin_s:,.1f} s", f"{count} until {same[-1][0]:,.1f} s{whole}"


def data_sheet_lines(report: Report) -> list[str]:
    """Return which coefficients are above the data sheet of the sensor, and why others may be."""
    if report.data_sheet is None or not report.data_sheet.values:
        return []
    sheet = report.data_sheet
    above = [f"{value.channel} {value.coefficient}" for value in sheet.values if value.above]
    lines = [f"data sheet: {sheet.title} ({sheet.document}); above it: {', '.join(above) or 'nothing'}"]
    doubts: dict[str, list[str]] = {}
    for value in sheet.values:
        if value.reason:
            doubts.setdefault(value.reason, []).append(value.channel)
    return lines + [f"  N of {joined(names)} may be above: {reason}" for reason, names in doubts.items()]


def _events(report: Report) -> list[str]:
    lines = [f"{time:>14}  {text}" for time, text in event_rows(report)]
    return ["", "events, by the time since the first sample", *lines] if lines else []
