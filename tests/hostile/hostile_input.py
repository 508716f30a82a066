"""What a hostile input is, and what several doors need to make one: files, links, and text that a terminal obeys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Hostile:
    """An input, and what must happen.

    Attributes
    ----------
    door : where it enters.
    name : id of its test, unique within the door.
    make : returns the input; called with an empty directory.
    outcome : in the words of the door.
    says : part of what the command prints on it; empty: anything.
    seconds : of processor time that it may take.
    memory : bytes that the process may take for it.
    """

    door: str
    name: str
    make: Callable[[Path], Any]
    outcome: str
    says: str = ""
    seconds: float = 5.0
    memory: int = 1 << 30


TITLE = "\x1b]0;owned\x07"
"""Sets the title of a terminal that obeys."""
ESCAPES = "\x1b]0;owned\x07\x1b[2J\x9b1m\u202e"
"""The same, a clean screen and bold letters, in 7 and 8 bits, and a right-to-left override."""


def file(name: str, content: Callable[[], bytes | str]) -> Callable[[Path], Path]:
    """Return what writes a file."""

    def write(place: Path) -> Path:
        data = content()
        (place / name).write_bytes(data.encode() if isinstance(data, str) else data)
        return place / name

    return write


def link(name: str, target: Callable[[Path], Path]) -> Callable[[Path], Path]:
    """Return what makes a symbolic link to a file."""

    def make(place: Path) -> Path:
        (place / name).symlink_to(target(place))
        return place / name

    return make
