"""Benchmark of the accumulators: what a sample costs, beside one pass of np.sum and beside allantools.

    python benchmarks/cascade.py            one table, about 15 s
    python benchmarks/cascade.py --long     also 10^8 samples against exact integer arithmetic, about 1 min
    python benchmarks/cascade.py --day      also a day of one channel beside allantools, and growth with the length

All figures come from one run; every time is the least processor time of its repetitions. One pass of np.sum
over the same array is the yardstick.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import chain
from typing import NamedTuple

import allantools
import numpy as np
from document_tables import Figure, at_most, seconds, show

from imumon.model.saved_state import pack, unpack
from imumon.noise.allan import OctaveCascade
from imumon.noise.statistics.moments import Moments
from imumon.noise.synthesis import NoiseStream

GROUPS = (0, 0, 0, 1, 1, 1, 2, 2, 2)
SEED = 20240229


def costs() -> Iterator[Figure]:
    rng = np.random.default_rng(SEED)
    values = 9.8 + 1e-3 * rng.standard_normal((8000, 9))
    valid = rng.random((8000, 3)) >= 0.005
    unit = seconds(values.sum, 200) / values.size

    def cost(elapsed: float, samples: int = values.size) -> tuple[float, str]:
        """ns a sample, and beside one pass of np.sum."""
        return elapsed / samples * 1e9, f"{elapsed / samples / unit:,.0f} × np.sum"

    cascade, moments = OctaveCascade(9, 1 / 200, groups=GROUPS), Moments(9, GROUPS)
    cascade.skip(10**8)  # as deep as in a run of days
    ns, ratio = cost(seconds(lambda: cascade.update(values), 60))
    yield at_most(
        "a channel-sample, octaves, spectrum and block means, blocks of 8,000 × 9", ns, 60.0, "ns", ratio
    )
    ns, ratio = cost(seconds(lambda: cascade.update(values, valid), 40))
    yield Figure("the same, 0.5 % of the samples missing", f"{ns:.3g} ns", ratio)
    ns, ratio = cost(seconds(lambda: moments.update(values), 60))
    yield at_most("a channel-sample, moments to the fourth", ns, 6.0, "ns", ratio)
    noise = NoiseStream(800.0, N=np.full(9, 1e-3), B=1e-4, K=1e-5, seed=SEED)
    ns, ratio = cost(seconds(lambda: noise.generate(8000), 20))
    yield Figure("synthesis of N, B and K", f"{ns:.3g} ns", ratio)
    record = np.ascontiguousarray(np.tile(values[:, :1], (25, 1))[:, 0])
    elapsed = seconds(lambda: allantools.oadev(record, rate=200.0, data_type="freq", taus="octave"), 5, 1)
    ns, ratio = cost(elapsed, len(record))
    yield Figure("allantools, offline, 200,000 samples", "", f"{ns:,.0f} ns, {ratio}")
    ns, ratio = cost(seconds(lambda: realtime(record[:20_000]), 1, 0), 20_000)
    yield Figure("allantools, realtime, 20,000 samples, 10 octaves", "", f"{ns:,.0f} ns, {ratio}")
    yield from live(cascade, moments, values)


def realtime(record: np.ndarray) -> object:
    """The peer that takes one sample at a time, and keeps all of them."""
    tool = allantools.realtime.oadev_realtime(afs=2 ** np.arange(10), tau0=1 / 200)
    phase = np.cumsum(record - record[0]) / 200
    for x in phase:
        tool.add_phase(x)
    return tool


def live(cascade: OctaveCascade, moments: Moments, values: np.ndarray) -> Iterator[Figure]:
    """Small blocks as a port delivers them, and what is asked for every second."""
    blocks = [values[i : i + 40] for i in range(0, 8000, 40)]

    def all_of(update: Callable[[np.ndarray], None]) -> float:
        """us a block."""
        return seconds(lambda: [update(block) for block in blocks], 10) / len(blocks) * 1e6

    yield at_most(
        "a live block of 40 × 9, octaves, spectrum and block means", all_of(cascade.update), 100.0, "µs"
    )
    yield Figure("a live block of 40 × 9, moments", f"{all_of(moments.update):.3g} µs")
    state = pack(cascade)
    for what, work in (
        ("result()", cascade.result),
        ("pack", lambda: pack(cascade)),
        ("unpack", lambda: unpack(state)),
        ("skip(10^9)", lambda: cascade.copy().skip(10**9)),
    ):
        yield Figure(f"cascade, {what}", f"{seconds(work, 50) * 1e6:,.0f} µs")


def agreement() -> Figure:
    """With the offline tool, on the octaves that overlap fully."""
    y = np.random.default_rng(SEED).standard_normal((100_000, 1))
    cascade = OctaveCascade(1, 1.0)
    cascade.update(y)
    curve = cascade.result()
    _, sigma, _, _ = allantools.oadev(y[:, 0], rate=1.0, data_type="freq", taus=curve.tau[:4])
    error = float(np.abs(curve.sigma[:4, 0] / sigma - 1).max())
    return Figure("difference from allantools, m ≤ 8", f"{error:.0e}", "", "≤ 1e-12", error <= 1e-12)


def state_sizes() -> Iterator[Figure]:
    for exponent in (10, 12):
        cascade = OctaveCascade(9, 1 / 800, groups=GROUPS)
        cascade.skip(10**exponent)
        yield at_most(f"state of 9 channels at n = 10^{exponent}", len(pack(cascade)) / 1000, 200.0, "kB")


class ExactCascade:
    """The same octaves in integers: exact at any length.

    A float64 between 8 and 16 is a whole number of 2^-49, as are all sums of such numbers; their squares are
    added in two halves to integers of any size.
    """

    def __init__(self, octaves: int) -> None:
        self.taken = 0
        self.history = [np.zeros(0, dtype=np.int64) for _ in range(octaves)]
        self.squares = [0] * octaves
        self.terms = [0] * octaves

    def update(self, values: np.ndarray) -> None:
        entries = np.ldexp(values, 49).astype(np.int64) - (98 << 49) // 10
        index = self.taken  # of the first entry, on the octave's grid
        self.taken += len(values)
        for j in range(len(self.squares)):
            lag = min(1 << j, 8)
            x = np.concatenate((self.history[j], entries))
            index += lag - len(self.history[j])  # of the first with another `lag` before it
            self.history[j] = x[-lag:]
            difference, entries = x[lag:] - x[:-lag], x[lag:] + x[:-lag]
            self.terms[j] += len(difference)
            for i in range(0, len(difference), 32768):
                self.squares[j] += self.square(difference[i : i + 32768])
            if lag == 8:  # the next octave takes every second one
                entries = entries[(index + 1) % 2 :: 2]
                index //= 2

    @staticmethod
    def square(d: np.ndarray) -> int:
        high, low = d >> 24, d & 0xFFFFFF
        return (int(high @ high) << 48) + (int(high @ low) << 25) + int(low @ low)

    def avar(self, j: int) -> Fraction:
        return Fraction(self.squares[j], (2 * self.terms[j]) << 2 * j) / 2**98


def exactness(n: int) -> Figure:
    """Relative error after n samples around 9.8 of deviation 1e-3."""
    rng = np.random.default_rng(SEED)
    cascade, exact = OctaveCascade(1, 1 / 200), ExactCascade(12)
    for _ in range(n // 100_000):
        block = 9.8 + 1e-3 * rng.standard_normal(100_000)
        cascade.update(block[:, None])
        exact.update(block)
    curve = cascade.result()
    assert curve.terms[:12, 0].tolist() == exact.terms
    error = max(abs(float(Fraction(float(curve.avar[j, 0])) / exact.avar(j) - 1)) for j in range(12))
    what = f"error against exact integers after {n:.0e} samples, m = 1 ... 2048"
    return Figure(what, f"{error:.0e}", "", "≤ 1e-9", error <= 1e-9)


# A day, beside allantools --------------------------------------------------------------

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


def cost_of(program: str, samples: int) -> Cost:
    """Return the time and the memory that a program takes for a number of samples."""
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + program + END, str(samples)],
        capture_output=True,
        text=True,
        check=True,
    )
    return Cost(*map(float, done.stdout.split()))


def day(hours: float = 24.0) -> Iterator[Figure]:
    """Time and memory of one channel at 100 Hz, beside allantools, each in a process of its own.

    The realtime class of allantools gets a share of the record only, and its figures are scaled up: both grow in step
    with it. Memory is the peak of the process less what it needed before the first sample.
    """
    n = round(hours * 3600 * RATE)
    ours, offline = cost_of(CASCADE, n), cost_of(OFFLINE, n)
    part = cost_of(REALTIME, round(n * REALTIME_SHARE))
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


# Growth with the length of the record --------------------------------------------------

BLOCK = 1000
OFFLINE_MOST, MOMENTS_MOST, REALTIME_MOST = 7, 7, 5


class Length(NamedTuple):
    """Processor time, ns a sample, and bytes that are held; None: not tried."""

    n: int
    cascade_ns: float
    with_moments_ns: float | None
    offline_ns: float | None
    realtime_ns: float | None
    state_one: int
    state_nine: int
    offline_bytes: int


def fed(n: int, block: np.ndarray, moments: bool) -> tuple[float, OctaveCascade]:
    """Processor seconds to feed n samples."""
    cascade, running = OctaveCascade(1, 1 / 200), Moments(1, (0,))
    start = time.process_time()
    for _ in range(n // len(block)):
        cascade.update(block)
        if moments:
            running.update(block)
    cascade.result()
    return time.process_time() - start, cascade


def offline(values: np.ndarray) -> float:
    start = time.process_time()
    allantools.oadev(values, rate=200.0, data_type="freq", taus="octave")
    return time.process_time() - start


def of_length(exponent: int) -> Length:
    n, repeat = 10**exponent, max(1, min(5, 10 ** (7 - exponent)))
    rng = np.random.default_rng(SEED)
    block = 9.8 + 1e-3 * rng.standard_normal((BLOCK, 1))
    runs = [fed(n, block, False) for _ in range(repeat)]
    both = None
    if exponent <= MOMENTS_MOST:
        both = min(fed(n, block, True)[0] for _ in range(repeat)) / n * 1e9
    peer = None
    if exponent <= OFFLINE_MOST:
        record = np.tile(block[:, 0], n // BLOCK)
        peer = min(offline(record) for _ in range(repeat)) / n * 1e9
    live = None
    if exponent <= REALTIME_MOST:
        record = np.tile(block[:, 0], n // BLOCK)
        start = time.process_time()
        realtime(record)
        live = (time.process_time() - start) / n * 1e9
    nine = OctaveCascade(9, 1 / 200, groups=GROUPS)
    nine.skip(n)
    return Length(
        n,
        min(r[0] for r in runs) / n * 1e9,
        both,
        peer,
        live,
        len(pack(runs[-1][1])),
        len(pack(nine)),
        8 * n,
    )


def plot(rows: list[Length], path: str) -> None:
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "imumon"
    from matplotlib import pyplot

    n = [row.n for row in rows]
    figure, (cost, state) = pyplot.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    cost.loglog(n, [row.cascade_ns for row in rows], "o-", label="imumon: octaves")
    done = [row for row in rows if row.with_moments_ns is not None]
    cost.loglog([r.n for r in done], [r.with_moments_ns or 0.0 for r in done], "s-", label="with moments")
    done = [row for row in rows if row.offline_ns is not None]
    cost.loglog([r.n for r in done], [r.offline_ns or 0.0 for r in done], "^--", label="allantools, offline")
    done = [row for row in rows if row.realtime_ns is not None]
    cost.loglog(
        [r.n for r in done], [r.realtime_ns or 0.0 for r in done], "v--", label="allantools, realtime"
    )
    cost.set(
        xlabel="samples n", ylabel="processor time, ns a sample", title="Cost of one channel", ylim=(10, 1e5)
    )
    state.loglog(n, [row.state_nine for row in rows], "o-", label="imumon: octaves of 9 channels")
    state.loglog(n, [row.state_one for row in rows], "s-", label="imumon: octaves of 1 channel")
    state.loglog(n, [row.offline_bytes for row in rows], "^--", label="a record of 1 channel")
    state.set(xlabel="samples n", ylabel="bytes", title="Memory of one and of nine channels")
    for axes in (cost, state):
        axes.grid(True, which="major", alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(path, metadata={"Date": None})


def growth(most: int = 7, path: str | None = None) -> Iterator[Figure]:
    """Rows of the table from 10^4 to 10^most samples; the plot, if it is to go somewhere."""
    rows = []
    for exponent in range(4, most + 1):
        found = of_length(exponent)
        rows.append(found)
        peer = f"allantools {found.offline_ns:.0f} ns, " if found.offline_ns is not None else ""
        peer += f"realtime {found.realtime_ns:,.0f} ns, " if found.realtime_ns is not None else ""
        moments = f"{found.with_moments_ns:.0f}" if found.with_moments_ns is not None else "–"
        yield Figure(
            f"n = 10^{exponent}: a sample (with moments); state of 1 (9)",
            f"{found.cascade_ns:.0f} ({moments}) ns; "
            f"{found.state_one / 1e3:.1f} ({found.state_nine / 1e3:.1f}) kB",
            f"{peer}record {found.offline_bytes / 1e6:g} MB",
        )
    ratio = rows[-1].cascade_ns / rows[1].cascade_ns
    yield Figure(f"cost of a sample at n = 10^{most} over that at 10^5", f"{ratio:.2f} ×")
    if path is not None:
        plot(rows, path)


def measure(long: bool = False) -> Iterator[Figure]:
    yield from costs()
    yield agreement()
    yield exactness(10**8 if long else 10**6)
    yield from state_sizes()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--long", action="store_true", help="10^8 samples against exact arithmetic")
    parser.add_argument("--day", action="store_true", help="a day of one channel, and growth with the length")
    words = parser.parse_args()
    parts = [measure(words.long), *([day(), growth()] if words.day else [])]
    show("cascade", chain.from_iterable(parts))
