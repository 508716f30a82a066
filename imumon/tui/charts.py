"""Charts of a report on the canvas of `imumon.tui.braille_canvas`.

The report has the curves as points; here they are only placed. The asymptotes of an Allan deviation are straight
lines on a log-log chart. A coefficient is marked where its asymptote has its value: N at 1 s, K at 3 s. B has no such
place, and its line is at 0.664 B (IEEE Std 952, annex C).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.model.coefficients import COEFFICIENTS, MARKOV, NOISE, Estimate
from imumon.model.report import Allan, Channel, Histogram, Spectrum, Strip
from imumon.model.samples import ChannelName
from imumon.model.units import MINUTE, duration, number, pretty
from imumon.tui.braille_canvas import (
    TEXT_COST,
    AxisScale,
    Canvas,
    Floats,
    PlotFrame,
    logarithmic,
    ticked,
)
from imumon.tui.formatting import Line, Notation, approximate_duration, decade, fitted, length, padded
from imumon.tui.panels import precision_goal
from imumon.tui.view_state import WINDOWS, ViewState

EXTREME_VALUES = np.errstate(over="ignore", invalid="ignore", divide="ignore")
"""A value that a chart cannot place becomes infinite or NaN and is not drawn; a warning would end up on the screen."""

VISIBLE = 0.1
"""Share by which the model differs from the noise where both are drawn: a tenth of a line in half a decade."""

GUTTER = 7
"""Cells to the left of a frame, for its labels."""

CURVE_POINTS = 96
"""Points of the line of correlated noise: about one per column of cells."""

DECIMALS = 4
"""Decimals of a label at most; beyond them, it has an exponent: 2e-05, not 0.00002."""

MOST_TIMES = 6.0
"""Parts of the time axis of a signal, at most."""

NUMBERED = 48
"""Cells of a frame from which the marks of coefficients have their values beside them."""


def numbers(values: Sequence[float | None], factor: float = 1.0) -> Floats:
    """Return (n,) values in another unit, NaN where unknown."""
    return np.array([math.nan if v is None else v * factor for v in values], dtype=np.float64)


def centred_text(text: Sequence[str], width: int, height: int) -> list[Line]:
    """Return a text in the middle of an empty area."""
    top = max((height - len(text)) // 2, 0)
    lines: list[Line] = [[] for _ in range(top)]
    lines += [[(line[:width].center(width), "muted")] for line in text]
    return [padded(line, width) for line in lines + [[] for _ in range(height)]][:height]


@EXTREME_VALUES
def allan_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the Allan deviation of the selected channel, or of all axes of its sensor."""
    selected, channel = state.selected, state.channel
    if selected.allan is None or not selected.allan.tau_s:
        if channel.sensor in ("gyro", "accel", "mag"):
            return centred_text([f"{channel}: the curve begins with the first differences"], width, height)
        return centred_text([f"{channel} has no Allan deviation", "press 2 for its signal"], width, height)
    factor, unit = state.notation.deviation(channel)
    title = _allan_title(state, channel, unit, width)
    canvas = Canvas(width, height if state.compact else height - 1)
    # from the back to the front: where dots share a cell, the last ones give it their colour
    frame = _allan_frame(state, canvas, factor)
    _decades(frame, "τ [s]")
    if state.compact:
        _title_inside(canvas, title)  # before the labels, which go round it
    labels = _limit_curves(frame, state, channel, factor) if state.show_limits else []  # written at the end
    _baseline(frame, state, channel, factor)
    if state.overlay:
        for name in state.sensor_channels():
            _axis(frame, state, name, factor)
    else:
        _curve(frame, state.notation, selected, channel.sensor, factor)
    for column, row, grade in labels:
        canvas.text(column, row, grade, f"grade-{grade}")
    return canvas.rows() if state.compact else [title, *canvas.rows()]


def _baseline(frame: PlotFrame, state: ViewState, channel: ChannelName, factor: float) -> None:
    """Draw the Allan deviation of the channel in the baseline, if there is one."""
    before = state.baseline.channels.get(channel) if state.baseline is not None else None
    if before is not None and before.allan is not None:
        frame.curve(numbers(before.allan.tau_s), numbers(before.allan.sigma, factor), "baseline")


def _title_inside(canvas: Canvas, title: Line) -> None:
    """Write a title at the right end of the first row: a curve begins at the left, and falls."""
    spans = list(title)
    for end in (0, -1):  # the gutter, and the rest of the line
        while spans and not spans[end][0].strip() and "/" not in spans[end][1]:
            spans.pop(end)
    # a title as wide as the frame, with the way back at its end, must not touch the label of the first row
    column = max(canvas.width - sum(len(text) for text, _ in spans) - 1, GUTTER)
    for text, role in spans:
        canvas.text(column, 0, text, role)
        column += len(text)


def _goals(state: ViewState) -> list[Line]:
    """Return the time until each coefficient of the channel has its configured precision."""
    goals = [(letter, precision_goal(state, letter)) for letter in NOISE]
    return [[(f"  {letter} ", letter), (goal, "muted")] for letter, goal in goals if goal]


def _allan_title(state: ViewState, channel: ChannelName, unit: str, width: int) -> Line:
    """Return what is drawn, its unit, the way back, and as far as they fit, the missing time and the legend."""
    name = channel.sensor if state.overlay else channel.replace("/", " ")
    title: Line = [
        (" " * GUTTER, "text"),
        (name, "title"),
        (f"  σ(τ) [{unit}]", "muted"),
    ]
    back: Line = [("   esc", "key"), (" back ", "muted")] if state.zoomed else []
    goals = _goals(state) if not (state.detailed or state.overlay) else []
    back = [*fitted([[], *goals], width - length(title) - length(back)), *back]
    for item in _legend(state):
        if length(title) + length(item) + 3 <= width - length(back):
            title += [("   ", "text"), *item]
    return [*padded(title, width - length(back)), *back]


def _legend(state: ViewState) -> list[Line]:
    """Return what the lines and marks of the chart mean, the most important first."""
    if state.overlay:
        legend: list[Line] = [[("━ ", f"axis-{c[-1]}"), (c[-1], "muted")] for c in state.sensor_channels()]
    else:
        mark = "⠿ "
        legend = [
            [(mark, "point"), ("measured", "muted")],
            [("  ", "text/band"), (" 95 %", "muted")],
            [("━ ", "model"), ("model", "muted")],
        ]
        allan = state.selected.allan
        if allan is not None and not all(allan.used):
            legend.append([(mark, "unused"), ("not used", "muted")])
    if state.baseline is not None:  # beside `measured`: a narrow screen leaves out the last entries
        legend.insert(1, [("━ ", "baseline"), (state.baseline_name, "muted")])
    return legend


def _allan_frame(state: ViewState, canvas: Canvas, factor: float) -> PlotFrame:
    """Return axes that contain every curve to be drawn, in half decades."""
    names = state.sensor_channels() if state.overlay else (state.channel,)
    curves = [c.allan for name in names if (c := state.report.channels.get(name)) and c.allan]
    tau = np.concatenate([numbers(c.tau_s) for c in curves])
    sigma = np.concatenate([numbers((*c.sigma, *c.model), factor) for c in curves])
    edges = np.concatenate([numbers((*c.low, *c.high), factor) for c in curves])
    # limits of octaves with few samples may be decades away: the points decide, limits add at most a factor
    positive = sigma[np.isfinite(sigma) & (sigma > 0)]
    if len(positive):
        edges = np.clip(edges, positive.min() / 4.0, positive.max() * 4.0)
        lowest = positive.min() / (25.0 if canvas.height >= 16 else 5.0)
        marks = [] if state.overlay else [m * factor for m in _marks(state.selected) if m * factor > lowest]
        sigma = np.concatenate((sigma, edges, marks))
    x = logarithmic(np.concatenate((tau, [1.0, 3.0])))  # s, where N and K are marked
    bottom = 2 if canvas.height >= 14 else 1
    area = (GUTTER, 0, max(canvas.width - GUTTER - 2, 4), max(canvas.height - bottom, 2))
    return PlotFrame(canvas, area, x, logarithmic(sigma))


def _marks(channel: Channel) -> list[float]:
    """Return the Allan deviations, SI, at the marks of the measured coefficients."""
    return [value * COEFFICIENTS[letter].mark_height for letter, (value, _) in _drawn(channel).items()]


def _drawn(channel: Channel) -> dict[str, tuple[float, float]]:
    """Return value, SI, and place, s, of the mark of each measured coefficient that has an Allan deviation."""
    floor_s, time_s = _lowest(channel.allan or Allan()), channel.time_constant_s
    places = {letter: COEFFICIENTS[letter].mark_s(floor_s, time_s) for letter in channel.estimates}
    values = {letter: part.value for letter, part in channel.estimates.items()}
    return {
        letter: (value, place)
        for letter, place in places.items()
        if (value := values[letter]) and place is not None
    }


def _decades(frame: PlotFrame, x_unit: str) -> None:
    """Draw the grid of decades with their labels, and the unit of the x axis."""
    x, y = frame.x.decades(), frame.y.decades()
    frame.grid([10.0**e for e in x], [10.0**e for e in y])
    frame.y_labels(_labels(frame.y))
    row = frame.canvas.height - 1
    frame.canvas.text(frame.canvas.width - len(x_unit), row, x_unit, "text")
    available = frame.canvas.width - len(x_unit) - 1
    columns = (frame.across(np.array([10.0**e for e in x])) // 2).astype(np.int64)
    texts = [decade(e) for e in x]
    # the unit stands at the right end of the same row
    fits = [c + len(text) < available for c, text in zip(columns, texts, strict=True)]
    frame.x_labels([(10.0**e, text) for e, text, fit in zip(x, texts, fits, strict=True) if fit], row)
    if frame.top + frame.height < row:
        _axis_line(frame, row - 1, [10.0**e for e in x])


def _axis_line(frame: PlotFrame, row: int, ticks: Sequence[float]) -> None:
    """Draw the horizontal axis in a row of cells, with a mark at each tick."""
    frame.canvas.text(frame.left, row, "─" * frame.width, "axis")
    for across in frame.across(np.array(ticks, dtype=np.float64)):
        if math.isfinite(across):
            frame.canvas.text(int(across) // 2, row, "┴", "axis")


def _labels(axis: AxisScale) -> list[tuple[float, str]]:
    """Return the labels of a logarithmic axis: its decades, or 1, 2 and 5 times them where it has less than two."""
    decades = axis.decades()
    if len(decades) > 1:
        return [(10.0**e, decade(e)) for e in decades]
    exponents = range(math.floor(math.log10(axis.low)), math.floor(math.log10(axis.high)) + 1)
    values = [m * 10.0**e for e in exponents for m in (1, 2, 5)]
    return [(v, number(v, 1)) for v in values if axis.low <= v <= axis.high]


def _limit_curves(
    frame: PlotFrame, state: ViewState, channel: ChannelName, factor: float
) -> list[tuple[int, int, str]]:
    """Draw the curve at the limits of each grade; return column, row and text of the labels."""
    labels = []
    curves = state.report.limit_curves.get(channel.sensor, {})
    tau = np.geomspace(frame.x.low, frame.x.high, 64)
    for grade, curve in curves.items():
        log_sigma = np.interp(np.log(tau), np.log(curve.tau_s), np.log(curve.sigma))
        sigma: Floats = np.asarray(factor * np.exp(log_sigma), dtype=np.float64)
        frame.curve(tau, sigma, "limit", (1, 3))
        inside = np.flatnonzero((sigma > frame.y.low) & (sigma < frame.y.high))
        cell = frame.cell(float(tau[inside[-1]]), float(sigma[inside[-1]])) if len(inside) else None
        if cell is not None:
            column = min(cell[0], frame.left + frame.width) - len(grade)
            labels.append((column, max(cell[1] - 1, 0), grade))
    return labels


def _axis(frame: PlotFrame, state: ViewState, name: ChannelName, factor: float) -> None:
    """Draw the curve of one axis among others."""
    allan = state.report.channels[name].allan
    if allan is None or not allan.tau_s:
        return
    tau, sigma = numbers(allan.tau_s), numbers(allan.sigma, factor)
    frame.curve(tau, sigma, f"axis-{name[-1]}")
    frame.points(tau, sigma, f"axis-{name[-1]}")
    cell = frame.cell(float(tau[-1]), float(sigma[-1]))
    if cell is not None:
        column, row = min(cell[0] + 1, frame.canvas.width - 1), cell[1]
        # axes that end in one row have their names in rows of their own
        free = [r for r in (row, row - 1, row + 1) if frame.canvas.overlap(column, r, 1) < TEXT_COST]
        frame.canvas.text(column, free[0] if free else row, name[-1], f"axis-{name[-1]}")


def _curve(frame: PlotFrame, notation: Notation, channel: Channel, sensor: str, factor: float) -> None:
    """Draw points with their band, the model, its noise where it differs, and the measured coefficients."""
    allan = channel.allan or Allan()
    tau, sigma = numbers(allan.tau_s), numbers(allan.sigma, factor)
    frame.band(tau, numbers(allan.low, factor), numbers(allan.high, factor), "band")
    marks, time_constant_s = _drawn(channel), channel.time_constant_s
    for letter, (value, _) in marks.items():
        row = COEFFICIENTS[letter]
        # an asymptote is straight on these axes; the line of correlated noise has a hump
        times = np.geomspace(frame.x.low, frame.x.high, CURVE_POINTS if letter in MARKOV else 2)
        line = np.array([row.deviation(tau_s, time_constant_s) for tau_s in times.tolist()])
        frame.curve(times, line * value * factor, letter, (3, 3))
    model, noise = numbers(allan.model, factor), numbers(allan.noise, factor)
    if (np.abs(model / noise - 1.0) > VISIBLE).any():
        frame.curve(tau, noise, "model", (1, 2))
    frame.curve(tau, model, "model")
    used = np.array(allan.used, dtype=np.bool_) if allan.used else np.ones(len(tau), dtype=np.bool_)
    frame.points(tau[used], sigma[used], "point")
    frame.points(tau[~used], sigma[~used], "unused")
    for letter, (value, tau_s) in marks.items():
        part = channel.estimates[letter]
        text = _mark_text(notation, sensor, letter, part) if frame.width >= NUMBERED else letter
        frame.label(tau_s, value * COEFFICIENTS[letter].mark_height * factor, text, letter)


def _mark_text(notation: Notation, sensor: str, letter: str, part: Estimate) -> str:
    """Return the text beside the mark of a coefficient: its value, or what the axis shows of it."""
    value, height = notation.limits(part)[0], COEFFICIENTS[letter].mark_height
    if value is None:
        return letter
    if (
        COEFFICIENTS[letter].read_s is None
    ):  # the axis is in the unit of B and M: a line at 0.664 B or 0.617 M
        return f"{height:.3f} {letter} = {number(height * value, 3)}"
    return f"{letter} {number(value, 3)} {notation.coefficient_scale(sensor, letter)[1]}"


def _lowest(allan: Allan) -> float:
    """Return the time at which the noise is lowest, s: where B is read."""
    known = [(m, t) for m, t in zip(allan.noise, allan.tau_s, strict=False) if m is not None]
    return min(known)[1] if known else 1.0


@EXTREME_VALUES
def signal_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return minimum and maximum of the selected channel over time."""
    channel = state.channel
    factor, unit = state.notation.scale(channel)
    envelope: Strip | None = getattr(state.signal, state.window) if state.signal is not None else None
    title: Line = [(" " * GUTTER, "text"), (channel.replace("/", " "), "title"), (f"  [{unit}]   ", "muted")]
    for name in WINDOWS:
        title.append((f" {name} ", "tab" if name == state.window else "muted"))
    if envelope is None or not any(v is not None for v in envelope.low):
        text = "no signal yet" if state.signal else "waiting for the signal"
        return [padded(title, width), *centred_text([text], width, height - 1)]
    column = f"{envelope.column_s:.2g} s" if envelope.column_s < MINUTE else duration(envelope.column_s)
    legend: list[Line] = [[("   ", "text"), ("  ", "text/band"), (" minimum to maximum", "muted")]]
    legend.append([(f" of each {column}", "muted")])
    end = "now" if state.connection_status().live else "end"
    chart = _envelope(envelope, factor, end, width, height - 1)
    return [padded(fitted([title, *legend], width), width), *chart]


def _envelope(envelope: Strip, factor: float, end: str, width: int, height: int) -> list[Line]:
    """Return the chart of minimum and maximum over the time before `end`: two lines and what lies between them."""
    low, high = numbers(envelope.low, factor), numbers(envelope.high, factor)
    canvas = Canvas(width, height)
    span = envelope.column_s * len(low)
    rows = max(height - 1, 2)
    y, ticks = ticked(np.concatenate((low, high)), rows)
    levels = [(t, tick_text(t, ticks)) for t in ticks]
    left = max(GUTTER + 2, *(len(text) + 1 for _, text in levels))  # a label is never cut
    frame = PlotFrame(canvas, (left, 0, max(width - left - 2, 4), rows), AxisScale(-span, 0.0), y)
    times = AxisScale(0.0, span).multiples(round_step(span, MOST_TIMES))
    frame.grid([-t for t in times], ticks)
    frame.y_labels(levels)
    # x labels are placed from the left, and one that would touch its neighbour is left out: `end` is the last
    labels = [(-t, f"−{approximate_duration(t)}" if t else end) for t in reversed(times)]
    frame.x_labels(labels, canvas.height - 1)
    # of a terminal with less columns than the envelope, each shows the extremes of several
    top, bottom = _extremes(low, high, min(2 * frame.width, len(low)))
    moments: Floats = np.asarray((np.arange(len(top)) + 0.5) / len(top) * span - span, dtype=np.float64)
    frame.bars(moments, bottom, top, np.full(len(top), span / len(top)), "band")
    for edge in (bottom, top):
        frame.curve(moments, edge, "point")
    return canvas.rows()


def _extremes(low: Floats, high: Floats, count: int) -> tuple[Floats, Floats]:
    """Return the maximum of `high` and the minimum of `low` in each of `count` equal columns.

    Parameters
    ----------
    low, high : (n,) any unit, NaN without samples.

    Returns
    -------
    top, bottom : (count,) the same unit.
    """
    first = np.minimum(np.arange(count) * len(low) // count, len(low) - 1)
    top = np.maximum.reduceat(np.where(np.isfinite(high), high, -np.inf), first)
    bottom = np.minimum.reduceat(np.where(np.isfinite(low), low, np.inf), first)
    known = np.isfinite(top) & np.isfinite(bottom)
    return np.where(known, top, np.nan), np.where(known, bottom, np.nan)


STEPS_S = (
    *(1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0, 7200.0, 10_800.0),
    *(14_400.0, 21_600.0, 43_200.0, 86_400.0, 172_800.0, 345_600.0, 604_800.0, 1_209_600.0, 2_592_000.0),
    5_184_000.0,
)
"""s between two labels of a time axis."""


def round_step(span: float, most: float) -> float:
    """Return the least round step, s, of which a time has at most a number."""
    # beyond the table, as few parts as it needs
    return next(
        (step for step in STEPS_S if span / step <= most), math.ceil(span / STEPS_S[-1]) * STEPS_S[-1]
    )


def tick_text(value: float, ticks: Sequence[float]) -> str:
    """Return the label of a tick, with as many digits as its neighbours require, in at most 8 cells where they do.

    >>> tick_text(0.2, [0.0, 0.2, 0.4]), tick_text(1.05e-5, [1e-5, 1.05e-5]), tick_text(0.0, [0.0, 1e-5])
    ('0.2', '1.05e-05', '0')
    >>> tick_text(-331.7501, [-331.7502, -331.7501])
    '-331.7501'
    """
    step = ticks[1] - ticks[0] if len(ticks) > 1 else abs(value) or 1.0
    decimals = max(-math.floor(math.log10(step) + 1e-9), 0)
    if abs(value) < 0.5 * step:
        return "0"
    text = f"{value:.{decimals}f}"
    if len(text) <= GUTTER + 1 and decimals <= DECIMALS:
        return text
    digits = math.floor(math.log10(abs(value)) + 1e-9) - math.floor(math.log10(step) + 1e-9)
    with_power = f"{value:.{max(digits, 0)}e}"
    return text if len(text) <= len(with_power) else with_power


@EXTREME_VALUES
def histogram_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the distribution of the values, with the Gaussian of the same mean and standard deviation."""
    channel = state.channel
    histogram: Histogram | None = state.selected.histogram
    factor, unit = state.notation.scale(channel)
    name: Line = [(" ", "text"), ("distribution", "title"), ("  [% per bin]", "muted")]
    title = padded(fitted([name, [("   ━ ", "N"), ("Gaussian", "muted")]], width), width)
    if histogram is None or not histogram.counts:
        return [title, *centred_text(["no distribution yet"], width, height - 1)]
    canvas = Canvas(width, height - 1)
    counts = np.array(histogram.counts, dtype=np.float64)
    share = 100.0 / max(float(counts.sum()), 1.0)  # % of a sample
    start, bin_width = histogram.start * factor, histogram.width * factor
    edges = AxisScale(start, start + bin_width * len(counts))
    area = (GUTTER, 0, max(width - GUTTER - 2, 4), max(height - 3, 2))
    expected = numbers(histogram.gaussian, share)
    y, heights_shown = ticked(np.concatenate((counts * share, expected)), area[3], floor=0.0)
    frame = PlotFrame(canvas, area, edges, y)
    # bins to columns: the mean of the bins of a column, or one bin in several columns
    first = np.arange(frame.width) * len(counts) // frame.width
    until = np.maximum(np.arange(1, frame.width + 1) * len(counts) // frame.width, first + 1)
    heights = np.array([counts[a:b].mean() for a, b in zip(first, until, strict=True)])
    heights = heights * (share / y.high) * frame.height
    heights = np.where(heights > 0, np.maximum(heights, 0.125), np.nan)  # at least an eighth of a cell
    ticks = edges.ticks(max(frame.width // 14, 2))
    for height_shown in heights_shown:
        text, row = tick_text(height_shown, heights_shown), int(frame.down(np.array([height_shown]))[0]) // 4
        # 0 is the lower edge of the last row, which is the row of the axis: the others are one row below, too
        canvas.text(frame.left - 1 - len(text), row + 1, text, "muted")
    canvas.fill(frame.left, frame.height - heights, np.full(frame.width, float(frame.height)), "bar")
    centres = start + bin_width * (np.arange(len(counts)) + 0.5)
    frame.curve(np.asarray(centres, dtype=np.float64), expected, "N")
    _axis_line(frame, canvas.height - 2, ticks)
    canvas.text(width - len(unit) - 2, canvas.height - 1, f"[{unit}]", "text")
    last = width - len(unit) - 3
    labels = [(t, tick_text(t, ticks)) for t in ticks]
    clear = [(t, text) for t, text in labels if frame.across(np.array([t]))[0] // 2 + len(text) < last]
    frame.x_labels(clear, canvas.height - 1)
    return [title, *canvas.rows()]


@EXTREME_VALUES
def spectrum_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the amplitude spectral density over frequency, log-log, with its lines marked."""
    channel = state.channel
    spectrum: Spectrum | None = state.selected.spectrum
    factor, unit = state.notation.scale(channel)
    root = pretty("sqrt(Hz)")
    title = padded([(" " * GUTTER, "text"), ("spectrum", "title"), (f"  [{unit}/{root}]", "muted")], width)
    if spectrum is None or not any(f > 0 for f in spectrum.frequency_hz):
        return [title, *centred_text(["no spectrum yet"], width, height - 1)]
    frequency = numbers(spectrum.frequency_hz)
    density: Floats = np.asarray(np.sqrt(numbers(spectrum.density)) * factor, dtype=np.float64)
    good = (frequency > 0) & (density > 0)
    frequency, density = frequency[good], density[good]
    canvas = Canvas(width, height - 1)
    x = AxisScale(float(frequency.min()), float(frequency.max()) * 1.02, log=True)
    area = (GUTTER, 0, max(width - GUTTER - 1, 4), max(height - 2, 2))
    frame = PlotFrame(canvas, area, x, logarithmic(density))
    _decades(frame, "[Hz]")
    frame.curve(frequency, density, "signal")
    for line in spectrum.lines:
        near = int(np.argmin(np.abs(frequency - line.frequency_hz)))
        text = line.name or f"{line.frequency_hz:.3g} Hz"
        frame.label(float(frequency[near]), float(density[near]), text, "warn", "◇")
    return [title, *canvas.rows()]
