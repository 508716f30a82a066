"""Process of an emulator: its loop, and its start from another process.

The child exits at the end of its standard input, so that it exits with its parent, however the parent ends.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import time

from imumon.sources.device import InvalidOption
from imumon.sources.vn100.emulator.emulator_settings import EmulatorSettings
from imumon.sources.vn100.registers import FACTORY_BAUD

_STOP_S = 2.0
"""s that the emulator may take to exit before it is killed."""


def run(settings: EmulatorSettings, inputs: tuple[int, ...] = ()) -> int:
    """Run until SIGTERM, SIGINT, or the end of one of the inputs; return the exit code.

    The first line printed is the path of the terminal.
    """
    stop: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda received, _: stop.append(received))
    try:
        # it needs numpy, which the parser of the options does not: the manual page is built without
        from imumon.sources.vn100.emulator.emulator import Emulator

        emulator = Emulator(settings, time.monotonic())
    except (InvalidOption, OSError) as error:
        text = f"--link {settings.link}: {error.strerror}" if isinstance(error, OSError) else error
        print(f"imumon sim: {text}", file=sys.stderr)
        return 2
    if emulator.device.baud != (settings.baud or FACTORY_BAUD):
        print(
            f"imumon sim: {settings.rate:g} Hz needs {emulator.device.baud} baud: the line has them",
            file=sys.stderr,
        )
    with contextlib.suppress(BrokenPipeError):  # what started it was interrupted: then its input ends
        os.write(sys.stdout.fileno(), f"{emulator.terminal.path}\n".encode())
    try:
        while not stop and not emulator.turn([*inputs]):  # nothing is written to the inputs: they end
            pass
    finally:
        emulator.close()
    return 130 if signal.SIGINT in stop else 0


class EmulatorProcess:
    """A running emulator.

    Attributes
    ----------
    path : of the pseudo-terminal.
    pid : of the process.

    Raises
    ------
    InvalidOption : the emulator did not start.
    """

    def __init__(self, settings: EmulatorSettings) -> None:
        self._process = start_process(settings)
        self.pid = self._process.pid
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._output = self._process.stdin, self._process.stdout
        self.path = self._output.readline().strip()
        if not self.path:
            self.close()
            raise InvalidOption("emulator_not_started", "the emulator did not start", "see its own message")

    def close(self) -> None:
        """Stop the emulator and wait for its exit."""
        self._input.close()
        self._output.close()
        try:
            self._process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> EmulatorProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def start_process(settings: EmulatorSettings) -> subprocess.Popen[str]:
    """Start the process of an emulator, whose standard input and output are pipes."""
    command = [sys.executable, "-P", "-m", "imumon.sources.vn100.emulator", pickle.dumps(settings).hex()]
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )


def spawn(settings: EmulatorSettings | None = None) -> EmulatorProcess:
    """Return an emulator in a separate process, which exits with its parent."""
    return EmulatorProcess(settings or EmulatorSettings())
