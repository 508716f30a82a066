"""Lines and where they come from: which number of a line is which channel, in which unit.

They come from the URL, from a header line in the stream, or are `DEFAULT_COLUMNS`. A recording keeps them as
settings of the device, so that it can be decoded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from imumon.grid.stamp_kinds import typical_step
from imumon.model.ledger import ColumnUse
from imumon.model.report import MOST_CHARACTERS
from imumon.model.report_json import plain
from imumon.model.samples import ACCEL, CHANNELS, FASTEST_HZ, GYRO, SLOWEST_HZ, Stream
from imumon.sources.column_names import UNITS, Column, parse_names, unit_of
from imumon.sources.device import InvalidOption
from imumon.sources.rest_sizes import is_one_g, median_size, too_noisy

if TYPE_CHECKING:
    from imumon.model.samples import Floats

DEFAULT_COLUMNS = "t,gx,gy,gz,ax,ay,az"
DEFAULT_UNIT = "ms"
"""Unit of a time without one that shows no rate: boards print `millis()`."""
USUAL_HZ = (0.7, 1400.0)
"""Hz, rates at which the unit of a time is inferred; they overlap those of the next unit by less than an octave."""
SENSORS = {
    "gyro": "gyro", "accel": "accel", "mag": "mag", "temp": "temperature", "pressure": "pressure", "time": "t"
}  # fmt: skip
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
    account : what became of each column; two layouts do not differ by it.
    """

    count: int
    time: Column | None
    used: tuple[Column, ...]
    stream: Stream
    settings: Mapping[str, str]
    inertial: int
    account: tuple[ColumnUse, ...] = field(default=(), compare=False)

    def with_unit(self, unit: str) -> LineColumns:
        """Return these columns with a unit of the time, which has none."""
        assert self.time is not None
        settings = {**self.settings, "time": unit}
        return replace(self, time=replace(self.time, unit=unit), settings=settings)

    @property
    def time_factor(self) -> float:
        """Factor of the time to ns; 1.0 before its unit is known, or without one."""
        return 1.0 if self.time is None else self.time.factor

    @property
    def wrapping_ns(self) -> int:
        """Unit of the time, ns, if it is a counter that wraps; 0: it does not wrap, or there is no time."""
        # those of Arduino and MicroPython do; no board is known whose counter of s or ns wraps
        return int(self.time.factor) if self.time is not None and self.time.unit in ("ms", "us") else 0


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
    columns = [_time_named(column) for column in parse_names([name.strip() for name in names])]
    for name, column in zip(names, columns, strict=True):
        if column.quantity in (None, "angle", "velocity", "dt") and name.strip() not in ("-", ""):
            cure = "write t_s, t_ms, t_us or t_ns, gx to gz, ax to az, mx to mz, temp, or - for a column to ignore"
            raise InvalidOption("lines_columns_invalid", f"lines: has no column {name.strip()!r}", cure)
        if column.unknown_unit is not None:
            _known_unit(column.unknown_unit, column.quantity or "")
    layout = _layout(columns, settings)
    if layout is None:
        text = f"columns={settings['columns']} name no gyroscope and no accelerometer, or one twice"
        raise InvalidOption("lines_columns_invalid", text, f"write for example columns={DEFAULT_COLUMNS}")
    return layout


def header_columns(cells: Sequence[str], settings: Mapping[str, str]) -> LineColumns | None:
    """Return the columns that a header line names; None: it is no header. Names without a meaning are ignored.

    >>> header_columns(["millis", "gyro_x", "seq"], {}).stream.channels
    ('gyro/x',)
    >>> header_columns(["MPU6050", "ready"], {}) is None
    True
    """
    if len(cells) < 2:
        return None
    columns = [_time_named(column) for column in parse_names(cells)]
    if any(column.unknown_unit is not None for column in columns):
        return None
    return _layout(columns, settings)


def _time_named(column: Column) -> Column:
    """Return a column named millis or micros, as in sketches for Arduino, as a time; others unchanged."""
    unit = {"millis": "ms", "micros": "us"}.get(column.name.lower())
    return column if unit is None else replace(column, quantity="t", unit=unit)


def _layout(columns: Sequence[Column], settings: Mapping[str, str]) -> LineColumns | None:
    """Return the columns with the units of the settings; None: nothing inertial is among them, or one is twice."""
    given = {name: settings[name] for name in SENSORS if name in settings}
    columns = _with_units(columns, given)
    # in the order of the channels, whatever that of the columns: inertial ones first, see `LineColumns.inertial`
    used = sorted((c for c in columns if c.channel in CHANNELS), key=lambda c: CHANNELS.index(c.channel))
    channels = tuple(column.channel for column in used)
    inertial = [column for column in used if column.channel in (*GYRO, *ACCEL)]
    if not inertial or len(set(channels)) < len(channels):
        return None
    time = next((column for column in columns if column.quantity == "t"), None)
    kinds = {column.kind for column in inertial}
    kind = kinds.pop() if len(kinds) == 1 else None  # columns that contradict each other say nothing
    # A recording keeps these names and is decoded by them: unused columns keep their places. They also name the
    # stream, so that another order of the columns is another record.
    source = ",".join(column.name if column in (*used, time) else "-" for column in columns)
    stream = Stream(
        kind or "unknown", channels, source=f"lines of {source}", clock="none" if time is None else "startup"
    )
    account = tuple(_use_of(column, used, time) for column in columns)
    return LineColumns(
        len(columns), time, tuple(used), stream, {"columns": source} | given, len(inertial), account
    )


def _use_of(column: Column, used: Sequence[Column], time: Column | None) -> ColumnUse:
    """Return what became of a column of lines."""
    name = plain(column.name)[:MOST_CHARACTERS]
    if column in used:
        return ColumnUse(name=name, use=column.channel)
    if column is time:
        return ColumnUse(name=name, use="time")
    reason = (
        "another column is the time" if column.quantity == "t" else "it has no name of a sensor or a time"
    )
    return ColumnUse(name=name, reason="columns= ignores it" if name in ("-", "") else reason)


def _with_units(columns: Sequence[Column], given: Mapping[str, str]) -> list[Column]:
    """Return the columns, with the given unit of its quantity where the name of a column has none."""
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


def proposed_settings(rows: Sequence[Sequence[float]]) -> str | None:
    """Return the parameters of a URL that lines of numbers fit, by their sizes; None: nothing shows them.

    Three numbers of one g are an accelerometer, three others beside them a gyroscope, a number that only grows in even
    steps before them a time.

    >>> still = [0.001, 0.002, 0.003, 0.1, 0.2, 9.8]
    >>> proposed_settings([[10.0 * k, *still] for k in range(30)])
    'columns=t_ms,gx,gy,gz,ax,ay,az'
    >>> proposed_settings([[0.01, 0.02, 0.99, *still[:3], 7.0] for k in range(30)])
    'columns=ax,ay,az,gx,gy,gz,-&accel=g'
    """

    numbers = np.array(rows, dtype=np.float64)
    width = numbers.shape[1]
    names, units = ["-"] * width, []
    begin = 0
    if (numbers[1:, 0] > numbers[:-1, 0]).all() and (unit := unit_of_time(numbers[:, 0])) is not None:
        names[0], begin = f"t_{unit}", 1
    accel = _accelerometer(numbers, begin)
    if accel is not None:
        names[accel[0] : accel[0] + 3] = ["ax", "ay", "az"]
        units += [] if accel[1] == "m/s2" else [f"accel={accel[1]}"]
    # beside the accelerometer, in front of it or behind it
    places = [begin] if accel is None else [accel[0] - 3, accel[0] + 3]
    gyro = next((k for k in places if begin <= k <= width - 3), None)
    if gyro is not None:
        names[gyro : gyro + 3] = ["gx", "gy", "gz"]
        units[:0] = ["gyro=deg/s"] if too_noisy(numbers[:, gyro : gyro + 3]) else []
    return None if accel is None and gyro is None else "&".join([f"columns={','.join(names)}", *units])


def unit_of_time(times: Floats) -> str | None:
    """Return the unit in which (n,) times are those of a sensor; None: they show no rate, or one of no sensor.

    It is the finest one in which their rate is usual, else the finest in which it is possible.

    >>> import numpy as np
    >>> [unit_of_time(step * np.arange(25.0)) for step in (0.01, 10.0, 2500.0, 1e7, 1e-4, 1e-7)]
    ['s', 'ms', 'us', 'ns', 's', None]
    """
    if len(times) < 2 or not (times[1:] > times[:-1]).any():
        return None
    step_ns = {unit: typical_step(times) * UNITS["t"][unit] for unit in ("s", "ms", "us", "ns")}
    for slowest, fastest in (USUAL_HZ, (SLOWEST_HZ, FASTEST_HZ)):
        if units := [unit for unit, ns in step_ns.items() if slowest <= 1e9 / ns <= fastest]:
            return units[-1]
    return None


def _accelerometer(numbers: Floats, begin: int) -> tuple[int, str] | None:
    """Return the first of three columns of (n, k) numbers whose size is one g, and the unit; None: there are none."""
    sizes = {k: median_size(numbers[:, k : k + 3]) or 0.0 for k in range(begin, numbers.shape[1] - 2)}
    units = ("m/s2", "g", "mg")
    return next(
        ((k, u) for u in units for k, size in sizes.items() if is_one_g(size * UNITS["accel"][u])), None
    )
