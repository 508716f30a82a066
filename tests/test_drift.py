"""Drift: slopes have correct limits, and a random walk is no slope."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise.allan import OctaveCascade
from imumon.noise.fit import fit_curve
from imumon.noise.nonstationarity.drift import DriftAccumulator, Trend
from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.noise.synthesis import synthesise
from imumon.samples import Floats

RATE = 10.0
NOISES = {
    "white": (1e-4, 0.0, 0.0),
    "flicker": (1e-4, 3e-5, 0.0),
    "walk": (1e-4, 2e-5, 3e-6),
    "flicker alone": (1e-5, 1e-4, 0.0),
}


def trends(values: Floats, noise_model: MeanCovariance, temperature: int | None = None) -> list[Trend]:
    c = values.shape[1]
    drift = DriftAccumulator((0,) * c, RATE, temperature)
    for i in range(0, len(values), 5000):
        drift.update(values[i : i + 5000])
    noise_models = [None if i == temperature else noise_model for i in range(c)]
    return [t for t in drift.result(noise_models) if t is not None]


@pytest.mark.parametrize("noise", NOISES)
def test_slopes_scatter_as_their_errors_predict_and_none_is_significant(noise: str) -> None:
    n, b, k = NOISES[noise]
    z = []
    for seed in range(2):
        values = synthesise(20_000, RATE, N=[n] * 12, B=b, K=k, seed=seed)
        results = trends(values + 9.8, MeanCovariance(n, b, k))
        assert not any(t.time.significant for t in results)
        z += [t.time.value / t.time.error for t in results]
    # three standard errors of 24 values; without a walk the limits allow for what is not known of it
    assert 0.25 < np.std(z) < 1.45
    assert abs(np.mean(z)) < 0.6


def test_drift_is_estimated_with_correct_limits() -> None:
    slope = 2e-7  # 7.2e-4 in an hour
    values = synthesise(36_000, RATE, N=[1e-4] * 12, B=2e-5, K=1e-7, seed=5)
    values += slope * np.arange(len(values))[:, None] / RATE
    slopes = [t.time for t in trends(values, MeanCovariance(1e-4, 2e-5, 1e-7))]
    assert all(s.significant for s in slopes)
    assert sum(s.low < slope < s.high for s in slopes) >= 9


def test_temperature_explains_what_follows_it() -> None:
    n = 36_000
    hours = np.arange(n) / RATE / 3600
    rng = np.random.default_rng(2)
    degrees = 25.0 + 3.0 * np.sin(2 * np.pi * 2.3 * hours) + 0.01 * rng.standard_normal(n)
    values = synthesise(n, RATE, N=[1e-4] * 2, B=2e-5, K=1e-7, seed=3)
    values[:, 0] += 4e-4 * degrees
    first, second = trends(
        np.column_stack((values, degrees)), MeanCovariance(1e-4, 2e-5, 1e-7), temperature=2
    )
    assert first.temperature is not None
    assert first.temperature.significant
    assert first.temperature.value == pytest.approx(4e-4, abs=3 * first.temperature.error)
    assert first.explained == pytest.approx(1.0, abs=0.02)
    assert second.temperature is not None
    assert not second.temperature.significant
    assert abs(second.temperature.value) < 4 * second.temperature.error


def test_the_curve_without_temperature_equals_that_at_constant_temperature() -> None:
    n, rng = 72_000, np.random.default_rng(4)
    hours = np.arange(n) / RATE / 3600
    degrees = 25.0 + 4.0 * np.sin(2 * np.pi * 1.3 * hours) + 0.01 * rng.standard_normal(n)
    steady = synthesise(n, RATE, N=[1e-4] * 3, B=2e-5, K=1e-8, seed=6)
    values = steady + np.array([3e-4, 3e-4, 0.0]) * degrees[:, None]
    curves = []
    for each in (steady, values):
        cascade = OctaveCascade(3, 1 / RATE)
        cascade.update(each)
        curves.append(cascade.result())
    drift = DriftAccumulator((0, 0, 0, 1), RATE, temperature=3)
    drift.update(np.column_stack((values, degrees)))
    noise_model = MeanCovariance(1e-4, 2e-5, 1e-7)
    corrected = drift.without_temperature(curves[1], drift.result([noise_model] * 3 + [None]))
    assert corrected is not None
    before, truth, after = curves[1].sigma, curves[0].sigma, corrected.sigma
    long = (curves[1].tau > 60) & (curves[1].tau < 1000)
    assert (before[long, :2] / truth[long, :2]).max() > 5.0
    np.testing.assert_allclose(after[long, :2], truth[long, :2], rtol=0.25)
    np.testing.assert_allclose(after[:6], before[:6], rtol=1e-3)
    np.testing.assert_array_equal(after[:, 2], before[:, 2])
    drift = DriftAccumulator((0, 0, 0, 1), RATE, temperature=3)
    drift.update(np.column_stack((steady, degrees)))
    assert drift.without_temperature(curves[0], drift.result([noise_model] * 3 + [None])) is None


def test_the_slope_does_not_depend_on_the_warmup_that_is_excluded() -> None:
    n, slope = 36_000, 2e-7
    t = np.arange(n)[:, None] / RATE
    steady = synthesise(n, RATE, N=[1e-4] * 4, B=5e-6, seed=8) + slope * t
    results = []
    for values in (steady, steady + 1e-2 * np.exp(-t / 60.0)):
        drift = DriftAccumulator((0,) * 4, RATE)
        drift.update(values)
        results.append(drift.result([MeanCovariance(1e-4, 5e-6, 0.0)] * 4, begin_s=1200.0))
    for plain, warm in zip(*results, strict=True):
        assert plain is not None
        assert warm is not None
        assert warm.begin_s == 1200.0
        assert warm.time.value == pytest.approx(plain.time.value, rel=1e-3)
        assert warm.time.low < slope < warm.time.high


def test_a_drift_and_a_temperature_that_rise_together_are_told_apart_or_not() -> None:
    n, rng = 36_000, np.random.default_rng(9)
    t = np.arange(n) / RATE / 3600.0
    values = synthesise(n, RATE, N=[1e-4], B=2e-6, seed=9)
    bent = 25.0 + 4.0 * t + 2.0 * np.sin(9.0 * t)
    straight = 25.0 + 4.0 * t + 0.02 * rng.standard_normal(n)
    for degrees, separable in ((bent, True), (straight, False)):
        heated = values[:, 0] + 1e-4 * degrees + 2e-4 * t
        (trend,) = trends(np.column_stack((heated, degrees)), MeanCovariance(1e-4, 2e-6, 0.0), temperature=1)
        assert trend.separable == separable
        assert trend.covered == pytest.approx((degrees.min(), degrees.max()), abs=0.2)
        if separable:
            assert trend.reason is None
            assert trend.temperature is not None
            assert trend.temperature.low < 1e-4 < trend.temperature.high
            assert trend.time.low < 2e-4 / 3600.0 < trend.time.high
            assert trend.temperature.significant
        else:
            assert trend.reason == "collinear"
            assert trend.temperature is None
            assert trend.time.value == pytest.approx(6e-4 / 3600.0, rel=0.1)


def test_blocks_are_the_means_of_what_is_valid() -> None:
    rng = np.random.default_rng(5)
    values = rng.standard_normal((2000, 3)) + 9.8
    valid = np.ones((2000, 2), dtype=bool)
    valid[300:900, 0] = False
    drift = DriftAccumulator((0, 0, 1), RATE, temperature=2)
    drift.update(values, valid)
    blocks = drift.blocks(2, begin_s=20.0)
    width = round(blocks.length_s * RATE)
    first = 200 // width
    assert len(blocks.means) == -(-2000 // width) - first
    assert blocks.temperature is not None
    whole = (
        values[first * width :][: 2000 // width * width - first * width].reshape(-1, width, 3).mean(axis=1)
    )
    ok = np.isfinite(blocks.means[: len(whole), 0])
    assert not ok.all()
    spread = blocks.means[: len(whole)] - whole[:, :2]
    np.testing.assert_allclose(spread[ok], spread[ok][0] * np.ones((ok.sum(), 1)), atol=1e-12)
    np.testing.assert_allclose(np.diff(blocks.temperature[: len(whole)] - whole[:, 2]), 0.0, atol=1e-12)
    np.testing.assert_array_equal(blocks.share[: len(whole)][ok], 1.0)


def test_a_constant_temperature_gives_no_slope() -> None:
    values = synthesise(20_000, RATE, N=[1e-4], seed=3)
    degrees = 25.0 + 0.1 * (np.arange(len(values)) % 2)
    (trend,) = trends(np.column_stack((values, degrees)), MeanCovariance(1e-4, 1e-6, 1e-8), temperature=1)
    assert trend.temperature is None
    assert trend.explained is None
    assert trend.reason == "small_range"
    assert trend.separable


def test_too_short_or_unknown_noise_is_none() -> None:
    drift = DriftAccumulator((0, 0), RATE)
    assert drift.result([MeanCovariance(1.0, 0.0, 0.0), None]) == [None, None]
    drift.update(np.zeros((50, 2)))
    assert drift.result([MeanCovariance(1.0, 0.0, 0.0), None]) == [None, None]


def test_any_chunking_and_a_restored_state_give_the_same() -> None:
    rng = np.random.default_rng(1)
    values = rng.standard_normal((30_000, 2)) + 5.0
    valid = rng.random((30_000, 1)) > 0.1
    noise_model = MeanCovariance(0.3, 0.01, 1e-4)
    slopes = []
    for chunk in (30_000, 777, 64):
        drift = DriftAccumulator((0, 0), RATE)
        for i in range(0, len(values), chunk):
            drift.update(values[i : i + chunk], valid[i : i + chunk])
            if i // 10_000 != (i + chunk) // 10_000:
                drift = DriftAccumulator.restore(drift.save())
        slopes.append([t.time.value for t in drift.result([noise_model] * 2) if t])
    np.testing.assert_allclose(slopes[0], slopes[1], rtol=1e-6)
    np.testing.assert_allclose(slopes[0], slopes[2], rtol=1e-6)


def test_gaps_count_as_time() -> None:
    slope = 1e-3
    t = np.arange(20_000) / RATE
    values = 1e-3 * np.random.default_rng(1).standard_normal((20_000, 1)) + slope * t[:, None]
    drift = DriftAccumulator((0,), RATE)
    drift.update(values[:4000])
    drift.skip(9000)
    drift.update(values[13_000:])
    (trend,) = drift.result([MeanCovariance(1e-3 / np.sqrt(RATE), 0.0, 0.0)])
    assert trend is not None
    assert trend.time.value == pytest.approx(slope, rel=1e-3)
    drift.skip(10**9)
    assert drift.elapsed_s > 1e8
    assert sum(a.nbytes for a in drift.save().values()) < 10_000


@pytest.mark.parametrize("noise", NOISES)
def test_differences_of_means_scatter_as_the_noise_predicts(noise: str) -> None:
    n, b, k = NOISES[noise]
    noise_model = MeanCovariance(n, b, k)
    values = synthesise(12_000, RATE, N=[n] * 400, B=b, K=k, seed=7)
    steps = values[8000:].mean(axis=0) - values[:6000].mean(axis=0)
    assert np.std(steps) == pytest.approx(noise_model.difference(600.0, 400.0, 200.0), rel=0.12)


@pytest.mark.parametrize("at", [0.5, 0.62])
def test_a_step_of_the_bias_is_detected_at_its_time(at: float) -> None:
    n = 72_000
    values = synthesise(n, RATE, N=[6e-5] * 3, B=5e-6, seed=5)
    values[round(at * n) :, 1] += 1e-4
    drift, noise_model = DriftAccumulator((0,) * 3, RATE), MeanCovariance(6e-5, 5e-6, 5e-7)
    drift.update(values)
    step = drift.bias_step(1, noise_model)
    assert step is not None
    assert step.at_s == pytest.approx(at * n / RATE, abs=130.0)
    assert step.change.now - step.change.before == pytest.approx(1e-4, rel=0.3)
    assert drift.bias_step(0, noise_model) is drift.bias_step(2, noise_model) is None


def test_random_walk_drift_and_slow_waves_are_no_step() -> None:
    n, steps = 72_000, 0
    t = np.arange(n) / RATE
    slow = np.stack((1e-7 * t, 1e-4 * np.sin(t / 900.0), 1e-3 * np.exp(-t / 600.0)), axis=1)
    for seed in range(2):
        for k in (0.0, 1e-6):
            values = synthesise(n, RATE, N=[6e-5] * 6, B=5e-6, K=k, seed=seed)
            values[:, :3] += slow
            drift = DriftAccumulator((0,) * 6, RATE)
            drift.update(values)
            cascade = OctaveCascade(6, 1.0 / RATE)
            cascade.update(values)
            noise_models = [
                MeanCovariance.of(fit) for fit in fit_curve(cascade.result(), averaged=True, time_to=False)
            ]
            steps += sum(
                w is not None and drift.bias_step(c, w) is not None for c, w in enumerate(noise_models)
            )
    assert steps == 0
