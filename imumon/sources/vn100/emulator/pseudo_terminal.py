"""Pseudo-terminal whose master side is the emulated sensor.

It is raw, and its master never blocks. Messages without a client are lost, as on a real line, and the next client gets
no old bytes. Only clients have the slave open: the master hangs up (POLLHUP) while there is none, and its settings
stay.
"""

from __future__ import annotations

import contextlib
import os
import select
import termios
import tty
from pathlib import Path

from imumon.sources.device import InvalidOption

PENDING = 1 << 17
"""Bytes held for a full terminal: 3 s of the highest rate, for a reader or an emulator that was not scheduled."""


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
    has_client : whether one has it open.
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
        self._master, slave = os.openpty()
        os.set_blocking(self._master, False)
        tty.setraw(slave)
        settings = termios.tcgetattr(slave)
        settings[4] = settings[5] = _code(baud) or termios.B115200
        termios.tcsetattr(slave, termios.TCSANOW, settings)
        self.path = os.ttyname(slave)
        os.close(slave)
        self._pending = bytearray()
        self._hang_up = select.poll()
        self._hang_up.register(self._master, 0)  # no events of interest: POLLHUP is reported in any case
        self.has_client = False
        if self._link is not None:
            new = self._link.with_name(f"{self._link.name}.{os.getpid()}")
            new.unlink(missing_ok=True)
            new.symlink_to(self.path)
            new.replace(self._link)

    def update_clients(self) -> None:
        """Notice a client that has opened or closed the terminal; discard what the latter has not read."""
        before, self.has_client = self.has_client, not self._hang_up.poll(0)
        if before and not self.has_client:
            self._pending.clear()
            with contextlib.suppress(OSError):
                slave = os.open(self.path, os.O_RDWR | os.O_NOCTTY)
                termios.tcflush(slave, termios.TCIFLUSH)  # the kernel holds it for the next one
                os.close(slave)

    @property
    def full(self) -> bool:
        return len(self._pending) >= PENDING

    @property
    def descriptors(self) -> tuple[list[int], list[int]]:
        """Descriptors to wait for: until they are readable, and until they are writable; none without a client."""
        client = [self._master] if self.has_client else []
        return client, client if self._pending else []

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
        except OSError:  # nothing was written, or the client has just closed the terminal
            return b""
        return data if self._has_baud(baud) else b""

    def _has_baud(self, baud: int) -> bool:
        return bool(termios.tcgetattr(self._master)[5] == _code(baud))  # Linux returns those of the slave

    def close(self) -> None:
        """Hang up, and remove the link."""
        if self._link is not None:
            with contextlib.suppress(OSError):  # the link may be gone or point elsewhere
                if os.readlink(self._link) == self.path:
                    self._link.unlink()
        os.close(self._master)


def _code(baud: int) -> int | None:
    """Return the constant of termios; None for 128000, which has none: no client on Linux can set it."""
    return getattr(termios, f"B{baud}", None)
