"""An emulated VN-100 with faults: of the cable, the sensor and its clock, in a process that takes commands.

    with spawn(EmulatorSettings(seed=1)) as sensor:
        sensor.ask("fault drop=0.2")

Each command is answered by the counters, in messages: made + replies + duplicated = sent + lost + dropped + unheard +
held. ``lost`` were removed by faults, ``dropped`` found the terminal full, ``unheard`` found no client, ``held`` wait
for the end of a stall. ``unread`` bytes wait for the client.

| command | effect |
|---|---|
| ``counters`` | none |
| ``fault drop=0.01,...`` | these probabilities of `FAULTS`, and no other one |
| ``stall S`` | bytes are held back, then arrive at once |
| ``silence S`` | nothing arrives, and it is lost |
| ``jump S`` | the sensor clock jumps |
| ``reboot`` | power interruption: silence, then a start with the saved registers |
| ``unplug``, ``replug`` | the terminal hangs up; another one replaces it |
"""

from __future__ import annotations

import fcntl
import json
import os
import pickle
import random
import sys
import termios
import time
from collections import Counter
from math import inf
from typing import Any

import forked

from imumon.sources.vn100.emulator import EmulatorProcess, EmulatorSettings
from imumon.sources.vn100.emulator.emulator import Emulator
from imumon.sources.vn100.emulator.pseudo_terminal import PseudoTerminal
from imumon.sources.vn100.registers import LOOP_RATE

FAULTS = ("drop", "duplicate", "corrupt")
"""Of a message, and ``corrupt`` of a byte: lost, twice, another byte."""


class Unplugged:
    """The end of a cable: what is sent into it is lost."""

    has_client, full, path = True, False, ""

    def update_clients(self) -> None: ...
    def flush(self) -> None: ...
    def close(self) -> None: ...

    @property
    def descriptors(self) -> tuple[list[int], list[int]]:
        return [], []


class FaultySensor(Emulator):
    """The emulator, with what may happen to its messages."""

    def __init__(self, settings: EmulatorSettings, faults: dict[str, float]) -> None:
        self._now = time.monotonic()
        super().__init__(settings, self._now)
        self._faults, self._dice = faults, random.Random(settings.seed)
        self._stalled_until = self._silent_until = -inf
        self._held: list[tuple[bytes, int]] = []
        self._counts: Counter[str] = Counter()
        replies, receive = self.device.replies, self.device.receive

        def counted(now: float) -> list[bytes]:
            answers = replies(now)
            self._counts["replies"] += len(answers)
            return answers

        def received(data: bytes, now: float) -> None:
            if now >= self._silent_until:
                receive(data, now)

        self.device.replies, self.device.receive = counted, received  # type: ignore[method-assign]

    def step(self, now: float) -> float:
        self._now = now
        return super().step(now)

    def _send(self, messages: list[bytes], baud: int) -> None:
        self._counts["all"] += len(messages)
        for message in messages:
            copies = [] if self._now < self._silent_until else self._arriving(message)
            self._counts["lost"] += not copies
            self._counts["duplicated"] += len(copies) > 1
            self._held += [(copy, baud) for copy in copies]
        if self._now >= self._stalled_until:
            for copy, sent_at in self._held:
                self._write(copy, sent_at)
            self._held.clear()

    def _write(self, message: bytes, baud: int) -> None:
        if isinstance(self.terminal, Unplugged):
            self._counts["lost"] += 1
        elif self.terminal.write(message, baud):
            self._counts["sent"] += 1
            self._counts["bytes"] += len(message)
        else:
            self._counts["dropped" if self.terminal.has_client else "unheard"] += 1

    def _arriving(self, message: bytes) -> list[bytes]:
        """Return what arrives of one message: nothing, the message, or one with other bytes, perhaps twice."""
        struck = {name for name, p in self._faults.items() if name != "corrupt" and self._dice.random() < p}
        if "drop" in struck:
            return []
        data = bytearray(message)
        if probability := self._faults.get("corrupt"):
            for place in range(len(data)):
                if self._dice.random() < probability:
                    data[place] ^= self._dice.randrange(1, 256)
        return [bytes(data)] * (2 if "duplicate" in struck else 1)

    def execute(self, text: str) -> dict[str, object]:
        """Execute a command; return the counters."""
        command, _, argument = text.partition(" ")
        now = time.monotonic()
        match command:
            case "counters":
                pass
            case "fault":
                pairs = [part.split("=") for part in argument.split(",") if part]
                self._faults = {name: float(probability) for name, probability in pairs}
                assert set(self._faults) <= set(FAULTS)
            case "stall":
                self._stalled_until = now + float(argument)
            case "silence":
                self._silent_until = now + float(argument)
            case "jump":
                self.device.outputs.start_tick -= round(float(argument) * LOOP_RATE)
            case "reboot":
                self.device.restart(now)
            case "unplug":
                self.terminal.close()
                self.terminal = Unplugged()  # type: ignore[assignment]
            case "replug":
                self.terminal = PseudoTerminal(
                    self.device.baud, self._settings.link, self._settings.time_lapse
                )
            case _:
                raise ValueError(command)
        return self._counted()

    def _counted(self) -> dict[str, object]:
        names = ("replies", "duplicated", "sent", "lost", "dropped", "unheard", "bytes")
        return {
            **{name: self._counts[name] for name in names},
            "made": self._counts["all"] - self._counts["replies"],
            "held": len(self._held),
            "unread": self._unread(),
            "ticks": self.device.outputs.tick,
            "path": self.terminal.path,
        }

    def _unread(self) -> int:
        if isinstance(self.terminal, Unplugged):
            return 0
        # asked of the slave: the kernel does not count on the master what waits for a client
        slave = os.open(self.terminal.path, os.O_RDONLY | os.O_NOCTTY)
        waiting = fcntl.ioctl(slave, termios.FIONREAD, bytes(4))
        os.close(slave)
        return len(self.terminal._pending) + int.from_bytes(waiting, sys.byteorder)


class FaultySensorProcess(EmulatorProcess):
    """A running sensor with faults."""

    def __init__(self, settings: EmulatorSettings, faults: dict[str, float]) -> None:
        self._process = forked.ForkedEmulator((settings, faults), __name__)  # type: ignore[assignment]
        self.pid = self._process.pid
        self._input, self._output = self._process.stdin, self._process.stdout  # type: ignore[assignment]
        self.path = self._output.readline().strip()

    def ask(self, command: str) -> dict[str, Any]:
        """Execute a command; return the counters."""
        self._input.write(command + "\n")
        self._input.flush()
        answer: dict[str, Any] = json.loads(self._output.readline())
        return answer


def spawn(settings: EmulatorSettings, **faults: float) -> FaultySensorProcess:
    """Return a sensor in a process of its own, which exits with this one."""
    return FaultySensorProcess(settings, faults)


def serve(sensor: FaultySensor) -> None:
    """Run until the end of the standard input."""
    os.write(1, f"{sensor.terminal.path}\n".encode())
    lines = b""
    while True:
        if sensor.turn([0]):
            data = os.read(0, 4096)
            if not data:
                return
            *complete, lines = (lines + data).split(b"\n")
            for line in complete:
                os.write(1, json.dumps(sensor.execute(line.decode())).encode() + b"\n")


if __name__ == "__main__":
    running = FaultySensor(*pickle.loads(bytes.fromhex(sys.argv[1])))
    try:
        serve(running)
    finally:
        running.close()
