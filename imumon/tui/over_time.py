"""The selected channel over time: what was stated while the record grew, or the rows of its history.

The span *record* asks whether each number has come to rest: N, B, K and M against the length of the record, on a
logarithmic axis. Two dashed lines are the configured precision about the present value: where the limits are between
them, the number is as precise as configured. The spans *day*, *month* and *year* show the rows of the history, which
come from the daemon as JSON (docs/HISTORY.md): coefficients, mean and temperature, with events.

Every quantity has a panel of its own, and both kinds are drawn alike. Bars are 95 % limits, and an arrow is the upper
bound of a number that was not known. A row of the history is measured alone, so its limits do not narrow from row to
row.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.model.coefficients import CONVERGING, Estimate
from imumon.model.history_report import HistoryRow, history_rows, objects
from imumon.model.readiness import seconds_left, state_of
from imumon.model.report import Channel
from imumon.model.samples import ChannelName, Floats
from imumon.model.units import MINUTE, duration, pretty
from imumon.tui.braille_canvas import AxisScale, Canvas, PlotFrame, ticked
from imumon.tui.channel_table import SYMBOLS
from imumon.tui.charts import EXTREME_VALUES, centred_text, numbers, round_step, tick_text
from imumon.tui.formatting import Line, approximate_duration, fitted, padded
from imumon.tui.view_state import RECORD, SPANS, HistorySeries, ViewState

MARKED = ("change", "restart", "connect", "disconnect", "warmup", "grade", "disturbance", "constant", "state")
"""Kinds of events that are marked."""
QUANTITIES = (*CONVERGING, "mean", "temperature")
MOST_ROOM = 0.5
"""Share of a value by which limits widen the scale: those of a young record or a short row may be many times it."""
LENGTHS_S = (1.0, 10.0, MINUTE, 600.0, 3600.0, 21_600.0, 86_400.0, 604_800.0, 2_592_000.0, 31_557_600.0)
"""s, lengths of a record that have a label, as far as they fit: those that people name."""
LAST_LABEL = 8
"""Cells at the end of the axis of lengths that its last label has for itself."""
LABEL_CELLS = 14
"""Cells of a label of the time axis, with its gap: a date and a clock time."""
GUTTER = 9
"""Cells to the left of a chart, for its labels."""
LEAST_ROWS = 4
"""Rows of a panel, with its title; fewer show no curve."""
_ROLES = {"mean": "signal", "temperature": "point"}
STATES = {"ready": "ready", "growing": "not precise enough", "bound": "only a bound", "none": "not known yet"}


@dataclass(frozen=True)
class Panel:
    """One quantity over time.

    Attributes
    ----------
    title : its name, with what is known of it now.
    time : (n,) s, length of the record or since 1970.
    value, low, high : (n,) as shown, NaN where unknown; of a bound, `high` alone is known.
    width : (n,) s, widths of the bars.
    role : role of the points.
    goal : ends of the configured precision, as shown; empty: none.
    """

    title: Line
    time: Floats
    value: Floats
    low: Floats
    high: Floats
    width: Floats
    role: str
    goal: tuple[float, ...] = ()


def parse(channel: ChannelName, rows: bytes, events: bytes) -> HistorySeries | None:
    """Return the history in the replies of a daemon; None if it has no valid row."""
    known = [_numbers(row) for row in history_rows(objects(rows)) if row.channel == channel]
    if not known:
        return None
    known.sort()
    table = np.array(known, dtype=np.float64)
    begin, end = table[:, 0], table[:, 1]
    sizes = dict(zip(QUANTITIES, table[:, 2:].T.reshape(len(QUANTITIES), 3, -1), strict=True))
    shown, period_s = tuple(_marks(objects(events))), float((end - begin).max())
    middle = 0.5 * (begin + end)
    return HistorySeries(channel, float(begin[0]), float(end.max()), middle, sizes, shown, period_s)


def _numbers(row: HistoryRow) -> tuple[float, ...]:
    """Return begin, end, and value and limits of each of the `QUANTITIES` of a row; what is not known is NaN."""
    parts = [row.coefficients.get(name, Estimate()) for name in CONVERGING]
    parts += [Estimate(value=value) for value in (row.mean, row.temperature)]
    sizes = (size for part in parts for size in (part.value, part.low, part.high))
    known = (math.nan if size is None else size for size in sizes)
    return (row.begin.timestamp(), row.begin.timestamp() + row.length_s, *known)


def _marks(events: Iterable[Any]) -> Iterator[tuple[float, str]]:
    """Yield time, s since 1970, and kind of the events that are marked."""
    for event in events:  # from another program: of any form
        with suppress(KeyError, TypeError, ValueError, OverflowError):
            if event["kind"] in MARKED:
                yield datetime.fromisoformat(event["time"]).astimezone(UTC).timestamp(), event["kind"]


@EXTREME_VALUES
def over_time_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the panels of the selected channel, one below the other."""
    title: Line = [(" ", "text"), (state.channel.replace("/", " "), "title"), ("   ", "text")]
    title += [(f" {name} ", "tab" if name == state.span else "muted") for name in (RECORD, *SPANS)]
    shown = _of_record(state) if state.span == RECORD else _of_history(state)
    if shown is None:
        text = ["nothing yet", "a record fills this after its first seconds, a history after its first row"]
        return [padded(title, width), *centred_text(text, width, height - 1)]
    notes = _notes(shown.legend, of_record=state.span == RECORD, has_events=bool(shown.events))
    head = padded(fitted([title, *notes], width), width)
    labels = _lengths(shown.axis, width) if state.span == RECORD else _dates(shown.axis, width)
    scaled = _scaled(shown.panels, shown.axis, height - 2)
    # the panels have one time axis: the longest label, which is never cut, gives the cells left of all
    gutter = max([GUTTER, *(len(text) + 1 for one in scaled for _, text in one.labels)])
    drawn = [line for one in scaled for line in _drawn(one, shown.axis, shown.events, gutter, width)]
    return [head, *drawn, _axis_line(shown.axis, labels, gutter, width)][:height]


@dataclass(frozen=True, slots=True)
class Timeline:
    """Panels on one axis of time, what it shows, and events on it, s since 1970 with their kinds."""

    panels: list[Panel]
    axis: AxisScale
    legend: str
    events: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True, slots=True)
class _ScaledPanel:
    """A panel with its rows, the scale of its values, and the labels of the scale."""

    panel: Panel
    rows: int
    scale: AxisScale
    labels: list[tuple[float, str]]


def _scaled(panels: Sequence[Panel], axis: AxisScale, height: int) -> list[_ScaledPanel]:
    """Return the panels that have room, one below the other, of heights that differ by one row at most."""
    shown, scaled, left = panels[: max(height // LEAST_ROWS, 1)], list[_ScaledPanel](), height
    for k, panel in enumerate(shown):
        rows = left // (len(shown) - k)
        left -= rows
        inside = _inside(panel, axis)
        value, low, high = (column[inside] for column in (panel.value, panel.low, panel.high))
        scale, ticks = ticked(
            np.concatenate((value, panel.goal, *_edges(value, low, high))), max(rows - 1, 1)
        )
        scaled.append(_ScaledPanel(panel, rows, scale, [(tick, tick_text(tick, ticks)) for tick in ticks]))
    return scaled


def _inside(panel: Panel, axis: AxisScale) -> npt.NDArray[np.bool_]:
    """Return (n,) whether each point lies in the span that is shown."""
    return (panel.time >= axis.low) & (panel.time <= axis.high)


def _notes(legend: str, *, of_record: bool, has_events: bool) -> list[Line]:
    """Return what the marks mean, the most important first."""
    return [
        [(f"   {legend}", "muted")],
        [("   ", "text"), ("  ", "text/band"), (" 95 %", "muted")],
        [("   ↓", "bound"), (" 95 % upper bound", "muted")],
        *([[("   ╌", "good"), (" to be within", "muted")]] if of_record else []),
        *([[("   ▏", "warn"), ("event", "muted")]] if has_events else []),
    ]


def _of_record(state: ViewState) -> Timeline | None:
    """Return what was stated of each coefficient while the record grew; None: nothing yet."""
    channel, report = state.selected, state.report
    stated = channel.convergence
    if stated is None or len(stated.elapsed_s) < 2:
        return None
    time, panels = np.array(stated.elapsed_s), []
    for letter in (letter for letter in CONVERGING if letter in stated.coefficients):
        factor = state.notation.coefficient_scale(state.channel.sensor, letter)[0]
        series, precision = stated.coefficients[letter], report.precision.get(letter)
        value, low, high = (numbers(column, factor) for column in (series.value, series.low, series.high))
        now = value[-1]
        goal = (now * (1.0 - precision), now * (1.0 + precision)) if precision and now > 0.0 else ()
        title = _record_title(state, channel, letter)
        panels.append(Panel(title, time, value, low, high, np.gradient(time), letter, goal))
    axis = AxisScale(stated.elapsed_s[0], stated.elapsed_s[-1] * 1.001, log=True)
    return Timeline(panels, axis, "by length")


def _record_title(state: ViewState, channel: Channel, letter: str) -> Line:
    """Return a coefficient as it is now, what it is to be, and when."""
    precision = state.report.precision
    seconds, kind = seconds_left(channel, letter, precision), state_of(channel, letter, precision)
    text, role = state.notation.coefficient(channel.estimates.get(letter), seconds)
    unit = state.notation.coefficient_scale(state.channel.sensor, letter)[1]
    title: Line = [(f" {letter} ", f"{letter}-strong"), (text, role), (f" {unit}", "muted")]
    if letter in precision:
        symbol, symbol_role = SYMBOLS[kind]
        ahead = f"ready in {approximate_duration(seconds)}" if seconds else STATES[kind]
        title.append((f"   to be {state.notation.goal(precision[letter])}", "muted"))
        title.append((f"   {symbol} {ahead}", symbol_role))
    return title


def _of_history(state: ViewState) -> Timeline | None:
    """Return the quantities of the history of which a row has a value or a bound; None: no row of the channel."""
    series = state.history
    if series is None or series.channel != state.channel:
        return None
    width, panels = np.full(len(series.time), series.period_s), []
    for name, sizes in series.sizes.items():
        factor, unit = _scale(state, series.channel, name)
        value, low, high = sizes * factor
        if np.isfinite(value).any() or np.isfinite(high).any():
            title: Line = [(f" {name}", "title"), (f" [{unit}]", "muted")]
            role = _ROLES.get(name, name)
            panels.append(Panel(title, series.time, value, low, high, width, role))
    axis = AxisScale(max(series.begin, series.end - SPANS[state.span][0]), series.end)
    return Timeline(panels, axis, f"each {duration(series.period_s)}, UTC", series.events)


def _scale(state: ViewState, channel: ChannelName, name: str) -> tuple[float, str]:
    """Return factor and unit of a quantity."""
    if name == "temperature":
        return 1.0, pretty("degC")
    if name == "mean":
        return state.notation.scale(channel)
    return state.notation.coefficient_scale(channel.sensor, name)


def _drawn(
    scaled: _ScaledPanel, axis: AxisScale, events: Sequence[tuple[float, str]], gutter: int, width: int
) -> list[Line]:
    """Return the title and the chart of one quantity."""
    panel, scale = scaled.panel, scaled.scale
    canvas = Canvas(width, max(scaled.rows - 1, 1))
    inside = _inside(panel, axis)
    time, value, low, high, wide = (
        column[inside] for column in (panel.time, panel.value, panel.low, panel.high, panel.width)
    )
    measured, bound = np.isfinite(value), ~np.isfinite(value) & np.isfinite(high)
    frame = _frame(canvas, axis, scale, gutter)
    frame.grid([], [tick for tick, _ in scaled.labels])
    frame.y_labels(scaled.labels)
    for when, kind in events:
        cell = frame.cell(when, 0.5 * (scale.low + scale.high))
        for row in range(canvas.height) if cell is not None else ():
            canvas.put(cell[0], row, "▏", "bad" if kind == "change" else "warn")  # type: ignore[index]
    frame.bars(time[measured], low[measured], high[measured], wide[measured], "band")
    for level in panel.goal:
        frame.curve(np.array([axis.low, axis.high]), np.full(2, level), "good", (2, 4))
    for when, size in zip(time[bound], high[bound], strict=True):
        if (cell := frame.cell(float(when), float(size))) is not None:
            canvas.text(*cell, "↓", "bound")
    frame.points(time, value, panel.role)
    return [padded(panel.title, width), *canvas.rows()]


def _frame(canvas: Canvas, x: AxisScale, y: AxisScale, gutter: int) -> PlotFrame:
    """Return the axes of a panel, which are those of the labels of time, too."""
    return PlotFrame(canvas, (gutter, 0, max(canvas.width - gutter - 2, 4), canvas.height), x, y)


def _edges(value: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Return the limits as far as a scale shows them."""
    known = value[np.isfinite(value)]
    if not len(known):
        return low, high
    least, greatest = float(known.min()), float(known.max())
    room = max(greatest - least, MOST_ROOM * abs(greatest))
    return np.clip(low, least - room, greatest + room), np.clip(high, least - room, greatest + room)


def _axis_line(axis: AxisScale, labels: Sequence[tuple[float, str]], gutter: int, width: int) -> Line:
    """Return the labels of the time axis, each below what it names."""
    canvas = Canvas(width, 1)
    _frame(canvas, axis, AxisScale(0.0, 1.0), gutter).x_labels(labels, 0)
    return canvas.rows()[0]


def _lengths(axis: AxisScale, width: int) -> list[tuple[float, str]]:
    """Return the labels of the length of a record; the last one, which must not be left out, has room."""
    last = 1.0 - LAST_LABEL / max(width - GUTTER - 2, LAST_LABEL)
    shares = axis.share(np.array(LENGTHS_S))
    inside = [length for length, share in zip(LENGTHS_S, shares, strict=True) if 0.0 <= share < last]
    return [*((length, duration(length)) for length in inside), (axis.high / 1.001, "now")]


def _dates(axis: AxisScale, width: int) -> list[tuple[float, str]]:
    """Return the labels of a time axis: clock times of a day, else dates."""
    step = round_step(axis.high - axis.low, max((width - GUTTER - 2) / LABEL_CELLS, 1.0))
    labels, day = [], None
    for when in axis.multiples(step):
        date = datetime.fromtimestamp(when, UTC)
        clock = "" if step >= 86400.0 else f"{date:%H:%M}" if step >= MINUTE else f"{date:%H:%M:%S}"
        # a clock time has its date where it is another one than that of the label before
        dated = not clock or date.date() != day
        labels.append((when, f"{date:%d %b} {clock}".strip() if dated else clock))
        day = date.date()
    return labels
