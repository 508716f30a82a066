"""Laws of the bias against the temperature: limits hold the truth, and what cannot be told apart has a reason."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from noise_fits import curve_of, with_temperature

from imumon.model.samples import Floats
from imumon.noise import ChannelFit, Estimator, synthesise
from imumon.noise.fit import BiasFit

N, B, RATE, LENGTH, CHANNELS = 6.1e-5, 2.4e-5, 40.0, 72_000, 32
TIME = np.arange(LENGTH) / LENGTH
WARMING = 1.0 - np.exp(-TIME / 0.2)
BOTH_WAYS = np.sin(np.pi * TIME) ** 2
OFFSET = 9.8


@cache
def noise(k: float, channels: int) -> Floats:
    """Return (n, channels) noise that is the same for every effect."""
    values = synthesise(LENGTH, RATE, N=[N] * channels, B=B, K=k, seed=8)
    values.flags.writeable = False
    return values


def curves(
    effect: Floats, degrees: Floats, k: float, *, drift: float = 0.0, channels: int = CHANNELS
) -> tuple[BiasFit, ...]:
    """Return the curves of channels of noise with an effect (n,) of the temperature (n,) and a drift."""
    values = noise(k, channels) + (OFFSET + effect + drift * (TIME - 0.5))[:, None]
    curve = with_temperature(curve_of(values, RATE), degrees, RATE)
    estimator = Estimator(averaged=True, time_to=False)
    estimator.fit(curve)
    return estimator.bias_curves(curve.sums)


@pytest.mark.few
@pytest.mark.parametrize(("shape", "k"), [(WARMING, 3e-6), (BOTH_WAYS, 0.0)])
def test_limits_hold_the_slope_and_the_line(shape: Floats, k: float) -> None:
    degrees, truth = 20.0 + 40.0 * shape, 1e-5
    found = curves(truth * degrees, degrees, k, drift=2e-4 * (shape is WARMING))
    assert all(len(each.terms) == 2 for each in found)
    held = sum(each.terms[1].low <= truth <= each.terms[1].high for each in found)
    assert held >= 0.85 * CHANNELS  # of 32 with 95 % each, fewer once in 100 times
    line_held = []
    for each in found:
        bias, middle = np.array(each.bias), len(each.degC) // 2
        rise = truth * (np.array(each.degC) - each.degC[middle])
        line_held.append(np.abs(bias - bias[middle] - rise) <= np.array(each.high) - bias)
        assert each.std_with < each.std_without
    assert np.mean(line_held) >= 0.9


@pytest.mark.few
@pytest.mark.parametrize(
    ("degrees", "reason"),
    [
        (np.full(LENGTH, 25.0), "small_range"),
        (25.0 + 0.01 * np.random.default_rng(1).standard_normal(LENGTH), "small_range"),
        (25.0 + 4.0 * TIME, "collinear"),
        (np.full(LENGTH, np.nan), "small_range"),
        (293.15 + 40.0 * WARMING, "implausible"),
        (np.where(TIME < 0.5, 20.0 + 40.0 * WARMING, 0.0), "jumps"),
    ],
)
def test_a_temperature_that_says_nothing_gives_a_reason(degrees: Floats, reason: str) -> None:
    for each in curves(np.zeros(LENGTH), degrees, 0.0, channels=4):
        assert each == BiasFit(reason=reason)


@pytest.mark.slow
def test_steps_and_holes_of_the_temperature_do_no_harm() -> None:
    degrees = 20.0 + 40.0 * WARMING
    coarse = np.round(degrees * 2.0) / 2.0
    for seen in (coarse, np.where(np.abs(TIME - 0.5) < 0.05, np.nan, degrees)):
        found = curves(1e-5 * degrees, seen, 0.0)
        held = [each.terms[1].low <= 1e-5 <= each.terms[1].high for each in found if each.terms]
        assert len(held) >= 0.9 * CHANNELS
        assert sum(held) >= 0.85 * len(held)


def fits_beside(effect: Floats, degrees: Floats) -> tuple[ChannelFit, ...]:
    """Return the fits of noise with an effect (n,) of the temperature (n,)."""
    curve = curve_of(synthesise(LENGTH, RATE, N=[N] * 8, B=B, seed=9) + effect[:, None], RATE)
    return Estimator(averaged=True, time_to=False).fit(with_temperature(curve, degrees, RATE))


def test_the_noise_beside_a_bent_effect_is_that_without_one() -> None:
    """N within 1 %, the bound of B, which takes the low coefficients alone, within 10 %: a cubic effect is no walk."""
    degrees = 20.0 + 40.0 * WARMING
    effect = np.polynomial.polynomial.polyval(degrees - 40.0, (0.0, 1e-5, 1e-6, 2e-7))  # about the middle
    bent = fits_beside(effect, degrees)
    for plain, warm in zip(fits_beside(0.0 * degrees, degrees), bent, strict=True):
        assert warm.regressor("temperature_3") is not None
        assert warm.no_slope == ""  # its limits say how uncertain a slope is beside them
        assert warm.N.value == pytest.approx(plain.N.value, rel=0.01)
        assert warm.B.high == pytest.approx(plain.B.high, rel=0.1)
        assert warm.K.high < 2.0 * plain.K.high
