"""Ports of this machine and their opening: a tty, a URL of pyserial, standard input, or a socket.

What cannot be opened is an error that names the cause. This is the only module that imports pyserial.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import getpass
import os
import re
import shlex
import socket
import stat
import sys
import termios
import time
from collections.abc import Mapping
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Any

import serial as _pyserial
import serial.tools.list_ports

from imumon.sources import linux_tty
from imumon.sources.device import DeviceEnded, DeviceError, DeviceLost, DeviceNotFound

pyserial: Any = _pyserial  # it has no types

POLL_S = 0.1
"""s after which a wait for bytes looks whether it has to end."""
READ_BYTES = 1 << 16
"""Bytes of one read: more than a tty holds, and the longest datagram; after a stall, megabytes may be queued."""
DATAGRAM_BYTES = 1 << 22
"""Bytes of datagrams for which the kernel is asked, in case the reader is late; it may give less."""
SENDER_S = 2.0
"""s of silence after which another sender of the same address takes the place of a sender of datagrams."""
RIVAL_S = 30.0
"""s after the last datagram of another sender for which there counts as one."""
FROM = "?from="
"""In the path of a port for datagrams, before the address of their sender."""
BAUD_RATES = (115200, 921600, 460800, 230400, 57600, 38400, 19200, 9600)
"""bit/s in the order in which they are tried: the factory value of most sensors, then the fast ones."""
STANDARD_INPUT = "-"
"""Path of standard input."""

# what drivers raise for a port that has vanished (termios.error is no OSError)
LOSS_ERRORS = (OSError, pyserial.SerialException, termios.error)


@dataclass(frozen=True, slots=True)
class PortInfo:
    """A serial port of this machine; `usb` is (vendor, product, serial number) of its adapter."""

    path: str
    description: str
    usb: tuple[int, int, str | None] | None = None


def find_ports() -> list[PortInfo]:
    """Return the serial ports of this machine, USB adapters first."""
    ports = []
    for port in pyserial.tools.list_ports.comports():
        usb = None if port.vid is None else (port.vid, port.pid, port.serial_number)
        description = port.description if port.description not in (None, "n/a") else "serial port"
        ports.append(PortInfo(port.device, description, usb))
    return sorted(ports, key=lambda port: (port.usb is None, port.path))


def find_again(path: str, before: list[PortInfo], now: list[PortInfo]) -> list[str]:
    """Return the paths of a port that had vanished, best first.

    The same path is first, if it exists; then ports of the same adapter (vendor, product, serial number). A
    port of another adapter is never returned: it would be written to. A link is followed to whatever it names.

    Parameters
    ----------
    path : at which it was opened.
    before, now : `find_ports` before it vanished, and now.
    """
    # a URL has nothing that could be looked at without opening it
    paths = [path] if "://" in path or os.path.exists(path) else []
    adapters = {p.usb for p in before if os.path.realpath(p.path) == os.path.realpath(path)} - {None}
    return paths + [p.path for p in now if p.usb in adapters and p.path not in paths]


def open_port(path: str, baud: int) -> Any:
    """Return an open port: of pyserial, or one that is only read.

    Raises
    ------
    DeviceNotFound : there is no such port.
    DeviceError : it cannot be opened.
    """
    if path == STANDARD_INPUT:
        if sys.stdin is None:
            raise DeviceNotFound("input_closed", "standard input is closed", "give it a file or a pipe")
        return ReadOnlyPort(None)
    if path.startswith("udp://"):
        address, _, sender = path.partition(FROM)
        return Datagrams(_open_udp(address), sender)
    if path.startswith("tcp://"):
        return ReadOnlyPort(_open_tcp(path))
    return (_open_url if "://" in path else _open_tty)(path, baud)


def loss_of(path: str, error: Exception) -> DeviceLost:
    """Return the error of a port that has vanished.

    pyserial raises `SerialException` without a number if a port is ready to read and has no data: unplugged.
    """
    if isinstance(error, EOFError):
        return DeviceEnded("input_ended", "standard input has ended", "give it more to read")
    number = next((arg for arg in error.args if isinstance(arg, int)), None)
    unplugged = isinstance(error, pyserial.SerialException) and number is None
    if unplugged or number in (errno.EIO, errno.ENXIO, errno.ENODEV):
        why = "unplugged or hung up"
    else:
        why = (os.strerror(number) if number else str(error)).lower()
    cure = "start its server again" if "://" in path else "plug it in again"
    return DeviceLost("device_lost", f"{path} is gone ({why})", cure)


class ReadOnlyPort:
    """Standard input, or a socket, in the place of a port of pyserial."""

    def __init__(self, opened: socket.socket | None) -> None:
        self._socket = opened

    def fileno(self) -> int:
        return 0 if self._socket is None else self._socket.fileno()

    def write(self, data: bytes) -> None:
        raise OSError(errno.EBADF, "it can only be read")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


class Datagrams(ReadOnlyPort):
    """A socket of datagrams from one sender: whoever reaches the port may send, and two sensors are no sensor.

    The first sender, an address with its port, is the sensor. Two programs of one machine differ in the port alone. A
    sender that was started again has another port, so that one of the same address follows a sender that is silent.

    Parameters
    ----------
    address : of the sensor, as `from=` of the URL gives it: datagrams of all its ports are taken; "": not given.

    Attributes
    ----------
    other_lines : lines of other senders, which are ignored.
    other_sender : the first of them, as text; None: there is none.
    """

    def __init__(self, opened: socket.socket, address: str = "") -> None:
        super().__init__(opened)
        self._datagrams = opened
        self._address = ip_address(address) if address else None
        self._sender: Any = None  # address and port of the sensor
        self._heard = 0.0  # s monotonic of its last datagram
        self._other_heard = float("-inf")  # s monotonic, of the last datagram of another sender
        self.other_lines = 0
        self.other_sender: str | None = None

    def receive(self) -> bytes:
        """Return what has arrived, each datagram with an end of line: one is lost as a whole or not at all."""
        pieces, size, now = list[bytes](), 0, time.monotonic()
        with contextlib.suppress(BlockingIOError, InterruptedError):
            while size < READ_BYTES:
                data, sender = self._datagrams.recvfrom(READ_BYTES)
                data = data if data.endswith(b"\n") else data + b"\n"
                size += len(data)  # of others, too: they must not keep the reader here
                if self._is_sensor(sender, now):
                    pieces.append(data)
                else:
                    self.other_lines += data.count(b"\n")
                    self.other_sender = self.other_sender or f"{sender[0]} port {sender[1]}"
                    self._other_heard = now
        return b"".join(pieces)

    def has_rival(self, now: float) -> bool:
        """Return whether others send at present, s monotonic, and the sensor is the first of them, not a given one."""
        return now - self._other_heard < RIVAL_S and self._address is None

    def _is_sensor(self, sender: Any, now: float) -> bool:
        """Return whether a datagram is of the sensor."""
        if self._address is not None:
            return ip_address(sender[0]) == self._address
        if self._sender not in (None, sender):
            silent = now - self._heard > SENDER_S
            if not silent or sender[0] != self._sender[0]:
                return False
        self._sender, self._heard = sender, now
        return True


def _address_of(url: str) -> tuple[str, int, bool]:
    """Return host, port and whether the host is a number of IPv6 of a URL; without a host, it is empty.

    >>> _address_of("udp://:4000"), _address_of("tcp://[::1]:4000/")
    (('', 4000, False), ('::1', 4000, True))
    """
    match = re.fullmatch(r"(\w+)://(?:\[([^]]+)\]|([^/:]*)):(\d+)/?", url)
    if match is None or not 0 < int(match[4]) < 1 << 16:
        scheme = url.partition(":")[0]
        cure = f"write {scheme}://HOST:PORT{', or udp://:PORT' if scheme == 'udp' else ''}"
        raise DeviceNotFound("port_url_invalid", f"cannot open {url}", cure)
    return match[2] or match[3], int(match[4]), match[2] is not None


def _open_tcp(url: str) -> socket.socket:
    """Return a connection to the server of a URL. pyserial would discard the first bytes, such as a header."""
    host, port, _ = _address_of(url)
    try:
        # the time-out also makes its descriptor non-blocking, as the reader of a port needs it
        return socket.create_connection((host, port), timeout=5.0)
    except OSError as error:
        raise _unreachable(url, error) from None


def _unreachable(url: str, error: Exception) -> DeviceNotFound:
    cure = "check that the server is running and that the URL is correct"
    return DeviceNotFound("port_url_unreachable", f"cannot open {url} ({error})", cure)


def _open_udp(url: str) -> socket.socket:
    """Return a socket that receives the datagrams of a URL; without a host, those of this machine."""
    host, port, is_ipv6 = _address_of(url)
    opened = socket.socket(socket.AF_INET6 if is_ipv6 else socket.AF_INET, socket.SOCK_DGRAM)
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, DATAGRAM_BYTES)
        opened.bind((host or "127.0.0.1", port))
        opened.setblocking(False)
    except OSError as error:
        opened.close()
        text = f"cannot open {url} ({error})"
        cure = "name an address of this machine and a port that no other program has"
        raise DeviceNotFound("port_url_unreachable", text, cure) from None
    return opened


def _open_url(url: str, baud: int) -> Any:
    """Return an open port of pyserial on a URL."""
    if re.match(r"(socket|rfc2217)://", url):  # pyserial fails with a TypeError of its own without a port
        _address_of(url.partition("?")[0])
    try:
        return pyserial.serial_for_url(url, baudrate=baud, timeout=POLL_S, write_timeout=1.0)
    except (OSError, ValueError) as error:
        raise _unreachable(url, error) from None


def _open_tty(path: str, baud: int) -> Any:
    """Return an open serial device, which no other program reads."""
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):  # a ValueError: a path with a zero byte
        ports = ", ".join(port.path for port in find_ports())
        cure = f"choose another --port; this machine has {ports}" if ports else "plug the sensor in"
        raise DeviceNotFound("port_not_found", f"no port {path}", cure) from None
    if not stat.S_ISCHR(mode):
        kind = "directory" if stat.S_ISDIR(mode) else "file"
        cure = f"to read a recording, use imumon replay {shlex.quote(path)}"
        raise DeviceError("port_not_serial", f"{path} is a {kind}, not a serial port", cure)
    # a program that locks nothing would take a part of the bytes; many have /dev/null open, which is no port
    if (others := linux_tty.holders(path)) and not linux_tty.is_no_terminal(path):
        raise _busy(path, others)
    try:
        # a write must end, too: a sensor that holds the line, or a hung adapter, takes no bytes
        port = pyserial.Serial(path, baud, timeout=POLL_S, write_timeout=1.0, exclusive=True)
    except ValueError as error:
        text = f"{path} cannot do {baud} baud ({error})"
        raise DeviceError("baud_unsupported", text, "choose another --baud") from None
    except LOSS_ERRORS as error:
        raise _open_error(path, error) from None
    # An FTDI adapter otherwise keeps bytes for 16 ms, and each reply with them. A pseudo-terminal has no such mode.
    with contextlib.suppress(ValueError, OSError, NotImplementedError):
        port.set_low_latency_mode(True)
    # `exclusive` is a lock that other programs need not look at; this mode makes their opening fail. A
    # pseudo-terminal, whose other end stays open, would keep it after this process was killed.
    if not os.path.realpath(path).startswith(linux_tty.PSEUDO_TERMINALS):
        with contextlib.suppress(OSError):
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
    return port


def _busy(path: str, programs: Mapping[int, str]) -> DeviceError:
    """Return the error of a port in use; `programs`, by process, have it open: empty if they are not visible."""
    if not programs:
        cure = f"end it first: sudo fuser -v {shlex.quote(path)} names it"
        return DeviceError("port_busy", f"{path} is in use by another user's program", cure)
    cure = f"end it first: kill {' '.join(map(str, programs))}"
    names = ", ".join(f"{name} ({pid})" for pid, name in programs.items())
    return DeviceError("port_busy", f"{path} is in use by {names}", cure)


def _open_error(path: str, error: Exception) -> DeviceError:
    """Return why a port that exists does not open, and the cure."""
    # termios.error and some errors of pyserial have the number of the system error in their arguments only
    number = getattr(error, "errno", None) or next((a for a in error.args if isinstance(a, int)), None)
    if number in (errno.EACCES, errno.EPERM):
        user = "$USER"
        with contextlib.suppress(KeyError, OSError):  # a container may run under a number without a name
            user = getpass.getuser()
        cure = f"sudo usermod -aG {linux_tty.group_of(path)} {user}, then log in again"
        return DeviceError("port_permission_denied", f"no permission for {path}", cure)
    if number in (errno.EBUSY, errno.EAGAIN):  # the exclusive mode of another program, or its lock
        return _busy(path, linux_tty.holders(path))
    if not os.path.exists(path) or number in (errno.EIO, errno.ENXIO, errno.ENODEV, errno.ENOENT):
        text = f"{path} vanished while it was being opened"
        return DeviceNotFound("port_vanished", text, "plug the adapter in again, and check the cable")
    if isinstance(error, termios.error) or number == errno.ENOTTY or linux_tty.is_no_terminal(path):
        return DeviceError("port_not_serial", f"{path} is not a serial port", "choose another --port")
    cure = "unplug the adapter and plug it in again; dmesg shows what its driver reports"
    return DeviceError("port_unusable", f"cannot open {path} ({error})", cure)
