"""Binary packets of the VN-100: layouts, decode and encode.

A packet is ``FA``, the group byte, one 16-bit field word for each group that is set, the payload without
padding in little endian, and the CRC16 in big endian. The length is not sent; it follows from the words. Bit
7 of a group byte, or bit 15 of a field word, means that another one follows. A field of unknown size cannot
be skipped, so a header that contains one is refused.

Groups 4, 6 and 7 belong to the VN-200 and VN-300: only their sizes are known. The name of a field is that of
the manual after the number of its group: ``2.timeStartup``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.sources.vn100.checksum import crc16
from imumon.sources.vn100.measurements import SampleConverter, sample_converter

SYNC = 0xFA
RUN = 64
"""Packets whose CRC is computed by one call: a call takes as long as the CRC of 200 bytes."""
OVERLAID = 16 * RUN
"""Packets that are joined at once: behind a damaged one, the work on the others is lost."""


class Group(IntEnum):
    """Groups of fields of binary packets."""

    COMMON = 1
    TIME = 2
    IMU = 3
    ATTITUDE = 5


@dataclass(frozen=True, slots=True)
class BinaryField:
    """One field of a group.

    Attributes
    ----------
    code : numpy type of its components, little endian.
    width : number of components.
    quantities : quantities that it contains, each with (first, last + 1) of its components.
    """

    name: str
    code: str
    width: int
    quantities: Mapping[str, tuple[int, int]]


_XYZ, _ONE = (0, 3), (0, 1)
# The names do not show it: ``imu`` is uncompensated and has the accelerometer first; the magnetic field of ``magPres``
# is compensated.
QUANTITIES: dict[str, dict[str, tuple[int, int]]] = {
    "timeStartup": {"startup": _ONE}, "vpeStatus": {"vpe": _ONE}, "sensSat": {"sat": _ONE},
    "angularRate": {"gyro": _XYZ}, "accel": {"accel": _XYZ}, "mag": {"mag": _XYZ},
    "uncompGyro": {"ugyro": _XYZ}, "uncompAccel": {"uaccel": _XYZ}, "uncompMag": {"umag": _XYZ},
    "imu": {"uaccel": _XYZ, "ugyro": (3, 6)}, "magPres": {"mag": _XYZ, "temp": (3, 4), "pres": (4, 5)},
    "deltas": {"dt": _ONE, "dtheta": (1, 4), "dvel": (4, 7)}, "deltaTheta": {"dt": _ONE, "dtheta": (1, 4)},
    "deltaVel": {"dvel": _XYZ}, "temp": {"temp": _ONE}, "pres": {"pres": _ONE},
}  # fmt: skip
"""Quantities of each field with the range of their components."""


def _group(text: str) -> dict[int, BinaryField]:
    """Return the fields of a group by bit: a name, and numpy type and width unless they are f4 and 3."""
    fields = {}
    for bit, entry in enumerate(text.split()):
        name, code, width = entry.split(":") if ":" in entry else (entry, "f4", "3")
        if name != "-":
            fields[bit] = BinaryField(name, f"<{code}", int(width), QUANTITIES.get(name, {}))
    return fields


_GNSS = _group(
    "utc:u1:8 tow:u8:1 week:u2:1 numSats:u1:1 fix:u1:1 posLla:f8:3 posEcef:f8:3 velNed velEcef posU velU:f4:1 "
    "timeU:f4:1"
)

GROUPS: dict[int, dict[int, BinaryField]] = {
    Group.COMMON: _group(
        "timeStartup:u8:1 timeGps:u8:1 timeSyncIn:u8:1 ypr quat:f4:4 angularRate posLla:f8:3 velNed accel "
        "imu:f4:6 magPres:f4:5 deltas:f4:7 vpeStatus:u2:1 syncInCnt:u4:1 timeGpsPps:u8:1"
    ),
    Group.TIME: _group(
        "timeStartup:u8:1 timeGps:u8:1 gpsTow:u8:1 gpsWeek:u2:1 timeSyncIn:u8:1 gpsPps:u8:1 utc:u1:8 "
        "syncInCnt:u4:1 syncOutCnt:u4:1 timeStatus:u1:1"
    ),
    Group.IMU: _group(
        "imuStatus:u2:1 uncompMag uncompAccel uncompGyro temp:f4:1 pres:f4:1 deltaTheta:f4:4 deltaVel mag "
        "accel angularRate sensSat:u2:1"
    ),
    4: _GNSS,
    Group.ATTITUDE: _group(
        "vpeStatus:u2:1 ypr quat:f4:4 dcm:f4:9 magNed accelNed linAccelBody linAccelNed yprU - - - heave "
        "attU:f4:1"
    ),
    6: _group(
        "insStatus:u2:1 posLla:f8:3 posEcef:f8:3 velBody velNed velEcef magEcef accelEcef linAccelEcef "
        "posU:f4:1 velU:f4:1"
    ),
    7: _GNSS,
}
"""Fields by group and bit. Matrices are in column-major order; dt (s) is the first component of an
increment."""


@dataclass(frozen=True, slots=True, eq=False)
class BinaryLayout:
    """Layout of one type of packet.

    Attributes
    ----------
    header : sync byte, group bytes and field words as bytes.
    length : bytes of a packet.
    dtype : type of a packet; each field is a vector named ``group.name``, between ``header`` and ``crc``.
    sources : field and components of each quantity.
    converter : converts the quantities to samples; None if the packet has no sensor data.
    """

    header: bytes
    length: int
    dtype: np.dtype[np.void]
    sources: dict[str, tuple[str, slice]]
    converter: SampleConverter | None

    @staticmethod
    def of(words: Mapping[int, int]) -> BinaryLayout:
        """Return the layout with these field words by group.

        Raises
        ------
        ValueError : a group or a field of unknown size, or no field.

        >>> BinaryLayout.of({Group.TIME: 0x0001, Group.IMU: 0x00C0}).length
        44
        """
        if any(word & ~_KNOWN_BITS.get(group, 0) for group, word in words.items()):
            raise ValueError("no such binary output: a group or a field of unknown size")
        groups = sum(1 << (group - 1) for group in words)
        header = bytes((SYNC, groups)) + b"".join(words[g].to_bytes(2, "little") for g in sorted(words))
        layout = parse_header(header)
        if layout is None:
            raise ValueError("no such binary output: no group, or a group without a field")
        return layout

    def encode(self, values: Mapping[str, npt.ArrayLike]) -> bytes:
        """Return the bytes of packets, one for each row.

        Parameters
        ----------
        values : fields by name, with or without the number of the group (then in all groups that have it);
            (n, k) or, for k = 1, (n,). Missing fields are zero.
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
        """Names of the fields of the payload in their order."""
        return tuple(name for name in self.dtype.names or () if "." in name)

    def decode(self, data: bytes, begin: int = 0, count: int = 1) -> npt.NDArray[np.void]:
        """Return (count,) packets as a structured array, without a check of their CRC."""
        return np.frombuffer(data, self.dtype, count, begin)

    def quantity(self, packets: npt.NDArray[np.void], name: str) -> npt.NDArray[Any]:
        """Return (count, k), one quantity of the result of `decode`."""
        source, components = self.sources[name]
        vectors: npt.NDArray[Any] = packets[source]
        return vectors[:, components]

    def count_valid(self, data: bytes, begin: int, limit: int) -> int:
        """Return the number of consecutive valid packets of this layout from `begin`, at most `limit`."""
        packets = np.frombuffer(data, np.uint8, limit * self.length, begin).reshape(limit, self.length)
        other = (packets[:, : len(self.header)] != np.frombuffer(self.header, np.uint8)).any(axis=1)
        limit = int(other.argmax()) if other.any() else limit
        # Over the packet behind its sync byte and the CRC that ends it, a CRC without final XOR is 0.
        checked, count = packets[:limit, 1:], 0
        for overlaid in _overlaid_runs(checked):
            if crc16(overlaid.data):
                break
            count += RUN
        while count < limit and not crc16(checked[count].data):
            count += 1
        return count


def _overlaid_runs(packets: npt.NDArray[np.uint8]) -> Iterator[npt.NDArray[np.uint8]]:
    """Yield each `RUN` of packets (n, k) as one row: each of them a byte farther on, joined by XOR.

    A CRC without initial value and final XOR is linear, and zeros before and behind bytes whose CRC is 0 leave it 0: so
    is that of a row of valid packets. One damaged packet always changes it; several go unnoticed in one of 65,536
    cases, as often as a single one. Without the byte between them, damage that is alike in two packets would cancel.
    """
    for first in range(0, len(packets) // RUN * RUN, OVERLAID):
        some = packets[first : first + OVERLAID]
        runs, width = len(some) // RUN, some.shape[1] + RUN
        apart = np.zeros((runs, RUN, width), np.uint8)
        apart[:, :, :-RUN] = some[: runs * RUN].reshape(runs, RUN, -1)
        # rows that are a byte shorter begin a byte later each
        shifted = apart.reshape(runs, -1)[:, : RUN * (width - 1)].reshape(runs, RUN, width - 1)
        yield from np.bitwise_xor.reduce(shifted, axis=1)


class IncompleteHeader(Exception):
    """The data end within the header."""


def parse_header(data: bytes, begin: int = 0) -> BinaryLayout | None:
    """Return the layout of the packet at `begin`; None if no packet can begin there.

    Raises
    ------
    IncompleteHeader : the data end within a header that may be valid.
    """
    byte, end = _read_word(data, begin + 1, 1)
    groups = [bit + 1 for bit in range(7) if byte >> bit & 1]
    if not groups:
        return None
    if byte & 0x80:  # more groups, of unknown size, unless their byte is empty
        extension, end = _read_word(data, end, 1)
        if extension:
            return None
    for group in groups:
        word, end = _read_word(data, end, 2)
        if word & 0x7FFF & ~_KNOWN_BITS[group] or not word & 0x7FFF:
            return None
        if word & 0x8000:
            extension, end = _read_word(data, end, 2)
            if extension:
                return None
    return _layout_of_header(data[begin:end])


def _read_word(data: bytes, offset: int, size: int) -> tuple[int, int]:
    """Return a little-endian number and the position behind it."""
    if offset + size > len(data):
        raise IncompleteHeader
    return int.from_bytes(data[offset : offset + size], "little"), offset + size


_KNOWN_BITS = {group: sum(1 << bit for bit in fields) for group, fields in GROUPS.items()}


@lru_cache(maxsize=64)
def _layout_of_header(header: bytes) -> BinaryLayout:
    """Return the layout of a valid header."""
    names, sources, words = ["header"], dict[str, tuple[str, slice]](), []
    formats: list[tuple[str, tuple[int, ...]]] = [("u1", (len(header),))]
    offset = 3 if header[1] & 0x80 else 2
    for group in (bit + 1 for bit in range(7) if header[1] >> bit & 1):
        word, offset = _read_word(header, offset, 2)
        offset += 2 if word & 0x8000 else 0
        words.append(f"{word:04X}")
        for item in (item for bit, item in GROUPS[group].items() if word >> bit & 1):
            names.append(f"{group}.{item.name}")
            formats.append((item.code, (item.width,)))
            for quantity, (first, end) in item.quantities.items():
                # a quantity that several groups repeat is the same number in each
                sources.setdefault(quantity, (names[-1], slice(first, end)))
    dtype = np.dtype({"names": [*names, "crc"], "formats": [*formats, ("u1", (2,))]})
    converter = sample_converter(frozenset(sources), f"binary {header[1]:02X}:{','.join(words)}")
    return BinaryLayout(header, dtype.itemsize, dtype, sources, converter)
