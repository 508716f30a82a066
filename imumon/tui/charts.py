"""Charts: what is drawn of a report, on the canvas of `imumon.tui.braille_canvas`.

The report carries the curves as points; here they only find their place. The three asymptotes of an
Allan deviation are straight lines on a log-log chart: N / sqrt(tau), sqrt(2 ln2 / pi) B and
K sqrt(tau / 3) (IEEE Std 952, annex C), so N reads at tau = 1 s and K at tau = 3 s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.report import Allan, Channel, Histogram, Spectrum, Strip
from imumon.report import Line as SpectralLine
from imumon.samples import sensor_of
from imumon.tui.braille_canvas import AxisScale, Canvas, Floats, PlotFrame, linear, logarithmic
from imumon.tui.formatting import Line, Notation, about, length, padded
from imumon.tui.view_state import ViewState
from imumon.units import number

FLICKER = math.sqrt(2.0 * math.log(2.0) / math.pi)
"""Height of the flat part of an Allan deviation over B."""

GUTTER = 7
"""Cells left of a frame, for its labels."""


def numbers(values: Sequence[float | None], factor: float = 1.0) -> Floats:
    """(n,) values in another unit, NaN for what is not known."""
    return np.array([math.nan if v is None else v * factor for v in values], dtype=np.float64)


def message(text: Sequence[str], width: int, height: int, role: str = "muted") -> list[Line]:
    """Some words in the middle of nothing."""
    top = max((height - len(text)) // 2, 0)
    lines: list[Line] = [[] for _ in range(top)]
    lines += [[(line[:width].center(width), role)] for line in text]
    return [padded(line, width) for line in lines + [[] for _ in range(height)]][:height]


def allan(scene: ViewState, width: int, height: int) -> list[Line]:
    """Allan deviation of the chosen channel, or of the three axes of its sensor."""
    chosen, channel = scene.chosen, scene.channel
    if chosen is None or channel is None:
        return message(["no channel"], width, height)
    if chosen.allan is None or not chosen.allan.tau_s:
        if sensor_of(channel) in ("gyro", "accel", "mag"):
            return message([f"{channel}: the curve begins with the first differences"], width, height)
        return message([f"{channel} has no Allan deviation", "press 2 for its signal"], width, height)
    factor, unit = scene.notation.deviation(channel)
    canvas = Canvas(width, height - 1)
    frame = _allan_frame(scene, canvas, factor)
    _decades(frame, scene.notation)
    names = _limits(frame, scene, channel, factor) if scene.limits else []
    if scene.baseline is not None:
        _background(frame, scene.baseline.channels.get(channel), factor)
    if scene.overlay:
        for name in scene.siblings():
            _axis(frame, scene, name, factor)
    else:
        _curve(frame, scene.notation, chosen, sensor_of(channel), factor)
    for column, row, grade in names:
        canvas.text(column, row, grade, f"grade-{grade}")
    return [_allan_title(scene, channel, unit, width), *canvas.rows()]


def _allan_title(scene: ViewState, channel: str, unit: str, width: int) -> Line:
    """What is drawn, its unit, and the legend as far as there is room."""
    name = sensor_of(channel) if scene.overlay else channel.replace("/", " ")
    title: Line = [(" " * GUTTER, "text"), (name, "title"), (f"  {scene.notation.sigma} [{unit}]", "muted")]
    legend: list[Line] = []
    mark = "o " if scene.notation.ascii else "⠿ "
    if scene.overlay:
        legend = [[("━ ", f"axis-{c[-1]}"), (c[-1], "muted")] for c in scene.siblings()]
    else:
        legend = [
            [(mark, "point"), ("measured", "muted")],
            [("██ ", "bandkey"), ("95 %", "muted")],
            [("━ ", "model"), ("model", "muted")],
        ]
        allan = scene.chosen.allan if scene.chosen is not None else None
        if allan is not None and not all(allan.used):
            legend.append([(mark, "leftout"), ("left out", "muted")])
    if scene.baseline is not None:
        legend.insert(1, [("━ ", "baseline"), (scene.baseline_name, "muted")])
    back: Line = [("   z", "key"), (" back ", "muted")] if scene.zoomed else []
    for item in legend:
        if length(title) + length(item) + 3 <= width - length(back):
            title += [("   ", "text"), *item]
    return [*padded(title, width - length(back)), *back]


def _allan_frame(scene: ViewState, canvas: Canvas, factor: float) -> PlotFrame:
    """Axes that hold every curve to be drawn, in half decades."""
    names = scene.siblings() if scene.overlay else (scene.channel or "",)
    curves = [
        c.allan for name in names if scene.report and (c := scene.report.channels.get(name)) and c.allan
    ]
    tau = np.concatenate([numbers(c.tau_s) for c in curves])
    sigma = np.concatenate([numbers((*c.sigma, *c.model), factor) for c in curves])
    edges = np.concatenate([numbers((*c.low, *c.high), factor) for c in curves])
    # a limit of a thin octave may be decades away: the points decide, the limits get a decade at most
    solid = sigma[np.isfinite(sigma) & (sigma > 0)]
    if len(solid):
        edges = np.clip(edges, solid.min() / 4.0, solid.max() * 4.0)
        lowest = solid.min() / (25.0 if canvas.height >= 16 else 5.0)
        marks = [] if scene.overlay else [m * factor for m in _marks(scene.chosen) if m * factor > lowest]
        sigma = np.concatenate((sigma, edges, marks))
    x = logarithmic(np.concatenate((tau, [1.0, 3.0])))
    bottom = 2 if canvas.height >= 14 else 1
    area = (GUTTER, 0, max(canvas.width - GUTTER - 2, 4), max(canvas.height - bottom, 2))
    return PlotFrame(canvas, area, x, logarithmic(sigma))


def _marks(channel: Channel | None) -> list[float]:
    """Heights at which measured coefficients are marked, SI."""
    parts = () if channel is None else ((channel.N, 1.0), (channel.B, FLICKER), (channel.K, 1.0))
    return [part.value * height for part, height in parts if part is not None and part.value is not None]


def _decades(frame: PlotFrame, notation: Notation) -> None:
    """Grid of decades with their labels, and the unit of time."""
    x, y = frame.x.decades(), frame.y.decades()
    frame.grid([10.0**e for e in x], [10.0**e for e in y])
    labels = [(10.0**e, notation.decade(e)) for e in y]
    if len(y) < 2:
        values = [m * 10.0**e for e in range(math.floor(math.log10(frame.y.low)), 9) for m in (1, 2, 5)]
        labels = [(v, number(v, 1)) for v in values if frame.y.low <= v <= frame.y.high]
    frame.beside(labels)
    row = frame.canvas.height - 1
    unit = f"{notation.tau} [s]"
    frame.canvas.text(frame.canvas.width - len(unit), row, unit, "text")
    room = frame.canvas.width - len(unit) - 1
    ticks = [(10.0**e, notation.decade(e)) for e in x]
    frame.below([t for t in ticks if int(frame.across(np.array([t[0]]))[0]) // 2 + len(t[1]) < room], row)
    if frame.top + frame.height < row:
        frame.canvas.text(frame.left, row - 1, "─" * frame.width, "axis")
        for value, _ in ticks:
            at = frame.across(np.array([value]))[0]
            frame.canvas.text(int(at) // 2, row - 1, "┴", "axis")


def _limits(frame: PlotFrame, scene: ViewState, channel: str, factor: float) -> list[tuple[int, int, str]]:
    """Draw the curve of a sensor that just meets each grade; tell where the grade's name belongs."""
    names = []
    limits = scene.report.limits.get(sensor_of(channel), {}) if scene.report is not None else {}
    tau = np.geomspace(frame.x.low, frame.x.high, 64)
    for grade, white in limits.get("N", {}).items():
        flat = FLICKER * limits.get("B", {}).get(grade, 0.0)
        sigma: Floats = np.asarray(np.hypot(white / np.sqrt(tau), flat) * factor, dtype=np.float64)
        frame.curve(tau, sigma, "limit", (1, 3))
        seen = np.flatnonzero((sigma > frame.y.low) & (sigma < frame.y.high))
        if len(seen):
            at = frame.cell(float(tau[seen[-1]]), float(sigma[seen[-1]]))
            if at is not None:
                column = min(at[0], frame.left + frame.width) - len(grade)
                names.append((column, max(at[1] - 1, 0), grade))
    return names


def _background(frame: PlotFrame, channel: Channel | None, factor: float) -> None:
    """Curve of a saved report behind the live one."""
    if channel is not None and channel.allan is not None:
        frame.curve(numbers(channel.allan.tau_s), numbers(channel.allan.sigma, factor), "baseline")


def _axis(frame: PlotFrame, scene: ViewState, name: str, factor: float) -> None:
    """Curve of one axis among others."""
    channel = scene.report.channels.get(name) if scene.report is not None else None
    if channel is None or channel.allan is None or not channel.allan.tau_s:
        return
    tau, sigma = numbers(channel.allan.tau_s), numbers(channel.allan.sigma, factor)
    frame.curve(tau, sigma, f"axis-{name[-1]}")
    frame.points(tau, sigma, f"axis-{name[-1]}")
    at = frame.cell(float(tau[-1]), float(sigma[-1]))
    if at is not None:
        frame.canvas.text(min(at[0] + 1, frame.canvas.width - 1), at[1], name[-1], f"axis-{name[-1]}")


def _curve(frame: PlotFrame, notation: Notation, channel: Channel, sensor: str, factor: float) -> None:
    """Measured points with their band, the model, and what is measured of N, B, K."""
    allan = channel.allan or Allan()
    tau, sigma = numbers(allan.tau_s), numbers(allan.sigma, factor)
    frame.band(tau, numbers(allan.low, factor), numbers(allan.high, factor), "band")
    ends = np.array([frame.x.low, frame.x.high])
    lines = (
        ("N", channel.N, ends**-0.5, 1.0, 1.0),
        ("B", channel.B, FLICKER * ends**0.0, _lowest(allan), FLICKER),
        ("K", channel.K, np.sqrt(ends / 3.0), 3.0, 1.0),
    )
    for name, part, slope, _, _ in lines:
        if part is not None and part.value is not None:
            frame.curve(ends, slope * part.value * factor, name, (3, 3))
    frame.curve(tau, numbers(allan.model, factor), "model")
    used = np.array(allan.used, dtype=np.bool_) if allan.used else np.ones(len(tau), dtype=np.bool_)
    letter = "o" if notation.ascii else None
    frame.points(tau[used], sigma[used], "point", letter)
    frame.points(tau[~used], sigma[~used], "leftout", letter)
    for name, part, _, at, height in lines:
        if part is None or part.value is None:
            continue
        value = notation.limits(part)[0]
        text = name
        if frame.width >= 48 and value is not None:
            unit = notation.coefficient_unit(sensor, name)
            text += f" {number(value, 3)}{f' {unit}' if name != 'B' else ''}"  # the axis is in the unit of B
        frame.label(at, part.value * height * factor, text, name)


def _lowest(allan: Allan) -> float:
    """Time at which the model is lowest, s: where B is read."""
    known = [(m, t) for m, t in zip(allan.model, allan.tau_s, strict=False) if m is not None]
    return min(known)[1] if known else 1.0


def strip(scene: ViewState, width: int, height: int) -> list[Line]:
    """Least and greatest value of the chosen channel over time."""
    channel = scene.channel or ""
    factor, unit = scene.notation.scale(channel)
    found: Strip | None = getattr(scene.signal, scene.window) if scene.signal is not None else None
    title: Line = [(" " * GUTTER, "text"), (channel.replace("/", " "), "title"), (f"  [{unit}]   ", "muted")]
    for name in ("minute", "hour", "everything"):
        title.append((f" {name} ", "tab" if name == scene.window else "muted"))
    title = padded(title, width)
    if found is None or not any(v is not None for v in found.low):
        return [
            title,
            *message(["no signal yet" if scene.signal else "waiting for the signal"], width, height - 1),
        ]
    low, high = numbers(found.low, factor), numbers(found.high, factor)
    canvas = Canvas(width, height - 1)
    span = found.column_s * len(low)
    y = linear(np.concatenate((low, high)))
    area = (GUTTER + 2, 0, max(width - GUTTER - 4, 4), max(height - 2, 2))
    frame = PlotFrame(canvas, area, AxisScale(-span, 0.0), y)
    ticks = y.ticks(max(frame.height // 2, 2))
    times = _times(span)
    frame.grid([-t for t in times], ticks)
    frame.beside([(t, _tick(t, ticks)) for t in ticks])
    frame.below(
        [
            (-t, "now" if t == 0 and scene.situation().live else "end" if t == 0 else f"−{about(t)}")
            for t in reversed(times)
        ],
        canvas.height - 1,
    )
    top, bottom = _extremes(low, high, 2 * frame.width)
    frame.columns(bottom, top, "signal")
    return [title, *canvas.rows()]


def _extremes(low: Floats, high: Floats, count: int) -> tuple[Floats, Floats]:
    """Greatest of `high` and least of `low` in each of so many equal columns; NaN where nothing came.

    Parameters
    ----------
    low, high : (n,) any unit, NaN where nothing came.

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
    """Round times back from now, s, about five of them."""
    steps = (
        1,
        2,
        5,
        10,
        15,
        30,
        60,
        120,
        300,
        600,
        900,
        1800,
        3600,
        7200,
        14400,
        21600,
        43200,
        86400,
        172800,
    )
    step = next((s for s in steps if span / s <= 6.0), 604800)
    return [float(k * step) for k in range(int(span / step + 1e-9) + 1)]


def _tick(value: float, ticks: Sequence[float]) -> str:
    """Label of a tick with as many decimals as tell it from its neighbours, eight cells at most."""
    step = ticks[1] - ticks[0] if len(ticks) > 1 else abs(value) or 1.0
    decimals = max(-math.floor(math.log10(step) + 1e-9), 0)
    text = f"{value + 0.0:.{decimals}f}"
    return text if len(text) <= GUTTER + 1 and decimals < 7 else f"{value:.1e}"


def histogram(scene: ViewState, width: int, height: int) -> list[Line]:
    """Distribution of the values, with the Gaussian of the same mean and deviation over it."""
    channel = scene.channel or ""
    found: Histogram | None = scene.chosen.histogram if scene.chosen is not None else None
    factor, unit = scene.notation.scale(channel)
    title = padded(
        [
            (" ", "text"),
            ("distribution", "title"),
            (f"  [{unit}]", "muted"),
            ("   ━ ", "N"),
            ("Gaussian", "muted"),
        ],
        width,
    )
    if found is None or not found.counts:
        return [title, *message(["no distribution yet"], width, height - 1)]
    canvas = Canvas(width, height - 1)
    counts = np.array(found.counts, dtype=np.float64)
    start, bin_width = found.start * factor, found.width * factor
    edges = AxisScale(start, start + bin_width * len(counts))
    top = max(float(counts.max()), max(found.gaussian, default=0.0)) * 1.05
    frame = PlotFrame(canvas, (1, 0, max(width - 2, 4), max(height - 2, 2)), edges, AxisScale(0.0, top))
    which = np.minimum(np.arange(frame.width) * len(counts) // frame.width, len(counts) - 1)
    until = np.maximum(
        np.minimum((np.arange(frame.width) + 1) * len(counts) // frame.width, len(counts)), which + 1
    )
    mean = np.array([counts[a:b].mean() for a, b in zip(which, until, strict=True)])
    canvas.bars(1, frame.height - 1, mean / top * frame.height, "bar")
    centres = start + bin_width * (np.arange(len(counts)) + 0.5)
    frame.curve(np.asarray(centres, dtype=np.float64), numbers(found.gaussian), "N")
    ticks = edges.ticks(max(width // 14, 2))
    frame.below([(t, _tick(t, ticks)) for t in ticks], canvas.height - 1)
    return [title, *canvas.rows()]


def spectrum(scene: ViewState, width: int, height: int) -> list[Line]:
    """Root of the spectral density over frequency, log-log, with its lines marked."""
    channel = scene.channel or ""
    found: Spectrum | None = scene.chosen.spectrum if scene.chosen is not None else None
    factor, unit = scene.notation.scale(channel)
    root = scene.notation.unit("sqrt(Hz)")
    title = padded([(" " * GUTTER, "text"), ("spectrum", "title"), (f"  [{unit}/{root}]", "muted")], width)
    if found is None or not any(f > 0 for f in found.frequency_hz):
        return [title, *message(["no spectrum yet"], width, height - 1)]
    frequency = numbers(found.frequency_hz)
    density: Floats = np.asarray(np.sqrt(numbers(found.density)) * factor, dtype=np.float64)
    good = (frequency > 0) & (density > 0)
    frequency, density = frequency[good], density[good]
    canvas = Canvas(width, height - 1)
    x = AxisScale(float(frequency.min()), float(frequency.max()) * 1.02, log=True)
    frame = PlotFrame(
        canvas, (GUTTER, 0, max(width - GUTTER - 1, 4), max(height - 2, 2)), x, logarithmic(density)
    )
    decades = x.decades()
    frame.grid([10.0**e for e in decades], [10.0**e for e in frame.y.decades()])
    frame.beside([(10.0**e, scene.notation.decade(e)) for e in frame.y.decades()])
    row = canvas.height - 1
    canvas.text(canvas.width - 4, row, "[Hz]", "text")
    ticks = [(10.0**e, scene.notation.decade(e)) for e in decades]
    frame.below(
        [t for t in ticks if int(frame.across(np.array([t[0]]))[0]) // 2 + len(t[1]) < canvas.width - 5], row
    )
    frame.curve(frequency, density, "signal")
    for line in found.lines:
        _spectral_line(frame, line, frequency, density)
    return [title, *canvas.rows()]


def _spectral_line(frame: PlotFrame, line: SpectralLine, frequency: Floats, density: Floats) -> None:
    """Mark on a line of the spectrum, with its frequency or its name."""
    near = int(np.argmin(np.abs(frequency - line.frequency_hz)))
    frame.label(
        float(frequency[near]), float(density[near]), line.name or f"{line.frequency_hz:.3g} Hz", "warn", "◇"
    )
