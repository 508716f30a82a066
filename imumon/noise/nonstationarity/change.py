"""Changes of N, B and the bias against the hours before or a saved baseline.

N and B are compared by the logarithm of their ratio against their limits, the bias by the difference of the
means against what the fitted noise does by itself in that time (`mean_covariance`). The comparison with a
saved report shows whether a sensor has changed in the field. A change is reported if it is beyond chance and
large enough to matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from imumon.noise.fit import ChannelFit, FittedCoefficient
from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.report import Change, Coefficient, Report

CHANGE_SIGMA = 5.0
"""Standard errors beyond which a change is reported: 6e-7, for 27 comparisons an hour over years. Not
critical."""
LEAST_CHANGE_N = 0.05
"""Relative change of N below which it does not matter to a user. Not critical."""
LEAST_CHANGE_B = 0.5
"""Relative change of B below which it does not matter: B of the same sensor varies by as much. Not
critical."""
MOST_SIGMA = 1e6
"""Most standard errors that are reported; more have no meaning. Not critical."""
LIMIT_95 = 1.96
"""Standard errors, half-width of a 95 % interval. Not critical."""

_TINY = 1e-300
"""Least divisor. Not critical."""
_LEAST_ERROR = 1e-12
"""Relative, least divisor. Not critical."""


@dataclass(frozen=True, slots=True)
class NoiseSummary:
    """Noise and mean of a channel over a stretch.

    Attributes
    ----------
    N, B : with their limits.
    mean : channel unit; None if unknown.
    noise : covariance of its means; None if unknown.
    length_s : s.
    """

    N: FittedCoefficient | Coefficient
    B: FittedCoefficient | Coefficient
    mean: float | None
    noise: MeanCovariance | None
    length_s: float

    @classmethod
    def of(cls, fit: ChannelFit, mean: float | None, length_s: float) -> NoiseSummary:
        """Return the summary of a fit."""
        return cls(fit.N, fit.B, mean, MeanCovariance.of(fit), length_s)


def detect_changes(
    before: NoiseSummary, now: NoiseSummary, against: str, apart_s: float | None = 0.0
) -> list[Change]:
    """Return the significant changes between two stretches.

    Parameters
    ----------
    against : what `before` is, for the report.
    apart_s : s, from the end of the one to the beginning of the other. None: unknown, as for a saved
        baseline; then the bias is not compared, because it differs from one power-up to the next.
    """
    compared = [
        _compare(against, "N", before.N, now.N, LEAST_CHANGE_N),
        _compare(against, "B", before.B, now.B, LEAST_CHANGE_B),
        None if apart_s is None else _compare_bias(against, before, now, apart_s),
    ]
    return [change for change in compared if change is not None]


def compare_with_report(baseline: Report, name: str, now: NoiseSummary) -> list[Change]:
    """Return what differs between a channel of a saved report and the present noise of the same channel."""
    channel = baseline.channels.get(name)
    if channel is None or channel.N is None or channel.B is None:
        return []
    before = NoiseSummary(channel.N, channel.B, channel.mean, None, baseline.session.elapsed_s)
    return detect_changes(before, now, "baseline", None)


def compare_reports(baseline: Report, report: Report, name: str) -> list[Change]:
    """Return what differs between two reports in one channel."""
    channel = report.channels[name]
    if channel.N is None or channel.B is None:
        return []
    now = NoiseSummary(channel.N, channel.B, channel.mean, None, report.session.elapsed_s)
    return compare_with_report(baseline, name, now)


def _compare_bias(against: str, before: NoiseSummary, now: NoiseSummary, apart_s: float) -> Change | None:
    """Return the change of the bias; None if there is none."""
    # the longer stretch determines the slow noise best
    noise = (before if before.length_s >= now.length_s else now).noise
    if noise is None or before.mean is None or now.mean is None:
        return None
    error = noise.difference(before.length_s, now.length_s, apart_s)
    sigma = min(abs(now.mean - before.mean) / max(error, _TINY), MOST_SIGMA)
    if sigma <= CHANGE_SIGMA:
        return None
    return Change(against=against, quantity="bias", before=before.mean, now=now.mean, ratio=None, sigma=sigma)


def _compare(
    against: str,
    quantity: str,
    before: FittedCoefficient | Coefficient,
    now: FittedCoefficient | Coefficient,
    least: float,
) -> Change | None:
    """Return the change of a coefficient, compared on a logarithmic scale; None if there is none."""
    errors = []
    for each in (before, now):
        if not each.value or not each.low or not each.high or each.low <= 0.0:
            return None
        errors.append(math.log(each.high / each.low) / (2.0 * LIMIT_95))
    assert before.value is not None
    assert now.value is not None
    ratio = now.value / before.value
    sigma = abs(math.log(ratio)) / max(math.hypot(*errors), _LEAST_ERROR)
    if sigma < CHANGE_SIGMA or abs(math.log(ratio)) < math.log1p(least):
        return None
    return Change(
        against=against, quantity=quantity, before=before.value, now=now.value, ratio=ratio, sigma=sigma
    )
