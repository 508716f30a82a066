"""Table of arrays: named arrays of a file or of a program as blocks of samples.

An array of one column, (n,), (n, 1) or (1, n), is a column of the table. One of three columns has an axis each. Other
columns have the name of the array and a number from 1.

Missing samples are NaN, masked values of NumPy, ``None`` and ``NA`` of pandas. An array of dates is a time. Everything
else that is no number is refused if its name is that of a sensor or a time: an array of objects may hold anything, and
one of texts, of complex numbers or of bools is no signal. Rows are taken block by block: an array may be in a file.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

import numpy as np

from imumon.model.report_json import plain
from imumon.model.samples import AXES, Floats, SampleBlock
from imumon.sources.files.base import ROWS, ReadOptions, RecordingError, RowSource
from imumon.sources.files.column_names import names_sensor, names_time, split_unit, words_of
from imumon.sources.files.column_reader import read_columns
from imumon.sources.files.columns import LISTED, MOST_COLUMNS, Reading
from imumon.sources.files.table import Table
from imumon.sources.files.unit_grammar import StatedRate, stated_rate

HEAD_ROWS = 4096
"""First rows that show what the columns are."""

MOST_TRANSPOSED = 1 << 24
"""Samples of an array 3 x n, which is read as a whole; a longer one has to be saved as n x 3."""

INPUT = "the input"
"""What messages call the arrays of a program."""

IN_MEMORY = "arrays"
"""Their form as a source of rows, see `RowSource`."""

DATE_UNITS = ("s", "ms", "us", "ns")
"""Units of dates that a time may have; others become ns."""


class StoredArray:
    """Array (n,) or (n, k) in a file, whose rows are read by a slice: the first ones, or those behind the last.

    Attributes
    ----------
    shape : of the array.
    """

    shape: tuple[int, ...]

    def __getitem__(self, rows: slice) -> Any:
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class ArrayColumn:
    """Column of an array.

    Attributes
    ----------
    name : as of a column of a table.
    array : (n,) or (n, k) numbers, in memory or a `StoredArray`.
    place : of the column in it.
    """

    name: str
    array: Any
    place: int = 0

    @property
    def length(self) -> int:
        """Rows."""
        return int(self.array.shape[0])

    def rows(self, start: int, end: int) -> Any:
        """Return the numbers from a row to another one."""
        return self.array[start:end].reshape(end - start, -1)[:, self.place]


class ArrayTable(Table):
    """Arrays of one length as blocks of samples.

    Parameters
    ----------
    arrays : (n,), (n, 1) or (n, k) by name; anything that `numpy.asarray` accepts, or a column of a DataFrame.
    path : for messages.
    form : of `RowSource`.

    Raises
    ------
    RecordingError : they are no numbers, have different lengths or none at all, or have no inertial sensor.
    """

    def __init__(
        self, arrays: Mapping[str, Any], options: ReadOptions, path: str = INPUT, form: str = IN_MEMORY
    ) -> None:
        self.path = path
        try:
            columns = [column for name, value in arrays.items() for column in columns_of(str(name), value)]
            columns, reading = _columns_of_one_length(columns, options)
        except RecordingError as error:
            raise error if path == INPUT else error.of(path) from None
        layout = reading.checked(path, accept=options.accept).layout(options.kind)
        names = [column.name for column in columns]
        self._columns = [columns[k] for k in self._begin(RowSource(path, form, names), layout, options)]

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        count = self._columns[0].length
        for start in range(0, count, ROWS):
            rows = _rows(self._columns, start, min(start + ROWS, count))
            done = start + len(rows)
            self.fed += rows.nbytes
            self.progress = done / count
            yield self._blocks(rows, np.arange(start + 1, done + 1))
        yield self._finish()

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{self.path} has no samples", "give arrays with samples")


def _rows(columns: Sequence[ArrayColumn], start: int, end: int) -> Floats:
    """Return some rows of some columns, (n, k), column by column in memory."""
    return np.stack([np.asarray(column.rows(start, end), dtype=np.float64) for column in columns]).T


def _columns_of_one_length(
    columns: Sequence[ArrayColumn], options: ReadOptions
) -> tuple[list[ArrayColumn], Reading]:
    """Return the columns that have a sensor and one length, and what they are."""
    lengths = Counter(column.length for column in columns if column.length > 1)
    if not lengths:
        raise RecordingError("no_rows", "it has no samples", "give arrays with samples")
    faults: list[RecordingError] = []
    for length, _ in lengths.most_common():
        some = [column for column in columns if column.length == length]
        rows = _rows(some[:MOST_COLUMNS], 0, min(length, HEAD_ROWS))
        names = [column.name for column in some]
        try:
            reading = read_columns(names, (), rows, options, rate=_stated_rate(columns))
        except RecordingError as fault:
            faults.append(fault)
            continue
        others = [column.name for column in columns if column.length not in (length, 1)]
        remark = f"{', '.join(others[:LISTED])} not used: of another length"
        return some, replace(reading, remarks=(*reading.remarks, remark)) if others else reading
    if len(lengths) > 1 and any(fault.code == "unknown_column" for fault in faults):
        listed = ", ".join(f"{column.name} {column.length:,}" for column in columns[:LISTED])
        text = f"its arrays have different lengths: {listed}"
        raise RecordingError("array_lengths", text, "save arrays of one length")
    # that which says most of why no length has a sensor
    raise max(faults, key=lambda fault: fault.code != "no_sensor")


def _stated_rate(columns: Sequence[ArrayColumn]) -> StatedRate | None:
    """Return the rate that arrays of one number have by their names; None: there is none."""
    single = [column for column in columns if column.length == 1]
    texts = []
    for column in single:
        number = _rows([column], 0, 1)[0, 0]
        for word in column.name.split("."):
            name, unit = split_unit(word)
            is_interval = re.fullmatch(r"(?:sampl\w+ )?(?:interval|period)|dt", words_of(name)) is not None
            texts.append(f"dt: {number} {unit}" if is_interval else f"{words_of(word)}: {number}")
    return stated_rate("\n".join(texts))


def columns_of(name: str, value: Any) -> list[ArrayColumn]:
    """Return the columns of an array; none if it has no meaning and no numbers.

    Raises
    ------
    RecordingError : its name is that of a sensor or a time, and it has no numbers.
    """
    if (dates := _dates(name, value)) is not None:
        return [dates]
    name = plain(name)
    try:
        array = _numbers(name, value)
    except RecordingError:
        if names_sensor(name) or names_time(name):
            raise
        return []  # a column of labels, say
    if len(array.shape) not in (1, 2):
        return []
    if len(array.shape) == 1:
        return [ArrayColumn(name or "1", array)]
    length, width = array.shape
    # the longer side of an array is its time
    if length == 1 or length == len(AXES) < width <= MOST_TRANSPOSED:
        array = array[:].T
        length, width = array.shape
    if length == len(AXES) < width and names_sensor(name):
        cure = f"transpose it to n x 3, {name}={name}.T"
        raise RecordingError("array_transposed", f"the array {name} is 3 x n", cure)
    names = [name or "1"] if width == 1 else _column_names(name, width)
    return [ArrayColumn(column, array, k) for k, column in enumerate(names)]


def _column_names(name: str, width: int) -> list[str]:
    """Return the names of the columns of an array: its name with the axis, or with a number from 1."""
    if name and width == len(AXES):
        return [f"{name}_{axis}" for axis in AXES]
    # limited: an array may have millions of columns
    return [f"{name}.{k + 1}" if name else f"{k + 1}" for k in range(min(width, MOST_COLUMNS))]


def float_array(name: str, value: Any) -> Floats:
    """Return an array as floats with NaN where samples are missing.

    Raises
    ------
    RecordingError : it holds no numbers.
    """
    return np.asarray(_numbers(name, value), dtype=np.float64)


def _numbers(name: str, value: Any) -> Any:
    """Return an array of numbers, of which missing ones are NaN; raise `RecordingError` if it is none.

    An array of objects that are numbers or missing has numbers then. Without a missing value, nothing but a mistake
    makes objects of numbers.
    """
    if isinstance(value, StoredArray):
        return value
    if hasattr(value, "iloc") and not isinstance(getattr(value, "dtype", None), np.dtype):
        try:  # a column of pandas whose values are no array of NumPy
            return np.asarray(value.to_numpy(dtype=np.float64, na_value=np.nan))
        except (TypeError, ValueError):
            raise _no_numbers(name, value) from None
    array = _array(value)
    if array.dtype.kind not in "iuf":
        raise _no_numbers(name, array)
    is_masked = isinstance(array, np.ma.MaskedArray)
    return np.ma.filled(array.astype(np.float64), np.nan) if is_masked else array


def _array(value: Any) -> Any:
    """Return an array; one of objects that are numbers, of which some are missing, has numbers."""
    try:
        array = np.asanyarray(value)
    except ValueError:  # rows of different lengths
        return np.empty(0, object)
    if array.dtype.kind == "O":
        values = array.reshape(-1).tolist()
        missing = [v is None or type(v).__name__ in ("NAType", "MaskedConstant") for v in values]
        numbers = [isinstance(v, Real) and not isinstance(v, bool) for v in values]
        if any(missing) and all(map(max, missing, numbers)):
            floats = [np.nan if gone else float(v) for v, gone in zip(values, missing, strict=True)]
            return np.array(floats).reshape(array.shape)
    return array


def _dates(name: str, value: Any) -> ArrayColumn | None:
    """Return dates or durations as a column of time with its unit; None if they are none."""
    kind = str(getattr(value, "dtype", ""))
    if "datetime" not in kind and "timedelta" not in kind:
        return None
    nanoseconds = "m8[ns]" if "timedelta" in kind else "M8[ns]"
    dates = np.asarray(value, dtype=None if isinstance(value, np.ndarray) else nanoseconds)
    if np.datetime_data(dates.dtype)[0] not in DATE_UNITS:
        dates = dates.astype(nanoseconds)
    # a type of time has its unit, which a name need not have
    named = plain(name) if names_time(name) else "time"
    numbers = np.where(np.isnat(dates), np.nan, dates.astype(np.int64).astype(np.float64))
    return ArrayColumn(f"{named} [{np.datetime_data(dates.dtype)[0]}]", numbers)


def _no_numbers(name: str, array: Any) -> RecordingError:
    cure = "convert it to float64, such as array.astype(float); missing samples are NaN or None"
    return RecordingError("array_type", f"{name} holds no numbers: {array.dtype} is no number", cure)
