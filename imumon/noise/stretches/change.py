"""Changes of N and B against the hours before or a saved baseline.

N and B are compared by the logarithm of their ratio against their limits. The comparison with a saved report shows
whether a sensor has changed in the field. A change is reported if it is beyond chance and large enough to matter. A
sudden change of the bias is a step of the fit.
"""

from __future__ import annotations

import math

from imumon.coefficients import LIMIT_95
from imumon.noise.fit import ChannelFit
from imumon.report import Change, Channel, Estimate, Report

CHANGE_SIGMA = 5.0
"""Standard errors beyond which a change is reported: 6e-7, for 27 comparisons an hour over years."""
LEAST_CHANGE = {"N": 0.05, "B": 0.5}
"""Relative change below which it does not matter to a user: B of the same sensor varies by as much."""


def detect_changes(before: ChannelFit | Channel, now: ChannelFit | Channel, against: str) -> list[Change]:
    """Return the significant changes of N and B between two parts of a record, or two records.

    Parameters
    ----------
    against : what `before` is, for the report.
    """
    compared = [
        _compare(against, name, one, two, least)
        for name, least in LEAST_CHANGE.items()
        if (one := before.coefficients.get(name)) is not None
        and (two := now.coefficients.get(name)) is not None
    ]
    return [change for change in compared if change is not None]


def compare_with_report(baseline: Report, name: str, now: ChannelFit | Channel) -> list[Change]:
    """Return what differs between a channel of a saved report and the present noise of the same channel."""
    channel = baseline.channels.get(name)
    return [] if channel is None else detect_changes(channel, now, "baseline")


def _compare(
    against: str,
    quantity: str,
    before: Estimate,
    now: Estimate,
    least: float,
) -> Change | None:
    """Return the change of a coefficient, compared on a logarithmic scale; None if there is none."""
    errors = []
    for each in (before, now):
        if not each.value or not each.low or not each.high or not 0.0 < each.low < each.high:
            return None
        errors.append(math.log(each.high / each.low) / (2.0 * LIMIT_95))
    assert before.value is not None
    assert now.value is not None
    ratio = now.value / before.value
    sigma = abs(math.log(ratio)) / math.hypot(*errors)
    if sigma < CHANGE_SIGMA or abs(math.log(ratio)) < math.log1p(least):
        return None
    return Change(
        against=against, quantity=quantity, before=before.value, now=now.value, ratio=ratio, sigma=sigma
    )
