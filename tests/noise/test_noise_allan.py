"""Laws of the octave cascade; agreement with the definition, NIST SP 1065 and allantools."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from noise_fits import curve_of, fits_of, held, measured, width

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import pack
from imumon.noise import fit_curve
from imumon.noise.allan import AllanCurve, OctaveCascade
from imumon.noise.synthesis import synthesise

GROUPS = (0, 0, 1)


def grouped_curve(
    values: np.ndarray, valid: np.ndarray | None = None, *, groups: Sequence[int] | None = None
) -> AllanCurve:
    cascade = OctaveCascade(values.shape[1], 0.01, groups=groups)
    cascade.update(values, valid)
    return cascade.result()


def same_bits(a: AllanCurve, b: AllanCurve, *, spectrum: bool = True) -> None:
    for name in ("m", "avar", "terms", "stride", "valid"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert (a.span, a.sections, a.tau0) == (b.span, b.sections, b.tau0)
    for name in ("means", "share", "segment", "length", "interval_s", "offset"):
        own, other = (getattr(sums.blocks, name) for sums in (a.sums, b.sums))
        np.testing.assert_array_equal(own, other, err_msg=name)
    if spectrum:
        same_spectrum(a, b, rtol=0.0)


def same_spectrum(a: AllanCurve, b: AllanCurve, rtol: float) -> None:
    assert len(a.sums.levels) == len(b.sums.levels)
    for own, other in zip(a.sums.levels, b.sums.levels, strict=True):
        np.testing.assert_array_equal(own.averages, other.averages)
        for name in ("power", "white", "holes"):
            np.testing.assert_allclose(getattr(own, name), getattr(other, name), rtol=rtol, atol=0.0)


def same_to_rounding(a: AllanCurve, b: AllanCurve) -> None:
    np.testing.assert_array_equal(a.terms, b.terms)
    np.testing.assert_allclose(a.avar, b.avar, rtol=1e-12)
    assert (a.span, a.sections) == (b.span, b.sections)
    np.testing.assert_array_equal(a.valid, b.valid)
    same_spectrum(a, b, rtol=1e-9)


def definition(y: np.ndarray, ok: np.ndarray, m: int, ratio: int = 8) -> tuple[float, int]:
    """Return the Allan variance of one segment of one channel from its definition, and its terms.

    The excess of white noise of clusters with missing samples is subtracted.
    """
    ends = np.arange(0, len(y) + 1, max(1, m // ratio))
    ends = ends[ends >= m]
    total = np.concatenate(([0.0], np.cumsum(np.where(ok, y, 0.0))))
    count = np.concatenate(([0], np.cumsum(ok)))
    counts = count[ends] - count[ends - m]
    mean = (total[ends] - total[ends - m]) / np.maximum(counts, 1)
    good = counts >= (0.45 * m if m >= 16 else m)
    lag = min(m, ratio)
    use = good[lag:] & good[:-lag]
    avar = ((mean[lag:] - mean[:-lag])[use] ** 2).sum() / (2 * max(use.sum(), 1))
    weight = m / np.maximum(counts, 1)
    excess = (0.5 * (weight[lag:] + weight[:-lag]) - 1.0)[use].sum() / max(use.sum(), 1)
    if excess > 0.0:
        avar = max(avar - definition(y, ok, 1)[0] / m * excess, avar / (1.0 + excess))
    return avar, int(use.sum())


def check_definition(curve: AllanCurve, values: np.ndarray, ok: np.ndarray, groups: Sequence[int]) -> None:
    for j, m in enumerate(curve.m):
        for channel, group in enumerate(groups):
            avar, terms = definition(values[:, channel], ok[:, group], int(m))
            assert curve.terms[j, channel] == terms, (m, channel)
            assert curve.avar[j, channel] == pytest.approx(avar, rel=1e-6, abs=1e-18), (m, channel)


# --- published numbers and other implementations ------------------------------------------------------------

NINE = np.array([892.0, 809, 823, 798, 671, 644, 883, 903, 677])[:, None]


def test_nist_nine_points() -> None:
    curve = grouped_curve(NINE)
    assert curve.sigma[:2, 0] == pytest.approx([91.22945, 85.95287], abs=5e-6)
    np.testing.assert_array_equal(curve.m, [1, 2, 4])
    np.testing.assert_array_equal(curve.terms[:, 0], [8, 6, 2])


def test_nist_thousand_points() -> None:
    numbers, n = [], 1234567890
    for _ in range(1000):
        numbers.append(n / 2147483647)
        n = 16807 * n % 2147483647
    assert grouped_curve(np.array(numbers)[:, None]).sigma[0, 0] == pytest.approx(0.2922319, abs=5e-8)


@pytest.mark.few
@pytest.mark.parametrize("n", [2, 3, 255, 256, 257, 10_000])
def test_short_octaves_agree_with_allantools(n: int) -> None:
    import allantools  # it imports all of scipy

    values = np.random.default_rng(n).standard_normal((n, 2))
    curve = grouped_curve(values)
    assert curve.m[-1] <= n / 2 < 2 * curve.m[-1]
    for channel in range(2):
        tau = curve.tau[curve.m <= 8]
        if n < 4:
            continue
        _, sigma, _, count = allantools.oadev(values[:, channel], rate=100.0, data_type="freq", taus=tau)
        np.testing.assert_allclose(curve.sigma[: len(sigma), channel], sigma, rtol=1e-12)
        np.testing.assert_array_equal(curve.terms[: len(sigma), channel], count)


def test_long_octaves_agree_with_full_overlap() -> None:
    """Against full overlap, an estimator with 98 % of its EDF differs by sqrt(0.02) of its own deviation."""
    values = np.random.default_rng(5).standard_normal((1 << 15, 20))
    curve = grouped_curve(values)
    for j, m in enumerate(curve.m[4:9], start=4):
        edf = 2.0 * len(values) / m / 3.0 * 2.0  # of white noise, about
        for channel in range(values.shape[1]):
            full, _ = definition(values[:, channel], np.ones(len(values), dtype=bool), int(m), ratio=int(m))
            ratio = curve.avar[j, channel] / full - 1.0
            assert abs(ratio) < 4.5 * np.sqrt(2.0 / edf) * np.sqrt(0.03)


@pytest.mark.parametrize("offset", [9.75, -(2.0**23)])
def test_an_offset_costs_no_precision_of_any_segment(offset: float) -> None:
    """Of numbers in whole 2^-20, whose sum with an offset is exact; the mean changes its sign in a restart."""
    noise = np.rint(1024.0 * np.random.default_rng(3).standard_normal((3000, 1))) / 2.0**20
    curves = []
    for mean in (0.0, offset):
        cascade = OctaveCascade(1, 0.01)
        cascade.update(noise + mean)
        cascade.break_()
        cascade.update(noise - mean)
        curves.append(cascade.result().avar)
    np.testing.assert_allclose(curves[1], curves[0], rtol=1e-11)


# --- laws --------------------------------------------------------------------------------------------


@settings(max_examples=40)
@given(
    n=st.integers(0, 3000),
    cuts=st.lists(st.integers(0, 3000), max_size=12),
    seed=st.integers(0, 2**32 - 1),
    loss=st.sampled_from([0.0, 0.002, 0.1, 1.0]),
    gap=st.integers(1, 5000),
)
def test_any_chunking_gives_the_same_bits(n: int, cuts: list[int], seed: int, loss: float, gap: int) -> None:
    rng = np.random.default_rng(seed)
    values = 9.8 + rng.standard_normal((n, 3))
    valid = rng.random((n, 2)) >= loss
    whole, parts = (OctaveCascade(3, 0.01, groups=GROUPS) for _ in range(2))
    edges = sorted({0, n, *(c for c in cuts if c <= n)})
    for ends in (OctaveCascade.break_, lambda cascade: cascade.skip(gap), OctaveCascade.result):
        whole.update(values, None if loss == 0.0 else valid)
        for a, b in pairwise(edges):
            parts.update(values[a:b], valid[a:b])
            parts.result()  # does not change the state
        ends(whole)
        ends(parts)
    same_bits(whole.result(), parts.result())


Step = tuple[str, int]
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("update"), st.integers(0, 900)),
        st.tuples(st.just("skip"), st.integers(1, 4)),
        st.tuples(st.just("skip"), st.integers(1, 5000)),
    ),
    max_size=10,
)


def run(cascade: OctaveCascade, steps: list[Step], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Feed the steps; return the values and the validity on the grid, with missing samples as NaN."""
    values, ok = [np.zeros((0, 3))], [np.zeros((0, 2), dtype=bool)]
    for kind, n in steps:
        if kind == "update":
            values.append(9.8 + rng.standard_normal((n, 3)))
            ok.append(rng.random((n, 2)) < 0.98)
            cascade.update(values[-1], ok[-1])
        else:
            values.append(np.full((n, 3), np.nan))
            ok.append(np.zeros((n, 2), dtype=bool))
            cascade.skip(n)
    return np.concatenate(values), np.concatenate(ok)


@settings(max_examples=40)
@given(steps=STEPS, seed=st.integers(0, 2**32 - 1))
def test_gaps_are_missing_samples(steps: list[Step], seed: int) -> None:
    """Skipping, marking invalid and sending NaN give the same result, which agrees with the definition."""
    cascade = OctaveCascade(3, 0.01, groups=GROUPS)
    values, ok = run(cascade, steps, np.random.default_rng(seed))
    curve = cascade.result()
    same_bits(curve, grouped_curve(np.where(np.isnan(values), 7.0, values), ok, groups=GROUPS))
    with_nan = values.copy()
    with_nan[~ok[:, list(GROUPS)]] = np.nan
    same_bits(curve, grouped_curve(with_nan, groups=GROUPS))
    assert curve.span == len(values)
    np.testing.assert_array_equal(curve.valid, ok.sum(axis=0)[list(GROUPS)])
    check_definition(curve, values, ok, GROUPS)


@settings(max_examples=25)
@given(before=STEPS, after=STEPS, later=STEPS, seed=st.integers(0, 2**32 - 1))
def test_merge_is_one_run_with_a_break(
    before: list[Step], after: list[Step], later: list[Step], seed: int
) -> None:
    one, a, b = (OctaveCascade(3, 0.01, groups=GROUPS) for _ in range(3))
    run(one, before, np.random.default_rng(seed))
    one.break_()
    run(one, after, np.random.default_rng(seed + 1))
    run(a, before, np.random.default_rng(seed))
    run(b, after, np.random.default_rng(seed + 1))
    untouched = b.result()
    a.merge(b)
    same_to_rounding(a.result(), one.result())
    for cascade in (one, a):  # and it continues as that run would
        run(cascade, later, np.random.default_rng(seed + 2))
    same_to_rounding(a.result(), one.result())
    same_bits(b.result(), untouched)


def test_differences_never_span_a_break() -> None:
    """The step between two constants counts within a segment, and not across a break."""
    cascade = OctaveCascade(1, 1.0)
    cascade.update(np.zeros((1000, 1)))
    cascade.break_()
    cascade.break_()  # of nothing
    cascade.update(np.ones((1000, 1)))
    curve = cascade.result()
    assert curve.sections == 2
    assert curve.span == 2000
    assert not curve.avar.any()
    assert curve.m[-1] == 256  # the longest octave with two clusters and a difference in 1000 samples
    assert grouped_curve(np.repeat([[0.0], [1.0]], 1000, axis=0)).avar.any()


def test_a_ten_minute_gap_keeps_the_long_octaves() -> None:
    """24 h at 1 Hz with 600 s missing: a cluster of 10 000 s still has 94 % of its samples."""
    cascade = OctaveCascade(1, 1.0)
    cascade.update(np.random.default_rng(4).standard_normal((40_000, 1)))
    cascade.skip(600)
    cascade.update(np.random.default_rng(5).standard_normal((45_800, 1)))
    curve = cascade.result()
    whole = grouped_curve(np.zeros((86_400, 1)))
    np.testing.assert_array_equal(curve.m, whole.m)
    np.testing.assert_array_equal(curve.terms[curve.m >= 8192], whole.terms[curve.m >= 8192])


def test_a_gap_of_years_is_cheap_and_counts_as_missing() -> None:
    cascade = OctaveCascade(9, 1e-3, groups=[0, 0, 0, 1, 1, 1, 2, 2, 2])
    cascade.update(np.random.default_rng(1).standard_normal((700, 9)))
    cascade.skip(10**12)
    cascade.update(np.random.default_rng(2).standard_normal((700, 9)))
    curve = cascade.result()
    assert curve.span == 10**12 + 1400
    np.testing.assert_array_equal(curve.terms[0], [2 * 699] * 9)


def test_the_state_of_a_long_record_is_bounded() -> None:
    """Four times the samples add two levels of the spectrum, and no block."""
    sizes = []
    for n in (1 << 15, 1 << 17, 1 << 19):
        cascade = OctaveCascade(3, 1e-3)
        cascade.update(np.random.default_rng(1).standard_normal((n, 3)))
        sizes.append(len(pack(cascade)))
        assert len(cascade.blocks.result().means) <= 1024
    assert np.diff(sizes).max() <= 2 * 3 * 8 * 4 * 128 + 8_000


def test_counters_and_clusters_of_ten_billion() -> None:
    """A state written at 10^10 samples continues: no counter overflows, no digit is lost."""
    early, late = OctaveCascade(1, 0.01), OctaveCascade(1, 0.01)
    values = 9.8 + 1e-3 * np.random.default_rng(6).standard_normal((5000, 1))
    early.skip(1 << 17)
    late.skip(10_000_000 << 10)
    for cascade in (early, late):
        cascade.update(values)
    assert late.result().span == 10_240_005_000
    same_to_rounding(replace(late.result(), span=early.span), early.result())


# ---------- lost samples reduce the precision but keep all averaging times and do not bend the curve


LENGTH, CHANNELS = 1 << 17, 12


def signal(kind: str) -> Floats:
    """Return (n, c) noise of one kind."""
    white = np.random.default_rng(0).standard_normal((LENGTH, CHANNELS))
    if kind == "flicker":
        return np.asarray(synthesise(LENGTH, 100.0, N=[0.0] * CHANNELS, B=1.0, K=0.0, seed=2))
    return np.asarray(white if kind == "white" else np.cumsum(white, axis=0))


def received(loss: float, run: int) -> Bools:
    """Return (n, 1) the validity when runs of about `run` samples are lost."""
    generator = np.random.default_rng(1)
    ok = np.ones(LENGTH, dtype=bool)
    if run == 1:
        return np.asarray(generator.random((LENGTH, 1)) > loss)
    at = 0
    while at < LENGTH:
        at += int(generator.exponential(run * (1.0 - loss) / loss)) + 1
        lost = int(generator.exponential(run)) + 1
        ok[at : at + lost] = False
        at += lost
    return ok[:, None]


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("kind", "loss", "run"),
    [
        ("white", 0.5, 1),
        ("walk", 0.1, 100),
        ("flicker", 0.2, 1),
        ("white", 0.05, 1),
        ("white", 0.1, 100),
        ("walk", 0.5, 1),
    ],
)
def test_loss_does_not_bend_the_curve(kind: str, loss: float, run: int) -> None:
    values, ok = signal(kind), received(loss, run)
    expected, curve = curve_of(values, 100.0), curve_of(values, 100.0, ok)
    assert len(curve.m) == len(expected.m)
    ratio = curve.avar[:13].mean(axis=1) / expected.avar[:13].mean(axis=1)
    enough = curve.terms[:13, 0] > 1000 / curve.m[:13]
    assert np.abs(ratio[enough] - 1.0).max() < (0.1 if loss < 0.5 else 0.15)
    assert np.abs(ratio[4:9] - 1.0).max() < 0.08


@pytest.mark.few
@pytest.mark.parametrize(("loss", "run"), [(0.01, 1), (0.1, 1), (0.3, 1), (0.5, 1), (0.1, 100)])
def test_limits_hold_the_truth_with_missing_samples(loss: float, run: int) -> None:
    """95 % of 12; fewer than 9 once in 500 runs. Loss costs precision, at the upper end of the spectrum first."""
    values = synthesise(LENGTH, 40.0, N=[6.1e-5] * CHANNELS, B=2.4e-5, seed=8)
    complete = fits_of(values, 40.0, averaged=True)
    fits = fits_of(values, 40.0, received(loss, run), averaged=True)
    for name, truth in (("N", 6.1e-5), ("B", 2.4e-5)):
        assert held(fits, name, truth) >= 9, name
        assert width(fits, name) < (2.0 if loss <= 0.1 else 6.0) * width(complete, name), name
    assert measured(fits, "K") <= 2


def test_long_holes_cost_the_samples_that_are_missing_and_no_more() -> None:
    """A sixth of an hour in twenty holes of half a minute: they lie in each of the lower segments."""
    values = synthesise(144_000, 40.0, N=[6e-5] * CHANNELS, B=2.4e-5, K=4e-5, seed=5, averaged=False)
    ok = np.ones((144_000, 1), dtype=bool)
    for begin in np.random.default_rng(3).integers(0, 142_800, 20).tolist():
        ok[begin : begin + 1200] = False
    complete, fits = fits_of(values, 40.0), fits_of(values, 40.0, ok)
    assert width(fits, "K") < 1.4 * width(complete, "K")
    assert sum("model_misses" in fit.caveats for fit in fits) <= 1
    for name, truth in (("N", 6e-5), ("B", 2.4e-5), ("K", 4e-5)):
        assert held(fits, name, truth) >= 9, name


# ---------- the docstring of the package lists what it has


def test_masks_and_arrays_of_one_axis_are_handled_and_wrong_shapes_refused() -> None:
    samples = synthesise(3000, 100.0, N=1e-3, seed=1)[:, 0]
    holes = samples.copy()
    holes[100:200] = np.nan
    masked = np.ma.masked_invalid(np.where(np.isnan(holes), 1e9, holes), copy=False)
    masked[100:200] = np.ma.masked
    curves = []
    for values in (holes[:, None], holes, masked):
        cascade = OctaveCascade(1, tau0=0.01)
        cascade.update(values)
        curves.append(cascade.result().sigma.tolist())
    assert curves[0] == curves[1] == curves[2]
    for wrong, valid, words in (
        (np.zeros((3, 500)), None, "transpose"),
        (np.zeros(500), None, "shape"),
        (np.zeros((500, 3)), np.ones(400, bool), "valid must have the shape"),
    ):
        with pytest.raises(ValueError, match=words):
            OctaveCascade(3, tau0=0.01).update(wrong, valid)


def test_a_fit_to_a_curve_alone_says_what_it_cannot_know() -> None:
    curve = curve_of(synthesise(3000, 100.0, N=1e-3, seed=1), 100.0)
    assert fit_curve(curve, averaged=True)[0].caveats == ("unguarded",)
    known = fit_curve(curve, averaged=True, resolution=[0.0], kurtosis=[0.0])[0]
    assert known.caveats == ()
