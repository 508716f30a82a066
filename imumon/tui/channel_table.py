"""Table: all channels with their numbers, grouped by sensor.

The columns have fixed widths, each as wide as the longest text that can stand in it: a cut number is
a wrong number. Where the screen is too narrow, whole columns are left out.
"""

from __future__ import annotations

from collections.abc import Sequence

from imumon.report import COEFFICIENTS, Channel
from imumon.samples import sensor_of
from imumon.tui.formatting import CELL, Line, Notation, fitted, on, padded, remaining, signed
from imumon.tui.view_state import ViewState
from imumon.units import number, short

TABLE = 80
"""Cells the whole table takes."""
GRADED = ("gyro", "accel")
COLUMNS = {"mean": 10, "std": 8, "N": CELL + 1, "B": CELL + 1, "K": CELL + 1, "grade": 11}
"""Cells of each column of the table, the gap before it included."""
LABEL = 6


def columns(width: int) -> list[str]:
    """Columns for which there is room: on a narrow screen some are left out, none is cut."""
    kept = dict(COLUMNS)
    for name in ("std", "mean", "grade", "K", "B"):
        if LABEL + sum(kept.values()) <= width:
            break
        del kept[name]
    return list(kept)


def table(scene: ViewState, width: int, height: int) -> list[Line]:
    """All channels, grouped by sensor, moved so that the chosen one is seen."""
    return [padded(line, width) for line, _ in table_rows(scene, width, height)]


def table_rows(scene: ViewState, width: int, height: int) -> list[tuple[Line, str | None]]:
    """Lines of the table that are seen, each with its channel; None for a heading."""
    rows = rows_of(scene, width, airy=True)
    if len(rows) > height:
        rows = rows_of(scene, width)
    at = next((k for k, (_, channel) in enumerate(rows) if channel == scene.channel), 0)
    first = min(max(at - height + 2, 0), max(len(rows) - height, 0))
    return rows[first : first + height]


def rows_of(scene: ViewState, width: int = TABLE, *, airy: bool = False) -> list[tuple[Line, str | None]]:
    """Every line of the table; airy: an empty one before each group."""
    report = scene.report
    if report is None:
        return []
    shown = columns(width)
    rows: list[tuple[Line, str | None]] = []
    last = None
    for name, channel in report.channels.items():
        group = sensor_of(name) if "/" in name else "surroundings"
        if group != last:
            if airy and rows:
                rows.append(([], None))
            if "/" in name:
                rows.append((_heading(scene.notation, group, shown), None))
        last = group
        line = _row(scene, name, channel, shown) if "/" in name else _single(scene, name, channel, width)
        line = padded(line, min(TABLE, width))
        rows.append((on(line, "chosen") if name == scene.channel else line, name))
    return rows


def _heading(notation: Notation, sensor: str, shown: Sequence[str]) -> Line:
    """Names and units of the columns, for one sensor."""
    cells: dict[str, Line] = {
        "mean": [(f"mean {notation.scale(f'{sensor}/x')[1]}".rjust(COLUMNS["mean"]), "muted")],
        "std": [("std".rjust(COLUMNS["std"]), "muted")],
        "grade": [(" grade" if sensor in GRADED else "", "muted")],
    }
    for name in COEFFICIENTS:
        text = f"{name} {notation.coefficient_unit(sensor, name)}"
        cells[name] = [(" " * (COLUMNS[name] - len(text)), "text"), (name, name), (text[1:], "muted")]
    return [(f" {sensor:<5}", "title"), *(piece for name in shown for piece in cells[name])]


def _row(scene: ViewState, name: str, channel: Channel, shown: Sequence[str]) -> Line:
    """One axis of a sensor."""
    factor, _ = scene.notation.scale(name)
    nearest = channel.grade.nearest if channel.grade is not None else None
    blank = "–" if sensor_of(name) in GRADED else ""
    mean = "–" if channel.mean is None else signed(channel.mean * factor)
    cells: dict[str, tuple[str, str]] = {
        "mean": (mean, "text"),
        "std": ("–" if channel.std is None else short(channel.std * factor), "text"),
        "grade": (f" {nearest or blank:<10}", f"grade-{nearest}" if nearest else "faint"),
    }
    for part in COEFFICIENTS:
        cells[part] = scene.notation.coefficient(getattr(channel, part), remaining(channel.time_to, part))
    line: Line = [("▌" if name == scene.channel else " ", "accent"), (f"  {name[-1]}  ", "strong")]
    return line + [(cells[c][0].rjust(COLUMNS[c]), cells[c][1]) for c in shown]


def _single(scene: ViewState, name: str, channel: Channel, width: int) -> Line:
    """Temperature or pressure: running statistics alone."""
    factor, unit = scene.notation.scale(name)
    parts: list[Line] = [[("▌" if name == scene.channel else " ", "accent"), (f"{name:<12}", "title")]]
    if channel.last is not None:
        parts.append([(f"now {number(channel.last * factor, 5)} {unit}".ljust(20), "text")])
    if channel.mean is not None:
        parts.append([(f"mean {number(channel.mean * factor, 5)} {unit}".ljust(21), "muted")])
    if channel.std is not None:
        parts.append([(f"std {short(channel.std * factor)}", "muted")])
    return fitted(parts, width)
