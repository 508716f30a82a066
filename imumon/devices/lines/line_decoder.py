"""Decoder of lines: bytes in any chunks to samples, without I/O and clock.

Rules, which do not depend on the chunks:

- A line ends with LF, or CR and LF. A sample is a line with one number for each column, apart by commas, semicolons,
  tabs or blanks. If semicolons are apart, a comma is a decimal sign.
- Any other line counts as invalid and, where the stream has no clock, as a lost sample. So does one in which the
  time, or a value of gyroscope or accelerometer, is no finite number. Other values may be no number: they are unknown.
- Blank lines, lines that begin with ``#``, and header lines are no samples and nothing is lost by them. A header sets
  the columns, unless they are given or samples came before it.
- A line longer than `LONGEST_LINE` is discarded up to its end.
- A counter that wraps continues. A time that goes back otherwise is that of a restarted sensor.

A line has no checksum, so a damaged digit is a number like any other.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.devices.base import RESTART_NS
from imumon.devices.lines.line_columns import (
    DEFAULT_COLUMNS,
    LineColumns,
    columns_of,
    header_columns,
)
from imumon.errors import QUOTED
from imumon.report import plain
from imumon.samples import LONGEST_NS, SampleBlock
from imumon.timebase.interval import CLOCK_SLACK_S
from imumon.timebase.live_stamps import LiveStamps
from imumon.units import STANDARD_GRAVITY

LONGEST_LINE = 4096
"""Bytes of a line at most."""
WRAPS = (1 << 30, 1 << 32)
"""Periods of counters, in their units: MicroPython ``ticks_ms`` and ``ticks_us``; Arduino ``millis`` and ``micros``."""
GRAVITY_SAMPLES = 100
"""Samples whose acceleration is compared with gravity."""
GRAVITY_RATIO = 1.5
"""Factor between the two above which the unit is doubted: no sensor at rest is so wrong."""

_NUMBER = re.compile(rb"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Row:
    """A sample: time in ns, values in SI, and lines that were lost before it."""

    time_ns: int
    values: list[float]
    lost: int


class _NoSample(Exception):
    """A line is no sample; the text says why."""


class LineDecoder:
    """Feed bytes, get samples; see `imumon.devices.base.RawDecoder`.

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
        self.columns: LineColumns | None = None
        self._settings, self._given = settings, "columns" in settings
        if not needs_header:
            self.columns = columns_of({"columns": DEFAULT_COLUMNS} | dict(settings))
        self._rest = b""
        self._skipping = self._begun = False  # an overlong line; samples or a header were there
        self._lost = 0  # invalid lines since the last sample
        self._fault: str | None = None
        self._stamps: LiveStamps | None = None
        self._resolution = 0.0  # ns, of the last time
        self._offset = 0  # ns, of all wraps so far
        self._last: int | None = None  # ns, before its wraps are undone
        self._waiting: list[_Row] = []  # whose time is not decided
        self._lengths: list[float] = []  # m/s^2, of the first accelerations

    @property
    def pending(self) -> int:
        """Bytes of a line whose end is missing."""
        return len(self._rest)

    @property
    def remarks(self) -> tuple[str, ...]:
        found = [self._fault, self._stamps and self._stamps.remark, self._doubted_unit()]
        return tuple(text for text in found if text)

    def feed(self, data: bytes) -> list[SampleBlock]:
        """Return the samples of the lines that `data` completes."""
        self.fed += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        blocks: list[SampleBlock] = []
        rows: list[_Row] = []
        for line in lines:
            if (row := self._line(line)) is None:
                continue
            if self._restarted(row):
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
        self._rest, self._skipping = b"", False
        return self._blocks([], final=True)

    # ------------------------------------------------------------------ lines

    def _line(self, line: bytes) -> _Row | None:
        """Return the sample of a line, if it is one; count the line in any case."""
        size, text = len(line) + 1, line.strip()
        skipped, self._skipping = self._skipping, False
        try:
            if skipped or len(line) > LONGEST_LINE:
                raise _NoSample("is too long")
            row = None if not text or text.startswith(b"#") else self._parsed(text)
        except _NoSample as fault:
            self.discarded += size
            self.bad_checksums += 1
            self._lost += 1
            self._fault = self._fault or f"a line is no sample: it {fault}"
            return None
        if not text or text.startswith(b"#"):
            self.discarded += size
        else:
            self.messages += 1
            self.message_bytes += size
        return row

    def _parsed(self, text: bytes) -> _Row | None:
        """Return the sample of a line; None of a header. Raise `_NoSample` of any other."""
        cells, columns = _cells(text), self.columns
        if all(map(_NUMBER.fullmatch, cells)):
            if columns is None or len(cells) != columns.count:
                expected = f", not {columns.count} for {columns.settings['columns']}" if columns else ""
                raise _NoSample(f"has {len(cells)} numbers{expected}")
            return self._sample(columns, cells)
        names = [cell.decode("utf-8", "replace") for cell in cells]
        header = header_columns(names, self._settings) if all(map(_is_name, names)) else None
        if header is None:
            raise _NoSample(f"is {plain(text.decode('latin-1'))[:QUOTED]!r}")
        if not self._begun and not self._given:
            self.columns, self._begun = header, True
        return None

    def _sample(self, columns: LineColumns, cells: Sequence[bytes]) -> _Row:
        """Return the sample of a line of numbers."""
        values = [float(cells[column.index]) * column.factor - column.zero for column in columns.used]
        if not all(map(math.isfinite, values[: columns.inertial])):
            raise _NoSample("has a value that is no finite number")
        time_ns = 0
        if columns.time is not None:
            text, unit = cells[columns.time.index], columns.time.factor
            if not abs(float(text) * unit) < LONGEST_NS:
                raise _NoSample("has a time that is no finite number")
            time_ns = int(text) * int(unit) if text.isdigit() else round(float(text) * unit)
            self._resolution = unit / 10 ** len(text.partition(b".")[2])
        lost, self._lost = self._lost if self._begun else 0, 0
        self._begun = True
        if len(self._lengths) < GRAVITY_SAMPLES:
            self._lengths.append(columns.acceleration(values))
        return _Row(time_ns, values, lost)

    # ------------------------------------------------------------------ time

    def _restarted(self, row: _Row) -> bool:
        """Return whether the clock has restarted before a sample; a wrap is added to `_offset`."""
        last, self._last = self._last, row.time_ns
        if last is None or row.time_ns > last - RESTART_NS:
            return False
        unit = self.columns.wrapping_ns if self.columns else 0
        for period in (unit * count for count in WRAPS):
            if last < period and row.time_ns + period - last < CLOCK_SLACK_S * 1e9:
                self._offset += period
                return False
        return True

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
            times = self._stamps.place(stamps, stamps, stamps, np.zeros(len(stamps), np.int64), final=final)
            ready = len(times)
        self._waiting, rows = rows[ready:], rows[:ready]
        if not rows:
            return []
        lost = np.array([row.lost for row in rows], np.int64)
        return [SampleBlock(columns.stream, np.array([row.values for row in rows]), times, lost)]

    def _doubted_unit(self) -> str | None:
        """Return that the acceleration is not that of gravity; None: it is, or is not known."""
        known = sorted(length for length in self._lengths if length > 0.0)
        if len(known) < GRAVITY_SAMPLES:
            return None
        ratio = known[len(known) // 2] / STANDARD_GRAVITY
        if 1.0 / GRAVITY_RATIO < ratio < GRAVITY_RATIO:
            return None
        length = f"{ratio * STANDARD_GRAVITY:.3g} m/s^2"
        return f"the acceleration is {length}, and at rest it is 9.81: check its unit, accel="


def _is_name(text: str) -> bool:
    """Return whether a cell can be a name in a header: printable, without a character that is not decoded."""
    return text.isprintable() and "\N{REPLACEMENT CHARACTER}" not in text


def _cells(text: bytes) -> list[bytes]:
    """Return the cells of a line, without blanks around them."""
    if b";" in text:
        text = text.replace(b",", b".").replace(b";", b",")
    return [cell.strip() for cell in (text.split(b",") if b"," in text else text.split())]
