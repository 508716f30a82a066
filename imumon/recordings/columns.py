"""Columns of a table that form a stream.

A table may have several streams by the names of its columns (`column_names`); the best is used. ``--map
gyro/x=COLUMN:UNIT,...`` overrides what it names, and nothing else. `ColumnLayout.remarks` name every column
of a sensor that is not used. This module knows no files: names in, `ColumnLayout` out.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from imumon.column_names import (
    NANOSECONDS,
    SENSOR_WORDS,
    UNITS,
    Column,
    assigned_column,
    parse_name,
    unit_of,
    words_of,
)
from imumon.recordings.base import OptionError, RecordingError
from imumon.samples import AXES, CHANNELS, Kind, sensor_of

KINDS: tuple[Kind, ...] = ("deltas", "uncompensated", "compensated")
"""Kinds of streams, the best first; all but the first are of point samples."""

SENSORS = {"gyro": "gyro", "angle": "gyro", "accel": "accel", "velocity": "accel", "mag": "mag"}
"""Sensor with axes that a quantity belongs to."""

POINTS, INCREMENTS = ("gyro", "accel"), ("angle", "velocity")
"""Quantities of a gyroscope and an accelerometer, and their increments."""

INERTIAL = set(POINTS)
"""Sensors of which a table must have one."""

READ_ALONE = "read each alone, --sensor gyro and --sensor accel"
"""Cure for sensors of different rates."""

SIMILAR = 0.3
"""Similarity of names (difflib ratio) from which one is suggested for another."""

MOST_COLUMNS = 2000
"""Columns of the widest table: logs have some hundreds."""

LISTED = 8
"""Column names that a message lists."""

MAP_EXAMPLE = "--map gyro/x=COLUMN:UNIT,..."


@dataclass(frozen=True, slots=True)
class ColumnLayout:
    """Columns of a table that form a stream.

    Attributes
    ----------
    kind : of the stream.
    channels, columns : the same number of each, in the order of the stream.
    times : columns of time, the best first; if `split_time`, two: seconds and nanoseconds to be added.
    interval : length of each sample's own interval, for deltas.
    remarks : which columns of a sensor are not used, and why.
    """

    kind: Kind
    channels: tuple[str, ...]
    columns: tuple[Column, ...]
    times: tuple[Column, ...] = ()
    interval: Column | None = None
    split_time: bool = False
    remarks: tuple[str, ...] = ()


def layout(
    names: Sequence[str],
    kind: Kind | None = None,
    given: Mapping[str, str] | None = None,
    sensor: str | None = None,
) -> ColumnLayout:
    """Return the columns of a stream.

    Parameters
    ----------
    names : of all columns.
    kind : of a table with several streams; None: the best.
    given : channel (also ``t``, ``dt``) to ``COLUMN`` or ``COLUMN:UNIT``; others are found by the names.
    sensor : ``gyro`` or ``accel``: the only sensor with axes that is used; None: all.

    Raises
    ------
    RecordingError : there is no complete gyroscope or accelerometer, or not the requested stream, or each sensor has a
        time of its own.
    """
    if len(names) > MOST_COLUMNS:
        text = f"it has {len(names):,} columns, more than {MOST_COLUMNS:,}"
        raise RecordingError("too_many_columns", text, "write a table with those of the sensor only")
    assigned = {channel: _assigned(names, channel, text, kind) for channel, text in (given or {}).items()}
    columns = _known_columns(names, assigned, sensor)
    pointwise = any(sensor_of(channel) in INERTIAL for channel in assigned)
    for candidate in (kind,) if kind else KINDS[pointwise:]:
        if (stream := _stream(columns, candidate)) is not None:
            _check_units(stream)
            _check_complete(stream, {} if sensor else assigned)
            _check_one_time(stream)
            stream = replace(stream, remarks=tuple(_unused(columns, stream)))
            return stream if kind or _names_kind(stream) else replace(stream, kind="unknown")
    raise _no_stream(names, columns, kind)


def _known_columns(names: Sequence[str], assigned: Mapping[str, Column], sensor: str | None) -> list[Column]:
    """Return the assigned columns, then those whose names have a meaning; of one sensor only, if it is given."""
    named = [column for k, name in enumerate(names) if (column := parse_name(k, name)).quantity]
    used = {column.index for column in assigned.values()}
    columns = [*assigned.values()]
    columns += [c for c in named if c.index not in used and channel_of(c) not in assigned]
    if sensor is None:
        return columns
    return [c for c in columns if (SENSORS.get(c.quantity or "") or time_of(c) or sensor) == sensor]


def _names_kind(found: ColumnLayout) -> bool:
    """Return whether the names of the columns show the kind of the stream."""
    sensor = next(s for s in ("gyro", "accel") if any(sensor_of(channel) == s for channel in found.channels))
    kinds = [
        c.kind for name, c in zip(found.channels, found.columns, strict=True) if sensor_of(name) == sensor
    ]
    return found.kind != "uncompensated" or kinds == ["uncompensated"] * len(kinds)


def _assigned(names: Sequence[str], channel: str, text: str, kind: Kind | None) -> Column:
    """Return the column that the user assigned to a channel."""
    quantity, _, axis = channel.partition("/")
    if kind == "deltas":
        quantity = {"gyro": "angle", "accel": "velocity"}.get(quantity, quantity)
    index, unit = _find(names, text, quantity)
    return assigned_column(index, names[index].strip(), quantity, axis or None, unit)


def channel_of(column: Column) -> str:
    """Return the channel of a column, also ``t`` and ``dt``."""
    sensor = SENSORS.get(column.quantity or "", column.quantity)
    return replace(column, quantity=sensor).channel


def _check_complete(found: ColumnLayout, assigned: Mapping[str, Column]) -> None:
    """Check that every assigned channel is in the stream."""
    for channel in assigned:
        sensor = sensor_of(channel)
        if sensor in SENSORS and channel not in found.channels:
            missing = [f"{sensor}/{axis}" for axis in AXES if f"{sensor}/{axis}" not in assigned]
            text = f"--map names only a part of a sensor: {_list(missing)} is missing and no name shows it"
            raise RecordingError("map_incomplete", text, f"name it too, {missing[0]}=COLUMN:UNIT")


def time_of(column: Column) -> str | None:
    """Return the inertial sensor that the name of a time has: ``t_gyro``; None: it has none."""
    words = set(words_of(column.name)) if column.quantity == "t" and column.rank >= 0 else set()
    return next((sensor for sensor in sorted(INERTIAL) if words & SENSOR_WORDS[sensor]), None)


def _check_one_time(found: ColumnLayout) -> None:
    """Check that the sensors of a stream do not have a time each."""
    own = {sensor: column.name for column in reversed(found.times) if (sensor := time_of(column))}
    if (
        found.times
        and time_of(found.times[0])
        and own.keys() == {sensor_of(c) for c in found.channels} & INERTIAL == INERTIAL
    ):
        text = f"gyro has the time {own['gyro']} and accel {own['accel']}"
        raise RecordingError("different_rates", text, READ_ALONE)


def _unused(columns: Sequence[Column], found: ColumnLayout) -> list[str]:
    """Return the columns of a sensor that are not in the stream, with the reason."""
    used = {column.index for column in found.columns}
    reasons: dict[str, list[str]] = {}
    for column in columns:
        if column.quantity in SENSORS and column.index not in used:
            reasons.setdefault(_why_unused(column, columns, found), []).append(column.name)
    sensors = list(map(sensor_of, found.channels))
    notes = [
        f"{sensor} has one axis only, {column.axis} (column {column.name})"
        for sensor, column in zip(sensors, found.columns, strict=True)
        if sensor in INERTIAL and sensors.count(sensor) == 1
    ]
    return [*notes, *(f"{_list(names)} not used: {why}" for why, names in reasons.items())]


def _why_unused(column: Column, columns: Sequence[Column], found: ColumnLayout) -> str:
    """Return why a column of a sensor is not in the stream."""
    axes = {c.axis for c in columns if c.quantity == column.quantity}
    missing = [f"{SENSORS[column.quantity or '']}/{axis}" for axis in AXES if axis not in axes]
    if column.axis is None:
        return "the name has no axis x, y or z"
    if missing:
        return f"{_list(missing)} is missing, name it with --map {missing[0]}=COLUMN:UNIT"
    if any(_same(column, other) for other in found.columns):
        return "another column is the same axis"
    return f"the stream used is {found.kind}, --stream or --map selects another"


def _same(one: Column, other: Column) -> bool:
    """Return whether two columns are one axis of one stream; a magnetometer belongs to each."""
    axis = (one.quantity, one.axis) == (other.quantity, other.axis)
    return axis and (one.quantity == "mag" or one.kind == other.kind)


def _check_units(found: ColumnLayout) -> None:
    """Check that all units are known."""
    for column in (*found.columns, *found.times[:1], found.interval):
        if column is not None and column.unknown_unit and column.quantity:
            text = f"the unit {column.unknown_unit!r} of column {column.name!r} is unknown"
            raise RecordingError("unknown_unit", text, f"use one of {_list(UNITS[column.quantity])}")


def _stream(columns: Sequence[Column], kind: Kind) -> ColumnLayout | None:
    """Return the columns of a stream of a kind; None if there is none."""
    sets = [_axes(columns, name, kind) for name in (INCREMENTS if kind == "deltas" else POINTS)]
    if not any(sets) or (kind != "deltas" and _is_of_other_kind(columns, kind, sets[0])):
        return None
    rest = [_axes(columns, "mag", "uncompensated")]
    rest += [(one,) if (one := _best(columns, name)) else () for name in ("temperature", "pressure")]
    used = tuple(column for found in (*sets, *rest) for column in found)
    channels = tuple(map(channel_of, used))
    times, split_time = _times(columns)
    return ColumnLayout(kind, channels, used, times, _best(columns, "dt"), split_time)


def _is_of_other_kind(columns: Sequence[Column], kind: Kind, gyro: tuple[Column, ...]) -> bool:
    """Return whether the gyroscope is of the other kind, or no name says that it is compensated."""
    if not gyro and any(_axes(columns, "gyro", other) for other in KINDS[1:]):
        return True
    return kind == "compensated" and not any(c.quantity == "gyro" and (c.kind or c.rank < 0) for c in columns)


def _axes(columns: Sequence[Column], quantity: str, kind: Kind) -> tuple[Column, ...]:
    """Return the axes of a sensor of a kind, else of unknown, else of any other kind but deltas.

    A sensor has three axes, or one: two are a part of one.
    """
    others: tuple[Kind | None, ...] = ("deltas",)
    if kind != "deltas":
        others = (kind, None) if quantity == "gyro" else (kind, None, *KINDS[1:])
    present = [c for c in columns if c.quantity == quantity and c.axis]
    single = len({c.axis for c in present}) == 1 and SENSORS[quantity] in INERTIAL
    for each in others:
        fitting = [c for c in present if c.kind == each or c.rank < 0]
        axes = [_best([c for c in fitting if c.axis == axis], quantity) for axis in AXES]
        if None not in axes or (single and any(axes)):
            return tuple(filter(None, axes))
    return ()


def _best(columns: Iterable[Column], quantity: str) -> Column | None:
    """Return the column of a quantity with the lowest rank."""
    return min((c for c in columns if c.quantity == quantity), key=lambda c: c.rank, default=None)


def _times(columns: Sequence[Column]) -> tuple[tuple[Column, ...], bool]:
    """Return the columns of time, the best first; or seconds and nanoseconds, and True."""
    found = sorted((c for c in columns if c.quantity == "t"), key=lambda c: c.rank)
    fine = [c for c in found if set(words_of(c.name)) & NANOSECONDS]
    coarse = [c for c in found if set(words_of(c.name)) & {"sec", "secs", "seconds"}]
    if fine and coarse and "startup" not in words_of(found[0].name):
        return (replace(coarse[0], unit="s"), replace(fine[0], unit="ns")), True
    return tuple(found), False


def _find(names: Sequence[str], text: str, quantity: str) -> tuple[int, str | None]:
    """Return the column of a ``--map``, by its name with or without unit or its number, and its unit."""
    whole = [name.strip() for name in names]
    bare = [without_unit(name) for name in whole]
    tries: list[tuple[str, str | None]] = [(text, None)]
    if ":" in text:
        name, _, unit = text.rpartition(":")
        tries.insert(0, (name, unit_of(unit, quantity)))
        if tries[0][1] is None and (name in (*bare, *whole) or name.isdigit()):
            text = f"the unit {unit!r} in --map is unknown"
            raise RecordingError("unknown_unit", text, f"use one of {_list(UNITS[quantity])}")
    for name, given_unit in tries:
        if name in (*whole, *bare):
            return min(each.index(name) for each in (whole, bare) if name in each), given_unit
        if name.isdigit() and 1 <= int(name) <= len(names):
            return int(name) - 1, given_unit
    name = tries[0][0]
    raise RecordingError("unknown_column", f"no column {name!r} for --map", _similar(name, whole))


def parse_map(text: str) -> dict[str, str]:
    """Return ``gyro/x=wx:deg/s,t=stamp:ns`` as a dict; raise `OptionError` if it has another form."""
    columns = {}
    channels = (*CHANNELS, "t", "dt")
    for part in text.split(","):
        channel, equals, column = part.strip().partition("=")
        if not equals or channel not in channels:
            named = channel_of(parse_name(0, channel))  # of gx, gyro/x; mag/x has more similar letters
            similar = difflib.get_close_matches(channel, channels, 1, SIMILAR) or ["gyro/x"]
            cure = f"write {named if named in channels else similar[0]}=COLUMN:UNIT"
            raise OptionError("map_syntax", f"--map {part.strip()!r} names no channel", cure)
        columns[channel] = column.strip()
    return columns


def _no_stream(names: Sequence[str], columns: Sequence[Column], kind: Kind | None) -> RecordingError:
    """Return the error that names what is missing and the similar columns."""
    if kind and any(_stream(columns, other) for other in KINDS):
        text = f"the recording has no {kind} stream"
        return RecordingError("no_stream", text, "leave --stream out to use the best stream")
    incomplete = [c.name for c in columns if c.quantity in SENSORS and c.quantity != "mag"]
    if incomplete:
        text = f"only {_list(incomplete)} of gyroscope and accelerometer"
        cure = f"add the three axes, or name them with {MAP_EXAMPLE}"
        return RecordingError("sensor_incomplete", text, cure)
    text = f"no column is that of a gyroscope or accelerometer ({_similar('gyro_x', names)})"
    return RecordingError("no_sensor", text, f"name them with {MAP_EXAMPLE}")


def without_unit(name: str) -> str:
    """Return the name of a column without a unit in brackets at its end."""
    return re.sub(r"\s*[\[(][^\])]*[\])]\s*$", "", name)


def _similar(name: str, names: Sequence[str]) -> str:
    """Return which names of columns are similar, else the first of all."""
    stripped = [each.strip() for each in names]
    if similar := difflib.get_close_matches(name, stripped, 3, SIMILAR):
        return f"similar: {_list(similar)}"
    return f"columns: {_list(stripped[:LISTED])}{' ...' if len(names) > LISTED else ''}"


def _list(texts: Iterable[str]) -> str:
    return ", ".join(texts)
