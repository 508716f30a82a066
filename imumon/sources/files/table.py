"""Table: rows of numbers as blocks of samples, from a file of any format or from memory.

A table has a column for each channel (`columns`) and mostly one of time; a table without time needs the rate. The way
of its rows, whoever reads them:

1. Rows of other sensors are left out; one number on all axes in place of a sample is none (`row_selection`).
2. The first rows decide which columns are used, their units, the clock and the interval (`first_rows`).
3. Late rows go back to their place (`row_selection`). Slow sensors are held, copies of a row are left out.
4. A row that lacks a number is a lost sample.
5. Factors make the values SI. The placer of the stamps puts the samples on a grid, or a stream without a clock takes
   the lost samples from them (`timebase.stamp_placement`).

`RowDecoder` goes this way and knows no file: names of columns and blocks of rows in, `SampleBlock` out. `Table` is the
recording whose reader feeds it. A remark reports everything that is left out or assumed.

Example: a gyroscope of which one sample is missing.

>>> from imumon.sources.files.column_reader import read_columns
>>> names = ["t [s]", "gyro_z [rad/s]"]
>>> rows = np.column_stack([np.arange(100) * 0.01, np.random.default_rng(0).normal(size=100)])
>>> rows[40, 1] = np.nan
>>> layout = read_columns(names, (), rows).layout()
>>> decoder = RowDecoder(RowSource("example", "npz", names), layout, rate_hz=None)
>>> blocks = [*decoder.feed(rows[:, decoder.columns], range(1, 101)), *decoder.finish()]
>>> sum(len(block.values) for block in blocks), sum(int(block.lost.sum()) for block in blocks)
(99, 1)
>>> decoder.remarks[-1]
'1 row lacks a number and counts as lost; first sample 41: gyro_z [rad/s]'
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from imumon.model.ledger import RECEIVED, ColumnUse, Ledger, column_account, merged
from imumon.model.report import MOST_CHARACTERS
from imumon.model.report_json import plain
from imumon.model.samples import INERTIAL, Floats, Ints, SampleBlock, Stream
from imumon.sources.files.base import ReadOptions, Recording, RecordingError, RowSource
from imumon.sources.files.columns import ColumnLayout
from imumon.sources.files.first_rows import FirstRows, TableStart, TableTimes, present
from imumon.sources.files.row_selection import RowOrder, SensorRows, copies

LARGEST = 1e10
"""Numbers beyond it, in the unit of the channel, are damage: raw counts of 32 bits are below, and a changed exponent of
a float is mostly above."""


def _rows(count: int, one: str, many: str) -> str:
    """Return a number of rows with a verb in its form for one or for many."""
    return f"1 row {one}" if count == 1 else f"{count:,} rows {many}"


class RowDecoder:
    """Turns blocks of rows into blocks of samples: `feed` for each block of rows, then `finish`.

    Parameters
    ----------
    source : of the rows.
    table_layout : columns of the stream.
    rate_hz : Hz, configured sample rate; None: not configured.

    Attributes
    ----------
    columns : indices, in the table, of the columns that the rows must have, in this order.
    fed : rows.
    incomplete : rows that lacked a number and count as lost, also those that the reader reported as invalid.
    ledger : what became of the rows that were fed and are no samples; those that the reader reported are in its own.
    """

    def __init__(self, source: RowSource, table_layout: ColumnLayout, rate_hz: float | None) -> None:
        self._source = source
        self._first = FirstRows(source, table_layout, rate_hz)
        self.columns = [column.index for column in self._first.columns]
        self.fed = self.incomplete = 0
        self._ledger = Ledger()
        self._start: TableStart | None = None  # None before the first rows
        self._lost_before = 0  # rows lost before the next one
        self._used: list[int] | None = None  # columns that are not left out
        self._sensor_rows = SensorRows(source.name, table_layout)
        self._order: RowOrder | None = None  # of a table with times
        self._waiting: Floats | None = None  # values until their stamps have been placed
        self._beyond = 0  # numbers that no sensor has
        self._unset_times = False  # a time of 0 is none
        self._lacking, self._first_lacking = 0, ""  # incomplete rows for the remark, and where the first is
        self._back, self._first_back = 0, ""  # steps back of a clock, and where the first is
        self._last: Ints | None = None  # ns, the last two times
        self._last_row: Floats | None = None
        self._last_values: Floats | None = None  # of the axes that are held in some rows
        self._held = 0  # rows left out because a sensor has no sample of its own in them
        self._copies = 0  # rows left out because they are copies of the row before

    @property
    def started(self) -> str | None:
        """Date of the first row; None: its time shows none, or no row has been fed."""
        return None if self._start is None or self._start.times is None else self._start.times.started

    @property
    def origin_ns(self) -> float | None:
        """ns, time of the first row as the table has it, from which the times of blocks count; None: there is none."""
        return None if self._start is None or self._start.times is None else self._start.times.origin_ns

    @property
    def caveats(self) -> tuple[str, ...]:
        """What limits the meaning of the numbers, as in `Recording`."""
        return tuple(self._first.caveats)

    @property
    def ledger(self) -> dict[str, int]:
        """What became of the rows that are no samples, by reason."""
        waiting = 0 if self._waiting is None else len(self._waiting)
        waiting += 0 if self._order is None else self._order.waiting
        return self._ledger.counts(pending=waiting, other_sensor=self._sensor_rows.others_counted)

    def feed(self, rows: Floats, places: Sequence[int] | Ints) -> list[SampleBlock]:
        """Return the samples that some rows complete; the last rows may wait for the next ones.

        Parameters
        ----------
        rows : (n, k) with `columns`; not finite is missing. May be changed.
        places : (n,) number of each row in its file, for messages; 0: the row has been reported.

        Raises
        ------
        RecordingError : the numbers cannot have their unit, or the rows are in no order. RateRequired : there is no
            time and no rate.
        """
        self.fed += len(rows)
        return list(self._used_blocks(rows, np.asarray(places, dtype=np.int64)))

    def skip(self, count: int) -> None:
        """Note `count` more rows without a number, after a block of such rows was fed."""
        self.fed += count
        if self._start is not None:  # rows before the first sample are no losses
            self.incomplete += count
            self._lost_before += count
            self._lacking += count
        self._ledger.add("not_finite", count)

    def finish(self) -> list[SampleBlock]:
        """Return the samples that still wait, at the end of the table; raise a `RecordingError` as `feed`."""
        return list(self._last_blocks())

    @property
    def _layout(self) -> ColumnLayout:
        return self._first.layout

    @property
    def remarks(self) -> list[str]:
        """What is not used of columns and rows so far, and what is assumed about units and stamps."""
        remarks = list(self._first.remarks)
        if self._beyond:
            numbers = "one number is" if self._beyond == 1 else f"{self._beyond:,} numbers are"
            remarks.append(f"{numbers} above {LARGEST:.0e} and of no sensor: the file may be damaged")
        if self._lacking:
            rows = _rows(self._lacking, "lacks a number and counts", "lack a number and count")
            remarks.append(f"{rows} as lost; first {self._first_lacking}")
        remarks += self._sensor_remarks()
        if self._order is not None and self._order.moved:
            rows = _rows(self._order.moved, "is", "are")
            remarks.append(f"{rows} not in the order of {self._layout.times[0].name}: sorted by it")
        if self._copies:
            remarks.append(
                f"{_rows(self._copies, 'repeats', 'repeat')} the row before with its stamp: each sample counts once"
            )
        if self._held:
            sensors = " and ".join(
                dict.fromkeys(self._layout.channels[k].sensor for k in self._first.repeated)
            )
            rows = _rows(self._held, "repeats", "repeat")
            remarks.append(f"{rows} the values of {sensors} of the row before: they are no samples of it")
        return [*remarks, *self._clock_remarks()]

    def _sensor_remarks(self) -> Iterator[str]:
        """Yield a remark on the rows that are no samples of a sensor."""
        for sensor, count in self._sensor_rows.fillers.items():
            yield f"{_rows(count, 'has', 'have')} the same number on all axes of {sensor}: no samples of it"
        if others := self._sensor_rows.others:
            sensors = " or ".join(
                dict.fromkeys(c.sensor for c in self._layout.channels if c.sensor in INERTIAL)
            )
            yield f"{others:,} rows have no number of {sensors}: they are no samples of it"

    def _clock_remarks(self) -> Iterator[str]:
        """Yield a remark on the steps back of the time, as the table has it and as the samples are placed."""
        if self._back:
            times = "once" if self._back == 1 else f"{self._back:,} times"
            yield f"the time in {self._layout.times[0].name} steps back {times}; {self._first_back}"
        used = self._start.times if self._start is not None else None
        if used is not None and used.placer.back_s:
            text = f"its clock steps back by {used.placer.back_s:.6g} s"
            yield f"{text}: a gap of unknown length, counted as none"

    def uses(self, names: Sequence[str]) -> tuple[ColumnUse, ...]:
        """Return what became of each column of a table, by the names of all its columns."""
        layout = self._layout
        uses = {c.index: str(channel) for channel, c in zip(layout.channels, layout.columns, strict=True)}
        unused = dict(self._first.unused)
        for column in layout.times:
            if self._first.no_time:
                unused[column.index] = self._first.no_time
            else:
                uses[column.index] = "time"
        uses |= {} if layout.interval is None else {layout.interval.index: "interval"}
        return column_account(
            [
                ColumnUse(
                    name=plain(name.strip())[:MOST_CHARACTERS],
                    use=uses.get(k),
                    reason=None if k in uses else unused.get(k),
                )
                for k, name in enumerate(names)
                if name.strip()
            ]
        )

    def _used_blocks(self, rows: Floats, places: Ints) -> Iterator[SampleBlock]:
        if len(rows):
            # before anything judges the rows: the rows of another sensor would look like losses
            self._sensor_rows.mark_fillers(rows)
            rows, places = self._sensor_rows.select(rows, present(rows), places)
        if not len(rows):
            return
        if self._used is None:
            self._used = self._first.choose_columns(rows)
            self._unset_times = self._first.note_unset_times(rows[:, self._used])
            if self._layout.times:
                self._order = RowOrder(self._source.name, self._layout.times[0].name)
        rows = rows[:, self._used]
        if self._unset_times:
            times = rows[:, len(self._layout.columns)]
            times[times == 0.0] = np.nan
        if self._order is not None:
            rows, places = self._order.sort(rows, self._sort_times(rows), places)
        yield from self._sorted_blocks(rows, places)

    def _sorted_blocks(self, rows: Floats, places: Ints) -> Iterator[SampleBlock]:
        """Yield blocks of some rows in order, with the columns that are used."""
        if not len(rows):
            return
        rows = self._possible(rows)
        if self._start is None:
            self._start = self._first.start(rows)
        for k, held in self._first.held.items():
            held.fill(rows[:, k])
        if self._start.doubled:
            rows, places = self._without_copies(rows, places)
        if self._first.repeated:
            rows, places = self._without_held(rows, places)
        complete = self._first.complete(rows)
        kept = np.flatnonzero(complete)
        if len(kept) < len(rows):
            self._note_lacking(rows, np.flatnonzero(~complete), places)
            places = places[kept]
        # lost rows belong to the sample after them, which may be in a later block
        lost = np.diff(kept, prepend=-1 - self._lost_before) - 1
        incomplete = len(rows) - len(kept)
        self.incomplete += incomplete
        self._lost_before += incomplete - int(lost.sum())
        if not len(kept):
            return
        yield from self._timed_blocks(self._start, rows[kept], lost, places)

    def _possible(self, rows: Floats) -> Floats:
        """Return the rows without numbers that no sensor has; they count as missing, and are noted."""
        factors = [column.factor for column in self._layout.columns]
        with np.errstate(over="ignore"):
            beyond = np.abs(rows[:, : len(factors)] * factors) > LARGEST
        if not beyond.any():
            return rows
        self._beyond += int(beyond.sum())
        possible = rows.copy()
        possible[:, : len(factors)][beyond] = np.nan
        return possible

    def _timed_blocks(
        self, start: TableStart, rows: Floats, lost: Ints, places: Ints
    ) -> Iterator[SampleBlock]:
        """Yield blocks of complete rows, with what their times show."""
        values, used = self._in_si(start.stream, rows), start.times
        if used is None:
            yield SampleBlock(start.stream, values, self._intervals(start.stream, rows), lost)
            return
        width = len(self._layout.columns)
        times = used.nanoseconds(rows[:, width : width + len(self._layout.times)])
        # the clock of a host may be set back, which says nothing of the sensor
        if start.stream.clock != "none":
            self._note_back(times, places)
        yield from self._placed(start.stream, used, values, times, lost)

    def _in_si(self, stream: Stream, rows: Floats) -> Floats:
        """Return the values of complete rows, channel unit."""
        columns = self._layout.columns
        factors, zeros = [column.factor for column in columns], [column.zero for column in columns]
        values: Floats = rows[:, : len(columns)] * factors - zeros
        return self._over_interval(stream, values, rows) if self._layout.has_increments else values

    def _without_copies(self, rows: Floats, places: Ints) -> tuple[Floats, Ints]:
        """Return the rows that differ from the row before."""
        before = rows[:1] if self._last_row is None else self._last_row
        same = copies(np.concatenate([before, rows]))
        same[0] &= self._last_row is not None
        self._last_row = rows[-1:] if len(rows) else self._last_row
        self._copies += int(same.sum())
        self._ledger.add("repeated", int((places[same] > 0).sum()))
        return rows[~same], places[~same]

    def _without_held(self, rows: Floats, places: Ints) -> tuple[Floats, Ints]:
        """Return the rows in which a sensor has a sample of its own, and not that of the row before."""
        if not len(rows):
            return rows, places
        values = rows[:, self._first.repeated]
        before = np.full((1, values.shape[1]), np.inf) if self._last_values is None else self._last_values
        held = copies(np.concatenate([before, values])) & np.isfinite(values).all(axis=1)
        self._last_values = values[-1:]
        self._held += int(held.sum())
        self._ledger.add("repeated", int((places[held] > 0).sum()))
        return rows[~held], places[~held]

    def _note_lacking(self, rows: Floats, incomplete: Ints, places: Ints) -> None:
        """Count rows that lack a number and note where the first is; not those that the reader has reported."""
        unreported = incomplete[places[incomplete] > 0]
        if len(unreported) and not self._lacking:
            k = unreported[0]
            there, columns = present(rows[k]), self._first.columns
            missing = [columns[i].name for i in self._first.needed if not there[i]]
            self._first_lacking = f"{self._source.row} {places[k]}: {', '.join(missing)}"
        self._lacking += len(unreported)
        # text has an empty cell there, other forms NaN
        self._ledger.add("not_numbers" if self._source.form == "csv" else "not_finite", len(unreported))

    def _note_back(self, times: Ints, places: Ints) -> None:
        """Count the steps back of a sample clock on which two stamps on either side agree; note the first."""
        # two: a single wrong stamp, forward or back, is no step of the clock
        recent = np.concatenate([times[[0, 0]] if self._last is None else self._last, times])
        now = recent[2:]
        back = np.maximum(now, np.append(now[1:], now[-1])) < np.minimum(recent[1:-1], recent[:-2])
        if back.any() and not self._back:
            first = int(np.argmax(back))
            by_s = (recent[first + 1] - now[first]) * 1e-9
            where = f"{self._source.row} {places[first]}"
            self._first_back = f"first by {by_s:.6g} s at {where}: a gap of unknown length"
        self._back += int(back.sum())
        self._last = recent[-2:]

    def _last_blocks(self) -> Iterator[SampleBlock]:
        if self.fed and self._used is None:
            names = ", ".join(column.name for column in self._layout.columns)
            text = f"{self._source.name}: no row has numbers for all of {names}"
            raise RecordingError("no_complete_row", text, "check that it is complete")
        self._sensor_rows.check()
        if self._order is not None:
            no_rows = np.empty((0, len(self._used or ())))
            nowhere = np.empty(0, np.int64)
            yield from self._sorted_blocks(*self._order.sort(no_rows, np.empty(0), nowhere, final=True))
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
        if stream.clock == "none":
            # rows without a number may be no samples: the stamps of a host show what is missing
            lost = np.zeros_like(lost)
        placed = used.placer.place(times, lost, final=final)
        ready = len(placed)
        self._waiting = values[ready:]
        if ready:
            times_ns = None if stream.clock == "none" else placed.times
            yield SampleBlock(stream, values[:ready], times_ns, placed.steps - 1)

    def _sort_times(self, rows: Floats) -> Floats:
        """Return (n,) times by which rows are sorted, in any unit."""
        width = len(self._layout.columns)
        # of seconds and nanoseconds the sum, ns: rounded to 256 ns, which is no matter for an order
        return rows[:, width] if len(self._layout.times) == 1 else rows[:, width : width + 2] @ (1e9, 1.0)

    def _over_interval(self, stream: Stream, values: Floats, rows: Floats) -> Floats:
        """Divide angles and velocities by the interval of each sample, else by the common one.

        Averages that are rates and accelerations remain as they are.
        """
        column = self._layout.interval
        interval: Any = stream.interval_s if column is None else rows[:, -1:] * column.factor
        increments = [k for k, c in enumerate(self._layout.columns) if c.quantity in ("angle", "velocity")]
        if increments:
            values[:, increments] /= interval
        return values

    def _intervals(self, stream: Stream, rows: Floats) -> Ints | None:
        """Return (n,) ns, the length of each sample; None: the table does not have it."""
        if stream.clock != "dt" or self._layout.interval is None:
            return None
        return np.rint(rows[:, -1] * self._layout.interval.factor * 1e9).astype(np.int64)


class Table(Recording):
    """Recording that is a table: its reader calls `_begin`, then `_blocks` for its rows and `_finish`.

    Attributes
    ----------
    path : for messages.
    """

    path: str

    def _begin(self, source: RowSource, table_layout: ColumnLayout, options: ReadOptions) -> list[int]:
        """Prepare to read rows of some columns; return the indices of their columns in the table."""
        self._rows, self._column_names = (
            RowDecoder(source, table_layout, options.rate_hz),
            source.column_names,
        )
        return self._rows.columns

    def _blocks(self, rows: Floats, places: Sequence[int] | Ints) -> list[SampleBlock]:
        """Return the samples of some rows, as `RowDecoder.feed`."""
        return self._noted(self._rows.feed(rows, places))

    def _finish(self) -> list[SampleBlock]:
        """Return the samples that still wait, as `RowDecoder.finish`."""
        return self._noted(self._rows.finish())

    def _noted(self, blocks: list[SampleBlock]) -> list[SampleBlock]:
        """Return some blocks, after what their rows show is set on the recording."""
        self.bad_checksums = self._rows.incomplete
        self.columns = self._rows.uses(self._column_names)
        self.ledger = merged(self._line_ledger(), self._rows.ledger)
        self.remarks = [*self._line_remarks(), *self._rows.remarks]
        self.started = self._rows.started
        self.caveats = self._rows.caveats
        return blocks

    def _line_ledger(self) -> Mapping[str, int]:
        """Return what was received, and what became of rows and lines that were not fed to the decoder as numbers."""
        return {RECEIVED: self._rows.fed}

    def _line_remarks(self) -> Sequence[str]:
        """Return remarks on lines that are no rows."""
        return ()
