"""Charts of the history of one channel: coefficients, mean and temperature over a day, a month or a year, with events.

A coefficient belongs to its row alone, 10 minutes, an hour or a day, so its limits do not narrow from row to row. They
are bars as wide as the row, and an arrow is the upper bound of a row that does not show it.

The rows come from the daemon as JSON (docs/HISTORY.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import numpy as np

from imumon.coefficients import CONVERGING, Estimate
from imumon.history_report import HistoryRow, history_rows, objects
from imumon.samples import Floats, sensor_of
from imumon.tui.braille_canvas import AxisScale, Canvas, PlotFrame, even
from imumon.tui.charts import EXTREME_VALUES, centred_text, tick_text
from imumon.tui.formatting import Line, fitted, padded
from imumon.tui.view_state import SPANS, HistorySeries, ViewState
from imumon.units import MINUTE, duration

MARKED = ("change", "restart", "connect", "disconnect", "warmup", "grade", "disturbance", "constant", "state")
"""Kinds of events that are marked."""
QUANTITIES = (*CONVERGING, "mean", "temperature")
MOST_ROOM = 0.5
"""Share of a value by which limits widen the scale."""
STEPS_S = (
    *(1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0, 7200.0, 10_800.0),
    *(14_400.0, 21_600.0, 43_200.0, 86_400.0, 172_800.0, 345_600.0, 604_800.0, 1_209_600.0, 2_592_000.0),
    5_184_000.0,
)
"""s between two labels of the time axis, of which the first that leaves enough room is used."""
LABEL_CELLS = 14
"""Cells of a label of the time axis, with its gap: a date and a clock time."""
GUTTER = 9
"""Cells to the left of a chart, for its labels."""
_ROLES = {"mean": "signal", "temperature": "point"}


def parse(channel: str, rows: bytes, events: bytes) -> HistorySeries | None:
    """Return the history in the replies of a daemon; None if it has no valid row."""
    known = [_numbers(row) for row in history_rows(objects(rows)) if row.channel == channel]
    if not known:
        return None
    known.sort()
    table = np.array(known, dtype=np.float64)
    begin, end = table[:, 0], table[:, 1]
    count = len(QUANTITIES)
    values = {name: table[:, 2 + k] for k, name in enumerate(QUANTITIES)}
    low = {name: table[:, 2 + count + 2 * k] for k, name in enumerate(CONVERGING)}
    high = {name: table[:, 3 + count + 2 * k] for k, name in enumerate(CONVERGING)}
    shown, period_s = tuple(_marks(objects(events))), float((end - begin).max())
    middle = 0.5 * (begin + end)
    return HistorySeries(
        channel, float(begin[0]), float(end.max()), middle, values, shown, low, high, period_s
    )


def _numbers(row: HistoryRow) -> tuple[float, ...]:
    """Return begin, end and quantities of a row; what is not known is NaN."""
    noise = [row.coefficients.get(name, Estimate()) for name in CONVERGING]
    limits = (limit for part in noise for limit in (part.low, part.high))
    known = (*(part.value for part in noise), row.mean, row.temperature, *limits)
    numbers = (math.nan if value is None else value for value in known)
    return (row.begin.timestamp(), row.begin.timestamp() + row.length_s, *numbers)


def _marks(events: Iterable[Any]) -> Iterator[tuple[float, str]]:
    """Yield time, s since 1970, and kind of the events that are marked."""
    for event in events:  # from another program: of any form
        with suppress(KeyError, TypeError, ValueError, OverflowError):
            if event["kind"] in MARKED:
                yield datetime.fromisoformat(event["time"]).astimezone(UTC).timestamp(), event["kind"]


@EXTREME_VALUES
def history_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the charts of the selected channel, one below the other."""
    channel, series = state.channel or "", state.history
    title: Line = [(" ", "text"), (channel.replace("/", " "), "title"), ("   ", "text")]
    for name in SPANS:
        title.append((f" {name} ", "tab" if name == state.span else "muted"))
    if series is None or series.channel != channel:
        text = [
            "no history yet",
            "rows of 10 minutes, hours and days appear here",
            "if history.enabled is true",
        ]
        return [padded(title, width), *centred_text(text, width, height - 1)]
    mark = "o " if state.notation.ascii else "⠶ "
    legend: list[Line] = [
        [(f"   {mark}", "text"), (f"each {duration(series.period_s)}, UTC", "muted")],
        [("   ", "text"), ("  ", "text/band"), (" 95 %", "muted")],
        [("   ↓", "bound"), (" 95 % upper bound", "muted")],
        *([[("   ▏", "warn"), ("event", "muted")]] if series.events else []),
    ]
    drawn = [name for name in QUANTITIES if _is_known(series, name)]
    drawn = drawn[: max((height - 2) // 3, 1)]  # three lines each at least: fewer show no curve
    times = max(series.begin, series.end - SPANS[state.span][0]), series.end
    lines = [padded(fitted([title, *legend], width), width)]
    left = height - 2  # lines below the title and above the time
    for k, name in enumerate(drawn):
        rows = left // (len(drawn) - k)
        left -= rows
        lines += _panel(state, series, name, times, width, rows)
    return [*lines, _time_axis(times, width)][:height]


def _panel(
    state: ViewState, series: HistorySeries, name: str, times: tuple[float, float], width: int, height: int
) -> list[Line]:
    """Return the chart of one quantity."""
    factor, unit = _scale(state, series.channel, name)
    canvas = Canvas(width, max(height, 2))
    inside = (series.time >= times[0]) & (series.time <= times[1])
    y = series.values[name][inside] * factor
    unknown = np.full(len(series.time), math.nan)
    low, high = (limits.get(name, unknown)[inside] * factor for limits in (series.low, series.high))
    measured, bound = np.isfinite(y), ~np.isfinite(y) & np.isfinite(high)
    area = (GUTTER, 1, max(width - GUTTER - 2, 4), max(height - 1, 1))
    scale, ticks = even(np.concatenate((y, *_edges(y, low, high))), area[3])
    frame = PlotFrame(canvas, area, AxisScale(*times), scale)
    frame.grid([], ticks)
    frame.y_labels([(tick, tick_text(tick, ticks)) for tick in ticks])
    for when, kind in series.events:
        cell = frame.cell(when, 0.5 * (scale.low + scale.high))
        for row in range(frame.top, frame.top + frame.height) if cell is not None else ():
            canvas.put(cell[0], row, "▏", "bad" if kind == "change" else "warn")  # type: ignore[index]
    times_s = series.time[inside]
    frame.bars(times_s[measured], low[measured], high[measured], series.period_s, "band")
    for when, size in zip(times_s[bound], high[bound], strict=True):
        if (cell := frame.cell(float(when), float(size))) is not None:
            canvas.text(*cell, "↓", "bound")
    frame.points(times_s, y, _ROLES.get(name, name), "o" if state.notation.ascii else None)
    canvas.text(GUTTER, 0, f"{name} [{unit}]", "muted")
    return canvas.rows()


def _is_known(series: HistorySeries, name: str) -> bool:
    """Return whether any row has a value or a bound of a quantity."""
    return bool(
        np.isfinite(series.values[name]).any() or np.isfinite(series.high.get(name, np.zeros(0))).any()
    )


def _edges(y: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Return the limits as far as a scale shows them: those of a short row may be many times its value."""
    known = y[np.isfinite(y)]
    if not len(known):
        return low, high
    least, greatest = float(known.min()), float(known.max())
    room = max(greatest - least, MOST_ROOM * abs(greatest))
    return np.clip(low, least - room, greatest + room), np.clip(high, least - room, greatest + room)


def _scale(state: ViewState, channel: str, name: str) -> tuple[float, str]:
    """Return factor and unit of a quantity."""
    if name == "temperature":
        return 1.0, state.notation.unit("degC")
    if name == "mean":
        return state.notation.scale(channel)
    return state.notation.coefficient_scale(sensor_of(channel), name)


def _time_axis(times: tuple[float, float], width: int) -> Line:
    """Return the labels of the time axis: clock times of a day, else dates."""
    inner, span = max(width - GUTTER - 2, 4), times[1] - times[0]
    step = next((s for s in STEPS_S if span / s <= max(inner / LABEL_CELLS, 1.0)), STEPS_S[-1])
    first = math.ceil(times[0] / step - 1e-9)  # 1e-9: a begin that is round but for rounding
    dates = [
        datetime.fromtimestamp(k * step, UTC) for k in range(first, math.floor(times[1] / step + 1e-9) + 1)
    ]
    form = "%d %b" if step >= 86400.0 else "%H:%M" if step >= MINUTE else "%H:%M:%S"
    # a clock time has its date where it is another one than that of the label before
    days = [None, *(date.date() for date in dates)]
    labels = [
        f"{date:%d %b} {date:{form}}" if step < 86400.0 and date.date() != day else f"{date:{form}}"
        for date, day in zip(dates, days, strict=False)
    ]
    canvas = Canvas(width, 1)
    # in the frame of the charts: a label stands below what it names
    frame = PlotFrame(canvas, (GUTTER, 0, inner, 1), AxisScale(*times), AxisScale(0.0, 1.0))
    frame.x_labels([(date.timestamp(), text) for date, text in zip(dates, labels, strict=True)], 0)
    return canvas.rows()[0]
