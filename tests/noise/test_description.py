"""Descriptions: filters, quantisation, lines and oscillations change neither N nor B, and none looks like K."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import scipy
from noise_fits import MOST_MISSED, check_noise, curve_of, fits_of, held, width

from imumon.model.grading import grade_channel
from imumon.model.samples import Floats
from imumon.noise import Estimator, OctaveCascade, fit_curve, synthesise

N, B, RATE, LENGTH, CHANNELS = 6.1e-5, 2.4e-5, 40.0, 72_000, 8
SIGMA = N * math.sqrt(RATE)
fitted = partial(fits_of, rate_hz=RATE)
check = partial(check_noise, N=N, B=B)


@pytest.fixture(scope="module")
def quiet() -> Floats:
    return synthesise(LENGTH + 100, RATE, N=[N] * CHANNELS, B=B, seed=4, averaged=False)


@pytest.fixture(scope="module")
def quiet_width(quiet: Floats) -> float:
    """Return the width of the limits of N of the noise alone."""
    return width(fitted(quiet), "N")


# --- filters and quantisation ------------------------------------------------------------------------------


def moving_average(values: Floats, length: int) -> Floats:
    return np.asarray(scipy.signal.lfilter(np.full(length, 1.0 / length), 1.0, values, axis=0)[100:])


def low_pass(values: Floats, samples: float) -> Floats:
    """Return values behind a low-pass of first order with a time constant of some samples."""
    pole = math.exp(-1.0 / samples)
    return np.asarray(scipy.signal.lfilter([1.0 - pole], [1.0, -pole], values, axis=0)[100:])


def second_order(values: Floats, share: float) -> Floats:
    """Return values behind a Butterworth filter with its corner at a share of half the sampling rate."""
    return np.asarray(scipy.signal.lfilter(*scipy.signal.butter(2, share), values, axis=0)[100:])


@pytest.mark.few
@pytest.mark.parametrize("length", [2, 3, 4, 5, 8])
def test_a_moving_average_costs_no_precision(quiet: Floats, quiet_width: float, length: int) -> None:
    """Its shape is known, and the whole spectrum counts."""
    fits = fitted(moving_average(quiet, length))
    check(fits)
    assert all("correlated" in fit.caveats for fit in fits)
    assert width(fits, "N") < 2.5 * quiet_width


@pytest.mark.parametrize("samples", [300, 600, 1000])
def test_a_short_record_behind_a_filter_has_a_value_or_a_reason(quiet: Floats, samples: int) -> None:
    """No band of its spectrum shows what the filter takes."""
    fits = fitted(moving_average(quiet, 2)[:samples])
    assert all(fit.N.value is not None or fit.N.reason for fit in fits)


@pytest.mark.few
@pytest.mark.parametrize(
    ("filtered", "size"), [(low_pass, 0.7), (low_pass, 2.0), (low_pass, 6.0), (second_order, 0.2)]
)
def test_a_low_pass_leaves_n_and_b(
    quiet: Floats, filtered: Callable[[Floats, float], Floats], size: float
) -> None:
    fits = fitted(filtered(quiet, size))
    check(fits)
    assert all("correlated" in fit.caveats for fit in fits)
    assert width(fits, "N") < 0.25 * N


def test_noise_that_is_not_white_is_no_filter_and_has_no_grade() -> None:
    """Of 1/sqrt(f) noise, N holds the level of the highest frequencies, not only that of lower ones."""
    f = np.fft.rfftfreq(2 * LENGTH, 1.0 / RATE)
    share = np.append(0.0, (f[-1] / f[1:]) ** 0.25)[:, None]
    white = np.random.default_rng(3).standard_normal((2 * LENGTH, CHANNELS))
    fits = fitted(SIGMA * np.fft.irfft(share * np.fft.rfft(white, axis=0), axis=0)[:LENGTH])
    for fit in fits:
        assert "not_white" in fit.caveats
        assert "correlated" not in fit.caveats
        assert fit.N.low < N < 2.0 * N < fit.N.high  # type: ignore[operator]
        assert grade_channel("gyro", fit.coefficients) is None


@pytest.mark.slow
def test_a_second_description_does_not_alternate(quiet: Floats) -> None:
    """Over a record that grows eightfold, 42 fits of each channel."""
    values = low_pass(quiet, 2.0)
    cascade, estimator = OctaveCascade(2, tau0=1.0 / RATE), Estimator(averaged=False, time_to=False)
    at, widths = 8_000, []
    cascade.update(values[:at, :2])
    while at < 64_000:
        widths.append([fit.N.high - fit.N.low for fit in estimator.fit(cascade.result())])  # type: ignore[operator]
        part = values[at : round(1.05 * at), :2]
        cascade.update(part)
        at += len(part)
    jumps = np.abs(np.diff(np.log(np.array(widths)), axis=0)) > math.log(1.4)
    assert jumps.sum() <= 8  # a choice is kept until the record has doubled


# --- lines and oscillations --------------------------------------------------------------------------------


def line(
    frequency_hz: float, size: float, *, wander: float = 0.0, change: float = 0.0, seed: int = 3
) -> Floats:
    """Return (n, c) a line of some standard deviations of the noise whose frequency and size change over a minute."""
    rng, pole = np.random.default_rng(seed), math.exp(-1.0 / 60.0)
    seconds = round((LENGTH + 100) / RATE) + 2
    steps = scipy.signal.lfilter(
        [math.sqrt(1.0 - pole**2)], [1.0, -pole], rng.standard_normal((2, seconds, CHANNELS)), axis=1
    )
    time = np.arange(LENGTH + 100) / RATE
    slow = np.array([[np.interp(time, np.arange(seconds), row) for row in each.T] for each in steps])
    phase = 2.0 * np.pi * np.cumsum(frequency_hz * (1.0 + wander * slow[0]), axis=1) / RATE
    return np.asarray((size * SIGMA * (1.0 + change * slow[1]) * np.sin(phase)).T)


@pytest.mark.few
@pytest.mark.parametrize(
    ("frequency_hz", "size", "wander", "change"),
    [
        (0.37, 0.5, 0.0, 0.0),
        (3.7, 3.0, 0.0, 0.0),
        (4.3, 3.0, 0.01, 0.2),
        (12.6, 10.0, 0.01, 0.0),
        (9.0, 3.0, 0.02, 0.0),
        (19.9, 10.0, 0.0, 0.0),
    ],
)
def test_a_line_leaves_the_noise(
    quiet: Floats, quiet_width: float, frequency_hz: float, size: float, wander: float, change: float
) -> None:
    fits = fitted(quiet + line(frequency_hz, size, wander=wander, change=change))
    check(fits)
    assert width(fits, "N") <= 2.0 * quiet_width
    for fit in fits:
        assert "vibration" in fit.caveats
        assert not fit.oscillations_s  # its alias in the block means is no oscillation
        assert fit.lines_hz[0] == pytest.approx(frequency_hz, rel=0.02)


@pytest.mark.few
@pytest.mark.parametrize(
    ("frequency_hz", "wander_hz", "size"), [(0.03, 0.02, 1.0), (0.3, 0.05, 0.5), (2.0, 0.4, 1.0)]
)
def test_a_hum_that_wanders_leaves_the_noise(
    quiet: Floats, quiet_width: float, frequency_hz: float, wander_hz: float, size: float
) -> None:
    """N is the level of the highest frequencies where these are flat, whatever stands below."""
    fits = fitted(quiet + line(frequency_hz, size, wander=wander_hz / frequency_hz))
    check(fits)
    assert width(fits, "N") <= 2.0 * quiet_width
    for fit in fits:
        assert "vibration" in fit.caveats
        assert "correlated" not in fit.caveats
        low, high = fit.hump_hz or (0.0, 0.0)
        assert low < frequency_hz < high
        assert fit.K.status != "measured"
        assert fit.markov is None or fit.markov.sigma.status != "measured"


@pytest.mark.few
@pytest.mark.parametrize("seed", range(4, 8))
def test_the_skirt_of_a_hum_that_wanders_to_zero_is_no_walk(quiet: Floats, seed: int) -> None:
    for fit in fitted(quiet + line(0.03, 1.0, wander=0.02 / 0.03, seed=seed)):
        assert fit.K.status != "measured"


@pytest.mark.few
@pytest.mark.parametrize("more", [0, 64, 100])
def test_many_lines_leave_the_noise(quiet: Floats, more: int) -> None:
    """Wherever in a block the record ends, too: a line does not average out over a part of a block."""
    values = quiet + sum(line(f, 1.0) for f in (0.3, 1.1, 5.3, 13.0))
    check(fitted(values[: LENGTH + more]))


@pytest.mark.few
@pytest.mark.parametrize(("pole", "size"), [(0.999, 3.0), (0.99, 2.0)])
def test_a_resonance_leaves_n(quiet: Floats, pole: float, size: float) -> None:
    turn = 2.0 * pole * math.cos(2.0 * math.pi * 8.0 / RATE)
    shaken = scipy.signal.lfilter(
        [1.0], [1.0, -turn, pole**2], np.random.default_rng(1).standard_normal(quiet.shape), axis=0
    )
    gain = size * SIGMA / shaken.std()
    truth = math.hypot(N, gain / (1.0 - turn + pole**2) / math.sqrt(RATE))
    fits = fitted(quiet + gain * shaken)
    assert held(fits, "N", truth) >= CHANNELS - MOST_MISSED
    assert {fit.N.status for fit in fits} == {"measured"}


def wave(length: int, period_s: float, size: float) -> Floats:
    return size * SIGMA * np.sin(2.0 * np.pi * np.arange(length) / RATE / period_s)[:, None]


@pytest.mark.parametrize(("period_s", "size"), [(60.0, 0.3), (150.0, 0.15)])
def test_a_slow_oscillation_is_left_out_and_its_period_stated(
    quiet: Floats, period_s: float, size: float
) -> None:
    fits = fitted(quiet + wave(len(quiet), period_s, size))
    check(fits)
    for fit in fits:
        assert "oscillation" in fit.caveats
        assert min(abs(each / period_s - 1.0) for each in fit.oscillations_s) < 0.08


@pytest.mark.slow
def test_noise_seldom_oscillates() -> None:
    """3 % of the records have a coefficient that chance does not explain at the stated probability."""
    values = synthesise(20_000, RATE, N=[N] * 40, B=B, K=3e-6, seed=8, averaged=False)
    fits = fitted(values)
    assert sum(bool(fit.oscillations_s) for fit in fits) <= 5


# --- what is drawn -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_drawn_model_passes_through_its_data(quiet: Floats) -> None:
    """At most 5 % of the octaves of all records have it outside their limits."""
    ramp = 1e-7 * np.arange(len(quiet))[:, None] / RATE
    records = {
        "clean": quiet,
        "average": moving_average(quiet, 4),
        "low-pass": low_pass(quiet, 3.0),
        "line": quiet + line(4.3, 3.0, wander=0.01, change=0.2),
        "slow line": quiet + line(0.37, 0.5),
        "ramp": quiet + ramp,
        "steep ramp": quiet + 10.0 * ramp,
        "oscillation": quiet + wave(len(quiet), 100.0, 0.15),
    }
    outside = {}
    for name, values in records.items():
        curve = curve_of(values, RATE)
        found = []
        for c, fit in enumerate(fit_curve(curve, averaged=False, time_to=False)):
            present = curve.terms[:, c] > 0
            found.append(((fit.model < fit.low) | (fit.model > fit.high))[present])
        outside[name] = float(np.mean(found))
    assert float(np.mean(list(outside.values()))) <= 0.05, outside


@pytest.mark.slow
def test_what_no_description_fits_has_a_caveat_or_limits_that_hold_the_truth(quiet: Floats) -> None:
    t = np.arange(len(quiet))[:, None] / RATE
    wild = 1e-3 * np.sin(2.0 * np.pi * np.cumsum(0.3 * np.abs(np.sin(t / 7.0)), axis=0) / RATE)
    for fit in fitted(quiet + wild):
        caveat = fit.N.status != "measured" or {"misfit", "vibration"} & set(fit.caveats)
        assert caveat or (fit.N.low <= N <= fit.N.high)  # type: ignore[operator]
