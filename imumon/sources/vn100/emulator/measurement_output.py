"""Measurements of the emulated device: every quantity of every message.

The signals of the sensor elements pass the filter of register 85 and the onboard estimate of the gyroscope bias.
Uncompensated quantities have passed the filter; from compensated ones the estimated bias is also subtracted. The
sensor lies level and at rest, so its attitude does not change. User calibrations, the rotation of the reference frame
and the configuration of the increments (registers 21 to 26, 44, 82 and 84) are stored and change nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import cos, radians, sin
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.model.samples import Floats, Ints
from imumon.sources.vn100.emulator.sensor_model import (
    ACCEL,
    CONSTANT,
    GYRO,
    MAG,
    PRESSURE,
    TEMPERATURE,
    SensorModel,
)
from imumon.sources.vn100.registers import FILTERED, LOOP_RATE

STEP = 80
"""Ticks between two steps of the bias estimator: 0.1 s."""

_BIAS_STEPS = 600
"""Steps over which the bias is averaged after the start: one minute."""

_COMPOSED = {
    "angularRate": ("gyro",), "imu": ("uaccel", "ugyro"), "magPres": ("mag", "temp", "pres"),
    "deltas": ("dt", "dtheta", "dvel"), "deltaTheta": ("dt", "dtheta"), "deltaVel": ("dvel",),
    "uncompMag": ("umag",), "uncompAccel": ("uaccel",), "uncompGyro": ("ugyro",),
}  # fmt: skip
"""Fields of the binary outputs that consist of other quantities, side by side."""

_READINGS = {
    "gyro": ("gyro", True), "ugyro": ("gyro", False), "accel": ("accel", True), "uaccel": ("accel", False),
    "mag": ("mag", True), "umag": ("mag", False), "temp": ("temperature", True), "pres": ("pressure", True),
}  # fmt: skip
"""Sensor of a quantity, and whether the quantity is compensated."""

_COLUMNS = {"gyro": GYRO, "accel": ACCEL, "mag": MAG, "temperature": TEMPERATURE, "pressure": PRESSURE}
_GRAVITY = CONSTANT[ACCEL] * [0.0, 0.0, 1.0]

_YAW = 35.0
"""deg, any direction."""
_TO_BODY = np.array(
    [
        [cos(radians(_YAW)), sin(radians(_YAW)), 0.0],
        [-sin(radians(_YAW)), cos(radians(_YAW)), 0.0],
        [0.0, 0.0, 1.0],
    ]
)
"""(3, 3) rotation from the north-east-down frame to the body frame."""
_FIXED = {
    "ypr": (_YAW, 0.0, 0.0),
    "quat": (0.0, 0.0, sin(radians(_YAW / 2.0)), cos(radians(_YAW / 2.0))),  # vector part first, scalar last
    "dcm": tuple(_TO_BODY.T.ravel().tolist()),  # column by column
    "heave": (0.0, 0.0, 0.0),
}
"""Quantities that do not change."""


@dataclass(frozen=True, slots=True)
class FilterWindows:
    """Moving averages of register 85.

    Attributes
    ----------
    windows : ticks, by sensor.
    modes : by sensor; bit 0: the uncompensated output is filtered, bit 1: the compensated one.
    """

    windows: Mapping[str, int]
    modes: Mapping[str, int]

    @staticmethod
    def of(register: Sequence[int]) -> FilterWindows:
        """Return the windows of the values of the register: those of each sensor, then their modes."""
        return FilterWindows(
            windows=dict(zip(FILTERED, register[:5], strict=True)),
            modes=dict(zip(FILTERED, register[5:], strict=True)),
        )

    def window(self, sensor: str, compensated: bool) -> int:
        """Return the ticks averaged in an output."""
        return self.windows[sensor] if self.modes[sensor] >> compensated & 1 else 0


class BiasEstimator:
    """Onboard filter: estimates the gyroscope bias ten times a second.

    The bias is the mean rate since the start, later over the last minute: slow compared with the noise, fast
    compared with an hour, so B and K of a compensated rate are those of the filter, not of the gyroscope.

    Parameters
    ----------
    tick : of the start.
    """

    def __init__(self, tick: int) -> None:
        self._first = tick // STEP
        self._count = 1
        self._bias = np.zeros((1, 3))  # rad/s, at the latest steps

    def update(self, sensor_model: SensorModel, upto: int) -> None:
        """Estimate up to tick `upto`; keep the steps since the last call."""
        steps = np.arange(self._first + len(self._bias) - 1, upto // STEP + 1)
        bias = [self._bias[-1]]
        if len(steps) > 1:
            rates = np.diff(sensor_model.integral(steps * STEP, GYRO), axis=0) * (LOOP_RATE / STEP)
            for rate in rates:
                bias.append(bias[-1] + (rate - bias[-1]) / min(self._count, _BIAS_STEPS))
                self._count += 1
        self._first += len(self._bias) - 1
        self._bias = np.array(bias)

    def bias_at(self, ticks: Ints) -> Floats:
        """Return the estimated bias at each of `ticks`, (n, 3) rad/s."""
        return np.asarray(self._bias[np.clip(ticks // STEP - self._first, 0, len(self._bias) - 1)])


class MeasurementOutput:
    """Measured quantities at some ticks, each computed on first use.

    A quantity is (n, k), one row per tick, in the units of the wire: deg, gauss, m/s^2, rad/s, degC, kPa;
    dt in s, dtheta in deg, dvel in m/s.

    Parameters
    ----------
    sensor_model : signals of the sensor elements.
    windows : moving averages.
    estimator : onboard filter.
    ticks : (n,) at which the quantities are measured.
    increments : (n, 7) s and unit * s, time and integrals of gyroscope and accelerometer since the last reset
        of the increments before each tick; None for measurements without increments.
    time_ns : (n,) ns, time stamps.
    """

    def __init__(
        self,
        sensor_model: SensorModel,
        windows: FilterWindows,
        estimator: BiasEstimator,
        ticks: Ints,
        increments: Floats | None,
        time_ns: Ints,
    ) -> None:
        self._model, self._windows, self._estimator = sensor_model, windows, estimator
        self._ticks = ticks
        self._values: dict[str, npt.NDArray[Any]] = {"timeStartup": time_ns[:, None]}
        if increments is not None:
            self._values["dt"] = increments[:, :1]
            self._values["dtheta"] = np.degrees(increments[:, 1:4])
            self._values["dvel"] = increments[:, 4:]

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        """Return a quantity or binary field by name; those that the emulator does not measure are zero."""
        if name not in self._values:
            self._values[name] = self._compute(name)
        return self._values[name]

    def has(self, name: str) -> bool:
        return any(name in names for names in (self._values, _COMPOSED, _READINGS, _FIXED, _DERIVED))

    def _compute(self, name: str) -> npt.NDArray[Any]:
        if name in _COMPOSED:
            return np.concatenate([self[part] for part in _COMPOSED[name]], axis=1)
        if name in _READINGS:
            return self._reading(*_READINGS[name])
        if name in _DERIVED:
            return _DERIVED[name](self)
        return np.tile(_FIXED.get(name, (0.0,)), (len(self._ticks), 1))

    def _reading(self, sensor: str, compensated: bool) -> Floats:
        """Return a quantity that is a reading of a sensor, after the filter and the compensation."""
        mean = self._model.mean(self._ticks, _COLUMNS[sensor], self._windows.window(sensor, compensated))
        return mean - self._estimator.bias_at(self._ticks) if sensor == "gyro" and compensated else mean


_DERIVED: dict[str, Callable[[MeasurementOutput], Floats]] = {
    "magNed": lambda output: np.asarray(output["mag"] @ _TO_BODY),
    "accelNed": lambda output: np.asarray(output["accel"] @ _TO_BODY),
    "linAccelNed": lambda output: np.asarray(output["accelNed"] - _GRAVITY),
    "linAccelBody": lambda output: np.asarray(output["accel"] - _GRAVITY),
}
"""Function of each quantity that is computed from others."""
