"""Warm-up: how often one is excluded from a record that has none, and how often one that is there is seen.

    python benchmarks/warmup.py [--records 100]

Records of 226 minutes, long enough for every decision, of six channels at 4 Hz: the recognition sees means
over seconds, so the rate does not matter. N = 6.1e-5 rad/s/sqrt(Hz) throughout. Exit code 1 where more than
one clean record in a hundred loses samples.
"""

from __future__ import annotations

import argparse

import numpy as np

from imumon.noise import Estimator, synthesise
from imumon.noise.stretches import RecordStatistics
from imumon.noise.stretches.warmup import still_settles

RATE_HZ, LENGTH_S, CHANNELS, N = 4.0, 13_520.0, 6, 6.1e-5
CLEAN = [(B, K) for B in (0.0, 2.4e-5) for K in (1e-7, 3e-7, 1e-6, 3e-6)]
HOUR_S, WALKS = 3600.0, (3e-7, 1e-6)
DECAYS = [(1e-4, 600.0), (1e-4, 300.0), (1e-3, 600.0)]


def watched(values: np.ndarray) -> tuple[float, bool]:
    """Seconds that are excluded as a warm-up, and whether some mean still settles at the end."""
    channels, averaged = range(CHANNELS), [True] * CHANNELS
    record = RecordStatistics(
        [0] * CHANNELS, CHANNELS, 1.0 / RATE_HZ, averaged=averaged, warmup_channels=channels
    )
    for begin in range(0, len(values), 4000):
        record.update(values[begin : begin + 4000])
    fits = Estimator(averaged=averaged, time_to=False).fit(record.curve())
    return record.warmup_s, still_settles(fits, LENGTH_S - record.begin_s)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=100, help="of each kind; default 100")
    count, false = parser.parse_args().records, 0
    n = round(LENGTH_S * RATE_HZ)
    print("B, rad/s  K, rad/s^2/sqrt(Hz)   excluded  still settles at the end, of", count)
    for B, K in CLEAN:
        made = (synthesise(n, RATE_HZ, N=[N] * CHANNELS, B=B, K=K, seed=seed) for seed in range(count))
        found = [watched(values) for values in made]
        excluded, lasts = sum(warmup > 0.0 for warmup, _ in found), sum(lasts for _, lasts in found)
        false += excluded
        print(f"{B:8g}  {K:19g}  {excluded:9d}  {lasts:24d}", flush=True)
    print("A exp(-t/T) on white noise, rad/s and s: excluded, of", count)
    elapsed = np.arange(n) / RATE_HZ
    for size, constant in DECAYS:
        excluded = 0
        for seed in range(count):
            values = synthesise(n, RATE_HZ, N=[N] * CHANNELS, B=0.0, K=0.0, seed=seed)
            values[:, 0] += size * np.exp(-elapsed / constant)
            excluded += watched(values)[0] > 0.0
        print(f"{size:8g}  {constant:4g}  {excluded:4d}", flush=True)
    print("walk of K rad/s^2/sqrt(Hz) on all axes that ends after an hour: excluded, of", count)
    for walk in WALKS:
        excluded = 0
        for seed in range(count):
            values = synthesise(n, RATE_HZ, N=[N] * CHANNELS, B=5e-6, seed=seed)
            steps = synthesise(n, RATE_HZ, K=[walk] * CHANNELS, seed=10_000 + seed)
            values += steps[np.minimum(np.arange(n), round(HOUR_S * RATE_HZ))]
            excluded += watched(values)[0] > 0.0
        print(f"{walk:8g}  {excluded:4d}", flush=True)
    print(f"{false} of {count * len(CLEAN)} clean records lose samples")
    return int(false > 0.01 * count * len(CLEAN))


if __name__ == "__main__":
    raise SystemExit(main())
