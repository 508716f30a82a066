"""Message fields: serialised ROS messages as columns of numbers, many messages at once.

The place of a field depends on the lengths of the strings and sequences before it, and on nothing else. The first
message shows the places and those lengths; they apply to every message of the same size that has the same
lengths, so their fields are columns of an array of bytes. Serialisation: ROS 1 packs the values; ROS 2 is CDR (OMG
DDSI-RTPS 2.2, section 10: 4 bytes of header, each value aligned to its size from there). rosbags makes an object of
each message, which takes ten times as long.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Nodetype

from imumon.model.samples import Bools
from imumon.sources.files.columns import MOST_COLUMNS

Types: TypeAlias = Mapping[str, Any]
"""By name of a type: its constants, and its fields as pairs of name and description, as rosbags parses them."""

FORMS = {
    "bool": "u1", "byte": "u1", "octet": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2",
    "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8", "float32": "f4", "float64": "f8", "string": "",
}  # fmt: skip
"""Type of numpy of each type of numbers; a string has none."""

TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
"""Types of seconds and nanoseconds, which are one column."""

MOST_ELEMENTS = 64
"""Elements of an array that are columns."""


class UnsupportedType(Exception):
    """The type has a field that cannot be read, or refers to an unknown type."""


class _Field(NamedTuple):
    """A field of a message or of an element: a number, a time, a string, or several elements.

    Attributes
    ----------
    name : of the column; of a field of an element, what follows its index.
    form : type of numpy; of a time, that of its seconds; empty: a string, or elements.
    element : fields of an element; None: it has none.
    elements : their number; None: the message has it.
    is_time : seconds are followed by nanoseconds.
    """

    name: str
    form: str = ""
    element: tuple[_Field, ...] | None = None
    elements: int | None = None
    is_time: bool = False


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
        self._types, self._cdr = types, cdr
        self._prefixes: list[tuple[str, str]] = []  # of the columns of each type in this one
        self._fields = tuple(self._fields_of(name, ""))
        columns = list(itertools.islice(_columns(self._fields), MOST_COLUMNS))
        self.names = [name for name, _ in columns]
        self.times = {name for name, is_time in columns if is_time}

    def _fields_of(self, type_name: str, prefix: str) -> Iterator[_Field]:
        """Yield the fields of a type."""
        if type_name not in self._types or len(self._prefixes) > MOST_COLUMNS:
            raise UnsupportedType(f"the type {type_name} has no definition, or is too large")
        self._prefixes.append((type_name, prefix))
        for part, description in self._types[type_name][1]:
            yield from self._described(description, f"{prefix}{part}")

    def _described(self, description: Any, name: str) -> Iterator[_Field]:
        kind, detail = description
        if kind == Nodetype.NAME and detail not in TIMES:
            yield from self._fields_of(detail, f"{name}.")
        elif kind == Nodetype.NAME:
            yield _Field(name, "i4", is_time=True)
        elif kind == Nodetype.BASE and detail[0] in FORMS:
            yield _Field(name, FORMS[detail[0]])
        elif kind == Nodetype.BASE:
            raise UnsupportedType(f"{detail[0]} is not supported")
        else:
            count = detail[1] if kind == Nodetype.ARRAY else None
            yield _Field(name, element=tuple(self._described(detail[0], "")), elements=count)

    def nested(self, wanted: str) -> list[str]:
        """Return the prefixes of the columns of another type in this one; the type itself has none."""
        return [prefix for name, prefix in self._prefixes if name == wanted and not prefix.startswith(".")]

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
            data = np.frombuffer(b"".join(messages[k] for k in which.tolist()), np.uint8)
            data = data.reshape(len(which), size)
            while len(which):
                same = np.ones(len(which), dtype=bool)
                walk = _Walk(data[0].tobytes(), names, cdr=self._cdr)
                if walk.fits(self._fields):
                    for offset, content in walk.lengths:
                        part = data[:, offset : offset + len(content)]
                        same &= (part == np.frombuffer(content, np.uint8)).all(axis=1)
                    for name in names:
                        out[name][which[same]] = self._column(data[same], *walk.places[name], name)
                    valid[which[same]] = True
                else:
                    same[1:] = False
                which, data = which[~same], data[~same]
        return out, valid

    def _column(self, data: npt.NDArray[np.uint8], offset: int, dtype: str, name: str) -> npt.NDArray[Any]:
        """Return the values of a column of messages of one layout."""

        def number(offset: int, dtype: str) -> npt.NDArray[Any]:
            end = offset + np.dtype(dtype).itemsize
            values: npt.NDArray[Any] = np.ascontiguousarray(data[:, offset:end]).view(dtype)[:, 0]
            return values

        if name not in self.times:
            return number(offset, dtype)
        stamps: npt.NDArray[Any] = number(offset, dtype).astype(np.int64) * 1_000_000_000
        stamps += number(offset + 4, f"{dtype[0]}u4")
        return stamps


def _columns(fields: Sequence[_Field], prefix: str = "") -> Iterator[tuple[str, bool]]:
    """Yield the name of each column, and whether it is a time."""
    for field in fields:
        if field.form:
            yield f"{prefix}{field.name}", field.is_time
        elif field.element is not None and (field.elements or MOST_ELEMENTS + 1) <= MOST_ELEMENTS:
            for k in range(field.elements or 0):
                yield from _columns(field.element, f"{prefix}{field.name}[{k}]")


class _Walk:
    """One pass over a message, which notes the places.

    Attributes
    ----------
    places : name to offset and type of numpy; of a time, those of its seconds.
    lengths : offset and bytes of everything that the places depend on.
    """

    def __init__(self, message: bytes, names: Collection[str], *, cdr: bool) -> None:
        self._message, self._names, self._cdr = message, names, cdr
        self.places: dict[str, tuple[int, str]] = {}
        self.lengths: list[tuple[int, bytes]] = [(0, message[:4])] if cdr else []
        self._at = 4 if cdr else 0
        self._order = ">" if cdr and not (message[1:2] or b"\0")[0] & 1 else "<"

    def fits(self, fields: Sequence[_Field]) -> bool:
        """Walk over the fields of the type; return whether the message has them all."""
        try:
            self._fields(fields, "")
        except struct.error:
            return False
        return self._at <= len(self._message)

    def _align(self, size: int) -> None:
        if self._cdr:
            self._at += (4 - self._at) % size

    def _length(self) -> int:
        """Read a length and note that all places behind it depend on it."""
        self._align(4)
        (length,) = struct.unpack_from(f"{self._order}I", self._message, self._at)
        self.lengths.append((self._at, self._message[self._at : self._at + 4]))
        self._at += 4
        if length > len(self._message):
            raise struct.error("longer than the message")
        return int(length)

    def _fields(self, fields: Sequence[_Field], prefix: str) -> None:
        for field in fields:
            name = f"{prefix}{field.name}"
            if field.form:
                size = int(field.form[-1])
                self._align(size)
                if name in self._names:
                    self.places[name] = self._at, f"{self._order}{field.form}"
                self._at += 2 * size if field.is_time else size
            elif field.element is not None:
                self._elements(
                    field.element, self._length() if field.elements is None else field.elements, name
                )
            else:
                length = self._length()  # which moves on
                self._at += length

    def _elements(self, element: Sequence[_Field], count: int, name: str) -> None:
        if count > MOST_ELEMENTS and len(element) == 1 and element[0].form:  # none of them is a column
            size = int(element[0].form[-1])
            self._align(size)
            self._at += (2 * size if element[0].is_time else size) * count
            return
        for k in range(count):
            self._fields(element, f"{name}[{k}]")
            if self._at > len(self._message):
                raise struct.error("longer than the message")
