"""Row selection: the rows of a table that are samples of the stream, in the order of their time.

A table may hold sensors of different rates: the slower one has blank cells. Rows that have both are too few for the
faster one, and every other row is no loss of the slower one. So such a table is an error unless one sensor is
selected; the rows without it are then no samples.

A temperature may be known in some rows, or have rows of its own; the next samples take it.

Rows of a log that several threads write may be swapped. `RowOrder` puts a row back that is late by less than a window.
A time that falls further is a clock that restarts, and stays. Rows in no order at all are an error. A row may be
written twice, a sensor may be held in some rows, and rows next to each other may be of two sensors.
"""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np

from imumon.grid.interval import SINGLE_EXCESS
from imumon.model.cures import option_text
from imumon.model.samples import AXES, Bools, Floats, Ints
from imumon.model.units import share_text
from imumon.sources.files.base import RecordingError
from imumon.sources.files.columns import ColumnLayout

COMPLETE = 0.75
"""Share of the rows of a sensor that must have the other one, for them to have one rate: a slower one has at most two
of three."""

NEIGHBOURS = 64
"""Rows of a piece of a table without time. A piece without a sample is part of a hole. Chosen: longer than what a
sensor buffers."""

WINDOW = 64
"""Rows by which a row may be late and is still sorted: more than a datagram holds."""

UNSORTED = 0.05
"""Share of steps back, after sorting, above which rows are in no order: a clock does not restart that often."""


DEAD = 0.95
"""Share of the rows of a sensor with one number on all axes above which it has no samples at all."""

FEWEST_HELD = 100
"""Rows that show whether samples are held."""

ALTERNATE_ERRORS = 8.0
"""Standard errors by which rows in turn must differ to be of two sensors, chosen: one of 10^15 records of noise does by
chance, and a vibration near half the sample rate has another phase within the first rows."""

COPIED = 0.99
"""Share of the rows with the stamp of the row before that must be copies of it, for rows to be doubled."""


class SensorRows:
    """Rows of the only inertial sensor of a stream, or of two sensors that have the same rows. Others are no samples.

    Parameters
    ----------
    path : for messages.
    table_layout : columns of the stream.

    Attributes
    ----------
    others : rows of other sensors, which were left out; of these, `others_counted` that no reader has counted.
    fillers : rows by sensor that have one number on all axes in place of a sample.
    """

    def __init__(self, path: str, table_layout: ColumnLayout) -> None:
        self._path = path
        sensors = [
            sensor
            for sensor in ("gyro", "accel")
            if sensor in {name.sensor for name in table_layout.channels}
        ]
        self._columns = [
            [k for k, name in enumerate(table_layout.channels) if name.sensor == sensor] for sensor in sensors
        ]
        self._inertial = [k for columns in self._columns for k in columns]
        self._slow = [k for k in range(len(table_layout.channels)) if k not in self._inertial]
        self._rows, self._counts, self._both = 0, np.zeros(len(sensors), np.int64), 0
        self._timed = bool(table_layout.times)
        self._mixed = False  # other sensors have rows of their own
        self.others = self.others_counted = 0
        self._names = sensors
        self.fillers: dict[str, int] = {}

    def mark_fillers(self, rows: Floats) -> None:
        """Make rows NaN in which a program wrote one number, such as 0, because a sensor had no sample.

        The axes of a coarse gyroscope are the same, too, and then often two of them.
        """
        for name, columns in zip(self._names, self._columns, strict=True):
            if len(columns) < len(AXES):
                continue
            x, y, z = rows[:, columns].T
            filled: Bools = (x == y) & (y == z)
            with_numbers = np.isfinite(x + y + z)  # a hole says nothing of coarse steps
            share = float(filled.sum() / max(with_numbers.sum(), 1))
            # decided once: a sensor that freezes later is stuck, which the guard has to see
            if not self._rows and 0.0 < share < DEAD:
                # coarse steps make two axes equal far more often than all three
                alike = ((x == y) | (y == z) | (z == x))[~filled & with_numbers]
                self.fillers |= {name: 0} if alike.mean() < share else {}
            if name in self.fillers:
                self.fillers[name] += int(filled.sum())
                rows[np.flatnonzero(filled)[:, None], columns] = np.nan

    def select(self, rows: Floats, present: Bools, places: Ints) -> tuple[Floats, Ints]:
        """Return the rows that are samples, complete or not, and their places.

        Parameters
        ----------
        rows, present : (n, k), and which numbers are there, with the columns of the layout first.
        """
        whole: Bools = np.stack([present[:, columns].all(axis=1) for columns in self._columns])
        has_sample: Bools = np.any(present[:, self._inertial], axis=1)
        first = not self._rows
        if first and not has_sample.any():  # before the first sample there is nothing to decide by
            self._note_others(places)
            return rows[:0], places[:0]
        self._rows += len(rows)
        self._counts += whole.sum(axis=1)
        self._both += int(whole.all(axis=0).sum())
        slow = np.any(present[:, self._slow], axis=1)
        if first:
            self.check()
            # many rows lack the only sensor, or the temperature has rows of its own: the rows are of several sensors
            sparse = len(whole) == 1 and bool(self._counts[0]) and self._usual_share(whole[0]) <= COMPLETE
            self._mixed = sparse or bool((slow & ~has_sample).sum() > (slow & has_sample).sum())
        if not self._mixed:
            return rows, places
        self._note_others(places[~has_sample])
        samples = np.flatnonzero(has_sample)
        # a temperature in a row that is left out goes to the next sample; behind the last one there is none
        end = samples[-1] if len(samples) else 0
        for k in self._slow:
            known = np.flatnonzero(present[:end, k] & ~has_sample[:end])
            rows[samples[np.searchsorted(samples, known)], k] = rows[known, k]
        return rows[has_sample], places[has_sample]

    def _usual_share(self, whole: Bools) -> float:
        """Return the share of rows that are complete samples of the only sensor.

        With stamps, rows without a sample are of another sensor, because lost samples have no rows. Without stamps, a
        row in a hole is a lost sample: only rows beside samples count.

        Parameters
        ----------
        whole : (n,) rows that are complete samples; at least one is.
        """
        return float(whole.mean()) if self._timed else _share_beside_samples(whole)

    def _note_others(self, places: Ints) -> None:
        """Count rows, of these places, that are no samples."""
        self.others += len(places)
        self.others_counted += int((places > 0).sum())

    def check(self) -> None:
        """Raise `RecordingError` if the sensors have different rows; an empty sensor has none."""
        counts = self._counts.tolist()
        if len(counts) < 2 or not all(counts) or self._both > COMPLETE * max(counts):
            return
        text = (
            f"{self._path}: gyro and accel have different rows: of {self._rows:,}, {counts[0]:,} have gyro, "
        )
        text += f"{counts[1]:,} have accel, {self._both:,} have both"
        alone = f"read each alone, {option_text(sensor='gyro')} and {option_text(sensor='accel')}"
        raise RecordingError("different_rates", text, alone)


class HeldNumbers:
    """Holds the last number of a slow sensor for some rows after it, whose own is missing.

    >>> held = HeldNumbers(2)
    >>> column = np.array([np.nan, 5.0, np.nan, np.nan, np.nan])
    >>> held.fill(column[:3]), held.fill(column[3:]), column.tolist()
    (None, None, [nan, 5.0, 5.0, 5.0, nan])
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._value, self._age = np.nan, most  # of the last number, and rows since it

    def fill(self, column: Floats) -> None:
        """Fill the next rows in place; a number that is not finite is missing."""
        here, known = np.arange(len(column)), np.isfinite(column)
        last = np.maximum.accumulate(np.where(known, here, -1))
        value = np.where(last < 0, self._value, column[last])
        age = here - np.where(last < 0, -1 - self._age, last)
        column[:] = np.where(age <= self._most, value, column)
        self._value, self._age = value[-1], int(age[-1])


def _share_beside_samples(whole: Bools) -> float:
    """Return the share of rows (n,) that are samples: the median of the pieces of `NEIGHBOURS` rows that have some."""
    starts = np.arange(0, len(whole), NEIGHBOURS)
    shares = np.add.reduceat(whole.astype(np.float64), starts) / np.diff(starts, append=len(whole))
    return float(np.median(shares[shares > 0.0]))


class RowOrder:
    """Puts rows in the order of their time. The last rows wait for those after them.

    Attributes
    ----------
    moved : rows that were out of order.
    """

    def __init__(self, path: str, name: str) -> None:
        self._path, self._name = path, name
        self._rows: Floats | None = None
        self._times = np.empty(0)
        self._places = np.empty(0, np.int64)
        self.moved = 0

    def sort(self, rows: Floats, times: Floats, places: Ints, *, final: bool = False) -> tuple[Floats, Ints]:
        """Return the oldest rows that wait, in order, and their places.

        Parameters
        ----------
        rows : (n, k), the next ones.
        times : (n,) in any unit; not finite: the row stays where it is.
        places : (n,) number of each row in its file.
        final : these are the last rows.

        Raises
        ------
        RecordingError : the rows are in no order.

        >>> order = RowOrder("a.csv", "t")
        >>> times = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 4.0, 6.0])
        >>> order.sort(times[:, None], times, np.arange(7), final=True)[1].tolist(), order.moved
        ([0, 1, 2, 3, 5, 4, 6], 1)
        """
        if self._rows is not None:
            rows, times = np.concatenate([self._rows, rows]), np.concatenate([self._times, times])
            places = np.concatenate([self._places, places])
        order = self._order(_filled(times))
        if order is not None:
            rows, times, places = rows[order], times[order], places[order]
            steps = np.diff(times)
            back = float(np.mean(steps < 0.0))
            # a time that only falls is another error, which `first_rows` raises
            if back > UNSORTED and (steps > 0.0).any():
                text = f"{self._path}: its rows are not in the order of {self._name}: "
                text += f"{share_text(back)} of the steps go back"
                raise RecordingError("rows_not_sorted", text, f"sort the rows by {self._name}")
        # the last rows wait: a row after them may belong between them
        ready = len(rows) if final else max(0, len(rows) - WINDOW)
        self._rows, self._times, self._places = rows[ready:], times[ready:], places[ready:]
        return rows[:ready], places[:ready]

    @property
    def waiting(self) -> int:
        """Rows that wait, without those that no sample comes of."""
        return int((self._places > 0).sum())

    def _order(self, times: Floats) -> list[int] | None:
        """Return the order of the rows; None: they are in order.

        A late row is put back where a row is missing, if the rows before it are no others than early ones.
        """
        steps = np.diff(times)
        late = (np.flatnonzero(steps < 0.0) + 1).tolist()
        if not late or not (steps > 0.0).any():
            return None
        # a late row left a hole where it was taken out
        hole = (1.0 + SINGLE_EXCESS) * float(np.median(steps[steps > 0.0]))
        values, order, newest, last = times.tolist(), list(range(len(times))), 0, np.nan
        for first in late:
            newest = max(newest, first)
            # a late row, if the times soon go on where they were; else a clock that restarts
            while newest < len(values) and values[newest] < values[newest - 1] < max(
                values[newest : newest + WINDOW]
            ):
                place = bisect_right(values, values[newest], max(0, newest - WINDOW), newest)
                copied = values[place - 1] == last == values[newest]  # of a row that has been put back
                # at the edge of the window the row is later than any thread writes, and stays
                if place in (0, newest - WINDOW) or not (copied or values[place] - values[place - 1] >= hole):
                    break
                last = values[newest]
                for moved in (values, order):
                    moved[place : newest + 1] = [moved[newest], *moved[place:newest]]
                self.moved += 1
                newest += 1
        return order


def _filled(times: Floats) -> Floats:
    """Return times of which those that are not finite are the one before.

    >>> _filled(np.array([np.nan, 1.0, np.nan, 3.0])).tolist()
    [1.0, 1.0, 1.0, 3.0]
    """
    finite = np.isfinite(times)
    if finite.all() or not finite.any():
        return times
    last = np.maximum.accumulate(np.where(finite, np.arange(len(times)), int(np.argmax(finite))))
    return times[last]


def copies(rows: Floats) -> Bools:
    """Return (n - 1,) which rows are the same as the row before; a missing number is one."""
    same: Bools = ((rows[1:] == rows[:-1]) | (np.isnan(rows[1:]) & np.isnan(rows[:-1]))).all(axis=1)
    return same


def are_doubled(rows: Floats, times: slice) -> bool:
    """Return whether rows with the stamp of the row before are copies of it, and not samples that came at once.

    >>> noise = np.random.default_rng(0).normal(size=(9, 3))
    >>> stamped = np.column_stack([noise, np.arange(9) // 2])
    >>> are_doubled(stamped, slice(3, 4)), are_doubled(np.repeat(stamped, 2, axis=0), slice(3, 4))
    (False, False)
    >>> stamped[:, 3] = np.arange(9)
    >>> are_doubled(stamped, slice(3, 4)), are_doubled(np.repeat(stamped, 2, axis=0), slice(3, 4))
    (False, True)
    """
    still = (rows[1:, times] == rows[:-1, times]).all(axis=1)
    if not still.any():
        return False
    same = copies(rows)
    # a sensor that is stuck repeats its values with new stamps, too: its rows are no copies
    constant = (np.delete(rows[1:], times, axis=1) == np.delete(rows[:-1], times, axis=1)).all(axis=1)[~still]
    return bool(same[still].mean() >= COPIED and (not len(constant) or constant.mean() < 0.5))


def repeats_by_chance(axis_share: float, share: float) -> float:
    """Return the share of the rows in which all three axes repeat by chance, each for itself.

    With p the chance that an axis repeats, and h the share of the rows that are held,

        1 - axis_share = (1 - h) (1 - p),    1 - share = (1 - h) (1 - p^3)

    so that their ratio is 1 + p + p^2, whatever h is.

    Parameters
    ----------
    axis_share, share : of the rows in which an axis repeats, on average, and in which all do.

    >>> round(repeats_by_chance(0.5, 0.125), 3), round(repeats_by_chance(0.75, 0.75), 3)
    (0.125, 0.0)
    """
    if axis_share >= 1.0:
        return 0.0
    ratio = min(max((1.0 - share) / (1.0 - axis_share), 1.0), 3.0)
    p = 0.5 * (math.sqrt(4.0 * ratio - 3.0) - 1.0)
    held = 1.0 - (1.0 - axis_share) / (1.0 - p) if p < 1.0 else 0.0
    return float((1.0 - max(held, 0.0)) * p**3)


def alternate(rows: Floats) -> bool:
    """Return whether (n, 3) rows next to each other differ significantly, as those of two sensors in turn.

    >>> noise = np.random.default_rng(0).normal(size=(500, 3))
    >>> alternate(noise), alternate(noise + 2.0 * (np.arange(500) % 2)[:, None])
    (False, True)
    """
    # differences of neighbours: a drift, or the motion of a hand, is in both
    steps = rows[1:] - rows[:-1]
    signed = steps * np.where(np.arange(len(steps)) % 2, -1.0, 1.0)[:, None]
    spread = signed.std(axis=0) / math.sqrt(max(len(signed), 1))
    return len(rows) > FEWEST_HELD and bool((np.abs(signed.mean(axis=0)) > ALTERNATE_ERRORS * spread).any())
