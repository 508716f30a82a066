"""Sums of one level of the cascade of spectra, its bins in use and its window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.noise.spectrum.spectral_lines import BINS, SEGMENT
from imumon.samples import Floats, Ints

FIRST_BIN = 46
"""First bin of a level that is used. An octave is, in which the filter is flat: the level above begins at twice the
frequency. Level 0 is used up to half the sampling rate."""
SUB_BAND = 8
"""Bins that are added up in the sums of a part of a record: a sixth of the octave."""

WINDOW = np.square(np.sin(np.pi * np.arange(SEGMENT) / SEGMENT))
"""Hann window."""
WINDOW_POWER = float(WINDOW @ WINDOW)


@dataclass(frozen=True, slots=True, eq=False)
class LevelSums:
    """Sums of one level over the segments of a record, or of a part of it.

    Attributes
    ----------
    power : (c, n) (channel unit)^2, sums of the squared transforms over `WINDOW_POWER`, by bin from `FIRST_BIN` on or
        by sub-band.
    white : (g,) sums of the relative density of white noise, 1 for a segment without missing samples.
    holes : (g,) sums of the relative variance of the share of valid samples within each segment.
    averages : (g,) segments.
    """

    power: Floats
    white: Floats
    holes: Floats
    averages: Ints

    def __sub__(self, other: LevelSums) -> LevelSums:
        """Return the sums since the others were taken."""
        return LevelSums(*(getattr(self, name) - getattr(other, name) for name in LevelSums.__slots__))


def last_bin(level: int) -> int:
    """Return the end of the bins that are used of a level."""
    return 2 * FIRST_BIN if level else BINS - 1


def sub_bands(level: int) -> Ints:
    """Return the first bins of the sub-bands of a level."""
    return np.arange(FIRST_BIN, last_bin(level), SUB_BAND)


class Level:
    """State of one level: its sums, and the samples that wait for the next segment."""

    def __init__(self, channels: int, groups: int) -> None:
        self.power = np.zeros((channels, BINS))
        self.white, self.holes = np.zeros(groups), np.zeros(groups)
        self.averages = np.zeros(groups, dtype=np.int64)
        self.clear()

    def clear(self) -> None:
        """Discard the samples that wait for a segment."""
        self.hops = 0  # since the last break
        self.last: Floats | None = None  # (c, HOP) the hop before
        self.last_share: Floats | None = None  # (g, HOP) its shares of valid samples; None: all
        self.half: Floats | None = None  # (c, HOP/2) first half of a hop
        self.half_share: Floats | None = None
        self.waiting: list[tuple[Floats, Floats | None]] = []  # hops (c, n HOP) and their shares (g, n HOP)

    def sub_sums(self, level: int) -> LevelSums:
        """Return the present sums by sub-band."""
        power = np.add.reduceat(self.power[:, : last_bin(level)], sub_bands(level), axis=1)
        return LevelSums(power / WINDOW_POWER, self.white.copy(), self.holes.copy(), self.averages.copy())
