"""Benchmark of the accumulators: what a sample costs, beside one pass of np.sum and beside allantools.

    python benchmarks/cascade.py            one table, about 15 s
    python benchmarks/cascade.py --long     also 10^8 samples against exact integer arithmetic, about 1 min

All figures come from one run; every time is the least processor time of its repetitions. One pass of np.sum
over the same array is the yardstick.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from fractions import Fraction

import allantools
import numpy as np
from figures import Figure, at_most, seconds, show

from imumon.noise.allan import OctaveCascade
from imumon.noise.statistics.moments import Moments
from imumon.noise.synthesis import NoiseStream
from imumon.saved_state import pack

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
        ("restore()", lambda: OctaveCascade.restore(state)),
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
        yield at_most(f"state of 9 channels at n = 10^{exponent}", cascade.nbytes / 1000, 200.0, "kB")


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


def measure(long: bool = False) -> Iterator[Figure]:
    yield from costs()
    yield agreement()
    yield exactness(10**8 if long else 10**6)
    yield from state_sizes()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--long", action="store_true", help="10^8 samples against exact arithmetic")
    show("cascade", measure(parser.parse_args().long))
