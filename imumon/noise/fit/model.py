"""Model of the noise of one channel: its terms, and what every statistic expects of each.

A sensor at rest measures y(t) = constant + regressors + noise. The regressors are what moves the mean and is not random
(`regressors`). The noise is a sum of independent processes, the terms of this module. Each is given by its two-sided
spectral density of the rate (IEEE Std 952-1997, IEEE Std 1139-2008):

| term | density of the rate | Allan variance |
|---|---|---|
| white noise, N | N^2 | N^2 / tau |
| flicker, B | B^2 / (2 pi f) | (2 ln 2 / pi) B^2 |
| random walk, K | K^2 / (2 pi f)^2 | K^2 tau / 3 |
| quantisation, Q | (Q^2 / tau0) 4 sin^2(pi f tau0) | 3 Q^2 / tau^2 |
| Gauss–Markov, M | 2 s^2 T / (1 + (2 pi f T)^2) | at most (0.617 s)^2, at tau = 1.89 T |
| line that wanders | s^2 times a normal density about ±1 / (2 pi T) | of its autocovariance |

A term has a *power*: the square of its coefficient in units of the sampling interval tau0, so that all powers are
(channel unit)^2: N^2 / tau0, B^2, K^2 tau0, (Q / tau0)^2, s^2. Frequencies are in cycles per sample. Everything that a
statistic expects is linear in the powers,

    expectation of a statistic = sum over terms of power * (expectation of the term with power 1)

and a term is the object that knows these unit expectations:

| statistic | where | method |
|---|---|---|
| density of the samples | drawn model | `density` |
| bin of a Welch spectrum, behind the filters of its level | bands of the likelihood | `bin_expectation` |
| density of the samples behind a moving average | what leaks beside missing samples | `seen_density` |
| cosine coefficient of block means | single coefficients of the likelihood | `cosine_variances` |
| Allan variance | drawn model | `allan_variances` |
| covariance of the differences of the Allan variance | limits of the curve | `difference_covariances` |
| information about it in a longer record | `time_to` | `rate_density` |

Likelihood, search, statement and curve go through tuples of terms and ask each what they need (`grows`,
`is_correlated`, `is_of_sensor`, `is_stated`, `time_letter`). They name white noise, which is the first of the scored
terms, and quantisation. A new term is one class, a place in one of the tuples below, and its row in `coefficients`: its
coefficient then is among those of the fit. The drawn model, its shares, the limits of the curve and `time_to` follow
from its power. A term with a time constant needs two formulas: `rate_density` and `phase_autocovariance`.

What is not noise with a density is no term. A line that keeps its frequency is a set of bins that are left out
(`spectrum.spectral_lines`); one that wanders is a term, which the report does not state (`is_stated`), but names. A
slow oscillation, a step or a drift is a regressor: a builder in `regressors` and a candidate in `slow_terms`.

Three roles. *Gridded* terms (B and K, in every fit) span the grid on which the likelihood is computed: they trade
against each other, their likelihoods are skewed, and their limits are quantiles. *Scored* terms are profiled at each
point of the grid by Fisher's scoring, because the model is linear in them and the bands show them well (N), or they
hardly disturb the others (Q); the single coefficients do not move them, so that no slow term can be scored. *Terms that
are tried* (`TRIED`: M, and a line that wanders) have a time constant (`TimedTerm`), and a search for one record asks
for observations that expect each of several (`spectral_powers`, `BlockSeries.with_terms`), puts them on a grid of their
own, and passes the one to state on as `Surface.beside`. The likelihood is summed over all kinds.

Example: the Allan variance of N = B = K = 1 at clusters of 4 samples that are true averages.

>>> m = np.array([4])
>>> [round(float(term.allan_variances(m, averaged=True)[0]), 4) for term in NOISE_TERMS]
[0.25, 0.4413, 1.3333]
>>> total({WHITE: 4.0, WALK: 3.0}, lambda term: term.allan_variances(m, averaged=True))
array([5.])
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from functools import lru_cache
from typing import Self, TypeAlias

import numpy as np

from imumon.model.coefficients import COEFFICIENTS, MARKOV
from imumon.model.samples import Floats, Ints
from imumon.noise import markov_law
from imumon.noise.allan.octave import RATIO
from imumon.noise.power_law import (
    EXACT,
    cosine_variances,
    cosine_variances_of,
    phase_autocovariance,
    sampled_density,
)
from imumon.noise.spectrum.expectation import (
    seen_by_bins,
    short_term_density,
    window_power,
)

LAGS = 12
"""Lags over which the covariance of differences is summed. Unit: clusters.

Otherwise: fewer: the limits of flicker are too narrow. Origin: that of flicker falls with the fourth power of the
lag.
"""

LINE_SHAPE = 0.9
"""Standard deviation of the frequency of a line that wanders. Unit: of its mean.

Otherwise: at 1, Gauss–Markov noise is taken for it in one record in ten more; its density is as flat at frequency zero.
At 0.67, limits of B beside a weak hum are a tenth narrower, and miss it in 4 records of 100 (`markov.py`).
"""
LEAST_DENSITY = 1e-30
"""Least density of a line, where it has none: a term of zero has no share. Unit: of the greatest."""
VIBRATION = "a vibration"
"""What a reason calls a line that wanders."""

SECOND_DIFFERENCE = {-2: 1.0, -1: -4.0, 0: 6.0, 1: -4.0, 2: 1.0}
"""Weights by lag of the autocovariance of second differences, that of (1, -2, 1) with itself."""


@dataclass(frozen=True, slots=True)
class NoiseTerm(ABC):
    """A random term of the model; all methods are for power 1.

    Terms are values, compared with ``==``: a copy of a record has copies of them.

    Attributes
    ----------
    letter : of its coefficient in the report, or of its kind.
    """

    letter: str

    @abstractmethod
    def rate_density(self, f: Floats) -> Floats:
        """Return (k,) the density of the rate, before sampling, at f (k,) cycles per sample."""

    def density(self, f: Floats, *, averaged: bool) -> Floats:
        """Return (k,) the density of the samples at f (k,) cycles per sample, above 0 and at most 1/2.

        That of the rate, where this falls so fast that neither sampling nor an average over a sample matters.

        Parameters
        ----------
        averaged : the samples are true averages over their interval (delta angles), else point samples.
        """
        return self.rate_density(f)

    def bin_expectation(self, level: int, *, averaged: bool, window: int) -> Floats:
        """Return (n,) the density of each bin in use of a level of the spectrum.

        Parameters
        ----------
        window : samples of a moving average in the sensor; 1: none.
        """
        return seen_by_bins(lambda f: self.density(f, averaged=averaged), level, window)

    def seen_density(self, f: Floats, *, averaged: bool, window: int) -> Floats:
        """Return (k,) the density of the samples behind a moving average in the sensor over `window` samples."""
        return self.density(f, averaged=averaged) * window_power(f, window)

    @abstractmethod
    def cosine_variances(self, count: int, length: int) -> Floats:
        """Return (count - 1,) the variances of the cosine coefficients of `count` means over `length` samples."""

    @abstractmethod
    def allan_variances(self, m: Ints, *, averaged: bool) -> Floats:
        """Return (k,) the Allan variance at clusters of m (k,) samples."""

    @abstractmethod
    def difference_covariances(self, m: Ints) -> Floats:
        """Return (k, l) the autocovariances of the differences at clusters of m (k,) samples.

        They are by lag, in strides of a cluster over `RATIO`.
        """

    def coefficient_scale(self, tau0: float) -> float:
        """Return the coefficient in SI of power 1, whose unit of time is tau0, s."""
        return math.pow(tau0, -COEFFICIENTS[self.letter].slope)

    @property
    def is_correlated(self) -> bool:
        """Whether it has a memory, so that it may be what another correlated term looks like."""
        return True

    @property
    def grows(self) -> bool:
        """Whether its Allan deviation grows with tau: a mean that moves slowly, or steps, look like it."""
        return COEFFICIENTS[self.letter].slope > 0.0

    @property
    def is_stated(self) -> bool:
        """Whether the report has its coefficient."""
        return True

    @property
    def name(self) -> str:
        """What a reason calls it."""
        return self.letter

    @property
    def time_letter(self) -> str | None:
        """Letter of its time constant in the report; None: only its size is stated."""
        return None

    @property
    def is_of_sensor(self) -> bool:
        """Whether it comes before a filter in the sensor; the output adds what does not."""
        return True


@dataclass(frozen=True, slots=True)
class PowerLaw(NoiseTerm):
    """Noise with a density of the rate of 1 / (2 pi f)^exponent: white (0), flicker (1), random walk (2).

    The formulas are in `power_law`, whose rows are numbered by the exponent. Power laws have no scale of their own: in
    units of a cluster of m samples, the power is m^(exponent - 1) times as large, by which all methods follow from one
    table.
    """

    exponent: int

    def rate_density(self, f: Floats) -> Floats:
        """Return (k,) the density of the rate."""
        return np.asarray((2.0 * np.pi * f) ** -float(self.exponent))

    def density(self, f: Floats, *, averaged: bool) -> Floats:
        """Return (k,) the density of the samples."""
        return np.asarray(sampled_density(f, averaged=averaged)[self.exponent])

    def cosine_variances(self, count: int, length: int) -> Floats:
        """Return (count - 1,) the variances of the cosine coefficients."""
        return np.asarray(cosine_variances(count)[self.exponent] * float(length) ** (self.exponent - 1))

    def allan_variances(self, m: Ints, *, averaged: bool) -> Floats:
        """Return (k,) the Allan variance.

        Point samples of flicker and of a random walk have more than their averages at short clusters. That of flicker
        follows from the autocovariance of the discrete process (Kasdin and Walter 1992), up to `EXACT` samples.

        >>> FLICKER.allan_variances(np.array([1, 2]), averaged=False).round(4)
        array([0.6366, 0.5093])
        """
        clusters = m.astype(np.float64)
        if self.exponent == 0:
            return np.asarray(1.0 / clusters)
        if self.exponent == 2:
            return np.asarray(clusters / 3.0 * (1.0 if averaged else 1.0 + 0.5 / clusters**2))
        flicker = np.full(m.size, COEFFICIENTS["B"].level ** 2)
        if not averaged:
            short = m < EXACT  # beyond, point samples of flicker are like averages
            phase = _sampled_flicker_phase(2 * EXACT)
            flicker[short] = (phase[2 * m[short]] - 4.0 * phase[m[short]]) / clusters[short] ** 2
        return flicker

    def difference_covariances(self, m: Ints) -> Floats:
        """Return (k, l) the autocovariances of the differences."""
        unit = _unit_difference_covariances()[self.exponent]
        return np.asarray(np.multiply.outer(m.astype(np.float64) ** (self.exponent - 1), unit))

    @property
    def is_correlated(self) -> bool:
        """Whether it is not white."""
        return self.exponent > 0


@dataclass(frozen=True, slots=True)
class Quantisation(NoiseTerm):
    """Rounding of an angle (or a velocity) to counts, of which the rate is the difference: density 4 sin^2(pi f).

    IEEE Std 952, section C.1.1. The rounding errors of neighbouring samples are taken as independent, which needs
    noise of half a count or more (Widrow and Kollar 2008).
    """

    def rate_density(self, f: Floats) -> Floats:
        """Return (k,) the density of the rate."""
        return np.asarray(4.0 * np.sin(np.pi * f) ** 2)

    def density(self, f: Floats, *, averaged: bool) -> Floats:
        """Return (k,) the density of the samples: rounding happens after a sample is taken."""
        return self.rate_density(f)

    def bin_expectation(self, level: int, *, averaged: bool, window: int) -> Floats:
        """Return (n,) the density of each bin in use of a level; rounding comes after any filter in the sensor."""
        return short_term_density(level)

    def seen_density(self, f: Floats, *, averaged: bool, window: int) -> Floats:
        """Return (k,) the density of the samples, which are rounded behind any filter."""
        return self.density(f, averaged=averaged)

    def cosine_variances(self, count: int, length: int) -> Floats:
        """Return (count - 1,) the variances of the cosine coefficients.

        The mean of `length` differences is the difference of the errors at the ends of the block over `length`.
        """
        return np.asarray((2.0 * np.sin(np.pi * np.arange(1, count) / (2.0 * count)) / length) ** 2)

    def allan_variances(self, m: Ints, *, averaged: bool) -> Floats:
        """Return (k,) the Allan variance, 3 / m^2."""
        return np.asarray(3.0 / m.astype(np.float64) ** 2)

    def difference_covariances(self, m: Ints) -> Floats:
        """Return (k, l) the autocovariances of the differences: the error of a phase is alone at its lag."""
        # second differences of independent phases: 6, -4, 1 at lags of 0, 1 and 2 clusters, nothing between
        unit = np.zeros(LAGS * RATIO + 1)
        for lag, weight in SECOND_DIFFERENCE.items():
            if lag >= 0:
                unit[lag * RATIO] = weight
        return np.asarray(np.multiply.outer(m.astype(np.float64) ** -2.0, unit))

    @property
    def is_correlated(self) -> bool:
        """Return False: its errors are independent."""
        return False

    @property
    def is_of_sensor(self) -> bool:
        """Return False: rounding comes after any filter in the sensor."""
        return False


@dataclass(frozen=True, slots=True)
class TimedTerm(NoiseTerm):
    """Noise with a time constant, on which its density depends in another way than on its power.

    A term is one time constant: those of different ones are different terms, between which a search decides.

    Attributes
    ----------
    time : time constant, samples.
    """

    time: float

    def with_time(self, time: float) -> Self:
        """Return the same noise with another time constant, samples."""
        return replace(self, time=time)

    @abstractmethod
    def phase_autocovariance(self, lag: Floats) -> Floats:
        """Return (...) the autocovariance of the integral at lags, samples, up to a constant and a square."""

    def autocovariance(self, count: int) -> Floats:
        """Return (count,) the autocovariance of averages over one sample, by lag, up to what is the same for all."""
        phase = self.phase_autocovariance(np.abs(np.arange(-1.0, count + 1.0)))
        return np.asarray(-np.diff(phase, 2))

    def cosine_variances(self, count: int, length: int) -> Floats:
        """Return (count - 1,) the variances of the cosine coefficients."""
        return _timed_variances(self.with_time(self.time / length), count)

    def allan_variances(self, m: Ints, *, averaged: bool) -> Floats:
        """Return (k,) the Allan variance of averages, which that of point samples tends to from a few samples on."""
        return np.asarray(0.5 * self.difference_covariances(m)[:, 0])

    def difference_covariances(self, m: Ints) -> Floats:
        """Return (k, l) the autocovariances of the differences."""
        # the shifts are whole strides, and the autocovariance is even: one table serves all of them
        lag = np.arange(LAGS * RATIO + 1)
        strides = np.arange(float(lag.size + max(SECOND_DIFFERENCE) * RATIO))
        phase = self.phase_autocovariance(np.multiply.outer(m / RATIO, strides))
        shifted = (
            weight * phase[:, np.abs(lag + shift * RATIO)] for shift, weight in SECOND_DIFFERENCE.items()
        )
        return np.asarray(sum(shifted)) / m[:, None].astype(np.float64) ** 2


@dataclass(frozen=True, slots=True)
class GaussMarkov(TimedTerm):
    """First-order Gauss–Markov noise (IEEE Std 952, exponentially correlated), whose power is its variance.

    The formulas are in `markov_law`.
    """

    def rate_density(self, f: Floats) -> Floats:
        """Return (k,) the density of the rate."""
        return np.asarray(2.0 * self.time / (1.0 + (2.0 * np.pi * f * self.time) ** 2))

    def density(self, f: Floats, *, averaged: bool) -> Floats:
        """Return (k,) the density of the samples."""
        return markov_law.sampled_density(f, self.time, averaged=averaged)

    def autocovariance(self, count: int) -> Floats:
        """Return (count,) the autocovariance of averages over one sample, by lag: no difference of large numbers."""
        zero, one, fall = markov_law.average_autocovariance(self.time)
        return np.concatenate(([zero], one * fall ** np.arange(count - 1.0)))

    def allan_variances(self, m: Ints, *, averaged: bool) -> Floats:
        """Return (k,) the Allan variance."""
        return markov_law.allan_variances(m, self.time, averaged=averaged)

    def phase_autocovariance(self, lag: Floats) -> Floats:
        """Return (...) the autocovariance of the integral at lags."""
        return markov_law.phase_autocovariance(lag, self.time)

    @property
    def time_letter(self) -> str | None:
        """Letter of its time constant."""
        return MARKOV.time_constant_s


@dataclass(frozen=True, slots=True)
class WanderingLine(TimedTerm):
    """A line whose frequency is normally distributed about 1 / (2 pi T), with `LINE_SHAPE` of it as deviation.

    Mains hum folds to such a line. Its power is its variance. In units of T its autocovariance is the real part of
    r(t) = exp(-(s t)^2 / 2 + i t), with s = `LINE_SHAPE`. No coefficient of the report is its size.
    """

    def rate_density(self, f: Floats) -> Floats:
        """Return (k,) the density of the rate."""
        middle = 0.5 / (np.pi * self.time)
        width = LINE_SHAPE * middle
        sides = [np.exp(-0.5 * ((f + sign * middle) / width) ** 2) for sign in (-1.0, 1.0)]
        return np.asarray(np.maximum(sum(sides), LEAST_DENSITY) / (2.0 * width * math.sqrt(2.0 * math.pi)))

    def phase_autocovariance(self, lag: Floats) -> Floats:
        """Return (...) the autocovariance of the integral at lags: r(t) integrated twice, by parts."""
        from scipy.special import erf

        s, t = LINE_SHAPE, np.abs(lag) / self.time
        scale = 1.0 / (s * math.sqrt(2.0))
        integral = (
            scale
            * math.sqrt(math.pi)
            * np.exp(-(scale**2))
            * (erf(s**2 * scale * t - 1j * scale) - erf(-1j * scale))
        )
        moment = (1j * integral - np.exp(-0.5 * (s * t) ** 2 + 1j * t) + 1.0) / s**2  # of t r(t)
        return np.asarray(-(self.time**2) * (t * integral - moment).real)

    def coefficient_scale(self, tau0: float) -> float:
        """Return 1: a standard deviation has no unit of time."""
        return 1.0

    @property
    def is_stated(self) -> bool:
        """Return False: the report has its band."""
        return False

    @property
    def name(self) -> str:
        """What a reason calls it."""
        return VIBRATION

    @property
    def grows(self) -> bool:
        """Return False: its Allan deviation falls beyond its hump."""
        return False

    @property
    def range(self) -> tuple[float, float]:
        """Cycles per sample, frequencies within one standard deviation."""
        middle = 0.5 / (math.pi * self.time)
        return middle * (1.0 - LINE_SHAPE), middle * (1.0 + LINE_SHAPE)


WHITE, FLICKER, WALK = PowerLaw("N", 0), PowerLaw("B", 1), PowerLaw("K", 2)
QUANTISATION = Quantisation("Q")

NOISE_TERMS: tuple[NoiseTerm, ...] = (WHITE, FLICKER, WALK)
"""Terms of every channel."""
GRIDDED: tuple[PowerLaw, PowerLaw] = (FLICKER, WALK)
"""Terms that span the grid of the likelihood of every channel, in the order of its axes."""
TERMS: tuple[NoiseTerm, ...] = (*NOISE_TERMS, QUANTISATION)
"""All terms that observations have an expectation of."""

TRIED: tuple[TimedTerm, ...] = (GaussMarkov(MARKOV.sigma, 1.0), WanderingLine("line", 1.0))
"""Terms that are tried with several time constants beside the others, in whatever unit of time."""

TermPowers: TypeAlias = Mapping[NoiseTerm, float]
"""Power of each term of a model, (channel unit)^2."""


def total(powers: Mapping[NoiseTerm, float], unit: Callable[[NoiseTerm], Floats]) -> Floats:
    """Return the expectation of a statistic: the sum over terms of power times unit expectation."""
    return np.asarray(sum(power * unit(term) for term, power in powers.items()))


def combined(powers: Mapping[NoiseTerm, Floats], unit: Mapping[NoiseTerm, Floats]) -> Floats:
    """Return (n, m) the expectations of n statistics for m sets of powers, in one product of matrices.

    Parameters
    ----------
    powers : (m,) of each term.
    unit : (n,) unit expectations of at least these terms.
    """
    return np.asarray(np.stack([unit[term] for term in powers], axis=1) @ np.stack(list(powers.values())))


class UpperShape(Enum):
    """What bends the upper end of the spectrum beside the noise terms.

    It acts on the bands of the spectrum. The single coefficients lie far below the frequencies that a filter in a
    sensor reaches, where each of these factors is 1; quantisation is a term and acts on every statistic.
    """

    FLAT = "flat"
    """Nothing: noise up to half the sampling rate, or behind a moving average of known length."""
    QUANTISED = "quantised"
    """The term `QUANTISATION` is scored beside N."""
    LOW_PASS = "low_pass"
    """The factor 1 / (1 + c 4 sin^2(pi f)) of a first-order low-pass (Percival and Walden 1993, section 9.8), which any
    filter looks like where it begins to bend the spectrum; c is scored beside N."""


@dataclass(frozen=True, slots=True)
class UpperEnd:
    """Description of the upper end of the spectrum of one channel.

    Attributes
    ----------
    octaves_left_out : octaves of frequency below half the sampling rate that do not count.
    window : samples of a moving average in the sensor; 1: none.
    shape : what else bends it.
    """

    octaves_left_out: int = 0
    window: int = 1
    shape: UpperShape = UpperShape.FLAT

    @property
    def highest(self) -> float:
        """Highest frequency that counts, cycles per sample."""
        return 0.5 / 2.0**self.octaves_left_out

    @property
    def scored(self) -> tuple[NoiseTerm, ...]:
        """Terms whose powers are scored."""
        return (WHITE, QUANTISATION) if self.shape is UpperShape.QUANTISED else (WHITE,)

    @property
    def low_pass(self) -> bool:
        """Whether a low-pass bends the bands."""
        return self.shape is UpperShape.LOW_PASS


@lru_cache(maxsize=64)  # channels of a record ask for the same time constants
def _timed_variances(term: TimedTerm, count: int) -> Floats:
    """Return (count - 1,) the variances of the cosine coefficients of neighbouring averages over one sample."""
    return cosine_variances_of(term.autocovariance(count))


@lru_cache(maxsize=4)
def _sampled_flicker_phase(reach: int) -> Floats:
    """Return (reach + 1,) the generalised autocovariance of summed sampled flicker, up to a lag^2 term.

    That of (1 - z^-1)^(-1/2) w itself is -1/pi sum_{j=1..k} 1/(j - 1/2) (Kasdin and Walter 1992); it is summed twice.
    """
    rate = np.concatenate([[0.0], -np.cumsum(1.0 / (np.arange(1, reach + 1) - 0.5)) / np.pi])
    slopes = -np.cumsum(rate[:reach])  # S(k+1) - S(k), S even
    return np.concatenate([[0.0], np.cumsum(slopes)])


@lru_cache(maxsize=1)
def _unit_difference_covariances() -> Floats:
    """Return (3, l) the autocovariances of differences of the power laws by lag in strides, in units of the cluster.

    Differences of a cluster are second differences of the phase, so that the covariance at a lag is nine terms of the
    generalised autocovariance of the phase (Greenhall 1991), five of which are different.
    """
    lag = np.arange(LAGS * RATIO + 1) / RATIO
    shifted = (weight * phase_autocovariance(lag + shift) for shift, weight in SECOND_DIFFERENCE.items())
    return np.asarray(sum(shifted))
