"""Decoder of lines: bytes in any chunks to samples, without I/O and clock.

Rules, which do not depend on the chunks:

- A line ends with LF, or CR and LF. Where the URL names the columns, a sample is a line with one number for each, apart
  by commas, semicolons, tabs or blanks. If semicolons are apart, a comma is a decimal sign.
- Otherwise the first lines show how a sample is printed and what its numbers are, as the head of a file does
  (`files.printed_log`, `files.columns`): cells below a header, names beside the numbers, JSON, a sample of several
  lines. They wait until `FIRST_LINES` are there; bytes that are no text do not wait. What is not certain needs
  ``accept`` or ``columns=`` in the URL: until then no line is a sample, and a remark has the question.
- Any other line counts as invalid and, where the stream has no clock, as a lost sample. So does one in which the
  time, or a value of gyroscope or accelerometer, is no finite number. Other values may be no number: they are unknown.
- Blank lines, lines that begin with ``#``, and the header are no samples and nothing is lost by them.
- A line longer than `LONGEST_LINE` is discarded up to its end.
- A counter that wraps continues. A time that goes back otherwise is that of a restarted sensor.

A line has no checksum, so a damaged digit is a number like any other.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.grid.counter_wraps import wrap_ns
from imumon.grid.live_stamps import LiveStamps
from imumon.model.errors import QUOTED, ImumonError
from imumon.model.ledger import Ledger
from imumon.model.report_json import plain
from imumon.model.samples import AXES, LONGEST_NS, Floats, SampleBlock
from imumon.sources.device import RESTART_NS
from imumon.sources.files.printed_log import PrintedTable, tables
from imumon.sources.files.sizes_at_rest import NOISIEST, is_one_g, median_size, sample_noise
from imumon.sources.files.text_cells import numbers_of, split
from imumon.sources.lines.line_columns import (
    LineColumns,
    columns_of,
    first_columns,
    line_columns,
)

LONGEST_LINE = 4096
"""Bytes of a line at most, where the settings say nothing."""
FIRST_LINES = (50, 100, 200, 400)
"""Numbers of first lines from which the form of a sample is tried: half a second at 100 Hz, and longer."""
SIZE_SAMPLES = 100
"""First samples, whose sizes are compared with those of a sensor at rest."""

_NO_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")
"""Control characters that no program prints: blanks and the escapes of colours are others."""
_NUMBER = re.compile(rb"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Row:
    """A sample: its time, ns, values in SI, and lines that were lost before it."""

    time_ns: int
    values: list[float]
    lost: int


class _NoSample(Exception):
    """A line is no sample: the text says why, and the reason is that of the ledger."""

    def __init__(self, text: str, reason: str) -> None:
        super().__init__(text)
        self.reason = reason


class LineDecoder:
    """Feed bytes, get samples; see `imumon.sources.device.RawDecoder`.

    Parameters
    ----------
    settings : columns and units, see `line_columns`; without ``columns``, the first lines show them.

    Attributes
    ----------
    columns : in use; None before they are known.
    remarks : doubts about the lines, one each.

    >>> decoder = LineDecoder({"columns": "gx,gy,gz"})
    >>> decoder.feed(b"1,2,3\\nhello\\n4,5,6\\n7,8")[0].values.tolist(), decoder.discarded, decoder.pending
    ([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], 6, 3)
    """

    def __init__(self, settings: Mapping[str, str], rate_hz: float | None = None) -> None:
        self.fed = self.messages = self.message_bytes = self.discarded = self.bad_checksums = 0
        self._ledger = Ledger()
        self._settings, self._rate_hz = settings, rate_hz
        self.columns = columns_of(settings) if "columns" in settings else None
        self._table: PrintedTable | None = None  # how a sample is printed; None: cells, or not known yet
        self._pattern = re.compile("")
        self._first_lines: list[bytes] = []  # before the columns are known
        self._record: list[str] = []  # lines of the sample that has begun
        self._rest = b""
        self._skipping = self._begun = False  # an overlong line; samples were there
        self._lost = 0  # invalid lines since the last sample
        self._fault: str | None = None
        self._question: str | None = None  # what the columns are, where that is not certain
        self._stamps: LiveStamps | None = None
        self._resolution = 0.0  # ns, of the times
        self._offset = 0  # ns, of all wraps so far
        self._last: int | None = None  # ns, before its wraps are undone
        self._waiting: list[_Row] = []  # whose time is not decided
        self._first: list[list[float]] = []  # values of the first samples, in SI
        self._unit_doubts: tuple[str, ...] = ()

    @property
    def pending(self) -> int:
        """Bytes of a line whose end is missing, and of lines that wait until the columns are known."""
        return len(self._rest) + sum(len(line) + 1 for line in self._first_lines)

    @property
    def ledger(self) -> dict[str, int]:
        """What became of all lines but those that are samples, by reason."""
        waiting = len(self._waiting) + len(self._record)
        return self._ledger.counts(pending=waiting, start=len(self._first_lines))

    def skip_line(self) -> None:
        """Count a line that was not fed: of a stream that had begun before, it may be half of one."""
        self._ledger.receive()
        self._ledger.add("start")

    @property
    def remarks(self) -> tuple[str, ...]:
        stamps = self._stamps.remark if self._stamps is not None else None
        doubts = [self._fault, self._question, stamps, *self._unit_doubts]
        return tuple(text for text in doubts if text)

    def feed(self, data: bytes) -> list[SampleBlock]:
        """Return the samples of the lines that `data` completes."""
        self.fed += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        blocks: list[SampleBlock] = []
        rows: list[_Row] = []
        for line in (known for received in lines for known in self._known(received)):
            if (row := self._line(line)) is None:
                continue
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
        rest, skipping = self._rest, self._skipping
        self._rest, self._skipping = b"", False
        rows = []
        if self.columns is None and self._first_lines:
            self._learn()
            lines, self._first_lines = self._first_lines, []
            rows = [row for line in lines if (row := self._line(line)) is not None]
        self.discarded += len(rest)
        if rest or skipping:
            self._ledger.receive()
            self._ledger.add("pending")
        return self._blocks(rows, final=True)

    # ------------------------------------------------------------------ the first lines

    def _known(self, line: bytes) -> Sequence[bytes]:
        """Return the lines that can be decoded now: none before the columns are known, then all that waited."""
        self._ledger.receive()
        # bytes that are no text show no form: at a wrong baud rate they would fill the first lines
        if self.columns is not None or _NO_TEXT.search(line):
            return (line,)
        self._first_lines.append(line[: LONGEST_LINE + 1])
        if len(self._first_lines) in FIRST_LINES:
            self._learn()
        if self.columns is None and len(self._first_lines) < FIRST_LINES[-1]:
            return ()
        lines, self._first_lines = self._first_lines, []
        return lines

    def _learn(self) -> None:
        """Find how a sample is printed and what its numbers are in the first lines."""
        text = "".join(f"{line.decode('utf-8', 'replace').rstrip()}\n" for line in self._first_lines)
        try:
            found = tables(f"{text}\n")
        except ImumonError:
            return
        for table in found:
            if table.samples:
                self._question = (
                    self._question or "a record of the lines holds several samples: print one in each"
                )
                continue
            try:
                reading = first_columns(table.names, table.units, table.rows, self._settings, self._rate_hz)
                reading = replace(reading, uses=tuple(use for use in reading.uses if use.key != "rate"))
                used = reading.checked("the lines", accept="accept" in self._settings)
            except ImumonError as error:
                proposal = getattr(error, "proposal", None)
                advice = f": give the port with ?accept or ?map={proposal}" if proposal else ""
                # asked once: the sizes in it differ with every attempt
                self._question = self._question or f"{getattr(error, 'message', error)}{advice}"
                continue
            self._table, self._question = table, None
            self._pattern = re.compile(table.pattern, re.MULTILINE)
            self.columns = line_columns(used, {**self._settings, "map": reading.map})
            assumed = [use.reason for use in used.uses if not use.certain]
            self._unit_doubts = tuple(f"assumed: {reason}" for reason in assumed)
            return

    # ------------------------------------------------------------------ lines

    def _line(self, line: bytes) -> _Row | None:
        """Return the sample of a line, if it ends one; count the line in any case."""
        size, text = len(line) + 1, line.strip()
        skipped, self._skipping = self._skipping, False
        is_comment = text.startswith(b"#")
        try:
            if skipped or len(line) > LONGEST_LINE:
                raise _NoSample("is too long", "damaged")
            row = self._parsed(text) if text and not is_comment else None
        except _NoSample as fault:
            self.discarded += size
            self.bad_checksums += 1  # the nearest that a line without a checksum has
            self._lost += 1
            greeting = not self._begun and fault.reason == "not_numbers"
            self._ledger.add("start" if greeting else fault.reason)
            self._fault = self._fault or f"a line is no sample: it {fault}"
            return None
        if not text or is_comment:
            self.discarded += size
            self._ledger.add("comment" if text else "blank")
        else:
            self.messages += 1
            self.message_bytes += size
        return row

    def _parsed(self, text: bytes) -> _Row | None:
        """Return the sample that a line ends; None of a header or a part. Raise `_NoSample` of any other."""
        columns, table = self.columns, self._table
        if columns is None:
            raise _NoSample("is before the columns are known", "not_numbers")
        line = text.decode("utf-8", "replace")
        if table is not None and table.pattern:
            return self._printed(columns, table, line)
        cells = _cells(text) if table is None else [c.encode() for c in split(line, table.separator)]
        if table is not None and line == table.header:
            self._ledger.add("header")
            return None
        used = {column.index for column in (*columns.used, *columns.time)}
        if not _are_numbers(cells, columns.count, used if table is not None else range(columns.count)):
            self._text(text, cells)
            return None
        self._note_digits(columns, [cell.decode() for cell in cells])
        return self._sample(
            columns, [float(cells[k]) if k in used else math.nan for k in range(columns.count)]
        )

    def _text(self, text: bytes, cells: Sequence[bytes]) -> None:
        """Count a header; raise `_NoSample` of other text."""
        is_header = self.columns is not None and len(cells) == self.columns.count
        if is_header and all(re.fullmatch(rb"[A-Za-z_][\w .\[\]()/^-]*", cell) for cell in cells):
            self._ledger.add("header")
            return
        raise _NoSample(f"is {plain(text[: 4 * QUOTED].decode('latin-1'))[:QUOTED]!r}", "not_numbers")

    def _printed(self, columns: LineColumns, table: PrintedTable, line: str) -> _Row | None:
        """Return the sample that a line with names beside its numbers ends."""
        self._record.append(line)
        match = self._pattern.fullmatch("".join(f"{text}\n" for text in self._record))
        if match is None and len(self._record) < table.lines:
            return None
        lines, self._record = self._record, []
        if match is None:
            # a sample may begin later: all but the first line are tried again
            self._ledger.add("not_numbers", 0)
            rest = lines[1:]
            self._record = rest
            raise _NoSample(f"is {plain(lines[0])[:QUOTED]!r}", "not_numbers")
        self._ledger.add("part", table.lines - 1)
        self._note_digits(columns, match.groups())
        return self._sample(columns, numbers_of(match.groups()))

    def _note_digits(self, columns: LineColumns, texts: Sequence[str]) -> None:
        """Note the resolution of a time, by its digits."""
        if columns.time:
            last = columns.time[-1]
            self._resolution = last.factor / 10 ** len(texts[last.index].partition(".")[2])

    def _sample(self, columns: LineColumns, numbers: Sequence[float]) -> _Row:
        """Return the sample of a record of numbers."""
        values = [numbers[c.index] * c.factor - c.zero for c in columns.used]
        if not all(map(math.isfinite, values[: columns.inertial])):
            raise _NoSample("has a value that is no finite number", "not_finite")
        time = sum(numbers[c.index] * c.factor for c in columns.time)
        if not abs(time) < LONGEST_NS:
            raise _NoSample("has a time that is no finite number", "not_finite")
        # before the first sample, invalid lines are greetings of the board and the half of a line
        lost, self._lost = self._lost if self._begun else 0, 0
        self._begun = True
        if len(self._first) < SIZE_SAMPLES:
            self._first.append(values)
            if len(self._first) == SIZE_SAMPLES:
                self._unit_doubts += tuple(_unit_doubts(columns, np.array(self._first)))
        return _Row(round(time), values, lost)

    # ------------------------------------------------------------------ time

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
        if columns.time:
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
    sensors = [channel.sensor for channel in columns.stream.channels]
    accel = [k for k, sensor in enumerate(sensors) if sensor == "accel"]
    # two axes do not show gravity: at rest, the third one may hold all of it
    size = median_size(rows[:, accel]) if len(accel) == len(AXES) else None
    if size and not is_one_g(size):
        yield f"the acceleration is {size:.3g} m/s^2, and at rest it is 9.81: check its unit, accel="
    gyro = [k for k, sensor in enumerate(sensors) if sensor == "gyro" and columns.used[k].factor == 1.0]
    if gyro and sample_noise(rows[:, gyro]) > NOISIEST:
        noise = f"{math.degrees(sample_noise(rows[:, gyro])):.2g} deg/s"
        yield f"the noise of the gyroscope is {noise} if it is in rad/s, more than at rest: check its unit, gyro=deg/s"


def _are_numbers(cells: Sequence[bytes], count: int, needed: Collection[int]) -> bool:
    """Return whether the needed cells of a line are numbers; raise `_NoSample` if it has another count of numbers."""
    if len(cells) == count:
        return all(_NUMBER.fullmatch(cells[k]) for k in needed)
    if all(map(_NUMBER.fullmatch, cells)) or _are_mostly_numbers(cells):
        raise _NoSample(f"has {len(cells)} numbers, not {count}", "wrong_columns")
    return False


def _are_mostly_numbers(cells: Sequence[bytes]) -> bool:
    return sum(_NUMBER.fullmatch(cell) is not None for cell in cells) > len(cells) / 2


def _cells(text: bytes) -> list[bytes]:
    """Return the cells of a line, without blanks around them."""
    if b";" in text:  # as spreadsheets of countries with a decimal comma write them
        text = text.replace(b",", b".").replace(b";", b",")
    return [cell.strip() for cell in (text.split(b",") if b"," in text else text.split())]
