"""Lines and where they come from: which number of a line is which channel, in which unit.

They come from the URL, from a header line in the stream, or are `DEFAULT_COLUMNS`. A recording keeps them as
settings of the device, so that it can be decoded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from imumon.column_names import UNITS, Column, parse_name, unit_of
from imumon.devices.base import InvalidOption
from imumon.samples import ACCEL, AXES, CHANNELS, GYRO, Stream

DEFAULT_COLUMNS = "t_ms,gx,gy,gz,ax,ay,az"
SENSORS = {"gyro": "gyro", "accel": "accel", "mag": "mag", "temp": "temperature", "pressure": "pressure"}
"""Quantity of each parameter that gives a unit."""


@dataclass(frozen=True, slots=True)
class LineColumns:
    """Meaning of the numbers of a line.

    Attributes
    ----------
    count : numbers of a line.
    time : column of the time; None: there is none.
    used : columns of the channels, in the order of `stream.channels`.
    stream : stream of the samples.
    settings : what `columns_of` makes the same from.
    inertial : number of leading channels of gyroscope and accelerometer: a sample has all of them.
    """

    count: int
    time: Column | None
    used: tuple[Column, ...]
    stream: Stream
    settings: Mapping[str, str]
    inertial: int

    @property
    def wrapping_ns(self) -> int:
        """Unit of a counter that wraps, ns; 0: the time is none."""
        return int(self.time.factor) if self.time is not None and self.time.unit in ("ms", "us") else 0

    def acceleration(self, values: Sequence[float]) -> float:
        """Return the length of the acceleration of a sample, m/s^2; 0.0 unless all three axes are there."""
        axes = [k for k, name in enumerate(self.stream.channels) if name.startswith("accel/")]
        return math.hypot(*(values[k] for k in axes)) if len(axes) == len(AXES) else 0.0


@dataclass(frozen=True, slots=True)
class LinesUrl:
    """Parts of a value of ``--port``: path or URL of the port, bit/s, Hz, name, and settings of the columns."""

    path: str
    baud: int
    rate_hz: float | None
    id: str
    settings: Mapping[str, str]


def columns_of(settings: Mapping[str, str]) -> LineColumns:
    """Return the columns that parameters of a URL, or settings of a recording, give.

    Raises
    ------
    InvalidOption : a name or a unit is unknown, or there is neither a gyroscope nor an accelerometer.
    """
    names = settings["columns"].split(",")
    columns = [_time_named(parse_name(k, name.strip())) for k, name in enumerate(names)]
    for name, column in zip(names, columns, strict=True):
        if column.quantity in (None, "angle", "velocity", "dt") and name.strip() not in ("-", ""):
            cure = "write t_s, t_ms, t_us or t_ns, gx to gz, ax to az, mx to mz, temp, or - for a column to ignore"
            raise InvalidOption("lines_columns_invalid", f"lines: has no column {name.strip()!r}", cure)
        if column.unknown_unit is not None:
            _known_unit(column.unknown_unit, column.quantity or "")
    found = _layout(columns, settings)
    if found is None:
        text = f"columns={settings['columns']} name no gyroscope and no accelerometer, or one twice"
        raise InvalidOption("lines_columns_invalid", text, f"write for example columns={DEFAULT_COLUMNS}")
    return found


def header_columns(cells: Sequence[str], settings: Mapping[str, str]) -> LineColumns | None:
    """Return the columns that a header line names; None: it is no header. Names without a meaning are ignored.

    >>> header_columns(["millis", "gyro_x", "seq"], {}).stream.channels
    ('gyro/x',)
    >>> header_columns(["MPU6050", "ready"], {}) is None
    True
    """
    if len(cells) < 2:
        return None
    columns = [_time_named(parse_name(k, cell)) for k, cell in enumerate(cells)]
    if any(column.unknown_unit is not None for column in columns):
        return None
    return _layout(columns, settings)


def _time_named(column: Column) -> Column:
    """Return a column that is named after the function of an Arduino as the time that it returns."""
    unit = {"millis": "ms", "micros": "us"}.get(column.name.lower())
    return column if unit is None else replace(column, quantity="t", unit=unit)


def _layout(columns: Sequence[Column], settings: Mapping[str, str]) -> LineColumns | None:
    """Return the columns with the units of the settings; None: nothing inertial is among them, or one is twice."""
    given = {name: settings[name] for name in SENSORS if name in settings}
    columns = _with_units(columns, given)
    used = sorted((c for c in columns if c.channel in CHANNELS), key=lambda c: CHANNELS.index(c.channel))
    channels = tuple(column.channel for column in used)
    inertial = [column for column in used if column.channel in (*GYRO, *ACCEL)]
    if not inertial or len(set(channels)) < len(channels):
        return None
    time = next((column for column in columns if column.quantity == "t"), None)
    kind = inertial[0].kind if len({column.kind for column in inertial}) == 1 else None
    source = ",".join(column.name if column in (*used, time) else "-" for column in columns)
    stream = Stream(
        kind or "unknown", channels, source=f"lines of {source}", clock="none" if time is None else "startup"
    )
    return LineColumns(len(columns), time, tuple(used), stream, {"columns": source} | given, len(inertial))


def _with_units(columns: Sequence[Column], given: Mapping[str, str]) -> list[Column]:
    """Return the columns; those whose names have no unit get the given one of their quantity."""
    units = {SENSORS[name]: _known_unit(text, SENSORS[name]) for name, text in given.items()}
    return [c if c.unit else replace(c, unit=units.get(c.quantity or "")) for c in columns]


def _known_unit(text: str, quantity: str) -> str:
    unit = unit_of(text, quantity) if quantity in UNITS else None
    if unit is None:
        known = ", ".join(UNITS.get(quantity, {}))
        raise InvalidOption(
            "lines_unit_invalid", f"{text!r} is no unit of {quantity}", f"write one of {known}"
        )
    return unit
