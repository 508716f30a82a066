"""Predicted error of a filter against the time since its last fix: figure and table of the datasheet.

Per sensor, the axis whose filter with N and K alone is the most overconfident. Solid: the error of the angle or
velocity that the filter has. Dashed: the one that it states. A filter is consistent where both agree.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imumon.datasheet.elements import DataTable
from imumon.datasheet.plotting import COLOURS, draw_grid, draw_legend, page_svg
from imumon.filter_report import FilterChannel, FilterReport
from imumon.units import DEG, figures

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FILTERS = {
    "n_and_k": "N and K alone",
    "white_walk": "white and walk",
    "gauss_markov": "with Gauss–Markov terms",
}
AXES = {"n_and_k": "y", "white_walk": "x", "gauss_markov": "z"}
"""Axis that has the colour of a filter in the other figures."""

QUANTITIES = {"gyro": ("angle", "°", DEG), "accel": ("velocity", "m/s", 1.0)}
"""What a filter integrates from a sensor: name, unit, factor from SI."""


def shown_axis(filters: FilterReport, sensor: str) -> tuple[str, FilterChannel] | None:
    """Return the axis of a sensor whose filter with N and K alone is the most overconfident; None without one."""
    axes = {n.partition("/")[2]: c for n, c in filters.channels.items() if n.startswith(f"{sensor}/")}
    return max(axes.items(), key=lambda item: max(item[1].nees.n_and_k)) if axes else None


def filter_table(sensor: str, axis: str, channel: FilterChannel) -> DataTable:
    """Return the error that each filter has and states, at times since its last fix."""
    quantity, unit, factor = QUANTITIES[sensor]
    head = [f"{quantity} error of axis {axis}, {unit}: s since the last fix"]
    for title in FILTERS.values():
        head += [title, "it states"]
    columns = [column for name in FILTERS for column in _errors(channel, name, factor)]
    rows = [
        (f"{horizon:g}", *(figures(column[i], 2) for column in columns))
        for i, horizon in enumerate(channel.nees.horizon_s)
    ]
    return DataTable(tuple(head), tuple(rows))


def filter_svg(sensor: str, channel: FilterChannel) -> str:
    """Return the figure of an axis as an SVG element of the HTML page."""
    quantity, unit, factor = QUANTITIES[sensor]

    def draw(panel: Axes) -> None:
        _draw(panel, channel, factor)
        panel.set(xlabel="time since the last fix, s", ylabel=f"error of the {quantity}, {unit}")

    return page_svg(draw, f"filter-{sensor}", f"Predicted {quantity} error of a filter")


def _errors(channel: FilterChannel, name: str, factor: float) -> tuple[list[float], list[float]]:
    """Return the root mean square of the error that a filter has, and the one that it states."""
    # NEES is the mean square of the error over the variance that the filter states
    stated = [factor * value for value in getattr(channel.std, name)]
    nees = getattr(channel.nees, name)
    return [s * math.sqrt(ratio) for s, ratio in zip(stated, nees, strict=True)], stated


def _draw(panel: Axes, channel: FilterChannel, factor: float) -> None:
    """Draw the error that each filter has, and the one that it states, against the time."""
    from matplotlib.lines import Line2D

    handles = []
    for name, title in FILTERS.items():
        colour = COLOURS[AXES[name]]
        true, stated = _errors(channel, name, factor)
        panel.plot(channel.nees.horizon_s, true, color=colour, linewidth=1.4)
        panel.plot(channel.nees.horizon_s, stated, color=colour, linewidth=1.1, linestyle=(0, (4, 2)))
        handles.append(Line2D([], [], color=colour, linewidth=1.4, label=title))
    handles.append(Line2D([], [], color=COLOURS["muted"], linestyle=(0, (4, 2)), label="stated"))
    panel.set(xscale="log", yscale="log", xlim=(channel.nees.horizon_s[0], channel.nees.horizon_s[-1]))
    draw_grid(panel)
    draw_legend(panel, handles)
