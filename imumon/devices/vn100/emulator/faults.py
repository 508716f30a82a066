"""Faults of a line and of the sensor behind it, made on purpose.

A fault has a probability: by message for ``drop``, ``duplicate``, ``cut`` and ``crc``, by byte for
``corrupt``. They act on what leaves the sensor, replies included, as bad cables do. What happens once (a
stall, a reboot, an unplugged cable) comes as a command while the emulator runs. This file knows no port.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class Faults:
    """Probabilities of the faults.

    Attributes
    ----------
    drop : a message is lost.
    duplicate : a message is sent twice.
    cut : a message ends in its middle.
    crc : a message carries a wrong check.
    corrupt : a byte is another one.
    """

    drop: float = 0.0
    duplicate: float = 0.0
    cut: float = 0.0
    crc: float = 0.0
    corrupt: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Faults:
        """Faults from ``name=probability`` with commas between them.

        >>> Faults.parse("drop=0.01,corrupt=1e-4").drop
        0.01
        """
        names = [entry.name for entry in fields(cls)]
        given: dict[str, float] = {}
        for part in filter(None, text.split(",")):
            name, _, number = part.partition("=")
            try:
                given[name.strip()] = probability = float(number)
            except ValueError:
                raise ValueError(f"fault {part!r}: write name=probability, such as drop=0.01") from None
            if name.strip() not in names:
                raise ValueError(f"fault {name!r}: there are {', '.join(names)}")
            if not 0.0 <= probability <= 1.0:
                raise ValueError(f"fault {part!r}: a probability lies between 0 and 1")
        return cls(**given)

    @staticmethod
    def explain() -> str:
        """The faults there are, for help."""
        return ", ".join(entry.name for entry in fields(Faults)) + " (corrupt: of a byte, else of a message)"

    def __str__(self) -> str:
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return ",".join(f"{name}={value!r}" for name, value in values.items() if value)

    def __bool__(self) -> bool:
        return any(getattr(self, entry.name) for entry in fields(self))

    def apply(self, message: bytes, rng: np.random.Generator) -> list[bytes]:
        """What arrives of one message: nothing, it, or something like it, perhaps twice."""
        drop, duplicate, cut, crc = rng.random(4)
        if drop < self.drop:
            return []
        if crc < self.crc:
            message = wrong_check(message)
        if cut < self.cut:
            message = message[: len(message) // 2]
        if self.corrupt:
            message = corrupted(message, self.corrupt, rng)
        return [message, message] if duplicate < self.duplicate else [message]


def wrong_check(message: bytes) -> bytes:
    """The message with a check that is not its own.

    >>> wrong_check(b"$VNRRG,01*72" + bytes((13, 10)))
    b'$VNRRG,01*73\\r\\n'
    """
    if message[:1] != b"$":
        return message[:-1] + bytes((message[-1] ^ 0x01,))
    at = len(message.rstrip()) - 1
    other = b"1" if message[at : at + 1] == b"0" else b"0" if message[at : at + 1] == b"1" else None
    return message[:at] + (other or bytes((message[at] ^ 0x01,))) + message[at + 1 :]


def corrupted(message: bytes, probability: float, rng: np.random.Generator) -> bytes:
    """The message with each byte replaced by another one at this probability."""
    data: npt.NDArray[np.uint8] = np.frombuffer(message, np.uint8).copy()
    hit = rng.random(len(data)) < probability
    data[hit] ^= rng.integers(1, 256, int(hit.sum()), dtype=np.uint8)
    return data.tobytes()
