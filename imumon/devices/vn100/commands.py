"""Dialogue with a VN-100: find its baud, ask it, write its registers.

The port and the clock are handed in. Every wait is bounded; a full scan of the bauds takes less than ten
seconds, twelve when nothing may be asked. Answers are always sentences, also between binary packets. What
comes during a dialogue goes through a decoder of its own: the record's counters count the record alone.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Protocol

from imumon.devices.vn100.ascii import Response, SensorError, encode
from imumon.devices.vn100.decoder import DecodedItem, Vn100Decoder

BAUDS = (115200, 921600, 460800, 230400, 57600, 38400, 19200, 9600)
"""Bauds in the order they are tried."""
LISTEN_S = 0.1  # before the first question: what streams at 20 Hz or faster need not be asked
PATIENT_S = 1.2  # where nothing may be asked
ANSWER_S = 0.3
TRIES = 5  # a line that spoils one byte in a hundred spoils every fourth answer

_UNASKED = {0x01, 0x02, 0x03, 0x0A, 0x0B, 0xFF}  # not about what was asked, or worth asking again
_NMEA = re.compile(rb"\$(G[A-Z][A-Z]{3}|P[A-Z]{3,8}),[ -~]*")


class SessionError(Exception):
    """The sensor cannot be used; the text is one line: what, and how to mend it."""


class NotAVn100(SessionError):
    """Nothing on this port answers like a VN-100."""


class SensorChanged(SessionError):
    """Another sensor answers than the one the session was made for."""


class Port(Protocol):
    """What a session needs of a port; it may raise what it likes when the port has vanished."""

    @property
    def name(self) -> str: ...

    @property
    def baud(self) -> int: ...

    @property
    def fixed_baud(self) -> bool:
        """Whether setting a baud has no effect."""

    def read(self, timeout: float) -> bytes:
        """What is there; waits up to `timeout` seconds for the first byte."""

    def write(self, data: bytes) -> None: ...

    def set_baud(self, baud: int) -> bool:
        """Change the baud and forget what was received; False when the adapter cannot."""

    def reopen(self) -> None: ...


class CommandChannel:
    """Questions and answers over one port.

    Parameters
    ----------
    port : open port.
    clock : seconds, monotonic.
    silent : write nothing, only listen.
    progress : told in a few words what is being tried.

    Attributes
    ----------
    settings : register values as last read or written, fields joined by commas, by number.
    touched : registers that were written.
    refusal : error code of the last `write`, None when it was accepted or not answered.
    decoder : the decoder of the dialogue.
    """

    def __init__(
        self, port: Port, clock: Callable[[], float], silent: bool, progress: Callable[[str], None]
    ) -> None:
        self.port = port
        self.settings: dict[int, str] = {}
        self.touched: set[int] = set()
        self.refusal: int | None = None
        self.decoder = Vn100Decoder()
        self._clock, self._silent, self._progress = clock, silent, progress

    def find(self, bauds: Iterable[int]) -> None:
        """Set the port to the sensor's baud, one of `bauds`, tried in this order.

        Raises
        ------
        NotAVn100 : nothing answers like one; the text says what was seen.
        """
        seen, tried, before = _Seen(), list(bauds), self.port.baud
        for thorough in (False, True):
            for baud in tried:
                self._progress(f"trying {baud} baud")
                if self.port.set_baud(baud):
                    if self.is_here(thorough, seen):
                        return
                elif len(tried) == 1:
                    raise SessionError(
                        f"the adapter of {self.port.name} cannot do {baud} baud: choose another"
                    )
                if seen.nmea:
                    raise NotAVn100(f"{self.port.name} {seen.verdict(tried)}")
        self.port.set_baud(before)
        raise NotAVn100(f"{self.port.name} {seen.verdict(tried)}")

    def is_here(self, thorough: bool = False, seen: _Seen | None = None) -> bool:
        """Whether valid messages come at this baud, by themselves or asked for."""
        seen = _Seen() if seen is None else seen
        self.decoder = Vn100Decoder()
        listening = LISTEN_S if not thorough else PATIENT_S if self._silent else 0.0
        if self._hear(listening, seen):
            return True
        for _ in range(0 if self._silent else 2 if thorough else 1):
            self._send("VNRRG,01")
            if self._hear(ANSWER_S, seen):
                return True
        return False

    def _hear(self, seconds: float, seen: _Seen) -> bool:
        """Listen until a valid message has come, or so long."""
        deadline = self._clock() + seconds
        while (left := deadline - self._clock()) > 0:
            data = self.port.read(left)
            seen.add(data)
            self.decoder.feed(data)
            if self.decoder.messages:
                return True
        self.decoder.finish()  # what looks like the beginning of a packet may hide a sentence
        return self.decoder.messages > 0

    def _send(self, body: str) -> None:
        self.port.write(encode(body))

    def ask(self, body: str, tries: int = TRIES) -> Response | SensorError | None:
        """Answer to a command, None when none came."""
        self.decoder.feed(self.port.read(0.0))  # late answers to what was asked before
        for _ in range(tries):
            self._send(body)
            deadline = self._clock() + ANSWER_S
            while (left := deadline - self._clock()) > 0:
                answer = _answer(body, self.decoder.feed(self.port.read(left)))
                if answer is not None:
                    return answer
            answer = _answer(body, self.decoder.finish())
            if answer is not None:
                return answer
        return None

    def wake(self) -> None:
        """Let a paused sensor stream again; its answer is not waited for."""
        self._send("VNASY,1")

    def read(self, register: int) -> str | None:
        """Value of a register, None when the sensor has none or does not answer."""
        answer = self.ask(f"VNRRG,{register:02d}")
        return ",".join(answer.fields[1:]) if isinstance(answer, Response) else None

    def write(self, register: int, text: str) -> bool:
        """Write a register unless it holds just that; what the sensor then holds is in `settings`."""
        self.refusal = None
        before = self.settings.get(register)
        if before == text:
            return True
        self.touched.add(register)
        self.settings.pop(register, None)  # not known until it is confirmed, which may never be
        answer = self.ask(f"VNWRG,{register:02d},{text}")
        if isinstance(answer, Response):
            self.settings[register] = ",".join(answer.fields[1:])
            return True
        if answer is not None:
            self.refusal = answer.code
            if before is not None:
                self.settings[register] = before
        return False


class _Seen:
    """What came while looking for a sensor, for the verdict."""

    def __init__(self) -> None:
        self.count = 0
        self.nmea: str | None = None
        self._text = b""

    def add(self, data: bytes) -> None:
        self.count += len(data)
        found = _NMEA.search(data)
        if found is not None and self.nmea is None:
            self.nmea = found[1].decode("ascii")
        lines = [line.strip() for line in re.findall(rb"[ -~\t\r\n]{24,}", data)]
        self._text = max((self._text, *lines), key=len)

    def verdict(self, bauds: list[int]) -> str:
        """Predicate of a sentence whose subject is the port."""
        where = "at every baud" if len(bauds) > 1 else f"at {bauds[0]} baud"
        if self.nmea is not None:
            return f"sends NMEA sentences (${self.nmea}): a GNSS receiver or the like; choose another port"
        if not self.count:
            return (
                f"is silent {where}: check that the sensor has power, that transmit and receive are not "
                "swapped, and that this is its port"
            )
        if b"$VN" in self._text:
            return f"sends messages of a VN-100, but all are damaged {where}: check the cable and its ground"
        if self._text:
            shown = self._text.splitlines()[0][:40].decode("ascii")
            return f"sends text that no VN-100 sends ({shown!r}): choose another port"
        return (
            f"sends bytes ({self.count} seen) but nothing valid {where}: another device, another baud, or a "
            "cable for other levels (RS-232, 3 V); choose another --port or --baud"
        )


def _answer(body: str, items: Iterable[DecodedItem]) -> Response | SensorError | None:
    """The sensor's answer to a command among items."""
    command, *fields = body.split(",")
    for item in items:
        if isinstance(item, SensorError) and item.code not in _UNASKED:
            return item
        if isinstance(item, Response) and item.command == command:
            if command not in ("VNRRG", "VNWRG"):
                return item
            number = item.fields[0] if item.fields else ""
            if number.isdigit() and int(number) == int(fields[0]):
                return item
    return None
