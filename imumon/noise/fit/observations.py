"""Observations of one channel: what the likelihood compares with a model.

Powers (`Powers`) are means of squares with a gamma distribution: bands of about half an octave of the Welch sums, and
of the higher cosine coefficients of the block means. The lower cosine coefficients stay single (`Coefficients`),
because what is not noise (constant, drift, temperature, settling, a step) is a regressor there. Both parts meet at one
frequency: the spectrum above it, the blocks below.

Units: tau0 = 1, so a = N^2/tau0, b = B^2, k = K^2 tau0, all (channel unit)^2, and f in cycles per sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from imumon.noise.blocks import BlockMeans
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.power_law import coefficient_variances
from imumon.noise.spectrum.expectation import (
    bin_expectation,
    degrees_of_freedom,
    filter_power,
    segment_variances,
    short_term_density,
)
from imumon.noise.spectrum.level_sums import FIRST_BIN, SUB_BAND, last_bin
from imumon.noise.spectrum.power_spectrum import LEAST_AVERAGES
from imumon.noise.spectrum.spectral_lines import SEGMENT
from imumon.samples import Bools, Floats, Ints

BAND_EDGES = (46, 70, 94, 128)
"""Bins between which the power of a level is one observation: within it no noise changes by more than 2.3 times."""
LEAST_BINS = 2
"""Bins without a line from which a band counts."""
SINGLE = 48
"""Cosine coefficients that stay single: the spectrum of a smooth regressor falls with the square of their number."""
LEAST_BLOCKS = 12
"""Blocks from which a segment counts, and without which nothing is said of B and K. A step has half of them on each
side."""
MOST_FILLED = 0.05
"""Share of the blocks that holes may be, all of them and each. They are filled by interpolation. A longer one separates
two segments, as does a gap of unknown length."""
LEAST_VARIANCE = 1e-100
"""(channel unit)^2; below, squares of variances underflow: a channel is constant, and a power holds no information."""


@dataclass(frozen=True, slots=True, eq=False)
class Powers:
    """Gamma-distributed mean squares.

    Attributes
    ----------
    power : (r,) (channel unit)^2, density per cycle per sample.
    dof : (r,) 1, degrees of freedom.
    expected : (r, 5) expectation for a = b = k = 1, and the mean and the harmonic mean of x = 4 sin^2(pi f).
    top : (r,) cycles per sample, upper end of the band.
    """

    power: Floats
    dof: Floats
    expected: Floats
    top: Floats

    def take(self, rows: Bools) -> Powers:
        """Return some of the powers."""
        return Powers(self.power[rows], self.dof[rows], self.expected[rows], self.top[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Coefficients:
    """Single cosine coefficients with their regressors.

    Attributes
    ----------
    y : (n,) channel unit.
    X : (n, q) regressors; the constant is removed already.
    variance : (3, n) for a = b = k = 1.
    """

    y: Floats
    X: Floats
    variance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class BlockSeries:
    """Cosine coefficients of all segments of the block means.

    Attributes
    ----------
    length : samples of a block.
    begin, count : (s,) first value and number of values of each segment.
    series : (n,) channel unit, means, about an offset, holes filled.
    degrees : (n,) degC, temperature of the same blocks, NaN where missing; None: there is none.
    y : (m,) channel unit, coefficients of all segments, without that of the constant.
    variance : (3, m) for a = b = k = 1.
    f : (m,) cycles per sample.
    order : (m,) numbers of the coefficients, lowest frequency first.
    """

    length: int
    begin: Ints
    count: Ints
    series: Floats
    degrees: Floats | None
    y: Floats
    variance: Floats
    f: Floats
    order: Ints

    @property
    def samples(self) -> float:
        """Samples of all segments."""
        return float(self.count.sum()) * self.length

    def transform(self, values: Floats) -> Floats:
        """Return (m, ...) the coefficients of values (n, ...) at the same blocks."""
        import scipy.fft

        parts = [
            scipy.fft.dct(values[begin : begin + count], axis=0, norm="ortho")[1:]
            for begin, count in zip(self.begin, self.count, strict=True)
        ]
        return np.concatenate(parts)


def block_series(blocks: BlockMeans, column: int, degrees: Floats | None = None) -> BlockSeries | None:
    """Return the coefficients of the means of a channel; None with too few of them.

    Where many short holes lie between the blocks, they are joined in pairs until few are left: what fills a hole has
    no noise of its own.

    Parameters
    ----------
    degrees : (blocks,) degC, temperature of the blocks, NaN where missing; None: there is none.
    """
    while True:
        means, share, segment = blocks.means[:, column], blocks.share[:, column], blocks.segment
        at = np.flatnonzero(np.isfinite(means))
        if at.size < LEAST_BLOCKS:
            return None
        steps = np.diff(at)
        apart = (steps > max(2.0, MOST_FILLED * at.size)) | (np.diff(segment[at]) != 0)
        if (steps[~apart] - 1).sum() <= MOST_FILLED * at.size:
            break
        blocks = blocks.joined()
        if degrees is not None:
            pairs = degrees[: degrees.size // 2 * 2].reshape(-1, 2)
            degrees = np.where(np.isnan(pairs[:, 0]), pairs[:, 1], pairs[:, 0])
    length, borders = blocks.length, np.flatnonzero(apart) + 1
    rows, begin, count, series, variance, f = [], [], [], [], [], []
    total = 0
    for part in np.split(at, borders):
        n = int(part[-1] - part[0]) + 1
        if n < LEAST_BLOCKS:
            continue
        every = np.arange(part[0], part[-1] + 1)
        values = np.interp(every, part, means[part])
        white = float(np.mean(1.0 / share[part])) * len(part) / n  # filled blocks have no white noise
        unit = np.array([white / length, 1.0, float(length)])
        begin.append(total)
        count.append(n)
        rows.append(every)
        series.append(values)
        variance.append(coefficient_variances(n) * unit[:, None])
        f.append(np.arange(1, n) / (2.0 * n * length))
        total += n
    if not rows:
        return None
    frequency = np.concatenate(f)
    made = BlockSeries(
        length,
        np.array(begin),
        np.array(count),
        np.concatenate(series),
        None if degrees is None else degrees[np.concatenate(rows)],
        np.zeros(0),
        np.concatenate(variance, axis=1),
        frequency,
        np.argsort(frequency, kind="stable"),
    )
    return replace(made, y=made.transform(made.series))


@lru_cache(maxsize=512)
def _band_dof(bins: bytes, segments: float) -> float:
    return degrees_of_freedom(np.frombuffer(bins, dtype=np.int64), segments)


def spectral_powers(sums: NoiseSums, column: int, *, averaged: bool, window: int = 1) -> Powers:
    """Return the bands of the spectrum of a channel without the bins of its lines.

    Parameters
    ----------
    averaged : the samples are true averages over their interval, else point samples.
    window : samples of a moving average in the sensor; 1: none.
    """
    masks = () if sums.spectrum is None else sums.spectrum.masks
    found = [np.zeros((8, 0))]
    group = int(sums.group[column])
    for s, level in enumerate(sums.levels):
        count = float(level.averages[group])
        if count < LEAST_AVERAGES:
            continue
        bins = np.arange(FIRST_BIN, last_bin(s))
        mask = masks[s][column][bins] if s < len(masks) else np.zeros(bins.size, dtype=bool)
        expected = bin_expectation(s, averaged=averaged, window=window)
        expected = np.concatenate((expected, short_term_density(s)[None], 1.0 / short_term_density(s)[None]))
        expected[0] *= level.white[group] / count
        if holes := level.holes[group] / count:
            leak = holes * segment_variances(s) * np.array([1.0, 1.0, 2.0**s]) * 2.0**s
            expected[:3] += leak[:, None]
        pool = SUB_BAND if sums.pooled else 1
        starts = np.array([low for low in BAND_EDGES[:-1] if low < bins[-1]]) - FIRST_BIN
        firsts = np.arange(0, bins.size, pool)
        keep = ~np.logical_or.reduceat(mask, firsts)  # a line in a sub-band leaves out all of it
        total = np.add.reduceat(level.power[column] * keep, starts // pool)
        keep = np.repeat(keep, pool)[: bins.size]
        number = np.add.reduceat(keep.astype(np.float64), starts)
        mean = np.add.reduceat(expected * keep, starts, axis=1) / np.maximum(number, 1.0)
        mean[4] = 1.0 / np.maximum(mean[4], 1e-300)
        own = [bins[part] for part in np.split(np.arange(bins.size), starts[1:])]
        dof = [
            _band_dof(part[keep[part - FIRST_BIN]].tobytes(), count) if size >= LEAST_BINS else 0.0
            for part, size in zip(own, number.tolist(), strict=True)
        ]
        top = np.array(BAND_EDGES[1 : 1 + starts.size]) / SEGMENT / 2.0**s
        power = total / np.maximum(number, 1.0) / count * 2.0**s
        found.append(np.concatenate((np.stack((power, dof, top)), mean))[:, number >= LEAST_BINS])
    power, dof_, top, *expected_ = np.concatenate(found, axis=1)
    return Powers(power, dof_, np.stack(expected_, axis=1), top)


@lru_cache(maxsize=64)
def _response(level: int, pooled: bool) -> Floats:
    """Return the power response of the filters above a level at its bins, or at the middle of its sub-bands."""
    bins = np.arange(FIRST_BIN, last_bin(level), SUB_BAND if pooled else 1)
    middle = bins + 0.5 * (np.diff(bins, append=last_bin(level)) - 1.0)
    return filter_power(middle / SEGMENT / 2.0**level, level)


def observed_density(sums: NoiseSums, column: int) -> tuple[Floats, Floats, Floats, Bools]:
    """Return the density of all bins of the spectrum of a channel.

    Returns
    -------
    f, width : (n,) cycles per sample.
    density : (n,) (channel unit)^2 per cycle per sample, of noise without missing samples.
    lines : (n,) bins of lines.
    """
    masks = () if sums.spectrum is None else sums.spectrum.masks
    group, found = int(sums.group[column]), []
    for s, level in enumerate(sums.levels):
        count = float(level.averages[group])
        if count < LEAST_AVERAGES:
            continue
        bins = np.arange(FIRST_BIN, last_bin(s))
        first = bins[::SUB_BAND] if sums.pooled else bins
        # the levels meet without a gap, and the highest bin reaches to half the sampling rate
        size = np.diff(first - 0.5, append=last_bin(s) - 1.0 if s else float(last_bin(s)))
        middle = first - 0.5 + 0.5 * size
        mask = masks[s][column][bins] if s < len(masks) else np.zeros(bins.size, dtype=bool)
        mask = np.logical_or.reduceat(mask, first - FIRST_BIN)
        number = np.diff(first, append=last_bin(s))
        density = level.power[column] / number / float(level.white[group]) * 2.0**s
        density = density / _response(s, sums.pooled)
        found.append(np.stack((middle / SEGMENT / 2.0**s, size / SEGMENT / 2.0**s, density, mask)))
    f, width, density, lines = np.concatenate(found, axis=1) if found else np.zeros((4, 0))
    return f, width, density, lines > 0.0


def meeting_frequency(series: BlockSeries | None) -> float:
    """Return the frequency, cycles per sample, below which the blocks count and above which the spectrum does.

    Blocks of 2^j samples serve up to the lowest band of level j - 1, at 0.72 of their highest frequency. Blocks of one
    sample serve alone.
    """
    if series is None:
        return 0.0
    length = series.length
    return 0.5 if length == 1 else BAND_EDGES[0] / SEGMENT * 2.0 / length


def pooled_coefficients(
    series: BlockSeries, residual: Floats, masked: Bools, single: int, top: float
) -> Powers:
    """Return bands of about half an octave of the coefficients from number `single` on, up to the frequency `top`.

    Parameters
    ----------
    residual : (m,) channel unit, coefficients without the regressors.
    masked : (m,) coefficients that do not count.
    """
    order = series.order[single:]
    order = order[series.f[order] <= top]
    order = order[~masked[order]]
    if not order.size:
        return Powers(np.zeros(0), np.zeros(0), np.zeros((0, 5)), np.zeros(0))
    octave = np.floor(2.0 * np.log2(series.f[order] / series.f[order[0]])).astype(np.int64)
    starts = np.flatnonzero(np.diff(octave, prepend=-1))
    sizes = np.diff(starts, append=order.size).astype(np.float64)
    power = np.add.reduceat(residual[order] ** 2, starts) / sizes
    expected = (np.add.reduceat(series.variance[:, order], starts, axis=1) / sizes).T
    # a density, as the spectrum has: coefficients of n means over m samples are 1/m of it
    expected = np.concatenate((expected, np.zeros((len(starts), 2))), axis=1)
    last = np.append(starts[1:], order.size) - 1
    scale = float(series.length)
    return Powers(power * scale, sizes, expected * scale, series.f[order[last]])
