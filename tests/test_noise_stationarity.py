"""Stationarity: an hour that differs is told, one that does not is not."""

from __future__ import annotations

import pytest

from imumon.noise.allan import OctaveCascade
from imumon.noise.fit import Estimator
from imumon.noise.nonstationarity.change import Behaviour, Change, Estimate, changes
from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.noise.synthesis import synthesise
from imumon.samples import Floats

RATE = 10.0
HOUR = 36_000


def behaviour(values: Floats) -> list[Behaviour]:
    """How each channel behaved over a stretch."""
    cascade = OctaveCascade(values.shape[1], 1 / RATE)
    cascade.update(values)
    fits = Estimator(averaged=True).fit(cascade.result())
    means = values.mean(axis=0).tolist()
    return [Behaviour.of(fit, mean, len(values) / RATE) for fit, mean in zip(fits, means, strict=True)]


def judged(values: Floats) -> list[list[Change]]:
    """Changes of each channel in the last hour."""
    before, last = behaviour(values[:-HOUR]), behaviour(values[-HOUR:])
    return [changes(old, new) for old, new in zip(before, last, strict=True)]


@pytest.mark.parametrize("seed", range(4))
def test_an_ordinary_hour_is_not_told(seed: int) -> None:
    values = synthesise(
        6 * HOUR, RATE, N=[1e-4] * 4, B=[2e-5, 5e-6, 2e-5, 0.0], K=[1e-7, 1e-6, 0, 0], seed=seed
    )
    assert judged(values) == [[], [], [], []]


def test_what_changed_is_told() -> None:
    values = synthesise(6 * HOUR, RATE, N=[1e-4] * 4, B=1e-5, K=1e-8, seed=9)
    values[5 * HOUR :, 1] *= 1.4
    values[5 * HOUR :, 2] += 5e-4
    nothing, louder, moved, also_nothing = judged(values)
    assert nothing == also_nothing == []
    (change,) = [c for c in louder if c.quantity == "N"]
    assert change.ratio == pytest.approx(1.4, rel=0.03)
    (change,) = moved
    assert change.quantity == "bias"
    assert change.now - change.before == pytest.approx(5e-4, rel=0.2)


def test_against_a_saved_baseline() -> None:
    def known(n: float, mean: float) -> Behaviour:
        wander = MeanCovariance(n, 1e-5, 1e-7)
        return Behaviour(Estimate(n, n * 0.99, n * 1.01), Estimate(None, None, 2e-5), mean, wander, 3600.0)

    assert changes(known(1e-4, 0.0), known(1.01e-4, 0.1), None) == []
    (change,) = changes(known(1e-4, 0.0), known(1.4e-4, 0.1), None)
    assert (change.quantity, change.ratio) == ("N", pytest.approx(1.4))
    assert changes(known(1e-4, 0.0), known(1e-4, 0.1), 0.0)[0].quantity == "bias"
