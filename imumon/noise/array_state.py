"""State of an accumulator or detector as arrays: saved, restored and copied by the names of its attributes."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from imumon.noise.state_schema import Field, Range, Schema


@dataclass(frozen=True, slots=True)
class Rows:
    """What an array with a varying number of rows may be.

    Attributes
    ----------
    length : name of the number of rows, see `Schema.lengths`.
    range : of the numbers.
    """

    length: str
    range: Range


class ArrayState:
    """Base of objects whose state is arrays and numbers: the attributes named in `_STATE`, with what they may be.

    An array has the type and the shape that it has in a new object, except for the number of `Rows`.
    """

    _STATE: ClassVar[Mapping[str, Range | Rows]] = {}

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        return {name.strip("_"): np.array(getattr(self, name)) for name in self._STATE}

    def load(self, saved: Mapping[str, np.ndarray]) -> None:
        """Continue from a saved state; numbers keep their type."""
        for name in self._STATE:
            # an archive of arrays returns numbers as arrays without dimensions
            now, value = getattr(self, name), saved[name.strip("_")]
            setattr(self, name, np.array(value) if isinstance(now, np.ndarray) else type(now)(value))

    def schema(self) -> Schema:
        """Return what a saved state of an object with the same arguments as this one, which is new, consists of."""
        fields = {}
        for name, described in self._STATE.items():
            now = np.asarray(getattr(self, name))
            if isinstance(described, Rows):
                field = Field(now.dtype, (described.length, *now.shape[1:]), described.range)
            else:
                field = Field(now.dtype, now.shape, described)
            fields[name.strip("_")] = field
        return Schema(fields)

    def copy(self) -> Self:
        """Return an independent object in the same state."""
        other = copy.copy(self)  # shares the arrays, which are replaced here
        for name in self._STATE:
            setattr(other, name, copy.copy(getattr(self, name)))
        return other


def subset(saved: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the arrays of a saved state whose names begin with `prefix`, without the prefix."""
    return {name.removeprefix(prefix): value for name, value in saved.items() if name.startswith(prefix)}
