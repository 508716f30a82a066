"""Charts of what was stated of the selected channel when the record was shorter: has each number come to rest?

One chart per coefficient, against the length of the record on a logarithmic axis: the value within its 95 % limits, and
an arrow at each upper bound. Two dashed lines are the configured precision about the present value: where the limits
are between them, the number is as precise as configured.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.coefficients import CONVERGING
from imumon.readiness import state_of
from imumon.report import Channel, Convergence, StatedSeries
from imumon.samples import Floats, sensor_of
from imumon.tui.braille_canvas import MOST_TICKS, AxisScale, Canvas, PlotFrame, logarithmic
from imumon.tui.channel_table import SYMBOLS
from imumon.tui.charts import EXTREME_VALUES, centred_text, numbers
from imumon.tui.formatting import Line, approximate_duration, fitted, padded
from imumon.tui.view_state import ViewState
from imumon.units import MINUTE, duration, number

GUTTER = 9
"""Cells to the left of a chart, for its labels."""
LENGTHS_S = (1.0, 10.0, MINUTE, 600.0, 3600.0, 21_600.0, 86_400.0, 604_800.0, 2_592_000.0, 31_557_600.0)
"""s, lengths that have a label, as far as they fit: those that people name."""
LEAST_ROWS = 4
"""Rows of the chart of a coefficient, with its title; fewer show no band."""
LAST_LABEL = 8
"""Cells at the end of the axis of lengths that its last label has for itself."""
WIDEST = 1.5
"""Factor by which limits widen the scale of the values: those of a young record may be decades away."""
ROOM = 1.08
"""Factor between the outermost numbers and the ends of a scale."""
STATES = {"ready": "ready", "growing": "not precise enough", "bound": "only a bound", "none": "not known yet"}


@EXTREME_VALUES
def convergence_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the charts of the selected channel, one below the other."""
    channel, name = state.selected, state.channel or ""
    stated = channel.convergence if channel is not None else None
    title: Line = [(" ", "text"), (name.replace("/", " "), "title")]
    if channel is None or stated is None or len(stated.elapsed_s) < 2:
        text = ["what was stated of a shorter record appears here", "after the first seconds of a record"]
        return [padded(title, width), *centred_text(text, width, height - 1)]
    legend: list[Line] = [
        [("   by the length of the record", "muted")],
        [("   ", "text"), ("  ", "text/band"), (" 95 %", "muted")],
        [("   ↓", "bound"), (" 95 % upper bound", "muted")],
        [("   ╌", "good"), (" to be within", "muted")],
    ]
    letters = [letter for letter in CONVERGING if letter in stated.coefficients]
    letters = letters[: max((height - 2) // LEAST_ROWS, 1)]
    lines, left = [padded(fitted([title, *legend], width), width)], height - 2
    for k, letter in enumerate(letters):
        rows = left // (len(letters) - k)
        left -= rows
        lines += _panel(state, channel, stated, letter, width, rows)
    return [*lines, _length_axis(stated, width)][:height]


def _panel(
    state: ViewState, channel: Channel, stated: Convergence, letter: str, width: int, height: int
) -> list[Line]:
    """Return the chart of one coefficient, with its title."""
    factor = state.notation.coefficient_scale(sensor_of(state.channel or ""), letter)[0]
    series = stated.coefficients[letter]
    canvas = Canvas(width, max(height - 1, 1))
    value, low, high = (numbers(column, factor) for column in (series.value, series.low, series.high))
    measured, bound = ~np.isnan(value), np.isnan(value) & ~np.isnan(high)
    precision = state.report.precision.get(letter) if state.report is not None else None
    now = value[-1] if measured[-1] else np.nan
    goal = np.array([now * (1.0 - precision), now * (1.0 + precision)]) if precision else np.full(2, np.nan)
    y = _scale(np.concatenate((value, high[bound], goal)), np.concatenate((low[measured], high[measured])))
    x = AxisScale(stated.elapsed_s[0], stated.elapsed_s[-1] * 1.001, log=True)
    frame = PlotFrame(canvas, (GUTTER, 0, max(width - GUTTER - 2, 4), canvas.height), x, y)
    frame.grid([], [10.0**e for e in y.decades()])
    ticks = _ticks(y, canvas.height)
    digits = 1 if len(ticks) > 1 and ticks[1] >= 1.9 * ticks[0] else 2
    frame.y_labels([(tick, number(tick, digits)) for tick in ticks])
    lengths = np.array(stated.elapsed_s)
    frame.band(lengths, np.where(measured, low, np.nan), np.where(measured, high, np.nan), "band")
    ends = np.array([x.low, x.high])
    for level in goal:
        frame.curve(ends, np.full(2, level), "good", (2, 4))
    frame.curve(lengths, value, letter)
    frame.points(lengths[measured], value[measured], letter, "o" if state.notation.ascii else None)
    for length, size in zip(lengths[bound], high[bound], strict=True):
        if (cell := frame.cell(float(length), float(size))) is not None:
            canvas.text(*cell, "↓", "bound")
    return [_panel_title(state, channel, letter, series, width), *canvas.rows()]


def _scale(sizes: Floats, limits: Floats) -> AxisScale:
    """Return a logarithmic scale of sizes, with room for limits up to `WIDEST` times beyond them."""
    sizes = sizes[np.isfinite(sizes) & (sizes > 0.0)]
    if not len(sizes):
        return logarithmic(sizes)
    least, greatest = float(sizes.min()), float(sizes.max())
    edges = np.clip(limits[np.isfinite(limits)], least / WIDEST, greatest * WIDEST)
    least, greatest = min([least, *edges.tolist()]), max([greatest, *edges.tolist()])
    return AxisScale(least / ROOM, greatest * ROOM, log=True)


def _ticks(y: AxisScale, rows: int) -> list[float]:
    """Return the decades of the axis, or round values between them where it has less than two."""
    decades = [10.0**e for e in y.decades()]
    if len(decades) > 1:
        return decades[:: math.ceil(len(decades) / rows)]
    whole = math.floor(math.log10(y.low))
    round_numbers = [m * 10.0**e for e in (whole, whole + 1) for m in (1, 2, 5)]
    inside = [tick for tick in round_numbers if y.low <= tick <= y.high]
    if len(inside) > 2:
        return inside
    # less than a factor of 10: equal steps lie nearly even on this scale
    steps = (AxisScale(y.low, y.high).ticks(count) for count in range(max(rows // 2, 2), MOST_TICKS))
    return next((ticks for ticks in steps if len(ticks) > 1), [y.low * ROOM, y.high / ROOM])


def _panel_title(state: ViewState, channel: Channel, letter: str, series: StatedSeries, width: int) -> Line:
    """Return a coefficient as it is now, what it is to be, and when."""
    part, seconds = channel.estimates.get(letter), (channel.time_to or {}).get(letter)
    text, role = state.notation.coefficient(part, seconds)
    unit = state.notation.coefficient_scale(sensor_of(state.channel or ""), letter)[1]
    kind = state_of(channel, letter)
    symbol, symbol_role = SYMBOLS[kind]
    parts: list[Line] = [[(f" {letter} ", f"{letter}-strong"), (text, role), (f" {unit}", "muted")]]
    if state.report is not None and letter in state.report.precision:
        parts.append([(f"   to be {state.notation.goal(state.report.precision[letter])}", "muted")])
        ahead = f"ready in {approximate_duration(seconds)}" if seconds else STATES[kind]
        parts.append([(f"   {symbol} ", symbol_role), (ahead, symbol_role)])
    return padded(fitted(parts, width), width)


def _length_axis(stated: Convergence, width: int) -> Line:
    """Return the labels of the length of the record."""
    canvas = Canvas(width, 1)
    x = AxisScale(stated.elapsed_s[0], stated.elapsed_s[-1] * 1.001, log=True)
    frame = PlotFrame(canvas, (GUTTER, 0, max(width - GUTTER - 2, 4), 1), x, AxisScale(0.0, 1.0))
    # the last label, which must not be left out, has room
    last = (frame.across(np.array([x.high / 1.001]))[0] - 2 * LAST_LABEL) if frame.width > LAST_LABEL else 0.0
    inside = [length for length in LENGTHS_S if frame.across(np.array([length]))[0] < last]
    labels = [(length, duration(length)) for length in inside]
    frame.x_labels([*labels, (stated.elapsed_s[-1], "now")], 0)
    return canvas.rows()[0]
