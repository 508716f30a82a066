"""Confidence limits of the powers from the efficient score test, with skewness and boundary included.

For a value x of one power, the others are fitted with it held, and the score

    U(x) = w' (s - A_a x),    w = V^-1 A_a projected off the other terms (Neyman 1959; Cox & Hinkley 9.3)

measures how far the data lie above (U > 0) or below. Since w has no part along the other terms, the limits do
not depend on another term whose estimate is zero at the boundary. U is a sum of few squares at long averaging
times, and skew: with the covariance V(mu) as variance function of a natural exponential family the third
cumulant of w's is 2 sum_j w_j (V w)_j^2 / mu_j, exact for gamma variables. A shifted gamma of those
cumulants together with a normal variable turns U into a standard normal score z(x), and the limits are where
z passes the quantiles.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import ndtr, ndtri

from imumon.noise.fit.leastsquares import PreparedProblems, T, cube_root_score, solve
from imumon.samples import Bools, Floats, Ints

MAX_TRIALS = 24
"""Values at which a score is computed in search of a limit, at most. Not critical."""

SCORE_ROUNDS = 4
"""Rounds of weighting the other terms for each value: they start near their values. Sensitivity: halved 2.2
%, doubled 17 % (gyro z time_to B of the record "disturbed")."""

SCORE_TOLERANCE = 4e-3
"""Standard deviations by which the score of a limit may miss its quantile. Sensitivity: halved 2 %, doubled
3.2 % (accel y K high of the record "disturbed")."""

LIMIT_TOLERANCE = 2e-4
"""1, relative width of the bracket that is narrow enough where the score jumps over its quantile. Not
critical."""

FAR_BOUND = 1e6
"""1, multiple of estimate plus deviation beyond which a bound is reported as unknown. Not critical."""

NEAR_ZERO = 1e-9
"""1, share of the estimate below which a lower limit is reported as zero. Not critical."""

FIRST_LOWER = 0.02
"""1, share of the estimate at which the search for a lower limit begins at the lowest. Not critical."""

STEP_FACTOR = 4.0
"""1, growth of the trial value while an upper limit has no bracket. Sensitivity: halved 2.8 %, doubled 1.6 %
(gyro x distribution bias_low of the record "disturbed")."""
GAMMA_REACH = 5.0
"""Standard deviations that the nodes of the gamma part reach to either side. Sensitivity: halved 82 %,
doubled 0 % (gyro x K high of the record "disturbed")."""

GAMMA_NODES = 81
"""Nodes of the gamma part. Not critical."""

LEAST_NORMAL_SHARE = 0.05
"""1, least share of the normal part in the variance: what the nodes resolve. Sensitivity: halved 30 %,
doubled 1.5e+02 % (gyro x distribution bias_low of the record "disturbed")."""

LEAST_GAMMA_SHARE = 0.02
"""1, least share of the gamma part in the variance. Not critical."""
MAX_SKEWNESS = 2.8
"""1, skewness of a single square, 2 sqrt(2): no sum of squares of one sign is more skew. Sensitivity: halved
1.5e+02 %, doubled 0 % (gyro x distribution bias_low of the record "disturbed")."""

LEAST_SKEWNESS = 0.05
"""1, skewness from which on the mixture of gamma and normal is used; below, both agree. Not critical."""

FAR_SCORE = 8.0
"""Standard deviations beyond which the mixture is not used, because its tail cannot be resolved. Not
critical."""

MIXTURE_SCORE = 5.5
"""Standard deviations up to which the score of the mixture is used. Not critical."""

MIXTURE_TAIL = 1e-9
"""1, least probability that the mixture resolves. Not critical."""

SINGULAR = 1e-12
"""1, ratio of eigenvalues of the scaled normal equations below which a direction is undetermined. Not
critical."""

DETERMINED = 0.999
"""1, share of a term's direction that must be determined for it to have limits. Sensitivity: halved 0 %,
doubled changes which values appear (cannot of the record "ValueError")."""


def deviations(prepared: PreparedProblems, free: Bools, p: Floats) -> Floats:
    """Return the standard deviations of the powers around p, with N, B and K always among the terms.

    Parameters
    ----------
    free : (b, 5) terms that are fitted.
    p : (b, 5) powers in units of tau0.

    Returns
    -------
    (b, 5) units of p; inf for a term that the octaves do not distinguish from the others.
    """
    inverse, known = _inverse(prepared.weight(p).normal, _unknown_terms(free))
    return np.where(known, np.sqrt(np.maximum(np.einsum("bii->bi", inverse), 0.0)), np.inf)


def score(
    prepared: PreparedProblems, free: Bools, term: Ints, x: Floats, start: Floats
) -> tuple[Floats, Floats]:
    """Return standard normal scores of the data under the hypothesis that a power has the value x.

    Parameters
    ----------
    free : (b, 5) terms that are fitted.
    term : (b,) index of the power.
    x : (b,) its value, >= 0, units of tau0.
    start : (b, 5) powers from which the fit of the others starts.

    Returns
    -------
    z : (b,) 1, positive where the data lie above x.
    p : (b, 5) fitted powers with the one held.
    """
    rows = np.arange(len(x))
    others, held = free.copy(), np.zeros(start.shape)
    others[rows, term] = False
    held[rows, term] = x
    p = solve(prepared, others, start=start, held=held, rounds=SCORE_ROUNDS)
    weighted = prepared.weight(p)
    inverse, _ = _inverse(weighted.normal, _unknown_terms(free))
    column = inverse[rows, :, term][:, :, None]
    weights, spread = (weighted.weighted @ column)[:, :, 0], (weighted.design @ column)[:, :, 0]  # w and V w
    rest = (prepared.variance - prepared.offset) / weighted.model - weighted.design[rows, :, term] * x[
        :, None
    ]
    # w is orthogonal to the other terms, so that they need not be subtracted
    both = weights * spread
    deviation = np.sqrt(np.maximum(both.sum(axis=1), 1e-300))
    t = (weights * rest).sum(axis=1) / deviation
    third = 2.0 * (both * spread).sum(axis=1)
    mixed = (weighted.relative @ both[:, :, None])[:, :, 0]
    fourth = (both * (2.0 * spread**2 + 4.0 * mixed)).sum(axis=1)
    return normal_score(t, third / deviation**3, fourth / deviation**4), p


def normal_score(t: Floats, skewness: Floats, kurtosis: Floats) -> Floats:
    """Return the standard normal score of a standardised sum of a gamma and a normal variable.

    The gamma part, up to shift and sign, has the share of the variance and the skewness that give the sum its
    third and fourth cumulant: among squares with weights of both signs, the few that dominate are skew and
    the many others are not.

    Parameters
    ----------
    t : (b,) 1, (variable - mean) / standard deviation.
    skewness, kurtosis : (b,) 1, the latter in excess of the normal one.
    """
    sign = np.where(skewness < 0.0, -1.0, 1.0)
    size = np.maximum(np.abs(skewness), 1e-6)
    z = _gamma_score(sign * t, size)
    mixed = np.flatnonzero((size > LEAST_SKEWNESS) & (np.abs(t) < FAR_SCORE))
    if mixed.size:
        share = np.sqrt(1.5 * size[mixed] ** 2 / np.maximum(kurtosis[mixed], 1e-12))
        share = np.clip(share, LEAST_GAMMA_SHARE, 1.0 - LEAST_NORMAL_SHARE)
        skew = np.minimum(size[mixed] / share**1.5, MAX_SKEWNESS)
        shape = 8.0 / skew**2
        h = 2.0 / (9.0 * shape)
        nodes, weights = _gamma_nodes(GAMMA_REACH, GAMMA_NODES)
        node = np.maximum(1.0 - h[:, None] + nodes * np.sqrt(h)[:, None], 0.0) ** 3
        gamma = (node - 1.0) * np.sqrt(shape / 2.0)[:, None]
        distance = ((sign * t)[mixed, None] - np.sqrt(share)[:, None] * gamma) / np.sqrt(1.0 - share)[:, None]
        exact = ndtri(np.clip(ndtr(distance) @ weights, MIXTURE_TAIL, 1.0 - MIXTURE_TAIL))
        z[mixed] = np.where(np.abs(exact) < MIXTURE_SCORE, exact, z[mixed])
    return np.asarray(sign * z)


@lru_cache(maxsize=2)
def _gamma_nodes(reach: float, count: int) -> tuple[Floats, Floats]:
    """Return normal scores of the gamma part and their weights, (count,) each."""
    nodes = np.linspace(-reach, reach, count)
    density = np.exp(-0.5 * nodes**2)
    return nodes, density / density.sum()


def _gamma_score(t: Floats, skewness: Floats) -> Floats:
    """Return the standard normal score of a gamma variable of positive skewness."""
    return cube_root_score(np.maximum(1.0 + t * skewness / 2.0, 0.0), 8.0 / skewness**2)


def limits(
    prepared: PreparedProblems,
    free: Bools,
    term: Ints,
    p: Floats,
    score_at_p: Floats,
    deviation: Floats,
    target: Floats,
    upper: Bools,
) -> Floats:
    """Return the values of powers at which their scores pass a quantile.

    Parameters
    ----------
    free : (b, 5) terms that are fitted.
    term : (b,) index of the power.
    p : (b, 5) fitted powers, where the search begins; the power of `term` may be zero.
    score_at_p : (b,) score at that value.
    deviation : (b,) standard deviation of the power.
    target : (b,) score of the limit: below `score_at_p` for an upper limit, above it for a lower one.
    upper : (b,) whether it is an upper limit.

    Returns
    -------
    (b,) units of tau0; inf (upper) where no value is excluded, 0 (lower) where zero is not.
    """
    rows = np.arange(len(term))
    begin = p[rows, term]
    # g = score - target falls with x: the root lies between left (g > 0) and right (g < 0)
    left = np.where(upper, begin, 0.0)
    right = np.where(upper, np.inf, begin)
    last_x, last_g = begin.copy(), score_at_p - target
    lowest = np.where(upper, 0.0, FIRST_LOWER * begin)
    x = np.maximum(begin - (target - score_at_p) * deviation, lowest)
    start, result = p.copy(), np.full(len(term), np.nan)
    for _ in range(MAX_TRIALS):
        todo = np.flatnonzero(np.isnan(result))
        if not todo.size:
            break
        z, start[todo] = score(prepared.take(todo), free[todo], term[todo], x[todo], start[todo])
        g = z - target[todo]
        trial = x[todo]
        left[todo] = np.where(g > 0.0, trial, left[todo])
        right[todo] = np.where(g > 0.0, right[todo], trial)
        width = right[todo] - left[todo]
        narrow = width < np.minimum(SCORE_TOLERANCE * deviation[todo], LIMIT_TOLERANCE * trial)
        done = (np.abs(g) < SCORE_TOLERANCE) | narrow
        result[todo[done]] = trial[done]
        x[todo] = _next_trial(trial, g, last_x[todo], last_g[todo], left[todo], right[todo])
        last_x[todo], last_g[todo] = trial, g
        unbounded = todo[~done & (x[todo] > FAR_BOUND * (begin + deviation)[todo])]
        result[unbounded] = np.inf
        zero = todo[~done & (right[todo] < NEAR_ZERO * begin[todo])]
        result[zero] = 0.0
    return np.where(np.isnan(result), x, result)


def _next_trial(x: Floats, g: Floats, last_x: Floats, last_g: Floats, left: Floats, right: Floats) -> Floats:
    """Return the next trial values: along the secant if that stays inside the bracket, else its middle."""
    slope = (g - last_g) / np.where(x == last_x, 1.0, x - last_x)
    secant = x - g / np.where(slope < 0.0, slope, -1e-300)
    unbounded = np.isinf(right)
    reach = np.where(unbounded, STEP_FACTOR * x - (STEP_FACTOR - 1.0) * left + 1e-300, right)
    reach = np.where(unbounded, np.maximum(reach, STEP_FACTOR * x), reach)
    middle = np.where(unbounded, reach, (left + np.where(unbounded, left, right)) / 2.0)
    return np.where((slope < 0.0) & (secant > left) & (secant < reach), secant, middle)


def _unknown_terms(free: Bools) -> Bools:
    """Return the terms with an unknown value: N, B, K even if their estimate is zero, others if fitted."""
    return np.asarray(free | (np.arange(T) < 3))


def _inverse(normal: Floats, terms: Bools) -> tuple[Floats, Bools]:
    """Return the inverse of the normal equations of some terms, zero elsewhere, and which terms have one."""
    size = np.einsum("bii->bi", normal)
    known = terms & (size > 0.0)
    scale = 1.0 / np.sqrt(np.where(known, size, 1.0))
    both = known[:, :, None] & known[:, None, :]
    matrix = np.where(both, normal * scale[:, :, None] * scale[:, None, :], np.eye(T))
    values, vectors = np.linalg.eigh(matrix)
    kept = vectors * (values > SINGULAR * values[:, -1:])[:, None, :]
    inverse = (kept / np.where(values > 0.0, values, 1.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    determined = (kept * vectors).sum(axis=2) > DETERMINED
    return np.where(both, inverse * scale[:, :, None] * scale[:, None, :], 0.0), known & determined
