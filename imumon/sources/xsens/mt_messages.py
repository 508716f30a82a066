"""Messages of an Xsens MTi: frame, identifiers, and the fields of MTData2.

A message is ``FA FF``, its identifier, the length of its data, the data, and a byte that makes the sum of all but the
first byte 0. A length of 255 is followed by the real one, two bytes. Numbers are big endian. MTData2 is a sequence of
fields: identifier, two bytes; length, one byte; contents. The last four bits of an identifier are the precision of the
numbers and the frame of the axes. A reply has the identifier of its request plus one.

The facts are those on which the open drivers of ethz-asl and of rpng, a C library with packets that were recorded
beside their decoded values, and the public XsDataIdentifier and XsStatusFlag agree. What only one of them has is left
out, and so are fields of fixed-point numbers.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

PREAMBLE = b"\xfa\xff"
LONG = 255
"""Length byte in front of a length of two bytes."""
LONGEST = 2048
"""Bytes of data at most; a larger length is no message."""


class MessageId(IntEnum):
    """Identifiers of messages; the reply to a request is the next number."""

    REQUEST_DEVICE = 0x00
    GO_TO_MEASUREMENT = 0x10
    REQUEST_FIRMWARE = 0x12
    REQUEST_PRODUCT = 0x1C
    GO_TO_CONFIG = 0x30
    DATA = 0x36
    WAKE_UP = 0x3E
    ERROR = 0x42
    OUTPUT_CONFIGURATION = 0xC0


class DataId(IntEnum):
    """Identifiers of fields of MTData2, for 32-bit floats and the default frame."""

    TEMPERATURE = 0x0810
    PACKET_COUNTER = 0x1020
    SAMPLE_TIME_FINE = 0x1060
    DELTA_V = 0x4010
    ACCELERATION = 0x4020
    RATE_OF_TURN = 0x8020
    DELTA_Q = 0x8030
    STATUS_WORD = 0xE020


KIND_BITS, PRECISION_BITS = 0xFFF0, 0x0003
FLOATS = {0: "f", 3: "d"}
"""Format of a number by its precision; 1 and 2 are fixed-point numbers."""
EVERY_PACKET = 0xFFFF
"""Rate of a field that is in every message, such as a counter."""
TICK_S = 1e-4
"""s, unit of SampleTimeFine."""
CLIPPED = {"gyro": 0b111 << 11, "accel": 0b111 << 8}
"""Bits of the status word: an axis of this sensor exceeded its range."""

_NUMBERS = {
    DataId.TEMPERATURE: 1,
    DataId.DELTA_V: 3,
    DataId.ACCELERATION: 3,
    DataId.RATE_OF_TURN: 3,
    DataId.DELTA_Q: 4,
}
_COUNTS = {DataId.PACKET_COUNTER: ">H", DataId.SAMPLE_TIME_FINE: ">I", DataId.STATUS_WORD: ">I"}


@dataclass(frozen=True, slots=True)
class Message:
    """One message with a valid checksum."""

    id: int
    data: bytes


def encode(message_id: int, data: bytes = b"") -> bytes:
    """Return the bytes of a message.

    >>> encode(MessageId.GO_TO_CONFIG).hex()
    'faff3000d1'
    """
    length = bytes([len(data)]) if len(data) < LONG else bytes([LONG]) + len(data).to_bytes(2, "big")
    body = bytes([0xFF, message_id]) + length + data
    return PREAMBLE[:1] + body + bytes([-sum(body) & 0xFF])


def size_at(data: bytes, begin: int) -> tuple[int, int] | None:
    """Return the size of the message whose frame begins at a place, and of its header; None: more bytes are needed.

    A size of 0 means that none can begin there.
    """
    if len(data) < begin + 4:  # FA alone decides nothing: it occurs in data, too
        return (0, 0) if data[begin : begin + 2] != PREAMBLE[: len(data) - begin] else None
    if data[begin : begin + 2] != PREAMBLE:
        return 0, 0
    length, header = data[begin + 3], 4
    if length == LONG:
        if len(data) < begin + 6:
            return None
        length, header = int.from_bytes(data[begin + 4 : begin + 6], "big"), 6
    return (header + length + 1, header) if length <= LONGEST else (0, 0)


def fields(data: bytes) -> dict[int, tuple[float, ...]]:
    """Return the numbers of the known fields of MTData2, by `DataId`.

    Raises
    ------
    ValueError : a field is longer than the data, or a known one has another length.
    """
    numbers: dict[int, tuple[float, ...]] = {}
    offset = 0
    while offset < len(data):
        if len(data) < offset + 3 or len(data) < offset + 3 + data[offset + 2]:
            raise ValueError("a field is incomplete")
        name, size = int.from_bytes(data[offset : offset + 2], "big"), data[offset + 2]
        content = data[offset + 3 : offset + 3 + size]
        offset += 3 + size
        kind = name & KIND_BITS  # without precision and frame of the axes
        if kind in _COUNTS:
            form = _COUNTS[DataId(kind)]
        elif kind in _NUMBERS and name & PRECISION_BITS in FLOATS:
            form = f">{_NUMBERS[DataId(kind)]}{FLOATS[name & PRECISION_BITS]}"
        else:
            continue
        try:
            numbers[kind] = struct.unpack(form, content)
        except struct.error:
            raise ValueError(f"field {name:04X} has {size} bytes") from None
    return numbers


def outputs(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield identifier and rate, Hz, of each field of an output configuration.

    >>> list(outputs(bytes.fromhex("1020ffff80300064")))
    [(4128, 65535), (32816, 100)]
    """
    usable = len(data) - len(data) % 4
    yield from struct.iter_unpack(">HH", data[:usable])
