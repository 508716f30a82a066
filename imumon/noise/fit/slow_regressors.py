"""Allan variances without a straight drift, what follows the temperature, and an exponential.

They bend the Allan deviation at long tau, where they would count as flicker and random walk. Their sizes come
from the block means, by generalised least squares with the noise that the restricted likelihood finds
(`restricted_likelihood`). With d the sum of these effects in each block:

- From `DIRECT_BLOCKS` blocks on, the Allan variance is that of the means less d.
- Below, the Allan variance of d is subtracted, and from one block on also what d and the noise have in common.
  Within a block d is straight, so that its Allan variance rises with tau^2.

The fitted slopes take noise with them. What share of the expectation remains follows from the covariance of
the residuals, trace(D (1 - P) C (1 - P)' D') to trace(D C D'), with D the second differences and P the
projection on the regressors; the variance is divided by it.
"""

from __future__ import annotations

import numpy as np

from imumon.noise.allan import AllanCurve
from imumon.noise.fit.covariance import FLICKER_FLOOR
from imumon.noise.fit.restricted_likelihood import LEAST_BLOCKS, BlockMeans, fit_slow_terms, unit_covariances
from imumon.samples import Floats, Ints

SIGNIFICANT = 2.5
"""Standard errors from which on a drift is removed. Smaller ones bend the curve less than its statistics. Not
critical."""
FOLLOWS = 1.5
"""Standard errors from which on what follows the temperature is removed: it bends the octaves from which B comes
more than a drift does. At 2.5, K beside a weak effect is too high in 5 % of the records instead of 2 %. Not
critical."""
DIRECT_BLOCKS = 4.0
"""Blocks; from here on, means at each block are as precise as the overlapping octave. Not critical."""
SHAPE_ERROR = 0.01
"""1, relative error of the Allan variance of d below `DIRECT_BLOCKS`. Not critical."""
LEAST_REST = 0.2
"""1, least share of the expectation that remains by which a variance is divided. Not critical."""
_LENGTHS = np.unique(np.round(2.0 ** np.arange(0.0, 12.0, 0.25)).astype(np.int64))
"""Blocks, cluster lengths at which the variances of the means are computed."""
_SECOND = np.array([1.0, -2.0, 1.0])
FREE_CONSTANT = 1e3
"""1, variance of the constant over that of the means; it leaves the digits that the slopes need. Not critical."""
LEAST_VARIANCE = 1e-3
"""1, least share of an Allan variance that is left. Not critical."""


def without_slow_regressors(curve: AllanCurve, blocks: BlockMeans) -> tuple[Floats, Floats]:
    """Return the Allan variances without drift and temperature, and what this adds to their covariance.

    Parameters
    ----------
    blocks : means of the channels of the curve.

    Returns
    -------
    variance : (c, k) unit^2.
    extra : (c, k) unit^4, variance of `variance` beyond that of the noise.
    """
    variance, extra = curve.avar.T.copy(), np.zeros(curve.avar.T.shape)
    tau = curve.m * curve.tau0
    positive = np.where((curve.terms > 0) & (curve.avar > 0.0), curve.avar, np.inf)
    white, floor = (positive * tau[:, None]).min(axis=0), positive.min(axis=0) / FLICKER_FLOOR
    known = np.isfinite(white)
    means = np.where(known, blocks.means, np.nan)
    white, floor = np.where(known, white, 1.0), np.where(known, floor, 1.0)
    terms = fit_slow_terms(
        means,
        blocks.length_s,
        white,
        floor,
        share=blocks.share,
        temperature=blocks.temperature,
        settling=True,
    )
    drifts = np.abs(terms.drift) > SIGNIFICANT * terms.drift_error
    follows = np.abs(terms.temperature) > FOLLOWS * terms.temperature_error
    flicker, walk = unit_covariances(len(means))
    for c in np.flatnonzero(drifts | follows | (terms.settling_s > 0.0)):
        rows = np.isfinite(means[:, c]) & (blocks.share[:, c] > 0.0)
        slopes = [np.ones(len(rows)), np.linspace(-1.0, 1.0, len(rows))]
        if blocks.temperature is not None and np.isfinite(terms.temperature[c]):
            rows &= np.isfinite(blocks.temperature)
            slopes.append(blocks.temperature - np.nanmean(blocks.temperature))
        if terms.settling_s[c] > 0.0:
            after = np.arange(len(rows)) - np.argmax(rows)
            exponent = np.maximum(after, 0) * blocks.length_s / terms.settling_s[c]
            slopes += [np.exp(-exponent), exponent * np.exp(-exponent)]
        if rows.sum() < LEAST_BLOCKS:
            continue
        at = np.flatnonzero(rows)
        x, grid, y = np.stack(slopes, axis=1)[at], np.ix_(at, at), means[at, c]
        noise = np.diag(white[c] / blocks.length_s / blocks.share[at, c])
        noise += terms.B2[c] * flicker[grid] + terms.K2[c] * blocks.length_s * walk[grid]
        solved = _solve_contrasts(noise, x)
        projection = x @ solved
        d = x[:, 1:] @ (solved @ y)[1:]
        rest = np.eye(len(at)) - projection
        remaining = rest @ noise @ rest.T
        found = _BlockVariances.of(at, len(means), y, d, noise, remaining)
        lengths = np.asarray(tau / blocks.length_s, dtype=np.float64)
        variance[c], extra[c] = _corrected(variance[c], lengths, found, len(means))
    return variance, extra


def _solve_contrasts(noise: Floats, x: Floats) -> Floats:
    """Return the generalised least-squares solution as a matrix.

    A constant in `noise` does not matter: its mean was removed, and any other makes it positive.
    """
    weights = np.linalg.inv(noise + FREE_CONSTANT * float(np.trace(noise)) / len(noise))
    return np.asarray(np.linalg.solve(x.T @ weights @ x, x.T @ weights))


class _BlockVariances:
    """Allan variances of block means, by cluster length in blocks."""

    def __init__(self, m: Ints, whole: Floats, slow: Floats, rest: Floats, share: Floats) -> None:
        self.log_m, self.m = np.log(m), m
        self.whole, self.slow, self.rest, self.share = whole, slow, rest, share

    @classmethod
    def of(cls, at: Ints, n: int, y: Floats, d: Floats, noise: Floats, remaining: Floats) -> _BlockVariances:
        """Return those of means y, of their slow part d and of the rest, at blocks `at` of n."""
        present, series, covariances = np.zeros(n + 1), np.zeros((3, n + 1)), np.zeros((2, n + 1, n + 1))
        present[at + 1], series[:, at + 1] = 1.0, (y, d, y - d)
        covariances[:, at[:, None] + 1, at + 1] = noise, remaining
        present, series = np.cumsum(present), np.cumsum(series, axis=1)
        covariances = covariances.cumsum(axis=1).cumsum(axis=2)
        lengths, found = [], []
        for m in _LENGTHS[: np.searchsorted(_LENGTHS, n // 2, "right")].tolist():
            begin = np.arange(n - 2 * m + 1)
            begin = begin[present[begin + 2 * m] - present[begin] == 2 * m]
            if not len(begin):
                break
            places = begin + np.array([[0], [m], [2 * m]])
            differences = np.tensordot(_SECOND, series[:, places], (0, 1))
            squares = 0.5 * np.mean(differences**2, axis=1) / m**2
            powers = np.einsum("i,j,cijb->c", _SECOND, _SECOND, covariances[:, places[:, None], places])
            lengths.append(m)
            found.append([*squares, max(powers[1] / powers[0], LEAST_REST)])
        return cls(np.array(lengths), *np.array(found).T)

    def interpolated(self, values: Floats, m: Floats) -> Floats:
        """Return values over m^2 at other lengths, times m^2; below one block they rise with m^2."""
        return np.asarray(np.interp(np.log(m), self.log_m, values / self.m**2) * m**2)


def _corrected(variance: Floats, m: Floats, found: _BlockVariances, n: int) -> tuple[Floats, Floats]:
    """Return the Allan variances of a channel without its slow part, and their additional variance.

    Parameters
    ----------
    variance : (k,) unit^2.
    m : (k,) cluster lengths, blocks.
    n : blocks of the record.
    """
    slow = found.interpolated(found.slow, m)
    common = np.where(m < 1.0, 0.0, found.interpolated(found.whole - found.slow - found.rest, m))
    below = np.maximum(variance - slow - common, LEAST_VARIANCE * variance)
    rest = np.maximum(found.rest, LEAST_VARIANCE * found.whole)
    direct = np.exp(np.interp(np.log(m), found.log_m, np.log(rest)))
    share = np.where(m < 1.0, 1.0, np.interp(np.log(m), found.log_m, found.share))
    result = np.where(m < DIRECT_BLOCKS, below, direct) / share
    extra = np.where(m < DIRECT_BLOCKS, (SHAPE_ERROR * slow) ** 2, 0.0)
    extra += np.where(m < 1.0, 4.0 * slow * below * m / n, 0.0)  # what both have in common
    return result, extra + ((1.0 - share) * result) ** 2
