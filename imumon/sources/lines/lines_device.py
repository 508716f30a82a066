"""A sensor that prints numbers as a device: lines from a serial port, TCP, UDP or standard input."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from imumon.model.ledger import column_account
from imumon.model.samples import DeviceInfo, SampleBlock
from imumon.sources.device import DeviceOptions
from imumon.sources.lines.line_columns import SENSORS, LinesUrl
from imumon.sources.lines.line_decoder import LONGEST_LINE, LineDecoder
from imumon.sources.port_device import PortDevice, RateCheck, Session
from imumon.sources.ports import STANDARD_INPUT
from imumon.sources.serial_port import SerialPort

CLOCK_RATIO = 2.0
"""Factor between the two beyond which the unit of the time is doubted; wrong units differ by 1000."""
DROPPED = b"\n?"
"""Bytes in the place of dropped ones: the halves of the lines there do not become one line, or a whole one."""


class LinesSession(Session):
    """Lines on an open port; nothing is ever written."""

    def __init__(self, port: SerialPort, url: LinesUrl, name: str, decoder: LineDecoder) -> None:
        self._port, self._url, self._name, self._decoder = port, url, name, decoder
        self._paced = not url.path.startswith(STANDARD_INPUT)  # a file arrives faster than it was measured
        self._rate_check = RateCheck()
        self._newest_ns = 0  # time of the newest line
        # a datagram and an input begin with a whole line; a port or a server may be in the middle of one
        self._first: bytes | None = None if url.path.startswith(("udp:", STANDARD_INPUT)) else b""

    def info(self) -> DeviceInfo:
        decoder, columns, rate_doubts = self._decoder, self._decoder.columns, tuple(self._rate_doubts())
        facts: dict[str, Any] = {"caveats": ()}
        if columns is not None:
            facts = {
                **columns.stream.facts,
                "settings": columns.settings,
                "columns": column_account(columns.account),
                "caveats": (*columns.stream.caveats, *columns.caveats),
            }
        rivals = ("other_sender",) if self._port.has_rival else ()
        facts["caveats"] += rivals + (("doubtful_rate",) if rate_doubts else ())
        return DeviceInfo(
            id=self._url.id,
            kind="sensor that prints lines",
            port=self._name,
            baud=None if self._port.fixed_baud else self._port.baud,
            sample_rate_hz=self._url.rate_hz,
            data_settings=tuple(SENSORS),
            remarks=(*decoder.remarks, *self._doubts(), *rate_doubts),
            **facts,
        )

    def _doubts(self) -> Iterator[str]:
        """Yield who else sends."""
        # without a number of lines: a remark that changes would be an event each time
        if (sender := self._port.other_sender) is not None:
            cure = "name the sensor with from=ADDRESS if it is not the first one, or sends from several ports"
            yield f"lines of another sender, {sender}, are ignored: {cure}"

    def _rate_doubts(self) -> Iterator[str]:
        """Yield what does not fit the host clock: the time of the lines, or the given rate."""
        ratio, columns, rate_hz = self._rate_check.rate_hz, self._decoder.columns, self._url.rate_hz
        if columns is not None and columns.layout.times:
            if ratio is not None and not 1.0 / CLOCK_RATIO < ratio < CLOCK_RATIO:
                shown = f"{float(f'{ratio:.2g}'):,g}"
                yield f"the time of the lines advances by {shown} s in a second: check its unit in the URL"
        elif rate_hz is not None and (remark := self._rate_check.remark(rate_hz)) is not None:
            yield remark

    def read(self, timeout: float) -> bytes:
        """Return bytes, without the first line of a stream that had begun before: it may be half of one.

        A first line that begins with a letter, such as a header, is kept.
        """
        data = self._port.read(timeout)
        if self._first is None:
            return data
        self._first += data
        first, end, rest = self._first.partition(b"\n")
        if not end and len(first) < LONGEST_LINE:
            return b""
        # half a line begins with a digit, sign, comma or blank; a server sends its header once, at the connection
        if end and first[:1].isalpha():
            data = self._first
        else:
            data = rest
            self._decoder.skip_line()
        self._first = None
        return data

    def decode(self, data: bytes) -> list[SampleBlock]:
        blocks = self._decoder.feed(data)
        for block in blocks if self._paced else ():
            now = time.monotonic()
            if block.time_ns is None and self._url.rate_hz is not None:
                self._rate_check.update(len(block) + int(block.lost.sum()), now, self._url.rate_hz)
            elif block.time_ns is not None:
                step_ns = int(block.time_ns[-1]) - self._newest_ns
                self._newest_ns += step_ns
                if step_ns < 0:  # a restarted sensor
                    self._rate_check.restart()
                self._rate_check.update(step_ns * 1e-9, now, 1.0)
        return blocks


class LinesDevice(PortDevice):
    """One sensor that prints lines."""

    title = "sensor that prints lines"
    mark = DROPPED

    def __init__(self, options: DeviceOptions, url: LinesUrl) -> None:
        self._url, self._name = url, options.url
        self._lines = LineDecoder(self._url.settings, self._url.rate_hz)
        # the other end of these stops when nothing is read; a serial board and a sender of datagrams do not notice
        waits = self._url.path.startswith(("socket:", "tcp:", STANDARD_INPUT))
        super().__init__(options, self._url.path, self._url.baud, self._lines, lossless=waits)

    def _new_session(self, port: SerialPort) -> LinesSession:
        return LinesSession(port, self._url, self._name, self._lines)
