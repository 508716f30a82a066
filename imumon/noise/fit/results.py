"""Fit of a channel in SI units, and the classical slope readings of its curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from imumon.coefficients import SIGNIFICANT
from imumon.report import COEFFICIENTS, NOISE, Change, Estimate, ModelColumn
from imumon.samples import Bools, Floats

SLOPE_TOLERANCE = 0.2
"""1, difference from the nominal slope of log sigma over log tau up to which a slope is read."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelFit:
    """Fit of one channel.

    Attributes
    ----------
    coefficients : by letter: N, B and K always; others where the data show them. In SI, without a unit.
    chi2, dof, p_value : of the misfit; None while there is nothing to test.
    model : (k,) channel unit, Allan deviation of everything that the fit states; 0.0 where there is no fit.
    noise : (k,) channel unit, Allan deviation of N, B and K alone.
    used : (k,) octaves in the range of frequencies that the fit uses.
    low, high : (k,) channel unit, 95 % limits of the Allan deviation; 0.0 where there is no difference.
    edf : (k,) 1, equivalent degrees of freedom; 0.0 where there is no difference.
    time_to : s by letter, still to record until a coefficient is as precise as requested; None: unknown.
    readings : classical slope readings by letter; None: the curve has none.
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

    coefficients: Mapping[str, Estimate]
    chi2: float | None = None
    dof: int | None = None
    p_value: float | None = None
    model: Floats
    noise: Floats
    used: Bools
    low: Floats
    high: Floats
    edf: Floats
    time_to: Mapping[str, float | None] = field(default_factory=lambda: dict.fromkeys(NOISE))
    readings: Mapping[str, float | None] = field(default_factory=lambda: dict.fromkeys(NOISE))
    caveats: tuple[str, ...] = ()
    columns: tuple[ModelColumn, ...] = ()
    no_slope: str = "no_temperature"
    explained: float | None = None
    step: Change | None = None
    lines_hz: tuple[float, ...] = ()
    oscillations_s: tuple[float, ...] = ()
    highest_hz: float | None = None

    @property
    def N(self) -> Estimate:
        """White noise, channel unit times sqrt(s)."""
        return self.coefficients["N"]

    @property
    def B(self) -> Estimate:
        """Flicker, channel unit."""
        return self.coefficients["B"]

    @property
    def K(self) -> Estimate:
        """Random walk, channel unit over sqrt(s)."""
        return self.coefficients["K"]

    @property
    def follows_temperature(self) -> bool:
        """Whether the mean follows the temperature significantly."""
        slope = self.column("temperature")
        return slope is not None and slope.sigma > SIGNIFICANT

    def column(self, name: str) -> ModelColumn | None:
        """Return the last regressor of a name; None if it is not in use."""
        return next((each for each in reversed(self.columns) if each.name == name), None)


def pending_fit(octaves: int, reason: str, reason_code: str | None = None) -> ChannelFit:
    """Return the fit of a channel with too little data."""
    pending = dict.fromkeys(NOISE, Estimate(reason=reason, reason_code=reason_code))
    zeros = np.zeros(octaves)
    return ChannelFit(
        coefficients=pending, model=zeros, noise=zeros, used=zeros > 0.0, low=zeros, high=zeros, edf=zeros
    )


def read_slopes(tau: Floats, sigma: Floats) -> dict[str, float | None]:
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
    >>> print(f"{readings['N']:.4f} {readings['B']:.4f} {readings['K']:.2e}")
    0.0100 0.0034 1.04e-04
    """
    readings: dict[str, float | None] = dict.fromkeys(NOISE)
    slope = np.diff(np.log(sigma)) / np.diff(np.log(tau))
    for letter in NOISE if slope.size > 1 else ():
        row = COEFFICIENTS[letter]
        at = int(np.argmin(np.abs(slope - row.slope)))
        if abs(slope[at] - row.slope) <= SLOPE_TOLERANCE:
            readings[letter] = float(sigma[at]) / row.deviation(float(tau[at]))
    return readings
