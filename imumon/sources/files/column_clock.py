"""Clock among columns: which column is the time, in which unit, and which interval increments have.

A clock never falls. Its unit is stated, or its numbers count from 1970; a rate that is stated or given shows the unit,
too. Without any of these, the unit is proposed in which the rate is most usual.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from imumon.grid.stamp_kinds import shows_rate, stamp_interval, typical_step
from imumon.model.cures import option, option_text
from imumon.model.samples import INERTIAL
from imumon.model.units import DAY
from imumon.sources.files.base import ReadOptions, RecordingError, different_rates, not_in_order
from imumon.sources.files.column_names import COUNTER, TIME, NamedColumn, label_of, names_sensor
from imumon.sources.files.columns import SINCE_1970_S, Use, factors_of, reference
from imumon.sources.files.row_selection import WINDOW
from imumon.sources.files.sizes_at_rest import FEWEST
from imumon.sources.files.unit_grammar import POSSIBLE_HZ, StatedRate, Unit, known_unit

USUAL_HZ, TYPICAL_HZ = (0.5, 9000.0), 150.0
"""Hz, rates at which the unit of a time is proposed, and the one that they lie around."""

SINCE_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of clocks that count from 1970, in s."""

CLOCK_UNITS = {**SINCE_UNITS, "day": DAY}
"""Units in which a clock may count, in s."""

STATED_SHARE = 0.02
"""Share by which the rate of a clock may differ from one that is stated: those are nominal."""

ALIKE = 0.01
"""Share by which two clocks of one time may differ, that of a host by its jitter: a 1024th of a second is no ms."""

MOST_INTERVALS = 30.0
"""Ratio of an interval to the typical step of the time, or its reciprocal, beyond which it is another quantity."""

_DURATION = r"(?:^| )(?:dt|delta|interval|nsecs?|nanosecs?)(?: |$)|deltatheta time"
"""Words of a time that is no clock: an interval, or a part of a second."""


class ColumnClock:
    """Finds the time of one table.

    Parameters
    ----------
    columns : of the table.
    options : of the user.
    rate : that a comment states; None: none does.
    dates : columns whose cells were dates.
    """

    def __init__(
        self,
        columns: Sequence[NamedColumn],
        options: ReadOptions,
        rate: StatedRate | None,
        dates: Collection[int],
    ) -> None:
        self._columns, self._options, self._dates = columns, options, dates
        self._rate, self._reason = options.rate_hz, "the rate is given"
        self._of_chip = False
        if self._rate is None and rate is not None:
            self._rate, self._reason = rate.hz, f"a comment states {rate.hz:g} Hz"
            self._of_chip = not rate.of_rows
        names = Counter(column.name for column in columns if column.rises)
        self._words = [column.words for column in columns]
        for column, behind in pairwise(columns):
            if names[column.name] > 1:  # clocks of one name are each that of the channel behind it
                quantity = "" if behind.known is None else behind.known.quantity
                self._words[column.index] = f"{column.words} {behind.words} {quantity}"

    def time(self, excluded: Collection[int]) -> Use:
        """Return the time, or the rate in its place.

        Parameters
        ----------
        excluded : columns that are something else.

        Raises
        ------
        RecordingError : each sensor has a clock of its own, or the rows are not in the order of the time.
        """
        free = [c for c in self._columns if c.index not in excluded]
        clocks = sorted(filter(self._may_be_clock, free), key=self._rank)
        best = clocks[0] if clocks else None
        is_alone = best is not None and (best.index in self._dates or "startup" in best.words)
        if not is_alone and (pair := _pair(free)) is not None:
            return pair
        if best is not None:
            self._check_one_clock(clocks)
            return self._beside_stated(best, clocks)
        _check_order(free)
        if self._rate is not None:
            rate, text = Unit("rate", self._rate), f"{self._rate:g}"
            if not self._of_chip:
                return Use("rate", unit=text, known=rate, certain=True, reason=self._reason)
            reason = f"{self._reason} as the output data rate of the chip, which may be read less often"
            return Use("rate", unit=text, known=rate, reason=reason, assumptions=("assumed_rate",))
        reason = "no column is a time, and nothing states the rate"
        return Use("rate", reason=reason, assumptions=("assumed_rate",))

    def _beside_stated(self, best: NamedColumn, clocks: Sequence[NamedColumn]) -> Use:
        """Return the best clock; without a unit, it has the one in which it runs as a clock whose unit is known.

        If it has none of these, it counts ticks of its own, and the clock whose unit is known is used.
        """
        stated = next((c for c in clocks if self._unit(c) and not self._is_of_other(c)), best)
        if stated is best or self._rate is not None:
            return self.use_of(best)
        use = self.use_of(stated)
        assert use.known is not None
        per_second = float(np.ptp(best.present) / np.ptp(stated.present)) / use.known.factor
        for text, factor in CLOCK_UNITS.items():
            if abs(per_second * factor - 1.0) < ALIKE:
                return replace(use, columns=(best.index,), unit=text, known=known_unit(text, "t"))
        return use

    def use_of(self, column: NamedColumn) -> Use:
        """Return the time that a column is, with its unit; raise `RecordingError` if that is stated and not known."""
        step, certain = typical_step(column.present), True
        rates = {text: 1.0 / (step * factor) for text, factor in CLOCK_UNITS.items()}
        text = self._options.units.get("time", "") or self._unit(column)
        reason = "its unit is given or stated, or its numbers count from 1970"
        if not text and self._rate is not None and not self._of_chip:
            fitting = [unit for unit, hz in rates.items() if abs(hz / (self._rate or hz) - 1.0) < 0.05]
            # a comment may state the rate of the sensor, and the clock another one of the rows
            certain = bool(fitting) or step == 1.0 or self._options.rate_hz is not None
            text = [*fitting, f"{float(f'{1.0 / (step * self._rate):.7g}')!r}s"][0]
            reason = f"{self._reason}, which gives {label_of(column)} the unit {text}"
        if not text and column.unit:
            names = [c.name for c in self._columns]
            stated = option_text(columns={"t": f"{reference(column.index, names)}:UNIT"})
            message = f"the unit {column.unit!r} of the time {label_of(column)} is not known"
            cure = f"say which it is, {stated}, or {option('rate_hz')}"
            raise RecordingError("unknown_unit", message, cure)
        if not text:
            text, reason = _proposal(column, rates)
            certain = False
        known = known_unit(text, "t")
        return Use("t", (column.index,), ("",), text, known, certain, reason, ("assumed_rate",))

    def _unit(self, column: NamedColumn) -> str:
        """Return the unit of a clock that is stated, is its name, or is shown by a time since 1970; empty: none."""
        if column.index in self._dates:
            return "s"
        if column.known is not None:
            return column.unit
        middle, step = float(np.median(column.present)), typical_step(column.present)
        for text, factor in SINCE_UNITS.items():
            if SINCE_1970_S[0] <= middle * factor < SINCE_1970_S[1] and _is_possible(step * factor):
                return text
        return ""

    def _may_be_clock(self, column: NamedColumn) -> bool:
        """Return whether a column may be the time, by its numbers, its name and its unit."""
        if not (column.rises or column.index in self._dates) or not shows_rate(column.present):
            return False
        step = typical_step(column.present)
        if column.known is not None:
            return column.known.quantity == "t" and _is_possible(step * column.known.factor)
        counts_rows = step == 1.0 or COUNTER.search(column.words)
        shows = not counts_rows and (not column.words or _is_steady(column))
        return bool(TIME.search(column.words) or self._unit(column) or shows)

    def _rank(self, column: NamedColumn) -> tuple[object, ...]:
        """Return the order of clocks: that of a sensor, the stated rate, no restart, a name, even steps."""
        step, text, words = typical_step(column.present), self._unit(column), self._words[column.index]
        units = [known_unit(unit, "t") for unit in ([text] if text else CLOCK_UNITS)]
        rates = [1.0 / (step * unit.factor) for unit in units if unit is not None]
        return (
            not names_sensor(words),
            not any(abs(hz / (self._rate or math.inf) - 1.0) < STATED_SHARE for hz in rates),
            self._is_of_other(column),
            float(np.diff(column.present).min()) < -WINDOW * step,  # rows that are late make it fall less
            not (TIME.search(column.words) or not column.words),
            not _is_steady(column),
            not text,
            "tick" in column.words,  # of a length of its own
            not re.search(r"startup|sample|sensor|device|boot|chip", column.words),
            bool(re.search(r"host|system|app|log|recv|receive|arrival|gps|utc", column.words)),
        )

    def _is_of_other(self, column: NamedColumn) -> bool:
        """Return whether a clock is named after another sensor than the one that is read."""
        of_other = {"gyro": "acc", "accel": "gyr"}.get(self._options.sensor or "", "$^")
        words = self._words[column.index]
        return re.search(rf"{of_other}|gnss|location|mag|baro|alt|position", words) is not None

    def _check_one_clock(self, clocks: Sequence[NamedColumn]) -> None:
        """Raise `RecordingError` if gyroscope and accelerometer have a time each, and these differ."""
        of = {sensor: c for sensor in INERTIAL for c in clocks[::-1] if sensor[:3] in self._words[c.index]}
        if self._options.sensor is not None or len(of) < len(INERTIAL):
            return
        gyro, accel = of["gyro"], of["accel"]
        if abs(typical_step(gyro.present) / typical_step(accel.present) - 1.0) > STATED_SHARE:
            raise different_rates(f"gyro has the time {label_of(gyro)} and accel {label_of(accel)}")


def interval_among(columns: Sequence[NamedColumn], step_s: float | None) -> Use | None:
    """Return the length of each sample's own interval; None: no column has it.

    Parameters
    ----------
    step_s : s, typical step of the time; None: unknown.
    """
    for column in columns:
        words, size = column.words, float(np.median(column.present)) if len(column.present) else 0.0
        if column.rises or size <= 0.0 or not re.search(rf"{_DURATION}|delta ?time|(?:^| )time$", words):
            continue
        for text in [column.unit] if column.known is not None else CLOCK_UNITS:
            known = known_unit(text, "t")
            if known is None or known.quantity != "t":
                continue
            fits = 1e-4 < size * known.factor < 2.0
            if step_s is not None:
                fits = abs(math.log(size * known.factor / step_s)) < math.log(MOST_INTERVALS)
            if fits:
                reason = "its size is that of the steps of the time"
                return Use("dt", (column.index,), ("",), text, known, True, reason)
    return None


def step_of(use: Use, columns: Sequence[NamedColumn]) -> float | None:
    """Return the typical interval, s, that a time, an interval or a rate shows; None: it shows none."""
    if use.known is None:
        return None
    if not use.columns:
        return 1.0 / use.known.factor
    values = np.column_stack([columns[k].values for k in use.columns]) @ factors_of(use)
    whole = values[np.isfinite(values)]
    if use.key == "dt":
        return float(np.median(whole)) if len(whole) else None
    return typical_step(whole) if len(whole) > 2 and whole[-1] > whole[0] else None


def _is_possible(step_s: float) -> bool:
    return POSSIBLE_HZ[0] <= 1.0 / step_s <= POSSIBLE_HZ[1]


def _is_steady(column: NamedColumn) -> bool:
    """Return whether the steps of a column are those of a sample clock."""
    with np.errstate(all="ignore"):
        return stamp_interval(column.present)[1]


def _proposal(column: NamedColumn, rates: Mapping[str, float]) -> tuple[str, str]:
    """Return the unit of a time whose rate, Hz, is the most usual one, and why it is asked."""

    def unusual(text: str) -> float:
        return abs(math.log(rates[text] / TYPICAL_HZ))

    usual = [text for text, hz in rates.items() if USUAL_HZ[0] <= hz <= USUAL_HZ[1]]
    alternatives = (f"{rates[text]:.4g} Hz if it is {text}" for text in sorted(rates, key=unusual)[:2])
    return min(usual or rates, key=unusual), f"{label_of(column)} has no unit: {', '.join(alternatives)}"


def _pair(free: Sequence[NamedColumn]) -> Use | None:
    """Return whole seconds and a fine part of them in two columns; None: there are none."""
    for seconds in free:
        there, named = seconds.present, re.search(r"(?:^| )(?:s|sec|secs|seconds)$", seconds.words)
        if not len(there) or not (named or seconds.known == known_unit("s", "t")):
            continue
        if (there != np.rint(there)).any() or (np.diff(there) < 0.0).any():
            continue
        for part in free:
            unit = "" if part is seconds else _part_of_second(part)
            if unit:
                reason = f"{seconds.name} has seconds and {part.name} the {unit} of them"
                columns, known = (seconds.index, part.index), known_unit("s", "t")
                return Use("t", columns, ("", ""), f"s+{unit}", known, True, reason)
    return None


def _part_of_second(column: NamedColumn) -> str:
    """Return the unit of a column of parts of a second, ns or us; empty: it has none."""
    there = column.present
    for unit in ("ns", "us") if len(there) else ():
        if column.known == known_unit(unit) and there.min() >= 0.0 < there.max() < 1.0 / SINCE_UNITS[unit]:
            return unit
    return ""


def _check_order(free: Sequence[NamedColumn]) -> None:
    """Raise `RecordingError` if a time is there whose rows are in no order."""
    for column in free:
        there, is_time = column.present, column.known is not None and column.known.quantity == "t"
        named = column.words in ("t", "time", "timestamp") or is_time
        if (
            named
            and not re.search(_DURATION, column.words)
            and len(np.unique(there)) > len(there) / 2 > FEWEST
        ):
            back = float((np.diff(there) < 0.0).mean())
            if 0.05 < back < 1.0:
                raise not_in_order(label_of(column), back)
