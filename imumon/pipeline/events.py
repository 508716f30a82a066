"""Events of a monitor: what happened, each thing told once.

The record only counts; here its counts are compared with what was told before. An event has no time of the
room: whoever knows a clock stamps it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import datetime

from imumon.pipeline import report_builder
from imumon.pipeline.accumulators import Accumulators
from imumon.report import Change, Event, SensorGrade, stamp
from imumon.units import duration

GAP_TELL_S = 10.0
"""Sensor seconds between two events that tell of gaps."""

GRADE_STAYS = 1.1
"""Growth of the record in which another grade must stay before it is told."""


@dataclass(frozen=True, slots=True)
class DetectedEvent:
    """An event without its time."""

    kind: str
    text: str
    elapsed_s: float | None = None
    channel: str | None = None
    length_s: float | None = None
    size: float | None = None

    def stamped(self, now: datetime, device: str) -> Event:
        """The event of a report, told at `now` of `device`."""
        return Event(time=stamp(now), device=device, **asdict(self))


class EventLog:
    """Tell it what is; it keeps what is new until it is taken."""

    def __init__(self) -> None:
        self._found: list[DetectedEvent] = []
        self._gaps = (0, 0, 0.0)  # gaps and missing samples told so far, and when to tell again
        self._at_rest = True
        self._warmup_s = 0.0
        self._warming = self._warmed = False
        self._constants: set[str] = set()
        self._changes: set[tuple[int, str, str]] = set()
        self._grades: dict[str, str | None] = {}  # as told
        self._turning: dict[str, tuple[str | None, float]] = {}  # what they are instead, and since when
        self._grades_known = False

    def take(self) -> list[DetectedEvent]:
        """What happened since the last call, in order."""
        found, self._found = self._found, []
        return found

    def tell(
        self,
        kind: str,
        text: str,
        record: Accumulators | None = None,
        length_s: float | None = None,
        channel: str | None = None,
    ) -> None:
        """Tell one thing, `length_s` long, at the present end of the record."""
        elapsed = record.elapsed_s if record else None
        self._found.append(DetectedEvent(kind, text, elapsed_s=elapsed, channel=channel, length_s=length_s))

    def resumed(self, record: Accumulators) -> None:
        """The record was taken up: the gaps and grades it has were told before."""
        self._gaps = (record.gaps, record.missing, 0.0)
        self._grades_known = True

    def from_guards(self, record: Accumulators) -> None:
        """Tell what the guards cut out, of a warm-up that is over, and of rest and motion."""
        for cut in record.found():
            name = None if cut.channel is None else record.channels[cut.channel]
            where = "" if name is None else f" on {name}"
            length = cut.length * record.interval_s
            self._found.append(
                DetectedEvent(
                    "disturbance",
                    f"{cut.kind}{where}: {duration(length) if length >= 1 else f'{length:.2g} s'} left out",
                    elapsed_s=cut.start * record.interval_s,
                    channel=name,
                    length_s=length,
                    size=cut.size,
                )
            )
        warmup = record.warmup_s
        if warmup > self._warmup_s:
            self._warmup_s = warmup
            self.tell("warmup", f"a warm-up of {duration(warmup)} is over and left out", record, warmup)
        if record.at_rest != self._at_rest:
            self._at_rest = record.at_rest
            text = "at rest again" if record.at_rest else "not at rest: statistics are suspended"
            self.tell("rest" if record.at_rest else "motion", text, record)

    def from_warming(self, record: Accumulators, warming: bool) -> None:
        """Tell, once, when a warm-up is over of which nothing is cut out; where something is, the cut is
        told."""
        over = self._warming and not warming
        self._warming = warming
        if over and not self._warmed and not record.warmup_s:
            self._warmed = True
            text = "the warm-up is over: it does not show in the record so far, nothing is cut out"
            self.tell("warmup", text, record)

    def from_gaps(self, record: Accumulators) -> None:
        """Tell of gaps, those that came since the last telling in one line, ten seconds apart."""
        new = record.gaps - self._gaps[0]
        if not new or record.elapsed_s < self._gaps[2]:
            return
        missing = record.missing - self._gaps[1]
        if not missing:
            return  # of unknown length: told when it came
        length = missing * record.interval_s
        plural = "gap" if new == 1 else f"{new} gaps"
        self.tell("gap", f"{plural}: {missing:,} samples missing ({length:.4g} s)", record, length)
        self._gaps = (record.gaps, record.missing, record.elapsed_s + GAP_TELL_S)

    def from_constants(self, names: Iterable[str], record: Accumulators) -> None:
        """Tell of channels that never change, and of one that does after all."""
        now = set(names)
        for name in sorted(now - self._constants):
            self.tell("constant", f"{name} never changed: dead, stuck or not measured", record, channel=name)
        for name in sorted(self._constants - now):
            self.tell("constant", f"{name} changes now", record, channel=name)
        self._constants = now

    def from_changes(self, changes: Mapping[int, tuple[Change, ...]], record: Accumulators) -> None:
        """Tell of changes that are new, by column."""
        told = {
            (column, each.against, each.quantity): report_builder.sentence(record.channels[column], each)
            for column, of_channel in changes.items()
            for each in of_channel
        }
        for key, sentence in told.items():
            if key not in self._changes:
                self.tell("change", sentence, record)
        self._changes = set(told)

    def from_grades(self, grades: Mapping[str, SensorGrade], record: Accumulators) -> None:
        """Tell when a headline is another and has stayed so for a while: on the line between two it flips."""
        elapsed = record.elapsed_s
        for sensor, grade in grades.items():
            now, before = grade.nearest, self._grades.get(sensor)
            if now == before:
                self._turning.pop(sensor, None)
                continue
            turned, since = self._turning.get(sensor, (None, elapsed))
            if turned != now or elapsed < since:  # of another record
                since = elapsed
            self._turning[sensor] = (now, since)
            if sensor not in self._grades or elapsed >= since * GRADE_STAYS:
                self._grades[sensor] = now
                if not self._grades_known:
                    was = f" (was {before})" if before else ""
                    self.tell("grade", f"{sensor} is {now or 'without a grade'}{was}", record)
        self._grades_known &= not grades
