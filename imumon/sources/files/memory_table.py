"""Arrays in memory as a recording: those that a program passes to `imumon.analyse`.

Missing samples are NaN, masked values of NumPy, ``None`` and ``NA`` of pandas. An array of dates is a time, as in a
Parquet file. Everything else that is no number is refused: an array of objects may hold anything, and one of texts, of
complex numbers or of bools is no signal. Rows are converted block by block, so that nothing is copied as a whole.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

from imumon.model.samples import Floats
from imumon.sources.files.array_table import ArrayColumn, ArrayTable, Shape, in_blocks
from imumon.sources.files.base import ReadOptions, RecordingError
from imumon.sources.files.column_names import names_sensor, names_time

NAME = "the input"
"""What messages call the arrays."""

FORM = "arrays"
"""Their form as a source of rows, see `RowSource`."""

DATE_UNITS = ("s", "ms", "us", "ns")
"""Units of dates that a time may have; others become ns."""

Rows = Callable[[int, int], Any]
"""Returns the rows of an array from a start to an end, as an array of floats or of integers."""


class MemoryTable(ArrayTable):
    """Arrays of a program as blocks of samples.

    Parameters
    ----------
    arrays : (n,), (n, 1) or (n, 3) by name; anything that `numpy.asarray` accepts, or a column of a DataFrame.

    Raises
    ------
    RecordingError : they are no numbers, have different lengths or none at all, or have no inertial sensor.
    """

    def __init__(self, arrays: Mapping[str, Any], options: ReadOptions) -> None:
        shapes: dict[str, tuple[Shape, Sequence[str]]] = {}
        readers: dict[str, Rows] = {}
        for name, value in arrays.items():
            if (named := _reader(str(name), value)) is not None:
                column_name, shape, reader = named
                shapes[column_name], readers[column_name] = (shape, ()), reader
        if shapes and not any(max(shape, default=0) for shape, _ in shapes.values()):
            raise RecordingError("no_rows", f"{NAME} has no samples", "pass arrays with samples")

        def take(column: ArrayColumn, start: int, end: int) -> Any:
            rows = readers[column.array](start, end)
            return rows if column.key is None else rows[:, column.key]

        def read(columns: Sequence[ArrayColumn]) -> Iterator[Floats]:
            return in_blocks(columns, take)

        super().__init__(NAME, FORM, (shapes, read), options)

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{NAME} has no samples", "pass arrays with samples")


def _reader(name: str, value: Any) -> tuple[str, Shape, Rows] | None:
    """Return name, shape and reader of an array; None if it has no meaning and no numbers.

    Raises
    ------
    RecordingError : its name is that of a sensor or a time, and it has no numbers.
    """
    if _is_extension(value):
        if (dates := _dates(name, value)) is not None:
            return dates
        try:
            _of_extension(name, value, 0, 1)
        except RecordingError:
            if not names_sensor(name) and not names_time(name):
                return None
            raise
        return name, (len(value),), lambda start, end: _of_extension(name, value, start, end)
    array = _array(name, value)
    if array.dtype.kind in "Mm":
        return _dates(name, array)
    if array.dtype.kind not in "iuf":
        if not names_sensor(name) and not names_time(name):
            return None  # a column of labels, say
        raise _no_numbers(name, f"{array.dtype} is no number")
    if array.ndim == 2 and 1 in array.shape:
        array = array.reshape(-1)
    return name, array.shape, lambda start, end: _with_nan(array[start:end])


def float_array(name: str, value: Any) -> Floats:
    """Return an array as floats with NaN where samples are missing.

    Raises
    ------
    RecordingError : it holds no numbers.
    """
    if _is_extension(value):
        return _of_extension(name, value, 0, len(value))
    array = _array(name, value)
    if array.dtype.kind not in "iuf":
        raise _no_numbers(name, f"{array.dtype} is no number")
    return np.asarray(_with_nan(array), dtype=np.float64)


def _array(name: str, value: Any) -> Any:
    """Return an array of NumPy, masked or not; objects that are numbers or missing are numbers then."""
    try:
        array = np.asanyarray(value)
    except ValueError:
        return np.empty(0, object)  # rows of different lengths
    return _numbers_of_objects(array) if array.dtype.kind == "O" else array


def _with_nan(array: Any) -> Any:
    """Return an array with NaN in place of its masked values."""
    return np.ma.filled(array.astype(np.float64), np.nan) if isinstance(array, np.ma.MaskedArray) else array


def _is_extension(value: Any) -> bool:
    """Return whether this is a column of pandas whose values are no array of NumPy."""
    return hasattr(value, "iloc") and not isinstance(getattr(value, "dtype", None), np.dtype)


def _of_extension(name: str, value: Any, start: int, end: int) -> Floats:
    """Return some rows of such a column; NaN where it has NA."""
    try:
        return np.asarray(value.iloc[start:end].to_numpy(dtype=np.float64, na_value=np.nan))
    except (TypeError, ValueError):
        raise _no_numbers(name, f"{value.dtype} is no number") from None


def _dates(name: str, value: Any) -> tuple[str, Shape, Rows] | None:
    """Return dates or durations as a column of time with its unit; None if they are none."""
    is_duration = "timedelta" in str(value.dtype)
    if not (is_duration or "datetime" in str(value.dtype)):
        return None
    dates = np.asarray(
        value, dtype=None if isinstance(value, np.ndarray) else "m8[ns]" if is_duration else "M8[ns]"
    )
    unit = np.datetime_data(dates.dtype)[0]
    if unit not in DATE_UNITS:
        unit, dates = "ns", dates.astype(f"{dates.dtype.kind}8[ns]")
    named = name if names_time(name) else "time"

    def take(start: int, end: int) -> Floats:
        some = dates[start:end]
        return np.where(np.isnat(some), np.nan, some.astype(np.int64).astype(np.float64))

    return f"{named} [{unit}]", dates.shape, take


def _numbers_of_objects(array: Any) -> Any:
    """Return an array of objects as numbers if it holds nothing but numbers and missing values, else as it is."""
    values = array.reshape(-1).tolist()
    missing = [value is None or type(value).__name__ in ("NAType", "MaskedConstant") for value in values]
    numbers = [isinstance(value, Real) and not isinstance(value, bool) for value in values]
    if not all(map(max, missing, numbers)) or not any(missing):
        return array  # without a missing value, nothing but a mistake makes objects of numbers
    floats = [np.nan if gone else float(value) for value, gone in zip(values, missing, strict=True)]
    return np.array(floats).reshape(array.shape)


def _no_numbers(name: str, why: str) -> RecordingError:
    cure = "convert it to float64, such as array.astype(float); missing samples are NaN or None"
    return RecordingError("array_type", f"{name} holds no numbers: {why}", cure)
