"""Quantiles of the normal and the chi-square distribution, for any positive degrees of freedom.

numpy and the standard library only: the intervals of a daemon need no more. Chi-square probabilities are
the regularised incomplete gamma function by its series (Abramowitz & Stegun 6.5.29) and, for many degrees
of freedom, the cube-root normal approximation of Wilson and Hilferty, better than 1e-5 there.
"""

from __future__ import annotations

import math
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from imumon.samples import Floats

_NORMAL = NormalDist()
_MANY = 300.0  # degrees of freedom from which the cube root is normal enough
_TABLED = 60.0  # and for quantiles, which are wanted less exactly


def normal_quantile(probability: float) -> float:
    """z with P(Z <= z) = probability.

    >>> round(normal_quantile(0.975), 4)
    1.96
    """
    return _NORMAL.inv_cdf(probability)


def normal_cdf(z: Floats) -> Floats:
    """P(Z <= z), better than 2e-7 (Abramowitz & Stegun 26.2.17).

    >>> normal_cdf(np.array([0.0, 1.96, -4.0])).round(6)
    array([5.00000e-01, 9.75002e-01, 3.20000e-05])
    """
    t = 1.0 / (1.0 + 0.2316419 * np.abs(z))
    series = t * (0.319381530 + t * (-0.356563782 + t * (1.781477937 + t * (-1.821255978 + t * 1.330274429))))
    tail = series * np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    return np.asarray(np.where(z < 0.0, tail, 1.0 - tail))


def cube_root_score(ratio: Floats, dof: Floats) -> Floats:
    """Standard normal score of chi2/dof by Wilson and Hilferty (1931).

    Parameters
    ----------
    ratio : 1, value over expectation, >= 0.
    dof : equivalent degrees of freedom.
    """
    h = 2.0 / (9.0 * dof)
    return np.asarray((np.cbrt(ratio) - (1.0 - h)) / np.sqrt(h))


def chi2_cdf(value: Floats | float, dof: Floats | float) -> Floats:
    """P(chi2 <= value).

    Parameters
    ----------
    value, dof : 1, of shapes that broadcast; `dof` > 0.

    >>> chi2_cdf(3.841459, 1.0).round(6)
    np.float64(0.95)
    """
    x, v = np.broadcast_arrays(np.asarray(value, dtype=np.float64), np.asarray(dof, dtype=np.float64))
    out = np.zeros(x.shape)
    many = v > _MANY
    if np.any(many):
        score = cube_root_score(x[many] / v[many], v[many])
        out[many] = [_NORMAL.cdf(float(z)) for z in score]
    few = ~many & (x > 0.0)
    if np.any(few):
        a, half = v[few] / 2.0, np.minimum(x[few] / 2.0, 600.0)
        term = 1.0 / a
        total = term.copy()
        for n in range(1, 4000):
            term = term * half / (a + n)
            total += term
            if np.all(term < 1e-16 * total):
                break
        gamma = np.array([math.lgamma(float(g)) for g in a])
        out[few] = np.minimum(1.0, total * np.exp(a * np.log(half) - half - gamma))
    return out[()]


def chi2_tail(value: float, dof: int) -> float:
    """P(chi2 > value) for whole degrees of freedom (Abramowitz & Stegun 26.4.4, 26.4.5).

    >>> round(chi2_tail(9.487729, 4), 6), round(chi2_tail(11.0705, 5), 6)
    (0.05, 0.05)
    """
    half = max(value, 0.0) / 2.0
    if half > 700.0:
        return 0.0
    odd = dof % 2
    total = math.erfc(math.sqrt(half)) if odd else 0.0
    term = math.exp(-half) * (math.sqrt(half / math.pi) * 2.0 if odd else 1.0)
    for n in range(dof // 2):
        total += term
        term *= half / (n + (1.5 if odd else 1.0))
    return min(1.0, total)


def chi2_quantile(probability: float, dof: Floats | float) -> Floats:
    """Value with P(chi2 <= value) = probability, better than 1e-3 from a quarter of a degree of freedom on.

    Parameters
    ----------
    probability : between 0 and 1.
    dof : 1, any shape.

    >>> chi2_quantile(0.025, np.array([1.0, 1.7, 30.0])).round(3)
    array([1.0000e-03, 2.5000e-02, 1.6791e+01])
    """
    v = np.asarray(dof, dtype=np.float64)
    h = 2.0 / (9.0 * v)
    many = v * np.maximum(1.0 - h + normal_quantile(probability) * np.sqrt(h), 0.0) ** 3
    grid, quantiles = _few(probability)
    few = np.exp(np.interp(np.log(v), grid, quantiles))
    return np.asarray(np.where(v < _TABLED, few, many))[()]


@lru_cache(maxsize=8)
def _few(probability: float) -> tuple[Floats, Floats]:
    """Logarithms of few degrees of freedom and of their quantiles."""
    dof = np.exp(np.linspace(np.log(0.25), np.log(_TABLED), 200))
    low, high = np.full(dof.size, -40.0), np.full(dof.size, np.log(5.0 * _TABLED))
    for _ in range(40):
        middle = (low + high) / 2.0
        below = chi2_cdf(np.exp(middle), dof) < probability
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.log(dof), (low + high) / 2.0


_EDF = (1.0, 1.02, 1.06, 1.14, 1.24, 1.45, 1.8, 2.4, 3.0, 3.6, 4.7, 6.4, 8.7, 12.2, 18.0)
_SHARE = (
    *(0.001, 0.0048, 0.0077, 0.0142, 0.02, 0.0305, 0.0475, 0.074),
    *(0.103, 0.132, 0.182, 0.245, 0.314, 0.39, 0.472),
)


def few_differences_quantile(dof: Floats) -> Floats:
    """2.5 % quantile of an Allan variance over its expectation, where few overlapping differences make it.

    Chi-square of the same equivalent degrees of freedom has too long a tail towards zero there: several
    squares of unlike weights are less often all small than one and a fraction of equal ones. The table is
    the distribution of the squares with the weights that they have, the eigenvalues of the covariance of
    the differences at R = 8, for flicker and random walk (white noise is up to a third narrower); from 18
    degrees of freedom on it is chi-square's. A tenth is taken off: the degrees of freedom come from
    a fit themselves.

    >>> few_differences_quantile(np.array([1.0, 1.24, 100.0])).round(3)
    array([0.001, 0.02 , 0.742])
    """
    few = np.interp(np.log(dof), np.log(_EDF), _SHARE)
    return np.asarray(np.where(dof < _EDF[-1], few, chi2_quantile(0.025, dof) / dof))
