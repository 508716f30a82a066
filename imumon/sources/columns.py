"""Columns: which column of a table is which channel, in which unit, by its name.

People name the same thing `gyro_x [rad/s]`, `IMU::UncompGyro::X [rad/s]`, `angular_velocity.x`, `wx`.
A name is taken apart into words; the last word tells the axis, the others the sensor, what the sensor
has done to the values already, and the unit. Without a unit SI is meant. What a name does not tell,
`--map gyro/x=COLUMN:UNIT,...` does. This file knows no files: names in, `Layout` out.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from imumon.samples import ACCEL, AXES, GYRO, MAG, Kind, sensor_of
from imumon.sources.errors import SourceError

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

BY_HAND = "--map gyro/x=COLUMN:UNIT,..."
_PER_SENSOR = {("mag", "g"): "gauss", ("mag", "mg"): "mgauss"}

_SENSORS = {
    "gyro": {"gyro", "gyr", "gyros", "gyroscope", "omega", "w", "rate", "rates"},
    "accel": {"accel", "acc", "accels", "acceleration", "accelerometer", "accelerations", "a", "force"},
    "mag": {"mag", "magn", "magnetic", "magnetometer", "compass", "m"},
    "temperature": {"temp", "temperature"},
    "pressure": {"pres", "press", "pressure", "baro"},
}
_STRANGE = {
    *(
        "cov",
        "covariance",
        "var",
        "variance",
        "std",
        "sigma",
        "bias",
        "offset",
        "error",
        "ned",
        "enu",
        "world",
    ),
    *("inertial", "orientation", "quaternion", "quat", "ypr", "status", "valid", "ok", "week", "cycle"),
}
"""Words that make another thing of a name."""

_NEUTRAL = {
    *(
        "imu",
        "sensor",
        "data",
        "field",
        "msg",
        "rs",
        "s",
        "b",
        "body",
        "linear",
        "angular",
        "velocity",
        "vel",
    ),
    *(
        "time",
        "header",
        "stamp",
        "uncomp",
        "comp",
        "uncompensated",
        "compensated",
        "raw",
        "specific",
        "delta",
    ),
}
"""Words that change nothing."""

_LETTERS = re.compile(r"^(w|g|gyr|gyro|omega|rate|a|acc|accel|m|mag)([xyz])$")
_TIMES = {"t": 0, "time": 0, "timestamp": 0, "stamp": 1, "startup": -2, "sec": 2, "secs": 2, "seconds": 2}
_NANOSECONDS = {"nsec", "nsecs", "nanosec", "nanosecs"}
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


@dataclass(frozen=True, slots=True)
class Layout:
    """What of a table makes a stream.

    Attributes
    ----------
    kind : of the stream.
    channels, columns : the same number of each, in the order of the stream.
    times : columns of time, the best first; with `apart` two, seconds and nanoseconds to be added.
    interval : length of each sample's own interval, for deltas.
    """

    kind: Kind
    channels: tuple[str, ...]
    columns: tuple[Column, ...]
    times: tuple[Column, ...] = ()
    interval: Column | None = None
    apart: bool = False


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
    text, unit, axis = name.strip().strip("\"'").lstrip("#% "), None, None
    if found := re.search(r"[\[(]([^\])]*)[\])]\s*$", text):
        text, inside = text[: found.start()], found.group(1)
        if inside in ("0", "1", "2"):
            axis = AXES[int(inside)]
        else:
            unit = inside
    words = _words(text)
    words, suffix = _suffix(words)
    if axis is None and words and words[-1] in AXES:
        axis = words.pop()
    quantity, kind, doubt = _meaning(set(words), axis)
    if quantity is None:
        return Column(index, name)
    spoken = unit or suffix
    known = None if spoken is None else spelled(spoken, quantity)
    return Column(index, name.strip(), quantity, axis, kind, known, doubt, unit if known is None else None)


def _words(text: str) -> list[str]:
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
        if words & _NANOSECONDS:
            return "t", None, 9
        for name in ("temperature", "pressure"):
            if words & _SENSORS[name]:
                return name, None, len(words - _SENSORS[name] - _NEUTRAL)
        if at := words & set(_TIMES):
            rest = words - set(_TIMES) - _NEUTRAL - {"header", "startup"}
            return "t", None, max(min(_TIMES[word] for word in at) + 3 * len(rest) + 2, 0)
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


# ---------------------------------------------------------------- which columns are taken


def layout(names: Sequence[str], kind: Kind | None = None, given: Mapping[str, str] | None = None) -> Layout:
    """Columns of a stream.

    Parameters
    ----------
    names : of all columns.
    kind : which stream, where the table has several; None: the best.
    given : channel (also ``t``, ``dt``) to ``COLUMN`` or ``COLUMN:UNIT``, as a user says it; then the
        names say nothing.

    Raises
    ------
    SourceError : there is no complete gyroscope or accelerometer, or what is asked for is not there.
    """
    if given:
        return _given(names, kind, given)
    columns = [column for k, name in enumerate(names) if (column := understood(k, name)).quantity]
    for wanted in (kind,) if kind else ("deltas", "uncompensated", "compensated"):
        found = _stream(columns, wanted)
        if found is not None:
            _check_units(found)
            return found
    raise SourceError(_missing(names, columns, kind))


def _check_units(found: Layout) -> None:
    for column in (*found.columns, *found.times[:1], found.interval):
        if column is not None and column.unknown and column.quantity:
            known = _list(UNITS[column.quantity])
            raise SourceError(
                f"the unit {column.unknown!r} of column {column.name!r} is not known; known: {known}"
            )


def _stream(columns: Sequence[Column], kind: Kind) -> Layout | None:
    """Columns of a stream of that kind, None where it is not there."""
    if kind == "deltas":
        sets = [_triple(columns, "angle", kind), _triple(columns, "velocity", kind)]
    else:
        sets = [_triple(columns, sensor, kind) for sensor in ("gyro", "accel")]
        if not sets[0] and any(_triple(columns, "gyro", other) for other in ("uncompensated", "compensated")):
            return None  # its gyroscope is of the other kind
        if kind == "compensated" and not any(c.kind for c in columns if c.quantity == "gyro"):
            return None  # nothing says that it is compensated
    if not any(sets):
        return None
    rest = [_triple(columns, "mag", "uncompensated")]
    rest += [(one,) if (one := _best(columns, name)) else () for name in ("temperature", "pressure")]
    names = (GYRO, ACCEL, MAG, ("temperature",), ("pressure",))
    chosen = [(names[k], found) for k, found in enumerate([*sets, *rest]) if found]
    channels = tuple(name for group, _ in chosen for name in group)
    taken = tuple(c for _, found in chosen for c in found)
    times, apart = _times(columns)
    return Layout(kind, channels, taken, times, _best(columns, "dt"), apart)


def _triple(columns: Sequence[Column], quantity: str, kind: Kind) -> tuple[Column, ...]:
    """Axes of a sensor: of that kind, else such as say nothing, else any but deltas."""
    others: tuple[Kind | None, ...] = (kind, None, "uncompensated", "compensated")
    if kind == "deltas":
        others = ("deltas",)
    elif quantity == "gyro":
        others = (kind, None)
    for each in others:
        axes = [
            [c for c in columns if c.quantity == quantity and c.axis == axis and c.kind == each]
            for axis in AXES
        ]
        if all(axes):
            return tuple(min(found, key=lambda c: c.doubt) for found in axes)
    return ()


def _best(columns: Iterable[Column], quantity: str) -> Column | None:
    return min((c for c in columns if c.quantity == quantity), key=lambda c: c.doubt, default=None)


def _times(columns: Sequence[Column]) -> tuple[tuple[Column, ...], bool]:
    """Columns of time, the best first; or seconds and nanoseconds apart."""
    found = sorted((c for c in columns if c.quantity == "t"), key=lambda c: c.doubt)
    small = [c for c in found if set(_words(c.name)) & _NANOSECONDS]
    great = [c for c in found if set(_words(c.name)) & {"sec", "secs", "seconds"}]
    if small and great and "startup" not in _words(found[0].name):
        return (replace(great[0], unit="s"), replace(small[0], unit="ns")), True
    return tuple(found), False


def _given(names: Sequence[str], kind: Kind | None, given: Mapping[str, str]) -> Layout:
    """Columns as the user names them."""
    kind = kind or "uncompensated"
    found: dict[str, Column] = {}
    for channel, text in given.items():
        quantity = sensor_of(channel)
        if kind == "deltas":
            quantity = {"gyro": "angle", "accel": "velocity"}.get(quantity, quantity)
        found[channel] = _named(names, text, quantity)
    known = [*GYRO, *ACCEL, *MAG, "temperature", "pressure"]
    for group in (GYRO, ACCEL, MAG):
        lacking = [name for name in group if name not in found]
        if 0 < len(lacking) < 3:
            raise SourceError(f"--map names a part of a sensor only: {', '.join(lacking)} is missing")
    channels = tuple(name for name in known if name in found)
    if not set(channels) & {*GYRO, *ACCEL}:
        raise SourceError(
            "--map names neither gyroscope nor accelerometer: --map gyro/x=COLUMN:UNIT,gyro/y=..."
        )
    times = (found["t"],) if "t" in found else ()
    return Layout(kind, channels, tuple(found[name] for name in channels), times, found.get("dt"))


def _named(names: Sequence[str], text: str, quantity: str) -> Column:
    """Column by its name, with or without its own unit, or its number from 1; perhaps with ``:UNIT``."""
    bare = [re.sub(r"\s*[\[(][^\])]*[\])]\s*$", "", name.strip()) for name in names]
    whole = [name.strip() for name in names]
    tries: list[tuple[str, str | None]] = [(text, None)]
    if ":" in text:
        name, _, unit = text.rpartition(":")
        tries.insert(0, (name, spelled(unit, quantity)))
        if tries[0][1] is None and (name in (*bare, *whole) or name.isdigit()):
            raise SourceError(f"the unit {unit!r} in --map is not known; known: {_list(UNITS[quantity])}")
    for name, spoken in tries:
        for index, candidates in enumerate(zip(whole, bare, strict=True)):
            if name in candidates:
                return Column(
                    index, whole[index], quantity, unit=spoken or understood(index, whole[index]).unit
                )
        if name.isdigit() and 1 <= int(name) <= len(names):
            return Column(int(name) - 1, whole[int(name) - 1], quantity, unit=spoken)
    close = difflib.get_close_matches(tries[0][0], whole, 3, 0.3)
    raise SourceError(
        f"no column {tries[0][0]!r} for --map; " + (f"near: {_list(close)}" if close else _there(whole))
    )


def parse_map(text: str) -> dict[str, str]:
    """``gyro/x=wx:deg/s,t=stamp:ns`` as a dict.

    Raises
    ------
    ValueError : not of that form.
    """
    found = {}
    channels = (*GYRO, *ACCEL, *MAG, "temperature", "pressure", "t", "dt")
    for part in text.split(","):
        channel, equals, column = part.strip().partition("=")
        if not equals or channel not in channels:
            near = difflib.get_close_matches(channel, channels, 1, 0.3)
            raise ValueError(f"--map {part.strip()!r}: write {near[0] if near else 'gyro/x'}=COLUMN:UNIT")
        found[channel] = column.strip()
    return found


def _missing(names: Sequence[str], columns: Sequence[Column], kind: Kind | None) -> str:
    """What is lacking, what there is, and what is nearest."""
    if kind and any(_stream(columns, other) for other in ("deltas", "uncompensated", "compensated")):
        return f"there is no {kind} stream in it; without --stream the best there is will be taken"
    partly = [c for c in columns if c.quantity in ("gyro", "accel", "angle", "velocity")]
    if partly:
        told = _list(c.name for c in partly)
        return f"only {told} of gyroscope and accelerometer: three axes are needed, or {BY_HAND}"
    near = difflib.get_close_matches("gyro_x", [name.strip() for name in names], 3, 0.3)
    there = f"nearest: {_list(near)}" if near else _there([name.strip() for name in names])
    return f"no column is a gyroscope's or accelerometer's ({there}); name them with {BY_HAND}"


def _there(names: Sequence[str]) -> str:
    return f"there are {_list(names[:8])}{' ...' if len(names) > 8 else ''}"


def _list(words: Iterable[str]) -> str:
    return ", ".join(words)
