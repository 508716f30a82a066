"""Serial port: bytes from and to a serial device or a pyserial URL; also from standard input and UDP.

Reading must never stall: a Linux tty holds 4 kB, which is 44 ms at 921600 baud. So one thread drains the port
into a bounded queue and does nothing else; bytes that do not fit are dropped and counted. This is the only
module that imports pyserial; it does not know what the bytes mean.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import getpass
import io
import os
import re
import select
import socket
import stat
import sys
import termios
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import serial as _pyserial
import serial.tools.list_ports

from imumon.devices import linux_tty
from imumon.devices.base import DeviceEnded, DeviceError, DeviceLost, DeviceNotFound

pyserial: Any = _pyserial  # it has no types

QUEUE_BYTES = 8 << 20
"""Bytes in the queue: 90 s at 921600 baud."""
POLL_S = 0.1
"""s after which the reading thread checks whether it has to end."""
DIALOGUE_S = 1.0
"""s after a write in which the reader delivers every byte at once, because a reply is expected."""
COLLECT_S = 0.05
"""s for which the reader collects bytes otherwise, to save wake-ups."""
FEW_BYTES = 512
"""Bytes of one read from which it collects for less time: at a steady rate, a read then has at most half of what a
tty holds up to 1 Mbit/s. The baud rate does not show it: a board on USB ignores it."""
COLLECT_BYTES = 2048
"""Bytes from which the reader does not wait: half of what a tty holds."""
READ_BYTES = 1 << 16
"""Bytes of one read from the port: more than a tty holds, and the longest datagram."""
DATAGRAM_BYTES = 1 << 22
"""Bytes of datagrams for which the kernel is asked, in case the reader is late; it may give less."""
CONNECT_S = 5.0
"""s to wait for the answer of a TCP server."""
STANDARD_INPUT = "-"
"""Path of standard input."""
PIECE_BYTES = 1 << 16
"""Bytes that `SerialPort.read` returns at most: after a stall there may be megabytes."""

# what drivers raise for a port that has vanished (termios.error is no OSError)
_LOSS_ERRORS = (OSError, pyserial.SerialException, termios.error)


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


def find_again(
    path: str, before: list[PortInfo], now: list[PortInfo], terminal: int | None = None
) -> list[str]:
    """Return the paths of a port that had vanished, best first.

    The same path is first, if it exists; then ports of the same adapter (vendor, product, serial number). A
    port of another adapter is never returned: it would be written to. Nor is another
    pseudo-terminal with the number of the one that was closed; a link is followed to whatever it names.

    Parameters
    ----------
    path : at which it was opened.
    before, now : `find_ports` before it vanished, and now.
    terminal : `linux_tty.pseudo_terminal` of the path when it was opened.
    """
    remains = os.path.exists(path) and linux_tty.pseudo_terminal(path) == terminal
    paths = [path] if "://" in path or remains else []
    adapters = {p.usb for p in before if os.path.realpath(p.path) == os.path.realpath(path)} - {None}
    return paths + [p.path for p in now if p.usb in adapters and p.path not in paths]


class SerialPort:
    """An open port, 8N1 and exclusive, drained by its own thread.

    Parameters
    ----------
    path : device path, or any pyserial URL (``socket://host:port``, ``rfc2217://host:port``); to read only also ``-``,
        standard input, ``tcp://host:port``, and ``udp://host:port``, datagrams, each a line or more.
    baud : bit/s.
    queue_bytes : size of the queue; what does not fit is dropped and counted.
    lossless : stop draining while the queue is full, so that the other end waits: for an emulator in
        time-lapse or a pipe, never for a sensor.
    mark : bytes put where others were dropped.

    Attributes
    ----------
    received_bytes, dropped_bytes : read from the port, and of these dropped at a full queue.
    most_queued : bytes, largest size of the queue.

    Raises
    ------
    DeviceNotFound : there is no such port.
    DeviceError : it cannot be opened.
    """

    def __init__(
        self,
        path: str,
        baud: int = 115200,
        *,
        queue_bytes: int = QUEUE_BYTES,
        lossless: bool = False,
        mark: bytes = b"",
    ) -> None:
        self.name = path
        self.received_bytes = self.dropped_bytes = self.most_queued = 0
        self._baud, self._limit, self._lossless, self._mark = baud, queue_bytes, lossless, mark
        self._queue: deque[bytes] = deque()
        self._queued = self._episodes = 0
        self._changed = threading.Condition()
        self._kernel_before: int | None = None
        self._loss: DeviceLost | None = None
        self._serial: Any = None
        self._fd: int | None = None
        self._open()

    @property
    def baud(self) -> int:
        """Baud the port is set to, bit/s."""
        return self._baud

    @property
    def fixed_baud(self) -> bool:
        """Whether the baud rate has no effect, as on a bare TCP socket."""
        return self.name.startswith(("socket://", "tcp://", "udp://")) or self.name == STANDARD_INPUT

    @property
    def gone(self) -> bool:
        """Whether the port has vanished; bytes read before are still returned."""
        return self._loss is not None

    @property
    def waits(self) -> bool:
        """Whether to read at once: a whole piece is queued, or no more bytes will arrive."""
        return self._queued >= PIECE_BYTES or self._loss is not None

    @property
    def overruns(self) -> int:
        """Times bytes were lost on this side: at a full queue, or in the kernel if it counts them."""
        return self._episodes + (self.kernel_overruns or 0)

    @property
    def kernel_overruns(self) -> int | None:
        """Overruns that the driver counted; None if it does not count, as for a pseudo-terminal."""
        now = linux_tty.overruns(self._fd)
        return self._kernel_before if now is None else (self._kernel_before or 0) + now - self._kernel_start

    def read(self, timeout: float) -> bytes:
        """Return what is queued, about 64 kB at most; wait up to `timeout` seconds for the first byte.

        Raises
        ------
        DeviceLost : nothing is queued and nothing will arrive.
        DeviceEnded : so it is, and that is the end of standard input.
        """
        with self._changed:
            if not self._queue and self._loss is None:
                self._changed.wait(timeout)
            if not self._queue and self._loss is not None:
                raise self._loss
            piece, size = [], 0
            while self._queue and size < PIECE_BYTES:
                piece.append(self._queue.popleft())
                size += len(piece[-1])
            self._queued -= size
            self._changed.notify_all()
            return b"".join(piece)

    def write(self, data: bytes) -> None:
        """Send `data`.

        Raises
        ------
        DeviceLost : the port has vanished or takes no bytes.
        """
        if self._loss is not None:
            raise self._loss
        self._dialogue_until = time.monotonic() + DIALOGUE_S
        try:
            self._serial.write(data)
        except _LOSS_ERRORS as error:
            raise self._fail(error) from None

    def set_baud(self, baud: int) -> bool:
        """Change the baud rate and discard the bytes received so far; return False if the adapter cannot.

        Raises
        ------
        DeviceLost : the port has vanished.
        """
        try:
            done = self._apply(baud)
            if done:
                self._baud = baud
                self._serial.reset_input_buffer()
            else:
                self._apply(self._baud)
        except _LOSS_ERRORS as error:
            raise self._fail(error) from None
        with self._changed:
            self._queue.clear()
            self._queued = 0
        return done

    def _apply(self, baud: int) -> bool:
        try:
            self._serial.baudrate = baud
        except (ValueError, OverflowError):
            return False
        actual = linux_tty.actual_baud(self._fd)
        return actual is None or abs(actual - baud) <= 0.03 * baud

    def reopen(self) -> None:
        """Close and open again at the same baud, which cures some bad reads.

        Raises
        ------
        DeviceLost : it does not open again.
        """
        self.close()
        try:
            self._open()
        except DeviceError as error:
            raise DeviceLost(error.code, error.message, error.cure) from None

    def close(self) -> None:
        """Stop the thread and close the port."""
        self._kernel_before = self.kernel_overruns
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        self._fd = None
        with contextlib.suppress(*_LOSS_ERRORS):
            self._serial.close()

    def __enter__(self) -> SerialPort:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self) -> None:
        self._datagrams = _open_udp(self.name) if self.name.startswith("udp://") else None
        if self.name == STANDARD_INPUT and sys.stdin is None:
            raise DeviceNotFound("input_closed", "standard input is closed", "give it a file or a pipe")
        if self.name == STANDARD_INPUT or self._datagrams is not None:
            self._serial = _Descriptor(self._datagrams)
        elif self.name.startswith("tcp://"):
            self._serial = _Descriptor(_open_tcp(self.name))
        else:
            self._serial = (_open_url if "://" in self.name else _open_tty)(self.name, self._baud)
        self._fd = None
        with contextlib.suppress(io.UnsupportedOperation, AttributeError):
            self._fd = self._serial.fileno()
        self._closing, self._loss, self._dropping, self._empty = False, None, False, 0
        try:
            self._kernel_start = linux_tty.overruns(self._fd) or 0
            if not self.fixed_baud and not self.set_baud(self._baud):
                text = f"the adapter of {self.name} cannot do {self._baud} baud"
                raise DeviceError("baud_unsupported", text, "choose another --baud")
        except DeviceLost as error:
            self._serial.close()
            text = f"{error.message} (while it was being opened)"
            raise DeviceError(error.code, text, error.cure) from None
        except DeviceError:
            self._serial.close()
            raise
        self._dialogue_until = time.monotonic() + DIALOGUE_S
        self._thread = threading.Thread(target=self._drain, name=f"read {self.name}", daemon=True)
        self._thread.start()

    def _drain(self) -> None:
        """The reader thread: port to queue, nothing else."""
        try:
            while not self._closing:
                data = self._receive()
                if data:
                    self._keep(data)
                    if len(data) < COLLECT_BYTES and time.monotonic() > self._dialogue_until:
                        time.sleep(COLLECT_S * min(1.0, FEW_BYTES / len(data)))
        except Exception as error:  # whatever it is, `read` must raise it
            self._fail(error)

    def _receive(self) -> bytes:
        """Return what the port holds, b"" if nothing arrived for a while."""
        if self._fd is None:  # no file behind it (rfc2217)
            return bytes(self._serial.read(max(1, self._serial.in_waiting)))
        if not select.select([self._fd], [], [], POLL_S)[0]:
            self._empty = 0
            return b""
        if self._datagrams is not None:
            return _received(self._datagrams)
        try:
            data = os.read(self._fd, READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return b""
        if not data and self.name == STANDARD_INPUT:
            raise EOFError
        # Ready without data: Linux shows an unplugged adapter so, or a flush between the two calls.
        self._empty = 0 if data else self._empty + 1
        if not data and (self.fixed_baud or self._empty > 100 or linux_tty.hung_up(self._fd)):
            raise OSError(errno.EIO, "hung up")
        return data

    def _keep(self, data: bytes) -> None:
        with self._changed:
            while self._lossless and self._queue and self._is_full(data) and not self._closing:
                self._changed.wait(POLL_S)
            self.received_bytes += len(data)
            dropped_before, self._dropping = self._dropping, not self._lossless and self._is_full(data)
            if self._dropping:
                self.dropped_bytes += len(data)
                self._episodes += not dropped_before
                return
            if dropped_before:
                data = self._mark + data
            self._queue.append(data)
            self._queued += len(data)
            self.most_queued = max(self.most_queued, self._queued)
            self._changed.notify_all()

    def _is_full(self, data: bytes) -> bool:
        return self._queued + len(data) > self._limit

    def _fail(self, error: Exception) -> DeviceLost:
        """Record that the port has vanished; return the error.

        pyserial raises `SerialException` without a number if a port is ready to read and has no data: unplugged.
        """
        if isinstance(error, EOFError):
            ended = DeviceEnded("input_ended", "standard input has ended", "give it more to read")
            return self._note_loss(ended)
        number = next((arg for arg in error.args if isinstance(arg, int)), None)
        unplugged = isinstance(error, pyserial.SerialException) and number is None
        if unplugged or number in (errno.EIO, errno.ENXIO, errno.ENODEV):
            why = "unplugged or hung up"
        else:
            why = (os.strerror(number) if number else str(error)).lower()
        cure = "start its server again" if "://" in self.name else "plug it in again"
        lost = DeviceLost("device_lost", f"{self.name} is gone ({why})", cure)
        return self._note_loss(lost)

    def _note_loss(self, lost: DeviceLost) -> DeviceLost:
        with self._changed:
            if self._loss is None and not self._closing:
                self._loss = lost
            self._changed.notify_all()
        return lost


class _Descriptor:
    """Standard input, or a socket, in the place of a port of pyserial; it is only read."""

    def __init__(self, opened: socket.socket | None) -> None:
        self._socket = opened

    def fileno(self) -> int:
        return 0 if self._socket is None else self._socket.fileno()

    def write(self, data: bytes) -> None:
        raise OSError(errno.EBADF, "it can only be read")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


def _open_tcp(url: str) -> socket.socket:
    """Return a connection to the server of a URL. pyserial would discard the first bytes, such as a header."""
    match = re.fullmatch(r"tcp://(?:\[([^]]+)\]|([^/:]+)):(\d+)/?", url)
    if match is None or not 0 < int(match[3]) < 1 << 16:
        raise DeviceNotFound("port_url_invalid", f"cannot open {url}", "write tcp://HOST:PORT")
    try:
        return socket.create_connection((match[1] or match[2], int(match[3])), timeout=CONNECT_S)
    except OSError as error:
        cure = "check that the server is running and that the URL is correct"
        raise DeviceNotFound("port_url_unreachable", f"cannot open {url} ({error})", cure) from None


def _open_udp(url: str) -> socket.socket:
    """Return a socket that receives the datagrams of a URL; without a host, those of this machine."""
    match = re.fullmatch(r"udp://(?:\[([^]]+)\]|([^/:]*)):(\d+)/?", url)
    if match is None or not 0 < int(match[3]) < 1 << 16:
        raise DeviceNotFound(
            "port_url_invalid", f"cannot open {url}", "write udp://:PORT or udp://ADDRESS:PORT"
        )
    address = (match[1] or match[2] or "127.0.0.1", int(match[3]))
    opened = socket.socket(socket.AF_INET6 if match[1] else socket.AF_INET, socket.SOCK_DGRAM)
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, DATAGRAM_BYTES)
        opened.bind(address)
        opened.setblocking(False)
    except OSError as error:
        opened.close()
        text = f"cannot open {url} ({error})"
        cure = "name an address of this machine and a port that no other program has"
        raise DeviceNotFound("port_url_unreachable", text, cure) from None
    return opened


def _received(datagrams: socket.socket) -> bytes:
    """Return the datagrams that have arrived, each with an end of line: one is lost as a whole or not at all."""
    pieces, size = list[bytes](), 0
    with contextlib.suppress(BlockingIOError, InterruptedError):
        while size < READ_BYTES:
            data = datagrams.recv(READ_BYTES)
            pieces.append(data if data.endswith(b"\n") else data + b"\n")
            size += len(pieces[-1])
    return b"".join(pieces)


def _open_url(url: str, baud: int) -> Any:
    network = re.match(r"(socket|rfc2217)://", url)
    if network and not re.match(r"[^/]+:\d+", url[network.end() :]):
        raise DeviceNotFound("port_url_invalid", f"cannot open {url}", f"write {network[0]}HOST:PORT")
    try:
        return pyserial.serial_for_url(
            re.sub("^tcp:", "socket:", url), baudrate=baud, timeout=POLL_S, write_timeout=1.0
        )
    except (OSError, ValueError) as error:
        cure = "check that the server is running and that the URL is correct"
        raise DeviceNotFound("port_url_unreachable", f"cannot open {url} ({error})", cure) from None


def _open_tty(path: str, baud: int) -> Any:
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        ports = ", ".join(port.path for port in find_ports())
        cure = f"choose another --port; this machine has {ports}" if ports else "plug the sensor in"
        raise DeviceNotFound("port_not_found", f"no port {path}", cure) from None
    if not stat.S_ISCHR(mode):
        kind = "directory" if stat.S_ISDIR(mode) else "file"
        cure = f"to read a recording, use imumon replay {path}"
        raise DeviceError("port_not_serial", f"{path} is a {kind}, not a serial port", cure)
    if others := linux_tty.holders(path):  # one that locks nothing would take a part of the bytes
        raise _busy(path, others)
    try:
        port = pyserial.Serial(path, baud, timeout=POLL_S, write_timeout=1.0, exclusive=True)
    except ValueError as error:
        text = f"{path} cannot do {baud} baud ({error})"
        raise DeviceError("baud_unsupported", text, "choose another --baud") from None
    except _LOSS_ERRORS as error:
        raise _open_error(path, error) from None
    with contextlib.suppress(ValueError, OSError, NotImplementedError):  # a pseudo-terminal has no such mode
        port.set_low_latency_mode(True)
    if not os.path.realpath(path).startswith(linux_tty.PSEUDO_TERMINALS):  # it would stay locked after a kill
        with contextlib.suppress(OSError):
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
    return port


def _busy(path: str, programs: Mapping[int, str]) -> DeviceError:
    """Return that a port is in use, with the programs by process that have it open."""
    if not programs:
        cure = f"end it first: sudo fuser -v {path} names it"
        return DeviceError("port_busy", f"{path} is in use by another user's program", cure)
    cure = f"end it first: kill {' '.join(map(str, programs))}"
    return DeviceError("port_busy", f"{path} is in use by {', '.join(programs.values())}", cure)


def _open_error(path: str, error: Exception) -> DeviceError:
    """Return why a port that exists does not open, and the cure."""
    number = getattr(error, "errno", None) or next((a for a in error.args if isinstance(a, int)), None)
    if number in (errno.EACCES, errno.EPERM):
        user = "$USER"
        with contextlib.suppress(KeyError, OSError):  # a container may run under a number without a name
            user = getpass.getuser()
        cure = f"sudo usermod -aG dialout {user}, then log in again"
        return DeviceError("port_permission_denied", f"no permission for {path}", cure)
    if number in (errno.EBUSY, errno.EAGAIN):
        return _busy(path, linux_tty.holders(path))
    if not os.path.exists(path) or number in (errno.EIO, errno.ENXIO, errno.ENODEV, errno.ENOENT):
        text = f"{path} vanished while it was being opened"
        return DeviceNotFound("port_vanished", text, "plug the adapter in again, and check the cable")
    if isinstance(error, termios.error) or number == errno.ENOTTY or linux_tty.is_no_terminal(path):
        return DeviceError("port_not_serial", f"{path} is not a serial port", "choose another --port")
    cure = "unplug the adapter and plug it in again; dmesg shows what its driver reports"
    return DeviceError("port_unusable", f"cannot open {path} ({error})", cure)
