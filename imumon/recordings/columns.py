"""Columns: which columns of a table make a stream.

By their names (`names`) there may be several streams, of which the best is taken. ``--map
gyro/x=COLUMN:UNIT,...`` says otherwise of what it names, and of nothing else. No sensor vanishes without a
word: `ColumnLayout.remarks` name every column of one that is not used. This file knows no files: names in,
`ColumnLayout` out.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from imumon.errors import SourceError
from imumon.recordings.column_names import (
    NANOSECONDS,
    UNITS,
    Column,
    said,
    spelled,
    understood,
    words_of,
)
from imumon.samples import ACCEL, AXES, GYRO, MAG, Kind, sensor_of

KINDS: tuple[Kind, ...] = ("deltas", "uncompensated", "compensated")
"""The best first."""

SENSORS = {"gyro": "gyro", "angle": "gyro", "accel": "accel", "velocity": "accel", "mag": "mag"}
"""Sensor with axes that a quantity is of."""

INERTIAL = {"gyro", "accel"}

BY_HAND = "--map gyro/x=COLUMN:UNIT,..."


@dataclass(frozen=True, slots=True)
class ColumnLayout:
    """What of a table makes a stream.

    Attributes
    ----------
    kind : of the stream.
    channels, columns : the same number of each, in the order of the stream.
    times : columns of time, the best first; with `apart` two, seconds and nanoseconds to be added.
    interval : length of each sample's own interval, for deltas.
    remarks : which columns of a sensor are not used, and why.
    """

    kind: Kind
    channels: tuple[str, ...]
    columns: tuple[Column, ...]
    times: tuple[Column, ...] = ()
    interval: Column | None = None
    apart: bool = False
    remarks: tuple[str, ...] = ()


def layout(
    names: Sequence[str], kind: Kind | None = None, given: Mapping[str, str] | None = None
) -> ColumnLayout:
    """Columns of a stream.

    Parameters
    ----------
    names : of all columns.
    kind : which stream, where the table has several; None: the best.
    given : channel (also ``t``, ``dt``) to ``COLUMN`` or ``COLUMN:UNIT``, as a user says it; what it does
        not name is found by the names.

    Raises
    ------
    SourceError : there is no complete gyroscope or accelerometer, or what is asked for is not there.
    """
    hand = {channel: _by_hand(names, channel, text, kind) for channel, text in (given or {}).items()}
    columns = _overridden([c for k, name in enumerate(names) if (c := understood(k, name)).quantity], hand)
    pointwise = any(sensor_of(channel) in INERTIAL for channel in hand)
    for wanted in (kind,) if kind else KINDS[pointwise:]:
        found = _stream(columns, wanted)
        if found is not None:
            _check_units(found)
            _check_whole(found, hand)
            return replace(found, remarks=tuple(_unused(columns, found)))
    raise SourceError(_missing(names, columns, kind))


def _by_hand(names: Sequence[str], channel: str, text: str, kind: Kind | None) -> Column:
    """Column that the user says is a channel."""
    quantity, _, axis = channel.partition("/")
    if kind == "deltas":
        quantity = {"gyro": "angle", "accel": "velocity"}.get(quantity, quantity)
    index, unit = _named(names, text, quantity)
    return said(index, names[index].strip(), quantity, axis or None, unit)


def _overridden(columns: Sequence[Column], hand: Mapping[str, Column]) -> list[Column]:
    """The columns, those that the user named in the place of what their names say."""
    taken = {column.index for column in hand.values()}
    free = [c for c in columns if c.index not in taken and _channel(c) not in hand]
    return [*hand.values(), *free]


def _channel(column: Column) -> str:
    """Channel, also ``t`` and ``dt``, that a column is of."""
    sensor = SENSORS.get(column.quantity or "", column.quantity)
    return f"{sensor}/{column.axis}" if column.axis else f"{sensor}"


def _check_whole(found: ColumnLayout, hand: Mapping[str, Column]) -> None:
    """What the user named must be there."""
    for channel in hand:
        sensor = sensor_of(channel)
        if sensor in SENSORS and channel not in found.channels:
            lacking = [f"{sensor}/{axis}" for axis in AXES if f"{sensor}/{axis}" not in hand]
            raise SourceError(
                f"--map names a part of a sensor only: {_list(lacking)} is missing, "
                "and no column is that by its name"
            )


def _unused(columns: Sequence[Column], found: ColumnLayout) -> list[str]:
    """Columns of a sensor that are not in the stream, with the reason."""
    used = {column.index for column in found.columns}
    reasons: dict[str, list[str]] = {}
    for column in columns:
        if column.quantity not in SENSORS or column.index in used:
            continue
        sensor = SENSORS[column.quantity]
        there = {c.axis for c in columns if c.quantity == column.quantity}
        lacking = [f"{sensor}/{axis}" for axis in AXES if axis not in there]
        if column.axis is None:
            why = "the name tells no axis x, y or z"
        elif lacking:
            why = f"{_list(lacking)} is missing, name it with --map {lacking[0]}=COLUMN:UNIT"
        elif any(_same(column, other) for other in found.columns):
            why = "another column is the same axis"
        else:
            why = f"the stream taken is {found.kind}, --stream or --map asks for another"
        reasons.setdefault(why, []).append(column.name)
    return [f"{_list(names)} not used: {why}" for why, names in reasons.items()]


def _same(one: Column, other: Column) -> bool:
    """Whether two columns are one axis of one stream; a magnetometer belongs to each."""
    axis = (one.quantity, one.axis) == (other.quantity, other.axis)
    return axis and (one.quantity == "mag" or one.kind == other.kind)


def _check_units(found: ColumnLayout) -> None:
    for column in (*found.columns, *found.times[:1], found.interval):
        if column is not None and column.unknown and column.quantity:
            known = _list(UNITS[column.quantity])
            raise SourceError(
                f"the unit {column.unknown!r} of column {column.name!r} is not known; known: {known}"
            )


def _stream(columns: Sequence[Column], kind: Kind) -> ColumnLayout | None:
    """Columns of a stream of that kind, None where it is not there."""
    if kind == "deltas":
        sets = [_triple(columns, "angle", kind), _triple(columns, "velocity", kind)]
    else:
        sets = [_triple(columns, sensor, kind) for sensor in ("gyro", "accel")]
        if not sets[0] and any(_triple(columns, "gyro", other) for other in ("uncompensated", "compensated")):
            return None  # its gyroscope is of the other kind
        told = [c for c in columns if c.quantity == "gyro" and (c.kind or c.doubt < 0)]
        if kind == "compensated" and not told:
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
    return ColumnLayout(kind, channels, taken, times, _best(columns, "dt"), apart)


def _triple(columns: Sequence[Column], quantity: str, kind: Kind) -> tuple[Column, ...]:
    """Axes of a sensor: of that kind, else such as say nothing, else any but deltas.

    What the user named is of every kind.
    """
    others: tuple[Kind | None, ...] = (kind, None, "uncompensated", "compensated")
    if kind == "deltas":
        others = ("deltas",)
    elif quantity == "gyro":
        others = (kind, None)
    for each in others:
        axes = [
            [
                c
                for c in columns
                if c.quantity == quantity and c.axis == axis and (c.kind == each or c.doubt < 0)
            ]
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
    small = [c for c in found if set(words_of(c.name)) & NANOSECONDS]
    great = [c for c in found if set(words_of(c.name)) & {"sec", "secs", "seconds"}]
    if small and great and "startup" not in words_of(found[0].name):
        return (replace(great[0], unit="s"), replace(small[0], unit="ns")), True
    return tuple(found), False


def _named(names: Sequence[str], text: str, quantity: str) -> tuple[int, str | None]:
    """Which column that is, by its name with or without its own unit, or its number from 1, and the ``:UNIT``
    behind it."""
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
                return index, spoken
        if name.isdigit() and 1 <= int(name) <= len(names):
            return int(name) - 1, spoken
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
    if kind and any(_stream(columns, other) for other in KINDS):
        return f"there is no {kind} stream in it; without --stream the best there is will be taken"
    partly = [c for c in columns if c.quantity in SENSORS and c.quantity != "mag"]
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
