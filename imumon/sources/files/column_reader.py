"""Column reader: what the columns of one table are, by their names, their numbers, and what the user gives.

The order of its questions: which triples are sensors, in which unit; which column is the time; which interval do
increments have; what is beside the sensors. `columns` has the theory.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from imumon.model.cures import option, option_text
from imumon.model.report_json import plain
from imumon.model.samples import AXES, INERTIAL, ChannelName, Floats, Kind
from imumon.sources.files.base import OptionError, ReadOptions, RecordingError
from imumon.sources.files.column_clock import ClockReader
from imumon.sources.files.column_names import (
    ANGULAR,
    COUNTS,
    DELTA,
    LINEAR,
    OTHER,
    TIME,
    NamedColumn,
    Triple,
    _kind_of_words,
    label_of,
    names_sensor,
    split_unit,
    triples,
    words_of,
)
from imumon.sources.files.columns import (
    INCREMENTS,
    KINDS,
    LISTED,
    MOST_COLUMNS,
    SENSORS,
    Reading,
    Use,
    _found,
    check_meaning,
    find,
    reference,
)
from imumon.sources.files.sensors_without_unit import (
    by_gravity,
    by_noise,
    in_counts,
    increments_without_unit,
    kind_of,
)
from imumon.sources.files.sizes_at_rest import (
    FASTEST_RATE,
    NOISIEST,
    NOISIEST_DEG,
    counts_of_gravity,
    is_one_g,
    median_size,
    sample_noise,
    unit_of_rate,
    units_of_gravity,
)
from imumon.sources.files.unit_grammar import POSSIBLE_HZ, Unit, known_unit


def read_columns(
    names: Sequence[str],
    units: Sequence[str],
    rows: Floats,
    options: ReadOptions | None = None,
    *,
    source: str = "",
    stated_hz: float | None = None,
    dates: Sequence[int] = (),
    where: Sequence[tuple[str, str]] = (),
) -> Reading:
    """Return what the columns of a table are.

    Parameters
    ----------
    names, units : of all columns; empty: not stated. A unit may also be a part of a name.
    rows : (n, k) the first numbers; not finite is missing.
    options : of the user: ``columns``, ``rate_hz``, ``sensor``, ``units``, ``samples``, ``kind``.
    source : text before the table, or its name: it may say of which sensor the rows are.
    stated_hz : Hz, rate that a comment states.
    dates : columns that were dates; their numbers are seconds.
    where : rows that were chosen.

    Raises
    ------
    RecordingError : no column is that of a sensor, a stated unit is not known, or a map names what is not there.
    """
    if len(names) > MOST_COLUMNS:
        text = f"it has {len(names):,} columns, more than {MOST_COLUMNS:,}"
        raise RecordingError("too_many_columns", text, "write a table with those of the sensor only")
    if options is not None:
        check_meaning(options.units, options.samples)
    reader = _ColumnReader(names, units, rows, options or ReadOptions(), source, stated_hz, set(dates))
    return replace(reader.reading(), where=tuple(where))


class _ColumnReader(ClockReader):
    """Reads the columns of one table; see `read_columns`."""

    def __init__(
        self,
        names: Sequence[str],
        units: Sequence[str],
        rows: Floats,
        options: ReadOptions,
        source: str,
        stated_hz: float | None,
        dates: set[int],
    ) -> None:
        columns = []
        for k, name in enumerate(names):
            base, unit = split_unit(name)
            unit = units[k].strip("[]() ") if k < len(units) and units[k] else unit
            hint = "mag" if re.search("mag|field", base, re.IGNORECASE) else ""
            known = known_unit(unit, hint) if unit else None
            columns.append(NamedColumn(k, name, base, unit, known, rows[:, k]))
        super().__init__(names, columns, options, stated_hz, dates)
        self._source = source
        self._remarks: list[str] = []
        self._given = self._given_uses()
        self._taken = {k for use in self._given.values() for k in use.columns}

    def reading(self) -> Reading:
        """Return the sensors, then the time, then what is beside them."""
        uses = dict(self._sensors())
        if not any(key in INERTIAL for key in uses):
            raise self._no_sensor()
        uses |= self._time(self._taken | {k for use in uses.values() for k in use.columns})
        uses = self._as_increments(uses)
        uses |= self._interval(uses)
        uses = self._with_increments(uses)
        uses |= self._beside({k for use in uses.values() for k in use.columns})
        used = {k for use in uses.values() for k in use.columns}
        unused = {c.index: self._why_unused(c) for c in self._columns if c.index not in used}
        return Reading(
            self._names, tuple(uses.values()), tuple(self._views(uses)), (), tuple(self._remarks), unused
        )

    # ------------------------------------------------------------ sensors

    def _sensors(self) -> dict[str, Use]:
        by_sensor = self._sensors_of_names()
        chosen = {key: use for key, use in self._given.items() if key in INERTIAL}
        wanted = [key for key in INERTIAL if self._options.sensor in (None, key)]
        for key in wanted:
            if key not in chosen and by_sensor[key] and not self._is_left_out(key):
                ranked = sorted(by_sensor[key], key=self._rank)
                chosen[key] = self._with_stated_meaning(ranked[0])
                self._note_others(key, ranked)
        chosen = {key: chosen[key] for key in wanted if key in chosen}
        if any(key in self._given for key in chosen):  # who names a sensor is not asked about the other one
            for key in [k for k, use in chosen.items() if not use.certain and k not in self._given]:
                self._remarks.append(f"{key} is not used: {chosen.pop(key).reason}")
        return self._of_one_kind(chosen, by_sensor)

    def _sensors_of_names(self) -> dict[str, list[Use]]:
        """Return all gyroscopes and accelerometers that the columns not given by the user may be."""
        every = [t for t in triples(self._columns) if not self._taken & set(t.indices)]
        by_sensor: dict[str, list[Use]] = {"gyro": [], "accel": []}
        moving = [t for t in every if _moves(t)]
        gravity = self._unit_beside(moving)
        for triple in moving:
            if (use := self._sensor(triple, gravity)) is not None:
                if triple.guessed and use.certain:
                    reason = f"the order of the axes in {triple.label} is assumed"
                    use = replace(use, certain=False, assumption="assumed_columns", reason=reason)
                by_sensor[use.key].append(use)
        # beside an accelerometer, three numbers of one name that move around a constant
        if not by_sensor["gyro"]:
            used = {k for use in by_sensor["accel"] for k in use.columns}
            by_sensor["gyro"] += self._remaining(moving, used, gravity)
        if not by_sensor["gyro"] or not by_sensor["accel"]:
            for use in self._single_axes(every, gravity, by_sensor):
                by_sensor[use.key].append(use)
        return by_sensor

    def _is_left_out(self, key: str) -> bool:
        """Return whether the user has named axes of a sensor, which are all that is used of it."""
        return any(ChannelName(channel).sensor == key for channel in self._options.columns or {})

    def _unit_beside(self, triples: Sequence[Triple]) -> str:
        """Return the unit of an accelerometer that is one g; empty: there is none."""
        for triple in triples:
            if triple.known_quantity in (None, "accel") and not ANGULAR.search(triple.words):
                if triple.unit and triple.known_quantity == "accel":
                    return triple.unit.lower()
                if gravity := units_of_gravity(triple.size):
                    return gravity[0]
        return ""

    def _sensor(self, triple: Triple, gravity: str) -> Use | None:
        """Return the sensor that a triple is, with its unit; None: it is none."""
        words = self._words_with_hint(triple)
        quantity = triple.known_quantity
        if _is_of_another_sensor(words, quantity):
            return None
        is_angular, is_linear = bool(ANGULAR.search(words)), bool(LINEAR.search(words))
        delta = bool(DELTA.search(words))
        if quantity is not None:
            return self._stated(triple, quantity, is_angular=is_angular, is_linear=is_linear, delta=delta)
        if triple.unit:
            return self._unknown_unit(triple, is_angular, is_linear)
        if delta and (is_angular or is_linear or re.search(r"theta|ang|vel", words)):
            angular = bool(re.search(r"theta|ang|gyr|rot", words))
            return increments_without_unit(triple, "gyro" if angular else "accel")
        if is_angular:
            return _gyro_by_noise(triple, gravity, named=True)
        of_gravity = units_of_gravity(triple.size)
        if is_linear or of_gravity:
            return by_gravity(triple, of_gravity, named=is_linear)
        if words.strip():
            return None
        if triple.counts and counts_of_gravity(triple.size):
            return in_counts(triple, "accel")
        return _gyro_by_noise(triple, gravity, named=False)

    def _words_with_hint(self, triple: Triple) -> str:
        """Return the words of a triple, with the sensor that the text before the table says if they say none."""
        words = triple.words
        says_none = re.fullmatch(r"(?:axis|3 ?dof|value|values|raw|data|\d| )*", words)
        return f"{words} {self._hint()}" if says_none else words

    def _remaining(self, triples: Sequence[Triple], used: set[int], gravity: str) -> Iterator[Use]:
        """Yield the gyroscope that a triple without a meaning may be, beside an accelerometer."""
        for triple in triples:
            known = triple.unit or OTHER.search(triple.words) or DELTA.search(triple.words)
            quiet = sample_noise(triple.rows) < NOISIEST_DEG and not any(c.rises for c in triple.columns)
            if used and quiet and not known and not used & set(triple.indices):
                yield _gyro_by_noise(triple, gravity, named=False)
                return

    def _hint(self) -> str:
        """Return the sensor that the text before the table, or the name of the file, says; empty: none, or both."""
        text = words_of(self._source)
        named = [word for word, pattern in (("gyro", r"gyr"), ("accel", r"acc")) if re.search(pattern, text)]
        return named[0] if len(named) == 1 else ""

    def _unknown_unit(self, triple: Triple, angular: bool, linear: bool) -> Use | None:
        """Return a sensor in counts; raise `RecordingError` if the unit of a sensor is stated and not known."""
        if not (angular or linear):
            return None
        key = "gyro" if angular else "accel"
        if COUNTS.match(triple.unit):
            return in_counts(triple, key)
        text = f"the unit {triple.unit!r} of {triple.label} is not known"
        if key in self._options.units or self._options.columns:
            return None
        given = ",".join(reference(k, self._names) for k in triple.indices)
        raise RecordingError(
            "unknown_unit", text, f"say which it is, {option_text(columns={key: f'{given}:UNIT'})}"
        )

    def _stated(
        self, triple: Triple, quantity: str, *, is_angular: bool, is_linear: bool, delta: bool
    ) -> Use | None:
        """Return a sensor whose unit is stated."""
        known = known_unit(triple.unit)
        assert known is not None
        key = SENSORS[quantity]
        if quantity in INCREMENTS.values() and not delta:
            if not (is_angular and quantity == "angle") or re.search(r"angle|pose|position", triple.words):
                return None  # an orientation, or a velocity over ground
            unit = triple.unit + "/s"
            reason = (
                f"{triple.label} have the unit {triple.unit}, which is none of a rate: {unit} is meant, or "
                "they are increments"
            )
            return Use(
                key, triple.indices, triple.axes, unit, known_unit(unit), False, reason, kind=kind_of(triple)
            )
        kind: Kind = "deltas" if quantity in INCREMENTS.values() else kind_of(triple)
        use = Use(key, triple.indices, triple.axes, triple.unit, known, True, "its unit is stated", kind=kind)
        if quantity == "accel" and len(triple.axes) == len(AXES):
            return self._compared_with_gravity(use, triple, known)
        if quantity == "gyro" and sample_noise(triple.rows * known.factor) > 10.0 * NOISIEST:
            self._doubt(
                f"{triple.label}: the noise is {math.degrees(sample_noise(triple.rows * known.factor)):.2g} "
                f"deg/s in the unit {triple.unit}, more than that of a gyroscope at rest"
            )
        return use

    def _doubt(self, text: str) -> None:
        self._remarks.append(f"{text}: its unit may be wrong")

    def _compared_with_gravity(self, use: Use, triple: Triple, known: Unit) -> Use:
        """Return an accelerometer, with a question if its length is one g in another unit than that which is stated."""
        size = triple.size
        if is_one_g(size * known.factor):
            return use
        if others := [u for u in units_of_gravity(size) if known_unit(u) != known]:
            reason = (
                f"{triple.label} state {triple.unit}, and their length of {size:.4g} is 1 g in {others[0]}"
            )
            return replace(use, unit=others[0], known=known_unit(others[0]), certain=False, reason=reason)
        if size * known.factor > 400.0:
            reason = (
                f"{triple.label} state {triple.unit}, and their length of {size:.4g} is more than a sensor at "
                "rest shows"
            )
            return replace(use, certain=False, reason=reason)
        self._remarks.append(
            f"the length of {triple.label} is {size:.4g} {triple.unit}, and not 1 g: its unit may be wrong, "
            "or gravity has been removed"
        )
        return use

    def _single_axes(
        self, triples: Sequence[Triple], gravity: str, by_sensor: Mapping[str, Sequence[Use]]
    ) -> Iterator[Use]:
        """Yield the sensors of one axis: a single column by its unit or name, where the sensor has no triple."""
        used = {k for triple in triples for k in triple.indices} | self._taken
        alone: dict[str, list[tuple[NamedColumn, str]]] = {}
        for column in self._columns:
            words = column.words if column.words else self._hint()
            if column.index not in used and (key := _sensor_of_one_axis(column, words)):
                match = re.search(r"(?:^| )([xyz])(?: |$)|([xyz])$", words)
                alone.setdefault(key, []).append((column, (match[1] or match[2]) if match else "x"))
        for key, columns in alone.items():
            if by_sensor.get(key):
                continue
            if len(columns) == 1:
                yield _single_axis(key, *columns[0], gravity)
            else:
                listed = ", ".join(c.name for c, _ in columns)
                self._remarks.append(f"{listed} not used: a sensor has one axis or three")

    def _rank(self, use: Use) -> tuple[object, ...]:
        """Return the order in which sensors are chosen: what is certain, averages, then raw numbers; the first."""
        wanted = self._options.kind
        kinds = [wanted, *KINDS] if wanted else [*KINDS]
        order: float = kinds.index(use.kind) if use.kind in kinds else 1.5
        if not use.certain and use.kind == "deltas":
            order = len(kinds)
        words = words_of(self._names[use.columns[0]])
        direct = bool(re.search(r"gyr" if use.key == "gyro" else r"acc", words)) and not re.search(
            r"user|linear accel", words
        )
        # the field of the earth has a length, and the rate of a sensor at rest hardly one
        rows = np.column_stack([self._columns[k].values for k in use.columns])
        size = (
            (median_size(rows) or 0.0) if use.assumption == "assumed_columns" and use.key == "gyro" else 0.0
        )
        fused = re.search(r"motion|user|fused|rotation ?rate", words) is not None
        return (
            wanted is not None and use.kind != wanted,
            use.known is None,
            not use.certain,
            order,
            fused,
            not direct,
            size,
            use.columns,
        )

    def _note_others(self, key: str, ranked: Sequence[Use]) -> None:
        for other in ranked[1:]:
            listed = ",".join(reference(k, self._names) for k in other.columns)
            use_it = option_text(columns={key: f"{listed}:{other.unit or 'UNIT'}"})
            self._remarks.append(f"{listed} not used: another {key}; {use_it} uses it")

    def _of_one_kind(self, chosen: dict[str, Use], by_sensor: Mapping[str, Sequence[Use]]) -> dict[str, Use]:
        """Return the sensors, with the accelerometer of the kind of the gyroscope where there is one as certain."""
        if len(chosen) == 2 and chosen["gyro"].kind != chosen["accel"].kind and "accel" not in self._given:
            for use in by_sensor["accel"]:
                if use.kind == chosen["gyro"].kind and use.certain >= chosen["accel"].certain:
                    return {**chosen, "accel": self._with_stated_meaning(use)}
        return chosen

    def _with_stated_meaning(self, use: Use) -> Use:
        """Return a sensor with the unit and the kind of samples that the caller states."""
        samples, unit = self._options.samples, self._options.units.get(use.key)
        if samples == "increment" and unit is None and use.kind != "deltas":
            unit = "rad" if use.key == "gyro" else "m/s"
        if unit is not None:
            known = known_unit(unit)
            if known is None:
                raise OptionError("unknown_unit", f"{unit!r} is no unit", "use one such as deg/s, g or ms")
            use = replace(use, unit=unit, known=known, certain=True, reason="its unit is given", scale=1.0)
        if samples in ("average", "increment"):
            use = replace(use, kind="deltas")
        elif samples == "point" and use.kind == "deltas":
            text = f"{', '.join(self._names[k] for k in use.columns)} are increments, and kind='point' is for rates"
            raise OptionError("kind_contradicts", text, "use kind='increment', or leave it out")
        return use

    # ------------------------------------------------------------ what the user gives

    def _given_uses(self) -> dict[str, Use]:
        """Return what the map of the user names."""
        given: dict[str, list[tuple[str, int, str, float]]] = {}
        uses: dict[str, Use] = {}
        for channel, text in (self._options.columns or {}).items():
            key, _, axis = channel.partition("/")
            if key == "rate":
                uses["rate"] = Use("rate", (), (), text, Unit("rate", _positive(text)), True, "it is given")
            elif key == "t" and "+" in text and find(self._names, text) is None:
                uses["t"] = self._given_pair(text)
            else:
                index, unit, scale = _found(self._names, text)
                given.setdefault(key, []).append((axis, index, unit, scale))
        for key, columns in given.items():
            uses[key] = self._given_use(key, columns)
        twice = [k for k, n in Counter(k for use in uses.values() for k in use.columns).items() if n > 1]
        if twice:
            raise RecordingError(
                "column_twice",
                f"{option('columns')} gives {self._names[twice[0]]} to two channels",
                "name another column for each axis",
            )
        return uses

    def _given_pair(self, text: str) -> Use:
        parts = [_found(self._names, part) for part in text.split("+")]
        unit = "+".join(part[1] or default for part, default in zip(parts, ("s", "ns"), strict=False))
        return Use(
            "t", tuple(part[0] for part in parts), ("", ""), unit, known_unit("s", "t"), True, "it is given"
        )

    def _given_use(self, key: str, columns: Sequence[tuple[str, int, str, float]]) -> Use:
        """Return one sensor, or the time, that the user names; without a unit, that of the name or of the numbers."""
        columns = sorted(columns)
        axes, indices = tuple(axis for axis, *_ in columns), tuple(index for _, index, *_ in columns)
        if key in SENSORS.values() and len(axes) == 2:
            missing = next(axis for axis in AXES if axis not in axes)
            raise RecordingError(
                "map_incomplete",
                f"{option('columns')} names only a part of {key}: {key}/{missing} is missing",
                f"name it too, {key}/{missing}=COLUMN:UNIT",
            )
        text, known = self._given_unit(key, indices, next((unit for _, _, unit, _ in columns if unit), ""))
        kind: Kind = (
            "deltas"
            if known is not None and known.quantity in INCREMENTS.values()
            else _kind_of_words(words_of(self._names[indices[0]]))
        )
        scale, certain = columns[0][3], known is not None
        use = Use(key, indices, axes, text, known, certain, "it is given", scale=scale, kind=kind)
        if scale == 0.0:
            reason = (
                f"the size of {', '.join(self._names[k] for k in indices)} is what only the owner knows: it "
                "is in the data sheet"
            )
            return replace(use, known=None, certain=False, reason=reason)
        if known is None:
            return self._without_unit(use)
        self._check_size(use, known)
        if self._options.samples in ("average", "increment") and key in INERTIAL:
            use = replace(use, kind="deltas")
        return use

    def _given_unit(self, key: str, indices: Sequence[int], given: str) -> tuple[str, Unit | None]:
        """Return the unit that the user gives, else that of a name; empty and None: neither is one of the sensor."""
        unit = given or self._options.units.get("time" if key == "t" else key, "")
        stated = unit or next((self._columns[k].unit for k in indices if self._columns[k].unit), "")
        known = known_unit(stated, key) if stated else None
        quantity = "t" if key == "dt" else key
        if known is not None and SENSORS.get(known.quantity, known.quantity) == quantity:
            return stated, known
        if unit:
            raise RecordingError(
                "unknown_unit",
                f"the unit {unit!r} in {option('columns')} is none of {'a time' if quantity == 't' else key}",
                "use one such as rad/s, deg/s, m/s^2, g, ms",
            )
        return "", None

    def _check_size(self, use: Use, known: Unit) -> None:
        """Raise `RecordingError` if what is given is larger than in the given unit possible, or 1 g in another."""
        if use.key == "accel" and known.quantity == "accel":
            self._check_gravity(use, known)
        size = median_size(np.column_stack([self._columns[k].values for k in use.columns])) or 0.0
        if known.quantity == "gyro" and size * known.factor * abs(use.scale) > FASTEST_RATE:
            labels = ", ".join(label_of(self._columns[k]) for k in use.columns)
            text = f"{labels} are given in {use.unit}, and are {size:.3g}"
            raise RecordingError("wrong_unit", text, "give the unit that they have")

    def _check_gravity(self, use: Use, known: Unit) -> None:
        """Raise `RecordingError` if the length of an accelerometer is 1 g in another unit than is given."""
        rows = np.column_stack([self._columns[k].values for k in use.columns]) * use.scale
        size = median_size(rows) if len(use.axes) == len(AXES) else None
        if size is None or is_one_g(size * known.factor):
            return
        if others := units_of_gravity(size):
            names = ", ".join(label_of(self._columns[k]) for k in use.columns)
            text = f"{names} are given in {use.unit}, and their length of {size:.4g} is 1 g in {others[0]}"
            listed = ",".join(reference(k, self._names) for k in use.columns)
            raise RecordingError(
                "wrong_unit",
                text,
                f"if it is {others[0]}, {option_text(columns={'accel': f'{listed}:{others[0]}'})}",
            )

    def _without_unit(self, use: Use) -> Use:
        """Return what the user names without a unit, with the one that its numbers suggest."""
        columns = tuple(self._columns[k] for k in use.columns)
        triple = Triple(columns, use.axes, columns[0].base)
        if use.key == "t":
            return self._clock(columns[0], self._options.rate_hz or self._stated_hz)
        if use.key == "gyro":
            return by_noise(
                triple,
                "gyro",
                "" if triple.counts and use.scale == 1.0 else unit_of_rate(triple.rows * use.scale, ""),
            )
        if use.key == "accel":
            return by_gravity(triple, units_of_gravity(triple.size), named=True)
        default = {"temperature": "degC", "dt": "s"}.get(use.key, "")
        known = known_unit(default) if default else None
        return replace(
            use, unit=default, known=known, certain=known is not None, reason=f"{columns[0].name} has no unit"
        )

    def _no_sensor(self) -> RecordingError:
        constant = [
            t for t in triples(self._columns) if names_sensor(t.stem) and all(c.constant for c in t.columns)
        ]
        if constant and len(constant[0].rows) > 1:
            text = f"every value of {constant[0].label} is the same: there is no noise"
            return RecordingError(
                "all_constant", text, "pass samples of a sensor that is on, with all their digits"
            )
        listed = ", ".join(plain(name.strip()) or "-" for name in self._names[:LISTED])
        text = (
            "no column is that of a gyroscope or accelerometer "
            f"({listed}{', ...' if len(self._names) > LISTED else ''})"
        )
        return RecordingError(
            "no_sensor", text, f"name them, {option_text(columns={'gyro': 'COLUMN,COLUMN,COLUMN:UNIT'})}"
        )


def _moves(triple: Triple) -> bool:
    """Return whether the numbers of a triple change, and are no clocks."""
    columns = triple.columns
    return not all(c.constant for c in columns) and not any(c.rises and TIME.search(c.words) for c in columns)


def _is_of_another_sensor(words: str, quantity: str | None) -> bool:
    """Return whether the unit or the words of a triple are those of something else than an inertial sensor."""
    if quantity in ("mag", "temperature", "pressure", "t"):
        return True
    if not OTHER.search(words):
        return False
    is_inertial = quantity in ("gyro", "accel")
    return not is_inertial or bool(re.search(r"bias|drift|offset|std|cov|gravity|mag", words))


def _gyro_by_noise(triple: Triple, gravity: str, *, named: bool) -> Use:
    """Return a gyroscope without a unit, beside an accelerometer whose unit is given."""
    return by_noise(triple, "gyro", "" if triple.counts else unit_of_rate(triple.rows, gravity), named=named)


def _sensor_of_one_axis(column: NamedColumn, words: str) -> str:
    """Return the sensor of which a column is an axis, by its unit or its words; empty: it is of none."""
    known = column.known
    if column.constant or OTHER.search(words):
        return ""
    if known is not None:
        return known.quantity if known.quantity in INERTIAL else ""
    if column.rises or column.unit:
        return ""
    if ANGULAR.search(words):
        return "gyro"
    return "accel" if LINEAR.search(words) else ""


def _single_axis(key: str, column: NamedColumn, axis: str, gravity: str) -> Use:
    """Return the sensor of one axis that a column is."""
    triple = Triple((column,), (axis,), column.base)
    if column.known is not None:
        reason, kind = "its unit is stated", kind_of(triple)
        return Use(key, (column.index,), (axis,), column.unit, column.known, True, reason, kind=kind)
    if key == "gyro":
        return _gyro_by_noise(triple, gravity, named=True)
    reason = f"{column.name} has no unit, and one axis does not show 1 g"
    return Use(key, (column.index,), (axis,), "m/s^2", known_unit("m/s^2"), False, reason)


def _positive(text: str) -> float:
    """Return a sample rate, Hz; raise `OptionError` if it is none."""
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not POSSIBLE_HZ[0] <= rate <= POSSIBLE_HZ[1]:
        raise OptionError("rate_invalid", f"{text!r} is no sample rate", "write for example rate=100")
    return rate
