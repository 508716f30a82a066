"""Decoder of lines: bytes in any chunks to samples, without I/O and clock.

Rules, which do not depend on the chunks:

- A line ends with LF, or CR and LF. Where the URL names the columns, a sample is a line with one number for each, apart
  by commas, semicolons, tabs or blanks. If semicolons are apart, a comma is a decimal sign.
- Otherwise the first lines show how a sample is printed and what its numbers are, as the head of a file does
  (`files.printed_log`, `files.table_choice`): cells below a header, names beside the numbers, JSON, a sample of several
  lines. They wait until `FIRST_LINES` are there; bytes that are no text do not wait. What is not certain needs
  ``accept`` or ``columns=`` in the URL: until then no line is a sample, and a remark has the question.
- Then the lines are read as those of a file (`files.record_reader`). Any other line counts as invalid and, where the
  stream has no clock, as a lost sample. So does one in which the time, or a value of gyroscope or accelerometer, is no
  finite number. Other values may be no number: they are unknown.
- Blank lines, comments, and the header are no samples and nothing is lost by them.
- A line longer than `LONGEST_LINE` is discarded up to its end.
- A counter that wraps continues. A time that goes back otherwise is that of a restarted sensor.

A line has no checksum, so a damaged digit is a number like any other.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.grid.counter_wraps import wrap_ns
from imumon.grid.live_stamps import LiveStamps
from imumon.model.errors import QUOTED, ImumonError
from imumon.model.ledger import REASONS, Ledger
from imumon.model.report_json import plain
from imumon.model.samples import INERTIAL, LONGEST_NS, Floats, SampleBlock
from imumon.sources.device import RESTART_NS
from imumon.sources.files.base import RecordingError
from imumon.sources.files.column_header import are_names
from imumon.sources.files.printed_log import TOO_LONG_BYTES, PrintedTable, tables
from imumon.sources.files.record_reader import OUTSIDE, RecordForm, line_kind
from imumon.sources.files.sizes_at_rest import NOISIEST, doubt_at_rest
from imumon.sources.files.table_choice import chosen_table
from imumon.sources.files.table_clock import counter_unit
from imumon.sources.files.text_cells import decoded
from imumon.sources.lines.line_columns import (
    LineColumns,
    columns_of,
    line_columns,
    read_options,
)

LONGEST_LINE = 4096
"""Bytes of a line with its end at most, where the settings say nothing."""
FIRST_LINES = (50, 100, 200, 400)
"""Numbers of first lines from which the form of a sample is tried: half a second at 100 Hz, and longer."""
SIZE_SAMPLES = 100
"""First samples, whose sizes are compared with those of a sensor at rest."""

_NO_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")
"""Control characters that no program prints: blanks and the escapes of colours are others."""


@dataclass(frozen=True, slots=True)
class _Row:
    """A sample: its time, ns, values in SI, and lines that were lost before it."""

    time_ns: int
    values: list[float]
    lost: int


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
        self.fed = self.messages = self.message_bytes = self.bad_checksums = 0
        self._ledger = Ledger()
        self._settings, self._options = settings, read_options(settings, rate_hz)
        self.columns: LineColumns | None = None
        if "columns" in settings:
            names = tuple(settings["columns"].split(","))
            table = PrintedTable(names, (), np.empty((0, len(names))), 0)
            by_mark = {mark: replace(table, separator=mark, decimal=mark == ";") for mark in (";", ",", None)}
            # numbers are in all columns, also in those that the URL ignores
            self._use(columns_of(settings), by_mark, range(len(names)))
        self._first_lines: list[bytes] = []  # before the columns are known
        self._record: list[bytes] = []  # lines of the sample that has begun
        self._rest = b""
        self._begun = False  # samples were there
        self._lost = 0  # invalid lines since the last sample
        self._fault: str | None = None
        self._question: str | None = None  # what the columns are, where that is not certain
        self._stamps: LiveStamps | None = None
        self._resolution = 0.0  # ns, of the times
        self._offset = 0  # ns, of all wraps so far
        self._last: int | None = None  # ns, before its wraps are undone
        self._waiting: list[_Row] = []  # whose time is not decided
        self._first: list[Floats] = []  # values of the first samples, in SI
        self._unit_doubts: tuple[str, ...] = ()

    @property
    def pending(self) -> int:
        """Bytes of a line or a sample whose end is missing, and of lines that wait until the columns are known."""
        return len(self._rest) + sum(map(len, [*self._record, *self._first_lines]))

    @property
    def discarded(self) -> int:
        """Bytes of lines that are no samples."""
        return self.fed - self.message_bytes - self.pending

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
        # before the columns are known, no line is a sample
        doubts = [self._question or self._fault, stamps, *self._unit_doubts]
        return tuple(text for text in doubts if text)

    def feed(self, data: bytes) -> list[SampleBlock]:
        """Return the samples of the lines that `data` completes."""
        self.fed += len(data)
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[:LONGEST_LINE]  # of a line that never ends, no more is in memory
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
        return [*blocks, *self._blocks(rows, final=False)]

    def finish(self) -> list[SampleBlock]:
        """Return what waits, at the end of the stream. A line without its end may be half of one: it is discarded."""
        if self._first_lines:
            self._learn()
        lines, self._first_lines = self._first_lines, []
        rows = [row for line in lines if (row := self._line(line)) is not None]
        if self._rest:
            self._ledger.receive()
        self._ledger.add("pending", len(self._record) + bool(self._rest))
        self._rest, self._record = b"", []
        return self._blocks(rows, final=True)

    # ------------------------------------------------------------------ the first lines

    def _known(self, line: bytes) -> Sequence[bytes]:
        """Return the lines that can be decoded now: none before the columns are known, then all that waited."""
        self._ledger.receive()
        line = line + b"\n" if len(line) < LONGEST_LINE else TOO_LONG_BYTES
        # bytes that are no text show no form: at a wrong baud rate they would fill the first lines
        if self.columns is not None or _NO_TEXT.search(line):
            return (line,)
        self._first_lines.append(line)
        if len(self._first_lines) in FIRST_LINES:
            self._learn()
        if self.columns is None and len(self._first_lines) < FIRST_LINES[-1]:
            return ()
        lines, self._first_lines = self._first_lines, []
        return lines

    def _learn(self) -> None:
        """Find how a sample is printed and what its numbers are in the first lines."""
        text = "".join(f"{decoded(line).rstrip()}\n" for line in self._first_lines)
        try:
            if not (printed := tables(f"{text}\n")):
                return
            table, reading = chosen_table(printed, text, self._options)
            if table.samples:
                several = "a record of the lines holds several samples"
                raise RecordingError("columns_unclear", several, "print one in each")
            reading = replace(reading, uses=tuple(use for use in reading.uses if use.key != "rate"))
            used = reading.checked("the lines", accept=self._options.accept)
            columns = line_columns(used, {**self._settings, "map": reading.map})
        except ImumonError as error:
            proposal = getattr(error, "proposal", None)
            cure = error.cure if error.code == "columns_unclear" else ""  # others are those of files
            advice = f"give the port with ?accept or ?map={proposal}" if proposal else cure
            # asked once: the sizes in it differ with every attempt
            self._question = self._question or f"{error.message}{': ' if advice else ''}{advice}"
            return
        self._question = None
        others = [other for other in printed if other is not table]
        self._use(columns, dict.fromkeys((";", ",", None), table), (), others)
        assumed = [use.reason for use in used.uses if not use.certain]
        self._unit_doubts = tuple(f"assumed: {reason}" for reason in assumed)

    def _use(
        self,
        columns: LineColumns,
        tables_by_mark: Mapping[str | None, PrintedTable],
        checked: Iterable[int],
        others: Sequence[PrintedTable] = (),
    ) -> None:
        """Read lines by what separates their cells; `checked` are further columns that must have numbers."""
        used = columns.layout.used
        indices = [column.index for column in used]  # a column that two names mean is there twice
        read = [*indices, *(k for k in checked if k not in indices)]
        self.columns = columns
        self._forms = {
            mark: RecordForm(table, read, others, exact=True) for mark, table in tables_by_mark.items()
        }
        self._times = [(k, column.factor) for k, column in enumerate(used) if column.use == "t"]
        self._scales = [(column.factor, column.zero) for column in columns.layout.columns]
        self._inertial = sum(column.use.sensor in INERTIAL for column in used)

    # ------------------------------------------------------------------ lines

    def _line(self, line: bytes) -> _Row | None:
        """Return the sample that a line ends; count the line, or keep it if what follows decides."""
        if self.columns is None:
            self._leave_out(line, line_kind(line, "") or "not_numbers")
            return None
        form = self._forms[";" if b";" in line else "," if b"," in line else None]
        self._record.append(line)
        if len(self._record) < form.table.lines:
            return None
        record = b"".join(self._record)
        if (match := form.pattern.fullmatch(record)) is None:
            line = self._record.pop(0)
            self._leave_out(line, _reason(form, line))
            return None
        self._record = []
        if form.table.lines > 1:
            self._ledger.add("part", form.table.lines - 1)
        numbers = form.sample(match)
        time = sum([numbers[k] * factor for k, factor in self._times])
        if not (abs(time) < LONGEST_NS and all(map(math.isfinite, numbers[: self._inertial]))):
            self._leave_out(record, "not_finite")
            return None
        self.messages += form.table.lines
        self.message_bytes += len(record)
        if self._times and self._stamps is None:  # the resolution of a time, by its digits
            k, factor = self._times[-1]
            self._resolution = factor / 10 ** len(match[1 + form.groups[0][k]].partition(b".")[2])
        # before the first sample, invalid lines are greetings of the board and the half of a line
        lost, self._lost = self._lost if self._begun else 0, 0
        self._begun = True
        scaled = zip(numbers, self._scales, strict=False)
        return _Row(round(time), [number * factor - zero for number, (factor, zero) in scaled], lost)

    def _leave_out(self, line: bytes, reason: str) -> None:
        """Count a line that is no sample, and note what is wrong with it."""
        self._ledger.add(reason if self._begun or reason in OUTSIDE else "start")
        if reason not in OUTSIDE:
            self.bad_checksums += 1  # the nearest that a line without a checksum has
            self._lost += 1
            text = plain(decoded(line).strip())[:QUOTED]
            self._fault = self._fault or f"a line is no sample, {text!r}: {REASONS[reason]}"

    # ------------------------------------------------------------------ time

    def _restarted(self, row: _Row) -> bool:
        """Return whether the clock has restarted before a sample; a wrap is added to `_offset`."""
        last, self._last = self._last, row.time_ns
        if last is None or row.time_ns > last - RESTART_NS:
            return False
        unit = counter_unit(self.columns.layout) if self.columns else 0
        period = wrap_ns(last, row.time_ns, unit) if unit else 0
        self._offset += period
        return not period

    def _blocks(self, rows: list[_Row], *, final: bool) -> list[SampleBlock]:
        """Return the samples whose time is decided."""
        columns, rows = self.columns, [*self._waiting, *rows]
        if columns is None or not rows:
            return []
        times, ready = None, len(rows)
        if self._times:
            if self._stamps is None:
                self._stamps = LiveStamps(self._resolution)
            stamps = np.array([row.time_ns for row in rows[len(self._waiting) :]], np.int64)
            # a line has one time: that of the sample also counts as that of its publication and arrival
            times = self._stamps.place(stamps, stamps, stamps, np.zeros_like(stamps), final=final).times
            ready = len(times)
        self._waiting, rows = rows[ready:], rows[:ready]
        if not rows:
            return []
        values = np.array([row.values for row in rows])
        if len(self._first) < SIZE_SAMPLES:
            self._first = [*self._first, *values][:SIZE_SAMPLES]
            if len(self._first) == SIZE_SAMPLES:
                self._unit_doubts += tuple(_unit_doubts(columns, np.array(self._first)))
        return [SampleBlock(columns.stream, values, times, np.array([row.lost for row in rows], np.int64))]


def _reason(form: RecordForm, line: bytes) -> str:
    """Return why a line is no sample, as the ledger has it; a board that restarts prints its header again."""
    cells = form.cells(line)
    is_header = len(cells) == len(form.table.names) and are_names(cells)
    return "header" if is_header else form.reason(line)


def _unit_doubts(columns: LineColumns, rows: Floats) -> Iterator[str]:
    """Yield what (n, k) values in SI say against their units."""
    used = columns.layout.columns
    for sensor in INERTIAL:
        axes = [k for k, column in enumerate(used) if column.use.sensor == sensor]
        # where no unit is given, rad/s is meant
        noisiest = NOISIEST if axes and used[axes[0]].factor == 1.0 else math.inf
        if axes and (doubt := doubt_at_rest(sensor, rows[:, axes], noisiest)):
            yield f"{sensor}: {doubt}; check {sensor}="
