"""Live stamps: times for samples that arrive with stamps of any quality.

A recording shows all its stamps at once (`timestamps`); here they come one after the other, and the rate may
change. The first stamps show what they are:

- Stamps of a sample clock step by whole intervals. They are used as they are, but for single late ones
  (`late_stamps`); `sample_clock` places them.
- Stamps of a host are late or in batches. `HostStamps` finds the samples lost before each row, and the times are
  those of an even grid that follows the stamps slowly.
- Stamps that do not change, or show no possible rate, are missing: the time of publication is used instead, as stamps
  of a host, and if that is no better, the time of arrival.

Both checks are repeated: stamps that turn uneven, and a rate that changes, begin a new grid. This module reads no
clock: times in, times out.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from imumon.samples import FASTEST_HZ, SLOWEST_HZ, Floats, Ints
from imumon.timebase.interval import CLOCK_SLACK_S, RATE_TOLERANCE
from imumon.timebase.late_stamps import LateStamps
from imumon.timebase.timestamps import (
    AHEAD_S,
    FEW_STEPS,
    LONG_WINDOW,
    HostStamps,
    is_coarse,
    rate_obstacle,
    stamp_interval,
)

FIRST_ROWS = 128
"""Rows whose stamps are assessed first; the number doubles while they are uneven."""

DECIDE_S = 10.0
"""s of rows after which a decision is due."""

LATEST_S = 60.0
"""s after which it is made with however many rows."""

CHECK_ROWS = 2048
"""Rows after which the decision is checked: 10 s at 200 Hz."""

FOLLOW = 0.01
"""Intervals per sample by which the grid may follow the stamps, so that no step gets ambiguous."""

WRONG_STAMPS = 8
"""Stamps in a row that differ by `CLOCK_SLACK_S` from the time of arrival, after which the clock was set."""

COARSE = "its time stamps are too coarse for its rate: only their mean rate is used"
UNEVEN = "its time stamps are late or in batches, as those of a host: only their mean rate is used"
ROUGH_LOSSES = ", and single missing samples cannot be detected"
MISSING = "its header.stamp is not set: the time of publication is used"
UNUSABLE = "neither header.stamp nor the time of publication is usable: the time of arrival is used"


class RowColumn(IntEnum):
    """Columns of the rows that wait; the first three are times, the best first."""

    STAMPS = 0
    PUBLISHED = 1
    ARRIVED = 2
    LOST = 3


class LiveStamps:
    """Times of samples, from their stamps.

    Parameters
    ----------
    resolution : ns to which the stamps are rounded; 0: to much less than their steps.

    Attributes
    ----------
    remark : what is wrong with the stamps, one line; None: nothing, or not decided yet.
    """

    def __init__(self, resolution: float = 0.0) -> None:
        self.remark: str | None = None
        self._resolution = resolution
        self._steady: bool | None = None  # None: undecided
        self._used = RowColumn.STAMPS  # column of the times that are used
        self._waiting = np.empty((0, 4), np.int64)  # not decided
        self._next_rows = FIRST_ROWS
        self._recent = np.empty(0, np.int64)  # stamps since the last check
        self._doubts = 0  # checks in a row that contradict the decision
        self._origin = 0  # ns; times below are relative to it
        self._late: LateStamps | None = None  # of steady stamps
        self._host: HostStamps | None = None
        self._interval = 0.0  # ns, of host stamps
        self._lost = 0  # messages known to be lost, which `HostStamps` does not count again
        self._lost_before = np.empty(0, np.int64)  # the same, before each row that waits there
        self._at: float | None = None  # ns, the last time that was returned
        self._last: tuple[int, int] | None = None  # stamp and arrival of the last good row
        self._wrong = 0  # stamps in a row that are far off

    @property
    def decided(self) -> bool:
        """Whether it is known what the stamps are."""
        return self._steady is not None

    def place(self, stamps: Ints, published: Ints, arrived: Ints, lost: Ints, *, final: bool = False) -> Ints:
        """Return the times of the oldest rows that wait, ns; the others wait for rows after them.

        Parameters
        ----------
        stamps : (n,) ns, of the next rows.
        published : (n,) ns, when they were published, by the clock of the publisher.
        arrived : (n,) ns, when they arrived, by the host clock.
        lost : (n,) messages known to be lost before each.
        final : these are the last rows.
        """
        rows = np.stack([stamps, published, arrived, lost], axis=1).astype(np.int64)
        earlier = np.empty(0, np.int64)
        if self._steady is None:
            self._waiting = np.concatenate([self._waiting, rows])
            self._decide(final)
            if self._steady is None:
                return earlier
            rows, self._waiting = self._waiting, self._waiting[:0]
        elif (recent := self._contradicting(rows)) is not None:
            earlier = self._times(rows[:0], final=True)
            self._begin_grid(recent)
        return np.concatenate([earlier, self._times(rows, final)])

    def _decide(self, final: bool) -> None:
        """Decide what the stamps are, if the waiting rows show it."""
        count = len(self._waiting)
        span_s = float(np.ptp(self._waiting[:, RowColumn.ARRIVED])) * 1e-9 if count else 0.0
        due = final or (span_s >= DECIDE_S and count >= LONG_WINDOW) or span_s >= LATEST_S
        if not count or (not due and (count < FEW_STEPS or (count < self._next_rows and span_s < DECIDE_S))):
            return
        self._next_rows = max(self._next_rows, 2 * count)
        stamps = self._waiting[:, RowColumn.STAMPS]
        found = self._interval_of(stamps)
        if not due and not (found is not None and found[1]):
            return
        times = (RowColumn.STAMPS, RowColumn.PUBLISHED, RowColumn.ARRIVED)
        usable = [each for each in times if self._interval_of(self._waiting[:, each]) is not None]
        self._used = usable[0] if usable else RowColumn.STAMPS
        self._origin = int(self._waiting[0, self._used])
        self._begin_grid(self._waiting[:, self._used])

    def _begin_grid(self, times: Ints) -> None:
        """Use stamps like (n,) `times` as they are, or begin an even grid for them."""
        found = self._interval_of(times)
        self._steady = found is None or (found[1] and self._used == RowColumn.STAMPS)
        self.remark = {RowColumn.STAMPS: None, RowColumn.PUBLISHED: MISSING, RowColumn.ARRIVED: UNUSABLE}[
            self._used
        ]
        self._late, self._host, self._last, self._at = None, None, None, None
        if found is None:
            return
        if self._steady:
            self._late = LateStamps(found[0])
            return
        self._interval = found[0]
        self._host = HostStamps((times - self._origin).astype(np.float64), self._interval)
        self._lost, self._lost_before = 0, np.empty(0, np.int64)
        if self._used == RowColumn.STAMPS:
            coarse = is_coarse(self._interval, self._resolution)
            self.remark = (COARSE if coarse else UNEVEN) + (ROUGH_LOSSES if self._host.rough else "")

    def _contradicting(self, rows: Ints) -> Ints | None:
        """Return the last stamps if they contradict the decision for the second time in a row."""
        self._recent = np.concatenate([self._recent, rows[:, self._used]])
        if len(self._recent) < CHECK_ROWS:
            return None
        recent, self._recent = self._recent, self._recent[:0]
        found = self._interval_of(recent)
        if found is None:
            return None
        interval, steady = found
        if steady and self._late is not None:
            self._late.interval = interval
        differs = not steady if self._steady else abs(interval / self._interval - 1.0) > RATE_TOLERANCE
        self._doubts = self._doubts + 1 if differs else 0
        if self._doubts < 2:
            return None
        self._doubts = 0
        return recent

    def _times(self, rows: Ints, final: bool) -> Ints:
        """Return the times of the oldest rows that wait, ns."""
        if self._host is not None:
            return self._even_times(self._host, rows, final)
        if self._late is not None:
            return self._late.place(rows[:, RowColumn.STAMPS], rows[:, RowColumn.LOST], final=final)
        return rows[:, RowColumn.STAMPS]

    def _even_times(self, host: HostStamps, rows: Ints, final: bool) -> Ints:
        """Return times on an even grid that follows the stamps, ns."""
        lost = self._lost + np.cumsum(rows[:, RowColumn.LOST])
        self._lost = int(lost[-1]) if len(lost) else self._lost
        self._lost_before = np.concatenate([self._lost_before, rows[:, RowColumn.LOST]])
        missing = host.place(self._plausible(rows) - lost * self._interval)
        times = self._after(missing, follow=True)
        if final:  # no later row shows whether these are late or behind a loss
            rest = self._after(np.zeros(len(self._lost_before), np.int64), follow=False)
            times = np.concatenate([times, rest])
        return times

    def _after(self, missing: Ints, *, follow: bool) -> Ints:
        """Return the times of the oldest rows that wait, with (n,) samples missing before each.

        Parameters
        ----------
        follow : these rows have been placed by `HostStamps`, which knows the time of the last.
        """
        count = len(missing)
        if not count or self._host is None:
            return missing
        known, self._lost_before = self._lost_before[:count], self._lost_before[count:]
        ahead = np.cumsum(1 + missing + known) * self._interval
        lost_by_now = self._lost - int(self._lost_before.sum())
        last = self._host.next_ns + (lost_by_now - 1) * self._interval  # by the stamps, of the last row
        if not follow:
            last += count * self._interval
        if self._at is None:
            self._at = last - float(ahead[-1])
        off = last - self._at - float(ahead[-1])
        if abs(off) > max(AHEAD_S * 1e9, 2.0 * self._interval):
            self._at += off
        elif follow:
            most = FOLLOW * self._interval
            ahead += np.arange(1, count + 1) * min(max(off / count, -most), most)
        times: Ints = self._origin + np.rint(self._at + ahead).astype(np.int64)
        self._at += float(ahead[-1])
        return times

    def _plausible(self, rows: Ints) -> Floats:
        """Return the times of rows, ns since the origin; those that are far off follow the arrival."""
        times = np.empty(len(rows))
        for k, (stamp, arrived) in enumerate(rows[:, [self._used, RowColumn.ARRIVED]].tolist()):
            if self._last is not None:
                expected = self._last[0] + arrived - self._last[1]
                far = abs(stamp - expected) > CLOCK_SLACK_S * 1e9
                self._wrong = self._wrong + 1 if far else 0
                if far and self._wrong < WRONG_STAMPS:
                    times[k] = expected - self._origin
                    continue
            self._last = (stamp, arrived)
            times[k] = stamp - self._origin
        return times

    def _interval_of(self, stamps: Ints) -> tuple[float, bool] | None:
        """Return the interval of stamps, ns, and whether they are those of a sample clock; None: they show none."""
        relative = (stamps - stamps[0]).astype(np.float64)
        if rate_obstacle(relative) is not None:
            return None
        found = stamp_interval(relative, self._resolution)
        return found if SLOWEST_HZ <= 1e9 / found[0] <= FASTEST_HZ else None
