"""Stationarity: an hour that differs is told, one that does not is not, in memory of the logarithm."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.noise.allan import OctaveCascade
from imumon.noise.fit import Estimator
from imumon.noise.stationarity import Behaviour, Change, Estimate, Stationarity, changes
from imumon.noise.synthesis import synthesise
from imumon.noise.wander import Wander
from imumon.samples import Bools, Floats

RATE = 10.0
HOUR = 36_000


class Hourly:
    """A cascade with the mean beside it."""

    def __init__(self) -> None:
        self.cascade = OctaveCascade(4, 1 / RATE)
        self.sum, self.n = np.zeros(4), 0

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        self.cascade.update(values, valid)
        self.sum, self.n = self.sum + values.sum(axis=0), self.n + len(values)

    def skip(self, n: int) -> None:
        self.cascade.skip(n)

    def break_(self) -> None:
        self.cascade.break_()

    def merge(self, other: Hourly) -> None:
        self.cascade.merge(other.cascade)
        self.sum, self.n = self.sum + other.sum, self.n + other.n

    def copy(self) -> Hourly:
        new = Hourly()
        new.cascade, new.sum, new.n = self.cascade.copy(), self.sum, self.n
        return new

    def behaviour(self, c: int, length_s: float) -> Behaviour:
        fit = Estimator(averaged=True).fit(self.cascade.result())[c]
        return Behaviour.of(fit, float(self.sum[c] / self.n), length_s)


def judged(values: Floats) -> list[list[Change]]:
    """Changes of each channel in the last whole hour."""
    hours: Stationarity[Hourly] = Stationarity(Hourly, RATE)
    for i in range(0, len(values), 7000):
        hours.update(values[i : i + 7000])
    before, recent = hours.before(), hours.recent
    assert before is not None
    assert recent is not None
    assert recent[1] == pytest.approx(before[1] + before[2])
    return [changes(before[0].behaviour(c, before[2]), recent[0].behaviour(c, recent[2])) for c in range(4)]


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
    def behaviour(n: float, mean: float) -> Behaviour:
        wander = Wander(n, 1e-5, 1e-7)
        return Behaviour(Estimate(n, n * 0.99, n * 1.01), Estimate(None, None, 2e-5), mean, wander, 3600.0)

    assert changes(behaviour(1e-4, 0.0), behaviour(1.01e-4, 0.1), None) == []
    (change,) = changes(behaviour(1e-4, 0.0), behaviour(1.4e-4, 0.1), None)
    assert (change.quantity, change.ratio) == ("N", pytest.approx(1.4))
    assert changes(behaviour(1e-4, 0.0), behaviour(1e-4, 0.1), 0.0)[0].quantity == "bias"


def test_hours_are_bounded_and_none_is_lost() -> None:
    class Span:
        def __init__(self) -> None:
            self.n = 0

        def update(self, values: Floats, valid: Bools | None = None) -> None:
            self.n += len(values)

        def skip(self, n: int) -> None:
            self.n += n

        def break_(self) -> None:
            pass

        def merge(self, other: Span) -> None:
            self.n += other.n

        def copy(self) -> Span:
            new = Span()
            new.n = self.n
            return new

    hours: Stationarity[Span] = Stationarity(Span, 1.0, 10.0)
    values = np.zeros((7, 1))
    for i in range(3000):
        hours.update(values)
        if i % 5 == 0:
            hours.skip(4)
        if i % 1000 == 0:
            fresh: Stationarity[Span] = Stationarity(Span, 1.0, 10.0)
            fresh.restore(hours.save(), hours.statistics)
            hours = fresh
    total = 3000 * 7 + 600 * 4
    assert sum(s.n for s in hours.statistics) == total
    assert len(hours) < 26
    before, recent = hours.before(), hours.recent
    assert before is not None
    assert recent is not None
    assert recent[0].n == 10
    assert before[0].n == total // 10 * 10 - 10
    hours.skip(10**7)
    hours.update(values)
    assert len(hours) < 26


def test_before_two_hours_nothing_is_said() -> None:
    hours = Stationarity(Hourly, RATE)
    hours.update(np.zeros((HOUR + 10, 4)))
    assert hours.recent is None
    assert hours.before() is None
