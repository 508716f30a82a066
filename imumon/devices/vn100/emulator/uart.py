"""The line: a pseudo-terminal for a serial port, and the time that bytes take on it.

`Uart` queues messages as a transmitter does: ten bits a byte at the baud, one message after the other.
`Terminal` is the pseudo-terminal: raw, its master never blocking, its slave kept open so that a client
that goes away takes nothing with it. What comes while no client is there is gone, as on a real line, and the
next one finds neither old bytes nor an exclusive claim (TIOCEXCL) of the last. Who sets another baud than the
sensor's reads garbage.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import termios
import tty
from collections import deque
from pathlib import Path

import numpy as np

from imumon.devices.vn100.emulator.pty_clients import PtyClients

OUTPUT_BUFFER = 2048
"""Bytes that the sensor holds for a line that is still busy."""

STAGED, STAGED_LAPSE = 4096, 1 << 17
"""Bytes held for a terminal that is full: then messages are dropped, or in time-lapse the sensor waits."""

_SPEEDS = {
    getattr(termios, f"B{baud}"): baud
    for baud in (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)
    if hasattr(termios, f"B{baud}")
}
_CODES = {baud: code for code, baud in _SPEEDS.items()}


class Uart:
    """Transmitter: when which message has left.

    Parameters
    ----------
    baud : of messages put from now on.
    pacing : whether bytes take time at all.
    """

    def __init__(self, baud: int, pacing: bool = True) -> None:
        self.baud, self._pacing = baud, pacing
        self._queue: deque[tuple[float, bytes, int]] = deque()
        self._free = float("-inf")
        self.overflowed = 0

    def put(self, message: bytes, at: float) -> None:
        """Queue a message that was made at `at` (s); what the buffer cannot hold is lost."""
        if not self._pacing:
            self._queue.append((at, message, self.baud))
            return
        start = max(self._free, at)
        if (start - at) * self.baud / 10 > OUTPUT_BUFFER:
            self.overflowed += 1
            return
        self._free = start + len(message) * 10 / self.baud
        self._queue.append((self._free, message, self.baud))

    def due(self, now: float) -> list[tuple[bytes, int]]:
        """Messages whose last byte has left by `now`, each with the baud it was sent at."""
        out = []
        while self._queue and self._queue[0][0] <= now:
            _, message, baud = self._queue.popleft()
            out.append((message, baud))
        return out

    def next(self) -> float | None:
        """When the next message will have left."""
        return self._queue[0][0] if self._queue else None

    def __len__(self) -> int:
        return len(self._queue)


class Terminal:
    """Pseudo-terminal with the sensor behind it.

    Parameters
    ----------
    baud : that the terminal is set to at first.
    link : symbolic link to keep on it.
    rng : of garbage.
    drop : whether messages are lost when it is full.

    Attributes
    ----------
    path : of the slave, which clients open.
    sent, dropped, unheard : messages that went into it, that it had no room for, and that came while nobody
        was there.
    sent_bytes : bytes that were taken.
    """

    def __init__(self, baud: int, link: str | None, rng: np.random.Generator, drop: bool = True) -> None:
        self._rng, self._link, self._drop = rng, link, drop
        self._room = STAGED if drop else STAGED_LAPSE
        self.sent = self.dropped = self.unheard = self.sent_bytes = 0
        self._staged = bytearray()
        self._open(baud)

    def _open(self, baud: int) -> None:
        link = Path(self._link) if self._link else None
        if link is not None and link.exists():  # looked at first: a name that was freed may be given to us
            linked = link.is_symlink()
            there = f"{link.readlink()} is in use: end its emulator" if linked else "something else is there"
            raise ValueError(f"--link {link}: {there}, or give another path")
        self.master, self._slave = os.openpty()
        os.set_blocking(self.master, False)
        tty.setraw(self._slave)
        settings = termios.tcgetattr(self._slave)
        settings[4] = settings[5] = _CODES.get(baud, termios.B115200)
        termios.tcsetattr(self._slave, termios.TCSANOW, settings)
        self.path = os.ttyname(self._slave)
        self._presence = PtyClients(self.path)
        if link is not None:
            fresh = link.with_name(f"{link.name}.{os.getpid()}")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(self.path)
            fresh.replace(link)

    def speed(self) -> int | None:
        """Baud that the client has set; None for one without a name."""
        return _SPEEDS.get(termios.tcgetattr(self._slave)[5])

    @property
    def heard(self) -> bool:
        """Whether any client is there."""
        return self._presence.anyone

    @property
    def descriptors(self) -> list[int]:
        """What to wait for: input, and clients that come and go."""
        return [self.master, *([] if self._presence.descriptor is None else [self._presence.descriptor])]

    def look(self) -> None:
        """See who came and went; who went leaves nothing behind."""
        if not all(self._presence.changes()):
            self._staged.clear()
            termios.tcflush(self._slave, termios.TCIFLUSH)
            fcntl.ioctl(self._slave, termios.TIOCNXCL)

    @property
    def full(self) -> bool:
        return len(self._staged) >= self._room

    @property
    def waiting(self) -> bool:
        """Whether bytes wait for the terminal to take them."""
        return bool(self._staged)

    def write(self, messages: list[tuple[bytes, int]]) -> None:
        """Send messages, each garbled if the client listens at another baud than its own.

        A message that finds the terminal full is lost whole, as nothing holds it back on a serial line;
        without `drop` it waits.
        """
        if not self.heard:
            self.unheard += len(messages)
        elif messages:
            speed = self.speed()
            if not self._drop:
                self._staged += b"".join(self._heard(m, baud, speed) for m, baud in messages)
                self.sent += len(messages)
            else:
                for message, baud in messages:
                    if self.full:
                        self.flush()
                    if self.full:
                        self.dropped += 1
                    else:
                        self._staged += self._heard(message, baud, speed)
                        self.sent += 1
        self.flush()

    def flush(self) -> None:
        """Give the terminal what it takes of what waits."""
        while self._staged:
            try:
                count = os.write(self.master, self._staged)
            except BlockingIOError:
                return
            self.sent_bytes += count
            del self._staged[:count]

    def _heard(self, message: bytes, baud: int, speed: int | None) -> bytes:
        if speed == baud or (speed is None and baud not in _CODES):
            return message
        count = max(1, round(len(message) * min(1.0, (speed or baud) / baud)))
        return self._rng.integers(0, 256, count, dtype=np.uint8).tobytes()

    def read(self, baud: int) -> bytes:
        """What the client wrote; nothing that was written at another baud makes sense."""
        try:
            data = os.read(self.master, 4096)
        except BlockingIOError:
            return b""
        speed = self.speed()
        return data if speed == baud or (speed is None and baud not in _CODES) else b""

    def unplug(self) -> None:
        """The cable is pulled: clients see the terminal hang up."""
        self.close()
        self._staged.clear()

    def replug(self, baud: int) -> None:
        """The cable is back, under another name where the old one is still held."""
        self._open(baud)

    def close(self) -> None:
        if self._link:
            with contextlib.suppress(OSError):  # it may lead elsewhere by now
                if os.readlink(self._link) == self.path:
                    Path(self._link).unlink()
        self._presence.close()
        os.close(self.master)
        os.close(self._slave)
