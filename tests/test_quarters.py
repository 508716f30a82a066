"""Quarters of a record: scatter of N, B and K, independent of chunks, kept by a saved state."""

from __future__ import annotations

import numpy as np

from imumon.noise import OctaveCascade, synthesise
from imumon.noise.allan.windows import WindowedCascade
from imumon.noise.fit.estimator import point_estimates
from imumon.noise.nonstationarity.quarters import Quarters

RATE = 100.0
N = 1e-4


def fed(values: np.ndarray, chunk: int) -> tuple[WindowedCascade, Quarters]:
    """Return a cascade and its quarters after some samples."""
    cascade = WindowedCascade(OctaveCascade(values.shape[1], 1.0 / RATE))
    quarters = Quarters(cascade, RATE)
    at = 0
    while at < len(values):
        stop = min(len(values), at + chunk, quarters.next_end)
        cascade.update(values[at:stop])
        quarters.close_stretch()
        at = stop
    return cascade, quarters


def noise(n: int, scale: np.ndarray | float = 1.0) -> np.ndarray:
    return np.column_stack([synthesise(n, RATE, N, 0.0, 0.0, seed) for seed in range(2)]) * scale


def test_the_quarters_follow_a_change_of_n() -> None:
    n = 64 * 1024
    scale = np.repeat([1.0, 1.1, 1.2, 1.3], n // 4)[:, None]
    sums = fed(noise(n, scale), 999)[1].result()
    assert sums is not None
    found = [point_estimates(each.curve(1.0 / RATE), averaged=[False] * 2)[:, 0] for each in sums]
    np.testing.assert_allclose(
        np.array(found).T / N, [[1.0, 1.1, 1.2, 1.3]] * 2, rtol=0.05
    )  # the last stretch is incomplete


def test_the_quarters_do_not_depend_on_chunks() -> None:
    values = noise(30_000)
    whole, parts = (fed(values, chunk)[1].result() for chunk in (30_000, 777))
    assert whole is not None
    assert parts is not None
    for one, two in zip(whole, parts, strict=True):
        np.testing.assert_allclose(one.squares, two.squares, rtol=1e-12)
        assert one.span == two.span


def test_a_saved_state_continues() -> None:
    values = noise(40_000)
    cascade, quarters = fed(values[:20_000], 20_000)
    restored = WindowedCascade.restore(cascade.save())
    copy = Quarters.restore(restored, RATE, quarters.save())
    assert copy.next_end == quarters.next_end
    for one, two in zip(quarters.result() or [], copy.result() or [], strict=True):
        np.testing.assert_array_equal(one.squares, two.squares)
        np.testing.assert_array_equal(one.terms, two.terms)


def test_stretches_before_the_end_of_a_warm_up_are_forgotten() -> None:
    _, quarters = fed(noise(16 * 1024), 1024)
    before = quarters.result()
    assert before is not None
    quarters.discard_before(6 * 1024)
    after = quarters.result()
    assert after is not None
    assert sum(each.span for each in after) <= 16 * 1024 - 6 * 1024
    quarters.discard_before(15 * 1024)
    assert quarters.result() is None
