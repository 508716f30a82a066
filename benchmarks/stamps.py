"""Rate, losses and limits of N, B and K with host stamps that jitter, where samples are lost.

    python benchmarks/stamps.py | python benchmarks/document_tables.py -       102 records a cell, ten minutes
    python benchmarks/stamps.py --records 402 --first 1000 --only "even 0.25"

Ten minutes at 40 Hz, a clock that is 30 ppm fast, three channels a run with the truth of `sample_errors`. Jitter is
the width of an even distribution, or the standard deviation of a normal one, in intervals. A row has the share of the
losses that are found, and of steps that are wrong, and the largest error of the interval; then the columns of
`sample_errors`. N is wrong by half of the error of the interval.
"""

from __future__ import annotations

import argparse

import numpy as np
from document_tables import head, row
from sample_errors import COLUMNS, B, K, N, Tally

import imumon
from imumon.noise import synthesise
from imumon.timebase.stamp_kinds import StampCandidate, decide

RATE, LENGTH, DRIFT = 40.0, 24_000, 3e-5
JITTER = (("even", 0.0), ("even", 0.1), ("even", 0.25), ("normal", 0.04), ("normal", 0.12))
LOSSES = (0.01, 0.07, 0.15, 0.3)


class Placing:
    """What the time base makes of the stamps of some records."""

    def __init__(self) -> None:
        self._off: list[float] = []
        self._found: list[float] = []
        self._wrong: list[float] = []

    def add(self, stamps: np.ndarray, received: np.ndarray) -> None:
        """Count the steps of one record: stamps in ns, and which samples (n,) arrived."""
        decision = decide([StampCandidate(stamps)])
        assert decision.interval is not None
        placed = decision.placer(stamps[:2048]).place(stamps, np.zeros(len(stamps), np.int64), final=True)
        steps, true = placed.steps[1:], np.diff(np.flatnonzero(received))
        self._off.append(abs(decision.interval * RATE * 1e-9 / (1.0 + DRIFT) - 1.0))
        self._found.append(int((steps - 1).sum()) / max(int((true - 1).sum()), 1))
        self._wrong.append(float(np.mean(steps != true)))

    def cells(self) -> list[str]:
        """Return the cells of a row."""
        return [f"{np.mean(self._found):.1%}", f"{np.mean(self._wrong):.2%}", f"{max(self._off):.1e}"]


def add_run(name: str, width: float, share: float, seed: int, placing: Placing, tally: Tally) -> None:
    """Count a run of three channels."""
    rng = np.random.default_rng([round(1000.0 * width), round(1000.0 * share), seed])
    received = rng.random(LENGTH) >= share
    late = rng.uniform(0.0, 1.0, LENGTH) if name == "even" else rng.standard_normal(LENGTH)
    times = np.sort(((np.arange(LENGTH) + width * late) * (1.0 + DRIFT) / RATE * 1e9)[received])
    stamps = times.astype(np.int64)
    values = synthesise(LENGTH, RATE, N=[N] * 3, B=[B] * 3, K=[K] * 3, seed=rng, averaged=False)[received]
    placing.add(stamps, received)
    tally.add(imumon.analyse(gyro=values, time_s=1.7e9 + stamps * 1e-9))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=102)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", default="", help="part of the names of a jitter")
    options = parser.parse_args()
    print(head("stamps", "jitter", "loss", "found", "wrong steps", "interval off", *COLUMNS), flush=True)
    for name, width in JITTER:
        for share in LOSSES:
            if options.only in f"{name} {width:g}":
                placing, tally = Placing(), Tally((N, B, K))
                for seed in range(options.first, options.first + options.records // 3):
                    add_run(name, width, share, seed, placing, tally)
                found, *others = placing.cells()
                cells = [f"{name} {width:g}", f"{share:.0%}", found, *others]
                print(row([*cells, *tally.cells()]), flush=True)


if __name__ == "__main__":
    main()
