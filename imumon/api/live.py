"""Live analysis: samples that come block by block, in bounded memory.

Rows are collected until they fill a block of the size that arrays are read in, and go the way of a recording then.
Blocks of any size therefore give the report that `imumon.analyse` gives of all samples together. A result in between
is that of a copy: it changes nothing for the samples that follow.

>>> import imumon
>>> gyro = imumon.simulate(20_000, 200.0, N=[6.1e-5] * 3, seed=1)
>>> live = imumon.Live(rate_hz=200.0, channels=("gyro/x", "gyro/y", "gyro/z"), kind="average")
>>> for first in range(0, len(gyro), 777):
...     live.update(gyro[first : first + 777])
>>> live.result()["gyro/z"].N == imumon.analyse(gyro, rate_hz=200.0, kind="average")["gyro/z"].N
True
"""

from __future__ import annotations

import copy
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from imumon.api.document_report import document_report
from imumon.api.measurement import Measurement
from imumon.api.record_analysis import (
    array_remarks,
    checked_precision,
    one_thread,
    require_noise,
)
from imumon.api.replay_options import ReplayOptions, SensorFilter
from imumon.api.replayed_record import ReplayedRecord
from imumon.api.sensor_arrays import SI, checked_rate
from imumon.checkpoint import StateError, decode, encode
from imumon.files import replace_file
from imumon.model.cures import python_caller
from imumon.model.errors import ImumonError
from imumon.model.ledger import merged
from imumon.model.samples import CHANNELS, GYRO, ChannelName, Floats, SampleBlock
from imumon.model.saved_state import pack, restorable
from imumon.model.system_errors import not_read, not_written
from imumon.record import RecordOptions
from imumon.record.record import SavedRecord
from imumon.sources.files.array_table import IN_MEMORY, INPUT, float_array
from imumon.sources.files.base import ROWS, OptionError, ReadOptions, RecordingError, RowSource, Samples
from imumon.sources.files.column_reader import read_columns
from imumon.sources.files.sizes_at_rest import FEWEST
from imumon.sources.files.table import Table


@restorable
@dataclass(frozen=True, slots=True, kw_only=True)
class SavedLive:
    """What `Live.load` continues from.

    Attributes
    ----------
    arguments : of `Live`.
    origin_ns : ns, time of the first row; None: rows have no times.
    record : of these rows.
    ledger : of the rows so far.
    """

    arguments: dict[str, Any]
    origin_ns: float | None
    record: SavedRecord
    ledger: dict[str, int]


MOST_MISSING = 1 << 48
"""Rows of a gap that are counted: a longer one is of unknown length at any rate, and sums of it fit 64 bits."""


class PushedTable(Table):
    """Table of arrays whose rows are pushed.

    Parameters
    ----------
    channels : of its columns, in the order of a stream.
    timed : its last column is a time, s.
    origin_ns : ns, time of the first row of a record that is continued; None: it begins here.
    """

    path = INPUT

    def __init__(
        self, channels: Sequence[str], timed: bool, options: ReadOptions, origin_ns: float | None = None
    ) -> None:
        names = [channel.replace("/", "_") for channel in channels] + ["time [s]"] * timed
        units = (
            SI
            | ({"gyro": "rad", "accel": "m/s"} if options.samples == "increment" else {})
            | dict(options.units)
        )
        fields = {
            channel: f"{k + 1}:{units.get(ChannelName(channel).sensor, 'kPa')}"
            for k, channel in enumerate(channels)
        }
        fields |= {"t": f"{len(names)}:{units['time']}"} if timed else {}
        stated = replace(options, columns=fields, units={})
        self._names, self._stated = names, stated
        reading = read_columns(names, (), np.empty((0, len(names))), stated)
        self._columns = self._begin(RowSource(INPUT, IN_MEMORY, names), reading.layout(), options)
        self._pushed = 0
        self.origin_ns = origin_ns
        self._later_ns = 0  # by which the times of this table begin after those of the record

    def push(self, rows: Floats) -> list[SampleBlock]:
        """Return the samples that (n, c) more rows complete; NaN is missing."""
        first = self._pushed + 1
        self._pushed += len(rows)
        if first == 1 and len(rows) >= FEWEST:  # an acceleration that is 1 g in another unit is refused
            read_columns(self._names, (), rows, self._stated)
        chosen = np.ascontiguousarray(rows[:, self._columns])
        self.fed += chosen.nbytes
        return self._since_origin(self._blocks(chosen, np.arange(first, self._pushed + 1)))

    def skip(self, count: int) -> None:
        """Note `count` more missing rows, after a block of them was pushed."""
        self._pushed += count
        self._skip(count)

    def end(self) -> list[SampleBlock]:
        """Return the samples that still wait."""
        return self._since_origin(self._finish())

    def _since_origin(self, blocks: list[SampleBlock]) -> list[SampleBlock]:
        """Return blocks whose times count from the first row of the record: a decoder counts from its first."""
        first_ns = None if self._times is None else self._times.origin_ns
        if first_ns is not None and self.origin_ns is None:
            self.origin_ns = first_ns
        if first_ns is not None and self.origin_ns is not None:
            self._later_ns = round(first_ns - self.origin_ns)
        if not self._later_ns:
            return blocks
        return [b if b.time_ns is None else replace(b, time_ns=b.time_ns + self._later_ns) for b in blocks]

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{INPUT} has no samples", "update it with samples first")


class Live:
    """Analyse samples as they come.

    Parameters
    ----------
    rate_hz : Hz, sample rate; None: each update has times.
    channels : of the columns of a block, such as ``gyro/x``; a sensor has three axes or one.
    kind, units, guards, filter, precision : as of `imumon.analyse`.

    Raises
    ------
    ImumonError : a channel is unknown, or an option has no meaning.
    """

    def __init__(
        self,
        rate_hz: float | None = None,
        channels: Sequence[str] = GYRO,
        *,
        kind: Samples | None = None,
        units: Mapping[str, str] | None = None,
        guards: bool = True,
        filter: str | None = None,
        precision: Mapping[str, float] | None = None,
    ) -> None:
        with python_caller():
            unknown = [name for name in channels if name not in CHANNELS]
            if unknown or not channels or len(set(channels)) < len(channels):
                text = f"channels={tuple(channels)!r} are not those of a sensor"
                raise OptionError("channels_invalid", text, f"choose from {', '.join(CHANNELS)}")
            self.channels = tuple(channels)
            self._options = ReplayOptions(
                arrays={},
                read=ReadOptions(
                    rate_hz=checked_rate(rate_hz, alone=True), units=dict(units or {}), samples=kind
                ),
                record=RecordOptions(guarded=guards, precision=checked_precision(precision)),
                filter=None if filter is None else SensorFilter.parse(filter),
            )
        self._table: PushedTable | None = None  # None before the first block, which may have times
        self._replayed: ReplayedRecord | None = None
        self._timed = self._restored = False
        self._waiting: list[Floats] = []
        self._rows_waiting = 0

    def update(self, block: Any, time_s: Any = None, missing: Any = None) -> None:
        """Add samples.

        Parameters
        ----------
        block : (n, c), a column for each of the channels, or (n,) of one channel. NaN and masked values are missing.
        time_s : (n,) s, time of each sample; given in every update or in none.
        missing : (n,) whether each sample is missing; or a number of samples that are missing before this block.

        Raises
        ------
        ImumonError : the block has another shape, or its samples cannot be those of a sensor.
        """
        with python_caller():
            before, rows = self._rows(block, time_s, missing)
            if self._table is None:
                self._begin(timed=time_s is not None)
            elif self._timed != (time_s is not None) and len(rows):
                text = "some updates have times and others have none"
                raise OptionError("time_missing", text, "give time_s in every update, or in none")
            if before:
                self._skip(before)
            self._add(rows)

    def result(self) -> Measurement:
        """Return the measurement of all samples so far.

        Raises
        ------
        ImumonError : there are none, or they cannot be those of a sensor.
        """
        with python_caller(), one_thread():
            ended = copy.deepcopy(self)
            report = ended._ended()
            require_noise(self._options, report)
            notes = array_remarks(self._options, report)
            return Measurement(document_report(report), notes)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a state from which `load` continues, in another process or on another day.

        Raises
        ------
        ImumonError : there are no samples yet, or the file cannot be written.
        """
        with python_caller(), one_thread():
            ended = copy.deepcopy(self)
            ended._push_all()
            replayed, table = ended._replayed, ended._table
            if replayed is None or table is None or not replayed.record.samples:
                raise RecordingError("no_rows", f"{INPUT} has no samples", "update it with samples first")
            options = self._options
            saved = SavedLive(
                arguments={
                    "channels": self.channels,
                    "rate_hz": options.read.rate_hz,
                    "kind": options.read.samples,
                    "units": dict(options.read.units),
                    "guards": options.record.guarded,
                    "filter": options.filter.text if options.filter else None,
                    "precision": dict(options.record.precision),
                },
                origin_ns=table.origin_ns,
                record=replayed.record.save(),
                ledger=dict(replayed.left_out()),
            )
            try:
                replace_file(os.fspath(path), encode(pack(saved)))
            except OSError as error:
                raise not_written(os.fspath(path), error, "name another file") from None

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Live:
        """Return what `save` wrote. The time until the next samples is a gap, whose length only `time_s` shows.

        Raises
        ------
        ImumonError : the file cannot be read, or is no such state.
        """
        name = os.fspath(path)
        try:
            data = Path(name).read_bytes()
        except OSError as error:
            raise not_read(name, error) from None
        try:
            saved = decode(data, name)
        except StateError as error:
            raise ImumonError(error.code, error.message, "save one with Live.save") from None
        if not isinstance(saved, SavedLive):
            raise ImumonError("state_invalid", f"{name} is the state of a daemon", "save one with Live.save")
        live = cls(**saved.arguments)
        live._begin(timed=saved.origin_ns is not None, origin_ns=saved.origin_ns)
        assert live._replayed is not None
        live._replayed.record.restore(saved.record, 0.0)
        live._replayed.earlier_ledger = merged(saved.ledger)
        live._restored = True
        return live

    def _begin(self, *, timed: bool, origin_ns: float | None = None) -> None:
        options = self._options
        if not timed and options.read.rate_hz is None:
            raise OptionError(
                "rate_required", "there is neither a rate nor a time", "give rate_hz, or time_s"
            )
        self._table = PushedTable(self.channels, timed, options.read, origin_ns)
        self._replayed = ReplayedRecord(options, self._table)
        self._timed = timed

    def _rows(self, block: Any, time_s: Any, missing: Any) -> tuple[int, Floats]:
        """Return the rows that are missing before a block, and its rows with NaN where they are missing.

        Times are the last column. They show what is missing themselves.
        """
        values = float_array("the block", block)
        values = values.reshape(-1, 1) if values.ndim == 1 and len(self.channels) == 1 else values
        if values.ndim != 2 or values.shape[1] != len(self.channels):
            text = f"the block has the shape {values.shape}, and there are {len(self.channels)} channels"
            raise RecordingError(
                "array_shape", text, f"give (n, {len(self.channels)}), a column for each channel"
            )
        before = 0
        if isinstance(missing, int | np.integer) and not isinstance(missing, bool):
            before = int(missing)
            if before < 0:
                raise OptionError(
                    "missing_invalid", f"missing={before} is no number of samples", "give 0 or more"
                )
        elif missing is not None:
            flags = np.asarray(missing)
            if flags.shape != (len(values),) or flags.dtype != bool:
                text = f"missing has the shape {flags.shape} and the type {flags.dtype}"
                cure = f"give ({len(values)},) bools, or the number of samples before the block"
                raise OptionError("missing_invalid", text, cure)
            values = np.where(flags[:, None], np.nan, values)
        if time_s is None:
            return before, values
        times = float_array("time_s", time_s)
        if times.shape != (len(values),):
            text = f"time_s has the shape {times.shape}, and the block {len(values)} samples"
            raise RecordingError("array_shape", text, "give one time for each sample")
        return 0, np.asarray(np.column_stack([values, times]))

    def _skip(self, count: int) -> None:
        """Add missing rows: the block in progress and a whole one as rows, further whole blocks as a number."""
        count = min(count, MOST_MISSING)
        whole = max(0, count - (2 * ROWS - self._rows_waiting)) // ROWS * ROWS
        no_row = np.full(len(self.channels), np.nan)
        if whole:
            filling = 2 * ROWS - self._rows_waiting
            self._add(np.tile(no_row, (filling, 1)))
            assert self._table is not None
            self._table.skip(whole)
            count -= filling + whole
        self._add(np.tile(no_row, (count, 1)))

    def _add(self, rows: Floats) -> None:
        """Queue rows, and feed the blocks that are full."""
        self._waiting.append(rows)
        self._rows_waiting += len(rows)
        if self._rows_waiting >= ROWS:
            with one_thread():
                for chunk in self._full_blocks():
                    self._feed(chunk)

    def _full_blocks(self) -> Iterator[Floats]:
        """Yield blocks of `ROWS` rows: the size of a block decides nothing if it is always the same."""
        rows = np.concatenate(self._waiting)
        full = len(rows) // ROWS * ROWS
        self._waiting, self._rows_waiting = [rows[full:].copy()], len(rows) - full
        yield from np.split(rows[:full], full // ROWS)

    def _feed(self, rows: Floats) -> None:
        assert self._table is not None
        assert self._replayed is not None
        for block in self._table.push(rows):
            self._replayed.record.feed(block)

    def _push_all(self) -> None:
        """Feed the samples that wait; nothing can be added after this."""
        if self._table is None or self._replayed is None:
            raise RecordingError("no_rows", f"{INPUT} has no samples", "update it with samples first")
        if self._rows_waiting:
            self._feed(np.concatenate(self._waiting))
        for block in self._table.end():
            self._replayed.record.feed(block)

    def _ended(self) -> Any:
        """Return the report of all samples; nothing can be added after this."""
        self._push_all()
        assert self._replayed is not None
        if self._restored and not self._replayed.record.samples:
            self._replayed.record.accept_restored()  # no samples have come since
        return self._replayed.final()
