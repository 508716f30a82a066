"""Uncertainty of N, B and K: conformity with a limit, and the budget after JCGM 100:2008 (GUM).

Conformity follows the rule of guarded acceptance and guarded rejection with the combined 95 % limits as guard band
(JCGM 106:2012, section 8.3): pass if the upper limit does not exceed the limit of the data sheet, fail if the
lower one does, else undecided. The probability is that of the same distribution of the logarithm: coefficients are
positive, and their limits are not symmetric.

The budget lists what the value of the record may differ by from the mean of the same quantity of the sensor under the
same conditions. Components of a coefficient C:

- statistics (type A): the 95 % limits of the fit, as a standard deviation of the logarithm.
- scatter (type A): how much C varies between the quarters of the record beyond what statistics explain
  (`stretches.quarters.excess`), over the root of their number: the quarters count as independent. Where they do not
  show it, its bound is stated and not combined. Statistics and scatter together are estimated from four values: they
  have 3 degrees of freedom. Of a coefficient that walks away, the limits hold the mean over the record only.
- repeatability (type A): how much C scatters between the days of the history of the sensor, beyond the statistics of a
  day and the scatter of this record. n - 1 degrees of freedom of n days. Only where the history is known.
- resolution (type B): rounding to a step q adds a white variance of q^2/12 per sample, N_q^2 = q^2 / (12 rate).
  N without it lies in [sqrt(N^2 - N_q^2), N]: a rectangular distribution.
- aliasing (type B): a factor, not a spread. It is named and not combined. The alias factor of a report is that of
  gyroscope and accelerometer: a magnetometer has point samples also beside deltas.
- time base (type B): a clock that runs fast by e changes tau: N by e/2, K by -e/2. Deltas divided by the interval
  also change by -e. Rectangular, with an assumed tolerance of the clock.

The combined limits are value exp(-k u) and value exp(k u), with u of each side from the limit of the fit on that side.

The budget of the bias has the statistics of the mean and the turn-on bias repeatability. Without a history of enough
power-ups there is none: what the power cycle adds exceeds the rest by far.

The effective degrees of freedom are those of Welch and Satterthwaite (JCGM 100, G.4.1), the coverage factor k is
Student's t for 95 %.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from scipy.special import ndtr, stdtr, stdtrit

from imumon.coefficients import LIMIT_95, QUARTERS
from imumon.evaluation import UncertaintyBudget, UncertaintyComponent, Verdict
from imumon.history_report import DayScatter
from imumon.noise.validity_groups import DITHERED
from imumon.report import COEFFICIENTS, Channel, Estimate, Report
from imumon.samples import sensor_of

CRYSTAL_TOLERANCE = 1e-4
"""Share by which the clock of a sensor is assumed to be off at most: 100 parts in a million, ten times a usual
crystal over temperature."""
GIVEN_RATE_TOLERANCE = 0.01
"""Share by which a configured or mean rate is assumed to be off at most: the oscillator of a sensor without a
crystal."""

NOT_COVERED = (
    "a coefficient that moves away and does not return: its limits hold its mean over this record, not its value "
    "before or after",
    "the scale factor of the sensor: values are taken as the sensor reports them, not compared with a standard",
    "ageing, orientation, supply voltage, and vibration or mounting other than in this record",
)


def verdict(limit: float, low: float | None, high: float | None) -> Verdict:
    """Return whether a quantity with these 95 % limits is at most `limit`.

    >>> verdict(2.0, 1.0, 1.5), verdict(2.0, 2.1, 2.5), verdict(2.0, 1.9, 2.1), verdict(2.0, None, None)
    ('pass', 'fail', 'undecided', 'undecided')
    """
    if high is not None and high <= limit:
        return "pass"
    return "fail" if low is not None and low > limit else "undecided"


def probability_at_most(
    limit: float, value: float, low: float, high: float, dof: float | None = None
) -> float | None:
    """Return the probability that a quantity is at most `limit`, 0 to 1; None if its limits show no spread.

    Parameters
    ----------
    dof : degrees of freedom of the 95 % limits; None: infinite.

    Examples
    --------
    >>> round(probability_at_most(1.1, 1.0, 0.9, 1.1), 3), probability_at_most(1.0, 1.0, 0.9, 1.1)
    (0.975, 0.5)
    >>> round(probability_at_most(1.1, 1.0, 0.9, 1.1, 3.0), 3)
    0.975
    """
    end = high if limit > value else low
    if not (limit > 0.0 and value > 0.0 and end > 0.0) or end == value:
        return None
    errors = math.log(limit / value) / abs(math.log(end / value)) * _coverage(dof)
    return float(ndtr(errors) if dof is None else stdtr(_whole(dof), errors))


def with_combined(
    report: Report, budgets: Mapping[str, Mapping[str, UncertaintyBudget]]
) -> dict[str, Channel]:
    """Return the channels of a report with the combined limits of their coefficients; those of a bound are its own."""

    def combined(part: Estimate, made: UncertaintyBudget | None) -> Estimate:
        low, high = (part.low, part.high) if made is None else (made.low, made.high)
        return replace(part, combined_low=low, combined_high=high)

    return {
        name: replace(
            channel,
            coefficients={
                letter: combined(part, budgets.get(name, {}).get(letter))
                for letter, part in channel.coefficients.items()
            },
        )
        for name, channel in report.channels.items()
    }


def uncertainty_budgets(
    report: Report, history: Mapping[str, Mapping[str, DayScatter]] | None = None
) -> dict[str, dict[str, UncertaintyBudget]]:
    """Return the budget of each measured coefficient, by channel and letter; bounds have none.

    Parameters
    ----------
    history : scatter between the days, by channel and letter; None: no history of the sensor is known.
    """
    budgets: dict[str, dict[str, UncertaintyBudget]] = {}
    for name, channel in report.channels.items():
        for letter, part in channel.coefficients.items():
            days = (history or {}).get(name, {}).get(letter)
            if (made := _budget(report, name, channel, letter, part, days)) is not None:
                budgets.setdefault(name, {})[letter] = made
    return budgets


def not_covered(report: Report) -> tuple[str, ...]:
    """Return what no budget of the report includes, one line each."""
    temperature = report.channels.get("temperature")
    if temperature is None or temperature.min is None or temperature.max is None:
        covered = "the temperature: it is not in the record"
    else:
        covered = f"temperatures outside {temperature.min:.1f} °C to {temperature.max:.1f} °C"
    return (covered, _power_cycles(report), *NOT_COVERED)


def _power_cycles(report: Report) -> str:
    """Return what of the repeatability between power cycles is not covered."""
    text = "repeatability between power cycles (turn-on to turn-on)"
    shapes = [channel.distribution for channel in report.channels.values()]
    if any(shape is not None and shape.turn_on_std is not None for shape in shapes):
        return f"{text} of N, B and K, except as far as the days of the history show it"
    known = max((shape.turn_on_count or 0 for shape in shapes if shape is not None), default=0)
    return f"{text}: {f'the history has only {known} of them' if known else 'this is one record'}"


def bias_budgets(report: Report) -> dict[str, UncertaintyBudget]:
    """Return the budget of the bias of each channel whose turn-on repeatability is known."""
    budgets = {}
    for name, channel in report.channels.items():
        shape = channel.distribution
        if shape is None or not shape.bias or shape.turn_on_std is None or not shape.turn_on_count:
            continue
        known = shape.bias_low is not None and shape.bias_high is not None
        spread = (shape.bias_high - shape.bias_low) / (2.0 * LIMIT_95) if known else None  # type: ignore[operator]
        count = shape.turn_on_count
        components = (
            UncertaintyComponent(
                source="statistics",
                kind="A",
                standard=spread,
                basis="95 % limits of the mean"
                if known
                else "the record is too short for limits of the mean",
            ),
            UncertaintyComponent(
                source="repeatability",
                kind="A",
                standard=shape.turn_on_std,
                dof=count - 1.0,
                basis=f"settled biases of {count} power-ups",
            ),
        )
        budgets[name] = _combined(channel.unit, shape.bias, components)
    return budgets


def _budget(
    report: Report, name: str, channel: Channel, letter: str, part: Estimate, days: DayScatter | None
) -> UncertaintyBudget | None:
    value = part.value
    if part.status != "measured" or not value or part.low is None or part.high is None:
        return None
    wide = not 0.0 < part.low < value < part.high
    spread = part.high - part.low if wide else value * math.log(part.high / part.low)
    statistics = spread / (2.0 * LIMIT_95)
    scatter = _scatter(part, value, statistics)
    components = (
        UncertaintyComponent(
            source="statistics", kind="A", standard=statistics, basis="95 % limits of the fit"
        ),
        scatter,
        *([_repeatability(days, scatter.standard or 0.0)] if days is not None else []),
        _resolution(channel, letter, value, report.device.sample_rate_hz),
        *([_aliasing(report, name)] if letter == "N" else []),
        _time_base(report, name, letter, value),
    )
    made = _combined(part.unit, value, components)
    if wide:
        return replace(made, low=max(0.0, value - made.expanded))
    others = math.sqrt(max(0.0, made.combined**2 - statistics**2)) / value

    def half(limit: float) -> float:
        return made.coverage * math.hypot(math.log(limit / value) / LIMIT_95, others)

    low, high = value * math.exp(-half(part.low)), value * math.exp(half(part.high))
    return replace(made, low=low, high=high, expanded=0.5 * (high - low))


def _coverage(dof: float | None) -> float:
    """Return the coverage factor for 95 %."""
    return LIMIT_95 if dof is None else float(stdtrit(_whole(dof), 0.975))


def _whole(dof: float) -> float:
    """Return degrees of freedom truncated to the next lower integer, at least 1 (JCGM 100, G.4.2)."""
    return max(1.0, math.floor(dof * (1.0 + 1e-9)))


def _combined(unit: str, value: float, components: tuple[UncertaintyComponent, ...]) -> UncertaintyBudget:
    """Return a budget of the components that are known, with symmetric limits."""
    known = [(each.standard, each.dof) for each in components if each.standard]
    combined = math.sqrt(sum(u * u for u, _ in known))
    spread = sum(u**4 / dof for u, dof in known if dof is not None)
    dof = combined**4 / spread if spread > 0.0 else None
    coverage = _coverage(dof)
    expanded = coverage * combined
    return UncertaintyBudget(
        unit=unit,
        value=value,
        components=components,
        combined=combined,
        dof=dof,
        coverage=coverage,
        expanded=expanded,
        low=value - expanded,
        high=value + expanded,
    )


def _scatter(part: Estimate, value: float, statistics: float) -> UncertaintyComponent:
    """Return how much the mean of the quarters is uncertain by what they scatter beyond statistics."""
    if (found := part.excess) is None:
        reason = (part.reason or "the quarters do not show it").removeprefix("scatter: ")
        return UncertaintyComponent(source="scatter", kind="A", standard=None, basis=reason)
    if not found.value:
        most = value * found.high / math.sqrt(QUARTERS)
        basis = "the quarters of the record do not show it: a 95 % bound, not combined"
        return UncertaintyComponent(source="scatter", kind="A", standard=None, bound=most, basis=basis)
    standard = value * found.value / math.sqrt(QUARTERS)
    dof = (QUARTERS - 1) * (standard**2 / (standard**2 + statistics**2)) ** 2
    basis = "between the quarters of the record, beyond statistics"
    return UncertaintyComponent(source="scatter", kind="A", standard=standard, dof=dof, basis=basis)


def _repeatability(days: DayScatter, scatter: float) -> UncertaintyComponent:
    """Return how much the coefficient scatters between days, beyond their statistics and the scatter of this record."""
    if days.std is None or days.statistics is None:
        basis = f"fewer than {days.needed} days of the history have a value"
        return UncertaintyComponent(source="repeatability", kind="A", standard=None, basis=basis)
    excess = math.sqrt(max(0.0, days.std**2 - days.statistics**2 - scatter**2))
    text = f"between {days.days} days of the history, beyond statistics and scatter"
    basis = text if excess else f"{text}: none"
    return UncertaintyComponent(
        source="repeatability", kind="A", standard=excess, dof=days.days - 1.0, basis=basis
    )


def _resolution(channel: Channel, letter: str, value: float, rate_hz: float | None) -> UncertaintyComponent:
    """Return what rounding to the steps of the values may add."""

    def made(standard: float | None, basis: str) -> UncertaintyComponent:
        return UncertaintyComponent(source="resolution", kind="B", standard=standard, basis=basis)

    step = channel.resolution
    if step is None or letter != "N":
        return made(0.0, "no steps seen" if step is None else "rounding of noisy values is white: N only")
    if not rate_hz or channel.std is None or channel.std < DITHERED * step:
        return made(None, "the steps are coarser than the noise: unknown")
    rounding = step**2 / (12.0 * rate_hz)
    least = math.sqrt(max(0.0, value**2 - rounding))
    return made((value - least) / math.sqrt(12.0), f"steps of {step:.3g} {channel.unit}, rectangular")


def _aliasing(report: Report, name: str) -> UncertaintyComponent:
    factor = report.device.alias_factor
    if sensor_of(name) not in ("gyro", "accel"):
        standard, basis = None, f"the filter of {sensor_of(name)} is unknown: N may be too high, not combined"
    elif factor is None:
        standard, basis = None, "the filter of the sensor is unknown: N may be too high, not combined"
    elif factor > 1.001:
        standard, basis = None, f"N of the stream is {factor:.2f} times that of the sensor, not combined"
    else:
        standard, basis = 0.0, "none"
    return UncertaintyComponent(source="aliasing", kind="B", standard=standard, basis=basis)


def _time_base(report: Report, name: str, letter: str, value: float) -> UncertaintyComponent:
    own = report.device.clock in ("startup", "counter", "dt")
    tolerance = CRYSTAL_TOLERANCE if own else GIVEN_RATE_TOLERANCE
    averaged = report.device.stream == "deltas" and sensor_of(name) in ("gyro", "accel")
    # N = sigma sqrt(tau), K = sigma sqrt(3 / tau)
    exponent = -COEFFICIENTS[letter].slope - (1.0 if averaged else 0.0)
    clock = "clock of the sensor" if own else "configured or mean rate"
    return UncertaintyComponent(
        source="time base",
        kind="B",
        standard=abs(exponent) * tolerance * value / math.sqrt(3.0),
        basis=f"{clock}, assumed within {100.0 * tolerance:g} %, rectangular",
    )
