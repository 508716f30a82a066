"""Columns: which number of a record is which channel, in which unit, and how certain that is.

Other people's tables are read by three principles, in this order:

1. *What is stated.* A name says of which sensor a number is, a unit what it means: in brackets, as a suffix, in a line
   of units, behind the number (`column_names`). Units are a grammar (`unit_grammar`). Three columns whose names differ
   only by the axis are a triple.
2. *What physics shows.* The length of an accelerometer at rest is 1 g, in exactly one unit (`sizes_at_rest`). A clock
   never falls, and one that counts seconds, ms, us or ns since 1970 is recognised by its size. Columns that are
   constant are no sensor.
3. *What is left is a question.* A size or a name only suggests the rest: it is a proposal, with its reason and with
   what another choice would change. A unit that is stated and not known is never replaced by a guess.

`column_reader.read_columns` returns a `Reading`: for each sensor and the time, the columns, the unit, whether both are
certain, and
why. If all are, `Reading.layout` is what the rows are read by. Otherwise `ColumnsUnclear` carries the question: its
proposal is the text of ``--map``, and ``--accept`` takes it.

This module knows no files: names and the first numbers in, columns out.

>>> import numpy as np
>>> from imumon.sources.files.column_reader import read_columns
>>> rows = np.column_stack([np.arange(50) * 10.0, np.random.default_rng(0).normal([0.0, 0.1, 9.8], 0.01, (50, 3))])
>>> reading = read_columns(["t [ms]", "ax", "ay", "az"], (), rows)
>>> reading.map, reading.certain
('accel=ax,ay,az:m/s^2,t=t:ms', True)
>>> reading = read_columns(["t", "ax", "ay", "az"], (), rows)
>>> [use.reason for use in reading.uses if not use.certain]
['t has no unit: 100 Hz if it is ms, 1e+05 Hz if it is us']
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from imumon.model.cures import option, option_text
from imumon.model.ledger import ColumnUse, column_account
from imumon.model.report import MOST_CHARACTERS
from imumon.model.report_json import plain
from imumon.model.samples import AXES, CHANNELS, INERTIAL, ChannelName, Kind
from imumon.sources.files.base import OptionError, RecordingError
from imumon.sources.files.column_names import NamedColumn, split_unit
from imumon.sources.files.unit_grammar import DIMENSIONS, Unit, known_unit

INCREMENTS = {"gyro": "angle", "accel": "velocity"}
"""Quantity of the increments of a sensor."""

LISTED, MOST_SHOWN = 8, 24
"""Column names that a message lists, and rows of the table of a question."""


KINDS: tuple[Kind, ...] = ("deltas", "uncompensated", "compensated")
"""Kinds of streams, the best first; all but the first are of point samples."""

SENSORS = {"gyro": "gyro", "angle": "gyro", "accel": "accel", "velocity": "accel", "mag": "mag"}
"""Sensor with axes that a quantity belongs to."""

MOST_COLUMNS = 2000
"""Columns of the widest table: logs have some hundreds."""


def check_width(count: int) -> None:
    """Raise `RecordingError` if a table or a record has more columns than any sensor."""
    if count > MOST_COLUMNS:
        text = f"it has {count:,} columns, more than {MOST_COLUMNS:,}"
        raise RecordingError("too_many_columns", text, "write a table with those of the sensor only")


SINCE_1970_S = (1e9, 4.1e9)
"""s, times that count from 1970: the years 2001 to 2099."""

Assumption = Literal["assumed_unit", "assumed_rate", "assumed_columns"]


@dataclass(frozen=True, slots=True)
class Column:
    """A column that is used: its place and name in the table, for what, and how its numbers become SI (times: ns)."""

    index: int
    name: str
    use: ChannelName  # a channel, or ``t`` or ``dt``
    quantity: str
    factor: float = 1.0
    zero: float = 0.0


@dataclass(frozen=True, slots=True)
class ColumnLayout:
    """Columns of a table that form a stream.

    Attributes
    ----------
    kind : of the stream.
    used : columns of the channels in the order of the stream, then those of the time and of the interval.
    remarks : what is assumed, and which sensors are not used.
    caveats : codes of what is assumed.
    gyro, accel : kind of the numbers of a sensor where it is not `kind`.
    rate_hz : Hz, that a comment or the user states; None: none does.
    unused : why a column that is in none of these is not used, by its place in the table.
    """

    kind: Kind
    used: tuple[Column, ...]
    remarks: tuple[str, ...] = ()
    caveats: tuple[str, ...] = ()
    gyro: Kind | None = None
    accel: Kind | None = None
    rate_hz: float | None = None
    unused: Mapping[int, str] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the channels."""
        return tuple(column for column in self.used if column.use in CHANNELS)

    @property
    def channels(self) -> tuple[ChannelName, ...]:
        """Channels of the stream."""
        return tuple(column.use for column in self.columns)

    @property
    def times(self) -> tuple[Column, ...]:
        """Column of time; or two, whose sum is the time."""
        return tuple(column for column in self.used if column.use == "t")

    @property
    def interval(self) -> Column | None:
        """Length of each sample's own interval, for increments."""
        return next((column for column in self.used if column.use == "dt"), None)

    def account(self, names: Sequence[str], unused: Mapping[int, str]) -> tuple[ColumnUse, ...]:
        """Return what became of each column of a table that has a name.

        Parameters
        ----------
        names : of all columns.
        unused : why a column is not used, by its place.
        """
        words = {"t": "time", "dt": "interval"}
        uses = {c.index: words.get(c.use, c.use) for c in self.used if c.index not in unused}
        accounts = [
            ColumnUse(
                name=plain(name.strip())[:MOST_CHARACTERS],
                use=uses.get(k),
                reason=None if k in uses else unused.get(k),
            )
            for k, name in enumerate(names)
            if name.strip()
        ]
        return column_account(accounts)

    @property
    def has_increments(self) -> bool:
        """Whether some columns are angles or velocities, which become rates over the interval."""
        return any(column.quantity in INCREMENTS.values() for column in self.columns)


@dataclass(frozen=True, slots=True)
class Use:
    """What columns are used for.

    Attributes
    ----------
    key : ``gyro``, ``accel``, ``mag``, ``temperature``, ``pressure``, ``t``, ``dt`` or ``rate``.
    columns : their places in the table.
    axes : of a sensor, one for each column.
    unit : as ``--map`` has it; empty: nothing shows it.
    known : what the unit means.
    certain : columns and unit are stated, or physics shows them.
    reason : why, for people.
    assumptions : codes of what is assumed if it is not certain.
    scales : of the columns, units in a number: of counts, or of an axis that is turned around; 0.0 is not known.
    kind : of the numbers of a sensor.
    """

    key: str
    columns: tuple[int, ...] = ()
    axes: tuple[str, ...] = ()
    unit: str = ""
    known: Unit | None = None
    certain: bool = False
    reason: str = ""
    assumptions: tuple[Assumption, ...] = ("assumed_unit",)
    scales: tuple[float, ...] = ()
    kind: Kind = "unknown"

    def factors(self, unit: float) -> list[float]:
        """Return what makes the numbers of each column SI, by the factor of its unit."""
        return [unit * scale for scale in self.scales or [1.0] * len(self.columns)]


@dataclass(frozen=True, slots=True)
class ColumnView:
    """A column as a question shows it: name, unit that is stated, mean, standard deviation, and what it looks like."""

    index: int
    name: str
    unit: str
    mean: float
    std: float
    looks_like: str


class ColumnsUnclear(RecordingError):
    """What the columns of a table are is not certain: a person has to decide.

    Attributes
    ----------
    proposal : text of ``--map``; parts in capitals are what the numbers do not show.
    columns : each column that has numbers.
    reasons : why the proposal is one.
    lacks : what nothing shows, such as the rate, so that it cannot be accepted.
    given : the proposal as options.
    """

    def __init__(self, name: str, reading: Reading, given: str) -> None:
        unclear = [use for use in reading.uses if not use.certain]
        self.proposal, self.columns, self.given = reading.map, reading.views, given
        self.reasons = tuple(plain(use.reason) for use in unclear)
        self.lacks = tuple(use.key for use in unclear if use.known is None)
        self.where = dict(reading.where)
        self.name = plain(name)
        what = "give what is in capitals" if self.lacks else f"{option('accept')} takes it"
        code = "rate_required" if [use.key for use in unclear] == ["rate"] else "columns_unclear"
        super().__init__(code, f"{name}: {'; '.join(self.reasons)}", f"{what}: {given}")

    @property
    def text(self) -> str:
        """The question, for a terminal: table of the columns, proposal and reasons."""
        width = max([len(view.name) for view in self.columns] + [4])
        rows = [f"  {'':>4} {'name':{width}} {'unit':8} {'mean':>11} {'std. dev.':>11}  looks like"]
        for view in self.columns:
            numbers = f"{view.mean:11.5g} {view.std:11.3g}"
            rows.append(
                f"  {view.index + 1:>4} {view.name:{width}} {view.unit:8} {numbers}  {view.looks_like}"
            )
        reasons = [f"  - {reason}" for reason in self.reasons]
        return "\n".join(
            [
                self.name + ": what its columns are is not certain",
                *rows,
                *reasons,
                f"proposal: {self.given}",
            ]
        )


@dataclass(frozen=True, slots=True)
class Reading:
    """What the columns of a table are.

    Attributes
    ----------
    names : of all columns.
    uses : of the sensors and the time.
    views : each column that has numbers, for a question.
    where : rows that are read, by column.
    remarks : what is not used, or doubtful.
    unused : why other columns are not used, by their places.
    """

    names: tuple[str, ...]
    uses: tuple[Use, ...]
    views: tuple[ColumnView, ...] = ()
    where: tuple[tuple[str, str], ...] = ()
    remarks: tuple[str, ...] = ()
    unused: Mapping[int, str] = field(default_factory=dict)

    @property
    def certain(self) -> bool:
        """Whether nothing is left to ask."""
        return all(use.certain for use in self.uses)

    @property
    def map_fields(self) -> dict[str, str]:
        """The proposal as fields of ``--map``."""
        fields = {}
        for use in (use for use in self.uses if use.key != "rows"):
            references = [
                reference(k, self.names) + ("" if scale == 1.0 else f"*{scale:.12g}" if scale else "*SCALE")
                for k, scale in zip(use.columns, use.factors(1.0), strict=True)
            ]
            unit = use.unit or ("HZ" if use.key == "rate" else "UNIT")
            if use.key == "rate":
                fields["rate"] = unit
            elif use.key == "t" and len(use.columns) == 2:
                parts = unit.split("+")
                fields["t"] = f"{references[0]}:{parts[0]}+{references[1]}:{parts[-1]}"
            elif use.axes in (("",), AXES):
                fields[use.key] = f"{','.join(references)}:{unit}"
            else:
                fields |= {
                    f"{use.key}/{axis}": f"{text}:{unit}"
                    for axis, text in zip(use.axes, references, strict=True)
                }
        return fields

    @property
    def map(self) -> str:
        """The proposal as text of ``--map``."""
        return ",".join(f"{key}={text}" for key, text in self.map_fields.items())

    @property
    def given_text(self) -> str:
        """The proposal as options, or as arguments of a call."""
        where = {} if not self.where else {"where": dict(self.where)}
        return option_text(**where, columns=self.map_fields)

    def checked(self, name: str, *, accept: bool) -> Reading:
        """Return the reading that is used: all of it is certain or accepted, or is in the map of the user.

        Raises
        ------
        ColumnsUnclear : something is not, or cannot be accepted because nothing shows it.
        """
        if self.certain:
            return self
        if not accept:
            raise ColumnsUnclear(name, self, self.given_text)
        # a sensor in counts is left out beside one whose unit is known
        kept = tuple(use for use in self.uses if use.certain or use.known is not None)
        if not any(use.key in INERTIAL for use in kept) or any(
            u.key in ("t", "rate") for u in self.uses if u not in kept
        ):
            raise ColumnsUnclear(name, self, self.given_text)
        left_out = [f"{use.key} is not used: {use.reason}" for use in self.uses if use not in kept]
        return replace(self, uses=kept, remarks=(*self.remarks, *left_out))

    def layout(self, stream: Kind | None = None) -> ColumnLayout:
        """Return the columns that the rows are read by."""
        by_key = {use.key: use for use in self.uses}
        kinds = {key: by_key[key].kind for key in INERTIAL if key in by_key}
        points = [kind for kind in kinds.values() if kind != "deltas"]
        assumed = [use for use in self.uses if not use.certain]
        rate = by_key.get("rate")
        return ColumnLayout(
            _kind_of_stream(stream, points), tuple(self._used_columns()),
            remarks=(*(f"assumed: {use.reason}" for use in assumed), *self.remarks),
            caveats=tuple(dict.fromkeys(code for use in assumed for code in use.assumptions)),
            gyro="deltas" if points and kinds.get("gyro") == "deltas" else None,
            accel="deltas" if points and kinds.get("accel") == "deltas" else None,
            rate_hz=None if rate is None or rate.known is None else rate.known.factor,
            unused=self.unused,
        )  # fmt: skip

    def _used_columns(self) -> Iterator[Column]:
        """Yield the columns whose unit is known: of the channels in the order of a stream, the time, the interval."""
        by_key = {use.key: use for use in self.uses}
        for key in (*dict.fromkeys(name.sensor for name in CHANNELS), "t", "dt"):
            use = by_key.get(key)
            if use is None or use.known is None:
                continue
            factors = use.factors(use.known.factor)
            if key == "t":
                factors = [factor * 1e9 for factor in factors_of(use)]
            for index, axis, factor in zip(use.columns, use.axes, factors, strict=True):
                name, channel = plain(self.names[index]), ChannelName(f"{key}/{axis}" if axis else key)
                yield Column(index, name, channel, use.known.quantity, factor, use.known.zero)


def factors_of(use: Use) -> list[float]:
    """Return the seconds in a unit of each column of a time or an interval."""
    parts = [known_unit(part, "t") for part in use.unit.split("+")]
    scales = use.factors(1.0)
    return [part.factor * scale for part, scale in zip(parts, scales, strict=True) if part is not None]


def _kind_of_stream(stream: Kind | None, points: Sequence[Kind]) -> Kind:
    """Return the kind of a stream whose point samples have some kinds; without any, it is of increments."""
    if not points:
        return "deltas"
    return points[0] if stream is None or stream == "deltas" else stream


# ---------------------------------------------------------------- the map


def parse_map(text: str) -> dict[str, str]:
    """Return a ``--map`` as columns by channel; raise `OptionError` if it has another form.

    >>> parse_map("gyro=gx,gy,gz:deg/s,t=time:ms")
    {'gyro/x': 'gx:deg/s', 'gyro/y': 'gy:deg/s', 'gyro/z': 'gz:deg/s', 't': 'time:ms'}
    >>> parse_map("gyro/x=wx:deg/s,rate=100")
    {'gyro/x': 'wx:deg/s', 'rate': '100'}
    """
    fields: dict[str, str] = {}
    for part in re.split(rf",\s*(?=(?:{'|'.join(MAP_KEYS)})\s*=)", text):
        key, equals, columns = part.strip().partition("=")
        if not equals or key.strip() not in MAP_KEYS:
            cure = "write gyro=COLUMN,COLUMN,COLUMN:UNIT or gyro/x=COLUMN:UNIT; the names are "
            raise _map_syntax(f"{part.strip()!r} names no channel", cure + ", ".join(MAP_KEYS))
        fields |= _entries(key.strip(), [column.strip() for column in columns.split(",")])
    return fields


MAP_KEYS = (*dict.fromkeys(SENSORS.values()), *CHANNELS, "t", "dt", "rate")
"""Names of a map: a sensor with its axes, a channel, the time, the interval, the rate."""


def _map_syntax(fault: str, cure: str) -> OptionError:
    return OptionError("map_syntax", f"{option('columns')} {fault}", cure)


def _entries(key: str, columns: Sequence[str]) -> dict[str, str]:
    """Return the channels of one part of a map; the unit behind the last column of a sensor is that of all."""
    has_axes = key in SENSORS.values()
    if len(columns) == 1:
        return {f"{key}/x" if has_axes else key: columns[0]}
    if not has_axes or len(columns) != len(AXES):
        cure = (
            f"a sensor has three, {key}=COLUMN,COLUMN,COLUMN:UNIT" if has_axes else f"write {key}=COLUMN:UNIT"
        )
        raise _map_syntax(f"gives {key} {len(columns)} columns", cure)
    unit = "".join(columns[-1].rpartition(":")[1:])
    named = [column if ":" in column else column + unit for column in columns]
    return {f"{key}/{axis}": column for axis, column in zip(AXES, named, strict=True)}


def parse_where(text: str) -> dict[str, str]:
    """Return ``sensor=4,device=A`` as a dict; raise `OptionError` if it has another form."""
    values = {}
    for part in text.split(","):
        column, equals, value = part.partition("=")
        if not equals or not column.strip():
            message = f"{option('where')} {part.strip()!r} names no column"
            raise OptionError("where_syntax", message, "write COLUMN=VALUE, such as sensor=4")
        values[column.strip()] = value.strip()
    return values


def find(names: Sequence[str], text: str) -> int | None:
    """Return the place of a column by its name, with or without unit, or by its number from 1; None: there is none."""
    for spelling in ([name.strip() for name in names], [split_unit(name)[0].strip() for name in names]):
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


_SCALED = re.compile(r"(.+?)(?:([/*])([-+]?[\d.]+(?:[eE][-+]?\d+)?|-?[A-Z_]+))?(?::([^:]*))?")
"""Column of a map with its scale, which is a number or a word for what only the owner knows, and its unit."""


def given_column(names: Sequence[str], text: str) -> tuple[int, str, float]:
    """Return the column, the unit and the scale of ``COLUMN``, ``COLUMN*0.5:UNIT`` or such; 0.0: a scale is unknown.

    >>> given_column(["t", "ax"], "ax/4:g"), given_column(["t", "a:x"], "a:x"), given_column(["gx"], "gx*SCALE:deg/s")
    ((1, 'g', 0.25), (1, '', 1.0), (0, 'deg/s', 0.0))
    """
    head, _, unit_behind = text.rpartition(":")
    scaled = _SCALED.fullmatch(text)
    column, sign, size, unit = scaled.groups() if scaled else ("", None, None, None)
    for name, scale, of in ((text, None, ""), (head, None, unit_behind), (column, size, unit or "")):
        if name and (index := find(names, name)) is not None:
            number = 1.0 if scale is None else 0.0 if scale.strip("+-")[0].isalpha() else float(scale)
            return index, of, 1.0 / number if sign == "/" and number else number
    listed = ", ".join(plain(n.strip()) for n in names[:LISTED])
    message = f"no column {head or text!r} for {option('columns')}"
    raise RecordingError("unknown_column", message, f"there are {listed}")


def reference(index: int, names: Sequence[str]) -> str:
    """Return how ``--map`` names a column: by its name without unit, or by its number if that is ambiguous.

    >>> reference(0, ["gyro[0]", "t"]), reference(1, ["a [s]", "a [g]"]), reference(0, ["a,b"])
    ('gyro[0]', '2', '1')
    """
    name = split_unit(names[index])[0].strip()
    try:
        plain_name = name and not set(name) & set(",=:+*/'\" ") and find(names, name) == index
    except RecordingError:
        plain_name = False
    return name if plain_name else str(index + 1)


def check_meaning(units: Mapping[str, str], samples: str | None) -> None:
    """Check what a caller states before anything is read; raise `OptionError` if it has no meaning."""
    if samples is not None and samples not in ("point", "average", "increment"):
        cure = "use one of point, average, increment, or leave it out"
        raise OptionError("kind_unknown", f"kind={samples!r} is no kind of sample", cure)
    for name, text in units.items():
        quantity = {"time": "t"}.get(name, name)
        if quantity not in DIMENSIONS or quantity in INCREMENTS.values():
            raise OptionError(
                "units_of_unknown",
                f"units has {name!r}, which is no sensor",
                "the names are gyro, accel, mag, temperature, pressure, time",
            )
        known = known_unit(str(text), quantity)
        wanted = INCREMENTS.get(quantity, quantity) if samples == "increment" else quantity
        if known is None or known.quantity != wanted:
            raise OptionError(
                "unknown_unit", f"{text!r} is no unit of {name}", "use one such as rad/s, deg/s, g, m/s^2, ms"
            )


def views_of(columns: Sequence[NamedColumn], uses: Mapping[str, Use]) -> Iterator[ColumnView]:
    """Yield the columns that a question shows: those that are used first."""
    looks = {
        k: {"t": "time", "dt": "interval"}.get(key, key) for key, use in uses.items() for k in use.columns
    }
    shown = sorted((c for c in columns if len(c.present)), key=lambda c: c.index not in looks)[:MOST_SHOWN]
    for column in sorted(shown, key=lambda c: c.index):
        name, unit = plain(column.base or "-")[:32], plain(column.unit or "-")[:8]
        mean, std = float(np.mean(column.present)), float(np.std(column.present))
        looks_like = looks.get(column.index, "constant" if column.constant else "")
        yield ColumnView(column.index, name, unit, mean, std, looks_like)
