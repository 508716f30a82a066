"""Table: rows of numbers as blocks of samples, from a file of any format or from memory.

A table has a column for each channel (`columns`) and mostly one of time; a table without time needs the rate. The way
of its rows, whoever reads them:

1. Columns without numbers, rows of other sensors, and rows that repeat a sample are left out (`row_selection`).
2. Late rows go back to their place (`row_selection`).
3. The first rows show the clock and the interval (`table_clock`).
4. A row that lacks a number is a lost sample.
5. Factors make the values SI. The placer of the stamps puts the samples on a grid, or a stream without a clock takes
   the lost samples from them (`timebase.stamp_placement`).

`Table` goes this way and knows no form of files: columns and blocks of rows in, `SampleBlock` out. Its subclasses read
the rows. A remark reports everything that is left out or assumed.

Example: a gyroscope of which one sample is missing.

>>> from imumon.sources.files.array_table import ArrayTable
>>> gyro = np.random.default_rng(0).normal(size=100)
>>> gyro[40] = np.nan
>>> table = ArrayTable({"t [s]": np.arange(100) * 0.01, "gyro_z [rad/s]": gyro}, ReadOptions())
>>> blocks = [block for blocks in table for block in blocks]
>>> sum(len(block.values) for block in blocks), sum(int(block.lost.sum()) for block in blocks)
(99, 1)
>>> table.remarks[-1]
'1 row lacks a number and counts as lost; first sample 41: gyro_z [rad/s]'
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from imumon.model.ledger import RECEIVED, Ledger, merged
from imumon.model.samples import Floats, Ints, SampleBlock, Stream
from imumon.sources.files.base import ReadOptions, Recording, RecordingError, RowSource
from imumon.sources.files.columns import INCREMENTS, ColumnLayout
from imumon.sources.files.row_selection import RowOrder, RowSelection, counted
from imumon.sources.files.table_clock import TableClock, TableTimes, clock_of


class Table(Recording):
    """Recording that is a table: its reader calls `_begin`, then `_blocks` for each block of rows, and `_finish`.

    Attributes
    ----------
    path : for messages.
    """

    path: str
    _clock: TableClock | None = None  # None before the first rows
    _stream: Stream | None = None
    _order: RowOrder | None = None  # of a table with times
    _waiting: Floats | None = None  # values until their stamps have been placed
    _rows_fed = _lost_before = 0  # all rows, and those lost before the next one
    _lacking, _first_lacking = 0, ""  # incomplete rows for the remark, and where the first is

    def _begin(self, source: RowSource, table_layout: ColumnLayout, options: ReadOptions) -> list[int]:
        """Prepare to read rows of some columns; return the indices of their columns in the table, in their order."""
        self._source, self._rate = source, options.rate_hz
        self._selection = RowSelection(source, table_layout)
        self._row_ledger = Ledger()
        return [column.index for column in self._selection.columns]

    def _blocks(self, rows: Floats, places: Ints) -> list[SampleBlock]:
        """Return the samples that some rows complete; the last rows may wait for the next ones.

        Parameters
        ----------
        rows : (n, k) with the columns of `_begin`; not finite is missing. May be changed. Column by column in memory,
            they take less time: all that follows works on columns.
        places : (n,) number of each row in its file, for messages; 0: the row has been reported.

        Raises
        ------
        RecordingError : the numbers cannot have their unit, or the rows are in no order. RateRequired : there is no
            time and no rate.
        """
        self._rows_fed += len(rows)
        rows, numbers = self._selection.select(rows, places)
        if self._selection.started and self._order is None and self._layout.times:
            self._order = RowOrder(self._source.name, self._layout.used)
        if self._order is not None:
            rows, numbers = self._order.sort(rows, numbers)
        return self._noted(self._sorted_blocks(rows, numbers))

    def _skip(self, count: int) -> None:
        """Note `count` more rows without a number, after a block of such rows was fed."""
        self._rows_fed += count
        if self._clock is not None:  # rows before the first sample are no losses
            self.bad_checksums += count
            self._lost_before += count
            self._lacking += count
        self._row_ledger.add("not_finite", count)

    def _finish(self) -> list[SampleBlock]:
        """Return the samples that still wait, at the end of the table; raise a `RecordingError` as `_blocks`."""
        return self._noted(self._last_blocks())

    def _noted(self, blocks: Iterator[SampleBlock]) -> list[SampleBlock]:
        """Return some blocks, after what their rows show is set on the recording."""
        decoded = list(blocks)
        selection, clock, times = self._selection, self._clock, self._times
        unused = dict(selection.unused)
        if clock is not None and clock.unused:
            unused |= {column.index: clock.unused for column in self._layout.times}
        self.columns = self._layout.account(self._source.column_names, unused)
        waiting = (0 if self._waiting is None else len(self._waiting)) + (
            0 if self._order is None else self._order.waiting
        )
        rows = self._row_ledger.counts(pending=waiting, **selection.left_out)
        self.ledger = merged(self._line_ledger(), rows)
        self.remarks = [*self._line_remarks(), *self._row_remarks()]
        self.started = None if times is None else times.started
        is_doubtful = clock is not None and clock.is_doubtful
        self.caveats = (*selection.caveats, *(["doubtful_rate"] if is_doubtful else []))
        return decoded

    def _line_ledger(self) -> Mapping[str, int]:
        """Return what was received, and what became of rows and lines that were not fed as numbers."""
        return {RECEIVED: self._rows_fed}

    def _line_remarks(self) -> Sequence[str]:
        """Return remarks on lines that are no rows."""
        return ()

    def _row_remarks(self) -> list[str]:
        """Return what is not used of columns and rows so far, and what is assumed about units and stamps."""
        remarks = self._selection.remarks
        if self._lacking:
            rows = counted(self._lacking, "lacks a number and counts", "lack a number and count")
            remarks.append(f"{rows} as lost; first {self._first_lacking}")
        if self._order is not None and self._order.moved:
            rows = counted(self._order.moved, "is", "are")
            remarks.append(f"{rows} not in the order of {self._layout.times[0].name}: sorted by it")
        remarks += [] if self._clock is None else self._clock.remarks
        if self._times is not None and self._times.placer.back_s:
            text = f"its clock steps back by {self._times.placer.back_s:.6g} s"
            remarks.append(f"{text}: a gap of unknown length, counted as none")
        return remarks

    @property
    def _times(self) -> TableTimes | None:
        return None if self._clock is None else self._clock.times

    @property
    def _layout(self) -> ColumnLayout:
        return self._selection.layout

    def _sorted_blocks(self, rows: Floats, places: Ints) -> Iterator[SampleBlock]:
        """Yield blocks of some rows in order, with the columns that are used."""
        if not len(rows):
            return
        complete = np.isfinite(rows[:, self._selection.needed]).all(axis=1)
        kept = np.flatnonzero(complete)
        if self._stream is None:
            self._stream = self._begun_stream(rows[kept])
        if len(kept) < len(rows):
            self._note_lacking(rows, np.flatnonzero(~complete), places)
        # lost rows belong to the sample after them, which may be in a later block
        lost = np.diff(kept, prepend=-1 - self._lost_before) - 1
        incomplete = len(rows) - len(kept)
        self.bad_checksums += incomplete
        self._lost_before += incomplete - int(lost.sum())
        if not len(kept):
            return
        rows = rows if len(kept) == len(rows) else rows[kept]
        values, width = self._in_si(self._stream, rows), len(self._layout.columns)
        if self._times is None:
            yield SampleBlock(self._stream, values, self._intervals(self._stream, rows), lost)
            return
        times = self._times.nanoseconds(rows[:, width : width + len(self._layout.times)])
        yield from self._placed(self._stream, self._times, values, times, lost)

    def _begun_stream(self, rows: Floats) -> Stream:
        """Return the stream of the samples, by the first complete rows."""
        layout, source = self._layout, self._source
        if not len(rows):
            raise self._no_complete_row()
        self._clock = clock_of(rows, layout, source, self._rate, held=bool(self._selection.held))
        self._selection.note_alternating(rows)
        sensors = ", ".join(dict.fromkeys(channel.sensor for channel in layout.channels))
        title = f"{source.title or source.form} ({sensors})"
        clock, interval_s = self._clock.clock, self._clock.interval_s
        return Stream(layout.kind, layout.channels, title, clock, interval_s, layout.gyro, layout.accel)

    def _no_complete_row(self) -> RecordingError:
        names = ", ".join(column.name for column in self._layout.columns)
        text = f"{self._source.name}: no row has numbers in all of {names}"
        return RecordingError("no_complete_row", text, "check that it is complete")

    def _in_si(self, stream: Stream, rows: Floats) -> Floats:
        """Return the values of complete rows, channel unit; angles and velocities become rates over the interval."""
        columns, interval = self._layout.columns, self._layout.interval
        factors, zeros = [column.factor for column in columns], [column.zero for column in columns]
        values: Floats = rows[:, : len(columns)] * factors
        if any(zeros):  # of degC and degF
            values -= zeros
        increments = [k for k, c in enumerate(columns) if c.quantity in INCREMENTS.values()]
        if increments:  # averages that are rates and accelerations remain as they are
            seconds: Any = stream.interval_s if interval is None else rows[:, -1:] * interval.factor
            values[:, increments] /= seconds
        return values

    def _note_lacking(self, rows: Floats, incomplete: Ints, places: Ints) -> None:
        """Count rows that lack a number and note where the first is; not those that the reader has reported."""
        unreported = incomplete[places[incomplete] > 0]
        if len(unreported) and not self._lacking:
            k, columns = unreported[0], self._layout.used
            missing = [columns[i].name for i in self._selection.needed if not np.isfinite(rows[k, i])]
            self._first_lacking = f"{self._source.row} {places[k]}: {', '.join(missing)}"
        self._lacking += len(unreported)
        # text has an empty cell there, other forms NaN
        self._row_ledger.add("not_numbers" if self._source.form == "csv" else "not_finite", len(unreported))

    def _last_blocks(self) -> Iterator[SampleBlock]:
        if self._rows_fed and not self._selection.started:
            raise self._no_complete_row()
        self._selection.check()
        if self._order is not None:
            no_rows, nowhere = np.empty((0, len(self._layout.used))), np.empty(0, np.int64)
            yield from self._sorted_blocks(*self._order.sort(no_rows, nowhere, final=True))
        if self._stream is not None and self._times is not None:
            no_values, nothing = np.empty((0, len(self._layout.columns))), np.empty(0, np.int64)
            yield from self._placed(self._stream, self._times, no_values, nothing, nothing, final=True)

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
        if stream.clock == "none":
            # rows without a number may be no samples: the stamps of a host show what is missing
            lost = np.zeros_like(lost)
        placed = used.placer.place(times, lost, final=final)
        ready = len(placed)
        self._waiting = values[ready:]
        if ready:
            times_ns = None if stream.clock == "none" else placed.times
            yield SampleBlock(stream, values[:ready], times_ns, placed.steps - 1)

    def _intervals(self, stream: Stream, rows: Floats) -> Ints | None:
        """Return (n,) ns, the length of each sample; None: the table does not have it."""
        if stream.clock != "dt" or self._layout.interval is None:
            return None
        return np.rint(rows[:, -1] * self._layout.interval.factor * 1e9).astype(np.int64)
