"""Commands to a VN-100: find its baud rate, send requests, read and write registers.

The port and the clock are arguments. Every wait is bounded: a full scan of the baud rates takes less than ten
seconds, twelve if nothing may be sent. Replies are always ASCII sentences, also between binary packets. Replies
go through a decoder of their own, so that the counters of the record cover the record alone.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from imumon.sources.device import DeviceNotFound
from imumon.sources.serial_port import SerialPort
from imumon.sources.vn100.ascii import Response, SensorError, encode
from imumon.sources.vn100.decoder import DecodedItem, Vn100Decoder
from imumon.sources.vn100.registers import ErrorCode

LISTEN_S = 0.1
"""s to listen before the first request: a stream of 20 Hz or more needs none."""
LISTEN_ONLY_S = 1.2
"""s to listen at one baud rate where nothing may be sent: a stream of 1 Hz has to show."""
REPLY_S = 0.3
"""s to wait for a reply. The sensor replies within 20 ms; a USB adapter adds 16 ms."""
TRIES = 5
"""Most requests for one reply: a line that damages one byte in a hundred damages every fourth reply."""

_RETRIABLE = {
    ErrorCode.HARD_FAULT,
    ErrorCode.SERIAL_INPUT_BUFFER_OVERFLOW,
    ErrorCode.INVALID_CHECKSUM,
    ErrorCode.WATCHDOG_RESET,
    ErrorCode.SERIAL_OUTPUT_BUFFER_OVERFLOW,
    ErrorCode.ERROR_BUFFER_OVERFLOW,
}
"""Error codes that are not about the request, or after which it should be sent again."""


class NotAVn100(DeviceNotFound):
    """No VN-100 replies on this port."""


class CommandChannel:
    """Requests and replies over one port.

    Parameters
    ----------
    port : open port.
    clock : s, monotonic.
    listen_only : send nothing.
    progress : called with a short text about the current step.

    Attributes
    ----------
    settings : register values as last read or written, fields joined by commas, by number.
    written : registers that were written.
    error_code : error code of the last `write`; None if it was accepted or had no reply.
    decoder : decoder of the replies.
    """

    def __init__(
        self, port: SerialPort, clock: Callable[[], float], listen_only: bool, progress: Callable[[str], None]
    ) -> None:
        self.port = port
        self.settings: dict[int, str] = {}
        self.written: set[int] = set()
        self.error_code: int | None = None
        self.decoder = Vn100Decoder()
        self._clock, self._listen_only, self._progress = clock, listen_only, progress

    def find_baud(self, bauds: Iterable[int]) -> None:
        """Set the port to the baud rate of the sensor, one of `bauds`, tried in this order.

        Raises
        ------
        NotAVn100 : no VN-100 replies.
        """
        evidence, tried, before = _Evidence(), list(bauds), self.port.baud
        # First one request at each rate, which finds most sensors soon. The second round is for a slow stream or a
        # damaged line, and for a sensor whose reply to the first request after the opening was lost, as it often is.
        for thorough in (False, True):
            for baud in tried:
                self._progress(f"trying {baud} baud")
                if self.port.set_baud(baud):
                    if self.is_present(thorough, evidence):
                        return
                elif len(tried) == 1:  # of several, an adapter without one of them can still find the sensor
                    raise baud_unsupported(self.port.name, baud)
        self.port.set_baud(before)
        raise evidence.error(self.port.name, tried)

    def is_present(self, thorough: bool = False, evidence: _Evidence | None = None) -> bool:
        """Return whether valid messages arrive at this baud rate, with or without a request."""
        evidence = _Evidence() if evidence is None else evidence
        self.decoder = Vn100Decoder()
        listening = LISTEN_S if not thorough else LISTEN_ONLY_S if self._listen_only else 0.0
        if self._receives_message(listening, evidence):
            return True
        for _ in range(0 if self._listen_only else 2 if thorough else 1):
            self._send("VNRRG,01")
            if self._receives_message(REPLY_S, evidence):
                return True
        return False

    def _receives_message(self, seconds: float, evidence: _Evidence) -> bool:
        """Listen up to `seconds`; return whether a valid message has arrived."""
        deadline = self._clock() + seconds
        while (left := deadline - self._clock()) > 0:
            data = self.port.read(left)
            evidence.add(data)
            self.decoder.feed(data)
            if self.decoder.messages:
                return True
        self.decoder.finish()  # a pending start of a packet may hide a sentence
        return self.decoder.messages > 0

    def _send(self, body: str) -> None:
        self.port.write(encode(body))

    def request(self, body: str, tries: int = TRIES) -> Response | SensorError | None:
        """Send a command and return the reply; None if there is none."""
        self.decoder.feed(self.port.read(0.0))  # late replies to earlier requests
        for _ in range(tries):
            self._send(body)
            deadline = self._clock() + REPLY_S
            while (left := deadline - self._clock()) > 0:
                if (reply := _reply(body, self.decoder.feed(self.port.read(left)))) is not None:
                    return reply
            # bytes before the reply that look like the start of a packet have held it back
            if (reply := _reply(body, self.decoder.finish())) is not None:
                return reply
        return None

    def read(self, register: int) -> str | None:
        """Return the value of a register; None if the sensor has none or does not reply."""
        reply = self.request(f"VNRRG,{register:02d}")
        return ",".join(reply.fields[1:]) if isinstance(reply, Response) else None

    def write(self, register: int, text: str) -> bool:
        """Write a register unless it has this value; `settings` then has the value of the sensor."""
        self.error_code = None
        before = self.settings.get(register)
        if before == text:
            return True
        self.written.add(
            register
        )  # before the request: of a lost reply, nothing shows whether it was written
        self.settings.pop(register, None)  # unknown until the sensor confirms it
        reply = self.request(f"VNWRG,{register:02d},{text}")
        if isinstance(reply, Response):
            self.settings[register] = ",".join(reply.fields[1:])
            return True
        if reply is not None:
            self.error_code = reply.code
            if before is not None:
                self.settings[register] = before
        return False


def baud_unsupported(port: str, baud: int) -> DeviceNotFound:
    """Return the error of an adapter that cannot do a baud rate."""
    text = f"the adapter of {port} cannot do {baud} baud"
    return DeviceNotFound("baud_unsupported", text, "choose another --baud")


class _Evidence:
    """Bytes received during a scan, for the error message."""

    def __init__(self) -> None:
        self._count, self._text = 0, b""

    def add(self, data: bytes) -> None:
        self._count += len(data)
        # random bytes, as at a wrong baud rate, have no 24 of these in a row
        lines = [line.strip() for line in re.findall(rb"[ -~\t\r\n]{24,}", data)]
        self._text = max((self._text, *lines), key=len)

    def error(self, port: str, bauds: list[int]) -> NotAVn100:
        """Return the error with the kind of the received bytes."""
        where = "at every baud rate" if len(bauds) > 1 else f"at {bauds[0]} baud"
        if not self._count:
            cure = "check its power, that transmit and receive are not swapped, and that the port is correct"
            return NotAVn100("device_silent", f"{port} sends nothing {where}", cure)
        if self._text:
            shown = self._text.splitlines()[0][:40].decode("ascii")
            text = f"{port} sends text without a valid message of a VN-100 ({shown!r})"
            cure = f"check the cable, choose another --port, or if it prints numbers, --port lines:{port}"
            return NotAVn100("device_sends_text", text, cure)
        text = f"{port} sends bytes ({self._count} received) but no valid message {where}"
        cure = "choose another --port or --baud, or a cable of other levels (RS-232, 3 V)"
        return NotAVn100("device_sends_garbage", text, cure)


def _reply(body: str, items: Iterable[DecodedItem]) -> Response | SensorError | None:
    """Return the reply to a command among decoded items."""
    command, *fields = body.split(",")
    for item in items:
        # an error does not name its request: one that is about a request is about the last one
        if isinstance(item, SensorError) and item.code not in _RETRIABLE:
            return item
        if isinstance(item, Response) and item.command == command:
            if command not in ("VNRRG", "VNWRG"):
                return item
            # a late reply to an earlier request may have another register
            number = item.fields[0] if item.fields else ""
            if number.isdigit() and int(number) == int(fields[0]):
                return item
    return None
