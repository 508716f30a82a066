"""History of one device, as a daemon keeps it: periods, events and power-ups, and the answers to questions.

A thread writes, so that a slow or full disk delays no sample. What cannot be written stays in memory, for two weeks
at most, and is written once there is room again; what is dropped after that is counted. Answers contain what is not
written yet and the periods in progress, and do not wait for the disk of the writer: each opens the file for itself.
"""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from imumon.files import lack_of_files
from imumon.history import selection
from imumon.history.day_changes import DAYS_KEPT, DayChanges
from imumon.history.power_ups import PowerUps
from imumon.history.rows import iso, json_pieces, rows
from imumon.history.selection import EVENTS, Selection, SelectionError
from imumon.history.store import (
    SUFFIX,
    HistoryError,
    HistoryStore,
    PowerUp,
    TimedPeriod,
    damaged,
    set_aside,
)
from imumon.model.errors import why
from imumon.model.history_report import STEPS, HistoryPeriod
from imumon.model.messages import change_text
from imumon.model.report import Event, Report
from imumon.model.samples import Level
from imumon.model.system_errors import OTHER_STATE, cure_of_writing
from imumon.model.units import DAY
from imumon.sources.clock import REAL_TIME, HostClock

MOST_PENDING = 2400
"""Periods that wait for the disk, two weeks of them, and events; then the oldest is dropped."""
MOST_ROWS = 20_000
"""Rows of one answer on the bus, 8 MB. More need a longer step."""
CLOSE_S = 3.0
"""s that the disk may take at the end."""
BARRIER_S = 3.0
"""s for which a state waits for the periods before it: a disk that hangs must not keep it from being saved."""

_Key = tuple[int, str, int]


class History:
    """What a daemon keeps of its reports.

    Parameters
    ----------
    directory : of the file; it is created if needed.
    device : name of the device.
    keep_days : days after which rows and events are deleted.
    clock : of the host.
    """

    def __init__(
        self, directory: Path, device: str, *, keep_days: float, clock: HostClock = REAL_TIME
    ) -> None:
        self.path = directory / f"{device}{SUFFIX}"
        self._device, self._keep_s, self._clock = device, 86400.0 * keep_days, clock
        self._changed = threading.Condition()
        self._pending: dict[_Key, TimedPeriod] = {}
        self._last: dict[int, HistoryPeriod] = {}  # newest of each length
        self._events: list[tuple[float, Event]] = []
        self._power_up: PowerUp | None = None  # to write
        self._dropped = 0
        self._closing = False
        self._asked = self._tried = 0  # how often a write was wanted, and how many of these have been tried
        self._failed: str | None = None
        self._reported: str | None = None
        self._notes: list[tuple[str, Level]] = []
        self._days = DayChanges(clock)
        self._reported_changes: set[tuple[str, str]] = set()  # channel and coefficient
        self._power_ups: PowerUps | None = None
        # s since the power-up of the sensor, and s since 1970 when that was
        self._sensor_clock: tuple[float, float] | None = None
        self._next_clean = 0.0
        self._thread = threading.Thread(target=self._run, name="history", daemon=True)
        self._thread.start()

    # ------------------------------------------------------------------ input

    def add(self, periods: Sequence[HistoryPeriod], record: str, now: float) -> None:
        """Keep periods, finished ones or in progress.

        Parameters
        ----------
        record : when the record began, as text.
        now : s since 1970, of the newest sample.
        """
        for period in periods:
            if self._last.get(period.step_s) is period:
                continue  # nothing new in the period in progress
            self._last[period.step_s] = period
            begin, end = (now - self._clock.to_host_s(age) for age in (period.begin_age_s, period.end_age_s))
            timed = TimedPeriod(record=record, begin=begin, end=end, period=period)
            self._settle(timed, now)
            with self._changed:
                self._pending[period.step_s, record, period.number] = timed
                self._asked += period.complete
                while len(self._pending) > MOST_PENDING:
                    del self._pending[next(iter(self._pending))]
                    self._dropped += 1
        with self._changed:
            self._changed.notify_all()

    def event(self, event: Event) -> None:
        """Keep an event."""
        when = datetime.fromisoformat(event.time).timestamp()
        with self._changed:
            self._events.append((when, event))
            if len(self._events) > MOST_PENDING:
                del self._events[0]
                self._dropped += 1

    def clock(self, clock_s: float, now: float) -> None:
        """Note the clock of the sensor, s since its power-up, at the time `now`, s since 1970."""
        self._sensor_clock = (clock_s, now)
        if self._power_ups is not None:
            self._power_ups.update(clock_s, now)
            self._power_up = self._power_ups.newest

    def barrier(self) -> Callable[[], None]:
        """Let the thread write what is new; return a function that waits until that is written, or cannot be.

        A state continues behind the periods that have ended: if it were written before them, a kill between both
        would lose them.
        """
        with self._changed:
            self._asked += 1
            number = self._asked
            self._changed.notify_all()

        def wait() -> None:
            with self._changed:
                self._changed.wait_for(lambda: self._tried >= number, BARRIER_S)

        return wait

    def problems(self) -> list[tuple[str, Level]]:
        """Return what is new: why nothing can be written, that it can be again, what was set aside."""
        with self._changed:
            notes, self._notes = self._notes, []
            # once, though the reason may change: SQLite has several for a full disk
            if (self._failed is None) != (self._reported is None):
                self._reported = self._failed
                if self._failed is None:
                    dropped = f"; {self._dropped:,} entries were dropped" if self._dropped else ""
                    notes.append((f"the history is written again{dropped}", "info"))
                    self._dropped = 0
                else:
                    notes.append((f"the history cannot be written: {self._failed}", "error"))
        return notes

    def new_changes(self) -> list[tuple[str, str]]:
        """Return the changes over days that are new: channel and text."""
        new = []
        for name, changes in self._days.changes.items():
            for change in changes:
                if (name, change.quantity) not in self._reported_changes:
                    self._reported_changes.add((name, change.quantity))
                    new.append((name, change_text(name, change)))
        return new

    def annotated(self, report: Report) -> Report:
        """Return a report with what the history shows: changes over days, and the turn-on bias."""
        changes, power_ups = self._days.changes, self._power_ups
        channels = {}
        for name, channel in report.channels.items():
            if of_days := changes.get(name):
                caveats = tuple(dict.fromkeys((*channel.caveats, "changed")))
                channel = replace(channel, changes=(*channel.changes, *of_days), caveats=caveats)
            channels[name] = channel
        report = replace(report, channels=channels)
        return report if power_ups is None else power_ups.annotated(report)

    def close(self) -> None:
        """Write what is new, and wait for the disk."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(CLOSE_S)

    def _settle(self, timed: TimedPeriod, now: float) -> None:
        """Take the settled bias of this power-up from an hour."""
        if self._power_ups is None or self._sensor_clock is None or timed.period.step_s != STEPS["1h"]:
            return
        clock_s, seen = self._sensor_clock
        begin_s = clock_s - timed.period.begin_age_s - self._clock.to_sample_s(seen - now)
        if self._power_ups.settle(timed, begin_s):
            self._power_up = self._power_ups.newest

    # ------------------------------------------------------------------ answers

    def answer(self, name: str, parameters: str) -> str:
        """Return the reply to a query for ``history`` or one of the keys below it, as JSON.

        Raises
        ------
        SelectionError, HistoryError : the query is not valid, or the file cannot be read.
        """
        now = self._clock.time_s()
        chosen = selection.of_parameters(parameters, now)
        if name == EVENTS:
            return "".join(json_pieces(self._known_events(chosen)))
        if name:
            raise SelectionError("unknown_history", f"no history is named {name[:40]!r}", f"ask for {EVENTS}")
        return "".join(json_pieces(self._rows(chosen)))

    def _rows(self, chosen: Selection) -> Iterator[dict[str, Any]]:
        with self._changed:
            pending = {key: timed for key, timed in self._pending.items() if key[0] == STEPS[chosen.step]}
        count = 0
        for timed in self._merged(chosen, pending):
            for row in rows(timed, self._device, chosen):
                if (count := count + 1) > MOST_ROWS:
                    message = f"these are more than {MOST_ROWS:,} rows"
                    raise SelectionError("too_many_rows", message, "ask for a longer step, or less time")
                yield row

    def _merged(self, chosen: Selection, pending: dict[_Key, TimedPeriod]) -> Iterator[TimedPeriod]:
        """Yield the periods of the file, and in their place those that are newer in memory."""
        with suppress(FileNotFoundError):
            try:
                with HistoryStore(self.path) as store:
                    for timed in store.periods(chosen):
                        yield pending.pop((timed.period.step_s, timed.record, timed.period.number), timed)
            except HistoryError as error:
                if error.code != "no_history" and not pending:
                    raise
        for timed in sorted(pending.values(), key=lambda timed: timed.begin):
            if timed.begin <= chosen.until and timed.end >= chosen.since:
                yield timed

    def _known_events(self, chosen: Selection) -> Iterator[dict[str, Any]]:
        try:
            with HistoryStore(self.path) as store:
                known = store.events(chosen.since, chosen.until)
        except HistoryError:
            known = []
        with self._changed:
            known += [
                {"time": when, "kind": event.kind, "channel": event.channel, "text": event.text, "count": 1}
                for when, event in self._events
                if chosen.since <= when <= chosen.until
            ]
        for event in known[-MOST_ROWS:]:
            yield {**event, "time": iso(event["time"])}

    # ------------------------------------------------------------------ the thread that writes

    def _run(self) -> None:
        while True:
            # before the write: what is added during it is written by the next
            closing, asked = self._closing, self._asked
            try:
                # opened for each write: a file that was removed or replaced meanwhile is no other case than none
                self.path.parent.mkdir(parents=True, exist_ok=True)
                with HistoryStore(self.path, write=True) as store:
                    if self._power_ups is None:
                        self._power_ups = self._known(store)
                    self._write(store)
                self._failed = None
            except HistoryError as error:  # damaged, or of another version
                self._set_aside(error)
                continue
            except sqlite3.DatabaseError as error:
                if not isinstance(error, sqlite3.OperationalError):
                    self._set_aside(damaged(self.path))
                    continue
                cause = lack_of_files() or error
                self._failed = f"{self.path.parent}: {why(cause)}: {cure_of_writing(cause, OTHER_STATE)}"
            except (OSError, MemoryError) as error:
                reason = getattr(error, "strerror", None) or "out of memory"
                self._failed = f"{self.path.parent}: {reason}: {cure_of_writing(error, OTHER_STATE)}"
            with self._changed:
                self._tried = asked
                self._changed.notify_all()
                if closing:
                    break
                self._changed.wait_for(lambda: self._asked > self._tried or self._closing)

    def _known(self, store: HistoryStore) -> PowerUps:
        """Check a file that was not opened before, judge its days, and return its power-ups."""
        store.check()
        self._load_days(store)
        known = PowerUps(store.power_ups(), real_time=self._clock.is_real_time)
        if self._sensor_clock is not None:
            known.update(*self._sensor_clock)
        return known

    def _load_days(self, store: HistoryStore) -> None:
        """Judge the days of the file; a change that has an event already is not reported again."""
        now = self._clock.time_s()
        wanted = Selection(since=now - 2 * DAYS_KEPT * DAY, until=now, step="1d")
        self._days.add(list(store.periods(wanted)))
        reported = {
            (event["channel"], when)
            for event in store.events(wanted.since, now)
            if event["kind"] == "change" and (when := event["time"])
        }
        for name, changes in self._days.changes.items():
            for change in changes:
                since = datetime.fromisoformat(change.since).timestamp() if change.since else now
                if any(channel == name and when >= since for channel, when in reported):
                    self._reported_changes.add((name, change.quantity))

    def _write(self, store: HistoryStore) -> None:
        """Write everything that is new; what cannot be written stays."""
        with self._changed:
            periods, events = dict(self._pending), list(self._events)
        store.add(list(periods.values()))
        self._days.add(list(periods.values()))
        with self._changed:
            for key, timed in periods.items():
                if self._pending.get(key) is timed:
                    del self._pending[key]
        store.add_events(events)
        with self._changed:
            written = set(map(id, (event for _, event in events)))
            self._events = [entry for entry in self._events if id(entry[1]) not in written]
        if (power_up := self._power_up) is not None:
            store.set_power_up(power_up)
        now = self._clock.time_s()
        if now >= self._next_clean:
            self._next_clean = now + DAY
            store.delete_before(now - self._keep_s)

    def _set_aside(self, error: HistoryError) -> None:
        reason = "other-version" if error.code == "history_version" else "damaged"
        try:
            aside = set_aside(self.path, reason)
        except OSError as failure:
            self._failed = f"{error.message}, and cannot be renamed: {failure.strerror}"
            time.sleep(1.0)
            return
        with self._changed:
            self._notes.append((f"{error.message}: kept as {aside.name}, a new history begins", "warning"))
