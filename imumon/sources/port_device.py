"""Device on a port: what sensors on serial lines share, whatever they send.

A family of sensors is a `Session`: what its bytes mean, and what it writes. `PortDevice` finds the port, loses it and
finds it again, keeps the counters over all connections, and keeps the original settings of a sensor on disk while
they are changed: a process that was killed leaves the file behind, and the next one restores the sensor at its end.
"""

from __future__ import annotations

import json
import os
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import ClassVar

from imumon.files import SMALL_BYTES, read_bounded, write_new
from imumon.grid.interval import RATE_TOLERANCE
from imumon.model.samples import DeviceCounters, DeviceInfo, Item, Notice, RawBytes, SampleBlock
from imumon.sources.device import (
    ARRIVAL_SAMPLES,
    BATCH_S,
    READ_S,
    Device,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceOptions,
    Interrupted,
    RawDecoder,
    sample_blocks,
)
from imumon.sources.ports import POLL_S, PortInfo, find_again, find_ports
from imumon.sources.serial_port import QUEUE_BYTES, SerialPort

TIME_LAPSE_QUEUE_BYTES = 1 << 19
"""Bytes of an emulator in time-lapse that may wait; it waits for its reader anyway."""
QUIET_UNKNOWN_S = 3.0
"""s without samples after which a stream of unknown rate is silent, and the comparison of the rate starts again."""
RATE_SHORTEST_S = 5.0
"""s of samples before the rate is judged."""
RATE_LONGEST_S = 120.0
"""s after which the comparison starts again, so that a change of the rate shows."""


class RateCheck:
    """Compare the rate at which samples arrive with the configured one.

    A stream without a clock gets its time from a configured rate alone, and a wrong one makes all of N, B and K
    wrong. So it is compared with the host clock. The seconds of a clock of the samples are compared in the same way,
    as a rate of 1 Hz.

    Attributes
    ----------
    rate_hz : Hz, at which samples arrive; None: at the configured rate, or not known yet.
    """

    def __init__(self) -> None:
        self.rate_hz: float | None = None
        self._start: float | None = None
        self._last, self._count = 0.0, 0.0

    def restart(self) -> None:
        """Discard earlier samples."""
        self._start = None

    def update(self, count: float, now: float, nominal_hz: float) -> None:
        """Add `count` samples, lost ones included, that arrived at `now`, s monotonic."""
        if self._start is None or now - self._last > max(QUIET_UNKNOWN_S, 4.0 / nominal_hz):
            # the samples of this block were measured before `now`, where the comparison begins: they do not count
            self._start, self._last, self._count = now, now, 0.0
            return
        self._last = now
        self._count += count
        span = now - self._start
        if span < RATE_SHORTEST_S:
            return
        error_s = abs(self._count / nominal_hz - span)
        if error_s > RATE_TOLERANCE * span + READ_S + ARRIVAL_SAMPLES / nominal_hz:
            rate = self._count / span
            if self.rate_hz is None or abs(rate / self.rate_hz - 1.0) > RATE_TOLERANCE:
                self.rate_hz = rate
        elif error_s < RATE_TOLERANCE * span:  # between the two, late batches decide: what was said stays
            self.rate_hz = None
        if span > RATE_LONGEST_S:
            self._start = None

    def remark(self, nominal_hz: float) -> str | None:
        """Return the remark for the report; None if the rate is correct."""
        if self.rate_hz is None:
            return None
        return f"samples arrive at {self.rate_hz:.3g} Hz, not at the configured {nominal_hz:g} Hz: correct the rate"


class Session(ABC):
    """What a family of sensors does on an open port. A sensor that only sends needs `info`, `read`, `decode`.

    Attributes
    ----------
    quiet_s : s without a sample after which the sensor is looked for and configured again; None: it is waited for.
    """

    quiet_s: float | None = None

    def connect(self) -> DeviceInfo:
        """Identify the sensor, without changing it.

        Raises
        ------
        DeviceNotFound : no sensor of this family is on the port.
        """
        return self.info()

    @abstractmethod
    def info(self) -> DeviceInfo:
        """Return what is known of the sensor and its stream."""

    def save_settings(self, saved: Mapping[str, str] | None = None) -> dict[str, str]:
        """Return the settings to restore at the end; empty: nothing will be changed.

        Parameters
        ----------
        saved : the return value in an earlier process that ended without `restore`; None: there was none.
        """
        return {}

    def configure(self) -> DeviceInfo:
        """Make the sensor stream."""
        return self.info()

    def changes(self) -> str | None:
        """Return which output was changed and what is restored at the end; None without a change."""
        return None

    @abstractmethod
    def read(self, timeout: float) -> bytes:
        """Return bytes of the stream; wait up to `timeout` seconds for the first."""

    @abstractmethod
    def decode(self, data: bytes) -> Sequence[object]:
        """Return the items in bytes that `read` returned."""

    def is_alive(self, block: SampleBlock) -> bool:
        """Return whether a block shows that the sensor sends what was configured."""
        return True

    def check_health(self) -> list[Notice]:
        """Return what the sensor reports; called a few times a second once it was started.

        Raises
        ------
        DeviceLost : it has to be configured again.
        """
        return []

    def restore(self) -> bool:
        """Restore the saved settings; return whether the sensor has confirmed each."""
        return True


class PortDevice(Device):
    """A device on a serial port or a pyserial URL.

    Parameters
    ----------
    options : see `DeviceOptions`.
    path : of the port; empty: the only one on which a session connects.
    baud : bit/s at which the port is opened.
    decoder : of all connections, so that its counters continue.
    lossless : the other end waits for its reader, and nothing may be dropped.

    Attributes
    ----------
    title : noun for the sensor, such as "VN-100".
    mark : bytes put where others were dropped, see `SerialPort`.
    """

    title: ClassVar[str]
    mark: ClassVar[bytes] = b""

    def __init__(
        self, options: DeviceOptions, path: str, baud: int, decoder: RawDecoder, *, lossless: bool = False
    ) -> None:
        super().__init__()
        self._given_path = self._path = path
        self._baud, self._decoder, self._lossless = baud, decoder, lossless
        self._state_directory = options.state_directory
        self._time_lapse = options.time_lapse
        self._port: SerialPort | None = None
        self._session: Session | None = None
        self._earlier = DeviceCounters()  # of earlier connections
        self._ports: list[PortInfo] = []  # when the sensor was found
        self._serial: str | None = None
        self._identified = self._streaming = self._started = False
        self._info: DeviceInfo | None = None
        self._pending: DeviceError | None = None
        self._changes: str | None = None  # of the outputs of the sensor, to report once
        self._saved_settings: Path | None = None
        self._original: dict[str, str] | None = None  # settings to restore, of this process
        self._sample_at = 0.0  # s monotonic, of the last sample

    @abstractmethod
    def _new_session(self, port: SerialPort) -> Session:
        """Return a session on an open port."""

    # ------------------------------------------------------------------ start and end

    def open(self) -> DeviceInfo:
        """Find the sensor and identify it; after a loss, where it may be again.

        Raises
        ------
        DeviceNotFound : there is no such port, or no sensor of this family on it.
        DeviceError : the port cannot be used, or another sensor is on it.
        """
        if not self._identified:  # until it was started, another sensor may take its place
            self._serial = None
            self._path = self._given_path or self._search()
        paths = [self._path]
        if self._identified:
            paths = find_again(self._path, self._ports, find_ports())
        # raised if no port is left at all; else the error of the last one is, which was tried
        error: DeviceError = DeviceNotFound(
            "port_not_found", f"no port {self._path}", "plug the sensor in again"
        )
        for path in paths:
            try:
                return self._open(path)
            except DeviceError as problem:
                error = problem
        raise error

    def start(self) -> DeviceInfo:
        session = self._connected()
        self._save_settings(session)  # before the first write: a kill may follow at any moment
        self._started = True
        self._info = session.configure()
        self._sample_at = time.monotonic()
        self._changes = session.changes()
        self._identified = True
        return self._info

    def restore(self) -> bool:
        if self._session is None:
            return self._saved_settings is None  # it is gone: the saved settings stay for the next run
        if not self._session.restore():
            return False
        if self._saved_settings is not None:
            with suppress(OSError):
                self._saved_settings.unlink(missing_ok=True)
        return True

    def close(self) -> None:
        if self._port is not None:
            self._port.close()
            self._baud = (
                self._port.baud
            )  # the first to be tried: after a loss, the sensor most likely still has it
            self._earlier = self.counters  # those of the port end with it; the decoder continues
        self._port = self._session = self._pending = None
        self._streaming = self._started = False

    def _open(self, path: str) -> DeviceInfo:
        """Open a port and identify the sensor on it; the port is closed again if that fails."""
        limit = TIME_LAPSE_QUEUE_BYTES if self._time_lapse else QUEUE_BYTES
        port = SerialPort(
            path,
            self._baud,
            queue_bytes=limit,
            lossless=self._time_lapse or self._lossless,
            mark=self.mark,
            interrupted=self.interrupted,
        )
        try:
            session = self._new_session(port)
            info = session.connect()
            if self._serial not in (None, info.serial):  # it would be configured, and continue the record
                text = f"the sensor on {path} is {info.serial or 'unknown'}, not {self._serial}"
                raise DeviceError("other_sensor", text, "connect the first one again, or restart imumon")
        except BaseException:  # an interrupt, too: the port would stay locked, and its thread would run on
            port.close()
            raise
        self._port, self._session, self._path = port, session, path
        self._serial = info.serial
        self._ports = find_ports()
        self._info = info
        return info

    def _search(self) -> str:
        """Return the path of the only sensor of this family on the serial ports."""
        ports = find_ports()
        if not ports:
            raise DeviceNotFound(
                "no_serial_port", "no serial port on this machine", "plug the sensor in, or try --port sim"
            )
        sensors: dict[str, str] = {}  # path -> what answers there
        problems = []
        for port in ports:
            try:
                info = self._open(port.path)
            except DeviceError as error:
                problems.append(f"{error.message} ({port.description})")
                continue
            sensors[port.path] = f"{port.path} ({info.model or 'listen-only'} {info.serial or ''})"
            self.close()
            self._serial, self._path = None, ""
        if len(sensors) == 1:
            return next(iter(sensors))
        if sensors:
            names = ", ".join(sensors.values())
            raise DeviceNotFound("several_devices", f"several sensors: {names}", "choose one with --port")
        text = f"no {self.title} on the serial ports: {'; '.join(problems)}"
        raise DeviceNotFound("no_device", text, "name one with --port")

    def _save_settings(self, session: Session) -> None:
        """Write the original settings to disk before they are changed."""
        directory = self._state_directory
        if directory is None or self._info is None:
            self._original = session.save_settings(self._original)
            return
        path = directory / f"{self._info.id}.found.json"
        self._original = settings = session.save_settings(self._original or _saved_settings(path))
        if settings:  # nothing with listen-only: what an earlier run saved stays
            with suppress(OSError):  # a full disk prevents no run: it then restores from memory alone
                new = path.with_suffix(".new")
                write_new(new, json.dumps(settings).encode())
                os.replace(new, path)
            self._saved_settings = path

    def _connected(self) -> Session:
        if self._session is None:
            raise DeviceError("device_closed", "the device is not open", "open it first")
        return self._session

    # ------------------------------------------------------------------ while it streams

    def info(self) -> DeviceInfo:
        if self._session is not None:
            self._info = self._session.info()
        assert self._info is not None
        return self._info

    def read(self, timeout_s: float) -> list[Item]:
        session, port = self._connected(), self._port
        assert port is not None
        if self._streaming and timeout_s > 0.0:  # not before the first sample, which should show at once
            self._collect(port)
        if self._pending is not None:
            error, self._pending = self._pending, None
            raise error
        items: list[Item] = []
        if self._changes is not None:
            items.append(Notice("reconfigured", self._changes, "info"))
            self._changes = None
        try:
            data = session.read(timeout_s)
        except DeviceLost as lost:
            self._pending = lost
            return self.finish()  # samples first: a message may have been complete but undecided
        if data:
            items.append(RawBytes(data))
            blocks = sample_blocks(session.decode(data))
            self._streaming |= bool(blocks)
            if any(map(session.is_alive, blocks)):
                self._sample_at = time.monotonic()
            items += blocks
        if self._started:  # without `start` nothing may be repaired: that writes to the sensor
            items += self._health_items(session, keep=bool(items))
        return items

    def _collect(self, port: SerialPort) -> None:
        """Let bytes collect for `BATCH_S`; less if a whole piece is queued, or the port is lost."""
        end = time.monotonic() + BATCH_S
        while not port.waits and (left := end - time.monotonic()) > 0.0:
            if self.interrupted.wait(min(left, POLL_S)):
                raise Interrupted

    def _health_items(self, session: Session, keep: bool) -> list[Item]:
        """Return what the health check finds; an error waits for the next read, as samples are delivered first."""
        quiet_s = session.quiet_s
        try:
            if self._streaming and quiet_s is not None and time.monotonic() - self._sample_at > quiet_s:
                text = f"no sample arrives from the sensor on {self._path}"
                raise DeviceLost("device_lost", text, "check its power and the cable")
            return list[Item](session.check_health())
        except DeviceError as error:
            self._pending = error
            return self.finish()
        except Interrupted:  # the next read raises it again
            if not keep:
                raise
        return []

    def finish(self) -> list[Item]:
        return [*sample_blocks(self._decoder.finish())]

    @property
    def counters(self) -> DeviceCounters:
        decoder, port, earlier = self._decoder, self._port, self._earlier
        kernel, now = earlier.kernel_overruns, port.kernel_overruns if port else None
        return DeviceCounters(
            received_bytes=decoder.fed,
            messages=decoder.messages,
            discarded_bytes=decoder.discarded,
            bad_checksums=decoder.bad_checksums,
            overruns=earlier.overruns + (port.overruns if port else 0),
            kernel_overruns=kernel if now is None else (kernel or 0) + now,
            other_sender=earlier.other_sender + (port.other_lines if port else 0),
            ledger=decoder.ledger,
            most_queued_bytes=max(earlier.most_queued_bytes or 0, port.most_queued if port else 0),
        )


def _saved_settings(path: Path) -> dict[str, str] | None:
    """Return the settings that a killed run saved; None if there are none that can be read.

    They are written to the sensor at the end: a value has the characters of a setting, and no other command.
    """
    try:
        saved = json.loads(read_bounded(path, SMALL_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(saved, dict):
        return None
    valid = all(
        re.fullmatch(r"[0-9]{1,3}|[a-z ]+", name) and re.fullmatch(r"[A-Za-z0-9.,+-]{0,400}", str(text))
        for name, text in saved.items()
    )
    return saved if valid and all(isinstance(text, str) for text in saved.values()) else None
