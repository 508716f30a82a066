"""Column names: quantity, axis, kind and unit in the name of a column.

The same quantity is named `gyro_x [rad/s]`, `IMU::UncompGyro::X [rad/s]`, `angular_velocity.x` or `wx`. A
name is split into words; the last word is the axis, the others are the sensor, its processing (compensated or
not) and the unit. Without a unit, the values are in SI units.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass

from imumon.samples import AXES, Kind
from imumon.units import STANDARD_GRAVITY

ZERO_CELSIUS = 273.15
"""K."""
_RATE = {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": math.radians(1.0), "mdeg/s": math.radians(1e-3),
         "deg/h": math.radians(1.0) / 3600.0}  # fmt: skip
_ACCELERATION = {
    "m/s2": 1.0,
    "g": STANDARD_GRAVITY,
    "mg": STANDARD_GRAVITY / 1e3,
    "ug": STANDARD_GRAVITY / 1e6,
}
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
        ("s", "sec secs second seconds sek sekunden secondes"),
        ("ms", "msec millis milliseconds millisekunden millisecondes"),
        ("us", "usec micros microseconds"),
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
SENSOR_WORDS = {"gyro": {"gyro", "gyr", "gyroscope"}, "accel": {"accel", "acc", "accelerometer"}}
"""Words that name an inertial sensor even without an axis."""

_EXCLUDED = {
    "fine",  # SampleTimeFine of Xsens counts 100 us, which is no unit
    "cov", "covariance", "var", "variance", "std", "sigma", "bias", "offset", "error", "ned", "enu",
    "world", "inertial", "orientation", "quaternion", "quat", "ypr", "status", "valid", "ok", "week",
    "cycle"
}  # fmt: skip
"""Words of columns that are no samples of a sensor."""

_NEUTRAL = {
    "imu", "sensor", "data", "field", "msg", "rs", "s", "b", "body", "linear", "angular", "velocity",
    "vel", "time", "header", "stamp", "uncomp", "comp", "uncompensated", "compensated", "raw",
    "specific", "delta", "axis", "of", "in", "der", "de", "du"
}  # fmt: skip
"""Words without a meaning of their own."""

_ENGLISH = {
    german_or_french: english
    for english, words in (
        ("gyro", "drehrate drehraten drehratensensor winkelgeschwindigkeit winkelgeschw gyroskop gyrometre"),
        ("accel", "beschleunigung beschleunigungen beschleunigungssensor beschl accelerometre"),
        ("mag", "magnetfeld magnetometre magnetique"),
        ("temperature", "temperatur"),
        ("pressure", "druck luftdruck pression"),
        ("time", "zeit temps"),
        ("timestamp", "zeitstempel horodatage horodate"),
        ("seconds", "sekunden secondes"),
        ("milliseconds", "millisekunden millisecondes"),
        ("angular", "angulaire"), ("velocity", "vitesse geschwindigkeit"), ("linear", "lineaire"),
        ("field", "champ"), ("axis", "achse axe"), ("raw", "roh brut brute"), ("delta", "increment inkrement"),
        ("angle", "winkel"),
    )
    for german_or_french in words.split()
}  # fmt: skip
"""English words for the German and French ones in names of columns, without accents."""

_AXIS_SUFFIX = re.compile(r"^(w|g|gyr|gyro|omega|rate|a|acc|accel|f|m|mag)([xyz])$")
_NO_TIME_RANK = 9
"""Rank of a column that is the nanoseconds of a stamp: the last choice of a time."""

_TIMES = {"t": 0, "time": 0, "timestamp": 0, "stamp": 1, "startup": -2, "sec": 2, "secs": 2, "seconds": 2}
"""Words of a time, with their rank: the lower is preferred."""

_TICKS = {"ms", "us", "msec", "usec", "millis", "micros", "milliseconds", "microseconds"}
"""Names of a time that are its unit, without another word."""

_SECONDS = {"secs", "seconds", *_TICKS}
"""Words of a time that are its unit; ``sec`` alone may be a part of a stamp."""
NANOSECONDS = {"nsec", "nsecs", "nanosec", "nanosecs"}
_INTERVALS = ({"dt"}, {"delta", "time"}, {"delta", "t"})


@dataclass(frozen=True, slots=True)
class Column:
    """Column with the quantity, axis, kind and unit that its name shows.

    Attributes
    ----------
    index : its place in the table, from 0.
    name : as in the table.
    quantity : key of `UNITS`; None: not used.
    axis : ``x``, ``y``, ``z`` or None.
    kind : kind of the values, if the name says so, else None.
    unit : key of the table of its quantity in `UNITS`; None: the name has none.
    rank : about the number of unknown words in the name; of two columns the one with the lower rank is used.
        Below 0 if the user has assigned the column: then it fits every `kind`.
    unknown_unit : unit that is not in `UNITS`.
    """

    index: int
    name: str
    quantity: str | None = None
    axis: str | None = None
    kind: Kind | None = None
    unit: str | None = None
    rank: int = 0
    unknown_unit: str | None = None

    @property
    def zero(self) -> float:
        """What remains to be subtracted after the factor: degC begin at 273.15 K."""
        return ZERO_CELSIUS if self.unit == "k" else 0.0

    @property
    def channel(self) -> str:
        """Quantity and axis in the form of a channel: ``gyro/x``, also ``angle/x``, ``t`` and ``dt``."""
        return f"{self.quantity}/{self.axis}" if self.axis else f"{self.quantity}"

    @property
    def factor(self) -> float:
        """Factor to SI, gauss, degC, kPa; of a time to ns, of an interval to s."""
        return 1.0 if self.unit is None or self.quantity is None else UNITS[self.quantity][self.unit]


def unit_of(text: str, quantity: str) -> str | None:
    """Return a unit as in `UNITS`; None if it is unknown.

    >>> unit_of("rad s^-1", "gyro"), unit_of("m/s²", "accel"), unit_of("furlong", "accel")
    ('rad/s', 'm/s2', None)
    """
    unit = text.lower().replace("²", "2").replace("µ", "u").replace("μ", "u").replace("°", "deg")
    unit = re.sub(r"[\s^*·_]+|sqrt", "", unit)
    unit = _SPELLINGS.get(unit, unit)
    unit = _PER_SENSOR.get((quantity, unit), unit)
    return unit if unit in UNITS[quantity] else None


def parse_name(index: int, name: str) -> Column:
    """Return quantity, axis, kind and unit by the name of a column.

    >>> column = parse_name(3, "IMU::UncompGyro::X [rad/s]")
    >>> column.quantity, column.axis, column.kind, column.unit
    ('gyro', 'x', 'uncompensated', 'rad/s')
    >>> parse_name(0, "linear_acceleration.z").quantity, parse_name(0, "GyroX_dps").unit
    ('accel', 'deg/s')
    """
    words, axis, unit = _parts(name)
    quantity, kind, rank = _meaning(set(words), axis)
    if quantity is None:
        return Column(index, name)
    unit = unit or next((word for word in words if quantity == "t" and word in _SECONDS), None)
    known = None if unit is None else unit_of(unit, quantity)
    return Column(index, name.strip(), quantity, axis, kind, known, rank, unit if known is None else None)


def assigned_column(index: int, name: str, quantity: str, axis: str | None, unit: str | None) -> Column:
    """Return a column that the user has assigned; without a given unit, that of the name applies.

    >>> assigned_column(2, "p [deg/s]", "gyro", "x", None).unit
    'deg/s'
    """
    own = _parts(name)[2]
    unit = unit or (None if own is None else unit_of(own, quantity))
    return Column(index, name, quantity, axis, unit=unit, rank=-1)


def _parts(name: str) -> tuple[list[str], str | None, str | None]:
    """Return the words of a name, its axis, and its unit as written there."""
    text, unit, axis = name.strip().strip("\"'").lstrip("#% "), None, None
    if match := re.search(r"[\[(]([^\])]*)[\])]\s*$", text):
        text = text[: match.start()]
        if match[1] in ("0", "1", "2"):
            axis = AXES[int(match[1])]
        else:
            unit = match[1]
    words, suffix = _suffix(words_of(text))
    for at in (-1, 0):  # gyro_x, also X-Beschleunigung
        if axis is None and len(words) > (at == 0) and words[at] in AXES:
            axis = words.pop(at)
    return words, axis, unit or suffix


def words_of(text: str) -> list[str]:
    """Return the English words of a name in lower case: split at signs, blanks and capitals.

    >>> words_of("Accélération linéaire X"), words_of("DrehrateZ")
    (['acceleration', 'linear', 'x'], ['gyro', 'z'])
    """
    text = "".join(c for c in unicodedata.normalize("NFD", text) if not unicodedata.combining(c))
    text = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", text)
    text = re.sub(r"([A-Z]+)([A-Z][a-z])", r"\1 \2", text)
    words = []
    for word in re.findall(r"[a-zµ]+[0-9]*|[0-9]+", text.lower()):
        if match := _AXIS_SUFFIX.match(word):
            words += ["gyro" if match[1] == "g" else match[1], match[2]]
        else:
            word = word if word in ("s2", "mps2", "ms2") else word.rstrip("0123456789") or word
            words.append(_ENGLISH.get(word, word))
    return words


def _suffix(words: list[str]) -> tuple[list[str], str | None]:
    """Return the words without a unit at their end, behind the axis, and that unit."""
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


def _meaning_without_axis(words: set[str]) -> tuple[str | None, Kind | None, int]:
    """Return quantity, kind and rank of a time, an interval, a temperature, a pressure, or a sensor without axis."""
    if any(name <= words for name in _INTERVALS):
        return "dt", None, 0
    if words & NANOSECONDS:
        return "t", None, _NO_TIME_RANK
    for name in ("temperature", "pressure"):
        if words & _SENSORS[name]:
            return name, None, len(words - _SENSORS[name] - _NEUTRAL)
    if len(words) == 1 and words <= _TICKS:
        return "t", None, max(_TIMES.values())
    if at := words & set(_TIMES):
        rest = words - set(_TIMES) - _NEUTRAL - {"header", "startup"}
        return "t", None, max(min(_TIMES[word] for word in at) + 3 * len(rest) + 2, 0)
    for sensor, names in SENSOR_WORDS.items():
        if words & names:
            return sensor, None, len(words)
    return None, None, 0


def _meaning(words: set[str], axis: str | None) -> tuple[str | None, Kind | None, int]:
    """Return quantity, kind and rank of the words of a name."""
    if words & _EXCLUDED:
        return None, None, 0
    if axis is None:
        return _meaning_without_axis(words)
    if words & {"delta", "dtheta", "dvel", "dv"}:
        if words & {"theta", "angle", "dtheta"}:
            return "angle", "deltas", 0
        if words & {"vel", "velocity", "v", "dvel", "dv"}:
            return "velocity", "deltas", 0
        return None, None, 0
    kind: Kind | None = None
    if words & {"uncomp", "uncompensated", "raw"}:
        kind = "uncompensated"
    elif words & {"comp", "compensated"} or {"angular", "rate"} <= words:
        kind = "compensated"
    if words & {"angular", "ang"} and words & {"velocity", "vel"}:
        return "gyro", kind, len(words - _NEUTRAL - {"ang"})
    for sensor in ("gyro", "accel", "mag"):
        if words & _SENSORS[sensor]:
            return sensor, kind, len(words - _SENSORS[sensor] - _NEUTRAL)
    return None, None, 0
