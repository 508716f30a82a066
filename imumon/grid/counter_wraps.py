"""Counter wraps: times of a counter of 32 or 30 bits, continued over its wraps.

`millis` and `micros` of Arduino wrap at 2^32, `ticks_ms` and `ticks_us` of MicroPython at 2^30. A time that goes back
is a wrap if the step is short with the period added; else the clock has restarted, or the time is wrong. A restart near
the end of a period is taken for a wrap. Live lines and recordings share this decision.

>>> wraps = CounterWraps(1_000_000)
>>> times = np.array([(1 << 32) - 20, (1 << 32) - 10, 0, 10, 5]) * 1_000_000
>>> ((wraps.continued(times) - times) // 1_000_000).tolist(), wraps.count
([0, 0, 4294967296, 4294967296, 4294967296], 1)
"""

from __future__ import annotations

import numpy as np

from imumon.grid.interval import CLOCK_SLACK_S
from imumon.model.samples import Ints

PERIODS = (1 << 30, 1 << 32)
"""Periods of counters, in their units."""


def wrap_ns(last: int, time: int, unit_ns: int) -> int:
    """Return the period, ns, that a counter has wrapped between two times, ns; 0: it has not."""
    for period in (unit_ns * count for count in PERIODS):
        if time < last < period and time + period - last < CLOCK_SLACK_S * 1e9:
            return period
    return 0


class CounterWraps:
    """Continues the times of a counter: `continued` for each block.

    Parameters
    ----------
    unit_ns : ns in a unit of the counter; 0: the times are none of a counter.

    Attributes
    ----------
    count : wraps so far.
    """

    def __init__(self, unit_ns: int) -> None:
        self.count = 0
        self._unit_ns = unit_ns
        self._last: int | None = None  # ns, before its wraps are undone
        self._offset = 0  # ns, of all wraps so far

    def continued(self, times: Ints) -> Ints:
        """Return (n,) ns of the next times, with the periods of all wraps before each added."""
        if not self._unit_ns or not len(times):
            return times
        steps = np.diff(times, prepend=times[0] if self._last is None else self._last)
        offsets = np.full(len(times), self._offset, np.int64)
        for k in np.flatnonzero(steps < 0).tolist():
            last = self._last if k == 0 else int(times[k - 1])
            period = 0 if last is None else wrap_ns(last, int(times[k]), self._unit_ns)
            if period:
                self.count += 1
                self._offset += period
                offsets[k:] = self._offset
        self._last = int(times[-1])
        return np.asarray(times + offsets)
