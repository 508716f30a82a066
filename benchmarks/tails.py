"""What the guards do to N of noise that is not Gaussian.

    python -m benchmarks.tails                 24 records a cell, half an hour at 40 Hz
    python -m benchmarks.tails --records 6

Truth: N = 6.1e-5 rad/s/sqrt(Hz), B = 2.4e-5 rad/s; white noise with the tails of Student's t of some degrees of
freedom, of the same variance, or Gaussian noise with single errors. A row has the mean error of N through the whole
pipeline with guards and without, the records whose limits miss the truth below and above, and the share of samples that
are excluded. Three channels are one run.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import imumon
from imumon.noise import synthesise

N, B, RATE, LENGTH = 6.1e-5, 2.4e-5, 40.0, 72_000
SIGMA = N * np.sqrt(RATE)
White = Callable[[np.random.Generator], np.ndarray]


def student(degrees: float) -> White:
    return lambda rng: rng.standard_t(degrees, (LENGTH, 3)) * np.sqrt((degrees - 2.0) / degrees)


def with_errors(share: float, least: float, most: float) -> White:
    """Gaussian noise of which a share of samples is off by some standard deviations."""

    def white(rng: np.random.Generator) -> np.ndarray:
        values = rng.standard_normal((LENGTH, 3))
        hit = rng.random((LENGTH, 3)) < share
        size = rng.uniform(least, most, int(hit.sum()))
        values[hit] += rng.choice([-1.0, 1.0], size.size) * size
        return values

    return white


CELLS: dict[str, White] = {
    "Gaussian": lambda rng: rng.standard_normal((LENGTH, 3)),
    "t(8)": student(8.0),
    "t(5)": student(5.0),
    "t(4)": student(4.0),
    "t(3)": student(3.0),
    "0.1 % of 8 to 20 sigma": with_errors(0.001, 8.0, 20.0),
    "0.1 % of 9 sigma": with_errors(0.001, 9.0, 9.0),
    "one in 20,000 of 1,000 sigma": with_errors(5e-5, 1000.0, 1000.0),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=24)
    parser.add_argument("--only", default="")
    arguments = parser.parse_args()
    print("| noise | guards | N off, mean | N misses below, above | excluded | `outliers` |")
    print("|---|---|---|---|---|---|")
    for name, white in CELLS.items():
        if arguments.only not in name:
            continue
        for guards in (True, False):
            parts, excluded, caveats = [], [], 0
            for seed in range(arguments.records // 3):
                rng = np.random.default_rng([47, seed])
                slow = synthesise(LENGTH, RATE, B=[B] * 3, seed=rng, averaged=False)
                m = imumon.analyse(gyro=slow + SIGMA * white(rng), rate_hz=RATE, guards=guards)
                channels = [m.report.channels[f"gyro/{axis}"] for axis in "xyz"]
                parts += [channel.N for channel in channels if channel.N is not None]
                excluded.append(m.report.session.excluded_s * RATE / LENGTH)
                caveats += sum("outliers" in channel.caveats for channel in channels)
            known = [part.value for part in parts if part.value is not None]
            below = sum(part.low is not None and part.low > N for part in parts)
            above = sum(part.high is not None and part.high < N for part in parts)
            error = f"{np.mean(known) / N - 1.0:+.1%} of {len(known)}"
            share, switch = f"{np.mean(excluded):.2%}", "on" if guards else "off"
            row = [name, switch, error, f"{below}, {above}", share, f"{caveats} of {len(parts)}"]
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
