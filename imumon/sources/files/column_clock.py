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
    ANGULAR,
    COUNTER,
    DELTA,
    FEWEST,
    OTHER,
    TIME,
    NamedColumn,
    label_of,
    triples,
)
from imumon.sources.files.columns import MOST_SHOWN, SINCE_1970_S, ColumnView, Use, reference
from imumon.sources.files.sizes_at_rest import NEAR_ONE_G, is_one_g, median_size, sample_noise
from imumon.sources.files.unit_grammar import POSSIBLE_HZ, Unit, known_unit

USUAL_HZ, TYPICAL_HZ = (0.5, 9000.0), 150.0
"""Hz, rates at which the unit of a time is proposed, and the one that they lie around."""

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
        result = []
        for column in self._columns:
            named = bool(TIME.search(column.words)) or (
                column.known is not None and column.known.quantity == "t"
            )
            if (
                column.index in used
                or not (column.rises or column.index in self._dates)
                or not shows_rate(column.present)
            ):
                continue
            if re.search(r"^(?:dt|delta time|week|gps week)$|leap", column.words) or (
                column.known is not None and column.known.quantity != "t"
            ):
                continue
            step = typical_step(column.present)
            if not named and (step == 1.0 or COUNTER.search(column.words)):
                continue
            if not named and column.words and self._clock_unit(column) is None and not _is_steady(column):
                continue
            if (
                column.known is not None
                and not POSSIBLE_HZ[0] <= 1.0 / (step * column.known.factor) <= POSSIBLE_HZ[1]
            ):
                continue
            result.append(column)
        return sorted(result, key=lambda c: self._clock_rank(c, rate))

    def _clock_rank(self, column: NamedColumn, rate: float | None) -> tuple[object, ...]:
        step = typical_step(column.present)
        unit = self._clock_unit(column)
        units = [unit] if unit is not None else [known_unit(u, "t") for u in ("s", "ms", "us", "ns")]
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
        for text in ("s", "ms", "us", "ns"):
            unit = known_unit(text, "t")
            if unit is not None and SINCE_1970_S[0] <= middle * unit.factor < SINCE_1970_S[1]:
                hz = 1.0 / (typical_step(column.present) * unit.factor)
                return unit if POSSIBLE_HZ[0] <= hz <= POSSIBLE_HZ[1] else None
        return None

    def _clock(self, column: NamedColumn, rate: float | None) -> Use:
        """Return the time that a column is, with its unit."""
        name, step = label_of(column), typical_step(column.present)
        has_unit = column.known is not None or rate is not None or "time" in self._options.units
        if column.unit and not has_unit and self._clock_unit(column) is None:
            stated = option_text(columns={"t": f"{reference(column.index, self._names)}:UNIT"})
            cure = f"say which it is, {stated}, or {option('rate_hz')}"
            raise RecordingError(
                "unknown_unit", f"the unit {column.unit!r} of the time {name} is not known", cure
            )
        if (given := self._options.units.get("time")) is not None:
            known = known_unit(given, "t")
            if known is None or known.quantity != "t":
                raise OptionError("unknown_unit", f"{given!r} is no unit of time", "use s, ms, us or ns")
            return Use("t", (column.index,), ("",), given, known, True, "its unit is given", "assumed_rate")
        unit = self._clock_unit(column)
        if unit is not None:
            text = (
                column.unit
                if column.known is not None
                else next(u for u in ("s", "ms", "us", "ns") if known_unit(u, "t") == unit)
            )
            return Use(
                "t",
                (column.index,),
                ("",),
                text,
                unit,
                bool(column.words)
                or column.index in self._dates
                or column.known is not None
                or not column.name,
                "its unit is stated, or its numbers count from 1970",
                "assumed_rate",
            )
        rates = {text: 1.0 / (step * 10.0 ** (-3 * k)) for k, text in enumerate(("s", "ms", "us", "ns"))}
        if rate is not None:
            fitting = next((text for text, hz in rates.items() if abs(hz / rate - 1.0) < 0.05), None)
            text = fitting or f"{float(f'{1.0 / (step * rate):.7g}')!r}s"
            return Use(
                "t",
                (column.index,),
                ("",),
                text,
                known_unit(text, "t"),
                True,
                f"{rate:g} Hz gives the unit of {name}",
                "assumed_rate",
            )
        usual = {text: hz for text, hz in rates.items() if USUAL_HZ[0] <= hz <= USUAL_HZ[1]}
        best = min(usual or rates, key=lambda text: abs(math.log(rates[text] / TYPICAL_HZ)))
        shown = sorted(rates, key=lambda text: abs(math.log(rates[text] / TYPICAL_HZ)))[:2]
        alternatives = ", ".join(f"{rates[text]:.4g} Hz if it is {text}" for text in shown)
        return Use(
            "t",
            (column.index,),
            ("",),
            best,
            known_unit(best, "t"),
            False,
            f"{name} has no unit: {alternatives}",
            "assumed_rate",
        )

    def _pair(self, used: set[int]) -> Use | None:
        """Return seconds and a fine part of them in two columns; None: there are none."""
        free = [c for c in self._columns if c.index not in used]
        coarse = [
            c
            for c in free
            if len(c.present)
            and (c.known == known_unit("s", "t") or re.search(r"(?:^| )(?:s|sec|secs|seconds)$", c.words))
            and bool((c.present == np.rint(c.present)).all() and (np.diff(c.present) >= 0.0).all())
        ]
        for seconds in coarse:
            for part in free:
                match = re.search(
                    r"(?:^| )(ns|n ?secs?|nano ?secs?|nanos?|nanoseconds|us|u ?secs?|micro ?secs?|micros)(?: |$)",
                    f"{part.words} {part.unit}",
                )
                if match is None or part is seconds or not len(part.present):
                    continue
                unit = "ns" if match[1].startswith("n") else "us"
                most = 1e9 if unit == "ns" else 1e6
                if part.present.min() >= 0.0 and part.present.max() < most and (part.present.max() > 0.0):
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
        for triple in triples(self._columns):
            if triple.unit or (gyro is not None and set(triple.indices) & set(gyro.columns)):
                continue
            if (
                re.search(r"acc|mag|quat|pos", triple.words)
                or not abs(triple.size / step_s / STANDARD_GRAVITY - 1.0) < NEAR_ONE_G
            ):
                continue
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
            if (
                gyro is not None
                and not gyro.certain
                and gyro.kind != "deltas"
                and gyro.assumption == "assumed_columns"
            ):
                listed = ", ".join(label_of(self._columns[k]) for k in gyro.columns)
                reason = f"{listed} are beside increments: rad"
                gyro = replace(gyro, unit="rad", known=known_unit("rad"), kind="deltas", reason=reason)
            return {
                **({"gyro": gyro} if gyro is not None else {}),
                "accel": accel,
                **{k: u for k, u in uses.items() if k != "gyro"},
            }
        return uses

    # ------------------------------------------------------------ increments, and what is beside the sensors

    def _interval(self, uses: Mapping[str, Use]) -> dict[str, Use]:
        """Return the length of each sample's own interval, where a sensor has increments."""
        if "dt" in self._given:
            return {"dt": self._given["dt"]}
        if not any(uses[key].kind == "deltas" for key in INERTIAL if key in uses):
            return {}
        step_s = self._step_s(uses)
        for column in self._columns:
            if (
                not re.search(
                    r"(?:^| )dt(?: |$)|delta ?time|deltatheta time|interval|(?:^| )time$", column.words
                )
                or column.rises
                or not len(column.present)
            ):
                continue
            typical = float(np.median(column.present))
            texts = (
                [column.unit]
                if column.known is not None and column.known.quantity == "t"
                else ["s", "ms", "us", "ns"]
            )
            for text in texts:
                unit = known_unit(text, "t")
                if unit is None or typical <= 0.0:
                    continue
                if step_s is None and column.known is None and not 1e-4 < typical * unit.factor < 2.0:
                    continue
                if step_s is None or 1.0 / 30.0 < typical * unit.factor / step_s < 30.0:
                    return {
                        "dt": Use(
                            "dt",
                            (column.index,),
                            ("",),
                            text,
                            unit,
                            True,
                            "its size is that of the steps of the time",
                        )
                    }
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
        accel = uses.get("accel")
        if (
            step_s
            and accel is not None
            and accel.kind == "deltas"
            and not accel.certain
            and accel.known is not None
        ):
            size = median_size(np.column_stack([self._columns[k].values for k in accel.columns]))
            if size and is_one_g(size / step_s):
                uses["accel"] = replace(
                    accel,
                    unit="m/s",
                    known=known_unit("m/s"),
                    certain=True,
                    reason="over its interval, its length is 1 g in m/s",
                )
            elif size and is_one_g(size * STANDARD_GRAVITY / step_s):
                uses["accel"] = replace(
                    accel,
                    unit="g*s",
                    known=known_unit("g*s"),
                    certain=True,
                    reason="over its interval, its length is 1 g in g*s",
                )
        gyro = uses.get("gyro")
        if step_s and gyro is not None and not gyro.certain:
            rows = np.column_stack([self._columns[k].values for k in gyro.columns])
            others = [
                t
                for t in triples(self._columns)
                if not set(t.indices) & set(gyro.columns)
                and len(t.axes) == len(gyro.axes) == 3
                and bool(DELTA.search(t.words)) != (gyro.kind == "deltas")
                and (ANGULAR.search(t.words) or DELTA.search(t.words))
                and not OTHER.search(t.words)
            ]
            for other in others:
                one, two = sample_noise(rows), sample_noise(other.rows)
                ratio = (
                    (two / (one * step_s) if gyro.kind != "deltas" else two * step_s / one)
                    if one > 0.0
                    else 0.0
                )
                if abs(ratio / math.degrees(1.0) - 1.0) < 0.1 and gyro.kind != "deltas":
                    reason = (
                        f"{gyro.reason}; {other.label} over their interval are 57.3 times as large: these are "
                        "rad/s, and those deg"
                    )
                    uses["gyro"] = replace(gyro, unit="rad/s", known=known_unit("rad/s"), reason=reason)
        return uses

    # ------------------------------------------------------------ what is beside the sensors

    def _beside(self, used: set[int]) -> dict[str, Use]:
        """Return magnetometer, temperature and pressure whose unit is stated, or shown by the size."""
        uses: dict[str, Use] = {
            key: use for key, use in self._given.items() if key in ("mag", "temperature", "pressure")
        }
        if self._options.sensor is None:
            for triple in triples(self._columns):
                if (
                    "mag" not in uses
                    and triple.known_quantity == "mag"
                    and not used & set(triple.indices)
                    and not all(c.constant for c in triple.columns)
                ):
                    known = known_unit(triple.unit, "mag")
                    uses["mag"] = Use(
                        "mag", triple.indices, AXES, triple.unit, known, True, "its unit is stated"
                    )
        for column in self._columns:
            if column.index in used or not len(column.present) or COUNTER.search(column.words):
                continue
            middle = float(np.median(column.present))
            quantity = None if column.known is None else column.known.quantity
            named = re.search(r"temp|(?:^| )tmp(?: |$)|^t$", column.words) is not None
            if (
                "temperature" not in uses
                and (quantity == "temperature" or (named and not column.unit))
                and -60.0 <= middle - (273.15 if column.unit.lower() in ("k", "kelvin") else 0.0) <= 130.0
            ):
                uses["temperature"] = Use(
                    "temperature",
                    (column.index,),
                    ("",),
                    column.unit or "degC",
                    column.known or known_unit("degC"),
                    True,
                    "its size is that of degC",
                )
            if (
                "pressure" not in uses
                and quantity == "pressure"
                and column.known is not None
                and 20.0 < middle * column.known.factor < 130.0
            ):
                uses["pressure"] = Use(
                    "pressure", (column.index,), ("",), column.unit, column.known, True, "its unit is stated"
                )
        return uses

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
