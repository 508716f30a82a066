"""Limits of short records in which B or K just shows, or is absent.

    python -m benchmarks.threshold                    100 records a cell
    python -m benchmarks.threshold --records 48

Truth: N = 6.1e-5 rad/s/sqrt(Hz), B and K of the row, point samples at 20 Hz, at 5 Hz from an hour on. A row has the
records whose limits miss the truth below and above, and of those in which B or K is measured the number and their mean
error: what is measured by chance is too large, because a smaller estimate would have been a bound.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from imumon.coefficients import Estimate
from imumon.noise import ChannelFit, OctaveCascade, fit_curve, synthesise

N, B = 6.1e-5, 2.4e-5
CELLS = (
    (120, B, 0.0),
    (120, B, 1e-5),
    (120, 0.0, 1e-5),
    (120, 0.0, 3e-5),
    (300, B, 0.0),
    (300, B, 1e-5),
    (300, 0.0, 1e-5),
    (600, B, 0.0),
    (600, B, 1e-5),
    (600, 0.0, 1e-5),
    (600, 0.0, 3e-5),
    (600, 0.0, 0.0),
    (1800, 0.0, 1e-4),
    (7200, B, 0.0),
    (7200, B, 1.7e-6),
    (7200, 0.0, 3e-6),
)
"""s, B and K."""
BATCH = 24


def fits_of(seconds: int, flicker: float, walk: float, records: int) -> list[ChannelFit]:
    rate = 20.0 if seconds < 3600 else 5.0
    fits: list[ChannelFit] = []
    for begin in range(0, records, BATCH):
        count = min(BATCH, records - begin)
        values = synthesise(
            round(seconds * rate), rate, N=[N] * count, B=flicker, K=walk, seed=begin, averaged=False
        )
        cascade = OctaveCascade(count, tau0=1.0 / rate)
        cascade.update(values)
        fits += fit_curve(cascade.result(), averaged=False, time_to=False)
    return fits


def missed(parts: list[Estimate], truth: float) -> str:
    below = sum(part.low is not None and part.low > truth for part in parts)
    above = sum(part.high is not None and part.high < truth for part in parts)
    return f"{below}, {above}"


def measured(parts: list[Estimate], truth: float) -> str:
    values = [part.value for part in parts if part.status == "measured" and part.value is not None]
    return f"{len(values)}, {np.mean(values) / truth - 1.0:+.0%}" if values and truth else f"{len(values)}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=100)
    records = parser.parse_args().records
    print("| record | B | K | N off | B off | K off | B measured | K measured |")
    print("|---|---|---|---|---|---|---|---|")
    for seconds, flicker, walk in CELLS:
        fits = fits_of(seconds, flicker, walk, records)
        n, b, k = ([getattr(fit, letter) for fit in fits] for letter in "NBK")
        row = [
            f"{seconds:,} s",
            f"{flicker:g}",
            f"{walk:g}",
            missed(n, N),
            missed(b, flicker),
            missed(k, walk),
        ]
        print(f"| {' | '.join([*row, measured(b, flicker), measured(k, walk)])} |", flush=True)


if __name__ == "__main__":
    main()
