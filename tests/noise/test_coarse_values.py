"""Values with steps that are coarser than the noise: right, or pending, and never between."""

from __future__ import annotations

import math

import numpy as np
import pytest
from noise_fits import curve_of
from scipy.special import ndtr

from imumon.model.samples import Floats
from imumon.noise import ChannelFit, Estimator, synthesise
from imumon.noise.fit import statement

RATE, SAMPLES, N = 100.0, 180_000, 1e-6


def fit_of(values: Floats, step: float) -> ChannelFit:
    (fit,) = Estimator(averaged=True, time_to=False).fit(curve_of(values[:, None], RATE), resolution=[step])
    return fit


def noise(seed: int, mean: float) -> Floats:
    return synthesise(SAMPLES, RATE, N=[N], seed=seed, averaged=True)[:, 0] + mean


@pytest.mark.few
@pytest.mark.parametrize("mean", [0.0, 1.5e-5, 7e-5])
@pytest.mark.parametrize("ratio", [0.2, 0.5, 1.0, 3.0, 10.0])
def test_a_counting_gyroscope_shows_n_and_q(ratio: float, mean: float) -> None:
    """Of a fibre-optic or ring laser gyroscope, an angle in counts arrives; `ratio` is Q / (N sqrt(tau0))."""
    quantisation = ratio * N / math.sqrt(RATE)
    count = quantisation * math.sqrt(12.0)
    angle = np.round(np.cumsum(noise(4, mean)) / RATE / count) * count
    fit = fit_of(np.diff(angle, prepend=0.0) * RATE, count * RATE)
    assert fit.N.low < N < fit.N.high
    assert fit.N.high < (1.4 if ratio <= 3.0 else 2.0) * fit.N.low
    assert fit.coefficients["Q"].value == pytest.approx(quantisation, rel=0.05)
    assert "quantised" in fit.caveats
    assert "correlated" not in fit.caveats


@pytest.mark.few
@pytest.mark.parametrize(("counts", "samples"), [(1.0, 2_000), (2.0, 30_000)])
def test_counts_that_a_short_record_does_not_show_are_in_the_limits_of_n(counts: float, samples: int) -> None:
    """`counts` is the noise of a sample; the rounding of both ends of an interval adds to N."""
    count = N / math.sqrt(RATE) / counts
    misses = 0
    for seed in range(12):
        white = synthesise(samples, RATE, N=[N], seed=seed, averaged=True)[:, 0]
        angle = np.round(np.cumsum(white) / RATE / count) * count
        fit = fit_of(np.diff(angle, prepend=0.0) * RATE, count * RATE)
        misses += fit.N.low > N
    assert misses <= 2  # without the second end, four and five


def test_a_record_too_short_for_its_counts_is_pending() -> None:
    """With a hundredth of a count of noise a sample, no octave of half an hour has independent errors."""
    count = 30.0 * N / math.sqrt(RATE) * math.sqrt(12.0)
    angle = np.round(np.cumsum(noise(4, 0.0)) / RATE / count) * count
    fit = fit_of(np.diff(angle, prepend=0.0) * RATE, count * RATE)
    assert fit.N.status == "pending"
    assert "counts" in fit.N.reason


@pytest.mark.few(2)
@pytest.mark.parametrize("steps", [0.5, 5.0, 1.0, 1.5, 1.9, 2.1, 2.5, 3.0])
@pytest.mark.parametrize("mean", [0.0, 0.3, 0.5])
def test_a_rounded_rate_is_right_or_pending(steps: float, mean: float) -> None:
    """`steps` is the step in standard deviations of a sample, `mean` the place between two levels."""
    step = steps * N * math.sqrt(RATE)
    fit = fit_of(np.round(noise(4, mean * step) / step) * step, step)
    if fit.N.status == "measured":
        assert steps < 2.2
        assert 0.98 * fit.N.low < N < 1.02 * fit.N.high
        # of the samples as they are, which have the variance of the rounding, too
        assert fit.N.value == pytest.approx(N * math.sqrt(1.0 + steps**2 / 12.0), rel=0.05)
    else:
        assert steps > 1.8
        assert {part.reason_code for part in (fit.N, fit.B, fit.K)} == {"resolution"}


@pytest.mark.parametrize("sigma", [0.3, 0.45, 0.6])
def test_the_error_of_the_variance_is_that_of_rounded_gaussian_noise(sigma: float) -> None:
    """In steps, for any mean: the exact variance of what is rounded, less its own and that of rounding."""
    mean, level = np.linspace(0.0, 1.0, 64, endpoint=False), np.arange(-6.0, 8.0)[:, None]
    share = ndtr((level + 0.5 - mean) / sigma) - ndtr((level - 0.5 - mean) / sigma)
    variance = np.sum(level**2 * share, axis=0) - np.sum(level * share, axis=0) ** 2
    error = variance - sigma**2 - 1.0 / 12.0
    stated = statement._rounding_error(sigma**2, 1.0 / 12.0)
    assert stated == pytest.approx(float(np.sqrt(np.mean(error**2))), rel=0.03 if sigma > 0.3 else 0.2)


def test_limits_of_counts_are_those_of_the_deviation_of_rounding_errors() -> None:
    errors = np.random.default_rng(6).uniform(-0.5, 0.5, (4000, 50))
    deviations = np.sqrt(np.mean(errors**2, axis=1))
    q = statement._of_counts(1.0, white=10.0, samples=50.0)
    assert q.value == pytest.approx(deviations.mean(), rel=0.01)
    assert np.mean((q.low < deviations) & (deviations < q.high)) == pytest.approx(0.95, abs=0.015)


def test_a_cycle_of_few_values_shows_no_noise() -> None:
    values = np.resize([33.3, 34.05, 33.75, 33.45, 34.2, 33.9, 33.6], 7680) * 1e-2
    fit = fit_of(values, 0.0)
    assert fit.coefficients["N"].value is None
