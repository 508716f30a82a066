"""Devices on a serial line that are no VN-100 and answer nothing: a GNSS receiver, unrelated bytes, silence, text."""

from __future__ import annotations

import os
import random
from functools import reduce
from operator import xor

from emulated_sensor import EmulatedSensor

RATE_HZ = 10


def message(kind: str, number: int) -> bytes:
    """Return what the device sends as its message of this number."""
    if kind == "silent":
        return b""
    if kind == "garbage":
        return random.Random(number).randbytes(64)
    if kind == "text":
        return b"temp=21.5C humidity=40% ok\r\n"
    second, tenth = divmod(number, RATE_HZ)
    body = f"GPGGA,1200{second % 60:02d}.{tenth}0,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()


class ForeignDevice(EmulatedSensor):
    """One of them on a terminal."""

    rate_hz = RATE_HZ

    def __init__(self, kind: str) -> None:
        self._kind = kind
        super().__init__()

    def step(self) -> None:
        for number in self.due():
            os.write(self._master or 0, message(self._kind, number))
