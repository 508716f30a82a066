"""Spectral lines: groups of bins that exceed the power density beside them, and their possible causes.

Model
-----
The density beside a bin is the median of the `SIDE` bins on each side of it, the higher one where the two differ. The
power of a bin of noise over its expectation is chi-square with nu = 1.89 a degrees of freedom over nu, of a averages
that overlap by half (Welch 1967). A group begins with a bin that exceeds the density beside it by more than the
quantile of that distribution at `LINE_CHANCE`: by more than chance does in hundreds of reports.

The Allan variance is a thousand times more precise than a bin, so that weak lines bend it, and real lines wander: a fan
changes its speed by a per cent. So every group is a narrow band with a frequency, a width and a power, which the fit
leaves out. Groups are excluded from the medians of the next pass, so that a strong line does not hide a weak one beside
it. A band whose highest bin is `PROMINENCE` times the density beside it is reported as a line.

Sampled signals fold: a line at f may be any |k rate +- f|, so mains and its harmonics are candidates. This module does
not depend on how a density is measured.

>>> power = np.ones(BINS)
>>> power[60] = 50.0
>>> (band,), inside = find_narrow_bands(power, averages=100, rate=256.0, bins=range(46, 128))
>>> round(band.frequency_hz), round(band.power), np.flatnonzero(inside).tolist()
(60, 49, [58, 59, 60, 61, 62])
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammainccinv, gammaincinv

from imumon.model.samples import Bools, Floats
from imumon.noise.spectrum.level_sums import BINS, SEGMENT

LINE_CHANCE = 1e-6
"""A bin is a narrow band above a density that noise alone exceeds in this share of bins. Unit: probability.

Otherwise: lower, a weak line stays in the spectrum that is fitted; higher, bins are left out by chance. Origin: one
in 200 reports of nine channels has such a band, of little power; one that is also a line was in none of 3,000.
"""
SIDE = 11
"""The density beside a bin is the median of this many bins on each side; lower bins have no lines. Unit: bins.

Otherwise: the median of fewer scatters more, and that of more follows a slope of the density less.
"""
LEVEL_ERRORS = 3.0
"""The threshold of a line is raised by this many of the median beside it. Unit: standard errors.

Otherwise: a median that is too low by chance makes a line of noise.
"""
HARMONICS = 3
"""Highest harmonic of the mains that a line, or its alias, is compared with.

Otherwise: with more, some harmonic is near to any frequency.
"""
MAINS_SPREAD = 0.002
"""Deviation of the mains from 50 or 60 Hz up to which a line may be of the mains. Unit: of the frequency.

Otherwise: a hum beside the nominal frequency has no cause that is named. Chosen: a deviation that is common.
"""

LOBE = 2
"""Bins on each side of a bin that the main lobe of the window fills."""
PASSES = 3
"""Searches, each with the medians of the bins that the one before left."""
OVERLAP_DOF = 1.89
"""Degrees of freedom of a bin per average: half overlap costs 1 + 2 (1/6)^2 (Welch 1967)."""
LEAST_WIDTH = 0.05
"""Bins, least width of a band: the error of its frequency."""
MAINS_HZ = (50.0, 60.0)


@dataclass(frozen=True, slots=True)
class SpectralLine:
    """A line as people see it.

    Attributes
    ----------
    frequency_hz : Hz, as it appears.
    amplitude : channel unit, of the sinusoid.
    aliases_hz : Hz, mains and harmonics that fold to it.
    name : "50 Hz mains" or the like, if one fits; None: no name.
    """

    frequency_hz: float
    amplitude: float
    aliases_hz: tuple[float, ...]
    name: str | None


@dataclass(frozen=True, slots=True)
class NarrowBand:
    """Power above the density beside it.

    Attributes
    ----------
    frequency_hz : Hz, centroid.
    width_hz : Hz, root mean square deviation of the frequency.
    power : (channel unit)^2, variance of the samples that it makes: a^2/2 of a sinusoid of amplitude a.
    peak_hz, peak_power : the same of its highest bin and those that the lobe of the window fills beside it.
    prominence : 1, its highest bin over the density beside it.
    resolution_hz : Hz, width of a bin.
    """

    frequency_hz: float
    width_hz: float
    power: float
    peak_hz: float
    peak_power: float
    prominence: float
    resolution_hz: float

    def line(self, sampling: float) -> SpectralLine:
        """Return its peak as a line of a signal with a sampling rate, Hz."""
        aliases, name = mains(self.peak_hz, sampling, self.resolution_hz)
        return SpectralLine(self.peak_hz, math.sqrt(2.0 * self.peak_power), aliases, name)


def median_to_mean(averages: int) -> float:
    """Return the mean of a bin over its median: chi-square with `OVERLAP_DOF` times `averages` degrees."""
    shape = 0.5 * OVERLAP_DOF * averages
    return shape / float(gammaincinv(shape, 0.5))


def find_narrow_bands(
    power: Floats, averages: int, rate: float, bins: range
) -> tuple[list[NarrowBand], Bools]:
    """Return the bands of one channel in one level of the spectrum, and (BINS,) the bins that they fill.

    Parameters
    ----------
    power : (BINS,) (channel unit)^2/Hz, one-sided density.
    averages : segments averaged.
    rate : Hz, sampling rate of the level.
    bins : in which the centroid may be; others belong to a level that resolves them better.
    """
    inside, level = _bins_above(power, averages)
    known = np.flatnonzero(level > 0.0)
    if not len(known):
        return [], inside
    # in the middle of a broad band both sides are unknown
    level = np.exp(np.interp(np.arange(BINS), known, np.log(level[known])))
    level[-1] *= 0.5  # as the density at the Nyquist frequency
    above = np.flatnonzero(inside)
    groups = np.split(above, np.flatnonzero(np.diff(above) > 1) + 1)
    bands = (_band(group, power, level, rate / SEGMENT, bins) for group in groups)
    return [band for band in bands if band is not None], inside


def _bins_above(power: Floats, averages: int) -> tuple[Bools, Floats]:
    """Return which bins exceed the density beside them, with those that the window fills, and that density.

    The density is 0 everywhere if there is no band, and NaN where both sides of a bin are unknown.
    """
    nu, to_mean = OVERLAP_DOF * averages, median_to_mean(averages)
    # the variance of a median is pi / 2 that of a mean
    margin = 1.0 + LEVEL_ERRORS * math.sqrt(math.pi / nu / SIDE)
    least = 2.0 * float(gammainccinv(0.5 * nu, LINE_CHANCE)) / nu * margin
    inside, level = np.zeros(BINS, dtype=bool), power
    for _ in range(PASSES):
        left, right = _side_levels(np.where(inside, np.nan, power)) * to_mean
        higher = np.fmax(left, right)
        high = (power > least * higher) | (inside & np.isnan(higher))
        high[: SIDE + 1] = False  # a drift exceeds the bins beside it
        if not high.any():
            # bins of an earlier pass that do not exceed the medians without them stay masked, but are no band
            return inside, np.zeros(BINS)
        # the geometric mean: on a slope, that of the bin itself
        level = np.sqrt(np.where(np.isfinite(left), left, right) * np.where(np.isfinite(right), right, left))
        inside = np.convolve(high, np.ones(2 * LOBE + 1), "same") > 0.5
    return inside, level


def _band(group: np.ndarray, power: Floats, level: Floats, df: float, bins: range) -> NarrowBand | None:
    """Return the band of a group of neighbouring bins, df Hz apart; None if it has no power or lies elsewhere."""
    above = power[group] - level[group]
    size, weights = float(above.sum() * df), np.maximum(above, 0.0)
    if size <= 0.0:
        return None
    frequency = float(weights @ group / weights.sum())
    if not bins.start <= frequency < bins.stop:
        return None
    variance = float(weights @ (group - frequency) ** 2 / weights.sum())
    # the power of a Hann window in three bins, 1/4, 1, 1/4, has a variance of 1/3
    width = math.sqrt(max(variance - 1.0 / 3.0, LEAST_WIDTH**2))
    core = np.abs(group - group[np.argmax(above)]) <= LOBE
    high_power = float(weights[core].sum())
    peak = float(weights[core] @ group[core]) / high_power
    prominence = float((power[group] / level[group]).max())
    return NarrowBand(frequency * df, width * df, size, peak * df, high_power * df, prominence, df)


def _side_levels(power: Floats) -> Floats:
    """Return (2, BINS) the median density of the `SIDE` bins on the left and on the right of each bin.

    `power` is (BINS,), (channel unit)^2/Hz, as the result, which is NaN if more than half are missing.
    """
    reach = LOBE + SIDE
    padded = np.full(BINS + 2 * reach, np.nan)
    padded[reach + 2 : reach + BINS] = power[2:]  # bins 0 and 1 hold the mean and its leakage
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(padded, SIDE), axis=1)
    known = np.isfinite(windows).sum(axis=1)
    median = windows[np.arange(len(windows)), np.maximum(known - 1, 0) // 2]
    median[known < SIDE // 2] = np.nan
    right = reach + LOBE + 1
    return np.stack((median[:BINS], median[right : right + BINS]))


def distinct(bands: list[NarrowBand]) -> tuple[NarrowBand, ...]:
    """Return bands of different frequencies, strongest first: once, not once from each of two levels."""
    out: list[NarrowBand] = []
    for band in sorted(bands, key=lambda band: band.power, reverse=True):
        # two levels see a line at frequencies that differ by up to 3 %
        if all(abs(band.frequency_hz - other.frequency_hz) > 0.03 * band.frequency_hz for other in out):
            out.append(band)
    return tuple(out)


def mains(frequency: float, sampling: float, tolerance: float) -> tuple[tuple[float, ...], str | None]:
    """Return the frequencies of mains and harmonics that appear at `frequency` when sampled, and a name.

    The name is that of the most likely one. A line slower than the spread of the mains has no name, because a
    drift looks the same.

    Parameters
    ----------
    frequency, sampling, tolerance : Hz.

    >>> mains(10.0, 40.0, 0.1)
    ((50.0, 150.0), '50 Hz mains')
    >>> mains(7.3, 40.0, 0.1)
    ((), None)
    """
    fits: list[tuple[int, float, float]] = []
    for base in MAINS_HZ:
        for order in range(1, HARMONICS + 1):
            true = base * order
            miss = abs(abs(true - round(true / sampling) * sampling) - frequency)
            if miss <= tolerance + MAINS_SPREAD * true:
                fits.append((order, miss, base))
    if not fits:
        return (), None
    order, _, base = min(fits)  # the lowest harmonic, then the nearest
    name = f"{base:.0f} Hz mains" + (f", harmonic {order}" if order > 1 else "")
    slow = frequency <= tolerance + MAINS_SPREAD * base * order
    return tuple(sorted({b * o for o, _, b in fits})), None if slow else name
