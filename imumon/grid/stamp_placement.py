"""Stamp placement: from the stamps of rows to steps of the grid, for stamps that are late.

The package has the model. Here are the two placers that `stamp_kinds.KINDS` names. Both take stamps, with the losses
that are known beside them, and return `PlacedRows`: steps of the grid, and times that a `SampleClock` can follow.

Stamps of a clock, of which a few are late (`LateStamps`)
    A host that stamps samples is punctual most of the time, and late now and then. A late stamp looks like a lost
    sample, and the next one, in time again, like a duplicate of it: both would be wrong. A long step is a loss only if
    the stamps stay behind the grid. If one of them is on it again within a second, the samples between were late, and
    none is lost. Of row i behind the row 0 before the step, with L(i) losses that are known,

        delay(i) = (s(i) - s(0)) / T - (i + L(i))

    and the first row with delay <= `AMBIGUOUS` is on time. Rows before it are put on the grid that ends in it.

Stamps that are all late (`HostStamps`)
    Each is late by another delay: a scheduler, a bus that batches, a stall after which many rows arrive at once. No
    single step says much, but a row that is late is not lost if later rows catch up. So the smallest delay within the
    next second decides. With the lateness l(i) = s(i) / T - i and the losses so far,

        edge(i) = min(l(i), ..., l(i + w - 1)),    w: rows of a second
        lost before row i = round(edge(i) - edge(0) - losses so far), if that is more than half an interval

    The least delayed message says most of a clock: the clock filter of NTP rests on the same (RFC 5905, section 10).

Rows whose step is not decided wait for those after them. This module reads no clock: stamps in, steps out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.grid.interval import AMBIGUOUS, REFERENCE_SAMPLES, SINGLE_EXCESS, WHOLE
from imumon.model.samples import Bools, Floats, Ints

AHEAD_S = 1.0
"""s. A stall that is made up for within this time is a delay; a longer one counts as lost samples."""

AHEAD_ROWS = 32
"""Rows that are looked ahead at least."""

ROUGH_LOSS = 5.0
"""Intervals by which the smallest delay must rise to be lost samples, where single losses do not show."""

ROUGH_LOSS_S = 0.1
"""s, at least, of a loss where single losses do not show."""

FOLLOW = 0.01
"""Intervals per sample by which the times of `HostStamps` may follow the stamps, so that no step gets ambiguous."""


@dataclass(frozen=True, slots=True)
class PlacedRows:
    """The oldest rows that waited, with their places on the grid.

    Attributes
    ----------
    times : (k,) ns, by the clock of the stamps, where a `SampleClock` can follow them.
    steps : (k,) grid steps since the row before, at least 1; of n, n - 1 samples are lost. The first row of all has 1.
        Where the stamps are those of a clock, this is what they show: duplicates and wrong stamps are left to the
        `SampleClock`.
    """

    times: Ints
    steps: Ints

    def __len__(self) -> int:
        return len(self.times)

    def then(self, later: PlacedRows) -> PlacedRows:
        """Return these rows and those that follow them."""
        times, steps = np.concatenate([self.times, later.times]), np.concatenate([self.steps, later.steps])
        return PlacedRows(times, steps)


NO_ROWS = PlacedRows(np.empty(0, np.int64), np.empty(0, np.int64))


class StampPlacer:
    """Base class of what places rows by their stamps.

    Parameters
    ----------
    interval : ns, the sampling interval.

    Attributes
    ----------
    hides_losses : single lost samples do not show in the stamps, only longer gaps.
    back_s : s by which the clock of the stamps stepped back, in total.
    """

    hides_losses = False
    back_s = 0.0

    def __init__(self, interval: float) -> None:
        self.interval = interval

    def place(self, stamps: Ints, lost: Ints, *, final: bool = False) -> PlacedRows:
        """Return the oldest rows that wait; the others wait for rows after them.

        Parameters
        ----------
        stamps : (n,) ns, of the next rows.
        lost : (n,) samples known to be lost before each, whatever the stamps show.
        final : the record ends with these rows: those that are there decide.
        """
        raise NotImplementedError

    def release(self) -> PlacedRows:
        """Return all rows that wait, because the stream is interrupted: none of them counts as behind a loss.

        What a stall has delayed may never arrive then, so that rows which are late look like rows behind a loss.
        """
        return self.place(NO_ROWS.times, NO_ROWS.steps, final=True)


class LateStamps(StampPlacer):
    """Places rows with the stamps of a clock, of which a few are late; all others keep their stamps.

    A stamp after the next one is wrong and not late: it stays as it is. Rows behind a long step wait for those after
    them; all others pass at once. The result does not depend on the blocks.

    >>> late = LateStamps(10.0)
    >>> placed = late.place(np.array([0, 10, 20, 38, 40, 50]), np.zeros(6, np.int64))
    >>> placed.times.tolist(), placed.steps.tolist()
    ([0, 10, 20, 30, 40, 50], [1, 1, 1, 1, 1, 1])
    >>> late.place(np.array([60, 80]), np.zeros(2, np.int64)).times.tolist()  # lost or late?
    [60]
    """

    def __init__(self, interval: float) -> None:
        super().__init__(interval)
        self._stamps = np.empty(0, np.int64)  # the last rows that were returned, and those that wait
        self._known = np.empty(0, np.int64)  # samples known to be lost before each
        self._returned = 0  # of these rows
        self._last: int | None = None  # ns, time of the last row that was returned

    def place(self, stamps: Ints, lost: Ints, *, final: bool = False) -> PlacedRows:
        stamps = np.concatenate([self._stamps, stamps])
        known = np.concatenate([self._known, lost])
        times, settled, ready = stamps.copy(), max(1, self._returned), len(stamps)
        intervals = np.diff(stamps)
        for row in (np.flatnonzero(intervals > (1.0 + AMBIGUOUS) * self.interval) + 1).tolist():
            # behind a change of the rate every step is long, and none of the rows is late
            if row < settled or not self._same_rate(intervals[max(0, row - 1 - REFERENCE_SAMPLES) : row - 1]):
                continue
            late = self._settle(stamps[row - 1 :], known[row:], times[row:], final)
            if late is None:
                ready = row
                break
            settled = row + late + 1
        placed = self._with_steps(times[self._returned : ready])
        # the rows before a long step show whether the rate has changed
        first = max(0, ready - REFERENCE_SAMPLES - 1)
        self._stamps, self._known, self._returned = stamps[first:], known[first:], ready - first
        return placed

    def _with_steps(self, times: Ints) -> PlacedRows:
        """Return rows at (k,) times, ns, with the steps between them."""
        if not len(times):
            return NO_ROWS
        before = int(times[0]) if self._last is None else self._last
        self._last = int(times[-1])
        steps = np.maximum(1, np.rint(np.diff(times, prepend=before) / self.interval)).astype(np.int64)
        return PlacedRows(times, steps)

    def _same_rate(self, intervals: Ints) -> bool:
        """Return whether the steps before a long one, ns, are still about one interval."""
        return not len(intervals) or abs(float(np.median(intervals)) / self.interval - 1.0) < AMBIGUOUS

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
        intervals = np.diff(stamps)
        # a stamp that repeats the one before is that of a duplicate, which has no place of its own
        places = np.cumsum((intervals != 0) + known)  # on the grid, if no other sample was lost
        delays = (stamps[1:] - stamps[0]) / self.interval - places
        # a stamp after the next one is wrong and not late; a negative delay: the losses were others
        back = _first((intervals < 0) | (delays < -AMBIGUOUS))
        long_after = _first(stamps[1:] - stamps[1] >= AHEAD_S * 1e9)
        known_to_end = final or len(delays) == most or min(back, long_after) < len(delays)
        delays = delays[: min(back, long_after + 1)]
        on_time = _first(delays <= AMBIGUOUS)
        if on_time >= len(delays):
            if not known_to_end:
                return None
            # no row is on the grid again: the step is a loss, and the least late row shows how long it is
            on_time = _first(delays <= delays.min() + AMBIGUOUS) if len(delays) else 0
        ahead: Floats = (places[on_time] - places[:on_time]) * self.interval
        times[:on_time] = stamps[1 + on_time] - np.rint(ahead).astype(np.int64)
        return on_time


class HostStamps(StampPlacer):
    """Places rows with the stamps of a host, or with stamps that are too coarse: on an even grid that follows them.

    Rows of the last second wait for those after them.

    Parameters
    ----------
    first : (n,) ns, the first stamps; they show whether single losses can be seen.
    interval : ns, the sampling interval.

    >>> ticks = np.delete(np.arange(500), [200, 201, 202])  # of 100 Hz; three samples are lost
    >>> stamps = (ticks // 10 + 1) * 100_000_000  # ten rows arrive at once
    >>> placed = HostStamps(stamps, 10e6).place(stamps, np.zeros(497, np.int64), final=True)
    >>> int((placed.steps - 1).sum())
    3
    """

    def __init__(self, first: Ints, interval: float) -> None:
        super().__init__(interval)
        # floats count from the first stamp: those of nanoseconds since 1970 would have steps of 256 ns
        self._origin = int(first[0])
        relative = (first - self._origin).astype(np.float64)
        self._window = rows_ahead(interval)
        self.hides_losses = _roughness(relative, interval) > WHOLE
        self._least = max(ROUGH_LOSS, ROUGH_LOSS_S * 1e9 / interval) if self.hides_losses else SINGLE_EXCESS
        self._waiting = np.empty(0)  # ns since the origin, stamps without the known losses
        self._waiting_known = np.empty(0, np.int64)  # losses known before each of these rows
        self._rows = 0  # that have been placed
        self._shown = 0  # losses before these that the stamps show
        self._known = 0  # losses before these that are known
        self._level: float | None = None  # intervals, the smallest delay
        self._time: float | None = None  # ns since the origin, of the last row that was placed

    def place(self, stamps: Ints, lost: Ints, *, final: bool = False) -> PlacedRows:
        # a loss that is known must not show as a delay: it would count twice
        known = self._known + int(self._waiting_known.sum()) + np.cumsum(lost)
        relative = (stamps - self._origin).astype(np.float64) - known * self.interval
        self._waiting = np.concatenate([self._waiting, relative])
        self._waiting_known = np.concatenate([self._waiting_known, lost])
        # at the end of a record fewer rows show less: the last ones may count as behind a loss and be late only
        ready = len(self._waiting) if final else max(0, len(self._waiting) - self._window)
        return self._on_grid(self._shown_losses(ready))

    def release(self) -> PlacedRows:
        return self._on_grid(np.zeros(len(self._waiting), np.int64))

    def _shown_losses(self, ready: int) -> Ints:
        """Return the (ready,) losses that the stamps show before each of the oldest rows."""
        late = self._waiting / self.interval - (self._rows + np.arange(len(self._waiting)))
        edge = sliding_minimum(late, self._window)[:ready]
        losses = np.zeros(ready, dtype=np.int64)
        for k, height in enumerate(edge.tolist()):
            level = height if self._level is None else self._level
            above = height - self._shown - level
            if above > self._least:
                losses[k] = round(above)
                self._shown += int(losses[k])
                above -= int(losses[k])
            if above < -self._window:
                self.back_s -= above * self.interval * 1e-9
            # clocks drift apart slowly; a row that is early shows a smaller delay at once
            self._level = level + (above if above < -SINGLE_EXCESS else above / self._window)
        return losses

    def _on_grid(self, losses: Ints) -> PlacedRows:
        """Return the oldest rows that wait, with (k,) losses that the stamps show before each."""
        count = len(losses)
        if not count:
            return NO_ROWS
        steps = 1 + losses + self._waiting_known[:count]
        self._rows += count
        self._known += int(self._waiting_known[:count].sum())
        self._waiting, self._waiting_known = self._waiting[count:], self._waiting_known[count:]
        return PlacedRows(self._times(steps), steps)

    def _times(self, steps: Ints) -> Ints:
        """Return the times of the next rows, ns, on an even grid that follows the stamps.

        The interval is known to 1e-4 at best, so an even grid alone would leave the stamps by 9 s in a day.
        """
        count = len(steps)
        ahead = np.cumsum(steps) * self.interval
        index = self._rows - 1 + self._shown + self._known  # of the last of these rows
        last = (index + (self._level or 0.0)) * self.interval  # its time by the stamps
        if self._time is None:
            self._time = last - float(ahead[-1])
        off = last - self._time - float(ahead[-1])
        if abs(off) > max(AHEAD_S * 1e9, 2.0 * self.interval):
            self._time += off  # the clock of the host was set: following would take hours
        else:
            most = FOLLOW * self.interval
            ahead += np.arange(1, count + 1) * min(max(off / count, -most), most)
        times: Ints = self._origin + np.rint(self._time + ahead).astype(np.int64)
        self._time += float(ahead[-1])
        return times


def rows_ahead(interval: float) -> int:
    """Return the number of rows in the next second, of an interval in ns."""
    return max(AHEAD_ROWS, math.ceil(AHEAD_S * 1e9 / interval))


def delay_rise(times: Floats, interval: float) -> tuple[Floats, int]:
    """Return (k,) intervals by which the smallest delay rises within a second, and the rows of a second.

    Parameters
    ----------
    times : (n,) ns.
    interval : ns.
    """
    window = min(rows_ahead(interval), len(times) // 2)
    edge = sliding_minimum(times / interval - np.arange(len(times)), window)
    return edge[window:] - edge[:-window], window


def _roughness(times: Floats, interval: float) -> float:
    """Return how far from whole intervals the smallest delay rises within a second; 0.25: no grid at all."""
    rise, _ = delay_rise(times, interval)
    return float(np.median(np.abs(rise - np.rint(rise))))


def sliding_minimum(values: Floats, window: int) -> Floats:
    """Return (n,) the smallest of each value and the window - 1 after it.

    The work does not grow with the window: minima to the end and from the start of blocks of its length meet in it
    (van Herk 1992, Pattern Recognition Letters 13:517).

    >>> sliding_minimum(np.array([3.0, 1.0, 2.0, 5.0, 4.0]), 2).tolist()
    [1.0, 1.0, 2.0, 4.0, 4.0]
    """
    padded = np.full((len(values) // window + 2) * window, np.inf)
    padded[: len(values)] = values
    blocks = padded.reshape(-1, window)
    to_end = np.minimum.accumulate(blocks[:, ::-1], axis=1)[:, ::-1].ravel()
    from_start = np.minimum.accumulate(blocks, axis=1).ravel()
    n = len(values)
    return np.asarray(np.minimum(to_end[:n], from_start[window - 1 : n + window - 1]))


def _first(hits: Bools) -> int:
    """Return the index of the first True; a large number if there is none."""
    return int(np.argmax(hits)) if hits.any() else 1 << 60
