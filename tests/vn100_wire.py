"""Independent packer and unpacker of VN-100 messages, with the standard library only.

The emulator and the decoder of imumon share the code that packs and unpacks messages, so an error in it could
cancel out. This module is written separately after the user manual (UM001 2.43) and imports nothing of imumon: its
tables, its checksums (bit by bit) and its rules are its own. The sizes of the fields that a VN-100 does not have
are those of VectorNav's programming library.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

CheckWidth = Literal[8, 16]
Position = tuple[int, int]  # group and bit of a binary field
Values = tuple[float, ...]


def xor8(data: bytes) -> int:
    """Return the XOR of all bytes, bit by bit."""
    return sum((sum(byte >> bit & 1 for byte in data) & 1) << bit for bit in range(8))


def crc16(data: bytes) -> int:
    """Return the remainder of the polynomial x^16 + x^12 + x^5 + 1, bit by bit."""
    remainder = 0
    for byte in data:
        for bit in range(7, -1, -1):
            carry = (remainder >> 15 & 1) ^ (byte >> bit & 1)
            remainder = remainder << 1 & 0xFFFF
            if carry:
                remainder ^= 1 << 12 | 1 << 5 | 1
    return remainder


# ------------------------------------------------------------------------------------- sentences


def _axes(name: str, number_format: str) -> list[tuple[str, str]]:
    return [(f"{name}/{axis}", number_format) for axis in "xyz"]


_YPR = [("yaw", "%+08.3f"), ("pitch", "%+08.3f"), ("roll", "%+08.3f")]
_QUATERNION = [(f"q{k}", "%+09.6f") for k in range(4)]
_MAG = _axes("mag", "%+08.4f")
_ACCEL = _axes("accel", "%+07.3f")
_LINEAR = _axes("linear", "%+07.3f")
_GYRO = _axes("gyro", "%+010.6f")

SENTENCES: dict[str, list[tuple[str, str]]] = {
    "VNYPR": _YPR,
    "VNQTN": _QUATERNION,
    "VNQMR": _QUATERNION + _MAG + _ACCEL + _GYRO,
    "VNDCM": [(f"c{row}{column}", "%+09.6f") for row in range(3) for column in range(3)],
    "VNMAG": _MAG,
    "VNACC": _ACCEL,
    "VNGYR": _GYRO,
    "VNMAR": _MAG + _ACCEL + _GYRO,
    "VNYMR": _YPR + _MAG + _ACCEL + _GYRO,
    "VNYBA": _YPR + _LINEAR + _GYRO,
    "VNYIA": _YPR + _LINEAR + _GYRO,
    "VNIMU": [*_MAG, *_ACCEL, *_GYRO, ("temperature", "%+05.1f"), ("pressure", "%+08.3f")],
    "VNDTV": [("dt", "%+09.6f"), *_axes("theta", "%+08.3f"), *_axes("velocity", "%+08.3f")],
    "VNHVE": [("heave", "%+08.3f"), ("heave rate", "%+08.3f"), ("delayed heave", "%+08.3f")],
}
"""Names and printf formats of the fields of each asynchronous message (tables of registers 6 and 8 to 240)."""

OTHER_PRODUCTS = {"VNGPS", "VNGPE", "VNINS", "VNINE", "VNISL", "VNISE", "VNG2S", "VNG2E", "VNRTK"}
"""Asynchronous messages of the VN-200 and VN-300."""

COMMANDS = (
    "VNRRG", "VNWRG", "VNWNV", "VNRST", "VNRFS", "VNASY", "VNTAR", "VNSIH", "VNSGB", "VNSFB", "VNKMD", "VNKAD",
    "VNBOM", "VNCMD", "VNFWU", "VNSBL",
)  # fmt: skip
"""Commands, which the sensor repeats in its response."""

ERROR_CODES = (*range(0x01, 0x0D), 0xFF)

_CHANNEL = re.compile(r"(gyro|accel|mag)/[xyz]|temperature|pressure")
CHANNELS = [f"{sensor}/{axis}" for sensor in ("gyro", "accel", "mag") for axis in "xyz"]
CHANNELS += ["temperature", "pressure"]


def frame(body: str | bytes, check: CheckWidth = 8, end: bytes = b"\r\n") -> bytes:
    """Return the sentence of a body."""
    data = body.encode("ascii") if isinstance(body, str) else body
    digits = f"{xor8(data):02X}" if check == 8 else f"{crc16(data):04X}"
    return b"$" + data + b"*" + digits.encode() + end


def measurement(header: str, values: Sequence[float], appended: Sequence[str] = ()) -> str:
    """Return the body of a measurement."""
    texts = [form % value for (_, form), value in zip(SENTENCES[header], values, strict=True)]
    return ",".join([header, *texts, *appended])


def unframe(data: bytes) -> tuple[str, list[str], CheckWidth]:
    """Return header, fields and checksum width of one sentence; ValueError if any byte is wrong."""
    match = re.fullmatch(rb"\$(VN[A-Z0-9]{3}(?:,[ -#%-)+-~]*)?)\*([0-9A-F]{2}|[0-9A-F]{4})\r\n", data)
    if match is None:
        raise ValueError(f"not a sentence: {data!r}")
    body, digits = match[1], match[2].decode()
    expected = f"{xor8(body):02X}" if len(digits) == 2 else f"{crc16(body):04X}"
    if digits != expected:
        raise ValueError(f"checksum {digits}, not {expected}: {data!r}")
    header, *fields = body.decode().split(",")
    return header, fields, 8 if len(digits) == 2 else 16


# --------------------------------------------------------------------------------------- packets


@dataclass(frozen=True)
class Field:
    """One field of a packet: struct format without byte order, and a name for each sampled component.

    A name is a channel after the kind of the value: ``d`` increment, ``u`` uncompensated, ``c`` compensated.
    """

    format: str
    names: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        return struct.calcsize("<" + self.format)

    @property
    def count(self) -> int:
        return len(struct.unpack("<" + self.format, bytes(self.size)))


def _vector(kind: str, *sensors: str) -> tuple[str, ...]:
    return tuple(f"{kind} {sensor}/{axis}" for sensor in sensors for axis in "xyz")


_STARTUP = Field("Q", ("startup",))
_VPE_STATUS = Field("H", ("vpe status",))
_GNSS = dict(
    enumerate(map(Field, ("8s", "Q", "H", "B", "B", "3d", "3d", "3f", "3f", "3f", "f", "f")))
)  # Utc, Tow, Week, NumSats, Fix, PosLla, PosEcef, VelNed, VelEcef, PosU, VelU, TimeU

FIELDS: dict[Position, Field] = {
    (1, 0): _STARTUP,
    (1, 1): Field("Q"),  # TimeGps
    (1, 2): Field("Q"),  # TimeSyncIn
    (1, 3): Field("3f"),  # Ypr
    (1, 4): Field("4f"),  # Quat
    (1, 5): Field("3f", _vector("c", "gyro")),
    (1, 6): Field("3d"),  # PosLla
    (1, 7): Field("3f"),  # VelNed
    (1, 8): Field("3f", _vector("c", "accel")),
    (1, 9): Field("6f", _vector("u", "accel", "gyro")),
    (1, 10): Field("5f", (*_vector("c", "mag"), "c temperature", "c pressure")),
    (1, 11): Field("7f", ("dt", *_vector("d", "gyro", "accel"))),
    (1, 12): _VPE_STATUS,
    (1, 13): Field("I"),  # SyncInCnt
    (1, 14): Field("Q"),  # TimeGpsPps
    (2, 0): _STARTUP,
    (2, 1): Field("Q"),  # TimeGps
    (2, 2): Field("Q"),  # GpsTow
    (2, 3): Field("H"),  # GpsWeek
    (2, 4): Field("Q"),  # TimeSyncIn
    (2, 5): Field("Q"),  # GpsPps
    (2, 6): Field("8s"),  # Utc
    (2, 7): Field("I"),  # SyncInCnt
    (2, 8): Field("I"),  # SyncOutCnt
    (2, 9): Field("B"),  # TimeStatus
    (3, 0): Field("H"),  # ImuStatus
    (3, 1): Field("3f", _vector("u", "mag")),
    (3, 2): Field("3f", _vector("u", "accel")),
    (3, 3): Field("3f", _vector("u", "gyro")),
    (3, 4): Field("f", ("c temperature",)),
    (3, 5): Field("f", ("c pressure",)),
    (3, 6): Field("4f", ("dt", *_vector("d", "gyro"))),
    (3, 7): Field("3f", _vector("d", "accel")),
    (3, 8): Field("3f", _vector("c", "mag")),
    (3, 9): Field("3f", _vector("c", "accel")),
    (3, 10): Field("3f", _vector("c", "gyro")),
    (3, 11): Field("H", ("sensor saturation",)),
    (5, 0): _VPE_STATUS,
    (5, 1): Field("3f"),  # Ypr
    (5, 2): Field("4f"),  # Quat
    (5, 3): Field("9f"),  # DCM
    (5, 4): Field("3f"),  # MagNed
    (5, 5): Field("3f"),  # AccelNed
    (5, 6): Field("3f"),  # LinAccelBody
    (5, 7): Field("3f"),  # LinAccelNed
    (5, 8): Field("3f"),  # YprU
    (5, 12): Field("3f"),  # Heave
    (5, 13): Field("f"),  # AttU
    **{(4, bit): field for bit, field in _GNSS.items()},
    **{
        (6, bit): Field(form)  # InsStatus, PosLla, PosEcef, VelBody, VelNed, VelEcef, MagEcef, AccelEcef, ...
        for bit, form in enumerate(("H", "3d", "3d", "3f", "3f", "3f", "3f", "3f", "3f", "f", "f"))
    },
    **{(7, bit): field for bit, field in _GNSS.items()},
}
"""Fields by group and bit (manual, binary output groups)."""


def header(positions: Sequence[Position], *, extended: bool = False) -> bytes:
    """Return sync byte, group byte and field words; `extended`: with empty extension words."""
    words: dict[int, int] = {}
    for group, bit in positions:
        words[group] = words.get(group, 0) | 1 << bit
    groups = sum(1 << group - 1 for group in words)
    more = 1 << 15 if extended else 0
    packed = b"".join(
        struct.pack("<H", words[group] | more) + (b"\0\0" if extended else b"") for group in sorted(words)
    )
    return b"\xfa" + bytes([groups | 0x80, 0] if extended else [groups]) + packed


def packet(values: Mapping[Position, Sequence[float | bytes]], *, extended: bool = False) -> bytes:
    """Return a packet with these values by field."""
    positions = sorted(values)
    payload = b"".join(struct.pack("<" + FIELDS[p].format, *values[p]) for p in positions)
    covered = header(positions, extended=extended)[1:] + payload
    return b"\xfa" + covered + struct.pack(">H", crc16(covered))


def split_packet(data: bytes, at: int = 0) -> tuple[dict[Position, tuple[float | bytes, ...]], int]:
    """Return the values by field and the end of the packet at `at`; ValueError if any byte is wrong."""
    if data[at] != 0xFA:
        raise ValueError("no sync byte")
    place, positions = at + 2, []
    for group in range(1, 8):
        if data[at + 1] >> group - 1 & 1:
            (word,) = struct.unpack_from("<H", data, place)
            place += 2
            positions += [(group, bit) for bit in range(16) if word >> bit & 1]
    values = {}
    for position in positions:
        field = FIELDS[position]
        values[position] = struct.unpack_from("<" + field.format, data, place)
        place += field.size
    (crc,) = struct.unpack_from(">H", data, place)
    if crc != crc16(data[at + 1 : place]):
        raise ValueError("wrong CRC")
    return values, place + 2


def messages(data: bytes) -> Iterator[tuple[str, list[str]] | dict[Position, tuple[float | bytes, ...]]]:
    """Yield the sentences and packets of a stream; ValueError if any byte belongs to no valid message."""
    at = 0
    while at < len(data):
        if data[at] == 0xFA:
            values, at = split_packet(data, at)
            yield values
        else:
            end = data.index(b"\n", at) + 1
            name, fields, _ = unframe(data[at:end])
            yield name, fields
            at = end


# --------------------------------------------------------------------------------------- samples


@dataclass(frozen=True)
class Sample:
    """What a message means: kind, value by channel (SI units), clock with its time, and the saturated sensors."""

    kind: str
    values: dict[str, float]
    clock: str
    time_ns: int | None
    saturated: frozenset[str] | None = None


_KINDS = {"d": "deltas", "u": "uncompensated", "c": "compensated"}
_RATES: dict[str, Callable[[float], float]] = {"gyro": math.radians, "accel": float}


def sample_of_sentence(name: str, fields: Sequence[str]) -> Sample | None:
    """Return the sample in a measurement; None if it has no sensor data."""
    fields, count = list(fields), None
    while fields[-1][0] in "ST":
        mark = fields.pop()
        count = int(mark[1:]) if mark[0] == "T" else count
    named = {key: float(text) for (key, _), text in zip(SENTENCES[name], fields, strict=True)}
    if name == "VNDTV":
        values = {f"gyro/{axis}": math.radians(named[f"theta/{axis}"]) / named["dt"] for axis in "xyz"}
        values |= {f"accel/{axis}": named[f"velocity/{axis}"] / named["dt"] for axis in "xyz"}
        if count is None:
            return Sample("deltas", values, "dt", round(named["dt"] * 1e9))
        return Sample("deltas", values, "counter", count)
    values = {channel: named[channel] for channel in CHANNELS if channel in named}
    if not any(channel[-2] == "/" for channel in values):
        return None
    kind = "uncompensated" if name == "VNIMU" else "compensated"
    return Sample(kind, values, "none" if count is None else "counter", count)


def sample_of_packet(values: Mapping[Position, Sequence[float | bytes]]) -> Sample | None:
    """Return the sample in a packet; None if it has no sensor data.

    Each sensor uses its best kind (increments, uncompensated, compensated), the same for gyroscope and
    accelerometer if possible. A quantity that occurs twice is taken from the lower group.
    """
    named: dict[str, float] = {}
    for position in sorted(values):
        for key, value in zip(FIELDS[position].names, values[position], strict=False):
            assert not isinstance(value, bytes)
            named.setdefault(key, value)

    def has(kind: str, sensor: str) -> bool:
        return f"{kind} {sensor}/x" in named and (kind != "d" or "dt" in named)

    both = [kind for kind in "duc" if has(kind, "gyro") and has(kind, "accel")]
    result: dict[str, float] = {}
    used: list[str] = []
    for sensor in ("gyro", "accel"):
        kinds = both or [kind for kind in "duc" if has(kind, sensor)]
        for axis in "xyz" if kinds else "":
            value = named[f"{kinds[0]} {sensor}/{axis}"]
            result[f"{sensor}/{axis}"] = _RATES[sensor](value) / named["dt"] if kinds[0] == "d" else value
        used += kinds[:1]
    mags = [kind for kind in "uc" if has(kind, "mag")]
    result |= {f"mag/{axis}": named[f"{mags[0]} mag/{axis}"] for axis in "xyz" if mags}
    worst = max(used or mags[:1], key="duc".index, default="")
    if not worst:
        return None
    result |= {name: named[f"c {name}"] for name in ("temperature", "pressure") if f"c {name}" in named}
    clock = "startup" if "startup" in named else "dt" if "dt" in named else "none"
    time_ns = {"startup": lambda: int(named["startup"]), "dt": lambda: round(named["dt"] * 1e9)}.get(clock)
    words = {"vpe status": {2: "gyro", 9: "accel"}}
    words["sensor saturation"] = dict(enumerate(["mag"] * 3 + ["accel"] * 3 + ["gyro"] * 3 + ["pressure"]))
    saturated = {s for word in words for bit, s in words[word].items() if int(named.get(word, 0)) >> bit & 1}
    saturated &= {
        channel.split("/")[0] for channel in result
    }  # what exceeds its range unseen does not matter
    says = any(word in named for word in words)
    return Sample(_KINDS[worst], result, clock, time_ns and time_ns(), frozenset(saturated) if says else None)
