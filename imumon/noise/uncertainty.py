"""Uncertainty of N, B and K: what the limits of a fit do not hold, and its combination after JCGM 100:2008 (GUM).

The problem
-----------
The 95 % limits of a fit hold for one record of a sensor that does not change. A document states how far the value may
be from the mean of the same quantity of the sensor under the same conditions. This module has the formulas;
`pipeline.combined_limits` applies them to a report.

The model
---------
Coefficients are positive and their limits are not symmetric: their logarithms are taken as normally distributed.

Components u of a coefficient C, each a standard uncertainty in the unit of C. Type A comes from statistics of
observations, type B from other knowledge (JCGM 100, 4.2 and 4.3):

- statistics (A): the limits of the fit as a standard deviation, u = C ln(high / low) / (2 * 1.96).
- scatter (A): how much C varies between the quarters of the record beyond what statistics explain, e
  (`stretches.quarters.excess`): u = C e / sqrt(4), because the quarters count as independent. Of a coefficient that
  walks away, the limits hold the mean over the record only.
- repeatability (A): how much C scatters between days, beyond the statistics of a day and the scatter of this record:
  u^2 = std^2 - statistics^2 - scatter^2, with n - 1 degrees of freedom of n days.
- resolution (B): rounding to a step q adds a white variance q^2 / 12 per sample, N_q^2 = q^2 / (12 rate) (Bennett, Bell
  Syst. Tech. J. 27, 446, 1948). N without it lies in [sqrt(N^2 - N_q^2), N]: a rectangular distribution, whose
  standard deviation is its width / sqrt(12).
- time base (B): a clock that runs fast by e changes tau: N by e/2, K by -e/2, because the Allan deviation at tau is
  N tau^-1/2 and K (tau/3)^1/2. Deltas divided by the interval also change by -e. Rectangular over +-e.

They add as u_c^2 = sum of u^2. The effective degrees of freedom are those of Welch and Satterthwaite (JCGM 100, G.4.1),
u_c^4 / sum(u^4 / dof), the coverage factor k is Student's t for 95 %. The combined limits are C exp(-k u / C) and
C exp(k u / C), with u of each side from the limit of the fit on that side.

Example
-------
A value of 1.0 with limits 0.9 to 1.12, and quarters that scatter by 5 % beyond their statistics:

>>> fit = of_limits(1.0, 0.9, 1.12)
>>> quarters = of_scatter(1.0, 0.05, fit.standard)
>>> both = combine(1.0, 0.9, 1.12, [fit, quarters])
>>> [round(u, 3) for u in (fit.standard, quarters.standard)]
[0.056, 0.025]
>>> [round(number, 2) for number in (both.dof, both.low, both.high)]
[3.0, 0.83, 1.22]
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from imumon.model.coefficients import COEFFICIENTS, LIMIT_95, MARKOV, QUARTERS
from imumon.model.samples import Floats
from imumon.noise.validity_groups import DITHERED, ROUNDING_VARIANCE


@dataclass(frozen=True, slots=True)
class StandardUncertainty:
    """What one component adds, in the unit of the value."""

    standard: float  # standard uncertainty
    dof: float | None = None  # 1, degrees of freedom; None: infinite


@dataclass(frozen=True, slots=True)
class CombinedUncertainty:
    """What all components add, in the unit of the value."""

    dof: float | None  # 1, effective degrees of freedom; None: infinite
    low: float  # combined lower 95 % limit
    high: float  # combined upper 95 % limit


# ---------------------------------------------------------------- components


def of_limits(value: float, low: float, high: float) -> StandardUncertainty:
    """Return the uncertainty that 95 % limits of statistics stand for."""
    logarithmic = _are_logarithmic(value, low, high)
    spread = value * math.log(high / low) if logarithmic else high - low
    return StandardUncertainty(spread / (2.0 * LIMIT_95))


def of_scatter(value: float, excess: float, statistics: float) -> StandardUncertainty:
    """Return how much the mean of the quarters is uncertain by what they scatter beyond statistics.

    Parameters
    ----------
    excess : 1, standard deviation of the logarithm between the quarters, without that of their statistics.
    statistics : in the unit of the value, standard uncertainty of the value by statistics.
    """
    standard = value * excess / math.sqrt(QUARTERS)
    # The excess is what remains of a variance of four values when that of statistics is subtracted. With these
    # degrees of freedom, the formula of Welch and Satterthwaite gives 3 for both together.
    dof = (QUARTERS - 1) * (standard**2 / (standard**2 + statistics**2)) ** 2
    return StandardUncertainty(standard, dof)


def of_days(days: int, std: float, statistics: float, scatter: float) -> StandardUncertainty:
    """Return how much a coefficient scatters between days, beyond their statistics and the scatter of this record.

    Parameters
    ----------
    std : in the unit of the value, standard deviation between the days.
    statistics : in the unit of the value, root mean square of the standard errors of the days.
    scatter : in the unit of the value, standard uncertainty of this record by its scatter.
    """
    # Days that agree better than their statistics show no excess: chance may make the difference negative.
    excess = math.sqrt(max(0.0, std**2 - statistics**2 - scatter**2))
    return StandardUncertainty(excess, days - 1.0)


def of_resolution(
    white: float, step: float, std: float | None, rate_hz: float | None
) -> StandardUncertainty | None:
    """Return what rounding to steps may have added to N; None if the noise is finer than they are, or the rate unknown.

    Parameters
    ----------
    white : N.
    step : channel unit, of the values.
    std : channel unit, standard deviation of the values; None: unknown.
    """
    # Below this, errors of rounding follow the signal and are neither white nor q^2 / 12.
    if not rate_hz or std is None or std < DITHERED * step:
        return None
    rounding = ROUNDING_VARIANCE * step**2 / rate_hz
    return StandardUncertainty((math.sqrt(white**2 + rounding) - white) / math.sqrt(12.0))


def of_time_base(value: float, letter: str, tolerance: float, *, averaged: bool) -> StandardUncertainty:
    """Return what a clock that is wrong by at most a share, `tolerance`, adds to a coefficient.

    Parameters
    ----------
    averaged : values are deltas that were divided by the interval.
    """
    # N = sigma sqrt(tau), K = sigma sqrt(3 / tau): a coefficient depends on tau with the negative slope of sigma
    exponent = -COEFFICIENTS[letter].slope - (1.0 if averaged else 0.0)
    if letter == MARKOV.time_constant_s:  # a time, whatever the values are
        exponent = 1.0
    return StandardUncertainty(abs(exponent) * tolerance * value / math.sqrt(3.0))


# ---------------------------------------------------------------- combination


def combine(
    value: float, low: float, high: float, components: Sequence[StandardUncertainty]
) -> CombinedUncertainty:
    """Return the uncertainty by all components, with the skewed limits of a coefficient.

    Parameters
    ----------
    low, high : 95 % limits of statistics.
    components : the first is that of these limits.
    """
    # A component of 0 says that there is no such error, and its degrees of freedom say nothing.
    known = [(part.standard, part.dof) for part in components if part.standard]
    combined = math.sqrt(sum(u * u for u, _ in known))
    spread = sum(u**4 / dof for u, dof in known if dof is not None)
    dof = combined**4 / spread if spread > 0.0 else None
    coverage = _coverage(dof)
    if not _are_logarithmic(value, low, high):
        # no coefficient is below 0
        return CombinedUncertainty(dof, max(0.0, value - coverage * combined), value + coverage * combined)
    others = math.sqrt(max(0.0, combined**2 - components[0].standard ** 2)) / value

    def half_width(limit: float) -> float:
        """Return the half-width of the logarithm on the side of a limit of statistics."""
        return coverage * math.hypot(math.log(limit / value) / LIMIT_95, others)

    return CombinedUncertainty(dof, value * math.exp(-half_width(low)), value * math.exp(half_width(high)))


@dataclass(frozen=True, slots=True)
class RecordMean:
    """Mean of a coefficient over several records of one sensor, in the unit of the coefficient."""

    value: float
    low: float  # lower 95 % limit of the statistics of the records alone
    high: float  # upper 95 % limit of these
    combined_low: float  # lower 95 % limit of the mean over all records that there could be
    combined_high: float  # upper 95 % limit of it
    scatter: float  # 1, standard deviation of the logarithm between records, beyond their statistics
    dof: float  # 1, degrees of freedom of the combined limits


def of_records(values: Sequence[float], errors: Sequence[float], systematic: float = 0.0) -> RecordMean:
    """Return the mean of a coefficient over records, with the scatter between them in its limits.

    The logarithm of each record is that of the mean, plus what the sensor varies from record to record (variance
    t^2), plus the error of its statistics. t^2 is that with which the weighted residuals have their degrees of freedom
    (Paule and Mandel, J. Res. NBS 87, 377, 1982). The limits come from the residuals with Student's t of k - 1 degrees
    of freedom (Hartung and Knapp, Statistics in Medicine 20, 3875, 2001), as a type A evaluation by JCGM 100, 4.2 does.
    They are never narrower than those of the statistics alone, which two records that agree by chance would undercut.

    Parameters
    ----------
    values : (k,) of the records, above 0; at least two.
    errors : (k,) 1, standard errors of their logarithms by statistics, above 0.
    systematic : 1, standard uncertainty that all records share, a share of the value.

    Examples
    --------
    >>> mean = of_records([1.0, 1.1, 0.9, 1.0], [0.02] * 4)
    >>> [round(number, 2) for number in (mean.value, mean.scatter, mean.low, mean.high)]
    [1.0, 0.08, 0.98, 1.02]
    >>> [round(number, 2) for number in (mean.combined_low, mean.combined_high)]
    [0.88, 1.14]
    """
    logs, variances = np.log(values), np.square(errors)
    freedom = logs.size - 1
    between = variance_between(logs, variances, freedom)
    weights = 1.0 / (variances + between)
    mean = float(weights @ logs / weights.sum())
    residual = weighted_squares(logs, variances + between)
    statistics = LIMIT_95 / math.sqrt(float((1.0 / variances).sum()))
    empirical = _coverage(freedom) * math.sqrt(residual / (freedom * float(weights.sum())))
    whole = math.hypot(max(statistics, empirical), LIMIT_95 * systematic)
    return RecordMean(
        value=math.exp(mean),
        low=math.exp(mean - statistics),
        high=math.exp(mean + statistics),
        combined_low=math.exp(mean - whole),
        combined_high=math.exp(mean + whole),
        scatter=math.sqrt(between),
        dof=float(freedom),
    )


def weighted_squares(logs: Floats, variances: Floats) -> float:
    """Return the sum of the squared distances of values (k,) from their weighted mean, over their variances."""
    weights = 1.0 / variances
    return float(weights @ (logs - weights @ logs / weights.sum()) ** 2)


def variance_between(logs: Floats, variances: Floats, target: float) -> float:
    """Return the variance between values (k,) with which their weighted squares sum to a target, or 0.0.

    With a target of k - 1 degrees of freedom it is the estimate of Paule and Mandel (J. Res. NBS 87, 377, 1982).
    """
    if weighted_squares(logs, variances) <= target:
        return 0.0
    # with equal variances of zero the sum would be the upper end; variances only lower it
    low, high = 0.0, float(np.sum((logs - logs.mean()) ** 2)) / target
    while low < (middle := 0.5 * (low + high)) < high:  # until no float lies between
        low, high = (middle, high) if weighted_squares(logs, variances + middle) > target else (low, middle)
    return high


def _are_logarithmic(value: float, low: float, high: float) -> bool:
    """Return whether limits can be those of a logarithm: a lower limit of 0 has none."""
    return 0.0 < low < value < high


def _coverage(dof: float | None) -> float:
    """Return the coverage factor for 95 %."""
    return LIMIT_95 if dof is None else float(stdtrit(_whole(dof), 0.975))


def _whole(dof: float) -> float:
    """Return degrees of freedom truncated to the next lower integer, at least 1 (JCGM 100, G.4.2)."""
    return max(1.0, math.floor(dof * (1.0 + 1e-9)))  # 1e-9: the 3 of `of_scatter` may be 2.9999999999999996
