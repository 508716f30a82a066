"""Quarters of a record: how much N, B and K move from one quarter to the next.

The limits of a fit say how far chance may have moved a coefficient in this record, if the sensor is constant.
Real sensors are not: N moves by 0.5 to 1 % within an hour, a multiple of its limits. The standard deviation
between the quarters shows that. The record is kept as 8 to 15 sums over stretches of equal length; when there
are 16, neighbours are joined and stretches double. A quarter is two to four of them, or one or two while the
record is short or after its warm-up was excluded.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from imumon.noise.allan.curve import WindowSums
from imumon.noise.allan.octave import BLOCK
from imumon.noise.allan.windows import Window, WindowedCascade
from imumon.noise.detection.disturbance import subset

STRETCHES = 16
"""Stretches that are joined in pairs. More make the quarters more equal. Not critical."""
LEAST_STRETCHES = 4
"""Stretches from which on there are quarters. Not critical."""
STRETCH_S = 8.0
"""s, shortest stretch: a quarter then has 16 s, enough for N. Not critical."""


class Quarters:
    """Sums over neighbouring stretches of a record.

    Parameters
    ----------
    cascade : of the record.
    rate_hz : Hz, sampling rate.
    """

    def __init__(self, cascade: WindowedCascade, rate_hz: float) -> None:
        self._cascade = cascade
        self._length = BLOCK * max(1, round(STRETCH_S * rate_hz / BLOCK))
        self._sums: list[WindowSums] = []
        self._start = cascade.position
        self._window: Window = cascade.open_window()

    @property
    def next_end(self) -> int:
        """Samples of the grid at which the stretch in progress ends."""
        return self._start + self._length

    def close_stretch(self) -> None:
        """End the stretch in progress if the record has reached its end."""
        if self._cascade.position < self.next_end:
            return
        if (
            self._cascade.position > self.next_end
        ):  # a gap of hours: the stretches are not neighbours any more
            self._sums = []
            self._begin()
            return
        self._sums.append(self._cascade.block_sums_since(self._window))
        if len(self._sums) == STRETCHES:
            pairs = zip(self._sums[::2], self._sums[1::2], strict=True)
            self._sums = [first + second for first, second in pairs]
            self._length *= 2
        self._begin()

    def discard_before(self, position: int) -> None:
        """Forget the stretches that begin before a position, samples of the grid."""
        first = self._start - len(self._sums) * self._length
        before = -(-(position - first) // self._length)
        self._sums = self._sums[max(0, before) :]
        if position > self._start:
            self._begin()

    def _begin(self) -> None:
        self._cascade.close_window(self._window)
        self._start = self._cascade.position
        self._window = self._cascade.open_window()

    def result(self) -> list[WindowSums] | None:
        """Return the sums of the four quarters; None while the record is too short."""
        if len(self._sums) < LEAST_STRETCHES:
            return None
        bounds = np.linspace(0, len(self._sums), 5).round().astype(int)
        quarters = []
        for begin, end in pairwise(bounds):
            quarter = self._sums[begin]
            for stretch in self._sums[begin + 1 : end]:
                quarter = quarter + stretch
            quarters.append(quarter)
        return quarters

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        number = list(self._cascade.windows).index(self._window)
        out = {"numbers": np.array([self._length, self._start, number], dtype=np.int64)}
        out["count"] = np.array(len(self._sums))
        for number, each in enumerate(self._sums):
            out |= {f"{number}.{name}": value for name, value in each.save().items()}
        return out

    @classmethod
    def restore(cls, cascade: WindowedCascade, rate_hz: float, saved: Mapping[str, np.ndarray]) -> Quarters:
        """Return the quarters in a saved state; the cascade is restored already."""
        self = cls(cascade, rate_hz)
        cascade.close_window(self._window)
        self._length, self._start, number = (int(v) for v in saved["numbers"])
        self._window = cascade.windows[number]
        self._sums = [WindowSums.restore(subset(saved, f"{n}.")) for n in range(int(saved["count"]))]
        return self
