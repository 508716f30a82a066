"""Speed of the VN-100 decoder compared with its goals and with a reference loop.

Goals: packets of 60 bytes with CRC check at 40 MB/s; ``$VNYMR`` with checksum at 300,000 sentences/s; a live
block (a few messages) in 100 µs. The reference, in the same run, is a loop that parses and checks the same
messages with the standard library at known positions. Throughput is the best of several rounds, the time of a
block is the median, because other load on the machine only makes them slower.

    python benchmarks/codec.py
"""

from __future__ import annotations

import binascii
import struct
import time
from collections.abc import Iterator
from functools import reduce
from operator import xor
from statistics import median

import numpy as np
from figures import Figure, at_most, seconds, show

from imumon.devices.vn100 import ascii, binary
from imumon.devices.vn100.decoder import Vn100Decoder
from imumon.samples import SampleBlock

ROUNDS = 7
CHUNK = 65536


def packets(count: int) -> bytes:
    """TimeStartup, UncompMag, Temp, DeltaTheta, DeltaVel: 60 bytes each."""
    rng = np.random.default_rng(1)
    layout = binary.BinaryLayout.of({binary.Group.TIME: 0x0001, binary.Group.IMU: 0x00D2})
    theta = rng.normal(0.0, 1e-2, (count, 4))
    theta[:, 0] = 0.01
    return layout.encode(
        {
            "timeStartup": np.arange(count) * 10_000_000,
            "uncompMag": rng.normal(0.2, 1e-3, (count, 3)),
            "temp": rng.normal(25.0, 0.1, count),
            "deltaTheta": theta,
            "deltaVel": rng.normal(0.0, 1e-2, (count, 3)),
        }
    )


def sentences(count: int) -> bytes:
    """``$VNYMR`` of 122 bytes each."""
    rows = np.random.default_rng(2).normal(0.0, 5.0, (count, 12))
    return b"".join(ascii.encode(ascii.sentence("VNYMR", row)) for row in rows)


def decode(data: bytes, chunk: int) -> int:
    """Return the number of samples."""
    decoder = Vn100Decoder()
    found = 0
    for at in range(0, len(data), chunk):
        for item in decoder.feed(data[at : at + chunk]):
            found += len(item) if isinstance(item, SampleBlock) else 0
    return found


def one_by_one(data: bytes, size: int) -> int:
    """Return the number of samples by the reference loop: standard library, known positions."""
    found = 0
    for at in range(0, len(data), size):
        if size == 60:
            right = binascii.crc_hqx(data[at + 1 : at + size], 0) == 0
            values = struct.unpack_from("<6xQ11f", data, at)
        else:
            body, _, check = data[at + 1 : at + size - 2].partition(b"*")
            right = reduce(xor, body) == int(check, 16)
            values = tuple(map(float, body.decode().split(",")[1:]))
        found += right and len(values) == 12
    return found


def live(data: bytes, size: int) -> float:
    """Return the median time of a feed of `size` bytes, s."""
    decoder = Vn100Decoder()
    times = []
    for at in range(0, size * 2000, size):
        block = data[at : at + size]
        start = time.perf_counter()
        decoder.feed(block)
        times.append(time.perf_counter() - start)
    return median(times)


def measure() -> Iterator[Figure]:
    """Yield figures with those of the reference loop."""
    count = 20_000
    binary_data, ascii_data = packets(count), sentences(count)
    for work in (lambda d: decode(d, CHUNK), lambda d: one_by_one(d, len(d) // count)):
        assert work(binary_data) == work(ascii_data) == count
    for name, data, goal in (
        ("packets of 60 bytes", binary_data, 40e6 / 60),
        ("`$VNYMR`", ascii_data, 300e3),
    ):
        size = len(data) // count
        ours = count / seconds(lambda d=data: decode(d, CHUNK), ROUNDS, 0)
        plain = count / seconds(lambda d=data, s=size: one_by_one(d, s), ROUNDS, 0)
        yield Figure(
            f"decoder, {name}, check and all",
            f"{ours:,.0f}/s, {ours * size / 1e6:.0f} MB/s",
            f"a loop over struct or split: {plain:,.0f}/s",
            f"≥ {goal:,.0f}/s",
            ours >= goal,
        )
    for name, data in (("packets", binary_data), ("sentences", ascii_data)):
        for size in (100, 400):
            yield at_most(f"a live block of {size} bytes, {name}", live(data, size) * 1e6, 100.0, "µs")


if __name__ == "__main__":
    show("codec", measure())
