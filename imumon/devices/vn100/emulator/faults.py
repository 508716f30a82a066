"""Deliberate faults: of the serial line and the sensor behind it, or another device in its place.

A fault of `Faults` has a probability: per message for ``drop``, ``duplicate``, ``cut`` and ``crc``, per byte
for ``corrupt``. Faults act on everything that leaves the sensor, including replies, as a bad cable does.
Single events (a stall, a reboot, an unplugged cable) are commands of the control channel.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import reduce
from operator import xor
from random import Random
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the parser of the command line needs the names of the faults, not numpy
    import numpy as np

FOREIGN_DEVICES = ("nmea", "garbage", "silent")

_FOREIGN_RATE_HZ = 10
_GARBAGE_BYTES = 64


@dataclass(frozen=True, slots=True)
class Faults:
    """Probabilities of the faults.

    Attributes
    ----------
    drop : a message is lost.
    duplicate : a message is sent twice.
    cut : a message ends in its middle.
    crc : a message has a wrong checksum.
    corrupt : a byte is replaced by another one.
    """

    drop: float = 0.0
    duplicate: float = 0.0
    cut: float = 0.0
    crc: float = 0.0
    corrupt: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Faults:
        """Return the faults of a text ``name=probability,name=probability``.

        >>> Faults.parse("drop=0.01,corrupt=1e-4").drop
        0.01
        """
        names = [entry.name for entry in fields(cls)]
        probabilities: dict[str, float] = {}
        for part in filter(None, text.split(",")):
            name, _, number = part.partition("=")
            try:
                probabilities[name.strip()] = probability = float(number)
            except ValueError:
                raise ValueError(f"fault {part!r}: write name=probability, such as drop=0.01") from None
            if name.strip() not in names:
                raise ValueError(f"fault {name!r}: choose one of {', '.join(names)}")
            if not 0.0 <= probability <= 1.0:
                raise ValueError(f"fault {part!r}: give a probability from 0 to 1")
        return cls(**probabilities)

    @staticmethod
    def help_text() -> str:
        """Return the names of the faults for `--help`."""
        return ", ".join(entry.name for entry in fields(Faults)) + " (corrupt: of a byte, else of a message)"

    def apply(self, message: bytes, rng: np.random.Generator) -> list[bytes]:
        """Return what arrives of one message: nothing, the message, or a damaged one, perhaps twice."""
        drop, duplicate, cut, crc = rng.random(4)
        if drop < self.drop:
            return []
        if crc < self.crc:
            message = with_wrong_checksum(message)
        if cut < self.cut:
            message = message[: len(message) // 2]
        if self.corrupt:
            message = corrupted(message, self.corrupt, rng)
        return [message, message] if duplicate < self.duplicate else [message]


def with_wrong_checksum(message: bytes) -> bytes:
    """Return the message with another checksum.

    >>> with_wrong_checksum(b"$VNRRG,01*72" + bytes((13, 10)))
    b'$VNRRG,01*70\\r\\n'
    """
    if message[:1] != b"$":
        return message[:-1] + bytes((message[-1] ^ 0x01,))
    # another hexadecimal digit: any other character would be a damaged frame, and no wrong checksum
    last = len(message.rstrip()) - 1
    return message[:last] + (b"1" if message[last : last + 1] == b"0" else b"0") + message[last + 1 :]


def corrupted(message: bytes, probability: float, rng: np.random.Generator) -> bytes:
    """Return the message with each byte replaced by another one at this probability."""
    data = bytearray(message)
    hit = (rng.random(len(data)) < probability).nonzero()[0]
    for index, change in zip(hit, rng.integers(1, 256, len(hit), dtype="uint8"), strict=True):
        data[index] ^= change
    return bytes(data)


class ForeignDevice:
    """A device on the line that is not a VN-100, and answers nothing.

    Parameters
    ----------
    kind : ``nmea`` (a GNSS receiver), ``garbage`` (unrelated bytes) or ``silent``.
    now : s, host clock at the start.
    """

    def __init__(self, kind: str, now: float) -> None:
        self._kind, self._start, self._count = kind, now, 0
        self._random = Random(1)

    def messages(self, now: float) -> list[bytes]:
        """Return the messages up to `now` (s) that were not returned before, ten per second."""
        first, self._count = self._count, int((now - self._start) * _FOREIGN_RATE_HZ)
        if self._kind == "silent":
            return []
        if self._kind == "garbage":
            return [self._random.randbytes(_GARBAGE_BYTES) for _ in range(first, self._count)]
        return [_nmea_sentence(number) for number in range(first, self._count)]


def _nmea_sentence(number: int) -> bytes:
    second, tenth = divmod(number, _FOREIGN_RATE_HZ)
    body = f"GPGGA,1200{second % 60:02d}.{tenth}0,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,"
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()
