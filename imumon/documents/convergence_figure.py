"""Convergence of a sensor in the datasheet: what was stated when the record was shorter, as a figure or a table.

One panel for each of N, B and K: the value of each axis within its 95 % limits, and a mark at each upper bound, against
the length of the record.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imumon.documents.elements import DataTable
from imumon.documents.plotting import COLOURS, MARKERS, draw_grid, page_svg
from imumon.documents.tables import sensor_axes
from imumon.model.coefficients import NOISE, unit_of
from imumon.model.report import Convergence, Report, StatedSeries
from imumon.model.units import duration, figures, pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEAST_POINTS = 3
"""Lengths below which there is nothing to see."""
MOST_LENGTHS = 8
"""Rows of the table: with more, it is longer than the table of the coefficients."""
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


def convergence_table(report: Report, sensor: str) -> DataTable:
    """Return N, B and K of the axis that is known worst, at some lengths."""
    stated = convergences(report, sensor)
    columns, heads = [], []
    lengths = next(iter(stated.values())).elapsed_s
    step = -(-len(lengths) // MOST_LENGTHS)
    rows = list(range(len(lengths)))[::-1][::step][::-1]  # the present one is always shown
    for letter in NOISE:
        axis = max(stated, key=lambda name: _width(stated[name].coefficients.get(letter)))
        unit = unit_of(sensor, letter)
        heads.append(f"{letter} of {axis}, {pretty(unit.unit)}")
        columns.append([_text(stated[axis].coefficients.get(letter), row, unit.factor) for row in rows])
    table = zip([duration(lengths[row]) for row in rows], *columns, strict=True)
    return DataTable((f"Length, {sensor}", *heads), tuple(table))


def _width(series: StatedSeries | None) -> float:
    """Return the relative width of the last limits; of a bound more than of any value."""
    if series is None or not series.value or not series.value[-1]:
        return float("inf")
    return ((series.high[-1] or 0.0) - (series.low[-1] or 0.0)) / series.value[-1]


def _text(series: StatedSeries | None, row: int, factor: float) -> str:
    """Return the value with its limits at one length, or the bound."""
    if series is None or series.high[row] is None:
        return "–"
    value, low, high = (
        None if part is None else part * factor
        for part in (series.value[row], series.low[row], series.high[row])
    )
    if value is None or low is None or high is None:
        return f"< {figures(high or 0.0)}"
    return f"{figures(value)} ({figures(low)} to {figures(high)})"


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
            sizes += [high for _, high in bounds[-MOST_LENGTHS:]]
    panel.set_title(f"{letter}, {pretty(unit.unit)}", loc="left", fontsize=9)
    panel.set_xlabel("length of the record, h", fontsize=8)
    panel.set_xscale("log")
    panel.set_yscale("log")
    if sizes:
        panel.set_ylim(min(sizes) / ROOM, max(sizes) * ROOM)
        panel.set_xlim(min(ends) / ROOM, max(ends) * ROOM)
        draw_grid(panel)
