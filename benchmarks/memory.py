"""What 24 hours of one channel take of time and memory: the cascade beside allantools, offline and live.

    python benchmarks/memory.py [--hours 24]

Each tool works in a process of its own at 100 Hz, and is handed white noise. The cascade gets it in blocks of
1,000 samples; allantools' `oadev` the whole record at all octaves; its realtime class sample by sample at ten
octaves, for a share of the record only, whose figures are scaled up: both grow in step with it. Memory is the
peak of the process less what it needed before the first sample.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from typing import NamedTuple

from figures import Figure, show

RATE = 100.0
REALTIME_SHARE = 0.02
BEGIN = """
import sys, time, numpy as np
n = int(sys.argv[1])
block = np.random.default_rng(1).standard_normal(1000)
def peak():
    return int(next(l for l in open("/proc/self/status") if l.startswith("VmHWM")).split()[1])
"""
END = """
print(time.process_time() - began, (peak() - before) / 1024)
"""
CASCADE = """
from imumon.noise.allan import OctaveCascade
cascade = OctaveCascade(1, 0.01)
cascade.update(block[:, None]); cascade.result()
before, began = peak(), time.process_time()
for _ in range(n // 1000):
    cascade.update(block[:, None])
cascade.result()
"""
OFFLINE = """
import allantools
allantools.oadev(block, rate=100.0, data_type="freq", taus="octave")
before, began = peak(), time.process_time()
allantools.oadev(np.tile(block, n // 1000), rate=100.0, data_type="freq", taus="octave")
"""
REALTIME = """
from allantools.realtime import oadev_realtime
tool = oadev_realtime(afs=2 ** np.arange(10), tau0=0.01)
phase = np.cumsum(np.tile(block, n // 1000)) / 100.0
before, began = peak(), time.process_time()
for x in phase:
    tool.add_phase(x)
"""


class Cost(NamedTuple):
    """Processor time, s, and memory, MB."""

    cpu_s: float
    memory_mb: float


def cost(program: str, samples: int) -> Cost:
    """Of a program over so many samples."""
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + program + END, str(samples)],
        capture_output=True,
        text=True,
        check=True,
    )
    return Cost(*map(float, done.stdout.split()))


def measure(hours: float = 24.0) -> Iterator[Figure]:
    n = round(hours * 3600 * RATE)
    ours, offline = cost(CASCADE, n), cost(OFFLINE, n)
    part = cost(REALTIME, round(n * REALTIME_SHARE))
    live = Cost(part.cpu_s / REALTIME_SHARE, part.memory_mb / REALTIME_SHARE)
    what = f"one channel of {hours:g} h at {RATE:g} Hz"
    yield Figure(
        f"{what}, time",
        f"{ours.cpu_s:.2f} s",
        f"allantools offline {offline.cpu_s:.2f} s, realtime {live.cpu_s:,.0f} s",
    )
    yield Figure(
        f"{what}, memory",
        f"{max(ours.memory_mb, 0.1):.1f} MB or less",
        f"allantools offline {offline.memory_mb:,.0f} MB, realtime {live.memory_mb:,.0f} MB",
        "≤ 1 MB",
        ours.memory_mb <= 1.0,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--hours", type=float, default=24.0)
    show("memory", measure(parser.parse_args().hours))
