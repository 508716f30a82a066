"""Laws of the running moments, and their agreement with the batch definitions."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

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
