"""Terminals of Linux: what the kernel knows of a serial port, whatever opened it."""

from __future__ import annotations

import array
import contextlib
import fcntl
import grp
import os
import select
import sys
from pathlib import Path

from imumon.model.report_json import plain

PSEUDO_TERMINALS = "/dev/pts/"
# requests that the module termios does not have; numbers of asm-generic/ioctls.h
_TIOCGICOUNT = 0x545D
_TCGETS2 = 0x802C542A


def group_of(path: str) -> str:
    """Return the group that owns a device: its members may open it. Without one, that of most systems."""
    with contextlib.suppress(OSError, KeyError):
        group = grp.getgrgid(os.stat(path).st_gid).gr_name
        if group != "root":  # nothing else may open such a device, and no user should be in that group
            return group
    return "dialout"


def holders(path: str) -> dict[int, str]:
    """Return the names of other processes that have a port open; of other users, only root sees them."""
    programs, target = {}, os.path.realpath(path)
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            files = [os.readlink(link) for link in (process / "fd").iterdir()]
            # one that has a master is the other end of a pseudo-terminal, and takes no bytes of it
            if target in files and not any(file.endswith("/ptmx") for file in files):
                programs[int(process.name)] = plain((process / "comm").read_text().strip())
    programs.pop(os.getpid(), None)
    return programs


def overruns(fd: int | None) -> int | None:
    """Return the overruns that the driver has counted since it was loaded; None if it does not count."""
    counts = _numbers(fd, _TIOCGICOUNT, 20)  # struct serial_icounter_struct
    # overrun (of the UART) and buf_overrun (of the tty): bytes are lost in either place
    return None if counts is None else counts[7] + counts[10]


def hung_up(fd: int) -> bool:
    """Return whether the other side of a descriptor has hung up."""
    poll = select.poll()
    poll.register(fd, 0)  # no events of interest: these three are reported in any case
    return any(event & (select.POLLHUP | select.POLLERR | select.POLLNVAL) for _, event in poll.poll(0))


def actual_baud(fd: int | None) -> int | None:
    """Return the baud rate that the driver has really set; None if it cannot be asked.

    `termios.tcgetattr` returns the requested one, also where the divisor of the adapter cannot make it.
    """
    settings = _numbers(fd, _TCGETS2, 64)  # struct termios2: the output speed is its eleventh word
    return None if settings is None else settings[10]


def _numbers(fd: int | None, request: int, count: int) -> array.array[int] | None:
    """Return what the driver answers to a request, as integers of C; None if it knows no such request."""
    if fd is not None and sys.platform.startswith("linux"):
        with contextlib.suppress(OSError):
            numbers = array.array("i", [0] * count)
            fcntl.ioctl(fd, request, numbers)
            return numbers
    return None


def is_no_terminal(path: str) -> bool:
    """Return whether a path is a file or a device that is no terminal."""
    with contextlib.suppress(OSError):
        # without these, opening waits for the carrier of a modem, or makes it the terminal of this process
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        with open(fd, "rb", buffering=0) as file:
            return not file.isatty()
    return False
