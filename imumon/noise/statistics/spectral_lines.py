"""Lines: frequencies that stand out of a power spectral density, and what may stand behind them.

A line is a bin that exceeds the median of the bins on both sides, the higher of the two, by more than chance
makes in a thousand reports. Sampled signals fold: a line at f may be any |k rate +- f|, so mains and its
harmonics are tried and told as candidates. This file does not know how a density is measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.samples import Floats

SEGMENT = 256
HOP = SEGMENT // 2
BINS = HOP + 1
CHANCE_SIGMA = 5.6
"""Standard deviations (of the normalised bin) that a line stands out by: 1e-8 a bin."""
PROMINENCE = 2.0
"""A line's bin holds at least so many times the density beside it."""
SIDE, GUARD = 11, 3
"""Bins beside one that tell the level there, and those between that its own line may fill."""
_WINDOWS = np.add.outer(np.arange(BINS + 2 * GUARD + SIDE + 1), np.arange(SIDE))  # bins of each stretch
LOWEST = 12
"""First bin in which a line is looked for: below, a drift looks like one."""
MAINS_HZ = (50.0, 60.0)
HARMONICS = 3
MAINS_WANDER = 0.002
"""Relative deviation of the mains frequency that is common."""
ROUNDING = 1e-10
"""Amplitude of a line, as a share of the size of the numbers, below which it may be their rounding."""


@dataclass(frozen=True, slots=True)
class SpectralLine:
    """A line.

    Attributes
    ----------
    frequency_hz : Hz, as it appears.
    amplitude : channel unit, of the sinusoid.
    aliases_hz : Hz, frequencies of mains and harmonics that would appear there.
    name : what it may be, where one fits.
    """

    frequency_hz: float
    amplitude: float
    aliases_hz: tuple[float, ...]
    name: str | None


def beside(power: Floats) -> Floats:
    """Median density of the `SIDE` bins to the left and to the right of each, beyond a guard.

    Parameters
    ----------
    power : (c, BINS) (channel unit)^2/Hz.

    Returns
    -------
    (2, c, BINS) (channel unit)^2/Hz; NaN where more than half of them are missing.
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
) -> list[SpectralLine]:
    """Lines of one channel in a band of one stage.

    Parameters
    ----------
    power : (BINS,) (channel unit)^2/Hz, density.
    sides : (2, BINS) (channel unit)^2/Hz, medians left and right, see `beside`.
    averages : segments behind the density.
    rate : Hz, sampling rate of the stage.
    band : bins to look at.
    sampling : Hz, sampling rate of the signal itself, about which frequencies fold.
    size : channel unit, of the numbers.
    """
    df = rate / SEGMENT
    nu = 1.89 * averages  # degrees of freedom of a bin: overlap costs 1 + 2 (1/6)^2 (Welch 1967)
    to_mean = 1.0 / (1.0 - 2.0 / (9.0 * nu)) ** 3  # from the median of chi-square to its mean
    unsure = 1.0 + 3.0 * 1.25 * math.sqrt(2.0 / nu / SIDE)
    # Wilson-Hilferty quantile of chi-square over nu.
    chance = (1.0 - 2.0 / (9.0 * nu) + CHANCE_SIGMA * math.sqrt(2.0 / (9.0 * nu))) ** 3
    level = np.fmax(sides[0], sides[1]) * to_mean
    out: list[SpectralLine] = []
    bins = np.arange(band.start, band.stop)
    high = bins[power[bins] > max(PROMINENCE, chance * unsure) * level[bins]]
    for k in sorted(high.tolist(), key=lambda k: -float(power[k])):
        if k < LOWEST or any(abs(line.frequency_hz - k * df) < 4.5 * df for line in out):
            continue
        around = np.arange(k - 2, min(k + 3, BINS))
        excess = np.maximum(power[around] - float(np.nanmean(sides[:, k])) * to_mean, 0.0)
        frequency = float(excess @ around / excess.sum()) * df
        amplitude = math.sqrt(2.0 * float(excess.sum()) * df)
        if amplitude < ROUNDING * size:
            continue
        aliases, name = mains(frequency, sampling, 0.75 * df)
        out.append(SpectralLine(frequency, amplitude, aliases, name))
    return out


def distinct(lines: list[SpectralLine]) -> tuple[SpectralLine, ...]:
    """Strongest first; one that two stages saw at their border is told once."""
    out: list[SpectralLine] = []
    for line in sorted(lines, key=lambda line: -line.amplitude):
        if all(abs(line.frequency_hz - other.frequency_hz) > 0.03 * line.frequency_hz for other in out):
            out.append(line)
    return tuple(out)


def mains(frequency: float, sampling: float, tolerance: float) -> tuple[tuple[float, ...], str | None]:
    """Frequencies of mains and harmonics that appear at `frequency` when sampled, all in Hz; and the
    likeliest. What is slower than the mains wander has no name: any drift appears there.

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
            if miss <= tolerance + MAINS_WANDER * true:
                fits.append((order, miss, base))
    if not fits:
        return (), None
    order, _, base = min(fits)
    name = f"{base:.0f} Hz mains" + (f", harmonic {order}" if order > 1 else "")
    slow = frequency <= tolerance + MAINS_WANDER * base * order
    return tuple(sorted({b * o for o, _, b in fits})), None if slow else name
