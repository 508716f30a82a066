"""CSV: tables as text, of any dialect, in blocks of rows.

The header line shows the separator and the columns, a row of units below it their units; lines before it are
ignored, and so are comments and repeated headers. A time may be a number, a date or a time of day. Memory does not
grow with the length.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from imumon.column_names import UNITS, unit_of
from imumon.errors import QUOTED
from imumon.recordings.base import HEAD_LINES, LONGEST_LINE, ReadOptions, RecordingError
from imumon.recordings.columns import MAP_EXAMPLE, ColumnLayout, layout
from imumon.recordings.csv_rows import (
    MISSING,
    TOO_LONG,
    DateReader,
    RowParser,
    TextTable,
    has_cells,
    is_number,
    lines_of,
    separator_of,
    split,
)
from imumon.recordings.raw_capture import RawCapture
from imumon.report import plain
from imumon.samples import AXES, SampleBlock

COMPLETE = "check that it is complete"
"""Cure for a table without rows."""

ECHOED = (
    "sec", "nanosec", "frame_id", *("orientation",) * 13,
    *(f"angular_velocity.{axis} [rad/s]" for axis in AXES), *("covariance",) * 9,
    *(f"linear_acceleration.{axis}" for axis in AXES), *("covariance",) * 9,
)  # fmt: skip
"""Columns that ``ros2 topic echo --csv`` prints of `sensor_msgs/Imu`, without a header."""


class CsvFile(TextTable):
    """A CSV file, gzip or not, as blocks of samples.

    Iterating raises `RecordingError` if its columns are not those of an inertial sensor.
    """

    def __init__(self, capture: RawCapture, options: ReadOptions) -> None:
        self._capture, self._options = capture, options
        self.path = capture.path
        self._dates: dict[int, DateReader] = {}  # by column, of those with dates instead of numbers

    def _parsed(self, block: bytes, places: range, *, last: bool = False) -> list[SampleBlock]:
        return self._blocks(*self._parser.numbers(block, places, last=last))

    def _line_remarks(self) -> Sequence[str]:
        return self._parser.remarks

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
        at = header_line(seen)
        if at is None:
            header, (names, begin, separator) = "", self._without_header(seen)
        else:
            header, begin, separator = seen[at], at + 1, separator_of(seen[at])
            names = [plain(name) for name in split(header, separator)]
            if _is_one_number("".join(seen[begin : begin + 1])):
                names, separator = [plain(header.strip())], None
            if begin < len(seen) and (united := with_units(names, plain(seen[begin]), separator)) is not None:
                names, begin = united, begin + 1
        try:
            found = layout(names, self._options.kind, self._options.columns, self._options.sensor)
        except RecordingError as error:
            raise error.of(self.path) from None
        found = self._with_readable_times(found, seen[begin:], separator)
        columns = self._begin(found, "csv", self._options.rate_hz, names)
        self._parser = RowParser(self.path, header, separator, columns, self._dates)
        return head.split(b"\n", begin)[begin], begin

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
        what, first = ("column", 1) if count == 1 else (f"{count} columns", 2)
        cure = f"add one, or --map gyro/x={first}:rad/s,... by number"
        raise RecordingError("no_header", f"{self.path} has no line that names its {what}", cure)

    def _with_readable_times(
        self, found: ColumnLayout, lines: Sequence[str], separator: str | None
    ) -> ColumnLayout:
        """Return the columns without the times that cannot be read; dates are read as seconds."""
        cells = [split(line, separator) for line in lines if has_cells(line)]
        times, unreadable = [], ""
        for column in found.times:
            texts = [row[column.index] for row in cells if len(row) > column.index]
            texts = [text for text in texts if text.lower() not in MISSING]
            if not texts or any(is_number(text.replace(",", ".")) for text in texts):
                times.append(column)
            elif any(is_number(text, DateReader().seconds) for text in texts):
                self._dates[column.index] = DateReader()
                times.append(replace(column, unit="s"))
            else:
                unreadable = unreadable or f"the time in {column.name} is not readable, {texts[0][:QUOTED]!r}"
        if unreadable and not times:
            cure = f"write numbers or 2026-01-31T12:00:00.000, or omit it with {MAP_EXAMPLE} and --rate"
            raise RecordingError("time_not_readable", f"{self.path}: {unreadable}", cure)
        return replace(found, times=tuple(times))

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{self.path} has a header and no row of numbers after it", COMPLETE)


def is_echoed(line: str) -> bool:
    """Return whether a line is a message that ``ros2 topic echo --csv`` prints of an IMU."""
    cells = split(line, ",")
    return len(cells) == len(ECHOED) and all(map(is_number, (*cells[:2], *cells[3:])))


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
        if k and _names_one_column(lines[k - 1]) and all(map(_is_one_number, lines[k : k + 3])):
            return k - 1
        cells = split(line, separator_of(line))
        if len(cells) > 1 and sum(not is_number(cell) for cell in cells if cell) > len(cells) / 2:
            candidates.append(k)
        elif len(cells) > 1 and sum(is_number(cell) for cell in cells) > len(cells) / 2:
            excess = {at: _excess_cells(lines[at], line) for at in candidates}
            best = min(excess, key=excess.__getitem__, default=None)
            return best if best is not None and excess[best] <= 1 else None
    return candidates[0] if candidates else None


def _excess_cells(names: str, row: str) -> int:
    """Return by how many cells a line of names and a row differ."""
    separator = separator_of(names)
    return abs(len(split(names, separator)) - len(split(row, separator)))


def with_units(names: Sequence[str], row: str, separator: str | None) -> list[str] | None:
    """Return the names with the units of a row below them; None if it is no row of units.

    >>> with_units(["t", "wx", "wy [deg/s]"], "s,rad/s,", ",")
    ['t [s]', 'wx [rad/s]', 'wy [deg/s]']
    >>> with_units(["t", "wx"], "0.0,n/a", ",") is None
    True
    """
    cells = [cell.strip("[]()") for cell in split(row, separator)]
    known = [any(unit_of(cell, quantity) for quantity in UNITS) for cell in cells if cell]
    if 2 * sum(known) <= len(known):
        return None
    cells += [""] * (len(names) - len(cells))
    return [
        f"{name} [{cell}]" if cell and not name.rstrip().endswith(("]", ")")) else name
        for name, cell in zip(names, cells, strict=False)
    ]
