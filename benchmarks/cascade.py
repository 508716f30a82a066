"""Benchmark of the accumulators: what a sample costs, beside one pass of np.sum and beside allantools.

    python benchmarks/cascade.py            one table, about 15 s
    python benchmarks/cascade.py --long     also 10^8 samples against exact integer arithmetic, about 1 min

All figures come from one run; every time is the shortest of its repetitions, the one that other work on the
machine disturbed least. `ratio` is to one pass of np.sum over the same array.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from fractions import Fraction

import allantools
import numpy as np

from imumon.noise.allan import OctaveCascade
from imumon.noise.signal.moments import Moments
from imumon.noise.synthesis import NoiseStream

GROUPS = (0, 0, 0, 1, 1, 1, 2, 2, 2)
SEED = 20240229


def seconds(work: Callable[[], object], repeat: int, warm: int = 2) -> float:
    """Shortest time of one call."""
    for _ in range(warm):
        work()
    times = []
    for _ in range(repeat):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def row(what: str, value: str, ratio: str = "", goal: str = "") -> None:
    print(f"| {what:<52} | {value:>16} | {ratio:>7} | {goal:>10} |")


def per_sample(what: str, elapsed: float, samples: int, unit: float, goal: str = "") -> None:
    row(what, f"{elapsed / samples * 1e9:.2f} ns", f"{elapsed / samples / unit:.1f}", goal)


def costs() -> None:
    rng = np.random.default_rng(SEED)
    values = 9.8 + 1e-3 * rng.standard_normal((8000, 9))
    valid = rng.random((8000, 3)) >= 0.005
    unit = seconds(values.sum, 200) / values.size
    per_sample("np.sum over 8,000 x 9, a channel-sample", unit * values.size, values.size, unit)
    cascade = OctaveCascade(9, 1 / 200, groups=GROUPS)
    cascade.skip(10**8)  # as deep as in a run of days
    per_sample(
        "cascade, blocks of 8,000 x 9",
        seconds(lambda: cascade.update(values), 60),
        values.size,
        unit,
        "<= 12",
    )
    per_sample(
        "cascade, 0.5 % of samples missing",
        seconds(lambda: cascade.update(values, valid), 40),
        values.size,
        unit,
    )
    moments = Moments(9, GROUPS)
    per_sample(
        "moments, blocks of 8,000 x 9", seconds(lambda: moments.update(values), 60), values.size, unit, "<= 6"
    )
    record = np.ascontiguousarray(np.tile(values[:, :1], (25, 1))[:, 0])
    elapsed = seconds(lambda: allantools.oadev(record, rate=200.0, data_type="freq", taus="octave"), 5, 1)
    per_sample('allantools.oadev(taus="octave"), 200,000 samples', elapsed, len(record), unit)
    per_sample(
        "allantools, realtime, 20,000 samples", seconds(lambda: realtime(record[:20_000]), 1, 0), 20_000, unit
    )
    noise = NoiseStream(800.0, N=np.full(9, 1e-3), B=1e-4, K=1e-5, seed=SEED)
    per_sample("synthesis, N, B and K", seconds(lambda: noise.take(8000), 20), values.size, unit)
    live(cascade, moments, values)


def realtime(record: np.ndarray) -> object:
    """The peer that takes one sample at a time, and keeps all of them."""
    tool = allantools.realtime.oadev_realtime(afs=2 ** np.arange(10), tau0=1 / 200)
    phase = np.cumsum(record - record[0]) / 200
    for x in phase:
        tool.add_phase(x)
    return tool


def live(cascade: OctaveCascade, moments: Moments, values: np.ndarray) -> None:
    """Small blocks as a port delivers them, and what is asked for every second."""
    blocks = [values[i : i + 40] for i in range(0, 8000, 40)]

    def all_of(update: Callable[[np.ndarray], None]) -> Callable[[], None]:
        def run() -> None:
            for block in blocks:
                update(block)

        return run

    row(
        "cascade, live block of 40 x 9",
        f"{seconds(all_of(cascade.update), 10) / 200 * 1e6:.1f} us",
        "",
        "<= 100 us",
    )
    row("moments, live block of 40 x 9", f"{seconds(all_of(moments.update), 10) / 200 * 1e6:.1f} us")
    row("cascade, result()", f"{seconds(cascade.result, 100) * 1e6:.0f} us")
    row("cascade, save()", f"{seconds(cascade.save, 100) * 1e6:.0f} us")
    state = cascade.save()
    row("cascade, restore()", f"{seconds(lambda: OctaveCascade.restore(state), 50) * 1e6:.0f} us")
    row("cascade, skip(10^9)", f"{seconds(lambda: cascade.copy().skip(10**9), 20) * 1e6:.0f} us")


def accuracy() -> None:
    """Against the offline tool, on the octaves that overlap fully."""
    y = np.random.default_rng(SEED).standard_normal((100_000, 1))
    cascade = OctaveCascade(1, 1.0)
    cascade.update(y)
    curve = cascade.result()
    _, sigma, _, _ = allantools.oadev(y[:, 0], rate=1.0, data_type="freq", taus=curve.tau[:4])
    row(
        "relative error against allantools.oadev, m <= 8",
        f"{np.abs(curve.sigma[:4, 0] / sigma - 1).max():.1e}",
        "",
        "1e-12",
    )


def state_sizes() -> None:
    for exponent in (4, 6, 8, 10, 12):
        cascade = OctaveCascade(9, 1 / 800, groups=GROUPS)
        cascade.skip(10**exponent)
        goal = "<= 64 kB" if exponent == 10 else ""
        row(f"state of 9 channels at n = 10^{exponent}", f"{cascade.nbytes / 1000:.1f} kB", "", goal)


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


def exactness(n: int) -> None:
    """Relative error after n samples around 9.8 of deviation 1e-3."""
    rng = np.random.default_rng(SEED)
    cascade, exact = OctaveCascade(1, 1 / 200), ExactCascade(12)
    for _ in range(n // 100_000):
        block = 9.8 + 1e-3 * rng.standard_normal(100_000)
        cascade.update(block[:, None])
        exact.update(block)
    curve = cascade.result()
    assert curve.terms[:12, 0].tolist() == exact.terms
    errors = [abs(float(Fraction(float(curve.avar[j, 0])) / exact.avar(j) - 1)) for j in range(12)]
    row(f"relative error after {n:.0e} samples, m = 1 ... 2048", f"{max(errors):.1e}", "", "1e-9")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--long", action="store_true", help="10^8 samples against exact arithmetic")
    long = parser.parse_args().long
    row("what", "value", "ratio", "goal")
    row("---", "---:", "---:", "---:")
    costs()
    accuracy()
    exactness(10**8 if long else 10**6)
    state_sizes()


if __name__ == "__main__":
    main()
