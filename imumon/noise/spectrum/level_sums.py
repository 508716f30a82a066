"""Levels of the spectrum: their segments and bins, and the sums of one level over a record or a part of it.

Level s has the rate of the samples over 2^s. A segment is 256 of its samples under a Hann window, and two of them
overlap by half, one hop. Of each level about one octave of bins is used, in which the filter above it is flat:

    level 0   bins 46 to 127 of 128   0.18 to 0.50 of its rate   11 sub-bands of 8 bins
    others    bins 46 to 91           0.18 to 0.36 of its rate   6 sub-bands

so that all levels together cover every frequency once: bin 92 of a level is bin 46 of the level above it.

>>> sub_bands(1).tolist(), last_bin(1)
([46, 54, 62, 70, 78, 86], 92)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.model.samples import Floats, Ints
from imumon.model.saved_state import restorable

SEGMENT = 256
"""Samples of a segment: bins are 0.6 % to 2 % of their frequency wide, fine enough to leave out a line and little
else."""
HOP = SEGMENT // 2
"""Samples from one segment to the next."""
BINS = np.fft.rfftfreq(SEGMENT).size
FIRST_BIN = 46
"""First bin of a level that is used: below, the level after it resolves better. Level 0 is used up to half the sampling
rate."""
NEAR = FIRST_BIN // 2
"""Bins on each side of a bin from which slow noise counts as that of the bin; what is farther away leaks (`leakage`).
Half the distance from the lowest bin in use to zero."""
SUB_BAND = 8
"""Bins that are added up in the sums of a part of a record: a sixth of the octave. By bin, a mark would be eight times
as large in the saved state."""

HANN = np.square(np.sin(np.pi * np.arange(SEGMENT) / SEGMENT))
"""Hann window of a segment: without it, a strong line or the bias would leak into every bin."""
HANN_POWER = float(HANN @ HANN)

_WAVES = 16
SLOW_WAVES = np.cos(np.pi * np.outer(np.arange(_WAVES), np.arange(SEGMENT) + 0.5) / SEGMENT)
SLOW_WAVES /= np.sqrt((SLOW_WAVES**2).sum(axis=1, keepdims=True))
"""(waves, SEGMENT) orthonormal cosines up to bin 7.5, which leave the bins in use alone. They are subtracted from
segments with missing samples. Of the variance of a random walk a 25th remains, so that much less of it leaks."""
WAVES_PRIOR = np.arange(_WAVES) ** 2 / (_WAVES * SEGMENT)
"""(waves,) added to the diagonal of the equations for the amplitudes of the waves: they are not larger than those of a
random walk. Each is the variance per sample that the waves leave of a walk, over that of the amplitude in it. Without
it, a hole of half a segment makes the amplitudes arbitrary."""


@restorable
@dataclass(frozen=True, slots=True, eq=False)
class LevelSums:
    """Sums of one level over the segments of a record, or of a part of it.

    Attributes
    ----------
    power : (c, n) (channel unit)^2, sums of the squared transforms over `HANN_POWER`, by bin from `FIRST_BIN` on or
        by sub-band.
    holes : (g, n) sums of the density of the shares of valid samples of each segment under the window, over the square
        of their mean; mean of each sub-band. 0 for a segment without missing samples.
    white : (g,) sums of the relative density of white noise, 1 for a segment without missing samples.
    slow : (g,) sums of the relative density of slow noise from frequencies near those of its bin, 1 without any.
    averages : (g,) segments.
    """

    power: Floats
    holes: Floats
    white: Floats
    slow: Floats
    averages: Ints

    def __sub__(self, other: LevelSums) -> LevelSums:
        """Return the sums since the others, which are earlier ones of the same record."""
        return LevelSums(*(getattr(self, name) - getattr(other, name) for name in LevelSums.__slots__))


def last_bin(level: int) -> int:
    """Return the end of the bins that are used of a level."""
    return 2 * FIRST_BIN if level else BINS - 1


def sub_bands(level: int) -> Ints:
    """Return the first bins of the sub-bands of a level."""
    return np.arange(FIRST_BIN, last_bin(level), SUB_BAND)


@restorable
class Level:
    """State of one level: its sums, and the samples that wait for the next segment.

    Parameters
    ----------
    number : of the level.
    channels, groups : number of columns, and of the groups that share their validity.
    """

    def __init__(self, number: int, channels: int, groups: int) -> None:
        self.power = np.zeros((channels, BINS))
        self.holes = np.zeros((groups, sub_bands(number).size))
        self.white, self.slow = np.zeros(groups), np.zeros(groups)
        self.averages = np.zeros(groups, dtype=np.int64)
        self.clear()

    def clear(self) -> None:
        """Discard the samples that wait for a segment."""
        self.hops = 0  # since the last break
        self.last: Floats | None = None  # (c, HOP) the hop before
        self.last_share: Floats | None = None  # (g, HOP) its shares of valid samples; None: all
        self.half: Floats | None = None  # (c, HOP/2) first half of a hop
        self.half_share: Floats | None = None

    def sub_sums(self, level: int) -> LevelSums:
        """Return the present sums by sub-band."""
        power = np.add.reduceat(self.power[:, : last_bin(level)], sub_bands(level), axis=1)
        counts = (self.white.copy(), self.slow.copy(), self.averages.copy())
        return LevelSums(power / HANN_POWER, self.holes.copy(), *counts)
