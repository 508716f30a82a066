"""Binary packets of the VN-100: layouts, read and written.

A packet is ``FA``, the group byte, one 16-bit field word for each group that is set, the payload without
padding, little endian, and the CRC16 big endian. Its length is not sent: it follows from the words. A set
bit 7 of a group byte, or bit 15 of a field word, says that another one follows. What is not known by its
size cannot be stepped over, so a header that names such a field is refused.

Groups 4, 6 and 7 belong to the VN-200 and VN-300: sizes only. Names are the field's own in the
manual's manner, with its group in front: ``2.timeStartup``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from struct import iter_unpack
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.devices.vn100.checksum import crc16, crc16_rows
from imumon.devices.vn100.measurements import Recipe, recipe

SYNC = 0xFA
_FEW = 128
"""Packets that are checked one by one; those behind them by the array."""

COMMON, TIME, IMU, ATTITUDE = 1, 2, 3, 5


@dataclass(frozen=True, slots=True)
class BinaryField:
    """One field of a group.

    Attributes
    ----------
    code : numpy's type of its components, little endian.
    width : number of components.
    parts : quantities in it, as (first, last + 1) of its components.
    """

    name: str
    code: str
    width: int
    parts: Mapping[str, tuple[int, int]] = field(default_factory=dict)


def _f(name: str, code: str = "<f4", width: int = 3, **parts: tuple[int, int]) -> BinaryField:
    return BinaryField(name, code, width, parts)


_XYZ = (0, 3)
_ONE = (0, 1)
_TIME_STARTUP = _f("timeStartup", "<u8", 1, startup=_ONE)
_VPE_STATUS = _f("vpeStatus", "<u2", 1, vpe=_ONE)
_GNSS = {
    0: _f("utc", "u1", 8), 1: _f("tow", "<u8", 1), 2: _f("week", "<u2", 1), 3: _f("numSats", "u1", 1),
    4: _f("fix", "u1", 1), 5: _f("posLla", "<f8"), 6: _f("posEcef", "<f8"), 7: _f("velNed"), 8: _f("velEcef"),
    9: _f("posU"), 10: _f("velU", width=1), 11: _f("timeU", width=1),
}  # fmt: skip

GROUPS: dict[int, dict[int, BinaryField]] = {
    COMMON: {
        0: _TIME_STARTUP,
        1: _f("timeGps", "<u8", 1),
        2: _f("timeSyncIn", "<u8", 1),
        3: _f("ypr"),
        4: _f("quat", width=4),
        5: _f("angularRate", gyro=_XYZ),
        6: _f("posLla", "<f8"),
        7: _f("velNed"),
        8: _f("accel", accel=_XYZ),
        9: _f("imu", width=6, uaccel=_XYZ, ugyro=(3, 6)),
        10: _f("magPres", width=5, mag=_XYZ, temp=(3, 4), pres=(4, 5)),
        11: _f("deltas", width=7, dt=_ONE, dtheta=(1, 4), dvel=(4, 7)),
        12: _VPE_STATUS,
        13: _f("syncInCnt", "<u4", 1),
        14: _f("timeGpsPps", "<u8", 1),
    },
    TIME: {
        0: _TIME_STARTUP,
        1: _f("timeGps", "<u8", 1),
        2: _f("gpsTow", "<u8", 1),
        3: _f("gpsWeek", "<u2", 1),
        4: _f("timeSyncIn", "<u8", 1),
        5: _f("gpsPps", "<u8", 1),
        6: _f("utc", "u1", 8),
        7: _f("syncInCnt", "<u4", 1),
        8: _f("syncOutCnt", "<u4", 1),
        9: _f("timeStatus", "u1", 1),
    },
    IMU: {
        0: _f("imuStatus", "<u2", 1),
        1: _f("uncompMag", umag=_XYZ),
        2: _f("uncompAccel", uaccel=_XYZ),
        3: _f("uncompGyro", ugyro=_XYZ),
        4: _f("temp", width=1, temp=_ONE),
        5: _f("pres", width=1, pres=_ONE),
        6: _f("deltaTheta", width=4, dt=_ONE, dtheta=(1, 4)),
        7: _f("deltaVel", dvel=_XYZ),
        8: _f("mag", mag=_XYZ),
        9: _f("accel", accel=_XYZ),
        10: _f("angularRate", gyro=_XYZ),
        11: _f("sensSat", "<u2", 1, sat=_ONE),
    },
    4: _GNSS,
    ATTITUDE: {
        0: _VPE_STATUS,
        1: _f("ypr"),
        2: _f("quat", width=4),
        3: _f("dcm", width=9),
        4: _f("magNed"),
        5: _f("accelNed"),
        6: _f("linAccelBody"),
        7: _f("linAccelNed"),
        8: _f("yprU"),
        12: _f("heave"),
        13: _f("attU", width=1),
    },
    6: {
        0: _f("insStatus", "<u2", 1), 1: _f("posLla", "<f8"), 2: _f("posEcef", "<f8"), 3: _f("velBody"),
        4: _f("velNed"), 5: _f("velEcef"), 6: _f("magEcef"), 7: _f("accelEcef"), 8: _f("linAccelEcef"),
        9: _f("posU", width=1), 10: _f("velU", width=1),
    },
    7: _GNSS,
}  # fmt: skip
"""Fields by group and bit. Matrices are column by column; dt (s) is the first component of an increment."""


@dataclass(frozen=True, slots=True, eq=False)
class BinaryLayout:
    """One make of packet.

    Attributes
    ----------
    header : sync byte, group byte(s) and field words as they stand on the line.
    length : bytes of the whole packet.
    dtype : of one whole packet, every field a vector named ``group.name``; ``header`` and ``crc`` frame it.
    sources : field and components of each quantity.
    recipe : what becomes samples; None when there is no sensor in it.
    """

    header: bytes
    length: int
    dtype: np.dtype[np.void]
    sources: dict[str, tuple[str, slice]]
    recipe: Recipe | None

    @staticmethod
    def of(words: Mapping[int, int]) -> BinaryLayout:
        """Layout by field word of each group.

        >>> BinaryLayout.of({TIME: 0x0001, IMU: 0x00C0}).length
        44
        """
        if any(word & ~_KNOWN.get(group, 0) for group, word in words.items()):
            raise ValueError("no such binary output: a group or field whose size is not known")
        groups = sum(1 << (group - 1) for group in words)
        header = bytes((SYNC, groups)) + b"".join(words[g].to_bytes(2, "little") for g in sorted(words))
        made = layout(header)
        if made is None:
            raise ValueError("no such binary output: no group, or a group without a field")
        return made

    def encode(self, values: Mapping[str, npt.ArrayLike]) -> bytes:
        """Packets, one after the other, one for each row.

        Parameters
        ----------
        values : fields by name, with or without the group in front (then in all groups that have it);
            (n, k) or, for k = 1, (n,). A field that is not given is zero.
        """
        arrays = {name: np.asarray(value) for name, value in values.items()}
        packets = np.zeros(max(len(a) for a in arrays.values()), self.dtype)
        packets["header"] = np.frombuffer(self.header, np.uint8)
        for name in self.fields:
            value = arrays.get(name, arrays.get(name.partition(".")[2]))
            if value is not None:
                packets[name] = value.reshape(len(packets), -1)
        raw = packets.view(np.uint8).reshape(len(packets), self.length)
        raw[:, -2:] = [divmod(crc16(row[1:-2].tobytes()), 256) for row in raw]
        return raw.tobytes()

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the payload's fields, in their order."""
        return tuple(name for name in self.dtype.names or () if "." in name)

    def decode(self, data: bytes, at: int = 0, count: int = 1) -> npt.NDArray[np.void]:
        """(count,) packets as a structured array; their CRC is taken on trust."""
        return np.frombuffer(data, self.dtype, count, at)

    def quantity(self, packets: npt.NDArray[np.void], name: str) -> npt.NDArray[Any]:
        """(count, k) one quantity of what `decode` gave."""
        of, components = self.sources[name]
        vectors: npt.NDArray[Any] = packets[of]
        return vectors[:, components]

    def count(self, data: bytes, at: int, most: int) -> int:
        """How many valid packets of this layout follow one another from `at` on."""
        good = self._one_by_one(data, at, min(most, _FEW))
        size = _FEW
        # many at once only behind many good ones: a damaged line is not looked at over and over
        while good >= size and good < most:
            size = min(4 * size, most - good)
            rows = np.frombuffer(data, np.uint8, size * self.length, at + good * self.length)
            bad = self._invalid(rows.reshape(size, self.length))
            first = int(bad.argmax())
            if bad[first]:
                return good + first
            good += size
        return good

    def _one_by_one(self, data: bytes, at: int, most: int) -> int:
        """As `count`, for a few."""
        header, begun = self.header, crc16(self.header[1:])
        span = memoryview(data)[at : at + most * self.length]
        packets = iter_unpack(f"{len(header)}s{self.length - len(header)}s", span)
        for good, (head, rest) in enumerate(packets):
            if head != header or crc16(rest, begun):
                return good
        return most

    def _invalid(self, packets: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
        """Which rows are no valid packets of this layout."""
        begin = len(self.header) - (self.length - len(self.header)) % 2
        bad = np.not_equal(crc16_rows(packets[:, begin:], crc16(self.header[1:begin])), 0)
        for column, byte in enumerate(self.header):
            bad |= packets[:, column] != byte
        return bad


class Incomplete(Exception):
    """The header ends beyond the bytes there are."""


def layout(data: bytes, at: int = 0) -> BinaryLayout | None:
    """Layout of the packet that begins at `at`; None where no packet can begin.

    Raises
    ------
    Incomplete
        As long as the header may yet become one.
    """
    byte, end = _word(data, at + 1, 1)
    groups = [bit + 1 for bit in range(7) if byte >> bit & 1]
    if not groups:
        return None
    if byte & 0x80:
        beyond, end = _word(data, end, 1)
        if beyond:
            return None
    for group in groups:
        word, end = _word(data, end, 2)
        if word & 0x7FFF & ~_KNOWN[group] or not word & 0x7FFF:
            return None
        if word & 0x8000:
            beyond, end = _word(data, end, 2)
            if beyond:
                return None
    return _layout(data[at:end])


def _word(data: bytes, at: int, size: int) -> tuple[int, int]:
    """Little-endian number and where it ends."""
    if at + size > len(data):
        raise Incomplete
    return int.from_bytes(data[at : at + size], "little"), at + size


_KNOWN = {group: sum(1 << bit for bit in fields) for group, fields in GROUPS.items()}


@lru_cache(maxsize=64)
def _layout(header: bytes) -> BinaryLayout:
    """Layout of a header that is known to be good."""
    names: list[str] = ["header"]
    formats: list[tuple[str, tuple[int, ...]]] = [("u1", (len(header),))]
    sources: dict[str, tuple[str, slice]] = {}
    words: list[int] = []
    at = 3 if header[1] & 0x80 else 2
    for group in (bit + 1 for bit in range(7) if header[1] >> bit & 1):
        word, at = _word(header, at, 2)
        at += 2 if word & 0x8000 else 0
        words.append(word)
        for item in (item for bit, item in GROUPS[group].items() if word >> bit & 1):
            names.append(f"{group}.{item.name}")
            formats.append((item.code, (item.width,)))
            for part, (first, end) in item.parts.items():
                sources.setdefault(part, (names[-1], slice(first, end)))
    names.append("crc")
    formats.append(("u1", (2,)))
    dtype = np.dtype({"names": names, "formats": formats})
    source = f"binary {header[1]:02X}:{','.join(f'{word:04X}' for word in words)}"
    return BinaryLayout(header, dtype.itemsize, dtype, sources, recipe(frozenset(sources), source))
