"""Observations of one channel: the numbers that the likelihood compares with a model.

Two sets of sums carry what is known of a channel (`NoiseSums`), and they meet at one frequency:

| part | sums | observations |
|---|---|---|
| above | Welch sums of the levels of the spectrum | `Bands`: bands of about half an octave |
| below | means over blocks, as cosine coefficients | `Cosines`: the lowest ones; `Bands`: bands of the others |

*Bands* are means of squares. A mean of nu/2 independent pairs of squares of normal numbers with expectation S is gamma
distributed, S chi^2(nu) / nu (McCullagh and Nelder 1989, section 8.3). *Coefficients* stay single and normal, because
what is not noise (constant, drift, temperature, settling, a step) is a regressor there (`regressors`). In the basis of
the discrete cosine transform (DCT-II, Strang 1999) white noise and random walk are diagonal and flicker nearly, so that
coefficients count as independent. Coefficient k of n blocks of L samples belongs to the frequency k / (2 n L).

A block mean does not see frequencies above 1/(2L), and aliases those that are there: for N, B and K this is part of the
expectation. A filter in the sensor is not; therefore the spectrum serves down to 0.72 of the highest frequency of the
blocks, where a filter no longer bends what the blocks see.

Each frequency counts once. Bands of the spectrum count above the meeting frequency (`search.ModelSearch._powers`),
those of the blocks up to it (`slow_terms.observations`), and the single coefficients are the lowest third of the
blocks' at most. The spectrum cannot do the work of the blocks: at the lowest frequencies it has too few averages, and
a mean that moves is no noise there.

Units: tau0 = 1, so that powers are (channel unit)^2 (see `model`), and f is in cycles per sample.

Example: the coefficients of twelve block means of one sample each, of which the first belongs to 1/24 cycle per sample.

>>> blocks = BlockMeans(np.arange(12.0)[:, None], np.ones((12, 1)), np.zeros(12, int), 1, 1.0, np.zeros(1))
>>> series = block_series(blocks, 0)
>>> series.y.size, round(float(series.f[0]), 4), meeting_frequency(series)
(11, 0.0417, 0.5)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from imumon.model.samples import Bools, Floats, Ints
from imumon.noise.blocks import BlockMeans
from imumon.noise.fit.model import TERMS, WHITE, NoiseTerm
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.spectrum.expectation import degrees_of_freedom, filter_power, short_term_density
from imumon.noise.spectrum.leakage import HALF, WAVES_SHARE, leaked
from imumon.noise.spectrum.level_sums import FIRST_BIN, SEGMENT, SUB_BAND, LevelSums, last_bin
from imumon.noise.spectrum.power_spectrum import LEAST_AVERAGES

BAND_EDGES = (46, 70, 94, 128)
"""Edges of the bands of a level; a level below the first uses bins 46 to 91 only. Unit: bins.

Otherwise: wider bands: one expectation does not describe a band of K; narrower ones: the likelihood is slower.
Origin: within half an octave no noise of the model changes by more than 2.3 times; the level above has the bins from
92 on.
"""
LEAST_BLOCKS = 12
"""A segment with fewer blocks does not count, a channel with fewer is pending; a step has half of them on each
side. Unit: blocks.

Otherwise: drift and constant leave no coefficient for the noise, and limits of B and K are those of the prior.
Origin: 12 blocks have 11 coefficients, of which a third stays single: three, of which the drift takes one
(`real_effects.py`).
"""
MOST_FILLED = 0.3
"""Holes between blocks up to this share together are interpolated; more of them join the blocks in pairs. Unit: of
the blocks.

Otherwise: with 0.05 blocks are so long that no octave shows B where a sixth of a record is missing, and many records
have no result where half is missing. Origin: the expectation holds what interpolation takes; limits hold with half of
a record missing (`holes.py`).
"""
LONGEST_FILLED = 0.05
"""A hole up to this share is interpolated; a longer one separates two segments. Unit: of the blocks.

Otherwise: the straight line over a long hole repeats the flicker of its two ends, which no expectation holds. Origin:
chosen; limits of records with lost samples are tested with it (`real_effects.py`).
"""


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """Gamma-distributed mean squares.

    Attributes
    ----------
    power : (r,) (channel unit)^2, density per cycle per sample.
    dof : (r,) 1, degrees of freedom.
    expected : (r,) of each term, the expectation of power 1.
    bend : (r,) harmonic mean of 4 sin^2(pi f) over the band, with which a low-pass of first order acts on it; 0.0 in
        the bands of block means, which lie below the reach of a filter.
    top : (r,) cycles per sample, upper end of the band.
    """

    power: Floats
    dof: Floats
    expected: Mapping[NoiseTerm, Floats]
    bend: Floats
    top: Floats

    def take(self, rows: Bools | Ints) -> Bands:
        """Return some of the powers."""
        expected = {term: unit[rows] for term, unit in self.expected.items()}
        return Bands(self.power[rows], self.dof[rows], expected, self.bend[rows], self.top[rows])

    def up_to(self, highest: float) -> Bands:
        """Return the powers up to a frequency, cycles per sample."""
        return self.take(self.top <= highest * (1.0 + 1e-9))

    def joined(self, other: Bands) -> Bands:
        """Return these powers and others after them, with the terms that both have an expectation of."""
        return Bands(
            np.concatenate((self.power, other.power)),
            np.concatenate((self.dof, other.dof)),
            {
                term: np.concatenate((unit, other.expected[term]))
                for term, unit in self.expected.items()
                if term in other.expected
            },
            np.concatenate((self.bend, other.bend)),
            np.concatenate((self.top, other.top)),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Cosines:
    """Single cosine coefficients with their regressors.

    Attributes
    ----------
    y : (n,) channel unit.
    X : (n, q) regressors; the constant is removed already.
    variances : (n,) of each term, the variance of power 1.
    """

    y: Floats
    X: Floats
    variances: Mapping[NoiseTerm, Floats]


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
    variances : (m,) of each term, the variance of power 1.
    f : (m,) cycles per sample.
    order : (m,) numbers of the coefficients, lowest frequency first.
    left : (m,) share of the variance of slow noise that interpolation across holes leaves.
    """

    length: int
    begin: Ints
    count: Ints
    series: Floats
    degrees: Floats | None
    y: Floats
    variances: Mapping[NoiseTerm, Floats]
    f: Floats
    order: Ints
    left: Floats

    @property
    def samples(self) -> float:
        """Samples of all segments."""
        return float(self.count.sum()) * self.length

    def with_terms(self, more: Sequence[NoiseTerm]) -> BlockSeries:
        """Return the same with the variances of some more terms, none of which is white noise."""
        added = {
            term: self.left * np.concatenate([term.cosine_variances(int(n), self.length) for n in self.count])
            for term in more
        }
        return replace(self, variances={**self.variances, **added})

    def transform(self, values: Floats) -> Floats:
        """Return (m, ...) the coefficients of values (n, ...) at the same blocks."""
        import scipy.fft

        parts = [
            scipy.fft.dct(values[begin : begin + count], axis=0, norm="ortho")[1:]
            for begin, count in zip(self.begin, self.count, strict=True)
        ]
        return np.concatenate(parts)


def block_series(
    blocks: BlockMeans,
    channel: int,
    degrees: Floats | None = None,
    terms: Sequence[NoiseTerm] = TERMS,
) -> BlockSeries | None:
    """Return the coefficients of the means of a channel; None with too few blocks.

    Parameters
    ----------
    degrees : (blocks,) degC, temperature of the blocks, NaN where missing; None: there is none.
    terms : whose variances are needed.
    """
    while True:
        means, share, segment = blocks.means[:, channel], blocks.share[:, channel], blocks.segment
        present = np.flatnonzero(np.isfinite(means))
        if present.size < LEAST_BLOCKS:
            return None
        steps = np.diff(present)
        # one missing block never cuts: a cut costs a constant, a drift and the lowest frequencies
        apart = (steps > max(2.0, LONGEST_FILLED * present.size)) | (np.diff(segment[present]) != 0)
        if (steps[~apart] - 1).sum() <= MOST_FILLED * present.size:
            break
        # what fills a hole adds no information; of two neighbours seldom both are missing
        blocks = blocks.joined()
        if degrees is not None:
            pairs = degrees[: degrees.size // 2 * 2].reshape(-1, 2)
            degrees = np.where(np.isnan(pairs[:, 0]), pairs[:, 1], pairs[:, 0])
    length, borders = blocks.length, np.flatnonzero(apart) + 1
    rows, begin, count, series, f, left = [], [], [], [], [], []
    variances: dict[NoiseTerm, list[Floats]] = {term: [] for term in terms}
    first = 0
    for part in np.split(present, borders):
        n = int(part[-1] - part[0]) + 1
        if n < LEAST_BLOCKS:
            continue
        every = np.arange(part[0], part[-1] + 1)
        white = _white_by_interpolation(np.diff(part), share[part], n)
        slow = _left_by_interpolation(np.diff(part), n)
        begin.append(first)
        count.append(n)
        rows.append(every)
        series.append(np.interp(every, part, means[part]))
        for term in terms:
            variance = term.cosine_variances(n, length)
            variances[term].append(variance * (white if term == WHITE else slow))
        f.append(np.arange(1, n) / (2.0 * n * length))
        left.append(slow)
        first += n
    if not rows:
        return None
    frequency = np.concatenate(f)
    without_transform = BlockSeries(
        length,
        np.array(begin),
        np.array(count),
        np.concatenate(series),
        None if degrees is None else degrees[np.concatenate(rows)],
        np.zeros(0),
        {term: np.concatenate(parts) for term, parts in variances.items()},
        frequency,
        np.argsort(frequency, kind="stable"),
        np.concatenate(left),
    )
    return replace(without_transform, y=without_transform.transform(without_transform.series))


def _left_by_interpolation(steps: Ints, count: int) -> Floats:
    """Return (count - 1,) the share of the variance of slow noise that interpolation leaves in each coefficient.

    A random walk between two known values is their straight line and a Brownian bridge, independent of each other. The
    line takes the place of both. Of the walk, a bridge over T blocks has the share T (1 - sinc^2(f T)) / count at f
    cycles per block: its increments are those of the walk less their mean, whose transform is a sinc.

    Parameters
    ----------
    steps : blocks from each one that is present to the next.
    """
    bridges = steps[steps > 1, None].astype(np.float64)
    f = np.arange(1, count) / (2.0 * count)
    return np.asarray(1.0 - (bridges * (1.0 - np.sinc(f * bridges) ** 2)).sum(axis=0) / count)


def _white_by_interpolation(steps: Ints, share: Floats, count: int) -> Floats:
    """Return (count - 1,) the variance of white noise in each coefficient, 1 for whole blocks without a hole.

    A mean of a share of its samples has more white noise, and the blocks beside a hole seldom have all. The straight
    line over a hole of T steps repeats the noise of its ends: that of one has the weights 1, 1 - 1/T, 1 - 2/T ... 1/T.
    At the lowest frequencies they add up, at the highest they cancel.

    Parameters
    ----------
    steps : blocks from each one that is present to the next.
    share : of the samples in each block that is present.
    """
    f = np.arange(1, count) / (2.0 * count)
    variance = 1.0 / share
    power = np.full(count - 1, variance.sum())
    of_ends = variance[:-1] + variance[1:]
    for step in np.unique(steps[steps > 1]).tolist():
        weights = 1.0 - np.arange(step) / step
        repeated = np.abs(np.exp(-2j * np.pi * np.multiply.outer(f, np.arange(step))) @ weights) ** 2
        power += float(of_ends[steps == step].sum()) * (repeated - 1.0)
    return power / count


@lru_cache(maxsize=512)
def _band_dof(bins: bytes, segments: float) -> float:
    return degrees_of_freedom(np.frombuffer(bins, dtype=np.int64), segments)


@lru_cache(maxsize=1024)
def _bin_expectation(term: NoiseTerm, level: int, averaged: bool, window: int) -> Floats:
    return term.bin_expectation(level, averaged=averaged, window=window)


def spectral_powers(
    sums: NoiseSums,
    channel: int,
    *,
    averaged: bool,
    window: int = 1,
    terms: Sequence[NoiseTerm] = TERMS,
) -> Bands:
    """Return the bands of the spectrum of a channel without the bins of its lines.

    Parameters
    ----------
    averaged : the samples are true averages over their interval, else point samples.
    window : samples of a moving average in the sensor; 1: none.
    terms : whose expectations are needed.
    """
    layouts = _layouts(sums, channel)
    if not layouts:
        empty = np.zeros(0)
        return Bands(empty, empty, dict.fromkeys(terms, empty), empty, empty)
    group = int(sums.group[channel])
    powers = []
    for layout in layouts:
        level = sums.levels[layout.s]
        kept = layout.kept[:: layout.pool]
        power = np.add.reduceat(level.power[channel] * kept, layout.starts // layout.pool)
        # per sample of level 0
        powers.append(power[layout.counts] / layout.number / float(level.averages[group]) * 2.0**layout.s)
    dof, bend, top = (
        np.concatenate([getattr(layout, part) for layout in layouts]) for part in ("dof", "bend", "top")
    )
    expected = spectral_expectations(sums, channel, averaged=averaged, window=window, terms=terms)
    return Bands(np.concatenate(powers), dof, expected, bend, top)


def spectral_expectations(
    sums: NoiseSums, channel: int, *, averaged: bool, window: int, terms: Sequence[NoiseTerm]
) -> dict[NoiseTerm, Floats]:
    """Return (r,) of each term, the expectation of power 1 of the bands of `spectral_powers`."""
    group = int(sums.group[channel])
    means = [
        _band_means(layout, sums.levels, group, averaged, window, tuple(terms))
        for layout in _layouts(sums, channel)
    ]
    none = np.zeros((len(terms), 0))  # a short record has no level that counts
    return dict(zip(terms, np.concatenate((none, *means), axis=1), strict=True))


def _layouts(sums: NoiseSums, channel: int) -> list[_BandLayout]:
    """Return the bands of each level that counts."""
    group, pool = int(sums.group[channel]), SUB_BAND if sums.pooled else 1
    out = []
    for s, level in enumerate(sums.levels):
        count = float(level.averages[group])
        if count >= LEAST_AVERAGES:
            # what is missing in a segment is missing in its degrees of freedom
            there = count / float(level.white[group])
            mask = _line_bins(sums, s, channel)
            # sums of a part of a record have sub-bands instead of bins: a line in one leaves out all of it
            kept = ~np.logical_or.reduceat(mask, np.arange(0, mask.size, pool))
            out.append(_band_layout(s, count, there, pool, kept.tobytes()))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _BandLayout:
    """What the bands of a level are, whatever their power and its expectations.

    Attributes
    ----------
    s : number of the level.
    pool : bins of a sub-band, or 1.
    kept : (n,) bins in use that hold no line.
    starts : first bin of each band, from the first bin in use.
    counts : which bands have a bin that holds no line.
    number, dof, top : of those bands, bins that count, degrees of freedom, upper end in cycles per sample.
    bend : of those bands, the harmonic mean of 4 sin^2(pi f).
    """

    s: int
    pool: int
    kept: Bools
    starts: Ints
    counts: Bools
    number: Floats
    dof: Floats
    top: Floats
    bend: Floats

    def mean(self, of_bins: Floats) -> Floats:
        """Return (..., b) the means of (..., n) values of the bins in use."""
        sums = np.add.reduceat(of_bins * self.kept, self.starts, axis=-1)
        return np.asarray(sums[..., self.counts] / self.number)


@lru_cache(maxsize=64)  # the channels of a sensor have the same bands unless they have lines
def _band_layout(s: int, count: float, there: float, pool: int, kept_pools: bytes) -> _BandLayout:
    """Return the bands of level s, of `count` averages, of which some bins, or pools of bins, are kept.

    Parameters
    ----------
    there : by which missing samples reduce the degrees of freedom, 1 without any: that of white noise, about the share
        of samples that are valid.
    """
    bins = np.arange(FIRST_BIN, last_bin(s))
    kept = np.repeat(np.frombuffer(kept_pools, dtype=bool), pool)[: bins.size]
    starts = np.array([low for low in BAND_EDGES[:-1] if low < bins[-1]]) - FIRST_BIN
    number = np.add.reduceat(kept.astype(np.float64), starts)
    rows_of = np.split(np.arange(bins.size), starts[1:])
    dof = [
        there * _band_dof(bins[rows[kept[rows]]].tobytes(), count) if size >= 2 else 0.0
        for rows, size in zip(rows_of, number.tolist(), strict=True)
    ]
    # a level below the first ends within its last band: the level above has the bins beyond
    top = np.minimum(BAND_EDGES[1 : 1 + starts.size], last_bin(s)) / SEGMENT / 2.0**s
    counts = number >= 2.0
    bend = np.maximum(number, 1.0) / np.maximum(np.add.reduceat(kept / short_term_density(s), starts), 1e-300)
    return _BandLayout(
        s, pool, kept, starts, counts, number[counts], np.array(dof)[counts], top[counts], bend[counts]
    )


@lru_cache(maxsize=64)  # most channels of a sensor ask for the same terms
def _band_means(
    layout: _BandLayout,
    levels: tuple[LevelSums, ...],
    group: int,
    averaged: bool,
    window: int,
    terms: tuple[NoiseTerm, ...],
) -> Floats:
    """Return (terms, b) what each band of a level expects of each term."""
    return layout.mean(expected_bins(levels, layout.s, group, averaged=averaged, window=window, terms=terms))


def _line_bins(sums: NoiseSums, s: int, channel: int) -> Bools:
    """Return (n,) the bins in use of level s that hold a line of a channel."""
    masks = () if sums.spectrum is None else sums.spectrum.masks
    bins = np.arange(FIRST_BIN, last_bin(s))
    return np.asarray(masks[s][channel][bins] if s < len(masks) else np.zeros(bins.size, dtype=bool))


def expected_bins(
    levels: Sequence[LevelSums],
    s: int,
    group: int,
    *,
    averaged: bool,
    window: int,
    terms: Sequence[NoiseTerm],
) -> Floats:
    """Return (terms, n) what each bin in use of level s expects of each term with power 1."""
    level = levels[s]
    count = float(level.averages[group])
    # missing samples make noise larger, white noise by more: its density follows from their number
    missing = [(level.white if term == WHITE else level.slow)[group] / count for term in terms]
    unit = [_bin_expectation(term, s, averaged, window) for term in terms]
    expected = np.stack([factor * of_term for factor, of_term in zip(missing, unit, strict=True)])
    if level.holes[group].any():
        # white noise times any pattern of missing samples is white; the slow waves take a share of what leaks
        wave_share = WAVES_SHARE * np.repeat(level.holes[group] / count, SUB_BAND)[: expected.shape[1]]
        for row, term in enumerate(terms):
            if term == WHITE:
                expected[row] *= 1.0 - wave_share
            else:
                density = partial(_level_density, term, averaged=averaged, window=window)
                expected[row] += leaked(levels, s, group, density)
    return np.asarray(expected)


@lru_cache(maxsize=1024)
def _level_density(term: NoiseTerm, level: int, *, averaged: bool, window: int) -> Floats:
    """Return (HALF + 1,) the density of a term at the bins of a level, as `leaked` needs it; 0.0 in bin 0."""
    f = np.arange(1, HALF + 1) / SEGMENT / 2.0**level
    return np.concatenate(([0.0], term.seen_density(f, averaged=averaged, window=window)))


@lru_cache(maxsize=64)
def _response(level: int, pooled: bool) -> Floats:
    """Return the power response of the filters above a level at its bins, or at the middle of its sub-bands."""
    bins = np.arange(FIRST_BIN, last_bin(level), SUB_BAND if pooled else 1)
    middle = bins + 0.5 * (np.diff(bins, append=last_bin(level)) - 1.0)
    return filter_power(middle / SEGMENT / 2.0**level, level)


def observed_density(sums: NoiseSums, channel: int) -> tuple[Floats, Floats, Floats, Bools]:
    """Return the density of all bins of the spectrum of a channel.

    Returns
    -------
    f, width : (n,) cycles per sample.
    density : (n,) (channel unit)^2 per cycle per sample, of noise without missing samples.
    lines : (n,) bins of lines.
    """
    group = int(sums.group[channel])
    levels: list[Floats] = []
    for s, level in enumerate(sums.levels):
        count = float(level.averages[group])
        if count < LEAST_AVERAGES:
            continue
        bins = np.arange(FIRST_BIN, last_bin(s))
        first = bins[::SUB_BAND] if sums.pooled else bins
        # the levels meet without a gap, and the highest bin reaches to half the sampling rate
        size = np.diff(first - 0.5, append=last_bin(s) - 1.0 if s else float(last_bin(s)))
        middle = first - 0.5 + 0.5 * size
        mask = np.logical_or.reduceat(_line_bins(sums, s, channel), first - FIRST_BIN)
        number = np.diff(first, append=last_bin(s))
        density = level.power[channel] / number / float(level.white[group]) * 2.0**s
        density = density / _response(s, sums.pooled)
        levels.append(np.stack((middle / SEGMENT / 2.0**s, size / SEGMENT / 2.0**s, density, mask)))
    f, width, density, lines = np.concatenate(levels, axis=1) if levels else np.zeros((4, 0))
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


def pooled_cosines(series: BlockSeries, residual: Floats, masked: Bools, single: int, top: float) -> Bands:
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
        empty = np.zeros(0)
        return Bands(empty, empty, dict.fromkeys(series.variances, empty), empty, empty)
    octave = np.floor(2.0 * np.log2(series.f[order] / series.f[order[0]])).astype(np.int64)
    starts = np.flatnonzero(np.diff(octave, prepend=-1))
    sizes = np.diff(starts, append=order.size).astype(np.float64)
    # a density, as the spectrum has: coefficients of n means over m samples are 1/m of it
    scale = float(series.length)
    power = np.add.reduceat(residual[order] ** 2, starts) / sizes * scale
    unit = np.stack([variance[order] for variance in series.variances.values()])
    means = np.add.reduceat(unit, starts, axis=1) / sizes * scale
    last = np.append(starts[1:], order.size) - 1
    return Bands(
        power,
        sizes,
        dict(zip(series.variances, means, strict=True)),
        np.zeros(starts.size),
        series.f[order[last]],
    )
