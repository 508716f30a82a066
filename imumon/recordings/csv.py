"""CSV: tables as text, of any dialect, in pieces.

The header line tells separator and columns, a row of units below it their units; what stands before it is
passed over, and so are comments and headers that come again. A row that lacks a number is a lost sample, and
so is one that is no row: they are counted and the first is named; a file that is full of them is no table.
A time may be written as a date or a time of day.
Memory does not grow with the length.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from imumon.errors import SourceError
from imumon.recordings.column_names import UNITS, spelled
from imumon.recordings.columns import BY_HAND, ColumnLayout, layout
from imumon.recordings.dates import Dates
from imumon.recordings.raw_capture import RawCapture
from imumon.recordings.table import ROWS, ReadOptions, TableRows
from imumon.samples import Floats, SampleBlock

PREAMBLE = 30
"""Lines before which the header must come."""

SPOILT_SHARE, SPOILT_ROWS = 0.1, 10
"""More rows than these that are no rows of numbers make a file no table."""

MISSING = {"", "nan", "na", "n/a", "null", "none", "-"}
"""What stands where a number is missing."""


class CsvFile:
    """A CSV file, gzip or not, as blocks of samples.

    Attributes
    ----------
    header : None: such a file tells nothing of the sensor.
    bad_checksums, discarded, fed : rows that lacked a number, 0, and bytes read.

    Raises
    ------
    SourceError : it cannot be read, or its columns are not those of an inertial sensor.
    """

    header: Mapping[str, Any] | None = None
    discarded = 0

    def __init__(self, recording: RawCapture, wanted: ReadOptions) -> None:
        self._recording, self._wanted = recording, wanted
        self.path = recording.path
        self.fed = 0
        self.bad_checksums = 0
        self._reader: _Reader | None = None
        self._dates: dict[int, Dates] = {}  # by column, of those that hold no numbers
        self._rows: TableRows | None = None

    @property
    def remarks(self) -> Sequence[str]:
        return [text for part in (self._reader, self._rows) if part is not None for text in part.remarks]

    @property
    def problem(self) -> str | None:
        return self._recording.problem

    @property
    def progress(self) -> float | None:
        return self._recording.progress

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        lines = self._lines()
        head, separator, rows, first, number = self._head(lines)
        self._reader = reader = _Reader(self.path, head, separator, rows.columns, self._dates)
        self._rows = rows
        gathered: list[str] = []
        before = number - len(first)
        for line in chain(first, chain.from_iterable(lines)):
            gathered.append(line)
            if len(gathered) >= ROWS:
                yield self._hand(rows, reader, gathered, before)
                before += len(gathered)
                gathered = []
        if gathered:
            yield self._hand(rows, reader, gathered, before, last=True)
        yield list(rows.finish())

    def _hand(
        self, rows: TableRows, reader: _Reader, lines: list[str], before: int, *, last: bool = False
    ) -> list[SampleBlock]:
        numbers, places = reader.numbers(lines, before, last=last)
        found = list(rows.blocks(rows.pick(numbers), places))
        self.bad_checksums = rows.lost
        return found

    def _lines(self) -> Iterator[list[str]]:
        """Whole lines, as many at once as a piece of the file has."""
        rest = b""
        for chunk in self._recording:
            self.fed += len(chunk)
            if b"\r" in chunk:
                chunk = chunk.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
            *whole, rest = (rest + chunk).split(b"\n")
            yield [_text(line) for line in whole]
        if rest.strip():
            yield [_text(rest)]

    def _head(self, lines: Iterator[list[str]]) -> tuple[str, str | None, TableRows, list[str], int]:
        """The header, separator, columns, the rows read along with it, and lines read so far."""
        seen: list[str] = []
        for piece in lines:
            seen += piece
            if len(seen) > PREAMBLE:
                break
        names_at = header_line(seen)
        if names_at is None:
            return self._headless(seen)
        separator = separator_of(seen[names_at])
        names, begin = split(seen[names_at], separator), names_at + 1
        if begin < len(seen) and (told := units_of(names, seen[begin], separator)) is not None:
            names, begin = told, begin + 1
        try:
            found = layout(names, self._wanted.kind, self._wanted.given)
        except SourceError as error:
            raise SourceError(f"{self.path}: {error}") from None
        found = self._timed(found, seen[begin:], separator)
        rows = TableRows(self.path, found, "csv", self._wanted.rate_hz, names)
        return seen[names_at], separator, rows, seen[begin:], len(seen)

    def _timed(self, found: ColumnLayout, lines: Sequence[str], separator: str | None) -> ColumnLayout:
        """The columns without the times that cannot be read; dates are noted, and count in seconds.

        Raises
        ------
        SourceError : none of the times can be read.
        """
        cells = [split(line, separator) for line in lines if line.strip() and line.lstrip()[0] not in "#%"]
        times, strange = [], ""
        for column in found.times:
            told = [row[column.index] for row in cells if len(row) > column.index]
            told = [text for text in told if text.lower() not in MISSING]
            if not told or any(_is_number(text.replace(",", ".")) for text in told):
                times.append(column)
            elif any(_is_date(text) for text in told):
                self._dates[column.index] = Dates()
                times.append(replace(column, unit="s"))
            else:
                strange = strange or f"the time in {column.name} cannot be read, {told[0][:30]!r}"
        if strange and not times:
            raise SourceError(
                f"{self.path}: {strange}: write numbers or 2026-01-31T12:00:00.000, "
                f"or leave it out with {BY_HAND} and --rate"
            )
        return replace(found, times=tuple(times))

    def _headless(self, seen: list[str]) -> tuple[str, str | None, TableRows, list[str], int]:
        """Numbers from the first line on: columns by their number, if the user names them."""
        start = next(
            (k for k, line in enumerate(seen) if line.strip() and line.lstrip()[0] not in "#%"), None
        )
        if start is None:
            raise SourceError(f"{self.path} holds no rows")
        separator = separator_of(seen[start])
        names = [str(k + 1) for k in range(len(split(seen[start], separator)))]
        if not self._wanted.given:
            raise SourceError(
                f"{self.path} has no line that names its {len(names)} columns: add one, "
                "or --map gyro/x=2:rad/s,... by number"
            )
        try:
            found = layout(names, self._wanted.kind, self._wanted.given)
        except SourceError as error:
            raise SourceError(f"{self.path}: {error}") from None
        found = self._timed(found, seen[start:], separator)
        rows = TableRows(self.path, found, "csv", self._wanted.rate_hz, names)
        return "", separator, rows, seen[start:], len(seen)

    def verdict(self) -> str:
        return f"{self.path} has a header and no row of numbers behind it"


def _text(line: bytes) -> str:
    """A line in UTF-8, else as spreadsheets of the West write it: their degree sign is one byte."""
    try:
        return line.decode("utf-8-sig")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def header_line(lines: Sequence[str]) -> int | None:
    """Which of the first lines names the columns: the one most of whose cells are no numbers, as many as the
    first row of numbers has."""
    named: list[int] = []
    for k, line in enumerate(lines[:PREAMBLE]):
        cells = split(line, separator_of(line))
        if len(cells) > 1 and sum(not _is_number(cell) for cell in cells if cell) > len(cells) / 2:
            named.append(k)
        elif len(cells) > 1 and sum(_is_number(cell) for cell in cells) > len(cells) / 2:
            fitting = [at for at in named if _as_wide(lines[at], line)]
            return fitting[0] if fitting else None
    return named[0] if named else None


def _as_wide(names: str, row: str) -> bool:
    separator = separator_of(names)
    return abs(len(split(row, separator)) - len(split(names, separator))) <= 1


def units_of(names: Sequence[str], row: str, separator: str | None) -> list[str] | None:
    """The names with the units that a row below them tells; None where it is no such row.

    >>> units_of(["t", "wx", "wy [deg/s]"], "s,rad/s,", ",")
    ['t [s]', 'wx [rad/s]', 'wy [deg/s]']
    >>> units_of(["t", "wx"], "0.0,n/a", ",") is None
    True
    """
    cells = [cell.strip("[]()") for cell in split(row, separator)]
    known = [any(spelled(cell, quantity) for quantity in UNITS) for cell in cells if cell]
    if 2 * sum(known) <= len(known):
        return None
    cells += [""] * (len(names) - len(cells))
    return [
        f"{name} [{cell}]" if cell and not name.rstrip().endswith(("]", ")")) else name
        for name, cell in zip(names, cells, strict=False)
    ]


def separator_of(line: str) -> str | None:
    """Sign between the cells; None is blanks."""
    found = max((";", ",", "\t"), key=line.count)
    return found if line.count(found) else None


def split(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_date(text: str) -> bool:
    try:
        Dates().seconds(text)
    except ValueError:
        return False
    return True


class _Reader:
    """Lines to numbers.

    Parameters
    ----------
    dates : what reads the columns that hold no numbers.

    Attributes
    ----------
    read, spoilt : rows so far, and how many of them were no rows of numbers.
    """

    def __init__(
        self,
        path: str,
        head: str,
        separator: str | None,
        columns: Sequence[int],
        dates: Mapping[int, Dates],
    ) -> None:
        self._path, self._head, self._separator, self._columns = path, head, separator, list(columns)
        self._dates = dates
        self.read = self.spoilt = 0
        self._first = ""  # of the spoilt rows, and what is wrong with it

    @property
    def remarks(self) -> list[str]:
        """What was passed over, for people."""
        if not self.spoilt:
            return []
        rows = "1 row is no row" if self.spoilt == 1 else f"{self.spoilt:,} rows are no rows"
        return [f"{rows} of numbers and taken as lost; first {self._first}"]

    def numbers(self, lines: list[str], before: int, *, last: bool) -> tuple[Floats, Sequence[int]]:
        """(n, k) of the wanted columns, and (n,) the number of each row's line.

        A row that is no row is not a number, and its line 0.

        Raises
        ------
        SourceError : there are too many such rows; it names the first.
        """
        try:
            found = np.asarray(
                np.loadtxt(
                    lines,
                    delimiter=self._separator,
                    usecols=self._columns,
                    ndmin=2,
                    comments=None,
                    quotechar='"',
                    converters={column: read.seconds for column, read in self._dates.items()} or None,
                    encoding="utf-8",
                ),
                dtype=np.float64,
            )
            places = [before + k + 1 for k, line in enumerate(lines) if line.strip()]
        except (ValueError, IndexError):
            end = len(lines) - 1 if last else -1
            read = [self._row(line, before + k + 1, k == end) for k, line in enumerate(lines)]
            found = np.array([row for row, _ in read if row]).reshape(-1, len(self._columns))
            places = [place for row, place in read if row]
        self.read += len(found)
        if self.spoilt > SPOILT_ROWS and self.spoilt > SPOILT_SHARE * self.read:
            raise SourceError(
                f"{self._path} {self._first}; {self.spoilt:,} of {self.read:,} rows are no rows of numbers"
            )
        return found, places

    def _row(self, line: str, number: int, last: bool) -> tuple[list[float], int]:
        """Numbers of a line that is not quite regular; none of a line that stands for no sample."""
        if not line.strip() or line.lstrip()[0] in "#%" or line == self._head:
            return [], number
        cells = split(line, self._separator)
        try:
            return [self._number(cells, column) for column in self._columns], number
        except ValueError as error:
            if last:  # cut off
                return [], number
            self.spoilt += 1
            self._first = self._first or f"line {number} {error}"
            return [math.nan] * len(self._columns), 0

    def _number(self, cells: Sequence[str], column: int) -> float:
        """Number in a cell, NaN where it is left open.

        Raises
        ------
        ValueError : there is none; it says so in words.
        """
        if column >= len(cells):
            raise ValueError(f"has {len(cells)} columns, column {column + 1} is wanted")
        text = cells[column]
        if self._separator != ",":
            text = text.replace(",", ".")
        if text.lower() in MISSING:
            return math.nan
        try:
            return self._dates[column].seconds(text) if column in self._dates else float(text)
        except ValueError:
            raise ValueError(f"column {column + 1}: {text[:30]!r} is no number") from None
