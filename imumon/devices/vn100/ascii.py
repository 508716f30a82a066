"""ASCII sentences of the VN-100: ``$VNYMR,...*65`` and their kin, read and written.

A sentence is ``$``, a body of printable characters, ``*``, the check (two hexadecimal digits are the
XOR of the body, four its CRC16), then LF or CR LF. Numbers are fixed width in one firmware and other
widths in the next: they are read by field. To read them fast, sentences are sorted by *shape*: the
body with every digit made 0 and every minus made plus. Sentences of one shape share their grammar, so it is
checked once a shape, and their digits stand in the same columns: times their place values and summed, they
are all numbers of all rows. A number of up to 15 digits is below 2^53 and its power of ten exact, so the one
division rounds correctly: the result is the same float64 that reading the text gives.

This file knows neither where bytes come from nor what is done with samples.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from imumon.devices.vn100.checksum import crc16, xor8
from imumon.devices.vn100.measurements import WIDTHS, Recipe, recipe
from imumon.samples import Floats


@dataclass(frozen=True, slots=True)
class Response:
    """Answer of the sensor to a command.

    Attributes
    ----------
    command : five letters, such as ``VNRRG``.
    fields : the comma-separated fields behind it, as sent.
    """

    command: str
    fields: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SensorError:
    """Error message of the sensor: its code and what it means."""

    code: int
    text: str


LIMIT = 256
"""Longest sentence, bytes; a candidate beyond it is none."""

FORMS = {
    "ypr": "%+08.3f", "quat": "%+09.6f", "mag": "%+08.4f", "accel": "%+07.3f", "linaccel": "%+07.3f",
    "gyro": "%+010.6f", "temp": "%+05.1f", "pres": "%+08.3f", "dt": "%+09.6f", "dtheta": "%+08.3f",
    "dvel": "%+08.3f", "umag": "%+08.4f", "uaccel": "%+07.3f", "ugyro": "%+010.6f", "dcm": "%+09.6f",
    "heave": "%+08.3f",
}  # fmt: skip
"""printf form of a number by its quantity, as firmware 2 and 3 write it; ``dcm``, ``heave`` are guesses."""

MEASUREMENTS: dict[str, tuple[str, ...]] = {
    "VNYPR": ("ypr",),
    "VNQTN": ("quat",),
    "VNQMR": ("quat", "mag", "accel", "gyro"),
    "VNDCM": ("dcm",),
    "VNMAG": ("mag",),
    "VNACC": ("accel",),
    "VNGYR": ("gyro",),
    "VNMAR": ("mag", "accel", "gyro"),
    "VNYMR": ("ypr", "mag", "accel", "gyro"),
    "VNYBA": ("ypr", "linaccel", "gyro"),
    "VNYIA": ("ypr", "linaccel", "gyro"),
    "VNIMU": ("umag", "uaccel", "ugyro", "temp", "pres"),
    "VNDTV": ("dt", "dtheta", "dvel"),
    "VNHVE": ("heave",),
}
"""Quantities of an asynchronous message, in the order of its fields."""

SAMPLED = frozenset(message.encode() for message in MEASUREMENTS)
"""Headers of the measurements, as they stand on the line."""

FOREIGN = frozenset({"VNGPS", "VNGPE", "VNINS", "VNINE", "VNISL", "VNISE", "VNG2S", "VNG2E", "VNRTK"})
"""Asynchronous messages of the VN-200 and VN-300: valid, but nothing in them is sampled here."""

ERRORS = {
    0x01: "hard fault", 0x02: "serial input buffer overflow", 0x03: "invalid checksum",
    0x04: "invalid command", 0x05: "not enough parameters", 0x06: "too many parameters",
    0x07: "invalid parameter", 0x08: "invalid register", 0x09: "not allowed",
    0x0A: "watchdog reset", 0x0B: "serial output buffer overflow",
    0x0C: "baud rate too low for the requested output", 0xFF: "error buffer overflow",
}  # fmt: skip
"""Meaning of the code of ``VNERR``."""

SENTENCE = re.compile(rb"\$(VN[A-Z0-9]{3}(?:,[^$\r\n\xfa]*)?)\*([0-9A-Fa-f]{4}|[0-9A-Fa-f]{2})\r?\n")
"""Frame of a sentence. A beginning of another message ends it, so a cut one never swallows the next; what
else the line has made of its characters is for the check to find."""

_BEGUN = re.compile(rb"\$(?:V(?:N(?:[A-Z0-9]{1,2}|[A-Z0-9]{3}(?:[,*][^$\r\n\xfa]*\r?)?)?)?)?")
_LINE = re.compile(rb"\$(VN[A-Z0-9]{3}(?:,[ -#%-~]*)?)\*([0-9A-Fa-f]{4}|[0-9A-Fa-f]{2}|XXXX|XX)\r?\n?")

PRINTABLE = re.compile(rb"[ -~]*")
"""Characters of a body."""

_SHAPE = bytes.maketrans(b"-123456789", b"+000000000")
_NUMBER = re.compile(rb"\+?0+(?:\.0+)?")
_APPENDED = re.compile(rb"T0{1,15}|S[0A-Fa-f]{4}")
_MAX_DIGITS = 15
_FEW = 8
_HEX = np.array([list(b"%02X" % value) for value in range(256)], np.uint8)


def begun(data: bytes, at: int) -> bool:
    """Whether everything from `at` to the end may be the beginning of a sentence."""
    return len(data) - at < LIMIT and _BEGUN.fullmatch(data, at) is not None


def intact(body: bytes, check: bytes) -> bool:
    """Whether the check, two or four hexadecimal digits, is the body's."""
    return int(check, 16) == (xor8(body) if len(check) == 2 else crc16(body))


def encode(body: str | bytes, check: Literal["xor", "crc"] = "xor") -> bytes:
    """Sentence with its frame and check, ready for the line.

    >>> encode("VNRRG,01")
    b'$VNRRG,01*72\\r\\n'
    """
    if isinstance(body, str):
        body = body.encode("ascii")
    return b"$%s*%s\r\n" % (body, b"%02X" % xor8(body) if check == "xor" else b"%04X" % crc16(body))


def parse(line: bytes, *, bypass: bool = False) -> tuple[str, tuple[str, ...]] | None:
    """Five letters and fields of one line; None when it is no sentence or its check is wrong.

    A host may write ``XX`` for the check, a sensor may not: `bypass` takes it.

    >>> parse(b"$VNWRG,07,40*59\\n"), parse(b"$VNRRG,01*XX"), parse(b"$VNRRG,01*XX", bypass=True)
    (('VNWRG', ('07', '40')), None, ('VNRRG', ('01',)))
    """
    found = _LINE.fullmatch(line)
    if found is None:
        return None
    body, check = found.groups()
    if not (bypass if check[:1] == b"X" else intact(body, check)):
        return None
    return split(body)


def split(body: bytes) -> tuple[str, tuple[str, ...]]:
    """Five letters and the fields behind them, of a body in ASCII."""
    command, *fields = body.decode("ascii").split(",")
    return command, tuple(fields)


def numbers(message: str, values: Sequence[float]) -> list[str]:
    """Fields of a measurement as the sensor prints them.

    >>> numbers("VNACC", (0.02, -0.0921, -9.683))
    ['+00.020', '-00.092', '-09.683']
    """
    forms = [FORMS[q] for q in MEASUREMENTS[message] for _ in range(WIDTHS[q])]
    return [form % value for form, value in zip(forms, values, strict=True)]


def sentence(message: str, values: Sequence[float], *appended: str) -> str:
    """Body of a measurement, for `encode`; `appended` are fields such as ``T0000000543``.

    >>> sentence("VNACC", (0.02, -0.0921, -9.683), "T0000000543")
    'VNACC,+00.020,-00.092,-09.683,T0000000543'
    """
    return ",".join((message, *numbers(message, values), *appended))


def error(fields: tuple[str, ...]) -> SensorError | None:
    """What the fields of ``VNERR`` say; None when they are no code."""
    if len(fields) != 1 or not re.fullmatch("[0-9A-Fa-f]{1,2}", fields[0]):
        return None
    code = int(fields[0], 16)
    return SensorError(code, ERRORS.get(code, "unknown error"))


@dataclass(frozen=True, slots=True)
class SentenceFormat:
    """Grammar of all measurement sentences whose digits stand in the same columns.

    Attributes
    ----------
    body : b characters, every digit 0 and every sign plus.
    place : (b,) place value of each column's digit in its number; 0 where no number's digit stands.
    start : (f,) first column of each of the f numbers; the column of its sign if it has one.
    divisor : (f,) power of ten that puts the decimal point.
    columns : where each quantity's numbers stand among the f.
    recipe : what they become; None when the message has no sensor in it.
    """

    body: bytes
    place: Floats
    start: npt.NDArray[np.intp]
    divisor: Floats
    columns: dict[str, slice]
    recipe: Recipe | None

    def run(self, data: bytes, at: int, check: int, end: int, most: int) -> int:
        """How many valid sentences of this shape follow one another from `at` on.

        `check` and `end` are the numbers of check digits and of line end characters; the first one is known
        to be valid. Few are looked at one by one, many in arrays that double as long as all are good.
        """
        size = len(self.body) + 2 + check + end
        count, step = 1, _FEW
        while count < most and count < _FEW:
            if not self._valid(data, at + count * size, size):
                return count
            count += 1
        while count < most:
            step = min(2 * step, most - count)
            good = self._equal(data[at + count * size : at + (count + step) * size], check, end, step)
            count += good
            if good < step:
                break
        return count

    def _valid(self, data: bytes, at: int, size: int) -> bool:
        found = SENTENCE.match(data, at, at + size)
        return (
            found is not None
            and found.end() == at + size
            and found[1].translate(_SHAPE) == self.body
            and intact(found[1], found[2])
        )

    def _equal(self, data: bytes, check: int, end: int, count: int) -> int:
        """Of `count` sentences that fill `data`, those before one that is not valid or not of this shape."""
        body = len(self.body)
        pattern = np.frombuffer(b"$%s*" % self.body, np.uint8)
        rows = np.frombuffer(data, np.uint8).reshape(count, -1)
        shapes = np.frombuffer(data.translate(_SHAPE), np.uint8).reshape(count, -1)
        good = (shapes[:, : body + 2] == pattern).all(axis=1)
        good &= (rows[:, -end:] == list(b"\r\n"[-end:])).all(axis=1)
        if check == 2:
            sums = _HEX[np.bitwise_xor.reduce(rows[:, 1 : body + 1], axis=1)]
        else:
            crcs = (crc16(data[i + 1 : i + 1 + body]) for i in range(0, len(data), rows.shape[1]))
            sums = np.frombuffer(b"".join(b"%04X" % crc for crc in crcs), np.uint8).reshape(count, 4)
        good &= (rows[:, body + 2 : -end] == sums).all(axis=1)
        return count if good.all() else int(good.argmin())

    def read(self, data: bytes, at: int, size: int, count: int) -> Floats:
        """Numbers of `count` sentences of `size` bytes each, (count, f)."""
        body = len(self.body)
        rows = np.frombuffer(data, np.uint8, count * size, at).reshape(count, size)[:, 1 : body + 1]
        digits = (rows - np.uint8(ord("0"))) * self.place
        read: Floats = np.add.reduceat(digits, self.start, axis=1) / self.divisor
        np.negative(read, out=read, where=rows.take(self.start, axis=1) == ord("-"))
        return read

    def quantity(self, values: Floats, name: str) -> npt.NDArray[Any]:
        """One quantity of what `read` gave."""
        return values[:, self.columns[name]]


def shape(body: bytes) -> SentenceFormat | None:
    """Shape of a measurement's body; None when it does not obey the message's grammar."""
    return _shape(body.translate(_SHAPE))


@lru_cache(maxsize=64)
def _shape(body: bytes) -> SentenceFormat | None:
    message = body[:5].decode("ascii")
    quantities = MEASUREMENTS[message]
    fields = body[6:].split(b",")
    appended: list[bytes] = []
    while fields and fields[-1][:1] in (b"S", b"T") and len(appended) < 2:
        appended.append(fields.pop())
    marks = {field[:1] for field in appended if _APPENDED.fullmatch(field)}
    expected = sum(WIDTHS[q] for q in quantities)
    if len(fields) != expected or len(marks) != len(appended):
        return None
    if not all(_NUMBER.fullmatch(field) and field.count(b"0") <= _MAX_DIGITS for field in fields):
        return None
    columns: dict[str, slice] = {}
    at = 0
    for quantity in quantities:
        columns[quantity] = slice(at, at + WIDTHS[quantity])
        at += WIDTHS[quantity]
    starts = [i + 1 for i, byte in enumerate(body) if byte == ord(",")][:expected]
    if b"T" in marks:
        columns["counter"] = slice(at, at + 1)
        starts.append(body.index(b",T") + 2)
    place = np.zeros(len(body))
    divisor = np.ones(len(starts))
    for number, start in enumerate(starts):
        text = body[start:].partition(b",")[0]
        digits = [start + i for i, byte in enumerate(text) if byte == ord("0")]
        place[digits] = [float(10**power) for power in reversed(range(len(digits)))]
        divisor[number] = float(10 ** len(text.partition(b".")[2]))
    found = recipe(frozenset(columns), "$" + message)
    return SentenceFormat(body, place, np.array(starts), divisor, columns, found)
