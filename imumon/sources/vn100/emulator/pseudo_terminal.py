"""Pseudo-terminal whose master side is the emulated sensor.

It is raw, its master never blocks, and its slave stays open, so that a client that closes it has no effect. Messages
without a client are lost, as on a real line; the next client gets neither old bytes nor the exclusive mode (TIOCEXCL)
of the previous one. Linux reports every opening and closing of a file, also of a terminal (inotify(7)). Where that is
not available, a client is always assumed.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import struct
import termios
import tty
from pathlib import Path

from imumon.sources.device import InvalidOption

PENDING = 1 << 17
"""Bytes held for a full terminal: 3 s of the highest rate, for a reader or an emulator that was not scheduled."""

_OPEN, _CLOSE = 0x20, 0x08 | 0x10  # IN_OPEN; IN_CLOSE_WRITE or IN_CLOSE_NOWRITE
_EVENT = struct.Struct("iIII")


class PseudoTerminal:
    """Pseudo-terminal that clients open.

    Parameters
    ----------
    baud : that a client finds set, bit/s.
    link : symbolic link to maintain to its path.
    lossless : messages for a full terminal wait, since the sensor waits for its reader.

    Raises
    ------
    InvalidOption : the name of the link is in use.

    Attributes
    ----------
    path : of the slave, which clients open.
    """

    def __init__(self, baud: int, link: str | None, lossless: bool = False) -> None:
        self._lossless = lossless
        self._link = Path(link) if link else None
        if self._link is not None and self._link.exists():  # first: openpty may return the name it points to
            used = (
                f"{self._link.readlink()} is in use"
                if self._link.is_symlink()
                else "another file has this name"
            )
            raise InvalidOption("link_in_use", f"--link {link}: {used}", "give another path")
        self._master, self._slave = os.openpty()
        os.set_blocking(self._master, False)
        tty.setraw(self._slave)
        settings = termios.tcgetattr(self._slave)
        settings[4] = settings[5] = _code(baud) or termios.B115200
        termios.tcsetattr(self._slave, termios.TCSANOW, settings)
        self.path = os.ttyname(self._slave)
        self._pending = bytearray()
        self._clients = 0
        self._inotify = _watch(self.path)
        if self._link is not None:
            new = self._link.with_name(f"{self._link.name}.{os.getpid()}")
            new.unlink(missing_ok=True)
            new.symlink_to(self.path)
            new.replace(self._link)

    def update_clients(self) -> None:
        """Count the clients; discard the bytes and modes of one that has closed the terminal."""
        if self._inotify is None:
            return
        with contextlib.suppress(BlockingIOError):
            events = os.read(self._inotify, 4096)
            for _, mask, _, _ in _EVENT.iter_unpack(
                events
            ):  # without names: the path is a file, no directory
                self._clients = max(0, self._clients + bool(mask & _OPEN) - bool(mask & _CLOSE))
                if self._clients == 0:
                    self._pending.clear()
                    # while the slave is open, the kernel holds what the client has not read, and its exclusive mode
                    termios.tcflush(self._slave, termios.TCIFLUSH)
                    fcntl.ioctl(self._slave, termios.TIOCNXCL)

    @property
    def has_client(self) -> bool:
        return self._inotify is None or self._clients > 0

    @property
    def full(self) -> bool:
        return len(self._pending) >= PENDING

    @property
    def descriptors(self) -> tuple[list[int], list[int]]:
        """Descriptors to wait for: until they are readable, and until they are writable."""
        readable = [self._master] if self._inotify is None else [self._master, self._inotify]
        return readable, [self._master] if self._pending else []

    def write(self, message: bytes, baud: int) -> bool:
        """Queue a message for the client, as random bytes if its baud differs; return False if the message is lost.

        It is lost whole without a client, and unless lossless if the terminal is full: a serial line has no flow
        control.
        """
        if not self.has_client or (self.full and not self._lossless):
            return False
        self._pending += message if self._has_baud(baud) else os.urandom(len(message))
        return True

    def flush(self) -> None:
        """Write pending bytes until the kernel takes no more."""
        with contextlib.suppress(BlockingIOError):
            while self._pending:
                del self._pending[: os.write(self._master, self._pending)]

    def read(self, baud: int) -> bytes:
        """Return the bytes that the client has written; none if its baud is not `baud`."""
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            return b""
        return data if self._has_baud(baud) else b""

    def _has_baud(self, baud: int) -> bool:
        return bool(termios.tcgetattr(self._slave)[5] == _code(baud))

    def close(self) -> None:
        """Hang up, and remove the link."""
        if self._link is not None:
            with contextlib.suppress(OSError):  # the link may be gone or point elsewhere
                if os.readlink(self._link) == self.path:
                    self._link.unlink()
        for descriptor in (self._master, self._slave, self._inotify):
            if descriptor is not None:
                os.close(descriptor)


def _code(baud: int) -> int | None:
    """Return the constant of termios; None for 128000, which has none: no client on Linux can set it."""
    return getattr(termios, f"B{baud}", None)


def _watch(path: str) -> int | None:
    """Return a descriptor that is readable when a client opens or closes a path; None if that is not available."""
    libc = ctypes.CDLL(None, use_errno=True)  # the standard library of Python has no inotify
    if not hasattr(libc, "inotify_init1"):
        return None
    descriptor = int(libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC))
    if descriptor >= 0 and libc.inotify_add_watch(descriptor, path.encode(), _OPEN | _CLOSE) < 0:
        os.close(descriptor)
        return None
    return descriptor if descriptor >= 0 else None
