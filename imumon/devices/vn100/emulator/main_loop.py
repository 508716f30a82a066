"""The emulator at work: device, line and control in one loop.

The sensor's clock follows the room's: tick t is due at start + t / 800 s, whatever the loop did meanwhile,
so nothing drifts; a loop that was kept from running makes up for it at twice the pace. In time-lapse it runs
faster, without pacing, and stands still as long as its reader has not taken what there is, or none is there.
Messages are made in batches of a few milliseconds.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal as signals
import sys
import time

import numpy as np

from imumon.devices.vn100.emulator.command_handler import CommandHandler
from imumon.devices.vn100.emulator.control import Control
from imumon.devices.vn100.emulator.emulator_settings import EmulatorSettings
from imumon.devices.vn100.emulator.faults import Faults
from imumon.devices.vn100.emulator.foreign_device import ForeignDevice
from imumon.devices.vn100.emulator.sensor_model import SensorModel
from imumon.devices.vn100.emulator.uart import Terminal, Uart
from imumon.devices.vn100.registers import (
    ASCII_RATES,
    BAUD,
    BAUDS,
    BINARY_OUTPUTS,
    FACTORY_BAUD,
    LOOP_RATE,
    OUTPUT_RATE,
    OUTPUT_TYPE,
)

TIME_AND_DELTAS = ("06", "0001", "00C0")
"""Groups and field words of TimeStartup, DeltaTheta and DeltaVel: 44 bytes."""

BATCH_S, BATCH_LAPSE_S = 0.004, 0.016
"""Shortest time between two rounds of the loop, at the room's pace and in time-lapse."""

IDLE_S = 0.05
_LAPSE_TICKS = 1 << 14
CATCH_UP = 2.0


class Clock:
    """The room's time, s, as the loop follows it: where it was kept from running, at twice the pace.

    All that was due meanwhile would come at once else, which no line can bring and no terminal can hold, and
    the reader would be blamed for what is lost.
    """

    def __init__(self) -> None:
        self._room = self._shown = time.monotonic()

    def __call__(self) -> float:
        before, self._room = self._room, time.monotonic()
        self._shown = min(self._room, self._shown + CATCH_UP * min(self._room - before, IDLE_S))
        return self._shown


def make_device(settings: EmulatorSettings) -> CommandHandler:
    """Device that streams at the rate and baud that were asked for.

    Raises
    ------
    ValueError
        The rate does not fit the baud.
    """
    device = CommandHandler(settings, SensorModel(settings))
    candidates = [settings.baud] if settings.baud else [b for b in BAUDS if b >= FACTORY_BAUD and b != 128000]
    for baud in candidates:
        device.set(BAUD, str(baud))
        if settings.rate in ASCII_RATES:
            device.set(OUTPUT_RATE, str(int(settings.rate)))
        elif settings.rate:
            device.set(OUTPUT_TYPE, "0")
            divisor = str(round(LOOP_RATE / settings.rate))
            device.set(BINARY_OUTPUTS[0], str(settings.serial_port), divisor, *TIME_AND_DELTAS)
        else:
            device.set(OUTPUT_TYPE, "0")
        if device.sensor.load() <= baud / 10:
            return device
    raise ValueError(
        f"--rate {settings.rate:g} does not fit --baud {candidates[-1]}: give a higher baud or a lower rate"
    )


class Emulator:
    """Device, line and faults, driven by the clock that is handed in.

    Parameters
    ----------
    now : s, the room's clock at the start.
    """

    def __init__(self, settings: EmulatorSettings, now: float) -> None:
        self._settings = settings
        self._device = make_device(settings)
        self._impostor = ForeignDevice(settings.impostor, now) if settings.impostor else None
        self._rng = np.random.default_rng(settings.seed)
        self._faults = settings.faults
        self._uart = Uart(self._device.baud, pacing=not settings.time_lapse)
        self.terminal = Terminal(self._device.baud, settings.link, self._rng, not settings.time_lapse)
        self._plugged = True
        self._pace = LOOP_RATE * settings.speed
        self._origin, self._last = now, now
        self._stalled = self._silent = float("-inf")
        self._cut_next = False
        self.made = self.replied = self.duplicated = self.lost = 0

    def round(self, now: float) -> float:
        """Do what is due at `now` (s); returns when to come again unless something is read before."""
        uart, device = self._uart, self._device
        if self._plugged:
            self.terminal.look()
        waits = self.terminal.full or not self.terminal.heard or now < self._stalled
        if self._settings.time_lapse and self._plugged and waits:
            self._origin += now - self._last
        self._last = now
        target = int((now - self._origin) * self._pace)
        if self._settings.time_lapse and target > device.sensor.tick + _LAPSE_TICKS:
            self._origin += (target - device.sensor.tick - _LAPSE_TICKS) / self._pace
            target = device.sensor.tick + _LAPSE_TICKS
        messages = device.advance(target)
        if self._impostor is not None:
            messages = [(device.sensor.tick, message) for message in self._impostor.messages(now)]
        self.made += len(messages)
        self._emit([(self._origin + tick / self._pace, message) for tick, message in messages], now)
        replies = device.replies(now)
        self.replied += len(replies)
        self._emit([(now, reply) for reply in replies], now)
        uart.baud = device.baud
        due = [] if now < self._stalled else uart.due(now)
        if self._plugged:
            self.terminal.write(due)
        else:
            self.lost += len(due)
        return self._next(now)

    def _emit(self, messages: list[tuple[float, bytes]], now: float) -> None:
        """Put messages, each with the time it was made at, on the line, or what the faults leave of them."""
        if now < self._silent:
            self.lost += len(messages)
            return
        for at, message in messages:
            if self._cut_next:
                message, self._cut_next = message[: len(message) // 2], False
            arriving = self._faults.apply(message, self._rng) if self._faults else [message]
            self.lost += not arriving
            self.duplicated += len(arriving) > 1
            for each in arriving:
                self._uart.put(each, at)

    def _next(self, now: float) -> float:
        soon = now + (BATCH_LAPSE_S if self._settings.time_lapse else BATCH_S)
        times = [now + IDLE_S, self._origin + (self._device.sensor.next_tick() + 1) / self._pace]
        times += [t for t in (self._uart.next(), self._device.due()) if t is not None]
        return max(soon, min(times))

    def read(self, now: float) -> None:
        """The terminal has something for the sensor."""
        data = self.terminal.read(self._device.baud)
        if data and self._impostor is None and now >= self._silent:
            self._device.receive(data, now)

    @property
    def wants(self) -> tuple[list[int], list[int]]:
        """Descriptors to wait for: readable and writable ones."""
        if not self._plugged:
            return [], []
        return self.terminal.descriptors, [self.terminal.master] if self.terminal.waiting else []

    @property
    def baud(self) -> int:
        return self._device.baud

    def close(self) -> None:
        """Take the terminal away."""
        if self._plugged:
            self.terminal.close()

    def counters(self) -> dict[str, object]:
        """What was made, sent and lost so far.

        All but the last five are messages: made + replies + duplicated = sent + lost + dropped + unheard +
        overflowed + queued. ``lost`` are those that faults took, ``dropped`` those that found the terminal
        full, ``unheard`` those that found no client, ``overflowed`` those that the line was too slow for.
        """
        return {
            "made": self.made,
            "replies": self.replied,
            "duplicated": self.duplicated,
            "sent": self.terminal.sent,
            "lost": self.lost,
            "dropped": self.terminal.dropped,
            "unheard": self.terminal.unheard,
            "overflowed": self._uart.overflowed,
            "queued": len(self._uart),
            "bytes": self.terminal.sent_bytes,
            "ticks": self._device.sensor.tick,
            "restarts": self._device.restarts,
            "baud": self.baud,
            "path": self.terminal.path,
        }

    def command(self, text: str, now: float) -> dict[str, object]:
        """Obey a line of the control channel; the answer tells the counters.

        ``counters`` · ``fault NAME=P,...`` · ``stall S`` (bytes are held back, then come at once) ·
        ``silence S`` (nothing comes, and it is lost) · ``jump S`` (the sensor's clock leaps) · ``cut`` (the
        next message ends in its middle) · ``reboot`` · ``unplug`` · ``replug``.
        """
        word, _, rest = text.strip().partition(" ")
        try:
            if word == "fault":
                self._faults = Faults.parse(rest)
            elif word == "stall":
                self._stalled = now + float(rest)
            elif word == "silence":
                self._silent = now + float(rest)
            elif word == "jump":
                self._device.sensor.jump(float(rest))
            elif word == "cut":
                self._cut_next = True
            elif word == "reboot":
                self._device.restart(now)
            elif word == "unplug" and self._plugged:
                self._plugged = False
                self.terminal.unplug()
            elif word == "replug":
                if self._plugged:
                    self.terminal.unplug()
                self.terminal.replug(self._device.baud)
                self._plugged = True
            elif word not in ("counters", "unplug"):
                raise ValueError(f"{word!r} is no command")
        except ValueError as error:
            return {"error": str(error)}
        return self.counters()


def _refuse(why: str) -> int:
    print(f"imumon sim: {why}", file=sys.stderr)
    return 2


def run(settings: EmulatorSettings) -> int:
    """Serve until SIGTERM, SIGINT or the end of the control input; returns the exit code.

    The terminal's path is the first line printed.
    """
    stop: list[int] = []
    for number in (signals.SIGTERM, signals.SIGINT, signals.SIGHUP):
        signals.signal(number, lambda received, _: stop.append(received))
    try:
        emulator = Emulator(settings, time.monotonic())
    except ValueError as error:
        return _refuse(str(error))
    except OSError as error:
        return _refuse(f"--link {settings.link}: {error.strerror}")
    try:
        control = Control(settings.control)
    except OSError as error:
        emulator.close()
        return _refuse(f"--control {settings.control}: {error.strerror}")
    if emulator.baud != (settings.baud or FACTORY_BAUD):
        print(f"imumon sim: {settings.rate:g} Hz needs {emulator.baud} baud", file=sys.stderr)
    print(emulator.terminal.path, flush=True)
    clock, again, ready = Clock(), 0.0, list[int]()
    try:
        while not stop and not control.ended:
            now = clock()
            if now >= again or ready:
                again = emulator.round(now)
            readable, writable = emulator.wants
            timeout = max(0.0, again - clock())
            ready, room, _ = select.select([*readable, *control.descriptors], writable, [], timeout)
            now = clock()
            if room:
                emulator.terminal.flush()
            if set(readable) & set(ready):
                emulator.read(now)
            for line, answer in control.lines(ready):
                with contextlib.suppress(OSError):
                    os.write(answer, json.dumps(emulator.command(line, now)).encode() + b"\n")
    finally:
        emulator.close()
        control.close()
    return 130 if signals.SIGINT in stop else 0
