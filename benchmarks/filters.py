"""Consistency of Kalman filters with the parameters of imumon: measured NEES against the prediction.

    python benchmarks/filters.py [--runs N] [--records N] [--recordings DIR] [--part truths|fitted|real|gtsam]

The Kalman filter of this file is not the code that predicts: it steps at 5 Hz, filters simulated noise, and
measures the error of the angle. Seeds are 0, 1, 2 ... and were never looked at for choosing anything.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imumon.noise import Estimator, OctaveCascade, synthesise
from imumon.noise.filter_consistency import ChannelTruths, FilterModels, predict
from imumon.noise.filter_parameters import gauss_markov, smallest_walk

RATE = 5.0  # Hz, of the filter
AIDED_S = 900
HORIZONS = (10.0, 60.0, 600.0, 1800.0)
NAMES = ("N and K alone", "white, walk", "Gauss–Markov")
FIX = 1e-3  # rad


@dataclass(frozen=True)
class Truth:
    """Noise of a gyroscope, SI."""

    name: str
    N: float
    B: float
    K: float


TRUTHS = (
    Truth("reference, K unseen", 6.1e-5, 2.4e-5, 1e-7),
    Truth("reference, K 1e-6", 6.1e-5, 2.4e-5, 1e-6),
    Truth("reference, K 5e-6", 6.1e-5, 2.4e-5, 5e-6),
    Truth("little flicker, K unseen", 6.1e-5, 4.8e-6, 1e-8),
    Truth("little flicker, K 1e-6", 6.1e-5, 4.8e-6, 1e-6),
    Truth("much flicker, K unseen", 6.1e-5, 1e-4, 1e-7),
    Truth("much flicker, K 1e-5", 6.1e-5, 1e-4, 1e-5),
    Truth("tactical, K unseen", 1e-5, 2e-6, 1e-9),
    Truth("tactical, K 2e-7", 1e-5, 2e-6, 2e-7),
    Truth("consumer, K unseen", 3e-4, 2e-4, 1e-6),
    Truth("consumer, K 2e-5", 3e-4, 2e-4, 2e-5),
    Truth("no flicker", 6.1e-5, 0.0, 2e-6),
)


def filter_errors(
    samples: np.ndarray,
    fixes: np.ndarray,
    white: float,
    walk: float,
    sigma: np.ndarray,
    tau: np.ndarray,
    horizons: tuple[float, ...],
    rate: float = RATE,
    fix: float = FIX,
) -> tuple[np.ndarray, np.ndarray]:
    """Run a Kalman filter over records, and return its errors of the angle and the variances that it states.

    Parameters
    ----------
    samples : (n, c) rad/s, mean rates of sensors at rest.
    fixes : (k, c) rad, errors of the fixes at 0, 1, 2 ... s.
    sigma, tau : (p,) rad/s and s, Gauss-Markov terms.

    Returns
    -------
    (c, h) rad, (h,) rad^2
    """
    m, dt = 2 + len(sigma), 1.0 / rate
    decay = np.exp(-dt / tau)
    f = np.diag(np.concatenate([[1.0, 1.0], decay]))
    f[0, 1:] = -dt
    q = np.diag(np.concatenate([[white**2 * dt, walk**2 * dt], sigma**2 * (1.0 - decay**2)]))
    p = np.diag(np.concatenate([[fix**2, 1e6 * fix**2], sigma**2]))
    x = np.zeros((m, samples.shape[1]))
    x[0] = fixes[0]
    h = np.zeros(m)
    h[0] = 1.0
    per_fix, last = round(rate), (len(fixes) - 1) * round(rate)
    at = {last + round(t * rate): i for i, t in enumerate(horizons)}
    errors, variances = np.empty((samples.shape[1], len(horizons))), np.empty(len(horizons))
    for k in range(1, max(at) + 1):
        x = f @ x
        x[0] += samples[k - 1] * dt
        p = f @ p @ f.T + q
        if k % per_fix == 0 and k <= last:
            gain = p @ h / (p[0, 0] + fix**2)
            x += np.outer(gain, fixes[k // per_fix] - x[0])
            rest = np.eye(m) - np.outer(gain, h)
            p = rest @ p @ rest.T + np.outer(gain, gain) * fix**2  # Joseph's form
        if k in at:
            errors[:, at[k]], variances[at[k]] = x[0], p[0, 0]
    return errors, variances


def simulated(truth: Truth, runs: int, seed: int, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return mean rates at 5 Hz, (n, runs), and the errors of the fixes, (AIDED_S + 1, runs)."""
    rng = np.random.default_rng([20_261, seed])
    n = round((AIDED_S + longest) * RATE)
    one = np.ones(runs)
    samples = synthesise(n, RATE, truth.N * one, truth.B * one, truth.K * one, seed=rng)
    return samples, FIX * rng.standard_normal((AIDED_S + 1, runs))


def filters_of(
    n: float, b: float, k: float, horizon: float
) -> list[tuple[float, float, np.ndarray, np.ndarray]]:
    """Return white noise, walk, sigma and tau of the three filters, in the order of `NAMES`."""
    truths = ChannelTruths(*(np.array([v]) for v in (n, b, k, FIX)))
    at = horizon_grid(horizon)
    models, _ = gauss_markov(truths, at)
    none = np.empty(0)
    walk = float(smallest_walk(truths, at)[0])
    return [(n, k, none, none), (n, walk, none, none), (n, k, models.sigma[0], models.tau[0])]


def horizon_grid(horizon: float) -> np.ndarray:
    from imumon.noise.filter_parameters import horizons

    return horizons(horizon)


def predicted(
    truth: Truth, made: tuple[float, float, np.ndarray, np.ndarray], at: tuple[float, ...]
) -> np.ndarray:
    """Return the prediction of imumon for one filter, (h,)."""
    white, walk, sigma, tau = made
    models = FilterModels(np.array([white]), np.array([walk]), sigma[None], tau[None])
    truths = ChannelTruths(*(np.array([v]) for v in (truth.N, truth.B, truth.K, FIX)))
    return predict(models, truths, np.array(at)).nees[0]


def measured(
    truth: Truth, made: tuple[float, float, np.ndarray, np.ndarray], records: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the measured NEES of one filter and its standard error, (h,) each."""
    errors, variances = filter_errors(*records, *made, HORIZONS)
    ratio = errors**2 / variances
    return ratio.mean(axis=0), ratio.std(axis=0, ddof=1) / np.sqrt(len(ratio))


def row(name: str, filter_name: str, values: np.ndarray, form: str = ".2f") -> str:
    return f"| {name} | {filter_name} | " + " | ".join(f"{v:{form}}" for v in values) + " |"


def head(what: str) -> str:
    columns = " | ".join(f"{h:g} s" for h in HORIZONS)
    return f"\n| {what} | filter | {columns} |\n|---|---|" + "---|" * len(HORIZONS)


def truths_part(runs: int) -> float:
    """Print measured and predicted NEES of filters from the true N, B, K; return the largest distance."""
    print(head("truth (N, B, K)"))
    worst = 0.0
    for seed, truth in enumerate(TRUTHS):
        records = simulated(truth, runs, seed, HORIZONS[-1])
        for name, made in zip(NAMES, filters_of(truth.N, truth.B, truth.K, HORIZONS[-1]), strict=True):
            mean, error = measured(truth, made, records)
            forecast = predicted(truth, made, HORIZONS)
            worst = max(worst, float(np.abs((mean - forecast) / error).max()))
            cells = " | ".join(
                f"{m:.2f} ±{e:.2f} ({p:.2f})" for m, e, p in zip(mean, error, forecast, strict=True)
            )
            print(f"| {truth.name} | {name} | {cells} |", flush=True)
    print(f"\nLargest distance: {worst:.1f} standard errors of {12 * len(TRUTHS)} comparisons.")
    return worst


def fitted_part(records: int, runs: int, rate: float = 10.0, hours: float = 5.0) -> None:
    """Print the NEES of filters from N, B, K that were fitted to records of 5 h."""
    print(head(f"truth, {records} records of {hours:g} h"))
    for seed, truth in enumerate(TRUTHS):
        sums = np.zeros((2, len(NAMES), len(HORIZONS)))
        for index in range(records):
            rng = np.random.default_rng([20_262, seed, index])
            record = synthesise(round(hours * 3600 * rate), rate, truth.N, truth.B, truth.K, seed=rng)
            cascade = OctaveCascade(1, tau0=1.0 / rate)
            cascade.update(record)
            fit = Estimator(averaged=True).fit(cascade.result())[0]
            sizes = [c.value if c.status == "measured" else c.high / 2.0 for c in (fit.N, fit.B, fit.K)]
            simulation = simulated(truth, runs, 1000 * seed + index, HORIZONS[-1])
            for i, horizon in enumerate((600.0, HORIZONS[-1])):
                for j, made in enumerate(filters_of(*sizes, horizon)):
                    sums[i, j] += measured(truth, made, simulation)[0] / records
        for j, name in enumerate(NAMES):
            print(row(truth.name, name, np.concatenate([sums[0, j, :3], sums[1, j, 3:]])), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--records", type=int, default=20)
    parser.add_argument("--part", choices=["truths", "fitted", "real", "gtsam"], action="append")
    default = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    parser.add_argument("--recordings", type=Path, default=default)
    options = parser.parse_args()
    parts = options.part or ["truths", "fitted", "real", "gtsam"]
    if "truths" in parts and truths_part(options.runs) > 4.0:
        sys.exit("the measured NEES is not the predicted one")
    if "fitted" in parts:
        fitted_part(options.records, options.runs // 10)


if __name__ == "__main__":
    main()
