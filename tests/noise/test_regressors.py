"""Regressors: what moves the mean is no random walk, and its own limits hold the truth."""

from __future__ import annotations

import math
from functools import cache, partial

import numpy as np
import pytest
from noise_fits import MOST_MISSED, cascade_of, check_noise, curve_of, held, measured, with_temperature

from imumon.model.samples import Floats
from imumon.noise import ChannelFit, Estimator, synthesise
from imumon.noise.fit import BiasFit
from imumon.noise.fit.observations import block_series
from imumon.noise.fit.slow_terms import SlowTermSearch

N, B, RATE, LENGTH, CHANNELS = 6.1e-5, 5e-6, 10.0, 72_000, 8
"""Two hours of a good gyroscope, rad/s."""
AT_S = np.arange(LENGTH)[:, None] / RATE
DEGREES = 25.0 + 3.0 * np.sin(2.0 * np.pi * AT_S / 5000.0)
check = partial(check_noise, N=N, B=B)


@pytest.fixture(scope="module")
def quiet() -> Floats:
    return synthesise(LENGTH, RATE, N=[N] * CHANNELS, B=B, seed=6)


@pytest.fixture(scope="module")
def walk() -> Floats:
    return synthesise(LENGTH, RATE, K=[2e-6] * CHANNELS, seed=7)


def fitted(values: Floats, degrees: Floats | None = None) -> tuple[ChannelFit, ...]:
    """Return the fits of a record with a temperature (n, 1)."""
    curve = curve_of(values, RATE)
    if degrees is not None:
        curve = with_temperature(curve, degrees[:, 0], RATE)
    return Estimator(averaged=True, time_to=False).fit(curve)


# --- drift -------------------------------------------------------------------------------------------------


@pytest.mark.few
@pytest.mark.parametrize("slope", [1e-8, 1e-6, -1e-5])
def test_a_drift_of_any_size_changes_no_coefficient(quiet: Floats, slope: float) -> None:
    """Its regressor is exact in the blocks, and segments of the spectrum are short beside it."""
    values = quiet[:, :4]
    for plain, drifting in zip(fitted(values), fitted(values + slope * AT_S), strict=True):
        for name in ("N", "B", "K"):
            one, other = getattr(plain, name), getattr(drifting, name)
            assert other.status == one.status
            for limit in ("value", "low", "high"):
                a, b = getattr(one, limit), getattr(other, limit)
                size = 0.05 * (one.high - one.low)  # the grid of the likelihood
                assert b == a or b == pytest.approx(a, abs=size), (name, limit)
        own, before = drifting.regressor("drift"), plain.regressor("drift")
        assert own.value - before.value == pytest.approx(slope, rel=1e-3)
        assert own.error == pytest.approx(before.error, rel=0.05)


@pytest.mark.few
@pytest.mark.parametrize("slope", [2e-7, -2e-7])
@pytest.mark.parametrize("k", [0.0, 1.0])
def test_a_drift_is_stated_with_its_limits(quiet: Floats, walk: Floats, slope: float, k: float) -> None:
    fits = fitted(quiet + k * walk + slope * AT_S)
    columns = [fit.regressor("drift") for fit in fits]
    assert sum(c is not None and abs(c.value - slope) <= 1.96 * c.error for c in columns) >= 6
    for fit in fits:
        if k:
            continue
        assert "ramp" in fit.caveats
        assert "R" in fit.coefficients
        assert fit.coefficients["R"].value == pytest.approx(abs(slope), rel=0.1)
        assert fit.coefficients["R"].low < abs(slope) * 1.1  # type: ignore[operator]
    assert held(fits, "N", N) >= CHANNELS - MOST_MISSED


@pytest.mark.slow
def test_noise_has_no_significant_drift(quiet: Floats, walk: Floats) -> None:
    """The error of a drift allows for flicker and random walk: its ratio to the error scatters by one."""
    ratios = []
    for values in (quiet, quiet + walk, quiet + 10.0 * walk):
        fits = fitted(values)
        assert all("R" not in fit.coefficients for fit in fits)
        for fit in fits:
            column = fit.regressor("drift")
            ratios.append(column.value / column.error)
    assert 0.5 < float(np.std(ratios)) < 1.45  # of 24, three standard errors


@pytest.mark.slow
def test_a_random_walk_beside_a_drift_is_measured(quiet: Floats, walk: Floats) -> None:
    """Or it is `indistinct`, with a bound, where Gauss–Markov noise describes a record better by chance."""
    fits = fitted(quiet + walk + 1e-6 * AT_S)
    others = [fit.K for fit in fits if fit.K.status == "indistinct"]
    assert measured(fits, "K") + len(others) == CHANNELS
    assert (
        len(others) <= 2
    )  # of a true walk, 3 to 10 % (`INSTEAD_GAIN`): of eight, more than two in 4 % of runs
    assert all(estimate.high is not None and estimate.high > 2e-6 for estimate in others)
    assert (
        held([fit for fit in fits if fit.K.status == "measured"], "K", 2e-6)
        >= measured(fits, "K") - MOST_MISSED
    )


# --- temperature -------------------------------------------------------------------------------------------


@pytest.mark.few
@pytest.mark.parametrize("per_degc", [0.0, 1e-4])
def test_a_temperature_slope_is_recovered_and_leaves_the_noise(quiet: Floats, per_degc: float) -> None:
    fits = fitted(quiet + per_degc * DEGREES + 1e-8 * AT_S, DEGREES)
    check(fits)
    held = 0
    for fit in fits:
        slope, drift = fit.regressor("temperature"), fit.regressor("drift")
        assert fit.no_slope == ""
        held += abs(slope.value - per_degc) <= 1.96 * slope.error
        assert fit.follows_temperature == bool(per_degc)
        assert drift.value == pytest.approx(1e-8, abs=4.0 * drift.error)
        if per_degc:
            assert fit.explained == pytest.approx(1.0, abs=0.05)
    assert held >= 6


def test_without_a_temperature_no_slope_is_stated_and_a_bent_one_is_right(quiet: Floats) -> None:
    (fit,) = fitted(quiet[:, :1])
    assert (fit.no_slope, fit.regressor("temperature"), fit.explained) == ("no_temperature", None, None)
    (fit,) = fitted(quiet[:, :1], 25.0 + 4.0 * AT_S / AT_S[-1])
    assert (fit.no_slope, fit.regressor("temperature"), fit.explained) == ("collinear", None, None)
    parabola = 25.0 + AT_S / AT_S[-1] + 2.0 * (AT_S / AT_S[-1]) ** 2
    (bent,) = fitted(quiet[:, :1] + 1e-4 * parabola, parabola)
    slope = bent.regressor("temperature")
    assert slope is None or slope.value == pytest.approx(1e-4, abs=4.0 * slope.error)


# --- warm-up and steps -------------------------------------------------------------------------------------


@pytest.mark.few
@pytest.mark.parametrize(
    ("size", "time_s"),
    [(3e-4, 300.0), (3e-4, 900.0), (-3e-3, 300.0), (-3e-3, 900.0)],
)
def test_an_exponential_is_no_random_walk(quiet: Floats, size: float, time_s: float) -> None:
    fits = fitted(quiet + size * np.exp(-AT_S / time_s))
    check(fits)
    for fit in fits:
        settling = fit.regressor("settling")
        assert settling.time_constant_s == pytest.approx(time_s, rel=0.5)
        assert fit.step is None


@pytest.mark.slow
def test_noise_does_not_settle(quiet: Floats, walk: Floats) -> None:
    """One record in a hundred of noise alone has an exponential that is likelier than none."""
    for values in (quiet, quiet + walk, quiet + 1e-6 * AT_S):
        assert sum(fit.regressor("settling") is not None for fit in fitted(values)) <= 1


@pytest.mark.few
@pytest.mark.parametrize("size", [10.0, 100.0, 1e4])
def test_a_step_of_any_size_hides_no_noise(quiet: Floats, size: float) -> None:
    """In standard deviations of a sample; the spectrum loses bands to it, and the blocks do not."""
    values = quiet + size * N * math.sqrt(RATE) * (np.arange(LENGTH) > LENGTH // 3)[:, None]
    fits = fitted(values)
    check(fits)
    assert all(fit.step is not None for fit in fits)


@pytest.mark.few
@pytest.mark.parametrize("at", [0.3, 0.62])
def test_a_step_is_found_with_its_place_and_size_and_is_no_random_walk(quiet: Floats, at: float) -> None:
    values = quiet.copy()
    values[round(at * LENGTH) :, ::2] += 1e-4
    curve = curve_of(values + 9.8, RATE)
    fits = Estimator(averaged=True, time_to=False).fit(curve)
    check(fits)
    for c, fit in enumerate(fits):
        column = fit.regressor("step")
        assert (column is not None) == (fit.step is not None) == (c % 2 == 0)
        if column is not None and fit.step is not None:
            series = block_series(curve.sums.blocks, c, None)
            slow = SlowTermSearch(series, None).result()
            (place,) = (each.place for each in slow.regressors if each.name == "step")
            assert place * series.length / RATE == pytest.approx(at * LENGTH / RATE, abs=60.0)
            assert column.value == pytest.approx(1e-4, abs=4.0 * column.error)
            assert column.error < 1e-5
            assert fit.step.after - fit.step.before == pytest.approx(column.value)
            assert fit.step.before == pytest.approx(9.8, abs=1e-4)


# --- gaps of unknown length --------------------------------------------------------------------------------


@pytest.mark.few
@pytest.mark.parametrize("at", [0.25, 0.5])
def test_another_bias_after_a_gap_of_unknown_length_changes_nothing(quiet: Floats, at: float) -> None:
    found = []
    for bias in (0.0, 1e-3, 1.0):
        cascade = cascade_of(quiet[: round(at * LENGTH)], RATE)
        cascade.break_()
        cascade.update(quiet[round(at * LENGTH) :] + bias)
        found.append(Estimator(averaged=True, time_to=False).fit(cascade.result()))
    for fits in found:
        check(fits)
        for fit, same in zip(fits, found[0], strict=True):
            assert fit.step is None
            assert fit.N.value == pytest.approx(same.N.value, rel=1e-6)
            assert fit.K.high == pytest.approx(same.K.high, rel=1e-3)


def test_a_missing_hour_counts_as_time(quiet: Floats) -> None:
    """A drift goes on during a gap of known length, also where it separates two segments."""
    slope = 1e-6
    cascade = cascade_of((quiet + slope * AT_S)[:20_000], RATE)
    cascade.skip(36_000)
    cascade.update((quiet + slope * AT_S)[56_000:])
    for fit in Estimator(averaged=True, time_to=False).fit(cascade.result()):
        drift = fit.regressor("drift")
        assert drift.value == pytest.approx(slope, abs=4.0 * drift.error)
        assert fit.K.status == "upper_bound" or math.isclose(fit.K.low or 0.0, 0.0, abs_tol=1e-6)


# --- bias against the temperature --------------------------------------------------------------------------

FLICKER, FAST, LONG, MANY = 2.4e-5, 40.0, 72_000, 32
"""Half an hour of a usual gyroscope."""
LONG_AT = np.arange(LONG) / LONG
WARMING = 1.0 - np.exp(-LONG_AT / 0.2)
BOTH_WAYS = np.sin(np.pi * LONG_AT) ** 2
OFFSET = 9.8


@cache
def noise_of(k: float, channels: int) -> Floats:
    """Return (n, channels) noise that is the same for every effect."""
    values = synthesise(LONG, FAST, N=[N] * channels, B=FLICKER, K=k, seed=8)
    values.flags.writeable = False
    return values


def curves(
    effect: Floats, degrees: Floats, k: float, *, drift: float = 0.0, channels: int = MANY
) -> tuple[BiasFit, ...]:
    """Return the curves of channels of noise with an effect (n,) of the temperature (n,) and a drift."""
    values = noise_of(k, channels) + (OFFSET + effect + drift * (LONG_AT - 0.5))[:, None]
    curve = with_temperature(curve_of(values, FAST), degrees, FAST)
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
    assert held >= 0.85 * MANY  # of 32 with 95 % each, fewer once in 100 times
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
        (np.full(LONG, 25.0), "small_range"),
        (25.0 + 0.01 * np.random.default_rng(1).standard_normal(LONG), "small_range"),
        (25.0 + 4.0 * LONG_AT, "collinear"),
        (np.full(LONG, np.nan), "small_range"),
        (293.15 + 40.0 * WARMING, "implausible"),
        (np.where(LONG_AT < 0.5, 20.0 + 40.0 * WARMING, 0.0), "jumps"),
    ],
)
def test_a_temperature_that_says_nothing_gives_a_reason(degrees: Floats, reason: str) -> None:
    for each in curves(np.zeros(LONG), degrees, 0.0, channels=4):
        assert each == BiasFit(reason=reason)


@pytest.mark.slow
def test_steps_and_holes_of_the_temperature_do_no_harm() -> None:
    degrees = 20.0 + 40.0 * WARMING
    coarse = np.round(degrees * 2.0) / 2.0
    for seen in (coarse, np.where(np.abs(LONG_AT - 0.5) < 0.05, np.nan, degrees)):
        found = curves(1e-5 * degrees, seen, 0.0)
        held = [each.terms[1].low <= 1e-5 <= each.terms[1].high for each in found if each.terms]
        assert len(held) >= 0.9 * MANY
        assert sum(held) >= 0.85 * len(held)


def fits_beside(effect: Floats, degrees: Floats) -> tuple[ChannelFit, ...]:
    """Return the fits of noise with an effect (n,) of the temperature (n,)."""
    values = synthesise(LONG, FAST, N=[N] * 8, B=FLICKER, seed=9)
    curve = curve_of(values + effect[:, None], FAST)
    return Estimator(averaged=True, time_to=False).fit(with_temperature(curve, degrees, FAST))


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
