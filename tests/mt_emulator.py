"""Emulator of an Xsens MTi on a pseudo-terminal: states, output configuration, noise, and some faults."""

from __future__ import annotations

import math
import os
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from emulated_sensor import EmulatedSensor

from imumon.model.units import STANDARD_GRAVITY
from imumon.sources.xsens.mt_decoder import COUNTER, TICKS, MtDecoder
from imumon.sources.xsens.mt_messages import (
    EVERY_PACKET,
    TICK_S,
    DataId,
    Message,
    MessageId,
    encode,
    outputs,
)

GYRO_N, ACCEL_N = 1.7e-4, 1.2e-3
"""rad/s/√Hz and m/s²/√Hz: 0.01 °/s/√Hz and 120 µg/√Hz, the order of size of a data sheet of this class."""
TEMPERATURE = 31.5
"""degC."""
FACTORY = bytes.fromhex("1020ffff1060ffff2010006440200064802000640810000ae020ffff")
"""Output configuration before anybody changes it: point samples and an orientation at 100 Hz."""


class MtEmulator(EmulatedSensor):
    """An MTi.

    Parameters
    ----------
    seed : of the noise.
    configuration : output configuration at the start.

    Attributes
    ----------
    configuration : that it has now.
    measuring : it is in the measurement state.
    """

    def __init__(
        self, *, link: Path | None = None, seed: int | None = None, configuration: bytes = FACTORY
    ) -> None:
        self.configuration, self.measuring = configuration, True
        self.product, self.serial, self.firmware = (
            b"MTi-300-2A5G4",
            bytes.fromhex("037003F8"),
            bytes((1, 8, 2)),
        )
        self._random, self._received = np.random.default_rng(seed), MtDecoder()
        super().__init__(link)

    @property
    def rate_hz(self) -> int:  # type: ignore[override]
        """Rate of the messages: that of the fastest field."""
        return max((rate for _, rate in outputs(self.configuration) if rate < EVERY_PACKET), default=0)

    def step(self) -> None:
        numbers = self.due()
        if self._master is None:
            return
        with suppress(BlockingIOError):
            for item in self._received.feed(os.read(self._master, 4096)):
                if isinstance(item, Message):
                    os.write(self._master, self._reply(item))
        for k in numbers if self.measuring else ():
            os.write(self._master, encode(MessageId.DATA, self._packet(k)))

    def _reply(self, message: Message) -> bytes:
        """Return the reply to a message; in the measurement state only `GO_TO_CONFIG` has one."""
        replies: dict[int, Callable[[], bytes]] = {
            MessageId.REQUEST_DEVICE: lambda: self.serial,
            MessageId.REQUEST_PRODUCT: lambda: self.product,
            MessageId.REQUEST_FIRMWARE: lambda: self.firmware,
            MessageId.OUTPUT_CONFIGURATION: lambda: self._configured(message.data),
            MessageId.GO_TO_MEASUREMENT: lambda: b"",
            MessageId.GO_TO_CONFIG: lambda: b"",
        }
        if self.measuring and message.id != MessageId.GO_TO_CONFIG:
            return b""
        if message.id not in replies:
            return encode(MessageId.ERROR, b"\x04")  # invalid message
        self.measuring = message.id == MessageId.GO_TO_MEASUREMENT
        # the rate may have changed: packets that are due by it were never made
        self._sent = int((time.monotonic() - self._begin) * self.rate_hz)
        return encode(message.id + 1, replies[message.id]())

    def _configured(self, data: bytes) -> bytes:
        self.configuration = data or self.configuration
        return self.configuration

    def _packet(self, k: int) -> bytes:
        """Return the fields of packet `k`."""
        rate = self.rate_hz
        sigma = math.sqrt(rate)
        gyro = self._random.normal(0.0, GYRO_N * sigma, 3)
        accel = self._random.normal((0.0, 0.0, STANDARD_GRAVITY), ACCEL_N * sigma)
        half = gyro / rate / 2.0
        numbers: dict[int, Sequence[float]] = {
            DataId.TEMPERATURE: (TEMPERATURE,),
            DataId.DELTA_V: (accel / rate).tolist(),
            DataId.ACCELERATION: accel.tolist(),
            DataId.RATE_OF_TURN: gyro.tolist(),
            DataId.DELTA_Q: (math.sqrt(1.0 - float(half @ half)), *half.tolist()),
        }
        parts = []
        for name, field_rate in outputs(self.configuration):
            if field_rate == EVERY_PACKET or k % max(1, rate // field_rate) == 0:
                if name == DataId.PACKET_COUNTER:
                    content = struct.pack(">H", k % COUNTER)
                elif name == DataId.SAMPLE_TIME_FINE:
                    content = struct.pack(">I", round(k / rate / TICK_S) % TICKS)
                elif name == DataId.STATUS_WORD:
                    content = bytes(4)
                elif name in numbers:
                    values = numbers[name]
                    content = struct.pack(f">{len(values)}f", *values)
                else:
                    continue  # of a field that imumon does not read
                parts.append(struct.pack(">HB", name, len(content)) + content)
        return b"".join(parts)
