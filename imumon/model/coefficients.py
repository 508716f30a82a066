"""Coefficients of the noise: the table that describes each, and the estimate of one.

A coefficient is a row of `COEFFICIENTS` and the code of the fit that finds it. Report, screen, datasheet, history,
metrics and CSV read the table. Standard library only, as `report`.

Gauss–Markov noise has two numbers, the standard deviation M and the time constant T. Each is a row, so that whatever
goes through the table shows both; the JSON of a report has them together, as a `MarkovEstimate`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias, get_args

from imumon.model.units import DEG, FLICKER, HOUR, STANDARD_GRAVITY

Status: TypeAlias = Literal["measured", "upper_bound", "indistinct", "pending"]
STATUSES: tuple[Status, ...] = get_args(Status)
BOUNDS: tuple[Status, ...] = ("upper_bound", "indistinct")
"""Statuses of a coefficient of which only an upper limit is known."""
LimitedGrade: TypeAlias = Literal["navigation", "tactical", "industrial", "consumer"]
GRADES: tuple[LimitedGrade, ...] = get_args(LimitedGrade)
"""Those that have limits, from the best to the worst."""
GradeName: TypeAlias = Literal[LimitedGrade, "below consumer"]
SCALE: tuple[GradeName, ...] = (*GRADES, "below consumer")
"""All that a sensor may have."""

LIMIT_95 = 1.959964
"""Standard errors, half-width of a 95 % interval."""

SIGNIFICANT = 3.9
"""Standard errors from which a drift, slope or correlation is significant: 10^-4, because many channels are tested."""

QUARTERS = 4
"""Parts of a record between which the scatter of a coefficient is known."""

INDISTINCT_WORD = "open"
"""Word after the bound of a coefficient that the record does not separate from another; a narrow column holds it."""

MG = 1000.0 / STANDARD_GRAVITY
"""mg in a m/s^2."""

HUMP_TIMES, HUMP_LEVEL = 1.8926, 0.6174
"""Averaging time, in time constants, at which the Allan deviation of Gauss–Markov noise is largest, and its value there
for a standard deviation of 1 (IEEE Std 952-1997, section C.1.4)."""
SERIES_BELOW = 0.01
"""Averaging times in time constants below which the Allan variance of Gauss–Markov noise is computed by its series: the
exponentials cancel, and what is left out of the series is below 1e-4 of it."""


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
    slope : of log sigma over log tau where it dominates the Allan deviation; of M 0.0, at its hump.
    level : Allan deviation at 1 s of a coefficient of 1 (IEEE Std 952 annex C); of M at its hump; 0.0: it has none.
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

    def deviation(self, tau_s: float, time_constant_s: float | None = None) -> float:
        """Return the Allan deviation of a coefficient of 1 at an averaging time; inf beyond the range of numbers.

        Parameters
        ----------
        time_constant_s : s, of Gauss–Markov noise; None: that of the power law, for M its largest one.
        """
        if time_constant_s is not None and self.letter == MARKOV.sigma:
            return markov_deviation(tau_s, time_constant_s)
        try:
            return self.level * math.pow(tau_s, self.slope)
        except OverflowError:  # a hostile report has averaging times of 1e-320 s
            return math.inf

    @property
    def read_s(self) -> float | None:
        """Averaging time at which the Allan deviation has the value of the coefficient; None: at none."""
        return math.pow(self.level, -1.0 / self.slope) if self.slope else None

    @property
    def mark_height(self) -> float:
        """Allan deviation at the mark in a figure, for a coefficient of 1: where it is read off, or its flat part."""
        return self.level if self.read_s is None else 1.0

    def mark_s(self, floor_s: float, time_constant_s: float | None) -> float | None:
        """Return the averaging time at which a figure marks the coefficient; None: nowhere.

        Flicker is flat everywhere: its mark is where the noise is lowest. That of Gauss–Markov noise is on its hump.

        Parameters
        ----------
        floor_s : s, where the noise is lowest.
        time_constant_s : s, of Gauss–Markov noise; None: unknown.
        """
        if self.letter == MARKOV.sigma:
            return None if time_constant_s is None else HUMP_TIMES * time_constant_s
        return (self.read_s or floor_s) if self.level else None


class MarkovLetters(NamedTuple):
    """Letters of the two numbers of Gauss–Markov noise."""

    sigma: str
    time_constant_s: str


MARKOV = MarkovLetters("M", "T")


def markov_deviation(tau_s: float, time_constant_s: float) -> float:
    """Return the Allan deviation of Gauss–Markov noise of standard deviation 1 (IEEE Std 952-1997, section C.1.4).

    Its square is (2 T / tau) (1 - T / (2 tau) (3 - 4 exp(-tau / T) + exp(-2 tau / T))): far below T that of a random
    walk of the density 2 / T, far above T that of white noise of the density 2 T.

    >>> round(markov_deviation(HUMP_TIMES * 50.0, 50.0), 4)
    0.6174
    """
    x = tau_s / time_constant_s if time_constant_s > 0.0 else math.inf
    if x < SERIES_BELOW:
        return math.sqrt(max(x * (2.0 / 3.0 - 0.5 * x), 0.0))
    variance = 2.0 / x * (1.0 - (3.0 - 4.0 * math.exp(-x) + math.exp(-2.0 * x)) / (2.0 * x))
    return math.sqrt(max(variance, 0.0))


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
        letter=MARKOV.sigma,
        about="correlated noise (first-order Gauss–Markov): its standard deviation",
        slope=0.0,
        level=HUMP_LEVEL,
        units={
            "gyro": CoefficientUnit("correlated noise (Gauss–Markov)", "rad/s", DEG * HOUR, "deg/h"),
            "accel": CoefficientUnit("correlated noise (Gauss–Markov)", "m/s^2", MG, "mg"),
            "mag": CoefficientUnit("correlated noise (Gauss–Markov)", "gauss", 1000.0, "mG"),
        },
    ),
    Coefficient(
        letter=MARKOV.time_constant_s,
        about="time constant of the correlated noise",
        slope=0.0,
        level=0.0,
        units=dict.fromkeys(("gyro", "accel", "mag"), CoefficientUnit("time constant", "s", 1.0, "s")),
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
NOT_WHITE = "not_white"
"""Reason code of an N whose noise is not white: its limits hold levels of several frequencies, and it has no grade."""
CONVERGING = (*NOISE, MARKOV.sigma)
"""Letters of which a report has what was stated when the record was shorter."""
SINGLE = tuple(letter for letter in COEFFICIENTS if letter not in MARKOV)
"""Letters of noise that one number describes: members of a channel in the JSON."""
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


_MEANS: Mapping[str, tuple[float, str]] = {"gyro": (DEG, "deg/s"), "mag": (1000.0, "mG")}


def mean_unit(sensor: str, si: str) -> tuple[float, str]:
    """Return the factor from SI and the unit in which people read the values of a sensor.

    >>> mean_unit("mag", "gauss"), mean_unit("accel", "m/s^2")
    ((1000.0, 'mG'), (1.0, 'm/s^2'))
    """
    return _MEANS.get(sensor, (1.0, si))


BIAS_SLOPE = "slope"
"""Slope of the bias against the temperature in the history, channel unit per degC."""


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
    combined_low: float | None = None  # in `unit`, lower 95 % limit with all that is known; null: unknown
    combined_high: float | None = None  # in `unit`, upper 95 % limit with all that is known; null: unknown
    dof: float | None = None  # 1, degrees of freedom of the combined limits; null: infinite, or not measured
    # "upper_bound": does not show, at most `high`; "indistinct": it or one in `reason` shows; "pending": unknown
    status: Status = "pending"
    unit: str = ""  # such as rad/s/sqrt(Hz)
    scatter: float | None = None  # in `unit`, standard deviation between the quarters of the record
    excess: Excess | None = None  # of this scatter; null: unknown
    reason: str | None = None  # why there is no value, or why there is no scatter
    reason_code: str | None = None  # why no value: constant, resolution, excluded, gaps; no grade: not_white

    DERIVED: ClassVar = {"readable": ("value", "low", "high", "unit")}
    """Properties that the JSON has, with their members."""

    @property
    def readable(self) -> Estimate:
        """The same in the unit that people read."""
        readable = _READABLE.get(self.unit)
        return self if readable is None else self.scaled(readable.factor, readable.unit)

    @property
    def stated(self) -> Estimate:
        """The same with the combined limits in place of those of the statistics, where they are known."""
        if self.combined_low is None or self.combined_high is None:
            return self
        return replace(self, low=self.combined_low, high=self.combined_high)

    @property
    def interval(self) -> tuple[float | None, float | None]:
        """The limits that documents print, in `unit`: combined where they are known; of a bound 0 and the bound."""
        return self.stated.low, self.stated.high

    def __str__(self) -> str:
        """Return value and limits in SI: ``6.1e-05 (6e-05 to 6.2e-05) rad/s/sqrt(Hz)``."""
        text = self.stated.text(_in_si, lambda high: f"< {high:.4g}", f"pending ({self.reason or 'unknown'})")
        return text if self.status == "pending" else f"{text} {self.unit}"

    @property
    def size(self) -> float | None:
        """Value, or half the bound, where it is about as likely above as below; None while it is pending."""
        if self.status == "measured":
            return self.value
        return self.high / 2.0 if self.is_bound and self.high is not None else None

    @property
    def is_bound(self) -> bool:
        """Whether `high` is all that is known: the record does not show it, or not which of several it is."""
        return self.status in BOUNDS

    @property
    def half_width(self) -> float | None:
        """Half of the 95 % interval as a share of the value; None if one of them is unknown."""
        if not self.value or self.low is None or self.high is None:
            return None
        return 0.5 * (self.high - self.low) / self.value

    def known_to(self, share: float) -> bool:
        """Return whether half of the interval that documents state is at most a share of the value.

        The two digits that are printed decide: a number does not miss the goal that is printed beside it.

        >>> one = Estimate(value=1.0, low=0.99, high=1.0104, status="measured")
        >>> one.known_to(0.01), one.known_to(0.0099)
        (True, False)
        """
        half = self.stated.half_width
        return half is not None and float(f"{100.0 * half:.2g}") <= 100.0 * share * (1.0 + 1e-9)

    def text(
        self,
        value: Callable[[float, float | None, float | None], str],
        bound: Callable[[float], str],
        pending: str,
        indistinct: str = f" {INDISTINCT_WORD}",
    ) -> str:
        """Return what `value` makes of a measured value with its limits, or `bound` of a bound, else `pending`.

        Parameters
        ----------
        indistinct : follows the bound of a coefficient that the record does not separate from another.
        """
        if self.status == "measured" and self.value is not None:
            return value(self.value, self.low, self.high)
        if self.high is None or not self.is_bound:
            return pending
        return bound(self.high) + (indistinct if self.status == "indistinct" else "")

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


def _in_si(value: float, low: float | None, high: float | None) -> str:
    return f"{value:.4g}" if low is None or high is None else f"{value:.4g} ({low:.4g} to {high:.4g})"


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkovEstimate:
    """First-order Gauss–Markov noise: standard deviation and time constant, with their 95 % limits."""

    sigma: Estimate  # channel unit, standard deviation
    time_constant_s: Estimate  # s, time after which it has forgotten its value


def by_letter(single: Mapping[str, Estimate], markov: MarkovEstimate | None) -> dict[str, Estimate]:
    """Return all coefficients by letter in the order of the table; the time constant only where both are measured.

    A time constant has no bound that says something: where it is not measured, its limits are those of the search.
    """
    known = dict(single)
    if markov is not None:
        known[MARKOV.sigma] = markov.sigma
        if markov.sigma.status == markov.time_constant_s.status == "measured":
            known[MARKOV.time_constant_s] = markov.time_constant_s
    return {letter: known[letter] for letter in (*COEFFICIENTS, *known) if letter in known}


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
    small, large = sorted((first, second), key=lambda estimate: estimate.value or 0.0)
    if not (small.value and small.high and large.value and large.low):
        return False
    half_width = math.hypot(math.log(small.high / small.value), math.log(large.value / large.low))
    return math.log(large.value / small.value) > half_width
