"""ASCII sentences of the VN-100, such as ``$VNYMR,...*65``: parse and format.

A sentence is ``$``, a body of printable characters, ``*``, a checksum (two hexadecimal digits: XOR of the
body; four: its CRC16), then LF or CR LF. The width of a number differs between firmware versions, so numbers
are parsed by field. To parse many sentences at once, they are grouped by *pattern*: the body with every digit
replaced by 0 and every minus by plus. Sentences of one pattern have the same grammar, which is checked once
per pattern, and their digits are in the same columns: the sum of digits times place values gives all numbers
of all rows. An integer of up to 15 digits is below 2^53 and its power of ten is exact, so the one division
rounds correctly: the result is the same float64 as that of `float`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from imumon.model.samples import Floats
from imumon.sources.vn100.checksum import crc16, xor8
from imumon.sources.vn100.measurements import WIDTHS, SampleConverter, sample_converter
from imumon.sources.vn100.registers import ErrorCode


@dataclass(frozen=True, slots=True)
class Response:
    """Response of the sensor to a command.

    Attributes
    ----------
    command : five letters, such as ``VNRRG``.
    fields : the comma-separated fields after it, as sent.
    """

    command: str
    fields: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SensorError:
    """Error message of the sensor: code and meaning."""

    code: int
    text: str


MAX_SENTENCE_BYTES = 256
"""Bytes; longer candidates are not sentences. A VN-100 sends at most 155 in a measurement."""

NUMBER_FORMATS = {
    "ypr": "%+08.3f", "quat": "%+09.6f", "mag": "%+08.4f", "accel": "%+07.3f", "linaccel": "%+07.3f",
    "gyro": "%+010.6f", "temp": "%+05.1f", "pres": "%+08.3f", "dt": "%+09.6f", "dtheta": "%+08.3f",
    "dvel": "%+08.3f", "umag": "%+08.4f", "uaccel": "%+07.3f", "ugyro": "%+010.6f", "dcm": "%+09.6f",
    "heave": "%+08.3f",
}  # fmt: skip
"""printf format of a number by its quantity in firmware 2 and 3; ``dcm`` and ``heave`` are assumptions."""

MEASUREMENTS: dict[str, tuple[str, ...]] = {
    "VNYPR": ("ypr",), "VNQTN": ("quat",), "VNQMR": ("quat", "mag", "accel", "gyro"), "VNDCM": ("dcm",),
    "VNMAG": ("mag",), "VNACC": ("accel",), "VNGYR": ("gyro",), "VNMAR": ("mag", "accel", "gyro"),
    "VNYMR": ("ypr", "mag", "accel", "gyro"), "VNYBA": ("ypr", "linaccel", "gyro"),
    "VNYIA": ("ypr", "linaccel", "gyro"), "VNIMU": ("umag", "uaccel", "ugyro", "temp", "pres"),
    "VNDTV": ("dt", "dtheta", "dvel"), "VNHVE": ("heave",),
}  # fmt: skip
"""Quantities of an asynchronous message in the order of its fields."""

MEASUREMENT_HEADERS = frozenset(message.encode() for message in MEASUREMENTS)
OTHER_PRODUCTS = frozenset({"VNGPS", "VNGPE", "VNINS", "VNINE", "VNISL", "VNISE", "VNG2S", "VNG2E", "VNRTK"})
"""Asynchronous messages of the VN-200 and VN-300: valid, but not decoded."""

ERRORS: dict[int, str] = {code: code.name.lower().replace("_", " ") for code in ErrorCode}
"""Text of an error by its code."""

SENTENCE = re.compile(rb"\$(VN[A-Z0-9]{3}(?:,[^$\r\n\xfa]*)?)\*([0-9A-Fa-f]{4}|[0-9A-Fa-f]{2})\r?\n")
"""Frame of a sentence. The start of another message ends it, so a truncated sentence never includes the next
one. The checksum detects other damaged characters."""

_PREFIX = re.compile(rb"\$(?:V(?:N(?:[A-Z0-9]{1,2}|[A-Z0-9]{3}(?:[,*][^$\r\n\xfa]*\r?)?)?)?)?")

PRINTABLE = re.compile(rb"[ -~]*")

_TO_PATTERN = bytes.maketrans(b"-123456789", b"+000000000")
_NUMBER = re.compile(rb"\+?0+(?:\.0+)?")
_APPENDED = re.compile(rb"T0{1,15}|S[0A-Fa-f]{4}")  # count and status of register 30, as patterns
_MAX_DIGITS = 15  # digits; 10^15 < 2^53, so the integer is exact. Required, not tuned
_HEX = np.array([list(b"%02X" % value) for value in range(256)], np.uint8)
"""Checksums as the sensor writes them. One in lower case ends a run of sentences and is then checked alone."""


def is_prefix(data: bytes, begin: int) -> bool:
    """Return whether the bytes from `begin` to the end may be the beginning of a sentence."""
    return len(data) - begin < MAX_SENTENCE_BYTES and _PREFIX.fullmatch(data, begin) is not None


def intact(body: bytes, check: bytes) -> bool:
    """Return whether the checksum, two or four hexadecimal digits, matches the body."""
    return int(check, 16) == (xor8(body) if len(check) == 2 else crc16(body))


def encode(body: str | bytes, check: Literal["xor", "crc"] = "xor") -> bytes:
    """Return the sentence of a body: with frame and checksum.

    >>> encode("VNRRG,01")
    b'$VNRRG,01*72\\r\\n'
    """
    if isinstance(body, str):
        body = body.encode("ascii")
    return b"$%s*%s\r\n" % (body, b"%02X" % xor8(body) if check == "xor" else b"%04X" % crc16(body))


def split(body: bytes) -> tuple[str, tuple[str, ...]]:
    """Return header and fields of a body in ASCII."""
    command, *fields = body.decode("ascii").split(",")
    return command, tuple(fields)


def numbers(message: str, values: Sequence[float]) -> list[str]:
    """Return the fields of a measurement as the sensor prints them.

    >>> numbers("VNACC", (0.02, -0.0921, -9.683))
    ['+00.020', '-00.092', '-09.683']
    """
    formats = [NUMBER_FORMATS[q] for q in MEASUREMENTS[message] for _ in range(WIDTHS[q])]
    return [number_format % value for number_format, value in zip(formats, values, strict=True)]


def sentence(message: str, values: Sequence[float], *appended: str) -> str:
    """Return the body of a measurement for `encode`; `appended` are fields such as ``T0000000543``.

    >>> sentence("VNACC", (0.02, -0.0921, -9.683), "T0000000543")
    'VNACC,+00.020,-00.092,-09.683,T0000000543'
    """
    return ",".join((message, *numbers(message, values), *appended))


def parse_error(fields: tuple[str, ...]) -> SensorError | None:
    """Return the error in the fields of ``VNERR``; None if they are not an error code."""
    if len(fields) != 1 or not re.fullmatch("[0-9A-Fa-f]{1,2}", fields[0]):
        return None
    code = int(fields[0], 16)
    return SensorError(code, ERRORS.get(code, "unknown error"))


@dataclass(frozen=True, slots=True)
class SentenceFormat:
    """Grammar of all measurement sentences of one pattern.

    Attributes
    ----------
    pattern : b characters, every digit 0 and every sign plus.
    place_value : (b,) place value of the digit in each column; 0 where there is no digit of a number.
    start : (f,) first column of each of the f numbers: the column of its sign if it has one.
    divisor : (f,) power of ten for the decimal point.
    columns : indices of the numbers of each quantity.
    converter : converts the quantities to samples; None if the message has no sensor data.
    """

    pattern: bytes
    place_value: Floats
    start: npt.NDArray[np.intp]
    divisor: Floats
    columns: dict[str, slice]
    converter: SampleConverter | None

    def count_valid(self, data: bytes, begin: int, check: int, end: int, limit: int) -> int:
        """Return the number of consecutive valid sentences of this pattern from `begin`, at most `limit`.

        The first one must be valid. The others are checked as arrays, whose size doubles as long as all are valid.

        Parameters
        ----------
        check, end : number of characters of the checksum and of the line end.
        """
        size = len(self.pattern) + 2 + check + end
        count = step = valid = 1
        while count < limit and valid == step:
            step = min(2 * step, limit - count)
            rows = data[begin + count * size : begin + (count + step) * size]
            valid = self._count_valid_rows(rows, check, end, step)
            count += valid
        return count

    def _count_valid_rows(self, data: bytes, check: int, end: int, count: int) -> int:
        """Return how many of `count` sentences in `data` precede one that is invalid or differs."""
        body = len(self.pattern)
        pattern = np.frombuffer(b"$%s*" % self.pattern, np.uint8)
        rows = np.frombuffer(data, np.uint8).reshape(count, -1)
        patterns = np.frombuffer(data.translate(_TO_PATTERN), np.uint8).reshape(count, -1)
        valid = (patterns[:, : body + 2] == pattern).all(axis=1)
        valid &= (rows[:, -end:] == list(b"\r\n"[-end:])).all(axis=1)
        if check == 2:
            expected = _HEX[np.bitwise_xor.reduce(rows[:, 1 : body + 1], axis=1)]
        else:
            crcs = (crc16(data[i + 1 : i + 1 + body]) for i in range(0, len(data), rows.shape[1]))
            expected = np.frombuffer(b"".join(b"%04X" % crc for crc in crcs), np.uint8).reshape(count, 4)
        valid &= (rows[:, body + 2 : -end] == expected).all(axis=1)
        return count if valid.all() else int(valid.argmin())

    def read(self, data: bytes, begin: int, size: int, count: int) -> Floats:
        """Return the numbers of `count` sentences of `size` bytes each, (count, f)."""
        body = len(self.pattern)
        rows = np.frombuffer(data, np.uint8, count * size, begin).reshape(count, size)[:, 1 : body + 1]
        # signs, points and commas become arbitrary numbers here, and their place value of 0 removes them
        digits = (rows - np.uint8(ord("0"))) * self.place_value
        # each sum ends where the next number starts, so the comma between the two adds 0 to it
        values: Floats = np.add.reduceat(digits, self.start, axis=1) / self.divisor
        np.negative(values, out=values, where=rows.take(self.start, axis=1) == ord("-"))
        return values

    def quantity(self, values: Floats, name: str) -> npt.NDArray[Any]:
        """Return one quantity of the result of `read`."""
        return values[:, self.columns[name]]


def sentence_format(body: bytes) -> SentenceFormat | None:
    """Return the format of the body of a measurement; None if it violates the grammar of the message."""
    return _format_of_pattern(body.translate(_TO_PATTERN))


@lru_cache(maxsize=64)
def _format_of_pattern(body: bytes) -> SentenceFormat | None:
    """Return the format of the sentences of a pattern; None if it violates the grammar of its message."""
    message = body[:5].decode("ascii")
    quantities = MEASUREMENTS[message]
    fields = body[6:].split(b",")
    appended = _remove_appended(fields)
    ends = list(accumulate(WIDTHS[q] for q in quantities))
    expected = ends[-1]
    # an exact count: a field that was lost would shift all after it to other quantities
    if len(fields) != expected or appended is None:
        return None
    if not all(_NUMBER.fullmatch(field) and field.count(b"0") <= _MAX_DIGITS for field in fields):
        return None
    columns = {q: slice(end - WIDTHS[q], end) for q, end in zip(quantities, ends, strict=True)}
    starts = [i + 1 for i, byte in enumerate(body) if byte == ord(",")][:expected]
    if b"T" in appended:  # the only clock that a sentence can have
        columns["counter"] = slice(expected, expected + 1)
        starts.append(body.index(b",T") + 2)
    place, divisor = _places(body, starts)
    converter = sample_converter(frozenset(columns), "$" + message)
    return SentenceFormat(body, place, np.array(starts), divisor, columns, converter)


def _remove_appended(fields: list[bytes]) -> set[bytes] | None:
    """Remove the fields that register 30 appends; return their letters, T and S, or None if one is invalid."""
    appended: list[bytes] = []
    # the text of the manual puts S first, its example T: both orders are accepted
    while fields and fields[-1][:1] in (b"S", b"T") and len(appended) < 2:
        appended.append(fields.pop())
    letters = {field[:1] for field in appended if _APPENDED.fullmatch(field)}
    return letters if len(letters) == len(appended) else None


def _places(body: bytes, starts: Sequence[int]) -> tuple[Floats, Floats]:
    """Return the value of a one at each byte of a pattern, (n,), and the divisor of each number, (k,)."""
    place, divisor = np.zeros(len(body)), np.ones(len(starts))
    for number, start in enumerate(starts):
        text = body[start:].partition(b",")[0]
        digits = [start + i for i, byte in enumerate(text) if byte == ord("0")]
        place[digits] = [float(10**power) for power in reversed(range(len(digits)))]
        divisor[number] = float(10 ** len(text.partition(b".")[2]))
    return place, divisor
