"""Checksums of the VN-100: an XOR of eight bits, and CRC16-CCITT.

Sentences carry either; binary packets carry the CRC, big endian, so that the CRC over a whole packet
behind its sync byte is zero.
"""

from __future__ import annotations

import binascii

import numpy as np


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
