"""Measurements of the emulated device: every quantity of every message, as the registers configure them.

The signals of the sensor elements pass the user calibrations (registers 23, 25, 84), the rotation of the
reference frame (26), the filter (85), the onboard estimate of the gyroscope bias, and the configuration of
the increments (82). Uncompensated quantities have passed calibration and filter; from compensated ones the
estimated bias is also subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.devices.vn100.emulator.sensor_model import (
    ACCEL,
    CONSTANT,
    GYRO,
    MAG,
    PRESSURE,
    TEMPERATURE,
    SensorModel,
)
from imumon.devices.vn100.registers import LOOP_RATE, REGISTERS, RegisterNumber
from imumon.samples import Floats, Ints

STEP = 80
"""Ticks between two steps of the attitude estimator: 0.1 s."""

_BIAS_STEPS = 600
"""Steps over which the bias is averaged after the start: one minute."""

_CORRECTION = 0.02
"""Share of the attitude error that gravity and the magnetic field correct in one step: 5 s."""

_HARD_IRON = np.array([0.012, -0.008, 0.015])
"""gauss, offset that the onboard hard iron estimate subtracts from the compensated magnetic field."""

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
_FIXED = {"yprU": (1.2, 0.3, 0.3), "attU": (0.02,), "heave": (0.0, 0.0, 0.0)}
_GRAVITY = CONSTANT[ACCEL] * [0.0, 0.0, 1.0]


@dataclass(frozen=True, slots=True)
class OutputConfiguration:
    """Registers that change the data.

    Attributes
    ----------
    windows, modes : of register 85, by sensor.
    calibration : (3, 3) and (3,) of registers 84, 25, 23 by sensor; out = C (in - B).
    rotation : (3, 3) of register 26, as it was at the start of the sensor.
    delta : frame, gyroscope and accelerometer compensation of register 82.
    hard_iron : whether the hard iron estimate is applied.
    """

    windows: Mapping[str, int]
    modes: Mapping[str, int]
    calibration: Mapping[str, tuple[Floats, Floats]]
    rotation: Floats
    delta: tuple[int, int, int]
    hard_iron: bool

    @staticmethod
    def of(read: Callable[[int], tuple[str, ...]], rotation: Floats, hard_iron: bool) -> OutputConfiguration:
        """Return the configuration of the fields of the registers."""
        filters = REGISTERS[RegisterNumber.IMU_FILTER].parse(read(RegisterNumber.IMU_FILTER))

        def calibration(number: int) -> tuple[Floats, Floats]:
            values = np.array(read(number), float)
            return rotation @ values[:9].reshape(3, 3), values[9:]

        numbers = {
            "gyro": RegisterNumber.GYRO_CALIBRATION,
            "accel": RegisterNumber.ACCEL_CALIBRATION,
            "mag": RegisterNumber.MAG_CALIBRATION,
        }
        frame, gyro, accel = (int(text) for text in read(RegisterNumber.DELTA_CONTROL)[:3])
        return OutputConfiguration(
            windows={sensor: int(filters[f"{sensor}_window"]) for sensor in _COLUMNS},
            modes={sensor: int(filters[f"{sensor}_mode"]) for sensor in _COLUMNS},
            calibration={sensor: calibration(number) for sensor, number in numbers.items()},
            rotation=rotation,
            delta=(frame, gyro, accel),
            hard_iron=hard_iron,
        )

    def window(self, sensor: str, compensated: bool) -> int:
        """Return the ticks averaged in an output; bit 0 of the mode: uncompensated, bit 1: compensated."""
        return self.windows[sensor] if self.modes[sensor] >> compensated & 1 else 0


class AttitudeEstimator:
    """Onboard filter: estimates the gyroscope bias and the attitude ten times a second.

    The bias is the mean rate since the start, later over the last minute: slow compared with the noise, fast
    compared with an hour, so B and K of a compensated rate are those of the filter, not of the gyroscope. The
    attitude is the integral of the compensated rate, corrected to level and heading within seconds.

    Parameters
    ----------
    bias : (3,) rad/s, initial estimate.
    tick : of the start.

    Attributes
    ----------
    bias : (n, 3) rad/s, estimates at the latest steps.
    heading : deg.
    """

    def __init__(self, bias: Floats, tick: int) -> None:
        self._first = tick // STEP
        self._count = 1
        self.bias = bias.reshape(1, 3).copy()
        self._angle = np.zeros((1, 3))
        self.heading = 35.0  # any direction

    def update(self, sensor_model: SensorModel, upto: int) -> None:
        """Estimate up to tick `upto`; keep the steps since the last two calls."""
        steps = np.arange(self._first + len(self.bias) - 1, upto // STEP + 1)
        # the newest two: the attitude of the next ticks is interpolated from the step before
        keep = max(0, len(self.bias) - 2)
        self._first += keep
        bias, angle = [*self.bias[keep:]], [*self._angle[keep:]]
        if len(steps) > 1:
            rates = np.diff(sensor_model.integral(steps * STEP, GYRO), axis=0) * (LOOP_RATE / STEP)
            for rate in rates:
                gain = 1.0 / min(self._count, _BIAS_STEPS)
                self._count += 1
                bias.append(bias[-1] + gain * (rate - bias[-1]))
                rotated = angle[-1] + np.degrees(rate - bias[-1]) * (STEP / LOOP_RATE)
                angle.append(rotated * (1.0 - _CORRECTION))
        self.bias, self._angle = np.array(bias), np.array(angle)

    def reset_bias(self) -> None:
        """Restart the average of the bias."""
        self._count = 1

    def bias_at(self, ticks: Ints) -> Floats:
        """Return the estimated bias at each of `ticks`, (n, 3) rad/s."""
        return np.asarray(self.bias[np.clip(ticks // STEP - self._first, 0, len(self.bias) - 1)])

    def attitude(self, ticks: Ints) -> Floats:
        """Return yaw, pitch and roll, (n, 3) deg, interpolated between two steps."""
        last = np.clip(ticks // STEP - self._first, 0, len(self._angle) - 1)
        before = np.maximum(last - 1, 0)
        share = (ticks % STEP / STEP)[:, None]
        roll_pitch_yaw = self._angle[before] * (1.0 - share) + self._angle[last] * share
        return np.asarray(roll_pitch_yaw[:, ::-1] + np.array([self.heading, 0.0, 0.0]))


class MeasurementOutput:
    """Measured quantities at some ticks, each computed on first use.

    A quantity is (n, k), one row per tick, in the units of the wire: deg, gauss, m/s^2, rad/s, degC, kPa;
    dt in s, dtheta in deg, dvel in m/s.

    Parameters
    ----------
    sensor_model : signals of the sensor elements.
    configuration : registers that change the data.
    estimator : onboard filter.
    ticks : (n,) at which the quantities are measured.
    increments : (n, 7) s and unit * s, time and integrals of gyroscope and accelerometer since the last reset
        of the increments before each tick; None for measurements without increments.
    counts : counters and status fields, by name.
    """

    def __init__(
        self,
        sensor_model: SensorModel,
        configuration: OutputConfiguration,
        estimator: AttitudeEstimator,
        ticks: Ints,
        increments: Floats | None,
        counts: Mapping[str, Floats | Ints],
    ) -> None:
        self._model, self._configuration, self._estimator = sensor_model, configuration, estimator
        self._ticks, self._increments = ticks, increments
        self._values: dict[str, npt.NDArray[Any]] = dict(counts)

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        """Return a quantity or binary field by name; fields that a VN-100 does not measure are zero."""
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
        """Return a quantity that is a reading of a sensor, after filter, calibration and compensation."""
        configuration = self._configuration
        raw = self._model.mean(self._ticks, _COLUMNS[sensor], configuration.window(sensor, compensated))
        if sensor not in configuration.calibration:
            return raw
        matrix, bias = configuration.calibration[sensor]
        if (
            sensor == "gyro" and compensated
        ):  # it is estimated from the raw rate: the user's bias is part of it
            bias = self._estimator.bias_at(self._ticks)
        hard_iron = _HARD_IRON if sensor == "mag" and compensated and configuration.hard_iron else 0.0
        return np.asarray((raw - bias) @ matrix.T - hard_iron)

    def _to_body(self) -> Floats:
        """Return the rotation from the north-east-down frame to the body frame, (n, 3, 3)."""
        angles = np.radians(self["ypr"]).T
        (cy, cp, cr), (sy, sp, sr) = np.cos(angles), np.sin(angles)
        rows = (
            (cp * cy, cp * sy, -sp),
            (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp),
            (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp),
        )
        return np.array(rows).transpose(2, 0, 1)

    def _quaternion(self) -> Floats:
        """Return the attitude quaternion, (n, 4): vector part first, scalar last."""
        angles = np.radians(self["ypr"]).T / 2.0
        (cy, cp, cr), (sy, sp, sr) = np.cos(angles), np.sin(angles)
        parts = (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )
        return np.stack(parts, axis=1)

    def _ned(self, body: Floats) -> Floats:
        return np.asarray(np.einsum("nji,nj->ni", self._to_body(), body))

    def _body(self, ned: Floats) -> Floats:
        return np.asarray(np.einsum("nij,nj->ni", self._to_body(), ned))

    def _delta(self, column: int, sensor: str) -> Floats:
        """Return increments in the units of the sensor, (n, 3) unit * s, of three columns from `column`."""
        assert self._increments is not None
        matrix, bias = self._configuration.calibration[sensor]
        frame, gyro_compensation, accel_compensation = self._configuration.delta
        dt = self["dt"]
        if sensor == "gyro" and gyro_compensation:
            bias = self._estimator.bias_at(self._ticks)
        body = (self._increments[:, column : column + 3] - bias * dt) @ matrix.T
        if sensor == "accel" and accel_compensation:
            body = body - self._body(np.broadcast_to(_GRAVITY, body.shape)) * dt
        return self._ned(body) if frame else np.asarray(body)

    def _dt(self) -> Floats:
        assert self._increments is not None
        return self._increments[:, :1]


_DERIVED: dict[str, Callable[[MeasurementOutput], Floats]] = {
    "ypr": lambda self: self._estimator.attitude(self._ticks),
    "quat": MeasurementOutput._quaternion,
    "dcm": lambda self: self._to_body().transpose(0, 2, 1).reshape(-1, 9),  # column by column
    "magNed": lambda self: self._ned(self["mag"]),
    "accelNed": lambda self: self._ned(self["accel"]),
    "linAccelNed": lambda self: np.asarray(self["accelNed"] - _GRAVITY),
    "linAccelBody": lambda self: self._body(self["linAccelNed"]),
    "dt": MeasurementOutput._dt,
    "dtheta": lambda self: np.degrees(self._delta(1, "gyro")),
    "dvel": lambda self: self._delta(4, "accel"),
}
"""Function of each quantity that is computed from others."""
