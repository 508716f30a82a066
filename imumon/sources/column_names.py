"""Column names: quantity, axis, kind and unit in the names of the columns of a table.

The same quantity is named `gyro_x [rad/s]`, `IMU::UncompGyro::X [rad/s]`, `angular_velocity.x`, `G_X [mdps]`,
`xgyro` or `wx`. Two readings of a header supplement each other; tables, arrays, topics and lines share both.

A name alone (`parse_name`)
    It is split into words. The first or last word is the axis, the others are the sensor, its processing (compensated
    or not) and the unit. Without a unit, the values are in SI units.
Three names together (`triples`)
    A sensor has three axes, so its columns have names that differ in nothing but the axis: x, y, z; 0, 1, 2; 1, 2, 3;
    roll, pitch, yaw. Wherever these stand, three such names are a triple, and what they have in common is the name of
    its sensor. A fourth name of the kind (``w``, ``[3]``) makes a quaternion or a list of it, and no sensor.

The quantity of a triple follows from its unit, then from its name, then from its size (`size_of_triple`): deg/s is a
rate and m/s2 an acceleration, whatever the name says. Where unit and name contradict each other, the unit decides, and
`Column.doubt` reports it. A triple of which nothing shows the quantity is not used.

>>> [column.channel for column in parse_names(["t", "G_X [mdps]", "G_Y [mdps]", "G_Z [mdps]"])]
['t', 'gyro/x', 'gyro/y', 'gyro/z']
>>> [column.channel for column in parse_names(["acc_2", "acc_0", "acc_1"])]
['accel/z', 'accel/x', 'accel/y']
>>> [column.quantity for column in parse_names(["q_x", "q_y", "q_z", "q_w"])]
[None, None, None, None]
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imumon.model.samples import AXES, Kind
from imumon.model.units import STANDARD_GRAVITY

ZERO_CELSIUS = 273.15
"""K."""
_RATE = {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": math.radians(1.0), "mdeg/s": math.radians(1e-3),
         "deg/h": math.radians(1.0) / 3600.0}  # fmt: skip
_ACCELERATION = {
    "m/s2": 1.0,
    "g": STANDARD_GRAVITY,
    "mg": STANDARD_GRAVITY / 1e3,
    "ug": STANDARD_GRAVITY / 1e6,
    "mm/s2": 1e-3,
    "cm/s2": 1e-2,
}
UNITS: Mapping[str, Mapping[str, float]] = {
    "gyro": _RATE,
    "accel": _ACCELERATION,
    "angle": {"rad": 1.0, "deg": math.radians(1.0), "mrad": 1e-3, "urad": 1e-6, "mdeg": math.radians(1e-3)},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "g*s": STANDARD_GRAVITY},
    "mag": {"gauss": 1.0, "mgauss": 1e-3, "t": 1e4, "mt": 10.0, "ut": 1e-2, "nt": 1e-5},
    "temperature": {"degc": 1.0, "k": 1.0},
    "pressure": {"kpa": 1.0, "pa": 1e-3, "hpa": 0.1, "mbar": 0.1, "bar": 100.0},
    "t": {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0, "100us": 1e5},
    "dt": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
}
"""Factor of each unit by quantity: to SI, gauss, degC, kPa; times to ns, intervals to s."""

_SPELLINGS = {
    spelling: unit
    for unit, spellings in (
        (
            "rad/s",
            "rads-1 rads radps rad/sec r/s rps radpersec radpersecond rad/second radians/s radians/sec "
            "radians/second",
        ),
        (
            "deg/s",
            "degs-1 degs degps deg/sec dps d/s degpersec degpersecond deg/second degree/s degree/sec "
            "degree/second degrees/s degrees/sec degrees/second",
        ),
        ("mdeg/s", "mdps mdegs mdegps"),
        ("mrad/s", "mradps mrads"),
        ("deg/h", "deg/hr dph"),
        ("m/s2", "ms-2 m/s/s mps2 mss mpss ms2 m/sec2 m/sec/sec meter/s2 meters/s2 meters/sec2"),
        ("mm/s2", "mms-2 mm/s/s mmps2"),
        ("cm/s2", "cms-2 gal"),
        ("g", "gn gee gforce g-force"),
        ("t", "tesla"),
        ("ut", "microt"),
        ("degc", "c celsius"),
        ("k", "kelvin"),
        ("s", "sec secs second seconds sek sekunden secondes"),
        ("ms", "msec millis milliseconds millisekunden millisecondes"),
        ("us", "usec micros microseconds"),
        ("ns", "nsec nsecs nanosec nanoseconds"),
        ("m/s", "ms-1 mps"),
        ("g*s", "gs g.s gsec"),
        ("rad", "radians"),
        ("deg", "degrees"),
    )
    for spelling in spellings.split()
}
"""Other spellings of the units."""

_PER_SENSOR = {
    ("mag", "gs"): "gauss",
    ("mag", "g*s"): "gauss",
    ("mag", "g"): "gauss",
    ("mag", "mg"): "mgauss",
    ("t", "ticks10khz"): "100us",
}

_SENSORS = {
    "gyro": {
        "gyro",
        "gyr",
        "gyros",
        "gyroscope",
        "omega",
        "w",
        "rate",
        "rates",
        "rotation",
        "angvel",
        "omg",
        "pqr",
    },
    "accel": {
        "accel",
        "acc",
        "accels",
        "acceleration",
        "accelerometer",
        "accelerations",
        "a",
        "force",
        "f",
        "accl",
    },
    "mag": {"mag", "magn", "magnetic", "magnetometer", "compass", "m", "magnetism"},
    "temperature": {"temp", "temperature"},
    "pressure": {"pres", "press", "pressure", "baro"},
}
SENSOR_WORDS = {"gyro": {"gyro", "gyr", "gyroscope"}, "accel": {"accel", "acc", "accelerometer"}}
"""Words that name an inertial sensor even without an axis."""

NO_SENSOR = {
    "user", "gravity",  # a phone has split its acceleration into these by a filter
    "cov", "covariance", "var", "variance", "std", "sigma", "bias", "offset", "error", "ned", "enu",
    "world", "inertial", "orientation", "quaternion", "quat", "ypr", "status", "valid", "ok", "week",
    "cycle", "flag", "flags", "tflags"
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

_INCREMENTS = {"delta", "increment", "increments", "incremental", "incr", "dtheta", "dvel", "dv", "dang"}
"""Words of what a sensor has summed up over the interval of a sample."""

_AXIS_SUFFIX = re.compile(r"^(w|g|gyr|gyro|omega|rate|a|acc|accel|f|m|mag)([xyz])$")
_NO_TIME_RANK = 9
"""Rank of a column that is the nanoseconds of a stamp: the last choice of a time."""

_TIMES = {"t": 0, "time": 0, "timestamp": 0, "stamp": 1, "startup": -2, "sec": 2, "secs": 2, "seconds": 2,
          "ts": 0, "utime": 1, "datetime": 1, "elapsed": 1, "epoch": 1, "epoc": 1, "tow": 1, "uptime": 1}  # fmt: skip
"""Words of a time, with their rank: the lower is preferred."""

_TICKS = {"ms", "us", "msec", "usec", "millis", "micros", "milliseconds", "microseconds"}
"""Names of a time that are its unit, without another word."""

_SECONDS = {"secs", "seconds", *_TICKS}
"""Words of a time that are its unit; ``sec`` alone may be a part of a stamp."""
NANOSECONDS = {"nsec", "nsecs", "nanosec", "nanosecs"}
_INTERVALS = ({"dt"}, {"delta", "time"}, {"delta", "t"})

_FINE_TIMES = {"sample", "time", "fine"}
"""Words of SampleTimeFine of Xsens, which counts 100 us (MT Low-Level Communication Protocol, Xsens MT0101P)."""

_NO_UNIT = re.compile(r"(0x|x)?[0-9a-f]{3,}|[+-]?\d*|txt|text|utc|lsb|counts?|raw|digits?", re.IGNORECASE)
"""What brackets at the end of a name hold that is no unit: code of a field, time zone, kind of cell, counts."""

_AXIS_NUMBERS = {"0", "1", "2", "3"}

_RATES = ("p", "q", "r")
"""Rates about x, y, z where each letter is a word: the names of flight mechanics (ISO 1151-1)."""

_LETTERS = (
    AXES,
    ("0", "1", "2"),
    ("1", "2", "3"),
    ("roll", "pitch", "yaw"),
    ("beta", "gamma", "alpha"),
    _RATES,
)
"""Names of three axes in columns; beta, gamma, alpha are x, y, z of a browser (W3C Device Orientation)."""

_FOURTH = {"x": ("w",), "0": ("3",), "1": ("0", "4"), "roll": (), "beta": (), "p": ()}
"""Names beside those of three axes that make a quaternion or a list of them, by the first of the three."""

_GLUED = {
    "gyro": re.compile("gyro|angular(rate|vel)|angvel"),
    "accel": re.compile("accel|^acc(?![uo])"),
    "mag": re.compile("^mag(?!n?itude)"),
}
"""Sensors in words without a boundary, such as ``gyroadc``."""

_AXIS_NAMES = re.compile(
    r"roll|pitch|yaw|alpha|beta|gamma|[wxyz]|(?<![a-z])[pqr](?![a-z])|(?<!\d)\d(?!\d)", re.IGNORECASE
)
_WITH_AXES = ("gyro", "accel", "mag", "angle", "velocity")


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
    scale : units in a number of the column, such as 1/131 of counts; 1: the numbers have the unit.
    doubt : why the quantity may be another one, for people; empty: nothing contradicts it.
    """

    index: int
    name: str
    quantity: str | None = None
    axis: str | None = None
    kind: Kind | None = None
    unit: str | None = None
    rank: int = 0
    unknown_unit: str | None = None
    scale: float = 1.0
    doubt: str = ""

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
        return self.scale * (
            1.0 if self.unit is None or self.quantity is None else UNITS[self.quantity][self.unit]
        )


@dataclass(frozen=True, slots=True)
class Triple:
    """Three columns whose names differ only by the axis.

    Attributes
    ----------
    indices : places of the axes x, y, z in the table.
    names : of the axes, as in the table.
    stems : the text before and behind the axis in each name, without a unit in brackets.
    """

    indices: tuple[int, ...]
    names: tuple[str, ...]
    stems: tuple[tuple[str, str], ...]


def triples(names: Sequence[str]) -> list[Triple]:
    """Return the triples of a header, in the order of their first columns; each column belongs to one at most.

    >>> [triple.names for triple in triples(["t", "vRoll", "vPitch", "vYaw", "m[0]", "m[1]", "m[2]", "m[3]"])]
    [('vRoll', 'vPitch', 'vYaw')]
    """
    complete = []
    for (first, _, _), axes in _names_without_axis(names).items():
        letters = next(letters for letters in _LETTERS if letters[0] == first)
        if all(letter in axes for letter in letters) and not any(other in axes for other in _FOURTH[first]):
            of_axes = [axes[letter] for letter in letters]
            indices = tuple(index for index, _, _ in of_axes)
            stems = tuple((before, behind) for _, before, behind in of_axes)
            complete.append(Triple(indices, tuple(names[k] for k in indices), stems))
    counts = Counter(index for triple in complete for index in triple.indices)
    # a column of two triples is an element of a matrix
    alone = [triple for triple in complete if all(counts[index] == 1 for index in triple.indices)]
    return sorted(alone, key=lambda triple: min(triple.indices))


def _names_without_axis(names: Sequence[str]) -> dict[tuple[str, str, str], dict[str, tuple[int, str, str]]]:
    """Return the columns whose names differ only by a letter of an axis, or by a fourth one beside these.

    The key is the first of the letters of `_LETTERS`, and the text before and behind the letter, in lower case. The
    value has, by each letter, the place of its column, and both stems as in the table.
    """
    places: dict[tuple[str, str, str], dict[str, tuple[int, str, str]]] = {}
    for index, name in enumerate(names):
        base = split_unit(name)[0]
        for match in _AXIS_NAMES.finditer(base):
            before, letter, behind = base[: match.start()], match[0].lower(), base[match.end() :]
            for first, *_ in (axes for axes in _LETTERS if letter in axes or letter in _FOURTH[axes[0]]):
                # the first of two columns with one name; the other is no part of a triple
                places.setdefault((first, before.lower(), behind.lower()), {}).setdefault(
                    letter, (index, before, behind)
                )
    return places


def parse_names(names: Sequence[str]) -> list[Column]:
    """Return the meaning of each column of a table, from its name and from the triple that it belongs to."""
    columns = [parse_name(k, name) for k, name in enumerate(names)]
    for triple in triples(names):
        if len({columns[k].axis for k in triple.indices} & set(AXES)) == len(AXES) and not any(
            _contradicts(columns[k]) for k in triple.indices
        ):
            continue
        for axis, index, stem in zip(AXES, triple.indices, triple.stems, strict=True):
            columns[index] = _column_of_triple(index, names[index], axis, *stem)
    return columns


def _contradicts(column: Column) -> bool:
    """Return whether the unit of a column is known, but not of the quantity that its name shows."""
    return column.unknown_unit is not None and any(
        unit_of(column.unknown_unit, quantity) for quantity in UNITS
    )


def _column_of_triple(index: int, name: str, axis: str, before: str, behind: str) -> Column:
    """Return an axis of a triple, which is between two parts of its name."""
    words, suffix = _suffix([*words_of(before), axis, *words_of(behind)])
    words = [word for word in words if word != axis]
    unit = split_unit(name)[1] or suffix
    if set(words) & NO_SENSOR:
        return Column(index, name.strip())
    by_name, kind, rank = _meaning_in_triple(words, axis)
    by_unit = _quantity_of_unit(unit, by_name, set(words))
    quantity = by_unit or by_name or ("gyro" if _is_rate(name, set(words)) else None)
    if quantity is None:
        return Column(index, name.strip())
    known = None if unit is None else unit_of(unit, quantity)
    doubt = ""
    if by_name is not None and by_unit not in (None, by_name):
        doubt = f"the name is that of a {by_name} and the unit {unit} that of {quantity}: the unit decides"
    unknown = unit if known is None else None
    kind = "deltas" if quantity in ("angle", "velocity") else kind if quantity == by_name else None
    return Column(index, name.strip(), quantity, axis, kind, known, rank, unknown, doubt=doubt)


def _meaning_in_triple(words: Sequence[str], axis: str) -> tuple[str | None, Kind | None, int]:
    """Return quantity, kind and rank of the words of an axis of a triple: they may also be glued, or g for gyro."""
    by_name, kind, rank = _meaning({"gyro" if word == "g" else word for word in words}, axis)
    if by_name is None:
        by_name = next((s for s, p in _GLUED.items() if any(map(p.search, words))), None)
        rank = len(words)
    return by_name, kind, rank


def _is_rate(name: str, words: set[str]) -> bool:
    """Return whether a name that says no sensor is that of a rate of rotation: rollspeed of MAVLink, or p, q, r."""
    turns = re.search("roll|pitch|yaw", name, re.IGNORECASE) is not None
    return (turns and bool(words & {"speed", "velocity"})) or split_unit(name)[0].lower() in _RATES


def _quantity_of_unit(unit: str | None, by_name: str | None, words: set[str]) -> str | None:
    """Return the quantity that a unit shows; None: several, or none of a sensor with three axes."""
    if unit is None:
        return None
    of_unit = [quantity for quantity in _WITH_AXES if unit_of(unit, quantity)]
    if by_name in of_unit:
        return by_name
    # an angle or a velocity is that of a body, such as its attitude, unless the name is that of an increment
    if not words & _INCREMENTS:
        of_unit = [quantity for quantity in of_unit if quantity not in ("angle", "velocity")]
    return of_unit[0] if of_unit else None


def unit_of(text: str, quantity: str) -> str | None:
    """Return a unit as in `UNITS`; None if it is unknown.

    >>> unit_of("rad s^-1", "gyro"), unit_of("m/s²", "accel"), unit_of("furlong", "accel")
    ('rad/s', 'm/s2', None)
    >>> unit_of("℃", "temperature"), unit_of("m/(s^2)", "accel"), unit_of("deg.s^-1", "gyro"), unit_of("º/s", "gyro")
    ('degc', 'm/s2', 'deg/s', 'deg/s')
    """
    # a raised o and a ring are written for the sign of degrees
    text = text.replace("º", "°").replace("˚", "°")
    # NFKC: the sign for degrees Celsius is a degree and a C, a raised 2 is a 2
    unit = unicodedata.normalize("NFKC", text).lower().replace("μ", "u").replace("°", "deg")
    unit = re.sub(r"[\s^*·._()]+|sqrt", "", unit)
    unit = _SPELLINGS.get(unit, unit)
    unit = _PER_SENSOR.get((quantity, unit), unit)
    return unit if unit in UNITS[quantity] else None


def parse_name(index: int, name: str) -> Column:
    """Return quantity, axis, kind and unit by the name of a column alone; see `parse_names`.

    >>> column = parse_name(3, "IMU::UncompGyro::X [rad/s]")
    >>> column.quantity, column.axis, column.kind, column.unit
    ('gyro', 'x', 'uncompensated', 'rad/s')
    >>> parse_name(0, "linear_acceleration.z").quantity, parse_name(0, "GyroX_dps").unit
    ('accel', 'deg/s')
    >>> parse_name(0, "T [°C]").quantity
    'temperature'
    """
    words, axis, unit = _parts(name)
    if set(words) >= _FINE_TIMES and axis is None:
        return Column(index, name.strip(), "t", unit="100us")
    quantity, kind, rank = _meaning(set(words), axis)
    if quantity is None:
        return Column(index, name)
    if quantity == "t" and unit and not unit_of(unit, "t") and unit_of(unit, "temperature"):
        quantity = "temperature"
    unit = unit or next((word for word in words if quantity == "t" and word in _SECONDS), None)
    known = None if unit is None else unit_of(unit, quantity)
    return Column(index, name.strip(), quantity, axis, kind, known, rank, unit if known is None else None)


def assigned_column(
    index: int, name: str, quantity: str, axis: str | None, unit: str | None, scale: float = 1.0
) -> Column:
    """Return a column that the user has assigned; without a given unit, that of the name applies.

    >>> assigned_column(2, "p [deg/s]", "gyro", "x", None).unit
    'deg/s'
    """
    written = _parts(name)[2]
    unit = unit or (None if written is None else unit_of(written, quantity))
    return Column(index, name, quantity, axis, unit=unit, rank=-1, scale=scale)


def split_unit(name: str) -> tuple[str, str | None]:
    """Return a name without brackets at its end, and the unit in them; the number of an axis remains there.

    >>> split_unit("gyroADC[0]"), split_unit("acc x (m/(s^2))"), split_unit("X Accel [x8004]")
    (('gyroADC[0]', None), ('acc x', 'm/(s^2)'), ('X Accel', None))
    """
    text = name.strip().strip("\"'").lstrip("#% ")
    match = re.search(r"\s*(?:\[([^\[\]]*)\]|\(((?:[^()]|\([^()]*\))*)\))\s*$", text)
    if match is None:
        return text, None
    inside = (match[1] if match[1] is not None else match[2]).strip()
    if inside in _AXIS_NUMBERS:
        return text, None
    return text[: match.start()], None if _NO_UNIT.fullmatch(inside) else inside


def _parts(name: str) -> tuple[list[str], str | None, str | None]:
    """Return the words of a name, its axis, and its unit as written there."""
    text, unit = split_unit(name)
    axis = None
    if match := re.search(r"[\[(]([012])[\])]$", text):
        text, axis = text[: match.start()], AXES[int(match[1])]
    words, suffix = _suffix(words_of(text))
    for place in (-1, 0):  # gyro_x, also X-Beschleunigung
        if axis is None and len(words) > (place == 0) and words[place] in AXES:
            axis = words.pop(place)
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
    if times := words & set(_TIMES):
        rest = words - set(_TIMES) - _NEUTRAL - {"header", "startup"}
        return "t", None, max(min(_TIMES[word] for word in times) + 3 * len(rest) + 2, 0)
    for sensor, names in SENSOR_WORDS.items():
        if words & names:
            return sensor, None, len(words)
    return None, None, 0


def _meaning(words: set[str], axis: str | None) -> tuple[str | None, Kind | None, int]:
    """Return quantity, kind and rank of the words of a name."""
    if words & NO_SENSOR:
        return None, None, 0
    if axis is None:
        return _meaning_without_axis(words)
    if words & _INCREMENTS:
        if words & {"theta", "angle", "angles", "ang", "angular", "dtheta", "dang", "rotation"}:
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
