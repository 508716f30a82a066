"""Table of all channels with their numbers, grouped by sensor.

Each column is as wide as its longest possible text, because a truncated number is a wrong number. On a narrow
screen whole columns are omitted.
"""

from __future__ import annotations

from collections.abc import Sequence

from imumon.model.coefficients import MARKOV, NOISE
from imumon.model.readiness import seconds_left, state_of
from imumon.model.report import Channel, Report
from imumon.model.samples import INERTIAL, ChannelName
from imumon.model.units import number, short
from imumon.tui.formatting import CELL, Line, fitted, padded, with_background
from imumon.tui.view_state import ViewState

COLUMNS = {"mean": 10, "std": 8, **dict.fromkeys((*NOISE, *MARKOV), CELL + 3), "grade": 12}
"""Cells of each column, including the gap before it; of a coefficient also a blank and the symbol of its state."""
SYMBOLS = {"ready": ("✓", "good"), "growing": ("↗", "muted"), "bound": ("↓", "bound"), "none": (" ", "text")}
"""Symbol of the state of a coefficient, and its role."""
LABEL = 6
"""Cells of the name of a sensor or an axis, before the columns."""
TABLE = LABEL + sum(cells for name, cells in COLUMNS.items() if name not in (*MARKOV, "std"))
"""Cells of the table where no channel has correlated noise M, without the standard deviation."""


def letters_of(report: Report) -> tuple[str, ...]:
    """Return the coefficients of the table: those that each channel has, and correlated noise where one has it."""
    known = report.channels.values()
    shown = {letter for channel in known if channel.M is not None for letter in channel.estimates}
    return (*NOISE, *(letter for letter in MARKOV if letter in shown))


def columns(width: int, letters: Sequence[str] = NOISE) -> list[str]:
    """Return the columns that fit."""
    left_out = {*MARKOV} - {*letters}
    kept: set[str] = set()
    # N, the first one, is kept on any screen; M is more than the mean, which may fit where M does not
    for name in (*NOISE, "grade", MARKOV.sigma, "mean", MARKOV.time_constant_s, "std"):
        needed = LABEL + COLUMNS[name] + sum(COLUMNS[other] for other in kept)
        # what says little alone: a time constant without its sigma, a deviation without its mean
        partner = {MARKOV.time_constant_s: MARKOV.sigma, "std": "mean"}.get(name)
        if name not in left_out and partner in (None, *kept) and (needed <= width or not kept):
            kept.add(name)
    return [name for name in COLUMNS if name in kept]


def table(state: ViewState, width: int, height: int) -> list[Line]:
    """Return all channels, grouped by sensor, scrolled so that the selected one is visible."""
    return [padded(line, width) for line, _ in table_rows(state, width, height)]


def table_rows(state: ViewState, width: int, height: int) -> list[tuple[Line, str | None]]:
    """Return the visible lines of the table, each with its channel; None for a heading."""
    rows = rows_of(state, width, spaced=True)
    if len(rows) > height:  # the empty lines go before any channel does
        rows = rows_of(state, width)
    selected = next((k for k, (_, channel) in enumerate(rows) if channel == state.channel), 0)
    first = min(max(selected - height + 2, 0), max(len(rows) - height, 0))  # one line below it stays visible
    return rows[first : first + height]


def rows_of(state: ViewState, width: int = TABLE, *, spaced: bool = False) -> list[tuple[Line, str | None]]:
    """Return every line of the table; `spaced`: with an empty one before each group."""
    report = state.report
    shown = columns(width, letters_of(report))
    whole = LABEL + sum(COLUMNS[name] for name in shown)
    rows: list[tuple[Line, str | None]] = []
    last = None
    for name, channel in report.channels.items():
        group = name.sensor if "/" in name else "surroundings"
        if state.folded and group not in (*INERTIAL, state.channel.sensor):
            continue  # folded, until one of its channels is selected
        if group != last:
            if spaced and rows:
                rows.append(([], None))
            if "/" in name:
                rows.append((fitted([_heading(state, group, shown)], width), None))
        last = group
        line = _row(state, name, channel, shown) if "/" in name else _single(state, name, channel, width)
        line = padded(line, min(max(TABLE, whole), width))
        rows.append((with_background(line, "selected") if name == state.channel else line, name))
    return rows


def _heading(state: ViewState, sensor: str, shown: Sequence[str]) -> Line:
    """Return names and units of the columns for one sensor."""
    notation = state.notation
    cells: dict[str, Line] = {
        "mean": [(f"mean {notation.scale(ChannelName(f'{sensor}/x'))[1]}".rjust(COLUMNS["mean"]), "muted")],
        "std": [("std".rjust(COLUMNS["std"]), "muted")],
        "grade": [_headline(state, sensor)],
    }
    for name in set(shown).intersection((*NOISE, *MARKOV)):
        text = f"{name} {notation.coefficient_scale(sensor, name)[1]}"
        gap = " " * (COLUMNS[name] - len(text) - 2)  # 2: the cells of the symbol of a state
        cells[name] = [(gap, "text"), (name, name), (f"{text[1:]}  ", "muted")]
    return [(f" {sensor:<5}", "title"), *(span for name in shown for span in cells[name])]


def _row(state: ViewState, name: ChannelName, channel: Channel, shown: Sequence[str]) -> Line:
    """Return one axis of a sensor."""
    factor, _ = state.notation.scale(name)
    mean = "–" if channel.mean is None else number(channel.mean * factor, 4)
    cells: dict[str, tuple[str, str]] = {
        "mean": (mean, "text"),
        "std": ("–" if channel.std is None else short(channel.std * factor), "text"),
        "grade": _grade_cell(name, channel),
    }
    estimates = channel.estimates
    precision = state.report.precision
    for part in set(shown).intersection((*NOISE, *MARKOV)):
        seconds = seconds_left(channel, part, precision)
        cells[part] = state.notation.coefficient(estimates.get(part), seconds)
    line: Line = [("▌" if name == state.channel else " ", "accent"), (f"  {name[-1]}  ", "strong")]
    for column in shown:
        text, role = cells[column]
        if column in NOISE:
            symbol, symbol_role = SYMBOLS[state_of(channel, column, precision)]
            line += [(text.rjust(COLUMNS[column] - 2), role), (f" {symbol}", symbol_role)]
        else:
            line.append(
                (text.rjust(COLUMNS[column] - 2 * (column in MARKOV)) + "  " * (column in MARKOV), role)
            )
    return line


def _grade_cell(name: ChannelName, channel: Channel) -> tuple[str, str]:
    """Return the grade of an axis, a dash while it is unknown; of a sensor that has no grades, blanks."""
    meets = channel.grade.meets if channel.grade is not None else None
    if meets is None:
        return f"  {'–' if name.sensor in INERTIAL else '':<10}", "faint"
    return f"  {_short_grade(meets):<10}", f"grade-{meets}"


def _short_grade(meets: str) -> str:
    """Return a grade in the 10 cells of the column: ``below`` of ``below consumer``."""
    return meets.partition(" ")[0]


def _headline(state: ViewState, sensor: str) -> tuple[str, str]:
    """Return the grade of a sensor where no other panel shows it, else the name of the column."""
    grade = state.report.grade.get(sensor)
    if sensor not in INERTIAL:
        return "", "muted"
    if not state.compact or grade is None or grade.meets is None:
        return "  grade", "muted"
    word = _short_grade(grade.meets)
    return f"  {word}{'?' if grade.provisional and len(word) < 10 else ''}", f"grade-{grade.meets}-strong"


def _single(state: ViewState, name: ChannelName, channel: Channel, width: int) -> Line:
    """Return temperature or pressure, which have running statistics and no coefficients."""
    factor, unit = state.notation.scale(name)
    parts: list[Line] = [[("▌" if name == state.channel else " ", "accent"), (f"{name:<12}", "title")]]
    if channel.last is not None:
        parts.append([(f"now {number(channel.last * factor, 5)} {unit}".ljust(20), "text")])
    if channel.mean is not None:
        parts.append([(f"mean {number(channel.mean * factor, 5)} {unit}".ljust(21), "muted")])
    if channel.std is not None:
        parts.append([(f"std {short(channel.std * factor)}", "muted")])
    return fitted(parts, width)
