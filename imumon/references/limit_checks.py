"""Checks of the values of a report against a reference sheet.

A check compares the value as this stream shows it. Where the report itself says that the stream does not show
the sensor, the check is undecided: a fail of N that aliasing raises, or may raise because the filter is unknown, and
a pass of B or K of a gyroscope whose bias the sensor subtracts.
"""

from __future__ import annotations

import math

from imumon.coefficients import Estimate
from imumon.evaluation import Conformity, LimitCheck, Verdict
from imumon.messages import filter_not_known
from imumon.noise.uncertainty import probability_at_most, verdict
from imumon.references.reference_sheet import QUANTITIES, UNITS, Limit, ReferenceSheet
from imumon.report import Channel, Report
from imumon.samples import ALIASED, INERTIAL, sensor_of


def conformity(report: Report, sheet: ReferenceSheet) -> Conformity:
    """Return the checks of all channels that the sheet has limits for."""
    checks = [
        _check(report, name, report.channels[name], limit)
        for limit in sheet.limits
        for name in limit.channels
        if name in report.channels and QUANTITIES[limit.quantity][0] in report.channels[name].estimates
    ]
    return Conformity(
        title=sheet.title,
        document=sheet.document,
        edition=sheet.edition,
        source=sheet.source,
        note=sheet.note,
        checks=tuple(checks),
    )


def _check(report: Report, name: str, channel: Channel, limit: Limit) -> LimitCheck:
    """Return the check of one channel against one limit, in the unit of the limit."""
    letter, ratio = QUANTITIES[limit.quantity]
    factor = ratio * UNITS[sensor_of(name), letter][limit.unit]
    part = channel.estimates[letter]
    known = part.status != "pending"
    shown = part.stated.scaled(factor) if known else Estimate()
    value, low, high = shown.value, shown.low, shown.high
    outcome: Verdict = verdict(limit.at_most, low if part.status == "measured" else None, high)
    chance = None
    reason = None if known else part.reason or "not known"
    if part.status == "measured" and value is not None and low is not None and high is not None:
        budgets = report.evaluation.budgets if report.evaluation is not None else {}
        budget = budgets.get(name, {}).get(letter)
        chance = probability_at_most(limit.at_most, value, low, high, None if budget is None else budget.dof)
    if part.is_bound:
        reason = "only a 95 % upper bound is known"
    if (doubt := _doubt(report, name, limit, outcome)) is not None:
        outcome, chance, reason = "undecided", None, doubt
    return LimitCheck(
        channel=name,
        quantity=limit.quantity,
        unit=limit.unit,
        limit=limit.at_most,
        basis=limit.basis,
        value=value,
        low=low,
        high=high,
        verdict=outcome,
        probability=chance,
        reason=reason,
    )


def _doubt(report: Report, name: str, limit: Limit, outcome: Verdict) -> str | None:
    """Return why a verdict does not hold for the sensor; None if it does."""
    letter, sensor = QUANTITIES[limit.quantity][0], sensor_of(name)
    # aliasing only raises N, and a subtracted bias only lowers B and K: the opposite verdict holds in spite of it
    if letter == "N" and outcome == "fail":
        factor = _alias_factor(report, sensor, limit)
        if factor > ALIASED:
            return f"aliasing raises N of this stream {factor:.2f} times, nominally"
        if sensor != "mag" and filter_not_known(report) is not None:
            return "the filter of the sensor is unknown: aliasing may raise N"
    if letter != "N" and outcome == "pass" and sensor == "gyro" and "compensated" in report.caveats:
        return "the sensor subtracts its bias from this stream"
    return None


def _alias_factor(report: Report, sensor: str, limit: Limit) -> float:
    """Return the nominal factor by which aliasing raises N of a sensor in this stream; 1: none is known."""
    device = report.device
    factor = (device.alias_factor or 1.0) if sensor in INERTIAL else 1.0
    # a quantity that the sensor reads, unfiltered, more often than it sends it
    if limit.sampled_hz is not None and device.sample_rate_hz:
        factor = max(factor, math.sqrt(limit.sampled_hz / device.sample_rate_hz))
    return factor
