"""Consistency of Kalman filters with the parameters of imumon: measured NEES against the prediction.

    python benchmarks/filters.py [--runs N] [--records N] [--recordings DIR] [--part truths|fitted|real]

The Kalman filter of this file is not the code that predicts: it steps at 5 Hz, filters simulated noise, and
measures the error of the angle. Seeds are 0, 1, 2 ... and were never looked at for choosing anything.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import scipy.signal

from imumon.model.filter_report import FilterChannel
from imumon.model.report import Channel, DeviceDescription, Report, SessionCounters
from imumon.model.samples import Kind, SampleBlock, Stream
from imumon.noise import ChannelFit, Estimator, OctaveCascade, synthesise
from imumon.noise.filter_consistency import ChannelTruths, FilterModels, predict
from imumon.noise.filter_parameters import gauss_markov_terms, smallest_walk
from imumon.noise.filter_parameters import horizons as imumon_horizons
from imumon.record import Record
from imumon.record.filter_report_builder import assumed_noise, filter_report

RATE = 5.0  # Hz, of the filter
AIDED_S = 900
HORIZONS = (10.0, 60.0, 600.0, 1800.0)
NAMES = ("N and K alone", "white, walk", "Gauss–Markov")
FIX = 1e-3  # rad
MOST_DISTANCE = 3.0  # standard errors between measured and predicted NEES
FITTED = {"white, walk": (0.0, 1.8), "Gauss–Markov": (0.55, 1.8)}
"""NEES that filters from fitted records may have, for horizons up to 600 s."""
MARKOV_FITTED = (0.7, 1.4)
"""The same of filters with Gauss–Markov terms where the noise is Gauss–Markov noise."""


@dataclass(frozen=True)
class Truth:
    """Noise of a gyroscope, SI."""

    name: str
    N: float
    B: float
    K: float
    M: float = 0.0
    T: float = 1.0
    jumps: bool = False  # M is popcorn noise: two levels, M from their mean, each held for 2 T on the average

    @property
    def sizes(self) -> tuple[float, float, float, float, float]:
        """N, B, K, M and T."""
        return self.N, self.B, self.K, self.M, self.T


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
    Truth("Markov, 10 s", 6.1e-5, 0.0, 0.0, 3e-5, 10.0),
    Truth("Markov, 60 s", 6.1e-5, 0.0, 0.0, 3e-5, 60.0),
    Truth("Markov, 600 s", 6.1e-5, 0.0, 0.0, 3e-5, 600.0),
    Truth("Markov, 60 s, flicker", 6.1e-5, 1e-5, 0.0, 3e-5, 60.0),
    Truth("popcorn, 30 s", 6.1e-5, 1e-5, 0.0, 3e-5, 15.0, jumps=True),
    Truth("popcorn, 200 s", 6.1e-5, 1e-5, 0.0, 3e-5, 100.0, jumps=True),
)


@dataclass(frozen=True)
class Filters:
    """Parameters of f Kalman filters with p Gauss-Markov terms, SI."""

    white: np.ndarray  # (f,)
    walk: np.ndarray  # (f,)
    sigma: np.ndarray  # (f, p)
    tau: np.ndarray  # (f, p)


def filter_errors(
    samples: np.ndarray,
    fixes: np.ndarray,
    made: Filters,
    horizons: tuple[float, ...],
    rate: float = RATE,
    fix: float = FIX,
) -> tuple[np.ndarray, np.ndarray]:
    """Run f Kalman filters over c records each; return the errors of the angle and the stated variances.

    Parameters
    ----------
    samples : (n, f, c) rad/s, mean rates of sensors at rest.
    fixes : (k, f, c) rad, errors of the fixes at 0, 1, 2 ... s.

    Returns
    -------
    (f, c, h) rad, (f, h) rad^2
    """
    count, terms = made.sigma.shape
    m, dt = 2 + terms, 1.0 / rate
    decay = np.exp(-dt / made.tau)
    one, drive, p = (np.zeros((count, m, m)) for _ in range(3))
    i = np.arange(2, m)
    one[:] = np.eye(m)
    one[:, 0, 1:] = -dt
    one[:, i, i] = decay
    drive[:, 0, 0], drive[:, 1, 1] = made.white**2 * dt, made.walk**2 * dt
    drive[:, i, i] = made.sigma**2 * (1.0 - decay**2)
    p[:, 0, 0], p[:, 1, 1] = fix**2, 1e6 * fix**2
    p[:, i, i] = made.sigma**2
    x = np.zeros((count, m, samples.shape[2]))
    x[:, 0] = fixes[0]
    per_fix, last = round(rate), (len(fixes) - 1) * round(rate)
    at = {last + round(t * rate): j for j, t in enumerate(horizons)}
    errors, variances = np.empty((count, samples.shape[2], len(at))), np.empty((count, len(at)))
    for k in range(1, max(at) + 1):
        x = one @ x
        x[:, 0] += samples[k - 1] * dt
        p = one @ p @ one.swapaxes(1, 2) + drive
        if k % per_fix == 0 and k <= last:
            gain = p[:, :, :1] / (p[:, :1, :1] + fix**2)
            x = x + gain * (fixes[k // per_fix] - x[:, 0])[:, None]
            rest = np.eye(m) - gain * np.eye(m)[:1]
            p = rest @ p @ rest.swapaxes(1, 2) + gain @ gain.swapaxes(1, 2) * fix**2  # Joseph's form
        if k in at:
            errors[:, :, at[k]], variances[:, at[k]] = x[:, 0], p[:, 0, 0]
    return errors, variances


def simulated(truth: Truth, filters: int, runs: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return mean rates at 5 Hz, (n, filters, runs), and the errors of the fixes, (AIDED_S + 1, filters, runs)."""
    rng = np.random.default_rng([20_261, seed])
    n, one = round((AIDED_S + HORIZONS[-1]) * RATE), np.ones(filters * runs)
    samples = synthesise(n, RATE, truth.N * one, truth.B * one, truth.K * one, seed=rng)
    if truth.M:
        samples = samples + correlated_rates(truth, rng, n, len(one), RATE)
    fixes = FIX * rng.standard_normal((AIDED_S + 1, filters, runs))
    return samples.reshape(n, filters, runs), fixes


def correlated_rates(
    truth: Truth, rng: np.random.Generator, count: int, columns: int, rate: float
) -> np.ndarray:
    """Return Gauss–Markov or popcorn noise as mean rates, (count, columns)."""
    if not truth.jumps:
        return markov_rates(rng, count, columns, rate, truth.M, truth.T)
    jumps = rng.random((count, columns)) < 1.0 / (2.0 * truth.T * rate)
    return truth.M * np.where((np.cumsum(jumps, axis=0) + rng.integers(2, size=columns)) % 2, 1.0, -1.0)


def markov_rates(
    rng: np.random.Generator, count: int, columns: int, rate: float, sigma: float, time_s: float
) -> np.ndarray:
    """Return Gauss–Markov noise as mean rates, (count, columns): exact values at 20 instants of a sample, averaged."""
    fine = 20
    a = np.exp(-1.0 / (rate * fine * time_s))
    out, state = np.empty((count, columns)), sigma * rng.standard_normal(columns)
    for begin in range(0, count, 500):
        rows = min(500, count - begin)
        drive = sigma * np.sqrt(1.0 - a * a) * rng.standard_normal((rows * fine, columns))
        values, _ = scipy.signal.lfilter([1.0], [1.0, -a], drive, axis=0, zi=a * state[None])
        state = values[-1]
        out[begin : begin + rows] = values.reshape(rows, fine, columns).mean(axis=1)
    return out


def filters_of(
    n: np.ndarray, b: np.ndarray, k: np.ndarray, m: np.ndarray, t: np.ndarray, horizon: float
) -> list[Filters]:
    """Return the filters that imumon makes from N, B, K, M and T, (f,) each, in the order of `NAMES`."""
    truths = ChannelTruths(n, b, k, np.full(len(n), FIX), m, t)
    at = imumon_horizons(horizon)
    models, _ = gauss_markov_terms(truths, at)
    none = np.empty((len(n), 0))
    return [
        Filters(n, k, none, none),
        Filters(n, smallest_walk(truths, at), none, none),
        Filters(n, k, models.sigma, models.tau),
    ]


def predicted(truth: Truth, made: Filters) -> np.ndarray:
    """Return the predictions of imumon, (f, h)."""
    models = FilterModels(made.white, made.walk, made.sigma, made.tau)
    one = np.ones(len(made.white))
    truths = ChannelTruths(*(one * v for v in (truth.N, truth.B, truth.K, FIX, truth.M, truth.T)))
    return predict(models, truths, np.array(HORIZONS)).nees


def measured(made: Filters, records: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the squared errors over the stated variances, (f, c, h)."""
    errors, variances = filter_errors(*records, made, HORIZONS)
    return errors**2 / variances[:, None, :]


def head(what: str) -> str:
    columns = " | ".join(f"{h:g} s" for h in HORIZONS)
    return f"\n| {what} | filter | {columns} |\n|---|---|" + "---|" * len(HORIZONS)


def truths_part(runs: int) -> float:
    """Print measured and predicted NEES of filters from the true N, B, K; return the largest distance."""
    print(head("truth"))
    worst = 0.0
    for seed, truth in enumerate(TRUTHS):
        records = simulated(truth, 1, runs, seed)
        exact = [np.array([v]) for v in truth.sizes]
        for name, made in zip(NAMES, filters_of(*exact, HORIZONS[-1]), strict=True):
            ratio, forecast = measured(made, records)[0], predicted(truth, made)[0]
            mean, error = ratio.mean(axis=0), standard_error(forecast, runs)
            worst = max(worst, float(np.abs((mean - forecast) / error).max()))
            cells = (f"{m:.2f} ±{e:.2f} ({p:.2f})" for m, e, p in zip(mean, error, forecast, strict=True))
            print(f"| {truth.name} | {name} | {' | '.join(cells)} |", flush=True)
    count = len(NAMES) * len(HORIZONS) * len(TRUTHS)
    print(f"\nLargest distance of {count} comparisons: {worst:.1f} standard errors.")
    return worst


def standard_error(forecast: np.ndarray, runs: int) -> np.ndarray:
    """Return the standard error of a measured NEES if the prediction is right: the errors are Gaussian."""
    return forecast * np.sqrt(2.0 / runs)


def fitted(truth: Truth, seed: int, records: int, rate: float = 10.0, hours: float = 5.0) -> np.ndarray:
    """Return what imumon assumes of N, B, K, M and T after fits of simulated records, (5, records)."""
    found = []
    for index in range(records):
        rng = np.random.default_rng([20_262, seed, index])
        record = synthesise(round(hours * 3600 * rate), rate, truth.N, truth.B, truth.K, seed=rng)
        if truth.M:
            record = record + correlated_rates(truth, rng, len(record), 1, rate)
        cascade = OctaveCascade(1, tau0=1.0 / rate)
        cascade.update(record)
        found.append(assumed(Estimator(averaged=True).fit(cascade.result())[0]))
    return np.array(found).T


def assumed(fit: ChannelFit) -> list[float]:
    """Return N, B, K, M and T as the exported parameters assume them."""
    noise = assumed_noise(Channel(unit="rad/s", coefficients=fit.coefficients, M=fit.markov))
    return [noise.N, noise.B, noise.K, noise.M or 0.0, noise.T or 1.0]


def fitted_part(records: int, runs: int) -> list[str]:
    """Print the NEES of filters from N, B, K that were fitted to records of 5 h, over all records and runs.

    Return the filters that are outside `FITTED`.
    """
    print(head(f"truth, {records} fitted records of 5 h"))
    outside = []
    for seed, truth in enumerate(TRUTHS):
        sizes = fitted(truth, seed, records)
        simulation = simulated(truth, records, runs, 1000 + seed)
        short, long = filters_of(*sizes, 600.0), filters_of(*sizes, HORIZONS[-1])
        for name, to_600, to_1800 in zip(NAMES, short, long, strict=True):
            # up to 600 s with the numbers for 600 s, at 1800 s with those for 1800 s
            ratios = [measured(made, simulation).mean(axis=(0, 1)) for made in (to_600, to_1800)]
            least, most = FITTED.get(name, (0.0, np.inf))
            if truth.M and name == NAMES[-1]:
                least, most = MARKOV_FITTED
            if ratios[0][:-1].min() < least or ratios[0][:-1].max() > most:
                outside.append(f"{truth.name}, {name}")
            cells = (f"{value:.2f}" for value in (*ratios[0][:-1], ratios[1][-1]))
            print(f"| {truth.name} | {name} | {' | '.join(cells)} |", flush=True)
    return outside


def report_of_samples(values: np.ndarray, rate: float, kind: Kind = "uncompensated") -> Report:
    """Return the report of samples at rest, (n, 6) rad/s and m/s^2, through the pipeline with its guards."""
    channels = tuple(f"{sensor}/{axis}" for sensor in ("gyro", "accel") for axis in "xyz")
    stream, monitor = Stream(kind, channels, "simulated", "startup"), Record()
    for begin in range(0, len(values), 4096):
        rows = np.arange(begin, min(begin + 4096, len(values)))
        stamps = 10**9 + np.rint(rows * 1e9 / rate).astype(np.int64)
        monitor.feed(SampleBlock(stream, values[rows], stamps, np.zeros(len(rows), dtype=np.int64)))
    device = DeviceDescription(id="benchmark", stream=kind, sample_rate_hz=rate, alias_factor=1.0)
    return monitor.report(datetime(2026, 1, 1, tzinfo=UTC), device, "stopped", SessionCounters())


@dataclass(frozen=True)
class RealRecord:
    """A recording of a sensor at rest, and how long its filter gets fixes in a window."""

    name: str
    title: str
    rate: float
    aided_s: int
    horizons: tuple[float, ...]
    every_s: int  # between the beginnings of two windows


REAL = (
    RealRecord("adis16405_1", "ADIS16405, 2.8 h", 100.0, AIDED_S, HORIZONS, 100),
    RealRecord("adis16405_4", "ADIS16405, 2.8 h", 100.0, AIDED_S, HORIZONS, 100),
    RealRecord("kiran_stat5min", "VN-100, 5 min", 40.0, 60, (10.0, 60.0), 5),
    RealRecord("fc_car_idle", "VN-100 in a parked car, 5 min", 40.0, 60, (10.0, 60.0), 5),
)


def real_samples(record: RealRecord, folder: Path) -> np.ndarray:
    """Return (n, 6) rad/s and m/s^2 of a recording."""
    if (path := folder / f"{record.name}.npz").exists():
        arrays = np.load(path)
        return np.hstack([np.radians(arrays["gyro_dps"]), 9.80665 * arrays["accel_g"]])
    from recordings import read

    return read(folder / f"{record.name}.vnymr.txt.gz")


def real_part(folder: Path) -> None:
    """Print the NEES in the second half of real records, of filters from their first half."""
    print(head("record, sensor"))
    for record in REAL:
        if not list(folder.glob(f"{record.name}.*")):
            print(f"{record.name} is not in {folder}", file=sys.stderr)
            continue
        samples = real_samples(record, folder)
        half = len(samples) // 2
        report = report_of_samples(samples[:half], record.rate)
        made = filter_report(report, record.horizons[-1]).channels
        for sensor, fix, offset in (("gyro", 1e-3, 0), ("accel", 1e-2, 3)):
            axes = [
                (i, made[f"{sensor}/{axis}"]) for i, axis in enumerate("xyz") if f"{sensor}/{axis}" in made
            ]
            columns = [offset + i for i, _ in axes]
            windows, fixes = real_windows(samples[half:, columns], record, fix)
            for name, filters in zip(NAMES, real_filters([channel for _, channel in axes]), strict=True):
                errors, variances = filter_errors(windows, fixes, filters, record.horizons, RATE, fix)
                nees = (errors**2 / variances[:, None, :]).mean(axis=(0, 1))
                cells = [f"{value:.2f}" for value in nees] + ["–"] * (len(HORIZONS) - len(nees))
                print(f"| {record.name}, {sensor} | {name} | {' | '.join(cells)} |", flush=True)


def real_windows(samples: np.ndarray, record: RealRecord, fix: float) -> tuple[np.ndarray, np.ndarray]:
    """Return mean rates at 5 Hz in overlapping windows, (n, f, windows), and the errors of their fixes."""
    per_step = round(record.rate / RATE)
    means = (
        samples[: len(samples) // per_step * per_step].reshape(-1, per_step, samples.shape[1]).mean(axis=1)
    )
    length = round((record.aided_s + record.horizons[-1]) * RATE)
    begins = range(0, len(means) - length + 1, round(record.every_s * RATE))
    windows = np.stack([means[begin : begin + length] for begin in begins], axis=2)
    shape = (record.aided_s + 1, samples.shape[1], len(begins))
    return windows, fix * np.random.default_rng(20_265).standard_normal(shape)


def real_filters(channels: list[FilterChannel]) -> list[Filters]:
    """Return the filters of the axes of a sensor, in the order of `NAMES`."""
    n, k, walk = (np.array(v) for v in zip(*((c.white, c.walk_gm, c.walk) for c in channels), strict=True))
    terms = max(len(c.gauss_markov) for c in channels)
    sigma, tau = np.zeros((len(channels), terms)), np.ones((len(channels), terms))
    for i, channel in enumerate(channels):
        for j, term in enumerate(channel.gauss_markov):
            sigma[i, j], tau[i, j] = term.sigma, term.tau_s
    none = np.empty((len(channels), 0))
    return [Filters(n, k, none, none), Filters(n, walk, none, none), Filters(n, k, sigma, tau)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--records", type=int, default=20)
    parser.add_argument("--part", choices=["truths", "fitted", "real"], action="append")
    default = Path(__file__).resolve().parents[2] / "shared" / "recordings"
    parser.add_argument("--recordings", type=Path, default=default)
    options = parser.parse_args()
    parts = options.part or ["truths", "fitted", "real"]
    if "truths" in parts and truths_part(options.runs) > MOST_DISTANCE:
        sys.exit("the measured NEES is not the predicted one")
    if "fitted" in parts and (outside := fitted_part(options.records, options.runs // options.records)):
        sys.exit(f"filters from fitted records are not consistent: {'; '.join(outside)}")
    if "real" in parts:
        real_part(options.recordings)


if __name__ == "__main__":
    main()
