"""What holes in a record do to N and K.

    python -m benchmarks.holes                        100 records a cell, half an hour
    python -m benchmarks.holes --records 24

Truth: N = 6e-5 rad/s/sqrt(Hz) and K, an hour at 40 Hz, point samples. Holes lie at random places. A row has the mean
error of K with its standard deviation between records, and the records in which a 95 % limit misses the truth below and
above.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from imumon.coefficients import Estimate
from imumon.noise import ChannelFit, OctaveCascade, fit_curve, synthesise

N, RATE, LENGTH = 6e-5, 40.0, 144_000
WALKS = (1e-4, 3e-5, 1e-3, 3e-6)
HOLES = ((0, 0), (440, 1), (440, 20), (40, 20), (1200, 5), (4000, 1))
"""Samples of a hole, and number of them."""


def record(K: float, length: int, count: int, seed: int) -> ChannelFit:
    values = synthesise(LENGTH, RATE, N=[N], K=[K], seed=1000 + seed, averaged=False)
    rng = np.random.default_rng(seed)
    for begin in rng.integers(0, LENGTH - length if length else 1, count):
        values[begin : begin + length] = np.nan
    cascade = OctaveCascade(1, tau0=1.0 / RATE)
    cascade.update(values)
    (fit,) = fit_curve(cascade.result(), averaged=False, time_to=False)
    return fit


def missed(estimates: list[Estimate], truth: float) -> tuple[int, int]:
    """Return in how many records the truth lies below the lower limit, and above the upper one."""
    below = sum(estimate.low is not None and truth < estimate.low for estimate in estimates)
    above = sum(estimate.high is not None and truth > estimate.high for estimate in estimates)
    return below, above


def row(K: float, length: int, count: int, records: int) -> str:
    fits = [record(K, length, count, seed) for seed in range(records)]
    errors = [fit.K.value / K - 1.0 for fit in fits if fit.K.value is not None]
    size = f"{np.mean(errors):+.1%} ± {np.std(errors):.1%} of {len(errors)}"
    apart = [
        ", ".join(map(str, missed([getattr(fit, c) for fit in fits], t))) for c, t in (("N", N), ("K", K))
    ]
    holes = f"{count} of {length / RATE:g} s" if count else "none"
    return f"| {K:g} | {holes} | {size} | {apart[0]} | {apart[1]} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=100)
    records = parser.parse_args().records
    print(f"Of {records} records:\n")
    print("| K | holes | error of K | N misses below, above | K misses below, above |\n|---|---|---|---|---|")
    for K in WALKS:
        for length, count in HOLES:
            print(row(K, length, count, records), flush=True)


if __name__ == "__main__":
    main()
