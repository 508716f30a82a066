"""Column reader: what the columns of one table are, by their names, their numbers, and what the user gives.

Each triple of columns, and each single one that a triple does not have, is asked the same: is it of a sensor, and in
which unit? What is stated or given answers first. Then the size at rest does (`sizes_at_rest`): an accelerometer has
the length of 1 g, its increments have it over their interval. A gyroscope has only its noise, so that its unit is a
proposal. The clock comes before (`column_clock`), because increments need the interval. `columns` has the theory.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from imumon.model.cures import option, option_text
from imumon.model.report_json import plain
from imumon.model.samples import AXES, INERTIAL, ChannelName, Floats, Kind
from imumon.sources.files.base import OptionError, ReadOptions, RecordingError
from imumon.sources.files.column_clock import ColumnClock, interval_among, step_of
from imumon.sources.files.column_names import (
    ANGULAR,
    COUNTER,
    COUNTS,
    DELTA,
    LINEAR,
    OTHER,
    TIME,
    NamedColumn,
    Triple,
    inertial_sensor_of,
    is_of_another_sensor,
    is_of_one_axis,
    kind_of,
    named_channel,
    names_sensor,
    split_unit,
    triples,
    words_of,
)
from imumon.sources.files.columns import (
    INCREMENTS,
    KINDS,
    LISTED,
    SENSORS,
    Assumption,
    Reading,
    Use,
    check_meaning,
    check_width,
    find,
    given_column,
    reference,
    views_of,
)
from imumon.sources.files.sizes_at_rest import (
    FASTEST_RATE,
    NOISIEST,
    NOISIEST_DEG,
    STRONGEST,
    counts_of_gravity,
    doubt_at_rest,
    is_direction,
    is_one_g,
    same_sensor,
    sample_noise,
    unit_of_rate,
    units_of_gravity,
)
from imumon.sources.files.unit_grammar import POSSIBLE_HZ, StatedRate, Unit, known_unit

MOST_NAMELESS = 3
"""Triples without a name and a unit that may be gyroscopes: more of them are a list, such as samples one behind the
other in a record."""

PLAUSIBLE = {"temperature": (-60.0, 130.0), "pressure": (20.0, 130.0)}
"""degC and kPa, numbers of sensors and of air: other numbers of that name are something else."""


def read_columns(
    names: Sequence[str],
    units: Sequence[str],
    rows: Floats,
    options: ReadOptions | None = None,
    *,
    source: str = "",
    rate: StatedRate | None = None,
    dates: Sequence[int] = (),
) -> Reading:
    """Return what the columns of a table are.

    Parameters
    ----------
    names, units : of all columns; empty: not stated. A unit may also be a part of a name.
    rows : (n, k) the first numbers; not finite is missing.
    options : of the user: ``columns``, ``rate_hz``, ``sensor``, ``units``, ``samples``, ``kind``.
    source : texts that may say of which sensor the rows are, the nearest first, a line each.
    rate : that a comment states.
    dates : columns that were dates; their numbers are seconds.

    Raises
    ------
    RecordingError : no column is that of a sensor, a stated unit is not known, or a map names what is not there.
    """
    check_width(len(names))
    options = options or ReadOptions()
    check_meaning(options.units, options.samples)
    if (given := (options.columns or {}).get("rate")) is not None:
        options = replace(options, rate_hz=_rate_of(given))
    columns = _named_columns(names, units, rows)
    if units and any(map(_has_unit_of_another, columns)):  # the line is not that of these names
        columns = _named_columns(names, (), rows)
    clock = ColumnClock(columns, options, rate, set(dates))
    return _ColumnReader(columns, options, source, clock).reading()


class _ColumnReader:
    """Reads the columns of one table; see `read_columns`."""

    def __init__(
        self, columns: Sequence[NamedColumn], options: ReadOptions, source: str, clock: ColumnClock
    ) -> None:
        self._names = tuple(column.name for column in columns)
        self._columns, self._options, self._clock = columns, options, clock
        words = map(words_of, source.split("\n"))
        named = (
            [word for word, part in (("gyro", "gyr"), ("accel", "acc")) if part in line] for line in words
        )
        # sensor that the nearest text says
        self._hint = next((of_line[0] for of_line in named if len(of_line) == 1), "")
        self._remarks: list[str] = []
        self._given = self._given_uses()
        self._taken = {k for use in self._given.values() for k in use.columns}
        self._triples = triples(columns)
        self._step_s: float | None = None
        self._gravity: Triple | None = None  # accelerometer of 1 g

    def reading(self) -> Reading:
        """Return the sensors, the time, and what is beside them."""
        of_triples = {k for t in self._triples if not any(c.rises for c in t.columns) for k in t.indices}
        time = self._given.get("t") or self._clock.time(self._taken | of_triples)
        dt = self._given.get("dt")
        self._step_s = step_of(dt or time, self._columns)
        uses = self._sensors()
        if not uses:
            raise self._no_sensor()
        if dt is None and any(use.kind == "deltas" for use in uses.values()):
            dt = interval_among(self._free([*uses.values(), time]), self._step_s)
        uses = {use.key: use for use in (*uses.values(), time, dt) if use is not None}
        uses |= self._beside(self._free(uses.values()))
        unused = {column.index: _why_unused(column) for column in self._free(uses.values())}
        views = tuple(views_of(self._columns, uses))
        return Reading(self._names, tuple(uses.values()), views, remarks=tuple(self._remarks), unused=unused)

    def _free(self, uses: Iterable[Use]) -> list[NamedColumn]:
        """Return the columns that have none of some uses."""
        used = {k for use in uses for k in use.columns}
        return [column for column in self._columns if column.index not in used]

    # ------------------------------------------------------------ sensors

    def _sensors(self) -> dict[str, Use]:
        """Return the gyroscope and the accelerometer, the best of all that the columns may be."""
        wanted = [key for key in INERTIAL if self._options.sensor in (None, key)]
        chosen = {key: use for key, use in self._given.items() if key in wanted}
        # who names a sensor, or an axis of one, is not asked about it
        named = {ChannelName(channel).sensor for channel in self._options.columns or {}}
        candidates = sorted(self._candidates(), key=self._rank)
        for key in [key for key in wanted if key not in named]:
            ranked = [use for use in candidates if use.key == key]
            if ranked and chosen.keys() & self._given.keys() and not ranked[0].certain:
                self._remarks.append(f"{key} is not used: {ranked[0].reason}")
            elif ranked:
                chosen[key] = self._with_stated_meaning(self._beside_samples(ranked))
                self._note_others(key, ranked)
        if "gyro" in chosen and "gyro" not in self._given:
            chosen["gyro"] = self._beside_increments(chosen["gyro"], chosen.get("accel"))
        return {key: chosen[key] for key in wanted if key in chosen}

    def _candidates(self) -> list[Use]:
        """Return all gyroscopes and accelerometers that the columns not given by the user may be."""
        free = [t for t in self._triples if not self._taken & set(t.indices)]
        moving = [t for t in free if _moves(t)]
        self._gravity = next(filter(_unit_of_one_g, moving), None)
        uses = self._of_triples(moving)
        keys = {use.key for use in uses}
        if keys == {"accel"}:
            uses += self._quiet_gyro(moving, uses)
        of_triples = {k for triple in free for k in triple.indices}
        singles = self._single_axes(of_triples) if len(keys) < len(INERTIAL) else ()
        return [*uses, *(use for use in singles if use.key not in keys)]

    def _of_triples(self, moving: Sequence[Triple]) -> list[Use]:
        """Return the sensors that triples are, without gyroscopes of no name if these are a list."""
        uses = [_in_order(use, triple) for triple in moving if (use := self._sensor(triple)) is not None]
        nameless = [use for use in uses if use.key == "gyro" and "assumed_columns" in use.assumptions]
        return [use for use in uses if use not in nameless] if len(nameless) > MOST_NAMELESS else uses

    def _quiet_gyro(self, moving: Sequence[Triple], uses: Sequence[Use]) -> list[Use]:
        """Return the gyroscope beside an accelerometer: three numbers of one name that move around a constant."""
        used = {k for use in uses for k in use.columns}
        quiet = [t for t in moving if not used & set(t.indices) and _may_be_gyro(t)]
        return [self._gyro(triple, named=False) for triple in quiet[:1]]

    def _sensor(self, triple: Triple) -> Use | None:
        """Return the sensor that a triple is, with its unit; None: it is none."""
        words, quantity = self._words(triple), triple.known_quantity
        if (use := self._increments_of_gravity(triple, words)) is not None:
            return use
        if is_of_another_sensor(words, quantity):
            return None
        if quantity is not None:
            return self._stated(triple, quantity)
        key = inertial_sensor_of(words)
        # the letter is of both sensors: of the only one of 1 g, it is the unit
        if words.strip() == "g" and self._gravity is None and "g" in units_of_gravity(triple.size):
            return replace(_by_gravity(triple, named=False), certain=False)
        if triple.unit:
            return self._of_unknown_unit(triple, key) if key else None
        if key or units_of_gravity(triple.size):
            return self._by_size(triple, key or "accel", delta=bool(DELTA.search(words)), named=bool(key))
        if words.strip():
            return None
        if triple.counts and counts_of_gravity(triple.size):
            return _in_counts(triple, "accel")
        return self._gyro(triple, named=False)

    def _words(self, triple: Triple) -> str:
        """Return the words of a triple; those of the text before the table if they say both sensors, or no name one."""
        if ANGULAR.search(triple.words) and LINEAR.search(triple.words) and not OTHER.search(triple.words):
            return self._hint
        is_named = any(names_sensor(t.stem) for t in self._triples)
        return triple.words if is_named else f"{triple.words} {self._hint}"

    def _by_size(self, triple: Triple, key: str, *, delta: bool, named: bool) -> Use:
        """Return a sensor without a unit, in the one that its size shows or suggests."""
        if delta:
            unit, other = "m/s", ""
            if key == "gyro":
                unit, other = "rad", f"; in deg, N would be {_times(math.radians(1.0))}"
            reason = f"{triple.label} have the name of increments and no unit{other}"
            return _use(key, triple, unit, reason, kind="deltas")
        if key == "gyro":
            return self._gyro(triple, named=named)
        return _by_gravity(triple, named=named)

    def _gyro(self, triple: Triple, *, named: bool) -> Use:
        """Return a gyroscope without a unit: in counts, unless its whole numbers are beside such of mg."""
        beside = self._gravity
        if triple.counts and not (beside is not None and beside.counts and _unit_of_one_g(beside) == "mg"):
            return _in_counts(triple, "gyro")
        return _by_noise(triple, beside, named=named)

    def _increments_of_gravity(self, triple: Triple, words: str) -> Use | None:
        """Return increments of velocity whose length over the interval is 1 g; None: it is not."""
        named = DELTA.search(words) is not None
        other = re.search(r"acc|mag|quat|pos", words) or ANGULAR.search(words)
        if triple.unit or not self._step_s or len(triple.axes) < len(AXES) or (other and not named):
            return None
        units = {"m/s^2": "m/s", "g": "g*s"} if named else {"m/s^2": "m/s"}
        unit = next((units[u] for u in units_of_gravity(triple.size / self._step_s) if u in units), None)
        if unit is None:
            return None
        reason = f"the length of {triple.label} over the interval is 1 g in {unit}: they are increments"
        of_columns: tuple[Assumption, ...] = ("assumed_columns",)
        return _use("accel", triple, unit, reason, certain=named, assumptions=of_columns, kind="deltas")

    def _stated(self, triple: Triple, quantity: str) -> Use | None:
        """Return a sensor whose unit is stated; None: it is an orientation, or a velocity over ground."""
        key, unit, words = SENSORS[quantity], triple.unit, self._words(triple)
        if quantity in INCREMENTS.values() and not DELTA.search(words):
            return _rates_in_angles(triple) if quantity == "angle" and ANGULAR.search(words) else None
        kind = "deltas" if quantity in INCREMENTS.values() else kind_of(triple.words)
        named = inertial_sensor_of(triple.words)
        # one number of that unit may be any speed: its name says that it is of a sensor
        certain = named == key or (not named and (len(triple.axes) == len(AXES) or self._hint == key))
        of_other = f"{triple.label} have the unit {unit}, and the name of {named or 'no sensor'}"
        reason = "its unit is stated" if certain else of_other
        return self._at_rest(_use(key, triple, unit, reason, certain=certain, kind=kind), triple, quantity)

    def _at_rest(self, use: Use, triple: Triple, quantity: str) -> Use:
        """Return a sensor with its stated unit, or a question if its size is 1 g in another one; note other doubts."""
        assert use.known is not None
        doubt = doubt_at_rest(quantity, triple.rows * use.known.factor, 10.0 * NOISIEST)
        if doubt and quantity == "accel" and (reason := _contradiction(triple, use.unit, use.known)):
            other = next(iter(units_of_gravity(triple.size)), use.unit)
            return _use(use.key, triple, other, reason, kind=use.kind)
        if doubt:
            self._remarks.append(f"{triple.label} in {use.unit}: {doubt}")
        return use

    def _of_unknown_unit(self, triple: Triple, key: str) -> Use | None:
        """Return a sensor in counts; raise `RecordingError` if its unit is stated and not known."""
        if COUNTS.match(triple.unit):
            return _in_counts(triple, key)
        if key in self._options.units or self._options.columns:
            return None
        text = f"the unit {triple.unit!r} of {triple.label} is not known"
        given = option_text(columns={key: f"{self._listed(triple.indices)}:UNIT"})
        raise RecordingError("unknown_unit", text, f"say which it is, {given}")

    def _listed(self, indices: Sequence[int]) -> str:
        return ",".join(reference(k, self._names) for k in indices)

    def _single_axes(self, of_triples: set[int]) -> Iterator[Use]:
        """Yield the sensors of one axis: a single column by its unit or name, where the sensor has no triple."""
        alone: dict[str, list[Use]] = {}
        for column in self._columns:
            words = column.words or self._hint
            if column.index in of_triples | self._taken or not is_of_one_axis(column, words):
                continue
            axis = re.search(r"(?:^| )([xyz])(?: |$)|([xyz])$", words)
            triple = Triple((column,), ((axis[1] or axis[2]) if axis else "x",), column.base)
            if (use := self._sensor(triple)) is not None:
                alone.setdefault(use.key, []).append(use)
        for uses in alone.values():
            if len(uses) == 1:
                yield uses[0]
            else:
                listed = ", ".join(self._names[use.columns[0]] for use in uses)
                self._remarks.append(f"{listed} not used: a sensor has one axis or three")

    def _rank(self, use: Use) -> tuple[object, ...]:
        """Return the order in which sensors are chosen: what is certain, averages, then raw numbers; the first."""
        wanted = self._options.kind
        kinds = [wanted, *KINDS] if wanted else [*KINDS]
        order: float = kinds.index(use.kind) if use.kind in kinds else 1.5
        # what only a size shows to be increments comes last
        inferred = use.kind == "deltas" and (not use.certain or "assumed_columns" in use.assumptions)
        words = words_of(self._names[use.columns[0]])
        direct = re.search(r"gyr" if use.key == "gyro" else r"acc", words)
        fused = re.search(r"motion|user|fused|rotation ?rate", words) is not None
        # the field of the earth has a length, and the rate of a sensor at rest hardly one
        is_unnamed = "assumed_columns" in use.assumptions and use.key == "gyro"
        return (
            wanted is not None and use.kind != wanted,
            use.known is None,
            not use.certain or inferred,
            len(kinds) if inferred else order,
            fused,
            not direct or re.search(r"user|linear accel", words) is not None,
            self._triple_of(use).size if is_unnamed else 0.0,
            use.columns,
        )

    def _triple_of(self, use: Use) -> Triple:
        columns = tuple(self._columns[k] for k in use.columns)
        return Triple(columns, use.axes, columns[0].base)

    def _beside_samples(self, ranked: Sequence[Use]) -> Use:
        """Return the best of some uses, with a question if others of its name may be further samples of it in a row."""
        best, *others = ranked
        first = self._triple_of(best)
        name = re.sub(r"\d", "", first.columns[0].base)
        for other in map(self._triple_of, others):
            alike = other.axes == first.axes and re.sub(r"\d", "", other.columns[0].base) == name
            if alike and same_sensor(first.rows, other.rows):
                reason = f"{other.label} have the mean and the noise of {first.label}: a row may have several samples"
                reason += "" if best.certain else f"; {best.reason}"
                assumptions = dict.fromkeys((*(() if best.certain else best.assumptions), "assumed_columns"))
                return replace(best, certain=False, reason=reason, assumptions=tuple(assumptions))
        return best

    def _note_others(self, key: str, ranked: Sequence[Use]) -> None:
        for other in ranked[1:]:
            listed = self._listed(other.columns)
            use_it = option_text(columns={key: f"{listed}:{other.unit or 'UNIT'}"})
            self._remarks.append(f"{listed} not used: another {key}; {use_it} uses it")

    def _with_stated_meaning(self, use: Use) -> Use:
        """Return a sensor with the unit and the kind of samples that the caller states."""
        samples, unit = self._options.samples, self._options.units.get(use.key)
        if samples == "point" and use.kind == "deltas":
            text = f"{', '.join(self._names[k] for k in use.columns)} are increments, and kind='point' is for rates"
            raise OptionError("kind_contradicts", text, "use kind='increment', or leave it out")
        if samples == "increment" and unit is None and use.kind != "deltas":
            unit = "rad" if use.key == "gyro" else "m/s"
        if unit is not None:
            known = known_unit(unit)
            use = replace(use, unit=unit, known=known, certain=True, reason="its unit is given", scales=())
        return replace(use, kind="deltas") if samples in ("average", "increment") else use

    def _beside_increments(self, gyro: Use, accel: Use | None) -> Use:
        """Return a gyroscope, compared with increments of the same motion."""
        if gyro.certain or gyro.kind == "deltas":
            return gyro
        triple = self._triple_of(gyro)
        if accel is not None and accel.kind == "deltas" and "assumed_columns" in gyro.assumptions:
            reason = f"{triple.label} are beside increments: rad"
            return _use("gyro", triple, "rad", reason, assumptions=("assumed_columns",), kind="deltas")
        noise = sample_noise(triple.rows) * (self._step_s or 0.0)
        for other in self._triples:
            of_deltas = DELTA.search(other.words) and not OTHER.search(other.words)
            if noise and of_deltas and abs(sample_noise(other.rows) / noise / math.degrees(1.0) - 1.0) < 0.1:
                reason = (
                    f"{gyro.reason}; {other.label} over their interval are 57.3 times as large: these are "
                )
                reason += "rad/s, and those deg"
                return replace(gyro, unit="rad/s", known=known_unit("rad/s"), reason=reason)
        return gyro

    # ------------------------------------------------------------ what the user gives

    def _given_uses(self) -> dict[str, Use]:
        """Return what the map of the user names."""
        given: dict[str, list[tuple[str, int, str, float]]] = {}
        uses: dict[str, Use] = {}
        for channel, text in (self._options.columns or {}).items():
            key, _, axis = channel.partition("/")
            if key == "t" and "+" in text and find(self._names, text) is None:
                uses["t"] = self._given_pair(text)
            elif key != "rate":
                given.setdefault(key, []).append((axis, *given_column(self._names, text)))
        for key, named in given.items():
            uses[key] = self._given_use(key, sorted(named))
        twice = [k for k, n in Counter(k for use in uses.values() for k in use.columns).items() if n > 1]
        if twice:
            text = f"{option('columns')} gives {self._names[twice[0]]} to two channels"
            raise RecordingError("column_twice", text, "name another column for each axis")
        return uses

    def _given_pair(self, text: str) -> Use:
        """Return the time whose seconds and parts of a second are in two columns."""
        parts = [given_column(self._names, part) for part in text.split("+")]
        unit = "+".join(part[1] or default for part, default in zip(parts, ("s", "ns"), strict=False))
        columns = tuple(part[0] for part in parts)
        return Use("t", columns, ("", ""), unit, known_unit("s", "t"), True, "it is given")

    def _given_use(self, key: str, named: Sequence[tuple[str, int, str, float]]) -> Use:
        """Return one sensor, or the time, that the user names; without a unit, that of the name or of the numbers."""
        axes, scales = tuple(axis for axis, *_ in named), tuple(scale for *_, scale in named)
        if key in SENSORS.values() and len(axes) == 2:
            missing = next(axis for axis in AXES if axis not in axes)
            text = f"{option('columns')} names only a part of {key}: {key}/{missing} is missing"
            raise RecordingError("map_incomplete", text, f"name it too, {key}/{missing}=COLUMN:UNIT")
        columns = [self._columns[index] for _, index, *_ in named]
        units = [*dict.fromkeys(unit for *_, unit, _ in named if unit)]
        if len(units) > 1:
            text = f"{option('columns')} gives the axes of {key} the units {' and '.join(units)}"
            raise OptionError("map_syntax", text, "give one for all of them; COLUMN*2:UNIT scales an axis")
        unit, known = self._given_unit(key, columns, [*units, ""][0])
        scaled = tuple(
            replace(column, values=column.values * scale, unit=unit, known=known)
            for column, scale in zip(columns, scales, strict=True)
        )
        triple = Triple(scaled, axes, columns[0].base)
        if 0.0 in scales:
            reason = f"the size of {triple.label} is what only the owner knows: it is in the data sheet"
            return replace(_use(key, triple, unit, reason, scales=scales), known=None)
        if known is not None:
            return self._with_given_unit(
                _use(key, triple, unit, "it is given", certain=True, scales=scales), triple
            )
        if key == "t":
            return self._clock.use_of(columns[0])
        if key in INERTIAL:
            self._step_s, self._gravity = None, None
            return replace(self._by_size(triple, key, delta=False, named=True), scales=scales)
        default = {"temperature": "degC", "dt": "s"}.get(key, "")
        return _use(
            key, triple, default, f"{columns[0].name} has no unit", certain=bool(default), scales=scales
        )

    def _with_given_unit(self, use: Use, triple: Triple) -> Use:
        """Return what the user names with its unit; raise `RecordingError` if its numbers cannot have that one."""
        assert use.known is not None
        if reason := _contradiction(triple, use.unit, use.known):
            units = units_of_gravity(triple.size) if use.key == "accel" else []
            given = option_text(columns={use.key: f"{self._listed(triple.indices)}:{[*units, 'UNIT'][0]}"})
            raise RecordingError("wrong_unit", reason, f"give the unit that they have, such as {given}")
        is_average = self._options.samples in ("average", "increment") and use.key in INERTIAL
        return replace(use, kind="deltas") if is_average or use.known.quantity in INCREMENTS.values() else use

    def _given_unit(self, key: str, columns: Sequence[NamedColumn], given: str) -> tuple[str, Unit | None]:
        """Return the unit that the user gives, else that of a name; empty and None: neither is one of the sensor."""
        unit = given or self._options.units.get("time" if key == "t" else key, "")
        stated = unit or next((column.unit for column in columns if column.unit), "")
        known = known_unit(stated, key) if stated else None
        quantity = "t" if key == "dt" else key
        if known is not None and SENSORS.get(known.quantity, known.quantity) == quantity:
            return stated, known
        if unit:
            what = "a time" if quantity == "t" else key
            text = f"the unit {unit!r} in {option('columns')} is none of {what}"
            raise RecordingError("unknown_unit", text, "use one such as rad/s, deg/s, m/s^2, g, ms")
        return "", None

    # ------------------------------------------------------------ what is beside the sensors

    def _beside(self, free: Sequence[NamedColumn]) -> dict[str, Use]:
        """Return magnetometer, temperature and pressure whose unit is stated, or shown by the size."""
        uses = {key: use for key, use in self._given.items() if key in ("mag", *PLAUSIBLE)}
        indices = {column.index for column in free}
        for triple in self._triples:
            is_free = indices.issuperset(triple.indices) and not all(c.constant for c in triple.columns)
            if is_free and triple.known_quantity == "mag" and self._options.sensor is None:
                uses.setdefault("mag", _use("mag", triple, triple.unit, "its unit is stated", certain=True))
        for use in filter(None, map(_slow_sensor, sorted(free, key=lambda c: (c.constant, not c.unit)))):
            uses.setdefault(use.key, use)
        return uses

    def _no_sensor(self) -> RecordingError:
        constant = [t for t in self._triples if names_sensor(t.stem) and all(c.constant for c in t.columns)]
        if constant and len(constant[0].rows) > 1:
            text = f"every value of {constant[0].label} is the same: there is no noise"
            cure = "pass samples of a sensor that is on, with all their digits"
            return RecordingError("all_constant", text, cure)
        listed = ", ".join(plain(name.strip()) or "-" for name in self._names[:LISTED])
        more = ", ..." if len(self._names) > LISTED else ""
        text = f"no column is that of a gyroscope or accelerometer ({listed}{more})"
        cure = f"name them, {option_text(columns={'gyro': 'COLUMN,COLUMN,COLUMN:UNIT'})}"
        return RecordingError("no_sensor", text, cure)


def _rate_of(text: str) -> float:
    """Return a sample rate, Hz; raise `OptionError` if it is none."""
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not POSSIBLE_HZ[0] <= rate <= POSSIBLE_HZ[1]:
        raise OptionError("rate_invalid", f"{text!r} is no sample rate", "write for example rate=100")
    return rate


def _use(
    key: str,
    triple: Triple,
    unit: str,
    reason: str,
    *,
    certain: bool = False,
    assumptions: tuple[Assumption, ...] = ("assumed_unit",),
    scales: tuple[float, ...] = (),
    kind: Kind | None = None,
) -> Use:
    """Return the sensor that a triple is in a unit; empty: nothing shows it."""
    known, kind = known_unit(unit, key) if unit else None, kind or kind_of(triple.words)
    return Use(key, triple.indices, triple.axes, unit, known, certain, reason, assumptions, scales, kind)


def _rates_in_angles(triple: Triple) -> Use | None:
    """Return a gyroscope whose stated unit is one of angles; None: it is an orientation."""
    if re.search(r"angle|pose|position", triple.words):
        return None
    unit = triple.unit
    reason = f"{triple.label} have the unit {unit}, which is none of a rate: {unit}/s is meant, or they are increments"
    return _use("gyro", triple, f"{unit}/s", reason)


def _by_gravity(triple: Triple, *, named: bool) -> Use:
    """Return an accelerometer without a unit."""
    if len(triple.axes) < len(AXES):
        return _use("accel", triple, "m/s^2", f"{triple.label} has no unit, and one axis does not show 1 g")
    units, size = units_of_gravity(triple.size), triple.size
    if triple.counts and (counts_of_gravity(size) or not units):
        return _in_counts(triple, "accel")
    if not units:
        return _use(
            "accel", triple, "", f"{triple.label} have no unit, and their length of {size:.4g} is 1 g in none"
        )
    in_one = len(units) == 1 and not triple.counts and bool(triple.stem.strip() or named)
    counts = ", or in counts" if triple.counts else ""
    reason = f"the length of {triple.label} is {size:.4g}, which is 1 g in {' or '.join(units)}{counts}"
    assumptions = _assumptions(named=named, shown=len(units) == 1)
    return _use("accel", triple, units[0], reason, certain=in_one, assumptions=assumptions)


def _assumptions(*, named: bool, shown: bool) -> tuple[Assumption, ...]:
    """Return what is assumed of columns without a unit, by whether they have a name, and physics shows the unit."""
    if named:
        return ("assumed_unit",)
    return ("assumed_columns",) if shown else ("assumed_columns", "assumed_unit")


def _in_counts(triple: Triple, key: str) -> Use:
    """Return a sensor whose numbers are counts."""
    counts = counts_of_gravity(triple.size) if key == "accel" else 0.0
    if counts:
        reason = f"{triple.label} are counts, of which 1 g has about {counts:g}"
        return _use(key, triple, "g", reason, scales=(1.0 / counts,) * len(triple.axes))
    reason = f"{triple.label} are counts: how many a unit has is in the data sheet"
    unit, scales = "deg/s" if key == "gyro" else "g", (0.0,) * len(triple.axes)
    return replace(_use(key, triple, unit, reason, scales=scales), known=None)


def _by_noise(triple: Triple, beside: Triple | None, *, named: bool) -> Use:
    """Return a gyroscope whose unit only its noise suggests, beside an accelerometer of 1 g."""
    noise = sample_noise(triple.rows)
    of_accel, noise_beside = "", 0.0
    if beside is not None and (in_accel := known_unit(of_accel := _unit_of_one_g(beside))) is not None:
        noise_beside = sample_noise(beside.rows) * in_accel.factor
    unit = unit_of_rate(triple.rows, of_accel, noise_beside)
    other = "rad/s" if unit != "rad/s" else "deg/s"
    known, of_other = known_unit(unit), known_unit(other)
    assert known is not None
    assert of_other is not None
    what = "have no unit" if named else "have no name and no unit"
    times = _times(of_other.factor / known.factor)
    reason = f"{triple.label} {what}: their noise of {noise:.2g} is usual in {unit}; in {other}, N would be {times}"
    return _use("gyro", triple, unit, reason, assumptions=_assumptions(named=named, shown=False))


def _times(factor: float) -> str:
    """Return a factor of N for people.

    >>> _times(57.2958), _times(0.0175)
    ('57 times larger', '57 times smaller')
    """
    return f"{factor:.2g} times larger" if factor >= 1.0 else f"{1.0 / factor:.2g} times smaller"


def _contradiction(triple: Triple, unit: str, known: Unit) -> str:
    """Return why the numbers of a sensor cannot have a unit; empty: they can."""
    size = triple.size
    if known.quantity == "gyro" and size * known.factor > FASTEST_RATE:
        return f"{triple.label} have the unit {unit}, and their length of {size:.3g} is more than a gyroscope has"
    if known.quantity != "accel" or len(triple.axes) < len(AXES) or is_one_g(size * known.factor):
        return ""
    others = [other for other in units_of_gravity(size) if known_unit(other) != known]
    if others:
        return f"{triple.label} have the unit {unit}, and their length of {size:.4g} is 1 g in {others[0]}"
    if size * known.factor > STRONGEST:
        return f"{triple.label} have the unit {unit}, and their length of {size:.4g} is more than one at rest shows"
    return ""


def _named_columns(names: Sequence[str], units: Sequence[str], rows: Floats) -> list[NamedColumn]:
    """Return the columns of a table with their units: of a line of units, else of the name."""
    columns = []
    for k, name in enumerate(names):
        base, unit = split_unit(name)
        unit = units[k].strip("[]() ") if k < len(units) and units[k] else unit
        hint = "mag" if re.search("mag|field", base, re.IGNORECASE) else ""
        columns.append(NamedColumn(k, name, base, unit, known_unit(unit, hint) if unit else None, rows[:, k]))
    return columns


def _has_unit_of_another(column: NamedColumn) -> bool:
    """Return whether a time has the unit of a sensor, or a sensor that of a time."""
    if column.known is None:
        return False
    if column.known.quantity == "t":
        return "/" in named_channel(column.base)[0]
    return column.known.quantity in SENSORS and TIME.search(column.words) is not None


def _moves(triple: Triple) -> bool:
    """Return whether the numbers of a triple change, and are no clocks and no direction."""
    columns = triple.columns
    is_clock = all(c.rises for c in columns) or any(c.rises and TIME.search(c.words) for c in columns)
    return not all(c.constant for c in columns) and not is_clock and not is_direction(triple.rows)


def _may_be_gyro(triple: Triple) -> bool:
    """Return whether nothing says that a triple is no gyroscope."""
    quiet = sample_noise(triple.rows) < NOISIEST_DEG and not any(c.rises for c in triple.columns)
    return quiet and not triple.unit and not OTHER.search(triple.words) and not DELTA.search(triple.words)


def _unit_of_one_g(triple: Triple) -> str:
    """Return the unit of an accelerometer, stated or that of its length; empty: it is none."""
    in_counts = triple.counts and counts_of_gravity(triple.size)
    is_other = ANGULAR.search(triple.words) or is_of_another_sensor(triple.words, triple.known_quantity)
    if triple.known_quantity not in (None, "accel") or is_other or in_counts:
        return ""
    return triple.unit.lower() if triple.known_quantity else next(iter(units_of_gravity(triple.size)), "")


def _in_order(use: Use, triple: Triple) -> Use:
    """Return a sensor, with a question if nothing states the order of its axes."""
    if not triple.guessed or not use.certain:
        return use
    reason = f"the order of the axes in {triple.label} is assumed"
    return replace(use, certain=False, assumptions=("assumed_columns",), reason=reason)


def _slow_sensor(column: NamedColumn) -> Use | None:
    """Return the temperature or the pressure that a column is, by its unit or name, and its size; None: it is none."""
    named = not column.unit and re.search(r"temp|(?:^| )tmp(?: |$)|^t$", column.words)
    known = known_unit("degC") if column.known is None and named else column.known
    if known is None or not len(column.present) or COUNTER.search(column.words):
        return None
    low, high = PLAUSIBLE.get(known.quantity, (math.inf, 0.0))
    if not low < float(np.median(column.present)) * known.factor - known.zero < high:
        return None
    unit, reason = column.unit or "degC", "its unit is stated, or its size is that of degC"
    return Use(known.quantity, (column.index,), ("",), unit, known, True, reason)


def _why_unused(column: NamedColumn) -> str:
    if column.constant:
        return "it is constant" if len(column.present) else "no row has a number in it"
    return (
        "another column is the time" if TIME.search(column.words) else "no name or unit of a sensor or a time"
    )
