"""Warm-up: recognised and left out where the sensor settles, never where it wanders."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise.history.drift import Drift, Slope
from imumon.noise.history.wander import Wander
from imumon.noise.history.warmup import ENOUGH, TIMES_S, settles, warming
from imumon.noise.synthesis import synthesise
from imumon.samples import Floats

RATE = 10.0
NOISE = Wander(1e-4, 2e-5, 1e-7)


def record(amplitude: float, time_s: float, seed: int, minutes: float = 115.0) -> Floats:
    n = round(minutes * 60 * RATE)
    values = synthesise(n, RATE, N=[NOISE.N] * 3, B=NOISE.B, K=NOISE.K, seed=seed)
    return np.asarray(values + amplitude * np.exp(-np.arange(n) / RATE / time_s)[:, None])


def warmup(values: Floats) -> float:
    """s, end of the last warm-up recognised, every candidate being asked at its time."""
    drift, begin, done = Drift((0,) * 3, RATE), 0.0, 0
    for candidate in TIMES_S:
        until = round(ENOUGH * candidate * RATE)
        for i in range(done, until, 500):
            drift.update(values[i : min(i + 500, until)])
        done = until
        slopes = (
            (drift.slope(c, NOISE, begin, candidate), drift.slope(c, NOISE, candidate)) for c in range(3)
        )
        if any(settles(before, behind) for before, behind in slopes):
            begin = candidate
    return begin


@pytest.mark.parametrize("seed", range(8))
def test_noise_is_no_warmup(seed: int) -> None:
    assert warmup(record(0.0, 1.0, seed)) == 0.0


@pytest.mark.parametrize(
    ("amplitude", "time_s", "least", "most"),
    [(2e-3, 100.0, 300.0, 600.0), (2e-3, 400.0, 1200.0, 2400.0), (1e-3, 1200.0, 1200.0, 2400.0)],
)
def test_settling_is_recognised(amplitude: float, time_s: float, least: float, most: float) -> None:
    values = record(amplitude, time_s, 1)
    end = warmup(values)
    assert least <= end <= most
    left = values[round(end * RATE) :, 0]
    assert np.ptp(left[: len(left) // 600 * 600].reshape(-1, 600).mean(axis=1)) < 0.4 * amplitude


def test_a_steady_drift_is_no_warmup() -> None:
    values = record(0.0, 1.0, 3)
    values += 3e-7 * np.arange(len(values))[:, None] / RATE
    assert warmup(values) == 0.0


def test_what_is_unknown_settles_nothing() -> None:
    assert not settles(None, None)
    assert not settles(Slope(1.0, 1e-3, 10, 1e-3), None)
    assert settles(Slope(1.0, 1e-3, 10, 1e-3), Slope(0.1, 1e-3, 10, 1e-3))
    assert not settles(Slope(1.0, 1e-3, 10, 1e-3), Slope(0.9, 1e-3, 10, 1e-3))
    assert not settles(Slope(1.0, 1.0, 10, 1.0), Slope(0.1, 1.0, 10, 1.0))


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


def test_a_room_that_grows_warm_again_is_no_warmup() -> None:
    t = np.arange(72_000) / RATE
    drift = Drift((0, 1), RATE, temperature=1)
    drift.update(np.column_stack((np.zeros(len(t)), 25.0 + 3.0 * np.sin(2 * np.pi * t / 2400.0))))
    assert not warming(drift, 1)
