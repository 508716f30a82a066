"""The doors of imumon for the corpus: how an input goes through, and the laws that hold for every input."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from commands import imumon
from hostile_input import Hostile
from hostile_reports import show_on_screen

from imumon.api.replay import replay
from imumon.api.replay_options import ReplayOptions
from imumon.config import ConfigError, load
from imumon.model.errors import ImumonError
from imumon.model.report import Report, Signal, from_json, is_device_name


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
        report = replay(ReplayOptions(path=str(path), guarded=False, accept=True), remark=remarks.append)
    except ImumonError as error:
        return error.code, str(error)
    return f"{report.session.samples} samples", "\n".join(remarks)


def settings(path: Path) -> tuple[str, str]:
    try:
        load(path)
    except ConfigError as error:
        return "faults", str(error)
    return "read", ""


def report(text: str) -> tuple[str, str]:
    try:
        message = from_json(Report, text)
    except ValueError as error:
        return "rejected", str(error)
    assert len(text) < 1_000_000  # what is accepted fits into a message of the bus
    show_on_screen(message, None, ())
    return "shown", ""


def signal(text: str) -> tuple[str, str]:
    try:
        from_json(Signal, text)
    except ValueError as error:
        return "rejected", str(error)
    return "accepted", ""


def device_name(text: str) -> tuple[str, str]:
    return "accepted" if is_device_name(text) else "rejected", ""


def saved_report(path: Path) -> tuple[str, str]:
    message = imumon("report", path, code=1)
    assert path.parent.name in message
    return "refused", message.rstrip("\n")


DOORS: dict[str, Callable[[Any], tuple[str, str]]] = {
    "recording": recording,
    "settings": settings,
    "report": report,
    "signal": signal,
    "device-name": device_name,
    "saved-report": saved_report,
}
"""Doors that need no other process. tests/hostile/test_hostile_bus.py has those of the bus."""


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
