"""Regressors of the block means: what moves the mean of a channel and is not noise.

The block means of a segment are regressed on series x_i(t), and the cosine coefficients of the means on the cosine
transforms of these:

| regressor | x(t) | because |
|---|---|---|
| drift | t, of each segment | the constant is removed by the transform; a ramp is the longest "noise" of all |
| temperature | T(t) less its mean | the first effect of the room on a sensor |
| its square, its cube | T^2, T^3 | a bend of this effect |
| settling | exp(-t / tau), and its derivative by tau | a warm-up; with the derivative tau is free to first order |
| step | 0 before its place, 1 after it, between in its block | a knock, a range that changes |
| oscillation | cos, sin, and both times t | an air conditioner of few cycles; with t, its size or period may change |

All regressors have norm one in the cosine coefficients. Which of them count is decided in `search`.

Example: the drift of a segment of four blocks, as its cosine coefficients see it. Even coefficients of a straight line
vanish.

>>> _line(4)[1].round(3).ravel()
array([-2.23 ,  0.   , -0.159])
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from imumon.model.samples import Floats, Ints
from imumon.noise.fit.likelihood import Surface
from imumon.noise.fit.model import combined
from imumon.noise.fit.normal_equations import inverse_and_log, normal_matrix
from imumon.noise.fit.observations import LEAST_BLOCKS, BlockSeries, Cosines
from imumon.noise.validity_groups import ROUNDING

COLLINEAR = 0.95
"""A temperature slope is stated where its estimate is less correlated with that of the drift. Unit: correlation.

Otherwise: slope and drift are two large numbers of opposite sign that say nothing each. Origin: 0.95: the error of
the slope is three times as large as without the drift.
"""

SINGLE = 48
"""This many lowest cosine coefficients stay single; regressors act on them, the others are pooled in bands. Unit:
coefficients.

Otherwise: with fewer, a settling or a step leaves power in the bands, which B and K take; with more, fits are slow.
Origin: the spectrum of a smooth regressor falls with the square of the number: 1/48^2 is below the noise of a band.
"""
SETTLING_TIMES = (0.008, 0.015, 0.03, 0.05, 0.08, 0.13, 0.2, 0.32, 0.5)
"""Time constants of an exponential that are tried. Unit: of the segment.

Otherwise: a settling between two of them leaves power in the lowest coefficients. Origin: the derivative by the time
constant is a regressor, too: neighbours a factor of 1.6 to 2 apart cover what lies between (`real_effects.py --only
warm-up`).
"""
COEFFICIENTS_PER_REGRESSOR = 6
"""Single coefficients of a segment that its drift, or an exponential, needs. Unit: coefficients.

Otherwise: a record of many short segments spends all coefficients on drifts and has none for the noise. Origin: one
in six: limits grow by 10 % (`real_effects.py`).
"""
STEP_WIDTHS = (1, 4, 16)
"""Widths before and after a place whose means are compared for a step. Unit: blocks.

Otherwise: with single blocks a small step of a long segment is not among the candidates. Chosen: powers of four
(`real_effects.py`).
"""

LEAST_SPAN_DEGC = 0.3
"""The temperature is a regressor from this range on. Unit: degC.

Otherwise: the noise of a thermometer with a step of 0.1 degC is a regressor that takes power from K. Chosen: three
steps of a thermometer that reports tenths of a degree.
"""

CHI_SQUARE_MEDIAN = 0.455
"""Median of a chi-square variable of one degree of freedom, over its mean."""
OSCILLATION = ("oscillation", "oscillation_sine", "oscillation_growth", "oscillation_sine_growth")
"""Regressors of an oscillation: two phases, and the same growing in time."""
BENT = ("temperature_2", "temperature_3")
"""Regressors of the effect of a temperature beside a straight line."""


@dataclass(frozen=True, slots=True, eq=False)
class Regressor:
    """One regressor.

    Attributes
    ----------
    name : ``drift``, ``temperature``, ``temperature_2``, ``temperature_3``, ``settling``, ``settling_time``,
        ``step`` or one of `OSCILLATION`.
    series : (n,) value at each block.
    cosines : (m,) its coefficients, of norm one.
    scale : norm one over that of the coefficients of the values.
    place : blocks: of a step its place, of a settling its time constant, of an oscillation its period; 0.0 else.
    """

    name: str
    series: Floats
    cosines: Floats
    scale: float
    place: float = 0.0


def scaled(
    names: Sequence[str], lines: Floats, cosines: Floats, places: Floats | None = None
) -> list[Regressor]:
    """Return regressors of values `lines` (n, t) at each block, with their coefficients `cosines` (m, t)."""
    # norm one, so that a normal matrix of a drift in 10^-9 per block and of a temperature can be inverted
    scale = 1.0 / np.maximum(np.sqrt((cosines**2).sum(axis=0)), 1e-300)
    places = np.zeros(len(names)) if places is None else places
    rows = zip(names, lines.T, (cosines * scale).T, scale.tolist(), places.tolist(), strict=True)
    return [Regressor(*row) for row in rows]


def of_series(series: BlockSeries, name: str, values: Floats) -> Regressor:
    """Return the regressor of values (n,) at each block."""
    return scaled([name], values[:, None], series.transform(values[:, None]))[0]


def matrix(series: BlockSeries, used: Sequence[Regressor]) -> Floats:
    """Return (m, q) the coefficients of regressors."""
    return np.array([regressor.cosines for regressor in used]).reshape(-1, series.y.size).T


def _within(
    series: BlockSeries, segment: int, names: Sequence[str], lines: Floats, cosines: Floats, places: Floats
) -> list[Regressor]:
    """Return regressors of values (count, t) and coefficients (count - 1, t) in a segment, zero outside of it."""
    begin, count = int(series.begin[segment]), int(series.count[segment])
    values, coefficients = np.zeros((series.series.size, len(names))), np.zeros((series.y.size, len(names)))
    values[begin : begin + count] = lines
    coefficients[begin - segment : begin - segment + count - 1] = cosines
    return scaled(names, values, coefficients, places)


def _transform(lines: Floats) -> Floats:
    """Return (count - 1, t) the coefficients of values (count, t) in a segment, without that of the constant."""
    import scipy.fft

    return np.asarray(scipy.fft.dct(lines, axis=0, norm="ortho")[1:])


def drifts(series: BlockSeries) -> list[Regressor]:
    """Return a straight drift of each segment that is long enough, per block."""
    out = []
    for segment in _held(series, 1).tolist():
        out += _within(series, segment, ["drift"], *_line(int(series.count[segment])), np.zeros(1))
    return out


@lru_cache(maxsize=4)  # the channels of a record have the same
def _line(count: int) -> tuple[Floats, Floats]:
    line = np.arange(count, dtype=np.float64)[:, None] - 0.5 * (count - 1)
    return line, _transform(line)


def temperature(series: BlockSeries) -> tuple[Regressor | None, str]:
    """Return the temperature as a regressor, degC, or why it is none."""
    degrees = series.degrees
    if degrees is None:
        return None, "no_temperature"
    known = np.isfinite(degrees)
    # A thermometer that was present for half of the record says nothing of the other half. The reason says so, too:
    # what is known of the temperature has too small a range.
    if known.sum() < 0.5 * degrees.size or np.ptp(degrees[known]) < LEAST_SPAN_DEGC:
        return None, "small_range"
    blocks = np.arange(degrees.size)
    degrees = np.interp(blocks, blocks[known], degrees[known])
    degrees = degrees - degrees.mean()
    # a temperature that is a straight line in time cannot be distinguished from the drift: only its bend counts
    bend = degrees.copy()
    for begin, count in zip(series.begin, series.count, strict=True):
        part = slice(begin, begin + count)
        bend[part] -= np.polyval(np.polyfit(blocks[part], degrees[part], 1), blocks[part])
    # second differences of a slow temperature are its noise, with 1 + 4 + 1 times the variance of a value; their
    # median, because a warm-up moves the first ones
    squares = np.diff(bend, 2) ** 2
    # a coarse thermometer repeats its value: then the median is zero, and its steps are the noise
    noise = float(np.sqrt((np.median(squares) / CHI_SQUARE_MEDIAN or squares.mean()) / 6.0))
    slow = np.convolve(bend, np.full(4, 0.25), mode="valid")
    # The mean of four has half of the noise. At three times that, errors in variables bias the slope by 10 %.
    if np.std(slow) <= 1.5 * noise:
        return None, "collinear"
    return of_series(series, "temperature", _without_noise(series, degrees, noise)), ""


def _without_noise(series: BlockSeries, degrees: Floats, noise: float) -> Floats:
    """Return (n,) a temperature without the noise of its thermometer.

    A regressor with noise of its own carries this noise, times its slope, into the model and into what is left for the
    bands (errors in variables: Fuller 1987). A temperature changes slowly, the noise of a thermometer is white: so its
    cosine coefficients are weighted by the share of their power that is not noise (Wiener), in bands of half an octave,
    and from the first band on that does not exceed the noise nothing is kept.

    Parameters
    ----------
    noise : degC, standard deviation of a value.
    """
    import scipy.fft

    out = degrees.copy()
    for begin, count in zip(series.begin.tolist(), series.count.tolist(), strict=True):
        part = slice(begin, begin + count)
        # without the straight line through its ends: its coefficients fall slowly, and none would be below the noise
        line = np.linspace(degrees[part][:4].mean(), degrees[part][-4:].mean(), count)
        cosines = scipy.fft.dct(degrees[part] - line, norm="ortho")
        octave = np.floor(2.0 * np.log2(np.arange(1, count))).astype(np.int64)
        starts = np.flatnonzero(np.diff(octave, prepend=-1))
        sizes = np.diff(starts, append=octave.size)
        power = np.add.reduceat(cosines[1:] ** 2, starts) / sizes
        above = power > noise**2 * (1.0 + 3.0 * np.sqrt(2.0 / sizes))  # by three standard deviations
        gain = np.where(np.logical_and.accumulate(above), 1.0 - noise**2 / np.maximum(power, 1e-300), 0.0)
        cosines[1:] *= np.repeat(gain, sizes)
        out[part] = line + scipy.fft.idct(cosines, norm="ortho")
    return out


def bends(series: BlockSeries, heat: Regressor) -> list[Regressor]:
    """Return what a straight line leaves of the effect of a temperature: its square and its cube."""
    return [of_series(series, name, heat.series**power) for name, power in zip(BENT, (2, 3), strict=True)]


def unit_span(degrees: Floats) -> Floats:
    """Return (n,) a temperature as -1 at the lowest to 1 at the highest."""
    return np.asarray(2.0 * (degrees - degrees.min()) / np.ptp(degrees) - 1.0)


def settlings(series: BlockSeries) -> list[list[Regressor]]:
    """Return exponentials from the beginning of the last long segment on, with derivatives by the time constant."""
    # a sensor warms up after each start: the last segment that is long enough, not the first
    segment = int(_held(series, COEFFICIENTS_PER_REGRESSOR)[-1])
    count = int(series.count[segment])
    names = ("settling", "settling_time") * len(SETTLING_TIMES)
    falls = _within(series, segment, names, *_falls(count), np.repeat(SETTLING_TIMES, 2) * count)
    return [list(pair) for pair in zip(falls[::2], falls[1::2], strict=True)]


@lru_cache(maxsize=1)
def _falls(count: int) -> tuple[Floats, Floats]:
    falls = np.exp(-np.multiply.outer(np.arange(count) + 0.5, 1.0 / (np.array(SETTLING_TIMES) * count)))
    lines = np.stack((falls, -falls * np.log(falls)), axis=2).reshape(count, -1)
    return lines, _transform(lines)


def waves(series: BlockSeries, numbers: Floats) -> Floats:
    """Return (m, 2 t) a cosine and a sine in the last segment, at the frequencies of coefficients (t,)."""
    count = int(series.count[-1])
    out = np.zeros((series.y.size, 2 * numbers.size))
    out[1 - count :] = _waves(count, numbers.tobytes())
    return out


@lru_cache(maxsize=2)  # the search asks for the same frequencies in each round, and for each channel
def _waves(count: int, numbers: bytes) -> Floats:
    angles = np.multiply.outer(np.arange(count) + 0.5, np.pi * np.frombuffer(numbers) / count)
    pairs = np.stack((np.cos(angles), np.sin(angles)), axis=2).reshape(count, -1)
    return _transform(pairs)


def oscillation(series: BlockSeries, number: float) -> list[Regressor]:
    """Return an oscillation in the last segment: two phases, and the same growing in time.

    Parameters
    ----------
    number : of the cosine coefficient with its frequency; not an integer in general.
    """
    count = int(series.count[-1])
    middles = np.arange(count) + 0.5
    angle = np.pi * number / count
    pair = np.stack((np.cos(angle * middles), np.sin(angle * middles)), axis=1)
    # the growth describes, to first order, an amplitude or a period that changes over the segment
    lines = np.concatenate((pair, pair * (middles / count - 0.5)[:, None]), axis=1)
    periods = np.full(len(OSCILLATION), 2.0 * count / number)
    return _within(series, len(series.count) - 1, OSCILLATION, lines, _transform(lines), periods)


def _held(series: BlockSeries, least: int) -> Ints:
    """Return the numbers of the segments with at least `least` single coefficients, or of the longest one.

    No more than leave some coefficients for the noise: the longest ones.
    """
    single = max(1, min(SINGLE, series.y.size // 3))
    # a short segment has its first coefficients at frequencies that are pooled: a drift there would act on nothing
    last = 0.5 * least / (series.count * series.length)
    held = np.flatnonzero((last <= series.f[series.order[single - 1]] * (1.0 + 1e-9)) & (series.count > 1))
    longest = np.argsort(-series.count[held], kind="stable")[: max(1, single // COEFFICIENTS_PER_REGRESSOR)]
    return np.sort(held[longest]) if held.size else np.array([int(series.count.argmax())])


def likely_steps(series: BlockSeries) -> list[Regressor]:
    """Return steps where the means before and after a place differ most, over several widths.

    The value at the place itself has the share of the step that it shows.
    """
    out, margin = [], LEAST_BLOCKS // 2
    near = margin - 2  # blocks beside the place from which its height is estimated
    for segment, (begin, count) in enumerate(zip(series.begin.tolist(), series.count.tolist(), strict=True)):
        means = series.series[begin : begin + count]
        sums = np.concatenate(([0.0], np.cumsum(means)))
        candidates: set[int] = set()
        for width in STEP_WIDTHS:
            if count >= 2 * max(width, margin):
                jumps = np.abs(sums[2 * width :] - 2.0 * sums[width:-width] + sums[: -2 * width])
                # two candidates: with one, an outlying block would hide the step
                ends = np.argsort(-jumps)[:2] + width
                ends = ends[(ends >= margin) & (ends <= count - margin)]
                # the step is within the block before or after the place where the means differ most
                candidates |= {*ends.tolist(), *(ends - 1).tolist()}
        if candidates:
            places = np.array(sorted(candidates))
            before = (sums[places] - sums[places - near]) / near
            height = (sums[places + near + 1] - sums[places + 1]) / near - before
            share = np.divide(means[places] - before, height, out=np.ones(places.size), where=height != 0.0)
            lines = (np.arange(count)[:, None] > places).astype(np.float64)
            lines[places, np.arange(places.size)] = np.clip(share, 0.0, 1.0)
            names = ["step"] * places.size
            begins = (begin + places).astype(np.float64)
            out += _within(series, segment, names, lines, _transform(lines), begins)
    return out


def gains(cosines: Cosines, surface: Surface, more: Floats, starts: Ints) -> Floats:
    """Return (s,) twice the gain in log likelihood by some more regressors, with the best B and K for each.

    Of the single coefficients alone: the powers would hold what the regressors explain as noise. Adding regressors Z to
    the regression on X changes the restricted likelihood by what Z explains beside X; ln |X'V^-1 X| is left as it is,
    because the regressors of Z are nearly orthogonal to X, and the same for all candidates.

    Parameters
    ----------
    surface : on a grid that reaches to B = K = 0.
    more : (n, t) regressors at the coefficients.
    starts : (s,) first regressor of each candidate; the regressors of one are nearly orthogonal, so that their gains
        add up.
    """
    y, X = cosines.y, cosines.X
    w = 1.0 / combined(surface.noise_powers, cosines.variances)
    (n, q), t = X.shape, more.shape[1]
    inverse, log_information = inverse_and_log(normal_matrix(w, X))
    Xy = (X.T * y) @ w
    beta = (inverse * Xy).sum(axis=1)
    log = -0.5 * (y**2 @ w - np.log(w).sum(axis=0) - (beta * Xy).sum(axis=0) + log_information)
    cross = ((X[:, :, None] * more[:, None, :]).reshape(n, q * t).T @ w).reshape(q, t, -1)
    with_self = (more**2).T @ w
    # a regressor that X explains already has nothing of its own left: rounding must not make a gain of it
    least = ROUNDING * with_self + 1e-300
    with_y = (more.T * y) @ w - (cross * beta[:, None]).sum(axis=0)
    with_self -= (cross * np.einsum("qrm,rtm->qtm", inverse, cross)).sum(axis=0)
    gain = np.add.reduceat(with_y**2 / np.maximum(with_self, least), starts, axis=0)
    return np.asarray((2.0 * log + gain).max(axis=1) - 2.0 * log.max())
