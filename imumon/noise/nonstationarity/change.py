"""Stationarity: does this hour behave like the hours before, or like a saved baseline?

N and B are compared by the logarithm of their ratio against their limits, the bias by the difference of the
means against what the fitted noise does by itself in that time (`wander`). The same comparison against a
saved report tells whether a sensor in the field has changed. A change is told when it is beyond chance and
large enough to matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from imumon.noise.nonstationarity.mean_covariance import Fitted, MeanCovariance

SIGMA = 5.0
"""Standard errors beyond which a change is told."""
LEAST = {"N": 0.05, "B": 0.5}
"""Relative change below which it does not matter."""

Quantity: TypeAlias = Literal["N", "B", "bias"]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A coefficient as fitted or as read from a saved report.

    Attributes
    ----------
    value : None where it was not measured.
    low, high : its 95 % limits.
    """

    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class Behaviour:
    """How a channel behaved over a stretch.

    Attributes
    ----------
    N, B : as fitted.
    mean : channel unit; None where unknown.
    wander : its noise; None where unknown.
    length_s : s.
    """

    N: Estimate
    B: Estimate
    mean: float | None
    wander: MeanCovariance | None
    length_s: float

    @classmethod
    def of(cls, fit: Fitted, mean: float | None, length_s: float) -> Behaviour:
        """From a fit whose coefficients also have `low`."""
        n, b = (Estimate(k.value, getattr(k, "low", None), k.high) for k in (fit.N, fit.B))
        return cls(n, b, mean, MeanCovariance.of(fit), length_s)


@dataclass(frozen=True, slots=True)
class Change:
    """Something that differs.

    Attributes
    ----------
    quantity : "N", "B" or "bias".
    before, now : SI, the two values.
    ratio : now over before; None for the bias.
    sigma : by how many standard errors they differ.
    """

    quantity: Quantity
    before: float
    now: float
    ratio: float | None
    sigma: float


def changes(before: Behaviour, now: Behaviour, apart_s: float | None = 0.0) -> list[Change]:
    """What differs between two stretches beyond chance.

    Parameters
    ----------
    apart_s : s, between the end of the one and the beginning of the other; None: unknown, as for a saved
        baseline; then the bias is not compared: it differs from one switching-on to the next.
    """
    found = []
    pairs: tuple[tuple[Quantity, Estimate, Estimate], ...] = (("N", before.N, now.N), ("B", before.B, now.B))
    for quantity, old, new in pairs:
        change = _ratio(quantity, old, new)
        if change is not None:
            found.append(change)
    if apart_s is not None and before.mean is not None and now.mean is not None:
        # The longer stretch knows best what the noise does in a long time.
        wander = (before if before.length_s >= now.length_s else now).wander
        moved = now.mean - before.mean
        if wander is not None:
            sigma = abs(moved) / max(wander.step(before.length_s, now.length_s, apart_s), 1e-300)
            if sigma > SIGMA:
                found.append(Change("bias", before.mean, now.mean, None, min(sigma, 1e6)))
    return found


def _ratio(quantity: Quantity, old: Estimate, new: Estimate) -> Change | None:
    """A change of a coefficient, compared on a log scale."""
    if old.value is None or new.value is None:
        return None
    errors = []
    for estimate in (old, new):
        value, low, high = estimate.value, estimate.low, estimate.high
        if not value or not low or not high or low <= 0.0:
            return None
        errors.append(math.log(high / low) / (2.0 * 1.96))
    ratio = new.value / old.value
    sigma = abs(math.log(ratio)) / max(math.hypot(*errors), 1e-12)
    if sigma < SIGMA or abs(math.log(ratio)) < math.log1p(LEAST[quantity]):
        return None
    return Change(quantity, old.value, new.value, ratio, sigma)
