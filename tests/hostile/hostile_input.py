"""Hostile files: what one is, the doors that it attacks, and the laws that hold for every file.

A door is a place where a file of others enters imumon. What a person reads of it has no control character and no
traceback, and time and memory are bounded. `test_hostile_reports.py` has messages, `test_hostile_bus.py` the bus.

| door | an input is | outcomes |
|---|---|---|
| recording | a file for `imumon replay` | code of the error; `N samples`: it is read |
| settings | a file for `--config` | `faults`; `read` |
| saved-report | a file for `imumon report` | `refused` |

The files are rows of tables. The name of a row is the id of its test: `pytest -k NAME` runs it.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from commands import imumon
from tables import options

from imumon.api.replay import replay
from imumon.config import ConfigError, load
from imumon.model.errors import ImumonError


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


def rows(inputs: Iterable[Hostile]) -> list[Any]:
    """Return inputs as parameters of a test: all but the first of a door are slow."""
    seen: set[str] = set()
    parameters = []
    for hostile in inputs:
        marks = [pytest.mark.slow] if hostile.door in seen else []
        seen.add(hostile.door)
        parameters.append(pytest.param(hostile, id=f"{hostile.door}-{hostile.name}", marks=marks))
    return parameters


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


# Each door returns the outcome and what a person reads of it.


def recording(path: Path) -> tuple[str, str]:
    remarks: list[str] = []
    try:
        report = replay(options(path), remark=remarks.append)
    except ImumonError as error:
        return error.code, str(error)
    return f"{report.session.samples} samples", "\n".join(remarks)


def settings(path: Path) -> tuple[str, str]:
    try:
        load(path)
    except ConfigError as error:
        return "faults", str(error)
    return "read", ""


def saved_report(path: Path) -> tuple[str, str]:
    message = imumon("report", path, code=1)
    assert path.parent.name in message
    return "refused", message.rstrip("\n")


DOORS = {"recording": recording, "settings": settings, "saved-report": saved_report}


def go_through(hostile: Hostile, place: Path) -> None:
    """Take an input through its door; what happens is what the corpus says, within its limits."""
    content = hostile.make(place)
    with little_memory(hostile.memory):
        begin = time.process_time()
        outcome, text = DOORS[hostile.door](content)
        seconds = time.process_time() - begin
    assert outcome == hostile.outcome, text
    assert hostile.says in printable(text)
    assert seconds < hostile.seconds
