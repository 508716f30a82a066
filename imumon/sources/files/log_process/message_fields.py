"""Message fields: ROS messages of one type as columns of numbers.

rosbags makes an object of each message. A column is the path of a number in it, such as ``angular_velocity.x`` or
``force[2]``. A time, which is seconds and nanoseconds, is one column of whole ns. What has no fixed place, such as an
element of a sequence, is no column.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import reduce
from operator import attrgetter, itemgetter
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Nodetype
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

from imumon.model.samples import Bools, Ints
from imumon.sources.files.columns import MOST_COLUMNS

Types: TypeAlias = Mapping[str, Any]
"""By name of a type: its constants, and its fields as pairs of name and description, as rosbags parses them."""

TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
"""Types of seconds and nanoseconds, which are one column."""

MOST_ELEMENTS = 64
"""Elements of an array that are columns."""


class UnsupportedType(Exception):
    """The type has too many fields."""


class MessageFields:
    """Columns of the messages of one type.

    Parameters
    ----------
    types : definitions of the type and of all types in it.
    name : of the type.
    cdr : the messages are in CDR, otherwise in the form of ROS 1.

    Attributes
    ----------
    names : of the columns.
    times : those of them that are times; ns, as integers.

    Raises
    ------
    Exception : of rosbags, and KeyError or `UnsupportedType`: the type cannot be read.
    """

    def __init__(self, types: Types, name: str, *, cdr: bool) -> None:
        self.times: set[str] = set()
        self._prefixes: list[tuple[str, str]] = []  # of the columns of each type in this one
        self._type, store = name, Typestore()
        store.register(_needed(types, name))
        store.get_msgdef(name)
        self._decode: Callable[[bytes, str], Any] = store.deserialize_cdr if cdr else store.deserialize_ros1
        self.names = list(itertools.islice(self._of_type(types, name, ""), MOST_COLUMNS))

    def _of_type(self, types: Types, type_name: str, prefix: str) -> Iterator[str]:
        """Yield the columns of a type in this one."""
        if len(self._prefixes) > MOST_COLUMNS:
            raise UnsupportedType(f"{self._type} is too large")
        self._prefixes.append((type_name, prefix))
        for part, description in types[type_name][1]:
            yield from self._described(types, description, f"{prefix}{part}")

    def _described(self, types: Types, description: Any, name: str) -> Iterator[str]:
        kind, detail = description
        if kind == Nodetype.NAME and detail in TIMES:
            self.times.add(name)
            yield name
        elif kind == Nodetype.NAME:
            yield from self._of_type(types, detail, f"{name}.")
        elif kind == Nodetype.BASE and detail[0] != "string":
            yield name
        elif kind == Nodetype.ARRAY and detail[1] <= MOST_ELEMENTS:
            for k in range(detail[1]):
                yield from self._described(types, detail[0], f"{name}[{k}]")

    def nested(self, wanted: str) -> list[str]:
        """Return the prefixes of the columns of another type in this one; the type itself has none."""
        return [prefix for name, prefix in self._prefixes if name == wanted]

    def read(
        self, messages: Sequence[bytes], names: Sequence[str]
    ) -> tuple[dict[str, npt.NDArray[Any]], Bools]:
        """Return the values of some columns in the valid messages, and which these are, (n,)."""
        getters = [_getter(name) for name in names]
        valid = np.zeros(len(messages), dtype=bool)
        rows = []
        for k, data in enumerate(messages):
            try:
                message = self._decode(data, self._type)
            except Exception:  # of a damaged message, rosbags raises any kind
                continue
            valid[k] = True
            rows.append([get(message) for get in getters])
        columns = zip(*rows, strict=True) if rows else [()] * len(names)
        return {
            name: _nanoseconds(values) if name in self.times else np.array(values, np.float64)
            for name, values in zip(names, columns, strict=True)
        }, valid


def _needed(types: Types, name: str) -> dict[str, Any]:
    """Return the definitions of a type and of all types in it; raise KeyError if one is missing."""
    needed: dict[str, Any] = {}
    waiting = [name]
    while waiting:
        if (type_name := waiting.pop()) in needed:
            continue
        needed[type_name] = types[type_name]
        for _, (kind, detail) in types[type_name][1]:
            while kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                kind, detail = detail[0]
            if kind == Nodetype.NAME:
                waiting.append(detail)
    return needed


def _getter(path: str) -> Callable[[Any], Any]:
    """Return the function that takes the value at a path from a message.

    >>> _getter("shape[1].real")(np.zeros((2, 3)))
    3
    """
    steps: list[Callable[[Any], Any]] = []
    for names, index in re.findall(r"([\w.]+)|\[(\d+)\]", path):
        # rosbags gives a field whose name is a word of Python another name
        attributes = ".".join(normalize_fieldname(name) for name in names.strip(".").split("."))
        steps.append(itemgetter(int(index)) if index else attrgetter(attributes))
    return (
        steps[0]
        if len(steps) == 1
        else lambda message: reduce(lambda value, step: step(value), steps, message)
    )


def _nanoseconds(times: Sequence[Any]) -> Ints:
    """Return times as ns."""
    return np.array([time.sec * 1_000_000_000 + time.nanosec for time in times], np.int64)
