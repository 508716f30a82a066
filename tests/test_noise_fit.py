"""Laws of the fit: covariance equals its definition, limits contain the truth, numbers are valid."""

import doctest
import math
import pkgutil
import warnings
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

import imumon.noise
from imumon.noise import Estimator, OctaveCascade, fit_curve, synthesise
from imumon.noise.allan import AllanCurve
from imumon.noise.allan.windows import WindowedCascade
from imumon.noise.fit import covariance
from imumon.noise.fit.covariance import PAIRS, tables
from imumon.noise.fit.leastsquares import cube_root_score
from imumon.noise.fit.results import _few_differences_quantile, _share_of_expectation
from imumon.noise.statistics.psd import SpectrumAccumulator

N, B = 6.1e-5, 2.4e-5
PARTS = [name for _, name, _ in pkgutil.walk_packages(imumon.noise.__path__, "imumon.noise.")]


def curve_of(values, rate_hz=40.0, **changes):
    cascade = OctaveCascade(values.shape[1], tau0=1 / rate_hz)
    cascade.update(values)
    return replace(cascade.result(), **changes)


def noise(hours, channels, seed, K=0.0, rate_hz=40.0, averaged=False):
    n = round(hours * 3600 * rate_hz)
    generator = np.random.default_rng(seed)
    rows = [synthesise(n, rate_hz, N=N, B=B, K=K, seed=generator, averaged=averaged) for _ in range(channels)]
    return np.column_stack([np.ravel(row) for row in rows])


@pytest.fixture(scope="module")
def records():
    """An hour of 48 channels, K = 3e-6."""
    return noise(1.0, 48, seed=11, K=3e-6)


@pytest.mark.parametrize("name", PARTS)
def test_docstring_examples_of_a_module_are_correct(name):
    assert doctest.testmod(import_module(name)).failed == 0


def test_package_docstring_is_correct_and_lists_every_module():
    assert doctest.testmod(imumon.noise).failed == 0
    assert set(imumon.noise.__all__) <= set(dir(imumon.noise))
    modules = {name for _, name, _ in pkgutil.iter_modules(imumon.noise.__path__)}
    named = {
        line.split("`")[1].rstrip("/") for line in (imumon.noise.__doc__ or "").splitlines() if "| `" in line
    }
    assert named == modules


# The covariance ---------------------------------


@pytest.mark.parametrize("octaves", [20, 26, 30])
def test_a_ramp_on_another_channel_does_not_change_the_fit_of_a_long_record(octaves):
    m = 1 << np.arange(octaves)
    stride, span = np.maximum(1, m // 8), 3 << (octaves - 1)
    terms = (span - 2 * m) // stride + 1
    edf = np.maximum(1, span // m // 2)
    generator = np.random.default_rng(7)
    design = covariance.design(octaves, averaged=False)
    white, ramp = (
        design @ np.array([1e-6, B, 0.0, Q, 100.0 * R])
        for B, Q, R in ((0.0, 0.0, 0.0), (1e-9, 3e-6, 1e-6 * 4.0**-octaves))
    )
    both = np.stack([white, ramp], axis=1)
    both *= 1.0 + 0.5 * (generator.chisquare(edf, (2, octaves)).T / edf[:, None] - 1.0)

    def n_of(channels):
        count = channels.shape[1]
        both_terms = np.repeat(terms[:, None], count, 1)
        curve = AllanCurve(0.00125, m, channels, both_terms, span, np.full(count, span), 1)
        return Estimator(averaged=False).fit(curve)[0].N

    alone, together = n_of(both[:, :1]), n_of(both)
    assert together.value == pytest.approx(alone.value, rel=1e-9)
    assert alone.low < math.sqrt(1e-6 * 0.00125) < alone.high


def differences(n, m):
    """Return (M, n) the second differences of an octave as rows over the samples, by definition."""
    stride = max(1, m // 8)
    rows = []
    for start in range(0, n - 2 * m + 1, stride):
        row = np.zeros(n)
        row[start : start + m] = -1.0 / m
        row[start + m : start + 2 * m] = 1.0 / m
        rows.append(row)
    return np.array(rows)


@pytest.mark.parametrize("kind", ["white", "walk", "flicker"])
def test_each_table_agrees_with_the_definition(kind):
    n, octaves = 96, 6
    table = tables(n, octaves, averaged=False)
    lag = np.arange(n)
    if kind == "white":
        covariance, index = np.eye(n), 0
    elif kind == "walk":
        covariance, index = np.minimum.outer(lag, lag).astype(float), 2
    else:  # generalised: a constant drops out of every difference
        gamma = np.concatenate([[0.0], -np.cumsum(1.0 / (np.arange(1, n) - 0.5)) / np.pi])
        covariance, index = gamma[np.abs(lag[:, None] - lag)], 1
    rows = [differences(n, 1 << j) for j in range(octaves)]
    for i in range(octaves):
        r = rows[i] @ covariance @ rows[i].T
        assert 0.5 * np.mean(np.diag(r)) == pytest.approx(table.design[i, index], rel=1e-9)
        for j in range(i, octaves):
            r = rows[i] @ covariance @ rows[j].T
            exact = np.sum(r**2) / (2 * len(rows[i]) * len(rows[j]))
            assert table.pairs[PAIRS.index((index, index)), i, j] == pytest.approx(exact, rel=2e-4)


@pytest.mark.parametrize("span", [64, 91, 100, 127])
def test_counts_of_pairs_agree_with_enumeration(span):
    middles = [np.arange(0, span - 2 * m + 1, max(1, m // 8)) + m for m in 2 ** np.arange(6)]
    for i in range(6):
        for j in range(i, 6):
            apart = np.abs(np.subtract.outer(middles[i], middles[j])).ravel()
            steps = np.arange(0, span, max(1, (1 << i) // 8))
            exact = np.bincount(apart, minlength=span)[steps]
            assert covariance._counts(i, j, span, steps).tolist() == exact.tolist()


def test_tables_are_positive_definite_and_scale_with_the_record():
    for averaged in (True, False):
        table = tables(1 << 22, 22, averaged=averaged)
        for term in range(4):
            matrix = table.pairs[PAIRS.index((term, term))]
            size = np.sqrt(np.diag(matrix))
            assert np.linalg.eigvalsh(matrix / np.outer(size, size))[0] > 0.0
    short, long = (tables(n, 10, averaged=True).pairs[0, 3, 3] for n in (1 << 16, 1 << 18))
    assert short / long == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("averaged", [True, False])
@pytest.mark.parametrize("span", [37 << 11, 100_003])
def test_linearly_extrapolated_tables_agree_with_sums_over_lags(span, averaged):
    octaves = 16
    table = covariance._cached_tables(span, octaves, averaged)
    for i, j in np.argwhere(np.triu(np.arange(octaves) % 3 == np.arange(octaves)[:, None] % 3)).tolist():
        sums = covariance._sums(i, j, span, averaged) / (table.full[i] * table.full[j])
        for index, (a, b) in enumerate(PAIRS):
            exact = sums[index] * (0.5 if a == b else 1.0)
            assert table.pairs[index, i, j] == table.pairs[index, j, i]
            assert table.pairs[index, i, j] == pytest.approx(exact, rel=1e-11)
        size = np.abs(table.means[:, i, j]).max()
        assert table.means[:, i, j] == pytest.approx(sums[len(PAIRS) :], rel=1e-9, abs=1e-9 * size)


def test_quantiles_of_octaves_agree_with_scipy_stats():
    stats = pytest.importorskip("scipy.stats")
    dof = np.array([0.5, 1.0, 1.3, 4.0, 30.0, 59.0, 61.0, 500.0])
    for probability in (0.025, 0.5, 0.975):
        exact = stats.chi2.ppf(probability, dof)
        assert _share_of_expectation(probability, dof) * dof == pytest.approx(exact, rel=1e-9)
    long = dof[4:]
    assert _few_differences_quantile(long) == pytest.approx(stats.chi2.ppf(0.025, long) / long, rel=1e-9)
    ratio = np.array([20.0, 30.0, 45.0]) / 30.0
    exact = stats.norm.ppf(stats.chi2.cdf(30.0 * ratio, 30.0))
    assert cube_root_score(ratio, np.full(3, 30.0)) == pytest.approx(exact, abs=0.01)


# The fit ---------------------------------


def test_values_and_limits_contain_the_truth(records):
    fits = fit_curve(curve_of(records), averaged=False)
    for name, truth in (("N", N), ("B", B), ("K", 3e-6)):
        coefficients = [getattr(fit, name) for fit in fits]
        covered = [c.high is not None and c.low <= truth <= c.high for c in coefficients]
        # 95 % of 48 are expected; fewer than 40 occur once in 5,000 runs
        assert sum(covered) >= 40, name
        for c in coefficients:
            assert (c.value is None) == (c.status != "measured")
            if c.value is not None:
                assert 0.0 < c.low <= c.value <= c.high
    spread = np.std([fit.N.value / N for fit in fits])
    assert spread == pytest.approx(1.95e-3, rel=0.35)  # Cramer-Rao bound of an hour at 40 Hz; 48 channels
    assert sum(not fit.used.all() for fit in fits) <= 3
    covered = np.array([(fit.low**2 <= fit.model**2) & (fit.model**2 <= fit.high**2) for fit in fits])
    assert covered.mean() > 0.9


def test_k_is_not_measured_in_white_noise_and_flicker():
    fits = fit_curve(curve_of(noise(0.5, 48, seed=5)), averaged=False)
    assert sum(fit.K.status == "measured" for fit in fits) <= 5  # expected 0.7
    for fit in fits:
        assert fit.K.status in ("measured", "upper_bound")
        assert fit.K.high > 0.0


def test_averages_and_point_samples_have_different_expectations():
    for averaged in (True, False):
        fits = fit_curve(curve_of(noise(0.5, 12, seed=8, averaged=averaged)), averaged=averaged)
        values = np.array([fit.N.value for fit in fits]) / N
        assert values.mean() == pytest.approx(1.0, abs=4 * 2.8e-3 / math.sqrt(12))
    flicker = np.column_stack([synthesise(1 << 15, 40.0, B=B, seed=s, averaged=False) for s in range(6)])
    for fit in fit_curve(curve_of(flicker), averaged=False):
        assert fit.used.all()
        assert fit.N.status == "upper_bound"  # not the 1.44 of the first octave


def test_channels_are_fitted_independently(records):
    curve = curve_of(records[:, :4])
    together = fit_curve(curve, averaged=False)
    for channel in range(4):
        alone = fit_curve(
            replace(
                curve,
                **{k: getattr(curve, k)[..., channel : channel + 1] for k in ("avar", "terms", "valid")},
            ),
            averaged=False,
        )[0]
        assert alone.N.value == pytest.approx(together[channel].N.value, rel=1e-4)
        assert alone.K.high == pytest.approx(together[channel].K.high, rel=1e-2)


def test_results_scale_with_the_unit(records):
    small = fit_curve(curve_of(records[:, :2]), averaged=False)
    large = fit_curve(curve_of(1e6 * records[:, :2]), averaged=False)
    slow = fit_curve(curve_of(records[:, :2], rate_hz=4.0), averaged=False)
    for a, b, c in zip(small, large, slow, strict=True):
        assert b.N.value == pytest.approx(1e6 * a.N.value, rel=1e-6)
        assert b.K.high == pytest.approx(1e6 * a.K.high, rel=1e-4)
        assert c.N.value == pytest.approx(math.sqrt(10) * a.N.value, rel=1e-6)
        assert c.B.value == pytest.approx(a.B.value, rel=1e-6)


def test_lost_samples_and_a_gap_widen_limits_and_keep_values(records):
    valid = np.random.default_rng(3).random(len(records)) > 0.005
    cascade = OctaveCascade(8, tau0=1 / 40)
    cascade.update(records[:100_000, :8], valid[:100_000])
    cascade.skip(20_000)
    cascade.update(records[120_000:, :8], valid[120_000:])
    whole, part = (fit_curve(c, averaged=False) for c in (curve_of(records[:, :8]), cascade.result()))
    for a, b in zip(whole, part, strict=True):
        assert b.N.value == pytest.approx(a.N.value, rel=4e-3)
    width = [np.mean([fit.N.high - fit.N.low for fit in fits]) for fits in (whole, part)]
    assert width[1] > width[0]


# Departures from the model ---------------------------------


@pytest.fixture(scope="module")
def quiet():
    """Two hours of 6 channels without K."""
    return noise(2.0, 6, seed=21)


def time_of(values):
    return np.arange(len(values))[:, None] / 40.0


@pytest.mark.parametrize(("amplitude", "frequency"), [(3e-4, 0.37), (3e-4, 3.7), (1e-3, 0.05)])
def test_a_line_of_the_spectrum_is_subtracted_and_keeps_the_accuracy(quiet, amplitude, frequency):
    values = quiet + amplitude * np.sin(2 * np.pi * frequency * time_of(quiet))
    spectrum = SpectrumAccumulator([0] * values.shape[1], 40.0)
    spectrum.update(values)
    for fit in fit_curve(curve_of(values), averaged=False, bands=spectrum.result().bands):
        assert fit.caveats == ("vibration",)
        assert fit.used.all()
        assert fit.N.value == pytest.approx(N, rel=0.01)
        assert fit.B.value == pytest.approx(B, rel=0.25)
        assert fit.N.high - fit.N.low < 0.02 * N


def test_a_line_without_a_spectrum_excludes_octaves_or_gives_no_value(quiet):
    line = 3e-4 * np.sin(2 * np.pi * 0.37 * time_of(quiet))
    for fit in fit_curve(curve_of(quiet + line), averaged=False):
        assert "vibration" in fit.caveats
        assert not fit.used.all()
        if fit.N.status == "measured":
            assert fit.N.low <= 1.01 * N
            assert fit.N.high >= 0.99 * N
            assert fit.N.value == pytest.approx(N, rel=0.02)


def test_a_filter_excludes_octaves_and_keeps_the_accuracy(quiet):
    boxcar = (quiet[3:] + quiet[2:-1] + quiet[1:-2] + quiet[:-3]) / 4
    for fit in fit_curve(curve_of(boxcar), averaged=False):
        assert fit.caveats == ("correlated",)
        assert not fit.used[0]
        assert fit.N.value == pytest.approx(N, rel=0.03)
        assert fit.N.low < N * 1.01
        assert fit.N.high > N * 0.99


def test_a_ramp_is_not_attributed_to_k(quiet):
    for fit in fit_curve(curve_of(quiet + 3e-7 * time_of(quiet)), averaged=False):
        assert "ramp" in fit.caveats
        assert fit.K.status == "upper_bound"
        assert fit.ramp == pytest.approx(3e-7, rel=0.3)
        assert fit.N.value == pytest.approx(N, rel=0.02)


def test_quantisation_is_not_attributed_to_n():
    generator = np.random.default_rng(2)
    phase = np.cumsum(generator.standard_normal((1 << 17, 3)), axis=0) * N / math.sqrt(40.0)
    step = 1e-5
    rounded = np.diff(np.round(phase / step) * step, axis=0) * 40.0
    for fit in fit_curve(curve_of(rounded), averaged=True):
        assert "quantised" in fit.caveats
        assert fit.quantisation == pytest.approx(step / math.sqrt(12), rel=0.15)
        assert fit.N.value == pytest.approx(N, rel=0.05)


def test_a_misfit_has_a_caveat_or_limits_that_contain_the_truth(quiet):
    wild = np.sin(2 * np.pi * np.cumsum(0.3 * np.abs(np.sin(time_of(quiet) / 7.0)), axis=0) / 40.0) * 1e-3
    many = sum(np.sin(2 * np.pi * f * time_of(quiet)) for f in (0.0013, 0.021, 0.33, 1.7, 5.3)) * 4e-4
    for fit in fit_curve(curve_of(quiet + wild + many), averaged=False):
        caveat = fit.N.status != "measured" or "misfit" in fit.caveats or "vibration" in fit.caveats
        assert caveat or fit.N.low <= N <= fit.N.high


def test_the_selection_of_octaves_is_stable(quiet):
    boxcar = (quiet[3:] + quiet[2:-1] + quiet[1:-2] + quiet[:-3]) / 4
    cascade, estimator = OctaveCascade(6, tau0=1 / 40), Estimator(averaged=False)
    changes, before = 0, None
    for block in np.array_split(boxcar, 40):
        cascade.update(block)
        firsts = [int(np.argmax(fit.used)) for fit in estimator.fit(cascade.result())]
        changes += 0 if before is None else sum(a != b for a, b in zip(firsts, before, strict=True))
        before = firsts
    assert changes <= 10  # in 240 comparisons


# Records of an estimator ---------------------------------


def cascade_of(values):
    cascade = OctaveCascade(values.shape[1], tau0=1 / 40)
    cascade.update(values)
    return cascade


def results(fits):
    """Return the published values of fits, for exact comparison."""
    return [
        (f.N, f.B, f.K, f.time_to, f.caveats, f.model.tolist(), f.low.tolist(), f.high.tolist()) for f in fits
    ]


def windowed(values):
    """Return a cascade of `values`, and a window of it that begins at sample 512."""
    whole = WindowedCascade(OctaveCascade(values.shape[1], tau0=1 / 40))
    whole.update(values[:512])
    window = whole.open_window()
    whole.update(values[512:])
    return whole, window


def other_records(whole, window, values):
    """Yield curves of records other than that of the cascade of `values`, (n, 2), with the difference."""
    n, first = len(values), whole.cascade
    white = 5e-4 * np.random.default_rng(9).standard_normal((2 * n, 2))
    yield "longer", cascade_of(white).result()
    yield "slightly longer", cascade_of(white[: n + 100]).result()
    yield "same length", cascade_of(white[:n]).result()
    yield "same beginning", cascade_of(np.concatenate([values[: n - 50], white[:60]])).result()
    yield "scaled", cascade_of(3.0 * values).result()
    yield "shorter", cascade_of(white[: n // 2]).result()
    other = first.copy()
    other.update(white[: n // 100])
    yield "copy that continued differently", other.result()
    restored = OctaveCascade.restore(first.save())
    restored.update(10.0 * white[: n // 100])
    yield "restored state that continued differently", restored.result()
    yield "changed values", replace(first.result(), avar=4.0 * first.result().avar)
    yield "other channels", first.result().select([1, 0])
    yield "part of the record", whole.sums_since(window).curve(1 / 40)


def test_an_estimator_returns_no_limits_of_another_record(records):
    values = records[:20_000, :2]
    whole, window = windowed(values)
    first = whole.cascade
    expected_first = results(fit_curve(first.result(), averaged=False))
    for name, other in other_records(whole, window, values):
        estimator = Estimator(averaged=False)
        assert results(estimator.fit(first.result())) == expected_first, name
        expected = results(fit_curve(other, averaged=False))
        assert results(estimator.fit(other)) == expected, name
        assert results(estimator.fit(other, renew=False)) == expected, name
        assert results(estimator.fit(first.result())) == expected_first, name


@pytest.mark.parametrize("kind", ["plain", "restored", "part"])
def test_a_growing_record_keeps_its_limits_between_renewals(records, kind):
    whole, window = windowed(records[:20_000, :2])
    if kind == "restored":
        whole = WindowedCascade.restore(whole.save())
    estimator = Estimator(averaged=False)
    renewals, before = 0, None
    for block in np.array_split(records[20_000:21_000, :2], 50):
        whole.update(block)
        curve = whole.sums_since(window).curve(1 / 40) if kind == "part" else whole.cascade.result()
        estimator.fit(curve)
        renewals += estimator._confidences[0] is not before
        before = estimator._confidences[0]
    assert 2 <= renewals <= 4  # at the beginning, and once in 2 % of growth


# A growing record ---------------------------------


def test_limits_are_renewed_by_growth_and_follow_their_value_in_between(records):
    cascade, estimator = OctaveCascade(2, tau0=1 / 40), Estimator(averaged=False)
    cascade.update(records[:40_000, :2])
    first = estimator.fit(cascade.result())
    cascade.update(records[40_000:40_200, :2])
    again = estimator.fit(cascade.result())
    for a, b in zip(first, again, strict=True):
        assert b.N.value != a.N.value
        assert b.N.low / b.N.value == pytest.approx(a.N.low / a.N.value, rel=1e-3)
        assert b.K.high == a.K.high
    cascade.update(records[40_200:44_000, :2])
    assert estimator.fit(cascade.result())[0].K.high != first[0].K.high


def test_time_to_precision_falls_to_zero_and_agrees_with_theory(records):
    cascade, estimator = OctaveCascade(8, tau0=1 / 40), Estimator(averaged=False)
    cascade.update(records[:4_000, :8])
    early = [fit.time_to.N for fit in estimator.fit(cascade.result())]
    # by the Cramer-Rao bound a 95 % half-width of 1 % takes 550 s at 40 Hz, of which 100 s have passed
    assert np.median(early) == pytest.approx(450.0, rel=0.4)
    cascade.update(records[4_000:, :8])
    for fit in estimator.fit(cascade.result()):
        assert fit.time_to.N == 0.0
        assert fit.time_to.K is None or fit.time_to.K >= 0.0


def test_averages_and_point_samples_in_one_curve_use_their_own_tables():
    kinds = (True, False, True)
    records = np.column_stack(
        [noise(0.5, 1, seed=50 + c, K=3e-6, averaged=kind) for c, kind in enumerate(kinds)]
    )
    curve = curve_of(records)
    mixed = Estimator(averaged=kinds).fit(curve, resolution=[0.0, 0.0, 0.0])
    for channel, kind in enumerate(kinds):
        alone = fit_curve(curve.select([channel]), averaged=kind)[0]
        other = fit_curve(curve.select([channel]), averaged=not kind)[0]
        assert mixed[channel].N.value == pytest.approx(alone.N.value, rel=1e-6)
        assert mixed[channel].model == pytest.approx(alone.model, rel=1e-6)
        assert mixed[channel].model != pytest.approx(other.model, rel=1e-6)


# Valid numbers ---------------------------------


def check_sound(fit):
    for c in (fit.N, fit.B, fit.K):
        for number in (c.value, c.low, c.high):
            assert number is None or math.isfinite(number)
        assert (c.status == "measured") == (c.value is not None)
        if c.status == "pending":
            assert c.reason
            assert c.low is c.high is None
        else:
            assert c.low <= c.high
    for array in (fit.model, fit.low, fit.high, fit.edf):
        assert np.isfinite(array).all()
    numbers = [value for item in (fit.time_to, fit.readings) for value in (item.N, item.B, item.K)]
    for number in (*numbers, fit.quantisation, fit.ramp, fit.chi2, fit.p_value):
        assert number is None or math.isfinite(number)


def test_no_input_raises_or_gives_nan():
    generator = np.random.default_rng(1)
    n = 3000
    white = generator.standard_normal(n)
    columns = {
        "zero": np.zeros(n),
        "constant": np.full(n, 9.8),
        "white": white,
        "walk": np.cumsum(white),
        "ramp": 1e-3 * np.arange(n),
        "alternating": np.where(np.arange(n) % 2, 1.0, -1.0),
        "sine": np.sin(np.arange(n) / 30),
        "steps": np.round(white / 9) * 9,
        "one step": np.where(np.arange(n) > n // 2, 1.0, 0.0),
        "spike": np.where(np.arange(n) == 77, 1e6, 0.0) + white,
        "tiny": 1e-150 * white,
        "huge": 1e12 * white,
        "blue": np.diff(white, prepend=0.0),
        "violet": np.diff(white, n=2, prepend=[0.0, 0.0]),
    }
    values = np.column_stack(list(columns.values()))
    for averaged in (True, False):
        cascade, estimator = OctaveCascade(values.shape[1], tau0=0.01), Estimator(averaged=averaged)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            done = 0
            for length in (0, 1, 2, 3, 4, 5, 8, 17, 33, 65, 200, 800, n):
                cascade.update(values[done:length])
                done = length
                for fit in estimator.fit(cascade.result()):
                    check_sound(fit)
    fits = dict(zip(columns, estimator.fit(cascade.result()), strict=True))
    assert fits["zero"].N.status == fits["constant"].K.status == "pending"
    assert fits["constant"].N.reason_code == "constant"
    assert fits["white"].N.status == "measured"


def test_a_channel_without_valid_samples_is_pending():
    generator = np.random.default_rng(4)
    values = generator.standard_normal((2000, 2))
    cascade = OctaveCascade(2, tau0=0.01, groups=[0, 1])
    cascade.update(values, np.column_stack([np.ones(2000, dtype=bool), np.zeros(2000, dtype=bool)]))
    first, second = fit_curve(cascade.result(), averaged=False)
    assert first.N.status == "measured"
    assert second.N.status == "pending"
    check_sound(second)


def test_a_resolution_that_hides_the_noise_is_reported():
    generator = np.random.default_rng(6)
    values = np.round(generator.standard_normal((20_000, 2)) * [0.2, 3.0])
    first, second = Estimator(averaged=False).fit(curve_of(values), resolution=[1.0, 1.0])
    assert first.N.status == "pending"
    assert first.N.reason_code == "resolution"
    assert second.N.value == pytest.approx(3.0 / math.sqrt(40.0), rel=0.03)
