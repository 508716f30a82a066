"""Laws of the statistics of a stream: moments, histogram, extremes, differences and envelope, for any chunking."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import pack, unpack
from imumon.noise.statistics.differences import BURST, DENSE, PERIOD, DifferenceAccumulator
from imumon.noise.statistics.distribution_shape import DistributionShape
from imumon.noise.statistics.envelope import RECENT_COLUMNS, Envelope, EnvelopeColumns
from imumon.noise.statistics.extreme_values import ExtremeVisits
from imumon.noise.statistics.histogram import HISTOGRAM_BINS, HistogramAccumulator, quantum
from imumon.noise.statistics.moments import ChannelMoments, Moments, MomentsResult

GROUPS = (0, 0, 1)


def check(result: MomentsResult, values: np.ndarray, ok: np.ndarray) -> None:
    """Compare the result with the definitions, channel by channel."""
    for c, group in enumerate(GROUPS):
        x = values[ok[:, group], c]
        got = result.channels[c]
        assert got.count == len(x)
        if len(x) == 0:
            assert got == ChannelMoments(0, None, None, None, None, None, None, None)
            continue
        assert (got.min, got.max, got.last) == (x.min(), x.max(), x[-1])
        assert got.mean == pytest.approx(x.mean(), rel=1e-12)
        if len(x) < 3:
            continue
        assert got.std == pytest.approx(x.std(ddof=1), rel=1e-9)
        assert got.skewness == pytest.approx(scipy.stats.skew(x), rel=1e-6, abs=1e-9)
        assert got.excess_kurtosis == pytest.approx(scipy.stats.kurtosis(x), rel=1e-6, abs=1e-9)
    if (n := ok[:, 0].sum()) > 1:
        pair = result.covariance[0]
        np.testing.assert_allclose(pair, np.cov(values[ok[:, 0], :2].T), rtol=1e-7, atol=1e-15)
        assert result.channels[0].std == pytest.approx(np.sqrt(pair[0, 0]), rel=1e-12)
    else:
        assert (result.covariance[0] is None) == (n < 2)


def grid(rng: np.random.Generator, n: int, loss: float) -> tuple[np.ndarray, np.ndarray]:
    """Return skewed, correlated values around 9.8, and (n, 2) the valid ones."""
    values = 9.8 + 1e-3 * (rng.standard_gamma(2.0, (n, 3)) @ np.array([[1, 0.5, 0], [0, 1, 0], [0, 0, 3]]))
    return values, rng.random((n, 2)) >= loss


@settings(max_examples=40)
@given(
    n=st.integers(0, 2000),
    cuts=st.lists(st.integers(0, 2000), max_size=8),
    loss=st.sampled_from([0.0, 0.01, 0.9, 1.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_chunking_agrees_with_the_definition(n: int, cuts: list[int], loss: float, seed: int) -> None:
    values, ok = grid(np.random.default_rng(seed), n, loss)
    moments = Moments(3, GROUPS)
    for a, b in pairwise(sorted({0, n, *(c for c in cuts if c <= n)})):
        moments.update(values[a:b], ok[a:b] if loss else None)
    check(moments.result(), values, ok)


@settings(max_examples=25)
@given(n=st.integers(0, 500), m=st.integers(0, 500), loss=st.sampled_from([0.0, 0.9, 1.0]))
def test_merged_moments_equal_one_run(n: int, m: int, loss: float) -> None:
    values, ok = grid(np.random.default_rng(n + m), n + m, loss)
    a, b = Moments(3, GROUPS), Moments(3, GROUPS)
    a.update(values[:n], ok[:n])
    b.update(values[n:], ok[n:])
    before = b.result().channels
    a.merge(b)
    check(a.result(), values, ok)
    assert b.result().channels == before


def test_an_offset_costs_no_precision() -> None:
    """A million samples of 1e-3 around 9.8 agree with numpy on the noise alone."""
    noise = 1e-3 * np.random.default_rng(4).standard_normal((1_000_000, 1))
    moments = Moments(1)
    for start in range(0, len(noise), 10_000):
        moments.update(9.8 + noise[start : start + 10_000])
    x = moments.result().channels[0]
    assert x.std == pytest.approx(noise.std(ddof=1), rel=1e-12)
    assert x.mean == pytest.approx(9.8 + noise.mean(), abs=1e-15 * 10)
    assert x.excess_kurtosis == pytest.approx(scipy.stats.kurtosis(noise[:, 0]), abs=1e-9)


def test_values_that_are_not_finite_never_count() -> None:
    moments = Moments(3, GROUPS)
    moments.update(np.array([[1.0, 2.0, 3.0], [np.nan, 5.0, 4.0], [2.0, np.inf, np.nan], [3.0, 3.0, 9.0]]))
    x, y, z = moments.result().channels
    assert (x.count, y.count, z.count) == (2, 2, 3)
    assert (x.mean, y.last, z.last) == (2.0, 3.0, 9.0)


# ---------- histogram: exact counts in bounded bins, and a verdict by effect size


def shape_of(values: Floats, chunk: int = 5000) -> DistributionShape:
    histogram = HistogramAccumulator((0,))
    for i in range(0, len(values), chunk):
        histogram.update(values[i : i + chunk, None])
    (result,) = histogram.result()
    return result


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.few
@pytest.mark.parametrize("n", [256, 3000, 100_000, 1_000_000])
@pytest.mark.parametrize("level", [0.0, -9.8])
def test_gaussian_noise_is_gaussian_at_any_length(n: int, level: float) -> None:
    result = shape_of(level + 1e-2 * rng(n).standard_normal(n))
    assert result.is_gaussian
    assert result.verdict == "Gaussian"
    assert sum(result.counts) == n
    assert sum(result.gaussian) == pytest.approx(n, rel=1e-2)


CASES: dict[str, tuple[Callable[[int], Floats], str]] = {
    "laplace": (lambda n: rng().laplace(size=n), "heavy tails"),
    "exponential": (lambda n: rng().exponential(size=n), "skewed"),
    "uniform": (lambda n: rng().uniform(size=n), "light tails"),
    "two": (lambda n: rng().standard_normal(n) + np.where(rng(2).random(n) < 0.4, 4.0, 0.0), "light tails"),
    "three": (lambda n: rng().standard_normal(n) + 6.0 * rng(2).integers(0, 3, n), "light tails"),
    "levels": (lambda n: np.rint(0.5 * rng().standard_normal(n)) * 0.001, "quantised"),
    "knocked": (lambda n: rng().standard_normal(n) * np.where(rng(2).random(n) < 0.02, 6.0, 1.0), "heavy"),
}


@pytest.mark.few
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("n", [5000, 300_000])
def test_verdict_names_how_values_differ_from_a_gaussian(case: str, n: int) -> None:
    make, reason = CASES[case]
    result = shape_of(np.asarray(make(n), dtype=np.float64))
    assert result.is_gaussian is False
    assert reason in result.verdict


@pytest.mark.few
@pytest.mark.parametrize("unit", [2.0**-60, 2.0**150])
def test_the_unit_has_no_effect(unit: float) -> None:
    values = rng().gamma(9.0, size=20_000)
    one, other = shape_of(values), shape_of(values * unit)
    assert (other.verdict, other.counts) == (one.verdict, one.counts)


def test_counts_are_exact_and_any_chunking_gives_the_same() -> None:
    values = rng().standard_normal((20_000, 3)) * [1.0, 1e-3, 5.0] + [0.0, 9.8, -3.0]
    values[:, 2] = np.rint(values[:, 2] * 10) / 10
    values[7000:, 0] *= 30.0
    valid = rng(2).random((20_000, 2)) > 0.1
    results = []
    for chunk in (20_000, 977, 61):
        histogram = HistogramAccumulator((0, 0, 1))
        for i in range(0, len(values), chunk):
            histogram.update(values[i : i + chunk], valid[i : i + chunk])
        results.append(histogram.result())
    assert results[0] == results[1] == results[2]
    for c, result in enumerate(results[0]):
        assert len(result.counts) <= HISTOGRAM_BINS
        edges = result.start + result.width * np.arange(len(result.counts) + 1)
        counted, _ = np.histogram(values[valid[:, c // 2], c], edges)
        assert result.counts == tuple(counted.tolist())


def test_one_huge_value_costs_resolution_only() -> None:
    values = rng().standard_normal(10_000)
    values[5000] = 1e30
    result = shape_of(values, 100)
    assert sum(result.counts) == 10_000
    assert result.counts[-1] == 1


def test_steps_are_estimated_from_the_values() -> None:
    x = rng().standard_normal(256)
    assert quantum(x) == 0.0
    assert quantum(x.astype(np.float32).astype(np.float64)) == 0.0
    assert quantum(np.rint(x * 14) * 0.001 - 9.8) == pytest.approx(0.001)
    assert quantum(25.0 + np.rint(x) * 0.1) == pytest.approx(0.1)
    ten_digits = (25.0 + np.rint(x) * 0.1) * (1.0 + 1e-11 * x)
    assert quantum(ten_digits) == pytest.approx(0.1)
    assert quantum(np.full(256, 25.0)) == 0.0


# ---------- extreme values: a range that is too small is seen from the values alone, and nothing else looks l


SAMPLES = 100_000


def clipped_at(values: Floats, chunk: int = 1000) -> tuple[float, ...]:
    extremes, histogram = ExtremeVisits([0]), HistogramAccumulator([0])
    for begin in range(0, len(values), chunk):
        extremes.update(values[begin : begin + chunk, None])
        histogram.update(values[begin : begin + chunk, None])
    (result,), (shape,) = extremes.result(), histogram.result()
    return result.clipped_at(shape)


def gaussian(seed: int = 1) -> Floats:
    return np.random.default_rng(seed).standard_normal(SAMPLES)


# of steps of 0.2, a limit at three deviations makes N 0.3 % low, and is not seen in each record
@pytest.mark.few(2)
@pytest.mark.parametrize("step", [1e-9, 0.02, 0.2])
@pytest.mark.parametrize("limit", [0.5, 1.0, 2.0, 3.0])
def test_clipped_noise_is_seen(limit: float, step: float) -> None:
    values, last = np.round(gaussian() / step), round(limit / step)
    if step < 0.1 or limit < 3.0:
        assert clipped_at(np.clip(values, -last, last) * step) == pytest.approx((-last * step, last * step))
        assert clipped_at(np.minimum(values, last) * step) == pytest.approx((last * step,))


SETTLING = 30.0 * np.exp(-np.arange(SAMPLES) / 5_000.0)
UNCLIPPED: dict[str, Callable[[Floats], Floats]] = {
    "few levels": lambda x: np.clip(np.round(x), 0.0, 2.0),
    "a drift that settles": lambda x: np.round((SETTLING + x) / 0.5) * 0.5,
    "a coarse drift": lambda x: np.round(SETTLING + 0.6 * x),
    "two levels": lambda x: np.clip(np.round(x), 0.0, 1.0),
    "noise": lambda x: x,
    **{
        f"steps of {step}": lambda x, step=step: np.round(x / step) * step
        for step in (0.01, 0.1, 0.3, 1.0, 1.5)
    },
}


@pytest.mark.few(3)
@pytest.mark.parametrize("name", UNCLIPPED)
@pytest.mark.parametrize("seed", range(1, 5))
def test_what_is_not_clipped_is_not_taken_for_it(name: str, seed: int) -> None:
    assert clipped_at(UNCLIPPED[name](gaussian(seed))) == ()


def test_visits_do_not_depend_on_the_chunks() -> None:
    values = np.clip(gaussian(), -2.0, 2.0)[:, None]
    whole, parts = ExtremeVisits([0]), ExtremeVisits([0])
    whole.update(values)
    for part in np.split(values, np.cumsum(np.random.default_rng(2).integers(1, 500, 400))):
        parts.update(part)
    assert whole.result() == parts.result()


# ---------- differences: the robust deviation and the kurtosis of known noise, for any blocks


COUNT = 1_000_000


def accumulated(x: Floats, groups: tuple[int, ...] = (0,)) -> DifferenceAccumulator:
    differences = DifferenceAccumulator(groups)
    for at in range(0, len(x), 7777):
        differences.update(x[at : at + 7777])
    return differences


@pytest.mark.few
@pytest.mark.parametrize("scale", [1e-6, 0.3, 9.8])
def test_gaussian_noise_has_a_ratio_of_one(scale: float) -> None:
    x = scale * np.random.default_rng(1).standard_normal((COUNT, 1))
    differences = accumulated(x + 9.8)
    (robust,) = differences.result([0.0])
    assert robust.sigma == pytest.approx(scale, rel=0.015)
    assert robust.ratio == pytest.approx(1.0, abs=0.012)
    assert not robust.disagrees
    assert differences.fast_kurtosis() == pytest.approx(0.0, abs=0.15)


@pytest.mark.few
@pytest.mark.parametrize("steps", [3.2, 4.0, 7.5, 20.0])
def test_quantised_noise_has_a_ratio_of_one(steps: float) -> None:
    x = np.rint(steps * np.random.default_rng(2).standard_normal((COUNT, 1))) * 0.1
    (robust,) = accumulated(x).result([0.1])
    assert robust.ratio == pytest.approx(1.0, abs=0.02)
    assert accumulated(x).result([0.1 * steps / 2.0]) == [None]


@pytest.mark.few
@pytest.mark.parametrize("share", [0.05, 0.2])
def test_repeated_values_are_no_outliers(share: float) -> None:
    """A sensor that is read more often than it has a value: one in five is that before it."""
    rng = np.random.default_rng(6)
    repeated = rng.random(100_000) < share
    repeated[0] = False
    newest = np.maximum.accumulate(np.where(repeated, 0, np.arange(100_000)))
    (robust,) = accumulated(rng.standard_normal((100_000, 1))[newest]).result([0.0])
    assert robust.ratio == pytest.approx(1.0, abs=0.02)
    assert not robust.disagrees


def test_contaminated_noise_disagrees() -> None:
    """The core is 1, the deviation 2.44; a tenth of the differences raises their median by 12 %."""
    rng = np.random.default_rng(3)
    x = rng.standard_normal((COUNT, 1)) * np.where(rng.random((COUNT, 1)) < 0.05, 10.0, 1.0)
    differences = accumulated(x)
    (robust,) = differences.result([0.0])
    assert robust.disagrees
    assert robust.ratio == pytest.approx(2.18, abs=0.08)
    assert differences.fast_kurtosis()[0] == pytest.approx(3 * 500.95 / 5.95**2 - 3, rel=0.15)


def test_blocks_gaps_and_saved_states_change_nothing() -> None:
    rng = np.random.default_rng(4)
    x, valid = rng.standard_normal((20_000, 4)), rng.random((20_000, 2)) > 0.01
    groups = (0, 0, 1, 1)
    whole = DifferenceAccumulator(groups)
    whole.update(x, valid)
    parts = DifferenceAccumulator(groups)
    for rows in np.split(np.arange(20_000), np.sort(rng.integers(0, 20_000, 50))):
        parts.update(x[rows], valid[rows])
        parts = unpack(pack(parts))
    assert np.array_equal(whole._counts, parts._counts)
    np.testing.assert_allclose(whole._sums, parts._sums, rtol=1e-12)
    place = np.arange(1, 20_000)
    pairs = valid[1:] & valid[:-1] & ((place < DENSE) | (place % PERIOD < BURST))[:, None]
    for c, group in enumerate(groups):
        assert whole._counts[c].sum() == pairs[:, group].sum()


def test_a_break_is_not_spanned() -> None:
    differences = DifferenceAccumulator((0,))
    differences.update(np.zeros((10, 1)))
    differences.break_()
    differences.update(np.ones((10, 1)))
    assert differences._counts.sum() == 18
    assert differences._sums.tolist() == [[0.0, 0.0]]
    assert differences.result([0.0]) == [None]
    assert differences.fast_kurtosis().tolist() == [0.0]


# ---------- envelope: every extreme is in its column, for any chunking


def expected(values: Floats, valid: Bools, width: int, start: int) -> tuple[Floats, Floats]:
    """Return (k, c) extremes of the columns that begin at `start`."""
    marked = np.where(valid, values, np.nan)[start:]
    pad = -len(marked) % width
    marked = np.concatenate((marked, np.full((pad, values.shape[1]), np.nan))).reshape(
        -1, width, values.shape[1]
    )
    return np.fmin.reduce(marked, axis=1), np.fmax.reduce(marked, axis=1)


def record(n: int) -> tuple[Floats, Bools]:
    rng = np.random.default_rng(1)
    valid = rng.random((n, 1)) > 0.05
    valid[n // 3 : n // 3 + 70] = False
    return rng.standard_normal((n, 2)).cumsum(axis=0), valid


@pytest.mark.few
@pytest.mark.parametrize("n", [1, 19, 20, 2345, 2400, 30_011])
@pytest.mark.parametrize("chunk", [7, 40, 1000, 100_000])
def test_columns_have_the_extremes(n: int, chunk: int) -> None:
    if n > 10_000 and chunk < 40:
        pytest.skip("long enough with larger chunks")
    values, valid = record(n)
    envelope = Envelope((0, 0), 40.0)
    for i in range(0, n, chunk):
        envelope.update(values[i : i + chunk], valid[i : i + chunk])
    minute, hour, everything = envelope.minute(), envelope.hour(), envelope.everything()
    assert (minute.width, hour.width) == (20, 1200)
    assert len(minute.low) <= RECENT_COLUMNS
    assert len(everything.low) <= 2 * RECENT_COLUMNS
    assert everything.start == 0
    for columns in (minute, hour, everything):
        low, high = expected(values, valid, columns.width, columns.start)
        np.testing.assert_array_equal(columns.low, low)
        np.testing.assert_array_equal(columns.high, high)


def test_statistics_of_the_last_minute() -> None:
    values, valid = record(30_000)
    values += 1e4
    envelope = Envelope((0, 0), 40.0)
    for i in range(0, len(values), 300):
        envelope.update(values[i : i + 300], valid[i : i + 300])
    recent = envelope.recent()
    last = values[-2400:][valid[-2400:, 0]]
    np.testing.assert_allclose(recent.mean, last.mean(axis=0))
    np.testing.assert_allclose(recent.std, last.std(axis=0, ddof=1), rtol=1e-6)
    assert recent.count[0] == len(last)


def columns_equal(a: EnvelopeColumns, b: EnvelopeColumns) -> None:
    assert (a.start, a.width) == (b.start, b.width)
    np.testing.assert_array_equal(a.low, b.low)
    np.testing.assert_array_equal(a.high, b.high)


@pytest.mark.few
@pytest.mark.parametrize("exponent", [7, 12, 15])
def test_a_gap_of_any_length_is_arithmetic(exponent: int) -> None:
    envelope = Envelope([0], 100.0)
    envelope.update(np.ones((1000, 1)))
    envelope.skip(10**exponent)
    envelope.update(np.zeros((1000, 1)))
    low, high = envelope.everything().low, envelope.everything().high
    assert (np.nanmin(low), np.nanmax(high)) == (0.0, 1.0)
    assert np.nanmax(envelope.hour().high) == 0.0


@pytest.mark.few
@pytest.mark.parametrize("gap", [1, 15, 500, 5000, 400_000])
def test_a_gap_equals_as_many_invalid_samples(gap: int) -> None:
    values, valid = record(3000)
    skipped, filled = Envelope((0, 0), 40.0), Envelope((0, 0), 40.0)
    for envelope in (skipped, filled):
        envelope.update(values[:1005], valid[:1005])
        if envelope is skipped:
            envelope.skip(gap)
        else:
            for i in range(0, gap, 999):
                n = min(999, gap - i)
                envelope.update(np.zeros((n, 2)), np.zeros((n, 1), dtype=bool))
        envelope.update(values[1005:], valid[1005:])
    for view in (Envelope.minute, Envelope.hour, Envelope.everything):
        columns_equal(view(skipped), view(filled))
