"""Clock among columns: which column is the time, in which unit, and which interval do increments have.

A clock never falls. Its unit is stated, or its numbers count from 1970; a rate that is stated or given shows the unit,
too. Without any of these, a unit is proposed in which the rate is usual. The length of increments over the interval is
one g, which shows that they are increments.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from imumon.grid.stamp_kinds import shows_rate, stamp_interval, typical_step
from imumon.model.cures import option, option_text
from imumon.model.report_json import plain
from imumon.model.samples import AXES, INERTIAL
from imumon.model.units import STANDARD_GRAVITY, share_text
from imumon.sources.files.base import OptionError, ReadOptions, RecordingError
from imumon.sources.files.column_names import (
    COUNTER,
    DELTA,
    FEWEST,
    OTHER,
    TIME,
    NamedColumn,
    Triple,
    label_of,
    triples,
)
from imumon.sources.files.columns import MOST_SHOWN, SINCE_1970_S, ColumnView, Use, reference
from imumon.sources.files.sizes_at_rest import NEAR_ONE_G, is_one_g, median_size, sample_noise
from imumon.sources.files.unit_grammar import POSSIBLE_HZ, Unit, known_unit

USUAL_HZ, TYPICAL_HZ = (0.5, 9000.0), 150.0
"""Hz, rates at which the unit of a time is proposed, and the one that they lie around."""

CLOCK_UNITS = ("s", "ms", "us", "ns")
"""Units in which a clock may count."""

STATED_SHARE = 0.02
"""Share by which the rate of a clock may differ from one that is stated: those are nominal."""


class ClockReader:
    """Finds the time and the interval of one table.

    Parameters
    ----------
    names, columns : of the table.
    options : of the user.
    stated_hz : Hz, rate that a comment states; None: none does.
    dates : columns whose cells were dates.
    """

    def __init__(
        self,
        names: Sequence[str],
        columns: Sequence[NamedColumn],
        options: ReadOptions,
        stated_hz: float | None,
        dates: set[int],
    ) -> None:
        self._names, self._columns, self._options = tuple(names), columns, options
        self._stated_hz, self._dates = stated_hz, dates
        self._given: dict[str, Use] = {}

    # ------------------------------------------------------------ time

    def _time(self, used: set[int]) -> dict[str, Use]:
        """Return the time, or the rate in its place."""
        if "t" in self._given:
            return {"t": self._given["t"]}
        rate, reason = self._options.rate_hz, "the rate is given"
        if rate is None and self._stated_hz is not None:
            rate, reason = self._stated_hz, f"a comment states {self._stated_hz:g} Hz"
        if rate is None and (constant := self._rate_column()) is not None:
            rate, reason = constant
        candidates = self._clocks(used, rate)
        pair = self._pair(used)
        if (
            pair is not None
            and not any(c.index in self._dates for c in candidates[:1])
            and not self._sensor_clock(candidates)
        ):
            return {"t": pair}
        if candidates:
            self._check_one_clock(candidates)
            return {"t": self._clock(candidates[0], rate)}
        self._check_order(used)
        if rate is not None:
            return {
                "rate": Use("rate", (), (), f"{rate:g}", Unit("rate", rate), True, reason, "assumed_rate")
            }
        text = "no column is a time, and nothing states the rate"
        return {"rate": Use("rate", (), (), "", None, False, text, "assumed_rate")}

    def _check_one_clock(self, candidates: Sequence[NamedColumn]) -> None:
        """Raise `RecordingError` if gyroscope and accelerometer have a time each, and these differ."""
        if self._options.sensor is not None:
            return
        clocks = {
            sensor: column for sensor in INERTIAL for column in candidates[::-1] if sensor[:3] in column.words
        }
        steps = {sensor: typical_step(column.present) for sensor, column in clocks.items()}
        if (
            len(clocks) == 2
            and clocks["gyro"] is not clocks["accel"]
            and abs(steps["gyro"] / steps["accel"] - 1.0) > STATED_SHARE
        ):
            text = f"gyro has the time {label_of(clocks['gyro'])} and accel {label_of(clocks['accel'])}"
            alone = f"read each alone, {option_text(sensor='gyro')} and {option_text(sensor='accel')}"
            raise RecordingError("different_rates", text, alone)

    def _check_order(self, used: set[int]) -> None:
        """Raise `RecordingError` if a time is there whose rows are in no order."""
        for column in self._columns:
            named = column.words in ("t", "time", "timestamp") or (
                column.known is not None and column.known.quantity == "t"
            )
            there = column.present
            if named and column.index not in used and len(np.unique(there)) > len(there) / 2 > FEWEST:
                back = float((np.diff(there) < 0.0).mean())
                if 0.05 < back < 1.0 and not re.search(
                    r"(?:^| )(?:dt|delta|nsecs?|nanosecs?)(?: |$)", column.words
                ):
                    text = f"its rows are not in the order of {label_of(column)}: "
                    text += f"{share_text(back)} of the steps go back"
                    raise RecordingError("rows_not_sorted", text, f"sort the rows by {label_of(column)}")

    def _sensor_clock(self, candidates: Sequence[NamedColumn]) -> bool:
        return bool(candidates) and "startup" in candidates[0].words

    def _rate_column(self) -> tuple[float, str] | None:
        """Return the rate that a column states in each row, and the reason."""
        for column in self._columns:
            if (
                len(column.present)
                and re.search(r"(?:^| )(?:hz|rate|odr|fs)(?: |$)", column.words)
                and re.search(r"hz", column.name, re.IGNORECASE)
            ):
                value = float(np.median(column.present))
                if (
                    1.0 <= value <= POSSIBLE_HZ[1]
                    and float((np.abs(column.present / value - 1.0) < STATED_SHARE).mean()) > 0.9
                ):
                    return value, f"{column.name} states {value:g} Hz"
        return None

    def _clocks(self, used: set[int], rate: float | None) -> list[NamedColumn]:
        """Return the columns that may be the time, the best first."""
        result = [c for c in self._columns if c.index not in used and self._may_be_clock(c)]
        return sorted(result, key=lambda c: self._clock_rank(c, rate))

    def _may_be_clock(self, column: NamedColumn) -> bool:
        """Return whether a column may be the time, by its numbers, its name and its unit."""
        known = column.known
        if not (column.rises or column.index in self._dates) or not shows_rate(column.present):
            return False
        if known is not None and known.quantity != "t":
            return False
        if re.search(r"^(?:dt|delta time|week|gps week)$|leap", column.words):
            return False
        step = typical_step(column.present)
        if known is not None:
            return POSSIBLE_HZ[0] <= 1.0 / (step * known.factor) <= POSSIBLE_HZ[1]
        if TIME.search(column.words):
            return True
        if step == 1.0 or COUNTER.search(column.words):
            return False
        return not column.words or self._clock_unit(column) is not None or _is_steady(column)

    def _clock_rank(self, column: NamedColumn, rate: float | None) -> tuple[object, ...]:
        step = typical_step(column.present)
        unit = self._clock_unit(column)
        units = [unit] if unit is not None else [known_unit(u, "t") for u in CLOCK_UNITS]
        rates = [1.0 / (step * u.factor) for u in units if u is not None]
        matches = rate is not None and any(abs(r / rate - 1.0) < STATED_SHARE for r in rates)
        named = bool(TIME.search(column.words)) or not column.words
        steady = _is_steady(column)
        sensor = bool(re.search(r"startup|sample|sensor|device|boot|chip", column.words))
        host = bool(re.search(r"host|system|app|log|recv|receive|arrival|gps|utc", column.words))
        sensor_of_rows = {"gyro": "acc", "accel": "gyr"}.get(self._options.sensor or "", "$^")
        other = bool(re.search(rf"{sensor_of_rows}|gnss|location|mag|baro|alt|position", column.words))
        return (
            not matches,
            other,
            not named,
            not steady,
            not sensor,
            unit is None,
            host,
            not column.words,
            column.index,
        )

    def _clock_unit(self, column: NamedColumn) -> Unit | None:
        """Return the unit of a clock that is stated, or shown by a time since 1970; None: neither."""
        if column.index in self._dates:
            return known_unit("s", "t")
        if column.known is not None:
            return column.known
        middle = float(np.median(column.present))
        for text in CLOCK_UNITS:
            unit = known_unit(text, "t")
            if unit is not None and SINCE_1970_S[0] <= middle * unit.factor < SINCE_1970_S[1]:
                hz = 1.0 / (typical_step(column.present) * unit.factor)
                return unit if POSSIBLE_HZ[0] <= hz <= POSSIBLE_HZ[1] else None
        return None

    def _clock(self, column: NamedColumn, rate: float | None) -> Use:
        """Return the time that a column is, with its unit."""
        self._check_clock_unit(column, rate)
        if (given := self._options.units.get("time")) is not None:
            known = known_unit(given, "t")
            if known is None or known.quantity != "t":
                raise OptionError("unknown_unit", f"{given!r} is no unit of time", "use s, ms, us or ns")
            return _time_of(column, given, known, "its unit is given")
        unit = self._clock_unit(column)
        if unit is not None:
            return self._clock_with_unit(column, unit)
        step = typical_step(column.present)
        rates = {text: 1.0 / (step * 10.0 ** (-3 * k)) for k, text in enumerate(CLOCK_UNITS)}
        if rate is not None:
            fitting = next((text for text, hz in rates.items() if abs(hz / rate - 1.0) < 0.05), None)
            text = fitting or f"{float(f'{1.0 / (step * rate):.7g}')!r}s"
            reason = f"{rate:g} Hz gives the unit of {label_of(column)}"
            return _time_of(column, text, known_unit(text, "t"), reason)
        return _proposed_time(column, rates)

    def _check_clock_unit(self, column: NamedColumn, rate: float | None) -> None:
        """Raise `RecordingError` if the unit of a time is stated and not known, and nothing else shows it."""
        has_unit = column.known is not None or rate is not None or "time" in self._options.units
        if column.unit and not has_unit and self._clock_unit(column) is None:
            stated = option_text(columns={"t": f"{reference(column.index, self._names)}:UNIT"})
            cure = f"say which it is, {stated}, or {option('rate_hz')}"
            text = f"the unit {column.unit!r} of the time {label_of(column)} is not known"
            raise RecordingError("unknown_unit", text, cure)

    def _clock_with_unit(self, column: NamedColumn, unit: Unit) -> Use:
        """Return the time that a column is whose unit is stated, or shown by a time since 1970."""
        is_stated = column.known is not None
        text = column.unit if is_stated else next(u for u in CLOCK_UNITS if known_unit(u, "t") == unit)
        certain = bool(column.words) or column.index in self._dates or is_stated or not column.name
        reason = "its unit is stated, or its numbers count from 1970"
        return _time_of(column, text, unit, reason, certain=certain)

    def _pair(self, used: set[int]) -> Use | None:
        """Return seconds and a fine part of them in two columns; None: there are none."""
        free = [c for c in self._columns if c.index not in used]
        for seconds in filter(_are_whole_seconds, free):
            for part in free:
                unit = "" if part is seconds else _part_of_second(part)
                if unit:
                    reason = f"{seconds.name} has seconds and {part.name} the {unit} of them"
                    return Use(
                        "t",
                        (seconds.index, part.index),
                        ("", ""),
                        f"s+{unit}",
                        known_unit("s", "t"),
                        True,
                        reason,
                        "assumed_rate",
                    )
        return None

    def _as_increments(self, uses: dict[str, Use]) -> dict[str, Use]:
        """Return the sensors of which nothing but the length over the interval shows that they are increments."""
        step_s, gyro = self._step_s(uses), uses.get("gyro")
        if (
            not step_s
            or "accel" in uses
            or self._options.columns
            or "accel" in self._given
            or self._options.sensor is not None
        ):
            return uses
        triple = self._velocity_increments(step_s, () if gyro is None else gyro.columns)
        if triple is None:
            return uses
        reason = f"the length of {triple.label} over the interval is 1 g in m/s: they are increments"
        accel = Use(
            "accel",
            triple.indices,
            AXES,
            "m/s",
            known_unit("m/s"),
            False,
            reason,
            "assumed_columns",
            kind="deltas",
        )
        return {
            **({"gyro": self._beside_increments(gyro)} if gyro is not None else {}),
            "accel": accel,
            **{k: u for k, u in uses.items() if k != "gyro"},
        }

    def _velocity_increments(self, step_s: float, used: Sequence[int]) -> Triple | None:
        """Return the triple whose length over the interval is one g in m/s; None: there is none."""
        for triple in triples(self._columns):
            if triple.unit or set(triple.indices) & set(used):
                continue
            if re.search(r"acc|mag|quat|pos", triple.words):
                continue
            if abs(triple.size / step_s / STANDARD_GRAVITY - 1.0) < NEAR_ONE_G:
                return triple
        return None

    def _beside_increments(self, gyro: Use) -> Use:
        """Return a gyroscope beside increments: as increments, too, if nothing but its noise shows what it is."""
        if gyro.certain or gyro.kind == "deltas" or gyro.assumption != "assumed_columns":
            return gyro
        listed = ", ".join(label_of(self._columns[k]) for k in gyro.columns)
        reason = f"{listed} are beside increments: rad"
        return replace(gyro, unit="rad", known=known_unit("rad"), kind="deltas", reason=reason)

    # ------------------------------------------------------------ increments, and what is beside the sensors

    def _interval(self, uses: Mapping[str, Use]) -> dict[str, Use]:
        """Return the length of each sample's own interval, where a sensor has increments."""
        if "dt" in self._given:
            return {"dt": self._given["dt"]}
        if not any(uses[key].kind == "deltas" for key in INERTIAL if key in uses):
            return {}
        step_s = self._step_s(uses)
        for column in self._columns:
            if _may_be_interval(column) and (text := _interval_unit(column, step_s)):
                reason = "its size is that of the steps of the time"
                return {"dt": Use("dt", (column.index,), ("",), text, known_unit(text, "t"), True, reason)}
        return {}

    def _step_s(self, uses: Mapping[str, Use]) -> float | None:
        """Return the typical interval, s; None: it is not known."""
        if (dt := uses.get("dt")) is not None and dt.known is not None:
            return float(np.median(self._columns[dt.columns[0]].present)) * dt.known.factor * dt.scale
        if (time := uses.get("t")) is not None and time.known is not None:
            parts = [self._columns[k].values for k in time.columns]
            factors = (
                [u.factor for p in time.unit.split("+") if (u := known_unit(p, "t")) is not None]
                if len(parts) == 2
                else [time.known.factor * time.scale]
            )
            total = sum(values * factor for values, factor in zip(parts, factors, strict=True))
            whole = np.asarray(total)[np.isfinite(total)]
            return typical_step(whole) if len(whole) > 2 and whole[-1] > whole[0] else None
        if (rate := uses.get("rate")) is not None and rate.known is not None:
            return 1.0 / rate.known.factor
        return None

    def _with_increments(self, uses: dict[str, Use]) -> dict[str, Use]:
        """Return the sensors; the length of increments over their interval is 1 g, and two streams have one ratio."""
        step_s = self._step_s(uses)
        if not step_s:
            return uses
        accel, gyro = uses.get("accel"), uses.get("gyro")
        if accel is not None and accel.kind == "deltas" and not accel.certain and accel.known is not None:
            uses["accel"] = self._with_length_of_gravity(accel, step_s)
        if gyro is not None and not gyro.certain and gyro.kind != "deltas":
            uses["gyro"] = self._compared_with_increments(gyro, step_s)
        return uses

    def _with_length_of_gravity(self, accel: Use, step_s: float) -> Use:
        """Return increments of velocity, in the unit in which their length over the interval is 1 g."""
        size = median_size(np.column_stack([self._columns[k].values for k in accel.columns]))
        for unit, factor in (("m/s", 1.0), ("g*s", STANDARD_GRAVITY)):
            if size and is_one_g(size * factor / step_s):
                reason = f"over its interval, its length is 1 g in {unit}"
                return replace(accel, unit=unit, known=known_unit(unit), certain=True, reason=reason)
        return accel

    def _compared_with_increments(self, gyro: Use, step_s: float) -> Use:
        """Return a gyroscope, in rad/s if increments of the same rotation beside it are those of deg."""
        noise = sample_noise(np.column_stack([self._columns[k].values for k in gyro.columns]))
        compared = gyro
        for other in triples(self._columns):
            if set(other.indices) & set(gyro.columns) or not len(other.axes) == len(gyro.axes) == 3:
                continue
            if not DELTA.search(other.words) or OTHER.search(other.words):
                continue
            ratio = sample_noise(other.rows) / (noise * step_s) if noise > 0.0 else 0.0
            if abs(ratio / math.degrees(1.0) - 1.0) < 0.1:
                reason = (
                    f"{gyro.reason}; {other.label} over their interval are 57.3 times as large: these are "
                    "rad/s, and those deg"
                )
                compared = replace(gyro, unit="rad/s", known=known_unit("rad/s"), reason=reason)
        return compared

    # ------------------------------------------------------------ what is beside the sensors

    def _beside(self, used: set[int]) -> dict[str, Use]:
        """Return magnetometer, temperature and pressure whose unit is stated, or shown by the size."""
        uses: dict[str, Use] = {
            key: use for key, use in self._given.items() if key in ("mag", "temperature", "pressure")
        }
        if (
            self._options.sensor is None
            and "mag" not in uses
            and (mag := self._magnetometer(used)) is not None
        ):
            uses["mag"] = mag
        for column in self._columns:
            if column.index in used or not len(column.present) or COUNTER.search(column.words):
                continue
            if "temperature" not in uses and _is_temperature(column):
                uses["temperature"] = Use(
                    "temperature",
                    (column.index,),
                    ("",),
                    column.unit or "degC",
                    column.known or known_unit("degC"),
                    True,
                    "its size is that of degC",
                )
            if "pressure" not in uses and _is_pressure(column):
                uses["pressure"] = Use(
                    "pressure", (column.index,), ("",), column.unit, column.known, True, "its unit is stated"
                )
        return uses

    def _magnetometer(self, used: set[int]) -> Use | None:
        """Return the first triple that states the unit of a magnetic field and moves; None: there is none."""
        for triple in triples(self._columns):
            if (
                triple.known_quantity == "mag"
                and not used & set(triple.indices)
                and not all(c.constant for c in triple.columns)
            ):
                known = known_unit(triple.unit, "mag")
                return Use("mag", triple.indices, AXES, triple.unit, known, True, "its unit is stated")
        return None

    def _why_unused(self, column: NamedColumn) -> str:
        if column.constant:
            return "it is constant" if len(column.present) else "no row has a number in it"
        if TIME.search(column.words):
            return "another column is the time"
        return "no name or unit of a sensor or a time"

    def _views(self, uses: Mapping[str, Use]) -> Iterator[ColumnView]:
        of = {k: key for key, use in uses.items() for k in use.columns}
        shown = [c for c in self._columns if len(c.present)]
        shown = sorted(sorted(shown, key=lambda c: c.index not in of)[:MOST_SHOWN], key=lambda c: c.index)
        for column in shown:
            looks = {"t": "time", "dt": "interval"}.get(
                of.get(column.index, ""), of.get(column.index, "constant" if column.constant else "")
            )
            there = column.present
            yield ColumnView(
                column.index,
                plain(column.base or "-")[:32],
                plain(column.unit or "-")[:8],
                float(np.mean(there)),
                float(np.std(there)),
                looks,
            )


def _is_steady(column: NamedColumn) -> bool:
    """Return whether the steps of a column are those of a sample clock."""
    with np.errstate(all="ignore"):
        return stamp_interval(column.present)[1]


def _time_of(column: NamedColumn, text: str, unit: Unit | None, reason: str, *, certain: bool = True) -> Use:
    """Return the time that a column is in a unit."""
    return Use("t", (column.index,), ("",), text, unit, certain, reason, "assumed_rate")


def _proposed_time(column: NamedColumn, rates: Mapping[str, float]) -> Use:
    """Return the time that a column is, in the unit whose rate, Hz, is the most usual one."""
    usual = {text: hz for text, hz in rates.items() if USUAL_HZ[0] <= hz <= USUAL_HZ[1]}
    best = min(usual or rates, key=lambda text: abs(math.log(rates[text] / TYPICAL_HZ)))
    shown = sorted(rates, key=lambda text: abs(math.log(rates[text] / TYPICAL_HZ)))[:2]
    alternatives = ", ".join(f"{rates[text]:.4g} Hz if it is {text}" for text in shown)
    reason = f"{label_of(column)} has no unit: {alternatives}"
    return _time_of(column, best, known_unit(best, "t"), reason, certain=False)


def _are_whole_seconds(column: NamedColumn) -> bool:
    """Return whether a column has whole seconds that never fall."""
    there = column.present
    if not len(there):
        return False
    named = re.search(r"(?:^| )(?:s|sec|secs|seconds)$", column.words)
    if column.known != known_unit("s", "t") and not named:
        return False
    return bool((there == np.rint(there)).all() and (np.diff(there) >= 0.0).all())


def _part_of_second(column: NamedColumn) -> str:
    """Return the unit of a column of parts of a second, ns or us; empty: it has none."""
    match = re.search(
        r"(?:^| )(ns|n ?secs?|nano ?secs?|nanos?|nanoseconds|us|u ?secs?|micro ?secs?|micros)(?: |$)",
        f"{column.words} {column.unit}",
    )
    if match is None or not len(column.present):
        return ""
    unit, most = ("ns", 1e9) if match[1].startswith("n") else ("us", 1e6)
    largest = column.present.max()
    return unit if column.present.min() >= 0.0 and 0.0 < largest < most else ""


def _may_be_interval(column: NamedColumn) -> bool:
    """Return whether a column has the name of an interval, and is no clock."""
    named = re.search(r"(?:^| )dt(?: |$)|delta ?time|deltatheta time|interval|(?:^| )time$", column.words)
    return named is not None and not column.rises and len(column.present) > 0


def _interval_unit(column: NamedColumn, step_s: float | None) -> str:
    """Return the unit in which intervals have the size of the steps of the time, s; empty: there is none."""
    typical = float(np.median(column.present))
    if typical <= 0.0:
        return ""
    is_time = column.known is not None and column.known.quantity == "t"
    for text in [column.unit] if is_time else CLOCK_UNITS:
        unit = known_unit(text, "t")
        if unit is None:
            continue
        interval_s = typical * unit.factor
        if step_s is not None:
            fits = 1.0 / 30.0 < interval_s / step_s < 30.0
        else:
            fits = column.known is not None or 1e-4 < interval_s < 2.0
        if fits:
            return text
    return ""


def _is_temperature(column: NamedColumn) -> bool:
    """Return whether a column is a temperature, by its unit or name, and its size."""
    quantity = None if column.known is None else column.known.quantity
    named = re.search(r"temp|(?:^| )tmp(?: |$)|^t$", column.words) is not None
    if quantity != "temperature" and not (named and not column.unit):
        return False
    zero = 273.15 if column.unit.lower() in ("k", "kelvin") else 0.0
    return -60.0 <= float(np.median(column.present)) - zero <= 130.0


def _is_pressure(column: NamedColumn) -> bool:
    """Return whether a column is the pressure of air, by its unit and its size."""
    if column.known is None or column.known.quantity != "pressure":
        return False
    return 20.0 < float(np.median(column.present)) * column.known.factor < 130.0
