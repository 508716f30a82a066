"""Decoder of lines: bytes in any chunks to samples, without I/O and clock.

Rules, which do not depend on the chunks:

- A line ends with LF, or CR and LF. A sample is a line with one number for each column, apart by commas, semicolons,
  tabs or blanks. If semicolons are apart, a comma is a decimal sign.
- A line may have names beside its numbers (``ax: 0.1, ay: 0.2``, or JSON): see `text_fields`. A sample is complete
  when a name comes again; then its names are a header, and its numbers a line.
- Any other line counts as invalid and, where the stream has no clock, as a lost sample. So does one in which the
  time, or a value of gyroscope or accelerometer, is no finite number. Other values may be no number: they are unknown.
- Blank lines, lines that begin with ``#``, and header lines are no samples and nothing is lost by them. A header sets
  the columns, unless they are given or samples came before it.
- A line longer than `LONGEST_LINE` is discarded up to its end.
- A header has at most `MOST_NAMES` names. Once samples came, it has as many names as they have numbers: to read a name
  takes a hundred times as long as a number, and a board may print other text all the time.
- A time without a unit has the one that the first `UNIT_ROWS` samples show (`unit_of_time`); they wait for it.
- A counter that wraps continues. A time that goes back otherwise is that of a restarted sensor.

A line has no checksum, so a damaged digit is a number like any other.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.grid.counter_wraps import wrap_ns
from imumon.grid.live_stamps import LiveStamps
from imumon.model.errors import QUOTED
from imumon.model.ledger import Ledger
from imumon.model.report_json import plain
from imumon.model.samples import AXES, LONGEST_NS, Floats, SampleBlock
from imumon.sources.device import RESTART_NS
from imumon.sources.lines.line_columns import (
    DEFAULT_COLUMNS,
    DEFAULT_UNIT,
    LineColumns,
    columns_of,
    header_columns,
    proposed_settings,
    unit_of_time,
)
from imumon.sources.rest_sizes import is_one_g, median_size, sample_noise, too_noisy
from imumon.sources.text_fields import RecordAssembler, fields_of

LONGEST_LINE = 4096
"""Bytes of a line at most, where the settings say nothing."""
MOST_NAMES = 128
"""Names of a header at most: there are eleven channels, and a board prints some columns of its own."""
SIZE_SAMPLES = 100
"""First samples, whose sizes are compared with those of a sensor at rest."""
PROPOSED_ROWS = 25
"""Lines of numbers that are no samples, from which columns are proposed."""
UNIT_ROWS = 25
"""Samples from which the unit of a time is inferred: a quarter of a second at 100 Hz."""

_NUMBER = re.compile(rb"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Row:
    """A sample: its time as it was printed, values in SI, and lines that were lost before it."""

    time: str
    values: list[float]
    lost: int
    time_ns: int = 0  # once its unit is known


class _NoSample(Exception):
    """A line is no sample: the text says why, and the reason is that of the ledger."""

    def __init__(self, text: str, reason: str) -> None:
        super().__init__(text)
        self.reason = reason


class LineDecoder:
    """Feed bytes, get samples; see `imumon.sources.device.RawDecoder`.

    Parameters
    ----------
    settings : columns and units, see `line_columns`; without ``columns``, a header line gives them, or they are
        the default.
    needs_header : there is no default.

    Attributes
    ----------
    columns : in use; None before a header that is needed.
    remarks : doubts about the lines, one each.

    >>> decoder = LineDecoder({"columns": "gx,gy,gz"})
    >>> decoder.feed(b"1,2,3\\nhello\\n4,5,6\\n7,8")[0].values.tolist(), decoder.discarded, decoder.pending
    ([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], 6, 3)
    """

    def __init__(self, settings: Mapping[str, str], *, needs_header: bool = False) -> None:
        self.fed = self.messages = self.message_bytes = self.discarded = self.bad_checksums = 0
        self._ledger = Ledger()
        self.columns: LineColumns | None = None
        self._settings, self._given = settings, "columns" in settings
        if not needs_header:
            self.columns = columns_of({"columns": DEFAULT_COLUMNS} | dict(settings))
        self._rest = b""
        self._records = RecordAssembler()  # of lines with names beside the numbers
        self._record_lines = 0  # of the record that has begun
        self._skipping = self._begun = False  # an overlong line; samples or a header were there
        self._lost = 0  # invalid lines since the last sample
        self._fault: str | None = None
        self._stamps: LiveStamps | None = None
        self._resolution = 0.0  # ns, of the last time
        self._offset = 0  # ns, of all wraps so far
        self._last: int | None = None  # ns, before its wraps are undone
        self._without_unit: list[_Row] = []  # wait for the unit of their time
        self._assumed_unit: str | None = None  # remark on it
        self._waiting: list[_Row] = []  # whose time is not decided
        self._unmatched: list[list[float]] = []  # numbers of lines that are no samples, at the start
        self._proposal: str | None = None  # columns that they fit
        self._first: list[list[float]] = []  # values of the first samples, in SI
        self._unit_doubts: tuple[str, ...] = ()

    @property
    def pending(self) -> int:
        """Bytes of a line whose end is missing."""
        return len(self._rest)

    @property
    def ledger(self) -> dict[str, int]:
        """What became of all lines but those that are samples, by reason."""
        waiting = len(self._without_unit) + len(self._waiting)
        return self._ledger.counts(pending=waiting + self._record_lines)

    def skip_line(self) -> None:
        """Count a line that was not fed: of a stream that had begun before, it may be half of one."""
        self._ledger.receive()
        self._ledger.add("start")

    @property
    def remarks(self) -> tuple[str, ...]:
        stamps = self._stamps.remark if self._stamps is not None else None
        doubts = [self._fault, self._proposal, stamps, self._assumed_unit, *self._unit_doubts]
        return tuple(text for text in doubts if text)

    def feed(self, data: bytes) -> list[SampleBlock]:
        """Return the samples of the lines that `data` completes."""
        self.fed += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        blocks: list[SampleBlock] = []
        rows: list[_Row] = []
        for line in lines:
            for row in self._timed(self._line(line)):
                if self._restarted(row):
                    # decide what waits by the old clock: no stamp of the new one says anything about it
                    blocks += self._blocks(rows, final=True)
                    rows, self._stamps, self._offset = [], None, 0
                rows.append(replace(row, time_ns=row.time_ns + self._offset) if self._offset else row)
        if len(self._rest) > LONGEST_LINE:
            self.discarded += len(self._rest)
            self._skipping, self._rest = True, b""
        return [*blocks, *self._blocks(rows, final=False)]

    def finish(self) -> list[SampleBlock]:
        """Return what waits, at the end of the stream. A line without its end may be half of one: it is discarded."""
        self.discarded += len(self._rest)
        if self._rest or self._skipping:
            self._ledger.receive()
            self._ledger.add("pending")
        self._rest, self._skipping = b"", False
        last: _Row | None = None
        if (record := self._records.finish()) is not None:
            lines, self._record_lines = self._record_lines, 0
            try:
                last = self._record_sample(record, lines)
            except _NoSample as fault:
                self._ledger.add(fault.reason)
        return self._blocks(self._timed(last, final=True), final=True)

    # ------------------------------------------------------------------ lines

    def _line(self, line: bytes) -> _Row | None:
        """Return the sample of a line, if it is one; count the line in any case."""
        size, text = len(line) + 1, line.strip()
        skipped, self._skipping = self._skipping, False
        self._ledger.receive()
        try:
            if skipped or len(line) > LONGEST_LINE:
                raise _NoSample("is too long", "damaged")
            row = None if not text or text.startswith(b"#") else self._parsed(text)
        except _NoSample as fault:
            self.discarded += size
            self.bad_checksums += 1  # the nearest that a line without a checksum has
            self._lost += 1
            greeting = not self._begun and fault.reason == "not_numbers"
            self._ledger.add("start" if greeting else fault.reason)
            self._fault = self._fault or f"a line is no sample: it {fault}"
            return None
        if not text or text.startswith(b"#"):
            self.discarded += size
            self._ledger.add("comment" if text else "blank")
        else:
            self.messages += 1
            self.message_bytes += size
        return row

    def _parsed(self, text: bytes) -> _Row | None:
        """Return the sample of a line; None of a header. Raise `_NoSample` of any other."""
        cells, columns = _cells(text), self.columns
        if all(map(_NUMBER.fullmatch, cells)):
            if columns is None or len(cells) != columns.count:
                self._propose(cells)
                expected = f", not {columns.count} for {columns.settings['columns']}" if columns else ""
                raise _NoSample(f"has {len(cells)} numbers{expected}", "wrong_columns")
            return self._sample(columns, [cell.decode() for cell in cells])
        line = text.decode("utf-8", "replace")
        named = {name: value for name, value in fields_of(line).items() if _NUMBER.fullmatch(value.encode())}
        if named and _is_name(line):
            record = self._records.add(named)
            lines, self._record_lines = self._record_lines, self._record_lines + 1
            if record is None:
                return None
            self._record_lines = 1
            return self._record_sample(record, lines)
        if not self._is_header([cell.decode("utf-8", "replace") for cell in cells]):
            raise _NoSample(f"is {plain(text[: 4 * QUOTED].decode('latin-1'))[:QUOTED]!r}", "not_numbers")
        self._ledger.add("header")
        return None

    def _is_header(self, names: Sequence[str]) -> bool:
        """Return whether names are those of columns; the first ones set the columns, unless these are given."""
        # a name takes a hundred times as long as a number: beside samples, text of another length is not tried
        if self._begun and self.columns is not None and len(names) != self.columns.count:
            return False
        if not 2 <= len(names) <= MOST_NAMES:
            return False
        header = header_columns(names, self._settings) if all(map(_is_name, names)) else None
        if header is None:
            return False
        if not self._begun and not self._given:
            self.columns, self._begun, self._lost = header, True, 0
        return True

    def _propose(self, cells: Sequence[bytes]) -> None:
        """Keep some numbers that are no sample, and note which columns they may be once there are enough."""
        if self._proposal is not None or self._begun:
            return
        if self._unmatched and len(cells) != len(self._unmatched[0]):
            self._unmatched = []
        if len(cells) <= MOST_NAMES:
            self._unmatched.append([float(cell) for cell in cells])
        if len(self._unmatched) == PROPOSED_ROWS:
            fitting = proposed_settings(self._unmatched)
            self._proposal = (
                f"lines of {len(cells)} numbers fit ?{fitting} behind the port" if fitting else None
            )
            self._unmatched = []

    def _record_sample(self, record: Mapping[str, str], lines: int) -> _Row:
        """Return the sample of some lines with names; raise `_NoSample` if they are not those of the columns."""
        if not self._begun and not self._given:
            self._is_header(list(record)[:MOST_NAMES])
        columns = self.columns
        try:
            if columns is None or not all(c.name in record for c in columns.used[: columns.inertial]):
                text = f"has numbers with the names {', '.join(record)[:QUOTED]!r}"
                raise _NoSample(text, "wrong_columns")
            names = columns.settings["columns"].split(",")
            row = self._sample(columns, [record.get(name, "nan") for name in names])
        except _NoSample as fault:
            # the line that is read begins the next record; the caller counts one of those that are no sample
            self._ledger.add(fault.reason, lines - 1)
            raise
        self._ledger.add("part", lines - 1)
        return row

    def _sample(self, columns: LineColumns, cells: Sequence[str]) -> _Row:
        """Return the sample of a line of numbers."""
        values = [float(cells[column.index]) * column.factor - column.zero for column in columns.used]
        if not all(map(math.isfinite, values[: columns.inertial])):
            raise _NoSample("has a value that is no finite number", "not_finite")
        time = "0" if columns.time is None else cells[columns.time.index]
        if not abs(float(time) * columns.time_factor) < LONGEST_NS:
            raise _NoSample("has a time that is no finite number", "not_finite")
        # before the first sample, invalid lines are greetings of the board and the half of a line
        lost, self._lost = self._lost if self._begun else 0, 0
        self._begun = True
        if len(self._first) < SIZE_SAMPLES:
            self._first.append(values)
            if len(self._first) == SIZE_SAMPLES:
                self._unit_doubts = tuple(_unit_doubts(columns, np.array(self._first)))
        return _Row(time, values, lost)

    # ------------------------------------------------------------------ time

    def _timed(self, row: _Row | None, *, final: bool = False) -> list[_Row]:
        """Return a sample with its time, once the unit is known; with it, those that have waited for the unit."""
        rows = [] if row is None else [row]
        columns = self.columns
        if columns is None or columns.time is None:
            return rows
        if columns.time.unit is None:
            columns, rows = self._with_unit(columns, rows, final=final)
            self.columns = columns
        factor, timed = columns.time_factor, []
        for row in rows:
            # a float resolves 256 ns of the time since 1970: whole numbers stay whole
            whole = row.time.isdigit()
            time_ns = int(row.time) * int(factor) if whole else round(float(row.time) * factor)
            if abs(time_ns) < LONGEST_NS:
                timed.append(replace(row, time_ns=time_ns))
                self._resolution = factor / 10 ** len(row.time.partition(".")[2])
            else:  # in the unit that the rows before it have shown
                self._ledger.add("not_finite")
        return timed

    def _with_unit(
        self, columns: LineColumns, rows: list[_Row], *, final: bool
    ) -> tuple[LineColumns, list[_Row]]:
        """Return the columns with a unit of the time, and the samples that have waited for it; before, none of them."""
        rows = [*self._without_unit, *rows]
        self._without_unit = [] if final or len(rows) >= UNIT_ROWS else rows
        if self._without_unit or not rows:
            return columns, []
        unit = unit_of_time(np.array([float(row.time) for row in rows])) or DEFAULT_UNIT
        if columns.time is not None and unit != "s" and columns.settings["columns"] != DEFAULT_COLUMNS:
            name = plain(columns.time.name)
            self._assumed_unit = f"{name} has no unit: {unit} is assumed; if it has another, write time="
        return columns.with_unit(unit), rows

    def _restarted(self, row: _Row) -> bool:
        """Return whether the clock has restarted before a sample; a wrap is added to `_offset`."""
        last, self._last = self._last, row.time_ns
        if last is None or row.time_ns > last - RESTART_NS:
            return False
        unit = self.columns.wrapping_ns if self.columns else 0
        period = wrap_ns(last, row.time_ns, unit) if unit else 0
        self._offset += period
        return not period

    def _blocks(self, rows: list[_Row], *, final: bool) -> list[SampleBlock]:
        """Return the samples whose time is decided."""
        columns, rows = self.columns, [*self._waiting, *rows]
        if columns is None or not rows:
            return []
        times, ready = None, len(rows)
        if columns.time is not None:
            if self._stamps is None:
                self._stamps = LiveStamps(self._resolution)
            stamps = np.array([row.time_ns for row in rows[len(self._waiting) :]], np.int64)
            # a line has one time: that of the sample also counts as that of its publication and arrival
            nothing = np.zeros(len(stamps), np.int64)
            times = self._stamps.place(stamps, stamps, stamps, nothing, final=final).times
            ready = len(times)
        self._waiting, rows = rows[ready:], rows[:ready]
        if not rows:
            return []
        lost = np.array([row.lost for row in rows], np.int64)
        return [SampleBlock(columns.stream, np.array([row.values for row in rows]), times, lost)]


def _unit_doubts(columns: LineColumns, rows: Floats) -> Iterator[str]:
    """Yield what (n, k) values in SI say against their units: gravity, and more noise than at rest."""
    accel = [k for k, column in enumerate(columns.used) if column.quantity == "accel"]
    # two axes do not show gravity: at rest, the third one may hold all of it
    size = median_size(rows[:, accel]) if len(accel) == len(AXES) else None
    if size and not is_one_g(size):
        yield f"the acceleration is {size:.3g} m/s^2, and at rest it is 9.81: check its unit, accel="
    gyro = [k for k, c in enumerate(columns.used) if c.quantity == "gyro" and c.unit in (None, "rad/s")]
    if gyro and too_noisy(rows[:, gyro]):
        noise = f"{math.degrees(sample_noise(rows[:, gyro])):.2g} deg/s"
        yield f"the noise of the gyroscope is {noise} if it is in rad/s, more than at rest: check its unit, gyro=deg/s"


def _is_name(text: str) -> bool:
    """Return whether a cell can be a name in a header: printable, without a character that is not decoded."""
    return text.isprintable() and "\N{REPLACEMENT CHARACTER}" not in text


def _cells(text: bytes) -> list[bytes]:
    """Return the cells of a line, without blanks around them."""
    if b";" in text:  # as spreadsheets of countries with a decimal comma write them
        text = text.replace(b",", b".").replace(b";", b",")
    return [cell.strip() for cell in (text.split(b",") if b"," in text else text.split())]
