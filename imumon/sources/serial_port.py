"""Serial port: bytes from and to a serial device or a pyserial URL; also from standard input and UDP.

Reading must never stall: a Linux tty holds 4 kB, which is 44 ms at 921600 baud. So one thread drains the port
into a bounded queue and does nothing else; bytes that do not fit are dropped and counted. This module does not
know what the bytes mean.
"""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import threading
import time
from collections import deque
from typing import Any

from imumon.sources import linux_tty
from imumon.sources.device import DeviceError, DeviceLost, Interrupted
from imumon.sources.ports import (
    LOSS_ERRORS,
    POLL_S,
    READ_BYTES,
    STANDARD_INPUT,
    Datagrams,
    loss_of,
    open_port,
)

QUEUE_BYTES = 8 << 20
"""Bytes in the queue: 90 s at 921600 baud."""
DIALOGUE_S = 1.0
"""s after a write in which the reader delivers every byte at once, because a reply is expected."""
COLLECT_S = 0.05
"""s for which the reader collects bytes otherwise, to save wake-ups."""
FEW_BYTES = 512
"""Bytes of one read from which it collects for less time: at a steady rate, a read then has at most half of what a
tty holds up to 1 Mbit/s. The baud rate does not show it: a board on USB ignores it."""
COLLECT_BYTES = 2048
"""Bytes from which the reader does not wait: half of what a tty holds."""
BAUD_TOLERANCE = 0.03
"""Share by which the real baud rate may differ from the requested one. With 5 % between both ends, the last of the ten
bits of a byte is sampled half a bit off; the other end has an error of its own."""


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
    interrupted : makes `read` raise `Interrupted`, also while it waits.

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
        interrupted: threading.Event | None = None,
    ) -> None:
        self.name = path
        self.received_bytes = self.dropped_bytes = self.most_queued = 0
        self._baud, self._limit, self._lossless, self._mark = baud, queue_bytes, lossless, mark
        self._interrupted = interrupted or threading.Event()
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
    def waits(self) -> bool:
        """Whether to read at once: a whole piece is queued, or no more bytes will arrive."""
        return self._queued >= READ_BYTES or self._loss is not None

    @property
    def other_sender(self) -> str | None:
        """Who else sends datagrams to this port, which are ignored; None: there is no other."""
        return self._serial.other_sender if isinstance(self._serial, Datagrams) else None

    @property
    def has_rival(self) -> bool:
        """Whether another sender sends datagrams to this port at present."""
        return isinstance(self._serial, Datagrams) and self._serial.has_rival(time.monotonic())

    @property
    def other_lines(self) -> int:
        """Lines of other senders so far, which are ignored."""
        return self._serial.other_lines if isinstance(self._serial, Datagrams) else 0

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
        Interrupted : see `interrupted`.
        """
        deadline = time.monotonic() + timeout
        with self._changed:
            while not self._interrupted.is_set() and not self._queue and self._loss is None:
                if (left := deadline - time.monotonic()) <= 0.0:
                    break
                self._changed.wait(min(left, POLL_S))  # `interrupted` does not notify this condition
            if self._interrupted.is_set():
                raise Interrupted
            if not self._queue and self._loss is not None:
                raise self._loss
            piece, size = [], 0
            # bounded: after a stall of the consumer, the queue may hold minutes of data
            while self._queue and size < READ_BYTES:
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
        self._dialogue_until = time.monotonic() + DIALOGUE_S  # before the write: the reply may come during it
        try:
            self._serial.write(data)
        except LOSS_ERRORS as error:
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
        except LOSS_ERRORS as error:
            raise self._fail(error) from None
        with (
            self._changed
        ):  # what arrived at the other rate is garbage, also what the reader had moved already
            self._queue.clear()
            self._queued = 0
        return done

    def _apply(self, baud: int) -> bool:
        try:
            self._serial.baudrate = baud
        except (ValueError, OverflowError):
            return False
        actual = linux_tty.actual_baud(self._fd)
        # a driver that has no such rate sets the nearest one without an error
        return actual is None or abs(actual - baud) <= BAUD_TOLERANCE * baud

    def close(self) -> None:
        """Stop the thread and close the port."""
        self._kernel_before = self.kernel_overruns  # a reopened port counts on; a closed one cannot be asked
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        self._fd = None
        with contextlib.suppress(*LOSS_ERRORS):
            self._serial.close()

    def __enter__(self) -> SerialPort:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self) -> None:
        """Open the port, set its baud rate, and start the thread that drains it."""
        self._serial = open_port(self.name, self._baud)
        self._fd = None
        with contextlib.suppress(io.UnsupportedOperation, AttributeError):  # rfc2217:// has no file behind it
            self._fd = self._serial.fileno()
        self._closing, self._loss, self._dropping, self._empty = False, None, False, 0
        try:
            # the driver counts since it was loaded, whoever had the port open
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
        if self._fd is None:
            return bytes(self._serial.read(max(1, self._serial.in_waiting)))
        if not select.select([self._fd], [], [], POLL_S)[0]:  # with a limit: `close` only sets a flag
            self._empty = 0
            return b""
        if isinstance(self._serial, Datagrams):
            return self._serial.receive()
        try:
            data = os.read(self._fd, READ_BYTES)
        except (BlockingIOError, InterruptedError):  # another program that reads the port was faster
            return b""
        if not data and self.name == STANDARD_INPUT:
            raise EOFError
        # Ready without data: Linux shows an unplugged adapter so, or a flush between the two calls.
        self._empty = 0 if data else self._empty + 1
        if not data and (self.fixed_baud or self._empty > 100 or linux_tty.hung_up(self._fd)):
            raise OSError(errno.EIO, "hung up")
        return data

    def _keep(self, data: bytes) -> None:
        """Put bytes into the queue; wait for room if the other end waits too, else drop what does not fit."""
        with self._changed:
            # an empty queue takes a piece of any size: one larger than the limit would never fit
            while self._lossless and self._queue and self._is_full(data) and not self._closing:
                self._changed.wait(POLL_S)
            self.received_bytes += len(data)
            dropped_before, self._dropping = self._dropping, not self._lossless and self._is_full(data)
            if self._dropping:
                self.dropped_bytes += len(data)
                self._episodes += not dropped_before
                return
            if dropped_before:  # or the halves of two messages would become one
                data = self._mark + data
            self._queue.append(data)
            self._queued += len(data)
            self.most_queued = max(self.most_queued, self._queued)
            self._changed.notify_all()

    def _is_full(self, data: bytes) -> bool:
        return self._queued + len(data) > self._limit

    def _fail(self, error: Exception) -> DeviceLost:
        """Record that the port has vanished; return the error."""
        lost = loss_of(self.name, error)
        with self._changed:
            # the first cause is kept; what fails while the port is being closed is no loss
            if self._loss is None and not self._closing:
                self._loss = lost
            self._changed.notify_all()
        return lost
