"""Laws of windows: the sums since the start of a window are those of a cascade that begins there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.noise.allan import OctaveCascade
from imumon.noise.allan.windows import WindowedCascade
from imumon.noise.blocks.block_means import BLOCK

RNG = np.random.default_rng(11)


def windowed() -> WindowedCascade:
    return WindowedCascade(OctaveCascade(2, 0.01))


def test_a_window_equals_a_cascade_that_begins_there() -> None:
    x = np.cumsum(RNG.normal(size=(40_000, 2)), axis=0) + 100.0
    whole = windowed()
    whole.update(x[: 7 * BLOCK])
    window = whole.open_window()
    whole.update(x[7 * BLOCK :])
    curve = whole.sums_since(window).curve(0.01)
    alone = OctaveCascade(2, 0.01)
    alone.update(x[7 * BLOCK :])
    expected = alone.result()
    k = len(expected.m)
    assert len(curve.m) == k
    assert curve.span == expected.span
    # at most one block of differences is missing at each octave, and none is added
    lost = expected.terms - curve.terms
    assert np.all(lost >= 0)
    assert np.all(lost <= BLOCK / expected.stride[:, None])
    np.testing.assert_allclose(curve.avar[:8], expected.avar[:8], rtol=0.05)


def test_an_early_ramp_has_no_effect_on_a_later_window() -> None:
    x = RNG.normal(size=(60_000, 2))
    ramp = x.copy()
    ramp[: 20 * BLOCK] += np.linspace(1e3, 0, 20 * BLOCK)[:, None]
    curves = []
    for series in (x, ramp):
        one = windowed()
        one.update(series[: 20 * BLOCK])
        window = one.open_window()
        one.update(series[20 * BLOCK :])
        curves.append(one.sums_since(window).curve(0.01))
    np.testing.assert_allclose(curves[0].avar, curves[1].avar, rtol=1e-6)
    np.testing.assert_array_equal(curves[0].terms, curves[1].terms)


@settings(max_examples=25)
@given(st.lists(st.integers(1, 9_000), max_size=5), st.integers(0, 12_000))
def test_any_chunking_gives_the_same_sums(cuts: list[int], at: int) -> None:
    x = np.random.default_rng(5).normal(size=(14_000, 2))
    sums, curves = [], []
    for pieces in ([], cuts):
        one = windowed()
        done, window = 0, None
        for stop in sorted({*(c for c in pieces if c < 14_000), at, 14_000}):
            one.update(x[done:stop])
            done = stop
            if stop == at:
                window = one.open_window()
        if window is None:
            window = one.open_window()
        sums.append(one.sums_since(window))
        curves.append(one.curve_since(window))
    np.testing.assert_array_equal(sums[0].terms, sums[1].terms)
    np.testing.assert_array_equal(sums[0].squares, sums[1].squares)
    one_sums, other_sums = (curve.sums for curve in curves)
    assert one_sums is not None
    assert other_sums is not None
    np.testing.assert_array_equal(one_sums.blocks.means, other_sums.blocks.means)
    for own, other in zip(one_sums.levels, other_sums.levels, strict=True):
        np.testing.assert_array_equal(own.power, other.power)
        np.testing.assert_array_equal(own.averages, other.averages)


def test_window_sums_add_up_to_merged_cascades() -> None:
    x = RNG.normal(size=(30 * BLOCK, 2))
    one = windowed()
    parts = []
    for start in range(0, len(x), 10 * BLOCK):
        window = one.open_window()
        one.update(x[start : start + 10 * BLOCK])
        parts.append(one.sums_since(window))
        one.close_window(window)
    total = (parts[0] + parts[1] + parts[2]).curve(0.01)
    merged = OctaveCascade(2, 0.01)
    for start in range(0, len(x), 10 * BLOCK):
        piece = OctaveCascade(2, 0.01)
        piece.update(x[start : start + 10 * BLOCK])
        merged.merge(piece)
    expected = merged.result()
    assert total.span == expected.span
    assert total.segments == expected.segments
    np.testing.assert_allclose(total.avar[:6], expected.avar[:6], rtol=0.15)


def test_gaps_and_breaks_are_counted() -> None:
    x = RNG.normal(size=(20_000, 2))
    one = windowed()
    one.update(x[:3000])
    window = one.open_window()
    one.update(x[3000:6000])
    one.break_()
    one.update(x[6000:9000])
    one.skip(10**6)
    one.update(x[9000:])
    sums = one.sums_since(window)
    assert sums.span == 20_000 + 10**6 - window.start
    assert sums.valid[0] == 20_000 - window.start
    assert sums.segments == 2
    assert np.all(sums.squares >= -1e-9)


def test_saved_windows_continue() -> None:
    x = RNG.normal(size=(50_000, 2))
    one = windowed()
    one.update(x[:5000])
    one.open_window()
    one.update(x[5000:20_000])
    again = WindowedCascade.restore(one.save())
    for each in (one, again):
        each.update(x[20_000:])
    a, b = one.sums_since(one.windows[0]), again.sums_since(again.windows[0])
    np.testing.assert_array_equal(a.squares, b.squares)
    np.testing.assert_array_equal(a.terms, b.terms)


def test_a_window_at_the_start_is_the_whole_record() -> None:
    x = RNG.normal(size=(5000, 2))
    one = windowed()
    window = one.open_window()
    one.update(x)
    expected = one.cascade.result()
    curve = one.sums_since(window).curve(0.01)
    np.testing.assert_array_equal(curve.terms, expected.terms)
    assert curve.avar == pytest.approx(expected.avar)


def test_the_sums_of_the_noise_of_a_window_are_those_of_a_cascade_that_begins_there() -> None:
    """Segments may begin up to a hop later, and the filters have a history; blocks lie on the grid of the record."""
    x, at = np.random.default_rng(7).normal(size=(60_000, 2)), 64 * BLOCK
    one, alone = windowed(), OctaveCascade(2, 0.01)
    one.update(x[:at])
    window = one.open_window()
    one.update(x[at:])
    alone.update(x[at:])
    own, other = one.curve_since(window).sums, alone.result().sums
    assert own is not None
    assert other is not None
    assert own.pooled
    assert not other.pooled
    for level, (a, b) in enumerate(zip(own.levels, other.levels, strict=False)):
        assert abs(int(a.averages[0]) - int(b.averages[0])) <= 2
        if level < 3:
            np.testing.assert_allclose(a.power.sum(axis=1), b.power.sum(axis=1), rtol=0.05)
    whole = one.cascade.blocks.result()
    first = -(-at // whole.length)
    np.testing.assert_array_equal(own.blocks.means, whole.means[first : first + len(own.blocks.means)])
    again = WindowedCascade.restore(one.save())
    restored = again.curve_since(again.windows[0]).sums
    assert restored is not None
    np.testing.assert_array_equal(restored.blocks.means, own.blocks.means)
    for a, b in zip(restored.levels, own.levels, strict=True):
        np.testing.assert_array_equal(a.power, b.power)
