"""What every sensor package offers: bytes in, samples and answers out, nothing else.

A sensor package is pure: it reads no port and no clock. `Decoder` turns bytes into items in the order
they ended on the line; the counters always add up: every byte fed is part of a message, discarded, or
pending. Garbage never raises and never makes a sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeAlias

from imumon.samples import SampleBlock


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


Item: TypeAlias = SampleBlock | Response | SensorError


class Decoder(Protocol):
    """Push bytes, get items.

    Attributes
    ----------
    fed : bytes fed so far.
    messages : valid messages of any type.
    message_bytes : bytes they took.
    discarded : bytes that belong to no valid message.
    bad_checksums : messages that framed but failed their check.
    pending : bytes held back until more come; fed = message_bytes + discarded + pending.
    """

    fed: int
    messages: int
    message_bytes: int
    discarded: int
    bad_checksums: int

    @property
    def pending(self) -> int: ...

    def feed(self, data: bytes) -> list[Item]:
        """Items completed by `data`, in the order they ended; blocks of one stream may be joined
        only where no other item stands between them."""

    def finish(self) -> list[Item]:
        """The stream has ended (end of file, port closed): what is pending is settled."""
