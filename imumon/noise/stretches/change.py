"""Changes of a coefficient between two parts: is it another one, beyond chance and by as much as matters?

One comparison serves all pairs of parts:

    before                      now                    of
    the hours before            an hour                N, B
    the first half of a record  its second half        K; N, B by its quarters
    a saved report              the record             N, B
    the days before             a day of the history   N, B, the slope against the temperature

Two values differ by chance by the errors of both. The error of each is that of its limits towards the other value. A
coefficient that does not show counts as 0 with its upper limit. The difference over the errors, added in quadrature, is
in standard errors. A record, or a history, is compared many times: a pair counts as a change if chance makes one so
large in `CHANCE` of all records, over all their pairs (Bonferroni). A sudden change of the bias is a step of the fit,
not a change of N or B.

>>> old = {"N": Estimate(value=1.0e-4, low=0.99e-4, high=1.01e-4, status="measured")}
>>> new = {"N": Estimate(value=1.4e-4, low=1.38e-4, high=1.42e-4, status="measured")}
>>> [(change.letter, round(change.ratio, 2), round(change.sigma)) for change in detect_changes(old, new, pairs=18)]
[('N', 1.4, 35)]
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, stdtr

from imumon.model.coefficients import LIMIT_95, Estimate
from imumon.model.saved_state import restorable

CHANCE = 0.01
"""Probability that chance makes a change in a record, over all pairs of its parts that are compared.

Otherwise: with 18 comparisons an hour, each month would have changes; with less, a change must be larger. For 18 pairs
it is 3.5 standard errors, after a month 5.
"""
LEAST_CHANGE = {"N": 0.05, "B": 0.5}
"""Relative changes of the coefficients below which one does not matter, however significant it is.

Otherwise: a long record reports differences that no user acts on. B of the same sensor varies by half.
"""


@restorable
@dataclass(frozen=True, slots=True)
class CoefficientChange:
    """A significant change of a coefficient.

    Attributes
    ----------
    letter : of the coefficient.
    before, now : channel unit of the coefficient.
    sigma : standard errors by which they differ.
    p_value : probability of such a difference by chance, over all pairs.
    """

    letter: str
    before: float
    now: float
    sigma: float
    p_value: float

    @property
    def ratio(self) -> float:
        """1, now over before."""
        return self.now / self.before


def compare(
    letter: str, before: Estimate, now: Estimate, *, pairs: int, dof: float = math.inf
) -> CoefficientChange | None:
    """Return the change of a coefficient; None if there is none, or if one of the two has no limits.

    Parameters
    ----------
    pairs : compared parts of the record so far, with all channels and coefficients.
    dof : degrees of freedom of the error of `before`; infinite where it follows from a fit.
    """
    if before.low is None or before.high is None or now.low is None or now.high is None:
        return None
    if not (before.low < before.high and now.low < now.high):  # limits of a saved report may be anything
        return None
    old, new = before.value or 0.0, now.value or 0.0  # what does not show is 0, up to its bound
    error = math.hypot(
        (before.high - old if new > old else old - before.low) / LIMIT_95,
        (new - now.low if new > old else now.high - new) / LIMIT_95,
    )
    if not error > 0.0:  # a value may lie at its limit
        return None
    sigma = abs(new - old) / error
    tail = float(ndtr(-sigma) if math.isinf(dof) else stdtr(dof, -sigma))
    p_value = min(1.0, 2.0 * tail * pairs)
    if p_value > CHANCE or abs(new - old) < LEAST_CHANGE.get(letter, 0.0) * old:
        return None
    return CoefficientChange(letter, old, new, sigma, p_value)


def joined(parts: Sequence[Mapping[str, Estimate]]) -> dict[str, Estimate]:
    """Return N and B of some equal parts together: the root mean square, where all parts show them."""
    whole = {}
    for letter in LEAST_CHANGE:
        shown = [part[letter] for part in parts if letter in part]
        known = [(each.value, each.low, each.high) for each in shown if each.status == "measured"]
        if len(known) == len(parts) and all(value and low and high for value, low, high in known):
            value, low, high = np.array(known, dtype=np.float64).T
            mean = float(np.sqrt(np.mean(value**2)))
            # the logarithms of independent parts, whose errors add in quadrature
            factor = float(np.exp(0.5 * np.linalg.norm(np.log(high / low)) / len(parts)))
            whole[letter] = Estimate(value=mean, low=mean / factor, high=mean * factor, status="measured")
    return whole


def detect_changes(
    before: Mapping[str, Estimate], now: Mapping[str, Estimate], *, pairs: int
) -> tuple[CoefficientChange, ...]:
    """Return the significant changes of N and B where both parts show them.

    Parameters
    ----------
    before, now : coefficients of the same channel by letter.
    pairs : as of `compare`.
    """
    shown = [
        letter
        for letter in LEAST_CHANGE
        if all(letter in part and part[letter].value for part in (before, now))
    ]
    changes = (compare(letter, before[letter], now[letter], pairs=pairs) for letter in shown)
    return tuple(change for change in changes if change is not None)
