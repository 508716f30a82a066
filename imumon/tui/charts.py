"""Charts of a report on the canvas of `imumon.tui.braille_canvas`.

The report has the curves as points; here they are only placed. The asymptotes of an Allan deviation are straight
lines on a log-log chart. A coefficient is marked where its asymptote has its value: N at 1 s, K at 3 s. B has no such
place, and its line is at 0.664 B (IEEE Std 952, annex C).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.report import COEFFICIENTS, NOISE, Allan, Channel, Histogram, Spectrum, Strip
from imumon.samples import sensor_of
from imumon.tui.braille_canvas import AxisScale, Canvas, Floats, PlotFrame, linear, logarithmic
from imumon.tui.formatting import Line, Notation, approximate_duration, fitted, length, padded
from imumon.tui.panels import precision_goal
from imumon.tui.view_state import ViewState
from imumon.units import number

EXTREME_VALUES = np.errstate(over="ignore", invalid="ignore", divide="ignore")
"""A value that a chart cannot place becomes infinite or NaN and is not drawn; a warning would end up on the screen."""

VISIBLE = 0.1
"""Share by which the model differs from the noise where both are drawn: a tenth of a line in half a decade."""

GUTTER = 7
"""Cells to the left of a frame, for its labels."""


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
    if selected is None or channel is None:
        return centred_text(["no channel"], width, height)
    if selected.allan is None or not selected.allan.tau_s:
        if sensor_of(channel) in ("gyro", "accel", "mag"):
            return centred_text([f"{channel}: the curve begins with the first differences"], width, height)
        return centred_text([f"{channel} has no Allan deviation", "press 2 for its signal"], width, height)
    factor, unit = state.notation.deviation(channel)
    canvas = Canvas(width, height - 1)
    frame = _allan_frame(state, canvas, factor)
    _decades(frame, state.notation, f"{state.notation.symbol('τ')} [s]")
    labels = _limit_curves(frame, state, channel, factor) if state.show_limits else []
    before = state.baseline.channels.get(channel) if state.baseline is not None else None
    if before is not None and before.allan is not None:
        frame.curve(numbers(before.allan.tau_s), numbers(before.allan.sigma, factor), "baseline")
    if state.overlay:
        for name in state.sensor_channels():
            _axis(frame, state, name, factor)
    else:
        _curve(frame, state.notation, selected, sensor_of(channel), factor)
    for column, row, grade in labels:
        canvas.text(column, row, grade, f"grade-{grade}")
    return [_allan_title(state, channel, unit, width), *canvas.rows()]


def _goals(state: ViewState) -> list[Line]:
    """Return the time until each coefficient of the channel has its configured precision."""
    goals = [(letter, precision_goal(state, letter)) for letter in NOISE]
    return [[(f"  {letter} ", letter), (goal, "muted")] for letter, goal in goals if goal]


def _allan_title(state: ViewState, channel: str, unit: str, width: int) -> Line:
    """Return what is drawn, its unit, the way back, and as far as they fit, the missing time and the legend."""
    name = sensor_of(channel) if state.overlay else channel.replace("/", " ")
    title: Line = [
        (" " * GUTTER, "text"),
        (name, "title"),
        (f"  {state.notation.symbol('σ(τ)')} [{unit}]", "muted"),
    ]
    legend: list[Line] = []
    mark = "o " if state.notation.ascii else "⠿ "
    if state.overlay:
        legend = [[("━ ", f"axis-{c[-1]}"), (c[-1], "muted")] for c in state.sensor_channels()]
    else:
        legend = [
            [(mark, "point"), ("measured", "muted")],
            [("██ ", "bandkey"), ("95 %", "muted")],
            [("━ ", "model"), ("model", "muted")],
        ]
        allan = state.selected.allan if state.selected is not None else None
        if allan is not None and not all(allan.used):
            legend.append([(mark, "unused"), ("not used", "muted")])
    if state.baseline is not None:
        legend.insert(1, [("━ ", "baseline"), (state.baseline_name, "muted")])
    back: Line = [("   esc", "key"), (" back ", "muted")] if state.zoomed else []
    goals = _goals(state) if not (state.detailed or state.overlay) else []
    back = [*fitted([[], *goals], width - length(title) - length(back)), *back]
    for item in legend:
        if length(title) + length(item) + 3 <= width - length(back):
            title += [("   ", "text"), *item]
    return [*padded(title, width - length(back)), *back]


def _allan_frame(state: ViewState, canvas: Canvas, factor: float) -> PlotFrame:
    """Return axes that contain every curve to be drawn, in half decades."""
    names = state.sensor_channels() if state.overlay else (state.channel or "",)
    curves = [
        c.allan for name in names if state.report and (c := state.report.channels.get(name)) and c.allan
    ]
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
    x = logarithmic(np.concatenate((tau, [1.0, 3.0])))
    bottom = 2 if canvas.height >= 14 else 1
    area = (GUTTER, 0, max(canvas.width - GUTTER - 2, 4), max(canvas.height - bottom, 2))
    return PlotFrame(canvas, area, x, logarithmic(sigma))


def _marks(channel: Channel | None) -> list[float]:
    """Return the heights at which measured coefficients are marked, SI."""
    known = channel.coefficients if channel is not None else {}
    return [part.value * _height(letter) for letter, part in known.items() if part.value is not None]


def _height(letter: str) -> float:
    """Return the Allan deviation at the place of a mark, over the coefficient."""
    row = COEFFICIENTS[letter]
    return row.level if row.read_s is None else 1.0


def _decades(frame: PlotFrame, notation: Notation, x_unit: str) -> None:
    """Draw the grid of decades with their labels, and the unit of the x axis."""
    x, y = frame.x.decades(), frame.y.decades()
    frame.grid([10.0**e for e in x], [10.0**e for e in y])
    labels = [(10.0**e, notation.decade(e)) for e in y]
    if len(y) < 2:
        values = [m * 10.0**e for e in range(math.floor(math.log10(frame.y.low)), 9) for m in (1, 2, 5)]
        labels = [(v, number(v, 1)) for v in values if frame.y.low <= v <= frame.y.high]
    frame.y_labels(labels)
    row = frame.canvas.height - 1
    frame.canvas.text(frame.canvas.width - len(x_unit), row, x_unit, "text")
    available = frame.canvas.width - len(x_unit) - 1
    columns = (frame.across(np.array([10.0**e for e in x])) // 2).astype(np.int64)
    texts = [notation.decade(e) for e in x]
    fits = [c + len(text) < available for c, text in zip(columns, texts, strict=True)]
    frame.x_labels([(10.0**e, text) for e, text, fit in zip(x, texts, fits, strict=True) if fit], row)
    if frame.top + frame.height < row:
        frame.canvas.text(frame.left, row - 1, "─" * frame.width, "axis")
        for column in columns:
            frame.canvas.text(int(column), row - 1, "┴", "axis")


def _limit_curves(
    frame: PlotFrame, state: ViewState, channel: str, factor: float
) -> list[tuple[int, int, str]]:
    """Draw the curve at the limits of each grade; return column, row and text of the labels."""
    labels = []
    curves = state.report.limit_curves.get(sensor_of(channel), {}) if state.report is not None else {}
    tau = np.geomspace(frame.x.low, frame.x.high, 64)
    for grade, curve in curves.items():
        log_sigma = np.interp(np.log(tau), np.log(curve.tau_s), np.log(curve.sigma))
        sigma: Floats = np.asarray(factor * np.exp(log_sigma), dtype=np.float64)
        frame.curve(tau, sigma, "limit", (1, 3))
        inside = np.flatnonzero((sigma > frame.y.low) & (sigma < frame.y.high))
        at = frame.cell(float(tau[inside[-1]]), float(sigma[inside[-1]])) if len(inside) else None
        if at is not None:
            column = min(at[0], frame.left + frame.width) - len(grade)
            labels.append((column, max(at[1] - 1, 0), grade))
    return labels


def _axis(frame: PlotFrame, state: ViewState, name: str, factor: float) -> None:
    """Draw the curve of one axis among others."""
    channel = state.report.channels.get(name) if state.report is not None else None
    if channel is None or channel.allan is None or not channel.allan.tau_s:
        return
    tau, sigma = numbers(channel.allan.tau_s), numbers(channel.allan.sigma, factor)
    frame.curve(tau, sigma, f"axis-{name[-1]}")
    frame.points(tau, sigma, f"axis-{name[-1]}")
    at = frame.cell(float(tau[-1]), float(sigma[-1]))
    if at is not None:
        frame.canvas.text(min(at[0] + 1, frame.canvas.width - 1), at[1], name[-1], f"axis-{name[-1]}")


def _curve(frame: PlotFrame, notation: Notation, channel: Channel, sensor: str, factor: float) -> None:
    """Draw points with their band, the model, its noise where it differs, and the measured coefficients."""
    allan = channel.allan or Allan()
    tau, sigma = numbers(allan.tau_s), numbers(allan.sigma, factor)
    frame.band(tau, numbers(allan.low, factor), numbers(allan.high, factor), "band")
    ends = np.array([frame.x.low, frame.x.high])
    known = {letter: part for letter, part in channel.coefficients.items() if part.value}
    for letter, part in known.items():
        slope = np.array([COEFFICIENTS[letter].deviation(tau_s) for tau_s in ends.tolist()])
        frame.curve(ends, slope * (part.value or 0.0) * factor, letter, (3, 3))
    model, noise = numbers(allan.model, factor), numbers(allan.noise, factor)
    if (np.abs(model / noise - 1.0) > VISIBLE).any():
        frame.curve(tau, noise, "model", (1, 2))
    frame.curve(tau, model, "model")
    used = np.array(allan.used, dtype=np.bool_) if allan.used else np.ones(len(tau), dtype=np.bool_)
    character = "o" if notation.ascii else None
    frame.points(tau[used], sigma[used], "point", character)
    frame.points(tau[~used], sigma[~used], "unused", character)
    for letter, part in known.items():
        at, height, value = COEFFICIENTS[letter].read_s, _height(letter), notation.limits(part)[0]
        text = letter
        if frame.width >= 48 and value is not None:
            unit = notation.coefficient_scale(sensor, letter)[1]
            # the axis is in the unit of B, and the line is at 0.664 B
            axis = f"{height:.3f} {letter} = {number(height * value, 3)}"
            text = axis if at is None else f"{letter} {number(value, 3)} {unit}"
        frame.label(at or _lowest(allan), (part.value or 0.0) * height * factor, text, letter)


def _lowest(allan: Allan) -> float:
    """Return the time at which the noise is lowest, s: where B is read."""
    known = [(m, t) for m, t in zip(allan.noise, allan.tau_s, strict=False) if m is not None]
    return min(known)[1] if known else 1.0


@EXTREME_VALUES
def signal_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return minimum and maximum of the selected channel over time."""
    channel = state.channel or ""
    factor, unit = state.notation.scale(channel)
    envelope: Strip | None = getattr(state.signal, state.window) if state.signal is not None else None
    title: Line = [(" " * GUTTER, "text"), (channel.replace("/", " "), "title"), (f"  [{unit}]   ", "muted")]
    for name in ("minute", "hour", "everything"):
        title.append((f" {name} ", "tab" if name == state.window else "muted"))
    title = padded(title, width)
    if envelope is None or not any(v is not None for v in envelope.low):
        text = "no signal yet" if state.signal else "waiting for the signal"
        return [title, *centred_text([text], width, height - 1)]
    low, high = numbers(envelope.low, factor), numbers(envelope.high, factor)
    canvas = Canvas(width, height - 1)
    span = envelope.column_s * len(low)
    y = linear(np.concatenate((low, high)))
    area = (GUTTER + 2, 0, max(width - GUTTER - 4, 4), max(height - 2, 2))
    frame = PlotFrame(canvas, area, AxisScale(-span, 0.0), y)
    ticks = y.ticks(max(frame.height // 2, 2))
    times = _times(span)
    frame.grid([-t for t in times], ticks)
    frame.y_labels([(t, _tick(t, ticks)) for t in ticks])
    end = "now" if state.connection_status().live else "end"
    labels = [(-t, f"−{approximate_duration(t)}" if t else end) for t in reversed(times)]
    frame.x_labels(labels, canvas.height - 1)
    top, bottom = _extremes(low, high, 2 * frame.width)
    frame.columns(bottom, top, "signal")
    return [title, *canvas.rows()]


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


def _times(span: float) -> list[float]:
    """Return about five round times before now, s."""
    minutes, hours = (60, 120, 300, 600, 900, 1800), (3600, 7200, 14400, 21600, 43200, 86400, 172800)
    steps = (1, 2, 5, 10, 15, 30, *minutes, *hours)
    weeks = max(span / 6.0 / 604800, 1.0)
    step = next((s for s in steps if span / s <= 6.0), 604800.0 * 10.0 ** math.ceil(math.log10(weeks)))
    return [float(k * step) for k in range(int(span / step + 1e-9) + 1)]


def _tick(value: float, ticks: Sequence[float]) -> str:
    """Return the label of a tick, with as many decimals as its neighbours require, in at most 8 cells."""
    step = ticks[1] - ticks[0] if len(ticks) > 1 else abs(value) or 1.0
    decimals = max(-math.floor(math.log10(step) + 1e-9), 0)
    text = f"{value + 0.0:.{decimals}f}"
    return text if len(text) <= GUTTER + 1 and decimals < 7 else f"{value:.1e}"


@EXTREME_VALUES
def histogram_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the distribution of the values, with the Gaussian of the same mean and standard deviation."""
    channel = state.channel or ""
    histogram: Histogram | None = state.selected.histogram if state.selected is not None else None
    factor, unit = state.notation.scale(channel)
    name: Line = [(" ", "text"), ("distribution", "title"), (f"  [{unit}]", "muted")]
    title = padded(fitted([name, [("   ━ ", "N"), ("Gaussian", "muted")]], width), width)
    if histogram is None or not histogram.counts:
        return [title, *centred_text(["no distribution yet"], width, height - 1)]
    canvas = Canvas(width, height - 1)
    counts = np.array(histogram.counts, dtype=np.float64)
    start, bin_width = histogram.start * factor, histogram.width * factor
    edges = AxisScale(start, start + bin_width * len(counts))
    top = max(float(counts.max()), max(histogram.gaussian, default=0.0)) * 1.05
    frame = PlotFrame(canvas, (1, 0, max(width - 2, 4), max(height - 2, 2)), edges, AxisScale(0.0, top))
    first = np.arange(frame.width) * len(counts) // frame.width
    until = np.maximum(np.arange(1, frame.width + 1) * len(counts) // frame.width, first + 1)
    heights = np.array([counts[a:b].mean() for a, b in zip(first, until, strict=True)]) / top * frame.height
    heights = np.where(heights > 0, np.maximum(heights, 0.125), np.nan)  # at least an eighth of a cell
    canvas.fill(1, frame.height - heights, np.full(frame.width, float(frame.height)), "bar")
    centres = start + bin_width * (np.arange(len(counts)) + 0.5)
    frame.curve(np.asarray(centres, dtype=np.float64), numbers(histogram.gaussian), "N")
    ticks = edges.ticks(max(width // 14, 2))
    frame.x_labels([(t, _tick(t, ticks)) for t in ticks], canvas.height - 1)
    return [title, *canvas.rows()]


@EXTREME_VALUES
def spectrum_chart(state: ViewState, width: int, height: int) -> list[Line]:
    """Return the amplitude spectral density over frequency, log-log, with its lines marked."""
    channel = state.channel or ""
    spectrum: Spectrum | None = state.selected.spectrum if state.selected is not None else None
    factor, unit = state.notation.scale(channel)
    root = state.notation.unit("sqrt(Hz)")
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
    _decades(frame, state.notation, "[Hz]")
    frame.curve(frequency, density, "signal")
    for line in spectrum.lines:
        near = int(np.argmin(np.abs(frequency - line.frequency_hz)))
        text = line.name or f"{line.frequency_hz:.3g} Hz"
        frame.label(float(frequency[near]), float(density[near]), text, "warn", "◇")
    return [title, *canvas.rows()]
