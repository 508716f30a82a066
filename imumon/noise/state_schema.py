"""Schema of a saved state: the arrays of an accumulator, and what they may hold.

A state file outlives the program that wrote it. It may be damaged, forged, or of a defect of an earlier version. What
it holds becomes indices of rings, counts under square roots and sums that later samples are added to. So a wrong number
shows hours later, as an error in the loop or as a coefficient that looks like any other. Therefore a state is checked
as a whole before any of it is used, against a description beside the code that saves it.

A `Schema` describes one object:

    fields   the arrays that are saved, by name: type, shape, range, and whether they may be unknown (NaN) or infinite
    rules    what holds between fields: a minimum is not above its maximum, a count not above the samples
    parts    the schemas of the objects within, by the prefix of their names; their number may follow from the fields
    whole    what holds between the arrays of several parts: no sum of a part of a record is above that of the record

A shape has the numbers of channels and groups of the object, or names: a name stands for any length up to that of
`Schema.lengths`, the same one in all fields. Nothing else may be in the state.

The limits are those of real records. A value is below `LARGEST`, because larger ones never count as samples. Sums of
their powers, over fewer samples than `MOST`, then stay finite: nothing that is computed from a valid state overflows.

>>> schema = Schema({"count": count_field("c"), "low": float_field("c"), "high": float_field("c")}, lengths={"c": 9})
>>> schema.check({"count": np.array([1]), "low": np.array([0.0]), "high": np.array([2.0])})
>>> schema.check({"count": np.array([-1]), "low": np.array([0.0]), "high": np.array([2.0])})
Traceback (most recent call last):
imumon.noise.state_schema.InvalidState: count has -1, below 0

A rule is named by the arrays that it reads:

>>> rule = ("a low above the high", lambda saved: saved["low"] <= saved["high"])
>>> ordered = Schema({"low": float_field(), "high": float_field()}, (rule,))
>>> ordered.check({"low": np.array(2.0), "high": np.array(1.0)})
Traceback (most recent call last):
imumon.noise.state_schema.InvalidState: a low above the high (low, high)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from imumon.noise.validity_groups import LARGEST

Saved: TypeAlias = Mapping[str, npt.NDArray[Any]]

MOST = 1 << 48
"""Samples, or anything that is counted by samples: 280 years at 30 kHz. Sums of a few of them are exact in a float."""

NAMED_ARRAYS = 3
"""Arrays that the message of a rule names: the last ones that it has read, for a rule over all parts reads dozens."""


class InvalidState(ValueError):
    """A saved state is not one of these accumulators. The message says which array of it is wrong, and how."""


@dataclass(frozen=True, slots=True)
class Range:
    """What the numbers of an array may be.

    Attributes
    ----------
    low, high : least and greatest finite number.
    nan : unknown numbers may occur.
    inf : infinite ones may.
    """

    low: float
    high: float
    nan: bool = False
    inf: bool = False

    def fault(self, array: npt.NDArray[Any]) -> str | None:
        """Return what is wrong with the numbers of an array; None: nothing."""
        if array.dtype == bool or not array.size:
            return None
        if array.dtype.kind == "f":
            if not self.nan and np.isnan(array).any():
                return "has a number that is unknown"
            if not self.inf and np.isinf(array).any():
                return "has a number that is infinite"
            array = array[np.isfinite(array)]
            if not array.size:
                return None
        # as numbers of Python: an integer of 64 bits compares exactly with a float
        least, greatest = array.min().item(), array.max().item()
        if least < self.low:
            return f"has {least:g}, below {self.low:g}"
        return f"has {greatest:g}, above {self.high:g}" if greatest > self.high else None


COUNT = Range(0, MOST)
VALUE = Range(-LARGEST, LARGEST)
"""Of channel unit, or a mean of such values."""
SPREAD = Range(0.0, 2.0 * LARGEST)
"""Of channel unit: distances and deviations."""
SQUARE = Range(0.0, 4.0 * LARGEST**2 * MOST)
"""Of sums of squared differences."""
LIMIT = Range(0.0, np.inf, inf=True)
"""Of channel unit: thresholds, which may be beyond any number."""
FLAG = Range(0, 1)


@dataclass(frozen=True, slots=True)
class Field:
    """One array of a state.

    Attributes
    ----------
    dtype : of the array.
    shape : lengths, or names of lengths.
    range : of its numbers.
    equal : what the array must be, because the object has it from its arguments; None: it is not known.
    optional : it may be absent.
    """

    dtype: npt.DTypeLike
    shape: tuple[int | str, ...]
    range: Range
    equal: npt.NDArray[Any] | None = None
    optional: bool = False


def count_field(*shape: int | str, high: float = MOST, optional: bool = False) -> Field:
    """Return a field of numbers that are counted."""
    return Field(np.int64, shape, Range(0, high), optional=optional)


def float_field(*shape: int | str, range: Range = VALUE, optional: bool = False) -> Field:
    """Return a field of floats, by default of values in their channel unit."""
    return Field(np.float64, shape, range, optional=optional)


def flag_field(*shape: int | str, optional: bool = False) -> Field:
    """Return a field of truth values."""
    return Field(np.bool_, shape, FLAG, optional=optional)


def given_field(value: npt.ArrayLike) -> Field:
    """Return a field that is known from the arguments of the object, such as its groups."""
    known = np.array(value)
    return Field(known.dtype, known.shape, Range(-np.inf, np.inf, nan=True, inf=True), equal=known)


Rule: TypeAlias = tuple[str, Callable[[Saved], Any]]
"""What does not hold, in words, and a test that returns whether it holds, as a truth value or an array of them."""
Parts: TypeAlias = Mapping[str, "Schema"] | Callable[[Saved], Mapping[str, "Schema"]]


@dataclass(frozen=True, slots=True)
class Schema:
    """The saved arrays of one object.

    Attributes
    ----------
    fields : by name.
    rules : what holds between fields. A test may rely on the fields, on the lengths of their names, and on the rules
        before it.
    parts : schemas by the prefix of their names; or what returns them for these arrays, which are valid by then.
    lengths : greatest length by name.
    whole : rules over the arrays of all parts, by their full names; tested last, when every part is valid by itself.
    optional : the object may be absent as a whole.
    """

    fields: Mapping[str, Field]
    rules: Sequence[Rule] = ()
    parts: Parts = field(default_factory=dict)
    lengths: Mapping[str, int] = field(default_factory=dict)
    whole: Sequence[Rule] = ()
    optional: bool = False

    def check(self, saved: Saved) -> None:
        """Raise `InvalidState` unless the arrays are a state of this object."""
        self._check(saved, "")

    def _check(self, saved: Saved, prefix: str) -> None:
        arrays = {name: saved[name] for name in self.fields if name in saved}
        lengths: dict[str, int] = {}
        for name, described in self.fields.items():
            if name in arrays:
                if fault := self._fault(described, arrays[name], lengths):
                    raise InvalidState(f"{prefix}{name} {fault}")
            elif not described.optional:
                raise InvalidState(f"{prefix}{name} is missing")
        _test(self.rules, arrays, prefix)
        parts = self.parts(arrays) if callable(self.parts) else self.parts
        inner: dict[str, dict[str, npt.NDArray[Any]]] = {name: {} for name in parts}
        for name, array in saved.items():
            if name in arrays:
                continue
            part = next((part for part in parts if name.startswith(part)), None)
            if part is None:
                raise InvalidState(f"{prefix}{name} is not known")
            inner[part][name.removeprefix(part)] = array
        for part, schema in parts.items():
            if inner[part] or not schema.optional:
                schema._check(inner[part], prefix + part)
        _test(self.whole, saved, prefix)

    def _fault(self, described: Field, array: npt.NDArray[Any], lengths: dict[str, int]) -> str | None:
        """Return what is wrong with an array; None: nothing. `lengths` by name are those so far, and are extended."""
        if array.dtype != described.dtype:
            return f"is of type {array.dtype}, not {np.dtype(described.dtype)}"
        if array.ndim != len(described.shape):
            return f"has {array.ndim} dimensions, not {len(described.shape)}"
        for length, wanted in zip(array.shape, described.shape, strict=True):
            if isinstance(wanted, str):
                if length > self.lengths[wanted]:
                    return f"has {length} entries, more than {self.lengths[wanted]}"
                wanted = lengths.setdefault(wanted, length)
            if length != wanted:
                return f"has the shape {array.shape}, which does not fit"
        if described.equal is not None:
            return None if np.array_equal(array, described.equal) else "is that of another stream"
        return described.range.fault(array)


class _ReadArrays(Mapping[str, npt.NDArray[Any]]):
    """Arrays of a state that note which of them a rule reads, so that the message of the rule can name them."""

    def __init__(self, arrays: Saved) -> None:
        self._arrays = arrays
        self.read: dict[str, None] = {}  # in the order of the last reading

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        self.read.pop(name, None)
        self.read[name] = None
        return self._arrays[name]

    def __contains__(self, name: object) -> bool:
        return name in self._arrays

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)


def _test(rules: Sequence[Rule], arrays: Saved, prefix: str) -> None:
    """Raise `InvalidState` with the text of the first rule that does not hold, and the arrays that it has read."""
    for text, holds in rules:
        noted = _ReadArrays(arrays)
        if not np.all(holds(noted)):
            names = ", ".join([name for name in noted.read if name in arrays][-NAMED_ARRAYS:])
            where = f"{prefix.rstrip('.')}: " if prefix else ""
            raise InvalidState(f"{where}{text} ({names})")
