"""Row selection: the rows of a table that are samples of the stream, in the order of their time.

A row is a sample if its sensor has numbers in it, and if these are new. The first block decides, once:

- A column without numbers is left out, a sensor with one on an axis, too, and a magnetometer that most rows lack. A
  temperature may be slow and is held between its numbers.
- One number on all axes, such as 0, means no sample where coarse numbers do not show it by chance.
- Rows of a table with times that have no number of the sensor are of another one: a lost sample has no row. Two sensors
  that have different rows are an error, whose cure reads each alone.
- A row with the stamp of the row before is a copy of it, if all such rows are. A sensor that is slower than its rows
  repeats its values; coarse numbers repeat by chance, each axis for itself.

Rows of a log that several threads write may be swapped. `RowOrder` puts a row back that is late by less than a window.
A time that falls further is a clock that restarts, and stays. Rows in no order at all are an error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from imumon.grid.interval import SINGLE_EXCESS
from imumon.model.cures import option_text
from imumon.model.samples import AXES, CHANNELS, INERTIAL, Bools, Floats, Ints
from imumon.model.units import share_text
from imumon.sources.files.base import RowSource, different_rates, not_in_order
from imumon.sources.files.columns import Column, ColumnLayout

LARGEST = 1e10
"""Numbers beyond it, in the unit of the channel, are damage: raw counts of 32 bits are below, and a changed exponent of
a float is mostly above."""

COMPLETE = 0.75
"""Share of the rows of a sensor that must have the other one, for them to have one rate: a slower one has at most two
of three."""

FILLED = 0.9
"""Share of the first rows in which a column of time or of a magnetometer must have a number."""

SLOW = ("temperature", "pressure")
"""Sensors that may be slower than the rows, and are held between their numbers."""

DEAD = 0.95
"""Share of the rows of a sensor with one number on all axes above which it has no samples at all."""

FEWEST_HELD = 100
"""Rows that show whether samples are held."""

HELD_SHARE = 0.01
"""Share of the rows that repeat all axes of a sensor, above which they are held: fewer move N by less than 0.5 %."""

HELD_EXCESS = 3.0
"""Ratio of this share to that of three axes that repeat by chance, each for itself, above which they are held."""

COPIED = 0.99
"""Share of the rows with the stamp of the row before that must be copies of it, for rows to be doubled."""

UNSET_ROWS, UNSET_STEPS = 2, 1e6
"""Rows with a time of 0 that are those of a clock that was not set, and steps by which its other times are beyond."""

ALTERNATE_ERRORS = 8.0
"""Standard errors by which rows in turn must differ to be of two sensors, chosen: one of 10^15 records of noise does by
chance, and a vibration near half the sample rate has another phase within the first rows."""

WINDOW = 64
"""Rows by which a row may be late and is still sorted: more than a datagram holds."""

UNSORTED = 0.05
"""Share of steps back, after sorting, above which rows are in no order: a clock does not restart that often."""


class RowSelection:
    """Chooses the columns that have numbers, and the rows that are samples.

    Parameters
    ----------
    source : of the rows.
    table_layout : columns of the stream, by their names.

    Attributes
    ----------
    layout : columns of the stream; the first rows may leave some out.
    started : the first rows have decided.
    needed : places of the columns, of those that are used, that a sample cannot lack.
    held : sensors that repeat their values in rows that are no samples of them.
    unused : why a column is not used, by its place in the table.
    columns : in the order of the rows.
    left_out : rows that no reader has counted, by reason: of other sensors, or those that repeat the row before.
    caveats : what limits the meaning of the numbers, as in `Recording`.
    """

    def __init__(self, source: RowSource, table_layout: ColumnLayout) -> None:
        self.layout, self._source = table_layout, source
        self.columns = table_layout.used
        self._places: dict[str, list[int]] = {}  # of the columns, by what they are used for
        for k, column in enumerate(self.columns):
            self._places.setdefault(column.use.sensor, []).append(k)
        self._names = [sensor for sensor in INERTIAL if sensor in self._places]
        self._slow_numbers = {self._places[s][0]: np.nan for s in SLOW if s in self._places}  # the last ones
        self._rows, self._counts, self._both = 0, np.zeros(len(self._names), np.int64), 0
        self.started = self._mixed = self._doubled = self._unset = False
        self.needed: list[int] = []
        self.held: set[str] = set()
        self._used: list[int] = []
        self._compared: list[
            int
        ] = []  # columns, of those that are used, that repeat in rows that are no samples
        self._last: Floats | None = None  # their numbers in the last row
        # a time has any number
        self._limits = np.array(
            [LARGEST / abs(c.factor) if c.use in CHANNELS else LARGEST**2 for c in self.columns]
        )
        self._beyond = 0  # numbers that no sensor has
        self._fillers: dict[str, int] = {}
        self.left_out = {"other_sensor": 0, "repeated": 0}
        self.unused = dict(table_layout.unused)
        self._remarks = list(table_layout.remarks)
        self.caveats = list(table_layout.caveats)

    @property
    def remarks(self) -> list[str]:
        """What is left out, for people."""
        remarks = list(self._remarks)
        if self._beyond:
            numbers = "one number is" if self._beyond == 1 else f"{self._beyond:,} numbers are"
            remarks.append(f"{numbers} above {LARGEST:.0e} and of no sensor: the file may be damaged")
        for sensor, count in self._fillers.items():
            remarks.append(
                f"{counted(count, 'has', 'have')} the same number on all axes of {sensor}: no samples of it"
            )
        others, repeats = self.left_out.values()
        if others:
            sensors = " or ".join(self._names)
            remarks.append(f"{others:,} rows have no number of {sensors}: they are no samples of it")
        if repeats:
            repeat = counted(repeats, "repeats", "repeat")
            of = " and ".join(sorted(self.held))
            copies_text = f"{repeat} the row before with its stamp: each sample counts once"
            held_text = f"{repeat} the values of {of} of the row before: they are no samples of it"
            remarks.append(held_text if of else copies_text)
        return remarks

    def select(self, rows: Floats, places: Ints) -> tuple[Floats, Ints]:
        """Return the rows that are samples, complete or not, with the columns that are used, and their places.

        Parameters
        ----------
        rows : (n, k), with `columns`. May be changed.
        places : (n,) number of each row in its file; 0: it is counted.

        Raises
        ------
        RecordingError : the sensors have different rows.
        """
        beyond = np.abs(rows) > self._limits
        if beyond.any():
            self._beyond += int(beyond.sum())
            rows[beyond] = np.nan
        self._mark_fillers(rows)
        for k, before in self._slow_numbers.items():
            rows[:, k] = _filled(rows[:, k], before)
            self._slow_numbers[k] = rows[-1, k] if len(rows) else before
        of_sensors = [np.isfinite(rows[:, self._places[name]]) for name in self._names]
        whole = np.stack([finite.all(axis=1) for finite in of_sensors])
        has_sample = np.concatenate(of_sensors, axis=1).any(axis=1)
        if not self.started and not has_sample.any():  # before the first sample there is nothing to decide by
            self._count_others(places)
            return rows[:0], places[:0]
        self._rows += len(rows)
        self._counts += whole.sum(axis=1)
        self._both += int(whole.all(axis=0).sum())
        if not self.started:
            self.check()
            self._mixed = bool(self.layout.times) and float(has_sample.mean()) <= COMPLETE
        if self._mixed:
            self._count_others(places[~has_sample])
            rows, places = rows[has_sample], places[has_sample]
        if not self.started:
            self._decide(rows)
        rows = rows[:, self._used]
        if self._unset:
            times = rows[:, len(self.layout.columns)]
            times[times == 0.0] = np.nan
        return self._without_repeats(rows, places)

    def _mark_fillers(self, rows: Floats) -> None:
        """Make rows NaN in which a program wrote one number, such as 0, because a sensor had no sample.

        The axes of a coarse gyroscope are the same, too, and then often two of them.
        """
        for name in self._names:
            columns = self._places[name]
            if len(columns) < len(AXES) or (self.started and name not in self._fillers):
                continue
            x, y, z = rows[:, columns].T
            filled: Bools = (x == y) & (y == z)
            # decided once: a sensor that freezes later is stuck, which the guard has to see
            if not self.started:
                with_numbers = np.isfinite(x + y + z)  # a hole says nothing of coarse steps
                share = float(filled.sum() / max(with_numbers.sum(), 1))
                # coarse steps make two axes equal far more often than all three
                alike = ((x == y) | (y == z) | (z == x))[~filled & with_numbers]
                if not 0.0 < share < DEAD or alike.mean() >= share:
                    continue
            self._fillers[name] = self._fillers.get(name, 0) + int(filled.sum())
            rows[np.flatnonzero(filled)[:, None], columns] = np.nan

    def _count_others(self, places: Ints) -> None:
        self.left_out["other_sensor"] += int((places > 0).sum())

    def check(self) -> None:
        """Raise `RecordingError` if the sensors have different rows; an empty sensor has none."""
        counts = self._counts.tolist()
        if len(counts) == len(INERTIAL) and all(counts) and self._both <= COMPLETE * max(counts):
            text = f"gyro and accel have different rows: of {self._rows:,}, {counts[0]:,} have gyro, "
            text += f"{counts[1]:,} have accel, {self._both:,} have both"
            raise different_rates(text).of(self._source.name)

    # ------------------------------------------------------------ the first rows

    def _decide(self, rows: Floats) -> None:
        """Decide which columns are used, and which rows repeat the row before, by the first rows of the sensors."""
        shares = {of: float(np.isfinite(rows[:, k]).mean(axis=0).min()) for of, k in self._places.items()}
        empty = {name for name in self._names if not shares[name]}
        if len(empty) == len(self._names):  # then no row is complete, which is another error
            empty = set()
        held = self._held_sensors(rows, empty)
        # the sensor that has a sample in each row is used
        slower = held if len(held) < len(self._names) - len(empty) else set()
        self._leave_out(dict(_unused(shares, empty, slower)))
        self.held = held - slower
        used = self.layout.used
        self._used = [k for k, column in enumerate(self.columns) if column in used]
        self.needed = [i for i, column in enumerate(used) if column.use.sensor not in ("mag", *SLOW)]
        of_held = [i for i, column in enumerate(used) if column.use.sensor in self.held]
        self._compared = of_held or list(range(len(used) if self._doubled else 0))
        self.started = True
        self._unset = len(self.layout.times) == 1 and self._has_unset_times(rows[:, self._places["t"][0]])

    def _leave_out(self, reasons: Mapping[str, str]) -> None:
        """Leave columns out of the layout, by what they are used for, and why; note it."""
        left_out = [column for column in self.columns if column.use.sensor in reasons]
        self.unused |= {column.index: reasons[column.use.sensor] for column in left_out}
        for reason in dict.fromkeys(reasons.values()):
            names = ", ".join(column.name for column in left_out if reasons[column.use.sensor] == reason)
            self._remarks.append(f"{names} not used: {reason}")
        self.layout = replace(self.layout, used=tuple(c for c in self.columns if c not in left_out))

    def _held_sensors(self, rows: Floats, empty: set[str]) -> set[str]:
        """Return the inertial sensors whose numbers are held in some rows, because rows come faster than samples.

        A program that writes a row whenever any sensor has a sample repeats the numbers of the others. Such rows are no
        samples: their noise is smaller. A row with the stamp of the row before is a copy, which is another matter.

        Raises
        ------
        RecordingError : two sensors have other rates than the rows, and each another one.
        """
        times = rows[:, self._places.get("t", [])]
        moved = (times[1:] != times[:-1]).any(axis=1)
        if not moved.any():
            return set()
        # a sensor that is stuck repeats its values with new stamps, too: its rows are no copies
        is_stuck = copies(rows[:, : len(self.layout.columns)])[moved].mean() >= 0.5
        self._doubled = not is_stuck and not moved.all() and copies(rows)[~moved].mean() >= COPIED
        rows = rows[np.append(True, moved)]
        held = dict(self._repeats_of_sensors(rows, empty))
        shares = [f"{sensor} in {share_text(float(repeats.mean()))}" for sensor, repeats in held.items()]
        if len(held) == len(INERTIAL):
            one, other = held.values()
            if len(one) != len(other) or float((one != other).mean()) > HELD_SHARE:
                text = f"the rows repeat {' and '.join(shares)} of them: both have other rates"
                raise different_rates(text).of(self._source.name)
        elif held and len(self._names) - len(empty) > 1:
            text = f"the rows repeat {shares[0]} of them: it is slower than they are, and left out"
            self._remarks.append(f"{text}; {option_text(sensor=next(iter(held)))} reads it")
        return set(held)

    def _repeats_of_sensors(self, rows: Floats, empty: set[str]) -> Iterator[tuple[str, Bools]]:
        """Yield each inertial sensor whose numbers are held, with the rows that repeat them."""
        for sensor in self._names:
            axes = self._places[sensor]
            whole = rows[np.isfinite(rows[:, axes]).all(axis=1)][:, axes]
            if len(axes) == len(AXES) and sensor not in empty and len(whole) >= FEWEST_HELD:
                repeats = copies(whole)
                if _is_held(repeats, float((whole[1:] == whole[:-1]).mean())):
                    yield sensor, repeats

    def _has_unset_times(self, times: Floats) -> bool:
        """Return whether the time is 0 in rows for which the clock was not set, and note it."""
        known = times[np.isfinite(times) & (times != 0.0)]
        steps = np.diff(known)
        # a time that counts from zero is 0 once, and near it then
        if (times == 0.0).sum() < UNSET_ROWS or not (steps > 0.0).any():
            return False
        if float(np.abs(known).min()) < UNSET_STEPS * float(np.median(steps[steps > 0.0])):
            return False
        name = self.layout.times[0].name
        self._remarks.append(f"the time in {name} is 0 in rows before its clock was set: they count as lost")
        return True

    # ------------------------------------------------------------ every row

    def _without_repeats(self, rows: Floats, places: Ints) -> tuple[Floats, Ints]:
        """Return the rows that have numbers of their own, and not those of the row before."""
        if not self._compared or not len(rows):
            return rows, places
        values = rows[:, self._compared]
        before = np.full((1, values.shape[1]), np.inf) if self._last is None else self._last
        same = copies(np.concatenate([before, values])) & np.isfinite(rows[:, self.needed]).all(axis=1)
        self._last = values[-1:]
        self.left_out["repeated"] += int(same.sum())
        return rows[~same], places[~same]

    def note_alternating(self, rows: Floats) -> None:
        """Note whether every second of the first samples is of another sensor, and no column says it."""
        for sensor in dict.fromkeys(name.sensor for name in self.layout.channels if name.sensor in INERTIAL):
            axes = [k for k, name in enumerate(self.layout.channels) if name.sensor == sensor]
            if alternate(rows[:, axes]):
                text = (
                    f"every second row of {sensor} differs from those between: the rows may be of two sensors"
                )
                self._remarks.append(f"{text}; write a file for each")
                self.caveats.append("mixed_rows")
                return


def counted(count: int, one: str, many: str) -> str:
    """Return a number of rows with a verb in its form for one or for many."""
    return f"1 row {one}" if count == 1 else f"{count:,} rows {many}"


def _unused(shares: Mapping[str, float], empty: set[str], slower: set[str]) -> Iterator[tuple[str, str]]:
    """Yield what is not used, and why.

    Parameters
    ----------
    shares : share of the rows that have a number, by what it is used for; of several columns the least.
    empty, slower : inertial sensors that are not used.
    """
    for use, share in shares.items():
        if use in slower:
            yield use, f"{use} is slower than the rows, and repeats its values"
        elif use in empty:
            yield use, f"an axis of {use} has no numbers"
        elif use not in INERTIAL and not share:
            yield use, "no row has a number in it"
        elif use not in (*INERTIAL, *SLOW) and share <= FILLED:
            yield use, f"{share_text(1.0 - share)} of the rows lack it"


def _is_held(repeats: Bools, axis_share: float) -> bool:
    """Return whether a sensor is held in the rows that repeat all its axes.

    Coarse numbers repeat by chance. With p the chance that an axis repeats, and h the share of the rows that are held,

        1 - axis_share = (1 - h) (1 - p),    1 - share = (1 - h) (1 - p^3)

    so that their ratio is 1 + p + p^2, whatever h is.

    Parameters
    ----------
    repeats : (n,) rows that repeat all axes.
    axis_share : share of the rows in which an axis repeats, on average.
    """
    share = float(repeats.mean())
    # a sensor that is stuck repeats its values, too, but for long: those are counted once
    begins = repeats & ~np.append(False, repeats[:-1])
    if float(begins.mean()) <= HELD_SHARE or share >= COPIED:
        return False
    ratio = min(max((1.0 - share) / (1.0 - axis_share), 1.0), 3.0)
    p = 0.5 * (math.sqrt(4.0 * ratio - 3.0) - 1.0)
    held = 1.0 - (1.0 - axis_share) / (1.0 - p) if p < 1.0 else 0.0
    return share > HELD_EXCESS * (1.0 - max(held, 0.0)) * p**3


def copies(rows: Floats) -> Bools:
    """Return (n - 1,) which rows are the same as the row before; a missing number is one."""
    same: Bools = ((rows[1:] == rows[:-1]) | (np.isnan(rows[1:]) & np.isnan(rows[:-1]))).all(axis=1)
    return same


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


def _filled(values: Floats, before: float) -> Floats:
    """Return numbers of which those that are not finite are the one before.

    >>> _filled(np.array([np.nan, 1.0, np.nan, 3.0]), 7.0).tolist()
    [7.0, 1.0, 1.0, 3.0]
    """
    finite = np.isfinite(values)
    if finite.all():
        return values
    last = np.maximum.accumulate(np.where(finite, np.arange(len(values)), -1))
    return np.where(last < 0, before, values[last])


class RowOrder:
    """Puts rows in the order of their time. The last rows wait for those after them.

    Parameters
    ----------
    path : for messages.
    used : columns of the rows, with a time.

    Attributes
    ----------
    moved : rows that were out of order.
    """

    def __init__(self, path: str, used: Sequence[Column]) -> None:
        self._path, self._times = path, {k: column for k, column in enumerate(used) if column.use == "t"}
        self._rows, self._places = np.empty((0, len(used))), np.empty(0, np.int64)  # those that wait
        self.moved = 0

    def sort(self, rows: Floats, places: Ints, *, final: bool = False) -> tuple[Floats, Ints]:
        """Return the oldest rows that wait, in order, and their places.

        Parameters
        ----------
        rows : (n, k), the next ones. If its time is not finite, a row stays where it is.
        places : (n,) number of each row in its file.
        final : these are the last rows.

        Raises
        ------
        RecordingError : the rows are in no order.

        >>> from imumon.model.samples import ChannelName
        >>> order = RowOrder("a.csv", [Column(0, "t", ChannelName("t"), "t")])
        >>> times = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 4.0, 6.0])
        >>> order.sort(times[:, None], np.arange(7), final=True)[1].tolist(), order.moved
        ([0, 1, 2, 3, 5, 4, 6], 1)
        """
        rows, places = np.concatenate([self._rows, rows]), np.concatenate([self._places, places])
        # rounded to 256 ns, which is no matter for an order
        times: Floats = rows[:, [*self._times]] @ np.array([column.factor for column in self._times.values()])
        finite = np.isfinite(times)
        order = self._order(_filled(times, times[np.argmax(finite)] if finite.any() else 0.0))
        if order is not None:
            rows, places, times = rows[order], places[order], times[order]
            steps = np.diff(times)
            back = float(np.mean(steps < 0.0))
            # a time that only falls is another error, which `table_clock` raises
            if back > UNSORTED and (steps > 0.0).any():
                raise not_in_order(next(iter(self._times.values())).name, back).of(self._path)
        # the last rows wait: a row after them may belong between them
        ready = len(rows) if final else max(0, len(rows) - WINDOW)
        self._rows, self._places = rows[ready:], places[ready:]
        return rows[:ready], places[:ready]

    @property
    def waiting(self) -> int:
        """Rows that wait, without those that no sample comes of."""
        return int((self._places > 0).sum())

    def _order(self, times: Floats) -> Ints | None:
        """Return the order of the rows; None: they are in order.

        Rows that are late, after which the times soon go on where they were, go back to where rows are missing. Where
        none are missing, a clock has restarted.
        """
        steps = np.diff(times)
        back = np.flatnonzero(steps < 0.0) + 1
        if not len(back) or not (steps > 0.0).any():
            return None
        restarts = [k for k in back.tolist() if times[k : k + WINDOW].max() < times[k - 1]]
        # between rows that have all been put back, the steps are those of the other rows
        fewest = float(np.median(steps[steps > 0.0])) / (1.0 + SINGLE_EXCESS)
        order = np.arange(len(times))
        for start, stop in pairwise([0, *restarts, len(times)]):
            newest = np.maximum.accumulate(times[start:stop])
            late = np.concatenate([[False], times[start:stop] < newest, [False]])
            for run in np.flatnonzero(late[1:] != late[:-1]).reshape(-1, 2):
                begin, end = (run + start).tolist()
                oldest = times[begin:end].min()
                first = start + int(np.searchsorted(newest[: begin - start], oldest, side="right"))
                if end - first > WINDOW or end == stop:
                    continue
                part = order[first:end][np.argsort(times[order[first:end]], kind="stable")]
                around = [*order[max(first - 1, 0) : first], *part]
                if float(np.median(np.diff(times[around]))) >= fewest:
                    order[first:end] = part
                    self.moved += end - begin
        return order
