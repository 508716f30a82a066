"""Summary of a report on one screen: what a notebook or a prompt shows of a measurement.

Whoever asks has the rest: a summary names what it leaves out.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from imumon.datasheet.html import table_html
from imumon.datasheet.sheet import coefficient_table, shown_sensors
from imumon.datasheet.tables import (
    channel_rows,
    counters_text,
    grade_lines,
    record_title,
    sensor_title,
)
from imumon.messages import caveats, exclusions, joined, line
from imumon.report import Report

WIDTH = 110
"""Characters of a line of channels."""

MOST_REMARKS = 4
"""Remarks, and caveats, that a summary has; it counts the others."""


def summary_text(report: Report, remarks: Sequence[str]) -> str:
    """Return a report as at most a screen of text.

    Parameters
    ----------
    remarks : what was assumed or is doubtful, one line each.
    """
    return "\n".join(
        [*_head(report), "", *channel_rows(report, WIDTH), "", *_notes(report, remarks)]
    ).rstrip()


def summary_html(report: Report, remarks: Sequence[str]) -> str:
    """Return a report as tables of HTML, one per sensor, between its title and its remarks."""
    head = "<br>".join(map(escape, _head(report)))
    tables = "".join(table_html(coefficient_table(report, sensor)) for sensor in shown_sensors(report))
    notes = "".join(f"<li>{escape(text)}</li>" for text in _notes(report, remarks))
    return f"<div><p>{head}</p>{tables}<ul>{notes}</ul></div>"


def _head(report: Report) -> list[str]:
    """Return what was measured, and how much of it counts."""
    excluded = exclusions(report, lambda seconds: f"{seconds:.1f} s")
    lines = [f"{sensor_title(report)}: {record_title(report)}", counters_text(report)]
    return [*lines, *([f"{' and '.join(excluded)} excluded"] if excluded else [])]


def _notes(report: Report, remarks: Sequence[str]) -> list[str]:
    """Return grades, caveats and remarks, those that do not fit as their number."""
    with_curve = sum(1 for channel in report.channels.values() if channel.allan is not None)
    named = [
        f"caveat {caveat}{f' ({joined(names)})' if 0 < len(names) < with_curve else ''}: {line(caveat)}"
        for caveat, names in caveats(report).items()
    ]
    return [*grade_lines(report, reasons=False), *_first(named, "caveats"), *_first(list(remarks), "remarks")]


def _first(lines: list[str], noun: str) -> list[str]:
    more = len(lines) - MOST_REMARKS
    return lines if more <= 0 else [*lines[:MOST_REMARKS], f"{more} more {noun}"]
