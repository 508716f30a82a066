"""Regressors of the block means: what moves the mean of a channel and is not noise.

Each segment has a straight drift of its own, and its constant is removed by the cosine transform. A temperature, an
exponential with its derivative by the time constant (so that to first order the time constant is free), a step, and an
oscillation of few cycles are further columns.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np

from imumon.noise.fit.likelihood import Surface, normal_matrix
from imumon.noise.fit.observations import SINGLE, BlockSeries, Coefficients
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
SETTLING_COEFFICIENTS = 6
"""Single coefficients of a segment in which an exponential is sought, beside its drift and the time constant."""
COEFFICIENTS_PER_COLUMN = 6
"""Single coefficients that a drift of a segment needs."""
DIRECTION_SHARE = 0.2
"""Share of the span that the temperature moves back before the direction has changed: less is noise."""
BOTH_WAYS = 0.15
"""Share of the blocks, and of the span, that each direction has at least where hysteresis can be seen."""
STEP_WIDTHS, STEP_PLACES = (1, 4, 16), 2
"""Blocks before and after a place whose means are compared, and places that are tried for each."""
STEP_MARGIN = 6
"""Blocks on each side of a step."""


@dataclass(frozen=True, slots=True)
class Regressor:
    """One column.

    Attributes
    ----------
    name : ``drift``, ``temperature``, ``temperature_2``, ``temperature_3``, ``hysteresis``, ``settling``,
        ``settling_time``, ``step`` or one of `OSCILLATION`.
    series : (n,) value at each block; the column is its transform.
    at : blocks, its place, time constant or period; 0.0 where it has none.
    scale : of the column, so that its norm is one.
    """

    name: str
    series: Floats
    at: float = 0.0
    scale: float = field(default=1.0)


def drifts(series: BlockSeries) -> list[Regressor]:
    """Return a straight drift of each segment that is long enough, per block."""
    out, held = [], _held(series, 1)
    for begin, count in zip(series.begin[held], series.count[held], strict=True):
        line = np.zeros(series.series.size)
        line[begin : begin + count] = np.arange(count) - 0.5 * (count - 1)
        out.append(Regressor("drift", line))
    return out


def temperature(series: BlockSeries) -> tuple[Regressor | None, str]:
    """Return the temperature as a regressor, degC, or why it is none."""
    own = series.degrees
    if own is None:
        return None, "no_temperature"
    known = np.isfinite(own)
    if known.sum() < max(STEP_MARGIN, 0.5 * own.size) or np.ptp(own[known]) < LEAST_SPAN_DEGC:
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
    return Regressor("temperature", own), ""


def bends(heat: Regressor) -> list[Regressor]:
    """Return what a straight line leaves of the effect of a temperature: its square, its cube, and hysteresis."""
    loop = hysteresis(heat.series)
    powers = [Regressor(name, heat.series**power) for name, power in zip(BENT, (2, 3), strict=False)]
    return powers if loop is None else [*powers, loop]


def hysteresis(degrees: Floats) -> Regressor | None:
    """Return half the difference between the directions of a temperature (n,), none at the ends of its span.

    None where it does not both rise and fall.
    """
    way = _direction(degrees)
    if way is None:
        return None
    return Regressor(BENT[-1], way * (1.0 - unit_span(degrees) ** 2))


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
            rising = None if abs(value - degrees[0]) < DIRECTION_SHARE * span else value > degrees[0]
            extreme = i
        elif (ahead > 0.0) == rising:
            extreme = i
        elif abs(ahead) > DIRECTION_SHARE * span:
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


def settling(series: BlockSeries, share: float) -> list[Regressor]:
    """Return an exponential from the beginning of the last long segment on, and its derivative by the time constant."""
    last = int(_held(series, SETTLING_COEFFICIENTS)[-1])
    begin, count = int(series.begin[last]), int(series.count[last])
    line = np.zeros((2, series.series.size))
    fall = np.exp(-(np.arange(count) + 0.5) / (share * count))
    line[0, begin : begin + count] = fall
    line[1, begin : begin + count] = -fall * np.log(fall)
    return [
        Regressor(name, own, share * count)
        for name, own in zip(("settling", "settling_time"), line, strict=True)
    ]


def waves(series: BlockSeries, numbers: Floats) -> Floats:
    """Return (m, 2 t) a cosine and a sine in the last segment, at the frequencies of coefficients (t,)."""
    count = int(series.count[-1])
    out = np.zeros((series.y.size, 2 * numbers.size))
    out[1 - count :] = _waves(count, numbers.tobytes())
    return out


@lru_cache(maxsize=2)  # the channels of a record have the same
def _waves(count: int, numbers: bytes) -> Floats:
    import scipy.fft

    angles = np.multiply.outer(np.arange(count) + 0.5, np.pi * np.frombuffer(numbers) / count)
    pairs = np.stack((np.cos(angles), np.sin(angles)), axis=2).reshape(count, -1)
    return np.asarray(scipy.fft.dct(pairs, axis=0, norm="ortho")[1:])


def oscillation(series: BlockSeries, number: float) -> list[Regressor]:
    """Return an oscillation in the last segment: two phases, and the same growing in time.

    Parameters
    ----------
    number : of the cosine coefficient with its frequency; not an integer in general.
    """
    begin, count = int(series.begin[-1]), int(series.count[-1])
    at = np.arange(count) + 0.5
    angle = np.pi * number / count
    slope = at / count - 0.5
    out: list[Regressor] = []
    for name, wave in zip(OSCILLATION, (np.cos(angle * at), np.sin(angle * at)) * 2, strict=True):
        line = np.zeros(series.series.size)
        line[begin : begin + count] = wave if len(out) < 2 else wave * slope
        out.append(Regressor(name, line, 2.0 * count / number))
    return out


def _held(series: BlockSeries, least: int) -> Ints:
    """Return the numbers of the segments with at least `least` single coefficients, or of the longest one.

    No more than leave some coefficients for the noise: the longest ones.
    """
    single = max(1, min(SINGLE, series.y.size // 3))
    last = 0.5 * least / (series.count * series.length)
    held = np.flatnonzero((last <= np.sort(series.f)[single - 1] * (1.0 + 1e-9)) & (series.count > 1))
    longest = np.argsort(-series.count[held], kind="stable")[: max(1, single // COEFFICIENTS_PER_COLUMN)]
    return np.sort(held[longest]) if held.size else np.array([int(series.count.argmax())])


def step(series: BlockSeries, at: int, share: float) -> Regressor:
    """Return a step within a value of the series, which has this share of it."""
    line = np.zeros(series.series.size)
    segment = int(np.searchsorted(series.begin, at, side="right")) - 1
    line[at : series.begin[segment] + series.count[segment]] = 1.0
    line[at] = share
    return Regressor("step", line, float(at))


def likely_steps(series: BlockSeries) -> list[Regressor]:
    """Return steps where the means before and after a place differ most, over several widths."""
    places: set[int] = set()
    for begin, count in zip(series.begin.tolist(), series.count.tolist(), strict=True):
        total = np.concatenate(([0.0], np.cumsum(series.series[begin : begin + count])))
        for width in STEP_WIDTHS:
            if count >= 2 * max(width, STEP_MARGIN):
                jumps = np.abs(total[2 * width :] - 2.0 * total[width:-width] + total[: -2 * width])
                ends = np.argsort(-jumps)[:STEP_PLACES] + width
                own = ends[(ends >= STEP_MARGIN) & (ends <= count - STEP_MARGIN)].tolist()
                places |= {begin + place + shift for place in own for shift in (-1, 0)}
    out = []
    for at in sorted(places):
        before, after = (
            float(series.series[part].mean()) for part in (slice(at - 4, at), slice(at + 1, at + 5))
        )
        share = (float(series.series[at]) - before) / (after - before) if after != before else 1.0
        out.append(step(series, at, min(max(share, 0.0), 1.0)))
    return out


def columns(series: BlockSeries, regressors: list[Regressor]) -> tuple[Floats, list[Regressor]]:
    """Return (m, q) the columns, each of norm one, and the regressors with their scales."""
    if not regressors:
        return np.zeros((series.y.size, 0)), []
    X = series.transform(np.stack([each.series for each in regressors], axis=1))
    norm = np.maximum(np.sqrt((X**2).sum(axis=0)), 1e-300)
    scaled = [
        Regressor(each.name, each.series, each.at, float(1.0 / size))
        for each, size in zip(regressors, norm, strict=True)
    ]
    return X / norm, scaled


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
    b, k = (axis.ravel() ** 2 for axis in np.meshgrid(surface.B, surface.K, indexing="ij"))
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
