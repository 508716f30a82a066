"""Measurements of the emulated device: every quantity of every message, as the registers configure them.

The signals of the sensor elements pass the user calibrations (registers 23, 25, 84), the rotation of the
reference frame (26), the filter (85), the onboard estimate of the gyroscope bias, and the configuration of
the increments (82). Uncompensated quantities have passed calibration and filter; from compensated ones the
estimated bias is also subtracted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imumon.devices.vn100.emulator.sensor_model import (
    ACCEL,
    CONSTANT,
    GYRO,
    MAG,
    PRESSURE,
    TEMPERATURE,
    SensorModel,
)
from imumon.devices.vn100.registers import (
    ACCEL_CALIBRATION,
    DELTA_CONTROL,
    GYRO_CALIBRATION,
    IMU_FILTER,
    LOOP_RATE,
    MAG_CALIBRATION,
    REGISTERS,
)
from imumon.samples import Floats, Ints

STEP = 80
"""Ticks between two steps of the attitude estimator: 0.1 s."""

_BIAS_STEPS = 600
"""Steps over which the bias is averaged after the start: one minute."""

_CORRECTION = 0.02
"""Share of the attitude error that gravity and the magnetic field correct in one step: 5 s."""

_HARD_IRON = np.array([0.012, -0.008, 0.015])
"""gauss, offset that the onboard hard iron estimate subtracts from the compensated magnetic field."""

COMPOSED = {
    "angularRate": ("gyro",),
    "imu": ("uaccel", "ugyro"),
    "magPres": ("mag", "temp", "pres"),
    "deltas": ("dt", "dtheta", "dvel"),
    "deltaTheta": ("dt", "dtheta"),
    "deltaVel": ("dvel",),
    "uncompMag": ("umag",),
    "uncompAccel": ("uaccel",),
    "uncompGyro": ("ugyro",),
}
"""Fields of the binary outputs that consist of other quantities, side by side."""


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
        filters = REGISTERS[IMU_FILTER].parse(read(IMU_FILTER))
        sensors = ("mag", "accel", "gyro", "temperature", "pressure")

        def calibration(number: int) -> tuple[Floats, Floats]:
            numbers = np.array([float(text) for text in read(number)])
            return rotation @ numbers[:9].reshape(3, 3), numbers[9:]

        delta = [int(text) for text in read(DELTA_CONTROL)]
        return OutputConfiguration(
            windows={s: int(filters[f"{s}_window"]) for s in sensors},
            modes={s: int(filters[f"{s}_mode"]) for s in sensors},
            calibration={
                "gyro": calibration(GYRO_CALIBRATION),
                "accel": calibration(ACCEL_CALIBRATION),
                "mag": calibration(MAG_CALIBRATION),
            },
            rotation=rotation,
            delta=(delta[0], delta[1], delta[2]),
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
    heading : deg.

    Attributes
    ----------
    bias : (n, 3) rad/s, estimates at the latest steps.
    heading : deg.
    """

    def __init__(self, bias: Floats, tick: int, heading: float = 35.0) -> None:
        self._first = tick // STEP
        self._count = 1
        self.bias = bias.reshape(1, 3).copy()
        self._angle = np.zeros((1, 3))
        self.heading = heading

    def update(self, sensor_model: SensorModel, upto: int) -> None:
        """Estimate up to tick `upto`; keep the steps since the last two calls."""
        steps = np.arange(self._first + len(self.bias) - 1, upto // STEP + 1)
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

    Every property is (n, k), one row per tick, in the units of the wire: deg, gauss, m/s^2, rad/s, degC,
    kPa; dt in s, dtheta in deg, dvel in m/s.

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
        self._ticks, self._increments, self._counts = ticks, increments, counts

    def __getitem__(self, name: str) -> Floats | Ints:
        """Return a quantity or binary field by name; fields that a VN-100 does not measure are zero."""
        if name in self._counts:
            return self._counts[name]
        if name in COMPOSED:
            return np.concatenate([self[part] for part in COMPOSED[name]], axis=1)
        quantity: Floats | None = getattr(self, name, None)
        return np.zeros((len(self._ticks), 1)) if quantity is None else quantity

    def has(self, name: str) -> bool:
        return name in self._counts or name in COMPOSED or hasattr(type(self), name)

    def _vector(self, sensor: str, columns: slice, compensated: bool) -> Floats:
        raw = self._model.mean(self._ticks, columns, self._configuration.window(sensor, compensated))
        if sensor == "gyro" and compensated:
            raw = raw - self._estimator.bias_at(self._ticks)
            return np.asarray(raw @ self._configuration.calibration[sensor][0].T)
        matrix, bias = self._configuration.calibration[sensor]
        return np.asarray((raw - bias) @ matrix.T)

    @cached_property
    def ugyro(self) -> Floats:
        return self._vector("gyro", GYRO, False)

    @cached_property
    def gyro(self) -> Floats:
        return self._vector("gyro", GYRO, True)

    @cached_property
    def uaccel(self) -> Floats:
        return self._vector("accel", ACCEL, False)

    @cached_property
    def accel(self) -> Floats:
        return self._vector("accel", ACCEL, True)

    @cached_property
    def umag(self) -> Floats:
        return self._vector("mag", MAG, False)

    @cached_property
    def mag(self) -> Floats:
        field = self._vector("mag", MAG, True)
        return field - _HARD_IRON if self._configuration.hard_iron else field

    @cached_property
    def temp(self) -> Floats:
        return self._model.mean(self._ticks, TEMPERATURE, self._configuration.window("temperature", True))

    @cached_property
    def pres(self) -> Floats:
        return self._model.mean(self._ticks, PRESSURE, self._configuration.window("pressure", True))

    @cached_property
    def ypr(self) -> Floats:
        return self._estimator.attitude(self._ticks)

    @cached_property
    def _to_body(self) -> Floats:
        """Rotation from the north-east-down frame to the body frame, (n, 3, 3)."""
        yaw, pitch, roll = np.radians(self.ypr).T
        cy, sy, cp, sp, cr, sr = (
            np.cos(yaw),
            np.sin(yaw),
            np.cos(pitch),
            np.sin(pitch),
            np.cos(roll),
            np.sin(roll),
        )
        rows = (
            (cp * cy, cp * sy, -sp),
            (sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp),
            (cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp),
        )
        return np.array(rows).transpose(2, 0, 1)

    @cached_property
    def quat(self) -> Floats:
        """Attitude quaternion, (n, 4): vector part first, scalar last."""
        yaw, pitch, roll = np.radians(self.ypr).T / 2.0
        cy, sy, cp, sp, cr, sr = (
            np.cos(yaw),
            np.sin(yaw),
            np.cos(pitch),
            np.sin(pitch),
            np.cos(roll),
            np.sin(roll),
        )
        parts = (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        )
        return np.stack(parts, axis=1)

    @cached_property
    def dcm(self) -> Floats:
        """Direction cosine matrix, (n, 9), column by column."""
        return np.asarray(self._to_body.transpose(0, 2, 1).reshape(-1, 9))

    def _ned(self, body: Floats) -> Floats:
        return np.asarray(np.einsum("nji,nj->ni", self._to_body, body))

    @cached_property
    def magNed(self) -> Floats:
        return self._ned(self.mag)

    @cached_property
    def accelNed(self) -> Floats:
        return self._ned(self.accel)

    @cached_property
    def linAccelNed(self) -> Floats:
        return np.asarray(self.accelNed - CONSTANT[ACCEL] * [0.0, 0.0, 1.0])

    @cached_property
    def linAccelBody(self) -> Floats:
        return np.asarray(np.einsum("nij,nj->ni", self._to_body, self.linAccelNed))

    @cached_property
    def yprU(self) -> Floats:
        return np.tile([1.2, 0.3, 0.3], (len(self._ticks), 1))

    @cached_property
    def attU(self) -> Floats:
        return np.full((len(self._ticks), 1), 0.02)

    @cached_property
    def heave(self) -> Floats:
        return np.zeros((len(self._ticks), 3))

    @cached_property
    def dt(self) -> Floats:
        assert self._increments is not None
        return self._increments[:, :1]

    @cached_property
    def dtheta(self) -> Floats:
        assert self._increments is not None
        matrix, bias = self._configuration.calibration["gyro"]
        frame, compensated, _ = self._configuration.delta
        rotated = self._increments[:, 1:4] - bias * self.dt
        if compensated:
            rotated = self._increments[:, 1:4] - self._estimator.bias_at(self._ticks) * self.dt
        body = np.degrees(rotated @ matrix.T)
        return self._ned(body) if frame else body

    @cached_property
    def dvel(self) -> Floats:
        assert self._increments is not None
        matrix, bias = self._configuration.calibration["accel"]
        frame, _, compensated = self._configuration.delta
        body = (self._increments[:, 4:7] - bias * self.dt) @ matrix.T
        if compensated:
            body = body - np.einsum("nij,j->ni", self._to_body, CONSTANT[ACCEL] * [0.0, 0.0, 1.0]) * self.dt
        return self._ned(body) if frame else np.asarray(body)
