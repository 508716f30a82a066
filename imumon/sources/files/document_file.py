"""Documents: named arrays in one object of JSON, in structs of MATLAB, and in text of Octave.

A program that has its arrays in memory writes them as a whole: ``{"gyro": [[...], ...], "fs": 100}``, the object of a
DataFrame, or ``save -text`` of Octave. Such a file is no lines of records. Its arrays go the way of those of
`array_file`; a list of names beside an array of as many columns, with units or without, names these. In a list of
objects, such as the signals of Simulink, the text by which they differ names each.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any

import numpy as np

from imumon.model.samples import Floats
from imumon.sources.files.array_table import float_array
from imumon.sources.files.base import LONGEST_LINE, RecordingError
from imumon.sources.files.column_names import names_sensor
from imumon.sources.files.sizes_at_rest import FEWEST

MOST_DOCUMENT = 1 << 25
"""Bytes of an object of JSON, of which all is in memory: 20 times as much at worst. A longer one is read as text."""

MOST_PARTS = 64
"""Objects of a list that are parts with a name each; more of them are samples."""

_WORD = re.compile("[A-Za-z]{3}")
"""Letters of a name, which a date does not have."""

OCTAVE = b"# Created by Octave"
"""First bytes of a text of Octave."""


def json_arrays(path: str) -> dict[str, Any]:
    """Return the arrays and numbers in a file that is one object of JSON; none: it is no such file."""
    if os.path.getsize(path) > MOST_DOCUMENT:
        return {}
    with open(path, "rb") as file:
        try:
            arrays = named_arrays(json.load(file))
        except (ValueError, RecursionError):  # behind the object of a record is another one
            return {}
    return arrays if any(len(array) > 1 for array in arrays.values()) else {}


def named_arrays(value: Any) -> dict[str, Any]:
    """Return the arrays and numbers in objects and lists, by their paths."""
    return dict(_arrays("", value, {}))


def _arrays(path: str, value: Any, beside: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the arrays and numbers in a value by their paths; `beside` has the values beside it."""
    value = _named_parts(value)
    if isinstance(value, dict) and not _is_indexed_column(value):
        for name, inner in value.items():
            yield from _arrays(f"{path}.{name}" if path else name, inner, value)
        return
    array = _numbers([*value.values()] if isinstance(value, dict) else value)
    if array is None:
        return
    names = next(filter(None, (_names(other, array.shape[-1:]) for other in beside.values())), ())
    if array.ndim == 2 and names and not names_sensor(path.rpartition(".")[2]):
        yield from zip(names, array.T, strict=True)
    elif array.ndim == 0 or len(array) >= FEWEST or array.ndim == 2:
        yield path, np.atleast_1d(array)


def _named_parts(value: Any) -> Any:
    """Return a short list of objects as an object, by the name that each has for itself."""
    if not isinstance(value, list) or len(value) > MOST_PARTS or not all(isinstance(v, dict) for v in value):
        return value
    for key in value[0] if value else ():
        texts = {
            text: part for part in value if isinstance(text := part.get(key), str) and _WORD.search(text)
        }
        if len(texts) == len(value):
            return texts
    return value


def _is_indexed_column(value: Mapping[str, Any]) -> bool:
    """Return whether an object is a column of a DataFrame, with its values by their index."""
    return len(value) >= FEWEST and all(key.isdigit() for key in value)


def _numbers(value: Any) -> Floats | None:
    """Return the number or the array of numbers that a value is; None: it is none."""
    try:
        return float_array("", value)
    except RecordingError:  # of texts, objects, or rows of different lengths
        return None


def _names(value: Any, shape: tuple[int, ...]) -> list[str]:
    """Return the names of columns in a list of texts, or of objects with a name and a unit; empty: it is none."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "OU":  # a cell array, or texts
        value = value.tolist()
    if not isinstance(value, list) or (len(value),) != shape:
        return []
    if all(isinstance(each, str) for each in value):
        return value
    if not all(isinstance(each, dict) and isinstance(each.get("name"), str) for each in value):
        return []
    units = [each.get("units", each.get("unit", "")) for each in value]
    return [
        f"{each['name']} [{unit}]" if unit else each["name"] for each, unit in zip(value, units, strict=True)
    ]


def octave_arrays(path: str) -> dict[str, Any]:
    """Return the matrices and scalars in a text of Octave."""
    arrays: dict[str, Any] = {}
    fields: dict[str, str] = {}
    with open(path, encoding="utf-8", errors="replace") as file:
        while line := file.readline(LONGEST_LINE):
            key, colon, text = line.lstrip("# ").partition(":")
            if line.startswith("#") and colon:
                fields[key] = text.strip()
            kind, name = fields.get("type", ""), fields.get("name", "")
            if kind == "scalar" and not line.startswith("#") and line.strip():
                arrays[name] = np.array([float(line)])
            elif kind == "matrix" and key == "columns":
                arrays[name] = np.loadtxt(islice(file, int(fields["rows"])), ndmin=2)
                if len(arrays[name]) != int(fields["rows"]):
                    raise ValueError("rows are missing")
            else:
                continue
            fields = {}
    return arrays
