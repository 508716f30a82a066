"""Convergence of a sensor in the datasheet: what was stated when the record was shorter, as a figure.

One panel for each of N, B and K: the value of each axis within its 95 % limits, and a mark at each upper bound, against
the length of the record.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imumon.documents.plotting import COLOURS, MARKERS, draw_grid, page_svg
from imumon.documents.report_texts import sensor_axes
from imumon.model.coefficients import NOISE, unit_of
from imumon.model.report import Convergence, Report
from imumon.model.units import pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEAST_POINTS = 3
"""Lengths below which there is nothing to see."""
LAST_BOUNDS = 8
"""Bounds that the frame shows: those of a young record may be decades away."""
HEIGHT = 0.5
"""Share of the usual height of a figure."""
ROOM = 1.2
"""Factor between the outermost values or bounds and the frame; limits of a young record may be decades away."""


def convergences(report: Report, sensor: str) -> dict[str, Convergence]:
    """Return what was stated by axis of a sensor; empty if there are too few lengths."""
    known = {axis: channel.convergence for axis, channel in sensor_axes(report, sensor)}
    return {
        axis: stated
        for axis, stated in known.items()
        if stated is not None and len(stated.elapsed_s) >= LEAST_POINTS
    }


def convergence_svg(report: Report, sensor: str) -> str:
    """Return the figure of a sensor as an SVG element of the HTML page."""
    stated = convergences(report, sensor)

    def draw(panel: Axes) -> None:
        figure = panel.figure
        panel.remove()
        for letter, axes in zip(NOISE, figure.subplots(1, len(NOISE)), strict=True):
            _draw(axes, sensor, letter, stated)

    return page_svg(draw, f"convergence-{sensor}", f"Convergence of the {sensor}", height=HEIGHT)


def _draw(panel: Axes, sensor: str, letter: str, stated: dict[str, Convergence]) -> None:
    """Draw one coefficient of all axes."""
    unit = unit_of(sensor, letter)
    sizes: list[float] = []
    ends: list[float] = []
    for axis, convergence in stated.items():
        if (series := convergence.coefficients.get(letter)) is None:
            continue
        hours = [length / 3600.0 for length in convergence.elapsed_s]
        ends += [hours[0], hours[-1]]
        points = [
            (hour, value * unit.factor, low * unit.factor, high * unit.factor)
            for hour, value, low, high in zip(hours, series.value, series.low, series.high, strict=True)
            if value and low is not None and high is not None
        ]
        if points:
            times, values, low_limits, high_limits = zip(*points, strict=True)
            panel.fill_between(times, low_limits, high_limits, color=COLOURS[axis], alpha=0.15, linewidth=0)
            panel.plot(
                times, values, color=COLOURS[axis], marker=MARKERS[axis], markersize=2.5, linewidth=0.9
            )
            sizes += values
        bounds = [
            (hour, high * unit.factor)
            for hour, value, high in zip(hours, series.value, series.high, strict=True)
            if not value and high
        ]
        if bounds:
            panel.plot(
                *zip(*bounds, strict=True), color=COLOURS[axis], marker="v", markersize=3.5, linestyle=""
            )
            sizes += [high for _, high in bounds[-LAST_BOUNDS:]]
    panel.set_title(f"{letter}, {pretty(unit.unit)}", loc="left", fontsize=9)
    panel.set_xlabel("length of the record, h", fontsize=8)
    panel.set_xscale("log")
    panel.set_yscale("log")
    if sizes:
        panel.set_ylim(min(sizes) / ROOM, max(sizes) * ROOM)
        panel.set_xlim(min(ends) / ROOM, max(ends) * ROOM)
        draw_grid(panel)
