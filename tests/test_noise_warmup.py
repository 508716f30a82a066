"""Warm-up: recognised and left out where the sensor settles, never where it wanders."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise.allan import OctaveCascade
from imumon.noise.drift import Drift
from imumon.noise.fit import Estimator
from imumon.noise.synthesis import synthesise
from imumon.noise.wander import Wander
from imumon.noise.warmup import TIMES_S, Warmup, warming
from imumon.samples import Bools, Floats

RATE = 10.0
NOISE = Wander(1e-4, 2e-5, 1e-7)


class Count:
    """Statistics that only count."""

    def __init__(self) -> None:
        self.n = 0

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        self.n += len(values)

    def skip(self, n: int) -> None:
        self.n += n

    def break_(self) -> None:
        pass


def record(amplitude: float, time_s: float, seed: int, minutes: float = 115.0) -> Floats:
    n = round(minutes * 60 * RATE)
    values = synthesise(n, RATE, N=[NOISE.N] * 3, B=NOISE.B, K=NOISE.K, seed=seed)
    return np.asarray(values + amplitude * np.exp(-np.arange(n) / RATE / time_s)[:, None])


def passed(values: Floats, chunk: int = 300) -> tuple[Warmup[Count], list[float]]:
    """The manager after a record, and when it changed its mind, s."""
    warmup, drift, changed = Warmup(Count, RATE), Drift((0,) * 3, RATE), []
    for i in range(0, len(values), chunk):
        warmup.update(values[i : i + chunk])
        drift.update(values[i : i + chunk])
        if warmup.decide(drift, dict.fromkeys(range(3), NOISE)):
            changed.append(i / RATE)
    return warmup, changed


@pytest.mark.parametrize("seed", range(8))
def test_noise_is_no_warmup(seed: int) -> None:
    warmup, changed = passed(record(0.0, 1.0, seed))
    assert changed == []
    assert warmup.warmup_s == 0.0
    assert warmup.decided
    assert len(warmup.statistics) == 1


@pytest.mark.parametrize(
    ("amplitude", "time_s", "least", "most"),
    [
        (2e-3, 100.0, 300.0, 600.0),
        (2e-3, 400.0, 1200.0, 2400.0),
        (1e-3, 1200.0, 1200.0, 2400.0),
    ],
)
def test_settling_is_left_out(amplitude: float, time_s: float, least: float, most: float) -> None:
    values = record(amplitude, time_s, 1)
    warmup, changed = passed(values)
    assert least <= warmup.warmup_s <= most
    assert changed
    assert warmup.shown.n == len(values) - warmup.warmup_s * RATE
    assert len(warmup.statistics) == 1
    left = values[round(warmup.warmup_s * RATE) :]
    assert np.ptp(left[:, 0].reshape(-1, 600)[: len(left) // 600].mean(axis=1)) < 0.4 * amplitude


def test_a_steady_drift_is_no_warmup() -> None:
    values = record(0.0, 1.0, 3)
    values += 3e-7 * np.arange(len(values))[:, None] / RATE
    assert passed(values)[0].warmup_s == 0.0


def test_nothing_waits_and_little_runs_beside() -> None:
    warmup: Warmup[Count] = Warmup(Count, RATE)
    values = np.zeros((100, 3))
    warmup.update(values)
    assert warmup.shown.n == 100
    most = 0
    for _ in range(300):
        warmup.update(values)
        warmup.skip(3)
        most = max(most, len(warmup.statistics))
    assert most <= len(TIMES_S) + 1
    assert warmup.shown.n == 100 + 300 * 103


def test_saved_and_restored() -> None:
    values = record(2e-3, 400.0, 1, 60.0)
    whole, _ = passed(values)
    warmup, drift = Warmup(Count, RATE), Drift((0,) * 3, RATE)
    for i in range(0, len(values), 300):
        warmup.update(values[i : i + 300])
        drift.update(values[i : i + 300])
        warmup.decide(drift, dict.fromkeys(range(3), NOISE))
        fresh = Warmup(Count, RATE)
        fresh.restore(warmup.save(), warmup.statistics)
        warmup = fresh
    assert warmup.warmup_s == whole.warmup_s
    assert warmup.shown.n == whole.shown.n


def test_with_the_noise_as_it_is_fitted() -> None:
    """N, B and K are not known beforehand: they come from the youngest statistics."""
    values = record(2e-3, 300.0, 2, 60.0)
    warmup = Warmup(lambda: OctaveCascade(3, 1 / RATE), RATE)
    drift = Drift((0,) * 3, RATE)
    for i in range(0, len(values), 1200):
        warmup.update(values[i : i + 1200])
        drift.update(values[i : i + 1200])
        fits = Estimator(averaged=True).fit(warmup.latest.result())
        warmup.decide(drift, {c: Wander.of(fit) for c, fit in enumerate(fits)})
    assert warmup.warmup_s >= 600.0
    total = OctaveCascade(3, 1 / RATE)
    total.update(values)
    shown = Estimator(averaged=True).fit(warmup.shown.result())
    assert all(fit.N.value == pytest.approx(NOISE.N, rel=0.02) for fit in shown)


def test_a_rising_temperature_is_warming() -> None:
    t = np.arange(12_000) / RATE
    drift = Drift((0, 1), RATE, temperature=1)
    degrees = 20.0 + 8.0 * (1 - np.exp(-t / 300.0)) + np.rint(np.random.default_rng(1).random(len(t))) * 0.1
    values = np.column_stack((np.zeros(len(t)), degrees))
    drift.update(values[:1500])
    assert warming(drift, 1)
    drift.update(values[1500:])
    assert not warming(drift, 1)
    assert not warming(drift, None)
