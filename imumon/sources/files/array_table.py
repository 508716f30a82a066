"""Table of arrays: named arrays of a file or of a program as blocks of samples.

An array of one column, (n,), (n, 1) or (1, n), is a column of the table. One of three columns has an axis each. Other
columns have the name of the array and a number from 1. Blocks of rows are taken as needed: memory does not grow with
the arrays.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imumon.model.cures import option_text
from imumon.model.report_json import plain
from imumon.model.samples import AXES, Floats, SampleBlock
from imumon.sources.files.base import ROWS, ReadOptions, RecordingError, RowSource
from imumon.sources.files.column_names import names_sensor
from imumon.sources.files.column_reader import read_columns
from imumon.sources.files.columns import LISTED, MOST_COLUMNS, Reading
from imumon.sources.files.table import Table

HEAD_ROWS = 4096
"""First rows that show what the columns are."""


@dataclass(frozen=True, slots=True)
class ArrayColumn:
    """Column of an array.

    Attributes
    ----------
    name : as of a column of a table.
    array : of the array that it is a part of.
    length : rows.
    key : its number in the array, or the name of a field; None: it is the array.
    """

    name: str
    array: str
    length: int
    key: int | str | None = None


Shape = tuple[int, ...]
Reader = Callable[[Sequence[ArrayColumn]], Iterator[Floats]]
"""Yields blocks of the rows of some columns, (n, k)."""
Opened = tuple[Mapping[str, tuple[Shape, Sequence[str]]], Reader]
"""Shape of each array, with the names of its fields, and its reader."""


class ArrayTable(Table):
    """Arrays of one length as blocks of samples.

    Parameters
    ----------
    path : for messages.
    form : of `RowSource`.
    opened : shapes of the arrays, and what reads their rows.

    Raises
    ------
    RecordingError : they have no inertial sensor, or different lengths.
    """

    def __init__(self, path: str, form: str, opened: Opened, options: ReadOptions) -> None:
        self.path = path
        shapes, self._read = opened
        listed = ", ".join(
            f"{plain(name) or 'one array'} {shape}" for name, (shape, _) in list(shapes.items())[:LISTED]
        )
        columns = [
            column for name, (shape, fields) in shapes.items() for column in columns_of(name, shape, fields)
        ]
        try:
            columns, reading = self._columns_of_one_length(columns, options)
        except RecordingError as error:
            if error.code != "no_sensor":
                raise error.of(path) from None
            text = f"{path}: no array is that of a gyroscope or accelerometer; there are {listed or 'none'}"
            raise RecordingError("no_sensor", text, error.cure) from None
        layout = reading.checked(path, accept=options.accept).layout(options.kind)
        names = [column.name for column in columns]
        self._columns = [columns[k] for k in self._begin(RowSource(path, form, names), layout, options)]

    def _columns_of_one_length(
        self, columns: Sequence[ArrayColumn], options: ReadOptions
    ) -> tuple[list[ArrayColumn], Reading]:
        """Return the columns that have a sensor and one length, and what they are."""
        lengths = Counter(column.length for column in columns if column.length > 1)
        rate = next(
            (
                c
                for c in columns
                if c.length == 1 and re.fullmatch(r"fs|.*rate.*|.*freq.*|odr", c.name, re.IGNORECASE)
            ),
            None,
        )
        stated_hz = None if rate is None else float(next(iter(self._read([rate])))[0, 0])
        if not lengths:
            raise RecordingError("no_rows", "it has no samples", "pass arrays with samples")
        faults = []
        for length, _ in lengths.most_common():
            some = [column for column in columns if column.length == length]
            with self._errors():
                rows = next(iter(self._read(some[:MOST_COLUMNS])))[:HEAD_ROWS]
            try:
                reading = read_columns(
                    [column.name for column in some], (), rows, options, stated_hz=stated_hz
                )
            except RecordingError as error:
                if error.code == "unknown_column" and len(lengths) > 1:
                    listed = ", ".join(f"{column.name} {column.length:,}" for column in columns[:LISTED])
                    text = f"its arrays have different lengths: {listed}"
                    raise RecordingError("array_lengths", text, "save arrays of one length") from None
                faults.append(error)
                continue
            others = [column.name for column in columns if column.length not in (length, 1)]
            if others:
                reading = replace(
                    reading,
                    remarks=(*reading.remarks, f"{', '.join(others[:LISTED])} not used: of another length"),
                )
            return some, reading
        raise max(
            faults,
            key=lambda error: error.code != "no_sensor",
            default=RecordingError(
                "no_sensor", "it has no columns", option_text(columns={"gyro": "COLUMN,COLUMN,COLUMN:UNIT"})
            ),
        )

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn what reading raises into an error."""
        yield

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        count, done = self._columns[0].length, 0
        with self._errors():
            for rows in self._read(self._columns):
                self.fed += rows.nbytes
                done += len(rows)
                self.progress = min(1.0, done / count)
                yield self._blocks(rows, range(done - len(rows) + 1, done + 1))
        yield self._finish()

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{self.path} has arrays without a sample", "save it again")


def columns_of(array: str, shape: Shape, fields: Sequence[str]) -> list[ArrayColumn]:
    """Return the columns of an array; raise `RecordingError` if it is that of a sensor, but transposed."""
    if not shape:  # a single number, such as a rate, or a single structure
        return []
    name = plain(array)
    shape = (max(shape),) if len(shape) == 2 and 1 in shape else shape
    if fields:
        return [ArrayColumn(plain(field), array, shape[0], field) for field in fields]
    if len(shape) == 1:
        return [ArrayColumn(name or "1", array, shape[0])]
    if len(shape) != 2:
        return []
    rows, width = shape
    # a sensor with 3 rows is refused: taken as it is, it would be three samples of many columns
    if rows == len(AXES) != width and names_sensor(name):
        cure = f"transpose it to n x 3, {array}={array}.T"
        raise RecordingError("array_transposed", f"the array {array} is 3 x n", cure)
    return [ArrayColumn(column, array, rows, k) for k, column in enumerate(_column_names(name, width))]


def _column_names(name: str, width: int) -> list[str]:
    """Return the names of the columns of an array: its name with the axis, or with a number from 1."""
    if name and width == len(AXES):
        return [f"{name}_{axis}" for axis in AXES]
    # limited: a header may claim millions of columns
    return [f"{name}.{k + 1}" if name else f"{k + 1}" for k in range(min(width, MOST_COLUMNS))]


def in_blocks(
    columns: Sequence[ArrayColumn], take: Callable[[ArrayColumn, int, int], Any]
) -> Iterator[Floats]:
    """Yield blocks from what returns the rows of a column from a start to an end."""
    for start in range(0, columns[0].length, ROWS):
        end = min(start + ROWS, columns[0].length)
        yield np.column_stack([np.asarray(take(column, start, end), dtype=np.float64) for column in columns])
