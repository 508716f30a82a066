"""Narrow bands of the spectrum that hold more power than the density beside them.

A line that is reported to a user is prominent (`spectral_lines`). The Allan variance is a thousand times more
precise than a bin, so that much weaker lines bend it, and real lines wander: a fan changes its speed by a per
cent. Here every group of bins that exceeds its surroundings by more than chance becomes a band with a
frequency, a width and a power. Groups that are found are excluded from the medians of the next pass, so that
a strong line does not hide a weak one beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammainccinv

from imumon.noise.spectrum.spectral_lines import (
    BINS,
    LEVEL_ERRORS,
    LOWEST_BIN,
    MEDIAN_ERROR,
    OVERLAP_DOF,
    SEGMENT,
    SIDE,
    median_to_mean,
    side_levels,
)
from imumon.samples import Bools, Floats

BAND_CHANCE = 1e-6
"""Probability that noise alone makes a band of a bin: one false band in about 200 reports of nine channels, and
its power is small."""
PASSES = 3
"""Searches, each with the medians of the bins that the one before left."""
LOBE_BINS = 2
"""Bins on each side of a bin that the main lobe of the window fills."""
WINDOW_WIDTH = 0.58
"""Bins, root mean square width of the main lobe of the Hann window's power: the part of a measured width that
is not the line's."""
LEAST_WIDTH = 0.05
"""Bins, least width of a band: the error of its frequency."""


@dataclass(frozen=True, slots=True)
class NarrowBand:
    """Power above the density beside it.

    Attributes
    ----------
    frequency_hz : Hz, centroid.
    width_hz : Hz, root mean square deviation of the frequency.
    power : (channel unit)^2, variance of the samples that it makes: a^2/2 of a sinusoid of amplitude a.
    """

    frequency_hz: float
    width_hz: float
    power: float


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
    margin = 1.0 + LEVEL_ERRORS * MEDIAN_ERROR * np.sqrt(2.0 / nu / SIDE)
    least = 2.0 * float(gammainccinv(0.5 * nu, BAND_CHANCE)) / nu * margin
    inside, level = np.zeros(BINS, dtype=bool), power
    for _ in range(PASSES):
        left, right = side_levels(np.where(inside, np.nan, power)[None])[:, 0] * to_mean
        higher = np.fmax(left, right)
        high = (power > least * higher) | (inside & np.isnan(higher))
        high[:LOWEST_BIN] = False
        if not high.any():
            return [], inside
        level = np.sqrt(np.where(np.isfinite(left), left, right) * np.where(np.isfinite(right), right, left))
        inside = _widened(high)
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
            variance = float(weights @ (group - frequency) ** 2 / weights.sum()) - WINDOW_WIDTH**2
            width = np.sqrt(max(variance, LEAST_WIDTH**2))
            bands.append(NarrowBand(frequency * df, float(width * df), size))
    return bands, inside


def _widened(high: Bools) -> Bools:
    """Return the bins that are high or within the main lobe of one that is."""
    wide = high.copy()
    for step in range(1, LOBE_BINS + 1):
        wide[step:] |= high[:-step]
        wide[:-step] |= high[step:]
    return wide
