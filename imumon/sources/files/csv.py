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

1. *Header.* `table_header` finds the line that names the columns, and what the lines around it say. A table without
   such a line needs ``--map`` with the numbers of columns, unless it is what ``ros2 topic echo --csv`` prints.
2. *Sensors by row.* A column may say of which sensor a row is: one of them is read (`sensor_column`).
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
from typing import Any, NoReturn

import numpy as np

from imumon.model.cures import example_text, option, option_text
from imumon.model.errors import QUOTED
from imumon.model.ledger import Ledger, merged
from imumon.model.samples import Floats, SampleBlock
from imumon.sources.files.base import (
    HEAD_LINES,
    LONGEST_LINE,
    ROWS,
    TABLE_BYTES,
    ReadOptions,
    RecordingError,
    RowSource,
)
from imumon.sources.files.columns import ColumnLayout, layout, proposed_map
from imumon.sources.files.date_reader import DateReader
from imumon.sources.files.raw_capture import RawCapture
from imumon.sources.files.sensor_column import (
    RowChoice,
    check_one_sensor,
    chosen_tag,
    row_choices,
    sensor_of_file,
    sensor_of_value,
    sensor_rows,
)
from imumon.sources.files.table import Table
from imumon.sources.files.table_header import (
    ECHOED,
    below_header,
    has_cells,
    has_thousands,
    header_cells,
    header_line,
    is_echoed,
    is_number,
    names_sensor,
    preamble_scales,
    separator_of,
    split,
    stated_rate,
    tagged_headers,
)
from imumon.sources.files.text_records import INVALID_RECORD, RecordText

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


THOUSANDS = "it has separators of thousands"
NO_THOUSANDS = (
    "write the numbers without them: in a spreadsheet, choose Number without the separator for the cells"
)

_WORD = re.compile("[A-Za-z]{2}")
"""What every line of names has, and few rows."""


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
        self._names: Sequence[str] = ()
        self._other_rows, self._other_value = 0, ""
        self.path = capture.path
        self._dates: dict[int, DateReader] = {}  # by column, of those with dates instead of numbers

    def _parsed(self, block: bytes, places: range, *, last: bool = False) -> list[SampleBlock]:
        numbers: Sequence[int] = places
        if self._choices:
            block, numbers = self._chosen(block, places)
            if not block:
                return []
        numbered = self._parser.numbers(block, numbers, last=last)
        self.problem = self._parser.problem or self.problem
        return self._blocks(*numbered)

    def _chosen(self, block: bytes, places: Sequence[int]) -> tuple[bytes, Sequence[int]]:
        """Return the lines of the rows that are read, and their numbers."""
        kept, numbers = [], []
        for line, place in zip(block.split(b"\n"), places, strict=False):
            text = decoded(line)
            is_row = has_cells(text) and not self._parser.is_header(text)
            cells = split(text, self._parser.separator) if is_row else []
            if cells and not all(choice.holds(cells) for choice in self._choices):
                self._other_rows += 1
                self._other_value = self._other_value or cells[self._choices[0].column][:QUOTED]
                self._lines.add("other_sensor")
            else:
                kept.append(line)
                numbers.append(place)
        return b"".join(line + b"\n" for line in kept), numbers

    def _line_remarks(self) -> Sequence[str]:
        if not self._other_rows:
            return self._parser.remarks
        if self._options.where:
            where = f"{option_text(where=self._options.where)} does not choose them"
        else:
            choice = self._choices[0]
            other = option_text(where={self._names[choice.column]: self._other_value})
            where = f"only those with {choice.value} are read; {other} reads others"
        return [*self._parser.remarks, f"{self._other_rows:,} rows are of other sensors: {where}"]

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
        try:
            header, names, begin, separator = self._names_of_columns(seen)
            cells = [split(line, separator) for line in seen[begin : begin + HEAD_ROWS] if has_cells(line)]
            table_layout = self._chosen_layout(names, cells, separator, preamble_scales(seen[:begin], names))
        except RecordingError as error:
            raise error.of(self.path) from None
        header_place = seen.index(header) if header else None
        self._names = names
        # before the rows are read: a column of texts would make every row invalid
        table_layout = self._with_readable_times(table_layout, cells)
        source = RowSource(self.path, self._form, names, stated_hz=stated_rate(seen[:begin]))
        columns = self._begin(source, table_layout, self._options)
        self._parser = RowParser(self.path, header, separator, columns, self._dates)
        for place, line in enumerate(seen[:begin]):
            # names behind a # are a header, and no comment
            kind = None if place == header_place else _kind_without_cells(line)
            self._lines.add(kind or "header")
        return head.split(b"\n", begin)[begin], begin

    def _names_of_columns(self, seen: Sequence[str]) -> tuple[str, list[str], int, str | None]:
        """Return the line that names the columns (empty: none), the names, the first row, and the separator."""
        if tags := tagged_headers(seen):
            tag = chosen_tag(tags, self._options.where or {})
            self._choices = [RowChoice(0, tag)]
            begin = next(k for k, line in enumerate(seen) if has_cells(line) and not line.startswith("sep="))
            return "", tags[tag], begin, separator_of(seen[begin])
        place = header_line(seen)
        if place is None:
            return ("", *self._without_header(seen))
        return (seen[place], *below_header(seen, place))

    def _chosen_layout(
        self,
        names: Sequence[str],
        cells: Sequence[Sequence[str]],
        separator: str | None,
        scales: Mapping[str, str],
    ) -> ColumnLayout:
        """Choose the rows; return the columns that the names and the first of these rows, as cells, show.

        Parameters
        ----------
        scales : columns that the lines before the names give, as ``--map`` has them.
        """
        options = self._options
        if not self._choices:
            self._choices = row_choices(names, options.where or {}, cells)
        implied = [] if self._choices or options.columns else sensor_rows(names, cells)
        self._choices += implied
        cells = [row for row in cells if all(choice.holds(row) for choice in self._choices)]
        numbers = head_numbers(cells, separator, len(names))
        if not options.columns or not self._choices:
            check_one_sensor(names, cells, numbers)
        values = [sensor for choice in self._choices if (sensor := sensor_of_value(choice.value)) is not None]
        row_sensor = next(iter(values), None) or sensor_of_file(self.path)
        given = {**scales, **(options.columns or {})}
        return layout(names, options.kind, given, options.sensor, numbers, row_sensor)

    def _without_header(self, seen: Sequence[str]) -> tuple[list[str], int, str | None]:
        """Return the names of columns that no line names, the first row, and the separator."""
        begin = next((k for k, line in enumerate(seen) if has_cells(line)), None)
        if begin is None:
            raise RecordingError("no_rows", "it has no rows", COMPLETE)
        separator = separator_of(seen[begin])
        count = len(split(seen[begin], separator))
        if self._options.columns:
            return [str(k + 1) for k in range(count)], begin, separator
        echoed = next((k for k, line in enumerate(seen) if is_echoed(line)), None)
        if echoed is not None:
            return list(ECHOED), echoed, ","
        if any(names_sensor(header_cells(line, separator_of(line))) for line in seen[:HEAD_LINES]):
            text = "its rows have another number of cells than the line that names its columns"
            cure = "a decimal comma needs another separator: export it with semicolons between the cells"
            raise RecordingError("header_differs", text, cure)
        unnamed, first = ("column", 1) if count == 1 else (f"{count} columns", 2)
        rows = [split(line, separator) for line in seen[begin : begin + HEAD_ROWS] if has_cells(line)]
        proposed = proposed_map(head_numbers(rows, separator, count))
        cure = f"add one, or {example_text(f'{first}:rad/s')} by number"
        if proposed:
            cure = (
                f"by the size of their numbers, {option_text(columns=proposed)}; check it, or add such a line"
            )
        raise RecordingError("no_header", f"it has no line that names its {unnamed}", cure)

    def _with_readable_times(
        self, table_layout: ColumnLayout, cells: Sequence[Sequence[str]]
    ) -> ColumnLayout:
        """Return the columns without the times that cannot be read; dates are read as seconds."""
        cells = [row for row in cells if all(choice.holds(row) for choice in self._choices)]
        times, unreadable = [], ""
        for column in table_layout.times:
            texts = _present(cells, column.index)
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
            if any(has_thousands(row[column.index]) for row in cells[:1] for column in table_layout.times):
                raise RecordingError("thousands", f"{self.path}: {unreadable}: {THOUSANDS}", NO_THOUSANDS)
            cure = f"write numbers or 2026-01-31T12:00:00.000, or omit it with {example_text()} and {option('rate_hz')}"
            raise RecordingError("time_not_readable", f"{self.path}: {unreadable}", cure)
        return replace(table_layout, times=tuple(times))

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{self.path} has a header and no row of numbers after it", COMPLETE)


def _present(cells: Sequence[Sequence[str]], index: int) -> list[str]:
    """Return the cells of a column that are there."""
    texts = (row[index] for row in cells if len(row) > index)
    return [text for text in texts if text.lower() not in MISSING]


def _may_be_row(rest: bytes) -> bool:
    """Return whether the bytes behind the last end of a line may be a line, or the begin of one."""
    text = decoded(rest)
    return all(character.isprintable() or character in "\t\v\f\x1a" for character in text)


def _kind_without_cells(line: str) -> str | None:
    """Return why a line has no cells, as in the ledger; None: it has some."""
    if not line.strip():
        return "blank"
    return None if has_cells(line) else "comment"


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
        self.problem = ""  # why the table ends before the file; empty: it does not
        self._thousands = False  # an invalid number has separators of thousands

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

    def _ends_table(self, line: str) -> bool:
        """Return whether a line names other columns of a sensor than the header."""
        if not self._header or not _WORD.search(line) or self.is_header(line):
            return False
        names = header_cells(line, self.separator)
        return not any(map(is_number, names)) and names_sensor(names)

    def is_header(self, line: str) -> bool:
        """Return whether a line is the header, again."""
        return bool(self._header) and line == self._header

    def numbers(self, block: bytes, places: Sequence[int], *, last: bool) -> tuple[Floats, Sequence[int]]:
        """Return (n, k) numbers of the columns of some lines, and (n,) the line number of each row.

        Lines behind another header are none: `problem` says it.

        An invalid row is NaN, and its line 0. Too many invalid rows raise a `RecordingError`.

        Parameters
        ----------
        places : number of each line.
        last : they end the table.
        """
        if self.problem:
            self._ledger.add("other_message", len(places))
            return np.empty((0, len(self._columns))), []
        rows = None if block.isspace() else self._regular(block)
        line_places = places
        if rows is not None and len(rows) < len(line_places):  # blank lines are no rows
            places_of_lines = zip(line_places, block.split(b"\n")[:-1], strict=True)
            places = [place for place, line in places_of_lines if line.strip()]
        # a fast reader that takes a line break in quotes for a part of a cell returns other rows: not used
        if rows is None or len(rows) != len(places):
            rows, places = self._line_by_line(block, line_places, last=last)
        else:
            self._ledger.add("blank", len(line_places) - len(places))
        self.read += len(rows)
        # here and not at the end: a file of another kind is refused within its first block
        if self.invalid > INVALID_ROWS and self.invalid > INVALID_SHARE * self.read:
            self._refuse()
        return rows, places

    def _line_by_line(
        self, block: bytes, line_places: Sequence[int], *, last: bool
    ) -> tuple[Floats, list[int]]:
        """Return what `numbers` does, of lines that are not all rows of numbers."""
        lines = lines_of(block)
        end = len(lines) - 1 if last else -1
        other = next((k for k, line in enumerate(lines) if self._ends_table(line)), None)
        if other is not None:
            where = f"{self._path} line {line_places[other]}"
            self.problem = f"{where} names other columns: only the rows before are used"
            self._ledger.add("other_message", len(lines) - other)
            lines, end = lines[:other], -1
        parsed = [self._row(line, line_places[k], k == end) for k, line in enumerate(lines)]
        rows = np.array([row for row, _ in parsed if row]).reshape(-1, len(self._columns))
        return rows, [place for row, place in parsed if row]

    def _refuse(self) -> NoReturn:
        """Raise the error of a table most of whose rows are none."""
        if self._thousands:
            raise RecordingError(
                "thousands", f"{self._path} {self._first_invalid}: {THOUSANDS}", NO_THOUSANDS
            )
        text = f"{self._path} {self._first_invalid}; {self.invalid:,} of {self.read:,} rows are invalid"
        raise RecordingError("too_many_invalid_rows", text, "correct these rows, or delete them")

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
        if (no_row := _kind_without_cells(line) or ("header" if self.is_header(line) else None)) is not None:
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
                self._thousands |= column < len(cells) and has_thousands(cells[column])
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
