"""Keeping: the record's state taken up at the start, saved on the way, set aside where it does not fit.

A state belongs to one sensor (serial number), one stream and one set of the registers that change the
data. One of another is never mixed in and never overwritten: it is set aside under a name that says why.
Beside it, as long as the sensor's own settings are changed, lies what they were: a daemon that was
killed leaves that file behind, and the next one puts the sensor back in order at its end.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from imumon import __version__
from imumon.checkpoint import Checkpoint, SavedState
from imumon.daemon.log import Level
from imumon.daemon.metadata import kept
from imumon.devices.vn100.vn100_session import Vn100Info
from imumon.devices.vn100.vn100_session import Vn100Session as Sensor
from imumon.pipeline import Monitor, RecordMismatch
from imumon.report import SessionCounters, stamp

COUNTERS = ("discarded_bytes", "bad_checksums", "received_bytes", "overruns", "restarts")
DATA_REGISTERS = ("23", "25", "26", "35", "43", "44", "82", "84", "85")
"""Registers, by number, that change what the samples mean. The outputs are not among them: they make
another stream, which the monitor sees by itself."""
_BOOT = Path("/proc/sys/kernel/random/boot_id")


class Run(Protocol):
    """What of the task matters here."""

    @property
    def fresh(self) -> bool: ...
    @property
    def speed(self) -> float: ...


class Persistence:
    """State of one device on disk.

    Parameters
    ----------
    directory : where the states live; made if it is not there.
    device : name of the device.
    identity : name of the sensor itself, whatever the device is called.

    Attributes
    ----------
    started : when the record began, None for a new one.
    fed_s : `uptime_s` of the last samples, from which a hole is counted; None before the first.

    Raises
    ------
    StateError : another daemon holds this device's state.
    """

    def __init__(self, directory: Path, device: str, identity: str, monitor: Monitor, run: Run) -> None:
        self._checkpoint = Checkpoint(directory, device)
        self._found = directory / f"{identity}.found.json"
        self._noted = False
        self._monitor = monitor
        self._run = run
        self._serial: str | None = None
        self._settings: dict[str, str] = {}
        self._device: dict[str, Any] = {}
        self._before = SessionCounters()
        self._complained: str | None = None
        self.started: str | None = None
        self.fed_s: float | None = None

    def take_up(self, facts: Vn100Info) -> list[tuple[str, Level]]:
        """Have the monitor go on with the kept record, if it is one of this sensor as it is set now.

        Returns
        -------
        What had to be decided, in words and by weight: that a record goes on is no warning.
        """
        self._serial, self._settings, self._device = facts.serial, data_settings(facts), kept(facts)
        if self._run.fresh:
            if not self._checkpoint.there:
                return []
            return [(f"started anew; the old state is {self._checkpoint.set_aside('old').name}", "info")]
        state, complaints = self._checkpoint.load()
        said: list[tuple[str, Level]] = [(text, "warning") for text in complaints]
        if state is not None:
            text = self._take_up(state)
            said.append((text, "warning" if self.started is None else "info"))
        return said

    def _take_up(self, state: SavedState) -> str:
        meta = state.meta
        if meta.get("serial") != self._serial:
            return self._refuse("other-sensor", f"of another sensor, {meta.get('serial')}")
        if changed := differing(meta.get("settings", {}), self._settings):
            return self._refuse("other-settings", f"of other settings, {'; '.join(changed)}")
        try:
            counted: dict[str, Any] = {name: int(meta["session"].get(name, 0)) for name in COUNTERS}
            away, saved = _since(meta) + float(meta.get("age_s", 0.0)), meta["saved"]
            self._monitor.restore(meta["monitor"], state.arrays, max(0.0, away) * self._run.speed)
        except RecordMismatch as error:
            return self._refuse("other-settings", error.message)
        except (KeyError, ValueError, TypeError, AttributeError, IndexError, AssertionError):
            return self._refuse(
                "unreadable", f"of imumon {meta.get('version')} and cannot be read by {__version__}"
            )
        self.started = meta.get("started")
        counted["restarts"] += 1
        self._before = SessionCounters(**counted)
        return f"the record begun {self.started} goes on, saved {saved}"

    def _refuse(self, name: str, why: str) -> str:
        self.started, self._before = None, SessionCounters()
        if not self._checkpoint.there:  # it was never saved
            return f"the record is {why}: begun anew"
        return f"the state is {why}: kept as {self._checkpoint.set_aside(name).name}, begun anew"

    def refuse(self) -> str | None:
        """Set aside a record that the stream does not go on with, once that shows; in words."""
        mismatch, self._monitor.mismatch = self._monitor.mismatch, None
        return None if mismatch is None else self._refuse("other-stream", mismatch.message)

    def differing(self, facts: Vn100Info) -> list[str]:
        """Settings that are not what the record was made with, in words."""
        return differing(self._settings, data_settings(facts))

    def begin_anew(self, facts: Vn100Info, monitor: Monitor, session: SessionCounters) -> str:
        """Set the record aside as it is and keep another one; what was done, in words."""
        self.save(session, self.started)
        self._checkpoint.settle()
        changed = "; ".join(self.differing(facts))
        self._monitor, self._settings, self._device = monitor, data_settings(facts), kept(facts)
        return self._refuse("other-settings", f"of other settings, {changed}")

    def remember(self, sensor: Sensor) -> None:
        """Note the sensor's own settings before they are changed."""
        found = sensor.remember(noted(self._found))
        if found:  # nothing of a sensor that is only listened to: what an earlier run noted stays
            with suppress(OSError):
                new = self._found.with_suffix(".new")
                new.write_text(json.dumps(found))
                os.replace(new, self._found)
            self._noted = True

    def forget(self) -> None:
        """The sensor has its settings back."""
        if self._noted:
            with suppress(OSError):
                self._found.unlink(missing_ok=True)

    def added_up(self, session: SessionCounters) -> SessionCounters:
        """Counters with those of the runs before."""
        sums = {name: getattr(session, name) + getattr(self._before, name) for name in COUNTERS}
        return replace(session, **sums)

    def save(self, session: SessionCounters, started: str | None) -> None:
        """Hand the state over to be written."""
        self._checkpoint.save(self._state(session, started))

    def close(self, session: SessionCounters, started: str | None) -> None:
        """Write the last state and wait for the disk."""
        state = self._state(session, started) if self._monitor.samples else None
        self._checkpoint.close(state)

    def complaint(self) -> str | None:
        """Why the last save failed, or that they succeed again: once per change."""
        if self._checkpoint.failed == self._complained:
            return None
        self._complained = self._checkpoint.failed
        if self._complained is None:
            return "the state is saved again"
        return f"the state cannot be saved: {self._complained}"

    @property
    def level(self) -> Level:
        """Weight of the last complaint."""
        return "error" if self._complained else "info"

    def _state(self, session: SessionCounters, started: str | None) -> SavedState:
        meta, arrays = self._monitor.save()
        whole: dict[str, Any] = {
            "version": __version__,
            "serial": self._serial,
            "settings": self._settings,
            "device": self._device,
            "started": started,
            "saved": stamp(datetime.now(UTC)),
            "boot": _boot(),
            "uptime_s": uptime_s(),
            "age_s": uptime_s() - self.fed_s if self.fed_s is not None else 0.0,
            "session": {name: getattr(session, name) for name in COUNTERS},
            "monitor": meta,
        }
        return SavedState(whole, dict(arrays))


def noted(path: Path) -> dict[str, str] | None:
    """Settings that a killed run noted, None where there is no such note or none that can be read."""
    try:
        noted = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(noted, dict) or not all(isinstance(text, str) for text in noted.values()):
        return None
    return noted


def data_settings(facts: Vn100Info) -> dict[str, str]:
    """Registers of `DATA_REGISTERS` as far as they are known, ``"85 IMU filtering"`` to its text."""
    return {name: text for name, text in facts.settings.items() if name.split()[0] in DATA_REGISTERS}


def differing(one: Mapping[str, str], other: Mapping[str, str]) -> list[str]:
    """Registers that both know and that are not the same, in words.

    >>> differing({"85 IMU filtering": "0"}, {"85 IMU filtering": "4", "23 magnetometer": "1"})
    ['85 IMU filtering 0, now 4']
    """
    return [f"{k} {one[k]}, now {other[k]}" for k in one if k in other and one[k] != other[k]]


def _boot() -> str | None:
    """What names this boot of the machine, None where that is hidden."""
    try:
        return _BOOT.read_text().strip()
    except OSError:
        return None


def uptime_s() -> float:
    """Seconds since the machine was started, sleep included where the system counts it (Linux does)."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


def _since(meta: Mapping[str, Any]) -> float:
    """Seconds since a state was saved: by a clock that nobody sets, or by the calendar after a reboot."""
    if meta.get("boot") is not None and meta["boot"] == _boot():
        return uptime_s() - float(meta["uptime_s"])
    return (datetime.now(UTC) - datetime.fromisoformat(meta["saved"])).total_seconds()
