"""Humps: bands of the spectrum that no sum of noise terms explains.

Mains hum that is sampled folds to a frequency near zero and wanders with the mains; so does the line of a fan or of a
pump. It is too wide for a line (`spectral_lines`), and it may lie at any frequency, also below the spectrum, in the
block means. The density of N, B, K and M falls at all frequencies, or is flat; a hump rises. Fitted as noise it is
taken for M or B, or for a plateau behind a filter.

So a band that is left out must explain what the terms do not. The likeliest powers of N, B and K follow by Fisher's
scoring for each range of neighbouring bands that may be left out, and the range with the least

    deviance of the bands that are left + 2 (number of bands that are left out)

counts (Akaike 1974), if chance explains that deviance. A filter in the sensor falls towards the highest frequency, and
a hump ends before it: the highest bands are never left out. They show N, whatever stands below.

A weak hump is a term: a line that wanders (`model.WanderingLine`), which `timed_search` weighs against Gauss–Markov
noise. Only what neither of them explains is left out, and only where chance would not make it at any of its places.

Example: white noise, of which two of nine bands are ten times too high.

>>> from imumon.noise.fit.model import FLICKER, WALK, WHITE
>>> f = 0.5 * 2.0 ** np.arange(-8.0, 1.0)
>>> power = np.where((f > 0.02) & (f < 0.1), 10.0, 1.0)
>>> expected = {WHITE: np.ones(9), FLICKER: 0.1 / f, WALK: 0.01 / f**2}
>>> bands = Bands(power, np.full(9, 100.0), expected, np.zeros(9), f)
>>> band_left_out(bands, (), error=0.01, least=1e-3)
Band(low=0.0078125, high=0.0625)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincc

from imumon.model.samples import Bools, Floats, Ints
from imumon.noise.fit.likelihood import CHANCE, Squares
from imumon.noise.fit.model import NOISE_TERMS, WHITE, NoiseTerm
from imumon.noise.fit.normal_equations import LEAST_VARIANCE
from imumon.noise.fit.observations import Bands, BlockSeries
from imumon.noise.fit.regressors import CHI_SQUARE_MEDIAN
from imumon.noise.fit.timed_search import LEAST_TIMED_SHARE, scored_powers
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.validity_groups import ROUNDING

KEPT = 3
"""The highest bands are never left out: they show N. Unit: bands, of half an octave.

Otherwise: with fewer, the end of a filter is left out as a hump. Origin: N, B and K are three numbers (`wander.py`).
"""
LINE_WIDTHS = 3.0
"""Distance from a line up to which its power reaches. Unit: widths of the line.

Otherwise: a strong hum is left out once, and once more with a false period. Origin: the share of a Gaussian line beyond
is 0.3 %.
"""
LEAST_RATIO = 12.0
"""A line shows in a cosine coefficient of the block means from here on. Unit: of the median.

Otherwise: coefficients are left out that lines do not disturb. Origin: chance exceeds it in 0.05 % of coefficients.
"""
MOST_HELD = 0.3
"""Lines are left out of the block means up to here. Unit: of the coefficients.

Otherwise: no coefficient is left beside a fast line that wanders (`real_effects.py`).
"""
STEADY_SHARE = 0.4
"""A line is steady if one cosine coefficient has more than this share of its power, and less than its inverse.

Otherwise: a line near half the sampling rate is an oscillation of the block means. Origin: one of the coefficients
beside a steady line has 40 % of its power or more; those of one that wanders by a per cent have some per cent.
"""
LEAK = 0.02
"""Coefficients beside a line, or an oscillation, are left out up to where its leakage is below this share of the noise.
Unit: of the noise.

Otherwise: the skirt of a strong oscillation is fitted as B. Origin: the leakage of a steady oscillation falls with
the square of the distance; 2 % is below the limits of B (`real_effects.py`).
"""


class Band(NamedTuple):
    """A range of frequencies that is left out.

    Attributes
    ----------
    low, high : cycles per sample.
    """

    low: float
    high: float

    def holds(self, f: Floats) -> Bools:
        """Return which of some frequencies are in the band."""
        return np.asarray((f > self.low) & (f <= self.high))


@dataclass(frozen=True, slots=True, eq=False)
class Hump:
    """What the bands that are left out hold above the noise.

    Attributes
    ----------
    band : the range of frequencies.
    f, size : (b,) cycles per sample, middle and width of each bin, or of each cosine coefficient.
    density : (b,) (channel unit)^2 per cycle per sample, two-sided.
    """

    band: Band
    f: Floats
    size: Floats
    density: Floats

    @property
    def power(self) -> float:
        """(channel unit)^2, the variance of the samples that it makes."""
        return max(2.0 * float(self.density @ self.size), 0.0)

    @property
    def frequency(self) -> float:
        """Cycles per sample, its middle."""
        return float(self._weight @ self.f)

    @property
    def width(self) -> float:
        """Cycles per sample, root mean square deviation of its frequency."""
        squares = (self.f - self.frequency) ** 2 + self.size**2 / 12.0
        return float(np.sqrt(self._weight @ squares))

    @property
    def reaches_zero(self) -> bool:
        """Whether it wanders to frequency zero, so that what is below its band may be its skirt."""
        return self.frequency < LINE_WIDTHS * self.width

    @property
    def _weight(self) -> Floats:
        """(b,) share of each bin in its power; a bin that chance puts below the noise has none."""
        weight = np.maximum(self.density, 0.0) * self.size
        return np.asarray(weight / max(float(weight.sum()), 1e-300))


def band_left_out(bands: Bands, timed: Sequence[NoiseTerm], *, error: float, least: float) -> Band | None:
    """Return the band of a hump, None without one.

    Parameters
    ----------
    bands : of the whole spectrum and all block means, lowest frequency first.
    timed : noise with time constants, a term of which may explain the bands instead.
    error : 1, relative error of the model in each band.
    least : probability from which on chance explains a deviance.
    """
    number = bands.power.size
    every = np.ones((1, number), dtype=bool)
    left = number - len(NOISE_TERMS)
    alone = float(_deviances(bands, every, error)[0][0])
    if _explained(alone, left, least):
        return None
    if timed:
        units = np.stack([bands.expected[term] for term in timed])
        beside = float(_deviances(bands, every, error, units)[0].min())
        if _explained(beside, left - 2, least):  # its size and its time constant
            return None
    ranges = _ranges(number)
    places = np.arange(number)
    counted = (places < ranges[:, :1]) | (places >= ranges[:, 1:])
    deviance, model = _deviances(bands, counted, error)
    left_out = ranges[:, 1] - ranges[:, 0]
    # a hump is above the noise: what lies below it is the end of a filter, or a walk beside a mean that does not move
    rises = ((bands.power > model) & ~counted).sum(axis=1) > 0.5 * left_out
    cost = np.where(rises, deviance + 2.0 * left_out, np.inf)
    best = int(cost.argmin()) if cost.size else 0
    if not cost.size or not _explained(float(deviance[best]), left - int(left_out[best]), least):
        return None
    chance = float(gammaincc(0.5 * left_out[best], 0.5 * max(alone - float(deviance[best]), 0.0)))
    if chance > CHANCE / cost.size:  # over all places (Bonferroni)
        return None
    begin, end = ranges[best].tolist()
    # its skirts lie in the bands beside it, where chance hides them
    begin, end = max(begin - 1, 0), min(end + 1, number - KEPT)
    low = float(bands.top[begin - 1]) if begin else 0.0
    return Band(low, float(bands.top[end - 1]))


def _ranges(number: int) -> Ints:
    """Return (m, 2) the first band, and the one behind the last, of each range that may be left out."""
    last = number - KEPT
    ranges = [
        (begin, end) for begin in range(last) for end in range(begin + 1, min(last, begin + number // 2) + 1)
    ]
    return np.array(ranges, dtype=np.int64).reshape(-1, 2)


def _explained(deviance: float, dof: int, least: float) -> bool:
    return dof > 0 and float(gammaincc(0.5 * dof, 0.5 * deviance)) > least


def _deviances(
    bands: Bands, counted: Bools, error: float, more: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return (m,) the deviance of the likeliest sum of terms in the bands that count, and (m, r) that sum.

    Parameters
    ----------
    counted : (m, r) which bands count in each of m cases; (1, r) the same in all.
    more : (m, r) what each band expects of another term beside N, B and K; None: there is none.
    """
    half = np.where(counted, 0.5 / (1.0 / bands.dof + 0.5 * error**2), 0.0)
    units = np.stack([bands.expected[term] for term in NOISE_TERMS])[None]
    if more is not None:
        units = np.concatenate((np.tile(units, (len(more), 1, 1)), more[:, None]), axis=1)
    white = float(np.median((bands.power / bands.expected[WHITE])[-KEPT:]))
    # where each term alone is nearly all of some band, and a ten thousandth of N everywhere
    most = (bands.power / units).min(axis=2)
    most[:, list(NOISE_TERMS).index(WHITE)] = white
    least = LEAST_TIMED_SHARE * white * (bands.expected[WHITE] / units).min(axis=2)
    start = np.log(np.maximum(most, 10.0 * least))
    squares = Squares(bands.power, half[:, None], {})
    cases = max(len(units), len(counted))
    powers = np.exp(scored_powers(squares, units, np.tile(start, (cases // len(units), 1)), np.log(least)))
    model = (powers[:, None] @ units)[:, 0]
    ratio = bands.power / model
    return np.asarray(
        2.0 * (half * (ratio - 1.0 - np.log(np.maximum(ratio, ROUNDING**2)))).sum(axis=1)
    ), model


def line_bands(sums: NoiseSums, channel: int) -> Floats:
    """Return (l, 3) frequency and width, cycles per sample, and power of the lines of a channel, strongest first."""
    bands = () if sums.spectrum is None else sums.spectrum.bands[channel]
    scaled = [(band.frequency_hz * sums.tau0, band.width_hz * sums.tau0, band.power) for band in bands]
    return np.array(scaled).reshape(-1, 3)


def at_aliases(series: BlockSeries, lines: Floats) -> Bools:
    """Return which cosine coefficients a line of the spectrum disturbs.

    Block means of L samples see a line of frequency f at its alias, the distance of f from the nearest multiple of
    1/L. A mean that such a line moves looks like a settling, a step or an oscillation.

    Parameters
    ----------
    lines : (l, 3) frequency and width, cycles per sample, and power of each line.
    """
    wide, steady = np.zeros((2, series.y.size), dtype=bool)
    step = 0.5 / series.samples  # of a segment that is the whole record
    ratio = series.y**2 / (np.median(series.y**2) / CHI_SQUARE_MEDIAN + LEAST_VARIANCE)
    for f, width, power in lines.tolist():
        distance = np.abs(series.f - abs(f - round(f * series.length) / series.length))
        high = (distance <= LINE_WIDTHS * width + step) & (ratio > LEAST_RATIO)
        if high.any():
            # the leakage of a steady line falls with the square of the distance
            leakage = step * (1.0 + np.sqrt(float(ratio[high].max()) / LEAK) / np.pi)
            reached = distance <= LINE_WIDTHS * width + leakage
            gain = np.sin(np.pi * series.f * series.length) / (series.length * np.sin(np.pi * f))
            share = series.y**2 / (power * gain**2 * series.y.size)
            peaks = series.f[high & (share > STEADY_SHARE) & (share < 1.0 / STEADY_SHARE)]
            wide |= reached
            steady |= np.abs(series.f - peaks.mean()) <= leakage if peaks.size else reached
    # The spectrum knows the frequency of a steady line to a part of a bin, which may be most of what long blocks see:
    # then, the one peak in the blocks shows where it is. Lines that wander over most of it are white noise there.
    return next((held for held in (wide, steady) if held.mean() <= MOST_HELD), np.zeros_like(wide))
