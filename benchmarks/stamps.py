"""Rate and losses of host stamps that jitter, where samples are lost.

    python -m benchmarks.stamps

Ten minutes at 40 Hz, a clock that is 30 ppm fast, 12 records a cell. Jitter is the width of an even distribution, or
the standard deviation of a normal one, in intervals. A row has the largest error of the interval, the share of the
losses that are found, and the share of steps that are wrong; N is wrong by half of the error of the interval.
"""

from __future__ import annotations

import numpy as np

from imumon.timebase.stamp_kinds import StampCandidate, decide

RATE, LENGTH, DRIFT, RECORDS = 40.0, 24_000, 3e-5, 12
JITTER = (("even", 0.1), ("even", 0.25), ("even", 0.5), ("normal", 0.04), ("normal", 0.12), ("normal", 0.2))
LOSSES = (0.0, 0.01, 0.07, 0.15, 0.3)


def main() -> None:
    print("| jitter | loss | interval off, largest | found | wrong steps |\n|---|---|---|---|---|")
    for name, width in JITTER:
        for share in LOSSES:
            off, found, wrong = [], [], []
            for seed in range(RECORDS):
                rng = np.random.default_rng([48, seed])
                received = rng.random(LENGTH) >= share
                late = rng.uniform(0.0, 1.0, LENGTH) if name == "even" else rng.standard_normal(LENGTH)
                times = np.sort(((np.arange(LENGTH) + width * late) * (1.0 + DRIFT) / RATE * 1e9)[received])
                stamps = times.astype(np.int64)
                decision = decide([StampCandidate(stamps)])
                assert decision.interval is not None
                placer = decision.placer(stamps[:2048])
                placed = placer.place(stamps, np.zeros(len(stamps), np.int64), final=True)
                steps, true = placed.steps[1:], np.diff(np.flatnonzero(received))
                off.append(abs(decision.interval * RATE * 1e-9 / (1.0 + DRIFT) - 1.0))
                found.append(int((steps - 1).sum()) / max(int((true - 1).sum()), 1))
                wrong.append(float(np.mean(steps != true)))
            seen = f"{np.mean(found):.1%}" if share else "–"
            row = [
                f"{name} {width:g}",
                f"{share:.0%}",
                f"{max(off):.1e}",
                seen,
                f"{np.mean(wrong):.2%}",
            ]
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
