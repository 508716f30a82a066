"""Checksums of the VN-100: XOR of bytes, and CRC16-CCITT.

Sentences have either of them. Binary packets have the CRC, big endian, so the CRC of all bytes of a packet
after its sync byte is zero.
"""

from __future__ import annotations

import binascii

import numpy as np


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
