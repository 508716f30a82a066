"""Late stamps: single samples of an otherwise even clock whose stamps are late.

A host that stamps samples is punctual most of the time, and late now and then. A late stamp looks like a lost sample,
and the next one, in time again, like a duplicate of it: both would be wrong. A long step is a loss only if the stamps
stay behind the grid. If one of them is on it again within a second, the samples between were late, and none is lost.
A stamp after the next one is wrong and not late: it stays as it is.

Rows behind a long step wait for those after them; all others pass at once. The result does not depend on the blocks.
This module reads no clock: times in, times out.
"""

from __future__ import annotations

import numpy as np

from imumon.samples import Floats, Ints
from imumon.timebase.interval import AMBIGUOUS, REFERENCE_SAMPLES
from imumon.timebase.timestamps import AHEAD_ROWS, AHEAD_S


class LateStamps:
    """Times of rows with even stamps, of which a few are late.

    Parameters
    ----------
    interval : ns, the sampling interval.

    >>> late = LateStamps(10.0)
    >>> late.place(np.array([0, 10, 20, 38, 40, 50]), np.zeros(6, np.int64)).tolist()
    [0, 10, 20, 30, 40, 50]
    >>> late.place(np.array([60, 80]), np.zeros(2, np.int64)).tolist()  # lost or late?
    [60]
    """

    def __init__(self, interval: float) -> None:
        self.interval = interval
        self._stamps = np.empty(0, np.int64)  # the last rows that were returned, and those that wait
        self._known = np.empty(0, np.int64)  # samples known to be lost before each
        self._returned = 0  # of these rows

    def place(self, stamps: Ints, lost: Ints, *, final: bool = False) -> Ints:
        """Return the times of the oldest rows that wait, ns.

        Parameters
        ----------
        stamps : (n,) ns, of the next rows.
        lost : (n,) samples known to be lost before each: they explain a long step.
        final : these are the last rows.
        """
        stamps = np.concatenate([self._stamps, stamps])
        known = np.concatenate([self._known, lost])
        times, settled, ready = stamps.copy(), max(1, self._returned), len(stamps)
        steps = np.diff(stamps)
        for row in (np.flatnonzero(steps > (1.0 + AMBIGUOUS) * self.interval) + 1).tolist():
            if row < settled or not self._same_rate(steps[max(0, row - 1 - REFERENCE_SAMPLES) : row - 1]):
                continue
            on_time = self._settle(stamps[row - 1 :], known[row:], times[row:], final)
            if on_time is None:
                ready = row
                break
            settled = row + on_time + 1
        found = times[self._returned : ready]
        first = max(0, ready - REFERENCE_SAMPLES - 1)
        self._stamps, self._known, self._returned = stamps[first:], known[first:], ready - first
        return found

    def _same_rate(self, steps: Ints) -> bool:
        """Return whether the steps before a long one are still about one interval."""
        return not len(steps) or abs(float(np.median(steps)) / self.interval - 1.0) < AMBIGUOUS

    def _settle(self, stamps: Ints, known: Ints, times: Ints, final: bool) -> int | None:
        """Put the rows behind a long step that are late on the grid; return how many, None: not known yet.

        Parameters
        ----------
        stamps : (n + 1,) ns, of the row before the step and of those behind it.
        known : (n,) samples known to be lost before each row behind it.
        times : (n,) ns, of these rows; changed in place.
        """
        most = round(AHEAD_S * 1e9 / self.interval) + AHEAD_ROWS
        stamps, known = stamps[: most + 1], known[:most]
        steps = np.diff(stamps)
        places = np.cumsum((steps != 0) + known)  # on the grid, if no other sample was lost
        delays = (stamps[1:] - stamps[0]) / self.interval - places
        # a stamp after the next one is wrong and not late; a negative delay: the losses were others
        back = _first((steps < 0) | (delays < -AMBIGUOUS))
        long_after = _first(stamps[1:] - stamps[1] >= AHEAD_S * 1e9)
        known_to_end = final or len(delays) == most or min(back, long_after) < len(delays)
        delays = delays[: min(back, long_after + 1)]
        on_time = _first(delays <= AMBIGUOUS)
        if on_time >= len(delays):
            if not known_to_end:
                return None
            on_time = _first(delays <= delays.min() + AMBIGUOUS) if len(delays) else 0
        ahead: Floats = (places[on_time] - places[:on_time]) * self.interval
        times[:on_time] = stamps[1 + on_time] - np.rint(ahead).astype(np.int64)
        return on_time


def _first(found: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> int:
    """Return the index of the first True; a large number if there is none."""
    return int(np.argmax(found)) if found.any() else 1 << 60
