"""Record reader: the records of a printed log in bulk, by the form that its head has shown.

A record is numbers in a fixed text, so that one pattern reads all of them; a row of cells is the simplest such text.
Blocks of nothing but regular cells are read by pyarrow or numpy, which know no other form. What is between two
records is counted line by line (`imumon.model.ledger`); what may have been a record is a lost sample.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from imumon.model.errors import QUOTED
from imumon.model.ledger import Ledger
from imumon.model.samples import AXES, Floats, Ints
from imumon.sources.files.base import LONGEST_LINE, RecordingError
from imumon.sources.files.column_header import are_names
from imumon.sources.files.column_names import names_sensor
from imumon.sources.files.date_reader import DateReader
from imumon.sources.files.printed_log import (
    TOKEN,
    TOO_LONG_BYTES,
    PrintedTable,
    line_count,
)
from imumon.sources.files.text_cells import decoded, numbers_of, split

INVALID_SHARE, INVALID_ROWS = 0.1, 10
"""Share of invalid rows above which a text is no table, and invalid rows that every table may have."""

ARROW_MISSING = ["", "nan", "NaN", "NAN", "NA", "N/A", "n/a", "null", "NULL", "Null"]
"""Spellings of a missing number that the fast reader knows. A block with another one is read by the pattern."""


@cache
def _arrow() -> Any:
    """Return pyarrow with its module that reads CSV; None if it is not installed."""
    try:
        import pyarrow
        import pyarrow.csv
    except ImportError:
        return None
    return pyarrow


OUTSIDE = ("blank", "header", "comment", "other_sensor")
"""Reasons of lines that no record has lost."""


class RecordForm:
    """What is a record of a table, and what a line is that is none.

    Parameters
    ----------
    columns : numbers that are read, by their places in a record.
    others : further tables of the text; their lines are of another sensor.
    exact : nothing follows the last cell of a row; otherwise further cells may.

    Attributes
    ----------
    pattern : of a record; it has a group for each number, or for each that is read.
    groups : of the columns, for each sample in a record.
    dates : readers of the columns that are dates, by their places.
    """

    def __init__(
        self,
        table: PrintedTable,
        columns: Sequence[int],
        others: Sequence[PrintedTable] = (),
        *,
        exact: bool = False,
    ) -> None:
        self.table, self._columns = table, list(columns)
        self.dates = {k: DateReader() for k in table.dates if k in self._columns}
        used = sorted(set(self._columns))
        # of the numbers of each sample in a record; a template has a group for each number
        places = range(len(table.names)) if table.pattern else {k: j for j, k in enumerate(used)}
        self.groups = [[sample[k] for k in self._columns] for sample in table.samples or (places,)]
        self.pattern = _compiled(table.pattern or _cell_pattern(table, used, exact=exact))
        patterns = [*(other.pattern for other in others if other.pattern), *table.between]
        self._others = [_compiled(pattern) for pattern in patterns]

    def numbers(self, texts: Sequence[Sequence[Any]]) -> list[list[float]]:
        """Return the numbers of each column, for each of the samples of a record, by the texts of the groups."""
        return [
            numbers_of(texts[group], self.dates.get(k), self.table.decimal)
            for groups in self.groups
            for k, group in zip(self._columns, groups, strict=True)
        ]

    def sample(self, record: re.Match[bytes]) -> list[float]:
        """Return the number of each column in one record, in its first sample."""
        if self.dates:
            return [column[0] for column in self.numbers([[text] for text in record.groups()])]
        return numbers_of([record[1 + group] for group in self.groups[0]], None, self.table.decimal)

    def cells(self, line: bytes) -> list[str]:
        """Return the cells of a line; none, if the text between the numbers divides them."""
        return [] if self.table.pattern else split(decoded(line), self.table.separator)

    def reason(self, line: bytes) -> str:
        """Return why a line is no record, as the ledger has it; `OUTSIDE` are those that no record has lost."""
        if len(line) > LONGEST_LINE or line == TOO_LONG_BYTES:
            return "damaged"
        if kind := line_kind(line, self.table.header):
            return kind
        cells = self.cells(line)
        # lines of the other tables have their patterns
        codes = self.table.codes if cells else ()
        is_other = any(cells[k : k + 1] != [code] for k, code in codes)
        if is_other or any(other.match(line + b"\n") for other in self._others):
            return "other_sensor"
        return "wrong_columns" if 1 < len(cells) != len(self.table.names) else "not_numbers"


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
        self._form = RecordForm(table, columns, others)
        self._pattern, self._groups, self._dates = self._form.pattern, self._form.groups, self._form.dates
        self._ledger = Ledger()
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

    def read(self, block: bytes, first: int, *, last: bool) -> tuple[Floats, Ints]:
        """Return (n, k) numbers of the records in some lines, and (n,) the number of the line of each.

        A lost row is NaN, and its line 0. Too many of them raise a `RecordingError`. A record may be several rows.

        Parameters
        ----------
        first : number of the first line.
        last : the block ends the text.
        """
        count = line_count(block)
        if self.problem:
            self._ledger.add("other_message", count)
            return np.empty((0, len(self._columns))), np.empty(0, np.int64)
        regular = self._regular_cells(block)
        if regular is not None and len(regular) == count:
            self._begun = True
            rows: Floats = regular
            places: Ints = np.arange(first, first + count)
        else:
            rows, places = self._by_pattern(block, first, last=last)
        self._read += len(rows)
        # here and not at the end: a file of another kind is refused within its first block
        if self._invalid > INVALID_ROWS and self._invalid > INVALID_SHARE * self._read:
            text = f"{self._path} {self._first_invalid}; {self._invalid:,} of {self._read:,} rows are invalid"
            raise RecordingError("too_many_invalid_rows", text, "correct these rows, or delete them")
        return rows, places

    # ------------------------------------------------------------ regular cells

    def _regular_cells(self, block: bytes) -> Floats | None:
        """Return the numbers of lines that all are rows of cells with numbers; None if one is not."""
        table = self._table
        if table.pattern or table.codes or block.isspace():
            return None
        if table.decimal and table.separator == ",":
            return None
        if table.decimal:
            block = block.replace(b",", b".")
        # pyarrow is several times as fast, but knows neither runs of blanks nor dates of loggers
        if table.separator is not None and not self._dates and (numbers := self._by_arrow(block)) is not None:
            return numbers
        convert: dict[int | str, Callable[[str], float]] = {k: d.seconds for k, d in self._dates.items()}
        try:
            rows: Floats = np.loadtxt(
                block.decode("latin-1").split("\n"), usecols=self._columns, delimiter=table.separator,
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
        first_line = block[: block.index(b"\n")].decode("latin-1")
        names = [str(k) for k in range(len(split(first_line, self._table.separator)))]
        if max(self._columns) >= len(names):
            return None
        used = [names[k] for k in self._columns]
        try:
            rows = arrow.csv.read_csv(
                arrow.BufferReader(block),
                read_options=arrow.csv.ReadOptions(
                    use_threads=False, block_size=len(block) + 1, column_names=names
                ),
                parse_options=arrow.csv.ParseOptions(delimiter=self._table.separator),
                convert_options=arrow.csv.ConvertOptions(
                    column_types=dict.fromkeys(used, "float64"), include_columns=[*dict.fromkeys(used)],
                    null_values=ARROW_MISSING,
                ),
            )  # fmt: skip
        except (ValueError, KeyError):  # ArrowInvalid is a ValueError
            return None
        columns = [rows.column(name).combine_chunks() for name in used]
        filled = (column.fill_null(math.nan) if column.null_count else column for column in columns)
        # to_numpy of pyarrow would import pandas, where that is installed, and take 0.3 s and 30 MB
        return np.stack([*map(np.from_dlpack, filled)]).T

    # ------------------------------------------------------------ any record

    def _by_pattern(self, block: bytes, first: int, *, last: bool) -> tuple[Floats, Ints]:
        block, first = self._rest + block, first - self._rest_lines
        self._rest, self._rest_lines = b"", 0
        if last:
            block = self._with_tail(block)
        matches = self._pattern.findall(block)
        count, lines = line_count(block), self._table.lines
        if len(matches) * lines == count:  # nothing is between the records
            self._ledger.add("part", len(matches) * (lines - 1))
            self._begun = self._begun or bool(matches)
            return self._values(matches), self._of_samples(np.arange(first, first + count, lines))
        bounds = np.append(0, np.flatnonzero(np.frombuffer(block, np.uint8) == ord("\n")) + 1)
        starts = np.searchsorted(bounds, [match.start() for match in self._pattern.finditer(block)])
        lost = np.zeros(len(starts) + 1, np.int64)  # records before each one, and behind the last one
        begins, ends = np.append(0, starts + lines), np.append(starts, count)
        for k in np.flatnonzero(ends > begins).tolist():
            begin, end = int(begins[k]), int(ends[k])
            behind = k == len(starts)
            if behind and not last and lines > 1 and end - begin < 4 * lines:
                self._rest, self._rest_lines = block[bounds[begin] :], end - begin
                break
            self._begun = self._begun or k > 0
            lost[k] = self._between(
                block[bounds[begin] : bounds[end]].split(b"\n")[:-1], first + begin, last=last and behind
            )
            if self.problem:
                self._ledger.add("other_message", count - end)
                starts, matches, lost = starts[:k], matches[:k], lost[: k + 1]
                break
        self._begun = self._begun or bool(len(starts))
        self._ledger.add("part", len(starts) * (lines - 1))
        where = self._of_samples(np.repeat(np.arange(len(lost)), lost))
        return (
            np.insert(self._values(matches), where * len(self._groups), math.nan, axis=0),
            np.insert(self._of_samples(first + starts), where * len(self._groups), 0),
        )

    def _of_samples(self, of_records: Ints) -> Ints:
        """Return a number for each sample, of (n,) for each record."""
        return np.repeat(of_records, len(self._groups))

    def _with_tail(self, block: bytes) -> bytes:
        """Return the last lines of a text, with those that the last record lacks behind its numbers."""
        tail = self._table.tail.encode()
        if not tail or len(self._pattern.findall(block + tail)) == len(self._pattern.findall(block)):
            return block
        self._ledger.add("part", -line_count(tail))
        return block + tail

    def _values(self, matches: Sequence[Any]) -> Floats:
        """Return (n, k) numbers of the columns that are used, with the samples of a record one behind the other."""
        self._ledger.receive(len(matches) * (len(self._groups) - 1))
        # of a pattern with one group, a match is its text
        texts = [matches] if self._pattern.groups == 1 else [*zip(*matches, strict=True)]
        columns = self._form.numbers(texts) if matches else []
        return np.array(columns).T.reshape(-1, len(self._columns))

    def _between(self, lines: Sequence[bytes], place: int, *, last: bool) -> int:
        """Account for lines between two records; return how many records are damaged in them."""
        damaged = 0
        for k, line in enumerate(lines):
            is_end = last and (self._table.lines > 1 or k == len(lines) - 1)
            reason, fault = self._reason(line, place + k, is_end=is_end)
            self._ledger.add(reason)
            if fault:
                damaged += 1
                self._first_invalid = self._first_invalid or f"line {place + k} {fault}"
        # as many records as the lines would hold
        lost = -(-damaged // self._table.lines)
        self._invalid += lost
        return lost

    def _reason(self, line: bytes, place: int, *, is_end: bool) -> tuple[str, str]:
        """Return why a line between two records is none, and what is wrong with it if it is a damaged one."""
        if self.problem:
            return "other_message", ""
        reason = self._form.reason(line)
        if reason in OUTSIDE:
            return reason, ""
        if is_end or not self._begun:  # half a line of a program that was killed, or that had begun before
            return "pending" if self._begun else "start", ""
        if reason == "damaged":
            return reason, "is too long"
        text, cells = decoded(line), self._form.cells(line)
        if self._begins_other_table(text, cells):
            self.problem = f"{self._path} line {place} names other columns: only the rows before are used"
            return "other_message", ""
        numbers = len(cells) or _numbers_in(text)
        if 2 * numbers * self._table.lines < len(self._table.names):  # less than half of those of a line
            return reason, ""
        return reason if cells else "damaged", f"is no record: {text[:QUOTED]!r}"

    def _begins_other_table(self, text: str, cells: Sequence[str]) -> bool:
        """Return whether a line names other columns, or is a title of few words that names a sensor."""
        if not cells or not are_names(cells):
            return False
        names_columns = bool(self._table.header) and len(cells) > 2
        return names_columns or (len(text.split()) <= len(AXES) and names_sensor(text))


def _numbers_in(text: str) -> int:
    return sum(match["number"] is not None for match in TOKEN.finditer(text))


def line_kind(line: bytes, header: str) -> str:
    """Return what a line is that can be no record: ``blank``, ``header`` or ``comment``; empty: none of these."""
    if not line.strip():
        return "blank"
    if header and decoded(line).rstrip() == header.rstrip():
        return "header"
    return "comment" if line.lstrip().startswith((b"#", b"%", b"//")) else ""


_CELL = (
    r"(?i:[-+]?(?:\d[\d.]*|\.\d+)(?:e[-+]?\d+|d[-+]\d+)?(?:\*[0-9A-F]{2,8})?"
    r"|[-+]?(?:nan|inf|infinity)|na|n/a|null|none|-|)"
)
"""Number of a cell, which may have a check behind it, or a word for none."""


def _compiled(pattern: str) -> re.Pattern[bytes]:
    """Return the pattern of a record for bytes; text that is no ASCII may have any encoding."""
    return re.compile(re.sub(r"[^\0-\x7f]+", r"[^\\0-\\x7f]+", pattern).encode(), re.MULTILINE)


def _cell_pattern(table: PrintedTable, columns: Sequence[int], *, exact: bool) -> str:
    """Return the pattern of a row of cells, with a group for each of some columns in their order."""
    blank = "[ ]*" if table.separator == "\t" else "[ \t]*"
    separator = "[ \t]+" if table.separator is None else blank + re.escape(table.separator)
    around = "" if table.separator is None else blank
    inside = " \t" if table.separator is None else re.escape(table.separator)
    # atomic: a cell in quotes is never tried without them, or a row of such cells takes a time without end
    any_cell = rf"(?>\"[^\"\n]*\"[^{inside}\n]*|[^{inside}\n]*)"
    number = _CELL.replace(r"[\d.]*|\.", r"[\d.,]*|[.,]") if table.decimal else _CELL
    codes, cells = dict(table.codes), []
    for k in range(len(table.names) if exact else max([*columns, *codes], default=-1) + 1):
        content = rf"([^{inside}\n]*?\d[^{inside}\n]*?)" if k in table.dates else f"({number})"
        if k in codes:
            content = re.escape(codes[k])  # which may be the number of an axis, too
            content = f"({content})" if k in columns else content
        elif k not in columns:
            content = ""
        cells.append(rf"{around}[\"']?{around}{content}{around}[\"']?{around}" if content else any_cell)
    end = r";?[ \t\r]*" if exact else rf"(?:;|[{inside}][^\n]*)?"
    return rf"^{blank}{separator.join(cells)}{end}\n"
