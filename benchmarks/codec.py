"""Speed of the VN-100 decoder, as ratios to the goals.

Three goals: packets of 60 bytes with their CRC checked at 40 MB/s; ``$VNYMR`` with its checksum checked at
300,000 sentences/s; a live block (a few messages) in 100 µs. Each figure is the best of several rounds:
what the machine does besides only makes it slower.

    python benchmarks/codec.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from imumon.samples import SampleBlock
from imumon.sensors.vn100 import Decoder, ascii, binary

ROUNDS = 7
CHUNK = 65536


def packets(count: int) -> bytes:
    """TimeStartup, UncompMag, Temp, DeltaTheta, DeltaVel: 60 bytes each."""
    rng = np.random.default_rng(1)
    layout = binary.Layout.of({binary.TIME: 0x0001, binary.IMU: 0x00D2})
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
    """Samples found."""
    decoder = Decoder()
    found = 0
    for at in range(0, len(data), chunk):
        for item in decoder.feed(data[at : at + chunk]):
            found += len(item) if isinstance(item, SampleBlock) else 0
    return found


def best(work: Callable[[], int]) -> float:
    """Shortest time of a round, s."""
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    """Print the figures and their ratios to the goals; above 1 is better than asked."""
    count = 20_000
    binary_data, ascii_data = packets(count), sentences(count)
    assert decode(binary_data, CHUNK) == decode(ascii_data, CHUNK) == count
    speed = len(binary_data) / best(lambda: decode(binary_data, CHUNK)) / 1e6
    print(f"binary, 60 bytes      {speed:9.1f} MB/s          {speed / 40:6.2f} x the goal")
    rate = count / best(lambda: decode(ascii_data, CHUNK))
    print(f"$VNYMR                {rate:9.0f} sentences/s   {rate / 300_000:6.2f} x the goal")
    for name, data in (("packets", binary_data), ("sentences", ascii_data)):
        for size in (100, 240, 400):
            part = data[: size * 1000]
            block = best(lambda part=part, size=size: decode(part, size)) / 1000 * 1e6
            print(f"live {name:<10} {size:4} B {block:7.1f} µs a block    {100 / block:6.2f} x the goal")


if __name__ == "__main__":
    main()
