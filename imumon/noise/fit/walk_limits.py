"""Limits of a random walk from nearly independent combinations of block means.

Each combination z_i has a variance v_i = N^2 + B^2 f_i + K^2 r_i, see `restricted_likelihood`.

The test of a value of K^2 is the efficient score (Rao; Cox & Hinkley 1974, section 9.3) with B^2 at its best
value for this K^2. The score is a weighted sum of chi-squares of one degree of freedom. Its tails come from
the chi-square with the same three cumulants (Hall 1983; Buckley & Eagleson 1988), so they hold where one
combination decides. Limits of K^2 are the values that the test does not reject, with equal tails.

The score is the best test against a K^2 that is a little larger. Then the one or two slowest combinations decide,
which a walk raises most, but which vary most, too. The lower limit is tested against a K^2 that is larger by
`STEP_OF_TEST` (point-optimal test: King, Econometric Reviews 6, 1987): r_i / v_i becomes r_i / (v_i + step r_i).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammainc, gammaincc

from imumon.samples import Floats

TAIL = 0.025
"""Probability of each tail of a 95 % interval. Not critical."""
NODES = np.array([0.03, 0.15, 0.325, 0.5, 0.675, 0.85, 0.97])
"""Probabilities of the K^2 over which the limits of the slopes are averaged. Not critical."""
NODE_WEIGHTS = np.array([0.06, 0.18, 0.17, 0.18, 0.17, 0.18, 0.06])
"""Widths of the intervals of probability whose centres are `NODES`. Not critical."""
HALVINGS = 30
"""Bisections of a root, in log K^2 or between two limits: the last step is below 1e-8 of the range. Not
critical."""
FIRST_STEPS, NEXT_STEPS = 10, 3
"""Steps of Fisher scoring of B^2, at the first K^2 of a search and at each one after it. Not critical."""
LOWEST_K2, HIGHEST_K2 = 1e-4, 1e3
"""Range of the search: shares of the standard deviation of K^2 without a walk, and of the largest K^2 that one
combination of the means suggests. Not critical."""
STEP_OF_TEST = 8.0
"""Standard deviations of K^2 without a walk, step of the test of the lower limit: about twice the smallest K that
shows. At 0, such a K is measured in 9 % fewer records; at 4 or 16, in as many within 1 %. Not critical."""
MOST_FREEDOM = 1e6
"""Degrees of freedom above which the chi-square is a normal distribution. Not critical."""

STEP_FACTOR = 3.0
"""Most by which a step of Fisher scoring multiplies or divides B^2. Not critical."""
_TINY = 1e-300
"""Least divisor. Not critical."""


def tail_probability(value: Floats | float, second: Floats | float, third: Floats | float) -> Floats:
    """Return the probability that a sum of weighted chi-squares exceeds its mean by at least `value`.

    Parameters
    ----------
    second, third : its cumulants, which the chi-square that is used instead has too.
    """
    freedom = np.minimum(8.0 * np.power(second, 3) / np.maximum(np.square(third), _TINY), MOST_FREEDOM)
    x = freedom + np.sign(third) * value / np.sqrt(second) * np.sqrt(2.0 * freedom)
    x = np.maximum(x, 0.0) / 2.0
    tail = np.where(np.greater(third, 0.0), gammaincc(freedom / 2.0, x), gammainc(freedom / 2.0, x))
    return np.asarray(tail, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Combinations:
    """Combinations of k means that are free of some regressors and nearly independent.

    Attributes
    ----------
    basis : (m, k) the combinations; of variance 1 under white noise.
    flicker, walk : (m,) their variances for B = 1 and K = 1.
    """

    basis: Floats
    flicker: Floats
    walk: Floats

    @classmethod
    def of(cls, without: Floats, white: Floats, flicker: Floats, walk: Floats) -> Combinations:
        """Return the combinations that are free of the columns of `without`, (k, p)."""
        free = np.linalg.qr(without, mode="complete")[0][:, without.shape[1] :]
        root = np.linalg.inv(np.linalg.cholesky(free.T @ white @ free))
        free = root @ free.T
        power, turn = np.linalg.eigh(free @ walk @ free.T)
        basis = turn.T @ free
        return cls(
            basis, np.einsum("mk,kl,ml->m", basis, flicker, basis, optimize=True), np.maximum(power, 0)
        )


class WalkLimits:
    """Roots of the distribution of K^2, of several channels at once; units of the stretch."""

    def __init__(self, free: Combinations, z: Floats, n2: Floats, b2: Floats, b2_error: Floats) -> None:
        self._f, self._r = free.flicker[:, None, None], free.walk[:, None, None]
        self._square = (z**2)[:, None, :]  # (m, 1, c)
        self._n2, self._b2 = np.maximum(n2, _TINY), b2
        self._known = b2_error == 0.0
        self._weight = 1.0 / np.where(self._known, 1.0, b2_error) ** 2

    def result(self) -> tuple[Floats, Floats]:
        """Return K^2 and B^2, (3 + nodes, c): estimate, limits, nodes.

        Two more rows are searched: the lower limit of the score, and the upper limit of typical means.
        """
        c = len(self._n2)
        own = self._square
        levels = np.concatenate(([0.5, TAIL, 1.0 - TAIL], NODES, [TAIL, 1.0 - TAIL]))[:, None]
        shape = (len(levels), c)
        _, total, b2_zero = self._test(np.zeros((1, c)), self._b2[None], FIRST_STEPS)
        # means as they are typically without a walk: no bound is lower than theirs
        usual = np.where(self._weight > 0.0, np.maximum(b2_zero, self._b2), b2_zero)
        variance = self._n2 + usual * self._f
        sigma = 1.0 / np.sqrt(0.5 * np.sum((self._r / variance) ** 2, axis=0))
        step = np.zeros(shape)
        step[1] = STEP_OF_TEST * sigma
        zero = self._test(np.zeros(shape), np.broadcast_to(b2_zero, shape), NEXT_STEPS, step)[0] >= levels
        zero[0], zero[-1] = total[0] <= 0.0, False  # the estimate is the root of the score, not of its median
        largest = np.max(own / self._r, axis=0)
        self._square = np.broadcast_to(own, (len(own), *shape)).copy()
        self._square[:, -1] = variance[:, 0]
        low = np.repeat(np.log(LOWEST_K2 * sigma), len(levels), axis=0)
        high = np.repeat(np.log(HIGHEST_K2 * np.maximum(sigma, largest)), len(levels), axis=0)
        b2 = np.repeat(b2_zero, len(levels), axis=0)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            confidence, slope, b2 = self._test(np.exp(middle), b2, NEXT_STEPS, step)
            beyond = confidence >= levels
            beyond[0] = slope[0] <= 0.0
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        k2, b2 = np.where(zero, 0.0, np.exp(high)), np.where(zero, b2_zero, b2)
        k2[2] = np.maximum(k2[2], k2[-1])
        # the estimate is the root of the score, so the lower limit of the score is always below it
        k2[1] = np.where(k2[1] < k2[0], k2[1], k2[-2])
        return k2[:-2], b2[:-2]

    def _test(
        self, k2: Floats, b2: Floats, steps: int, step: Floats | float = 0.0
    ) -> tuple[Floats, Floats, Floats]:
        """Return the test of K^2, (q, c), with B^2 at its best value from `b2` on.

        Parameters
        ----------
        step : (q, c) by how much K^2 is larger in the alternative; 0: the score.

        Returns
        -------
        Probability of a statistic at least as high, statistic, and B^2.
        """
        f, r = self._f, self._r
        fixed = self._n2 + k2 * r
        at_zero = 0.5 * np.sum(f / fixed * (self._square / fixed - 1.0), axis=0) + self._weight * self._b2
        rises = at_zero > 0.0  # else the best value is zero
        for _ in range(steps):
            v = fixed + b2 * f
            g = f / v
            slope = 0.5 * np.sum(g * (self._square / v - 1.0), axis=0) + self._weight * (self._b2 - b2)
            information = 0.5 * np.sum(g * g, axis=0) + self._weight
            # a bounded step: a large z^2 sends an undamped one far beyond, and the next one to zero
            least, most = b2 / STEP_FACTOR, STEP_FACTOR * (b2 + 1.0 / np.sqrt(information))
            free = np.where(rises, np.clip(b2 + slope / information, least, most), 0.0)
            b2 = np.where(self._known, b2, free)
        v = fixed + b2 * f
        g, h, excess = f / v, r / (v + step * r), self._square / v - 1.0
        information = 0.5 * np.sum(g * g, axis=0) + self._weight
        share = np.where(self._known | (b2 <= 0.0), 0.0, 0.5 * np.sum(g * h, axis=0) / information)
        weights = 0.5 * (h - share * g)
        total = np.sum(weights * excess, axis=0) - share * self._weight * (self._b2 - b2)
        second = 2.0 * np.sum(weights**2, axis=0) + share**2 * self._weight
        third = 8.0 * np.sum(weights**3, axis=0)
        return tail_probability(total, second, third), total, b2
