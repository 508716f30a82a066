"""Table of arrays: named arrays of a file or of a program as blocks of samples.

An array of one column, (n,), (n, 1) or (1, n), is a column of the table; that of a sensor alone, such as ``gyro``, is
its axis x. One of three columns has an axis each. Other columns have the name of the array and a number from 1; only
``--map`` uses them. Blocks of rows are taken as they are needed: memory does not grow with the arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from imumon.model.cures import example_text, option_text
from imumon.model.report_json import plain
from imumon.model.samples import AXES, INERTIAL, Floats, SampleBlock
from imumon.sources.column_names import SENSOR_WORDS, parse_name, words_of
from imumon.sources.files.base import ROWS, ReadOptions, RecordingError, RowSource
from imumon.sources.files.columns import LISTED, SENSORS, layout
from imumon.sources.files.table import Table

ARRAY_UNITS = {"gauss", "C", "kPa", "dps", "g", "mg", "rads", "uT", "nT", "ns", "us", "ms", "s"}
"""Units that the name of an array may end with."""


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
        names = [column.name for column in columns]
        try:
            table_layout = layout(names, options.kind, options.columns, options.sensor)
        except RecordingError as error:
            if error.code != "no_sensor":
                raise error.of(path) from None
            text = (
                f"{path}: no array has the name of a gyroscope or accelerometer; there are {listed or 'none'}"
            )
            raise RecordingError("no_sensor", text, f"name the columns, {_example_map(columns)}") from None
        self._columns = [columns[k] for k in self._begin(RowSource(path, form, names), table_layout, options)]
        lengths = {column.length: column.array for column in self._columns}
        if len(lengths) != 1:
            listed = ", ".join(f"{array} {length:,}" for length, array in sorted(lengths.items()))
            text = f"{path}: its arrays have different lengths: {listed}"
            raise RecordingError("array_lengths", text, _cure_of_lengths(columns, options))

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


def _cure_of_lengths(columns: Sequence[ArrayColumn], options: ReadOptions) -> str:
    """Return what to do with arrays of different lengths: a sensor that has one length can be read alone."""
    readable = [option_text(sensor=s) for s in INERTIAL if _is_readable(columns, options, s)]
    alone = f", or read a sensor alone, {' or '.join(readable)}" if readable else ""
    return f"save arrays of one length{alone}"


def _is_readable(columns: Sequence[ArrayColumn], options: ReadOptions, sensor: str) -> bool:
    """Return whether a sensor and its time have one length, so that it can be read alone."""
    try:
        alone = layout([column.name for column in columns], options.kind, options.columns, sensor)
    except RecordingError:
        return False
    used = [*alone.columns, *alone.times[:1], *([alone.interval] if alone.interval else [])]
    return len({columns[column.index].length for column in used}) == 1


def _example_map(columns: Sequence[ArrayColumn]) -> str:
    """Return an option that names the axes of a gyroscope, as an example: those of the first array that has three."""
    arrays = ([column.name for column in group] for _, group in groupby(columns, lambda column: column.array))
    axes = next((names for names in arrays if len(names) == len(AXES)), None)
    if axes is not None:
        named = {f"gyro/{axis}": f"{name}:rad/s" for axis, name in zip(AXES, axes, strict=True)}
        return option_text(columns=named)
    first = next((column.name for column in columns if column.key is not None or not column.array), "NAME")
    return example_text(f"{first}:rad/s")


def columns_of(array: str, shape: Shape, fields: Sequence[str]) -> list[ArrayColumn]:
    """Return the columns of an array; raise `RecordingError` if it is that of a sensor, but transposed."""
    if not shape:  # a single number, such as a rate, or a single structure
        return []
    bare, unit = _name_and_unit(plain(array))
    shape = (max(shape),) if len(shape) == 2 and 1 in shape else shape
    if fields:
        return [ArrayColumn(plain(name), array, shape[0], name) for name in fields]
    if len(shape) == 1:
        # a gyroscope of one axis has no letter of its own: its array is that of x
        alone = f"{bare}_{AXES[0]}" if _is_sensor(bare) else bare
        return [ArrayColumn(f"{alone}{unit}" or "1", array, shape[0])]
    return _columns_of_matrix(array, shape[0], shape[1]) if len(shape) == 2 else []


def _columns_of_matrix(array: str, rows: int, width: int) -> list[ArrayColumn]:
    """Return the columns of an array of two dimensions, neither of them 1; raise `RecordingError` as `columns_of`."""
    bare, unit = _name_and_unit(plain(array))
    # a sensor with 3 rows is refused: taken as it is, it would be three samples of many columns
    if rows == len(AXES) != width and parse_name(0, f"{bare}_x").quantity in SENSORS:
        cure = f"transpose it to n x 3, {array}={array}.T"
        raise RecordingError("array_transposed", f"the array {array} is 3 x n", cure)
    # limited: a header may claim millions of columns
    names = [f"{bare}.{k + 1}" if bare else f"{k + 1}" for k in range(min(width, ROWS))]
    if bare and width == len(AXES):
        names = [f"{bare}_{axis}{unit}" for axis in AXES]
    return [ArrayColumn(name, array, rows, k) for k, name in enumerate(names)]


def _is_sensor(name: str) -> bool:
    """Return whether a name is that of an inertial sensor and nothing else, such as ``gyro``."""
    words = set(words_of(name))
    return bool(words) and any(words <= names for names in SENSOR_WORDS.values())


def _name_and_unit(array: str) -> tuple[str, str]:
    """Return the name of an array without a unit at its end, and that unit in brackets."""
    stem, _, suffix = array.rpartition("_")
    return (stem, f" [{suffix}]") if stem and suffix in ARRAY_UNITS else (array, "")


def in_blocks(
    columns: Sequence[ArrayColumn], take: Callable[[ArrayColumn, int, int], Any]
) -> Iterator[Floats]:
    """Yield blocks from what returns the rows of a column from a start to an end."""
    for start in range(0, columns[0].length, ROWS):
        end = min(start + ROWS, columns[0].length)
        yield np.column_stack([np.asarray(take(column, start, end), dtype=np.float64) for column in columns])
