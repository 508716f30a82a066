"""Table of all channels with their numbers, grouped by sensor.

Each column is as wide as its longest possible text, because a truncated number is a wrong number. On a narrow
screen whole columns are omitted.
"""

from __future__ import annotations

from collections.abc import Sequence

from imumon.report import NOISE, Channel
from imumon.samples import INERTIAL, sensor_of
from imumon.tui.formatting import CELL, Line, fitted, padded, remaining_time, with_background
from imumon.tui.view_state import ViewState
from imumon.units import number, short

COLUMNS = {"mean": 10, "std": 8, **dict.fromkeys(NOISE, CELL + 1), "nearest": 11}
"""Cells of each column, including the gap before it."""
LABEL = 6
"""Cells of the name of a sensor or an axis, before the columns."""
TABLE = LABEL + sum(COLUMNS.values())
"""Cells of the whole table."""


def columns(width: int, *, times: bool = False) -> list[str]:
    """Return the columns that fit; `times`: those of the time to each precision."""
    kept = {name: cells for name, cells in COLUMNS.items() if not times or name not in ("mean", "std")}
    for name in ("std", "mean", "nearest", *reversed(NOISE[1:])):
        if LABEL + sum(kept.values()) <= width:
            break
        kept.pop(name, None)
    return list(kept)


def table(state: ViewState, width: int, height: int) -> list[Line]:
    """Return all channels, grouped by sensor, scrolled so that the selected one is visible."""
    return [padded(line, width) for line, _ in table_rows(state, width, height)]


def table_rows(state: ViewState, width: int, height: int) -> list[tuple[Line, str | None]]:
    """Return the visible lines of the table, each with its channel; None for a heading."""
    rows = rows_of(state, width, spaced=True)
    if len(rows) > height:
        rows = rows_of(state, width)
    at = next((k for k, (_, channel) in enumerate(rows) if channel == state.channel), 0)
    first = min(max(at - height + 2, 0), max(len(rows) - height, 0))
    return rows[first : first + height]


def rows_of(state: ViewState, width: int = TABLE, *, spaced: bool = False) -> list[tuple[Line, str | None]]:
    """Return every line of the table; `spaced`: with an empty one before each group."""
    report = state.report
    if report is None:
        return []
    shown = columns(width, times=state.show_times)
    rows: list[tuple[Line, str | None]] = []
    hint: list[Line] = [[("   p", "key"), (" values", "muted")]] if state.show_times else []
    last = None
    for name, channel in report.channels.items():
        group = sensor_of(name) if "/" in name else "surroundings"
        if group != last:
            if spaced and rows:
                rows.append(([], None))
            if "/" in name:
                rows.append((fitted([_heading(state, group, shown), *hint], width), None))
                hint = []
        last = group
        line = _row(state, name, channel, shown) if "/" in name else _single(state, name, channel, width)
        line = padded(line, min(TABLE, width))
        rows.append((with_background(line, "selected") if name == state.channel else line, name))
    return rows


def _heading(state: ViewState, sensor: str, shown: Sequence[str]) -> Line:
    """Return names and units of the columns for one sensor."""
    notation, precision = state.notation, state.report.precision if state.report is not None else {}
    cells: dict[str, Line] = {
        "mean": [(f"mean {notation.scale(f'{sensor}/x')[1]}".rjust(COLUMNS["mean"]), "muted")],
        "std": [("std".rjust(COLUMNS["std"]), "muted")],
        "nearest": [(" nearest" if sensor in INERTIAL else "", "muted")],
    }
    for name in NOISE:
        goal = notation.goal(precision[name]) if name in precision else ""
        text = f"{name} {goal if state.show_times else notation.coefficient_scale(sensor, name)[1]}"
        cells[name] = [(" " * (COLUMNS[name] - len(text)), "text"), (name, name), (text[1:], "muted")]
    return [(f" {sensor:<5}", "title"), *(span for name in shown for span in cells[name])]


def _row(state: ViewState, name: str, channel: Channel, shown: Sequence[str]) -> Line:
    """Return one axis of a sensor."""
    factor, _ = state.notation.scale(name)
    nearest = channel.grade.nearest if channel.grade is not None else None
    blank = "–" if sensor_of(name) in INERTIAL else ""
    mean = "–" if channel.mean is None else number(channel.mean * factor, 4)
    cells: dict[str, tuple[str, str]] = {
        "mean": (mean, "text"),
        "std": ("–" if channel.std is None else short(channel.std * factor), "text"),
        "nearest": (f" {nearest or blank:<10}", f"grade-{nearest}" if nearest else "faint"),
    }
    for part in NOISE:
        seconds = (channel.time_to or {}).get(part)
        known = channel.coefficients.get(part)
        cells[part] = (
            remaining_time(known, seconds) if state.show_times else state.notation.coefficient(known, seconds)
        )
    line: Line = [("▌" if name == state.channel else " ", "accent"), (f"  {name[-1]}  ", "strong")]
    return line + [(cells[c][0].rjust(COLUMNS[c]), cells[c][1]) for c in shown]


def _single(state: ViewState, name: str, channel: Channel, width: int) -> Line:
    """Return temperature or pressure, which have running statistics only."""
    factor, unit = state.notation.scale(name)
    parts: list[Line] = [[("▌" if name == state.channel else " ", "accent"), (f"{name:<12}", "title")]]
    if channel.last is not None:
        parts.append([(f"now {number(channel.last * factor, 5)} {unit}".ljust(20), "text")])
    if channel.mean is not None:
        parts.append([(f"mean {number(channel.mean * factor, 5)} {unit}".ljust(21), "muted")])
    if channel.std is not None:
        parts.append([(f"std {short(channel.std * factor)}", "muted")])
    return fitted(parts, width)
