"""JSON of the published messages: dataclasses to text, and text of any origin to dataclasses.

Standard library only. A message may come from any program, so numbers and lengths are bounded, words are those of
their `Literal`, and text is made `plain`. Unknown fields are ignored. `imumon.model.report` names the further rules.
"""

from __future__ import annotations

import json
import re
import typing
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Any, Literal

from imumon.model.samples import ChannelName

MAX_NUMBER = 1e150  # numbers from outside are smaller: squares and other units are finite
MAX_BYTES = 4_000_000  # bytes of JSON that is read; 64 channels with line breaks have 0.7 MB
MAX_ITEMS = 256  # entries of a mapping, and lines or parts in a list
MAX_LENGTH = 4096  # characters of a text, as the longest path of Linux, and numbers in an array

T = typing.TypeVar("T")
_CONTROL = re.compile(
    "[\x00-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff\U000e0000-\U000e007f]"
)
_NUMBERS = {float, int, bool, float | None}


def plain(text: str) -> str:
    """Return text without control characters, invisible ones and changes of the writing direction.

    Every text from outside passes through here before it is printed: from keys, reports, files and errors.
    >>> plain("VN-100\\x1b[2J T\\u202e")
    'VN-100[2J T'
    """
    return text if text.isascii() and text.isprintable() else _CONTROL.sub("", text)


def to_json(part: Any, *, indent: int | None = None) -> str:
    """Return a report or a part of one as JSON text; raise ValueError if a number is not finite."""
    if indent is None:
        return _ENCODER.encode(part)
    return json.dumps(part, default=members, allow_nan=False, ensure_ascii=False, indent=indent)


def entries(names: Collection[str]) -> dict[str, Any]:
    """Return the metadata of a field, a mapping of which each of these entries is a member of the JSON, or null."""
    return {"entries": tuple(names)}


def members(part: Any) -> dict[str, Any]:
    """Return the members of the JSON of a dataclass or a mapping.

    A dataclass has its fields, the `entries` of some, and the properties that its `DERIVED` lists.
    """
    if not is_dataclass(part):
        return dict(part)
    out: dict[str, Any] = {}
    for name, names in _fields(part.__class__):
        value = getattr(part, name)
        if names is None:
            out[name] = value
        else:
            out |= {name: value.get(name) for name in names}
    for name, keys in getattr(part, "DERIVED", {}).items():
        out[name] = {key: getattr(getattr(part, name), key) for key in keys}
    return out


_ENCODER = json.JSONEncoder(default=members, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


class JsonWriter:
    """Writer of an object that is sent again and again: a member is encoded again when its value has changed.

    A report has 0.1 MB, of which a few kB change in a second.
    """

    def __init__(self) -> None:
        self._written: dict[str, tuple[object, str]] = {}  # by name of a member: its value, and its text

    def texts(self, part: Any) -> dict[str, str]:
        """Return the text of each member of a dataclass or mapping, with its name in front, by this name."""
        written, texts = self._written, {}
        for name, value in members(part).items():
            known, text = written.get(name, (None, ""))
            if not text or known != value:
                text = f"{to_json(name)}:{to_json(value)}"
                written[name] = value, text
            texts[name] = text
        return texts


def joined(texts: Iterable[str]) -> str:
    """Return the JSON of an object from the texts of its members.

    >>> joined(JsonWriter().texts({"mean": 0.5, "std": None}).values())
    '{"mean":0.5,"std":null}'
    """
    return "{" + ",".join(texts) + "}"


@cache
def _fields(cls: Any) -> tuple[tuple[str, tuple[str, ...] | None], ...]:
    """Return the fields of a class with their `entries`; a report has 170 parts, every second."""
    return tuple((field.name, field.metadata.get("entries")) for field in fields(cls))


class JsonReader:
    """Reader of dataclasses.

    Parameters
    ----------
    checks : by class, raises TypeError if an object is not plausible.
    lists : classes whose arrays are independent lists. In others all arrays of numbers have equal lengths.
    """

    def __init__(self, checks: Mapping[Any, Callable[[Any], None]], lists: Collection[Any] = ()) -> None:
        self._checks, self._lists = checks, lists
        self._readers: dict[Any, Callable[[Any], Any]] = {}

    def read(self, cls: type[T], text: str | bytes) -> T:
        """Read JSON as `cls`.

        Raises
        ------
        TypeError, AttributeError, KeyError, ValueError, RecursionError : it is something else.
        """
        if len(text) > MAX_BYTES:
            raise TypeError(f"more than {MAX_BYTES} bytes")
        return self.part(cls, json.loads(text, parse_constant=_reject_constant))

    def part(self, cls: type[T], data: Any) -> T:
        """Return data of JSON as `cls`; raise an error as `read`."""
        return typing.cast(T, self._reader(cls)(data))

    def _reader(self, hint: Any) -> Callable[[Any], Any]:
        """Return the function that makes a value of type `hint` from JSON data."""
        if hint not in self._readers:
            self._readers[hint] = self._make(hint)
        return self._readers[hint]

    def _make(self, hint: Any) -> Callable[[Any], Any]:
        if is_dataclass(hint):
            return self._dataclass_reader(hint)
        origin, arguments = typing.get_origin(hint), typing.get_args(hint)
        if origin is Mapping:
            inner, key = self._reader(arguments[1]), self._reader(arguments[0])
            return lambda data: {
                key(k): inner(v) for k, v in bounded(_checked(data, dict), MAX_ITEMS).items()
            }
        if hint in (str, ChannelName):
            return lambda data: hint(plain(bounded(_checked(data, str), MAX_LENGTH)))
        if origin is Literal:
            return lambda data: _listed(data, arguments)
        if origin is None:
            return lambda data: _checked(data, hint)
        inner = self._reader(arguments[0])
        if origin is tuple:
            most = MAX_LENGTH if arguments[0] in _NUMBERS else MAX_ITEMS
            return lambda data: tuple(map(inner, bounded(_checked(data, list), most)))
        return lambda data: None if data is None else inner(data)

    def _dataclass_reader(self, cls: Any) -> Callable[[Any], Any]:
        """Return the function that makes a `cls`."""
        hints = typing.get_type_hints(cls)
        entries_of = {f.name: names for f in fields(cls) if (names := f.metadata.get("entries"))}
        readers = {f.name: self._reader(hints[f.name]) for f in fields(cls)}
        required = [f.name for f in fields(cls) if f.default is MISSING and f.default_factory is MISSING]
        arrays = [] if cls in self._lists else [name for name in readers if _is_numbers(hints[name])]
        check_part = self._checks.get(cls, lambda part: None)

        def read(data: Any) -> Any:
            given = {name: value for name, value in data.items() if name not in entries_of}
            for field, names in entries_of.items():
                given[field] = {name: data[name] for name in names if data.get(name) is not None}
            absent = [name for name in required if name not in given]
            check(not absent, f"{cls.__name__} without {', '.join(absent)}")
            part = cls(**{name: readers[name](value) for name, value in given.items() if name in readers})
            # An array that a later version adds must stay optional: reports of this one do not have it.
            lengths = {len(getattr(part, name)) for name in arrays}
            check(len(lengths) < 2, f"arrays of different lengths in {cls.__name__}")
            check_part(part)
            return part

        return read


def _is_numbers(hint: Any) -> bool:
    """Return whether a type is that of an array of numbers."""
    return typing.get_origin(hint) is tuple and typing.get_args(hint)[0] in _NUMBERS


def _reject_constant(name: str) -> None:
    raise TypeError(f"{name} is not a number of JSON")


def _checked(data: Any, kind: Any) -> Any:
    """Return data of type `kind`: an integer is a valid float, an integral float a valid integer."""
    number = type(data) in (int, float)
    if number and not abs(data) < MAX_NUMBER:  # NaN too
        raise TypeError(f"a number that is not below {MAX_NUMBER:g}")
    if kind is int and type(data) is float and data.is_integer():
        return int(data)
    if type(data) is kind or (kind is float and number):
        return data
    shown = data[:40] if isinstance(data, str) else type(data).__name__
    raise TypeError(f"{shown!r} instead of {kind.__name__}")


def bounded(data: Any, most: int) -> Any:
    """Return a text, list or mapping that is not too long."""
    check(len(data) <= most, f"{len(data)} entries or characters, more than {most}")
    return data


def _listed(data: Any, words: tuple[str, ...]) -> Any:
    """Return a word that is one of `words`."""
    check(data in words, f"{_checked(data, str)[:40]!r} is not one of {', '.join(words)}")
    return data


def check(holds: bool, fault: str) -> None:
    """Raise TypeError with the fault unless the rule holds."""
    if not holds:
        raise TypeError(fault)
