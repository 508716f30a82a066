"""Table: rows of numbers as blocks of samples, from a file of any format.

A table has a column for each channel (`columns`) and mostly one of time; a table without time needs the rate. Its
first rows decide about clock and interval (`first_rows`). Rows that lack a number are lost samples. A remark reports
everything that is left out or assumed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from imumon.recordings.base import Recording
from imumon.recordings.columns import INERTIAL, ColumnLayout
from imumon.recordings.first_rows import FirstRows, TableStart, TableTimes, present
from imumon.recordings.log_process.base import BLOCK_BYTES as BLOCK_BYTES
from imumon.recordings.log_process.base import ROWS as ROWS
from imumon.recordings.row_selection import OwnRows, RowOrder, copies
from imumon.samples import Floats, Ints, SampleBlock, Stream, sensor_of
from imumon.timebase.timestamps import HostStamps

ROW_NAMES = {
    **dict.fromkeys(("npz", "npy", "mat", "parquet"), "sample"),
    "bag": "message",
    "px4": "message",
    "ardupilot": "message",
}
"""Word for a row of a table in messages, where it is no line."""


def _rows(count: int, one: str, many: str) -> str:
    """Return a number of rows with a verb in its form for one or for many."""
    return f"1 row {one}" if count == 1 else f"{count:,} rows {many}"


class Table(Recording):
    """Recording that is a table: its reader calls `_begin`, then `_blocks` for its rows and `_finish`.

    Attributes
    ----------
    path : for messages.
    """

    path: str

    def _begin(
        self,
        columns: ColumnLayout,
        what: str,
        rate_hz: float | None,
        names: Sequence[str] = (),
        source: str = "",
    ) -> list[int]:
        """Prepare to read rows; return the indices of their columns in the table.

        Parameters
        ----------
        columns : columns of the stream.
        what : kind of the table: ``csv``, ``npz``, ``npy``, ``mat``, ``parquet``, ``bag``, ``px4``, ``ardupilot``.
        rate_hz : Hz, configured sample rate; None: not configured.
        names : of all columns of the table.
        source : what the samples are taken from, for people; empty: `what`.
        """
        self._row = ROW_NAMES.get(what, "line")
        self._first = FirstRows(self.path, columns, what, rate_hz, names, source or what)
        self._start: TableStart | None = None  # None before the first rows
        self._lost_before = 0  # rows lost before the next one
        self._used: list[int] | None = None  # columns that are not left out
        self._own_rows = OwnRows(self.path, columns)
        self._order: RowOrder | None = None  # of a table with times
        self._waiting: Floats | None = None  # values until their stamps have been placed
        self._waiting_lost = np.empty(0, np.int64)  # rows lost before each of these
        self._incomplete, self._first_incomplete = 0, ""  # rows that lacked a number, and where the first is
        self._back, self._first_back = 0, ""  # steps back of a clock, and where the first is
        self._last: Ints | None = None  # ns, the last two times
        self._last_row: Floats | None = None
        self._copies = 0  # rows left out because they are copies of the row before
        return [column.index for column in self._first.columns]

    def _blocks(self, rows: Floats, places: Sequence[int]) -> list[SampleBlock]:
        """Return the blocks of some rows, (n, k) with the columns of `_begin`; not finite is missing.

        Parameters
        ----------
        places : (n,) number of each row in its file, for messages; 0: the row has been reported.

        Raises
        ------
        RecordingError : the numbers cannot have their unit, or the rows are in no order. RateRequired : there is no
            time and no rate.
        """
        return self._noted(self._used_blocks(rows, places))

    def _finish(self) -> list[SampleBlock]:
        """Return the rows that still wait, at the end of the table; raise a `RecordingError` as `_blocks`."""
        return self._noted(self._last_blocks())

    def _noted(self, blocks: Iterator[SampleBlock]) -> list[SampleBlock]:
        """Return some blocks, and set what their rows show of the recording."""
        found = list(blocks)
        self.remarks = [*self._line_remarks(), *self._row_remarks()]
        if self._start is not None:
            self.assumed_unit = self._start.assumed_unit
            self.started = None if self._start.times is None else self._start.times.started
        return found

    def _line_remarks(self) -> Sequence[str]:
        """Return remarks on lines that are no rows."""
        return ()

    @property
    def _layout(self) -> ColumnLayout:
        return self._first.layout

    def _row_remarks(self) -> list[str]:
        """Return remarks on columns and rows that are not used, and on assumptions about units and stamps."""
        remarks = list(self._first.remarks)
        if self._incomplete:
            rows = _rows(self._incomplete, "lacks a number and counts", "lack a number and count")
            remarks.append(f"{rows} as lost; first {self._first_incomplete}")
        for sensor, count in self._own_rows.fillers.items():
            remarks.append(
                f"{_rows(count, 'has', 'have')} the same number on all axes of {sensor}: no samples of it"
            )
        if others := self._own_rows.others:
            sensors = " or ".join(
                dict.fromkeys(sensor_of(c) for c in self._layout.channels if sensor_of(c) in INERTIAL)
            )
            remarks.append(f"{others:,} rows have no number of {sensors}: they are no samples of it")
        if self._order is not None and self._order.moved:
            rows = _rows(self._order.moved, "is", "are")
            remarks.append(f"{rows} not in the order of {self._layout.times[0].name}: sorted by it")
        if self._copies:
            remarks.append(
                f"{_rows(self._copies, 'repeats', 'repeat')} the row before with its stamp: each sample counts once"
            )
        if self._back:
            times = "once" if self._back == 1 else f"{self._back:,} times"
            remarks.append(f"the time in {self._layout.times[0].name} steps back {times}; {self._first_back}")
        stamps = (
            self._start.times.stamps if self._start is not None and self._start.times is not None else None
        )
        if isinstance(stamps, HostStamps) and stamps.back_s:
            text = f"its clock steps back by {stamps.back_s:.6g} s"
            remarks.append(f"{text}: a gap of unknown length, counted as none")
        return remarks

    def _used_blocks(self, rows: Floats, places: Sequence[int]) -> Iterator[SampleBlock]:
        if len(rows):
            self._own_rows.mark_fillers(rows)
            rows, places = self._own_rows.select(rows, present(rows), places)
        if not len(rows):
            return
        if self._used is None:
            self._used = self._first.choose_columns(rows)
            if self._layout.times:
                self._order = RowOrder(self.path, self._layout.times[0].name)
        rows = rows[:, self._used]
        if self._order is not None:
            rows, places = self._order.sort(rows, self._sort_times(rows), places)
        yield from self._sorted_blocks(rows, places)

    def _sorted_blocks(self, rows: Floats, places: Sequence[int]) -> Iterator[SampleBlock]:
        """Yield blocks of some rows in order, with the columns that are used."""
        if not len(rows):
            return
        if self._start is None:
            self._start = self._first.start(rows)
        for k, held in self._first.held.items():
            held.fill(rows[:, k])
        if self._start.doubled:
            rows, places = self._without_copies(rows, places)
        good = self._first.complete(rows)
        kept = np.flatnonzero(good)
        if len(kept) < len(rows):
            self._note_incomplete(rows, np.flatnonzero(~good), places)
            places = [places[k] for k in kept.tolist()]
        lost = np.diff(kept, prepend=-1 - self._lost_before) - 1
        bad = len(rows) - len(kept)
        self.bad_checksums += bad
        self._lost_before += bad - int(lost.sum())
        if not len(kept):
            return
        yield from self._timed_blocks(self._start, rows[kept], lost, places)

    def _timed_blocks(
        self, start: TableStart, rows: Floats, lost: Ints, places: Sequence[int]
    ) -> Iterator[SampleBlock]:
        """Yield blocks of complete rows, with what their times show."""
        values, used = self._in_si(start.stream, rows), start.times
        if used is None:
            yield SampleBlock(start.stream, values, self._intervals(start.stream, rows), lost)
            return
        width = len(self._layout.columns)
        times = used.nanoseconds(rows[:, width : width + len(self._layout.times)])
        if not isinstance(used.stamps, HostStamps):
            self._note_back(times, places)
        yield from self._placed(start.stream, used, values, times, lost)

    def _in_si(self, stream: Stream, rows: Floats) -> Floats:
        """Return the values of complete rows, channel unit."""
        columns = self._layout.columns
        factors, zeros = [column.factor for column in columns], [column.zero for column in columns]
        values: Floats = rows[:, : len(columns)] * factors - zeros
        return self._over_interval(stream, values, rows) if self._layout.kind == "deltas" else values

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
            there, columns = present(rows[new[0]]), self._first.columns
            missing = [columns[k].name for k in self._first.needed if not there[k]]
            self._first_incomplete = f"{self._row} {places[new[0]]}: {', '.join(missing)}"
        self._incomplete += len(new)

    def _note_back(self, times: Ints, places: Sequence[int]) -> None:
        """Count the steps back of a sample clock on which two stamps on either side agree; note the first."""
        recent = np.concatenate([times[[0, 0]] if self._last is None else self._last, times])
        now = recent[2:]
        back = np.maximum(now, np.append(now[1:], now[-1])) < np.minimum(recent[1:-1], recent[:-2])
        if back.any() and not self._back:
            at = int(np.argmax(back))
            by_s = (recent[at + 1] - now[at]) * 1e-9
            where = f"{self._row} {places[at]}"
            self._first_back = f"first by {by_s:.6g} s at {where}: a gap of unknown length"
        self._back += int(back.sum())
        self._last = recent[-2:]

    def _last_blocks(self) -> Iterator[SampleBlock]:
        self._own_rows.check()
        if self._order is not None:
            no_rows = np.empty((0, len(self._used or ())))
            yield from self._sorted_blocks(*self._order.sort(no_rows, np.empty(0), (), final=True))
        if self._start is not None and self._start.times is not None:
            nothing = np.empty(0, np.int64)
            no_values = np.empty((0, len(self._layout.columns)))
            yield from self._placed(
                self._start.stream, self._start.times, no_values, nothing, nothing, final=True
            )

    def _placed(
        self,
        stream: Stream,
        used: TableTimes,
        values: Floats,
        times: Ints,
        lost: Ints,
        *,
        final: bool = False,
    ) -> Iterator[SampleBlock]:
        """Yield the oldest rows that wait: with their times on the grid, or with what a host shows to be lost."""
        values = values if self._waiting is None else np.concatenate([self._waiting, values])
        waiting = np.concatenate([self._waiting_lost, lost])
        found: Ints | None = None
        if isinstance(used.stamps, HostStamps):
            known = used.stamps.place(times.astype(np.float64), final=final)
        else:
            assert used.stamps is not None
            found = used.stamps.place(times, lost, final=final)
            known = waiting[: len(found)]
        ready = len(known)
        self._waiting, self._waiting_lost = values[ready:], waiting[ready:]
        if ready:
            yield SampleBlock(stream, values[:ready], found, known)

    def _sort_times(self, rows: Floats) -> Floats:
        """Return (n,) times by which rows are sorted, in any unit."""
        width = len(self._layout.columns)
        return rows[:, width] if len(self._layout.times) == 1 else rows[:, width : width + 2] @ (1e9, 1.0)

    def _over_interval(self, stream: Stream, values: Floats, rows: Floats) -> Floats:
        """Divide angles and velocities by the interval of each sample, else by the common one.

        Averages that are rates and accelerations remain as they are.
        """
        found = self._layout
        own = found.interval
        interval: Any = stream.interval_s if own is None else rows[:, -1:] * own.factor
        increments = [k for k, column in enumerate(found.columns) if column.quantity in ("angle", "velocity")]
        if increments:
            values[:, increments] /= interval
        return values

    def _intervals(self, stream: Stream, rows: Floats) -> Ints | None:
        """Return (n,) ns, the length of each sample; None: the table does not have it."""
        if stream.clock != "dt" or self._layout.interval is None:
            return None
        return np.rint(rows[:, -1] * self._layout.interval.factor * 1e9).astype(np.int64)
