"""Laws of Gauss–Markov noise: its expectations, its limits beside B and K, and that it is not invented."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy
import scipy.fft
import scipy.signal
from noise_fits import fits_of

from imumon.model import coefficients
from imumon.model.samples import Floats
from imumon.noise import ChannelFit, markov_law, synthesise
from imumon.noise.fit import timed_search
from imumon.noise.fit.curve_statement import bounded_by_curve
from imumon.noise.fit.likelihood import Surface, quantiles
from imumon.noise.fit.model import (
    FLICKER,
    TRIED,
    WALK,
    WHITE,
    GaussMarkov,
    NoiseTerm,
    TimedTerm,
    WanderingLine,
)
from imumon.noise.fit.timed_search import TimedSurface, mixed_with

RATE_HZ, LENGTH, N = 10.0, 50_000, 6.8e-4


@pytest.mark.parametrize("time", [0.3, 10.0, 300.0])
def test_the_formulas_are_those_of_the_autocovariance(time: float) -> None:
    zero, one, ratio = markov_law.average_autocovariance(time)
    by_lag = np.concatenate(([zero], one * ratio ** np.arange(199.0)))
    covariance = scipy.linalg.toeplitz(by_lag)
    cosines = scipy.fft.dct(scipy.fft.dct(covariance, axis=0, norm="ortho"), axis=1, norm="ortho")
    assert GaussMarkov("M", time).cosine_variances(200, 1) == pytest.approx(np.diag(cosines)[1:], rel=1e-9)
    m = np.array([1, 4, 50])
    of_sums = [covariance[:k, :k].sum() for k in (1, 4, 50)]
    of_doubles = [covariance[:k, :k].sum() for k in (2, 8, 100)]
    expected = (4.0 * np.array(of_sums) - of_doubles) / (2.0 * m**2)
    assert markov_law.allan_variances(m, time, averaged=True) == pytest.approx(expected, rel=1e-9)
    # a term that has no closed form takes the same from its density and the covariance of its integral
    markov, f = GaussMarkov("M", time), np.array([1e-4, 1e-3])
    assert TimedTerm.cosine_variances(markov, 200, 1) == pytest.approx(np.diag(cosines)[1:], rel=1e-6)
    assert TimedTerm.allan_variances(markov, m, averaged=True) == pytest.approx(expected, rel=1e-6)
    assert TimedTerm.density(markov, f, averaged=True) == pytest.approx(
        markov.density(f, averaged=True), rel=0.01
    )
    differences = GaussMarkov("M", time).difference_covariances(np.array([64]))[0]
    assert differences[0] == pytest.approx(
        2.0 * markov_law.allan_variances(np.array([64]), time, averaged=True)[0], rel=1e-6
    )


@pytest.mark.parametrize("length", [1, 8, 100])
def test_a_line_that_wanders_has_the_covariance_of_its_density(length: int) -> None:
    line, f = WanderingLine("line", 50.0), np.linspace(0.0, 0.2, 200_001)
    seen = line.rate_density(f) * np.sinc(f * length) ** 2
    lags = [0, 1, 2, 5]
    expected = [2.0 * np.trapezoid(seen * np.cos(2.0 * np.pi * f * length * lag), f) for lag in lags]
    assert line.with_time(50.0 / length).autocovariance(64)[lags] == pytest.approx(expected, abs=1e-9)
    assert 2.0 * np.trapezoid(line.rate_density(f), f) == pytest.approx(1.0)


@pytest.mark.parametrize("level", [0, 4])
@pytest.mark.parametrize(("time", "other", "power"), [(1e7, WALK, 2e-7), (0.01, WHITE, 0.02)])
def test_it_tends_to_a_walk_and_to_white_noise(level: int, time: float, other: object, power: float) -> None:
    markov = GaussMarkov("M", time)
    if other is WHITE and level == 0:
        return  # at the highest frequencies, averages of it still differ
    expected = power * other.bin_expectation(level, averaged=True, window=1)  # type: ignore[attr-defined]
    assert markov.bin_expectation(level, averaged=True, window=1) == pytest.approx(expected, rel=0.02)
    if other is WALK:
        f = np.arange(1, 129) / 256 / 2.0**level
        for averaged in (True, False):  # what missing samples let leak
            seen = markov.seen_density(f, averaged=averaged, window=3)
            assert seen == pytest.approx(power * WALK.seen_density(f, averaged=averaged, window=3), rel=1e-3)


def first_order(n: int, count: int, samples: float, rng: np.random.Generator) -> Floats:
    """Return (n, count) Gauss–Markov noise of standard deviation 1, with a time constant of some samples."""
    a = np.exp(-1.0 / samples)
    drive = np.sqrt(1.0 - a * a) * rng.standard_normal((n, count))
    drive[0] /= np.sqrt(1.0 - a * a)
    return np.asarray(scipy.signal.lfilter([1.0], [1.0, -a], drive, axis=0))


def records(
    count: int, seed: int, sigma: float = 0.0, time_s: float = 1.0, B: float = 0.0
) -> tuple[ChannelFit, ...]:
    """Return the fits of some records of white noise, flicker and Gauss–Markov noise."""
    values = sigma * first_order(LENGTH, count, RATE_HZ * time_s, np.random.default_rng(seed))
    noise = [synthesise(LENGTH, RATE_HZ, N=N, B=B, seed=100 * seed + k)[:, 0] for k in range(count)]
    return fits_of(values + np.stack(noise, axis=1), RATE_HZ)


def test_correlated_noise_is_measured_and_no_b_or_k_is_invented() -> None:
    fits = records(12, 1, sigma=4e-4, time_s=30.0)
    assert all(fit.markov is not None for fit in fits)
    held = [
        fit.markov.sigma.low <= 4e-4 <= fit.markov.sigma.high  # type: ignore[union-attr,operator]
        and fit.markov.time_constant_s.low <= 30.0 <= fit.markov.time_constant_s.high  # type: ignore[union-attr,operator]
        for fit in fits
    ]
    assert sum(held) >= 10
    assert sum(fit.B.status == "measured" for fit in fits) <= 1
    assert sum(fit.K.status == "measured" for fit in fits) <= 1
    assert sum(fit.N.low <= N <= fit.N.high for fit in fits) >= 9  # type: ignore[operator]
    term, octaves = GaussMarkov("M", RATE_HZ * 30.0), np.array([10])
    bounded = bounded_by_curve(fits[0], {term: fits[0].shares["M"]}, octaves, 2.0 * fits[0].high)
    assert bounded.markov.sigma.status == "upper_bound"  # where the curve leaves the octaves that it decides
    for fit in fits:  # the shares add up to the drawn model
        assert set(fit.shares) == {"N", "B", "K", "M", "lines", "columns", "filter"}
        assert np.sum(list(fit.shares.values()), axis=0) == pytest.approx(fit.model**2)


def test_flicker_is_no_correlated_noise() -> None:
    fits = records(8, 2, B=1.5e-4)
    assert sum(fit.markov is None for fit in fits) >= 7
    assert sum(fit.B.low <= 1.5e-4 <= fit.B.high for fit in fits) >= 7  # type: ignore[operator]


def test_what_the_record_does_not_tell_apart_is_indistinct_with_bounds() -> None:
    """Odds between even and certain: M, and what it may be instead, are bounds that hold the truth."""
    fits = [fit for fit in records(12, 3, sigma=1.6e-4, time_s=50.0) if fit.markov is not None]
    open_fits = [fit for fit in fits if fit.markov.sigma.status == "indistinct"]  # type: ignore[union-attr]
    assert open_fits
    for fit in open_fits:
        assert fit.markov.sigma.value is None
        assert "does not distinguish it from" in (fit.markov.sigma.reason or "")
        assert fit.markov.sigma.high is not None


@pytest.mark.few
def test_b_holds_beside_a_weak_hum_that_may_be_correlated_noise() -> None:
    """A hum that wanders by two thirds of its frequency, of a tenth of the noise: no record shows what it is."""
    n, count, rng = 72_000, 40, np.random.default_rng(3)
    steps = first_order(n, count, 60.0 * 20.0, rng)
    hum = np.sin(2.0 * np.pi * (np.cumsum(0.03 + 0.02 * steps, axis=0) / 20.0 + rng.random(count)))
    noise = [synthesise(n, 20.0, N=6.1e-5, B=2.4e-5, seed=k, averaged=False)[:, 0] for k in range(count)]
    fits = fits_of(np.stack(noise, axis=1) + 0.1 * 6.1e-5 * np.sqrt(40.0) * hum, 20.0)
    assert sum(fit.B.low <= 2.4e-5 <= fit.B.high for fit in fits) >= 35  # type: ignore[operator]
    assert sum(fit.K.status == "measured" for fit in fits) <= 1
    assert sum(fit.markov is not None and fit.markov.sigma.status == "measured" for fit in fits) <= 3


@pytest.mark.slow
def test_a_likelihood_with_correlated_noise_has_no_weight_outside_of_its_grid() -> None:
    """Far outside of its points, a cubic may have any value: there, M would add B or K that the record excludes."""
    markov = GaussMarkov("M", 100.0)
    inner = surface(
        {
            FLICKER: np.linspace(2.0, 3.0, 10),
            WALK: np.linspace(0.0, 1.0, 10),
            markov: np.linspace(0.5, 1.5, 10),
        }
    )
    without = surface({FLICKER: np.linspace(0.0, 3.0, 20), WALK: np.linspace(0.0, 1.0, 20)})
    with_term = TimedSurface(inner, markov, (markov,), np.ones(1), 1e6, inner.powers)
    both = mixed_with(without, with_term)
    for term in (FLICKER, WALK):
        expected = quantiles(inner, term, np.array([0.025, 0.5, 0.975]))
        assert quantiles(both, term, np.array([0.025, 0.5, 0.975])) == pytest.approx(
            expected, abs=0.08
        )  # half a cell of the wider grid


def surface(grids: dict[NoiseTerm, Floats]) -> Surface:
    """Return a likelihood that is largest in the middle of each grid."""
    centers = [(grid - grid[0]) / np.ptp(grid) for grid in grids.values()]
    axes = np.meshgrid(*centers, indexing="ij")
    # its cubic rises far below the points
    log = sum(-60.0 * (axis - 0.5) ** 2 - 40.0 * (axis - 0.5) ** 3 for axis in axes)
    m = np.size(log)
    none = np.zeros((m, 0))
    return Surface(grids, np.ravel(log), {WHITE: np.ones(m)}, {WHITE: np.ones(m)}, np.zeros(m), none, none)


def test_a_mean_that_moves_once_is_no_walk() -> None:
    """It has power in the lowest coefficients only: K is a bound, B keeps its limits, and the drawn model its curve."""
    rng = np.random.default_rng(5)
    rate, n, records = 5.0, 36_000, 16
    t = np.linspace(0.0, 1.0, n)[:, None]
    place = rng.uniform(0.25, 0.75, records)
    rise_and_fall = np.exp(-0.5 * ((t - place) / rng.uniform(0.08, 0.2, records)) ** 2)
    passage = np.tanh((t - place) / rng.uniform(0.08, 0.2, records))
    noise = synthesise(n, rate, N=[6.1e-5] * records, B=2.4e-5, seed=rng, averaged=False)
    for moved in (3e-4 * rise_and_fall, 2e-4 * passage):
        fits = fits_of(noise + moved, rate)
        assert sum(fit.K.status == "measured" for fit in fits) <= 2
        assert "a mean that moves slowly explains it" in {fit.K.reason for fit in fits}
        assert sum(not fit.B.low <= 2.4e-5 <= fit.B.high for fit in fits if fit.B.low is not None) <= 2
        assert not any(fit.oscillations_s for fit in fits)
        assert sum("model_misses" in fit.caveats for fit in fits) <= 1
        for fit in fits:  # what moved the mean is drawn, and the parts add up
            np.testing.assert_allclose(sum(fit.shares.values()), fit.model**2, rtol=1e-9, atol=1e-30)


@pytest.mark.slow
def test_the_bound_of_a_walk_in_the_lowest_coefficients_holds_it() -> None:
    """A walk that hardly shows beyond the lowest coefficients may be taken for a slow mean: its bound counts it."""
    rate, n, records, K = 5.0, 18_000, 48, 3e-6
    fits = fits_of(synthesise(n, rate, N=[6.1e-5] * records, B=2.4e-5, K=K, seed=3, averaged=False), rate)
    slow = [fit for fit in fits if fit.K.reason == "a mean that moves slowly explains it"]
    assert slow
    assert sum(fit.K.high is not None and fit.K.high < K for fit in fits) <= 3


@pytest.mark.slow
def test_slow_markov_noise_is_no_walk() -> None:
    """A time constant of a 36th of the record: where M explains it better than K, K is not measured."""
    rng = np.random.default_rng(12)
    rate, sigma, time_s, n, records = 5.0, 4.8e-5, 200.0, 36_000, 24
    values = sigma * first_order(n, records, rate * time_s, rng)
    values += synthesise(n, rate, N=[6.1e-5] * records, B=2.4e-5, seed=rng, averaged=False)
    fits = fits_of(values, rate)
    assert sum(fit.K.status == "measured" for fit in fits) <= 2
    reasons = {fit.K.reason for fit in fits if fit.K.status == "indistinct"}
    assert "the record does not distinguish it from M" in reasons
    assert all(fit.K.low == 0.0 for fit in fits if fit.K.status == "indistinct")


RATE_40, WHITE_N = 40.0, 6.1e-5


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
    a = np.exp(-1.0 / (RATE_40 * time_s))
    white = np.random.default_rng(seed).standard_normal(n + 20_000)
    twice = scipy.signal.lfilter([1.0], [1.0, -2.0 * a, a * a], white)[20_000:]
    return np.asarray(twice * np.sqrt((1.0 - a * a) ** 3 / (1.0 + a * a)))


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    row = replace(coefficients.COEFFICIENTS["M"], letter="W", about="second-order correlated noise")
    monkeypatch.setitem(coefficients.COEFFICIENTS, "W", row)  # type: ignore[arg-type]
    monkeypatch.setattr(timed_search, "TRIED", (*TRIED, SecondOrder("W", 1.0)))


@pytest.mark.usefixtures("registered")
def test_a_second_correlated_term_is_measured_and_the_first_one_stays() -> None:
    n, sigma, time_s = 144_000, 3e-4, 4.0
    values = synthesise(n, RATE_40, N=[WHITE_N, WHITE_N], seed=3, averaged=False)
    values[:, 0] += sigma * second_order(n, time_s, 5)
    values[:, 1] += sigma * first_order(n, 1, RATE_40 * time_s, np.random.default_rng(6))[:, 0]
    second, first = fits_of(values, RATE_40)
    own = second.coefficients["W"]
    assert own.status == "measured"
    assert own.low <= sigma <= own.high
    assert second.markov is None
    assert second.N.low <= WHITE_N <= second.N.high
    assert second.B.status == second.K.status == "upper_bound"
    assert "model_misses" not in second.caveats
    assert first.markov.sigma.low <= sigma <= first.markov.sigma.high
    assert "W" not in first.coefficients
