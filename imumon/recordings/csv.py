"""CSV: tables as text, of any dialect, in blocks of rows.

There is no standard for such files: separator, decimal sign, header and times are those of the program that wrote
them. An example that has most of what occurs::

    # export of logger 7
    measured in the cellar
    t;gyro_x;gyro_y;gyro_z
    s;deg/s;deg/s;deg/s
    0.00;0.012;-0.003;0.001
    0.01;0.011;-0.002;
    t;gyro_x;gyro_y;gyro_z
    0.02;0.013;-0.004;0.002
    0.03;0.012;-0.003;0.001

1. *Header.* The line that names the columns is the first one in which most cells are no numbers and which has as many
   cells as the first row of numbers, or one more or less (`header_line`). Lines before it are ignored. A table without
   such a line needs ``--map`` with the numbers of columns, unless it is what ``ros2 topic echo --csv`` prints.
2. *Units.* A row of units below the header is a part of the names (`with_units`).
3. *Separator.* That of the header: ``;``, ``,``, tab, ``|``, else blanks. Where it is no comma, a comma in a number is
   the decimal sign.
4. *Time.* A number, a date or a time of day (`DateReader`); a column of other texts is no time.
5. *Rows.* An empty cell is a missing number, and the row a lost sample. A row with a text, or too short, is invalid:
   a lost sample, too, and counted. Blank lines, comments and repeated headers are no rows. With more than a tenth
   of invalid rows, the file is no table.

The example has three samples, and one that is lost because it lacks ``gyro_z``. Blocks of regular rows go to a fast
reader, pyarrow or numpy; only blocks with an exception are read line by line. Memory does not grow with the length of
the file, and a line that never ends is no more than one invalid row.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from imumon.column_names import UNITS, unit_of
from imumon.cures import option_text
from imumon.errors import QUOTED
from imumon.ledger import Ledger, merged
from imumon.recordings.base import (
    HEAD_LINES,
    LONGEST_LINE,
    ROWS,
    TABLE_BYTES,
    ReadOptions,
    RecordingError,
    RowSource,
)
from imumon.recordings.columns import MAP_EXAMPLE, ColumnLayout, layout
from imumon.recordings.date_reader import DateReader
from imumon.recordings.raw_capture import RawCapture
from imumon.recordings.sensor_column import RowChoice, check_one_sensor, row_choices, sensor_of_value
from imumon.recordings.table import Table
from imumon.recordings.text_records import INVALID_RECORD, RecordText
from imumon.report_json import plain
from imumon.samples import AXES, Floats, SampleBlock

HEAD_ROWS = 500
"""Rows whose numbers show what their columns are."""

INVALID_SHARE = 0.1
"""Share of invalid rows above which a file is no table."""

INVALID_ROWS = 10
"""Invalid rows that every table may have."""

TOO_LONG = "\udfff"
"""Line in place of one that is too long; no text in UTF-8 or Latin-1 has this character."""

TOO_LONG_BYTES = b"\xed\xbf\xbf"
"""The same in front of the decoder: it is no UTF-8."""

ARROW_MISSING = ["", "nan", "NaN", "NAN", "NA", "N/A", "n/a", "null", "NULL", "Null"]
"""Spellings of these that the fast reader knows. A block with another one is read line by line."""

MISSING = {"", "nan", "na", "n/a", "null", "none", "-"}
"""Contents of a cell without a number."""

COMPLETE = "check that it is complete"
"""Cure for a table without rows."""

ECHOED = (
    "sec", "nanosec", "frame_id", *("orientation",) * 13,
    *(f"angular_velocity.{axis} [rad/s]" for axis in AXES), *("covariance",) * 9,
    *(f"linear_acceleration.{axis}" for axis in AXES), *("covariance",) * 9,
)  # fmt: skip
"""Columns that ``ros2 topic echo --csv`` prints of `sensor_msgs/Imu`, without a header."""


class TextTable(Table):
    """A table of text, gzip or not, in blocks of whole lines; memory does not grow with its length."""

    _capture: RawCapture | RecordText
    _lines: Ledger  # of the lines that are no rows

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        self._lines = Ledger()
        blocks = self._line_blocks()
        first, before = self._read_head(blocks)
        waiting, count, size = [first], first.count(b"\n"), len(first)
        for block in blocks:
            # a block is handed on when the next one is there: only then it is known not to be the last one
            if count >= ROWS or size > TABLE_BYTES:
                yield self._parsed(b"".join(waiting), range(before + 1, before + count + 1))
                before += count
                waiting, count, size = [], 0, 0
            waiting.append(block)
            count += block.count(b"\n")
            size += len(block)
        if size:
            yield self._parsed(b"".join(waiting), range(before + 1, before + count + 1), last=True)
        yield self._finish()

    def _read_head(self, blocks: Iterator[bytes]) -> tuple[bytes, int]:
        """Read the lines before the rows; return the lines read behind them, and how many are before."""
        return b"", 0

    def _parsed(self, block: bytes, places: range, *, last: bool = False) -> list[SampleBlock]:
        """Return the samples of some lines with their numbers; the last ones end the table."""
        raise NotImplementedError

    def _line_blocks(self) -> Iterator[bytes]:
        """Yield the lines that end in each chunk of the file, in a time that is linear in its size."""
        rest, skipping = b"", False  # the line that has begun; whether it is too long, and waits for its end
        begun = lines = 0  # bytes up to the line that has begun, and the lines before it
        carriage = b""  # at the end of a chunk: its line feed may follow
        for chunk in self._capture:
            self.fed += len(chunk)
            self.problem, self.progress = self._capture.problem, self._capture.progress
            if carriage or b"\r" in chunk:
                # all ends of lines become \n: Windows writes \r\n, which a chunk may split, and old programs \r
                chunk = carriage + chunk
                carriage = b"\r" if chunk.endswith(b"\r") else b""
                chunk = chunk.removesuffix(b"\r").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
            first, end, more = chunk.partition(b"\n")
            if not skipping:
                rest += first
            # of a file without ends of lines, such as binary data, no more than this is in memory
            skipping = skipping or len(rest) > LONGEST_LINE
            if not end:
                rest = b"" if skipping else rest
                continue
            whole = more.rfind(b"\n") + 1
            block = (TOO_LONG_BYTES if skipping else rest) + b"\n" + more[:whole]
            lines += block.count(b"\n")
            self._lines.receive(block.count(b"\n"))
            begun = self.fed - len(more) + whole
            yield block
            rest, skipping = more[whole:], False
        self.problem = self._capture.problem
        # within the head no table is before it: the head says that the line is too long
        of_head = skipping and lines <= HEAD_LINES
        is_row = of_head or (not skipping and _may_be_row(rest))
        yield from self._last_line(TOO_LONG_BYTES if of_head else rest, begun, is_row=is_row)

    def _last_line(self, rest: bytes, begun: int, *, is_row: bool) -> Iterator[bytes]:
        """Yield what is behind the last end of a line, `begun` bytes from the beginning, if it may be a row."""
        if not is_row:
            # a file that was made longer than its rows, a disk that was not written, data of another kind
            text = f"{self.path} has {self.fed - begun:,} bytes behind its last line that are no row"
            self.problem = self.problem or f"{text}: only the part before is used"
        elif rest.strip():
            self._lines.receive()
            yield rest + b"\n"


class CsvFile(TextTable):
    """A CSV file, gzip or not, as blocks of samples.

    Iterating raises `RecordingError` if its columns are not those of an inertial sensor.
    """

    def __init__(self, capture: RawCapture | RecordText, options: ReadOptions) -> None:
        self._capture, self._options = capture, options
        self._form = "records" if isinstance(capture, RecordText) else "csv"
        self._choices: list[RowChoice] = []
        self._other_rows = 0
        self.path = capture.path
        self._dates: dict[int, DateReader] = {}  # by column, of those with dates instead of numbers

    def _parsed(self, block: bytes, places: range, *, last: bool = False) -> list[SampleBlock]:
        numbers: Sequence[int] = places
        if self._choices:
            block, numbers = self._chosen(block, places)
            if not block:
                return []
        return self._blocks(*self._parser.numbers(block, numbers, last=last))

    def _chosen(self, block: bytes, places: Sequence[int]) -> tuple[bytes, Sequence[int]]:
        """Return the lines of the rows that are read, and their numbers."""
        kept, numbers = [], []
        for line, place in zip(block.split(b"\n"), places, strict=False):
            text = decoded(line)
            cells = split(text, self._parser.separator) if has_cells(text) else []
            if cells and not all(choice.holds(cells) for choice in self._choices):
                self._other_rows += 1
                self._lines.add("other_sensor")
            else:
                kept.append(line)
                numbers.append(place)
        return b"".join(line + b"\n" for line in kept), numbers

    def _line_remarks(self) -> Sequence[str]:
        where = option_text(where=self._options.where or {})
        others = f"{self._other_rows:,} rows are of other sensors: {where} does not choose them"
        return [*self._parser.remarks, *([others] if self._other_rows else [])]

    def _line_ledger(self) -> Mapping[str, int]:
        of_records = self._capture.ledger if isinstance(self._capture, RecordText) else {}
        return merged(of_records, self._lines.counts(), self._parser.ledger)

    def _read_head(self, blocks: Iterator[bytes]) -> tuple[bytes, int]:
        """Find the header and the columns; return the lines read behind them, and how many are before."""
        head = b""
        for block in blocks:
            head += block
            if head.count(b"\n") > HEAD_LINES:
                break
        seen = lines_of(head)
        if TOO_LONG in seen[:HEAD_LINES]:
            text = f"{self.path} line {seen.index(TOO_LONG) + 1} is longer than {LONGEST_LINE:,} bytes"
            raise RecordingError("line_too_long", text, "check that it is a table with one row per line")
        header_place = header_line(seen)
        if header_place is None:
            header, (names, begin, separator) = "", self._without_header(seen)
        else:
            header, (names, begin, separator) = seen[header_place], _below_header(seen, header_place)
        cells = [split(line, separator) for line in seen[begin : begin + HEAD_ROWS] if has_cells(line)]
        try:
            table_layout = self._chosen_layout(names, cells, separator)
        except RecordingError as error:
            raise error.of(self.path) from None
        # before the rows are read: a column of texts would make every row invalid
        table_layout = self._with_readable_times(table_layout, seen[begin:], separator)
        source = RowSource(self.path, self._form, names, stated_hz=_stated_rate(seen[:begin]))
        columns = self._begin(source, table_layout, self._options)
        self._parser = RowParser(self.path, header, separator, columns, self._dates)
        for place, line in enumerate(seen[:begin]):
            # names behind a # are a header, and no comment
            kind = None if place == header_place else _kind_without_cells(line)
            self._lines.add(kind or "header")
        return head.split(b"\n", begin)[begin], begin

    def _chosen_layout(
        self, names: Sequence[str], cells: Sequence[Sequence[str]], separator: str | None
    ) -> ColumnLayout:
        """Choose the rows; return the columns that the names and the first of these rows, as cells, show."""
        self._choices = row_choices(names, self._options.where or {}, cells)
        cells = [row for row in cells if all(choice.holds(row) for choice in self._choices)]
        numbers = head_numbers(cells, separator, len(names))
        if not self._options.columns or not self._choices:
            check_one_sensor(names, cells, numbers)
        values = [sensor for choice in self._choices if (sensor := sensor_of_value(choice.value)) is not None]
        return layout(
            names,
            self._options.kind,
            self._options.columns,
            self._options.sensor,
            numbers,
            next(iter(values), None),
        )

    def _without_header(self, seen: Sequence[str]) -> tuple[list[str], int, str | None]:
        """Return the names of columns that no line names, the first row, and the separator."""
        begin = next((k for k, line in enumerate(seen) if has_cells(line)), None)
        if begin is None:
            raise RecordingError("no_rows", f"{self.path} has no rows", COMPLETE)
        separator = separator_of(seen[begin])
        count = len(split(seen[begin], separator))
        if self._options.columns:
            return [str(k + 1) for k in range(count)], begin, separator
        echoed = next((k for k, line in enumerate(seen) if is_echoed(line)), None)
        if echoed is not None:
            return list(ECHOED), echoed, ","
        unnamed, first = ("column", 1) if count == 1 else (f"{count} columns", 2)
        cure = f"add one, or --map gyro/x={first}:rad/s,... by number"
        raise RecordingError("no_header", f"{self.path} has no line that names its {unnamed}", cure)

    def _with_readable_times(
        self, table_layout: ColumnLayout, lines: Sequence[str], separator: str | None
    ) -> ColumnLayout:
        """Return the columns without the times that cannot be read; dates are read as seconds."""
        cells = [split(line, separator) for line in lines if has_cells(line)]
        times, unreadable = [], ""
        for column in table_layout.times:
            texts = [row[column.index] for row in cells if len(row) > column.index]
            texts = [text for text in texts if text.lower() not in MISSING]
            # any, not all: the first rows may have cells such as "?" before the clock is set
            if not texts or any(is_number(text.replace(",", ".")) for text in texts):
                times.append(column)
            # a reader for each test: one that has read a date refuses texts of another form
            elif any(is_number(text, DateReader().seconds) for text in texts):
                self._dates[column.index] = DateReader()
                times.append(replace(column, unit="s"))
            else:
                unreadable = unreadable or f"the time in {column.name} is not readable, {texts[0][:QUOTED]!r}"
        if unreadable and not times:
            cure = f"write numbers or 2026-01-31T12:00:00.000, or omit it with {MAP_EXAMPLE} and --rate"
            raise RecordingError("time_not_readable", f"{self.path}: {unreadable}", cure)
        return replace(table_layout, times=tuple(times))

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{self.path} has a header and no row of numbers after it", COMPLETE)


_STATED_RATE = re.compile(
    r"(?:rate|frequency|odr)\b[^\d\n]{0,20}?(?P<number>\d+(?:\.\d+)?)\s*(?P<kilo>k?)hz\b", re.IGNORECASE
)
"""Sample rate in words before a table, such as ``// Update Rate: 100.0Hz``."""


def _stated_rate(lines: Sequence[str]) -> float | None:
    """Return the only rate that the lines before a table state, Hz; None: none, or several.

    >>> _stated_rate(["// Update Rate: 100.0Hz"]), _stated_rate(["# gyro rate 1 kHz, accel rate 100 Hz"])
    (100.0, None)
    """
    rates = {
        float(match["number"]) * (1e3 if match["kilo"] else 1.0)
        for line in lines
        for match in _STATED_RATE.finditer(line)
    }
    return rates.pop() if len(rates) == 1 and min(rates) > 0.0 else None


def _may_be_row(rest: bytes) -> bool:
    """Return whether the bytes behind the last end of a line may be a line, or the begin of one."""
    text = decoded(rest)
    return all(character.isprintable() or character in "\t\v\f\x1a" for character in text)


def _kind_without_cells(line: str) -> str | None:
    """Return why a line has no cells, as in the ledger; None: it has some."""
    if not line.strip():
        return "blank"
    return None if has_cells(line) else "comment"


def is_echoed(line: str) -> bool:
    """Return whether a line is a message that ``ros2 topic echo --csv`` prints of an IMU."""
    cells = split(line, ",")
    return len(cells) == len(ECHOED) and all(map(is_number, (*cells[:2], *cells[3:])))


def _below_header(lines: Sequence[str], place: int) -> tuple[list[str], int, str | None]:
    """Return the names of columns with their units, the first line of rows, and the separator, by a header's place."""
    header, begin, separator = lines[place], place + 1, separator_of(lines[place])
    names = [plain(name) for name in header_cells(header, separator)]
    # a table of one column: blanks in its header, as in "gyro z", do not separate anything
    if _is_one_number("".join(lines[begin : begin + 1])):
        names, separator = [plain(header.strip())], None
    if begin < len(lines) and (united := with_units(names, lines[begin], separator)) is not None:
        names, begin = united, begin + 1
    return names, begin, separator


def _is_one_number(line: str) -> bool:
    return len(line.split()) == 1 and is_number(line)


def _names_one_column(line: str) -> bool:
    return bool(line.strip()) and not is_number(line)


def header_line(lines: Sequence[str]) -> int | None:
    """Return which of the first lines names the columns.

    Most of its cells are no numbers, and it has as many as the first row of numbers. A table of one column has it
    before the first three numbers.

    >>> header_line(["t,gx", "0,1"]), header_line(["10", "gyro_z", "1", "2", "3"]), header_line(["1", "2"])
    (0, 1, None)
    """
    candidates: list[int] = []
    for k, line in enumerate(lines[:HEAD_LINES]):
        # three numbers: a single one in a line may be a setting in the preamble
        if k and _names_one_column(lines[k - 1]) and all(map(_is_one_number, lines[k : k + 3])):
            return k - 1
        cells = split(line, separator_of(line))
        if len(cells) > 1 and sum(not is_number(cell) for cell in cells if cell) > len(cells) / 2:
            candidates.append(k)
        elif len(cells) > 1 and sum(is_number(cell) for cell in cells) > len(cells) / 2:
            excess = {place: _excess_cells(lines[place], line) for place in candidates}
            best = min(excess, key=excess.__getitem__, default=None)
            # one more or less: many programs end their rows, or their header, with a separator
            return best if best is not None and excess[best] <= 1 else None
    return candidates[0] if candidates else None


def _excess_cells(names: str, row: str) -> int:
    """Return by how many cells a line of names and a row differ."""
    separator = separator_of(names)
    return abs(len(header_cells(names, separator)) - len(split(row, separator)))


def header_cells(line: str, separator: str | None) -> list[str]:
    """Return the names in a header; of names apart by blanks, a unit in brackets belongs to the name before it.

    >>> header_cells("t [ms] A_X [m / s2] B", None)
    ['t [ms]', 'A_X [m / s2]', 'B']
    """
    if separator is not None:
        return split(line, separator)
    return [cell.strip() for cell in re.findall(r"\S+(?:\s+[\[(][^\])]*[\])])?", line)]


def head_numbers(rows: Sequence[Sequence[str]], separator: str | None, width: int) -> Floats:
    """Return (n, width) numbers of the cells of the first rows; NaN where a cell has none."""
    numbers = []
    for row in rows:
        cells = row[:width]
        decimal = cells if separator == "," else [cell.replace(",", ".") for cell in cells]
        numbers.append([*map(_number_or_nan, decimal), *[math.nan] * (width - len(cells))])
    return np.array(numbers, dtype=np.float64).reshape(-1, width)


def _number_or_nan(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def with_units(names: Sequence[str], row: str, separator: str | None) -> list[str] | None:
    """Return the names with the units of a row below them; None if it is no row of units.

    >>> with_units(["t", "wx", "wy [deg/s]"], "s,rad/s,", ",")
    ['t [s]', 'wx [rad/s]', 'wy [deg/s]']
    >>> with_units(["t", "wx"], "0.0,n/a", ",") is None
    True
    """
    cells = [plain(_bare_unit(cell)) for cell in split(row, separator)]
    known = [any(unit_of(cell, quantity) for quantity in UNITS) for cell in cells if cell]
    # half: columns of other quantities have units that are not known here, such as V or %
    if 2 * sum(known) <= len(known):
        return None
    cells += [""] * (len(names) - len(cells))
    return [
        f"{name} [{cell}]" if cell and not name.rstrip().endswith(("]", ")")) else name
        for name, cell in zip(names, cells, strict=False)
    ]


def _bare_unit(cell: str) -> str:
    """Return a unit without brackets around it.

    >>> _bare_unit("[deg/s]"), _bare_unit("m/(s^2)")
    ('deg/s', 'm/(s^2)')
    """
    match = re.fullmatch(r"\[([^\]]*)\]|\(([^()]*)\)", cell)
    return cell if match is None else match[1] or match[2] or ""


# ---------------------------------------------------------------- lines and cells


def lines_of(block: bytes) -> list[str]:
    """Return the lines of a block, which ends with the end of one."""
    return [decoded(line) for line in block.split(b"\n")[:-1]]


def decoded(line: bytes) -> str:
    """Return a line in UTF-8, else in Latin-1: older spreadsheets write the degree sign as one byte."""
    if len(line) > LONGEST_LINE or line == TOO_LONG_BYTES:
        return TOO_LONG
    try:
        return line.decode("utf-8-sig")  # spreadsheets begin a file with a mark of the byte order
    except UnicodeDecodeError:
        return line.decode("latin-1")


def has_cells(line: str) -> bool:
    """Return whether a line is neither blank nor a comment."""
    return bool(line.strip()) and line.lstrip()[0] not in "#%"


def separator_of(line: str) -> str | None:
    """Return the character between the cells; None: blanks."""
    # ask a header: a row of numbers may have more decimal commas than separators
    separator = max((";", ",", "\t", "|"), key=line.count)
    return separator if line.count(separator) else None


def split(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line, without quotes."""
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def is_number(text: str, read: Callable[[str], float] = float) -> bool:
    try:
        read(text)
    except ValueError:
        return False
    return True


@cache
def _arrow() -> Any:
    """Return the module of pyarrow that reads CSV; None if it is not installed."""
    try:
        from pyarrow import csv
    except ImportError:
        return None
    return csv


class RowParser:
    """Parses lines to numbers.

    Parameters
    ----------
    dates : readers of the columns that hold dates.

    Attributes
    ----------
    read, invalid : rows so far, and how many of them were invalid.
    separator : between the cells; None: blanks.
    """

    def __init__(
        self, path: str, header: str, separator: str | None, columns: list[int], dates: dict[int, DateReader]
    ) -> None:
        self._path, self._header, self._columns = path, header, columns
        self.separator = separator
        self._dates = dates
        self.read = self.invalid = 0
        self._ledger = Ledger()
        self._first_invalid = ""  # line and reason

    @property
    def remarks(self) -> list[str]:
        """What was left out, for people."""
        rows = (
            f"{self.invalid:,} rows are invalid and count"
            if self.invalid > 1
            else "1 row is invalid and counts"
        )
        return [f"{rows} as lost; first {self._first_invalid}"] if self.invalid else []

    @property
    def ledger(self) -> dict[str, int]:
        """What became of the lines that are no rows of numbers, by reason."""
        return self._ledger.counts()

    def numbers(self, block: bytes, places: Sequence[int], *, last: bool) -> tuple[Floats, Sequence[int]]:
        """Return (n, k) numbers of the columns of some lines, and (n,) the line number of each row.

        An invalid row is NaN, and its line 0. Too many invalid rows raise a `RecordingError`.

        Parameters
        ----------
        places : number of each line.
        last : they end the table.
        """
        rows = None if block.isspace() else self._regular(block)
        line_places = places
        if rows is not None and len(rows) < len(line_places):  # blank lines are no rows
            places_of_lines = zip(line_places, block.split(b"\n")[:-1], strict=True)
            places = [place for place, line in places_of_lines if line.strip()]
        # a fast reader that takes a line break in quotes for a part of a cell returns other rows: not used
        if rows is None or len(rows) != len(places):
            whole = lines_of(block)
            end = len(whole) - 1 if last else -1
            parsed = [self._row(line, line_places[k], k == end) for k, line in enumerate(whole)]
            rows = np.array([row for row, _ in parsed if row]).reshape(-1, len(self._columns))
            places = [place for row, place in parsed if row]
        else:
            self._ledger.add("blank", len(line_places) - len(places))
        self.read += len(rows)
        # here and not at the end: a file of another kind is refused within its first block
        if self.invalid > INVALID_ROWS and self.invalid > INVALID_SHARE * self.read:
            text = f"{self._path} {self._first_invalid}; {self.invalid:,} of {self.read:,} rows are invalid"
            raise RecordingError("too_many_invalid_rows", text, "correct these rows, or delete them")
        return rows, places

    def _regular(self, block: bytes) -> Floats | None:
        """Return the numbers of lines that all are rows of numbers; None if one is not."""
        if self.separator != ",":
            block = block.replace(b",", b".")  # the decimal sign
        # pyarrow is several times as fast, but knows neither runs of blanks nor the dates that `DateReader` reads
        if self.separator is not None and not self._dates and (numbers := self._by_arrow(block)) is not None:
            return numbers
        convert: dict[int | str, Callable[[str], float]] = {k: d.seconds for k, d in self._dates.items()}
        try:
            rows: Floats = np.loadtxt(
                io.StringIO(block.decode("latin-1")), usecols=self._columns, delimiter=self.separator,
                converters=convert or None, comments=None, quotechar='"', ndmin=2,
            )  # fmt: skip
        except (ValueError, IndexError):
            return None
        return rows

    def _by_arrow(self, block: bytes) -> Floats | None:
        """Return the numbers, read by pyarrow; None if it is not installed or a line is no row of numbers."""
        if (arrow := _arrow()) is None:
            return None
        # rows of another length than the first one are an error of pyarrow, and so make the block irregular
        first = block[: block.index(b"\n")].decode("latin-1")
        names = [str(k) for k in range(len(split(first, self.separator)))]
        if max(self._columns) >= len(names):
            return None
        used = [names[k] for k in self._columns]
        try:
            table = arrow.read_csv(
                io.BytesIO(block),
                read_options=arrow.ReadOptions(
                    use_threads=False, block_size=len(block) + 1, column_names=names
                ),
                parse_options=arrow.ParseOptions(delimiter=self.separator),
                convert_options=arrow.ConvertOptions(
                    column_types=dict.fromkeys(used, "float64"), include_columns=[*dict.fromkeys(used)],
                    null_values=ARROW_MISSING,
                ),
            )  # fmt: skip
        except (ValueError, KeyError):  # ArrowInvalid is a ValueError
            return None
        return np.column_stack([table.column(name).to_numpy() for name in used])

    def _row(self, line: str, number: int, last: bool) -> tuple[list[float], int]:
        """Return the numbers of an irregular line; none for a line that is no sample."""
        if (no_row := _kind_without_cells(line) or ("header" if line == self._header else None)) is not None:
            self._ledger.add(no_row)
            return [], number
        cells = split(line, self.separator)
        row: list[float] = []
        for column in self._columns:
            value = self._number(cells, column)
            if value is None:
                if last:  # a program that was killed leaves half a line: no row, and not worth a remark
                    self._ledger.add("pending")
                    return [], number
                self.invalid += 1
                self._ledger.add(self._reason(line, cells, column))
                fault = "is too long" if line == TOO_LONG else self._fault(cells, column)
                self._first_invalid = self._first_invalid or f"line {number} {fault}"
                return [math.nan] * len(self._columns), 0
            row.append(value)
        return row, number

    def _number(self, cells: Sequence[str], column: int) -> float | None:
        """Return the number in a cell; NaN if it is empty, None if it is invalid."""
        if column >= len(cells):
            return None
        text = cells[column]
        if self.separator != ",":
            text = text.replace(",", ".")
        if text.lower() in MISSING:
            return math.nan
        try:
            return self._dates[column].seconds(text) if column in self._dates else float(text)
        except ValueError:
            return None

    @staticmethod
    def _reason(line: str, cells: Sequence[str], column: int) -> str:
        """Return why a line is an invalid row, as in the ledger."""
        if line in (TOO_LONG, INVALID_RECORD):
            return "damaged"
        return "wrong_columns" if column >= len(cells) else "not_numbers"

    @staticmethod
    def _fault(cells: Sequence[str], column: int) -> str:
        """Return what is wrong with a cell, for people."""
        if column >= len(cells):
            return f"has {len(cells)} columns, column {column + 1} is needed"
        return f"column {column + 1}: {cells[column][:QUOTED]!r} is no number"
