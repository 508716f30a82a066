"""Sensors and other devices on a pseudo-terminal that run in a thread, lose samples, and can be unplugged."""

from __future__ import annotations

import os
import random
import threading
import time
import tty
from contextlib import suppress
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Self

PERIOD_S = 0.005
"""s between two turns of its loop."""


class EmulatedSensor:
    """What its messages are says a derived class in `step`. Its clock continues while it is unplugged.

    Parameters
    ----------
    link : symbolic link to its terminal; None: there is none.

    Attributes
    ----------
    path : of the terminal, or the link.
    rate_hz : messages a second.
    """

    rate_hz = 100.0

    def __init__(self, link: Path | None = None) -> None:
        self._link, self.path = link, ""
        self._lock, self._ending = threading.Lock(), threading.Event()
        self._begin, self._sent, self._hidden = time.monotonic(), 0, 0
        self._master: int | None = None
        self.replug()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self.unplug()

    def replug(self) -> None:
        """Open a terminal."""
        with self._lock:
            self._master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(self._master, False)
            self.path = os.ttyname(slave)
            os.close(slave)
            if self._link is not None:
                self._link.symlink_to(self.path)
                self.path = str(self._link)

    def unplug(self) -> None:
        """Hang up."""
        with self._lock:
            if self._master is not None:
                os.close(self._master)
                if self._link is not None:
                    self._link.unlink()
            self._master = None

    def lose_samples(self, count: int = 9) -> None:
        """Let some messages be lost."""
        self._hidden = count

    def step(self) -> None:
        """Send what is due, with `_lock`; what cannot be written is lost."""
        raise NotImplementedError

    def due(self) -> range:
        """Return the numbers of the messages since the last turn, without those that are to be lost."""
        until = int((time.monotonic() - self._begin) * self.rate_hz)
        first, self._sent = min(self._sent, until), until
        hidden = min(self._hidden, until - first)
        self._hidden -= hidden
        return range(first + hidden, until)

    def _run(self) -> None:
        while not self._ending.wait(PERIOD_S):
            with self._lock, suppress(OSError):
                self.step()


FOREIGN_HZ = 10
"""Hz, messages of devices on a serial line that are no VN-100 and answer nothing."""


def foreign_message(kind: str, number: int) -> bytes:
    """Return what the device sends as its message of this number."""
    if kind == "silent":
        return b""
    if kind == "garbage":
        return random.Random(number).randbytes(64)
    if kind == "text":
        return b"temp=21.5C humidity=40% ok\r\n"
    second, tenth = divmod(number, FOREIGN_HZ)
    body = f"GPGGA,1200{second % 60:02d}.{tenth}0,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()


class ForeignDevice(EmulatedSensor):
    """A GNSS receiver, unrelated bytes, silence or text on a terminal."""

    rate_hz = FOREIGN_HZ

    def __init__(self, kind: str) -> None:
        self._kind = kind
        super().__init__()

    def step(self) -> None:
        for number in self.due():
            os.write(self._master or 0, foreign_message(self._kind, number))
