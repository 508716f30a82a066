"""State of an accumulator or detector as arrays: saved, restored and copied by the names of its attributes."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np


class ArrayState:
    """Base of objects whose state is arrays and numbers: the attributes named in `_STATE`."""

    _STATE: ClassVar[tuple[str, ...]] = ()

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        return {name.strip("_"): np.array(getattr(self, name)) for name in self._STATE}

    def load(self, saved: Mapping[str, np.ndarray]) -> None:
        """Continue from a saved state; numbers keep their type."""
        for name in self._STATE:
            now, value = getattr(self, name), saved[name.strip("_")]
            setattr(self, name, np.array(value) if isinstance(now, np.ndarray) else type(now)(value))

    def copy(self) -> Self:
        """Return an independent object in the same state."""
        other = copy.copy(self)
        for name in self._STATE:
            setattr(other, name, copy.copy(getattr(self, name)))
        return other


def subset(saved: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the arrays of a saved state whose names begin with `prefix`, without the prefix."""
    return {name.removeprefix(prefix): value for name, value in saved.items() if name.startswith(prefix)}
