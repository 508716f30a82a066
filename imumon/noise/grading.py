"""Grade of a sensor: navigation, tactical, industrial or consumer, from N and B.

The limits are table 3.1 of the VectorNav inertial navigation primer, kept in the units it prints and
turned into SI by the exact factors of `units`. Two readings of the word are given:

- ``meets``: the best grade whose limit is not exceeded; None when it is worse than consumer.
- ``nearest``: the grade whose limit is nearest on a logarithmic scale; this one is the headline.

The rules
---------
1. Only N and B have limits. A coefficient that is pending has no grade.
2. A bounded coefficient (``upper_bound``) stands in with its bound: ``meets`` holds at 95 %. A bound
   says how little is known and not how bad the sensor is, so it decides ``nearest`` only where nothing
   is measured. Where it is worse than the headline it makes that provisional, and the reason
   names it unless something is pending.
3. A channel is as good as the worse of its coefficients, a sensor as the worst of its axes. The one
   that decides is, within the worst grade, the one largest against that grade's limit.
4. The headline is provisional while it could still change: something is pending, or the headline
   of all lower limits differs from that of all upper limits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, TypeAlias

from imumon.units import READABLE

GradeName: TypeAlias = Literal["navigation", "tactical", "industrial", "consumer"]
Status: TypeAlias = Literal["measured", "upper_bound", "pending"]

GRADES: tuple[GradeName, ...] = ("navigation", "tactical", "industrial", "consumer")
"""From the best to the worst."""

READABLE_LIMITS: Mapping[str, Mapping[str, tuple[float, float, float, float]]] = {
    "gyro": {"N": (0.01, 0.05, 0.2, 2.0), "B": (0.01, 1.0, 10.0, 100.0)},  # deg/sqrt(h), deg/h
    "accel": {"N": (0.01, 0.03, 0.1, 1.0), "B": (0.01, 0.1, 1.0, 10.0)},  # m/s/sqrt(h), mg
}
"""Table 3.1 by sensor and coefficient, one limit for each of `GRADES`, in readable units."""


class Estimate(Protocol):
    """What grading reads of a coefficient: value and 95 % limits in SI, and what they are worth."""

    @property
    def value(self) -> float | None: ...
    @property
    def low(self) -> float | None: ...
    @property
    def high(self) -> float | None: ...
    @property
    def status(self) -> Status: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Grading:
    """Grade of one coefficient; None where there is none to give."""

    nearest: GradeName | None = None
    meets: GradeName | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelGrade:
    """Grades of a channel's N and B, and the worse of them."""

    N: Grading = Grading()
    B: Grading = Grading()
    nearest: GradeName | None = None
    meets: GradeName | None = None


class DecidedBy(NamedTuple):
    """The coefficient that a headline hangs on.

    Attributes
    ----------
    axis : as the caller named it.
    coefficient : ``N`` or ``B``.
    """

    axis: str
    coefficient: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorGrade:
    """Headline of a sensor: the worst of its axes, and what decides it.

    Attributes
    ----------
    reason : why there is no grade, or why it is provisional.
    """

    nearest: GradeName | None = None
    meets: GradeName | None = None
    decided_by: DecidedBy | None = None
    provisional: bool = True
    reason: str | None = None


def limits() -> dict[str, dict[str, dict[str, float]]]:
    """Limits in SI by sensor, coefficient and grade.

    >>> f"{limits()['gyro']['N']['industrial']:.3e} rad/s/sqrt(Hz)"
    '5.818e-05 rad/s/sqrt(Hz)'
    """
    return {
        sensor: {
            name: dict(zip(GRADES, (row / READABLE[sensor, name].factor for row in rows), strict=True))
            for name, rows in coefficients.items()
        }
        for sensor, coefficients in READABLE_LIMITS.items()
    }


LIMITS = limits()


def grade_coefficient(
    sensor: str,
    coefficient: str,
    value: float | None,
    low: float | None = None,
    high: float | None = None,
    status: Status = "measured",
) -> Grading:
    """Grade one coefficient.

    Parameters
    ----------
    sensor : ``gyro`` or ``accel``; others have no grades.
    coefficient : ``N`` or ``B``; K has none.
    value, low, high : SI, the estimate and its 95 % limits; `high` stands in for a bounded one.

    >>> grade_coefficient("gyro", "N", 8.858211836469779e-5)
    Grading(nearest='industrial', meets='consumer')
    """
    figure = _figure(value, high, status)
    table = LIMITS.get(sensor, {}).get(coefficient)
    if figure is None or table is None:
        return Grading()
    return Grading(nearest=_nearest(table, figure), meets=_meets(table, figure))


def grade_channel(sensor: str, *, N: Estimate | None = None, B: Estimate | None = None) -> ChannelGrade:
    """Grade a channel by its N and B."""
    found = {"N": N, "B": B}
    known = [
        _Known(sensor, "", name, estimate) for name, estimate in found.items() if _counts(sensor, estimate)
    ]
    gradings = {name: _grading(sensor, name, estimate) for name, estimate in found.items()}
    return ChannelGrade(
        N=gradings["N"],
        B=gradings["B"],
        nearest=_deciding(known).nearest if known else None,
        meets=_worst_meets(known),
    )


def grade_sensor(sensor: str, axes: Mapping[str, Mapping[str, Estimate | None]]) -> SensorGrade:
    """Headline grade of a sensor.

    Parameters
    ----------
    sensor : ``gyro`` or ``accel``.
    axes : by axis (any name, it comes back in `decided_by`), the estimates of N and B.
    """
    if sensor not in LIMITS:
        return SensorGrade(provisional=False, reason=f"the table has no grades for {sensor}")
    known = [
        _Known(sensor, axis, name, estimates.get(name))
        for axis, estimates in axes.items()
        for name in LIMITS[sensor]
        if _counts(sensor, estimates.get(name))
    ]
    pending = sum(len(LIMITS[sensor]) for _ in axes) - len(known)
    if not known:
        return SensorGrade(reason="no coefficient is measured or bounded yet")
    decides = _deciding(known)
    best = max(GRADES.index(item.at_low) for item in known)
    worst = max(GRADES.index(item.at_high) for item in known)
    reason = None
    loose = [item for item in known if GRADES.index(item.nearest) > GRADES.index(decides.nearest)]
    if pending:
        verb = "is" if pending == 1 else "are"
        reason = f"{pending} of {pending + len(known)} coefficients {verb} pending"
    elif loose:
        bound = _worst(loose)
        reason = f"{bound.coefficient} of {bound.axis} is only bounded: it may still be {bound.nearest}"
    elif best != worst:
        reason = f"the intervals reach from {GRADES[best]} to {GRADES[worst]}"
    return SensorGrade(
        nearest=decides.nearest,
        meets=_worst_meets(known),
        decided_by=DecidedBy(decides.axis, decides.coefficient),
        provisional=reason is not None,
        reason=reason,
    )


class _Known:
    """A coefficient that counts, with its grades at its figure and at both of its limits."""

    def __init__(self, sensor: str, axis: str, coefficient: str, estimate: Estimate | None) -> None:
        assert estimate is not None
        table = LIMITS[sensor][coefficient]
        figure = _figure(estimate.value, estimate.high, estimate.status)
        assert figure is not None
        self.axis = axis
        self.coefficient = coefficient
        self.measured = estimate.status == "measured"
        self.nearest = _nearest(table, figure)
        self.meets = _meets(table, figure)
        self.excess = figure / table[self.nearest]
        low = estimate.low if estimate.low is not None else (figure if self.measured else 0.0)
        self.at_low = _nearest(table, low)
        self.at_high = _nearest(table, estimate.high if estimate.high is not None else figure)


def _figure(value: float | None, high: float | None, status: Status) -> float | None:
    """The number a coefficient is graded by: its value, or its bound; None while it is pending."""
    return {"measured": value, "upper_bound": high, "pending": None}[status]


def _counts(sensor: str, estimate: Estimate | None) -> bool:
    if estimate is None or sensor not in LIMITS:
        return False
    return _figure(estimate.value, estimate.high, estimate.status) is not None


def _grading(sensor: str, name: str, estimate: Estimate | None) -> Grading:
    if estimate is None:
        return Grading()
    return grade_coefficient(sensor, name, estimate.value, estimate.low, estimate.high, estimate.status)


def _nearest(table: Mapping[str, float], figure: float) -> GradeName:
    """Grade nearest on a logarithmic scale; the better one on a tie."""
    if figure <= 0.0:
        return GRADES[0]
    return min(GRADES, key=lambda grade: abs(math.log(figure / table[grade])))


def _meets(table: Mapping[str, float], figure: float) -> GradeName | None:
    return next((grade for grade in GRADES if figure <= table[grade]), None)


def _deciding(known: Iterable[_Known]) -> _Known:
    """The worst of the measured ones, or of the bounds where nothing is measured."""
    items = list(known)
    candidates = [item for item in items if item.measured] or items
    return _worst(candidates)


def _worst(known: Iterable[_Known]) -> _Known:
    return max(known, key=lambda item: (GRADES.index(item.nearest), item.excess))


def _worst_meets(known: Iterable[_Known]) -> GradeName | None:
    """Worst `meets` of all; None when nothing is known or one meets no grade."""
    found = [item.meets for item in known]
    if not found or None in found:
        return None
    return max((grade for grade in found if grade), key=GRADES.index)
