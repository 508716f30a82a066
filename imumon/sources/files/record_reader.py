"""Record reader: the records of a printed log in bulk, by the form that its head has shown.

What fits the form becomes rows: regular cells by pyarrow or numpy, templates by one pattern. Only a block with an
exception is read line by line, and every line that is no record is counted (`imumon.model.ledger`).
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from imumon.model.errors import QUOTED
from imumon.model.ledger import Ledger
from imumon.model.samples import Floats
from imumon.sources.files.base import LONGEST_LINE, RecordingError
from imumon.sources.files.date_reader import DateReader
from imumon.sources.files.printed_log import (
    TOKEN,
    TOO_LONG,
    TOO_LONG_BYTES,
    PrintedTable,
    are_names,
    cell_number,
    decoded,
    number_of,
    split,
)

INVALID_SHARE, INVALID_ROWS = 0.1, 10
"""Share of invalid rows above which a text is no table, and invalid rows that every table may have."""


@cache
def _arrow() -> Any:
    """Return the module of pyarrow that reads CSV; None if it is not installed."""
    try:
        from pyarrow import csv as arrow
    except ImportError:
        return None
    return arrow


ARROW_MISSING = ["", "nan", "NaN", "NAN", "NA", "N/A", "n/a", "null", "NULL", "Null"]
"""Spellings of a missing number that the fast reader knows. A block with another one is read line by line."""


class RecordReader:
    """Reads the records of a table from blocks of whole lines.

    Parameters
    ----------
    path : for messages.
    table : how its records are printed.
    columns : numbers that are read, by their places in a record.
    others : further tables of the text; their lines are of another sensor.

    Attributes
    ----------
    problem : why the table ends before the text; empty: it does not.
    """

    def __init__(
        self, path: str, table: PrintedTable, columns: Sequence[int], others: Sequence[PrintedTable] = ()
    ) -> None:
        self._path, self._table, self._columns = path, table, list(columns)
        self._dates = {k: DateReader() for k in table.dates if k in self._columns}
        self._ledger = Ledger()
        self._pattern = re.compile(table.pattern.encode(), re.MULTILINE)
        self._others = [re.compile(other.pattern.encode(), re.MULTILINE) for other in others if other.pattern]
        self._rest, self._rest_lines = b"", 0  # of a record that has begun
        self.problem = ""
        self._read = self._invalid = 0
        self._first_invalid = ""
        self._begun = False

    @property
    def remarks(self) -> list[str]:
        """What was left out, for people."""
        if not self._invalid:
            return []
        rows = (
            f"{self._invalid:,} rows are invalid and count"
            if self._invalid > 1
            else "1 row is invalid and counts"
        )
        return [f"{rows} as lost; first {self._first_invalid}"]

    @property
    def ledger(self) -> dict[str, int]:
        """What became of the lines that are no rows of numbers, by reason."""
        return self._ledger.counts(pending=self._rest_lines)

    def read(self, block: bytes, first: int, *, last: bool) -> tuple[Floats, Sequence[int]]:
        """Return (n, k) numbers of the records in some lines, and (n,) the number of the line of each.

        An invalid row is NaN, and its line 0. Too many invalid rows raise a `RecordingError`.

        Parameters
        ----------
        first : number of the first line.
        last : the block ends the text.
        """
        if self.problem:
            self._ledger.add("other_message", block.count(b"\n"))
            return np.empty((0, len(self._columns))), []
        rows, places = (self._printed if self._table.pattern else self._cells)(block, first, last=last)
        self._read += len(rows)
        # here and not at the end: a file of another kind is refused within its first block
        if self._invalid > INVALID_ROWS and self._invalid > INVALID_SHARE * self._read:
            text = f"{self._path} {self._first_invalid}; {self._invalid:,} of {self._read:,} rows are invalid"
            raise RecordingError("too_many_invalid_rows", text, "correct these rows, or delete them")
        return rows, places

    def _invalid_row(self, place: int, reason: str, fault: str) -> tuple[list[float], int]:
        self._invalid += 1
        self._ledger.add(reason)
        self._first_invalid = self._first_invalid or f"line {place} {fault}"
        return [math.nan] * len(self._columns), 0

    # ------------------------------------------------------------ cells

    def _cells(self, block: bytes, first: int, *, last: bool) -> tuple[Floats, Sequence[int]]:
        count = block.count(b"\n")
        rows = None if self._table.codes or block.isspace() else self._regular(block)
        if rows is not None and len(rows) == count:
            return rows, range(first, first + count)
        parsed = []
        lines = block.split(b"\n")[:-1]
        for k, line in enumerate(lines):
            if self.problem:
                self._ledger.add("other_message")
            elif (
                row := self._row(
                    decoded(line) if len(line) <= LONGEST_LINE else TOO_LONG,
                    first + k,
                    last=last and k == count - 1,
                )
            ) is not None:
                parsed.append(row)
        numbers = np.array([row for row, _ in parsed]).reshape(-1, len(self._columns))
        return numbers, [place for _, place in parsed]

    def _regular(self, block: bytes) -> Floats | None:
        """Return the numbers of lines that all are rows of numbers; None if one is not."""
        table = self._table
        if table.decimal:
            block = block.replace(b",", b".")
        # pyarrow is several times as fast, but knows neither runs of blanks nor dates of loggers
        if table.separator is not None and not self._dates and (numbers := self._by_arrow(block)) is not None:
            return numbers
        convert: dict[int | str, Callable[[str], float]] = {k: d.seconds for k, d in self._dates.items()}
        try:
            rows: Floats = np.loadtxt(
                io.StringIO(block.decode("latin-1")), usecols=self._columns, delimiter=table.separator,
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
        names = [
            str(k)
            for k in range(len(split(block[: block.index(b"\n")].decode("latin-1"), self._table.separator)))
        ]
        if max(self._columns) >= len(names):
            return None
        used = [names[k] for k in self._columns]
        try:
            table = arrow.read_csv(
                io.BytesIO(block),
                read_options=arrow.ReadOptions(
                    use_threads=False, block_size=len(block) + 1, column_names=names
                ),
                parse_options=arrow.ParseOptions(delimiter=self._table.separator),
                convert_options=arrow.ConvertOptions(
                    column_types=dict.fromkeys(used, "float64"), include_columns=[*dict.fromkeys(used)],
                    null_values=ARROW_MISSING,
                ),
            )  # fmt: skip
        except (ValueError, KeyError):  # ArrowInvalid is a ValueError
            return None
        return np.column_stack([table.column(name).to_numpy() for name in used])

    def _row(self, line: str, place: int, *, last: bool) -> tuple[list[float], int] | None:
        """Return the numbers of an irregular line and its place; None of a line that is no sample."""
        table = self._table
        if not line.strip() or line == table.header:
            self._ledger.add("header" if line.strip() else "blank")
            return None
        cells = split(line, table.separator)
        for k, code in table.codes:
            if k >= len(cells) or cells[k] != code:
                self._ledger.add("other_sensor")
                return None
        row: list[float] = []
        for k in self._columns:
            value = cell_number(cells[k], self._dates.get(k), table.decimal) if k < len(cells) else None
            if value is None:
                return self._no_row(line, cells, k, place, last=last)
            row.append(value)
        self._begun = True
        return row, place

    def _no_row(
        self, line: str, cells: Sequence[str], k: int, place: int, *, last: bool
    ) -> tuple[list[float], int] | None:
        """Return the row of a line that lacks a number where one is needed; None: it is no row at all."""
        if line.lstrip().startswith(("#", "%", "//")):
            self._ledger.add("comment")
            return None
        if last or not self._begun:  # half a line of a program that was killed, or that had begun before
            self._ledger.add("pending" if last else "start")
            return None
        if self._table.header and are_names(cells) and len(cells) > 2 and line != TOO_LONG:
            self.problem = f"{self._path} line {place} names other columns: only the rows before are used"
            self._ledger.add("other_message")
            return None
        if line == TOO_LONG:
            return self._invalid_row(place, "damaged", "is too long")
        if k >= len(cells):
            return self._invalid_row(
                place, "wrong_columns", f"has {len(cells)} columns, column {k + 1} is needed"
            )
        return self._invalid_row(place, "not_numbers", f"column {k + 1}: {cells[k][:QUOTED]!r} is no number")

    # ------------------------------------------------------------ templates

    def _printed(self, block: bytes, first: int, *, last: bool) -> tuple[Floats, Sequence[int]]:
        block, first = self._rest + block, first - self._rest_lines
        self._rest, self._rest_lines = b"", 0
        matches = self._pattern.findall(block)
        if (
            last
            and self._table.tail
            and len(more := self._pattern.findall(block + self._table.tail.encode())) > len(matches)
        ):
            block, matches = block + self._table.tail.encode(), more
            self._ledger.add("part", -self._table.tail.count("\n"))  # of the last record, which lacks them
        count, lines = block.count(b"\n"), self._table.lines
        if len(matches) * lines == count:  # nothing stands between the records
            self._ledger.add("part", len(matches) * (lines - 1))
            self._begun = self._begun or bool(matches)
            return self._values(matches), range(first, first + count, lines)
        starts = [match.start() for match in self._pattern.finditer(block)]
        ends = np.flatnonzero(np.frombuffer(block, np.uint8) == 10)
        line_of_record = np.searchsorted(ends, starts)  # lines before each record
        values = self._values(matches)
        rows: list[Floats] = []
        places: list[int] = []
        begin = 0  # first line that is not accounted for
        bounds = np.concatenate([[0], ends + 1])
        for k, line in enumerate([*line_of_record.tolist(), count]):
            if k == len(line_of_record) and not last and count - begin < 4 * lines:
                self._rest, self._rest_lines = block[bounds[begin] :], count - begin
                break
            lost = (
                self._between(
                    block[bounds[begin] : bounds[line]], first + begin, last=k == len(line_of_record)
                )
                if line > begin
                else 0
            )
            rows += [np.full((lost, len(self._columns)), math.nan)] * bool(lost)
            places += [0] * lost
            if k < len(line_of_record):
                self._begun = True
                rows.append(values[k : k + 1])
                places.append(first + line)
            begin = line + lines
        self._ledger.add("part", len(line_of_record) * (lines - 1))
        return np.concatenate([*rows, np.empty((0, len(self._columns)))]), places

    def _values(self, matches: Sequence[Any]) -> Floats:
        """Return (n, k) numbers of the columns that are used."""
        if matches and isinstance(matches[0], bytes):
            matches = [(match,) for match in matches]
        out = np.empty((len(matches), len(self._columns)))
        for j, k in enumerate(self._columns):
            if (dates := self._dates.get(k)) is not None:
                out[:, j] = [dates.seconds(match[k].decode()) for match in matches]
                continue
            try:
                out[:, j] = [float(match[k]) for match in matches]
            except ValueError:
                numbers = (number_of(match[k].decode()) for match in matches)
                out[:, j] = [math.nan if number is None else number for number in numbers]
        return out

    def _between(self, text: bytes, place: int, *, last: bool) -> int:
        """Account for lines between two records; return how many records are damaged in them."""
        damaged = 0
        for line in text.split(b"\n")[:-1]:
            reason = self._reason_between(line, last=last)
            damaged += reason == "damaged"
            self._ledger.add(reason)
        # as many records as the lines would hold
        lost = -(-damaged // self._table.lines)
        if lost and not last:
            self._invalid += lost
            self._first_invalid = self._first_invalid or f"line {place} is another text"
        return lost if not last else 0

    def _reason_between(self, line: bytes, *, last: bool) -> str:
        """Return why a line between two records is none."""
        if not line.strip():
            return "blank"
        if any(other.match(line + b"\n") for other in self._others):
            return "other_sensor"
        if last or not self._begun:
            return "pending" if self._begun else "start"
        if len(line) > LONGEST_LINE or line == TOO_LONG_BYTES:
            return "damaged"
        numbers = sum(match["number"] is not None for match in TOKEN.finditer(decoded(line)))
        is_part = 2 * numbers * self._table.lines >= len(self._table.names) and bool(numbers)
        return "damaged" if is_part else "not_numbers"
