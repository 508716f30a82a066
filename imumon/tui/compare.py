"""Comparison: N, B and K of two sensors, channel by channel, and whether they differ.

Two values with 95 % limits differ at 95 % when the limits of their difference leave out zero. With the
limits of each on a logarithmic scale, those of the difference follow from the squares of the two
half-widths that face one another (the method of variance estimates recovery: Zou and Donner, Statistics
in Medicine 27, 1693, 2008). Of a bound only this is known: a measured value beyond it differs.
"""

from __future__ import annotations

import math

from imumon.report import COEFFICIENTS, Channel, Coefficient, Report
from imumon.samples import sensor_of
from imumon.tui.formatting import CELL, Line, Notation, Piece
from imumon.tui.view_state import ViewState
from imumon.units import short

NAME = 26
"""Cells for the name of a sensor."""


def comparison(scene: ViewState) -> list[Line]:
    """The chosen device and the one it is compared with, one under the other, and their ratios."""
    mine, other = scene.report, scene.reports.get(scene.other or "")
    if mine is None or other is None or scene.id is None or scene.other is None:
        return []
    lines: list[Line] = []
    last = None
    for name, channel in mine.channels.items():
        twin, sensor = other.channels.get(name), sensor_of(name)
        if "/" not in name or twin is None:
            continue
        if sensor != last:
            lines.append(_heading(scene.notation, sensor))
        last = sensor
        lines.append(_row(name[-1], scene.id, channel, scene.notation))
        lines.append(_row("", scene.other, twin, scene.notation))
        lines.append(_ratios(channel, twin))
    return [*_legend(mine, other), *lines]


def _legend(mine: Report, other: Report) -> list[Line]:
    """What the ratios mean, and what alone may make them differ from one."""
    lines: list[Line] = [
        [("   ratio: the second over the first, within the 95 % limits of both or not", "faint")]
    ]
    if mine.device.stream != other.device.stream:
        streams = f"{mine.device.stream or 'unknown'} and {other.device.stream or 'unknown'}"
        lines.append([(f"   their streams differ, {streams}: that alone may make a difference", "warn")])
    return [*lines, []]


def _heading(notation: Notation, sensor: str) -> Line:
    head: Line = [(f" {sensor:<{NAME + 5}}", "title")]
    for name in COEFFICIENTS:
        text = f"{name} {notation.coefficient_unit(sensor, name)}"
        head += [(" " * (CELL + 1 - len(text)), "text"), (name, name), (text[1:], "muted")]
    return head


def _row(axis: str, id: str, channel: Channel, notation: Notation) -> Line:
    shown = id if len(id) <= NAME - 2 else f"{id[: NAME - 3]}…"
    line: Line = [(f"   {axis:<3}", "strong"), (f"{shown:<{NAME}}", "text" if axis else "muted")]
    for name in COEFFICIENTS:
        text, role = notation.coefficient(getattr(channel, name), None)
        line.append((text.rjust(CELL + 1), role))
    return line


def _ratios(channel: Channel, twin: Channel) -> Line:
    line: Line = [(f"{'':<6}{'ratio':<{NAME}}", "faint")]
    for name in COEFFICIENTS:
        text, role = ratio(getattr(channel, name), getattr(twin, name))
        line.append((text.rjust(CELL + 1), role))
    return line


def ratio(one: Coefficient | None, two: Coefficient | None) -> Piece:
    """The second over the first, and whether they differ beyond their 95 % limits."""
    if one is None or two is None:
        return "", "faint"
    if one.value and two.value:
        text = short(two.value / one.value)
        if _apart(one, two) or _apart(two, one):
            return f"{text} differs", "warn"
        return f"{text}  within", "muted"
    if one.value and two.high is not None:
        differs, text = one.low is not None and two.high < one.low, f"< {short(two.high / one.value)}"
        return (f"{text} differs", "warn") if differs else ("–", "faint")
    if two.value and one.high:
        differs, text = two.low is not None and one.high < two.low, f"> {short(two.value / one.high)}"
        return (f"{text} differs", "warn") if differs else ("–", "faint")
    return "–", "faint"


def _apart(less: Coefficient, more: Coefficient) -> bool:
    """Whether one is larger than another for certain."""
    if not (less.value and less.high and more.value and more.low) or more.value <= less.value:
        return False
    facing = math.log(less.high / less.value), math.log(more.value / more.low)
    return math.log(more.value / less.value) > math.hypot(*facing)
