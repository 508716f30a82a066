"""Rows of a table of text: lines to cells, dates and numbers, one block at a time.

A row that lacks a number is a lost sample, and so is an invalid row: they are counted and the first is named. A file
with many invalid rows is no table.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime, time, timedelta
from functools import cache
from typing import Any

import numpy as np

from imumon.errors import QUOTED
from imumon.recordings.base import LONGEST_LINE, RecordingError
from imumon.recordings.raw_capture import RawCapture
from imumon.recordings.table import BLOCK_BYTES, ROWS, Table
from imumon.samples import Floats, SampleBlock
from imumon.units import DAY

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


class TextTable(Table):
    """A table of text, gzip or not, in blocks of whole lines; memory does not grow with its length."""

    _capture: RawCapture

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        blocks = self._line_blocks()
        first, before = self._read_head(blocks)
        waiting, count, size = [first], first.count(b"\n"), len(first)
        for block in blocks:
            if count >= ROWS or size > BLOCK_BYTES:
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
        carriage = b""  # at the end of a chunk: its line feed may follow
        for chunk in self._capture:
            self.fed += len(chunk)
            self.problem, self.progress = self._capture.problem, self._capture.progress
            if carriage or b"\r" in chunk:
                chunk = carriage + chunk
                carriage = b"\r" if chunk.endswith(b"\r") else b""
                chunk = chunk.removesuffix(b"\r").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
            first, end, more = chunk.partition(b"\n")
            if not skipping:
                rest += first
            skipping = skipping or len(rest) > LONGEST_LINE
            if not end:
                rest = b"" if skipping else rest
                continue
            whole = more.rfind(b"\n") + 1
            yield (TOO_LONG_BYTES if skipping else rest) + b"\n" + more[:whole]
            rest, skipping = more[whole:], False
        self.problem = self._capture.problem
        if skipping or rest.strip():
            yield (TOO_LONG_BYTES if skipping else rest) + b"\n"


def lines_of(block: bytes) -> list[str]:
    """Return the lines of a block, which ends with the end of one."""
    return [decoded(line) for line in block.split(b"\n")[:-1]]


def decoded(line: bytes) -> str:
    """Return a line in UTF-8, else in Latin-1: older spreadsheets write the degree sign as one byte."""
    if len(line) > LONGEST_LINE or line == TOO_LONG_BYTES:
        return TOO_LONG
    try:
        return line.decode("utf-8-sig")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def has_cells(line: str) -> bool:
    """Return whether a line is neither blank nor a comment."""
    return bool(line.strip()) and line.lstrip()[0] not in "#%"


def separator_of(line: str) -> str | None:
    """Return the character between the cells; None: blanks."""
    found = max((";", ",", "\t", "|"), key=line.count)
    return found if line.count(found) else None


def split(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line, without quotes."""
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def is_number(text: str, read: Callable[[str], float] = float) -> bool:
    try:
        read(text)
    except ValueError:
        return False
    return True


class DateReader:
    """Reads a column of dates or times of day, in any order, as seconds.

    It reads ISO 8601, ``2026-01-31T12:00:00.025Z`` or with a blank, and a time of day, ``12:00:00.025``, which
    continues over midnight. Seconds count from the first one, so that no digit is lost to the years since 1970.
    Digits beyond microseconds are ignored.
    """

    def __init__(self) -> None:
        self._first: datetime | None = None
        self._last = 0.0

    def seconds(self, text: str) -> float:
        """Return the seconds since the first date that was read; raise ValueError if it is no date.

        >>> dates = DateReader()
        >>> [dates.seconds(text) for text in ("23:59:59.5", "00:00:00.25", "23:59:59.75")]
        [0.0, 0.75, 0.25]
        """
        text = text.strip()
        if ":" not in text:  # a number, such as 20260131, is no date
            raise ValueError(text)
        try:
            of_day = datetime.combine(datetime(1970, 1, 1), time.fromisoformat(text))
        except ValueError:
            return self._since_first(datetime.fromisoformat(text))
        seconds = self._since_first(of_day)
        self._last = seconds + DAY * round((self._last - seconds) / DAY)
        return self._last

    def _since_first(self, moment: datetime) -> float:
        if self._first is None:
            self._first = moment
        try:
            return (moment - self._first) / timedelta(seconds=1)
        except TypeError:  # one has a time zone, the other has none
            raise ValueError(str(moment)) from None


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
    """

    def __init__(
        self, path: str, header: str, separator: str | None, columns: list[int], dates: dict[int, DateReader]
    ) -> None:
        self._path, self._header, self._separator, self._columns = path, header, separator, columns
        self._dates = dates
        self.read = self.invalid = 0
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

    def numbers(self, block: bytes, places: Sequence[int], *, last: bool) -> tuple[Floats, Sequence[int]]:
        """Return (n, k) numbers of the columns of some lines, and (n,) the line number of each row.

        An invalid row is NaN, and its line 0. Too many invalid rows raise a `RecordingError`.

        Parameters
        ----------
        places : number of each line.
        last : they end the table.
        """
        found = None if block.isspace() else self._regular(block)
        lines = places
        if found is not None and len(found) < len(lines):  # blank lines are no rows
            filled = zip(lines, block.split(b"\n")[:-1], strict=True)
            places = [place for place, line in filled if line.strip()]
        if found is None or len(found) != len(places):
            whole = lines_of(block)
            end = len(whole) - 1 if last else -1
            parsed = [self._row(line, lines[k], k == end) for k, line in enumerate(whole)]
            found = np.array([row for row, _ in parsed if row]).reshape(-1, len(self._columns))
            places = [place for row, place in parsed if row]
        self.read += len(found)
        if self.invalid > INVALID_ROWS and self.invalid > INVALID_SHARE * self.read:
            text = f"{self._path} {self._first_invalid}; {self.invalid:,} of {self.read:,} rows are invalid"
            raise RecordingError("too_many_invalid_rows", text, "correct these rows, or delete them")
        return found, places

    def _regular(self, block: bytes) -> Floats | None:
        """Return the numbers of lines that all are rows of numbers; None if one is not."""
        if self._separator != ",":
            block = block.replace(b",", b".")  # the decimal sign
        if self._separator is not None and not self._dates and (found := self._by_arrow(block)) is not None:
            return found
        convert: dict[int | str, Callable[[str], float]] = {k: d.seconds for k, d in self._dates.items()}
        try:
            rows: Floats = np.loadtxt(
                io.StringIO(block.decode("latin-1")), usecols=self._columns, delimiter=self._separator,
                converters=convert or None, comments=None, quotechar='"', ndmin=2,
            )  # fmt: skip
        except (ValueError, IndexError):
            return None
        return rows

    def _by_arrow(self, block: bytes) -> Floats | None:
        """Return the numbers, read by pyarrow; None if it is not installed or a line is no row of numbers."""
        if (arrow := _arrow()) is None:
            return None
        first = block[: block.index(b"\n")].decode("latin-1")
        names = [str(k) for k in range(len(split(first, self._separator)))]
        if max(self._columns) >= len(names):
            return None
        used = [names[k] for k in self._columns]
        try:
            table = arrow.read_csv(
                io.BytesIO(block),
                read_options=arrow.ReadOptions(
                    use_threads=False, block_size=len(block) + 1, column_names=names
                ),
                parse_options=arrow.ParseOptions(delimiter=self._separator),
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
        if not has_cells(line) or line == self._header:
            return [], number
        cells = split(line, self._separator)
        row: list[float] = []
        for column in self._columns:
            value = self._number(cells, column)
            if value is None:
                if last:  # truncated
                    return [], number
                self.invalid += 1
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
        if self._separator != ",":
            text = text.replace(",", ".")
        if text.lower() in MISSING:
            return math.nan
        try:
            return self._dates[column].seconds(text) if column in self._dates else float(text)
        except ValueError:
            return None

    @staticmethod
    def _fault(cells: Sequence[str], column: int) -> str:
        """Return what is wrong with a cell, for people."""
        if column >= len(cells):
            return f"has {len(cells)} columns, column {column + 1} is needed"
        return f"column {column + 1}: {cells[column][:QUOTED]!r} is no number"
