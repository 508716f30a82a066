"""The way of a block through the running code, from the device to the screen: short, and never back.

`model`, `grid`, `noise` and `files` are libraries, and so is the clock of the host: others call them, they call nobody.
"""

from __future__ import annotations

import asyncio
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
from fake_device import FakeDevice
from free_ports import free_endpoint
from source_trees import PACKAGE

from imumon.bus import Subscriber
from imumon.config import Settings
from imumon.daemon import Daemon, RunOptions
from imumon.model.samples import ACCEL, GYRO, MAG, Item, SampleBlock, Stream
from imumon.tui.app import ImumonApp

LIBRARIES = ("model", "grid", "noise", "files")
WAY = ("sources", "daemon", "record", "bus")
"""Packages in the order in which they call one another; the screen, which asks the bus, has threads of its own."""
NEVER = ""
"""Name of no function."""
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

    def __init__(
        self,
        thread: str,
        begins: str,
        waits: str = NEVER,
        ended: Callable[[list[Call]], None] = lambda turn: None,
    ) -> None:
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
            while (
                package not in LIBRARIES and caller is not None
            ):  # the way of a library is that of its caller
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


def is_drawn(turn: list[Call]) -> bool:
    """Whether the screen took a report in this turn, and drew its curves."""
    return {"bus.report", "tui.allan_chart"} <= names(turn)


def show(endpoint: str, ending: threading.Event) -> None:
    """Draw what is published at an endpoint until the end of the run."""

    async def draw() -> None:
        with Subscriber([endpoint]) as source:
            async with ImumonApp(source).run_test(size=(150, 45)):
                while not ending.is_set():
                    await asyncio.sleep(0.05)

    asyncio.run(draw())


class QuickDevice(FakeDevice):
    """Nine channels of noise, a few samples at a time and as fast as they are taken, whatever the machine does."""

    def read(self, timeout_s: float) -> list[Item]:
        index, self._next = np.arange(self._next, self._next + 5), self._next + 5
        values = self._random.normal(0.0, 1e-3, (5, 9))
        stamps = (index * 10**7).astype(np.int64)
        return [SampleBlock(STREAM, values, stamps, np.zeros(5, dtype=np.int64))]


@pytest.fixture(scope="module")
def traces(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Trace]]:
    """The loop of a daemon, and the threads of its device, of its side of the bus, and of a screen that shows it."""
    directory: Path = tmp_path_factory.mktemp("walk")
    (directory / "device").touch()
    default = Settings()
    endpoint = free_endpoint()
    settings = replace(
        default,
        history=replace(default.history, enabled=False),
        zenoh=replace(default.zenoh, listen=[endpoint]),
    )
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("imumon.daemon.daemon.create_device", lambda driver, options: QuickDevice(options))
        options = RunOptions(url=f"vn100:{directory / 'device'}", state_directory=directory)
        daemon = Daemon(settings, options)
        seen = {"light": 0, "fits": 0}

        def ended(turn: list[Call]) -> None:
            seen["light"] += is_light(turn)
            seen["fits"] += has_fits(turn)
            if min(seen.values()) >= 1 and any(map(is_drawn, traces["screen"].turns)):
                daemon._reader.stop()

        traces = {
            "loop": Trace(threading.main_thread().name, "daemon._handle", "sources.get", ended),
            "device": Trace("imumon-device", "sources._put_items", "sources.read"),
            "bus": Trace("imumon-bus", "bus._attempt"),
            "screen": Trace("screen", "tui.poll"),
        }

        def profile(frame: FrameType, event: str, argument: Any) -> None:
            for trace in traces.values():
                trace(frame, event, argument)

        ending = threading.Event()
        screen = threading.Thread(target=show, args=(endpoint, ending), name="screen")
        threading.setprofile(profile)
        sys.setprofile(traces["loop"])
        try:
            screen.start()
            daemon.run()
        finally:
            sys.setprofile(None)
            threading.setprofile(None)  # type: ignore[arg-type]
            ending.set()
            screen.join()
        yield traces


def packages_in(trace: Trace) -> set[str]:
    return {package for turn in trace.turns for stack, _ in turn for package in stack}


def test_no_package_returns_to_one_that_it_came_from(traces: dict[str, Trace]) -> None:
    """Of the packages on the stack, none is there twice, and each calls only those that come later on the way."""
    every = {stack for trace in traces.values() for turn in trace.turns for stack, _ in turn}
    assert not [stack for stack in every if len(stack) > len(set(stack))]
    stacks = {stack for turn in traces["loop"].turns for stack, _ in turn}
    on_the_way = [[WAY.index(package) for package in stack if package in WAY] for stack in stacks]
    assert not [stack for stack in on_the_way if stack != sorted(stack) and WAY.index("sources") not in stack]
    assert (packages_in(traces["device"]), packages_in(traces["bus"])) == ({"sources"}, {"bus"})


def test_a_block_goes_from_the_loop_into_the_record_and_a_report_from_there_to_the_bus(
    traces: dict[str, Trace],
) -> None:
    light = min(filter(is_light, traces["loop"].turns), key=len)
    assert list(dict.fromkeys(package for stack, _ in light for package in stack)) == ["daemon", "record"]
    published = next(filter(has_fits, traces["loop"].turns))
    entered = dict.fromkeys(package for stack, _ in published for package in stack if package in WAY[1:])
    assert list(entered) == ["daemon", "record", "bus"]


def test_a_report_goes_from_the_bus_to_the_screen(traces: dict[str, Trace]) -> None:
    """The screen asks for the reports once in a turn, and draws the newest: nothing else of imumon is on the way."""
    assert packages_in(traces["screen"]) == {"tui", "bus"}
    drawn = [name for _, name in next(filter(is_drawn, traces["screen"].turns))]
    assert drawn.count("bus.reports") == 1
    assert drawn.index("bus.report") < drawn.index("tui.allan_chart")


def test_a_block_makes_few_calls(traces: dict[str, Trace]) -> None:
    assert min(len(turn) for turn in traces["loop"].turns if is_light(turn)) <= LIGHT_CALLS


def test_a_report_with_new_fits_makes_few_calls_outside_of_the_mathematics(
    traces: dict[str, Trace],
) -> None:
    turns = filter(has_fits, traces["loop"].turns)
    calls = [sum(not name.startswith("noise.") for _, name in turn) for turn in turns]
    assert min(calls) <= RESULT_CALLS
