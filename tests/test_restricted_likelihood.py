"""Random walk, drift and temperature from block means: limits hold, and a drift is no random walk."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise.fit.restricted_likelihood import (
    INSEPARABLE,
    LEAST_BLOCKS,
    SlowTerms,
    fit_slow_terms,
    unit_covariances,
)
from imumon.noise.synthesis import synthesise
from imumon.samples import Floats

RECORDS, BLOCKS, LENGTH_S = 400, 64, 500.0
N, B = 1e-4, 5e-6
AT_S = (np.arange(BLOCKS) + 0.5) * LENGTH_S
DEGREES = 25.0 + 3.0 * np.sin(2 * np.pi * AT_S / 20_000.0) + 2.0 * AT_S / AT_S[-1]
PER_DEGC, PER_S = 3e-6, 2e-9


def block_means(K: float, b: float = B, seed: int = 1, records: int = RECORDS) -> Floats:
    values = synthesise(BLOCKS * 4, 4.0 / LENGTH_S, N=[N] * records, B=b, K=K, seed=seed)
    return np.asarray(values.reshape(BLOCKS, 4, records).mean(axis=1))


def fitted(
    means: Floats, *, b: float = B, share_of_b: float = 0.4, degrees: Floats | None = None
) -> SlowTerms:
    ones = np.ones(means.shape[1])
    return fit_slow_terms(
        means, LENGTH_S, N**2 * ones, b**2 * ones, B2_error=share_of_b * b**2 * ones, temperature=degrees
    )


def missed(truth: float, low: Floats, high: Floats) -> float:
    return float(np.mean((low > truth) | (high < truth)))


@pytest.mark.parametrize("heated", [False, True])
@pytest.mark.parametrize("K", [0.0, 1e-7, 1e-6])
def test_limits_contain_the_truth(K: float, heated: bool) -> None:
    degrees = DEGREES if heated else None
    means = block_means(K) + PER_S * AT_S[:, None] + (PER_DEGC * DEGREES[:, None] if heated else 0.0)
    fit = fitted(means, degrees=degrees)
    most = 0.07 + 1e-9
    assert missed(K**2, fit.K2_low, fit.K2_high) <= most
    assert missed(PER_S, fit.drift_low, fit.drift_high) <= most
    if heated:
        assert missed(PER_DEGC, fit.temperature_low, fit.temperature_high) <= most
        assert set(fit.reasons) == {""}
    else:
        assert np.isnan(fit.temperature).all()
        assert set(fit.reasons) == {"no_temperature"}


def test_a_drift_is_no_random_walk() -> None:
    means = block_means(0.0)
    plain = fitted(means)
    drifting = fitted(means + 20.0 * np.median(plain.drift_error) * AT_S[:, None])
    assert np.mean(plain.K2_low > 0.0) <= 0.05
    np.testing.assert_allclose(drifting.K2_high, plain.K2_high, rtol=1e-3)
    assert np.mean(drifting.K2_low > 0.0) <= 0.05
    assert np.mean(drifting.drift_low > 0.0) >= 0.95


def test_a_random_walk_is_measured_beside_a_drift() -> None:
    K = 1e-6
    fit = fitted(block_means(K) + 1e-6 * AT_S[:, None])
    assert np.mean(fit.K2_low > 0.0) >= 0.95
    least = 1.0 / np.sqrt(0.5 * np.sum((walk_share(K)) ** 2))
    assert np.sqrt(np.mean((fit.K2 / K**2 - 1.0) ** 2)) <= 1.3 * least
    assert np.all(np.diff([fit.K2_low, fit.K2, fit.K2_high], axis=0) >= 0.0)


@pytest.mark.parametrize("heated", [False, True])
def test_twice_the_smallest_walk_is_measured(heated: bool) -> None:
    """The smallest differs from zero by 1.96 standard deviations of generalised least squares."""
    flicker, walk = unit_covariances(BLOCKS)
    columns = [np.ones(BLOCKS), AT_S] + ([DEGREES] if heated else [])
    free = np.linalg.qr(np.stack(columns, axis=1), mode="complete")[0][:, len(columns) :]
    whole = N**2 / LENGTH_S * np.eye(BLOCKS) + B**2 * flicker
    inverse = np.linalg.inv(free.T @ whole @ free)
    f, r = (inverse @ (free.T @ each @ free) for each in (flicker, LENGTH_S * walk))
    own, both, other = (0.5 * np.sum(a * b.T) for a, b in ((r, r), (r, f), (f, f)))
    K = 2.0 * np.sqrt(1.96 / np.sqrt(own - both**2 / other))
    degrees = DEGREES if heated else None
    assert np.mean(fitted(block_means(K), degrees=degrees).K2_low > 0.0) >= 0.8
    assert np.mean(fitted(block_means(0.0), degrees=degrees).K2_low > 0.0) <= 0.05


def walk_share(K: float) -> Floats:
    """Return the eigenvalues of the share of the walk in the covariance without constant and drift: the
    information of K^2 with everything else known."""
    flicker, walk = unit_covariances(BLOCKS)
    free = np.linalg.qr(np.stack((np.ones(BLOCKS), AT_S), axis=1), mode="complete")[0][:, 2:]
    whole = N**2 / LENGTH_S * np.eye(BLOCKS) + B**2 * flicker + K**2 * LENGTH_S * walk
    part = K**2 * LENGTH_S * walk
    return np.asarray(
        np.linalg.eigvals(np.linalg.solve(free.T @ whole @ free, free.T @ part @ free)).real, dtype=np.float64
    )


def test_without_a_walk_no_bound_is_far_below_the_typical_one() -> None:
    fit = fitted(block_means(0.0))
    assert fit.K2_high.min() >= 0.5 * np.median(fit.K2_high)


def test_unknown_flicker_costs_precision_but_not_the_limits() -> None:
    K = 3e-7
    means = block_means(K, b=1e-5)
    known, free = (fitted(means, b=1e-5, share_of_b=share) for share in (0.0, np.inf))
    assert missed(K**2, free.K2_low, free.K2_high) <= 0.07
    assert missed(K**2, known.K2_low, known.K2_high) <= 0.07
    assert np.median(free.K2_high) > np.median(known.K2_high)
    # both tests of the lower limit may differ; the estimate is inside
    for fit in (free, fitted(block_means(0.0, b=1e-5), b=1e-5, share_of_b=np.inf)):
        measured = fit.K2_low > 0.0
        assert np.all(fit.K2_low[measured] < fit.K2[measured])


def test_a_temperature_that_is_a_straight_line_is_not_separable() -> None:
    means = block_means(0.0, records=4)
    noise = 0.02 * np.random.default_rng(1).standard_normal(BLOCKS)
    for degrees in (25.0 + AT_S / AT_S[-1] + noise, 25.0 + AT_S / AT_S[-1] + 0.05 * (AT_S / AT_S[-1]) ** 2):
        fit = fitted(means, degrees=degrees)
        assert set(fit.reasons) == {INSEPARABLE}
        assert np.isnan(fit.temperature).all()
        assert np.isfinite(fit.drift).all()
    assert set(fitted(means, degrees=25.0 + noise).reasons) == {"small_range"}


def test_missing_blocks_and_partial_blocks_keep_the_limits() -> None:
    K = 1e-6
    means = block_means(K)
    share = np.random.default_rng(2).uniform(0.5, 1.0, BLOCKS)
    extra = np.sqrt(N**2 / LENGTH_S * (1.0 / share - 1.0))
    means += extra[:, None] * np.random.default_rng(3).standard_normal(means.shape)
    means[20:29] = np.nan
    means[40, ::2] = np.nan
    ones = np.ones(RECORDS)
    fit = fit_slow_terms(means, LENGTH_S, N**2 * ones, B**2 * ones, B2_error=0.4 * B**2 * ones, share=share)
    assert missed(K**2, fit.K2_low, fit.K2_high) <= 0.07
    assert missed(0.0, fit.drift_low, fit.drift_high) <= 0.07


def test_too_few_blocks_are_unknown() -> None:
    means = block_means(0.0, records=3)[: LEAST_BLOCKS + 2]
    means[:, 1] = np.nan
    means[:4, 2] = np.nan
    fit = fitted(means)
    assert np.isfinite(fit.K2_high[0])
    assert np.isnan(fit.K2_high[1:]).all()
    assert np.isnan(fit.drift[1:]).all()


def test_units_do_not_matter() -> None:
    means, ones = block_means(1e-6, records=5), np.ones(5)
    one = fit_slow_terms(means, LENGTH_S, N**2 * ones, B**2 * ones, temperature=DEGREES)
    other = fit_slow_terms(
        means * 1e3 + 9.8, LENGTH_S, 1e6 * N**2 * ones, 1e6 * B**2 * ones, temperature=DEGREES
    )
    np.testing.assert_allclose(other.K2, 1e6 * one.K2, rtol=1e-4)
    np.testing.assert_allclose(other.drift, 1e3 * one.drift, rtol=1e-4)
    np.testing.assert_allclose(other.temperature_high, 1e3 * one.temperature_high, rtol=1e-4)


def test_an_exponential_is_no_random_walk() -> None:
    settles = 6e-5 * np.exp(-AT_S / 5000.0)[:, None]
    means, ones = block_means(0.0) + settles, np.ones(RECORDS)
    arguments = means, LENGTH_S, N**2 * ones, B**2 * ones
    without, beside = (
        fit_slow_terms(*arguments, B2_error=0.4 * B**2 * ones, settling=sought) for sought in (False, True)
    )
    assert np.mean(without.K2_low > 0.0) > 0.5
    assert np.mean(beside.K2_low > 0.0) <= 0.07
    walks = fit_slow_terms(block_means(1e-6), *arguments[1:], B2_error=0.4 * B**2 * ones, settling=True)
    assert np.mean(walks.K2_low > 0.0) >= 0.95
