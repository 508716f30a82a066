"""Serial line of the emulator: transmitter timing, and the pseudo-terminal that clients open.

`Uart` queues messages as a transmitter does: ten bits per byte at the baud, one message after the other.
`PseudoTerminal` is raw, its master never blocks, and its slave stays open so that a client that closes it has no
effect. Messages without a client are lost, as on a real line; the next client gets neither old bytes nor the
exclusive mode (TIOCEXCL) of the previous one. A client at another baud rate reads garbage.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import sys
import termios
import tty
from collections import deque
from math import inf
from pathlib import Path

import numpy as np

from imumon.devices.base import InvalidOption
from imumon.devices.vn100.emulator.pty_clients import PtyClients
from imumon.devices.vn100.registers import BAUDS

OUTPUT_BUFFER = 2048
"""bytes that the sensor buffers while the line is busy."""

PENDING, PENDING_TIME_LAPSE = 4096, 1 << 17
"""bytes held for a full terminal; beyond, messages are dropped, or in time-lapse the sensor waits."""

_SPEEDS = {getattr(termios, f"B{baud}"): baud for baud in BAUDS if hasattr(termios, f"B{baud}")}
_CODES = {baud: code for code, baud in _SPEEDS.items()}


class Uart:
    """Transmitter: when each message has left.

    Parameters
    ----------
    baud : of messages queued from now on.
    pacing : whether bytes take time.

    Attributes
    ----------
    overflowed : messages that the full output buffer has lost.
    """

    def __init__(self, baud: int, pacing: bool = True) -> None:
        self.baud, self._pacing = baud, pacing
        self._queue: deque[tuple[float, bytes, int]] = deque()
        self._free_at = -inf
        self.overflowed = 0

    def queue(self, message: bytes, now: float) -> None:
        """Queue a message that was made at `now` (s); what the buffer cannot hold is lost."""
        if not self._pacing:
            self._queue.append((now, message, self.baud))
            return
        start = max(self._free_at, now)
        # bytes that wait, by the time that they will take
        if (start - now) * self.baud / 10 > OUTPUT_BUFFER:
            self.overflowed += 1
            return
        self._free_at = start + len(message) * 10 / self.baud
        self._queue.append((self._free_at, message, self.baud))

    def transmitted(self, now: float) -> list[tuple[bytes, int]]:
        """Return the messages whose last byte has left by `now` (s), each with its baud."""
        messages = []
        while self._queue and self._queue[0][0] <= now:
            messages.append(self._queue.popleft()[1:])
        return messages

    def next_transmitted(self) -> float | None:
        """Return the time (s) at which the next message will have left; None without one."""
        return self._queue[0][0] if self._queue else None

    def __len__(self) -> int:
        return len(self._queue)


class PseudoTerminal:
    """Pseudo-terminal whose master side is the sensor.

    Parameters
    ----------
    baud : initial baud of the terminal.
    link : symbolic link to maintain to its path.
    rng : of the garbage at a wrong baud.
    drop : whether messages are lost when it is full.

    Attributes
    ----------
    path : of the slave, which clients open.
    sent, dropped, unheard : messages written, lost at a full terminal, and lost without a client.
    sent_bytes : bytes written.
    """

    def __init__(self, baud: int, link: str | None, rng: np.random.Generator, drop: bool = True) -> None:
        self._rng, self._link, self._drop = rng, link, drop
        self._limit = PENDING if drop else PENDING_TIME_LAPSE
        self.sent = self.dropped = self.unheard = self.sent_bytes = 0
        self._pending = bytearray()
        self.replug(baud)

    def replug(self, baud: int) -> None:
        """Open a terminal; it has another name if a client still has the old one open."""
        link = Path(self._link) if self._link else None
        if link is not None and link.exists():  # checked first: openpty may return the name it points to
            problem = f"{link.readlink()} is in use" if link.is_symlink() else "another file has this name"
            raise InvalidOption("link_in_use", f"--link {link}: {problem}", "give another path")
        self.master, self._slave = os.openpty()
        os.set_blocking(self.master, False)
        tty.setraw(self._slave)
        settings = termios.tcgetattr(self._slave)
        settings[4] = settings[5] = _CODES.get(baud, termios.B115200)
        termios.tcsetattr(self._slave, termios.TCSANOW, settings)
        self.path = os.ttyname(self._slave)
        self._clients = PtyClients(self.path)
        if link is not None:
            new = link.with_name(f"{link.name}.{os.getpid()}")
            new.unlink(missing_ok=True)
            new.symlink_to(self.path)
            new.replace(link)

    def _client_baud(self) -> int | None:
        """Return the baud that the client has set; None if it is not a standard one."""
        return _SPEEDS.get(termios.tcgetattr(self._slave)[5])

    @property
    def has_client(self) -> bool:
        return self._clients.any

    @property
    def descriptors(self) -> list[int]:
        """Descriptors to wait for: input, and clients that open or close the terminal."""
        return [self.master, *([] if self._clients.descriptor is None else [self._clients.descriptor])]

    def update_clients(self) -> None:
        """Discard the bytes and modes of a client that has closed the terminal."""
        if self._clients.update():
            self._pending.clear()
            # on the slave: the kernel holds what the client has not read, and the exclusive mode, as long as it is open
            termios.tcflush(self._slave, termios.TCIFLUSH)
            fcntl.ioctl(self._slave, termios.TIOCNXCL)

    @property
    def full(self) -> bool:
        return len(self._pending) >= self._limit

    @property
    def pending(self) -> bool:
        """Whether bytes wait to be written."""
        return bool(self._pending)

    @property
    def unread(self) -> int:
        """Bytes that are written or pending, and that the client has not read."""
        # asked of the slave: the kernel does not count on the master what waits for a client
        waiting = fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4))
        return len(self._pending) + int.from_bytes(waiting, sys.byteorder)

    def write(self, messages: list[tuple[bytes, int]]) -> None:
        """Write messages, garbled if the baud of the client is not theirs.

        A message for a full terminal is lost whole, since a serial line has no flow control; without `drop` it
        waits.
        """
        if not self.has_client:
            self.unheard += len(messages)
        elif messages:
            client_baud = self._client_baud()
            for message, baud in messages:
                if self._drop and self.full:
                    self.flush()
                if self._drop and self.full:
                    self.dropped += 1
                else:
                    self._pending += self._as_received(message, baud, client_baud)
                    self.sent += 1
        self.flush()

    def flush(self) -> None:
        """Write pending bytes until the terminal is full."""
        while self._pending:
            try:
                count = os.write(self.master, self._pending)
            except BlockingIOError:
                return
            self.sent_bytes += count
            del self._pending[:count]

    def _as_received(self, message: bytes, baud: int, client_baud: int | None) -> bytes:
        if _same_baud(client_baud, baud):
            return message
        # a slower receiver takes several bytes for one; a faster one sees about as many as were sent
        count = max(1, round(len(message) * min(1.0, (client_baud or baud) / baud)))
        return self._rng.integers(0, 256, count, dtype=np.uint8).tobytes()

    def read(self, baud: int) -> bytes:
        """Return the bytes that the client has written; none if its baud is not `baud`."""
        try:
            data = os.read(self.master, 4096)
        except BlockingIOError:
            return b""
        return data if _same_baud(self._client_baud(), baud) else b""

    def unplug(self) -> None:
        """Hang up the terminal, as a pulled cable does."""
        self.close()
        self._pending.clear()

    def close(self) -> None:
        if self._link:
            with contextlib.suppress(OSError):  # the link may be gone or point elsewhere
                if os.readlink(self._link) == self.path:
                    Path(self._link).unlink()
        self._clients.close()
        os.close(self.master)
        os.close(self._slave)


def _same_baud(client_baud: int | None, baud: int) -> bool:
    """Return whether a client reads at `baud`; None is any baud without a constant in termios."""
    return client_baud == baud or (client_baud is None and baud not in _CODES)
