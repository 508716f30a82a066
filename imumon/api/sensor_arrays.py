"""Arguments of a call as a file or as named arrays, which go the way of a recording.

An array of a sensor is (n, 3), with an axis in each column, or (n,) for a single axis, which is called x. What has
another shape is refused: a transposed array would be three samples of many axes. A DataFrame is its columns, by their
names; an index of times is one of them. A mapping is the arrays of an ``.npz`` file.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np

from imumon.model.samples import AXES, FASTEST_HZ, SLOWEST_HZ
from imumon.sources.files.base import OptionError, RecordingError
from imumon.sources.files.column_names import names_time

TIME_ROWS = 1 << 16
"""Times that are compared at once."""

SLOWEST_ALONE_HZ = 0.5
"""Hz, least rate that counts without a time: below it, a rate is almost always the interval of a faster sensor."""

EXAMPLE = "such as imumon.analyse(gyro=array, rate_hz=200)"


def named_source(source: Any, sensors: Mapping[str, Any], time_s: Any) -> tuple[str, dict[str, Any] | None]:
    """Return the path of a file, or an empty one and arrays by name.

    Parameters
    ----------
    source : path, array of a gyroscope, DataFrame or mapping; None: there are `sensors`.
    sensors : (n, 3) or (n,) by sensor, None where there is none.
    time_s : (n,) s, or dates; None: there is no time.

    Raises
    ------
    RecordingError : an array has a shape that no sensor has, or a time that goes back.
    OptionError : there is no source, or there are two.
    """
    given = {name: value for name, value in sensors.items() if value is not None}
    if isinstance(source, str | os.PathLike):
        if given or time_s is not None:
            text = f"a file and the argument {[*given, 'time_s'][0]} are both given"
            raise OptionError("two_sources", text, "give one of them: a file has all its columns")
        return os.fspath(source), None
    if source is not None and not _is_table(source):
        if "gyro" in given:
            raise OptionError(
                "two_sources", "source and gyro are both arrays of a gyroscope", "give only one"
            )
        given, source = {"gyro": source, **given}, None
    if source is None and not {"gyro", "accel", "mag"} & given.keys():
        raise OptionError(
            "no_source", "there is neither a file nor an array of a sensor", f"give one, {EXAMPLE}"
        )
    arrays = {} if source is None else _columns(source)
    for name, value in given.items():
        arrays |= _sensor(name, value)
    if time_s is not None:
        arrays["time_s"] = _times(time_s)
    return "", arrays


SI = {"gyro": "rad/s", "accel": "m/s^2", "mag": "gauss", "temperature": "degC", "time": "s"}
"""Units of arrays that are given by sensor, unless the caller states others."""


def units_of_arrays(source: Any, kind: str | None) -> dict[str, str]:
    """Return the units of arrays by sensor, which are a part of the contract; those of a table stand in it."""
    if isinstance(source, str | os.PathLike) or (source is not None and _is_table(source)):
        return {}
    return SI | ({"gyro": "rad", "accel": "m/s"} if kind == "increment" else {})


def columns_of_arrays(arrays: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, str]:
    """Return what the columns of arrays by sensor are, as a map gives it."""
    columns: dict[str, str] = {}
    for name, array in arrays.items():
        if name == "time_s":
            columns |= {} if "datetime" in _dtype(array) else {"t": f"{name}:{units['time']}"}
            continue
        sensor, _, axis = name.partition("_")
        if sensor == "temperature":
            columns[sensor] = f"{name}:{units[sensor]}"
        elif axis or np.ndim(array) == 1 or 1 in np.shape(array):
            columns[f"{sensor}/{axis or AXES[0]}"] = f"{name}:{units[sensor]}"
        else:
            columns |= {f"{sensor}/{a}": f"{name}_{a}:{units[sensor]}" for a in AXES}
    return columns


def checked_rate(rate_hz: Any, *, alone: bool) -> float | None:
    """Return a sample rate, Hz; None: there is none.

    Parameters
    ----------
    alone : no time can contradict it.

    Raises
    ------
    OptionError : it is no rate of a sensor.
    """
    if rate_hz is None:
        return None
    is_number = isinstance(rate_hz, Real | np.number) and not isinstance(rate_hz, bool | np.bool_)
    rate = float(rate_hz) if is_number else math.nan
    if not SLOWEST_HZ <= rate <= FASTEST_HZ:
        cure = f"give one from {SLOWEST_HZ:g} to {FASTEST_HZ:g}, in samples per second"
        raise OptionError("rate_invalid", f"rate_hz={rate_hz!r} is not a sample rate", cure)
    if alone and rate < SLOWEST_ALONE_HZ:
        text = f"rate_hz={rate:g} is slower than an inertial sensor, and looks like its interval"
        cure = (
            f"if that is the interval in s, rate_hz={1.0 / rate:g}; if the samples are that slow, give time_s"
        )
        raise OptionError("rate_is_interval", text, cure)
    return rate


def has_time(arrays: Mapping[str, Any]) -> bool:
    """Return whether one of some named arrays is a time."""
    return any(names_time(name) or "datetime" in _dtype(array) for name, array in arrays.items())


def _dtype(array: Any) -> str:
    return str(getattr(array, "dtype", ""))


def _is_table(source: Any) -> bool:
    return isinstance(source, Mapping) or hasattr(source, "columns")


def _columns(table: Any) -> dict[str, Any]:
    """Return the columns of a DataFrame, or the arrays of a mapping, by name."""
    if not hasattr(table, "columns"):
        return {_name(key): value for key, value in table.items()}
    positions = getattr(table, "iloc", None)
    arrays = {
        _name(name): table[name] if positions is None else positions[:, k]
        for k, name in enumerate(table.columns)
    }
    index: Any = getattr(table, "index", None)
    name = getattr(index, "name", None)
    is_time = "datetime" in _dtype(index) or "timedelta" in _dtype(index)
    if is_time or (isinstance(name, str) and names_time(name)):
        arrays[str(name or "time")] = index.to_series() if hasattr(index, "to_series") else index
    return arrays


def _name(key: Any) -> str:
    """Return the name of a column; of several levels, joined."""
    return "_".join(map(str, key)) if isinstance(key, tuple) else str(key)


def _sensor(name: str, value: Any) -> dict[str, Any]:
    """Return the array, or the columns of the DataFrame, of one sensor by name.

    Raises
    ------
    RecordingError : its shape is that of no sensor.
    """
    if isinstance(value, str | bytes | os.PathLike):
        raise OptionError("array_type", f"{name} is a text, and no array", f"give an array, {EXAMPLE}")
    if hasattr(value, "columns") and hasattr(value, "iloc"):
        return _axes_of_frame(name, value)
    if hasattr(value, "iloc"):
        return {name: value}
    try:
        array = value if isinstance(value, np.ndarray) else np.asanyarray(value)
    except ValueError:
        return {name: value}  # rows of different lengths: refused with their name
    if name == "temperature":
        return {name: _flat_temperature(array)}
    _check_shape(name, array)
    return {name: array}


def _axes_of_frame(name: str, frame: Any) -> dict[str, Any]:
    """Return the columns of the DataFrame of one sensor, in the order of the axes; a single one has its name."""
    if len(frame.columns) not in (1, len(AXES)):
        raise _wrong_shape(name, (len(frame), len(frame.columns)))
    axes = AXES if len(frame.columns) == len(AXES) else ("",)
    return {f"{name}_{a}" if a else name: frame.iloc[:, k] for k, a in enumerate(axes)}


def _flat_temperature(array: Any) -> Any:
    """Return a temperature as (n,), also one that is a row or a column; raise `RecordingError` if it is neither."""
    if array.ndim != 1 and array.size != max(array.shape, default=0):
        text = f"temperature has the shape {array.shape}"
        raise RecordingError("array_shape", text, "give an array (n,), one number for each sample")
    return array.reshape(-1)


def _check_shape(name: str, array: Any) -> None:
    """Raise `RecordingError` unless an array is (n, 3), (n, 1) or (n,), and has a sample."""
    if array.ndim == 2 and array.shape[0] == len(AXES) and array.shape[1] > len(AXES):
        cure = f"transpose it to n x 3, {name}=array.T"
        raise RecordingError("array_transposed", f"the array {name} is 3 x n", cure)
    if array.ndim not in (1, 2) or (array.ndim == 2 and array.shape[1] not in (1, len(AXES))):
        raise _wrong_shape(name, array.shape)
    if not len(array):
        raise RecordingError("no_rows", f"the array {name} has no samples", "pass arrays with samples")


def _wrong_shape(name: str, shape: tuple[int, ...]) -> RecordingError:
    text = f"the array {name} has the shape {shape}, and a sensor has (n, 3) or (n,)"
    cure = (
        "give each sensor alone, such as imumon.analyse(gyro=array[:, :3], accel=array[:, 3:6], rate_hz=200)"
    )
    return RecordingError("array_shape", text, cure)


def _times(time_s: Any) -> Any:
    """Return the times; raise `RecordingError` if they are not one number each, or go back."""
    times = time_s if hasattr(time_s, "dtype") else np.asanyarray(time_s)
    if len(getattr(times, "shape", ())) != 1:
        text = f"time_s has the shape {getattr(times, 'shape', ())}"
        raise RecordingError("array_shape", text, "give an array (n,), one time for each sample")
    if getattr(times.dtype, "kind", "O") in "iufM" and isinstance(times.dtype, np.dtype):
        _check_rising(times)
    return times


def _check_rising(times: Any) -> None:
    """Raise `RecordingError` if a clock steps back: two times behind are below two before; a single one may be late."""
    for begin in range(0, max(len(times) - 1, 1), TIME_ROWS):
        some = np.asarray(times[max(begin - 2, 0) : begin + TIME_ROWS + 1])
        some = some.astype(np.float64) if some.dtype.kind != "f" else some
        before, after = np.minimum(some[:-3], some[1:-2]), np.maximum(some[2:-1], some[3:])
        if len(some) >= 4 and bool((after < before).any()):
            row = begin + int(np.argmax(after < before))
            text = f"time_s goes back near sample {row + 1:,}"
            cure = "analyse the parts before and behind it as two records, and combine them"
            raise RecordingError("time_goes_back", text, cure)
