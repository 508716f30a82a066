"""Differences: the robust deviation and the kurtosis of known noise, for any blocks."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.model.samples import Floats
from imumon.model.saved_state import pack, unpack
from imumon.noise.statistics.differences import BURST, DENSE, PERIOD, DifferenceAccumulator

N = 1_000_000


def accumulated(x: Floats, groups: tuple[int, ...] = (0,)) -> DifferenceAccumulator:
    differences = DifferenceAccumulator(groups)
    for at in range(0, len(x), 7777):
        differences.update(x[at : at + 7777])
    return differences


@pytest.mark.few
@pytest.mark.parametrize("scale", [1e-6, 0.3, 9.8])
def test_gaussian_noise_has_a_ratio_of_one(scale: float) -> None:
    x = scale * np.random.default_rng(1).standard_normal((N, 1))
    differences = accumulated(x + 9.8)
    (robust,) = differences.result([0.0])
    assert robust.sigma == pytest.approx(scale, rel=0.015)
    assert robust.ratio == pytest.approx(1.0, abs=0.012)
    assert not robust.disagrees
    assert differences.fast_kurtosis() == pytest.approx(0.0, abs=0.15)


@pytest.mark.few
@pytest.mark.parametrize("steps", [3.2, 4.0, 7.5, 20.0])
def test_quantised_noise_has_a_ratio_of_one(steps: float) -> None:
    x = np.rint(steps * np.random.default_rng(2).standard_normal((N, 1))) * 0.1
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
    x = rng.standard_normal((N, 1)) * np.where(rng.random((N, 1)) < 0.05, 10.0, 1.0)
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
