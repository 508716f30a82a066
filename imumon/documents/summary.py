"""Summary of a report on one screen: what `status`, the end of `run` and `replay`, and a prompt show.

It has at most `LINES` lines: what was measured, the grades, N, B and K of each axis, and as much of the rest as has
room. The datasheet has everything.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from html import escape

from imumon.documents.html import table_html
from imumon.documents.report_texts import (
    coefficient_text,
    counters_text,
    excluded_sentence,
    record_title,
    sensor_title,
    shown_letters,
)
from imumon.documents.sheet import coefficient_table, shown_sensors
from imumon.model.coefficients import GRADED, NOISE, mean_unit
from imumon.model.ledger import RECEIVED, SAMPLES, ledger_text
from imumon.model.messages import (
    FILTER_NOT_KNOWN,
    caveat_lines,
    caveats,
    change_text,
    filter_not_known,
    grade_text,
    has_indistinct,
    joined,
    loss_text,
    uncertainty,
)
from imumon.model.readiness import readiness
from imumon.model.report import Report
from imumon.model.samples import TEMPERATURE
from imumon.model.units import duration, in_columns, pretty, share_text

LINES = 23
"""Lines of a summary: a terminal of 80 x 24 cells also shows the prompt."""
WIDTH = 110
"""Cells of a line where there is no terminal."""
FILTER_LINE = "the filter of the sensor is unknown: N may be too high. For a recording, --filter names it"
"""What the caveat of a filter that nothing names means."""
EXPECTED = {RECEIVED, SAMPLES, "header", "comment", "blank", "other_message", "part", "start", "pending"}
"""What the ledger of a good record has: with nothing else in it, its line is not printed."""


def summary_text(
    report: Report,
    width: int = WIDTH,
    *,
    late: str | None = None,
    remarks: Sequence[str] = (),
    last: Sequence[str] = (),
) -> str:
    """Return a report as at most a screen of text.

    Parameters
    ----------
    width : cells of a line.
    late : why the numbers are not current; None: they are.
    remarks : what was assumed or is doubtful, one line each.
    last : lines that are at the end in any case.
    """
    head = [part for text in _head(report, late) for part in textwrap.wrap(text, width)]
    lines = [*head, *_channel_rows(report, width)]
    for text in (*_notes(report), *remarks, *_caveat_lines(report)):
        part = textwrap.wrap(text, width, subsequent_indent="  ")
        if len(lines) + len(part) + len(last) <= LINES:
            lines += part
    return "\n".join([*lines, *last])


def summary_html(report: Report, remarks: Sequence[str]) -> str:
    """Return a report as tables of HTML, one per sensor, between its title and its remarks."""
    head = "<br>".join(map(escape, _head(report)))
    tables = "".join(table_html(coefficient_table(report, sensor)) for sensor in shown_sensors(report))
    notes = "".join(
        f"<li>{escape(text)}</li>" for text in (*_notes(report), *remarks, *_caveat_lines(report))
    )
    return f"<div><p>{head}</p>{tables}<ul>{notes}</ul></div>"


def _head(report: Report, late: str | None = None) -> Iterator[str]:
    """Yield what was measured and in which state it is, how much of it counts, and the grades."""
    device = report.device
    where = f" on {device.port}" if device.port else ""
    title = sensor_title(report)
    yield title if device.id == "replay" else f"{report.state}: {device.id}, {title}{where}"
    if late:
        yield late
    channel = report.channels.get(TEMPERATURE)
    degrees = f", {channel.last:.1f} °C" if channel is not None and channel.last is not None else ""
    times = filter(None, report.recording.times if report.recording is not None else ())
    yield f"{record_title(report)}{degrees}{''.join(f', time from {name}' for name in times)}"
    yield f"{counters_text(report)}. {excluded_sentence(report)}"
    if report.session.recent_loss:
        yield loss_text(report.session.recent_loss)
    for sensor, grade in report.grade.items():
        decided = grade.decided_by
        reason = f"decided by {decided.coefficient} of {decided.axis}" if decided else grade.reason
        yield f"{sensor}: {grade_text(grade)}{f'; {reason}' if reason else ''}"
    if not report.session.samples:
        yield from device.remarks


def _notes(report: Report) -> Iterator[str]:
    """Yield what restricts the numbers, the most important first, and what is still to come."""
    if names := _caveat_names(report):
        yield f"caveats: {', '.join(names)}"
    yield from _length_notes(report)
    for name, channel in report.channels.items():
        yield from (change_text(name, change) for change in channel.changes)
    if report.data_sheet is not None and report.data_sheet.values:
        above = [f"{value.channel} {value.coefficient}" for value in report.data_sheet.values if value.above]
        yield f"above the data sheet {report.data_sheet.title}: {', '.join(above) or 'nothing'}"
    if report.session.ledger.keys() - EXPECTED:
        yield ledger_text(report.session.ledger)


def _caveat_names(report: Report) -> list[str]:
    """Return the caveats in words, each with its channels if it is not one of all."""
    with_curve = sum(1 for channel in report.channels.values() if channel.allan is not None)
    names = [FILTER_NOT_KNOWN] if filter_not_known(report) else []
    for caveat, channels in caveats(report).items():
        of_some = f" ({joined(channels)})" if 0 < len(channels) < with_curve else ""
        names.append(caveat.replace("_", " ") + of_some)
    return names


def _length_notes(report: Report) -> Iterator[str]:
    """Yield which goals of precision take more time, and for which of them a record that has ended was enough."""
    goals = {
        item: f"{item.letter} within ±{share_text(report.precision[item.letter])}"
        for item in readiness(report, report.precision)
    }
    if times := [f"{text} in {duration(item.seconds)}" for item, text in goals.items() if item.seconds]:
        yield f"still to come: {', '.join(times)}"
    if report.state == "stopped" and goals:
        enough = ", ".join(text for item, text in goals.items() if item.ready)
        short = ", ".join(text for item, text in goals.items() if not item.ready)
        parts = (f"enough for {enough}" if enough else "", f"too short for {short}" if short else "")
        yield f"the record is {', '.join(filter(None, parts))}"


def _caveat_lines(report: Report) -> list[str]:
    """Return a line for a filter that nothing names, and one for each caveat."""
    unknown = filter_not_known(report)
    return [*([FILTER_LINE] if unknown else []), *caveat_lines(report)]


def comparison_text(report: Report, baseline: Report) -> str | None:
    """Return a line if no channel differs from a baseline or none can; None if changes say what differs."""
    changes = (change for channel in report.channels.values() for change in channel.changes)
    if any(change.against == "baseline" for change in changes):
        return None
    pairs = [
        [one.channels[name].coefficients[letter].status for one in (report, baseline)]
        for name in report.channels.keys() & baseline.channels.keys()
        for letter in GRADED
        if letter in report.channels[name].coefficients and letter in baseline.channels[name].coefficients
    ]
    if ["measured", "measured"] in pairs:
        return "nothing changed against the baseline"
    return "nothing to compare with the baseline: no N or B is measured in both"


def _channel_rows(report: Report, width: int) -> list[str]:
    """Return a line per axis below a heading per sensor; without correlated noise where it has no room."""
    lines: list[str] = []
    for letters in (shown_letters(report.channels.values()), NOISE):
        lines = in_columns(_channel_cells(report, letters), " ")
        if max(map(len, lines), default=0) <= width:
            break
    return [*lines, *([uncertainty(indistinct=has_indistinct(report))] if lines else [])]


def _channel_cells(report: Report, letters: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Yield the cells of each line of `_channel_rows`: for each sensor its heads, then its axes."""
    before, factor = "", 1.0
    axes = {name: channel for name, channel in report.channels.items() if channel.estimates}
    for name, channel in axes.items():
        if (sensor := name.sensor) != before:
            before = sensor
            factor, unit = mean_unit(sensor, channel.unit)
            units = {
                letter: other.estimates[letter].readable.unit
                for other_name, other in axes.items()
                for letter in other.estimates
                if other_name.sensor == sensor
            }
            heads = (f"{letter} {pretty(units[letter])}" if letter in units else "" for letter in letters)
            yield (f"in {pretty(unit)}", f"{'mean':>11}", *heads, "grade" if channel.grade else "")
        mean = "" if channel.mean is None else f"{factor * channel.mean:>11.4e}"
        noise = (coefficient_text(channel.estimates.get(letter), short=True) for letter in letters)
        word = channel.grade.meets if channel.grade is not None else None
        yield (name, mean, *noise, word or "")
