"""Columns of a table that form a stream.

A table may have several streams by the names of its columns (`column_names`); the best is used. ``--map
gyro/x=COLUMN:UNIT,...`` overrides what it names, and nothing else. `ColumnLayout.remarks` name every column
of a sensor that is not used. This module knows no files: names in, `ColumnLayout` out.
"""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.model.cures import example_text, option, option_text
from imumon.model.samples import AXES, CHANNELS, Floats, Kind, sensor_of
from imumon.sources.column_names import (
    NANOSECONDS,
    NO_SENSOR,
    SENSOR_WORDS,
    UNITS,
    Column,
    assigned_column,
    parse_name,
    parse_names,
    split_unit,
    triples,
    unit_of,
    words_of,
)
from imumon.sources.files.base import OptionError, RecordingError
from imumon.sources.rest_sizes import is_one_g, median_size, too_noisy

KINDS: tuple[Kind, ...] = ("deltas", "uncompensated", "compensated")
"""Kinds of streams, the best first; all but the first are of point samples."""

SENSORS = {"gyro": "gyro", "angle": "gyro", "accel": "accel", "velocity": "accel", "mag": "mag"}
"""Sensor with axes that a quantity belongs to."""

POINTS, INCREMENTS = ("gyro", "accel"), ("angle", "velocity")
"""Quantities of a gyroscope and an accelerometer, and their increments."""

INERTIAL = set(POINTS)
"""Sensors of which a table must have one."""

SIMILAR = 0.3
"""Similarity of names (difflib ratio) from which one is suggested for another."""

MOST_COLUMNS = 2000
"""Columns of the widest table: logs have some hundreds."""

LISTED = 8
"""Column names that a message lists."""

UNIT_QUATERNION = 1e-3
"""Difference of the size of a quaternion from one, with the digits that programs write."""

NOUNS = {"t": "time", "dt": "interval"}
"""Nouns for quantities of columns that are no channels."""


def read_alone() -> str:
    """Return the cure for sensors of different rates."""
    return f"read each alone, {option_text(sensor='gyro')} and {option_text(sensor='accel')}"


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
    gyro, accel : kind of the numbers of a sensor where it is not `kind`.
    time_option : how to use a column without the name of a time whose numbers are even; empty: there is none.
    unused : why a column that is in none of these is not used, by its place in the table.
    """

    kind: Kind
    channels: tuple[str, ...]
    columns: tuple[Column, ...]
    times: tuple[Column, ...] = ()
    interval: Column | None = None
    split_time: bool = False
    remarks: tuple[str, ...] = ()
    gyro: Kind | None = None
    accel: Kind | None = None
    time_option: str = ""
    unused: Mapping[int, str] = field(default_factory=dict)

    @property
    def has_increments(self) -> bool:
        """Whether some columns are angles or velocities, which become rates over the interval."""
        return any(column.quantity in INCREMENTS for column in self.columns)


def layout(
    names: Sequence[str],
    kind: Kind | None = None,
    given: Mapping[str, str] | None = None,
    sensor: str | None = None,
    head: Floats | None = None,
    row_sensor: str | None = None,
) -> ColumnLayout:
    """Return the columns of a stream.

    Parameters
    ----------
    names : of all columns.
    kind : of a table with several streams; None: the best.
    given : channel (also ``t``, ``dt``) to ``COLUMN``, ``COLUMN:UNIT`` or ``COLUMN/NUMBER:UNIT``; others are found by
        the names.
    sensor : ``gyro`` or ``accel``: the only sensor with axes that is used; None: all.
    row_sensor : sensor that the rows are of, which the names need not show; None: not known.
    head : (n, k) numbers of all columns in the first rows, not finite where there is none; None: not known.

    Raises
    ------
    RecordingError : there is no complete gyroscope or accelerometer, or not the requested stream, each sensor has a
        time of its own, or one column is to serve two axes.
    """
    _check_number(names)
    assigned = {channel: _assigned(names, channel, text, kind) for channel, text in (given or {}).items()}
    _check_distinct(assigned)
    columns = _known_columns(names, assigned, sensor)
    by_size: list[str] = []
    if not any(SENSORS.get(column.quantity or "") in INERTIAL for column in columns):
        columns, by_size = _sized(names, columns, head, row_sensor)
    candidates = (_stream(columns, candidate) for candidate in _candidates(kind, assigned))
    stream = next((candidate for candidate in candidates if candidate is not None), None)
    if stream is None:
        raise _no_stream(names, columns, kind, head)
    _check_units(names, stream, head)
    # with --sensor the other sensor is left out on purpose, even if --map names it
    _check_complete(stream, {} if sensor else assigned)
    stream = _with_one_time(stream, head)
    stream = replace(
        stream,
        remarks=(*by_size, *_unused(columns, stream), *_unused_triples(names, stream, head)),
        unused=_reasons(names, columns, stream, sensor),
        time_option="" if stream.times else _time_option(names, stream, head),
    )
    # the search takes names without a kind for uncompensated; a report must not claim that
    return stream if kind or _names_kind(stream) else replace(stream, kind="unknown")


def _check_number(names: Sequence[str]) -> None:
    """Check that a table has not too many columns."""
    if len(names) > MOST_COLUMNS:
        text = f"it has {len(names):,} columns, more than {MOST_COLUMNS:,}"
        raise RecordingError("too_many_columns", text, "write a table with those of the sensor only")


def _candidates(kind: Kind | None, assigned: Mapping[str, Column]) -> Sequence[Kind]:
    """Return the kinds of streams that the user asks for, the best first."""
    if kind is not None:
        return (kind,)
    quantities = {column.quantity for column in assigned.values()}
    # an axis of a gyroscope or accelerometer that the user names is of point samples, not of deltas
    pointwise = bool(quantities & set(POINTS)) and not quantities & set(INCREMENTS)
    return KINDS[pointwise:]


def _check_distinct(assigned: Mapping[str, Column]) -> None:
    """Check that no column is assigned to two channels."""
    twice = [index for index, n in Counter(column.index for column in assigned.values()).items() if n > 1]
    if twice:
        channels = [channel for channel, column in assigned.items() if column.index == twice[0]]
        text = f"{option('columns')} gives one column, {assigned[channels[0]].name}, to {_list(channels)}"
        raise RecordingError("column_twice", text, "name another column for each axis")


def _known_columns(names: Sequence[str], assigned: Mapping[str, Column], sensor: str | None) -> list[Column]:
    """Return the assigned columns, then those whose names have a meaning; of one sensor only, if it is given."""
    named = [column for column in parse_names(names) if column.quantity]
    used = {column.index for column in assigned.values()}
    columns = [*assigned.values()]
    columns += [c for c in named if c.index not in used and channel_of(c) not in assigned]
    if sensor is None:
        return columns
    return [c for c in columns if (SENSORS.get(c.quantity or "") or time_of(c) or sensor) == sensor]


def _names_kind(table_layout: ColumnLayout) -> bool:
    """Return whether the names of the columns show the kind of the stream."""
    sensor = next(
        s for s in ("gyro", "accel") if any(sensor_of(channel) == s for channel in table_layout.channels)
    )
    kinds = [
        c.kind
        for name, c in zip(table_layout.channels, table_layout.columns, strict=True)
        if sensor_of(name) == sensor
    ]
    return table_layout.kind != "uncompensated" or kinds == ["uncompensated"] * len(kinds)


def _assigned(names: Sequence[str], channel: str, text: str, kind: Kind | None) -> Column:
    """Return the column that the user assigned to a channel."""
    quantity, _, axis = channel.partition("/")
    if kind == "deltas":
        # columns have the increments, channels the names of the sensor
        quantity = {"gyro": "angle", "accel": "velocity"}.get(quantity, quantity)
    index, unit, scale = _find(names, text, quantity)
    # degrees are no rate: the column has increments, which its unit shows
    increment = {"gyro": "angle", "accel": "velocity"}.get(quantity)
    if unit is not None and unit not in UNITS[quantity] and increment is not None:
        quantity = increment
    return assigned_column(index, names[index].strip(), quantity, axis or None, unit, scale)


def channel_of(column: Column) -> str:
    """Return the channel of a column, also ``t`` and ``dt``."""
    sensor = SENSORS.get(column.quantity or "", column.quantity)
    return replace(column, quantity=sensor).channel


def _check_complete(table_layout: ColumnLayout, assigned: Mapping[str, Column]) -> None:
    """Check that every assigned channel is in the stream."""
    for channel in assigned:
        sensor = sensor_of(channel)
        if sensor in SENSORS and channel not in table_layout.channels:
            missing = [f"{sensor}/{axis}" for axis in AXES if f"{sensor}/{axis}" not in assigned]
            part = f"{option('columns')} names only a part of a sensor"
            text = f"{part}: {_list(missing)} is missing and no name shows it"
            raise RecordingError("map_incomplete", text, f"name it too, {missing[0]}=COLUMN:UNIT")


def time_of(column: Column) -> str | None:
    """Return the inertial sensor that the name of a time has: ``t_gyro``; None: it has none."""
    # a rank below 0 is that of --map: such a time is for all sensors
    words = set(words_of(column.name)) if column.quantity == "t" and column.rank >= 0 else set()
    return next((sensor for sensor in sorted(INERTIAL) if words & SENSOR_WORDS[sensor]), None)


def _with_one_time(table_layout: ColumnLayout, head: Floats | None) -> ColumnLayout:
    """Return a stream whose sensors have one time; raise `RecordingError` if each has one of its own."""
    by_sensor = {sensor: column for column in reversed(table_layout.times) if (sensor := time_of(column))}
    times, inertial = table_layout.times, {sensor_of(c) for c in table_layout.channels} & INERTIAL
    if not times or time_of(times[0]) is None or not by_sensor.keys() == inertial == INERTIAL:
        return table_layout
    if head is not None and _equal(head[:, by_sensor["gyro"].index], head[:, by_sensor["accel"].index]):
        return table_layout
    text = f"gyro has the time {by_sensor['gyro'].name} and accel {by_sensor['accel'].name}"
    raise RecordingError("different_rates", text, read_alone())


def _equal(one: Floats, other: Floats) -> bool:
    return bool(np.isfinite(one).any() and np.array_equal(one, other, equal_nan=True))


def _unused(columns: Sequence[Column], table_layout: ColumnLayout) -> list[str]:
    """Return the columns of a sensor that are not in the stream, with the reason."""
    used = {column.index for column in table_layout.columns}
    reasons: dict[str, list[str]] = {}
    for column in columns:
        if column.quantity in SENSORS and column.index not in used:
            reasons.setdefault(_why_unused(column, columns, table_layout), []).append(column.name)
    sensors = list(map(sensor_of, table_layout.channels))
    notes = [
        f"{sensor} has one axis only, {column.axis} (column {column.name})"
        for sensor, column in zip(sensors, table_layout.columns, strict=True)
        if sensor in INERTIAL and sensors.count(sensor) == 1
    ]
    return [*notes, *(f"{_list(names)} not used: {why}" for why, names in reasons.items())]


def _why_unused(column: Column, columns: Sequence[Column], table_layout: ColumnLayout) -> str:
    """Return why a column of a sensor is not in the stream."""
    axes = {c.axis for c in columns if c.quantity == column.quantity}
    missing = [f"{SENSORS[column.quantity or '']}/{axis}" for axis in AXES if axis not in axes]
    if column.axis is None:
        return "the name has no axis x, y or z"
    if missing:
        return f"{_list(missing)} is missing, name it with {option_text(columns={missing[0]: 'COLUMN:UNIT'})}"
    if any(_same(column, other) for other in table_layout.columns):
        return "another column is the same axis"
    return f"the stream used is {table_layout.kind}, {option('kind')} or {option('columns')} selects another"


def _reasons(
    names: Sequence[str], columns: Sequence[Column], stream: ColumnLayout, sensor: str | None
) -> dict[int, str]:
    """Return why each column is not used that is not in the stream, by its place."""
    interval = [] if stream.interval is None else [stream.interval]
    used = {column.index for column in (*stream.columns, *stream.times, *interval)}
    known = {column.index: column for column in columns}
    reasons = {}
    for index, named in enumerate(parse_names(names)):
        column = known.get(index)
        if index in used:
            continue
        if column is not None and column.quantity in SENSORS:
            reasons[index] = _why_unused(column, columns, stream)
        elif column is not None:
            reasons[index] = f"another column is the {NOUNS.get(column.quantity or '', column.quantity)}"
        elif sensor is not None and named.quantity is not None:
            reasons[index] = f"{option_text(sensor=sensor)} leaves it out"
        elif named.quantity is not None:
            reasons[index] = f"{option('columns')} names another column"
        else:
            reasons[index] = "no name or unit of a sensor or a time"
    return reasons


def _unused_triples(names: Sequence[str], table_layout: ColumnLayout, head: Floats | None) -> Iterator[str]:
    """Yield which triples of numbers have no meaning, with how to use them."""
    known = {column.index for column in parse_names(names) if column.quantity in SENSORS}
    known |= {column.index for column in table_layout.columns}
    unknown = [triple for triple in _number_triples(names, head) if not known & set(triple)]
    if unknown:
        first = _unused_proposal(names, unknown[0], set(map(sensor_of, table_layout.channels)), head)
        text = "; ".join(_list(names[k].strip() for k in triple) for triple in unknown[:LISTED])
        more = f" and {len(unknown) - LISTED} more" if len(unknown) > LISTED else ""
        yield f"{text}{more} not used: no name or unit of a sensor; if they are one, {option_text(columns=first)}"


def _unused_proposal(
    names: Sequence[str], three: Sequence[int], sensors: set[str], head: Floats | None
) -> dict[str, str]:
    """Return how ``--map`` names a triple: as the sensor that is missing if it may be it, else as an example."""
    proposal = _proposal(names, three, "accel", head)
    has_unit = any(split_unit(names[k])[1] for k in three)
    of_gravity = head is not None and not has_unit and _unit_of_gravity(head[:, three]) is not None
    if "accel" not in sensors and (of_gravity or proposal["accel/x"].endswith("m/s")):
        return proposal
    return {f"gyro/{axis}": f"{reference(k, names)}:UNIT" for axis, k in zip(AXES, three, strict=True)}


def _number_triples(names: Sequence[str], head: Floats | None) -> list[tuple[int, ...]]:
    """Return the triples of which the first rows have numbers, that are not all zero."""
    indices = [triple.indices for triple in triples(names)]
    if head is None or not len(head):
        return indices
    return [three for three in indices if np.any(np.nan_to_num(head[:, three], posinf=0.0, neginf=0.0))]


def _sized(
    names: Sequence[str], columns: list[Column], head: Floats | None, row_sensor: str | None
) -> tuple[list[Column], list[str]]:
    """Return the columns of a table whose names show no sensor: a triple of one g in size is an accelerometer."""
    if head is None or not len(head):
        return columns, []
    used = {column.index for column in columns}
    for three in _number_triples(names, head):
        if used & set(three):
            continue
        if row_sensor is not None:
            of_rows = [
                Column(k, names[k].strip(), row_sensor, axis) for axis, k in zip(AXES, three, strict=True)
            ]
            listed = _list(names[k].strip() for k in three)
            text = f"{listed} have no name of a sensor: the name of the rows or of the file is that of {row_sensor}"
            return [*columns, *of_rows], [text]
        excluded = any(words & NO_SENSOR for words in (set(words_of(names[k])) for k in three))
        unit = _unit_of_gravity(head[:, three])
        if unit is not None and not excluded:
            listed = _list(names[k].strip() for k in three)
            sized = [
                Column(k, names[k].strip(), "accel", axis, unit=unit, rank=LISTED)
                for axis, k in zip(AXES, three, strict=True)
            ]
            text = (
                f"{listed} have no name of a sensor: their size is one g in {unit}, so they are read as accel"
            )
            return [*columns, *sized], [text]
    return columns, []


def _unit_of_gravity(numbers: Floats) -> str | None:
    """Return the unit in which the size of (n, 3) numbers is one g; None: in neither m/s2 nor g."""
    size = median_size(numbers)
    if size is None:
        return None
    return next((unit for unit in ("m/s2", "g") if is_one_g(size * UNITS["accel"][unit])), None)


def _same(one: Column, other: Column) -> bool:
    """Return whether two columns are one axis of one stream; a magnetometer belongs to each."""
    axis = (one.quantity, one.axis) == (other.quantity, other.axis)
    return axis and (one.quantity == "mag" or one.kind == other.kind)


def _check_units(names: Sequence[str], table_layout: ColumnLayout, head: Floats | None) -> None:
    """Check that all units are known."""
    for column in (*table_layout.columns, table_layout.interval):
        if column is not None and column.unknown_unit and column.quantity:
            text = f"the unit {column.unknown_unit!r} of column {column.name!r} is unknown"
            units = f"one of {_list(UNITS[column.quantity])}"
            axes = [c for c in table_layout.columns if c.quantity == column.quantity]
            if column.quantity not in INERTIAL or len(axes) < len(AXES):
                raise RecordingError("unknown_unit", text, f"use {units}")
            proposed = option_text(
                columns=_proposal(names, tuple(c.index for c in axes), column.quantity, head)
            )
            raise RecordingError("unknown_unit", text, f"{proposed}, with the unit that it has, {units}")


def _stream(columns: Sequence[Column], kind: Kind) -> ColumnLayout | None:
    """Return the columns of a stream of a kind; None if there is none."""
    sets = [_axes(columns, name, kind) for name in (INCREMENTS if kind == "deltas" else POINTS)]
    if not any(sets) or (kind != "deltas" and _is_of_other_kind(columns, kind, sets[0])):
        return None
    kinds: dict[str, Kind | None] = {"gyro": None, "accel": None}
    if kind == "deltas" and not all(sets):
        sets, kinds = _with_points(columns, sets, kinds)
    rest = [_axes(columns, "mag", "uncompensated")]
    rest += [(one,) if (one := _best(columns, name)) else () for name in ("temperature", "pressure")]
    used = tuple(column for column_set in (*sets, *rest) for column in column_set)
    channels = tuple(map(channel_of, used))
    times, split_time = _times(columns)
    mixed = [of_sensor for of_sensor in kinds.values() if of_sensor not in (None, "deltas")]
    stream_kind = mixed[0] if mixed and mixed[0] is not None else kind
    interval = _best(columns, "dt")
    return ColumnLayout(
        stream_kind, channels, used, times, interval, split_time, (), kinds["gyro"], kinds["accel"]
    )


def _with_points(
    columns: Sequence[Column], sets: list[tuple[Column, ...]], kinds: dict[str, Kind | None]
) -> tuple[list[tuple[Column, ...]], dict[str, Kind | None]]:
    """Return the axes of gyroscope and accelerometer, and their kinds, with point samples of the one without deltas.

    A gyroscope with increments may be beside an accelerometer with point samples, or the other way round. If there are
    no point samples either, both are as before.
    """
    missing = 0 if not sets[0] else 1
    points = next((p for k in KINDS[1:] if (p := _axes(columns, POINTS[missing], k))), ())
    if not points:
        return sets, kinds
    both = (points, sets[1]) if missing == 0 else (sets[0], points)
    return [*both], {"gyro": "deltas", "accel": "deltas", POINTS[missing]: points[0].kind or "unknown"}


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
        # the kind of a stream is that of its gyroscope; the accelerometer is often there in one kind only
        others = (kind, None) if quantity == "gyro" else (kind, None, *KINDS[1:])
    present = [c for c in columns if c.quantity == quantity and c.axis]
    # a gyroscope of one axis is common; two axes are a part of a sensor whose third has another name
    single = len({c.axis for c in present}) == 1 and SENSORS[quantity] in INERTIAL
    for accepted in others:
        fitting = [c for c in present if c.kind == accepted or c.rank < 0]
        axes = [_best([c for c in fitting if c.axis == axis], quantity) for axis in AXES]
        if None not in axes or (single and any(axes)):
            return tuple(filter(None, axes))
    return ()


def _best(columns: Iterable[Column], quantity: str) -> Column | None:
    """Return the column of a quantity with the lowest rank."""
    return min((c for c in columns if c.quantity == quantity), key=lambda c: c.rank, default=None)


def _times(columns: Sequence[Column]) -> tuple[tuple[Column, ...], bool]:
    """Return the columns of time, the best first; or seconds and nanoseconds, and True."""
    times = sorted((c for c in columns if c.quantity == "t"), key=lambda c: c.rank)
    fine = [c for c in times if set(words_of(c.name)) & NANOSECONDS]
    coarse = [c for c in times if set(words_of(c.name)) & {"sec", "secs", "seconds"}]
    # the time since the start-up of the sensor is a sample clock, and better than any date
    if fine and coarse and "startup" not in words_of(times[0].name):
        return (replace(coarse[0], unit="s"), replace(fine[0], unit="ns")), True
    return tuple(times), False


def _find(names: Sequence[str], text: str, quantity: str) -> tuple[int, str | None, float]:
    """Return the column of a ``--map``, by its name with or without unit or its number, its unit and its scale."""
    # a name may have a colon itself: first as NAME:UNIT, then as a name
    tries: list[tuple[str, str | None]] = [(text, None)]
    if ":" in text and _index(names, text) is None:
        name, _, unit = text.rpartition(":")
        tries.insert(0, (name, _map_unit(unit, quantity)))
        if tries[0][1] is None and _scaled(names, name) is not None:
            text = f"the unit {unit!r} in {option('columns')} is unknown"
            raise RecordingError("unknown_unit", text, f"use one of {_list(UNITS[quantity])}")
    for name, given_unit in tries:
        if (column := _scaled(names, name)) is not None:
            return column[0], given_unit, column[1]
    name = tries[0][0]
    if (scale := re.fullmatch(r"(.+)[/*](\w+)", name)) and _index(names, scale[1]) is not None:
        text = f"{scale[2]!r} in {option('columns')} {name} is no number"
        raise RecordingError("unknown_column", text, "write the counts in a unit, from the data sheet")
    whole = [name.strip() for name in names]
    raise RecordingError(
        "unknown_column", f"no column {name!r} for {option('columns')}", _similar(name, whole)
    )


def _map_unit(text: str, quantity: str) -> str | None:
    """Return a unit of a quantity, or of its increments; None if it is unknown."""
    increment = {"gyro": "angle", "accel": "velocity"}.get(quantity)
    return unit_of(text, quantity) or (unit_of(text, increment) if increment else None)


def _scaled(names: Sequence[str], text: str) -> tuple[int, float] | None:
    """Return the column of ``COLUMN``, ``COLUMN/NUMBER`` or ``COLUMN*NUMBER`` and its scale; None: there is none.

    >>> _scaled(["p", "q/2"], "p/131")[0], _scaled(["p", "q/2"], "q/2"), _scaled(["p"], "1*0.5")
    (0, (1, 1.0), (0, 0.5))
    """
    index = _index(names, text)
    if index is not None:
        return index, 1.0
    match = re.fullmatch(r"(.+?)([/*])([-+]?[\d.]+(?:e[-+]?\d+)?)", text, re.IGNORECASE)
    if match is None or (index := _index(names, match[1])) is None:
        return None
    try:
        factor = float(match[3])
    except ValueError:
        return None
    if factor == 0.0:
        return None
    return index, factor if match[2] == "*" else 1.0 / factor


def _index(names: Sequence[str], text: str) -> int | None:
    """Return the place of a column by its name, with or without unit, or by its number from 1; None: there is none."""
    whole = [name.strip() for name in names]
    for spelling in (whole, [split_unit(name)[0] for name in names]):
        places = [k for k, name in enumerate(spelling) if name == text]
        if len(places) > 1:
            numbers = " or ".join(str(k + 1) for k in places)
            raise RecordingError(
                "ambiguous_column",
                f"{option('columns')} names {text!r}, and {len(places)} columns have that name",
                f"write {numbers}",
            )
        if places:
            return places[0]
    # after the names: a column may be named 7 and be another one than the seventh
    return int(text) - 1 if text.isdigit() and 1 <= int(text) <= len(names) else None


def reference(index: int, names: Sequence[str]) -> str:
    """Return how ``--map`` names a column: by its name without unit, or by its number if that is ambiguous.

    >>> reference(0, ["gyro [0]", "t"]), reference(1, ["a [s]", "a [g]"]), reference(0, ["a,b"])
    ('gyro [0]', '2', '1')
    """
    name = split_unit(names[index])[0].strip()
    try:
        return name if name and not set(name) & set(",=") and _index(names, name) == index else str(index + 1)
    except RecordingError:
        return str(index + 1)


def mapped(table_layout: ColumnLayout, names: Sequence[str]) -> dict[str, str]:
    """Return the columns of sensors and the first time of a stream, as ``--map`` has them."""
    columns = dict(zip(table_layout.channels, table_layout.columns, strict=True))
    columns |= {"t": table_layout.times[0]} if table_layout.times and not table_layout.split_time else {}
    return {
        channel: reference(column.index, names) + (f":{column.unit}" if column.unit else "")
        for channel, column in columns.items()
    }


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
            raise OptionError("map_syntax", f"{option('columns')} {part.strip()!r} names no channel", cure)
        columns[channel] = column.strip()
    return columns


def _no_stream(
    names: Sequence[str], columns: Sequence[Column], kind: Kind | None, head: Floats | None
) -> RecordingError:
    """Return the error that names what is missing and the similar columns."""
    if kind and any(_stream(columns, other) for other in KINDS):
        text = f"the recording has no {kind} stream"
        return RecordingError("no_stream", text, f"leave {option('kind')} out to use the best stream")
    incomplete = [c.name for c in columns if c.quantity in SENSORS and c.quantity != "mag"]
    if incomplete:
        text = f"only {_list(incomplete)} of gyroscope and accelerometer"
        cure = f"add the three axes, or name them with {example_text()}"
        return RecordingError("sensor_incomplete", text, cure)
    text = (
        f"no name or unit of a column is that of a gyroscope or accelerometer ({_similar('gyro_x', names)})"
    )
    unknown = _number_triples(names, head)
    if not unknown:
        return RecordingError("no_sensor", text, f"name them with {example_text()}")
    first = _proposal(names, unknown[0], "gyro", head)
    listed = _list(names[k].strip() for k in unknown[0])
    cure = f"if {listed} are a gyroscope, {option_text(columns=first)}, with their unit"
    return RecordingError("no_sensor", text, cure)


def _proposal(names: Sequence[str], three: Sequence[int], sensor: str, head: Floats | None) -> dict[str, str]:
    """Return the columns of a sensor as ``--map`` has them, with the unit that its names or numbers allow."""
    numbers = None if head is None else head[:, three]
    unit = "rad/s" if numbers is None or not too_noisy(numbers) else "deg/s"
    words = {word for k in three for word in words_of(names[k])}
    if sensor == "gyro" and words & {"theta", "angle", "dtheta", "dang"} and not words & {"rate", "speed"}:
        unit = "rad"  # an increment
    if sensor == "accel":
        increments = bool(words & {"vel", "velocity", "dv", "dvel"})
        of_size = None if numbers is None else _unit_of_gravity(numbers)
        unit = "m/s" if increments else of_size or "m/s2"
    return {f"{sensor}/{axis}": f"{reference(k, names)}:{unit}" for axis, k in zip(AXES, three, strict=True)}


def _time_option(names: Sequence[str], table_layout: ColumnLayout, head: Floats | None) -> str:
    """Return how to use a column as a time whose numbers rise evenly, as those of a clock; empty: there is none."""
    if head is None:
        return ""
    used = {column.index for column in table_layout.columns}
    for k in range(len(names)):
        # steps of one, in any column, are those of a counter
        if k not in used and _rises_evenly(head[:, k]) and float(head[1, k] - head[0, k]) != 1.0:
            unit = split_unit(names[k])[1]
            known = None if unit is None else unit_of(unit, "t")
            return option_text(columns={"t": reference(k, names) + (f":{known}" if known else "")})
    return ""


def _rises_evenly(numbers: Floats) -> bool:
    """Return whether numbers rise in steps of about one size."""
    steps = np.diff(numbers)
    return (
        len(steps) > LISTED and bool((steps > 0.0).all()) and float(np.ptp(steps)) < float(np.median(steps))
    )


def proposed_map(numbers: Floats) -> dict[str, str]:
    """Return what columns without names may be, as ``--map`` has them; empty: their sizes do not show it.

    Three columns of one g are the accelerometer. If three others are behind or before it that move around a constant,
    they are the gyroscope; and a first column that rises evenly is the time.

    Parameters
    ----------
    numbers : (n, k) of the first rows.
    """
    width = numbers.shape[1]
    if len(numbers) <= LISTED:
        return {}
    vary = [bool(np.ptp(column) > 0.0) and not _rises_evenly(column) for column in numbers.T]
    threes = [(k, k + 1, k + 2) for k in range(width - 2) if all(vary[k : k + 3])]
    units = {three: unit for three in threes if (unit := _unit_of_gravity(numbers[:, three]))}
    # a quaternion has the size of one g in g, so that m/s2 come first
    accel = min(units, key=lambda three: (units[three] != "m/s2", three), default=None)
    if accel is None or _in_quaternion(numbers, accel):
        return {}
    names = [str(k + 1) for k in range(width)]
    gyro = [three for k in (accel[2] + 1, accel[0] - 3) if (three := (k, k + 1, k + 2)) in threes]
    proposed = {"t": "1"} if accel[0] and _rises_evenly(numbers[:, 0]) else {}
    for three in gyro[:1]:
        proposed |= _proposal(names, three, "gyro", numbers)
    return proposed | _proposal(names, accel, "accel", numbers)


def _in_quaternion(numbers: Floats, three: Sequence[int]) -> bool:
    """Return whether three columns and one beside them are a quaternion: four numbers of size one."""
    fours = [numbers[:, k : k + 4] for k in (three[0] - 1, three[0]) if 0 <= k <= numbers.shape[1] - 4]
    return any(np.nanmax(np.abs(np.linalg.norm(four, axis=1) - 1.0)) < UNIT_QUATERNION for four in fours)


def without_unit(name: str) -> str:
    """Return the name of a column without a unit in brackets at its end."""
    return split_unit(name)[0]


def _similar(name: str, names: Sequence[str]) -> str:
    """Return which names of columns are similar, else the first of all."""
    stripped = [name.strip() for name in names]
    if similar := difflib.get_close_matches(name, stripped, 3, SIMILAR):
        return f"similar: {_list(similar)}"
    return f"columns: {_list(stripped[:LISTED])}{' ...' if len(names) > LISTED else ''}"


def _list(texts: Iterable[str]) -> str:
    return ", ".join(texts)
