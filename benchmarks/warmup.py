"""Warm-up: how often one is cut out of a record that has none, and how often one that is there is seen.

    python benchmarks/warmup.py [--records 100]

Records of 226 minutes, long enough for every decision, of six channels at 4 Hz: the recognition sees means
over seconds, so the rate does not matter. N = 6.1e-5 rad/s/sqrt(Hz) throughout. Exit code 1 where more than
one clean record in a hundred is cut.
"""

from __future__ import annotations

import argparse

import numpy as np

from imumon.noise.allan import AllanCurve
from imumon.noise.fit import ChannelFit, fit_curve
from imumon.noise.nonstationarity import HourlyStatistics
from imumon.noise.nonstationarity.warmup import find_settling, still_wanders_less
from imumon.noise.synthesis import synthesise

RATE_HZ, LENGTH_S, CHANNELS, N = 4.0, 13_520.0, 6, 6.1e-5
CLEAN = [(B, K) for B in (0.0, 2.4e-5) for K in (1e-7, 3e-7, 1e-6, 3e-6)]
HOUR_S, WALKS = 3600.0, (3e-7, 1e-6)
DECAYS = [(1e-4, 600.0), (1e-4, 300.0), (1e-3, 600.0)]


def fit(curve: AllanCurve) -> tuple[ChannelFit, ...]:
    return fit_curve(curve, averaged=True, time_to=False)


def watched(values: np.ndarray) -> tuple[float, bool]:
    """Seconds that were cut out as a warm-up, and whether one is still told at the end."""
    history = HourlyStatistics([0] * CHANNELS, CHANNELS, 1.0 / RATE_HZ, fit, warmup_channels=range(CHANNELS))
    for begin in range(0, len(values), 4000):
        history.update(values[begin : begin + 4000])
    drift, begin_s, fits = history.drift, history.begin_s, fit(history.curve())
    seen = [c for c, found in enumerate(fits) if found.K.value is not None]
    settles = any(find_settling(drift, seen, begin_s))
    return history.warmup_s, settles or still_wanders_less(drift, range(CHANNELS), begin_s)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=100, help="of each kind; default 100")
    count, false = parser.parse_args().records, 0
    n = round(LENGTH_S * RATE_HZ)
    print("B, rad/s  K, rad/s^2/sqrt(Hz)   cut  told at the end, of", count)
    for B, K in CLEAN:
        made = (synthesise(n, RATE_HZ, N=[N] * CHANNELS, B=B, K=K, seed=seed) for seed in range(count))
        found = [watched(values) for values in made]
        cut, told = sum(warmup > 0.0 for warmup, _ in found), sum(lasts for _, lasts in found)
        false += cut
        print(f"{B:8g}  {K:19g}  {cut:4d}  {told:15d}", flush=True)
    print("A exp(-t/T) on white noise, rad/s and s: cut, of", count)
    elapsed = np.arange(n) / RATE_HZ
    for size, constant in DECAYS:
        cut = 0
        for seed in range(count):
            values = synthesise(n, RATE_HZ, N=[N] * CHANNELS, B=0.0, K=0.0, seed=seed)
            values[:, 0] += size * np.exp(-elapsed / constant)
            cut += watched(values)[0] > 0.0
        print(f"{size:8g}  {constant:4g}  {cut:4d}", flush=True)
    print("walk of K rad/s^2/sqrt(Hz) on all axes that ends after an hour: cut, of", count)
    for walk in WALKS:
        cut = 0
        for seed in range(count):
            values = synthesise(n, RATE_HZ, N=[N] * CHANNELS, B=5e-6, seed=seed)
            steps = synthesise(n, RATE_HZ, K=[walk] * CHANNELS, seed=10_000 + seed)
            values += steps[np.minimum(np.arange(n), round(HOUR_S * RATE_HZ))]
            cut += watched(values)[0] > 0.0
        print(f"{walk:8g}  {cut:4d}", flush=True)
    print(f"{false} of {count * len(CLEAN)} clean records cut")
    return int(false > 0.01 * count * len(CLEAN))


if __name__ == "__main__":
    raise SystemExit(main())
