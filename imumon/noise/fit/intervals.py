"""Confidence limits of the powers by inverting the efficient score test, skewness and boundary included.

For a value x of one power, the others are fitted with it held, and the score

    U(x) = w' (s - A_a x),    w = V^-1 A_a projected off the other terms (Neyman 1959; Cox & Hinkley 9.3)

tells how far the data lie above (U > 0) or below. Since w has no part along the other terms, the
limits do not lean on a neighbour that came out as zero and may not be. U is a sum of few squares at long
averaging times, and skew: with the covariance V(mu) as variance function of a natural exponential family
the third cumulant of w's is 2 sum_j w_j (V w)_j^2 / mu_j, exact for gamma variables. A shifted gamma of
those cumulants, and a normal variable beside it, make U a standard normal score z(x), and the limits are
where z passes the quantiles.
"""

from __future__ import annotations

import numpy as np

from imumon.noise.fit.leastsquares import SubsetFrame, T, blocks, solve
from imumon.noise.fit.quantiles import cube_root_score, normal_cdf, normal_quantile
from imumon.samples import Bools, Floats, Ints

_TRIALS = 24
_NODES = np.linspace(-5.0, 5.0, 81)  # normal scores of the gamma part
_WEIGHTS = np.exp(-0.5 * _NODES**2) / np.exp(-0.5 * _NODES**2).sum()
_SMOOTH = 0.05  # least normal share of the variance: what the nodes resolve
_SKEWEST = 2.8  # a single square
_CLOSE = 4e-3  # standard deviations: as near to a quantile as a limit need be,
_NEAR = 2e-4  # and, where the score leaps over it, relative to the limit too
_FAR = 1e6  # times estimate and deviation: a bound out there says nothing
_ROUNDS = 4  # of weighing the other terms anew: they start from those of a value nearby


def deviations(frame: SubsetFrame, free: Bools, p: Floats) -> Floats:
    """Standard deviations of the powers around p, with every term of N, B, K in play.

    Parameters
    ----------
    free : (b, 5) terms that may be there.
    p : (b, 5) powers in units of tau0.

    Returns
    -------
    (b, 5) units of p; inf for a term that the octaves do not tell from the others.
    """
    found = np.empty_like(p)
    for part in blocks(len(p)):
        inverse, known = _inverse(frame.take(part).weigh(p[part]).normal, _in_play(free[part]))
        found[part] = np.where(known, np.sqrt(np.maximum(np.einsum("bii->bi", inverse), 0.0)), np.inf)
    return found


def score(frame: SubsetFrame, free: Bools, term: Ints, x: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Standard normal scores of the data if a power had the value x.

    Parameters
    ----------
    free : (b, 5) terms that may be there.
    term : (b,) index of the power.
    x : (b,) its value, >= 0, units of tau0.
    start : (b, 5) powers the others are sought from.

    Returns
    -------
    z : (b,) 1, positive where the data ask for more than x.
    p : (b, 5) powers with the one held.
    """
    rows = np.arange(len(x))
    others, held = free.copy(), np.zeros(start.shape)
    others[rows, term] = False
    held[rows, term] = x
    p = solve(frame, others, start=start, held=held, rounds=_ROUNDS)
    at = frame.weigh(p)
    inverse, _ = _inverse(at.normal, _in_play(free))
    column = inverse[rows, :, term][:, :, None]
    weights, spread = (at.weighted @ column)[:, :, 0], (at.design @ column)[:, :, 0]  # w and V w
    rest = frame.variance / at.model - at.design[rows, :, term] * x[:, None]
    # w is orthogonal to the other terms, so that what they come to need not be taken off
    both = weights * spread
    deviation = np.sqrt(np.maximum(both.sum(axis=1), 1e-300))
    t = (weights * rest).sum(axis=1) / deviation
    third = 2.0 * (both * spread).sum(axis=1)
    mixed = (at.relative @ both[:, :, None])[:, :, 0]
    fourth = (both * (2.0 * spread**2 + 4.0 * mixed)).sum(axis=1)
    return normal_score(t, third / deviation**3, fourth / deviation**4), p


def normal_score(t: Floats, skewness: Floats, kurtosis: Floats) -> Floats:
    """Standard normal score of a standardised variable that is a gamma variable and a normal one together.

    The gamma part, up to shift and sign, has the share of the variance and the skewness that give the sum
    its third and fourth cumulant: of squares that are weighed with both signs, the few that dominate are
    skew and the many others are not.

    Parameters
    ----------
    t : (b,) 1, (variable - mean) / standard deviation.
    skewness, kurtosis : (b,) 1, the latter in excess of the normal one.
    """
    sign = np.where(skewness < 0.0, -1.0, 1.0)
    size = np.maximum(np.abs(skewness), 1e-6)
    z = _gamma_score(sign * t, size)
    mixed = np.flatnonzero((size > 0.05) & (np.abs(t) < 8.0))
    if mixed.size:
        share = np.clip(
            np.sqrt(1.5 * size[mixed] ** 2 / np.maximum(kurtosis[mixed], 1e-12)), 0.02, 1.0 - _SMOOTH
        )
        skew = np.minimum(size[mixed] / share**1.5, _SKEWEST)
        shape = 8.0 / skew**2
        h = 2.0 / (9.0 * shape)
        node = np.maximum(1.0 - h[:, None] + _NODES * np.sqrt(h)[:, None], 0.0) ** 3
        gamma = (node - 1.0) * np.sqrt(shape / 2.0)[:, None]
        distance = ((sign * t)[mixed, None] - np.sqrt(share)[:, None] * gamma) / np.sqrt(1.0 - share)[:, None]
        below = normal_cdf(distance) @ _WEIGHTS
        exact = np.array([normal_quantile(float(p)) for p in np.clip(below, 1e-9, 1.0 - 1e-9)])
        z[mixed] = np.where(np.abs(exact) < 5.5, exact, z[mixed])
    return np.asarray(sign * z)


def _gamma_score(t: Floats, skewness: Floats) -> Floats:
    """Score of a gamma variable of positive skewness."""
    return cube_root_score(np.maximum(1.0 + t * skewness / 2.0, 0.0), 8.0 / skewness**2)


def limits(
    frame: SubsetFrame,
    free: Bools,
    term: Ints,
    p: Floats,
    here: Floats,
    spread: Floats,
    target: Floats,
    upper: Bools,
) -> Floats:
    """Values of powers at which their scores pass a quantile.

    Parameters
    ----------
    free : (b, 5) terms that may be there.
    term : (b,) index of the power.
    p : (b, 5) fitted powers, in which the search begins; the power of `term` may be zero.
    here : (b,) score at that value.
    spread : (b,) standard deviation of the power.
    target : (b,) score sought: below `here` for an upper limit, above it for a lower one.
    upper : (b,) which of the two.

    Returns
    -------
    (b,) units of tau0; inf (upper) where no value is excluded, 0 (lower) where zero is not.
    """
    rows = np.arange(len(term))
    begin = p[rows, term]
    # g = score - target falls with x: the root lies between left (g > 0) and right (g < 0)
    left = np.where(upper, begin, 0.0)
    right = np.where(upper, np.inf, begin)
    last_x, last_g = begin.copy(), here - target
    x = np.maximum(begin - (target - here) * spread, np.where(upper, 0.0, 0.02 * begin))
    start, found = p.copy(), np.full(len(term), np.nan)
    for _ in range(_TRIALS):
        todo = np.flatnonzero(np.isnan(found))
        if not todo.size:
            break
        z, start[todo] = score(frame.take(todo), free[todo], term[todo], x[todo], start[todo])
        g = z - target[todo]
        here_x = x[todo]
        left[todo] = np.where(g > 0.0, here_x, left[todo])
        right[todo] = np.where(g > 0.0, right[todo], here_x)
        between = right[todo] - left[todo]
        done = (np.abs(g) < _CLOSE) | (between < np.minimum(_CLOSE * spread[todo], _NEAR * here_x))
        found[todo[done]] = here_x[done]
        x[todo] = _next(here_x, g, last_x[todo], last_g[todo], left[todo], right[todo])
        last_x[todo], last_g[todo] = here_x, g
        lost = todo[~done & (x[todo] > _FAR * (begin + spread)[todo])]
        found[lost] = np.inf
        lost = todo[~done & (right[todo] < 1e-9 * begin[todo])]
        found[lost] = 0.0
    return np.where(np.isnan(found), x, found)


def _next(x: Floats, g: Floats, last_x: Floats, last_g: Floats, left: Floats, right: Floats) -> Floats:
    """Where to look next: along the secant where that stays well inside the bracket, else halfway."""
    slope = (g - last_g) / np.where(x == last_x, 1.0, x - last_x)
    secant = x - g / np.where(slope < 0.0, slope, -1e-300)
    open_ = np.isinf(right)
    reach = np.where(open_, 4.0 * x - 3.0 * left + 1e-300, right)
    reach = np.where(open_, np.maximum(reach, 4.0 * x), reach)
    half = np.where(open_, reach, (left + np.where(open_, left, right)) / 2.0)
    return np.where((slope < 0.0) & (secant > left) & (secant < reach), secant, half)


def _in_play(free: Bools) -> Bools:
    """Terms whose value is unknown: N, B, K even where they came out as zero, the others where fitted."""
    return np.asarray(free | (np.arange(T) < 3))


def _inverse(normal: Floats, terms: Bools) -> tuple[Floats, Bools]:
    """Inverse of the normal equations over some terms, zero elsewhere, and which terms have one."""
    size = np.einsum("bii->bi", normal)
    known = terms & (size > 0.0)
    scale = 1.0 / np.sqrt(np.where(known, size, 1.0))
    both = known[:, :, None] & known[:, None, :]
    matrix = np.where(both, normal * scale[:, :, None] * scale[:, None, :], np.eye(T))
    values, vectors = np.linalg.eigh(matrix)
    kept = vectors * (values > 1e-12 * values[:, -1:])[:, None, :]
    inverse = (kept / np.where(values > 0.0, values, 1.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    reached = (kept * vectors).sum(axis=2) > 0.999
    return np.where(both, inverse * scale[:, :, None] * scale[:, None, :], 0.0), known & reached
