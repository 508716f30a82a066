"""Coefficients of two sensors, channel by channel, and whether they differ."""

from __future__ import annotations

from collections.abc import Sequence

from imumon.coefficients import NOISE, Estimate, coefficient_ratio
from imumon.report import Channel, Report
from imumon.samples import sensor_of
from imumon.tui.channel_table import LABEL, letters_of
from imumon.tui.formatting import CELL, Line, Notation, Span
from imumon.tui.view_state import ViewState
from imumon.units import short

LEAST_NAME = 8
"""Cells of the name of a device that correlated noise leaves on a narrow screen."""


def comparison(state: ViewState, width: int) -> list[Line]:
    """Return the selected device and the compared one, one below the other, with their ratios."""
    first, second = state.report, state.reports.get(state.compared_id or "")
    if first is None or second is None or state.id is None or state.compared_id is None:
        return []
    longest = 1 + max(len(state.id), len(state.compared_id))
    letters = letters_of(first, second)
    while len(letters) > len(NOISE) and width < LABEL + LEAST_NAME + len(letters) * (CELL + 1) + 1:
        letters = letters[:-1]
    cells = max(min(longest, width - LABEL - len(letters) * (CELL + 1) - 1), 2)  # 1: the scrollbar
    lines: list[Line] = []
    last = None
    for name, channel in first.channels.items():
        match, sensor = second.channels.get(name), sensor_of(name)
        if "/" not in name or match is None:
            continue
        if sensor != last:
            lines.append(_heading(state.notation, sensor, cells, letters))
        last = sensor
        lines.append(_row(name[-1], state.id, channel, state.notation, cells, letters))
        lines.append(_row("", state.compared_id, match, state.notation, cells, letters))
        lines.append(_ratios(channel, match, cells, letters))
    return [*_legend(first, second), *lines]


def _legend(first: Report, second: Report) -> list[Line]:
    """Return what the ratios mean, and what may make them differ from one besides the sensors."""
    lines: list[Line] = [[("   ratio: second over first; differs if beyond 95 % limits", "faint")]]
    if first.device.stream != second.device.stream:
        streams = f"{first.device.stream or 'unknown'} and {second.device.stream or 'unknown'}"
        lines.append([(f"   different streams, {streams}: they alone may explain a difference", "warn")])
    return [*lines, []]


def _heading(notation: Notation, sensor: str, cells: int, letters: Sequence[str]) -> Line:
    head: Line = [(f" {sensor:<{cells + LABEL - 1}}", "title")]
    for name in letters:
        text = f"{name} {notation.coefficient_scale(sensor, name)[1]}"
        head += [(" " * (CELL + 1 - len(text)), "text"), (name, name), (text[1:], "muted")]
    return head


def _row(
    axis: str, id: str, channel: Channel, notation: Notation, cells: int, letters: Sequence[str]
) -> Line:
    shown = id if len(id) < cells else f"…{id[len(id) - cells + 2 :]}"  # names often differ at their end
    line: Line = [(f"   {axis:<3}", "strong"), (f"{shown:<{cells}}", "text" if axis else "muted")]
    for name in letters:
        text, role = notation.coefficient(channel.estimates.get(name), None)
        line.append((text.rjust(CELL + 1), role))
    return line


def _ratios(channel: Channel, match: Channel, cells: int, letters: Sequence[str]) -> Line:
    line: Line = [(f"{'':<{LABEL}}{'ratio':<{cells}}", "faint")]
    for name in letters:
        text, role = ratio_text(channel.estimates.get(name), match.estimates.get(name))
        line.append((text.rjust(CELL + 1), role))
    return line


def ratio_text(first: Estimate | None, second: Estimate | None) -> Span:
    """Return the ratio of the second to the first, and whether they differ beyond their 95 % limits."""
    if first is None or second is None:
        return "", "faint"
    ratio = coefficient_ratio(first, second)
    if ratio.value is None:
        return "–", "faint"
    text = short(ratio.value) if ratio.relation == "=" else f"{ratio.relation} {short(ratio.value)}"
    return (f"{text} differs", "warn") if ratio.differs else (f"{text}  within", "muted")
