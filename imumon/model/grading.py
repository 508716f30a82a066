"""Grade of a sensor: navigation, tactical, industrial, consumer or below, from N and B.

The problem
-----------
People compare sensors by grades. A grade is a limit of N and one of B; a record knows both within limits only, or only
a bound, and a sensor has three axes. This module says which grade a sensor has, and which ones it may have. It is the
only place that compares a coefficient with a limit: screen, `status`, `check`, `wait` and documents read its result.

The model
---------
The limits are table 3.1 of the VectorNav inertial navigation primer, in the units that it prints, converted to SI by
the exact factors of `coefficients`. The grade of a sensor is the best one whose limits no N and no B exceeds:

1. Only N and B have limits. A coefficient of which only a bound is known counts with its bound.
2. A channel is as good as the worse of its coefficients, a sensor as the worst of its axes. The deciding
   coefficient is, within the worst grade, the one that is largest relative to the limit of that grade.
3. An N that is not that of white noise (`NOT_WHITE`) has no limit to compare with, and its sensor no grade.
4. ``best`` is the grade if every coefficient is at its lower 95 % limit, ``worst`` if each is at its upper one. A
   coefficient that is pending may have any grade. The grade is certain where both agree.

Example
-------
A gyroscope with N of 0.30 deg/sqrt(h): above the limit of industrial sensors, 0.2, and far below that of consumer
ones, 2. Of B only a bound is known, which is below the limit of consumer sensors:

>>> n = Estimate(value=8.86e-5, low=8.8e-5, high=8.92e-5, status="measured")
>>> result = grade_sensor("gyro", {"x": {"N": n, "B": Estimate(low=0.0, high=4e-4, status="upper_bound")}})
>>> result.meets, result.best, result.worst, result.decided_by
('consumer', 'consumer', 'consumer', DecidedBy(axis='x', coefficient='B'))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from imumon.model.coefficients import COEFFICIENTS, GRADED, GRADES, NOT_WHITE, SCALE, Estimate, GradeName
from imumon.model.report import Axis, DecidedBy, SensorGrade

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


def grade_at(sensor: str, coefficient: str, size: float) -> GradeName:
    """Return the best grade whose limit a size of N or B does not exceed.

    Parameters
    ----------
    size : SI

    >>> grade_at("gyro", "N", 8.858211836469779e-5), grade_at("gyro", "B", 1.0)
    ('consumer', 'below consumer')
    """
    limits = LIMITS[sensor][coefficient]
    return next((grade for grade in GRADES if size <= limits[grade]), SCALE[-1])


def grade_channel(sensor: str, coefficients: Mapping[str, Estimate]) -> GradeName | None:
    """Return the grade of the N and B of a channel that are known; None if none is."""
    return grade_sensor(sensor, {"": coefficients}).meets


def grade_sensor(sensor: str, axes: Mapping[str, Mapping[str, Estimate]]) -> SensorGrade:
    """Return the grade of a sensor.

    Parameters
    ----------
    sensor : ``gyro`` or ``accel``; others have no grades.
    axes : coefficients by axis and letter; `decided_by` uses the same names of the axes.
    """
    if sensor not in LIMITS:
        # final, and not provisional: no sample will change it
        return SensorGrade(provisional=False, reason=f"the table has no grades for {sensor}")
    not_white = [axis for axis, parts in axes.items() if "N" in parts and parts["N"].reason_code == NOT_WHITE]
    if not_white:
        return SensorGrade(
            reason=f"the noise of {', '.join(not_white)} is not white, and limits of N are for white noise"
        )
    known = [part for axis, coefficients in axes.items() for part in _graded(sensor, axis, coefficients)]
    if not known:
        return SensorGrade(reason="no coefficient is measured or bounded yet")
    expected = len(LIMITS[sensor]) * len(axes)
    deciding = _worst(known)
    # The grade is the worst of all, so the best case is the worst of the lower limits, not the best of them.
    best = max((part.best for part in known), key=SCALE.index)
    worst = max((part.worst for part in known), key=SCALE.index) if len(known) == expected else SCALE[-1]
    return SensorGrade(
        meets=deciding.meets,
        best=best,
        worst=worst,
        # the names of axes and of graded letters are those of the message
        decided_by=DecidedBy(axis=cast(Axis, deciding.axis), coefficient=cast(Any, deciding.coefficient)),
        provisional=best != worst,
        reason=None if best == worst else _doubt(deciding, best, worst, expected - len(known), expected),
    )


@dataclass(frozen=True, slots=True)
class _Graded:
    """A measured or bounded coefficient, with its grades at its size and at both of its limits.

    Attributes
    ----------
    excess : 1, size over the limit of `meets`, or of the last grade.
    """

    axis: str
    coefficient: str
    measured: bool
    meets: GradeName
    best: GradeName
    worst: GradeName
    excess: float


def _graded(sensor: str, axis: str, coefficients: Mapping[str, Estimate]) -> list[_Graded]:
    """Return the coefficients of an axis that have a limit and are not pending."""
    graded = []
    for letter, limits in LIMITS.get(sensor, {}).items():
        estimate = coefficients.get(letter, Estimate()).stated
        measured = estimate.status == "measured"
        size = estimate.value if measured else estimate.high
        if estimate.status == "pending" or size is None:
            continue
        # A bound may be anything down to 0; a value without limits is as good as exact.
        low = estimate.low if estimate.low is not None else (size if measured else 0.0)
        high = estimate.high if estimate.high is not None else size
        meets = grade_at(sensor, letter, size)
        graded.append(
            _Graded(
                axis=axis,
                coefficient=letter,
                measured=measured,
                meets=meets,
                best=grade_at(sensor, letter, low),
                worst=grade_at(sensor, letter, high),
                excess=size / limits.get(meets, limits[GRADES[-1]]),
            )
        )
    return graded


def _doubt(deciding: _Graded, best: GradeName, worst: GradeName, pending: int, expected: int) -> str:
    """Return why a grade is not certain.

    Parameters
    ----------
    pending, expected : coefficients that are not known yet, and all of the sensor.
    """
    if pending:
        return f"{pending} of {expected} coefficients {'is' if pending == 1 else 'are'} pending"
    if not deciding.measured:
        return f"{deciding.coefficient} of {deciding.axis} is only bounded: the grade may be {best}"
    return f"the 95 % limits allow {best} to {worst}"


def _worst(graded: Sequence[_Graded]) -> _Graded:
    """Return the one of the worst grade that is largest relative to the limit of that grade."""
    return max(graded, key=lambda part: (SCALE.index(part.meets), part.excess))
