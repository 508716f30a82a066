"""Fit of a channel in SI units, and the classical slope readings of its curve."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.report import Change, Readings, Status, TimeTo
from imumon.samples import Bools, Floats

SLOPE_TOLERANCE = 0.2
"""1, difference from the nominal slope of log sigma over log tau up to which a slope is read."""

SIGNIFICANT = 3.9
"""Standard errors from which a drift or a temperature slope is significant: 10^-4, because many channels are tested."""

LIMIT_95 = 1.96
"""Standard errors, half-width of a 95 % interval."""

_FLICKER_FACTOR = math.sqrt(2.0 * math.log(2.0) / math.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedCoefficient:
    """A coefficient in SI with its 95 % limits; `value` is None unless measured."""

    value: float | None = None
    low: float | None = None
    high: float | None = None
    status: Status = "pending"
    reason: str | None = None
    reason_code: str | None = None  # see `imumon.report.Coefficient`


@dataclass(frozen=True, slots=True)
class FittedColumn:
    """A regressor in use.

    Attributes
    ----------
    name : ``drift``, ``temperature``, ``settling`` or ``step``.
    value, error : channel unit per s, per degC, or channel unit; estimate and its standard error.
    at_s : s, time constant of the settling; place of the step since the beginning of the blocks; 0.0 of others.
    """

    name: str
    value: float
    error: float
    at_s: float = 0.0

    @property
    def sigma(self) -> float:
        """Standard errors by which it differs from zero."""
        return abs(self.value) / self.error if self.error > 0.0 else 0.0

    @property
    def significant(self) -> bool:
        """Whether it differs from zero beyond `SIGNIFICANT`."""
        return self.sigma > SIGNIFICANT


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelFit:
    """Fit of one channel.

    Attributes
    ----------
    N, B, K : channel unit times sqrt(s), 1, 1/sqrt(s).
    Q, R : channel unit times s, and per s; None unless the data show them.
    chi2, dof, p_value : of the misfit; None while there is nothing to test.
    model : (k,) channel unit, Allan deviation of everything that the fit states; 0.0 where there is no fit.
    noise : (k,) channel unit, Allan deviation of N, B and K alone.
    used : (k,) octaves in the range of frequencies that the fit uses.
    low, high : (k,) channel unit, 95 % limits of the Allan deviation; 0.0 where there is no difference.
    edf : (k,) 1, equivalent degrees of freedom; 0.0 where there is no difference.
    time_to : s, still to record until N, B and K are as precise as requested.
    readings : classical slope readings.
    caveats : ``misfit``, ``vibration`` (lines that bend the curve), ``correlated`` (a filter), ``quantised``, ``ramp``,
        ``oscillation``.
    columns : regressors in use.
    no_slope : why there is no temperature slope: "", ``no_temperature``, ``small_range`` or ``collinear``.
    explained : share of the variance of the means beyond white noise that follows the temperature; None: unknown.
    step : sudden change of the mean; None: there is none.
    lines_hz : Hz, lines of the spectrum that are no part of the noise.
    oscillations_s : s, periods of slow oscillations that are left out.
    highest_hz : Hz, highest frequency in use; None without a fit.
    """

    N: FittedCoefficient
    B: FittedCoefficient
    K: FittedCoefficient
    Q: FittedCoefficient | None = None
    R: FittedCoefficient | None = None
    chi2: float | None = None
    dof: int | None = None
    p_value: float | None = None
    model: Floats
    noise: Floats
    used: Bools
    low: Floats
    high: Floats
    edf: Floats
    time_to: TimeTo = field(default_factory=TimeTo)
    readings: Readings = field(default_factory=Readings)
    caveats: tuple[str, ...] = ()
    columns: tuple[FittedColumn, ...] = ()
    no_slope: str = "no_temperature"
    explained: float | None = None
    step: Change | None = None
    lines_hz: tuple[float, ...] = ()
    oscillations_s: tuple[float, ...] = ()
    highest_hz: float | None = None

    @property
    def follows_temperature(self) -> bool:
        """Whether the mean follows the temperature significantly."""
        slope = self.column("temperature")
        return slope is not None and slope.significant

    def column(self, name: str) -> FittedColumn | None:
        """Return the last regressor of a name; None if it is not in use."""
        return next((each for each in reversed(self.columns) if each.name == name), None)


def pending_fit(octaves: int, reason: str, reason_code: str | None = None) -> ChannelFit:
    """Return the fit of a channel with too little data."""
    c, zeros = FittedCoefficient(reason=reason, reason_code=reason_code), np.zeros(octaves)
    return ChannelFit(
        N=c, B=c, K=c, model=zeros, noise=zeros, used=zeros > 0.0, low=zeros, high=zeros, edf=zeros
    )


def read_slopes(tau: Floats, sigma: Floats) -> Readings:
    """Return N, B and K read off a curve in the classical way, for comparison with papers and other tools.

    N is the line of slope -1/2 read at 1 s, K the line of slope +1/2 read at 3 s, B the flat part divided by
    sqrt(2 ln 2 / pi) = 0.664 (IEEE Std 952 annex C; the same as in MATLAB's example). Each line goes through
    the octave whose slope to the next is nearest to the nominal one; None where no slope is within
    `SLOPE_TOLERANCE` of it.

    Parameters
    ----------
    tau : (k,) s
    sigma : (k,) channel unit, all positive.

    >>> tau = 2.0 ** np.arange(-5, 16)
    >>> readings = read_slopes(tau, np.sqrt(0.01**2 / tau + (0.664 * 3e-3) ** 2 + 1e-4**2 * tau / 3))
    >>> print(f"{readings.N:.4f} {readings.B:.4f} {readings.K:.2e}")
    0.0100 0.0034 1.04e-04
    """
    if sigma.size < 3:
        return Readings()
    x, y = np.log(tau), np.log(sigma)
    slope = np.diff(y) / np.diff(x)

    def line(nominal: float, at: float) -> float | None:
        nearest = int(np.argmin(np.abs(slope - nominal)))
        if abs(slope[nearest] - nominal) > SLOPE_TOLERANCE:
            return None
        return float(np.exp(y[nearest] + nominal * (math.log(at) - x[nearest])))

    floor = line(0.0, 1.0)
    return Readings(N=line(-0.5, 1.0), B=None if floor is None else floor / _FLICKER_FACTOR, K=line(0.5, 3.0))
