"""Allan curves of one sensor as SVG: three axes on logarithmic scales, with their limits and models.

Numbers in, text out. Colours come from the page's style sheet (classes ``x``, ``y``, ``z``), so that
the same drawing serves a light page, a dark one and paper; the marks differ in shape too, for those who see
no colours.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from imumon.report import Allan, Report
from imumon.samples import AXES
from imumon.units import READABLE, pretty

WIDTH, HEIGHT = 760.0, 430.0
LEFT, RIGHT, TOP, BOTTOM = 70.0, 16.0, 30.0, 52.0
MARK = 3.6
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True, slots=True)
class FigureScale:
    """Decades from `low` to `high`, drawn from `start` to `end`."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        """Place of a positive value, kept within a little beyond the edges."""
        share = (math.log10(value) - self.low) / (self.high - self.low)
        return self.start + min(max(share, -0.5), 1.5) * (self.end - self.start)

    def decades(self) -> range:
        return range(math.ceil(self.low), math.floor(self.high) + 1)


def curves(made: Report, sensor: str) -> dict[str, Allan]:
    """Curves of a sensor's axes in readable units, those that have points."""
    factor = READABLE[sensor, "B"].factor
    found = {}
    for axis in AXES:
        channel = made.channels.get(f"{sensor}/{axis}")
        if channel is not None and channel.allan is not None and channel.allan.tau_s:
            found[axis] = _scaled(channel.allan, factor)
    return found


def _scaled(curve: Allan, factor: float) -> Allan:
    def times(values: Sequence[float | None]) -> tuple[float | None, ...]:
        return tuple(None if v is None else v * factor for v in values)

    return Allan(
        tau_s=curve.tau_s,
        sigma=tuple(s * factor for s in curve.sigma),
        low=times(curve.low),
        high=times(curve.high),
        edf=curve.edf,
        model=times(curve.model),
        used=curve.used,
    )


def extent(found: dict[str, Allan]) -> tuple[float, float, float, float]:
    """Logarithms of the least and greatest tau and sigma that are worth showing."""
    taus = [tau for curve in found.values() for tau in curve.tau_s]
    sizes = [s for curve in found.values() for s in curve.sigma if s > 0.0]
    # a limit that spans decades, as of the last octave, must not squeeze the curve
    limits = [v for c in found.values() for v in (*c.low, *c.high) if v is not None and v > 0.0]
    least, most = min(sizes), max(sizes)
    least = max(min([least, *limits]), least / 2.0)
    most = min(max([most, *limits]), most * 2.0)
    room = 0.06
    return (
        math.log10(min(taus)) - room,
        math.log10(max(taus)) + room,
        math.log10(least) - room,
        math.log10(most) + room,
    )


def svg(made: Report, sensor: str) -> str:
    """Drawing of a sensor's curves; empty where there are none."""
    found = curves(made, sensor)
    if not found or not any(s > 0.0 for curve in found.values() for s in curve.sigma):
        return ""
    x0, x1, y0, y1 = extent(found)
    x, y = FigureScale(x0, x1, LEFT, WIDTH - RIGHT), FigureScale(y0, y1, HEIGHT - BOTTOM, TOP)
    parts = [
        f'<svg class="allan" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" '
        f'aria-label="Allan deviation of the {sensor}, axes {", ".join(found)}">',
        f'<clipPath id="frame-{sensor}"><rect x="{LEFT:g}" y="{TOP:g}" width="{WIDTH - LEFT - RIGHT:g}" '
        f'height="{HEIGHT - TOP - BOTTOM:g}"/></clipPath>',
        *_grid(x, y),
        f'<g clip-path="url(#frame-{sensor})">',
        *(line for axis, curve in found.items() for line in _curve(axis, curve, x, y)),
        "</g>",
        *_names(sensor),
        *_legend(list(found)),
        "</svg>",
    ]
    return "\n".join(parts)


def power(exponent: int) -> str:
    """Power of ten.

    >>> power(-2), power(0), power(3)
    ('0.01', '1', '1000')
    """
    if -3 <= exponent <= 3:
        return f"{10.0**exponent:g}"
    return f"10{str(exponent).translate(_SUPERSCRIPT)}"


def _grid(x: FigureScale, y: FigureScale) -> Iterator[str]:
    top, bottom, left, right = y.end, y.start, x.start, x.end
    for scale, line in (
        (x, "M{0:.1f} {1:.1f}V{2:.1f}"),
        (y, "M{1:.1f} {0:.1f}H{2:.1f}"),
    ):
        ends = (bottom, top) if scale is x else (left, right)
        fine: list[str] = []
        strong: list[str] = []
        for decade in range(math.floor(scale.low), math.ceil(scale.high) + 1):
            for digit in range(1, 10):
                place = math.log10(digit) + decade
                if scale.low <= place <= scale.high:
                    (strong if digit == 1 else fine).append(line.format(scale(10.0**place), *ends))
        yield f'<path class="fine" d="{"".join(fine)}"/><path class="grid" d="{"".join(strong)}"/>'
    yield (
        f'<rect class="frame" x="{left:g}" y="{top:g}" width="{right - left:g}" height="{bottom - top:g}"/>'
    )
    for value, text in _ticks(x):
        yield f'<text x="{x(value):.1f}" y="{bottom + 17:.1f}" text-anchor="middle">{text}</text>'
    for value, text in _ticks(y):
        yield f'<text x="{left - 7:.1f}" y="{y(value) + 4:.1f}" text-anchor="end">{text}</text>'


def _ticks(scale: FigureScale) -> list[tuple[float, str]]:
    """Labels: decades, and 2 and 5 between them where there are few."""
    decades = [(10.0**d, power(d)) for d in scale.decades()]
    if len(decades) >= 3:
        return decades
    low, high = math.floor(scale.low), math.ceil(scale.high)
    values = [digit * 10.0**d for d in range(low, high + 1) for digit in (1, 2, 5)]
    return [(v, f"{v:g}") for v in values if scale.low <= math.log10(v) <= scale.high]


def _curve(axis: str, curve: Allan, x: FigureScale, y: FigureScale) -> Iterator[str]:
    model = [(t, m) for t, m in zip(curve.tau_s, curve.model, strict=True) if m is not None and m > 0.0]
    if len(model) > 1:
        d = "L".join(f"{x(t):.1f} {y(m):.1f}" for t, m in model)
        yield f'<path class="model {axis}" d="M{d}"/>'
    bars: list[str] = []
    full: list[str] = []
    hollow: list[str] = []
    shift = {"x": -2.2, "y": 0.0, "z": 2.2}[axis]  # bars of three axes must not hide one another
    for tau, sigma, low, high, used in zip(
        curve.tau_s, curve.sigma, curve.low, curve.high, curve.used, strict=True
    ):
        if sigma <= 0.0:
            continue
        at = x(tau) + shift
        if low is not None and high is not None and low > 0.0:
            bars.append(f"M{at:.1f} {y(low):.1f}V{y(high):.1f}")
        (full if used else hollow).append(_mark(axis, at, y(sigma)))
    yield f'<path class="bar {axis}" d="{"".join(bars)}"/>'
    yield f'<path class="mark {axis}" d="{"".join(full)}"/>'
    yield f'<path class="left-out {axis}" d="{"".join(hollow)}"/>'


def _mark(axis: str, x: float, y: float) -> str:
    """Disc for x, square for y, triangle for z."""
    r = MARK
    if axis == "x":
        return f"M{x - r:.1f} {y:.1f}a{r} {r} 0 1 0 {2 * r} 0a{r} {r} 0 1 0 {-2 * r} 0z"
    if axis == "y":
        s = 0.9 * r
        return f"M{x - s:.1f} {y - s:.1f}h{2 * s:.1f}v{2 * s:.1f}h{-2 * s:.1f}z"
    return f"M{x:.1f} {y - 1.2 * r:.1f}l{1.15 * r:.1f} {2 * r:.1f}h{-2.3 * r:.1f}z"


def _names(sensor: str) -> Iterator[str]:
    unit = html.escape(pretty(READABLE[sensor, "B"].unit))
    yield f'<text x="{(LEFT + WIDTH - RIGHT) / 2:.1f}" y="{HEIGHT - 12:.1f}" text-anchor="middle">τ, s</text>'
    middle = (TOP + HEIGHT - BOTTOM) / 2
    yield f'<text transform="translate(16 {middle:.1f}) rotate(-90)" text-anchor="middle">σ(τ), {unit}</text>'


def _legend(axes: list[str]) -> Iterator[str]:
    for k, axis in enumerate(axes):
        at = WIDTH - RIGHT - 44.0 * (len(axes) - k) + 8
        y = TOP - 14.0
        yield f'<path class="model {axis}" d="M{at - 9:.1f} {y:.1f}h18"/>'
        yield f'<path class="mark {axis}" d="{_mark(axis, at, y)}"/>'
        yield f'<text x="{at + 14:.1f}" y="{y + 4:.1f}">{axis}</text>'
