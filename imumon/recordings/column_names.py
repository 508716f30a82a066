"""Names: what the name of a column says of it.

People name the same thing `gyro_x [rad/s]`, `IMU::UncompGyro::X [rad/s]`, `angular_velocity.x`, `wx`.
A name is taken apart into words; the last word tells the axis, the others the sensor, what the sensor
has done to the values already, and the unit. Without a unit SI is meant.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from imumon.samples import AXES, Kind

_RATE = {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": math.radians(1.0), "mdeg/s": math.radians(1e-3),
         "deg/h": math.radians(1.0) / 3600.0}  # fmt: skip
_ACCELERATION = {"m/s2": 1.0, "g": 9.80665, "mg": 9.80665e-3, "ug": 9.80665e-6}
UNITS: Mapping[str, Mapping[str, float]] = {
    "gyro": _RATE,
    "accel": _ACCELERATION,
    "angle": {"rad": 1.0, "deg": math.radians(1.0)},
    "velocity": {"m/s": 1.0},
    "mag": {"gauss": 1.0, "mgauss": 1e-3, "t": 1e4, "mt": 10.0, "ut": 1e-2, "nt": 1e-5},
    "temperature": {"degc": 1.0, "k": 1.0},
    "pressure": {"kpa": 1.0, "pa": 1e-3, "hpa": 0.1, "mbar": 0.1, "bar": 100.0},
    "t": {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0},
    "dt": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
}
"""Factor of each unit by quantity: to SI, gauss, degC, kPa; times to ns, intervals to s."""

_SPELLINGS = {
    spelling: unit
    for unit, spellings in (
        ("rad/s", "rads-1 rads radps rad/sec r/s rps"),
        ("deg/s", "degs-1 degs degps deg/sec dps"),
        ("mdeg/s", "mdps"),
        ("deg/h", "deg/hr"),
        ("m/s2", "ms-2 m/s/s mps2 mss mpss ms2"),
        ("g", "gn"),
        ("gauss", "gs"),
        ("t", "tesla"),
        ("degc", "c celsius"),
        ("k", "kelvin"),
        ("s", "sec secs second seconds"),
        ("ms", "msec milliseconds"),
        ("us", "usec microseconds"),
        ("ns", "nsec nsecs nanosec nanoseconds"),
        ("m/s", "ms-1 mps"),
        ("rad", "radians"),
        ("deg", "degrees"),
    )
    for spelling in spellings.split()
}
"""Other spellings of the units."""

_PER_SENSOR = {("mag", "g"): "gauss", ("mag", "mg"): "mgauss"}

_SENSORS = {
    "gyro": {"gyro", "gyr", "gyros", "gyroscope", "omega", "w", "rate", "rates"},
    "accel": {"accel", "acc", "accels", "acceleration", "accelerometer", "accelerations", "a", "force", "f"},
    "mag": {"mag", "magn", "magnetic", "magnetometer", "compass", "m"},
    "temperature": {"temp", "temperature"},
    "pressure": {"pres", "press", "pressure", "baro"},
}
_PLAIN = {"gyro", "gyr", "gyroscope", "accel", "acc", "accelerometer"}
"""Words that name an inertial sensor even where no axis is told."""
_STRANGE = {
    "cov", "covariance", "var", "variance", "std", "sigma", "bias", "offset", "error", "ned", "enu",
    "world", "inertial", "orientation", "quaternion", "quat", "ypr", "status", "valid", "ok", "week",
    "cycle"
}  # fmt: skip
"""Words that make another thing of a name."""

_NEUTRAL = {
    "imu", "sensor", "data", "field", "msg", "rs", "s", "b", "body", "linear", "angular", "velocity",
    "vel", "time", "header", "stamp", "uncomp", "comp", "uncompensated", "compensated", "raw",
    "specific", "delta"
}  # fmt: skip
"""Words that change nothing."""

_LETTERS = re.compile(r"^(w|g|gyr|gyro|omega|rate|a|acc|accel|f|m|mag)([xyz])$")
_TIMES = {"t": 0, "time": 0, "timestamp": 0, "stamp": 1, "startup": -2, "sec": 2, "secs": 2, "seconds": 2}
_SECONDS = {"secs", "seconds"}
"""Names of a time that are its unit; ``sec`` alone may be the part of a stamp."""
NANOSECONDS = {"nsec", "nsecs", "nanosec", "nanosecs"}
_INTERVALS = ({"dt"}, {"delta", "time"}, {"delta", "t"})


@dataclass(frozen=True, slots=True)
class Column:
    """A column and what its name says.

    Attributes
    ----------
    index : its place in the table, from 0.
    name : as the table has it.
    quantity : key of `UNITS`; None: nothing that is used here.
    axis : ``x``, ``y``, ``z`` or None.
    kind : what its name says was done to the values, None where it says nothing.
    unit : as found in `UNITS`, None where the name has none.
    doubt : how many words of the name were not understood; of two columns the one with less is taken.
        Below 0 where the user said what the column is: then it goes with every `kind`.
    unknown : a unit that is not found there.
    """

    index: int
    name: str
    quantity: str | None = None
    axis: str | None = None
    kind: Kind | None = None
    unit: str | None = None
    doubt: int = 0
    unknown: str | None = None

    @property
    def factor(self) -> float:
        """To SI, gauss, degC, kPa; a time to ns, an interval to s."""
        return 1.0 if self.unit is None or self.quantity is None else UNITS[self.quantity][self.unit]


def spelled(text: str, quantity: str) -> str | None:
    """Unit as `UNITS` has it, None for one that is not known there.

    >>> spelled("rad s^-1", "gyro"), spelled("m/s²", "accel"), spelled("furlong", "accel")
    ('rad/s', 'm/s2', None)
    """
    unit = text.lower().replace("²", "2").replace("µ", "u").replace("μ", "u").replace("°", "deg")
    unit = re.sub(r"[\s^*·_]+|sqrt", "", unit)
    unit = _SPELLINGS.get(unit, unit)
    unit = _PER_SENSOR.get((quantity, unit), unit)
    return unit if unit in UNITS[quantity] else None


def understood(index: int, name: str) -> Column:
    """What a column's name says.

    >>> column = understood(3, "IMU::UncompGyro::X [rad/s]")
    >>> column.quantity, column.axis, column.kind, column.unit
    ('gyro', 'x', 'uncompensated', 'rad/s')
    >>> understood(0, "linear_acceleration.z").quantity, understood(0, "GyroX_dps").unit
    ('accel', 'deg/s')
    """
    words, axis, spoken = _parts(name)
    quantity, kind, doubt = _meaning(set(words), axis)
    if quantity is None:
        return Column(index, name)
    spoken = spoken or next((word for word in words if quantity == "t" and word in _SECONDS), None)
    known = None if spoken is None else spelled(spoken, quantity)
    return Column(index, name.strip(), quantity, axis, kind, known, doubt, spoken if known is None else None)


def said(index: int, name: str, quantity: str, axis: str | None, unit: str | None) -> Column:
    """Column that is what the user says; its name still tells the unit where he does not.

    >>> said(2, "p [deg/s]", "gyro", "x", None).unit
    'deg/s'
    """
    spoken = _parts(name)[2]
    unit = unit or (None if spoken is None else spelled(spoken, quantity))
    return Column(index, name, quantity, axis, unit=unit, doubt=-1)


def _parts(name: str) -> tuple[list[str], str | None, str | None]:
    """Words of a name, its axis, and its unit as it is spelled there."""
    text, unit, axis = name.strip().strip("\"'").lstrip("#% "), None, None
    if found := re.search(r"[\[(]([^\])]*)[\])]\s*$", text):
        text, inside = text[: found.start()], found.group(1)
        if inside in ("0", "1", "2"):
            axis = AXES[int(inside)]
        else:
            unit = inside
    words, suffix = _suffix(words_of(text))
    if axis is None and words and words[-1] in AXES:
        axis = words.pop()
    return words, axis, unit or suffix


def words_of(text: str) -> list[str]:
    """Words of a name, small: cut at signs, blanks and capitals."""
    text = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", text)
    text = re.sub(r"([A-Z]+)([A-Z][a-z])", r"\1 \2", text)
    words = []
    for word in re.findall(r"[a-zµ]+[0-9]*|[0-9]+", text.lower()):
        if found := _LETTERS.match(word):
            words += ["gyro" if found.group(1) == "g" else found.group(1), found.group(2)]
        else:
            words.append(word if word in ("s2", "mps2", "ms2") else word.rstrip("0123456789") or word)
    return words


def _suffix(words: list[str]) -> tuple[list[str], str | None]:
    """A unit written as the last words of a name, behind the axis."""
    for size in (3, 2, 1):
        if len(words) <= size:
            continue
        rest, tail = words[:-size], words[-size:]
        behind_axis = rest[-1] in AXES
        for joined in ("".join(tail), "/".join(tail)):
            unit = _SPELLINGS.get(joined, joined)
            if any(unit in units for units in UNITS.values()) and (behind_axis or rest[-1] in _TIMES):
                return rest, unit
    return words, None


def _meaning(words: set[str], axis: str | None) -> tuple[str | None, Kind | None, int]:
    """Quantity, kind and doubt of the words of a name."""
    if words & _STRANGE:
        return None, None, 0
    delta = "delta" in words or bool(words & {"dtheta", "dvel", "dv"})
    if axis is not None and delta:
        if words & {"theta", "angle", "dtheta"}:
            return "angle", "deltas", 0
        if words & {"vel", "velocity", "v", "dvel", "dv"}:
            return "velocity", "deltas", 0
        return None, None, 0
    if axis is None:
        if any(wanted <= words for wanted in _INTERVALS):
            return "dt", None, 0
        if words & NANOSECONDS:
            return "t", None, 9
        for name in ("temperature", "pressure"):
            if words & _SENSORS[name]:
                return name, None, len(words - _SENSORS[name] - _NEUTRAL)
        if at := words & set(_TIMES):
            rest = words - set(_TIMES) - _NEUTRAL - {"header", "startup"}
            return "t", None, max(min(_TIMES[word] for word in at) + 3 * len(rest) + 2, 0)
        if words & _PLAIN:
            return ("gyro" if words & _PLAIN & _SENSORS["gyro"] else "accel"), None, len(words)
        return None, None, 0
    kind: Kind | None = None
    if words & {"uncomp", "uncompensated", "raw"}:
        kind = "uncompensated"
    elif words & {"comp", "compensated"} or {"angular", "rate"} <= words:
        kind = "compensated"
    if {"angular", "velocity"} <= words or {"angular", "vel"} <= words or {"ang", "vel"} <= words:
        return "gyro", kind, len(words - _NEUTRAL - {"ang"})
    for sensor in ("gyro", "accel", "mag"):
        if words & _SENSORS[sensor]:
            return sensor, kind, len(words - _SENSORS[sensor] - _NEUTRAL)
    return None, None, 0
