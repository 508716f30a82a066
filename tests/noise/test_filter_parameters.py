"""Parameters for filters: the prediction is right, and the numbers are consistent and smallest."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from paths import ROOT
from reports import LONG_S, with_coefficients
from reports import report as make_report

from imumon.filter_report import DEFAULT_HORIZON_S
from imumon.noise.filter_consistency import ChannelTruths, FilterModels, predict
from imumon.noise.filter_parameters import (
    MOST_NEES,
    assumed_noise,
    filter_parameters,
    gauss_markov,
    horizons,
    smallest_walk,
)
from imumon.report import Estimate, Report

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


def walking(given: ChannelTruths, walk: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the largest NEES of filters with white noise and a walk."""
    return predict(FilterModels.without_terms(given.N, walk), given, at).nees.max(axis=1)


@pytest.mark.slow
def test_the_prediction_is_what_an_independent_filter_measures() -> None:
    """The filter of the benchmark steps at 5 Hz through simulated noise and knows nothing of the prediction."""
    sys.path.insert(0, BENCHMARKS)
    try:
        import filters
    finally:
        sys.path.pop(0)
    truth = filters.TRUTHS[0]
    records = filters.simulated(truth, 1, 1000, 77)
    exact = (np.array([size]) for size in (truth.N, truth.B, truth.K))
    for made in filters.filters_of(*exact, 1800.0):
        ratio = filters.measured(made, records)[0]
        forecast = filters.predicted(truth, made)[0]
        distance = ratio.mean(axis=0) - forecast
        assert np.abs(distance / filters.standard_error(forecast, len(ratio))).max() < 3.5


def test_a_filter_with_the_right_model_is_consistent() -> None:
    given = truths((6.1e-5, 0.0, 1e-7), (6.1e-5, 0.0, 1e-6), (1e-3, 0.0, 1e-4))
    found = predict(FilterModels.without_terms(given.N, given.K), given, horizons(1800.0))
    np.testing.assert_allclose(found.nees, 1.0, atol=0.01)


def test_the_unknown_bias_at_the_start_has_no_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    at = horizons(600.0)
    before = predict(FilterModels.without_terms(VARIED.N, VARIED.K), VARIED, at)
    monkeypatch.setattr("imumon.noise.filter_consistency.UNKNOWN_BIAS", 1e5)
    after = predict(FilterModels.without_terms(VARIED.N, VARIED.K), VARIED, at)
    np.testing.assert_allclose(after.nees, before.nees, rtol=1e-5)


@pytest.mark.parametrize("horizon", [1.0, 10.0, 600.0, 1800.0, 86400.0])
def test_the_walk_is_the_smallest_that_is_consistent(horizon: float) -> None:
    at = horizons(horizon)
    walk = smallest_walk(VARIED, at)
    most = walking(VARIED, walk, at)
    assert (walk > 0.0).all()
    assert (most <= MOST_NEES).all()
    needed = walk > 0.1001 * VARIED.K
    assert needed.sum() >= 5
    assert (walking(VARIED, 0.97 * walk, at) > MOST_NEES)[needed].all()


def test_the_walk_of_a_channel_without_b_or_k_is_that_of_nearly_none() -> None:
    one = np.ones(4)
    truths = ChannelTruths(
        6e-5 * one, np.array([2e-5, 2e-5, 0.0, 0.0]), np.array([0.0, 1e-12, 0.0, 1e-15]), 1e-3 * one
    )
    flicker, nearly, none, nearly_none = smallest_walk(truths, horizons(600.0)).tolist()
    assert flicker == pytest.approx(nearly, rel=1e-3)
    assert 0.0 < none < 1e-3 * flicker
    assert 0.0 < nearly_none < 1e-3 * flicker


@pytest.mark.parametrize("fix", [GYRO_FIX, ACCEL_FIX])
@pytest.mark.parametrize("horizon", [1.0, 600.0, 1800.0, 86400.0])
def test_gauss_markov_terms_are_consistent_at_every_horizon(horizon: float, fix: float) -> None:
    given = replace(VARIED, fix=np.full(len(VARIED.N), fix))
    models, found = gauss_markov(given, horizons(horizon))
    assert found.nees.max() <= MOST_NEES
    assert found.nees.min() >= 1.0 / MOST_NEES
    assert models.sigma.shape[1] <= 5


def test_n_and_k_alone_are_overconfident() -> None:
    """The figures of the reference: 4 to 35, from 1 s to 1800 s."""
    given = truths(REFERENCE)
    nees = predict(FilterModels.without_terms(given.N, given.K), given, np.array([1.0, 1800.0])).nees[0]
    np.testing.assert_allclose(nees, [3.9, 34.9], rtol=0.01)


def test_horizons_begin_at_1_s_end_at_the_horizon_and_are_steps_of_the_filter() -> None:
    for horizon in (1.0, 1.3, 7.0, 60.0, 600.0, 1000.0, 86400.0):
        at = horizons(horizon)
        assert at[0] == 1.0
        assert 0.0 <= horizon - at[-1] < 0.2
        assert (np.diff(at) > 0.0).all()
        np.testing.assert_allclose(at / 0.2, np.round(at / 0.2), atol=1e-9)


# ---------------------------------------------------------------- from a report


def with_bounds(report: Report) -> Report:
    """Return the report with a K of gyro/x that is only bounded."""
    channel = report.channels["gyro/x"]
    bounded = replace(channel.coefficients["K"], status="upper_bound", value=None, low=0.0, high=2e-6)
    return replace(report, channels=report.channels | {"gyro/x": with_coefficients(channel, K=bounded)})


def test_a_bounded_coefficient_counts_with_half_its_bound() -> None:
    report = with_bounds(make_report(LONG_S))
    channel = report.channels["gyro/x"]
    assumed = assumed_noise(channel)
    assert assumed is not None
    assert assumed.K == 1e-6
    assert channel.coefficients["N"].value == assumed.N
    found = filter_parameters(report, DEFAULT_HORIZON_S).channels
    assert found["gyro/x"].walk_factor is None
    assert "bounded_K" in found["gyro/x"].caveats
    y = found["gyro/y"]
    assert y.walk_factor == pytest.approx(y.walk / y.assumed.K)
    assert "bounded_K" not in y.caveats


def test_an_unknown_coefficient_gives_no_numbers() -> None:
    report = make_report(LONG_S)
    channel = report.channels["gyro/x"]
    unknown = with_coefficients(channel, B=Estimate())
    assert assumed_noise(unknown) is None
    found = filter_parameters(replace(report, channels={"gyro/x": unknown}), 600.0)
    assert found.channels == {}


def test_every_axis_of_gyroscope_and_accelerometer_has_consistent_numbers() -> None:
    report = make_report(LONG_S)
    found = filter_parameters(report, 600.0)
    assert set(found.channels) == {f"{sensor}/{axis}" for sensor in ("gyro", "accel") for axis in "xyz"}
    for channel in found.channels.values():
        assert channel.white == channel.white_gm == channel.assumed.N
        assert channel.walk_gm == channel.assumed.K
        assert channel.walk > 0.0
        assert max(channel.nees.white_walk) <= MOST_NEES
        assert (
            1.0 / MOST_NEES <= min(channel.nees.gauss_markov) <= max(channel.nees.gauss_markov) <= MOST_NEES
        )
        assert len(channel.gauss_markov) <= 5
        assert channel.nees.horizon_s == channel.std.horizon_s
        assert channel.nees.horizon_s[-1] == 600.0


# ---------------------------------------------------------------- another program


@pytest.mark.slow
def test_gtsam_with_the_exported_parameters_is_consistent() -> None:
    """Preintegrated rotation and velocity after 300 s of fixes; N and K alone are overconfident."""
    pytest.importorskip("gtsam", reason="gtsam is not installed (extra peers)")
    sys.path.insert(0, BENCHMARKS)
    try:
        import gtsam_filters
    finally:
        sys.path.pop(0)
    report = gtsam_filters.report_of_record()
    alone, exported = (
        gtsam_filters.nees_of(make(report, 600.0), 20, 0.0, 300, (10, 60)).mean(axis=0)
        for make in (gtsam_filters.plain, gtsam_filters.exported)
    )
    assert (exported < 1.8).all()
    assert (exported > 0.3).all()
    assert (alone > 1.2 * exported).all()
