"""Message fields: serialised ROS messages as columns of numbers, many messages at once.

The place of a field depends on the lengths of the strings and sequences before it, and on nothing else. The first
message shows the places and those lengths; they apply to every message of the same size that has the same
lengths, so their fields are columns of an array of bytes. Serialisation: ROS 1 packs the values; ROS 2 is CDR (OMG
DDSI-RTPS 2.2, section 10: 4 bytes of header, each value aligned to its size from there).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Nodetype

from imumon.samples import Bools

Types: TypeAlias = Mapping[str, Any]
"""By name of a type: its constants, and its fields as pairs of name and description, as rosbags parses them."""

NUMBERS = {
    "bool": "u1", "byte": "u1", "octet": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2",
    "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8", "float32": "f4", "float64": "f8",
}  # fmt: skip
"""Type of numpy of each type of numbers."""

TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
"""Types of seconds and nanoseconds, which are one column."""

MOST_ELEMENTS = 64
"""Elements of an array that are columns."""

MOST_NAMES = 5000
"""Columns of a type; the rest is not listed."""


class UnsupportedType(Exception):
    """The type has a field that cannot be read, or refers to an unknown type."""


@dataclass
class _Layout:
    """Places in a message.

    Attributes
    ----------
    places : name to offset and type of numpy; of a time, the offset of its seconds.
    lengths : offset, size and bytes of everything that the places depend on.
    """

    places: dict[str, tuple[int, str]] = field(default_factory=dict)
    lengths: list[tuple[int, bytes]] = field(default_factory=list)


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
    UnsupportedType : it has fields that cannot be read.
    """

    def __init__(self, types: Types, name: str, *, cdr: bool) -> None:
        self._types, self._name, self._cdr = types, name, cdr
        self.names: list[str] = []
        self.times: set[str] = set()
        self._list(name, "")

    def _list(self, name: str, prefix: str) -> None:
        """Add the columns of a type."""
        for part, description in self._fields(name):
            self._list_field(description, f"{prefix}{part}")

    def _fields(self, name: str) -> Any:
        if name not in self._types:
            raise UnsupportedType(f"the type {name} has no definition")
        return self._types[name][1]

    def _list_field(self, description: Any, name: str) -> None:
        kind, detail = description
        if len(self.names) >= MOST_NAMES or kind == Nodetype.SEQUENCE:
            return
        if kind == Nodetype.BASE and detail[0] in NUMBERS:
            self.names.append(name)
        elif kind == Nodetype.NAME and detail in TIMES:
            self.names.append(name)
            self.times.add(name)
        elif kind == Nodetype.NAME:
            self._list(detail, f"{name}.")
        elif kind == Nodetype.ARRAY and detail[1] <= MOST_ELEMENTS:
            for k in range(detail[1]):
                self._list_field(detail[0], f"{name}[{k}]")

    def nested(self, wanted: str) -> list[str]:
        """Return the prefixes of the columns of another type in this one; the type itself has none."""
        found: list[str] = []

        def search(name: str, prefix: str) -> None:
            if name == wanted:
                found.append(prefix)
                return
            for part, (kind, detail) in self._fields(name):
                if kind == Nodetype.NAME and detail not in TIMES:
                    search(detail, f"{prefix}{part}.")

        search(self._name, "")
        return found

    def read(
        self, messages: Sequence[bytes], names: Sequence[str]
    ) -> tuple[dict[str, npt.NDArray[Any]], Bools]:
        """Return (n,) values of some columns, and which of the messages are valid."""
        count = len(messages)
        out: dict[str, npt.NDArray[Any]] = {
            name: np.zeros(count, np.int64 if name in self.times else np.float64) for name in names
        }
        valid = np.zeros(count, dtype=bool)
        sizes = np.fromiter(map(len, messages), np.int64, count)
        for size in np.unique(sizes).tolist():
            which = np.flatnonzero(sizes == size)
            chosen = messages if len(which) == count else [messages[k] for k in which.tolist()]
            data = np.frombuffer(b"".join(chosen), np.uint8).reshape(len(which), size)
            while len(which):
                layout = self._layout(data[0].tobytes())
                if layout is None:
                    which, data = which[1:], data[1:]
                    continue
                same = np.ones(len(which), dtype=bool)
                for offset, content in layout.lengths:
                    same &= (data[:, offset : offset + len(content)] == np.frombuffer(content, np.uint8)).all(
                        axis=1
                    )
                chosen_data, rows = (data, which) if same.all() else (data[same], which[same])
                for name in names:
                    out[name][rows] = self._column(chosen_data, layout, name)
                valid[rows] = True
                which, data = which[~same], data[~same]
        return out, valid

    def _column(self, data: npt.NDArray[np.uint8], layout: _Layout, name: str) -> npt.NDArray[Any]:
        """Return the values of a column of messages of one layout."""

        def number(offset: int, dtype: str) -> npt.NDArray[Any]:
            end = offset + np.dtype(dtype).itemsize
            values: npt.NDArray[Any] = np.ascontiguousarray(data[:, offset:end]).view(dtype)[:, 0]
            return values

        offset, dtype = layout.places[name]
        if name not in self.times:
            return number(offset, dtype)
        order = dtype[0]
        seconds, rest = number(offset, dtype), number(offset + 4, f"{order}u4")
        stamps: npt.NDArray[Any] = seconds.astype(np.int64) * 1_000_000_000 + rest
        return stamps

    def _layout(self, message: bytes) -> _Layout | None:
        """Return the places in a message; None if it is shorter than its type."""
        walk = _Walk(self, message)
        try:
            walk.type(self._name, "")
        except struct.error:
            return None
        return walk.layout if walk.at <= len(message) else None

    @property
    def fields(self) -> tuple[Types, bool]:
        """Definitions of the types, and whether messages are in CDR."""
        return self._types, self._cdr


class _Walk:
    """One pass over a message, which notes the places."""

    def __init__(self, fields: MessageFields, message: bytes) -> None:
        self._types, self._cdr = fields.fields
        self._wanted = set(fields.names)
        self._message = message
        self.layout = _Layout()
        self.at = self._origin = 4 if self._cdr else 0
        self._order = "<"
        if self._cdr:
            (_, flags) = struct.unpack_from("BB", message)
            self._order = "<" if flags & 1 else ">"
            self.layout.lengths.append((0, message[:4]))

    def type(self, name: str, prefix: str) -> None:
        for part, description in self._types[name][1]:
            self._field(description, f"{prefix}{part}")

    def _align(self, size: int) -> None:
        if self._cdr:
            self.at += -(self.at - self._origin) % size

    def _length(self) -> int:
        """Read a length and note that all places behind it depend on it."""
        self._align(4)
        (length,) = struct.unpack_from(f"{self._order}I", self._message, self.at)
        self.layout.lengths.append((self.at, self._message[self.at : self.at + 4]))
        self.at += 4
        if length > len(self._message):
            raise struct.error("longer than the message")
        return int(length)

    def _field(self, description: Any, name: str) -> None:
        kind, detail = description
        if kind == Nodetype.BASE:
            self._base(detail[0], name)
        elif kind == Nodetype.NAME and detail in TIMES:
            self._align(4)
            self.layout.places[name] = (self.at, f"{self._order}i4")
            self.at += 8
        elif kind == Nodetype.NAME:
            self.type(detail, f"{name}.")
        else:
            element, count = detail[0], detail[1] if kind == Nodetype.ARRAY else self._length()
            self._elements(element, count, name)

    def _base(self, kind: str, name: str) -> None:
        if kind == "string":
            length = self._length()  # which moves on
            self.at += length
            return
        if kind not in NUMBERS:
            raise struct.error(f"{kind} is not supported")
        dtype = f"{self._order}{NUMBERS[kind]}"
        size = int(dtype[-1])
        self._align(size)
        if name in self._wanted:
            self.layout.places[name] = (self.at, dtype)
        self.at += size

    def _elements(self, element: Any, count: int, name: str) -> None:
        kind, detail = element
        if (
            kind == Nodetype.BASE and detail[0] in NUMBERS and count > MOST_ELEMENTS
        ):  # none of them is a column
            size = int(NUMBERS[detail[0]][-1])
            self._align(size)
            self.at += size * count
            return
        for k in range(count):
            self._field(element, f"{name}[{k}]")
            if self.at > len(self._message):
                raise struct.error("longer than the message")
