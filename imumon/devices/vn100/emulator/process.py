"""Emulator process: starts the emulator and sends commands to it.

The child reads commands from its standard input and exits at its end, so that it exits with its parent,
however the parent ends.
"""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from dataclasses import replace
from typing import Any

from imumon.devices.base import InvalidOption
from imumon.devices.vn100.emulator.emulator_settings import EmulatorSettings

_STOP_S = 2.0
"""s that the emulator may take to exit before it is killed."""


class EmulatorProcess:
    """A running emulator.

    Attributes
    ----------
    path : of the pseudo-terminal, as it was at the start.
    pid : of the process.

    Raises
    ------
    InvalidOption : the emulator did not start.
    """

    def __init__(self, settings: EmulatorSettings) -> None:
        self._process = start_process(replace(settings, control="-"))
        self.pid = self._process.pid
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._input, self._output = self._process.stdin, self._process.stdout
        self.path = self._output.readline().strip()
        if not self.path:
            self.close()
            raise InvalidOption("emulator_not_started", "the emulator did not start", "see its own message")

    def ask(self, command: str) -> dict[str, Any]:
        """Execute a command of the control channel; return the counters.

        Raises
        ------
        ValueError : the emulator does not know the command.
        ConnectionError : the emulator has exited.
        """
        self._input.write(command + "\n")
        self._input.flush()
        line = self._output.readline()
        if not line:
            raise ConnectionError("the emulator has exited")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer

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
    command = [sys.executable, "-P", "-m", "imumon.devices.vn100.emulator", pickle.dumps(settings).hex()]
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )


def spawn(settings: EmulatorSettings | None = None) -> EmulatorProcess:
    """Return an emulator in a separate process, which exits with its parent."""
    return EmulatorProcess(settings or EmulatorSettings())
