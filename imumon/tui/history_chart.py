"""Charts of the history of one channel: N, B, mean and temperature over a day, a month or a year, with the events.

The rows come from the daemon as JSON (docs/HISTORY.md).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

import numpy as np

from imumon.history_report import HistoryRow, history_rows, objects
from imumon.report import GRADED
from imumon.samples import sensor_of
from imumon.tui.braille_canvas import AxisScale, Canvas, PlotFrame, linear
from imumon.tui.charts import EXTREME_VALUES, centred_text
from imumon.tui.formatting import Line, padded
from imumon.tui.view_state import SPANS, HistorySeries, ViewState
from imumon.units import number

MARKED = ("change", "restart", "connect", "disconnect", "warmup", "grade", "disturbance", "constant", "state")
"""Kinds of events that are marked."""
QUANTITIES = (*GRADED, "mean", "temperature")
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
    values = {name: table[:, k] for k, name in enumerate(QUANTITIES, 2)}
    shown = tuple(_marks(objects(events)))
    return HistorySeries(channel, float(begin[0]), float(end.max()), 0.5 * (begin + end), values, shown)


def _numbers(row: HistoryRow) -> tuple[float, ...]:
    """Return begin, end and quantities of a row; what is not known is NaN."""
    noise = [part.value if (part := row.coefficients.get(name)) else None for name in GRADED]
    quantities = (math.nan if each is None else each for each in (*noise, row.mean, row.temperature))
    return (row.begin.timestamp(), row.begin.timestamp() + row.length_s, *quantities)


def _marks(events: Iterable[Any]) -> Iterator[tuple[float, str]]:
    """Yield time, s since 1970, and kind of the events that are marked."""
    for each in events:
        with suppress(KeyError, TypeError, ValueError, OverflowError):
            if each["kind"] in MARKED:
                yield datetime.fromisoformat(each["time"]).astimezone(UTC).timestamp(), each["kind"]


@EXTREME_VALUES
def history_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the charts of the selected channel, one below the other."""
    channel, series = state.channel or "", state.history
    title: Line = [(" " * GUTTER, "text"), (channel.replace("/", " "), "title"), ("   ", "text")]
    for name in SPANS:
        title.append((f" {name} ", "tab" if name == state.span else "muted"))
    title += [("   + -", "key"), (" span", "muted")]
    if series is None or series.channel != channel:
        text = [
            "no history yet",
            "rows of 10 minutes, hours and days appear here",
            "if history.enabled is true",
        ]
        return [padded(title, width), *centred_text(text, width, height - 1)]
    title += [("   ▏", "warn"), ("event", "muted")] if series.events else []
    drawn = [name for name in QUANTITIES if np.isfinite(series.values[name]).any()]
    drawn = drawn[: max((height - 2) // 3, 1)]
    times = max(series.begin, series.end - SPANS[state.span][0]), series.end
    lines = [padded(title, width)]
    left = height - 2
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
    scale = linear(y)
    area = (GUTTER, 1, max(width - GUTTER - 2, 4), max(height - 1, 1))
    frame = PlotFrame(canvas, area, AxisScale(*times), scale)
    ticks = scale.ticks(max(frame.height // 2, 2))
    frame.grid([], ticks)
    frame.y_labels([(tick, number(tick, 4)) for tick in ticks])
    for when, kind in series.events:
        at = frame.cell(when, 0.5 * (scale.low + scale.high))
        for row in range(frame.top, frame.top + frame.height) if at is not None else ():
            canvas.put(at[0], row, "▏", "bad" if kind == "change" else "warn")  # type: ignore[index]
    frame.points(series.time[inside], y, _ROLES.get(name, name), "o" if state.notation.ascii else None)
    canvas.text(GUTTER, 0, f"{name} [{unit}]", "muted")
    return canvas.rows()


def _scale(state: ViewState, channel: str, name: str) -> tuple[float, str]:
    """Return factor and unit of a quantity."""
    if name == "temperature":
        return 1.0, state.notation.unit("degC")
    if name == "mean":
        return state.notation.scale(channel)
    return state.notation.coefficient_scale(sensor_of(channel), name)


def _time_axis(times: tuple[float, float], width: int) -> Line:
    """Return the labels of the time axis: clock times of a day, else dates."""
    inner, span = width - GUTTER - 2, times[1] - times[0]
    count = max(2, min(7, inner // 12))
    form = "%H:%M" if span < 2 * 86400.0 else "%d %b" if span < 90 * 86400.0 else "%b %Y"
    form += ":%S" if span < 60.0 * count else ""
    text = [" "] * width
    for k in range(count):
        share = k / (count - 1)
        shown = f"{datetime.fromtimestamp(times[0] + share * span, UTC):{form}}"
        at = min(max(GUTTER + round(share * inner) - len(shown) // 2, 0), width - len(shown))
        text[at : at + len(shown)] = shown
    return padded([("".join(text)[:width], "muted")], width)
