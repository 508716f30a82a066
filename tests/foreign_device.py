"""Devices on a serial line that are no VN-100 and answer nothing: a GNSS receiver, unrelated bytes, silence, text."""

from __future__ import annotations

import os
import random
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import reduce
from operator import xor

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


@contextmanager
def on_a_terminal(kind: str) -> Iterator[str]:
    """Yield the path of a terminal on which the device sends."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    ended = threading.Event()

    def send() -> None:
        number = 0
        while not ended.wait(1.0 / RATE_HZ):
            with suppress(BlockingIOError):  # nobody reads: it is lost
                os.write(master, message(kind, number))
            number += 1

    sender = threading.Thread(target=send)
    sender.start()
    try:
        yield os.ttyname(slave)
    finally:
        ended.set()
        sender.join()
        os.close(master)
        os.close(slave)
