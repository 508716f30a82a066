"""Spectral lines: groups of bins that exceed the power density beside them, and their possible causes.

A group begins with a bin that exceeds the higher of the medians of the bins on both sides, by more than chance does in
hundreds of reports. The Allan variance is a thousand times more precise than a bin, so that weak lines bend it, and
real lines wander: a fan changes its speed by a per cent. So every group is a narrow band with a frequency, a width and
a power, which the fit leaves out. Groups that are found are excluded from the medians of the next pass, so that a
strong line does not hide a weak one beside it. A band whose highest bin is `PROMINENCE` times the density beside it is
reported as a line.

Sampled signals fold: a line at f may be any |k rate +- f|, so mains and its harmonics are candidates. This module does
not depend on how a density is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from scipy.special import gammainccinv, gammaincinv

from imumon.report import Line
from imumon.samples import Bools, Floats

SEGMENT = 256
"""Samples of a periodogram: each stage of the cascade resolves two octaves."""
HOP = SEGMENT // 2
BINS = np.fft.rfftfreq(SEGMENT).size
LINE_CHANCE = 1e-6
"""Probability that noise alone makes a band of a bin: one in 200 reports of nine channels, of little power. One with
`PROMINENCE` was in none of 3,000 (`python benchmarks/guards.py --lines`)."""
PROMINENCE = 2.0
"""Least ratio of the highest bin of a line to the density beside it: less does not matter to a user."""
SIDE = 11
"""Bins on each side of a bin whose median is the level there. Lines are sought above as many."""
LOBE = 2
"""Bins on each side of a bin that the main lobe of the window fills."""
PASSES = 3
"""Searches, each with the medians of the bins that the one before left."""
LEVEL_ERRORS = 3.0
"""Standard errors of the median beside a bin by which the threshold is higher."""
OVERLAP_DOF = 1.89
"""Degrees of freedom of a bin per average: half overlap costs 1 + 2 (1/6)^2 (Welch 1967)."""
LEAST_WIDTH = 0.05
"""Bins, least width of a band: the error of its frequency."""
SAME_LINE = 0.03
"""Relative difference of frequency within which lines of two stages are the same."""
MAINS_HZ = (50.0, 60.0)
HARMONICS = 3
"""Highest harmonic of the mains that is a candidate."""
MAINS_SPREAD = 0.002
"""Relative deviation of the mains frequency from its nominal value that is common."""


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
    """

    frequency_hz: float
    width_hz: float
    power: float
    peak_hz: float
    peak_power: float
    prominence: float

    def line(self, sampling: float, resolution: float) -> Line:
        """Return its peak as a line of a signal with a sampling rate, Hz, found in bins of a width, Hz."""
        aliases, name = mains(self.peak_hz, sampling, resolution)
        amplitude = math.sqrt(2.0 * self.peak_power)
        return Line(frequency_hz=self.peak_hz, amplitude=amplitude, aliases_hz=aliases, name=name)


class HasFrequency(Protocol):
    """A line or a narrow band."""

    @property
    def frequency_hz(self) -> float:
        """Hz."""


T = TypeVar("T", bound=HasFrequency)


def median_to_mean(averages: int) -> float:
    """Return the mean of a bin over its median: chi-square with `OVERLAP_DOF` times `averages` degrees."""
    shape = 0.5 * OVERLAP_DOF * averages
    return shape / float(gammaincinv(shape, 0.5))


def find_narrow_bands(
    power: Floats, averages: int, rate: float, band: range
) -> tuple[list[NarrowBand], Bools]:
    """Return the bands of one channel in one level of the spectrum, and (BINS,) the bins that they fill.

    Parameters
    ----------
    power : (BINS,) (channel unit)^2/Hz, one-sided density.
    averages : segments averaged.
    rate : Hz, sampling rate of the level.
    band : bins in which the centroid may be.
    """
    df, nu, to_mean = rate / SEGMENT, OVERLAP_DOF * averages, median_to_mean(averages)
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
            return [], inside
        level = np.sqrt(np.where(np.isfinite(left), left, right) * np.where(np.isfinite(right), right, left))
        inside = np.convolve(high, np.ones(2 * LOBE + 1), "same") > 0.5
    known = np.flatnonzero(level > 0.0)
    if not len(known):
        return [], inside
    # in the middle of a broad band both sides are unknown
    level = np.exp(np.interp(np.arange(BINS), known, np.log(level[known])))
    level[-1] *= 0.5  # as the density at the Nyquist frequency
    bins, bands = np.flatnonzero(inside), []
    for group in np.split(bins, np.flatnonzero(np.diff(bins) > 1) + 1):
        above = power[group] - level[group]
        size, weights = float(above.sum() * df), np.maximum(above, 0.0)
        if size <= 0.0:
            continue
        frequency = float(weights @ group / weights.sum())
        if band.start <= frequency < band.stop:
            variance = float(weights @ (group - frequency) ** 2 / weights.sum())
            # the power of a Hann window in three bins, 1/4, 1, 1/4, has a variance of 1/3
            width = math.sqrt(max(variance - 1.0 / 3.0, LEAST_WIDTH**2))
            core = np.abs(group - group[np.argmax(above)]) <= LOBE
            high_power = float(weights[core].sum())
            peak = float(weights[core] @ group[core]) / high_power
            prominence = float((power[group] / level[group]).max())
            bands.append(NarrowBand(frequency * df, width * df, size, peak * df, high_power * df, prominence))
    return bands, inside


def _side_levels(power: Floats) -> Floats:
    """Return (2, BINS) the median density of the `SIDE` bins on the left and on the right of each bin.

    `power` is (BINS,), (channel unit)^2/Hz, as the result, which is NaN if more than half are missing.
    """
    reach = LOBE + SIDE
    padded = np.full(BINS + 2 * reach, np.nan)
    padded[reach + 2 : reach + BINS] = power[2:]
    windows = np.sort(np.lib.stride_tricks.sliding_window_view(padded, SIDE), axis=1)
    known = np.isfinite(windows).sum(axis=1)
    median = windows[np.arange(len(windows)), np.maximum(known - 1, 0) // 2]
    median[known < SIDE // 2] = np.nan
    right = reach + LOBE + 1
    return np.stack((median[:BINS], median[right : right + BINS]))


def distinct(found: list[T], strength: Callable[[T], float]) -> tuple[T, ...]:
    """Return what was found at different frequencies, strongest first: once, not once from each of two levels."""
    out: list[T] = []
    for each in sorted(found, key=strength, reverse=True):
        if all(abs(each.frequency_hz - other.frequency_hz) > SAME_LINE * each.frequency_hz for other in out):
            out.append(each)
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
    order, _, base = min(fits)
    name = f"{base:.0f} Hz mains" + (f", harmonic {order}" if order > 1 else "")
    slow = frequency <= tolerance + MAINS_SPREAD * base * order
    return tuple(sorted({b * o for o, _, b in fits})), None if slow else name
