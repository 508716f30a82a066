"""The likelihood of the powers of a model, given the observations of one channel.

Bands count as gamma distributed and single cosine coefficients as normal, all independent of each other. With the
expectation S of a band of power P with nu degrees of freedom (Whittle 1953; McCullagh and Nelder 1989, section 8.3),
and coefficients y = X beta + noise of variance v, of which the restricted likelihood counts, the part that is free of
beta (Patterson and Thompson, Biometrika 58, 1971):

    -2 ln L = sum nu (P/S + ln S)  +  sum ((y - X beta)^2 / v + ln v)  +  ln |X' V^-1 X|

S and v are linear in the powers of the terms (`model`). B and K span a grid. At each point of it, the powers of the
scored terms (N, beside it quantisation or the corner of a low-pass) are the likeliest ones by Fisher's scoring, and
beta is the generalised least squares solution. Scoring sees the bands only: the few single coefficients would hardly
move N, and a term that they must move cannot be scored. So the grid carries all that is stated:

- limits of B and K: quantiles of the likelihood, normalised over amplitudes >= 0 (flat priors in the amplitude: Box and
  Tiao 1973, section 1.3). Flat in the amplitude, not in the power, which would favour large B.
- value and limits of N and beta: mean over the grid, with the normal error at each point.
- evidence: twice the log likelihood ratio against B = 0 or K = 0.

Nothing depends on whether a term shows: a B that is zero is a marginal likelihood with its maximum at zero, not another
model.

Error of the model: where chance does not explain the misfit, a relative error e in every band counts, 1/nu becomes
1/nu + e^2/2 (Paule and Mandel 1982).

Example: two bands of white noise with 100 degrees of freedom each.

>>> from imumon.noise.fit.model import FLICKER, NOISE_TERMS, WALK
>>> flat = {term: np.ones(2) if term == WHITE else np.full(2, 1e-6) for term in NOISE_TERMS}
>>> bands = Bands(np.array([3.9, 4.1]), np.full(2, 100.0), flat, np.zeros(2), np.array([0.25, 0.5]))
>>> none = Cosines(np.zeros(0), np.zeros((0, 0)), {term: np.zeros(0) for term in NOISE_TERMS})
>>> surface = Likelihood(bands, none).surface({FLICKER: np.zeros(1), WALK: np.zeros(1)})
>>> round(surface.powers[WHITE], 3), round(float(np.sqrt(surface.scored_variances[WHITE][0])), 2)
(4.0, 0.4)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from scipy.special import gammainc, gammaincc, ndtri

from imumon.model.samples import Floats
from imumon.noise.fit.model import GRIDDED, WHITE, NoiseTerm, combined, total
from imumon.noise.fit.normal_equations import LEAST_VARIANCE, inverse_and_log, normal_matrix
from imumon.noise.fit.observations import Bands, Cosines
from imumon.noise.fit.scoring import BandScoring
from imumon.noise.validity_groups import ROUNDING

GRID = 20
"""Resolution of B and of K, half as many where regressors are tried or M is beside them; also the frequencies that are
tried between two coefficients for an oscillation. Unit: values.

Otherwise: with 10, limits of B and K move by up to 9 % of their distance; with 7 beside M, those of M by a tenth in
half of the channels. Origin: with 16 no limit of 15 channels moves by more than 0.7 % of the distance of the limits;
with 40 and 80 by 1 %, but one, a lower limit of B, by 10 %.
"""
FINE = 8
"""Resolution of the cumulative probability between two points of the grid. Unit: parts of a cell.

Otherwise: with 2, limits move by up to 1.1 % of their distance. Origin: with 32 no limit moves by more than 0.1 % of
the distance of the limits.
"""
WIDEST_SEARCH = (1e-6, 1e12)
"""Least and greatest power of B and K in the first search, in the lowest coefficient of the record. Unit: of the
power of N.

Otherwise: a channel without white noise, or with K just above nothing, begins outside of the grid. Origin: from a
thousandth of the amplitude of N to a channel whose white noise is a millionth.
"""
DECADES = np.concatenate(([0.0], np.geomspace(*WIDEST_SEARCH, 27)))
"""B^2 and K^2 of the first search, in units of the power that N has in the lowest coefficient."""
DROP = 9.0
"""The grid ends where the likelihood has fallen by this much. Unit: log likelihood.

Otherwise: with 4.5, limits move by up to 9 % of their distance, because tails are cut off; with more, most of the
grid is empty. Origin: exp(-9) = 10^-4 of the greatest likelihood; with 13 no limit moves by more than 0.9 %.
"""
GRID_FALL = 0.7
"""A grid holds the likelihood if this has fallen by this share at both ends, and at least half of the cells lie
above that. Unit: of DROP.

Otherwise: at 1 a grid that was made from its predecessor would always be made again. Origin: exp(-6.3) = 0.002 of the
greatest likelihood; with 0.5 and 0.9 no limit moves by more than 1 %.
"""
MOST_MOVES = 6
"""A grid that does not hold the likelihood is moved this often at most. Unit: grids.

Otherwise: a likelihood with two maxima would move the grid to and fro without end. Origin: a likelihood with one
maximum is held after two or three.
"""
SLOW_GROUPS = (0, 3, 7, 15, 31)
"""First single coefficients of the groups in which their misfit is judged. Unit: coefficients.

Otherwise: with all 48 in one, a missing lowest frequency is diluted; with each alone, all of them are. Origin: an
octave each, beginning with three coefficients, of which a drift takes one (`markov.py`).
"""
EVIDENCE = 4.8
"""A coefficient is measured; else its 97.5 % quantile is an upper bound. Unit: twice the log likelihood ratio.

Otherwise: at 0 noise alone is measured as B and K in half of the records. Origin: 1.4 % false detections: half of the
records without the term have the best value at zero (Chernoff 1954). Of N^2 and Q^2 it is the square over that of the
standard error (`real_effects.py`).
"""

CHANCE = 0.01
"""Noise alone makes an oscillation that is left out, a hump that has a name, a bend of the effect of the temperature,
or a misfit in this share of records. Unit: probability.

Otherwise: leaving out a coefficient costs little, missing an oscillation makes B too large. Origin: over all places of
a record (Bonferroni) (`real_effects.py`).
"""

LIMITS = np.array([0.025, 0.5, 0.975])
"""Quantiles of the 95 % limits and of the value between them."""
Grids: TypeAlias = Mapping[NoiseTerm, Floats]
"""Amplitudes (not powers) of each gridded term, channel unit in units of tau0."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Likelihood on a grid of B and K, or of B, K and M: m = g h ... points, those of the last term fastest.

    Attributes
    ----------
    grids : (g,), (h,) ... amplitudes of the gridded terms.
    log : (m,) logarithm of the likelihood.
    scored : (m,) likeliest power of each scored term at each point.
    scored_variances : (m,) variance of its estimate.
    corner : (m,) likeliest parameter c of a low-pass 1 / (1 + c 4 sin^2(pi f)); 0.0 without one.
    beta, beta_variances : (m, q) coefficients of the regressors and their variances.
    beside : power of each term that is not on the grid, the same at all points.
    likeliest : likeliest power of every term, where it is known better than to a point of the grid; None: it is not.
    """

    grids: Grids
    log: Floats
    scored: Mapping[NoiseTerm, Floats]
    scored_variances: Mapping[NoiseTerm, Floats]
    corner: Floats
    beta: Floats
    beta_variances: Floats
    beside: Mapping[NoiseTerm, float] = field(default_factory=dict)
    likeliest: Mapping[NoiseTerm, float] | None = None

    @property
    def best(self) -> int:
        """Number of the point with the greatest likelihood, or nearest to it."""
        if self.likeliest is None:
            return int(self.log.argmax())
        near_peak = [
            int(np.abs(grid - np.sqrt(self.likeliest[term])).argmin()) for term, grid in self.grids.items()
        ]
        return int(np.ravel_multi_index(near_peak, self.shape))

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes of the grids."""
        return tuple(grid.size for grid in self.grids.values())

    @property
    def noise_powers(self) -> dict[NoiseTerm, Floats]:
        """(m,) power of every term at each point."""
        known = {term: np.full(self.log.size, power) for term, power in self.beside.items()}
        return {**self.scored, **grid_powers(self.grids), **known}

    @property
    def powers(self) -> dict[NoiseTerm, float]:
        """Power of every term at the greatest likelihood."""
        if self.likeliest is not None:
            return dict(self.likeliest)
        best = self.best
        places = np.unravel_index(best, self.shape)
        on_grid = {
            term: float(grid[place]) ** 2
            for (term, grid), place in zip(self.grids.items(), places, strict=True)
        }
        return {**{term: float(power[best]) for term, power in self.scored.items()}, **on_grid, **self.beside}

    def estimate(self, scored: NoiseTerm) -> tuple[float, float]:
        """Return the power of a scored term at the greatest likelihood, and its standard error."""
        best = self.best
        return float(self.scored[scored][best]), math.sqrt(float(self.scored_variances[scored][best]))

    @property
    def sensor_powers(self) -> dict[NoiseTerm, float]:
        """Power of each term of the sensor itself: all but quantisation, which its output adds."""
        return {term: power for term, power in self.powers.items() if term.is_of_sensor}

    def profile(self, term: NoiseTerm) -> Floats:
        """Return (g,) the greatest log likelihood at each amplitude of a gridded term."""
        others = tuple(axis for axis, other in enumerate(self.grids) if other != term)
        return np.asarray(self.log.reshape(self.shape).max(axis=others))

    def weights(self) -> Floats:
        """Return (g, h) the probability of each point, not normalised.

        The grids are even. A point at zero has only the half cell above it.
        """
        return np.asarray(np.exp(self.log - self.log.max()).reshape(self.shape) * self.cells)

    @property
    def cells(self) -> Floats:
        """(g, h, ...) cell of each point: 1, and half of it for each term that is zero there."""
        cells = np.ones(self.shape)
        for axis, grid in enumerate(self.grids.values()):
            if grid[0] == 0.0:
                cells[(slice(None),) * axis + (0,)] *= 0.5
        return cells


@dataclass(frozen=True, slots=True, eq=False)
class Squares:
    """All observations of a channel as gamma-distributed squares.

    Attributes
    ----------
    power : (r,) (channel unit)^2.
    half : (r,) half of the degrees of freedom.
    expected : (r,) of each term, the expectation of power 1.
    """

    power: Floats
    half: Floats
    expected: Mapping[NoiseTerm, Floats]


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Observations of one channel with the terms that explain them.

    Attributes
    ----------
    bands, cosines : the observations.
    scored : terms whose power is profiled; white noise first.
    low_pass : whether the bands of the spectrum are behind a low-pass of first order, whose corner is profiled, too.
    error : 1, relative error of the model in every power.
    beside : power of each term that is known, so that it is neither scored nor on a grid.
    """

    bands: Bands
    cosines: Cosines
    scored: tuple[NoiseTerm, ...] = (WHITE,)
    low_pass: bool = False
    error: float = 0.0
    beside: Mapping[NoiseTerm, float] = field(default_factory=dict)

    @cached_property
    def dof(self) -> Floats:
        """(r,) degrees of freedom, with the error of the model."""
        return np.asarray(1.0 / (1.0 / self.bands.dof + 0.5 * self.error**2))

    @property
    def free(self) -> int:
        """Number of parameters that are profiled."""
        return len(self.scored) + self.low_pass

    def surface(self, grids: Grids, start: Floats | None = None) -> Surface:
        """Return the likelihood at all points of a grid.

        Parameters
        ----------
        start : (free - 1,) first values of the profiled parameters but that of white noise; None: zeros.
        """
        gridded = self._with_known(grid_powers(grids))
        scored, corner, log, variances = self._profile(gridded, start)
        restricted, beta, beta_variances = self._restricted({**scored, **gridded})
        # without any noise there is no likelihood; a finite number, so that a surface of it alone gives no NaN
        log = log + restricted
        log = np.where(np.isfinite(log), log, np.finfo(np.float32).min)
        return Surface(grids, log, scored, variances, corner, beta, beta_variances, beside=self.beside)

    def _with_known(self, powers: Mapping[NoiseTerm, Floats]) -> dict[NoiseTerm, Floats]:
        """Return (m,) powers with those of the terms that are known."""
        size = next(iter(powers.values())).size
        return {**powers, **{term: np.full(size, power) for term, power in self.beside.items()}}

    def _profile(
        self, gridded: Mapping[NoiseTerm, Floats], start: Floats | None, *, only_white: bool = False
    ) -> tuple[dict[NoiseTerm, Floats], Floats, Floats, dict[NoiseTerm, Floats]]:
        """Return what profiling gives at each of m points, by Fisher's scoring (`scoring`).

        Parameters
        ----------
        gridded : (m,) powers of the terms that are not profiled.
        start : (free - 1,) or (free - 1, m) first values of the other parameters.
        only_white : the other parameters stay as they are.

        Returns
        -------
        scored : (m,) power of each scored term.
        corner : (m,) of the low-pass, zeros without one.
        log : (m,) logarithm of the likelihood of the powers.
        variances : (m,) of each scored power.
        """
        scoring = BandScoring(self.bands, self.dof, self.scored, gridded, self._floor, low_pass=self.low_pass)
        values = scoring.values[: self.free]
        values[0] = self._white
        if start is not None:
            values[1:] = start if start.ndim == 2 else start[:, None]
        least = np.zeros((self.free, 1))
        least[0] = 1e-6 * self._white  # never zero: a model without white noise has no variance at high f
        scoring.ascend(least, 1 if only_white else self.free)
        log, variances = scoring.likelihood()
        return (
            dict(zip(self.scored, values, strict=False)),
            values[-1] if self.low_pass else np.zeros(log.size),
            log,
            dict(zip(self.scored, variances, strict=False)),
        )

    @cached_property
    def _floor(self) -> Floats:
        """(r,) least power of a model."""
        # 30 dB below what was observed: without power, a band (N = 0 in the grid) has an infinite misfit
        share = np.maximum(1e-3 * self.bands.power, ROUNDING**2 * self.bands.power.max())
        return np.asarray(np.maximum(share, LEAST_VARIANCE))

    @cached_property
    def _white(self) -> float:
        """Return a first value of N^2: the median of the upper bands, behind a low-pass of those below."""
        order = np.argsort(-self.bands.top)
        # a first value only: the upper third of the bands holds N in all but the shortest records
        third = max(2, order.size // 3)
        behind = self.low_pass and order.size > 2 * third
        rows = order[third : 2 * third] if behind else order[:third]
        densities = self.bands.power[rows] / self.bands.expected[WHITE][rows]
        # a channel of impulses leaves most bands empty: their median is zero, their mean is not
        return float(np.median(densities) or max(densities.mean(), LEAST_VARIANCE))

    def _first_values(self, grids: Grids) -> Floats | None:
        """Return (free - 1,) first values of the profiled parameters but N: the best of a few in the middle of a grid.

        Scoring from zero does not find the corner of a low-pass: the likelihood has a maximum there, too.
        """
        if self.free == 1:
            return None
        scale = self._white if len(self.scored) > 1 else 1.0
        # six decades about the power of N, or about a corner at a sixth of the sampling rate; scoring does the rest
        tried = np.append(0.0, np.geomspace(1e-3, 1e3, 25)) * scale
        middle = {term: np.full(tried.size, float(np.median(grid)) ** 2) for term, grid in grids.items()}
        log = self._profile(self._with_known(middle), tried[None], only_white=True)[2]
        return tried[[log.argmax()]]

    def _restricted(self, powers: Mapping[NoiseTerm, Floats]) -> tuple[Floats, Floats, Floats]:
        """Return (m,) the restricted log likelihood of the coefficients, and (m, q) the regression with variances."""
        y, X = self.cosines.y, self.cosines.X
        v = combined(powers, self.cosines.variances)
        w = 1.0 / v
        log = -0.5 * (y**2 @ w + np.log(v, out=v).sum(axis=0))
        Xy = (X.T * y) @ w
        inverse, log_information = inverse_and_log(normal_matrix(w, X))
        beta = (inverse * Xy).sum(axis=1)
        log += 0.5 * ((beta * Xy).sum(axis=0) - log_information)
        return log, beta.T, np.einsum("iim->mi", inverse)

    def search(self, samples: float, start: Grids | None = None) -> Surface:
        """Return the likelihood on a grid that holds all of it, or the last one that was tried.

        Parameters
        ----------
        samples : length of the record.
        start : grids of an earlier search; None: unknown.
        """
        if start is None:
            # amplitudes whose power in the lowest coefficient, at half a cycle per record, is that of N times DECADES
            lowest = 2.0 * np.pi * 0.5 / samples
            grids: Grids = {term: np.sqrt(self._white * lowest**term.exponent * DECADES) for term in GRIDDED}
        else:
            grids = start
        surface, even = self.surface(grids, self._first_values(grids)), start is not None
        for _ in range(MOST_MOVES):
            if even and holds(surface):
                return surface
            even = True
            surface = self.surface(
                {term: near(surface, term) for term in surface.grids}, self._free_values(surface)
            )
        return surface

    def _free_values(self, surface: Surface) -> Floats | None:
        """Return (free - 1,) the profiled parameters but N at the greatest likelihood."""
        if self.free == 1:
            return None
        others = [surface.scored[term][surface.best] for term in self.scored[1:]]
        return np.array([*others, *([surface.corner[surface.best]] if self.low_pass else [])])

    def at_values_of(self, surface: Surface, grids: Grids) -> Surface:
        """Return the likelihood on other grids, scored from the likeliest values of a surface."""
        return self.surface(grids, self._free_values(surface))

    def as_squares(self, surface: Surface) -> Squares:
        """Return bands and single coefficients alike, as squares with their expectations behind the low-pass.

        A coefficient without the likeliest regression is a square with the degrees of freedom that this leaves.
        """
        residual, left = self.residuals(surface)
        fall = 1.0 / (1.0 + surface.corner[surface.best] * self.bands.bend)
        return Squares(
            # rounding leaves of nothing more than nothing
            np.concatenate((self.bands.power, residual**2 / np.maximum(left, 1e-3))),
            0.5 * np.concatenate((self.dof, left)),
            {
                term: np.concatenate((unit * fall, self.cosines.variances[term]))
                for term, unit in self.bands.expected.items()
            },
        )

    def residuals(self, surface: Surface) -> tuple[Floats, Floats]:
        """Return (n,) the single coefficients without the likeliest regression, and (n,) the share that it leaves."""
        y, X = self.cosines.y, self.cosines.X
        left = 1.0 - np.einsum("nq,qr,nr->n", X, self.covariance(surface), X) / self.slow_noise(surface)
        return y - X @ surface.beta[surface.best], np.asarray(left)

    def slow_noise(self, surface: Surface) -> Floats:
        """Return (n,) the variances of the single coefficients by the likeliest noise."""
        return total(surface.powers, lambda term: self.cosines.variances[term])

    def covariance(self, surface: Surface, used: Sequence[bool] | None = None) -> Floats:
        """Return (q, q) the covariance of the likeliest regression, or of that on the regressors in use alone."""
        X = self.cosines.X if used is None else self.cosines.X[:, used]
        return inverse_and_log(normal_matrix(1.0 / self.slow_noise(surface)[:, None], X))[0][:, :, 0]

    def at_powers(
        self, powers: Mapping[NoiseTerm, Floats], surface: Surface, more: Mapping[NoiseTerm, Floats]
    ) -> Floats:
        """Return (m,) the log likelihood at some powers, behind the low-pass of a surface.

        Parameters
        ----------
        more : (m,) powers of terms that are neither scored nor on the grid.
        """
        every = self._with_known({**powers, **more})
        model = combined(every, self.bands.expected).T
        model = np.maximum(model / (1.0 + surface.corner[surface.best] * self.bands.bend), self._floor)
        log = -((self.bands.power / model + np.log(model)) @ (0.5 * self.dof))
        return np.asarray(log + self._restricted(every)[0])

    def misfit(self, surface: Surface, rows: int | None = None) -> tuple[float, float]:
        """Return the misfit of the powers, or of the first `rows` of them, and its degrees of freedom.

        The deviance of gamma variables: chi-square of one degree each (McCullagh and Nelder 1989, section 8.3).
        """
        ratio = np.maximum(self.bands.power / self.model(surface), ROUNDING**2)[:rows]
        deviance = self.dof[:rows] * (ratio - 1.0 - np.log(ratio))
        # Two or three terms are fitted, most of them to the powers: N, one of B and K, and what bends the upper end.
        # The other of B and K, and M, are held by the single coefficients, which are judged by themselves
        # (`slow_misfit`).
        return float(deviance.sum()), max(float(ratio.size) - 1.0 - self.free, 1.0)

    def slow_misfit(self, surface: Surface) -> tuple[float, float]:
        """Return the misfit of the single coefficients and its degrees of freedom.

        Each group of coefficients gives the square of a standard normal number: that with the same probability as its
        chi-square. So a group of one coefficient counts as much as one of sixteen.
        """
        residual, left = self.residuals(surface)
        ratio = residual**2 / self.slow_noise(surface)
        starts = np.array([n for n in SLOW_GROUPS if n < residual.size], dtype=np.int64)
        if not starts.size:
            return 0.0, 0.0
        dof = np.maximum(np.add.reduceat(left, starts), LEAST_VARIANCE)
        # of less than half a coefficient the regressors take nearly all: any rounding of the rest would be a misfit
        judged = dof >= 0.5
        half, statistic = 0.5 * dof[judged], 0.5 * np.add.reduceat(ratio, starts)[judged]
        # the smaller tail, because a probability near 1 has no digits
        tail = np.minimum(gammainc(half, statistic), gammaincc(half, statistic))
        return float((ndtri(np.maximum(tail, LEAST_VARIANCE)) ** 2).sum()), float(half.size)

    def model(self, surface: Surface) -> Floats:
        """Return (r,) the expected powers at the greatest likelihood."""
        model = total(surface.powers, lambda term: self.bands.expected[term])
        model = model / (1.0 + surface.corner[surface.best] * self.bands.bend)
        return np.asarray(np.maximum(model, self._floor))

    def p_value(self, surface: Surface, rows: int | None = None) -> float:
        """Return the probability of a misfit as large."""
        misfit, dof = self.misfit(surface, rows)
        return float(gammaincc(0.5 * dof, 0.5 * misfit))


def mixed(one: Surface, two: Surface, weight: float) -> Surface:
    """Return the likelihood of either of two models on the same grid, the second one `weight` times as likely.

    The regression is that of the first, which the statement shows. The variance of N at a point is the mean of both
    variances: the two values of N at a point differ by far less than their errors, because only the slow part differs.
    """
    top = max(one.log.max(), two.log.max())
    p, q = np.exp(one.log - top), weight * np.exp(two.log - top)
    both = np.maximum(p + q, 1e-300)  # where both underflow nothing is stated
    scored = {term: (p * one.scored[term] + q * two.scored[term]) / both for term in one.scored}
    variances = {
        term: (p * one.scored_variances[term] + q * two.scored_variances[term]) / both for term in one.scored
    }
    beta, beta_variances = one.beta, one.beta_variances
    if two.beta.shape == beta.shape:  # the same regressors
        share = (q / both)[:, None]
        beta = (1.0 - share) * one.beta + share * two.beta
        beta_variances = (1.0 - share) * one.beta_variances + share * two.beta_variances
        beta_variances = beta_variances + share * (1.0 - share) * (one.beta - two.beta) ** 2
    return Surface(
        one.grids,
        np.log(both) + top,
        scored,
        variances,
        one.corner,
        beta,
        beta_variances,
        beside=one.beside,
    )


def quantiles(surface: Surface, term: NoiseTerm, probabilities: Floats) -> Floats:
    """Return quantiles of the amplitude of a gridded term."""
    grid = surface.grids[term]
    others = tuple(axis for axis, other in enumerate(surface.grids) if other != term)
    p = surface.weights().sum(axis=others)
    p[0] *= 2.0 if grid[0] == 0.0 else 1.0  # a density here, not a share of a cell
    return density_quantiles(grid, p, probabilities)


def without(surface: Surface, absent: NoiseTerm) -> Surface | None:
    """Return the part of a surface without a gridded term; None where its grid is far from zero.

    The prior of an amplitude gives zero no share. Summed over B, N and K are always smaller than without B, because
    some of both counts as B. Where the data do not show B, both descriptions are open.
    """
    if surface.grids[absent][0] > 0.0:
        return None
    axis = list(surface.grids).index(absent)

    def at_zero(values: Floats) -> Floats:
        """Return the values (m, ...) at the first point of the axis, which is zero."""
        rest = values.shape[1:]
        return np.asarray(np.take(values.reshape(*surface.shape, *rest), 0, axis=axis).reshape(-1, *rest))

    return replace(
        surface,
        grids={term: grid[:1] if term == absent else grid for term, grid in surface.grids.items()},
        log=at_zero(surface.log),
        scored={term: at_zero(power) for term, power in surface.scored.items()},
        scored_variances={term: at_zero(variance) for term, variance in surface.scored_variances.items()},
        corner=at_zero(surface.corner),
        beta=at_zero(surface.beta),
        beta_variances=at_zero(surface.beta_variances),
        likeliest=None,
    )


def upper_limit(surface: Surface, term: NoiseTerm, probability: float, absent: NoiseTerm) -> float:
    """Return a quantile of the amplitude of a gridded term: the greater one of those with and without another term."""
    parts = [surface, without(surface, absent)]
    quantile = np.array([probability])
    return max(float(quantiles(part, term, quantile)[0]) for part in parts if part is not None)


def density_quantiles(grid: Floats, p: Floats, probabilities: Floats) -> Floats:
    """Return quantiles of a probability density p (g,) at even points of a grid (g,).

    The cumulative probability is a piecewise cubic with the density as its slope. The integral of a cell is that of the
    parabola through its ends and a neighbour (5/12, 8/12, -1/12), within the grid the mean of both sides.
    """
    inner = np.concatenate(
        ([5.0 * p[0] + 8.0 * p[1] - p[2]], 6.5 * (p[1:-2] + p[2:-1]) - 0.5 * (p[:-3] + p[3:]))
    )
    cells = np.append(inner, 5.0 * p[-1] + 8.0 * p[-2] - p[-3]) / 12.0
    ends = np.concatenate(([0.0], np.cumsum(np.maximum(cells, 0.0))))
    t = np.arange(FINE)[:, None] / FINE
    rise = t * t * (3.0 - 2.0 * t)
    inside = ends[:-1] + rise * np.diff(ends) + t * (1.0 - t) * ((1.0 - t) * p[:-1] - t * p[1:])
    # a cubic may overshoot where the density falls steeply: a probability never decreases
    cumulative = np.maximum.accumulate(np.append(inside.T.ravel(), ends[-1]))
    amplitudes = np.linspace(grid[0], grid[-1], cumulative.size)
    return np.asarray(np.interp(probabilities, cumulative / cumulative[-1], amplitudes))


def evidence(surface: Surface, term: NoiseTerm) -> float:
    """Return twice the log likelihood ratio of a gridded term against zero; inf where the grid is far from zero."""
    if surface.grids[term][0] > 0.0:
        return np.inf
    log = surface.profile(term)
    return float(2.0 * (log.max() - log[0]))


def joint_evidence(surface: Surface, terms: Sequence[NoiseTerm]) -> float:
    """Return twice the log likelihood ratio of some gridded terms against all of them zero.

    Other terms of `terms`, which are not on the grid, stay as they are.
    """
    if any(surface.grids[term][0] > 0.0 for term in surface.grids if term in terms):
        return np.inf
    zero = surface.log.reshape(surface.shape)[
        tuple(0 if term in terms else slice(None) for term in surface.grids)
    ]
    return float(2.0 * (surface.log.max() - np.max(zero)))


def grid_mean(surface: Surface, value: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Return mean and standard deviation of quantities (m, ...) that have a normal error at each point of the grid."""
    p = surface.weights().ravel()
    p = p / p.sum()
    mean = p @ value
    return mean, np.sqrt(p @ (variance + (value - mean) ** 2))


def grid_powers(grids: Grids) -> dict[NoiseTerm, Floats]:
    """Return (m,) the power of each gridded term at all points of a grid."""
    axes = np.ix_(*(grid**2 for grid in grids.values()))
    shape = tuple(grid.size for grid in grids.values())
    return {term: np.broadcast_to(axis, shape).ravel() for term, axis in zip(grids, axes, strict=True)}


def near(surface: Surface, term: NoiseTerm, size: int = GRID) -> Floats:
    """Return a finer grid about the amplitudes whose likelihood is not negligible."""
    grid, log = surface.grids[term], surface.profile(term)
    rows = np.flatnonzero(log >= log.max() - DROP)
    low = grid[rows[0] - 1] if rows[0] > 1 else 0.0
    # at its upper end a grid says nothing of what lies beyond
    high = grid[rows[-1] + 1] if rows[-1] + 1 < grid.size else 2.0 * grid[-1]
    return np.linspace(low, high, size)


def holds(surface: Surface) -> bool:
    """Return whether the grid holds the whole likelihood, and is not much too wide."""
    for term, grid in surface.grids.items():
        log = surface.profile(term)
        rows = np.flatnonzero(log >= log.max() - GRID_FALL * DROP)
        begins_inside = rows[0] == 0 and grid[0] > 0.0
        if rows.size < grid.size // 2 or begins_inside or rows[-1] == grid.size - 1:
            return False
    return True


def _on(likelihood: Likelihood, surface: Surface, grids: Grids) -> Surface:
    """Return a surface on some grids; itself where it is on them."""
    if all(np.array_equal(grid, surface.grids[term]) for term, grid in grids.items()):
        return surface
    return likelihood.at_values_of(surface, grids)


@dataclass(frozen=True, eq=False)
class Alternatives:
    """The likelihoods without and with a regressor in doubt; the second is None without one.

    Attributes
    ----------
    odds : likelihood of the regressor against none.
    """

    likelihood: Likelihood
    surface: Surface
    other: Likelihood | None = None
    other_surface: Surface | None = None
    odds: float = 0.0

    def on(self, grids: Grids) -> Surface:
        """Return the likelihood of either of the models on a grid.

        The second surface is scaled so that its maximum is `odds` times that of the first: the restricted likelihoods
        of regressions that differ by a regressor have no common scale.
        """
        first = _on(self.likelihood, self.surface, grids)
        if self.other is None or self.other_surface is None:
            return first
        second = _on(self.other, self.other_surface, grids)
        second = replace(second, log=second.log - second.log.max() + first.log.max())
        return mixed(first, second, self.odds)

    @cached_property
    def mixed(self) -> Surface:
        """Likelihood of either of the models on a grid that holds both."""
        if self.other_surface is None:
            return self.surface
        grids = {
            term: np.linspace(
                min(grid[0], self.other_surface.grids[term][0]),
                max(grid[-1], self.other_surface.grids[term][-1]),
                grid.size,
            )
            for term, grid in self.surface.grids.items()
        }
        return self.on(grids)
