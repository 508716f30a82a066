"""Hourly statistics: warm-ups are excluded, hours are compared, for any chunking."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from imumon.noise.allan import AllanCurve
from imumon.noise.fit import ChannelFit, fit_curve
from imumon.noise.nonstationarity import HourlyStatistics
from imumon.noise.statistics.moments import Moments
from imumon.noise.synthesis import synthesise

RATE = 4.0
N, B = 6.1e-5, 2.4e-5


def fit(curve: AllanCurve) -> Sequence[ChannelFit]:
    return fit_curve(curve, averaged=True)


def history() -> HourlyStatistics:
    return HourlyStatistics([0, 0, 0], 3, 1.0 / RATE, fit, warmup_channels=(0, 1, 2))


def noise(hours: float, seed: int) -> np.ndarray:
    return synthesise(round(hours * 3600 * RATE), RATE, N=[N] * 3, B=B, K=0.0, seed=seed)


def run_history(values: np.ndarray, cuts: Sequence[int] = ()) -> HourlyStatistics:
    record = history()
    edges = [0, *cuts, len(values)]
    for start, end in pairwise(edges):
        record.update(values[start:end])
    return record


@pytest.fixture(scope="module")
def warm() -> np.ndarray:
    """Return two hours that begin with an exponential with a time constant of 5 min."""
    x = noise(2.2, 3)
    t = np.arange(len(x)) / RATE
    return x + 1e-3 * np.exp(-t / 300.0)[:, None]


def test_quiet_record_has_no_warm_up_and_no_change() -> None:
    x = noise(3.2, 1)
    record = run_history(x)
    assert record.warmup_s == 0.0
    assert record.changes() == {}
    assert len(record.hours()) == 3 - 1  # of three, the older two joined
    alone = Moments(3)
    alone.update(x)
    for own, other in zip(record.moments().channels, alone.result().channels, strict=True):
        assert own.count == other.count
        assert own.std == pytest.approx(other.std, rel=1e-12)


def test_warm_up_is_excluded(warm: np.ndarray) -> None:
    record = run_history(warm)
    assert 600.0 <= record.warmup_s <= 2400.0
    after = warm[round(record.warmup_s * RATE) :]
    assert record.moments().channels[0].count == len(after)
    assert record.moments().channels[0].mean == pytest.approx(after[:, 0].mean(), rel=1e-9)
    (first, *_) = fit(record.curve())
    assert first.K.status != "measured"
    assert first.N.value == pytest.approx(N, rel=0.05)


def test_a_faint_warm_up_is_excluded() -> None:
    """A random walk of the fitted size may be as large, but does not follow an exponential."""
    x = synthesise(round(3000.5 * RATE), RATE, N=[N] * 3, seed=8)
    x[:, 1] += 1.5e-4 * np.exp(-np.arange(len(x)) / RATE / 600.0)
    record = run_history(x)
    assert record.warmup_s == 1200.0
    assert fit(record.curve())[1].K.status != "measured"


def test_any_chunking_gives_the_same(warm: np.ndarray) -> None:
    one, many = run_history(warm), run_history(warm, [7, 480, 481, 5000, 14_400, 20_001])
    assert one.warmup_s == many.warmup_s
    np.testing.assert_array_equal(one.curve().terms, many.curve().terms)
    np.testing.assert_allclose(one.curve().avar, many.curve().avar, rtol=1e-12)


def test_saved_history_continues(warm: np.ndarray) -> None:
    one = run_history(warm[:16_000])
    again = history()
    again.restore(one.save())
    for each in (one, again):
        each.update(warm[16_000:])
    assert again.warmup_s == one.warmup_s
    np.testing.assert_array_equal(again.curve().avar, one.curve().avar)
    assert [h.start for h in again.hours()] == [h.start for h in one.hours()]


def test_noisier_hour_is_a_change() -> None:
    x = noise(3.1, 4)
    x[round(2 * 3600 * RATE) :, 1] *= 1.5
    record = run_history(x)
    changes = record.changes()
    assert list(changes) == [1]
    grown = next(change for change in changes[1] if change.quantity == "N")
    assert grown.ratio == pytest.approx(1.5, rel=0.1)
    restored = history()
    restored.restore(record.save())
    assert restored.changes() == changes


def test_a_gap_of_a_month_costs_little() -> None:
    record = history()
    record.update(noise(2.0, 6))
    record.skip(round(30 * 86400 * RATE))
    record.update(noise(1.0, 7))
    assert record.position == round((30 * 86400 + 3 * 3600) * RATE)
    assert record.moments().channels[0].count == round(3 * 3600 * RATE)


def test_warm_up_counts_valid_samples_only(warm: np.ndarray) -> None:
    """Missing and excluded samples within it are counted elsewhere."""
    ok = np.ones((len(warm), 1), dtype=bool)
    ok[100:300] = False
    record = history()
    record.update(warm[:1000], ok[:1000])
    record.skip(200)
    record.update(warm[1200:], ok[1200:])
    total = len(warm) - 400
    assert record.warmup_s > 0.0
    assert record.moments().channels[0].count + round(record.warmup_s * RATE) == total
    again = history()
    again.restore(record.save())
    assert again.warmup_s == record.warmup_s
