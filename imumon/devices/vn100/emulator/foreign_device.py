"""An impostor: a device on the line that is no VN-100.

What people plug in by mistake: a GNSS receiver that talks NMEA, something that makes no sense at all, or
something that is silent. None of them answers.
"""

from __future__ import annotations

from functools import reduce
from operator import xor

import numpy as np


class ForeignDevice:
    """Messages of something else, ten a second.

    Parameters
    ----------
    kind : ``nmea``, ``garbage`` or ``silent``.
    now : s, the clock at the start.
    """

    def __init__(self, kind: str, now: float) -> None:
        self._kind, self._start, self._count = kind, now, 0
        self._rng = np.random.default_rng(1)

    def messages(self, now: float) -> list[bytes]:
        """What it sends up to `now` and has not sent yet."""
        first, self._count = self._count, int((now - self._start) * 10)
        if self._kind == "silent":
            return []
        if self._kind == "garbage":
            return [
                self._rng.integers(0, 256, 64, dtype=np.uint8).tobytes() for _ in range(first, self._count)
            ]
        return [_nmea(number) for number in range(first, self._count)]


def _nmea(number: int) -> bytes:
    second, tenth = divmod(number, 10)
    body = f"GPGGA,1200{second % 60:02d}.{tenth}0,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()
