"""Link: a sensor on a port, found, lost and found again.

The session speaks the sensor's language over a port handed to it; this file owns the port. Whatever the
session waits for, it waits in `PortWithDuties.read`, which looks after the daemon's other duties a few times a second
and leaves when the daemon is to stop.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from imumon import report
from imumon.devices.vn100 import Vn100Decoder
from imumon.devices.vn100.vn100_session import (
    NotAVn100,
    SessionError,
    StreamRequest,
    Vn100Info,
    Vn100Session,
)
from imumon.recordings import (
    QUEUE_BYTES,
    PortInfo,
    SerialPort,
    SourceError,
    find_again,
    find_ports,
    holders,
)

BEAT_S = 0.2
FIRST_BAUD = 115200
LAPSE_BYTES = 1 << 19
"""Bytes of a sensor in time-lapse that may wait: it waits itself, and to decode more at once takes memory."""


class NoDevice(Exception):
    """There is no port to read, or none that will do; the text lists what there is."""


class PortWithDuties:
    """An open port as a session wants it, with a heart that beats while it waits.

    Parameters
    ----------
    port : the open port.
    beat : called at least every `BEAT_S` while waiting; raises `Stopped` to end it.
    """

    def __init__(self, port: SerialPort, beat: Callable[[], None]) -> None:
        self.port = port
        self.beat = beat

    @property
    def name(self) -> str:
        return self.port.name

    @property
    def baud(self) -> int:
        return self.port.baud

    @property
    def fixed_baud(self) -> bool:
        return self.port.fixed_baud

    def read(self, timeout: float) -> bytes:
        deadline = time.monotonic() + timeout
        data = self.port.read(0.0)  # what is there comes before all else
        while not data and (left := deadline - time.monotonic()) > 0.0:
            self.beat()
            data = self.port.read(min(left, BEAT_S))
        return data

    def write(self, data: bytes) -> None:
        self.port.write(data)

    def set_baud(self, baud: int) -> bool:
        return self.port.set_baud(baud)

    def reopen(self) -> None:
        self.port.reopen()


class DeviceConnection:
    """The one sensor the daemon reads.

    Parameters
    ----------
    path : port to open; None: the one VN-100 among the serial ports.
    wanted : what to ask of the sensor.
    beat : see `PortWithDuties`.
    progress : told what is being tried.
    lossless : the far end is an emulator in time-lapse, which waits for its reader.

    Attributes
    ----------
    session : None while there is no port.
    obstacle : why a port that is there again could not be had, of the last time.
    decoder : goes through all connections, so that its counters are those of the record.
    """

    def __init__(
        self,
        path: str | None,
        wanted: StreamRequest,
        beat: Callable[[], None],
        progress: Callable[[str], None],
        *,
        lossless: bool = False,
    ) -> None:
        self.path = path
        self.wanted = wanted
        self.decoder = Vn100Decoder()
        self.session: Vn100Session | None = None
        self.obstacle: str | None = None
        self._beat, self._progress, self._lossless = beat, progress, lossless
        self._port: SerialPort | None = None
        self._line: PortWithDuties | None = None
        self._seen: list[PortInfo] = []
        self._serial: str | None = None
        self._before = report.SessionCounters()  # of earlier connections

    @property
    def waits(self) -> bool:
        """Whether to read at once, and not to let bytes gather."""
        return self._port is None or self._port.waits

    def counted(self) -> report.SessionCounters:
        """What was received, and what was lost on the way, of all connections."""
        decoder, port, before = self.decoder, self._port, self._before
        kernel, now = before.kernel_overruns, port.kernel_overruns if port else None
        return report.SessionCounters(
            discarded_bytes=decoder.discarded,
            bad_checksums=decoder.bad_checksums,
            received_bytes=decoder.fed,
            overruns=before.overruns + (port.overruns if port else 0),
            kernel_overruns=kernel if now is None else (kernel or 0) + now,
            most_queued_bytes=max(before.most_queued_bytes or 0, port.most_queued if port else 0),
        )

    def open(self) -> Vn100Info:
        """Open the port and know the sensor, whichever it is.

        Raises
        ------
        NoSensor, PortError, PortGone, SessionError : it is not to be had.
        """
        self._serial = None
        if self.path is None:
            self.path = self._search()
        return self._open(self.path)

    def open_again(self) -> Vn100Info | None:
        """Look for the sensor where it may be back; None while it is not."""
        assert self.path is not None
        for path in find_again(self.path, self._seen, find_ports()):
            try:
                return self._open(path)
            except (SourceError, SessionError, OSError) as error:
                self.obstacle = str(error)
        return None

    def still(self) -> None:
        """From now on waiting is only waiting: nothing else is looked after."""
        if self._line is not None:
            self._line.beat = lambda: None

    def close(self) -> None:
        """Let go of the port; what the session held back is settled."""
        if self._port is not None:
            self._port.close()
            self._before = self.counted()
        self._port = self.session = None

    def _open(self, path: str) -> Vn100Info:
        baud, held = self.wanted.baud or FIRST_BAUD, LAPSE_BYTES if self._lossless else QUEUE_BYTES
        port = SerialPort(path, baud, queue_bytes=held, lossless=self._lossless)
        line = PortWithDuties(port, self._beat)
        try:
            session = Vn100Session(
                line,
                self.wanted,
                time.monotonic,
                decoder=self.decoder,
                serial=self._serial,
                progress=self._progress,
                paced=not self._lossless,
            )
            facts = session.connect()
        except NotAVn100 as error:
            port.close()
            raise NotAVn100(f"{error}{_others(path)}") from None
        except BaseException:
            port.close()
            raise
        self._port, self._line, self.session, self.path = port, line, session, path
        self._serial = facts.serial
        self._seen = find_ports()
        return facts

    def _search(self) -> str:
        """Path of the one VN-100 among the serial ports."""
        ports = find_ports()
        if not ports:
            raise NoDevice("no serial port on this machine: plug the sensor in, or try --port sim")
        found, tried = [], []
        for info in ports:
            try:
                facts = self._open(info.path)
            except (SourceError, SessionError) as error:
                tried.append(told(str(error), info))
                continue
            found.append(f"{info.path} ({facts.model or 'listening'} {facts.serial or ''})")
            self.close()
            self._serial = self.path = None
        if len(found) == 1:
            return found[0].partition(" ")[0]
        if found:
            raise NoDevice(f"several sensors, choose one with --port: {', '.join(found)}")
        raise NoDevice(f"no VN-100 among the serial ports, name one with --port: {'; '.join(tried)}")


def told(why: str, port: PortInfo) -> str:
    """What is wrong with a port, with what is known of it behind its name.

    >>> told("/dev/ttyS0 is silent", PortInfo("/dev/ttyS0", "serial port"))
    '/dev/ttyS0 (serial port) is silent'
    """
    named = f"{port.path} ({port.description})"
    return why.replace(port.path, named, 1) if port.path in why else f"{named}: {why}"


def _others(path: str) -> str:
    """Who else reads a port, and so takes a part of its bytes; a terminal of an emulator is its own."""
    who = [] if os.path.realpath(path).startswith("/dev/pts/") else holders(path)
    return f"; {', '.join(who)} has it open too: end that program first" if who else ""
