"""Hostile recordings: what one is, and the laws that hold for every one.

What a person reads of it has no control character and no traceback, and time and memory are bounded. The recordings
are rows of tables; the name of a row is the id of its test: `pytest -k NAME` runs it.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tables import options

from imumon.api.replay import replay
from imumon.model.errors import ImumonError


@dataclass(frozen=True)
class Hostile:
    """A recording, and what must happen.

    Attributes
    ----------
    name : id of its test.
    make : returns the file; called with an empty directory.
    outcome : code of the error; ``N samples``: it is read.
    says : part of what the command prints on it; empty: anything.
    seconds : of processor time that it may take.
    memory : bytes that the process may take for it.
    """

    name: str
    make: Callable[[Path], Path]
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


@contextmanager
def little_memory(extra: int) -> Iterator[None]:
    """Let this process have so many bytes more than it has now."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + extra, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


def printable(text: str) -> str:
    """Return a text after a look at each line: a terminal obeys none of its characters."""
    assert all(line.isprintable() for line in text.split("\n")), ascii(text)
    return text


def check(hostile: Hostile, place: Path) -> None:
    """Replay a recording; what happens is what its row says, within its limits."""
    path, remarks = hostile.make(place), list[str]()
    with little_memory(hostile.memory):
        begin = time.process_time()
        try:
            report = replay(options(path), remark=remarks.append)
            outcome, text = f"{report.session.samples} samples", "\n".join(remarks)
        except ImumonError as error:
            outcome, text = error.code, str(error)
        seconds = time.process_time() - begin
    assert outcome == hostile.outcome, text
    assert hostile.says in printable(text)
    assert seconds < hostile.seconds
