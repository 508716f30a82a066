"""Summary of a report on one screen: what a notebook or a prompt shows of a measurement.

Whoever asks has the rest: a summary names what it leaves out.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from imumon.datasheet.tables import (
    channel_rows,
    coefficient_text,
    counters_text,
    grade_lines,
    record_title,
    sensor_title,
    shown_letters,
)
from imumon.messages import caveats, exclusions, joined, line
from imumon.report import Report
from imumon.samples import sensor_of
from imumon.units import pretty

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
    parts = [f"<p>{'<br>'.join(map(escape, _head(report)))}</p>"]
    sensors = dict.fromkeys(sensor_of(name) for name, channel in report.channels.items() if channel.estimates)
    for sensor in sensors:
        channels = {n: c for n, c in report.channels.items() if sensor_of(n) == sensor and c.estimates}
        letters = [
            letter
            for letter in shown_letters(channels.values())
            if any(letter in c.estimates for c in channels.values())
        ]
        known = {
            letter: next(c.estimates[letter] for c in channels.values() if letter in c.estimates)
            for letter in letters
        }
        heads = "".join(
            f"<th>{letter}, {escape(pretty(known[letter].readable.unit))}</th>" for letter in letters
        )
        rows = "".join(
            f"<tr><th>{escape(name)}</th>"
            + "".join(f"<td>{escape(coefficient_text(c.estimates.get(letter)))}</td>" for letter in letters)
            + "</tr>"
            for name, c in channels.items()
        )
        parts.append(f"<table><thead><tr><th></th>{heads}</tr></thead><tbody>{rows}</tbody></table>")
    notes = "".join(f"<li>{escape(text)}</li>" for text in _notes(report, remarks))
    return f"<div>{''.join(parts)}<ul>{notes}</ul></div>"


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
