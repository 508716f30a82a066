"""Parameters for filters as a message: the data model of ``imumon report --format filter``.

A Kalman filter with the states angle and bias takes two numbers from a noise record: the white noise of the
rate and the random walk of its bias. `noise.filter_parameters` chooses them so that the filter is consistent
for a horizon, and this module holds the result. JSON is made by `report.to_json`, and the schema is
docs/filter.schema.json. Rules are those of the report: SI units, an unknown value is None, never 0, never NaN.

The reference scenario of every prediction: a Kalman filter with the states angle (of an accelerometer:
velocity), bias and Gauss-Markov terms integrates the channel at 5 Hz. It gets an angle fix of 1 mrad (a velocity
fix of 10 mm/s) once a second for 900 s, and none for the horizon h after that. NEES(h) is the mean of the squared
error of the angle over the variance that the filter states. 1 is consistent, above 1 is overconfident.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from imumon.report import DeviceDescription
from imumon.units import DAY

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


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussMarkovTerm:
    """A first-order Gauss-Markov process: covariance sigma^2 exp(-t / tau)."""

    sigma: float  # channel unit, standard deviation
    tau_s: float  # s, correlation time


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
    gauss_markov: tuple[GaussMarkovTerm, ...]  # at most five, fastest first
    nees: FilterCurves  # 1, predicted normalised estimation error squared
    std: FilterCurves  # rad or m/s, standard deviation of the error that each filter states
    caveats: tuple[str, ...] = ()  # those of the channel; also "bounded_N", "bounded_B", "bounded_K"


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterReport:
    """Parameters for filters of all gyroscope and accelerometer channels whose noise is known."""

    schema: str = FILTER_SCHEMA  # imumon.filter/1
    time: str  # ISO 8601 in UTC, of the report that they come from
    device: DeviceDescription  # device that the numbers describe
    horizon_s: float = DEFAULT_HORIZON_S  # s, longest time without a fix that the numbers hold for
    elapsed_s: float = 0.0  # s, length of the record that they rest on
    words: str = FIX_WORDS  # meaning of a fix and of NEES
    channels: Mapping[str, FilterChannel] = field(default_factory=dict)  # gyro/x ... accel/z
