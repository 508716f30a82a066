"""Spectrum as people see it: density at all frequencies, its lines, and its white level.

One-sided, (channel unit)^2/Hz: twice the mean of the squared transforms, over the rate of the level and the power of
the window. The levels follow each other without a gap, each where it resolves best:

    level s    bins 46 to 91      0.18 to 0.36 of its rate
    level 0    bins 46 to 128     up to half the sampling rate
    last one   bins 2 to 91       down to the lowest frequency; bins 0 and 1 hold the mean and its leakage

The white level comes from the median over the upper half of the band, which lines do not move: the median of a
chi-square is less than its mean, by a factor that the number of averages determines (`spectral_lines.median_to_mean`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.model.samples import Bools, Floats, Ints
from imumon.noise.spectrum.level_sums import BINS, FIRST_BIN, HANN_POWER, SEGMENT, last_bin
from imumon.noise.spectrum.spectral_lines import (
    NarrowBand,
    SpectralLine,
    distinct,
    find_narrow_bands,
    median_to_mean,
)
from imumon.noise.validity_groups import ROUNDING

LEAST_AVERAGES = 4
"""A level with fewer does not count in a fit, and the level above is displayed instead. Unit: averages.

Otherwise: the density of a bin is hardly known, and a level of few averages hides a better one. Origin: with three,
the 95 % limits of a bin span a factor of 13.
"""
PROMINENCE = 2.0
"""A band whose highest bin exceeds it is reported as a line. Unit: of the density beside it.

Otherwise: bands that change no coefficient are named. Chosen: less does not matter to a user.
"""


@dataclass(frozen=True, slots=True, eq=False)
class PowerSpectrum:
    """Power spectral densities of some channels.

    Attributes
    ----------
    frequency_hz : (k,) Hz, rising.
    density : (k, c) (channel unit)^2/Hz, one-sided; NaN where `averages` is 0.
    averages : (k, c) segments averaged in each value.
    lines : lines of each channel, strongest first.
    bands : narrow bands of each channel, also of weak and broad lines, strongest first.
    masks : for each level (c, BINS), the bins of narrow bands.
    white : (c,) channel unit/sqrt(Hz), N from the upper half of the band; NaN below `LEAST_AVERAGES` averages.
    """

    frequency_hz: Floats
    density: Floats
    averages: Ints
    lines: tuple[tuple[SpectralLine, ...], ...]
    bands: tuple[tuple[NarrowBand, ...], ...]
    masks: tuple[Bools, ...]
    white: Floats


def displayed(sums: list[tuple[Floats, Ints]], rate_hz: float, channels: int) -> PowerSpectrum:
    """Return density, lines and white level.

    Parameters
    ----------
    sums : of each level (c, BINS) squared transforms, and (c,) the segments in them.
    rate_hz : Hz, of the first level.
    channels : number of them.
    """
    levels = _densities(sums, rate_hz)
    if not levels:
        empty, none, white = np.zeros((0, channels)), ((),) * channels, np.full(channels, np.nan)
        return PowerSpectrum(np.zeros(0), empty, empty.astype(np.int64), none, none, (), white)
    frequency, density, averages = [], [], []
    bands: list[list[NarrowBand]] = [[] for _ in range(channels)]
    masks: list[Bools] = []
    # (channel unit)^2/Hz: beside a strong line a channel without noise has rounding only, where any bin may be a peak
    rounding = ROUNDING**2 * np.nansum(levels[0][1], axis=1)
    for s, (rate, power, count) in reversed(list(enumerate(levels))):
        low, high = _shown(s, len(levels))
        frequency.append(np.arange(low, high) * rate / SEGMENT)
        density.append(power[:, low:high].T)
        averages.append(np.broadcast_to(count, (high - low, len(count))))
        inside = np.zeros(power.shape, dtype=bool)
        for i in np.flatnonzero(count >= LEAST_AVERAGES).tolist():
            above_rounding = np.maximum(power[i], rounding[i])
            level_bands, inside[i] = find_narrow_bands(above_rounding, int(count[i]), rate, range(low, high))
            bands[i] += level_bands
        masks.insert(0, inside)
    of_channels = [distinct(of_levels) for of_levels in bands]
    lines = (
        [band.line(rate_hz) for band in of_channel if band.prominence > PROMINENCE]
        for of_channel in of_channels
    )
    return PowerSpectrum(
        frequency_hz=np.concatenate(frequency),
        density=np.concatenate(density),
        averages=np.concatenate(averages),
        lines=tuple(tuple(sorted(of_channel, key=lambda line: -line.amplitude)) for of_channel in lines),
        bands=tuple(of_channels),
        masks=tuple(masks),
        white=np.array([_white(p, int(k)) for p, k in zip(*levels[0][1:], strict=True)]),
    )


def _densities(sums: list[tuple[Floats, Ints]], rate_hz: float) -> list[tuple[float, Floats, Ints]]:
    """Return rate, Hz, (c, BINS) density and (c,) segments of the levels down to the last with enough segments.

    The first level counts whatever it has, so that a record of two seconds shows something.
    """
    enough = [s for s, (_, count) in enumerate(sums) if (count >= LEAST_AVERAGES).any()]
    out = []
    for s, (total, count) in enumerate(sums[: max(enough, default=0) + 1]):
        rate = rate_hz / 2.0**s
        with np.errstate(invalid="ignore", divide="ignore"):
            power = total * (2.0 / (rate * HANN_POWER)) / count[:, None]
        # mean and Nyquist frequency have no second side
        power[:, 0] *= 0.5
        power[:, -1] *= 0.5
        power[count == 0] = np.nan
        out.append((rate, power, count))
    return out


def _shown(s: int, levels: int) -> tuple[int, int]:
    """Return the range of bins of level s that are displayed and searched for lines."""
    return 2 if s + 1 == levels else FIRST_BIN, last_bin(s) if s else BINS


def _white(power: Floats, averages: int) -> float:
    """Return N from the median density in the upper half of the band, unit/sqrt(Hz)."""
    if averages < LEAST_AVERAGES:
        return math.nan
    # the bins next to the Nyquist frequency share its power through the window
    median = float(np.median(power[BINS // 2 : BINS - 3]))
    return math.sqrt(0.5 * median * median_to_mean(averages))
