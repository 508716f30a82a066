"""The emulator in a process of its own, for those who want a sensor without a cable.

The child reads commands on its standard input, and ends when that ends: a parent that is gone, however it
went, takes the emulator with it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from types import TracebackType
from typing import Any

from imumon.devices.vn100.emulator.emulator_settings import EmulatorSettings


class EmulatorProcess:
    """A running emulator.

    Attributes
    ----------
    path : of the pseudo-terminal, as it was at the start.
    pid : of the process.
    """

    def __init__(self, words: Sequence[str]) -> None:
        command = [sys.executable, "-P", "-m", "imumon.devices.vn100.emulator", *words, "--control", "-"]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        self.pid = self._process.pid
        assert self._process.stdout is not None
        self.path = self._process.stdout.readline().strip()
        if not self.path:
            self.close()
            raise ValueError("the emulator did not start; its own message says why")

    def ask(self, command: str) -> dict[str, Any]:
        """Obey a command of the control channel; the answer tells the counters.

        Raises
        ------
        ValueError
            The emulator does not know the command.
        ConnectionError
            It has gone.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise ConnectionError("the emulator has gone")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise ValueError(answer["error"])
        return answer

    def close(self) -> None:
        """End the emulator and wait until it has gone."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> EmulatorProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def spawn(settings: EmulatorSettings | None = None) -> EmulatorProcess:
    """Emulator in a process of its own; it ends with its parent."""
    return EmulatorProcess(replace(settings or EmulatorSettings(), control=None).arguments())
