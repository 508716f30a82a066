"""Regressors of the block means: what moves the mean of a channel and is not noise.

Each segment has a straight drift of its own, and its constant is removed by the cosine transform. A temperature, an
exponential with its derivative by the time constant (so that to first order the time constant is free), a step, and an
oscillation of few cycles are further columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from imumon.noise.fit.likelihood import Surface, normal_matrix
from imumon.noise.fit.observations import LEAST_BLOCKS, SINGLE, BlockSeries, Coefficients
from imumon.samples import Floats, Ints

OSCILLATION = ("oscillation", "oscillation_sine", "oscillation_growth", "oscillation_sine_growth")
"""Columns of an oscillation: two phases, and the same growing in time."""
BENT = ("temperature_2", "temperature_3", "hysteresis")
"""Columns of the effect of a temperature beside a straight line."""
LEAST_SPAN_DEGC = 0.3
"""degC, least range of the temperature from which its effect is estimated."""
TEMPERATURE_SNR = 3.0
"""Least ratio of the deviation of the temperature from a straight line to its own noise."""
COLLINEAR = 0.95
"""Correlation of the estimates of drift and temperature slope from which they count as not separable."""
SETTLING_SHARES = np.array([0.008, 0.015, 0.03, 0.05, 0.08, 0.13, 0.2, 0.32, 0.5])
"""Time constants of an exponential, as shares of the segment in which it is sought."""
COEFFICIENTS_PER_COLUMN = 6
"""Single coefficients of a segment that its drift needs, and that an exponential needs."""
BOTH_WAYS = 0.15
"""Share of the span that the temperature moves back before the direction has changed: less is noise. Also the share of
the span, and of the blocks, that each direction has at least where hysteresis can be seen."""
STEP_WIDTHS, STEP_PLACES = (1, 4, 16), 2
"""Blocks before and after a place whose means are compared, and places that are tried for each."""


@dataclass(frozen=True, slots=True, eq=False)
class Regressor:
    """One column.

    Attributes
    ----------
    name : ``drift``, ``temperature``, ``temperature_2``, ``temperature_3``, ``hysteresis``, ``settling``,
        ``settling_time``, ``step`` or one of `OSCILLATION`.
    series : (n,) value at each block.
    column : (m,) its coefficients, of norm one.
    scale : norm one over that of the coefficients of the values.
    at : blocks, its place, time constant or period; 0.0 where it has none.
    """

    name: str
    series: Floats
    column: Floats
    scale: float
    at: float = 0.0


def regressors(
    names: Sequence[str], lines: Floats, columns: Floats, at: Floats | None = None
) -> list[Regressor]:
    """Return regressors of values (n, t) at each block, and their coefficients (m, t)."""
    scale = 1.0 / np.maximum(np.sqrt((columns**2).sum(axis=0)), 1e-300)
    places = np.zeros(len(names)) if at is None else at
    each = zip(names, lines.T, (columns * scale).T, scale.tolist(), places.tolist(), strict=True)
    return [Regressor(*values) for values in each]


def of_series(series: BlockSeries, name: str, values: Floats) -> Regressor:
    """Return the regressor of values (n,) at each block."""
    return regressors([name], values[:, None], series.transform(values[:, None]))[0]


def matrix(series: BlockSeries, columns: Sequence[Regressor]) -> Floats:
    """Return (m, q) the columns of regressors."""
    return np.array([each.column for each in columns]).reshape(-1, series.y.size).T


def _within(
    series: BlockSeries, segment: int, names: Sequence[str], lines: Floats, columns: Floats, at: Floats
) -> list[Regressor]:
    """Return regressors of values (count, t) and coefficients (count - 1, t) in a segment, zero outside of it."""
    begin, count = int(series.begin[segment]), int(series.count[segment])
    values, coefficients = np.zeros((series.series.size, len(names))), np.zeros((series.y.size, len(names)))
    values[begin : begin + count] = lines
    coefficients[begin - segment : begin - segment + count - 1] = columns
    return regressors(names, values, coefficients, at)


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
    own = series.degrees
    if own is None:
        return None, "no_temperature"
    known = np.isfinite(own)
    if known.sum() < 0.5 * own.size or np.ptp(own[known]) < LEAST_SPAN_DEGC:
        return None, "small_range"
    at = np.arange(own.size)
    own = np.interp(at, at[known], own[known])
    own = own - own.mean()
    bend = own.copy()
    for begin, count in zip(series.begin, series.count, strict=True):
        part = slice(begin, begin + count)
        bend[part] -= np.polyval(np.polyfit(at[part], own[part], 1), at[part])
    noise = np.sqrt(np.mean(np.diff(bend, 2) ** 2) / 6.0)
    slow = np.convolve(bend, np.full(4, 0.25), mode="valid")
    if np.std(slow) <= TEMPERATURE_SNR * noise / 2.0:
        return None, "collinear"
    return of_series(series, "temperature", own), ""


def bends(series: BlockSeries, heat: Regressor) -> list[Regressor]:
    """Return what a straight line leaves of the effect of a temperature: its square, its cube, and hysteresis."""
    loop = hysteresis(series, heat.series)
    powers = [of_series(series, name, heat.series**power) for name, power in zip(BENT, (2, 3), strict=False)]
    return powers if loop is None else [*powers, loop]


def hysteresis(series: BlockSeries, degrees: Floats) -> Regressor | None:
    """Return half the difference between the directions of a temperature (n,), none at the ends of its span.

    None where it does not both rise and fall.
    """
    way = _direction(degrees)
    if way is None:
        return None
    return of_series(series, BENT[-1], way * (1.0 - unit_span(degrees) ** 2))


def unit_span(degrees: Floats) -> Floats:
    """Return (n,) a temperature as -1 at the lowest to 1 at the highest."""
    return np.asarray(2.0 * (degrees - degrees.min()) / np.ptp(degrees) - 1.0)


def _direction(degrees: Floats) -> Floats | None:
    """Return (n,) +0.5 while the temperature (n,) rises and -0.5 while it falls; None where not both occur enough.

    The direction changes at an extreme from which the temperature has come back by a share of the span.
    """
    span = float(np.ptp(degrees))
    turns, extreme, rising = [0], 0, None
    for i, value in enumerate(degrees.tolist()):
        ahead = value - degrees[extreme]
        if rising is None:
            rising = None if abs(value - degrees[0]) < BOTH_WAYS * span else value > degrees[0]
            extreme = i
        elif (ahead > 0.0) == rising:
            extreme = i
        elif abs(ahead) > BOTH_WAYS * span:
            turns.append(extreme)
            extreme, rising = i, not rising
    if rising is None or len(turns) == 1:
        return None
    first = rising if len(turns) % 2 else not rising
    out = np.empty(degrees.size)
    for number, (begin, end) in enumerate(pairwise([*turns, degrees.size])):
        out[begin:end] = 0.5 if first == (number % 2 == 0) else -0.5
    for side in (out > 0.0, out < 0.0):
        if side.mean() < BOTH_WAYS or np.ptp(degrees[side]) < BOTH_WAYS * span:
            return None
    return out


def settlings(series: BlockSeries) -> list[list[Regressor]]:
    """Return exponentials from the beginning of the last long segment on, with derivatives by the time constant."""
    segment = int(_held(series, COEFFICIENTS_PER_COLUMN)[-1])
    count = int(series.count[segment])
    names = ("settling", "settling_time") * SETTLING_SHARES.size
    made = _within(series, segment, names, *_falls(count), np.repeat(SETTLING_SHARES * count, 2))
    return [list(pair) for pair in zip(made[::2], made[1::2], strict=True)]


@lru_cache(maxsize=4)
def _falls(count: int) -> tuple[Floats, Floats]:
    falls = np.exp(-np.multiply.outer(np.arange(count) + 0.5, 1.0 / (SETTLING_SHARES * count)))
    lines = np.stack((falls, -falls * np.log(falls)), axis=2).reshape(count, -1)
    return lines, _transform(lines)


def waves(series: BlockSeries, numbers: Floats) -> Floats:
    """Return (m, 2 t) a cosine and a sine in the last segment, at the frequencies of coefficients (t,)."""
    count = int(series.count[-1])
    out = np.zeros((series.y.size, 2 * numbers.size))
    out[1 - count :] = _waves(count, numbers.tobytes())
    return out


@lru_cache(maxsize=2)
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
    at = np.arange(count) + 0.5
    angle = np.pi * number / count
    pair = np.stack((np.cos(angle * at), np.sin(angle * at)), axis=1)
    lines = np.concatenate((pair, pair * (at / count - 0.5)[:, None]), axis=1)
    periods = np.full(len(OSCILLATION), 2.0 * count / number)
    return _within(series, len(series.count) - 1, OSCILLATION, lines, _transform(lines), periods)


def _held(series: BlockSeries, least: int) -> Ints:
    """Return the numbers of the segments with at least `least` single coefficients, or of the longest one.

    No more than leave some coefficients for the noise: the longest ones.
    """
    single = max(1, min(SINGLE, series.y.size // 3))
    last = 0.5 * least / (series.count * series.length)
    held = np.flatnonzero((last <= series.f[series.order[single - 1]] * (1.0 + 1e-9)) & (series.count > 1))
    longest = np.argsort(-series.count[held], kind="stable")[: max(1, single // COEFFICIENTS_PER_COLUMN)]
    return np.sort(held[longest]) if held.size else np.array([int(series.count.argmax())])


def likely_steps(series: BlockSeries) -> list[Regressor]:
    """Return steps where the means before and after a place differ most, over several widths.

    The value at the place itself has the share of the step that it shows.
    """
    out, margin = [], LEAST_BLOCKS // 2
    near = margin - 2
    for segment, (begin, count) in enumerate(zip(series.begin.tolist(), series.count.tolist(), strict=True)):
        own = series.series[begin : begin + count]
        total = np.concatenate(([0.0], np.cumsum(own)))
        places: set[int] = set()
        for width in STEP_WIDTHS:
            if count >= 2 * max(width, margin):
                jumps = np.abs(total[2 * width :] - 2.0 * total[width:-width] + total[: -2 * width])
                ends = np.argsort(-jumps)[:STEP_PLACES] + width
                ends = ends[(ends >= margin) & (ends <= count - margin)]
                places |= {*ends.tolist(), *(ends - 1).tolist()}
        if places:
            at = np.array(sorted(places))
            before = (total[at] - total[at - near]) / near
            height = (total[at + near + 1] - total[at + 1]) / near - before
            share = np.divide(own[at] - before, height, out=np.ones(at.size), where=height != 0.0)
            lines = (np.arange(count)[:, None] > at).astype(np.float64)
            lines[at, np.arange(at.size)] = np.clip(share, 0.0, 1.0)
            names = ["step"] * at.size
            out += _within(series, segment, names, lines, _transform(lines), (begin + at).astype(np.float64))
    return out


def gains(coefficients: Coefficients, surface: Surface, more: Floats, starts: Ints) -> Floats:
    """Return (s,) twice the gain in log likelihood by some more terms, with the best B and K for each.

    Of the single coefficients alone: the powers would hold what the columns explain as noise.

    Parameters
    ----------
    surface : on a grid that reaches to B = K = 0.
    more : (n, t) columns at the coefficients.
    starts : (s,) first column of each term; the columns of one are nearly orthogonal.
    """
    y, X, variance = coefficients.y, coefficients.X, coefficients.variance
    b, k = surface.pairs
    w = 1.0 / (np.stack((surface.a, b, k), axis=1) @ variance)
    q, t = X.shape[1], more.shape[1]
    with_y, with_self = w @ (more * y[:, None]), w @ more**2
    if q:
        cross = (w @ (X[:, :, None] * more[:, None, :]).reshape(y.size, -1)).reshape(-1, q, t)
        XX, Xy = normal_matrix(w, X), w @ (X * y[:, None])
        solved = np.linalg.solve(XX, np.concatenate((cross, Xy[:, :, None]), axis=2))
        with_y = with_y - np.einsum("mqt,mq->mt", cross, solved[:, :, -1])
        with_self = with_self - np.einsum("mqt,mqt->mt", cross, solved[:, :, :-1])
    log = -0.5 * (w @ y**2 - np.log(w).sum(axis=1))
    if q:
        log += 0.5 * ((solved[:, :, -1] * Xy).sum(axis=1) - np.linalg.slogdet(XX)[1])
    gain = with_y**2 / np.maximum(with_self, 1e-12 * (w @ more**2) + 1e-300)
    gain = np.add.reduceat(gain, starts, axis=1)
    return np.asarray((2.0 * log[:, None] + gain).max(axis=0) - 2.0 * log.max())
