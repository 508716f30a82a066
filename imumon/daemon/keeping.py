"""Keeping: the record's state taken up at the start, saved on the way, set aside where it does not fit.

A state belongs to one sensor (serial number), one stream and one set of the registers that change the
data. One of another is never mixed in and never overwritten: it is set aside under a name that says why.
Beside it, as long as the sensor's own settings are changed, lies what they were: a daemon that was
killed leaves that file behind, and the next one puts the sensor back in order at its end.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from imumon import __version__
from imumon.checkpoint import Checkpoint, State
from imumon.monitor import Monitor
from imumon.report import Session, stamp
from imumon.sensors.vn100.session import Facts
from imumon.sensors.vn100.session import Session as Sensor

COUNTERS = ("discarded_bytes", "bad_checksums", "received_bytes", "overruns", "restarts")
DATA_REGISTERS = ("23", "25", "26", "35", "44", "82", "84", "85")


class Run(Protocol):
    """What of the task matters here."""

    @property
    def fresh(self) -> bool: ...
    @property
    def speed(self) -> float: ...


class Keeping:
    """State of one device on disk.

    Attributes
    ----------
    said : what had to be decided at the start, in words.
    started : when the record began, None for a new one.
    """

    def __init__(self, directory: Path, device: str, facts: Facts, monitor: Monitor, run: Run) -> None:
        self._checkpoint = Checkpoint(directory, device)
        self._found = directory / f"{device}.found.json"
        self._monitor = monitor
        self._serial = facts.serial
        self._speed = run.speed
        self._before = Session()
        self._complained: str | None = None
        self.started: str | None = None
        if run.fresh:
            self.said = []
            if self._checkpoint.path.exists():
                self.said.append(f"started anew; the old state is {self._checkpoint.set_aside('old').name}")
            return
        state, self.said = self._checkpoint.load()
        if state is not None:
            self._take_up(state)

    def _take_up(self, state: State) -> None:
        meta = state.meta
        if meta.get("serial") != self._serial:
            self._refuse("other-sensor", f"of another sensor, {meta.get('serial')}")
            return
        try:
            away = (datetime.now(UTC) - datetime.fromisoformat(meta["saved"])).total_seconds()
            self._monitor.resume(meta["monitor"], state.arrays, max(0.0, away) * self._speed)
        except (KeyError, ValueError, TypeError, AssertionError):
            self._refuse("unreadable", f"of imumon {meta.get('version')} and cannot be read by {__version__}")
            return
        self.started = meta.get("started")
        counted: dict[str, Any] = {name: int(meta["session"].get(name, 0)) for name in COUNTERS}
        counted["restarts"] += 1
        self._before = Session(**counted)
        self.said.append(f"the record of {meta['saved']} goes on")

    def _refuse(self, name: str, why: str) -> None:
        self.said.append(f"the state is {why}: kept as {self._checkpoint.set_aside(name).name}, begun anew")

    def remember(self, sensor: Sensor) -> None:
        """Note the sensor's own settings before they are changed."""
        saved = None
        with suppress(OSError, ValueError):
            saved = json.loads(self._found.read_text())
        found = sensor.remember(saved)
        with suppress(OSError):
            self._found.write_text(json.dumps(found))

    def forget(self) -> None:
        """The sensor has its settings back."""
        self._found.unlink(missing_ok=True)

    def added_up(self, session: Session) -> Session:
        """Counters with those of the runs before."""
        sums = {name: getattr(session, name) + getattr(self._before, name) for name in COUNTERS}
        return replace(session, **sums)

    def save(self, session: Session, started: str | None) -> None:
        """Hand the state over to be written."""
        if (why := self._monitor.refused) is not None:
            self._monitor.refused = None
            self._before = Session()
            self._refuse("other-stream", why)
        self._checkpoint.save(self._state(session, started))

    def close(self, session: Session, started: str | None) -> None:
        """Write the last state and wait for the disk."""
        state = self._state(session, started) if self._monitor.samples else None
        self._checkpoint.close(state)

    def complaint(self) -> str | None:
        """Why the last save failed, once per change."""
        if self._checkpoint.failed == self._complained:
            return None
        self._complained = self._checkpoint.failed
        return f"the state cannot be saved: {self._complained}" if self._complained else None

    def _state(self, session: Session, started: str | None) -> State:
        meta, arrays = self._monitor.save()
        whole: dict[str, Any] = {
            "version": __version__,
            "serial": self._serial,
            "started": started,
            "saved": stamp(datetime.now(UTC)),
            "session": {name: getattr(session, name) for name in COUNTERS},
            "monitor": meta,
        }
        return State(whole, dict(arrays))
