"""Columns: which columns of a table make a stream.

By their names (`names`) there may be several streams, of which the best is taken; what a name does not tell,
``--map gyro/x=COLUMN:UNIT,...`` does. This file knows no files: names in, `Layout` out.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from imumon.samples import ACCEL, AXES, GYRO, MAG, Kind, sensor_of
from imumon.sources.errors import SourceError
from imumon.sources.names import NANOSECONDS, UNITS, Column, spelled, understood, words_of

BY_HAND = "--map gyro/x=COLUMN:UNIT,..."


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
    small = [c for c in found if set(words_of(c.name)) & NANOSECONDS]
    great = [c for c in found if set(words_of(c.name)) & {"sec", "secs", "seconds"}]
    if small and great and "startup" not in words_of(found[0].name):
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
