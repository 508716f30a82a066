"""Spectral lines: frequencies that exceed the power density beside them, and their possible causes.

A line is a bin that exceeds the higher of the medians of the bins on both sides, by more than chance does in a
thousand reports. Sampled signals fold: a line at f may be any |k rate +- f|, so mains and its harmonics are
candidates. This module does not depend on how a density is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np
from scipy.special import gammainccinv, gammaincinv

from imumon.report import Line
from imumon.samples import Floats

SEGMENT = 256
"""Samples of a periodogram: each stage of the cascade resolves two octaves."""
HOP = SEGMENT // 2
BINS = HOP + 1
LINE_CHANCE = 1e-8
"""Probability that noise alone makes a line of a bin: one line in a thousand reports of nine channels."""
PROMINENCE = 2.0
"""Least ratio of the bin of a line to the density beside it: less does not matter to a user."""
SIDE = 11
"""Bins on each side of a bin whose median is the level there."""
GUARD = 3
"""Bins between these and the bin, which the line may fill: the main lobe of the window is four wide."""
_WINDOWS = np.add.outer(np.arange(BINS + 2 * GUARD + SIDE + 1), np.arange(SIDE))  # bins of each stretch
LOWEST_BIN = 12
"""First bin in which a line is sought: below, a drift exceeds the bins beside it."""
MAINS_HZ = (50.0, 60.0)
HARMONICS = 3
"""Highest harmonic of the mains that is a candidate."""
MAINS_SPREAD = 0.002
"""Relative deviation of the mains frequency from its nominal value that is common."""
LINE_SPACING = 4.5
"""Bins, least distance of two lines: the side lobes of a line are nearer."""
SAME_LINE = 0.03
"""Relative difference of frequency within which lines of two stages are the same."""
LINE_ERROR_BINS = 0.75
"""Bins by which the frequency of a line may be wrong, for its name."""
OVERLAP_DOF = 1.89
"""Degrees of freedom of a bin per average: half overlap costs 1 + 2 (1/6)^2 (Welch 1967)."""
LEVEL_ERRORS = 3.0
"""Standard errors of the median beside a bin by which the threshold is higher."""
MEDIAN_ERROR = 1.25
"""Standard error of a median over that of a mean, sqrt(pi / 2)."""
LEAST_AMPLITUDE = 1e-10
"""Amplitude of a line, as a share of the size of the values, below which it may be their rounding."""


def median_to_mean(averages: int) -> float:
    """Return the mean of a bin over its median: chi-square with `OVERLAP_DOF` times `averages` degrees."""
    shape = 0.5 * OVERLAP_DOF * averages
    return shape / float(gammaincinv(shape, 0.5))


class HasFrequency(Protocol):
    """A line or a narrow band."""

    @property
    def frequency_hz(self) -> float:
        """Hz."""


T = TypeVar("T", bound=HasFrequency)


def side_levels(power: Floats) -> Floats:
    """Return (2, c, BINS) the median density of the `SIDE` bins on the left and on the right of each bin.

    `power` is (c, BINS), (channel unit)^2/Hz, as the result, which is NaN if more than half are missing.
    """
    reach = GUARD + SIDE
    padded = np.full((len(power), BINS + 2 * reach), np.nan)
    padded[:, reach + 2 : reach + BINS] = power[:, 2:]
    windows = padded[:, _WINDOWS]
    windows.sort(axis=2)
    known = np.isfinite(windows).sum(axis=2)
    middle = np.maximum(known - 1, 0)[:, :, None] // 2
    median = np.take_along_axis(windows, middle, axis=2)[:, :, 0]
    median[known < SIDE // 2] = np.nan
    right = reach + GUARD + 1
    return np.stack((median[:, :BINS], median[:, right : right + BINS]))


def find_lines(
    power: Floats, sides: Floats, averages: int, rate: float, band: range, sampling: float, size: float
) -> list[Line]:
    """Return the lines of one channel in a band of one stage.

    Parameters
    ----------
    power : (BINS,) (channel unit)^2/Hz, density.
    sides : (2, BINS) (channel unit)^2/Hz, medians on the left and on the right, see `side_levels`.
    averages : segments averaged.
    rate : Hz, sampling rate of the stage.
    band : bins that are searched.
    sampling : Hz, sampling rate of the signal itself, about which frequencies fold.
    size : channel unit, of the values.
    """
    df = rate / SEGMENT
    nu = OVERLAP_DOF * averages
    to_mean = median_to_mean(averages)
    margin = 1.0 + LEVEL_ERRORS * MEDIAN_ERROR * math.sqrt(2.0 / nu / SIDE)
    chance = 2.0 * float(gammainccinv(0.5 * nu, LINE_CHANCE)) / nu  # of the bin over its mean
    level = np.fmax(sides[0], sides[1]) * to_mean
    out: list[Line] = []
    bins = np.arange(band.start, band.stop)
    high = bins[power[bins] > max(PROMINENCE, chance * margin) * level[bins]]
    for k in sorted(high.tolist(), key=lambda k: -float(power[k])):
        if k < LOWEST_BIN or any(abs(line.frequency_hz - k * df) < LINE_SPACING * df for line in out):
            continue
        around = np.arange(k - 2, min(k + 3, BINS))
        excess = np.maximum(power[around] - float(np.nanmean(sides[:, k])) * to_mean, 0.0)
        frequency = float(excess @ around / excess.sum()) * df
        amplitude = math.sqrt(2.0 * float(excess.sum()) * df)
        if amplitude < LEAST_AMPLITUDE * size:
            continue
        aliases, name = mains(frequency, sampling, LINE_ERROR_BINS * df)
        out.append(Line(frequency_hz=frequency, amplitude=amplitude, aliases_hz=aliases, name=name))
    return out


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
