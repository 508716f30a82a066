"""Laws of synthetic noise: spectrum, Allan variance, streams that do not depend on chunk sizes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from noise_fits import curve_of
from numpy.testing import assert_allclose, assert_array_equal

from imumon.noise.synthesis import (
    AVERAGING,
    NoiseStream,
    _averaged_increments,
    _discrete_increments,
    _DiscreteFlicker,
    synthesise,
)

RATE = 50.0
CHANNELS = 48
FLAT = 2.0 * np.log(2.0) / np.pi
DISCRETE = (1.442695, 1.154156, 1.050001, 1.015413, 1.004585, 1.001329, 1.000378)
"""Allan variance of discrete 1/f noise at m = 1, 2, 4 ..., in terms of the flat one."""


def batch(n: int, seed: int, averaged: bool, **strength: float) -> np.ndarray:
    return synthesise(
        n, RATE, seed=seed, averaged=averaged, **{k: np.full(CHANNELS, v) for k, v in strength.items()}
    )


def stream(n: int, seed: int, averaged: bool, **strength: float) -> np.ndarray:
    noise = NoiseStream(
        RATE, seed=seed, averaged=averaged, **{k: np.full(CHANNELS, v) for k, v in strength.items()}
    )
    return np.concatenate([noise.generate(999) for _ in range(n // 999 + 1)])[:n]


def deviation(n: int, m: np.ndarray, kind: str) -> np.ndarray:
    """Return the relative deviation of the mean over channels of the Allan variance (SP 1065, table 5)."""
    m = m.astype(float)
    if kind == "N":
        edf = (1.5 * (n - 1) / m - 2.0 * (n - 2) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    elif kind == "B":
        edf = np.where(m == 1, 2.0 * (n - 2) ** 2 / (2.3 * n - 4.9), 5.0 * n**2 / (4.0 * m * (n + 3.0 * m)))
    else:
        edf = (n - 2) / m * ((n - 1) ** 2 - 3.0 * m * (n - 1) + 4.0 * m**2) / (n - 3) ** 2
    return np.asarray(np.sqrt(2.0 / (np.maximum(edf, 1.0) * CHANNELS)))


def expected(m: np.ndarray, kind: str, averaged: bool) -> np.ndarray:
    tau = m / RATE
    if kind == "N":
        return np.asarray(1.0 / tau)
    if kind == "K":
        return np.asarray(tau / 3.0 * (1.0 if averaged else 1.0 + 1.0 / (2.0 * m**2)))
    factor = np.ones(len(m))
    if not averaged:
        factor[: len(DISCRETE)] = DISCRETE
    return np.asarray(FLAT * factor)


@pytest.mark.parametrize("kind", ["N", "B", "K"])
@pytest.mark.parametrize("averaged", [True, False])
@pytest.mark.parametrize("make", [batch, stream])
def test_allan_variance_agrees_with_the_formula(make: object, averaged: bool, kind: str) -> None:
    n = 1 << 14
    curve = curve_of(make(n, 11, averaged, **{kind: 1.0}), RATE)  # type: ignore[operator]
    short = curve.m <= n // 16
    m = curve.m[short]
    ratio = curve.avar[short].mean(axis=1) / expected(m, kind, averaged)
    assert np.all(np.abs(ratio - 1.0) < 4.5 * deviation(n, m, kind)), ratio


def allan_of_increments(r: np.ndarray, m: int) -> float:
    """Return the Allan variance at m from the covariance r of y[k+1] - y[k]."""
    # a second difference is a sum of increments with triangular weights
    triangle = np.convolve(np.ones(m), np.ones(m)) / m
    weight = np.convolve(triangle, triangle)
    lags = np.abs(np.arange(len(weight)) - len(weight) // 2)
    return float(weight @ r[lags]) / 2.0


def test_covariances_reproduce_the_curve_exactly() -> None:
    """Averaged flicker is flat at every octave, and discrete flicker converges to it."""
    lags = np.arange(2200)
    averaged, discrete = _averaged_increments(lags), _discrete_increments(lags)
    octaves = [1, 2, 4, 8, 16, 32, 64, 512]
    assert_allclose([allan_of_increments(averaged, m) for m in octaves], FLAT, rtol=1e-7)
    factors = np.array([allan_of_increments(discrete, m) for m in octaves]) / FLAT
    assert_allclose(factors, [*DISCRETE, 1.0], atol=1e-5)
    assert factors[0] == pytest.approx(1.0 / np.log(2.0), rel=1e-12)


@pytest.mark.few
@pytest.mark.parametrize("increments", [_averaged_increments, _discrete_increments])
def test_embedding_is_exact(increments: object) -> None:
    """Conditions for an exact circulant draw: positive variance, negative covariances, a sum near zero."""
    r = increments(np.arange(100_000))  # type: ignore[operator]
    assert r[0] > 0
    assert np.all(r[1:] < 0)
    assert 0 < r[0] + 2.0 * r[1:].sum() < 1e-5
    assert np.all(np.fft.rfft(np.concatenate((r, r[-2:0:-1]))).real > 0)


@pytest.mark.few
@pytest.mark.parametrize("rate", [1.0, 40.0, 800.0])
def test_bank_has_the_spectrum_of_flicker(rate: float) -> None:
    bank = _DiscreteFlicker(1, rate, np.random.default_rng(0))
    cycles = np.geomspace(1e-7, rate / 2.0, 1000) / rate
    behind = np.exp(-2j * np.pi * cycles)
    response = bank.direct + (bank.weights[:, None] / (1.0 - bank.poles[:, None] * behind)).sum(axis=0)
    # 1 - x z is computed directly: at 1e-7 Hz of 800 Hz it keeps six digits.
    assert_allclose(np.abs(response) ** 2 * 2.0 * np.sin(np.pi * cycles), 1.0, atol=3e-3)


def test_averaging_filter_converts_discrete_to_averaged_flicker() -> None:
    cycles = np.linspace(1e-3, 0.5, 500)
    gain = np.abs(AVERAGING @ np.exp(-2j * np.pi * cycles * np.arange(len(AVERAGING))[:, None])) ** 2
    aliases = (np.abs(cycles[:, None] + np.arange(-3000, 3001)) ** -3.0).sum(axis=1)
    averaged = np.sin(np.pi * cycles) ** 2 * aliases / (2.0 * np.pi**3)
    assert_allclose(gain / (2.0 * np.sin(np.pi * cycles)), averaged, rtol=2e-4)


def test_stream_of_flicker_is_stationary_from_the_start() -> None:
    """The first second has the increments of any later one: no filter has a transient."""
    many = 1000
    noise = NoiseStream(RATE, B=np.ones(many), seed=5)
    y = noise.generate(2048)
    r = _averaged_increments(np.arange(2048))
    for m in (1, 16, 256):
        first = y[m : 2 * m].mean(axis=0) - y[:m].mean(axis=0)
        assert (first**2).mean() / 2.0 == pytest.approx(
            allan_of_increments(r, m), rel=4.5 * np.sqrt(2.0 / many)
        )
    assert not y[0].any()


@settings(max_examples=20)
@given(cuts=st.lists(st.integers(0, 3000), max_size=6))
def test_a_stream_does_not_depend_on_chunk_sizes(cuts: list[int]) -> None:
    whole = NoiseStream(RATE, N=[1.0, 2.0], B=[0.5, 0.0], K=0.1, seed=3)
    parts = NoiseStream(RATE, N=[1.0, 2.0], B=[0.5, 0.0], K=0.1, seed=3)
    series = np.concatenate([np.empty((0, 2)), *(parts.generate(n) for n in cuts)])
    assert_array_equal(series, whole.generate(sum(cuts)))


def test_channels_are_independent_and_seeds_reproduce() -> None:
    y = synthesise(1 << 14, RATE, N=1.0, B=[0.3, 0.3], K=0.01, seed=1)
    d = np.diff(y, axis=0)
    assert abs(np.corrcoef(d.T)[0, 1]) < 4.5 / np.sqrt(len(d) / 2.0)
    assert_array_equal(y, synthesise(1 << 14, RATE, N=1.0, B=[0.3, 0.3], K=0.01, seed=1))
    assert not np.array_equal(y, synthesise(1 << 14, RATE, N=1.0, B=[0.3, 0.3], K=0.01, seed=2))
