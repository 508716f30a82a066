"""Main loop of the emulator process: terminal, control channel and signals in one `select` loop."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import sys
import time

from imumon.devices.base import InvalidOption
from imumon.devices.vn100.emulator.control import Control
from imumon.devices.vn100.emulator.emulator import IDLE_S, Emulator
from imumon.devices.vn100.emulator.emulator_settings import EmulatorSettings
from imumon.devices.vn100.registers import FACTORY_BAUD

CATCH_UP = 2.0
"""Speed at which the emulator catches up after its process was not scheduled, as a factor of real time."""


class CatchUpClock:
    """Host clock in s, which catches up at `CATCH_UP` times real time after the process was not scheduled.

    Otherwise all messages of the pause would be due at once: no line can carry them, no terminal can hold them.
    """

    def __init__(self) -> None:
        self._host = self._time = time.monotonic()

    def __call__(self) -> float:
        before, self._host = self._host, time.monotonic()
        self._time = min(self._host, self._time + CATCH_UP * min(self._host - before, IDLE_S))
        return self._time


def run(settings: EmulatorSettings) -> int:
    """Run until SIGTERM, SIGINT or the end of the control input; return the exit code.

    The first line printed is the path of the terminal.
    """
    stop: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda received, _: stop.append(received))
    try:
        emulator = Emulator(settings, time.monotonic())
    except (InvalidOption, OSError) as error:
        text = f"--link {settings.link}: {error.strerror}" if isinstance(error, OSError) else error
        print(f"imumon sim: {text}", file=sys.stderr)
        return 2
    try:
        control = Control(settings.control)
    except OSError as error:
        emulator.close()
        print(f"imumon sim: --control {settings.control}: {error.strerror}", file=sys.stderr)
        return 2
    if emulator.baud != (settings.baud or FACTORY_BAUD):
        print(f"imumon sim: {settings.rate:g} Hz needs {emulator.baud} baud", file=sys.stderr)
    with contextlib.suppress(BrokenPipeError):  # what started it was interrupted: then its control input ends
        os.write(sys.stdout.fileno(), f"{emulator.terminal.path}\n".encode())
    try:
        _loop(emulator, control, stop)
    finally:
        emulator.close()
        control.close()
    return 130 if signal.SIGINT in stop else 0


def _loop(emulator: Emulator, control: Control, stop: list[int]) -> None:
    """Serve clients and the control channel until `stop` has a signal or the control input ends."""
    clock, next_step, ready = CatchUpClock(), 0.0, list[int]()
    while not stop and not control.ended:
        now = clock()
        if now >= next_step or ready:
            next_step = emulator.step(now)
        readable, writable = emulator.descriptors
        timeout = max(0.0, next_step - clock())
        ready, ready_to_write, _ = select.select([*readable, *control.descriptors], writable, [], timeout)
        now = clock()
        if ready_to_write:
            emulator.terminal.flush()
        if set(readable) & set(ready):
            emulator.read(now)
        for line, descriptor in control.lines(ready):
            with contextlib.suppress(OSError):
                os.write(descriptor, json.dumps(emulator.execute(line, now)).encode() + b"\n")
