"""History of a sensor in the datasheet: N of its axes over days, as a figure of the page or a table.

The rows are those of `imumon history` (docs/HISTORY.md), of days or, of a young sensor, of hours.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING

from imumon.coefficients import Estimate, unit_of
from imumon.datasheet.elements import DataTable
from imumon.datasheet.plotting import COLOURS, MARKERS, draw_legend, page_svg
from imumon.datasheet.tables import MOST_ROWS
from imumon.history_report import LEAST_DAYS, HistoryRow
from imumon.units import figures, pretty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HistoryRows = Sequence[HistoryRow]
Series = dict[str, list[tuple[datetime, float, float, float]]]
"""Time and N with its limits, SI, by axis."""


def series(rows: HistoryRows, sensor: str) -> Series:
    """Return time and N with its limits, SI, by axis of a sensor; empty if there are too few."""
    by_axis: Series = {}
    for row in rows:
        part, axis = row.coefficients.get("N", Estimate()), row.channel.removeprefix(f"{sensor}/")
        if axis in MARKERS and part.value is not None and part.low is not None and part.high is not None:
            by_axis.setdefault(axis, []).append((row.begin, part.value, part.low, part.high))
    return {axis: points for axis, points in by_axis.items() if len(points) >= LEAST_DAYS}


def history_table(sensor: str, shown: Series) -> DataTable:
    """Return N of each axis by time; of a long history, every second, third and so on, and the newest."""
    unit = unit_of(sensor, "N")
    by_time: dict[datetime, dict[str, float]] = {}
    for axis, points in shown.items():
        for when, value, *_ in points:
            by_time.setdefault(when, {})[axis] = value
    times = sorted(by_time)
    step = -(-len(times) // MOST_ROWS)
    # counted from the newest, which is always shown
    lines = [
        (
            f"{when:%Y-%m-%d %H:%M}",
            *(figures(by_time[when][axis] * unit.factor) if axis in by_time[when] else "–" for axis in shown),
        )
        for when in times[::-1][::step][::-1]
    ]
    return DataTable((f"N of the {sensor}, {pretty(unit.unit)}", *shown), tuple(lines))


def history_svg(sensor: str, shown: Series) -> str:
    """Return the figure of a sensor as an SVG element of the HTML page."""
    unit = unit_of(sensor, "N")
    # the page keeps two decimals of a number, also of a label
    small = max(high for points in shown.values() for *_, high in points) * unit.factor < 1.0
    factor, prefix = (1000.0 * unit.factor, "10⁻³ ") if small else (unit.factor, "")

    def draw(panel: Axes) -> None:
        for axis, points in shown.items():
            times, values, low, high = zip(*points, strict=True)
            below = [(v - w) * factor for v, w in zip(values, low, strict=True)]
            above = [(w - v) * factor for v, w in zip(values, high, strict=True)]
            panel.errorbar(
                times, [v * factor for v in values], (below, above), label=axis, color=COLOURS[axis],
                marker=MARKERS[axis], markersize=3.5, linewidth=0.8, elinewidth=0.8,
            )  # fmt: skip
        panel.set_ylabel(f"N, {prefix}{pretty(unit.unit)}")
        draw_legend(panel)

    return page_svg(draw, f"history-{sensor}", f"History of N of the {sensor}", height=0.6)
