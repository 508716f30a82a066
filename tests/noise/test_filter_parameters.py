"""Parameters for filters: the prediction is right, and the numbers are consistent and smallest."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from paths import ROOT

from imumon.noise.filter_consistency import ChannelTruths, FilterModels, predict
from imumon.noise.filter_parameters import (
    MOST_NEES,
    filter_parameters,
    gauss_markov_terms,
    horizons,
    smallest_walk,
)

BENCHMARKS = str(ROOT / "benchmarks")

GYRO_FIX, ACCEL_FIX = 1e-3, 1e-2


def truths(*rows: tuple[float, float, float], fix: float = GYRO_FIX) -> ChannelTruths:
    n, b, k = np.array(rows).T
    return ChannelTruths(n, b, k, np.full(len(n), fix))


REFERENCE = (6.1e-5, 2.4e-5, 1e-7)
VARIED = truths(
    REFERENCE,
    (6.1e-5, 2.4e-5, 1e-6),
    (6.1e-5, 1e-4, 1e-5),
    (6.1e-5, 4.8e-6, 1e-8),
    (1e-5, 2e-6, 1e-9),
    (3e-4, 2e-4, 2e-5),
    (6.1e-5, 0.0, 2e-6),
    (1e-3, 6e-3, 1e-5),  # the flicker is above the white noise from 0.1 s on
    (1e-3, 1e-7, 1e-6),  # the white noise hides everything else
)


MARKOV = ChannelTruths(
    np.full(6, 6.1e-5), np.array([0.0, 0.0, 0.0, 2.4e-5, 0.0, 2.4e-5]), np.array([1e-9, 1e-9, 1e-9, 1e-7, 2e-6, 1e-7]),
    np.full(6, GYRO_FIX), np.array([3e-5, 3e-5, 3e-5, 3e-5, 2e-4, 0.0]), np.array([10.0, 60.0, 600.0, 57.0, 57.0, 1.0]),
)  # fmt: skip
"""Gauss-Markov noise alone, beside flicker, beside a walk, and none."""


def walking(given: ChannelTruths, walk: np.ndarray, horizon_s: np.ndarray) -> np.ndarray:
    """Return the largest NEES of filters with white noise and a walk."""
    return predict(FilterModels.without_terms(given.N, walk), given, horizon_s).nees.max(axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["reference, K unseen", "Markov, 60 s"])
def test_the_prediction_is_what_an_independent_filter_measures(name: str) -> None:
    """The filter of the benchmark steps at 5 Hz through simulated noise and knows nothing of the prediction."""
    sys.path.insert(0, BENCHMARKS)
    try:
        import filters
    finally:
        sys.path.pop(0)
    truth = next(truth for truth in filters.TRUTHS if truth.name == name)
    records = filters.simulated(truth, 1, 1000, 77)
    exact = (np.array([size]) for size in truth.sizes)
    for parameters in filters.filters_of(*exact, 1800.0):
        ratio = filters.measured(parameters, records)[0]
        forecast = filters.predicted(truth, parameters)[0]
        distance = ratio.mean(axis=0) - forecast
        assert np.abs(distance / filters.standard_error(forecast, len(ratio))).max() < 3.5


@pytest.mark.few
@pytest.mark.parametrize("horizon", [1.0, 10.0, 600.0, 1800.0, 86400.0])
def test_the_walk_is_the_smallest_that_is_consistent(horizon: float) -> None:
    times = horizons(horizon)
    walk = smallest_walk(VARIED, times)
    most = walking(VARIED, walk, times)
    assert (walk > 0.0).all()
    assert (most <= MOST_NEES).all()
    needed = walk > 0.1001 * VARIED.K
    assert needed.sum() >= 5
    assert (walking(VARIED, 0.97 * walk, times) > MOST_NEES)[needed].all()


@pytest.mark.few
@pytest.mark.parametrize("fix", [GYRO_FIX, ACCEL_FIX])
@pytest.mark.parametrize("horizon", [1.0, 600.0, 1800.0, 86400.0])
def test_gauss_markov_terms_are_consistent_at_every_horizon(horizon: float, fix: float) -> None:
    """The filter steps the state, the prediction has the covariance of the increments: noise of the sensor is exact."""
    for truth, most in ((VARIED, 5), (MARKOV, 6)):
        given = replace(truth, fix=np.full(len(truth.N), fix))
        models, consistency = gauss_markov_terms(given, horizons(horizon))
        assert consistency.nees.max() <= MOST_NEES
        assert consistency.nees.min() >= 1.0 / MOST_NEES
        assert models.sigma.shape[1] <= most
    np.testing.assert_allclose(consistency.nees[:3], 1.0, atol=2e-3)
    np.testing.assert_array_equal(models.sigma[:, -1], MARKOV.M)
    np.testing.assert_array_equal(models.tau[:, -1], MARKOV.T)


def test_the_walk_covers_gauss_markov_noise_up_to_the_horizon() -> None:
    times = horizons(600.0)
    walk = smallest_walk(MARKOV, times)
    assert (walking(MARKOV, walk, times) <= MOST_NEES).all()
    assert (walking(MARKOV, 0.97 * walk, times) > MOST_NEES)[:5].all()
    n_and_k = predict(FilterModels.without_terms(MARKOV.N, MARKOV.K), MARKOV, times).nees.max(axis=1)
    assert (n_and_k[:4] > 5.0).all()


def test_n_and_k_alone_are_overconfident() -> None:
    """The figures of the reference: 4 to 35, from 1 s to 1800 s."""
    given = truths(REFERENCE)
    nees = predict(FilterModels.without_terms(given.N, given.K), given, np.array([1.0, 1800.0])).nees[0]
    np.testing.assert_allclose(nees, [3.9, 34.9], rtol=0.01)


def test_terms_that_do_not_hold_are_marked() -> None:
    """Flicker of 40 deg/s, which no sensor at rest has, needs terms slower than any of the ranges within a day."""
    numbers = filter_parameters(truths(REFERENCE, (1e-5, 0.95, 1e-9)), 86400.0)
    assert numbers.terms_hold.tolist() == [True, False]
    assert numbers.gauss_markov.nees[1].min() < 1.0 / MOST_NEES
    assert numbers.white_walk.nees.max() <= MOST_NEES
