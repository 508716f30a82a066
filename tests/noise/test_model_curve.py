"""The curve that follows from a description agrees with its definition: expectation, degrees of freedom, limits."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from noise_fits import curve_of, fits_of
from term_powers import powers_of

from imumon.model.samples import Floats
from imumon.noise import fit_curve, read_slopes, synthesise
from imumon.noise.blocks import BlockMeans
from imumon.noise.fit.curve_statement import bounded_by_curve
from imumon.noise.fit.model import FLICKER, WALK, WHITE, total
from imumon.noise.fit.model_curve import (
    degrees_of_freedom,
    density_variances,
    few_differences_quantile,
    limit_factors,
    line_variances,
    moved_variances,
    moved_variances_at,
    share_of_expectation,
)
from imumon.noise.fit.observations import block_series

KINDS = {"white": WHITE, "flicker": FLICKER, "walk": WALK}


def differences(n: int, m: int) -> Floats:
    """Return (M, n) the second differences of an octave as rows over the samples, by definition."""
    rows = []
    for start in range(0, n - 2 * m + 1, max(1, m // 8)):
        row = np.zeros(n)
        row[start : start + m] = -1.0 / m
        row[start + m : start + 2 * m] = 1.0 / m
        rows.append(row)
    return np.array(rows)


def covariance(n: int, kind: str, *, averaged: bool) -> Floats:
    """Return (n, n) the covariance of samples of size 1, up to a constant of which differences are free."""
    lag = np.arange(n + 1.0)
    if kind == "white":
        return np.eye(n)
    if not averaged:
        if kind == "walk":
            return np.asarray(np.minimum.outer(lag[:-1], lag[:-1]))
        by_lag = np.concatenate([[0.0], -np.cumsum(1.0 / (np.arange(1, n) - 0.5)) / np.pi])
    else:
        phase = lag**2 * np.log(np.maximum(lag, 1.0)) / (2.0 * np.pi) if kind == "flicker" else lag**3 / 12.0
        by_lag = 2.0 * phase[:-1] - phase[np.abs(np.arange(n) - 1)] - phase[1:]
    return np.asarray(by_lag[np.abs(np.arange(n)[:, None] - np.arange(n))])


SIZES = {
    "white": (1.0, 0.0, 0.0),
    "flicker": (0.0, 1.0, 0.0),
    "walk": (0.0, 0.0, 1.0),
    "all": (1.0, 0.1, 0.005),
}
"""Powers of white noise, flicker and walk; of all three, none hides behind another one."""


@pytest.mark.parametrize("averaged", [True, False])
@pytest.mark.parametrize("kind", SIZES)
def test_variances_and_degrees_of_freedom_agree_with_the_definition(kind: str, averaged: bool) -> None:
    n, m = 192, 1 << np.arange(7)
    powers = {term: size for term, size in zip(KINDS.values(), SIZES[kind], strict=True) if size}
    matrix = sum(
        size * covariance(n, each, averaged=averaged)
        for each, size in zip(KINDS, SIZES[kind], strict=True)
        if size
    )
    terms = (n - 2 * m) // np.maximum(1, m // 8) + 1
    expected = total(powers, lambda term: term.allan_variances(m, averaged=averaged))
    edf = degrees_of_freedom(m, terms, n, powers)
    for i, cluster in enumerate(m.tolist()):
        rows = differences(n, cluster)
        r = rows @ matrix @ rows.T
        assert len(rows) == terms[i]
        assert expected[i] == pytest.approx(0.5 * np.trace(r) / len(r), rel=1e-6)
        exact = np.trace(r) ** 2 / (r**2).sum()
        # those of averages also count for point samples, which differ in the shortest octaves
        assert edf[i] == pytest.approx(exact, rel=0.01 if averaged else 0.12), cluster


def test_missing_differences_cost_their_share() -> None:
    m, powers = 1 << np.arange(7), {WHITE: 1.0}
    full = (4096 - 2 * m) // np.maximum(1, m // 8) + 1
    whole, half = (degrees_of_freedom(m, terms, 4096, powers) for terms in (full, full // 2))
    np.testing.assert_allclose(half / whole, (full // 2) / full)
    assert degrees_of_freedom(m, 0 * full, 4096, powers).tolist() == [0.0] * 7


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_limits_hold_the_expectation(kind: str) -> None:
    """95 % of 400 records at each octave, longer ones included; 3.5 standard deviations are 3.8 %."""
    count, n = 400, 512
    sizes = {"N": [0.0] * count, "B": 0.0, "K": 0.0}
    name = KINDS[kind].letter
    sizes[name] = [1.0] * count if name == "N" else 1.0
    curve = curve_of(synthesise(n, 1.0, seed=4, **sizes), 1.0)
    m, avar = curve.m, curve.avar
    powers = {KINDS[kind]: 1.0}
    expected = KINDS[kind].allan_variances(m, averaged=True)
    terms = (n - 2 * m) // np.maximum(1, m // 8) + 1
    low, high = limit_factors(degrees_of_freedom(m, terms, n, powers))
    ratio = np.sqrt(avar / expected[:, None])
    for i in range(len(m)):
        assert np.mean(ratio[i] * low[i] > 1.0) < 0.025 + 0.028, m[i]
        assert np.mean(ratio[i] * high[i] < 1.0) < 0.025 + 0.028, m[i]


def test_quantiles_agree_with_scipy_stats() -> None:
    dof = np.array([1.0, 1.3, 4.0, 30.0, 59.0, 500.0])
    for probability in (0.025, 0.5, 0.975):
        exact = scipy.stats.chi2.ppf(probability, dof)
        np.testing.assert_allclose(share_of_expectation(probability, dof) * dof, exact, rtol=1e-9)
    exact = scipy.stats.chi2.ppf(0.025, dof[3:]) / dof[3:]
    np.testing.assert_allclose(few_differences_quantile(dof[3:]), exact, rtol=1e-9)
    low, high = limit_factors(dof)
    assert (low < 1.0).all()
    assert (high > 1.0).all()
    assert (np.diff(high) < 0.0).all()


@pytest.mark.few
@pytest.mark.parametrize("frequency", [0.0007, 0.013, 0.21, 0.4999])
def test_a_line_has_the_stated_curve(frequency: float) -> None:
    n, amplitude = 1 << 17, 0.3
    phases = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 12)
    curve = curve_of(amplitude * np.sin(2.0 * np.pi * frequency * np.arange(n)[:, None] + phases), 1.0)
    m, avar = curve.m, curve.avar
    stated = line_variances(m, frequency, 0.0, 0.5 * amplitude**2)
    short = m < n / 16
    scale = 2.0 * 0.5 * amplitude**2 / np.maximum(m * np.sin(np.pi * frequency), 1.0) ** 2
    assert np.abs(avar.mean(axis=1) / scale - stated / scale)[short].max() < 0.03


@pytest.mark.parametrize("kind", ["ramp", "wave", "step"])
def test_what_regressors_move_has_the_stated_curve(kind: str) -> None:
    n, length = 1 << 15, 64
    at = np.arange(n) / n
    signal = {"ramp": at, "wave": np.sin(12.0 * at), "step": (at > 0.4) * 1.0}[kind]
    means = signal.reshape(-1, length).mean(axis=1)
    series = block_series(
        BlockMeans(
            means[:, None],
            np.ones((len(means), 1)),
            np.zeros(len(means), dtype=np.int64),
            length,
            1.0,
            np.zeros(1),
        ),
        0,
    )
    curve = curve_of(signal[:, None], 1.0)
    m, avar = curve.m, curve.avar
    stated = moved_variances_at(m, moved_variances(series, means))
    used = m >= length if kind == "step" else m > 1
    size = 0.1 * avar[:, 0].max() * (kind == "wave")  # differences of a wave may be small by chance
    np.testing.assert_allclose(stated[used], avar[used, 0], rtol=0.06, atol=size)


def test_a_density_has_the_curve_of_its_noise() -> None:
    """White noise between two frequencies: the integral over narrow bins agrees with that over wide ones."""
    edges = np.linspace(0.05, 0.5, 400)
    f, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    m = 1 << np.arange(10)
    fine = density_variances(m, f, width, np.ones(f.size))
    wide = edges[::21]
    coarse = density_variances(m, 0.5 * (wide[1:] + wide[:-1]), np.diff(wide), np.ones(wide.size - 1))
    np.testing.assert_allclose(coarse[:3], fine[:3], rtol=0.02)
    whole = np.linspace(1e-5, 0.5, 20_000)
    middle, size = 0.5 * (whole[1:] + whole[:-1]), np.diff(whole)
    np.testing.assert_allclose(density_variances(m, middle, size, np.ones(middle.size)), 1.0 / m, rtol=0.01)


@pytest.mark.slow
def test_the_stated_limits_of_a_curve_hold_its_expectation() -> None:
    """Limits come from the fitted powers; 95 % of 24 channels and 13 octaves, which are correlated."""
    values = synthesise(1 << 14, 1.0, N=[1.0] * 24, B=0.1, K=1e-3, seed=9)
    curve = curve_of(values, 1.0)
    powers = powers_of({"N": 1.0, "B": 0.1, "K": 1e-3})
    truth = np.sqrt(total(powers, lambda term: term.allan_variances(curve.m, averaged=True)))
    fits = fit_curve(curve, averaged=True, time_to=False)
    held = [(fit.low <= truth) & (truth <= fit.high) for fit in fits]
    assert float(np.mean(held)) > 0.92
    for fit in fits:
        stated = np.sqrt(fit.noise**2 + fit.shares["lines"])  # a hump that chance makes is drawn as one
        np.testing.assert_allclose(fit.model[:11], stated[:11], rtol=0.05)  # a drift is drawn too
        assert fit.used.all()


def test_slopes_are_read_off_the_curve() -> None:
    tau = 2.0 ** np.arange(-5, 16)
    readings = read_slopes(tau, np.sqrt(0.01**2 / tau + (0.664 * 3e-3) ** 2 + 1e-4**2 * tau / 3))
    assert pytest.approx(0.01, rel=0.02) == readings["N"]
    assert pytest.approx(1e-4, rel=0.1) == readings["K"]
    assert read_slopes(tau, tau**0.0) == read_slopes(tau * 2.0, tau**0.0)
    assert read_slopes(tau[:2], tau[:2])["N"] is None


def test_only_the_terms_that_decide_an_octave_are_bounded_by_it() -> None:
    """N decides the first octaves of a clean record: what leaves the curve there says nothing of B and K."""
    (fit,) = fits_of(synthesise(144_000, 40.0, N=[6e-5], B=2.4e-5, seed=1, averaged=False), 40.0)
    terms = {term: fit.shares[term.letter] for term in (WHITE, FLICKER, WALK)}
    high, middle = 2.0 * fit.high, 11
    assert bounded_by_curve(fit, terms, np.array([0, 1, 2]), high).coefficients == fit.coefficients
    bounded = bounded_by_curve(fit, terms, np.array([1, middle]), high)
    assert (bounded.N, bounded.K) == (fit.N, fit.K)
    assert bounded.B.status == "upper_bound"
    assert bounded.B.high == pytest.approx(fit.B.value * high[middle] / np.sqrt(terms[FLICKER][middle]))
