"""Saved state: objects as bytes and back, by their attributes, for records that survive a restart.

The problem
-----------
A record consists of some hundred accumulators that hold one another: arrays, counters, and the places at which parts
begin. A restart has to continue it exactly, and each class that wrote its own state would need a second description of
itself that can be forgotten.

The rule
--------
One function saves everything that an object holds, and one restores it. A class that may be saved says so with
`restorable`; its attributes need nothing. What two objects share is saved once, and is shared again afterwards.

    kind of a value                        how it is saved
    None, truth value, number, text        as JSON
    list, tuple, dict, slice, Enum         as JSON that says which one it is
    array of numbers, truth values, text   its type, shape and place among the bytes behind the JSON
    object of a restorable class           the name of its class and its attributes, once

Attributes in `NOT_SAVED` of a class follow from others, or are working space: a function makes them again.

What is restored is trusted as far as its checksum goes (`imumon.checkpoint`). Only objects of marked classes are made,
and no code of the file runs. A file of another layout has another number of its format.

>>> @restorable
... class Sum:
...     def __init__(self) -> None:
...         self.total, self.counts = 0.5, np.zeros(2, dtype=np.int64)
>>> one = Sum()
>>> one.counts += 3
>>> other = unpack(pack({"first": one, "same": one}))
>>> other["first"].total, other["first"].counts, other["first"] is other["same"]
(0.5, array([3, 3]), True)
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from itertools import chain
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from imumon.model.samples import ChannelName

_Class = TypeVar("_Class", bound=type)
_CLASSES: dict[str, type] = {}
"""Classes of which objects may be restored, by name."""

ARRAY_KINDS = "biufU"
"""Kinds of numpy of the arrays that are saved: truth values, integers, floats, text."""


def restorable(cls: _Class) -> _Class:
    """Mark a class whose objects are saved and restored by their attributes."""
    if _CLASSES.setdefault(cls.__name__, cls).__module__ != cls.__module__:
        raise ValueError(f"there are two restorable classes {cls.__name__}")
    _CLASSES[cls.__name__] = cls
    return cls


def pack(root: Any) -> bytes:
    """Return an object, and all objects that it holds, as bytes.

    Raises
    ------
    TypeError : it holds something that cannot be saved.
    """
    packer = _Packer()
    tree = packer.value(root)
    content = {"root": tree, "objects": packer.objects, "arrays": packer.arrays}
    text = json.dumps(content, separators=(",", ":")).encode()
    return b"".join([len(text).to_bytes(8, "little"), text, *packer.pieces])


def unpack(data: bytes) -> Any:
    """Return what `pack` was given, as new objects.

    Raises
    ------
    ValueError, LookupError, TypeError : it is not what `pack` returns.
    """
    end = 8 + int.from_bytes(data[:8], "little")
    content = json.loads(data[8:end])
    return _Unpacker(content, memoryview(data)[end:]).root()


def _attributes(thing: Any) -> Iterator[tuple[str, Any]]:
    """Iterate over the names and values of the attributes of an object that are saved."""
    left_out = _not_saved(type(thing))
    slots = (name for cls in type(thing).__mro__ for name in vars(cls).get("__slots__", ()))
    for name in chain(getattr(thing, "__dict__", ()), slots):
        if name not in left_out and hasattr(thing, name):
            yield name, getattr(thing, name)


def _not_saved(cls: type) -> Mapping[str, Callable[[], Any]]:
    """Return what makes the attributes of a class that are not saved, by name."""
    makers: Mapping[str, Callable[[], Any]] = getattr(cls, "NOT_SAVED", {})
    return makers


class _Packer:
    """Objects and arrays in the order in which they are met, each of them once."""

    def __init__(self) -> None:
        self.objects: list[Any] = []
        self.arrays: list[Any] = []
        self.pieces: list[memoryview] = []
        self._length = 0
        self._numbers: dict[int, int] = {}  # of objects and of arrays, by their identity

    def value(self, value: Any) -> Any:
        """Return a value as JSON; what it holds is added to the lists."""
        match value:
            case Enum():
                return {"enum": type(value).__name__, "value": value.value}
            case ChannelName():
                return {"channel": str(value)}
            case None | bool() | str():
                return value
            case int() | np.integer():
                return int(value)
            case float() | np.floating():
                return float(value)
            case np.bool_():
                return bool(value)
            case np.ndarray():
                return {"array": self._array(value)}
            case list():
                return [self.value(item) for item in value]
            case tuple():
                return {"tuple": [self.value(item) for item in value]}
            case dict():
                return {"dict": [[self.value(key), self.value(item)] for key, item in value.items()]}
            case slice():
                return {"slice": [value.start, value.stop, value.step]}
        return {"object": self._object(value)}

    def _object(self, thing: Any) -> int:
        name = type(thing).__name__
        if _CLASSES.get(name) is not type(thing):
            raise TypeError(f"{name} is not restorable")
        if (number := self._numbers.get(id(thing))) is None:
            number = self._numbers[id(thing)] = len(self.objects)
            self.objects.append(None)  # what it holds may hold it
            self.objects[number] = [name, {key: self.value(value) for key, value in _attributes(thing)}]
        return number

    def _array(self, array: npt.NDArray[Any]) -> int:
        if array.dtype.kind not in ARRAY_KINDS:
            raise TypeError(f"an array of {array.dtype} cannot be saved")
        if (number := self._numbers.get(id(array))) is None:
            number = self._numbers[id(array)] = len(self.arrays)
            # sums over an array depend on its order in memory, in their last bits
            order = "F" if array.flags.f_contiguous and not array.flags.c_contiguous else "C"
            # no copy of an array that is contiguous: together they are as large as the state
            piece = np.ascontiguousarray(array if order == "C" else array.T)
            self.arrays.append([array.dtype.str, array.shape, order, self._length])
            self.pieces.append(piece.data)
            self._length += piece.nbytes
        return number


class _Unpacker:
    """Objects and arrays of a saved state: objects are made first, because they may hold one another."""

    def __init__(self, content: Mapping[str, Any], data: memoryview) -> None:
        self._tree = content["root"]
        self._arrays = [_array(data, *described) for described in content["arrays"]]
        described = content["objects"]
        self._objects: list[Any] = [object.__new__(_CLASSES[name]) for name, _ in described]
        for thing, (_, attributes) in zip(self._objects, described, strict=True):
            # `object`: an attribute of a frozen class, too
            for key, value in attributes.items():
                object.__setattr__(thing, key, self._value(value))
            for key, make in _not_saved(type(thing)).items():
                object.__setattr__(thing, key, make())

    def root(self) -> Any:
        """Return the object that was packed."""
        return self._value(self._tree)

    def _value(self, value: Any) -> Any:
        match value:
            case list():
                return [self._value(item) for item in value]
            case {"array": number}:
                return self._arrays[number]
            case {"object": number}:
                return self._objects[number]
            case {"tuple": items}:
                return tuple(self._value(item) for item in items)
            case {"dict": items}:
                return {self._value(key): self._value(item) for key, item in items}
            case {"channel": name}:
                return ChannelName(name)
            case {"slice": limits}:
                return slice(*limits)
            case {"enum": name, "value": member}:
                return _CLASSES[name](member)
            case dict():
                raise ValueError("a value of an unknown kind")
        return value


def _array(data: memoryview, kind: str, shape: list[int], order: str, begin: int) -> npt.NDArray[Any]:
    """Return an array that may be changed, from its place among the bytes."""
    dtype = np.dtype(kind)
    if dtype.kind not in ARRAY_KINDS:
        raise ValueError(f"an array of {dtype}")
    count = int(np.prod(shape, dtype=np.int64))
    flat = np.frombuffer(data, dtype, count, begin) if count else np.empty(0, dtype)
    return flat.reshape(shape, order=order).copy(order="K")  # type: ignore[call-overload,no-any-return]
