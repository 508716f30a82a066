"""Emulator: device and pseudo-terminal, driven by a clock that is passed in.

The sensor clock follows the host clock: tick t is due at start + t / 800 s, whatever the loop did in the meantime, so
nothing drifts. In time-lapse the sensor clock runs faster, and stops while the reader has not read what was sent, or
while there is no reader.
"""

from __future__ import annotations

import select
import time

from imumon.sources.device import InvalidOption
from imumon.sources.vn100 import registers
from imumon.sources.vn100.emulator.command_handler import CommandHandler
from imumon.sources.vn100.emulator.emulator_settings import EmulatorSettings
from imumon.sources.vn100.emulator.output_streams import MOST_TICKS
from imumon.sources.vn100.emulator.pseudo_terminal import PseudoTerminal
from imumon.sources.vn100.emulator.sensor_model import SensorModel
from imumon.sources.vn100.registers import RegisterNumber

TIME_AND_DELTAS = ("06", "0001", "00C0")
"""Groups and field words of TimeStartup, DeltaTheta and DeltaVel: 44 bytes."""

IDLE_S = 0.05
"""s, longest time between two steps."""

_STEP_S, _STEP_TIME_LAPSE_S = 0.004, 0.016
"""s, shortest time between two steps, in real time and in time-lapse."""


def make_device(settings: EmulatorSettings) -> CommandHandler:
    """Return a device that streams at the configured rate and baud.

    Raises
    ------
    InvalidOption : the rate does not fit the baud.
    """
    device = CommandHandler(settings, SensorModel(settings))
    candidates = (
        [settings.baud]
        if settings.baud
        # 128000 has no constant in termios: no client on Linux could open it
        else [b for b in registers.BAUDS if b >= registers.FACTORY_BAUD and b != 128000]
    )
    for baud in candidates:
        device.set_register(RegisterNumber.BAUD, str(baud))
        if settings.rate in registers.ASCII_RATES:
            device.set_register(RegisterNumber.OUTPUT_RATE, str(int(settings.rate)))
        elif settings.rate:
            device.set_register(RegisterNumber.OUTPUT_TYPE, "0")
            divisor = str(round(registers.LOOP_RATE / settings.rate))
            device.set_register(
                registers.BINARY_OUTPUTS[0], str(settings.serial_port), divisor, *TIME_AND_DELTAS
            )
        else:
            device.set_register(RegisterNumber.OUTPUT_TYPE, "0")
        if device.outputs.bytes_per_second() <= baud / 10:
            return device
    text = f"--rate {settings.rate:g} does not fit --baud {candidates[-1]}"
    raise InvalidOption("rate_does_not_fit", text, "give a higher baud or a lower rate")


class Emulator:
    """Device on a pseudo-terminal.

    Parameters
    ----------
    now : s, host clock at the start.

    Raises
    ------
    InvalidOption : the rate does not fit the baud, or the link cannot be created.

    Attributes
    ----------
    device : what answers commands and sends measurements.
    terminal : the pseudo-terminal that clients open.
    """

    def __init__(self, settings: EmulatorSettings, now: float) -> None:
        self._settings = settings
        self.device = make_device(settings)
        self.terminal = PseudoTerminal(self.device.baud, settings.link, settings.time_lapse)
        self._ticks_per_s = registers.LOOP_RATE * settings.speed
        self._start, self._last_step, self._due = now, now, now

    def step(self, now: float) -> float:
        """Do what is due at `now` (s); return when to call again unless input arrives before."""
        self.terminal.update_clients()
        baud = self.device.baud  # a reply has the baud of its command
        messages = [message for _, message in self.device.advance(self._due_tick(now))]
        self._send([*messages, *self.device.replies(now)], baud)
        self.terminal.flush()
        return self._next_step(now)

    def _due_tick(self, now: float) -> int:
        """Return the tick up to which the sensor runs."""
        outputs, time_lapse = self.device.outputs, self._settings.time_lapse
        if time_lapse and (self.terminal.full or not self.terminal.has_client):
            self._start += now - self._last_step  # a later start is a sensor clock that stood still
        self._last_step = now
        target = int((now - self._start) * self._ticks_per_s)
        most = outputs.tick + MOST_TICKS
        if time_lapse and target > most:  # a machine that is too slow gets less time-lapse, not a backlog
            self._start += (target - most) / self._ticks_per_s
            target = most
        return target

    def _send(self, messages: list[bytes], baud: int) -> None:
        for message in messages:
            self.terminal.write(message, baud)

    def _next_step(self, now: float) -> float:
        earliest = now + (_STEP_TIME_LAPSE_S if self._settings.time_lapse else _STEP_S)
        # + 1: the message of a tick is complete when the tick is over
        times = [now + IDLE_S, self._start + (self.device.outputs.next_tick() + 1) / self._ticks_per_s]
        return max(earliest, min(times))

    def turn(self, others: list[int]) -> list[int]:
        """Do what is due, wait for input or until more is due, and read; return which `others` are readable."""
        if (now := time.monotonic()) >= self._due:
            self._due = self.step(now)
        readable, writable = self.terminal.descriptors
        timeout = max(0.0, self._due - time.monotonic())
        ready, ready_to_write, _ = select.select([*readable, *others], writable, [], timeout)
        if ready_to_write:
            self.terminal.flush()
        if set(readable) & set(ready):
            self._due = time.monotonic()
            self.device.receive(self.terminal.read(self.device.baud), self._due)
        return [descriptor for descriptor in others if descriptor in ready]

    def close(self) -> None:
        """Close the terminal."""
        self.terminal.close()
