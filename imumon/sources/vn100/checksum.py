"""Checksums of the VN-100: XOR of bytes, and CRC16-CCITT.

Sentences have either of them. Binary packets have the CRC, big endian, so the CRC of all bytes of a packet
after its sync byte is zero.
"""

from __future__ import annotations

import binascii
from functools import cache

import numpy as np
import numpy.typing as npt


def xor8(data: bytes | memoryview) -> int:
    """Return the XOR of all bytes.

    >>> f"{xor8(b'VNRRG,01'):02X}"
    '72'
    """
    return int(np.bitwise_xor.reduce(np.frombuffer(data, np.uint8)))


def crc16(data: bytes | memoryview, initial: int = 0) -> int:
    """Return the CRC16-CCITT (XMODEM): polynomial 0x1021, initial value 0, no reflection, no final XOR.

    Parameters
    ----------
    initial : CRC of the bytes before `data`.

    >>> f"{crc16(b'123456789'):04X}"
    '31C3'
    """
    return binascii.crc_hqx(data, initial)


def crc16_rows(rows: npt.NDArray[np.uint8], initial: int) -> npt.NDArray[np.uint16]:
    """Return the (n,) CRC16 of each row of (n, k) bytes, k even; each step handles two bytes of all rows.

    Parameters
    ----------
    initial : CRC of the bytes before each row.

    >>> rows = np.frombuffer(b"23456789" * 2, np.uint8).reshape(2, 8)
    >>> [f"{crc:04X}" for crc in crc16_rows(rows, crc16(b"1"))]
    ['31C3', '31C3']
    """
    table = _word_table()
    crc = np.full(len(rows), int.from_bytes(initial.to_bytes(2, "big"), "little"), "<u2")
    for word in rows.view("<u2").T.copy():
        np.bitwise_xor(crc, word, out=crc)
        table.take(crc, out=crc, mode="clip")  # "clip" writes in place; no index is out of range
    return crc.byteswap()


@cache
def _word_table() -> npt.NDArray[np.uint16]:
    """Return the (65536,) CRC16 of every pair of bytes, indexed by the pair; both are little endian."""
    single = np.array([crc16(bytes((byte,))) for byte in range(256)], np.uint16)
    pair = np.arange(1 << 16)
    high = single[pair & 0xFF]
    crc = (high << np.uint16(8)) ^ single[(high >> np.uint16(8)) ^ (pair >> 8)]
    return np.asarray(crc, np.uint16).byteswap().astype("<u2")
