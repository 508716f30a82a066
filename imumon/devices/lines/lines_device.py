"""A sensor that prints numbers as a device: lines from a serial port, TCP, UDP or standard input."""

from __future__ import annotations

from imumon.devices.base import DeviceOptions
from imumon.devices.lines.line_columns import SENSORS, LinesUrl
from imumon.devices.lines.line_decoder import LONGEST_LINE, LineDecoder
from imumon.devices.port_device import InterruptiblePort, PortDevice, Session
from imumon.devices.serial_port import STANDARD_INPUT
from imumon.samples import DeviceInfo, SampleBlock

DROPPED = b"\n?"
"""Bytes in the place of dropped ones: the halves of the lines there do not become one line, or a whole one."""


class LinesSession(Session):
    """Lines on an open port; nothing is ever written."""

    def __init__(self, port: InterruptiblePort, url: LinesUrl, name: str, decoder: LineDecoder) -> None:
        self._port, self._url, self._name, self._decoder = port, url, name, decoder
        self._first: bytes | None = None if url.path.startswith(("udp:", STANDARD_INPUT)) else b""

    def info(self) -> DeviceInfo:
        decoder, columns = self._decoder, self._decoder.columns
        return DeviceInfo(
            id=self._url.id,
            kind="sensor that prints lines",
            port=self._name,
            baud=None if self._port.fixed_baud else self._port.baud,
            stream=columns.stream.kind if columns else None,
            source=columns.stream.source if columns else None,
            clock=columns.stream.clock if columns else None,
            sample_rate_hz=self._url.rate_hz,
            settings=columns.settings if columns else {},
            data_settings=tuple(SENSORS),
            caveats=columns.stream.caveats if columns else (),
            remarks=decoder.remarks,
        )

    def read(self, timeout: float) -> bytes:
        """Return bytes; on a line that was on already, from the end of the first line on, for it may be half of one.

        A first line without a number, such as a header, is returned.
        """
        data = self._port.read(timeout)
        if self._first is None:
            return data
        self._first += data
        first, end, rest = self._first.partition(b"\n")
        if not end and len(first) < LONGEST_LINE:
            return b""
        data, self._first = self._first if end and first[:1].isalpha() else rest, None
        return data

    def decode(self, data: bytes) -> list[SampleBlock]:
        return self._decoder.feed(data)


class LinesDevice(PortDevice):
    """One sensor that prints lines."""

    title = "sensor that prints lines"
    mark = DROPPED

    def __init__(self, options: DeviceOptions, url: LinesUrl) -> None:
        self._url, self._name = url, options.url
        self._lines = LineDecoder(self._url.settings)
        waits = self._url.path.startswith(("socket:", STANDARD_INPUT))
        super().__init__(options, self._url.path, self._url.baud, self._lines, lossless=waits)

    def _new_session(self, port: InterruptiblePort) -> LinesSession:
        return LinesSession(port, self._url, self._name, self._lines)
