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


def crc16_rows(rows: npt.NDArray[np.uint8], begun: int = 0) -> npt.NDArray[np.uint16]:
    """(n,) CRC16 of each row of (n, k) bytes, k even, two bytes a step for all rows together.

    `begun` is the CRC of what stands before each row.

    >>> rows = np.frombuffer(b"23456789" * 2, np.uint8).reshape(2, 8)
    >>> [f"{crc:04X}" for crc in crc16_rows(rows, crc16(b"1"))]
    ['31C3', '31C3']
    """
    table = _word_table()
    crc = np.full(len(rows), int.from_bytes(begun.to_bytes(2, "big"), "little"), "<u2")
    for word in rows.view("<u2").T.copy():
        np.bitwise_xor(crc, word, out=crc)
        table.take(crc, out=crc, mode="clip")  # "clip" writes in place; nothing is out of range
    return crc.byteswap()


@cache
def _word_table() -> npt.NDArray[np.uint16]:
    """(65536,) CRC16 of every pair of bytes; both the pair and its CRC little endian, as words are read."""
    single = np.array([crc16(bytes((byte,))) for byte in range(256)], np.uint16)
    pair = np.arange(1 << 16)
    high = single[pair & 0xFF]
    crc = (high << np.uint16(8)) ^ single[(high >> np.uint16(8)) ^ (pair >> 8)]
    return np.asarray(crc, np.uint16).byteswap().astype("<u2")
