"""Events of the pipeline: what happened, each thing once.

The record only counts. The event log compares its counts with those of the last call and keeps what is new.
An event has no time: the caller, which has a clock, adds it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import datetime

from imumon.messages import EVENT_LEVELS, grade_text
from imumon.pipeline import report_builder
from imumon.pipeline.accumulators import Accumulators
from imumon.pipeline.loss import LossChange
from imumon.report import Change, Event, SensorGrade, stamp
from imumon.samples import Level
from imumon.units import duration

GAP_EVENT_S = 10.0
"""s of device time between two events about gaps: a lossy link must not flood the log. Not critical."""

GRADE_HOLD = 1.1
"""Growth of the record, as a factor, over which another grade must hold before it is an event: a value near
the limit of two grades changes sides with every fit. Not critical."""

CHANGE_HOLD_S = 60.0
"""s of the record without a change after which it is over: one near the limit comes and goes with every fit.
Not critical."""


@dataclass(frozen=True, slots=True)
class DetectedEvent:
    """An event without its time; see `imumon.report.Event`."""

    kind: str
    text: str
    code: str = ""  # cause of a restart, for programs: clock_reset, other_rate or other_stream
    elapsed_s: float | None = None
    channel: str | None = None
    length_s: float | None = None
    size: float | None = None
    level: Level | None = None  # None: that of the kind

    def stamped(self, now: datetime, device: str) -> Event:
        """Return the event of `device` at the time `now`."""
        published = asdict(self) | {"level": self.level or EVENT_LEVELS[self.kind]}
        del published["code"]
        return Event(time=stamp(now), device=device, **published)


class EventLog:
    """Events that were not read yet, and what earlier events have reported."""

    def __init__(self) -> None:
        self._events: list[DetectedEvent] = []
        self._gaps, self._missing = 0, 0  # reported so far
        self._next_gap_s = 0.0  # s of the record, earliest time of the next event about gaps
        self._at_rest = True
        self._warmup_s = 0.0
        self._warming_up = self._warmup_reported = False
        self._constant: set[str] = set()
        self._stuck = False
        self._changes: dict[tuple[int, str, str], float] = {}  # when it was last there, s of the record
        self._grades: dict[str, SensorGrade] = {}  # as reported
        self._candidates: dict[str, tuple[SensorGrade, float]] = {}  # other grades, and since when, s
        self._first_grades_known = False

    def drain(self) -> list[DetectedEvent]:
        """Return and forget the events since the last call, in order."""
        events, self._events = self._events, []
        return events

    def add(
        self,
        kind: str,
        text: str,
        record: Accumulators | None = None,
        length_s: float | None = None,
        channel: str | None = None,
        code: str = "",
        level: Level | None = None,
    ) -> None:
        """Add one event, `length_s` long, at the present end of the record."""
        elapsed = record.elapsed_s if record else None
        self._events.append(DetectedEvent(kind, text, code, elapsed, channel, length_s, level=level))

    def record_restored(self, record: Accumulators) -> None:
        """Note that the gaps and grades of a restored record have been reported before."""
        self._gaps, self._missing, self._next_gap_s = record.gaps, record.missing, 0.0
        self._first_grades_known = True

    def update_guard(self, record: Accumulators) -> None:
        """Add what the guard excluded, the end of a warm-up, and rest and motion."""
        for disturbance in record.new_disturbances():
            name = None if disturbance.channel is None else record.channels[disturbance.channel]
            start, length = disturbance.start * record.interval_s, disturbance.length * record.interval_s
            excluded = duration(length) if length >= 60.0 else f"{length:.2g} s"
            text = f"{disturbance.kind}{f' on {name}' if name else ''}: {excluded} excluded"
            event = DetectedEvent("disturbance", text, "", start, name, length, disturbance.size)
            self._events.append(event)
        warmup = record.warmup_s
        if warmup > self._warmup_s:
            self._warmup_s = warmup
            self.add("warmup", f"a warm-up of {duration(warmup)} is over and excluded", record, warmup)
        if (at_rest := record.guard.at_rest) != self._at_rest:
            self._at_rest = at_rest
            text = "at rest again" if at_rest else "not at rest: statistics are suspended"
            self.add("rest" if at_rest else "motion", text, record)
        self._update_stuck(record)

    def update_warmup(self, record: Accumulators, warming_up: bool) -> None:
        """Add, once, the end of a warm-up of which nothing is excluded; else `update_guard` adds it."""
        over = self._warming_up and not warming_up
        self._warming_up = warming_up
        if over and not self._warmup_reported and not record.warmup_s:
            self._warmup_reported = True
            text = "the warm-up is over: it does not show in the record so far, nothing is excluded"
            self.add("warmup", text, record)

    def update_gaps(self, record: Accumulators) -> None:
        """Add the gaps since the last event about gaps as one event."""
        new = record.gaps - self._gaps
        missing = record.missing - self._missing
        if not new or not missing or record.elapsed_s < self._next_gap_s:
            return  # without missing samples the length is unknown: the monitor has added that event
        length = missing * record.interval_s
        plural = "gap" if new == 1 else f"{new} gaps"
        self.add("gap", f"{plural}: {missing:,} samples missing ({length:.4g} s)", record, length)
        self._gaps, self._missing = record.gaps, record.missing
        self._next_gap_s = record.elapsed_s + GAP_EVENT_S

    def update_constant(self, names: Iterable[str], record: Accumulators) -> None:
        """Add channels that never change, and those that change after all."""
        now = set(names)
        for name in sorted(now - self._constant):
            self.add("constant", f"{name} never changed: dead, stuck or not measured", record, channel=name)
        for name in sorted(self._constant - now):
            self.add("constant", f"{name} changes now", record, channel=name, level="notice")
        self._constant = now

    def _update_stuck(self, record: Accumulators) -> None:
        """Add that the sensor or an axis begins, or ends, to repeat its values."""
        if record.stuck != self._stuck:
            self._stuck = record.stuck
            begins = "the values do not change: an axis or the whole sensor hangs"
            text = begins if self._stuck else "the values change again"
            self.add("stuck", text, record, level=None if self._stuck else "notice")

    def update_loss(self, changes: Iterable[LossChange], record: Accumulators) -> None:
        """Add that the link begins, or ends, to lose more samples than it may."""
        for change in changes:
            lost = f"{change.missing:,} of the last {change.expected:,} samples did not arrive"
            text = lost if change.begins else f"the loss has ended: {lost}"
            level: Level | None = None if change.begins else "notice"
            elapsed = record.elapsed_s - change.age_s
            self._events.append(DetectedEvent("loss", text, elapsed_s=elapsed, level=level))

    def update_changes(self, changes: Mapping[int, tuple[Change, ...]], record: Accumulators) -> None:
        """Add changes that are new, by column."""
        current = {
            (column, each.against, each.quantity): report_builder.change_text(record.channels[column], each)
            for column, of_channel in changes.items()
            for each in of_channel
        }
        elapsed = record.elapsed_s
        for key, text in current.items():
            if key not in self._changes:
                self.add("change", text, record, channel=record.channels[key[0]])
            self._changes[key] = elapsed
        for key, seen in list(self._changes.items()):
            if not seen <= elapsed < seen + CHANGE_HOLD_S:  # a shorter record is another one
                del self._changes[key]
                if elapsed > seen:
                    name, against, quantity = record.channels[key[0]], *key[1:]
                    text = f"{name}: {quantity} does not differ from the {against} any more"
                    self.add("change", text, record, channel=name, level="notice")

    def update_grades(self, grades: Mapping[str, SensorGrade], record: Accumulators) -> None:
        """Add a headline grade that differs from the reported one and has held for `GRADE_HOLD`."""
        elapsed = record.elapsed_s
        for sensor, grade in grades.items():
            before = self._grades.get(sensor, SensorGrade())
            if sensor in self._grades and _same(grade, before):
                self._candidates.pop(sensor, None)
                continue
            candidate, since = self._candidates.get(sensor, (grade, elapsed))
            if not _same(candidate, grade) or elapsed < since:  # a shorter record is another one
                since = elapsed
            self._candidates[sensor] = (grade, since)
            if sensor not in self._grades or elapsed >= since * GRADE_HOLD:
                self._grades[sensor] = grade
                if not self._first_grades_known:
                    was = f" (before: {grade_text(before)})" if before.nearest else ""
                    self.add("grade", f"{sensor}: {grade_text(grade)}{was}", record)
        self._first_grades_known &= not grades


def _same(one: SensorGrade, other: SensorGrade) -> bool:
    """Return whether two grades differ at most in being provisional."""
    return (one.nearest, one.meets) == (other.nearest, other.meets)
