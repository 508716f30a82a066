"""Measurements of the emulated device: every quantity of every message.

The signals of the sensor elements pass the filter of register 85. The sensor lies level, at rest and with its x axis
to the north, and its attitude filter estimates no bias: compensated quantities differ from uncompensated ones in the
mode of register 85 alone. User calibrations, the rotation of the reference frame and the configuration of the
increments (registers 21 to 26, 44, 82 and 84) are stored and change nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.model.samples import Floats, Ints
from imumon.sources.vn100.binary import QUANTITIES
from imumon.sources.vn100.emulator.sensor_model import (
    ACCEL,
    GYRO,
    MAG,
    PRESSURE,
    TEMPERATURE,
    SensorModel,
)
from imumon.sources.vn100.registers import FILTERED

_COMPOSED = {**QUANTITIES, "magNed": ("mag",), "accelNed": ("accel",)}
"""Fields of the binary outputs that consist of other quantities, side by side: here, north is ahead."""

_READINGS = {
    "gyro": ("gyro", True), "ugyro": ("gyro", False), "accel": ("accel", True), "uaccel": ("accel", False),
    "mag": ("mag", True), "umag": ("mag", False), "temp": ("temperature", True), "pres": ("pressure", True),
}  # fmt: skip
"""Sensor of a quantity, and whether the quantity is compensated."""

_COLUMNS = {"gyro": GYRO, "accel": ACCEL, "mag": MAG, "temperature": TEMPERATURE, "pressure": PRESSURE}
_FIXED = {
    "quat": (0.0, 0.0, 0.0, 1.0),  # scalar last
    "dcm": (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
    "ypr": (0.0, 0.0, 0.0),
    "heave": (0.0, 0.0, 0.0),
    "linaccel": (0.0, 0.0, 0.0),
}
"""Quantities that do not change."""


class MeasurementOutput:
    """Measured quantities at some ticks, each computed on first use.

    A quantity is (n, k), one row per tick, in the units of the wire: deg, gauss, m/s^2, rad/s, degC, kPa;
    dt in s, dtheta in deg, dvel in m/s.

    Parameters
    ----------
    sensor_model : signals of the sensor elements.
    averages : values of register 85: ticks that each sensor averages, then its modes. Bit 0: the uncompensated output
        is averaged, bit 1: the compensated one.
    ticks : (n,) at which the quantities are measured.
    increments : (n, 7) s and unit * s, time and integrals of gyroscope and accelerometer since the last reset
        of the increments before each tick; None for measurements without increments.
    time_ns : (n,) ns, time stamps.
    """

    def __init__(
        self,
        sensor_model: SensorModel,
        averages: Sequence[int],
        ticks: Ints,
        increments: Floats | None,
        time_ns: Ints,
    ) -> None:
        self._model, self._averages = sensor_model, averages
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

    def _compute(self, name: str) -> npt.NDArray[Any]:
        if name in _READINGS:
            sensor, compensated = _READINGS[name]
            place, length = FILTERED.index(sensor), len(FILTERED)
            applies = self._averages[place + length] >> compensated & 1
            window = self._averages[place] if applies else 0
            return self._model.mean(self._ticks, _COLUMNS[sensor], window)
        if name in _COMPOSED:
            return np.concatenate([self[part] for part in _COMPOSED[name]], axis=1)
        return np.tile(_FIXED.get(name, (0.0,)), (len(self._ticks), 1))
