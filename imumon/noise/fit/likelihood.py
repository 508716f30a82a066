"""The likelihood of N, B and K of one channel, and what follows from it: values, limits, evidence.

    S(f) = N^2 + B^2 / (2 pi f) + K^2 / (2 pi f)^2        two-sided density of the rate (IEEE Std 952, 1139)

Powers count as gamma distributed, single cosine coefficients as normal, all independent of each other. Of the
coefficients the restricted likelihood counts (Patterson & Thompson, Biometrika 58, 1971): the part that is free of
the regressors. N^2 and the shape of the upper end are profiled over, with their normal error; B and K span a grid.
Limits are quantiles of the likelihood, normalised over amplitudes >= 0. Nothing depends on whether a term shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaincc

from imumon.noise.fit.observations import LEAST_VARIANCE, Coefficients, Powers
from imumon.noise.validity_groups import ROUNDING
from imumon.samples import Bools, Floats

GRID = 20
"""Values of B and of K at which the likelihood is computed, half as many where terms are sought. Frequencies of an
oscillation between two coefficients."""
FINE = 8
"""Parts of a cell of the grid between which a quantile is interpolated."""
DECADES = np.concatenate(([0.0], np.geomspace(1e-6, 1e12, 27)))
"""B^2 and K^2 in the first search, over those whose power is that of N in the lowest coefficient."""
DROP = 9.0
"""Logarithm of the likelihood below its maximum at the ends of the grid: 10^-4 of it."""
MOST_MOVES = 6
"""Times that a grid which does not hold the likelihood is moved."""
SCORING_STEPS = 3
"""Steps of Fisher's scoring for N^2 at each point of the grid."""
LEAST_POWER = 1e-3
"""Share of an observed power below which no model is compared with it."""

SLOW_BANDS, SLOW_DEGREES = (0, 6, 16), 3.0
"""First coefficients of the bands in which the misfit of the single ones is judged, and least degrees of freedom of a
band."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Likelihood on a grid of B and K.

    Attributes
    ----------
    B, K : (g,), (h,) channel unit in units of tau0.
    log : (g h,) logarithm of the likelihood.
    a, a_variance : (g h,) best N^2 and the variance of its estimate.
    c : (g h,) best parameter of the shape.
    beta, beta_variance : (g h, q) coefficients of the regressors and their variances.
    """

    B: Floats
    K: Floats
    log: Floats
    a: Floats
    a_variance: Floats
    c: Floats
    beta: Floats
    beta_variance: Floats

    @property
    def best(self) -> int:
        """Number of the point with the greatest likelihood."""
        return int(self.log.argmax())

    @property
    def pairs(self) -> tuple[Floats, Floats]:
        """(g h,) B^2 and K^2 of each point."""
        return _pairs(self.B, self.K)

    @property
    def powers(self) -> Floats:
        """(3,) N^2, B^2 and K^2 there."""
        i, j = divmod(self.best, self.K.size)
        return np.array([self.a[self.best], self.B[i] ** 2, self.K[j] ** 2])


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Observations of one channel with a description: rows, regressors and the terms that are free.

    Attributes
    ----------
    powers, coefficients : the observations.
    shape : what else the spectrum has, x = 4 sin^2(pi f): "" nothing, ``quantised`` an additional c x, ``filtered`` the
        factor 1 / (1 + c x) of a first-order low-pass.
    error : 1, relative error of the model in every power.
    """

    powers: Powers
    coefficients: Coefficients
    shape: str = ""
    error: float = 0.0

    @cached_property
    def dof(self) -> Floats:
        """(r,) degrees of freedom, with the error of the model."""
        return np.asarray(1.0 / (1.0 / self.powers.dof + 0.5 * self.error**2))

    def surface(self, B: Floats, K: Floats, c: float = 0.0) -> Surface:
        """Return the likelihood for all pairs of B and K.

        Parameters
        ----------
        c : first value of the shape.
        """
        b, k = _pairs(B, K)
        a, c_best, log, variance = self._profile(b, k, np.full(b.size, c))
        more, beta, beta_variance = self._restricted(a, b, k)
        # without any noise there is no likelihood; a finite number, so that a surface of it alone gives no NaN
        total = log + more
        total = np.where(np.isfinite(total), total, np.finfo(np.float32).min)
        return Surface(B, K, total, a, variance, c_best, beta, beta_variance)

    def _profile(
        self, b: Floats, k: Floats, c: Floats, *, held: bool = False
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Return (m,) the best N^2 and shape, the logarithm of the likelihood, the variance of N^2.

        Fisher's scoring: the model is linear in N^2, and in the shape where it is additive.

        Parameters
        ----------
        c : (m,) first values of the shape.
        held : the shape stays as it is.
        """
        P, E, half = self.powers.power, self.powers.expected, 0.5 * self.dof
        base = np.multiply.outer(b, E[:, 1]) + np.multiply.outer(k, E[:, 2])
        floor, x, white = self._floor, self._x, E[:, 0]
        a = np.full(b.size, self._white)
        most = 1e-6 * a[0]
        for step in range(SCORING_STEPS + 1):
            model = np.multiply.outer(a, white) + base
            if self.shape == "filtered":
                fall = 1.0 / (1.0 + np.multiply.outer(c, x))
                model *= fall
                slopes = white * fall, -model * x * fall
            elif self.shape:
                model += np.multiply.outer(c, x)
                slopes = np.broadcast_to(white, model.shape), np.broadcast_to(x, model.shape)
            np.maximum(model, floor, out=model)
            weight = half / model**2
            if step == SCORING_STEPS:
                break
            rest = weight * (P - model)
            if self.shape:
                aa, ac, cc, determinant = _information(weight, slopes)
                one, two = ((rest * slope).sum(axis=1) for slope in slopes)
                a = a + (one / aa if held else (cc * one - ac * two) / determinant)
                c = c if held else np.maximum(c + (aa * two - ac * one) / determinant, 0.0)
            else:
                a = a + (rest @ white) / (weight @ white**2)
            a = np.maximum(a, most)
        log = -((P / model + np.log(model)) @ half)
        if not self.shape:
            return a, c, log, 1.0 / (weight @ white**2)
        _, _, cc, determinant = _information(weight, slopes)
        return a, c, log, cc / determinant

    @cached_property
    def _x(self) -> Floats:
        """(r,) 4 sin^2(pi f) of each band, as the shape needs it."""
        return np.asarray(self.powers.expected[:, 4 if self.shape == "filtered" else 3])

    @cached_property
    def _floor(self) -> Floats:
        """(r,) least power of a model."""
        share = np.maximum(LEAST_POWER * self.powers.power, ROUNDING**2 * self.powers.power.max())
        return np.asarray(np.maximum(share, LEAST_VARIANCE))

    @cached_property
    def _white(self) -> float:
        """Return a first value of N^2: the median of the upper bands, behind a filter of those below."""
        order = np.argsort(-self.powers.top)
        third = max(2, order.size // 3)
        rows = (
            order[third : 2 * third] if self.shape == "filtered" and order.size > 2 * third else order[:third]
        )
        found = self.powers.power[rows] / self.powers.expected[rows, 0]
        # impulses leave most bands empty
        return float(np.median(found) or max(found.mean(), LEAST_VARIANCE))

    def _first_shape(self, b: float, k: float) -> float:
        """Return a first value of the shape: the best of a few for some B^2 and K^2."""
        c = np.append(0.0, np.geomspace(1e-3, 1e3, 25)) * (self._white if self.shape == "quantised" else 1.0)
        log = self._profile(np.full(c.size, b), np.full(c.size, k), c, held=True)[2]
        return float(c[log.argmax()])

    def _restricted(self, a: Floats, b: Floats, k: Floats) -> tuple[Floats, Floats, Floats]:
        """Return (m,) the restricted log likelihood of the coefficients, and (m, q) the regression with variances."""
        y, X = self.coefficients.y, self.coefficients.X
        q = X.shape[1]
        v = np.stack((a, b, k), axis=1) @ self.coefficients.variance
        w = 1.0 / v
        log = -0.5 * (w @ y**2 + np.log(v).sum(axis=1))
        if not q:
            return log, np.zeros((a.size, 0)), np.zeros((a.size, 0))
        XX, Xy = normal_matrix(w, X), w @ (X * y[:, None])
        inverse = np.linalg.inv(XX)
        beta = np.einsum("mij,mj->mi", inverse, Xy)
        log += 0.5 * ((beta * Xy).sum(axis=1) - np.linalg.slogdet(XX)[1])
        return log, beta, np.diagonal(inverse, axis1=1, axis2=2)

    def search(self, samples: float, start: tuple[Floats, Floats] | None = None) -> Surface:
        """Return the likelihood on a grid that holds all of it.

        Parameters
        ----------
        samples : length of the record.
        start : grids of an earlier search; None: unknown.
        """
        white, c = self._white, 0.0
        if start is None:
            lowest = 2.0 * np.pi * 0.5 / samples
            B, K = np.sqrt(white * lowest * DECADES), np.sqrt(white * lowest**2 * DECADES)
        else:
            B, K = start
        if self.shape:
            c = self._first_shape(float(np.median(B)) ** 2, float(np.median(K)) ** 2)
        surface, even = self.surface(B, K, c), start is not None
        for _ in range(MOST_MOVES):
            if even and _holds(surface):
                break
            c, even = float(surface.c[surface.best]), True
            surface = self.surface(_near(surface, 0), _near(surface, 1), c)
        return surface

    def misfit(self, surface: Surface, rows: int | None = None) -> tuple[float, float]:
        """Return the misfit of the powers, or of the first `rows` of them, and its degrees of freedom.

        The deviance of gamma variables: chi-square of one degree each (McCullagh & Nelder 1989, section 8.3).
        """
        ratio = np.maximum(self.powers.power / self.model(surface), ROUNDING**2)[:rows]
        deviance = self.dof[:rows] * (ratio - 1.0 - np.log(ratio))
        # two or three terms are fitted, most of them to the powers
        return float(deviance.sum()), max(float(ratio.size) - 2.0 - bool(self.shape), 1.0)

    def slow_misfit(self, surface: Surface) -> tuple[float, float]:
        """Return the misfit of the single coefficients, in bands, and its degrees of freedom."""
        y, X = self.coefficients.y, self.coefficients.X
        w = 1.0 / (surface.powers @ self.coefficients.variance)
        inverse = np.linalg.inv(normal_matrix(w[None], X)[0])
        ratio = w * (y - X @ surface.beta[surface.best]) ** 2
        own = 1.0 - w * np.einsum("nq,qr,nr->n", X, inverse, X)  # what the regression leaves of each
        starts = np.array([n for n in SLOW_BANDS if n < y.size], dtype=np.int64)
        if not starts.size:
            return 0.0, 0.0
        dof = np.maximum(np.add.reduceat(own, starts), LEAST_VARIANCE)
        known = dof >= SLOW_DEGREES
        dof = dof[known]
        ratio = np.maximum(np.add.reduceat(ratio, starts)[known] / dof, ROUNDING**2)
        return float((dof * (ratio - 1.0 - np.log(ratio))).sum()), float(dof.size)

    def model(self, surface: Surface) -> Floats:
        """Return (r,) the expected powers at the greatest likelihood."""
        model = self.powers.expected[:, :3] @ surface.powers
        shape = surface.c[surface.best] * self._x
        if self.shape:
            model = model / (1.0 + shape) if self.shape == "filtered" else model + shape
        return np.asarray(np.maximum(model, self._floor))

    def p_value(self, surface: Surface, rows: int | None = None) -> float:
        """Return the probability of a misfit as large."""
        misfit, dof = self.misfit(surface, rows)
        return float(gammaincc(0.5 * dof, 0.5 * misfit))


def mixed(one: Surface, two: Surface, weight: float) -> Surface:
    """Return the likelihood of either of two descriptions on the same grid, the second one `weight` times as likely.

    The regression is that of the first.
    """
    top = max(one.log.max(), two.log.max())
    p, q = np.exp(one.log - top), weight * np.exp(two.log - top)
    total = np.maximum(p + q, 1e-300)
    a = (p * one.a + q * two.a) / total
    variance = (p * one.a_variance + q * two.a_variance) / total
    return Surface(one.B, one.K, np.log(total) + top, a, variance, one.c, one.beta, one.beta_variance)


def quantiles(surface: Surface, axis: int, probabilities: Floats) -> Floats:
    """Return quantiles of B (axis 0) or K (axis 1).

    The cumulative probability is a piecewise cubic with the probability density as its slope.
    """
    grid = (surface.B, surface.K)[axis]
    p = _probability(surface).sum(axis=1 - axis)
    p[0] *= 2.0 if grid[0] == 0.0 else 1.0
    inner = np.concatenate(
        ([5.0 * p[0] + 8.0 * p[1] - p[2]], 6.5 * (p[1:-2] + p[2:-1]) - 0.5 * (p[:-3] + p[3:]))
    )
    cells = np.append(inner, 5.0 * p[-1] + 8.0 * p[-2] - p[-3]) / 12.0
    ends = np.concatenate(([0.0], np.cumsum(np.maximum(cells, 0.0))))
    t = np.arange(FINE)[:, None] / FINE
    rise = t * t * (3.0 - 2.0 * t)
    inside = ends[:-1] + rise * np.diff(ends) + t * (1.0 - t) * ((1.0 - t) * p[:-1] - t * p[1:])
    cumulative = np.maximum.accumulate(np.append(inside.T.ravel(), ends[-1]))
    at = np.linspace(grid[0], grid[-1], cumulative.size)
    return np.asarray(np.interp(probabilities, cumulative / cumulative[-1], at))


def evidence(surface: Surface, axis: int) -> float:
    """Return twice the logarithm of the likelihood ratio of B or K against zero; inf where the grid is far from it."""
    grid = (surface.B, surface.K)[axis]
    if grid[0] > 0.0:
        return np.inf
    log = surface.log.reshape(surface.B.size, surface.K.size).max(axis=1 - axis)
    return float(2.0 * (log.max() - log[0]))


def averaged(surface: Surface, value: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Return mean and standard deviation of quantities (g h, ...) that have a normal error at each point."""
    p = _probability(surface).ravel()
    p = p / p.sum()
    mean = p @ value
    return mean, np.sqrt(p @ (variance + (value - mean) ** 2))


def normal_matrix(w: Floats, X: Floats) -> Floats:
    """Return (m, q, q) X^T W X for weights (m, n), invertible also where columns are alike."""
    n, q = X.shape
    XX = (w @ (X[:, :, None] * X[:, None, :]).reshape(n, -1)).reshape(-1, q, q)
    ridge = ROUNDING * np.einsum("mii->m", XX) + LEAST_VARIANCE
    return np.asarray(XX + ridge[:, None, None] * np.eye(q))


def _pairs(B: Floats, K: Floats) -> tuple[Floats, Floats]:
    return np.repeat(B**2, K.size), np.tile(K**2, B.size)


def _probability(surface: Surface) -> Floats:
    """Return (g, h) the probability at each point of an even grid, not normalised; at zero a point has half a cell."""
    p = np.exp(surface.log - surface.log.max()).reshape(surface.B.size, surface.K.size)
    p[0] *= 0.5 if surface.B[0] == 0.0 else 1.0
    p[:, 0] *= 0.5 if surface.K[0] == 0.0 else 1.0
    return np.asarray(p)


def _information(weight: Floats, slopes: tuple[Floats, Floats]) -> tuple[Floats, Floats, Floats, Floats]:
    """Return (m,) the information about N^2, about both, about the shape, and its determinant."""
    aa, ac, cc = ((weight * slopes[i] * slopes[j]).sum(axis=1) for i, j in ((0, 0), (0, 1), (1, 1)))
    cc = np.maximum(cc, LEAST_VARIANCE)
    return aa, ac, cc, np.maximum(np.maximum(aa * cc - ac * ac, ROUNDING * aa * cc), 1e-300)


def _near(surface: Surface, axis: int) -> Floats:
    """Return a finer grid about the values whose likelihood is not negligible."""
    grid = (surface.B, surface.K)[axis]
    log = surface.log.reshape(surface.B.size, surface.K.size).max(axis=1 - axis)
    rows = np.flatnonzero(log >= log.max() - DROP)
    low = grid[rows[0] - 1] if rows[0] > 1 else 0.0
    high = grid[rows[-1] + 1] if rows[-1] + 1 < grid.size else 2.0 * grid[-1]
    return np.linspace(low, high, GRID)


def _holds(surface: Surface) -> bool:
    """Return whether the grid holds the whole likelihood, and is not much too wide."""
    shape = surface.B.size, surface.K.size
    for axis, grid in enumerate((surface.B, surface.K)):
        log = surface.log.reshape(shape).max(axis=1 - axis)
        rows = np.flatnonzero(log >= log.max() - 0.7 * DROP)
        low = rows[0] == 0 and grid[0] > 0.0
        if low or rows[-1] == grid.size - 1 or rows.size < grid.size // 2:
            return False
    return True


def rows_up_to(powers: Powers, highest: float) -> Bools:
    """Return (r,) the powers up to a frequency, cycles per sample."""
    return np.asarray(powers.top <= highest * (1.0 + 1e-9))
