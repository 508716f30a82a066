"""Lines and where they come from: which number of a line is which channel, in which unit.

They come from the URL, or the first lines show them, as the head of a file does (`files.printed_log`, `files.columns`).
A recording keeps them as settings of the device, so that it can be decoded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from imumon.model.errors import ImumonError
from imumon.model.ledger import ColumnUse
from imumon.model.report import MOST_CHARACTERS
from imumon.model.report_json import plain
from imumon.model.samples import CHANNELS, INERTIAL, ChannelName, Floats, Stream
from imumon.sources.device import InvalidOption
from imumon.sources.files.base import ReadOptions
from imumon.sources.files.column_names import named_channel
from imumon.sources.files.column_reader import read_columns
from imumon.sources.files.columns import Column, Reading, parse_map
from imumon.sources.files.unit_grammar import known_unit

SENSORS = {
    "gyro": "gyro", "accel": "accel", "mag": "mag", "temp": "temperature", "pressure": "pressure", "time": "t"
}  # fmt: skip
"""Quantity of each parameter that gives a unit."""

SI = {"gyro": "rad/s", "accel": "m/s^2", "mag": "gauss", "temperature": "degC", "pressure": "kPa"}
"""Units of columns that the URL names without one."""

NAMES_CURE = "write t_s, t_ms, t_us or t_ns, gx to gz, ax to az, mx to mz, temp, or - for a column to ignore"


@dataclass(frozen=True, slots=True)
class LineColumns:
    """Meaning of the numbers of a record.

    Attributes
    ----------
    count : numbers of a record.
    time : columns of the time; two are added; empty: there is none.
    used : columns of the channels, in the order of `stream.channels`.
    stream : stream of the samples.
    settings : what `columns_of`, or the first lines, make the same from.
    inertial : number of leading channels of gyroscope and accelerometer: a sample has all of them.
    account : what became of each column; two layouts do not differ by it.
    caveats : codes of what is assumed.
    """

    count: int
    time: tuple[Column, ...]
    used: tuple[Column, ...]
    stream: Stream
    settings: Mapping[str, str]
    inertial: int
    account: tuple[ColumnUse, ...] = field(default=(), compare=False)
    caveats: tuple[str, ...] = ()

    @property
    def wrapping_ns(self) -> int:
        """Unit of the time, ns, if it is a counter that wraps; 0: it does not wrap, or there is no time."""
        # those of Arduino and MicroPython do; no board is known whose counter of s or ns wraps
        unit_ns = self.time[0].factor if len(self.time) == 1 else 0.0
        return int(unit_ns) if unit_ns in (1e6, 1e3) else 0


@dataclass(frozen=True, slots=True)
class LinesUrl:
    """Parts of a value of ``--port``: path or URL of the port, bit/s, Hz, name, and settings of the columns."""

    path: str
    baud: int
    rate_hz: float | None
    id: str
    settings: Mapping[str, str]


def units_of(settings: Mapping[str, str]) -> dict[str, str]:
    """Return the units that parameters give, by quantity; raise `InvalidOption` if one of them is none."""
    units = {}
    for name, quantity in SENSORS.items():
        if name in settings:
            known = known_unit(settings[name], quantity)
            if known is None or known.quantity != quantity:
                text = f"{settings[name]!r} is no unit of {quantity}"
                raise InvalidOption(
                    "lines_unit_invalid", text, "write one such as rad/s, deg/s, m/s^2, g, uT, ms"
                )
            units[quantity] = settings[name]
    return units


def columns_of(settings: Mapping[str, str]) -> LineColumns:
    """Return the columns that parameters of a URL, or settings of a recording, give.

    Raises
    ------
    InvalidOption : a name or a unit is unknown, or there is neither a gyroscope nor an accelerometer.
    """
    names = [name.strip() for name in settings["columns"].split(",")]
    fields = _fields_of(names, units_of(settings))
    if not any(ChannelName(channel).sensor in INERTIAL for channel in fields):
        text = f"columns={settings['columns']} name no gyroscope and no accelerometer"
        raise InvalidOption("lines_columns_invalid", text, "write for example columns=t_ms,gx,gy,gz,ax,ay,az")
    try:
        reading = read_columns(names, (), np.empty((0, len(names))), ReadOptions(columns=fields))
    except ImumonError as error:
        raise InvalidOption("lines_columns_invalid", error.message, error.cure) from None
    kept = ",".join(
        name if k in {u for use in reading.uses for u in use.columns} else "-" for k, name in enumerate(names)
    )
    given = {name: settings[name] for name in SENSORS if name in settings}
    return line_columns(reading, {"columns": kept} | given)


def _fields_of(names: Sequence[str], units: Mapping[str, str]) -> dict[str, str]:
    """Return the number and the unit of the column of each channel; raise `InvalidOption` of an unknown name."""
    fields: dict[str, str] = {}
    for k, name in enumerate(names):
        if name in ("-", ""):
            continue
        channel, unit = named_channel(name)
        if channel not in (*CHANNELS, "t") or channel in fields:
            raise InvalidOption(
                "lines_columns_invalid", f"lines: has no column {name!r}, or it is there twice", NAMES_CURE
            )
        sensor = ChannelName(channel).sensor
        unit = unit or units.get(sensor, "") or SI.get(sensor, "")
        _check_unit(name, unit, sensor)
        fields[channel] = f"{k + 1}:{unit}"
    return fields


def _check_unit(name: str, unit: str, sensor: str) -> None:
    """Raise `InvalidOption` if a column has no unit, or one of another quantity."""
    if not unit:
        raise InvalidOption(
            "lines_columns_invalid", f"the time {name!r} has no unit", "write t_s, t_ms, t_us or t_ns"
        )
    known = known_unit(unit, sensor)
    if known is None or known.quantity != sensor:
        raise InvalidOption(
            "lines_unit_invalid", f"{unit!r} is no unit of {sensor}", "write one such as deg/s, g, ms"
        )


def line_columns(reading: Reading, settings: Mapping[str, str]) -> LineColumns:
    """Return the columns that a reading of the first lines has."""
    layout = reading.layout()
    channels = layout.channels
    used = {column.index for column in layout.used}
    source = ",".join(plain(name) if k in used else "-" for k, name in enumerate(reading.names))[
        :MOST_CHARACTERS
    ]
    stream = Stream(
        layout.kind,
        channels,
        f"lines of {source}",
        "startup" if layout.times else "none",
        None,
        layout.gyro,
        layout.accel,
    )
    ignored = {k: "columns= ignores it" for k, name in enumerate(reading.names) if name == "-"}
    account = layout.account(reading.names, {**reading.unused, **ignored})
    inertial = sum(channel.sensor in INERTIAL for channel in channels)
    return LineColumns(
        len(reading.names), layout.times, layout.columns, stream, settings, inertial, account, layout.caveats
    )


def first_columns(
    names: tuple[str, ...],
    units: tuple[str, ...],
    rows: Floats,
    settings: Mapping[str, str],
    rate_hz: float | None,
) -> Reading:
    """Return what the numbers of the first lines are; raise `ImumonError` if they are none of a sensor."""
    columns = parse_map(settings["map"]) if "map" in settings else None
    options = ReadOptions(columns=columns, rate_hz=rate_hz, units={
        {"t": "time"}.get(quantity, quantity): unit for quantity, unit in units_of(settings).items()
    })  # fmt: skip
    return read_columns(names, units, rows, options)
