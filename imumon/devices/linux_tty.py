"""Terminals of Linux: what the kernel knows of a serial port, whatever opened it."""

from __future__ import annotations

import array
import contextlib
import fcntl
import os
import select
import sys
from pathlib import Path

PSEUDO_TERMINALS = "/dev/pts/"
_TIOCGICOUNT = 0x545D
_TCGETS2 = 0x802C542A


def pseudo_terminal(path: str) -> int | None:
    """Return when a pseudo-terminal was made, ns; None for others. The next terminal of its number has another time."""
    if os.path.abspath(path).startswith(PSEUDO_TERMINALS):
        with contextlib.suppress(OSError):
            return os.stat(path).st_ctime_ns
    return None


def holders(path: str) -> list[str]:
    """Return other processes that have this file open, as ``name (pid)``, as far as permissions show them."""
    target, programs = os.path.realpath(path), []
    for process in Path("/proc").glob("[0-9]*"):
        if int(process.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):
            if any(os.readlink(link) == target for link in (process / "fd").iterdir()):
                programs.append(f"{(process / 'comm').read_text().strip()} ({process.name})")
    return programs


def overruns(fd: int | None) -> int | None:
    """Return the overruns that the driver has counted since it was loaded; None if it does not count."""
    if fd is None:
        return None
    counts = array.array("i", [0] * 20)  # struct serial_icounter_struct
    try:
        fcntl.ioctl(fd, _TIOCGICOUNT, counts)
    except OSError:
        return None
    return counts[7] + counts[10]


def hung_up(fd: int) -> bool:
    """Return whether the other side of a descriptor has hung up."""
    poll = select.poll()
    poll.register(fd, 0)
    return any(event & (select.POLLHUP | select.POLLERR | select.POLLNVAL) for _, event in poll.poll(0))


def actual_baud(fd: int | None) -> int | None:
    """Return the speed that the driver has really set; None if it cannot be asked."""
    if fd is None or not sys.platform.startswith("linux"):
        return None
    settings = array.array("i", [0] * 64)  # struct termios2: the output speed is its eleventh word
    try:
        fcntl.ioctl(fd, _TCGETS2, settings)
    except OSError:
        return None
    return settings[10]


def is_no_terminal(path: str) -> bool:
    """Return whether a path is a file or a device that is no terminal."""
    with contextlib.suppress(OSError):
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        with open(fd, "rb", buffering=0) as file:
            return not file.isatty()
    return False
