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

from imumon.noise.statistics.spectral_lines import (
    BINS,
    LEVEL_ERRORS,
    LOWEST_BIN,
    MEDIAN_ERROR,
    OVERLAP_DOF,
    SAME_LINE,
    SEGMENT,
    SIDE,
    median_to_mean,
    side_levels,
)
from imumon.samples import Bools, Floats

BAND_CHANCE = 1e-6
"""Probability that noise alone makes a band of a bin: one false band in about 200 reports of nine channels, and
its power is small. Not critical."""
PASSES = 3
"""Searches, each with the medians of the bins that the one before left. Not critical."""
LOBE_BINS = 2
"""Bins on each side of a bin that the main lobe of the window fills. Not critical."""
WINDOW_WIDTH = 0.58
"""Bins, root mean square width of the main lobe of the Hann window's power: the part of a measured width that
is not the line's. Not critical."""
LEAST_WIDTH = 0.05
"""Bins, least width of a band: the error of its frequency. Not critical."""
TAIL_BINS = 3
"""Bins on each side of a band whose mean shows the tail of a resonance. Beyond the edge, at g bins from its centre,
a tail that falls as 1/f^2 holds g times the density of the edge. Not critical."""
LEVEL_ERROR = 0.02
"""1, relative error of the density under a band. Not critical."""


@dataclass(frozen=True, slots=True)
class NarrowBand:
    """Power above the density beside it.

    Attributes
    ----------
    frequency_hz : Hz, centroid.
    width_hz : Hz, root mean square deviation of the frequency.
    power : (channel unit)^2, variance of the samples that it makes: a^2/2 of a sinusoid of amplitude a.
    error : (channel unit)^2, standard error of `power` as that of the line in these very samples: of the noise
        beside it, and of what both have in common.
    """

    frequency_hz: float
    width_hz: float
    power: float
    error: float


@dataclass(frozen=True, slots=True, eq=False)
class QuietDensity:
    """Density of a channel with its narrow bands replaced by the density beside them.

    Attributes
    ----------
    density : (BINS,) (channel unit)^2/Hz, one-sided.
    replaced : (BINS,) bins of bands.
    tails : (BINS,) (channel unit)^2/Hz, what resonances may leave beside their bands, all of one sign.
    averages : segments averaged.
    rate_hz : Hz, sampling rate.
    """

    density: Floats
    replaced: Bools
    tails: Floats
    averages: int
    rate_hz: float


def find_narrow_bands(
    power: Floats, averages: int, rate: float, band: range
) -> tuple[list[NarrowBand], QuietDensity | None]:
    """Return the bands of one channel in one stage of the spectrum, and the density without any; None: it has none.

    Parameters
    ----------
    power : (BINS,) (channel unit)^2/Hz, one-sided density.
    averages : segments averaged.
    rate : Hz, sampling rate of the stage.
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
            return [], None
        level = np.sqrt(np.where(np.isfinite(left), left, right) * np.where(np.isfinite(right), right, left))
        inside = _widened(high)
    known = np.flatnonzero(level > 0.0)
    if not len(known):
        return [], None
    # in the middle of a broad band both sides are unknown
    level = np.exp(np.interp(np.arange(BINS), known, np.log(level[known])))
    level[-1] *= 0.5  # as the density at the Nyquist frequency
    bins, bands, tails = np.flatnonzero(inside), [], np.zeros(BINS)
    for group in np.split(bins, np.flatnonzero(np.diff(bins) > 1) + 1):
        above = power[group] - level[group]
        size, weights = float(above.sum() * df), np.maximum(above, 0.0)
        if size <= 0.0:
            continue
        frequency = float(weights @ group / weights.sum())
        for edge in (group[0] - TAIL_BINS, group[-1] + 1):
            beside = np.arange(max(edge, 0), min(edge + TAIL_BINS, BINS - 1))
            if len(beside):
                rise = max(float(np.mean(power[beside] / level[beside])) - 1.0, 0.0)
                rise = max(rise, float(np.sqrt(2.0 / nu / len(beside))))
                tails[beside] += rise * level[beside] * np.abs(beside - frequency).min() / len(beside)
        if not band.start <= frequency < band.stop:
            continue
        variance = float(weights @ (group - frequency) ** 2 / weights.sum()) - WINDOW_WIDTH**2
        width = np.sqrt(max(variance, LEAST_WIDTH**2))
        noise = level[group] * (level[group] + 2.0 * np.maximum(above, 0.0))
        error = df * np.hypot(np.sqrt(2.0 / nu * noise.sum()), LEVEL_ERROR * level[group].sum())
        bands.append(NarrowBand(frequency * df, float(width * df), size, float(error)))
    # a line at the lowest bins is not removed whole
    whole = not inside[: LOWEST_BIN + LOBE_BINS + 1].any()
    quiet = QuietDensity(np.where(inside, level, power), inside, tails, averages, rate) if whole else None
    return bands, quiet


def _widened(high: Bools) -> Bools:
    """Return the bins that are high or within the main lobe of one that is."""
    wide = high.copy()
    for step in range(1, LOBE_BINS + 1):
        wide[step:] |= high[:-step]
        wide[:-step] |= high[step:]
    return wide


def distinct_bands(bands: list[NarrowBand]) -> tuple[NarrowBand, ...]:
    """Return the bands, strongest first, without duplicates from the border of two stages."""
    out: list[NarrowBand] = []
    for band in sorted(bands, key=lambda band: -band.power):
        if all(abs(band.frequency_hz - other.frequency_hz) > SAME_LINE * band.frequency_hz for other in out):
            out.append(band)
    return tuple(out)
