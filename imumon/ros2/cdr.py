"""CDR: the bytes of ROS 2 messages (OMG DDS-XTypes 1.3, 7.4.1: XCDR version 1, plain).

The first four bytes say the byte order; each value is aligned to its size, counted from byte 4. A string is its
length with the final zero byte, then the bytes. `encode` and `decode` handle every type of `message_types`;
`ImuMessage` is the way for a message of which 1,000 arrive in a second.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from imumon.errors import ImumonError
from imumon.ros2.message_types import DEFINITIONS, fields_of

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""Encapsulation header of what is written here."""
BODY = 4
"""Bytes of that header."""
MAX_STRING = 4096
"""Bytes of a string that is read."""
MAX_SEQUENCE = 4096
"""Elements of a sequence that is read."""

_FORMATS = {
    "int8": "b", "uint8": "B", "byte": "B", "bool": "?", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_ORDERS = {0: ">", 1: "<"}
"""Byte order by the second byte of the encapsulation header."""


class CdrError(ImumonError):
    """The bytes are no message of the type."""


def encode(type_name: str, message: Mapping[str, Any]) -> bytes:
    """Return a message as bytes, little endian.

    Parameters
    ----------
    message : fields by name; nested messages are mappings, arrays are sequences. All fields are required.
    """
    body = bytearray()
    _write(body, type_name, message)
    return LITTLE_ENDIAN + bytes(body)


def _write(body: bytearray, kind: str, value: Any) -> None:
    if kind in DEFINITIONS:
        for name, inner, count in fields_of(kind):
            if count == 0:
                _write(body, "uint32", len(value[name]))
            for each in [value[name]] if count is None else value[name]:
                _write(body, inner, each)
    elif kind == "string":
        data = value.encode() + b"\0"
        _write(body, "uint32", len(data))
        body += data
    else:
        packed = struct.pack(f"<{_FORMATS[kind]}", value)
        body += bytes(-len(body) % len(packed)) + packed


def decode(type_name: str, payload: bytes) -> dict[str, Any]:
    """Return the fields of a message by name.

    Raises
    ------
    CdrError : the bytes are too short, or are no message of this type.
    """
    order = byte_order(payload)
    try:
        value, _ = _read(payload, BODY, type_name, order)
    except (struct.error, UnicodeDecodeError) as error:
        raise _invalid(type_name, str(error)) from None
    found: dict[str, Any] = value
    return found


def byte_order(payload: bytes) -> str:
    """Return the byte order of a message for `struct`; raise `CdrError` if the encoding is another one."""
    order = _ORDERS.get(payload[1]) if len(payload) > BODY and payload[0] == 0 else None
    if order is None:
        raise CdrError("cdr_encoding", f"encoding {payload[:2].hex() or 'none'}", "publish plain CDR")
    return order


def _read(payload: bytes, at: int, kind: str, order: str) -> tuple[Any, int]:
    """Return a value and the offset after it."""
    if kind in DEFINITIONS:
        message: dict[str, Any] = {}
        for name, inner, count in fields_of(kind):
            if count is None:
                message[name], at = _read(payload, at, inner, order)
                continue
            if count == 0:
                count, at = _read(payload, at, "uint32", order)
                if count > MAX_SEQUENCE:
                    raise _invalid(kind, f"a sequence of {count}")
            items = []
            for _ in range(count):
                item, at = _read(payload, at, inner, order)
                items.append(item)
            message[name] = items
        return message, at
    if kind == "string":
        length, at = _read(payload, at, "uint32", order)
        if not 0 < length <= MAX_STRING or at + length > len(payload):
            raise _invalid(kind, f"a string of {length} bytes")
        return payload[at : at + length - 1].decode(), at + length
    form = order + _FORMATS[kind]
    at += -(at - BODY) % struct.calcsize(form)
    return struct.unpack_from(form, payload, at)[0], at + struct.calcsize(form)


def _invalid(kind: str, why: str) -> CdrError:
    return CdrError("cdr_invalid", f"no {kind}: {why}", "check the type of the topic")


def header(stamp_ns: int, frame_id: str = "") -> dict[str, Any]:
    """Return the fields of a ``std_msgs/msg/Header``."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame_id}


class StampedNumbers(NamedTuple):
    """Stamp in ns, and the doubles that follow the header of a message."""

    stamp_ns: int
    numbers: tuple[float, ...]


def doubles_offset(payload: bytes, order: str = "<") -> int:
    """Return where the doubles of a message begin that has a header and doubles only."""
    (length,) = struct.unpack_from(f"{order}I", payload, BODY + 8)
    return int(BODY + (8 + 4 + length + 7) // 8 * 8)


def stamped_numbers(payload: bytes, count: int) -> StampedNumbers:
    """Return stamp and doubles of a message that has a header and `count` doubles: Imu, MagneticField, Temperature.

    Raises
    ------
    CdrError : the length is not that of such a message.
    """
    order = byte_order(payload)
    try:
        seconds, nanoseconds = struct.unpack_from(f"{order}iI", payload, BODY)
        start = doubles_offset(payload, order)
        numbers = struct.unpack_from(f"{order}{count}d", payload, start)
    except struct.error as error:
        raise _invalid("stamped message", str(error)) from None
    if len(payload) - start - 8 * count >= 8:  # DDS may pad to 4 bytes
        raise _invalid("stamped message", f"{len(payload)} bytes")
    return StampedNumbers(seconds * 1_000_000_000 + nanoseconds, numbers)


class ImuMessage(NamedTuple):
    """What a ``sensor_msgs/msg/Imu`` says of the two sensors; None: the message has no estimate of it."""

    stamp_ns: int
    gyro: tuple[float, ...] | None  # rad/s, x y z
    accel: tuple[float, ...] | None  # m/s^2


IMU_DOUBLES = 37
GYRO_AT, GYRO_COVARIANCE_AT, ACCEL_AT, ACCEL_COVARIANCE_AT = 13, 16, 25, 28
"""Index of the first double of each quantity behind the header."""


def imu_message(payload: bytes) -> ImuMessage:
    """Return an Imu message; -1 as the first covariance means "no estimate" (comments in Imu.msg).

    Raises
    ------
    CdrError : the length is not that of an Imu.
    """
    stamp_ns, numbers = stamped_numbers(payload, IMU_DOUBLES)
    gyro = None if numbers[GYRO_COVARIANCE_AT] == -1.0 else numbers[GYRO_AT : GYRO_AT + 3]
    accel = None if numbers[ACCEL_COVARIANCE_AT] == -1.0 else numbers[ACCEL_AT : ACCEL_AT + 3]
    return ImuMessage(stamp_ns, gyro, accel)


def with_imu_covariances(
    payload: bytes, gyro: Sequence[float] | None, accel: Sequence[float] | None
) -> bytes:
    """Return an Imu message with other diagonal covariances.

    Parameters
    ----------
    gyro, accel : variances of x, y and z; None: the covariance of the input stays. A quantity without an
        estimate (-1) stays without one.

    Raises
    ------
    CdrError : the payload is no Imu.
    """
    order = byte_order(payload)
    numbers = stamped_numbers(payload, IMU_DOUBLES).numbers
    start, changed = doubles_offset(payload, order), bytearray(payload)
    for at, variances in ((GYRO_COVARIANCE_AT, gyro), (ACCEL_COVARIANCE_AT, accel)):
        if variances is not None and numbers[at] != -1.0:
            matrix = [0.0] * 9
            matrix[0::4] = variances
            struct.pack_into(f"{order}9d", changed, start + 8 * at, *matrix)
    return bytes(changed)
