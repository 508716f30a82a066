"""Early walk: whether means wandered more before some time than after it, as those of a sensor that warms up.

A warm-up of an hour is seldom an exponential: the mean wanders until the sensor has settled. This is a random
walk with larger steps before a time than after it. The test compares it with noise that is the same
throughout, beside a straight drift:

    y = constant + drift t + noise,    covariance N^2 W + B^2 F + K^2 R + k^2 E,

with E the covariance of a walk that ends at the candidate. N, B and K come from the means themselves by
restricted likelihood (`restricted_likelihood`), with k = 0. So neither a drift nor a random walk of the whole
record counts, and nothing depends on a fit that a warm-up bends. The score of k^2, less its projections on the
scores of N^2, B^2 and K^2 (Rao; Cox & Hinkley 1974, section 9.3), is a weighted sum of chi-squares; its tail comes
from the chi-square with the same three cumulants (Hall 1983). All axes warm up at the same time. Their
standardised scores are added.
"""

from __future__ import annotations

import numpy as np

from imumon.noise.fit.restricted_likelihood import LEAST_BLOCKS, BlockMeans, unit_covariances
from imumon.noise.fit.walk_limits import Combinations, tail_probability
from imumon.samples import Floats

STEPS = 100
"""Steps of the search for N, B and K; each one raises the likelihood. Not critical."""
LEAST_SHARE_OF_TERM = 1e-3
"""Standard errors by which a term exceeds zero for its score to be projected out. Not critical."""
LEAST_SIDE = 4
"""Fewest blocks before and after the candidate. Not critical."""

_TINY = 1e-300
"""Least divisor. Not critical."""


def early_walk_probability(blocks: BlockMeans, end_s: float) -> float:
    """Return the probability of means that wander as much more before a time if their noise is stationary.

    Parameters
    ----------
    blocks : means of the channels that warm up together; those without enough means do not count.
    end_s : s since the first block, candidate of the end of the warm-up.
    """
    n = len(blocks.means)
    end = round(end_s / blocks.length_s)
    if not LEAST_SIDE <= end <= n - LEAST_SIDE:
        return 1.0
    flicker, walk = unit_covariances(n)
    early = walk_until(n, end)
    share = np.where(np.isfinite(blocks.means), blocks.share, 0.0)
    kinds, member = np.unique(share, axis=1, return_inverse=True)
    score = second = third = 0.0
    for kind, own in enumerate(kinds.T):
        rows = np.flatnonzero(own)
        if len(rows) < LEAST_BLOCKS:
            continue
        grid = np.ix_(rows, rows)
        line = np.stack((np.ones(len(rows)), rows - rows.mean()), axis=1)
        free = Combinations.of(line, np.diag(1.0 / own[rows]), flicker[grid], walk[grid])
        shapes = np.stack((np.ones(len(free.walk)), free.flicker, free.walk))
        power = free.basis @ early[grid] @ free.basis.T
        for column in np.flatnonzero(member.ravel() == kind):
            z = free.basis @ blocks.means[rows, column]
            if not z.any():
                continue
            value, variance, skew = _score(z, shapes, power)
            sigma = np.sqrt(max(variance, _TINY))
            score, second, third = score + value / sigma, second + 1.0, third + skew / sigma**3
    return 1.0 if second == 0.0 else float(tail_probability(score, second, third))


def walk_until(n: int, end: int) -> Floats:
    """Return (n, n) the covariance of block means of a Wiener process that begins at 0 and stops after `end`
    blocks, of unit steps."""
    at = np.arange(n)
    covariance = np.minimum.outer(np.where(at < end, at + 0.5, end), np.where(at < end, at + 0.5, end))
    covariance[at, at] = np.where(at < end, at + 1.0 / 3.0, end)
    return np.asarray(covariance, dtype=np.float64)


def _score(z: Floats, shapes: Floats, power: Floats) -> tuple[float, float, float]:
    """Return the efficient score of `power`, (m, m), beside `shapes`, (3, m), and its second and third
    cumulant, for combinations z, (m,)."""
    square = z**2
    terms = square.mean() / shapes.mean(axis=1) * np.array([1.0, 0.1, 0.1])
    for _ in range(STEPS):  # multiplicative steps keep the terms positive
        v = terms @ shapes
        terms = terms * np.sqrt((shapes @ (square / v**2)) / (shapes @ (1.0 / v)))
    root = 1.0 / np.sqrt(terms @ shapes)
    white, own = z * root, shapes * root**2
    power = power * np.outer(root, root)
    information, shared = 0.5 * own @ own.T, 0.5 * own @ np.diag(power)
    active = terms * np.sqrt(np.diag(information)) > LEAST_SHARE_OF_TERM
    projection = np.zeros(3)
    if active.any():
        both = np.ix_(active, active)
        projection[active] = np.linalg.lstsq(information[both], shared[active], rcond=None)[0]
    weights = 0.5 * (power - np.diag(projection @ own))
    product = weights @ weights
    value = float(white @ weights @ white - np.trace(weights))
    return value, 2.0 * float(np.trace(product)), 8.0 * float(np.sum(product * weights))
