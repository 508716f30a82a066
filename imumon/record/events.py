"""Events of the pipeline: what happened, each thing once.

What samples show on their own (gaps, exclusions, motion, changes between hours) is placed where it happened in
the record, for any splitting of the samples into blocks. What limits show (constant channels, grades, changes
from a baseline) is noted by the reports. An event has no time: the caller, which has a clock, adds it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime

import numpy as np

from imumon.grid.sample_clock import BREAK
from imumon.model.messages import EVENT_LEVELS, change_text, grade_text, loss_text
from imumon.model.report import WARM_S, Change, Event, SensorGrade, stamp
from imumon.model.samples import Ints, Level
from imumon.model.units import counted, duration
from imumon.noise.detection.disturbance import Disturbance
from imumon.noise.stretches.change import CoefficientChange
from imumon.noise.stretches.sums import Ended
from imumon.record.changes import HOURS_BEFORE, changes_by_column

GAP_EVENT_S = 10.0
"""s of device time between two events about gaps, or about resets of the clock: a lossy link or a broken clock
must not flood the log."""

GRADE_HOLD = 1.1
"""Growth of the record, as a factor, over which another grade must hold before it is an event: a value near
the limit of two grades changes sides with every fit."""

CHANGE_HOLD_S = 60.0
"""s of the record without a change after which it is over: one near the limit comes and goes with every fit."""

RECOVERED = 0.5
"""Share of the limit of the loss below which its alarm is over: a share near the limit crosses it all the time."""

NOTICE: Level = "notice"


@dataclass(frozen=True, slots=True)
class DetectedEvent:
    """An event without its time; see `imumon.model.report.Event`."""

    kind: str
    text: str
    elapsed_s: float | None = None
    code: str = ""  # cause of a restart, for programs: clock_reset, other_rate or other_stream
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
        self._gaps, self._missing = 0, 0  # not reported yet
        self._next_gap_s = 0.0  # s of the record, earliest time of the next event about gaps
        self._next_reset_s = 0.0  # the same for resets of the clock
        self._warming_up = self._warmup_reported = False
        self._constant: set[str] = set()
        self._lossy = False  # the loss was above its limit
        # by column, what it differs from, and quantity: when the change was last there, s of the record
        self._changes_between_hours: dict[tuple[int, str, str], float] = {}
        self._other_changes: dict[tuple[int, str, str], float] = {}
        self._grades: dict[str, SensorGrade] = {}  # as reported
        self._candidates: dict[str, tuple[SensorGrade, float]] = {}  # other grades, and since when, s
        self._first_grades_known = False
        self._channels: Sequence[str] = ()
        self._interval_s = 0.0

    def drain(self) -> list[DetectedEvent]:
        """Return and forget the events since the last call, in order."""
        events, self._events = self._events, []
        return events

    def add(self, event: DetectedEvent) -> None:
        """Add one event."""
        self._events.append(event)

    def begin(self, channels: Sequence[str], interval_s: float) -> None:
        """Note that a record of these channels begins: its times begin at 0, and nothing of it has been reported."""
        self._channels, self._interval_s = channels, interval_s
        self._gaps, self._missing = 0, 0
        self._next_gap_s = self._next_reset_s = 0.0
        self._warming_up = self._warmup_reported = False
        self._changes_between_hours.clear()
        self._other_changes.clear()

    def restored(self, changes: Mapping[int, tuple[CoefficientChange, ...]]) -> None:
        """Note that the changes between hours and the grades of a restored record have been reported before."""
        for column, of_column in changes_by_column(changes, HOURS_BEFORE).items():
            for change in of_column:
                self._changes_between_hours[column, change.against, change.quantity] = 0.0
        self._first_grades_known = True

    def update_happened(
        self,
        disturbances: Iterable[Disturbance],
        rest: Iterable[tuple[int, bool]],
        stuck: Iterable[tuple[int, bool]],
        ended: Ended,
    ) -> None:
        """Add what the guard excluded, rest and motion, the end of a warm-up, and changes between hours.

        Parameters
        ----------
        disturbances : that ended.
        rest, stuck : places on the grid where the sensor comes to rest or moves, and where it hangs or does not.
        ended : warm-ups and hours.
        """
        for disturbance in disturbances:
            name = None if disturbance.channel is None else self._channels[disturbance.channel]
            start, length = disturbance.start * self._interval_s, disturbance.length * self._interval_s
            excluded = duration(length) if length >= 60.0 else f"{length:.2g} s"
            text = f"{disturbance.kind}{f' on {name}' if name else ''}: {excluded} excluded"
            size = disturbance.size
            self.add(DetectedEvent("disturbance", text, start, channel=name, length_s=length, size=size))
        for elapsed_s, warmup in ended.warmups:
            text = f"a warm-up of {duration(warmup)} is over and excluded"
            self.add(DetectedEvent("warmup", text, elapsed_s, length_s=warmup))
        for place, at_rest in rest:
            text = "at rest again" if at_rest else "not at rest: samples are excluded"
            self.add(DetectedEvent("rest" if at_rest else "motion", text, place * self._interval_s))
        for place, hangs in stuck:
            begins = "the values do not change: an axis or the whole sensor hangs"
            text, level = (begins, None) if hangs else ("the values change again", NOTICE)
            self.add(DetectedEvent("stuck", text, place * self._interval_s, level=level))
        for elapsed_s, changes in ended.hours:
            self._update_changes(
                self._changes_between_hours, changes_by_column(changes, HOURS_BEFORE), elapsed_s
            )

    def update_warmup(self, elapsed_s: float, excluded_s: float, warming_up: bool, *, heats_up: bool) -> None:
        """Add, once, the end of a warm-up of which nothing is excluded; else `update_happened` adds it.

        The temperature begins it: means that seem to settle for a while are no event. A temperature that rests for a
        while in the first half hour does not end it.

        Parameters
        ----------
        elapsed_s, excluded_s : length of the record, and of the warm-up that is excluded of it.
        """
        # A mean may rest in the first minutes and move again: before half an hour no sensor counts as warm.
        over = self._warming_up and not warming_up and elapsed_s >= WARM_S
        self._warming_up = (self._warming_up and not over) or (warming_up and heats_up)
        if over and not self._warmup_reported and not excluded_s:
            self._warmup_reported = True
            text = "the warm-up is over: the numbers do not show it, and all samples count"
            self.add(DetectedEvent("warmup", text, elapsed_s))

    def update_steps(self, steps: Ints, span: int) -> None:
        """Add the gaps, and the resets of the clock, before samples that the record has just received.

        Parameters
        ----------
        steps : (n,) grid steps since the sample before.
        span : ticks of the grid at the end of these samples.
        """
        if self._gaps or (steps != 1).any():
            self._update_clock(steps, span)
            self._update_gaps(steps, span)

    def _update_clock(self, steps: Ints, span: int) -> None:
        """Add gaps of unknown length; after an event, those in the next `GAP_EVENT_S` are only counted."""
        breaks = steps == BREAK
        if not breaks.any():
            return
        places = span - np.cumsum(np.where(breaks, 1, steps)[::-1])[::-1]
        for elapsed_s in (places[breaks] * self._interval_s).tolist():
            if elapsed_s >= self._next_reset_s:
                self._next_reset_s = elapsed_s + GAP_EVENT_S
                text = "a gap of unknown length: the sensor or its clock restarted, or the connection was interrupted"
                self.add(DetectedEvent("restart", text, elapsed_s, code="clock_reset"))

    def _update_gaps(self, steps: Ints, span: int) -> None:
        """Add gaps: the first one is an event at its end, those in the next `GAP_EVENT_S` are one event together."""
        ticks = np.where(steps == BREAK, 1, steps)  # `_update_clock` reports a gap of unknown length
        rows = np.flatnonzero(ticks > 1)  # the first sample after a gap each
        missing = ticks[rows] - 1
        # The record has the samples already: count back from its end. A gap is placed at its last missing tick.
        places = span - int(ticks.sum()) + np.cumsum(ticks)[rows] - 1
        times = places * self._interval_s
        first = 0
        # Each pass closes one interval without events: the gaps in it are one event at its end, and the first gap
        # after it begins the next. Blocks of any length give the same events.
        while True:
            last = int(np.searchsorted(times, self._next_gap_s))
            self._gaps += last - first
            self._missing += int(missing[first:last].sum())
            first = last
            if self._gaps:
                if span * self._interval_s < self._next_gap_s:
                    return
                self.report_gaps(self._next_gap_s)
            elif first < len(times):
                self._next_gap_s = float(times[first]) + self._interval_s
            else:
                return

    def report_gaps(self, elapsed_s: float) -> None:
        """Add the gaps that wait, if there are any, as one event."""
        if not self._gaps:
            return
        length = self._missing * self._interval_s
        plural = "gap" if self._gaps == 1 else f"{self._gaps} gaps"
        text = f"{plural}: {counted(self._missing, 'sample')} missing ({length:.4g} s)"
        self.add(DetectedEvent("gap", text, elapsed_s, length_s=length))
        self._gaps, self._missing, self._next_gap_s = 0, 0, elapsed_s + GAP_EVENT_S

    def update_constant(self, names: Iterable[str], elapsed_s: float) -> None:
        """Add channels that never change, and those that change after all."""
        now = set(names)
        for name in sorted(now - self._constant):
            text = f"{name} never changed: dead, stuck or not measured"
            self.add(DetectedEvent("constant", text, elapsed_s, channel=name))
        for name in sorted(self._constant - now):
            text = f"{name} changes now"
            self.add(DetectedEvent("constant", text, elapsed_s, channel=name, level=NOTICE))
        self._constant = now

    def update_loss(self, share: float, limit: float, elapsed_s: float, *, ends: bool = True) -> None:
        """Add that the loss of the last minute exceeds its limit, or, if the alarm can end now, does so no more."""
        # RECOVERED is below 1: a share that stays near the limit would raise and end the alarm in turns.
        if not self._lossy and share > limit:
            self._lossy = True
            self.add(DetectedEvent("loss", loss_text(share), elapsed_s))
        elif ends and self._lossy and share <= RECOVERED * limit:
            self._lossy = False
            text = f"the alarm is over: {loss_text(share)}"
            self.add(DetectedEvent("loss", text, elapsed_s, level=NOTICE))

    def update_changes(self, changes: Mapping[int, tuple[Change, ...]], elapsed_s: float) -> None:
        """Add changes that are new and those that are over, other than those between hours.

        Parameters
        ----------
        changes : by column, all that hold now.
        """
        self._update_changes(self._other_changes, changes, elapsed_s)

    def _update_changes(
        self,
        reported: dict[tuple[int, str, str], float],
        changes: Mapping[int, tuple[Change, ...]],
        elapsed_s: float,
    ) -> None:
        """Add what differs between the changes that hold now and those of the same kind that were reported."""
        current: dict[tuple[int, str, str], str] = {
            (column, change.against, change.quantity): change_text(self._channels[column], change)
            for column, of_channel in changes.items()
            for change in of_channel
        }
        for key, text in current.items():
            if key not in reported:
                self.add(DetectedEvent("change", text, elapsed_s, channel=self._channels[key[0]]))
            reported[key] = elapsed_s
        for key, seen in list(reported.items()):
            if not seen <= elapsed_s < seen + CHANGE_HOLD_S:
                del reported[key]  # of a longer record before, or over
                if elapsed_s > seen:
                    column, against, quantity = key
                    name = self._channels[column]
                    text = f"{name}: {quantity} does not differ from the {against} any more"
                    self.add(DetectedEvent("change", text, elapsed_s, channel=name, level=NOTICE))

    def update_grades(self, grades: Mapping[str, SensorGrade], elapsed_s: float) -> None:
        """Add a headline grade that differs from the reported one and has held for `GRADE_HOLD`."""
        for sensor, grade in grades.items():
            before = self._grades.get(sensor, SensorGrade())
            # A grade that returns before another one has held is no event: forget the other.
            if sensor in self._grades and grade.meets == before.meets:
                self._candidates.pop(sensor, None)
                continue
            candidate, since = self._candidates.get(sensor, (grade, elapsed_s))
            if candidate.meets != grade.meets or elapsed_s < since:  # a shorter record is another one
                since = elapsed_s
            self._candidates[sensor] = (grade, since)
            if sensor not in self._grades or elapsed_s >= since * GRADE_HOLD:
                self._grades[sensor] = grade
                # A restored record has reported its grades before the restart.
                if not self._first_grades_known:
                    was = f" (before: {grade_text(before)})" if before.meets else ""
                    self.add(DetectedEvent("grade", f"{sensor}: {grade_text(grade)}{was}", elapsed_s))
        self._first_grades_known &= not grades
