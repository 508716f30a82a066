"""Uncertainty budgets: the components of `noise.uncertainty` for the coefficients and the bias of a report.

Each component states in words what it rests on, or why it is unknown. An unknown one is in the budget without a number:
a reader sees what is missing. Bounds and pending coefficients have no budget, because they have no value.

A bias has a budget only with a history of enough power-ups: what the power cycle adds exceeds the rest by far.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace

from imumon.coefficients import LIMIT_95, MARKOV, QUARTERS, Estimate, MarkovEstimate
from imumon.evaluation import UncertaintyBudget, UncertaintyComponent
from imumon.history_report import DayScatter
from imumon.noise import uncertainty
from imumon.noise.uncertainty import CombinedUncertainty, StandardUncertainty
from imumon.pipeline.report_builder import NOT_EVERY_QUARTER
from imumon.report import Channel, Report
from imumon.samples import INERTIAL, sensor_of

CRYSTAL_TOLERANCE = 1e-4
"""Share by which the clock of a sensor is assumed to be off at most: 100 parts in a million, ten times a usual
crystal over temperature."""
GIVEN_RATE_TOLERANCE = 0.01
"""Share by which a configured or mean rate is assumed to be off at most: the oscillator of a sensor without a
crystal."""

NO_ALIASING = 1.001
"""Factor by which aliasing raises N, up to which there is none: a filter that averages gives 1 but for rounding."""

NOT_COVERED = (
    "a coefficient that moves away and does not return: its limits hold its mean over this record, not its value "
    "before or after",
    "the scale factor of the sensor: values are taken as the sensor reports them, not compared with a standard",
    "ageing, orientation, supply voltage, and vibration or mounting other than in this record",
)


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
        for letter, part in channel.estimates.items():
            days = (history or {}).get(name, {}).get(letter)
            if (budget := _budget(report, name, channel, letter, part, days)) is not None:
                budgets.setdefault(name, {})[letter] = budget
    return budgets


def with_combined(
    report: Report, budgets: Mapping[str, Mapping[str, UncertaintyBudget]]
) -> dict[str, Channel]:
    """Return the channels of a report with the combined limits of their coefficients.

    Those of a coefficient without a budget are its limits of statistics: nothing else is known of a bound.
    """

    return {name: _with_combined(channel, budgets.get(name, {})) for name, channel in report.channels.items()}


def _with_combined(channel: Channel, budgets: Mapping[str, UncertaintyBudget]) -> Channel:
    """Return a channel with the combined limits of its coefficients."""

    def combined(letter: str, part: Estimate) -> Estimate:
        budget = budgets.get(letter)
        low, high = (part.low, part.high) if budget is None else (budget.low, budget.high)
        return replace(part, combined_low=low, combined_high=high)

    single = {letter: combined(letter, part) for letter, part in channel.coefficients.items()}
    if channel.M is None:
        return replace(channel, coefficients=single)
    pairs = zip(MARKOV, (channel.M.sigma, channel.M.time_constant_s), strict=True)
    sigma, time_constant = (combined(letter, part) for letter, part in pairs)
    return replace(channel, coefficients=single, M=MarkovEstimate(sigma=sigma, time_constant_s=time_constant))


def bias_budgets(report: Report) -> dict[str, UncertaintyBudget]:
    """Return the budget of the bias of each channel whose turn-on repeatability is known."""
    budgets = {}
    for name, channel in report.channels.items():
        shape = channel.distribution
        if shape is None or not shape.bias or shape.turn_on_std is None or not shape.turn_on_count:
            continue
        if shape.bias_low is not None and shape.bias_high is not None:
            spread, basis = (shape.bias_high - shape.bias_low) / (2.0 * LIMIT_95), "95 % limits of the mean"
            statistics = UncertaintyComponent(source="statistics", kind="A", standard=spread, basis=basis)
        else:
            basis = "the record is too short for limits of the mean"
            statistics = UncertaintyComponent(source="statistics", kind="A", standard=None, basis=basis)
        repeatability = UncertaintyComponent(
            source="repeatability",
            kind="A",
            standard=shape.turn_on_std,
            dof=shape.turn_on_count - 1.0,
            basis=f"settled biases of {shape.turn_on_count} power-ups",
        )
        components = (statistics, repeatability)
        # A bias may be negative, and its limits are symmetric.
        combined = uncertainty.combine(shape.bias, _known(components))
        budgets[name] = _message(channel.unit, shape.bias, components, combined)
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


# ---------------------------------------------------------------- one coefficient


def _budget(
    report: Report, name: str, channel: Channel, letter: str, part: Estimate, days: DayScatter | None
) -> UncertaintyBudget | None:
    """Return the budget of a coefficient; None without a value and both limits."""
    value = part.value
    if part.status != "measured" or not value or part.low is None or part.high is None:
        return None
    statistics = uncertainty.of_limits(value, part.low, part.high).standard
    scatter = _scatter(part, value, statistics)
    components = (
        # `combine_with_limits` expects it first
        UncertaintyComponent(
            source="statistics", kind="A", standard=statistics, basis="95 % limits of the fit"
        ),
        scatter,
        *([_repeatability(days, scatter.standard or 0.0)] if days is not None else []),
        _resolution(channel, letter, value, report.device.sample_rate_hz),
        # what folds down from higher frequencies is white: it raises N alone
        *([_aliasing(report, name)] if letter == "N" else []),
        _time_base(report, name, letter, value),
    )
    combined = uncertainty.combine_with_limits(value, part.low, part.high, _known(components))
    return _message(part.unit, value, components, combined)


def _known(components: Sequence[UncertaintyComponent]) -> list[StandardUncertainty]:
    """Return the components that have a number."""
    return [StandardUncertainty(c.standard, c.dof) for c in components if c.standard is not None]


def _message(
    unit: str, value: float, components: tuple[UncertaintyComponent, ...], combined: CombinedUncertainty
) -> UncertaintyBudget:
    return UncertaintyBudget(unit=unit, value=value, components=components, **asdict(combined))


def _scatter(part: Estimate, value: float, statistics: float) -> UncertaintyComponent:
    """Return how much the mean of the quarters is uncertain by what they scatter beyond statistics."""
    if (excess := part.excess) is None:
        # the reason of a coefficient with a value is that of its missing scatter; an earlier version had none
        basis = NOT_EVERY_QUARTER if part.reason else "the quarters do not show it"
        return UncertaintyComponent(source="scatter", kind="A", standard=None, basis=basis)
    if not excess.value:
        bound = value * excess.high / math.sqrt(QUARTERS)
        basis = "the quarters of the record do not show it: a 95 % bound, not combined"
        return UncertaintyComponent(source="scatter", kind="A", standard=None, bound=bound, basis=basis)
    component = uncertainty.of_scatter(value, excess.value, statistics)
    basis = "between the quarters of the record, beyond statistics"
    return UncertaintyComponent(
        source="scatter", kind="A", standard=component.standard, dof=component.dof, basis=basis
    )


def _repeatability(days: DayScatter, scatter: float) -> UncertaintyComponent:
    """Return how much the coefficient scatters between days, beyond their statistics and the scatter of this record."""
    if days.std is None or days.statistics is None:
        basis = f"fewer than {days.needed} days of the history have a value"
        return UncertaintyComponent(source="repeatability", kind="A", standard=None, basis=basis)
    component = uncertainty.of_days(days.days, days.std, days.statistics, scatter)
    text = f"between {days.days} days of the history, beyond statistics and scatter"
    basis = text if component.standard else f"{text}: none"
    return UncertaintyComponent(
        source="repeatability", kind="A", standard=component.standard, dof=component.dof, basis=basis
    )


def _resolution(channel: Channel, letter: str, value: float, rate_hz: float | None) -> UncertaintyComponent:
    """Return what rounding to the steps of the values may add."""
    step, standard = channel.resolution, None
    if step is None:
        standard, basis = 0.0, "no steps seen"
    elif letter != "N":
        standard, basis = 0.0, "rounding of noisy values is white: N only"
    elif (component := uncertainty.of_resolution(value, step, channel.std, rate_hz)) is None:
        basis = "the steps are coarser than the noise: unknown"
    else:
        standard, basis = component.standard, f"steps of {step:.3g} {channel.unit}, rectangular"
    return UncertaintyComponent(source="resolution", kind="B", standard=standard, basis=basis)


def _aliasing(report: Report, name: str) -> UncertaintyComponent:
    """Return what is known of aliasing: it is a factor, and not combined with spreads."""
    factor, sensor, standard = report.device.alias_factor, sensor_of(name), None
    if sensor not in INERTIAL:
        # The factor of a report is that of the inertial sensors: a magnetometer has point samples also beside deltas.
        basis = f"the filter of {sensor} is unknown: N may be too high, not combined"
    elif factor is None:
        basis = "the filter of the sensor is unknown: N may be too high, not combined"
    elif factor > NO_ALIASING:
        basis = f"N of the stream is {factor:.2f} times that of the sensor, not combined"
    else:
        standard, basis = 0.0, "none"
    return UncertaintyComponent(source="aliasing", kind="B", standard=standard, basis=basis)


def _time_base(report: Report, name: str, letter: str, value: float) -> UncertaintyComponent:
    """Return what the clock that stamps the samples may add."""
    is_of_sensor = report.device.clock in ("startup", "counter", "dt")
    tolerance = CRYSTAL_TOLERANCE if is_of_sensor else GIVEN_RATE_TOLERANCE
    averaged = report.device.stream == "deltas" and sensor_of(name) in INERTIAL
    clock = "clock of the sensor" if is_of_sensor else "configured or mean rate"
    return UncertaintyComponent(
        source="time base",
        kind="B",
        standard=uncertainty.of_time_base(value, letter, tolerance, averaged=averaged).standard,
        basis=f"{clock}, assumed within {100.0 * tolerance:g} %, rectangular",
    )
