"""Emulator: device, serial line and faults, driven by a clock that is passed in.

The sensor clock follows the host clock: tick t is due at start + t / 800 s, whatever the loop did in the
meantime, so nothing drifts. In time-lapse the sensor clock runs faster, the baud does not pace the line, and
the clock stops while the reader has not read what was sent, or while there is no reader.
"""

from __future__ import annotations

from math import inf

import numpy as np

from imumon.devices.base import InvalidOption
from imumon.devices.vn100 import registers
from imumon.devices.vn100.emulator.command_handler import CommandHandler
from imumon.devices.vn100.emulator.emulator_settings import EmulatorSettings
from imumon.devices.vn100.emulator.faults import Faults, ForeignDevice
from imumon.devices.vn100.emulator.output_streams import MOST_TICKS
from imumon.devices.vn100.emulator.sensor_model import SensorModel
from imumon.devices.vn100.emulator.uart import PseudoTerminal, Uart
from imumon.devices.vn100.registers import RegisterNumber

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
    """Device, serial line and faults.

    Parameters
    ----------
    now : s, host clock at the start.

    Raises
    ------
    InvalidOption : the rate does not fit the baud, or the link cannot be created.

    Attributes
    ----------
    terminal : the pseudo-terminal that clients open.
    """

    def __init__(self, settings: EmulatorSettings, now: float) -> None:
        self._settings = settings
        self._device = make_device(settings)
        self._foreign_device = ForeignDevice(settings.impostor, now) if settings.impostor else None
        self._rng = np.random.default_rng(settings.seed)
        self._faults = settings.faults
        self._uart = Uart(self._device.baud, pacing=not settings.time_lapse)
        self.terminal = PseudoTerminal(self._device.baud, settings.link, self._rng, not settings.time_lapse)
        self._plugged = True
        self._ticks_per_s = registers.LOOP_RATE * settings.speed
        self._start, self._last_step = now, now
        self._stalled_until = self._silent_until = -inf
        self._cut_next = False
        self._made = self._replies = self._duplicated = self._lost = 0

    def step(self, now: float) -> float:
        """Do what is due at `now` (s); return when to call again unless input arrives before."""
        uart, device = self._uart, self._device
        if self._plugged:
            self.terminal.update_clients()
        self._send(self._advance(now), now)
        replies = device.replies(now)
        self._replies += len(replies)
        self._send([(now, reply) for reply in replies], now)
        uart.baud = device.baud
        transmitted = [] if now < self._stalled_until else uart.transmitted(now)
        if self._plugged:
            self.terminal.write(transmitted)
        else:
            self._lost += len(transmitted)
        return self._next_step(now)

    def _advance(self, now: float) -> list[tuple[float, bytes]]:
        """Run the sensor up to `now`; return its messages, each with the time (s) at which it was made."""
        outputs = self._device.outputs
        time_lapse = self._settings.time_lapse
        waits = self.terminal.full or not self.terminal.has_client or now < self._stalled_until
        if time_lapse and self._plugged and waits:  # a later start is a sensor clock that stood still
            self._start += now - self._last_step
        self._last_step = now
        target = int((now - self._start) * self._ticks_per_s)
        most = outputs.tick + MOST_TICKS
        if time_lapse and target > most:  # a machine that is too slow gets less time-lapse, not a backlog
            self._start += (target - most) / self._ticks_per_s
            target = most
        messages = self._device.advance(target)
        if self._foreign_device is not None:
            messages = [(outputs.tick, message) for message in self._foreign_device.messages(now)]
        self._made += len(messages)
        return [(self._start + tick / self._ticks_per_s, message) for tick, message in messages]

    def _send(self, messages: list[tuple[float, bytes]], now: float) -> None:
        """Queue messages on the line after the faults have acted on them."""
        if now < self._silent_until:
            self._lost += len(messages)
            return
        for made_at, message in messages:
            if self._cut_next:
                message, self._cut_next = message[: len(message) // 2], False
            copies = self._faults.apply(message, self._rng)
            self._lost += not copies
            self._duplicated += len(copies) > 1
            for copy in copies:
                self._uart.queue(copy, made_at)

    def _next_step(self, now: float) -> float:
        earliest = now + (_STEP_TIME_LAPSE_S if self._settings.time_lapse else _STEP_S)
        # + 1: the message of a tick is complete when the tick is over
        times = [now + IDLE_S, self._start + (self._device.outputs.next_tick() + 1) / self._ticks_per_s]
        times += [t for t in (self._uart.next_transmitted(), self._device.next_reply()) if t is not None]
        return max(earliest, min(times))

    def read(self, now: float) -> None:
        """Read what a client has sent to the sensor."""
        data = self.terminal.read(self._device.baud)
        if data and self._foreign_device is None and now >= self._silent_until:
            self._device.receive(data, now)

    @property
    def descriptors(self) -> tuple[list[int], list[int]]:
        """Descriptors to wait for: until they are readable, and until they are writable."""
        if not self._plugged:
            return [], []
        return self.terminal.descriptors, [self.terminal.master] if self.terminal.pending else []

    @property
    def baud(self) -> int:
        return self._device.baud

    def close(self) -> None:
        """Close the terminal."""
        if self._plugged:
            self.terminal.close()

    def counters(self) -> dict[str, object]:
        """Return what was made, sent and lost so far.

        All but the last six are messages: made + replies + duplicated = sent + lost + dropped + unheard +
        overflowed + queued. ``lost`` were removed by faults, ``dropped`` found the terminal full, ``unheard``
        found no client, ``overflowed`` found the transmitter of the sensor full. ``bytes`` were written, ``unread`` of
        them wait for the client.
        """
        return {
            "made": self._made,
            "replies": self._replies,
            "duplicated": self._duplicated,
            "sent": self.terminal.sent,
            "lost": self._lost,
            "dropped": self.terminal.dropped,
            "unheard": self.terminal.unheard,
            "overflowed": self._uart.overflowed,
            "queued": len(self._uart),
            "bytes": self.terminal.sent_bytes,
            "unread": self.terminal.unread if self._plugged else 0,  # else its descriptors are closed
            "ticks": self._device.outputs.tick,
            "restarts": self._device.restarts,
            "baud": self.baud,
            "path": self.terminal.path,
        }

    def execute(self, text: str, now: float) -> dict[str, object]:
        """Execute a line of the control channel; return the counters.

        ``counters`` · ``fault NAME=P,...`` · ``stall S`` (bytes are held back, then arrive at once) ·
        ``silence S`` (nothing arrives, and it is lost) · ``jump S`` (the sensor clock jumps) · ``cut`` (the
        next message ends in its middle) · ``reboot`` · ``unplug`` · ``replug``.
        """
        command, _, argument = text.strip().partition(" ")
        try:
            match command:
                case "counters":
                    pass
                case "fault":
                    self._faults = Faults.parse(argument)
                case "stall":
                    self._stalled_until = now + float(argument)
                case "silence":
                    self._silent_until = now + float(argument)
                case "jump":
                    self._device.outputs.shift_clock(float(argument))
                case "cut":
                    self._cut_next = True
                case "reboot":
                    self._device.restart(now)
                case "unplug" | "replug":
                    if self._plugged:
                        self.terminal.unplug()
                    self._plugged = command == "replug"
                    if self._plugged:
                        self.terminal.replug(self._device.baud)
                case _:
                    raise ValueError(f"{command!r} is not a command")
        except ValueError as error:
            return {"error": str(error)}
        return self.counters()
