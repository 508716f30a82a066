"""Grade of a sensor: navigation, tactical, industrial or consumer, from N and B.

The limits are table 3.1 of the VectorNav inertial navigation primer, kept in the units it prints and
converted to SI by the exact factors of `coefficients`. There are two grades:

- ``meets``: the best grade whose limit is not exceeded; None if worse than consumer.
- ``nearest``: the grade whose limit is nearest on a logarithmic scale. This is the headline.

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
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from imumon.report import (
    COEFFICIENTS,
    GRADED,
    GRADES,
    ChannelGrade,
    DecidedBy,
    Estimate,
    GradeName,
    Grading,
    SensorGrade,
)

READABLE_LIMITS: Mapping[str, Mapping[str, tuple[float, float, float, float]]] = {
    "gyro": {"N": (0.01, 0.05, 0.2, 2.0), "B": (0.01, 1.0, 10.0, 100.0)},  # deg/sqrt(h), deg/h
    "accel": {"N": (0.01, 0.03, 0.1, 1.0), "B": (0.01, 0.1, 1.0, 10.0)},  # m/s/sqrt(h), mg
}
"""Table 3.1 by sensor and coefficient, one limit for each of `GRADES`, in readable units."""


LIMITS: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    sensor: {
        letter: {
            grade: row / COEFFICIENTS[letter].units[sensor].factor
            for grade, row in zip(GRADES, coefficients[letter], strict=True)
        }
        for letter in GRADED
    }
    for sensor, coefficients in READABLE_LIMITS.items()
}
"""Limits in SI by sensor, coefficient and grade; 5.8e-5 rad/s/sqrt(Hz) for N of an industrial gyro."""


def grade_coefficient(sensor: str, coefficient: str, value: float | None) -> Grading:
    """Return the grade of a value of a coefficient.

    Parameters
    ----------
    sensor : ``gyro`` or ``accel``; others have no grades.
    coefficient : ``N`` or ``B``; K has none.
    value : SI; None: unknown.

    >>> grade_coefficient("gyro", "N", 8.858211836469779e-5)
    Grading(nearest='industrial', meets='consumer')
    """
    table = LIMITS.get(sensor, {}).get(coefficient)
    if table is None or value is None:
        return Grading()
    return Grading(nearest=_nearest(table, value), meets=_meets(table, value))


def grade_channel(sensor: str, coefficients: Mapping[str, Estimate]) -> ChannelGrade:
    """Return the grades of a channel's coefficients, by letter and together."""
    candidates = _candidates(sensor, "", coefficients)
    gradings = {each.coefficient: Grading(nearest=each.nearest, meets=each.meets) for each in candidates}
    return ChannelGrade(
        coefficients=dict.fromkeys(GRADED, Grading()) | gradings,
        nearest=_deciding(candidates).nearest if candidates else None,
        meets=_worst_meets(candidates),
    )


def grade_sensor(sensor: str, axes: Mapping[str, Mapping[str, Estimate]]) -> SensorGrade:
    """Return the headline grade of a sensor.

    Parameters
    ----------
    sensor : ``gyro`` or ``accel``.
    axes : coefficients by axis and letter; `decided_by` uses the same names of the axes.
    """
    if sensor not in LIMITS:
        return SensorGrade(provisional=False, reason=f"the table has no grades for {sensor}")
    candidates = [each for axis, known in axes.items() for each in _candidates(sensor, axis, known)]
    pending = len(LIMITS[sensor]) * len(axes) - len(candidates)
    if not candidates:
        return SensorGrade(reason="no coefficient is measured or bounded yet")
    deciding = _deciding(candidates)
    best = max(GRADES.index(each.at_low) for each in candidates)
    worst = max(GRADES.index(each.at_high) for each in candidates)
    reason = None
    loose = [each for each in candidates if GRADES.index(each.nearest) > GRADES.index(deciding.nearest)]
    if pending:
        verb = "is" if pending == 1 else "are"
        reason = f"{pending} of {pending + len(candidates)} coefficients {verb} pending"
    elif loose:
        bound = _worst(loose)
        reason = f"{bound.coefficient} of {bound.axis} is only bounded: it may still be {bound.nearest}"
    elif best != worst:
        reason = f"the intervals reach from {GRADES[best]} to {GRADES[worst]}"
    return SensorGrade(
        nearest=deciding.nearest,
        meets=_worst_meets(candidates),
        decided_by=DecidedBy(axis=cast(Any, deciding.axis), coefficient=cast(Any, deciding.coefficient)),
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
    at_low: GradeName
    at_high: GradeName


def _candidates(sensor: str, axis: str, coefficients: Mapping[str, Estimate]) -> list[_Candidate]:
    """Return the coefficients of an axis that have a limit and are not pending."""
    candidates = []
    for name, table in LIMITS.get(sensor, {}).items():
        known = coefficients.get(name, Estimate()).stated
        if known.status == "pending":
            continue
        measured = known.status == "measured"
        size = known.value if measured else known.high
        if size is None:
            continue
        nearest = _nearest(table, size)
        low = known.low if known.low is not None else (size if measured else 0.0)
        high = known.high if known.high is not None else size
        candidates.append(
            _Candidate(
                axis=axis,
                coefficient=name,
                measured=measured,
                nearest=nearest,
                meets=_meets(table, size),
                excess=size / table[nearest],
                at_low=_nearest(table, low),
                at_high=_nearest(table, high),
            )
        )
    return candidates


def _nearest(table: Mapping[str, float], size: float) -> GradeName:
    """Return the grade that is nearest on a logarithmic scale; the better one on a tie."""
    if size <= 0.0:
        return GRADES[0]
    return min(GRADES, key=lambda grade: abs(math.log(size / table[grade])))


def _meets(table: Mapping[str, float], size: float) -> GradeName | None:
    """Return the best grade whose limit is not exceeded."""
    return next((grade for grade in GRADES if size <= table[grade]), None)


def _deciding(candidates: Sequence[_Candidate]) -> _Candidate:
    """Return the worst of the measured ones, or of the bounds if nothing is measured."""
    return _worst([each for each in candidates if each.measured] or candidates)


def _worst(candidates: Sequence[_Candidate]) -> _Candidate:
    """Return the one of the worst grade that is largest relative to that grade's limit."""
    return max(candidates, key=lambda each: (GRADES.index(each.nearest), each.excess))


def _worst_meets(candidates: Sequence[_Candidate]) -> GradeName | None:
    """Return the worst `meets`; None if nothing is known or one meets no grade."""
    grades = [each.meets for each in candidates if each.meets is not None]
    return max(grades, key=GRADES.index) if grades and len(grades) == len(candidates) else None
