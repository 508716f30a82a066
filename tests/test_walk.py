"""The way of a block through the running code, from the device to the bus: short, and never back.

`model`, `grid`, `noise` and `files` are libraries, and so is the clock of the host: others call them, they call nobody.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from itertools import groupby
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from daemons import free_endpoint
from fake_device import FakeDevice
from source_trees import PACKAGE

from imumon.config import Settings
from imumon.daemon import Daemon, RunOptions
from imumon.model.samples import ACCEL, GYRO, MAG, Item, SampleBlock, Stream

LIBRARIES = ("model", "grid", "noise", "files")
WAY = ("sources", "daemon", "record", "bus")
"""The screen follows in another process; `tui` calls `bus`, which the layers do not let call it."""
LIGHT_CALLS = 40
"""Most calls of functions of a block that only waits in the guard: nearly every block of a live stream."""
RESULT_CALLS = 2500
"""Most calls outside of the mathematics of a report with new fits of nine channels."""

STREAM = Stream("uncompensated", (*GYRO, *ACCEL, *MAG), source="quick", clock="startup")

Call = tuple[tuple[str, ...], str]
"""Packages on the stack, outermost first, without libraries; and the name of the function, with its package."""


@cache
def package_of(path: str) -> str | None:
    """Return the package of a file; None: it is not of imumon."""
    if not path.startswith(f"{PACKAGE}/"):
        return None
    inside = path.removeprefix(f"{PACKAGE}/")
    return "model" if inside == "sources/clock.py" else inside.partition("/")[0].removesuffix(".py")


class Trace:
    """Calls of functions of imumon in one thread, turn by turn of its loop; comprehensions are no calls."""

    def __init__(self, thread: str, begins: str, waits: str, ended: Callable[[list[Call]], None]) -> None:
        self.turns: list[list[Call]] = []
        self._thread, self._begins, self._waits, self._ended = thread, begins, waits, ended
        self._in_turn = False

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        if event != "call" or frame.f_code.co_name.startswith("<"):
            return
        if (package := package_of(frame.f_code.co_filename)) is None:
            return
        if threading.current_thread().name != self._thread:
            return
        name = f"{package}.{frame.f_code.co_name}"
        if name == self._begins:
            self.turns.append([])
            self._in_turn = True
        elif name == self._waits and self._in_turn:
            self._in_turn = False
            self._ended(self.turns[-1])
        if self._in_turn:
            packages, caller = [package], frame.f_back
            while caller is not None:
                packages += filter(None, [package_of(caller.f_code.co_filename)])
                caller = caller.f_back
            way = [each for each in reversed(packages) if each not in LIBRARIES]
            self.turns[-1].append((tuple(each for each, _ in groupby(way)), name))


def names(turn: list[Call]) -> set[str]:
    return {name for _, name in turn}


def is_light(turn: list[Call]) -> bool:
    """Whether a block came in this turn, and no report was due and no frame of the guard complete."""
    known = names(turn)
    return "noise.check" in known and not known & {"bus.publish", "noise.assess", "daemon.save_now"}


def has_fits(turn: list[Call]) -> bool:
    return {"noise.fit", "bus.publish"} <= names(turn)


class QuickDevice(FakeDevice):
    """Nine channels of noise, a few samples at a time and as fast as they are taken, whatever the machine does."""

    def read(self, timeout_s: float) -> list[Item]:
        index, self._next = np.arange(self._next, self._next + 5), self._next + 5
        values = self._random.normal(0.0, 1e-3, (5, 9))
        stamps = (index * 10**7).astype(np.int64)
        return [SampleBlock(STREAM, values, stamps, np.zeros(5, dtype=np.int64))]


@pytest.fixture(scope="module")
def traces(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Trace, Trace]]:
    """The loop of a daemon, and the thread of its device."""
    directory: Path = tmp_path_factory.mktemp("walk")
    (directory / "device").touch()
    default = Settings()
    settings = replace(
        default,
        history=replace(default.history, enabled=False),
        zenoh=replace(default.zenoh, listen=[free_endpoint()]),
    )
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("imumon.daemon.daemon.create_device", lambda driver, options: QuickDevice(options))
        options = RunOptions(url=f"vn100:{directory / 'device'}", state_directory=directory)
        daemon = Daemon(settings, options)
        seen = {"light": 0, "fits": 0}

        def ended(turn: list[Call]) -> None:
            seen["light"] += is_light(turn)
            seen["fits"] += has_fits(turn)
            if min(seen.values()) >= 1:
                daemon._reader.stop()

        main = threading.main_thread().name
        loop = Trace(main, "daemon._handle", "sources.get", ended)
        device = Trace("imumon-device", "sources._put_items", "sources.read", lambda turn: None)
        threading.setprofile(device)
        sys.setprofile(loop)
        try:
            daemon.run()
        finally:
            sys.setprofile(None)
            threading.setprofile(None)  # type: ignore[arg-type]
        yield loop, device


def test_no_package_returns_to_one_that_it_came_from(traces: tuple[Trace, Trace]) -> None:
    """Of the packages on the stack, none is there twice, and each calls only those that come later on the way."""
    loop, device = traces
    stacks = {stack for turn in loop.turns for stack, _ in turn}
    assert not [stack for stack in stacks if len(stack) > len(set(stack))]
    on_the_way = [[WAY.index(package) for package in stack if package in WAY] for stack in stacks]
    assert not [stack for stack in on_the_way if stack != sorted(stack) and WAY.index("sources") not in stack]
    assert {package for turn in device.turns for stack, _ in turn for package in stack} == {"sources"}


def test_a_block_goes_from_the_loop_into_the_record_and_a_report_from_there_to_the_bus(
    traces: tuple[Trace, Trace],
) -> None:
    light = min(filter(is_light, traces[0].turns), key=len)
    assert list(dict.fromkeys(package for stack, _ in light for package in stack)) == ["daemon", "record"]
    published = next(filter(has_fits, traces[0].turns))
    entered = dict.fromkeys(package for stack, _ in published for package in stack if package in WAY[1:])
    assert list(entered) == ["daemon", "record", "bus"]


def test_a_block_makes_few_calls(traces: tuple[Trace, Trace]) -> None:
    assert min(len(turn) for turn in traces[0].turns if is_light(turn)) <= LIGHT_CALLS


def test_a_report_with_new_fits_makes_few_calls_outside_of_the_mathematics(
    traces: tuple[Trace, Trace],
) -> None:
    calls = [
        sum(not name.startswith("noise.") for _, name in turn) for turn in traces[0].turns if has_fits(turn)
    ]
    assert min(calls) <= RESULT_CALLS
