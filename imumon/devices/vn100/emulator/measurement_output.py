"""Readings: every quantity of every message at chosen ticks, as the registers ask for them.

Between the elements and the line stand the user's calibrations (registers 23, 25, 84), the rotation of the
reference frame (26), the filter (85), the onboard estimate of the gyro's bias, and the settings of the
increments (82). Uncompensated quantities have passed calibration and filter; compensated ones have lost the
estimated bias too. This file knows neither messages nor commands.
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
"""Ticks between two steps of the estimator: 0.1 s."""

_MEMORY = 600
"""Steps over which the bias is averaged at last: a minute."""

_LEAK = 0.02
"""Share of an attitude's error that gravity and the magnetic field take away in a step: 5 s."""

_IRON = np.array([0.012, -0.008, 0.015])
"""Gauss, offset that the onboard estimate of hard iron takes out of the compensated magnetic field."""

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
"""Fields of the binary outputs that are other quantities, side by side."""


@dataclass(frozen=True, slots=True)
class OutputConfiguration:
    """Registers that change the data, read once for many readings.

    Attributes
    ----------
    windows, modes : of register 85 by sensor.
    calibration : (3, 3) and (3,) of registers 84, 25, 23 by sensor; out = C (in - B).
    rotation : (3, 3) of register 26, as it was when the sensor started.
    delta : frame, gyro and accelerometer compensation of register 82.
    """

    windows: Mapping[str, int]
    modes: Mapping[str, int]
    calibration: Mapping[str, tuple[Floats, Floats]]
    rotation: Floats
    delta: tuple[int, int, int]
    iron: bool

    @staticmethod
    def of(read: Callable[[int], tuple[str, ...]], rotation: Floats, iron: bool) -> OutputConfiguration:
        """Setup from the registers' fields."""
        bank = REGISTERS[IMU_FILTER].parse(read(IMU_FILTER))
        sensors = ("mag", "accel", "gyro", "temperature", "pressure")

        def calibration(number: int) -> tuple[Floats, Floats]:
            numbers = np.array([float(text) for text in read(number)])
            return rotation @ numbers[:9].reshape(3, 3), numbers[9:]

        delta = [int(text) for text in read(DELTA_CONTROL)]
        return OutputConfiguration(
            windows={s: int(bank[f"{s}_window"]) for s in sensors},
            modes={s: int(bank[f"{s}_mode"]) for s in sensors},
            calibration={
                "gyro": calibration(GYRO_CALIBRATION),
                "accel": calibration(ACCEL_CALIBRATION),
                "mag": calibration(MAG_CALIBRATION),
            },
            rotation=rotation,
            delta=(delta[0], delta[1], delta[2]),
            iron=iron,
        )

    def window(self, sensor: str, compensated: bool) -> int:
        """Ticks in the mean of an output; bit 0 of the mode is for uncompensated, bit 1 for compensated."""
        return self.windows[sensor] if self.modes[sensor] >> compensated & 1 else 0


class AttitudeEstimator:
    """What the sensor's own filter knows: the gyro's bias and the attitude, ten times a second.

    The bias is the mean rate since the start, later over the last minute: slow beside the noise, quick
    beside an hour, so B and K of a compensated rate are the filter's and not the gyro's. The attitude is the
    integral of the compensated rate, pulled back to level and heading within seconds.
    """

    def __init__(self, bias: Floats, tick: int, heading: float = 35.0) -> None:
        self._first = tick // STEP
        self._count = 1
        self.bias = bias.reshape(1, 3).copy()
        self._angle = np.zeros((1, 3))
        self.heading = heading

    def follow(self, tape: SensorModel, upto: int) -> None:
        """Take every whole step before `upto`; what lies before the last two calls is forgotten."""
        steps = np.arange(self._first + len(self.bias) - 1, upto // STEP + 1)
        keep = max(0, len(self.bias) - 2)
        self._first += keep
        bias, angle = [*self.bias[keep:]], [*self._angle[keep:]]
        if len(steps) > 1:
            rates = np.diff(tape.integral(steps * STEP, GYRO), axis=0) * (LOOP_RATE / STEP)
            for rate in rates:
                gain = 1.0 / min(self._count, _MEMORY)
                self._count += 1
                bias.append(bias[-1] + gain * (rate - bias[-1]))
                turned = angle[-1] + np.degrees(rate - bias[-1]) * (STEP / LOOP_RATE)
                angle.append(turned * (1.0 - _LEAK))
        self.bias, self._angle = np.array(bias), np.array(angle)

    def reset_bias(self) -> None:
        """Average anew from now on."""
        self._count = 1

    def bias_at(self, ticks: Ints) -> Floats:
        """Estimated bias, (n, 3) rad/s."""
        return np.asarray(self.bias[np.clip(ticks // STEP - self._first, 0, len(self.bias) - 1)])

    def attitude(self, ticks: Ints) -> Floats:
        """Yaw, pitch and roll, (n, 3) deg; between two steps on the straight line."""
        last = np.clip(ticks // STEP - self._first, 0, len(self._angle) - 1)
        before = np.maximum(last - 1, 0)
        share = (ticks % STEP / STEP)[:, None]
        roll_pitch_yaw = self._angle[before] * (1.0 - share) + self._angle[last] * share
        return np.asarray(roll_pitch_yaw[:, ::-1] + np.array([self.heading, 0.0, 0.0]))


class MeasurementOutput:
    """Quantities at some ticks, each reckoned when it is first asked for.

    Every property is (n, k), one row a tick, in the units of the wire: deg, gauss, m/s^2, rad/s, degC,
    kPa; dt in s, dtheta in deg, dvel in m/s.

    Parameters
    ----------
    since : (n, 7) time in s, and integrals of gyro and accelerometer since the increments' last
        reset before each tick; None for readings without increments.
    counts : the fields that are counters and status, by name.
    """

    def __init__(
        self,
        tape: SensorModel,
        setup: OutputConfiguration,
        estimator: AttitudeEstimator,
        ticks: Ints,
        since: Floats | None,
        counts: Mapping[str, Floats | Ints],
    ) -> None:
        self._tape, self._setup, self._estimator = tape, setup, estimator
        self._ticks, self._since, self._counts = ticks, since, counts

    def __getitem__(self, name: str) -> Floats | Ints:
        """Quantity or binary field by name; what a VN-100 does not have is zero."""
        if name in self._counts:
            return self._counts[name]
        if name in COMPOSED:
            return np.concatenate([self[part] for part in COMPOSED[name]], axis=1)
        found: Floats | None = getattr(self, name, None)
        return np.zeros((len(self._ticks), 1)) if found is None else found

    def has(self, name: str) -> bool:
        return name in self._counts or name in COMPOSED or hasattr(type(self), name)

    def _vector(self, sensor: str, columns: slice, compensated: bool) -> Floats:
        raw = self._tape.mean(self._ticks, columns, self._setup.window(sensor, compensated))
        if sensor == "gyro" and compensated:
            raw = raw - self._estimator.bias_at(self._ticks)
            return np.asarray(raw @ self._setup.calibration[sensor][0].T)
        matrix, bias = self._setup.calibration[sensor]
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
        return field - _IRON if self._setup.iron else field

    @cached_property
    def temp(self) -> Floats:
        return self._tape.mean(self._ticks, TEMPERATURE, self._setup.window("temperature", True))

    @cached_property
    def pres(self) -> Floats:
        return self._tape.mean(self._ticks, PRESSURE, self._setup.window("pressure", True))

    @cached_property
    def ypr(self) -> Floats:
        return self._estimator.attitude(self._ticks)

    @cached_property
    def _to_body(self) -> Floats:
        """Rotation from north-east-down to the body's frame, (n, 3, 3)."""
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
        """Vector part first, scalar last."""
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
        """Column by column."""
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
        assert self._since is not None
        return self._since[:, :1]

    @cached_property
    def dtheta(self) -> Floats:
        assert self._since is not None
        matrix, bias = self._setup.calibration["gyro"]
        frame, compensated, _ = self._setup.delta
        turned = self._since[:, 1:4] - bias * self.dt
        if compensated:
            turned = self._since[:, 1:4] - self._estimator.bias_at(self._ticks) * self.dt
        body = np.degrees(turned @ matrix.T)
        return self._ned(body) if frame else body

    @cached_property
    def dvel(self) -> Floats:
        assert self._since is not None
        matrix, bias = self._setup.calibration["accel"]
        frame, _, compensated = self._setup.delta
        body = (self._since[:, 4:7] - bias * self.dt) @ matrix.T
        if compensated:
            body = body - np.einsum("nij,j->ni", self._to_body, CONSTANT[ACCEL] * [0.0, 0.0, 1.0]) * self.dt
        return self._ned(body) if frame else np.asarray(body)
