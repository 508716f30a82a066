"""A second correlated term: a class, a row of the coefficients, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.signal

from imumon.model import coefficients
from imumon.model.samples import Floats
from imumon.noise import OctaveCascade, fit_curve, synthesise
from imumon.noise.fit import markov_search
from imumon.noise.fit.model import TRIED, TimedTerm

RATE, N = 40.0, 6.1e-5


@dataclass(frozen=True, slots=True)
class SecondOrder(TimedTerm):
    """Second-order Gauss–Markov noise, critically damped: covariance (1 + |t|/T) exp(-|t|/T)."""

    def rate_density(self, f: Floats) -> Floats:
        return np.asarray(4.0 * self.time / (1.0 + (2.0 * np.pi * f * self.time) ** 2) ** 2)

    def phase_autocovariance(self, lag: Floats) -> Floats:
        # minus half of the variance of the integral, which is 2 T^2 (2 x - 3 + (3 + x) exp(-x))
        x = lag / self.time
        return np.asarray(-(self.time**2) * (2.0 * x - 3.0 + (3.0 + x) * np.exp(-x)))


def second_order(n: int, time_s: float, seed: int) -> Floats:
    """Return (n,) such noise of standard deviation 1: white noise through two equal low-passes."""
    a = np.exp(-1.0 / (RATE * time_s))
    white = np.random.default_rng(seed).standard_normal(n + 20_000)
    twice = scipy.signal.lfilter([1.0], [1.0, -2.0 * a, a * a], white)[20_000:]
    return np.asarray(twice * np.sqrt((1.0 - a * a) ** 3 / (1.0 + a * a)))


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    row = replace(coefficients.COEFFICIENTS["M"], letter="W", about="second-order correlated noise")
    monkeypatch.setitem(coefficients.COEFFICIENTS, "W", row)  # type: ignore[arg-type]
    monkeypatch.setattr(markov_search, "TRIED", (*TRIED, SecondOrder("W", 1.0)))


@pytest.mark.usefixtures("registered")
def test_a_second_correlated_term_is_measured_and_the_first_one_stays() -> None:
    n, sigma, time_s = 144_000, 3e-4, 4.0
    values = synthesise(n, RATE, N=[N, N], seed=3, averaged=False)
    values[:, 0] += sigma * second_order(n, time_s, 5)
    a = np.exp(-1.0 / (RATE * time_s))
    drive = np.random.default_rng(6).standard_normal(n) * np.sqrt(1.0 - a * a)
    values[:, 1] += sigma * scipy.signal.lfilter([1.0], [1.0, -a], drive)
    cascade = OctaveCascade(2, tau0=1.0 / RATE)
    cascade.update(values)
    second, first = fit_curve(cascade.result(), averaged=False)
    own = second.coefficients["W"]
    assert own.status == "measured"
    assert own.low <= sigma <= own.high
    assert second.markov is None
    assert second.N.low <= N <= second.N.high
    assert second.B.status == second.K.status == "upper_bound"
    assert "model_misses" not in second.caveats
    assert first.markov.sigma.low <= sigma <= first.markov.sigma.high
    assert "W" not in first.coefficients
