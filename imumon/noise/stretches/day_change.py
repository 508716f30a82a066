"""Change of N, B or the temperature slope over days, tested against the scatter in the sensor's own history.

The limits of a fit say how well a day determines N, if the sensor is constant. Real sensors scatter more from day to
day, and only that scatter says whether a difference is one. The test is a regression of the logarithms of the daily
values on a step, and on the temperature if it varied. Slopes have any sign: they count as they are, weighted by the
errors of the days. The standard error comes from the residuals; it is larger where neighbouring days resemble each
other, by the factor for means of a first-order autoregressive process, sqrt((1 + r) / (1 - r)) (Brockwell & Davis,
Introduction to Time Series and Forecasting, section 2.4). Every day may be
the day of the step: the probability is multiplied by their number (Bonferroni).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from imumon.samples import Floats

DAYS_BEFORE = 7
"""A day with fewer days before it is no step. Unit: days.

Otherwise: the scatter of the days is not known, and any difference may be a step. See `history_study.py`.
"""
ALARM = 1e-5
"""A step between days is reported that chance makes less often, over all days of a series. Unit: probability.

Otherwise: a sensor with nine channels has 18 series, each of which is tested every day. Origin: chosen; days that
resemble each other more than neighbours show make steps likelier: of 30 days of a random walk, 2.6 % give one
(`history_study.py`).
"""
LEAST_DAYS_SPAN_DEGC = 1.0
"""The temperature is a regressor of the days where their standard deviation is above it. Unit: degC.

Otherwise: a temperature that hardly varies gets a large slope, which takes the step. See `history_study.py`.
"""
STRONGEST = 0.9
"""Greatest correlation of neighbouring days that the standard error of a step counts with. Unit: correlation.

Otherwise: with a larger one, no step can be seen. Chosen: the standard error is then 4.4 times as large, sqrt((1 + r)
/ (1 - r)) (`history_study.py`).
"""
LEAST_SCATTER = 2e-3
"""Scatter of the days that is assumed at least. Unit: of the value.

Otherwise: days that agree by chance make any difference a step. Chosen: a shorter record than the variations of the
sensor would show less (`history_study.py`).
"""
LEAST_DOF = 8.0
"""Degrees that Student's t has at least where days are strongly correlated. Unit: degrees of freedom.

Otherwise: the quantile of few degrees is so large that no step can be seen. See `history_study.py`.
"""


@dataclass(frozen=True, slots=True)
class DayChange:
    """A step in a series of daily values.

    Attributes
    ----------
    day : number of the first value after the step.
    before, now : unit of the values, levels before and after it, at the same temperature.
    sigma : standard errors by which they differ.
    p_value : probability of such a step by chance, over all days.
    """

    day: int
    before: float
    now: float
    sigma: float
    p_value: float

    @property
    def ratio(self) -> float:
        """The level after the step over that before, of positive values."""
        return self.now / self.before


def find_day_change(
    values: Floats, temperatures: Floats, least: float, errors: Floats | None = None
) -> DayChange | None:
    """Return the most significant step in daily values; None if there is none.

    Parameters
    ----------
    values : (n,) one per day, oldest first; positive without errors.
    temperatures : (n,) degC, NaN where unknown.
    least : relative change below which a step does not matter.
    errors : (n,) unit of the values, standard errors of the days; None: logarithms are compared, days are alike.

    Examples
    --------
    >>> daily = 1.0 + 0.01 * np.random.default_rng(1).standard_normal(30)
    >>> find_day_change(daily, np.full(30, 25.0), 0.05) is None
    True
    >>> daily[25:] *= 1.12
    >>> change = find_day_change(daily, np.full(30, 25.0), 0.05)
    >>> change.day, round(change.ratio, 2), change.p_value < 1e-6
    (25, 1.12, True)
    """
    n = len(values)
    if n <= DAYS_BEFORE:  # too few to know the scatter: no day can be a step
        return None
    logs, weight = (
        (np.log(values), np.full(n, 1.0 / LEAST_SCATTER)) if errors is None else (values, 1.0 / errors)
    )
    base = [np.ones(n)]
    if np.isfinite(temperatures).all() and float(np.std(temperatures)) > LEAST_DAYS_SPAN_DEGC:
        base.append(temperatures - temperatures.mean())
    steps = (np.arange(n)[None, :] >= np.arange(DAYS_BEFORE, n)[:, None]).astype(np.float64)
    # Frisch-Waugh: the coefficient of the step from what the other regressors leave of it and of the values
    basis, _ = np.linalg.qr(weight[:, None] * np.stack(base, axis=1))
    y = weight * logs - basis @ (basis.T @ (weight * logs))
    left = weight * steps - (weight * steps @ basis) @ basis.T
    # a step that the other regressors explain wholly leaves rounding, over which any height would be significant
    power = np.maximum((left**2).sum(axis=1), 1e-9 * float(weight @ weight))
    heights = left @ y / power
    squares = np.maximum((y**2).sum() - heights**2 * power, 0.0)
    dof = max(n - len(base) - 1, 1)
    best = int(np.argmin(squares))
    residuals = y - heights[best] * left[best]
    r = _correlation(residuals)
    inflation = math.sqrt((1.0 + r) / (1.0 - r))
    # in units of the errors of the days: days that agree better than these do so by chance
    scatter = max(math.sqrt(float(squares[best]) / dof), 1.0)
    sigma = abs(float(heights[best])) / (scatter * inflation / math.sqrt(float(power[best])))
    effective = max(dof * (1.0 - r) / (1.0 + r), LEAST_DOF)
    p = min(1.0, 2.0 * float(stdtr(effective, -sigma)) * len(steps))
    if p > ALARM or abs(heights[best]) < math.log1p(least):
        return None
    columns = weight[:, None] * np.stack((*base, steps[best]), axis=1)
    before = float(np.linalg.lstsq(columns, weight * logs, rcond=None)[0][0])
    levels = (before, before + float(heights[best]))
    before, now = levels if errors is not None else map(math.exp, levels)
    return DayChange(DAYS_BEFORE + best, before, now, sigma, p)


def _correlation(residuals: Floats) -> float:
    """Return the correlation of neighbouring days, 0 to `STRONGEST`, corrected for its bias (Marriott & Pope 1954)."""
    n, square = len(residuals), float((residuals**2).sum())
    if square <= 0.0:
        return 0.0
    r = float((residuals[1:] * residuals[:-1]).sum()) / square
    return min(max(r + (1.0 + 4.0 * r) / n, 0.0), STRONGEST)
