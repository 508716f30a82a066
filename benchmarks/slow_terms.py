"""Slow terms: how often the limits of K, drift and temperature slope miss the truth, in records of 10 h.

    python benchmarks/slow_terms.py [--records 400]

Block means of `restricted_likelihood`, 128 of each record, with the flicker known to 40 % of B^2. N = 1e-4
rad/s/sqrt(Hz), B = 5e-6 rad/s. `error` is the root mean square of K^2 over that of generalised least squares with
the same nuisance terms and the true covariance. Exit code 1 where limits of K miss in more than 7 %, or where
a drift of twenty standard errors gives a K that is not there in more than 5 %.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np

from imumon.noise.fit.restricted_likelihood import SlowTerms, fit_slow_terms, unit_covariances
from imumon.noise.synthesis import synthesise

BLOCKS, LENGTH_S, N, B, B_SHARE = 128, 281.25, 1e-4, 5e-6, 0.4
WALKS = (0.0, 3e-8, 1e-7, 3e-7, 1e-6, 1e-5)
AT_S = (np.arange(BLOCKS) + 0.5) * LENGTH_S
TEMPERATURES = {
    "none": None,
    "wave": 25.0 + 3.0 * np.sin(2.0 * np.pi * AT_S / 20_000.0),
    "warm-up": 25.0 + 8.0 * (1.0 - np.exp(-AT_S / 3000.0)),
}
PER_DEGC = 3e-6


def made(K: float, records: int) -> np.ndarray:
    values = synthesise(BLOCKS * 4, 4.0 / LENGTH_S, N=[N] * records, B=B, K=K, seed=20_261)
    return values.reshape(BLOCKS, 4, records).mean(axis=1)


def fitted(means: np.ndarray, temperature: np.ndarray | None) -> SlowTerms:
    ones = np.ones(means.shape[1])
    error = B_SHARE * B**2 * ones
    return fit_slow_terms(means, LENGTH_S, N**2 * ones, B**2 * ones, B2_error=error, temperature=temperature)


def least_error(K: float, temperature: np.ndarray | None) -> float:
    """Standard deviation of K^2 by generalised least squares, beside B^2 known to `B_SHARE`."""
    flicker, walk = unit_covariances(BLOCKS)
    columns = [np.ones(BLOCKS), AT_S] + ([] if temperature is None else [temperature])
    free = np.linalg.qr(np.stack(columns, axis=1), mode="complete")[0][:, len(columns) :]
    whole = N**2 / LENGTH_S * np.eye(BLOCKS) + B**2 * flicker + K**2 * LENGTH_S * walk
    inverse = np.linalg.inv(free.T @ whole @ free)
    f, r = (inverse @ (free.T @ each @ free) for each in (flicker, LENGTH_S * walk))
    own, both, other = (0.5 * float(np.sum(a * b.T)) for a, b in ((r, r), (r, f), (f, f)))
    return 1.0 / math.sqrt(own - both**2 / (other + (B_SHARE * B**2) ** -2))


def share_missed(truth: float, low: np.ndarray, high: np.ndarray) -> float:
    return float(np.mean((low > truth) | (high < truth)))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--records", type=int, default=400, help="of each cell; default 400")
    records, bad = parser.parse_args().records, False
    print("temperature, drift, K: K measured; missed by K, drift, temperature, %; error; ms per channel")
    for name, temperature in TEMPERATURES.items():
        for K in WALKS:
            means = made(K, records)
            if temperature is not None:
                means = means + PER_DEGC * temperature[:, None]
            unit = float(np.median(fitted(means[:, :20], temperature).drift_error))
            for errors in (0.0, 20.0):
                drift = errors * unit
                began = time.perf_counter()
                fit = fitted(means + drift * AT_S[:, None], temperature)
                spent = (time.perf_counter() - began) / records * 1e3
                measured, of_k = float(np.mean(fit.K2_low > 0.0)), share_missed(K**2, fit.K2_low, fit.K2_high)
                of_drift = share_missed(drift, fit.drift_low, fit.drift_high)
                of_heat = share_missed(PER_DEGC, fit.temperature_low, fit.temperature_high)
                error = float(np.sqrt(np.mean((fit.K2 - K**2) ** 2))) / least_error(K, temperature)
                bad |= of_k > 0.07 or (K == 0.0 and measured > 0.05)
                print(
                    f"{name:8} {errors:4g} {K:6g}: {measured:6.1%}; {of_k:5.1%} {of_drift:5.1%} {of_heat:5.1%}; "
                    f"{error:.2f}; {spent:.1f}",
                    flush=True,
                )
    return int(bad)


if __name__ == "__main__":
    raise SystemExit(main())
