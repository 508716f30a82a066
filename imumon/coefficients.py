"""Coefficients of the noise: the table that describes each, and the estimate of one.

A coefficient is a row of `COEFFICIENTS` and the code of the fit that finds it. Report, screen, datasheet, history,
metrics and CSV read the table. Standard library only, as `report`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias, get_args

from imumon.units import DEG, FLICKER, HOUR, STANDARD_GRAVITY

Status: TypeAlias = Literal["measured", "upper_bound", "pending"]
GradeName: TypeAlias = Literal["navigation", "tactical", "industrial", "consumer"]
GRADES: tuple[GradeName, ...] = get_args(GradeName)
"""From the best to the worst."""

LIMIT_95 = 1.959964
"""Standard errors, half-width of a 95 % interval."""

SIGNIFICANT = 3.9
"""Standard errors from which a drift, slope or correlation is significant: 10^-4, because many channels are tested."""

QUARTERS = 4
"""Parts of a record between which the scatter of a coefficient is known."""

MG = 1000.0 / STANDARD_GRAVITY
"""mg in a m/s^2."""


class CoefficientUnit(NamedTuple):
    """Name and units of a coefficient of one sensor: multiply SI by `factor` and write `unit`."""

    name: str
    si: str
    factor: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Coefficient:
    """A row of the table.

    Attributes
    ----------
    letter : its name in a report.
    about : what it is.
    slope : of log sigma over log tau where it dominates the Allan deviation.
    level : Allan deviation at 1 s of a coefficient of 1 (IEEE Std 952 annex C).
    precision : default of the requested 95 % half-width, as a share of the value; None: known only where it shows.
    graded : whether the grades have limits of it.
    units : by sensor.
    """

    letter: str
    about: str
    slope: float
    level: float
    precision: float | None = None
    graded: bool = False
    units: Mapping[str, CoefficientUnit]

    def deviation(self, tau_s: float) -> float:
        """Return the Allan deviation of a coefficient of 1 at an averaging time; inf beyond the range of numbers."""
        try:
            return self.level * math.pow(tau_s, self.slope)
        except OverflowError:  # a hostile report has averaging times of 1e-320 s
            return math.inf

    @property
    def read_s(self) -> float | None:
        """Averaging time at which the Allan deviation has the value of the coefficient; None: at none."""
        return math.pow(self.level, -1.0 / self.slope) if self.slope else None


_ROWS = (
    Coefficient(
        letter="N",
        about="white noise (random walk of the integral)",
        slope=-0.5,
        level=1.0,
        precision=0.01,
        graded=True,
        units={
            "gyro": CoefficientUnit("angle random walk", "rad/s/sqrt(Hz)", DEG * 60.0, "deg/sqrt(h)"),
            "accel": CoefficientUnit("velocity random walk", "m/s^2/sqrt(Hz)", 60.0, "m/s/sqrt(h)"),
            "mag": CoefficientUnit("white noise", "gauss/sqrt(Hz)", 1000.0, "mG/sqrt(Hz)"),
        },
    ),
    Coefficient(
        letter="B",
        about="flicker (bias instability)",
        slope=0.0,
        level=FLICKER,
        precision=0.2,
        graded=True,
        units={
            "gyro": CoefficientUnit("bias instability", "rad/s", DEG * HOUR, "deg/h"),
            "accel": CoefficientUnit("bias instability", "m/s^2", MG, "mg"),
            "mag": CoefficientUnit("bias instability", "gauss", 1000.0, "mG"),
        },
    ),
    Coefficient(
        letter="K",
        about="random walk of the rate",
        slope=0.5,
        level=1.0 / math.sqrt(3.0),
        precision=0.5,
        units={
            "gyro": CoefficientUnit("rate random walk", "rad/s*sqrt(Hz)", DEG * HOUR * 60.0, "deg/h/sqrt(h)"),
            "accel": CoefficientUnit(
                "acceleration random walk", "m/s^2*sqrt(Hz)", HOUR * 60.0, "m/s/h/sqrt(h)"
            ),
            "mag": CoefficientUnit("random walk", "gauss*sqrt(Hz)", 1000.0, "mG*sqrt(Hz)"),
        },
    ),
    Coefficient(
        letter="Q",
        about="quantisation",
        slope=-1.0,
        level=math.sqrt(3.0),
        units={
            "gyro": CoefficientUnit("quantisation", "rad", DEG * HOUR, "arcsec"),
            "accel": CoefficientUnit("quantisation", "m/s", 1.0, "m/s"),
            "mag": CoefficientUnit("quantisation", "gauss*s", 1000.0, "mG*s"),
        },
    ),
    Coefficient(
        letter="R",
        about="rate ramp: the drift of the model, as a size",
        slope=1.0,
        level=math.sqrt(0.5),
        units={
            "gyro": CoefficientUnit("rate ramp", "rad/s^2", DEG * HOUR * HOUR, "deg/h/h"),
            "accel": CoefficientUnit("acceleration ramp", "m/s^3", MG * HOUR, "mg/h"),
            "mag": CoefficientUnit("ramp", "gauss/s", 1000.0 * HOUR, "mG/h"),
        },
    ),
)

COEFFICIENTS: Mapping[str, Coefficient] = {row.letter: row for row in _ROWS}
"""All, by letter."""
NOISE = tuple(row.letter for row in _ROWS if row.precision is not None)
"""Letters that every channel with a curve has, measured, bounded or pending."""
GRADED = tuple(row.letter for row in _ROWS if row.graded)
"""Letters that have a grade."""
_READABLE = {unit.si: unit for row in _ROWS for unit in row.units.values()}


def default_precision() -> dict[str, float]:
    """Return the requested half-widths by letter that hold without settings."""
    return {row.letter: row.precision for row in _ROWS if row.precision is not None}


def unit_of(sensor: str, letter: str, si: str = "") -> CoefficientUnit:
    """Return the units of a coefficient; `si` of a sensor or letter that the table does not have.

    >>> unit_of("accel", "N").unit, unit_of("other", "N", "V")
    ('m/s/sqrt(h)', CoefficientUnit(name='N', si='V', factor=1.0, unit='V'))
    """
    row = COEFFICIENTS.get(letter)
    unknown = CoefficientUnit(letter, si, 1.0, si)
    return unknown if row is None else row.units.get(sensor, unknown)


BIAS_TERMS = ("slope", "degree_2", "degree_3")
"""Terms of the bias against the temperature in the history, channel unit per degC, degC^2 and degC^3."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Excess:
    """Scatter of a coefficient between the quarters of a record beyond what their statistics explain."""

    value: float | None = None  # 1, standard deviation over the value; null: the quarters do not show it
    low: float  # 1, lower 95 % limit; 0 of a bound
    high: float  # 1, upper 95 % limit, or the 95 % bound
    p_value: float  # 0 to 1, probability that statistics alone scatter as much


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A coefficient with its 95 % limits; `value` is None unless measured."""

    value: float | None = None  # in `unit`
    low: float | None = None  # in `unit`, lower 95 % limit of statistics; 0 of a bound, null while pending
    high: float | None = None  # in `unit`, upper 95 % limit of statistics, or bound; null while pending
    combined_low: float | None = None  # in `unit`, `low` with the whole uncertainty budget; null: unknown
    combined_high: float | None = None  # in `unit`, `high` with the whole uncertainty budget; null: unknown
    status: Status = "pending"  # "upper_bound": does not show, at most `high`; "pending": unknown so far
    unit: str = ""  # such as rad/s/sqrt(Hz)
    scatter: float | None = None  # in `unit`, standard deviation between the quarters of the record
    excess: Excess | None = None  # of this scatter; null: unknown
    reason: str | None = None  # why there is no value, or why there is no scatter
    reason_code: str | None = None  # why there is no value: constant, resolution, excluded, gaps

    DERIVED: ClassVar = {"readable": ("value", "low", "high", "unit")}
    """Properties that the JSON has, with their members."""

    @property
    def readable(self) -> Estimate:
        """The same in the unit that people read."""
        own = _READABLE.get(self.unit)
        return self if own is None else self.scaled(own.factor, own.unit)

    @property
    def stated(self) -> Estimate:
        """The same with the combined limits in place of those of the statistics, where they are known."""
        if self.combined_low is None or self.combined_high is None:
            return self
        return replace(self, low=self.combined_low, high=self.combined_high)

    @property
    def size(self) -> float | None:
        """Value, or half the bound, where it is about as likely above as below; None while it is pending."""
        if self.status == "measured":
            return self.value
        return self.high / 2.0 if self.status == "upper_bound" and self.high is not None else None

    @property
    def half_width(self) -> float | None:
        """Half of the 95 % interval as a share of the value; None if one of them is unknown."""
        if not self.value or self.low is None or self.high is None:
            return None
        return 0.5 * (self.high - self.low) / self.value

    def text(
        self,
        value: Callable[[float, float | None, float | None], str],
        bound: Callable[[float], str],
        pending: str,
    ) -> str:
        """Return what `value` makes of a measured value with its limits, or `bound` of a bound, else `pending`."""
        if self.status == "measured" and self.value is not None:
            return value(self.value, self.low, self.high)
        return bound(self.high) if self.status == "upper_bound" and self.high is not None else pending

    def scaled(self, factor: float, unit: str = "") -> Estimate:
        """Return the same in another unit.

        >>> Estimate(value=1.0, low=0.5, high=2.0, status="measured", unit="gauss").readable.high
        2000.0
        """

        def times(size: float | None) -> float | None:
            return None if size is None else size * factor

        sizes = ("value", "low", "high", "combined_low", "combined_high", "scatter")
        changed: dict[str, Any] = {name: times(getattr(self, name)) for name in sizes}
        return replace(self, **changed, unit=unit)


class CoefficientRatio(NamedTuple):
    """Ratio of a coefficient in two reports: a value if `relation` is "=", else a bound; None: unknown."""

    value: float | None = None
    relation: Literal["=", "<", ">"] = "="
    differs: bool = False  # whether the 95 % limits rule out that both are equal


def coefficient_ratio(first: Estimate, second: Estimate) -> CoefficientRatio:
    """Return the ratio of the second coefficient to the first, in SI, and whether they differ.

    Two values differ at 95 % if the 95 % limits of the difference of their logarithms exclude zero. They
    follow from the half-widths that face one another, added in quadrature (method of variance estimates
    recovery: Zou and Donner, Statistics in Medicine 27, 1693, 2008). A bound differs from a value only if
    the limits of the value are beyond it. Otherwise the ratio is unknown.
    """
    first, second = first.stated, second.stated
    if first.value and second.value:
        return CoefficientRatio(second.value / first.value, differs=_differ(first, second))
    if first.value and second.high is not None and first.low is not None and second.high < first.low:
        return CoefficientRatio(second.high / first.value, "<", differs=True)
    if second.value and first.high and second.low is not None and first.high < second.low:
        return CoefficientRatio(second.value / first.high, ">", differs=True)
    return CoefficientRatio()


def _differ(first: Estimate, second: Estimate) -> bool:
    """Return whether two values differ at 95 %."""
    small, large = sorted((first, second), key=lambda each: each.value or 0.0)
    if not (small.value and small.high and large.value and large.low):
        return False
    half_width = math.hypot(math.log(small.high / small.value), math.log(large.value / large.low))
    return math.log(large.value / small.value) > half_width
