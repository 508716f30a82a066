"""Extreme values: whether a channel ends at a limit of its range or of its converter.

Noise visits its extremes once: with steps that are finer than its spread, the outermost level has fewer samples than
the levels within (any density that falls outwards). A range that is too small gathers all that lies beyond it in one
value, which comes again and again. For Gaussian noise that is clipped at c standard deviations, the share of it is
Q(c): 0.3 at half of one, 3e-5 at four.

Visits count, not samples: a value that is held for many samples, because the sensor is slower than its output, is one
visit.

>>> extremes = ExtremeVisits([0])
>>> extremes.update(np.array([[3.0], [1.0], [3.0], [3.0], [2.0], [3.0]]))
>>> extremes.result()[0]
Extremes(low=1.0, high=3.0, low_visits=1, high_visits=3)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import restorable
from imumon.noise.statistics.distribution_shape import DistributionShape
from imumon.noise.statistics.histogram import ROUNDED_GAP

LEAST_VISITS = 5
"""With fewer, an extreme value is no limit of the range. Unit: visits.

Otherwise: values with fine steps meet once in a while by chance.
"""
NEXT_ERRORS = 4.0
"""Chance may change a number of samples by this many of its errors. Unit: standard errors.

Otherwise: a level with few samples is called a limit of the range by chance.
"""
LEAST_LEVELS = 4
"""With fewer from the least to the greatest value, nothing is said of a range. Unit: quantisation steps.

Otherwise: where levels are few, the outermost one may be the usual one.
"""


@dataclass(frozen=True, slots=True)
class Extremes:
    """Extreme values of one channel, channel unit, and how often each was visited."""

    low: float
    high: float
    low_visits: int
    high_visits: int

    def clipped_at(self, shape: DistributionShape) -> tuple[float, ...]:
        """Return the values at which the channel is clipped: none, one or both.

        Parameters
        ----------
        shape : distribution of the same samples.
        """
        if shape.step and self.high - self.low < LEAST_LEVELS * shape.step:
            return ()
        # whole bins, not levels: printed digits are finer than the steps of a converter, and most levels are empty
        inner = (0, 0, *shape.counts[1:-1], 0, 0)
        sides = ((self.low, self.low_visits, inner[2:4]), (self.high, self.high_visits, inner[-3:-5:-1]))
        return tuple(value for value, visits, beside in sides if _gathers(visits, *beside))


def _gathers(visits: int, beside: float, within: float) -> bool:
    """Return whether an extreme value gathers what lies beyond it.

    Parameters
    ----------
    beside, within : samples of the bin beside its own, and of the one after that.
    """
    more = visits > beside + NEXT_ERRORS * math.sqrt(beside)
    falls = beside <= 1.1 * within + NEXT_ERRORS * math.sqrt(within)  # of equal ones, one is a little higher
    return visits >= LEAST_VISITS and more and falls


@restorable
class ExtremeVisits:
    """Extremes of some channels and their visits.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1; the channels of a group share their validity.
    """

    def __init__(self, groups: Sequence[int]) -> None:
        self._groups = list(groups)
        # the least value, and the greatest one with its sign changed: both are a minimum
        self._values = np.full((2, len(self._groups)), np.nan)
        self._visits = np.zeros((2, len(self._groups)), dtype=np.int64)
        self._there = np.zeros((2, len(self._groups)), dtype=bool)  # whether the last sample was at it

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples (n, c), channel unit, of which those with `valid` (n, g) count; None: all."""
        if not len(values):
            return
        for side, sign in enumerate((1.0, -1.0)):
            x = sign * values if valid is None else np.where(valid[:, self._groups], sign * values, np.inf)
            least = x.min(axis=0)
            before = np.where(np.isnan(self._values[side]), np.inf, self._values[side])
            further = least < before - ROUNDED_GAP * np.abs(
                before, where=before < np.inf, out=np.zeros_like(before)
            )
            self._values[side, further] = least[further]
            self._visits[side, further], self._there[side, further] = 0, False
            # a scale, or printed digits, may round one value to two
            near = self._values[side] + ROUNDED_GAP * np.abs(self._values[side])
            for channel in np.flatnonzero((least <= near) | self._there[side]).tolist():
                there = x[:, channel] <= near[channel]
                arrivals = there[1:] & ~there[:-1]
                first = there[0] and not self._there[side, channel]
                self._visits[side, channel] += np.count_nonzero(arrivals) + first
                self._there[side, channel] = there[-1]

    def result(self) -> list[Extremes | None]:
        """Return the extremes of each channel; None without a sample."""
        return [
            None if np.isnan(low) else Extremes(float(low), -float(high), int(visits[0]), int(visits[1]))
            for low, high, visits in zip(*self._values, self._visits.T, strict=True)
        ]
