"""What holes in a record do to the limits of N, B and K.

    python benchmarks/holes.py | python benchmarks/document_tables.py -         100 records a cell, ten minutes
    python benchmarks/holes.py --records 400 --first 1000 --only 0.01           other seeds of one row

Truth: N = 6e-5 rad/s/sqrt(Hz), K and no B, an hour at 40 Hz, point samples. K / (2 pi N) is the frequency at which the
walk has the density of the white noise. Holes lie at random places; each column has noise of its own. A cell has the
records whose 95 % limits miss N below and above, those that measure a B, and those whose limits miss K below and above,
as N/B/K.
"""

from __future__ import annotations

import argparse
import math
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the program does

import numpy as np
from document_tables import head, row

from imumon.model.coefficients import Estimate
from imumon.noise import ChannelFit, OctaveCascade, fit_curve, synthesise

N, RATE, LENGTH, BATCH = 6e-5, 40.0, 144_000, 10
CROSSINGS_HZ = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
HOLES = ((0, 0), *((round(seconds * RATE), count) for seconds in (1, 11, 30, 100) for count in (1, 20)))
"""Samples of a hole, and number of them."""


def fits_of(K: float, holes: tuple[int, int], seeds: range) -> list[ChannelFit]:
    """Fit records of some seeds, each with its own holes."""
    length, count = holes
    values = np.concatenate(
        [
            synthesise(LENGTH, RATE, N=N, K=K, seed=np.random.default_rng([*holes, seed]), averaged=False)
            for seed in seeds
        ],
        axis=1,
    )
    valid = np.ones(values.shape, dtype=bool)
    for column, seed in enumerate(seeds):
        for begin in np.random.default_rng(seed).integers(0, LENGTH - length, count).tolist():
            valid[begin : begin + length, column] = False
    cascade = OctaveCascade(len(seeds), tau0=1.0 / RATE, groups=range(len(seeds)))
    cascade.update(values, valid)
    return list(fit_curve(cascade.result(), averaged=False, time_to=False))


def missed(parts: list[Estimate], truth: float) -> str:
    """Return the numbers of limits that miss the truth below and above."""
    below = sum(part.low is not None and part.low > truth for part in parts)
    above = sum(part.high is not None and part.high < truth for part in parts)
    return f"{below}, {above}"


def cell(K: float, holes: tuple[int, int], first: int, records: int) -> str:
    fits = [
        fit
        for begin in range(first, first + records, BATCH)
        for fit in fits_of(K, holes, range(begin, min(begin + BATCH, first + records)))
    ]
    n, k = (missed(part, truth) for part, truth in (([f.N for f in fits], N), ([f.K for f in fits], K)))
    measured = sum(fit.B.status == "measured" for fit in fits)
    return f"{n}/{measured}/{k}".replace(" ", "")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", type=float, help="Hz, one row")
    options = parser.parse_args()
    names = [f"{count} of {length / RATE:g} s" if count else "no hole" for length, count in HOLES]
    print(head("holes", "K / (2πN), Hz", *names), flush=True)
    for crossing in CROSSINGS_HZ:
        if options.only in (None, crossing):
            K = crossing * 2.0 * math.pi * N
            cells = [cell(K, holes, options.first, options.records) for holes in HOLES]
            print(row([f"{crossing:g}", *cells]), flush=True)


if __name__ == "__main__":
    main()
