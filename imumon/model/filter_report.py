"""Parameters for filters as a message: the data model of ``imumon report --format filter``.

A Kalman filter with the states angle and bias takes two numbers from a noise record: the white noise of the
rate and the random walk of its bias. `noise.filter_parameters` chooses them so that the filter is consistent
for a horizon, and `pipeline.filter_report_builder` fills this message. `report_json.to_json` makes its JSON, and the
schema is docs/filter.schema.json. Rules are those of the report: SI units; an unknown value is None, never 0 or NaN.

The reference scenario of every prediction: a Kalman filter with the states angle (of an accelerometer:
velocity), bias and Gauss-Markov terms integrates the channel at 5 Hz. It gets an angle fix of 1 mrad (a velocity
fix of 10 mm/s) once a second for 900 s, and none for the horizon h after that. NEES(h) is the mean of the squared
error of the angle over the variance that the filter states. 1 is consistent, above 1 is overconfident.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from imumon.model.errors import ImumonError
from imumon.model.report import DeviceDescription
from imumon.model.samples import ChannelName
from imumon.model.units import DAY

FILTER_SCHEMA = "imumon.filter/1"
FIX_WORDS = (
    "A fix is a measurement of the angle or the velocity from another source. NEES (normalised estimation error "
    "squared) is the mean squared error over the variance that the filter states: 1 is consistent, above 1 is "
    "overconfident."
)
"""Meaning of the words in numbers for filters, in each file that has them."""
DEFAULT_HORIZON_S = 600.0  # s, horizon of every format without --horizon
SHORTEST_HORIZON_S = 1.0  # s, one interval between two fixes of the reference scenario
LONGEST_HORIZON_S = DAY  # s, without any fix


@dataclass(frozen=True, slots=True, kw_only=True)
class AssumedNoise:
    """The truth that the numbers are made for: the measured value, or half the bound where only bounded."""

    N: float  # channel unit/sqrt(Hz), white noise
    B: float  # channel unit, flicker
    K: float  # channel unit*sqrt(Hz), random walk
    M: float | None = None  # channel unit, standard deviation of correlated noise; null: there is none
    T: float | None = None  # s, its time constant; null: there is none


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussMarkovTerm:
    """A first-order Gauss-Markov process: covariance sigma^2 exp(-t / tau)."""

    sigma: float  # channel unit, standard deviation
    tau_s: float  # s, correlation time


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkovTerm:
    """Correlated noise of the sensor, as a filter with one more state per axis takes it."""

    sigma: float  # channel unit, standard deviation
    time_constant_s: float  # s, correlation time
    drive: float  # channel unit*sqrt(Hz), density of the white noise that drives it: sigma sqrt(2 / time_constant_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterCurves:
    """One number per horizon for each of the three filters."""

    horizon_s: tuple[float, ...]  # s since the last fix
    white_walk: tuple[float, ...]  # filter with `white` and `walk`
    gauss_markov: tuple[float, ...]  # filter with `white_gm`, `walk_gm` and `gauss_markov`
    n_and_k: tuple[float, ...]  # filter with N and K of `assumed` alone


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterChannel:
    """Parameters for one channel, and what they achieve."""

    unit: str  # channel unit: rad/s or m/s^2
    assumed: AssumedNoise  # truth that the numbers are made for
    white: float  # channel unit/sqrt(Hz), white noise for use with `walk`
    walk: float  # channel unit*sqrt(Hz), random walk of the bias: the smallest that is consistent
    walk_factor: float | None  # `walk` over the measured K; null where K is only bounded
    white_gm: float  # channel unit/sqrt(Hz), white noise for use with `gauss_markov`
    walk_gm: float  # channel unit*sqrt(Hz), random walk for use with `gauss_markov`
    gauss_markov: tuple[GaussMarkovTerm, ...]  # at most five for flicker and that of `markov`, fastest first
    markov: MarkovTerm | None = None  # correlated noise M, one of `gauss_markov`; null: none
    nees: FilterCurves  # 1, predicted normalised estimation error squared
    std: FilterCurves  # rad or m/s, standard deviation of the error that each filter states
    # those of the channel; also "bounded_N" and so on of B, K, M; "inconsistent_terms": NEES out of 0.8 to 1.25
    caveats: tuple[str, ...] = ()

    def Q(self, dt_s: float) -> Any:
        """Return the covariance of the process noise of a step, for the state (angle or velocity, bias).

        The rate is that of the sensor less the bias, and white noise drives both: x' = [[0, -1], [0, 0]] x + noise.
        Over a step of dt, with N = `white` and W = `walk` (Van Loan, IEEE Trans. Autom. Control 23, 395, 1978),

            [[N^2 dt + W^2 dt^3 / 3, -W^2 dt^2 / 2], [-W^2 dt^2 / 2, W^2 dt]]

        Parameters
        ----------
        dt_s : s, length of the step.

        Returns
        -------
        (2, 2) array in units of the integrated channel and of the channel.
        """
        import numpy as np

        if not 0.0 < dt_s < math.inf:
            raise ImumonError(
                "step_length_invalid", f"dt_s={dt_s!r} is no length of a step", "give s, such as 0.005"
            )
        n, w = self.white**2, self.walk**2
        across = -w * dt_s**2 / 2.0
        return np.array([[n * dt_s + w * dt_s**3 / 3.0, across], [across, w * dt_s]])


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterReport:
    """Parameters for filters of all gyroscope and accelerometer channels whose noise is known."""

    schema: str = FILTER_SCHEMA  # imumon.filter/1
    time: str  # ISO 8601 in UTC, of the report that they come from
    device: DeviceDescription  # device that the numbers describe
    horizon_s: float = DEFAULT_HORIZON_S  # s, longest time without a fix that the numbers hold for
    elapsed_s: float = 0.0  # s, length of the record that they rest on
    words: str = FIX_WORDS  # meaning of a fix and of NEES
    channels: Mapping[ChannelName, FilterChannel] = field(default_factory=dict)  # gyro/x ... accel/z
