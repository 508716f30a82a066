"""Measurements: which quantities of a message become samples, and how.

A message, ASCII or binary, contains named quantities. Each type of message gives one stream: increments are
preferred to uncompensated values and these to compensated values, with gyroscope and accelerometer of the
same kind if the message has both in one kind. Otherwise the kind of the stream is the worse one, and the
stream states the kind of each sensor.

Increments are divided by their own interval: a delta angle divided by its interval is the mean rate, a true
cluster average in the sense of IEEE Std 952-2020, C.1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntFlag
from functools import lru_cache
from math import pi
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from imumon.model.samples import (
    CHANNELS,
    SLOWEST_HZ,
    Bools,
    ChannelName,
    Clock,
    Floats,
    Ints,
    Kind,
    SampleBlock,
    Stream,
)
from imumon.sources.vn100.registers import LOOP_RATE

GetQuantity: TypeAlias = Callable[[str], npt.NDArray[Any]]
"""Function that returns a quantity by name: (n, k), k its number of components."""

WIDTHS = {
    "ypr": 3, "quat": 4, "mag": 3, "accel": 3, "gyro": 3, "linaccel": 3, "umag": 3, "uaccel": 3, "ugyro": 3,
    "temp": 1, "pres": 1, "dt": 1, "dtheta": 3, "dvel": 3, "dcm": 9, "heave": 3,
}  # fmt: skip
"""Components of a quantity. Units: deg, gauss, m/s^2, rad/s, degC, kPa; dt s, dtheta deg, dvel m/s."""

_QUANTITIES: dict[str, dict[Kind, str]] = {
    "gyro": {"deltas": "dtheta", "uncompensated": "ugyro", "compensated": "gyro"},
    "accel": {"deltas": "dvel", "uncompensated": "uaccel", "compensated": "accel"},
    "mag": {"uncompensated": "umag", "compensated": "mag"},
}
"""Quantity of each kind by sensor, the best kind first."""

_OTHERS: dict[str, tuple[Kind, str]] = {"temperature": ("unknown", "temp"), "pressure": ("unknown", "pres")}
"""Kind and quantity of the other channels."""

_OVER_DT = {"dtheta": pi / 180.0, "dvel": 1.0}
"""Increments, with the factor that converts their rate to SI."""

_MAX_INTERVAL_S = 1.0 / SLOWEST_HZ
"""s; longer intervals are invalid, no sensor has them. A damaged one would be a gap of years."""

_MAX_VALUE = 1e9
"""Channel unit; larger values are invalid, no sensor measures them. A damaged float that passes its check can be 1e38,
whose fourth power overflows: one such sample would invalidate all moments."""


class VpeStatus(IntFlag):
    """Bits of VpeStatus that imumon reads or the emulator sets."""

    GYRO_SATURATED = 1 << 2
    ACCEL_SATURATED = 1 << 9


SATURATION_BITS: dict[str, dict[str, int]] = {
    "vpe": {"gyro": VpeStatus.GYRO_SATURATED.value, "accel": VpeStatus.ACCEL_SATURATED.value},
    "sat": {"mag": 0b111, "accel": 0b111 << 3, "gyro": 0b111 << 6, "pressure": 1 << 9},
}
"""Bits of the status words that say that a sensor exceeded its range; SensSat has one for each axis."""


@dataclass(frozen=True, slots=True)
class SampleConverter:
    """Converts the quantities of one type of message to samples of one stream.

    Attributes
    ----------
    stream : of the samples.
    parts : quantities with their columns in the samples.
    uses_dt : whether increments are among the parts, or dt is the clock.
    flags : those of the quantities ``vpe`` and ``sat`` that the message has; they report saturation.
    """

    stream: Stream
    parts: tuple[tuple[str, slice], ...]
    uses_dt: bool
    flags: tuple[str, ...]

    @np.errstate(all="ignore")  # rows that are not finite are invalid
    def convert(self, get: GetQuantity, count: int) -> tuple[SampleBlock, Bools | None]:
        """Return the samples of `count` messages of one type, and which are valid.

        Those are finite and plausible, with a positive interval and a possible time stamp; None: all are.
        """
        values = np.empty((len(self.stream.channels), count)).T  # channel by channel in memory
        dt = get("dt").astype(np.float64) if self.uses_dt else None
        for part, columns in self.parts:
            if dt is not None and part in _OVER_DT:
                values[:, columns] = get(part) / dt * _OVER_DT[part]
            else:
                values[:, columns] = get(part)
        time: Ints | None = None
        if self.stream.clock == "dt" and dt is not None:
            time = _nanoseconds(dt[:, 0])
        elif self.stream.clock != "none":
            time = get(self.stream.clock)[:, 0].astype(np.int64)
        saturated: Bools | None = None
        if self.flags:
            sensors = list(dict.fromkeys(self.stream.sensors))
            saturated = np.zeros((count, len(sensors)), dtype=bool)
            for flag in self.flags:
                for sensor, bits in SATURATION_BITS[flag].items():
                    if sensor in sensors:  # else what exceeded its range is not in the samples
                        saturated[:, sensors.index(sensor)] |= (get(flag)[:, 0] & bits) != 0
        block = SampleBlock(self.stream, values, time, np.zeros(count, np.int64), saturated)
        return block, _valid_rows(values, dt, time)


def _nanoseconds(dt: Floats) -> Ints:
    """Return intervals, (n,) s, in whole ns; 0 for invalid ones."""
    return np.rint(np.where((dt > 0.0) & (dt < _MAX_INTERVAL_S), dt, 0.0) * 1e9).astype(np.int64)


def _valid_rows(values: Floats, dt: Floats | None, time: Ints | None) -> Bools | None:
    """Return (n,) which rows are valid; None if all are, the usual case, which is detected fast."""
    intervals_valid = dt is None or (dt.min() > 0.0 and dt.max() < _MAX_INTERVAL_S)
    times_valid = time is None or time.min() >= 0
    if intervals_valid and times_valid and values.min() > -_MAX_VALUE and values.max() < _MAX_VALUE:
        return None
    valid: Bools = np.logical_and.reduce(np.abs(values) < _MAX_VALUE, axis=1)
    if dt is not None:
        valid = valid & (dt[:, 0] > 0.0) & (dt[:, 0] < _MAX_INTERVAL_S)
    if time is not None:
        valid = valid & (time >= 0)
    return valid


def _sensors(available: set[str]) -> dict[str, tuple[Kind, str]]:
    """Return kind and quantity of each sensor; of one kind if the message has gyroscope and accelerometer in it."""
    gyro, accel = _QUANTITIES["gyro"], _QUANTITIES["accel"]
    both = [kind for kind in gyro if {gyro[kind], accel[kind]} <= available]
    chosen: dict[str, tuple[Kind, str]] = {}
    for sensor, quantities in _QUANTITIES.items():
        kinds = quantities if sensor == "mag" else both or quantities
        present = [(kind, quantities[kind]) for kind in kinds if quantities[kind] in available]
        if present:
            chosen[sensor] = present[0]
    return chosen


def _kind_of_stream(sensors: Mapping[str, tuple[Kind, str]]) -> tuple[Kind, dict[str, Kind]]:
    """Return the worst kind among the sensors of a stream, and the kinds of sensors that are better."""
    # a magnetometer has no deltas: it decides the kind only of a message that has nothing else
    kinds = {sensor: kind for sensor, (kind, _) in sensors.items() if sensor != "mag" or len(sensors) == 1}
    worst = max(kinds.values(), key=list(_QUANTITIES["gyro"]).index)
    return worst, {sensor: kind for sensor, kind in kinds.items() if kind != worst}


@lru_cache(maxsize=256)
def sample_converter(quantities: frozenset[str], source: str) -> SampleConverter | None:
    """Return the converter to the best stream of a message; None if it has no sensor data.

    Parameters
    ----------
    quantities : those of `WIDTHS` in the message, and the clocks ``startup`` (ns) and ``counter`` and the
        flags ``vpe`` (VpeStatus) and ``sat`` (SensSat).
    source : name of the message.

    >>> sample_converter(frozenset({"ypr", "mag", "accel", "gyro"}), "$VNYMR").stream.kind
    'compensated'
    >>> sample_converter(frozenset({"ypr"}), "$VNYPR") is None
    True
    """
    # an increment without its interval cannot become a rate
    available = {q for q in quantities if q not in _OVER_DT or "dt" in quantities}
    sensors = _sensors(available)
    if not sensors:
        return None
    parts: list[tuple[str, slice]] = []
    channels: tuple[ChannelName, ...] = ()
    for sensor, (_, quantity) in (sensors | _OTHERS).items():
        if quantity in available:
            begin = len(channels)
            channels += tuple(name for name in CHANNELS if name.sensor == sensor)
            parts.append((quantity, slice(begin, len(channels))))
    # an absolute clock shows how long a gap is; intervals do not
    clocks: tuple[Clock, ...] = ("startup", "counter", "dt")
    clock: Clock = next((c for c in clocks if c in available), "none")
    uses_dt = clock == "dt" or any(part in _OVER_DT for part, _ in parts)
    flags = tuple(flag for flag in ("vpe", "sat") if flag in available)
    kind, exceptions = _kind_of_stream(sensors)
    gyro_kind, accel_kind = exceptions.get("gyro"), exceptions.get("accel")
    stream = Stream(kind, channels, source, clock, gyro=gyro_kind, accel=accel_kind, tick_s=1.0 / LOOP_RATE)
    return SampleConverter(stream, tuple(parts), uses_dt, flags)
