"""Changes of N and B between two parts of a record, or two records.

An hour is compared with the hours before it, and a record with a saved one: has the sensor changed in the field? Two
values differ by chance by the limits of both. N and B are compared by the logarithm of their ratio, whose standard
error is the width of the limits on that scale over 2 * 1.96, both errors added in quadrature. A change is reported if
it is beyond chance and large enough to matter. A sudden change of the bias is a step of the fit, not a change of N or
B.

>>> old = {"N": Estimate(value=1.0e-4, low=0.99e-4, high=1.01e-4, status="measured")}
>>> new = {"N": Estimate(value=1.4e-4, low=1.38e-4, high=1.42e-4, status="measured")}
>>> [(change.letter, round(change.ratio, 2), round(change.sigma)) for change in detect_changes(old, new)]
[('N', 1.4, 38)]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from imumon.coefficients import LIMIT_95, Estimate
from imumon.saved_state import restorable

CHANGE_SIGMA = 5.0
"""An hour differs from the hours before, or a record from a baseline, beyond chance. Unit: standard errors.

Otherwise: chance makes changes: there are 27 comparisons an hour, over years. Origin: 6e-7 by chance.
"""
LEAST_CHANGE_N = 0.05
"""A smaller change of N is none, however significant; also between days. Unit: relative change.

Otherwise: a long record reports differences that no user acts on.
"""
LEAST_CHANGE_B = 0.5
"""A smaller change of B is none, however significant; also between days. Unit: relative change.

Otherwise: hours of a sensor whose flicker noise wanders are reported as changes. Origin: B of the same sensor varies
by as much.
"""

LEAST_CHANGE = {"N": LEAST_CHANGE_N, "B": LEAST_CHANGE_B}
"""Relative changes of the coefficients that are compared, below which one does not matter."""


@restorable
@dataclass(frozen=True, slots=True)
class CoefficientChange:
    """A significant change of a coefficient.

    Attributes
    ----------
    letter : of the coefficient, one of `LEAST_CHANGE`.
    before, now : channel unit of the coefficient.
    sigma : standard errors of the logarithm of the ratio by which they differ.
    """

    letter: str
    before: float
    now: float
    sigma: float

    @property
    def ratio(self) -> float:
        """1, now over before."""
        return self.now / self.before


def detect_changes(
    before: Mapping[str, Estimate], now: Mapping[str, Estimate]
) -> tuple[CoefficientChange, ...]:
    """Return the significant changes of N and B.

    Parameters
    ----------
    before, now : coefficients of the same channel by letter; one that is missing or not measured is not compared.
    """
    changes = (
        _compare(letter, before[letter], now[letter], least)
        for letter, least in LEAST_CHANGE.items()
        if letter in before and letter in now
    )
    return tuple(change for change in changes if change is not None)


def _compare(letter: str, before: Estimate, now: Estimate, least: float) -> CoefficientChange | None:
    """Return the change of a coefficient; None if there is none, or if one of the values has no limits."""
    old, new = _with_error(before), _with_error(now)
    if old is None or new is None:
        return None
    distance = abs(math.log(new[0] / old[0]))
    sigma = distance / math.hypot(old[1], new[1])
    if sigma < CHANGE_SIGMA or distance < math.log1p(least):
        return None
    return CoefficientChange(letter, old[0], new[0], sigma)


def _with_error(estimate: Estimate) -> tuple[float, float] | None:
    """Return a value and the standard error of its logarithm; None without a value or limits.

    Limits of a saved report may be anything: without `low < high` the error would be zero or negative, and any
    difference a change.
    """
    value, low, high = estimate.value, estimate.low, estimate.high
    if not value or not low or not high or not 0.0 < low < high:
        return None
    return value, math.log(high / low) / (2.0 * LIMIT_95)
