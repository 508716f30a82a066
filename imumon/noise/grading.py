"""Grade of a sensor: navigation, tactical, industrial or consumer, from N and B.

The problem
-----------
People compare sensors by grades. A grade is a limit of N and one of B; a record knows both within limits only, or only
a bound, and a sensor has three axes. This module says which grade a sensor has and whether that may still change.

The model
---------
The limits are table 3.1 of the VectorNav inertial navigation primer, in the units that it prints, converted to SI by
the exact factors of `coefficients`. There are two grades:

- ``meets``: the best grade whose limit is not exceeded; None if worse than consumer. It is the one to quote.
- ``nearest``: the grade whose limit is nearest on a logarithmic scale, |ln(size / limit)|. This is the headline: a
  sensor that exceeds a limit by 1 % is still of that grade in any sensible sense.

Rules:

1. Only N and B have limits. A pending coefficient has no grade.
2. A bounded coefficient (``upper_bound``) is graded by its bound: ``meets`` holds at 95 %. A bound says how
   little is known and not how bad the sensor is, so it decides ``nearest`` only if nothing is measured. If it
   is worse than the headline, the headline is provisional, and the reason names the bound unless a
   coefficient is pending.
3. A channel is as good as the worse of its coefficients, a sensor as the worst of its axes. The deciding
   coefficient is, within the worst grade, the one that is largest relative to that grade's limit.
4. The headline is provisional while it may still change: a coefficient is pending, or the headline of all
   lower limits differs from that of all upper limits.

Example
-------
A gyroscope with N of 0.30 deg/sqrt(h): above the limit of industrial sensors, 0.2, and far below that of consumer
ones, 2. Of B only a bound is known:

>>> n = Estimate(value=8.86e-5, low=8.8e-5, high=8.92e-5, status="measured")
>>> headline = grade_sensor("gyro", {"x": {"N": n, "B": Estimate(low=0.0, high=4e-4, status="upper_bound")}})
>>> headline.nearest, headline.meets, headline.decided_by, headline.reason
('industrial', 'consumer', ('x', 'N'), 'B of x is only bounded: it may still be consumer')
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imumon.model.coefficients import COEFFICIENTS, GRADED, GRADES, Estimate, GradeName

READABLE_LIMITS: Mapping[str, Mapping[str, tuple[float, float, float, float]]] = {
    "gyro": {"N": (0.01, 0.05, 0.2, 2.0), "B": (0.01, 1.0, 10.0, 100.0)},  # deg/sqrt(h), deg/h
    "accel": {"N": (0.01, 0.03, 0.1, 1.0), "B": (0.01, 0.1, 1.0, 10.0)},  # m/s/sqrt(h), mg
}
"""Table 3.1 by sensor and coefficient, one limit for each of `GRADES`, in readable units."""


LIMITS: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    sensor: {
        letter: {
            grade: limit / COEFFICIENTS[letter].units[sensor].factor
            for grade, limit in zip(GRADES, coefficients[letter], strict=True)
        }
        for letter in GRADED
    }
    for sensor, coefficients in READABLE_LIMITS.items()
}
"""Limits in SI by sensor, coefficient and grade; 5.8e-5 rad/s/sqrt(Hz) for N of an industrial gyro."""


@dataclass(frozen=True, slots=True)
class CoefficientGrade:
    """Grades of one coefficient; None if there is none."""

    nearest: GradeName | None = None  # limit that is nearest on a logarithmic scale
    meets: GradeName | None = None  # best grade whose limit is not exceeded


@dataclass(frozen=True, slots=True)
class AxisGrade:
    """Grades of one channel."""

    coefficients: Mapping[str, CoefficientGrade]  # by letter
    nearest: GradeName | None  # the worse of these; a bound decides only if nothing is measured
    meets: GradeName | None  # the worse of these


@dataclass(frozen=True, slots=True)
class Headline:
    """Grades of a sensor: the worst of its axes."""

    nearest: GradeName | None = None
    meets: GradeName | None = None
    decided_by: tuple[str, str] | None = None  # axis and letter of the coefficient that decides `nearest`
    provisional: bool = True  # whether it may still change
    reason: str | None = None  # why there is no grade, or why it is provisional


def grade_coefficient(sensor: str, coefficient: str, value: float | None) -> CoefficientGrade:
    """Return the grade of a value of a coefficient.

    Parameters
    ----------
    sensor : ``gyro`` or ``accel``; others have no grades.
    coefficient : ``N`` or ``B``; K has none.
    value : SI; None: unknown.

    >>> grade_coefficient("gyro", "N", 8.858211836469779e-5)
    CoefficientGrade(nearest='industrial', meets='consumer')
    """
    limits = LIMITS.get(sensor, {}).get(coefficient)
    if limits is None or value is None:
        return CoefficientGrade()
    return CoefficientGrade(nearest=_nearest(limits, value), meets=_meets(limits, value))


def grade_channel(sensor: str, coefficients: Mapping[str, Estimate]) -> AxisGrade:
    """Return the grades of a channel's coefficients, by letter and together."""
    candidates = _candidates(sensor, "", coefficients)
    grades = {c.coefficient: CoefficientGrade(nearest=c.nearest, meets=c.meets) for c in candidates}
    return AxisGrade(
        # every graded letter has an entry: a reader of the JSON finds null and not a missing key
        coefficients=dict.fromkeys(GRADED, CoefficientGrade()) | grades,
        nearest=_deciding(candidates).nearest if candidates else None,
        meets=_worst_meets(candidates),
    )


def grade_sensor(sensor: str, axes: Mapping[str, Mapping[str, Estimate]]) -> Headline:
    """Return the headline grade of a sensor.

    Parameters
    ----------
    sensor : ``gyro`` or ``accel``.
    axes : coefficients by axis and letter; `decided_by` uses the same names of the axes.
    """
    if sensor not in LIMITS:
        # final, and not provisional: no sample will change it
        return Headline(provisional=False, reason=f"the table has no grades for {sensor}")
    candidates = [c for axis, coefficients in axes.items() for c in _candidates(sensor, axis, coefficients)]
    if not candidates:
        return Headline(reason="no coefficient is measured or bounded yet")
    deciding = _deciding(candidates)
    reason = _doubt(candidates, deciding, expected=len(LIMITS[sensor]) * len(axes))
    return Headline(
        nearest=deciding.nearest,
        meets=_worst_meets(candidates),
        decided_by=(deciding.axis, deciding.coefficient),
        provisional=reason is not None,
        reason=reason,
    )


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A measured or bounded coefficient, with its grades at its size and at both of its limits.

    Attributes
    ----------
    excess : 1, size over the limit of the nearest grade.
    """

    axis: str
    coefficient: str
    measured: bool
    nearest: GradeName
    meets: GradeName | None
    excess: float
    nearest_to_low: GradeName
    nearest_to_high: GradeName


def _candidates(sensor: str, axis: str, coefficients: Mapping[str, Estimate]) -> list[_Candidate]:
    """Return the coefficients of an axis that have a limit and are not pending."""
    candidates = []
    for name, limits in LIMITS.get(sensor, {}).items():
        estimate = coefficients.get(name, Estimate()).stated
        if estimate.status == "pending":
            continue
        measured = estimate.status == "measured"
        size = estimate.value if measured else estimate.high
        if size is None:
            continue
        nearest = _nearest(limits, size)
        # A bound may be anything down to 0; a value without limits is as good as exact.
        low = estimate.low if estimate.low is not None else (size if measured else 0.0)
        high = estimate.high if estimate.high is not None else size
        candidates.append(
            _Candidate(
                axis=axis,
                coefficient=name,
                measured=measured,
                nearest=nearest,
                meets=_meets(limits, size),
                excess=size / limits[nearest],
                nearest_to_low=_nearest(limits, low),
                nearest_to_high=_nearest(limits, high),
            )
        )
    return candidates


def _doubt(candidates: Sequence[_Candidate], deciding: _Candidate, expected: int) -> str | None:
    """Return why the headline may still change; None if it is final.

    Parameters
    ----------
    expected : number of coefficients that the sensor has.
    """
    if pending := expected - len(candidates):
        verb = "is" if pending == 1 else "are"
        return f"{pending} of {expected} coefficients {verb} pending"
    # A bound does not decide where something is measured (rule 2): one beyond the headline leaves it open.
    loose = [c for c in candidates if GRADES.index(c.nearest) > GRADES.index(deciding.nearest)]
    if loose:
        bound = _worst(loose)
        return f"{bound.coefficient} of {bound.axis} is only bounded: it may still be {bound.nearest}"
    # The headline is the worst of all, so the best case is the worst of the lower limits, not the best of them.
    best = max(GRADES.index(c.nearest_to_low) for c in candidates)
    worst = max(GRADES.index(c.nearest_to_high) for c in candidates)
    return None if best == worst else f"the intervals reach from {GRADES[best]} to {GRADES[worst]}"


def _nearest(limits: Mapping[str, float], size: float) -> GradeName:
    """Return the grade that is nearest on a logarithmic scale; the better one on a tie."""
    if size <= 0.0:  # the lower limit of a bound: it has no logarithm
        return GRADES[0]
    return min(GRADES, key=lambda grade: abs(math.log(size / limits[grade])))


def _meets(limits: Mapping[str, float], size: float) -> GradeName | None:
    """Return the best grade whose limit is not exceeded."""
    return next((grade for grade in GRADES if size <= limits[grade]), None)


def _deciding(candidates: Sequence[_Candidate]) -> _Candidate:
    """Return the worst of the measured ones, or of the bounds if nothing is measured."""
    return _worst([c for c in candidates if c.measured] or candidates)


def _worst(candidates: Sequence[_Candidate]) -> _Candidate:
    """Return the one of the worst grade that is largest relative to that grade's limit."""
    return max(candidates, key=lambda c: (GRADES.index(c.nearest), c.excess))


def _worst_meets(candidates: Sequence[_Candidate]) -> GradeName | None:
    """Return the worst `meets`; None if nothing is known or one meets no grade."""
    grades = [c.meets for c in candidates if c.meets is not None]
    return max(grades, key=GRADES.index) if grades and len(grades) == len(candidates) else None
