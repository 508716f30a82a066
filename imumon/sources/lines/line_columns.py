"""Lines and where they come from: which number of a line is which channel, in which unit.

They come from the URL, or the first lines show them, as the head of a file does (`files.printed_log`, `files.columns`).
A recording keeps them as settings of the device, so that it can be decoded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imumon.model.errors import ImumonError
from imumon.model.ledger import ColumnUse
from imumon.model.report import MOST_CHARACTERS
from imumon.model.report_json import plain
from imumon.model.samples import CHANNELS, ChannelName, Stream
from imumon.sources.device import InvalidOption
from imumon.sources.files.base import ReadOptions, RecordingError
from imumon.sources.files.column_names import named_channel
from imumon.sources.files.column_reader import read_columns
from imumon.sources.files.columns import ColumnLayout, Reading, check_meaning, parse_map

SENSORS = {
    "gyro": "gyro", "accel": "accel", "mag": "mag", "temp": "temperature", "pressure": "pressure", "time": "time"
}  # fmt: skip
"""What each parameter gives the unit of."""

SI = {"gyro": "rad/s", "accel": "m/s^2", "mag": "gauss", "temperature": "degC", "pressure": "kPa"}
"""Units of columns that the URL names without one."""

NAMES_CURE = "write t_s, t_ms, t_us or t_ns, gx to gz, ax to az, mx to mz, temp, or - for a column to ignore"


@dataclass(frozen=True, slots=True)
class LineColumns:
    """Meaning of the numbers of a record.

    Attributes
    ----------
    layout : columns that are used.
    stream : stream of the samples.
    settings : what `columns_of`, or the first lines, make the same from.
    account : what became of each column.
    """

    layout: ColumnLayout
    stream: Stream
    settings: Mapping[str, str]
    account: tuple[ColumnUse, ...]

    @property
    def caveats(self) -> tuple[str, ...]:
        """Codes of what is assumed."""
        return self.layout.caveats


@dataclass(frozen=True, slots=True)
class LinesUrl:
    """Parts of a value of ``--port``: path or URL of the port, bit/s, Hz, name, and settings of the columns."""

    path: str
    baud: int
    rate_hz: float | None
    id: str
    settings: Mapping[str, str]


def read_options(settings: Mapping[str, str], rate_hz: float | None) -> ReadOptions:
    """Return how the first lines are read; raise `InvalidOption` if a parameter gives no unit, or no map."""
    units = {quantity: settings[name] for name, quantity in SENSORS.items() if name in settings}
    _check_units(units)
    try:
        columns = parse_map(settings["map"]) if "map" in settings else None
    except ImumonError as error:
        raise InvalidOption("lines_columns_invalid", error.message, error.cure) from None
    return ReadOptions(columns=columns, rate_hz=rate_hz, units=units, accept="accept" in settings)


def _check_units(units: Mapping[str, str]) -> None:
    """Raise `InvalidOption` if one of the units, by quantity, is none."""
    try:
        check_meaning(units, None)
    except ImumonError as error:
        raise InvalidOption("lines_unit_invalid", error.message, error.cure) from None


def columns_of(settings: Mapping[str, str]) -> LineColumns:
    """Return the columns that parameters of a URL, or settings of a recording, give.

    Raises
    ------
    InvalidOption : a name or a unit is unknown, or there is neither a gyroscope nor an accelerometer.
    """
    names = [name.strip() for name in settings["columns"].split(",")]
    units = {**SI, **read_options(settings, None).units}
    fields: dict[str, str] = {}
    for k, name in enumerate(names):
        if name in ("-", ""):
            continue
        channel, unit = named_channel(name)
        if channel not in (*CHANNELS, "t") or channel in fields:
            raise _invalid(f"lines: has no column {name!r}, or it is there twice")
        quantity = "time" if channel == "t" else ChannelName(channel).sensor
        unit = unit or units.get(quantity, "")
        if not unit:
            raise _invalid(f"the time {name!r} has no unit")
        _check_units({quantity: unit})
        fields[channel] = f"{k + 1}:{unit}"
    try:
        reading = read_columns(names, (), np.empty((0, len(names))), ReadOptions(columns=fields))
    except ImumonError as error:
        raise _invalid(error.message) from None
    return line_columns(reading, {n: settings[n] for n in ("columns", *SENSORS) if n in settings})


def _invalid(text: str) -> InvalidOption:
    return InvalidOption("lines_columns_invalid", text, NAMES_CURE)


def line_columns(reading: Reading, settings: Mapping[str, str]) -> LineColumns:
    """Return the columns that a reading of the first lines has; raise `RecordingError` if they are increments."""
    layout = reading.layout()
    if layout.has_increments:  # without the interval of each they are no rates
        raise RecordingError("columns_unclear", "the numbers are increments", "print rates and accelerations")
    used = {column.index for column in layout.used}
    source = ",".join(plain(name) if k in used else "-" for k, name in enumerate(reading.names))
    stream = Stream(
        layout.kind,
        layout.channels,
        f"lines of {source[:MOST_CHARACTERS]}",
        "startup" if layout.times else "none",
        None,
        layout.gyro,
        layout.accel,
    )
    ignored = {k: "columns= ignores it" for k, name in enumerate(reading.names) if name == "-"}
    account = layout.account(reading.names, {**reading.unused, **ignored})
    return LineColumns(layout, stream, settings, account)
