"""Laws of the likelihood of N, B and K: limits hold the truth, precision is that of the data, times to it are right."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from noise_fits import column, curve_of, fits_of, held
from term_powers import powers_of

from imumon.model.samples import Floats
from imumon.model.saved_state import pack, unpack
from imumon.noise import ChannelFit, Estimator, OctaveCascade, fit_curve, synthesise
from imumon.noise.allan import AllanCurve
from imumon.noise.blocks import BlockMeans
from imumon.noise.fit.likelihood import EVIDENCE, Surface, evidence, quantiles, upper_limit
from imumon.noise.fit.model import FLICKER, NOISE_TERMS, TERMS, WALK, WHITE, NoiseTerm
from imumon.noise.fit.observations import BAND_EDGES, block_series, meeting_frequency, spectral_powers
from imumon.noise.fit.slow_terms import SlowTermSearch
from imumon.noise.fit.time_to_precision import relative_errors, seconds_to
from imumon.noise.stretches.parts import Parts

N, B, K, RATE = 6.1e-5, 2.4e-5, 3e-6, 40.0
LENGTH, CHANNELS = 72_000, 48


def noise(n: int, channels: int, seed: int, k: float = 0.0, *, averaged: bool = False) -> Floats:
    return synthesise(n, RATE, N=[N] * channels, B=B, K=k, seed=seed, averaged=averaged)


@pytest.fixture(scope="module")
def records() -> Floats:
    """Return half an hour of 48 channels with a random walk."""
    return noise(LENGTH, CHANNELS, seed=11, k=K)


@pytest.fixture(scope="module")
def fits(records: Floats) -> tuple[ChannelFit, ...]:
    return fit_curve(curve_of(records, RATE), averaged=False)


@pytest.fixture(scope="module")
def quiet_fits() -> tuple[ChannelFit, ...]:
    """Return the fits of 48 channels of averages without a random walk."""
    return fit_curve(curve_of(noise(LENGTH, CHANNELS, seed=5, averaged=True), RATE), averaged=True)


# --- limits and precision ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "truth"), [("N", N), ("B", B), ("K", K)])
def test_limits_hold_the_truth(fits: tuple[ChannelFit, ...], name: str, truth: float) -> None:
    """95 % of 48 are expected; fewer than 40 occur once in 2,000 runs."""
    assert held(fits, name, truth) >= 40
    for fit in fits:
        check_sound(fit)


@pytest.mark.parametrize(("name", "truth"), [("N", N), ("B", B)])
def test_limits_without_a_random_walk_hold_the_truth(
    quiet_fits: tuple[ChannelFit, ...], name: str, truth: float
) -> None:
    assert held(quiet_fits, name, truth) >= 40
    # in 48 records, Gauss–Markov noise is as likely as flicker in one or two
    assert sum(fit.B.status != "measured" for fit in quiet_fits) <= 3


def test_the_upper_limit_of_k_holds_without_flicker() -> None:
    """What counts as B is missing from K: where B may be absent, the limit is that without it, if that is greater."""
    b, k = np.linspace(0.0, 3.0, 40), np.linspace(0.0, 4.0, 50)
    together = k[None] + 0.5 * b[:, None]  # the data know the sum
    log = (-0.5 * ((together - 2.0) / 0.4) ** 2 - 0.5 * b[:, None] ** 2).ravel()
    none = np.zeros(log.size)
    surface = Surface({FLICKER: b, WALK: k}, log, {}, {}, none, none[:, None], none[:, None])
    assert quantiles(surface, WALK, np.array([0.975]))[0] < 2.6
    assert upper_limit(surface, WALK, 0.975, FLICKER) == pytest.approx(2.0 + 1.96 * 0.4, rel=0.01)
    shown = replace(surface, grids={FLICKER: b + 0.1, WALK: k})
    assert upper_limit(shown, WALK, 0.975, FLICKER) == quantiles(shown, WALK, np.array([0.975]))[0]


@pytest.mark.slow
def test_k_is_rarely_measured_without_a_random_walk(quiet_fits: tuple[ChannelFit, ...]) -> None:
    """1.4 % of 48 are expected; more than 4 occur once in 1,000 runs."""
    assert sum(fit.K.status == "measured" for fit in quiet_fits) <= 4
    assert all(fit.K.high is not None and fit.K.high > 0.0 for fit in quiet_fits)


@pytest.mark.slow
def test_n_and_b_are_as_precise_as_the_data_allow(fits: tuple[ChannelFit, ...]) -> None:
    """The Cramér-Rao bound of the spectrum; the standard error of a standard deviation of 48 values is 10 %."""
    powers = powers_of({"N": N, "B": B, "K": K}, tau0=1.0 / RATE)
    bounds = {term.letter: e[0] for term, e in relative_errors(powers, np.array([LENGTH]), 0.5).items()}
    for name, truth, bound, most in (("N", N, bounds["N"], 1.3), ("B", B, bounds["B"], 1.5)):
        ratio = column(fits, name, "value") / truth
        assert abs(np.nanmean(ratio) - 1.0) < 4.0 * bound / math.sqrt(CHANNELS), name
        assert np.nanstd(ratio) < most * bound, name
        widths = (column(fits, name, "high") - column(fits, name, "low")) / truth / 3.92
        assert np.nanmedian(widths) == pytest.approx(bound, rel=0.25), name


def test_averages_and_point_samples_have_different_expectations() -> None:
    """Flicker alone: the first octave of point samples is 1.44 times that of averages, and that is no white noise."""
    for averaged in (True, False):
        flicker = synthesise(1 << 15, RATE, N=[0.0] * 6, B=B, seed=2, averaged=averaged)
        found = fit_curve(curve_of(flicker, RATE), averaged=averaged)
        assert sum(fit.N.status == "measured" for fit in found) <= 1
        assert held(found, "B", B) >= 5
        assert max(fit.highest_hz or 0.0 for fit in found) == RATE / 2.0
    mixed = np.column_stack([noise(20_000, 1, seed=50 + c, k=K, averaged=c != 1) for c in range(3)])
    together = Estimator(averaged=[True, False, True]).fit(curve_of(mixed, RATE))
    for c in range(3):
        alone = fit_curve(curve_of(mixed[:, [c]], RATE), averaged=c != 1)[0]
        assert together[c].B.high == pytest.approx(alone.B.high, rel=1e-6)
        assert together[c].model == pytest.approx(alone.model, rel=1e-6)


def test_kurtosis_widens_n() -> None:
    """The relative variance of the power of n independent samples is (2 + kurtosis) / n."""
    curve = curve_of(noise(20_000, 1, seed=3), RATE)
    estimator = Estimator(averaged=False)
    plain, heavy = (estimator.fit(curve, kurtosis=[g], renew=True)[0].N for g in (0.0, 30.0))
    assert heavy.value == plain.value
    own, wide = ((each.high - each.low) / 3.92 / plain.value for each in (plain, heavy))  # type: ignore[operator]
    assert wide**2 - own**2 == pytest.approx(0.25 * 30.0 / 20_000, rel=0.05)


@pytest.mark.slow
def test_limits_of_heavy_tails_hold_the_truth() -> None:
    """Student's t of six degrees of freedom has a kurtosis of 3."""
    samples = np.random.default_rng(3).standard_t(6.0, (20_000, CHANNELS)) * math.sqrt(4.0 / 6.0)
    found = Estimator(averaged=True, time_to=False).fit(curve_of(samples, RATE), kurtosis=[3.0] * CHANNELS)
    assert held(found, "N", 1.0 / math.sqrt(RATE)) >= 40


# --- symmetries --------------------------------------------------------------------------------------------


def test_results_scale_with_the_unit_and_with_the_interval(records: Floats) -> None:
    values = records[:20_000, :2]
    small, large = (fit_curve(curve_of(scale * values, RATE), averaged=False) for scale in (1.0, 1e6))
    slow = fit_curve(curve_of(values, rate_hz=RATE / 16.0), averaged=False)
    for a, b, c in zip(small, large, slow, strict=True):
        for name, factor in (("N", 4.0), ("B", 1.0), ("K", 0.25)):
            own, unit, interval = (getattr(fit, name) for fit in (a, b, c))
            assert own.status == unit.status == interval.status
            assert unit.high == pytest.approx(1e6 * own.high, rel=1e-6)
            assert interval.high == pytest.approx(factor * own.high, rel=1e-6)
        assert b.model == pytest.approx(1e6 * a.model, rel=1e-6)
        assert c.model == pytest.approx(a.model, rel=1e-6)


# --- records of an estimator -------------------------------------------------------------------------------


def results(found: Sequence[ChannelFit]) -> list[Any]:
    """Return the published values of fits, for exact comparison."""
    arrays = ("model", "low", "high")
    return [
        (f.N, f.B, f.K, f.time_to, f.caveats, *(getattr(f, name).tolist() for name in arrays)) for f in found
    ]


def marked(values: Floats) -> Parts:
    """Return the parts of a record of `values`, with a mark at sample 512."""
    parts = Parts([0] * values.shape[1], range(values.shape[1]), 1.0 / RATE)
    parts.update(values[:512])
    parts.mark(curve=True)
    parts.update(values[512:])
    return parts


def other_records(parts: Parts, values: Floats) -> Iterator[tuple[str, AllanCurve]]:
    """Yield curves of records other than that of the cascade of `values`, (n, 2), with the difference."""
    n, first = len(values), parts.cascade
    white = 5e-4 * np.random.default_rng(9).standard_normal((2 * n, 2))
    yield "slightly longer", curve_of(white[: n + 100], RATE)
    yield "same beginning", curve_of(np.concatenate([values[: n - 50], white[:60]]), RATE)
    yield "scaled", curve_of(3.0 * values, RATE)
    restored = unpack(pack(first))
    restored.update(10.0 * white[: n // 100])
    yield "restored state that continued differently", restored.result()
    yield "other channels", first.result().select([1, 0])
    yield "part of the record", parts.curve(512)


def test_an_estimator_returns_no_limits_of_another_record(records: Floats) -> None:
    values = records[:8_000, :2]
    parts = marked(values)
    first = parts.cascade
    expected_first = results(Estimator(averaged=False).fit(first.result()))
    for name, other in other_records(parts, values):
        estimator = Estimator(averaged=False)
        assert results(estimator.fit(first.result())) == expected_first, name
        expected = results(Estimator(averaged=False).fit(other))
        assert results(estimator.fit(other)) == expected, name
        assert results(estimator.fit(other, renew=False)) == expected, name
        assert results(estimator.fit(first.result())) == expected_first, name
        # sums alone are of no record that could be known
        alone = results(Estimator(averaged=False).fit_sums(other.sums, other.span))
        assert results(estimator.fit_sums(other.sums, other.span)) == alone, name
        assert results(estimator.fit(first.result(), renew=False)) == expected_first, name
    changed = replace(first.result(), avar=4.0 * first.result().avar)
    assert changed.record is None


def test_a_growing_record_keeps_its_fit_until_it_has_grown_by_two_per_cent(records: Floats) -> None:
    parts = marked(records[:8_000, :1])
    estimator, seen = Estimator(averaged=False), []
    for block in np.array_split(records[8_000:8_400, :1], 50):
        parts.update(block)
        seen.append(estimator.fit(parts.cascade.result())[0].B)
    assert 3 <= len({each.high for each in seen}) <= 4
    again = estimator.fit(parts.cascade.result(), renew=True)[0]
    assert again.B.high != seen[-1].high


@pytest.mark.few
@pytest.mark.parametrize("period", [400, 1000, 4000])
def test_limits_hold_the_truth_where_every_second_stretch_is_missing(period: int) -> None:
    """As of a link that drops out, or of a guard that excludes what moves: 5 s to 50 s on, as long off."""
    values = noise(2 * LENGTH, 24, seed=5)
    fits = fits_of(values, RATE, (np.arange(len(values)) // (period // 2) % 2 == 0)[:, None])
    assert held(fits, "N", N) >= 20  # 19 or fewer of 24 are 1 in 200 by chance
    assert held(fits, "B", B) >= 20


# --- valid numbers -----------------------------------------------------------------------------------------


def check_sound(fit: ChannelFit) -> None:
    for c in (fit.N, fit.B, fit.K):
        for number in (c.value, c.low, c.high):
            assert number is None or math.isfinite(number)
        assert (c.status == "measured") == (c.value is not None)
        if c.status == "pending":
            assert c.reason
            assert c.low is c.high is None
        else:
            assert 0.0 <= c.low <= (c.value or 0.5 * (c.low + c.high)) <= c.high
            assert c.value is None or c.low < c.value < c.high
    for array in (fit.model, fit.noise, fit.low, fit.high, fit.edf):
        assert np.isfinite(array).all()
    numbers = [value for item in (fit.time_to, fit.readings) for value in item.values()]
    for number in (*numbers, fit.chi2, fit.p_value, fit.explained, fit.highest_hz):
        assert number is None or math.isfinite(number)


def odd_channels(n: int) -> dict[str, Floats]:
    white, at = np.random.default_rng(1).standard_normal(n), np.arange(n)
    return {
        "zero": np.zeros(n),
        "constant": np.full(n, 9.8),
        "white": white,
        "walk": np.cumsum(white),
        "ramp": 1e-3 * at,
        "alternating": np.where(at % 2, 1.0, -1.0),
        "sine": np.sin(at / 30),
        "steps": np.round(white / 9) * 9,
        "one step": np.where(at > n // 2, 1.0, 0.0),
        "spike": np.where(at == 77, 1e6, 0.0) + white,
        "tiny": 1e-150 * white,
        "huge": 1e12 * white,
        "blue": np.diff(white, prepend=0.0),
        "violet": np.diff(white, n=2, prepend=[0.0, 0.0]),
    }


@pytest.mark.few
@pytest.mark.parametrize("averaged", [True, False])
def test_no_input_raises_or_gives_nan(averaged: bool) -> None:
    n = 3000
    columns = odd_channels(n)
    values = np.column_stack(list(columns.values()))
    cascade, estimator = OctaveCascade(values.shape[1], tau0=0.01), Estimator(averaged=averaged)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = 0
        for length in (0, 1, 2, 17, 65, 400, n):
            cascade.update(values[done:length])
            done = length
            for name, fit in zip(columns, estimator.fit(cascade.result()), strict=True):
                try:
                    check_sound(fit)
                except AssertionError as error:
                    raise AssertionError(f"{name} at {length}: {fit}") from error
    found = dict(zip(columns, estimator.fit(cascade.result()), strict=True))
    assert found["zero"].N.status == found["constant"].K.status == "pending"
    assert found["constant"].N.reason_code == found["zero"].N.reason_code == "constant"
    assert found["white"].N.status == "measured"


def test_breaks_every_few_seconds_are_the_reason() -> None:
    cascade, values = OctaveCascade(1, tau0=1.0 / RATE), noise(LENGTH, 1, seed=2)
    for begin in range(0, LENGTH, 200):
        cascade.update(values[begin : begin + 200])
        cascade.break_()
    (fit,) = fit_curve(cascade.result(), averaged=False)
    assert {fit.coefficients[letter].reason for letter in "NBK"} == {
        "gaps of unknown length cut the record into parts that are too short"
    }


@pytest.mark.few
@pytest.mark.parametrize("samples", [3_000, 20_000])
@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_quantisation_of_any_size_leaves_n_and_is_measured(ratio: float, samples: int) -> None:
    """Counts of an angle, Q = ratio N sqrt(tau0). 95 % of 40 are expected; fewer than 31 occur once in 5,000 runs.

    In short records blocks of one sample hold all frequencies: the term must act there, too.
    """
    size = ratio * N / math.sqrt(RATE)
    errors = np.random.default_rng(samples).standard_normal((samples + 1, 40)) * size
    counted = noise(samples, 40, seed=int(10 * ratio), averaged=True) + np.diff(errors, axis=0) * RATE
    fits = fits_of(counted, RATE, averaged=True)
    assert held(fits, "N", N) >= 31
    measured = [fit.coefficients["Q"] for fit in fits if "Q" in fit.coefficients]
    assert len(measured) >= 36
    assert sum(q.low <= size <= q.high for q in measured) >= 31  # type: ignore[operator]


# ---------- laws of what the likelihood compares: each frequency counts once, and every term has an expectati


# ---------- laws of what the likelihood compares: each frequency counts once, and every term has an expectati


@pytest.mark.few
@pytest.mark.parametrize("samples", [2_000, 5_000, 20_000, 70_000])
def test_spectrum_and_blocks_meet_without_an_overlap(samples: int) -> None:
    """The lowest band that the spectrum has begins where the block means end."""
    sums = curve_of(np.random.default_rng(1).standard_normal((samples, 1)), 1.0).sums
    series = block_series(sums.blocks, 0)
    meeting = meeting_frequency(series)
    tops = np.sort(spectral_powers(sums, 0, averaged=True).top)
    edges = np.append(tops[0] * BAND_EDGES[0] / BAND_EDGES[1], tops)
    assert np.isclose(edges, meeting).any()


@pytest.mark.few(2)
@pytest.mark.parametrize("window", [1, 2, 8])
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_every_term_has_a_positive_expectation_of_every_observation(loss: float, window: int) -> None:
    """A moving average of two samples has no white noise at half the sampling rate."""
    valid = np.random.default_rng(2).random((20_000, 1)) >= loss
    sums = curve_of(np.random.default_rng(1).standard_normal((20_000, 1)), 1.0, valid).sums
    series, bands = block_series(sums.blocks, 0), spectral_powers(sums, 0, averaged=False, window=window)
    for term in TERMS:
        assert (bands.expected[term] > 0.0).all(), term.letter
        assert (series.variances[term] > 0.0).all(), term.letter


@pytest.mark.parametrize("length", [1, 4])
@pytest.mark.parametrize("term", NOISE_TERMS)
def test_what_is_interpolated_across_holes_is_expected(term: NoiseTerm, length: int) -> None:
    """A twentieth is missing: white noise is 15 % more in the lowest tenth, a walk 6 % less in the upper half."""
    count, records = 256, 400
    strengths = {"N": 0.0, "B": 0.0, "K": 0.0, term.letter: 1.0}
    means = synthesise(count, 1.0, **{name: [size] * records for name, size in strengths.items()}, seed=5)
    for begin in range(10, count - 12, count * length // 12):
        means[begin : begin + length] = np.nan
    share, segment = np.isfinite(means).astype(np.float64), np.zeros(count, dtype=np.int64)
    blocks = BlockMeans(means, share, segment, 1, 1.0, np.zeros(records))
    ratios = []
    for channel in range(records):
        series = block_series(blocks, channel)
        assert series.count.tolist() == [count]
        ratios.append(series.y**2 / series.variances[term])
    mean = np.mean(ratios, axis=0)
    assert mean[:24].mean() == pytest.approx(1.0, abs=0.05)  # 9,600 squares: a standard error of 1.4 %
    assert mean[24 : count // 2].mean() == pytest.approx(1.0, abs=0.025)
    assert mean[count // 2 :].mean() == pytest.approx(1.0, abs=0.03)


def test_interpolation_repeats_the_noise_of_the_blocks_beside_a_hole() -> None:
    """Of blocks at the border of a hole a part is missing, so that their means have more noise than the others."""
    values = np.random.default_rng(1).standard_normal((144_000, 24))
    valid = np.ones((144_000, 1), dtype=bool)
    for begin in np.random.default_rng(2).integers(0, 142_800, 20).tolist():
        valid[begin : begin + 1200] = False
    sums = curve_of(values, 1.0, valid).sums
    ratios = []
    for channel in range(24):
        series = block_series(sums.blocks, channel)
        assert series.count.size == 1
        low = series.order[2:80]
        ratios.append(series.y[low] ** 2 / series.variances[WHITE][low])
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)  # three standard errors; with the mean share, 1.25


WHOLE = 1 << 17
"""Samples: 1,024 whole blocks."""


def stated(
    values: Floats,
) -> tuple[Estimator, list[SlowTermSearch], list[dict[str, tuple[float, float, str]]]]:
    """Return the estimator, the slow terms, and limits and status of N, B and K of each channel."""
    cascade, estimator = OctaveCascade(values.shape[1], tau0=0.025), Estimator(averaged=False, time_to=False)
    cascade.update(values)
    curve = cascade.result()
    fits = estimator.fit(curve)
    searches = []
    for channel in range(values.shape[1]):
        series = block_series(curve.sums.blocks, channel)
        searches.append(SlowTermSearch(series, None))
        searches[-1].result()
    limits = [
        {letter: (part.low, part.high, part.status) for letter, part in fit.coefficients.items()}
        for fit in fits
    ]
    return estimator, searches, limits


@pytest.mark.few
@pytest.mark.parametrize("K", [3e-6, 0.0])
def test_a_record_played_backwards_states_the_same(K: float) -> None:
    values = synthesise(WHOLE, 40.0, N=[6.1e-5] * 8, B=[2.4e-5] * 8, K=[K] * 8, seed=11, averaged=False)
    forwards, backwards = stated(values), stated(values[::-1].copy())
    compared = 0
    for channel in range(8):
        one, two = (searches[channel] for _, searches, _ in (forwards, backwards))
        assert evidence(one.surface, WALK) == pytest.approx(evidence(two.surface, WALK), rel=1e-6, abs=1e-6)
        assert one.terms.slowest.tolist() == two.terms.slowest.tolist()
        assert one.terms.masked.sum() == two.terms.masked.sum()
        if one.terms.doubtful or two.terms.doubtful:
            continue
        compared += 1
        for letter, (low, high, status) in forwards[2][channel].items():
            low_back, high_back, status_back = backwards[2][channel][letter]
            assert abs(high - high_back) < 0.25 * (high - low)
            if status == status_back:
                assert abs(low - low_back) < 0.25 * (high - low)
            else:
                # only where chance decides whether it shows
                surfaces = [
                    estimator._known[channel].fitted.surface for estimator in (forwards[0], backwards[0])
                ]
                assert letter == "K"
                assert all(abs(evidence(surface, WALK) - EVIDENCE) < 1.0 for surface in surfaces)
    assert compared >= 4


# ---------- the time to a precision: 0 when it is reached, less as the record grows, none without a value


POWERS = powers_of({"N": N, "B": B, "K": 0.0}, tau0=1.0 / RATE)


def seconds(widths: list[float], samples: float = 72_000.0, precision: float = 0.1) -> list[float | None]:
    by_letter = dict(zip("NBK", widths, strict=True))
    times = seconds_to(POWERS, by_letter, samples, 1.0 / RATE, 0.5, dict.fromkeys("NBK", precision))
    return list(times.values())


def test_what_is_reached_takes_no_time_and_what_has_no_value_takes_none() -> None:
    assert seconds([0.05, 0.1, np.inf]) == [0.0, 0.0, None]
    n, b, _ = seconds([0.11, 0.2, np.inf])
    assert 0.0 < n < b


@pytest.mark.few
@pytest.mark.parametrize("factor", [1.5, 3.0, 20.0])
def test_the_time_of_white_noise_grows_with_the_square_of_the_precision(factor: float) -> None:
    (found, *_) = seconds([0.1 * factor, np.inf, np.inf])
    assert found == pytest.approx((factor**2 - 1.0) * 1800.0, rel=0.1)


def test_the_time_falls_as_the_record_grows() -> None:
    """By the Cramér-Rao bound a half-width of 1 % of N takes 9 min at 40 Hz."""
    values = synthesise(72_000, RATE, N=[N] * 8, B=B, seed=3)
    cascade, estimator, times = OctaveCascade(8, tau0=1.0 / RATE), Estimator(averaged=True), []
    for part in np.split(values, [4_000, 8_000, 16_000]):
        cascade.update(part)
        times.append([fit.time_to["N"] for fit in estimator.fit(cascade.result(), renew=True)])
    found = np.array(times, dtype=np.float64)
    ends = np.array([4_000, 8_000, 16_000])[:, None] / RATE + found[:3]
    assert np.median(ends) == pytest.approx(np.median(ends[2]), rel=0.5)
    assert (np.diff(np.median(found, axis=1)) < 0.0).all()
    assert not found[3].any()


@pytest.mark.slow
def test_a_stated_time_is_that_of_the_fit_of_a_longer_record() -> None:
    values = synthesise(288_000, RATE, N=[N] * 6, B=B, seed=4)
    first = OctaveCascade(6, tau0=1.0 / RATE)
    first.update(values[:30_000])
    times = [fit.time_to["B"] for fit in Estimator(averaged=True, precision={"B": 0.2}).fit(first.result())]
    known = [each for each in times if each is not None]
    assert len(known) >= 4
    assert min(known) > 0.0
    end = round((750.0 + float(np.median(known))) * RATE)
    assert end < len(values)
    longer = OctaveCascade(6, tau0=1.0 / RATE)
    longer.update(values[:end])
    reached = [0.5 * (fit.B.high - fit.B.low) / B for fit in fit_curve(longer.result(), averaged=True)]  # type: ignore[operator]
    assert 0.1 < float(np.median(reached)) < 0.3  # the limits of B scatter by a third


def test_an_absent_coefficient_has_no_time() -> None:
    """White noise alone: B and K are bounded at best, and no longer record measures them."""
    cascade = OctaveCascade(40, tau0=1.0 / RATE)
    cascade.update(np.random.default_rng(5).standard_normal((20_000, 40)))
    measured = 0
    for fit in fit_curve(cascade.result(), averaged=True):
        for name in ("B", "K"):
            is_measured = getattr(fit, name).status == "measured"
            measured += is_measured
            assert is_measured or fit.time_to[name] is None
        assert fit.time_to["N"] is not None
    assert measured <= 6  # of 80, at 1.4 % each: more once in 2,000 times
