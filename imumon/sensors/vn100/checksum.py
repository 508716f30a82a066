"""Checksums of the VN-100: an XOR of eight bits, and CRC16-CCITT.

Sentences carry either; binary packets carry the CRC, big endian, so that the CRC over a whole packet
behind its sync byte is zero.
"""

from __future__ import annotations

import binascii
from functools import cache

import numpy as np
import numpy.typing as npt


def xor8(data: bytes | memoryview) -> int:
    """XOR of all bytes.

    >>> f"{xor8(b'VNRRG,01'):02X}"
    '72'
    """
    return int(np.bitwise_xor.reduce(np.frombuffer(data, np.uint8)))


def crc16(data: bytes | memoryview, begun: int = 0) -> int:
    """CRC16-CCITT as XMODEM has it: polynomial 0x1021, start 0, no reflection, no final XOR.

    `begun` is the CRC of what stands before `data`.

    >>> f"{crc16(b'123456789'):04X}"
    '31C3'
    """
    return binascii.crc_hqx(data, begun)


def crc16_rows(rows: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint16]:
    """(n,) CRC16 of each row of (n, k) bytes, two bytes a step for all rows together.

    >>> rows = np.frombuffer(b"123456789", np.uint8).reshape(1, 9)
    >>> f"{crc16_rows(rows)[0]:04X}"
    '31C3'
    """
    table = _word_table()
    n, k = rows.shape
    # zeros in front do not change a CRC that starts at 0
    words = np.zeros((-(-k // 2), n), np.uint16)
    first = words.shape[0] * 2 - k
    columns = rows.T
    words[first:] = columns[first::2]
    words[first:] <<= 8
    words |= columns[1 - first :: 2]
    crc = np.zeros(n, np.uint16)
    for word in words:
        np.bitwise_xor(crc, word, out=crc)
        table.take(crc, out=crc, mode="clip")  # "clip" writes in place; nothing is out of range
    return crc


@cache
def _word_table() -> npt.NDArray[np.uint16]:
    """(65536,) CRC16 of every pair of bytes."""
    single = np.array([crc16(bytes((byte,))) for byte in range(256)], np.uint16)
    pair = np.arange(1 << 16)
    high = single[pair >> 8]
    return np.asarray((high << np.uint16(8)) ^ single[(high >> np.uint16(8)) ^ (pair & 0xFF)], np.uint16)
