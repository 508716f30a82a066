"""Table: rows of numbers as blocks of samples, from a file of any format.

A table has a column for each channel (`columns`) and mostly one of time. The time of its first rows shows the
sampling interval and whether the stamps are those of a sample clock or of a host (`timestamps`); a table
without time needs the rate. The stamps of a sample clock are used whatever rate is configured; those of a
host give way to it. Rows that lack a number are lost samples. A remark reports everything that is left out or
assumed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np

from imumon.column_names import UNITS, Column
from imumon.errors import RateRequired
from imumon.recordings.base import Recording, RecordingError
from imumon.recordings.columns import INERTIAL, LISTED, ColumnLayout
from imumon.recordings.row_selection import COPIED, HeldNumbers, OwnRows, RowOrder, are_doubled, copies
from imumon.recordings.unit_inference import check_magnitudes, time_unit, unit_remarks
from imumon.report import stamp
from imumon.samples import Bools, Clock, Floats, Ints, SampleBlock, Stream, sensor_of
from imumon.timebase.interval import NOMINAL_SHARE
from imumon.timebase.late_stamps import LateStamps
from imumon.timebase.timestamps import HostStamps, RateObstacle, rate_obstacle, stamp_interval

ROWS = 1 << 15
"""Rows in one block."""

LARGEST = 1e100
"""Size from which a number counts as missing: no instrument writes it, and its square overflows."""

FILLED = 0.9
"""Share of the first rows in which a column of time or of a magnetometer must have a number."""

SLOW = {"temperature", "pressure"}
"""Sensors that may be slower than the rows, and are held between their numbers."""

HELD_STEPS = 2.0
"""Mean steps between the numbers of a slow sensor for which one is held: its steps are not quite even."""

UNIX_S = (946_684_800.0, 4_102_444_800.0)
"""s since 1970 of the years 2000 and 2100: a time stamp between them is a date."""

LONGEST_NS = 4e18
"""ns, longest time since the first row; a time beyond it is invalid, and would not fit 64 bits."""

HELD = 0.25
"""Share of the rows that repeat all axes of a sensor above which it is slower than the rows; rounding repeats few."""

ROW_NAMES = {
    "csv": "line",
    **dict.fromkeys(("npz", "npy", "mat", "parquet"), "sample"),
    "bag": "message",
    "px4": "message",
    "ardupilot": "message",
}
"""Word for a row of a table in messages."""

RATE_CURE = "give the sample rate with --rate"

OBSTACLES: dict[RateObstacle, tuple[str, str]] = {
    "single_row": ("has one row, and a rate needs two", "check that the file is complete, or record longer"),
    "time_descending": ("runs backwards", f"sort the rows by it, or {RATE_CURE}"),
    "time_constant": ("does not change", f"write it with more digits, or {RATE_CURE}"),
    "time_too_coarse": ("changes in hardly any row", f"write it with more digits, or {RATE_CURE}"),
}
"""Message and cure for a time that shows no rate."""

ZERO_CELSIUS = 273.15
"""K."""


class Table(Recording):
    """Recording that is a table: its rows go through `TableRows`."""

    _rows: TableRows

    def _blocks(self, rows: Floats, places: Sequence[int]) -> list[SampleBlock]:
        """Return the blocks of some rows and update the counters; see `TableRows.blocks`."""
        return self._counted(list(self._rows.blocks(rows, places)))

    def _finish(self) -> list[SampleBlock]:
        return self._counted(list(self._rows.finish()))

    def _counted(self, blocks: list[SampleBlock]) -> list[SampleBlock]:
        self.bad_checksums, self.remarks = self._rows.lost, self._rows.remarks
        self.started, self.assumed_unit = self._rows.started, self._rows.assumed_unit
        return blocks


class TableRows:
    """Numbers of a table as blocks of samples.

    Parameters
    ----------
    path : for messages.
    columns : columns of the stream.
    what : kind of the table: ``csv``, ``npz``, ``npy``, ``mat``, ``parquet``, ``bag``, ``px4``, ``ardupilot``.
    rate_hz : Hz, configured sample rate; None: not configured.
    names : of all columns of the table.
    source : what the samples are taken from, for people; empty: `what`.

    Attributes
    ----------
    lost : rows that lacked a number.
    started : see `Recording`.
    assumed_unit : see `Recording`.
    """

    def __init__(
        self,
        path: str,
        columns: ColumnLayout,
        what: str,
        rate_hz: float | None,
        names: Sequence[str] = (),
        source: str = "",
    ) -> None:
        self._path, self._layout, self._what, self._rate = path, columns, what, rate_hz
        self._stream: Stream | None = None
        self._origin: Floats | None = None
        self.started: str | None = None
        self._scales: list[float] = []  # ns in a unit of each column of time
        self._lost_before = 0  # rows lost before the next one
        self._used: list[int] | None = None  # columns that are not left out
        self._needed: list[int] = []  # of these, those that a sample cannot lack
        self._held: dict[int, HeldNumbers] = {}  # by column, of those that some rows lack
        self._own_rows = OwnRows(path, columns)
        self._order: RowOrder | None = None  # of a table with times
        self._host: HostStamps | None = None  # rows wait until their stamps have been placed
        self._late: LateStamps | None = None  # of stamps of a sample clock
        self._waiting: list[Floats] = []
        self._waiting_lost = np.empty(0, np.int64)  # rows lost before each of these, of a sample clock
        self._names, self._source = names, source or what
        self._remarks = list(columns.remarks)
        self._incomplete, self._first_incomplete = 0, ""  # rows that lacked a number, and where the first is
        self._back, self._first_back = 0, ""  # steps back of a clock, and where the first is
        self._last: Ints | None = None  # ns, the last two times
        self._doubled = False  # rows may be copies of the row before
        self._last_row: Floats | None = None
        self._copies = 0  # rows left out because of that
        self.lost = 0
        self.assumed_unit = ""

    @property
    def remarks(self) -> list[str]:
        """Columns and rows that are not used, and assumptions about units and stamps."""
        remarks = list(self._remarks)
        if self._incomplete:
            one = self._incomplete == 1
            rows = (
                "1 row lacks a number and counts"
                if one
                else f"{self._incomplete:,} rows lack a number and count"
            )
            remarks.append(f"{rows} as lost; first {self._first_incomplete}")
        for sensor, count in self._own_rows.fillers.items():
            rows = "1 row has" if count == 1 else f"{count:,} rows have"
            remarks.append(f"{rows} the same number on all axes of {sensor}: no samples of it")
        if others := self._own_rows.others:
            sensors = " or ".join(
                dict.fromkeys(sensor_of(c) for c in self._layout.channels if sensor_of(c) in INERTIAL)
            )
            remarks.append(f"{others:,} rows have no number of {sensors}: they are no samples of it")
        if self._order is not None and self._order.moved:
            rows = "1 row is" if self._order.moved == 1 else f"{self._order.moved:,} rows are"
            remarks.append(f"{rows} not in the order of {self._layout.times[0].name}: sorted by it")
        if self._copies:
            rows = "1 row repeats" if self._copies == 1 else f"{self._copies:,} rows repeat"
            remarks.append(f"{rows} the row before with its stamp: each sample counts once")
        if self._back:
            times = "once" if self._back == 1 else f"{self._back:,} times"
            remarks.append(f"the time in {self._layout.times[0].name} steps back {times}; {self._first_back}")
        if self._host is not None and self._host.back_s:
            text = f"its clock steps back by {self._host.back_s:.6g} s"
            remarks.append(f"{text}: a gap of unknown length, counted as none")
        return remarks

    @property
    def columns(self) -> list[int]:
        """Indices of the columns of the table, in the order of `blocks`."""
        return [column.index for column in self._all_columns()]

    def _all_columns(self) -> tuple[Column, ...]:
        found = self._layout
        return (*found.columns, *found.times, *([found.interval] if found.interval is not None else []))

    def blocks(self, rows: Floats, places: Sequence[int]) -> Iterator[SampleBlock]:
        """Yield blocks of some rows, (n, k) with the columns of `columns`; not finite is missing.

        Parameters
        ----------
        places : (n,) number of each row in its file, for messages; 0: the row has been reported.

        Raises
        ------
        RecordingError : the numbers cannot have their unit, or the rows are in no order. RateRequired : there is no
            time and no rate.
        """
        if len(rows):
            self._own_rows.mark_fillers(rows)
            rows, places = self._own_rows.select(rows, _present(rows), places)
        if not len(rows):
            return
        if self._used is None:
            self._choose_columns(rows)
        rows = rows[:, self._used]
        if self._order is not None:
            rows, places = self._order.sort(rows, self._sort_times(rows), places)
        yield from self._sorted_blocks(rows, places)

    def _sorted_blocks(self, rows: Floats, places: Sequence[int]) -> Iterator[SampleBlock]:
        """Yield blocks of some rows in order, with the columns that are used."""
        if not len(rows):
            return
        if self._stream is None:
            self._begin(rows)
        for k, held in self._held.items():
            held.fill(rows[:, k])
        if self._doubled:
            rows, places = self._without_copies(rows, places)
        good = self._complete(rows)
        kept = np.flatnonzero(good)
        if len(kept) < len(rows):
            self._note_incomplete(rows, np.flatnonzero(~good), places)
            places = [places[k] for k in kept.tolist()]
        lost = np.diff(kept, prepend=-1 - self._lost_before) - 1
        bad = len(rows) - len(kept)
        self.lost += bad
        self._lost_before += bad - int(lost.sum())
        if not len(kept):
            return
        rows = rows[kept]
        assert self._stream is not None
        values = self._in_si(rows)
        if self._host is None:
            times = self._times(rows)
            if times is not None and self._stream.clock == "startup":
                self._note_back(times, places)
            if self._late is None or times is None:
                yield SampleBlock(self._stream, values, times, lost)
                return
            self._waiting.append(values)
            self._waiting_lost = np.concatenate([self._waiting_lost, lost])
            yield from self._in_time(self._late.place(times, lost))
            return
        self._waiting.append(values)
        width = len(self._layout.columns)
        stamps = rows[:, width : width + len(self._layout.times)]
        yield from self._placed(self._host.place(self._nanoseconds(stamps).astype(np.float64)))

    def _complete(self, rows: Floats) -> Bools:
        """Return which rows have the numbers that a sample needs: those of a temperature may be unknown."""
        return np.asarray(_present(rows[:, self._needed]).all(axis=1))

    def _in_si(self, rows: Floats) -> Floats:
        """Return the values of complete rows, channel unit."""
        columns = self._layout.columns
        values: Floats = rows[:, : len(columns)] * [column.factor for column in columns]
        values[:, [column.unit == "k" for column in columns]] -= ZERO_CELSIUS
        return self._over_interval(values, rows) if self._layout.kind == "deltas" else values

    def _without_copies(self, rows: Floats, places: Sequence[int]) -> tuple[Floats, Sequence[int]]:
        """Return the rows that differ from the row before."""
        before = rows[:1] if self._last_row is None else self._last_row
        same = copies(np.concatenate([before, rows]))
        same[0] &= self._last_row is not None
        self._last_row = rows[-1:] if len(rows) else self._last_row
        self._copies += int(same.sum())
        return rows[~same], [place for place, copy in zip(places, same.tolist(), strict=True) if not copy]

    def _note_incomplete(self, rows: Floats, bad: Ints, places: Sequence[int]) -> None:
        """Count rows that lack a number and note where the first is."""
        new = [k for k in bad.tolist() if places[k]]
        if new and not self._incomplete:
            present, columns = _present(rows[new[0]]), self._all_columns()
            missing = [columns[k].name for k in self._needed if not present[k]]
            self._first_incomplete = f"{ROW_NAMES[self._what]} {places[new[0]]}: {', '.join(missing)}"
        self._incomplete += len(new)

    def _note_back(self, times: Ints, places: Sequence[int]) -> None:
        """Count the steps back of a sample clock on which two stamps on either side agree; note the first."""
        recent = np.concatenate([times[[0, 0]] if self._last is None else self._last, times])
        now = recent[2:]
        back = np.maximum(now, np.append(now[1:], now[-1])) < np.minimum(recent[1:-1], recent[:-2])
        if back.any() and not self._back:
            at = int(np.argmax(back))
            by_s = (recent[at + 1] - now[at]) * 1e-9
            where = f"{ROW_NAMES[self._what]} {places[at]}"
            self._first_back = f"first by {by_s:.6g} s at {where}: a gap of unknown length"
        self._back += int(back.sum())
        self._last = recent[-2:]

    def finish(self) -> Iterator[SampleBlock]:
        """Yield the rows that still wait, at the end of the table.

        Raises
        ------
        RecordingError : see `blocks`.
        """
        self._own_rows.check()
        if self._order is not None:
            no_rows = np.empty((0, len(self._used or ())))
            yield from self._sorted_blocks(*self._order.sort(no_rows, np.empty(0), (), final=True))
        if self._host is not None:
            yield from self._placed(self._host.place(np.empty(0), final=True))
        if self._late is not None:
            nothing = np.empty(0, np.int64)
            yield from self._in_time(self._late.place(nothing, nothing, final=True))

    def _in_time(self, times: Ints) -> Iterator[SampleBlock]:
        """Yield the oldest rows that wait, at their times on the grid."""
        if not len(times):
            return
        assert self._stream is not None
        values, lost, ready = np.concatenate(self._waiting), self._waiting_lost, len(times)
        self._waiting, self._waiting_lost = [values[ready:]], lost[ready:]
        yield SampleBlock(self._stream, values[:ready], times, lost[:ready])

    def _placed(self, lost: Ints) -> Iterator[SampleBlock]:
        """Yield the oldest rows that wait, of which the losses before are known."""
        if not len(lost):
            return
        assert self._stream is not None
        values = np.concatenate(self._waiting)
        self._waiting = [values[len(lost) :]]
        yield SampleBlock(self._stream, values[: len(lost)], None, lost)

    def _sort_times(self, rows: Floats) -> Floats:
        """Return (n,) times by which rows are sorted, in any unit."""
        width = len(self._layout.columns)
        return rows[:, width] if len(self._layout.times) == 1 else rows[:, width : width + 2] @ (1e9, 1.0)

    def _begin(self, rows: Floats) -> None:
        """Decide on clock and interval."""
        found = self._layout
        width = len(found.columns)
        check_magnitudes(self._path, self._what, found, np.where(_present(rows), rows, np.nan))
        assumed = unit_remarks(self._what, found.columns)
        self.assumed_unit = (assumed or [""])[0]
        self._remarks += assumed
        self._doubled = bool(found.times) and are_doubled(rows, slice(width, width + len(found.times)))
        whole = rows[self._complete(rows)]
        if self._doubled:
            whole = whole[~np.append(False, copies(whole))]
        if not len(whole):
            text = f"{self._path}: no row has numbers in all of {', '.join(c.name for c in found.columns)}"
            raise RecordingError("no_complete_row", text, "check that it is complete")
        interval: float | None = None if self._rate is None else 1.0 / self._rate
        clock: Clock = "none"
        if found.times:
            clock, interval = self._clock(whole[:, width : width + len(found.times)])
        elif found.interval is not None:
            clock, interval = "dt", None
            self._compare(float(np.median(whole[:, -1])) * found.interval.factor, own=True)
        elif interval is None:
            raise self._rate_required()
        self._remarks += list(_repeating(found, whole))
        sensors = ", ".join(dict.fromkeys(sensor_of(channel) for channel in found.channels))
        self._stream = Stream(found.kind, found.channels, f"{self._source} ({sensors})", clock, interval)

    def _rate_required(self) -> RateRequired:
        """Return the error that lists the columns that may be a time."""
        used = {column.index for column in self._layout.columns}
        others = [name.strip() for k, name in enumerate(self._names) if k not in used]
        hint = f" (other columns: {', '.join(others[:LISTED])})" if others else ""
        text = f"{self._path} has no clock: no column with numbers has the name of a time{hint}"
        cure = f"name one with --map t=COLUMN:UNIT, or {RATE_CURE}" if others else RATE_CURE
        return RateRequired("rate_required", text, cure)

    def _compare(self, interval_s: float, *, own: bool) -> None:
        """Note if the configured rate differs from that of the stamps, and which is used."""
        if self._rate is None or abs(self._rate * interval_s - 1.0) <= NOMINAL_SHARE:
            return
        clock = " and are those of a sample clock" if own else ", but are those of a host"
        used = f"--rate {self._rate:g} is {'not used' if own else 'used'}"
        self._remarks.append(f"its time stamps show {1.0 / interval_s:.6g} Hz{clock}: {used}")

    def _choose_columns(self, rows: Floats) -> None:
        """Leave out columns with few numbers: an empty time, a slower magnetometer."""
        found = self._layout
        count = len(found.columns)
        full = np.isfinite(rows).mean(axis=0)
        empty = self._empty_sensors(full)
        sensors = [sensor_of(name) for name in found.channels]
        keep = [
            k
            for k, sensor in enumerate(sensors)
            if (sensor not in empty if sensor in INERTIAL else full[k] > (0.0 if sensor in SLOW else FILLED))
        ]
        times = [k for k in range(len(found.times)) if full[count + k] > FILLED]
        times = times if found.split_time else times[:1]
        interval = [k for k in range(count + len(found.times), len(full)) if full[k] > FILLED]
        self._used = [*keep, *(count + k for k in times), *interval]
        self._needed = [at for at, k in enumerate(self._used) if k >= count or sensors[k] in INERTIAL]
        sparse: dict[str, list[str]] = {}
        for k, column in enumerate(self._all_columns()):
            if full[k] <= FILLED and (k >= count or sensors[k] not in INERTIAL):
                lack = f"{1.0 - full[k]:.1%} of the rows lack" if full[k] else "no row has a number in"
                use = "the one before is held" if k in self._used else "not used"
                sparse.setdefault(f"{lack} {{}}: {use}", []).append(column.name)
        self._remarks += [text.format(", ".join(names)) for text, names in sparse.items()]
        slow = [(at, full[k]) for at, k in enumerate(self._used) if k < count and sensors[k] in SLOW]
        self._held = {at: HeldNumbers(math.ceil(HELD_STEPS / share)) for at, share in slow if share < 1.0}
        self._layout = replace(
            found,
            channels=tuple(found.channels[k] for k in keep),
            columns=tuple(found.columns[k] for k in keep),
            times=tuple(found.times[k] for k in times),
            interval=found.interval if interval else None,
        )
        if self._layout.times:
            self._order = RowOrder(self._path, self._layout.times[0].name)

    def _empty_sensors(self, full: Floats) -> set[str]:
        """Return inertial sensors with an axis without numbers; none if no other would be left."""
        channels = self._layout.channels
        axis = {sensor_of(name): k for k, name in enumerate(channels) if not full[k]}
        empty = {sensor for sensor in axis if sensor in INERTIAL}
        if empty == {sensor_of(name) for name in channels} & INERTIAL:
            return set()
        for sensor in empty:
            column = self._layout.columns[axis[sensor]].name
            self._remarks.append(f"{column} holds no numbers: {sensor} is left out")
        return empty

    def _clock(self, times: Floats) -> tuple[Clock, float]:
        """Return clock and interval, s, from the times of the first rows."""
        found = self._layout.times
        self._origin = times[0].copy()
        self._scales = [UNITS["t"][column.unit or "ns"] for column in found]
        raw = times[:, 0] if len(found) == 1 else self._nanoseconds(times).astype(np.float64)
        obstacle = rate_obstacle(raw)
        if obstacle is not None:
            what, cure = OBSTACLES[obstacle]
            text = f"the time in {found[0].name} {what}"
            if self._rate is None:
                raise RecordingError(obstacle, f"{self._path}: {text}", cure)
            self._remarks.append(f"{text}: --rate {self._rate:g} is used, lost samples cannot be detected")
            return "none", 1.0 / self._rate
        if len(found) == 1:
            unit, remark = time_unit(self._path, self._what, found[0], raw, self._rate)
            self._scales = [UNITS["t"][unit]]
            self._remarks += [remark] if remark else []
        self.started = _date(float(self._origin @ np.array(self._scales)) * 1e-9)
        t = self._nanoseconds(times).astype(np.float64)
        interval, steady = stamp_interval(t)
        self._compare(interval * 1e-9, own=steady)
        if steady:
            self._late = LateStamps(interval)
            return "startup", interval * 1e-9
        self._host = HostStamps(t, interval)
        text = "its time stamps are late or in batches, as those of a host: "
        text += "only their mean rate is used" if self._rate is None else "they only show what was lost"
        if self._host.rough:
            text += ", and single lost samples cannot be detected"
        self._remarks.append(text)
        return "none", interval * 1e-9 if self._rate is None else 1.0 / self._rate

    def _over_interval(self, values: Floats, rows: Floats) -> Floats:
        """Divide angles and velocities by the interval of each sample, else by the common one.

        Averages that are rates and accelerations remain as they are.
        """
        found = self._layout
        assert self._stream is not None
        own = found.interval
        interval: Any = self._stream.interval_s if own is None else rows[:, -1:] * own.factor
        increments = [k for k, column in enumerate(found.columns) if column.quantity in ("angle", "velocity")]
        if increments:
            values[:, increments] /= interval
        return values

    def _times(self, rows: Floats) -> Ints | None:
        assert self._stream is not None
        width = len(self._layout.columns)
        if self._stream.clock == "startup":
            return self._nanoseconds(rows[:, width : width + len(self._layout.times)])
        if self._stream.clock == "dt" and self._layout.interval is not None:
            return np.rint(rows[:, -1] * self._layout.interval.factor * 1e9).astype(np.int64)
        return None

    def _nanoseconds(self, times: Floats) -> Ints:
        """Return (n,) ns since the first row of (n, 1 or 2) times as in the table."""
        assert self._origin is not None
        total: Floats = (times - self._origin) @ np.array(self._scales)
        nanoseconds: Ints = np.rint(np.clip(total, -LONGEST_NS, LONGEST_NS)).astype(np.int64)
        return nanoseconds


def _present(rows: Floats) -> Bools:
    """Return which of some numbers are there: finite and possible."""
    return np.abs(rows) < LARGEST


def _repeating(found: ColumnLayout, rows: Floats) -> Iterator[str]:
    """Yield a remark on each inertial sensor that is slower than its rows and holds its values between."""
    for sensor in sorted(INERTIAL & set(map(sensor_of, found.channels)), reverse=True):
        own = [k for k, name in enumerate(found.channels) if sensor_of(name) == sensor]
        share = float(copies(rows[:, own]).mean()) if len(rows) > 1 else 0.0
        if HELD < share < COPIED:
            yield f"{sensor} repeats its values in {share:.0%} of the rows: it is slower than they are"


def _date(unix_s: float) -> str | None:
    """Return the date of a time stamp, s; None if it is no time since 1970: a clock that began with the device."""
    return stamp(datetime.fromtimestamp(unix_s, UTC)) if UNIX_S[0] <= unix_s < UNIX_S[1] else None
