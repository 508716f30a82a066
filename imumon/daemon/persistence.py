"""Persistence: the record is restored at the start, saved regularly, and set aside where it does not fit.

A state belongs to one sensor (serial number), one stream and one set of the settings that change the data. A
state of another one is never mixed in and never overwritten: it is renamed, and its new name says why.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from imumon import __version__
from imumon.checkpoint import Checkpoint, SavedState, encode
from imumon.pipeline import Monitor, RecordMismatch
from imumon.report import DeviceDescription, SessionCounters, plain, stamp, to_json
from imumon.samples import DeviceInfo, Level, SampleBlock

COUNTERS = ("discarded_bytes", "bad_checksums", "received_bytes", "overruns", "restarts")
TRIAL_SAMPLES = 2000
"""Samples with which a saved record is tried out before it continues."""
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class Persistence:
    """State of one device on disk.

    Parameters
    ----------
    directory : of the states; created if needed.
    device : name of the device.
    monitor : holds the record.
    fresh : start a new record; the old state is kept under another name.
    speed : seconds of the sample clock per second of the host clock.

    Attributes
    ----------
    started : when the record began; None for a new one.
    fed_s : `uptime_s` of the last samples, from which a gap is counted; None before the first.

    Raises
    ------
    StateError : another daemon uses the state of this device.
    """

    def __init__(
        self, directory: Path, device: str, monitor: Monitor, *, fresh: bool = False, speed: float = 1.0
    ) -> None:
        self._checkpoint = Checkpoint(directory, device)
        self._monitor = monitor
        self._fresh, self._speed = fresh, speed
        self._serial: str | None = None
        self._settings: dict[str, str] = {}
        self._device: dict[str, Any] = {}
        self._before = SessionCounters()
        self._reported_problem: str | None = None
        self.started: str | None = None
        self.fed_s: float | None = None

    @property
    def failed(self) -> str | None:
        """Why the last save failed, with the cure; None if it did not."""
        return self._checkpoint.failed

    @property
    def path(self) -> Path | None:
        """File of the state; None if the last save failed."""
        return None if self._checkpoint.failed else self._checkpoint.path

    def restore(self, info: DeviceInfo) -> list[tuple[str, Level]]:
        """Let the monitor continue the saved record, if it is one of this sensor with these settings.

        Returns
        -------
        What was decided, with the log level.
        """
        self._serial, self._settings, self._device = (
            info.serial,
            data_settings(info),
            _saved_description(info),
        )
        if self._fresh:
            if not self._checkpoint.exists:
                return []
            return [(f"new record; the old state is {self._checkpoint.set_aside('old').name}", "info")]
        state, problems = self._checkpoint.load()
        decisions: list[tuple[str, Level]] = [(text, "warning") for text in problems]
        if state is not None:
            text = self._restore(state)
            decisions.append((text, "warning" if self.started is None else "info"))
        return decisions

    def _restore(self, state: SavedState) -> str:
        meta = state.meta
        if meta.get("serial") != self._serial:
            return self._set_aside("other-sensor", f"of another sensor, {_quoted(meta.get('serial'))}")
        try:
            if changed := differing(meta["settings"], self._settings):
                return self._set_aside("other-settings", f"of other settings, {plain('; '.join(changed))}")
            counted: dict[str, Any] = {name: _count(meta["session"][name]) for name in COUNTERS}
            started, saved = (_time(meta[name]) for name in ("started", "saved"))
            away_s = max(0.0, _since(meta) + float(meta["age_s"])) * self._speed
            self._try_out(state, away_s)
            self._monitor.restore(meta["monitor"], state.arrays, away_s)
        except RecordMismatch as error:
            return self._set_aside("other-settings", plain(error.message))
        except Exception:  # a file may be forged: whatever it breaks, the daemon starts
            version = _quoted(meta.get("version"))
            return self._set_aside("unreadable", f"of imumon {version} and cannot be read by {__version__}")
        self.started = started
        counted["restarts"] += 1
        self._before = SessionCounters(**counted)
        return f"the record that began {self.started} continues, saved {saved}"

    def _try_out(self, state: SavedState, away_s: float) -> None:
        """Continue a copy of a record, report and save it; raise the error that the record causes later."""
        interval_ns = float(state.meta["monitor"]["clock"]["interval_s"]) * 1e9
        trial = Monitor(self._monitor.options, rate_hz=1e9 / interval_ns)
        arrays = {name: array.copy() for name, array in state.arrays.items()}
        trial.restore(state.meta["monitor"], arrays, away_s)
        trial.accept_restored()
        if trial.stream is None or any(a.ndim != 1 for name, a in arrays.items() if name.endswith("groups")):
            raise ValueError("the record has no stream, or no channels")
        trial.save()  # before samples replace what they can
        steps = np.ones(TRIAL_SAMPLES) if trial.stream.clock == "dt" else np.arange(TRIAL_SAMPLES)
        times, lost = (steps * interval_ns).astype(np.int64), np.zeros(TRIAL_SAMPLES, dtype=np.int64)
        values = np.random.default_rng(0).normal(0.0, 1e-3, (TRIAL_SAMPLES, len(trial.stream.channels)))
        with np.errstate(all="ignore"):
            for k in np.array_split(np.arange(TRIAL_SAMPLES), 7):
                trial.feed(SampleBlock(trial.stream, values[k], times[k], lost[k]))
            trial.flush()
            device = DeviceDescription(id="trial")
            to_json(trial.report(datetime.now(UTC), device, "running", SessionCounters()))
            saved_meta, saved_arrays = trial.save()
            encode(SavedState(saved_meta, dict(saved_arrays)))

    def _set_aside(self, name: str, why: str) -> str:
        self.started, self._before = None, SessionCounters()
        if not self._checkpoint.exists:  # it was never saved
            return f"the record is {why}: a new record starts"
        return f"the state is {why}: kept as {self._checkpoint.set_aside(name).name}, a new record starts"

    def set_aside_rejected(self, mismatch: RecordMismatch) -> str:
        """Set aside a record that the stream does not continue; return what was done."""
        return self._set_aside("other-stream", mismatch.message)

    def differing(self, info: DeviceInfo) -> list[str]:
        """Return the settings that differ from those of the record, as text."""
        return differing(self._settings, data_settings(info))

    def start_new_record(self, info: DeviceInfo, monitor: Monitor, session: SessionCounters) -> str:
        """Set the record aside as it is and start another one; return what was done."""
        self.save(session)
        self._checkpoint.flush()
        changed = "; ".join(self.differing(info))
        self._monitor, self._settings, self._device = monitor, data_settings(info), _saved_description(info)
        return self._set_aside("other-settings", f"of other settings, {changed}")

    def with_earlier_runs(self, session: SessionCounters) -> SessionCounters:
        """Return the counters with those of earlier runs added."""
        sums = {name: getattr(session, name) + getattr(self._before, name) for name in COUNTERS}
        return replace(session, **sums)

    def save(self, session: SessionCounters) -> None:
        """Hand the state over to be written."""
        self._checkpoint.save(self._state(session))

    def close(self, session: SessionCounters) -> None:
        """Write the last state and wait for the disk."""
        state = self._state(session) if self._monitor.samples else None
        self._checkpoint.close(state)

    def problem(self) -> tuple[str, Level] | None:
        """Return why the last save failed, or that saving works again: once per change."""
        if self._checkpoint.failed == self._reported_problem:
            return None
        self._reported_problem = self._checkpoint.failed
        if self._reported_problem is None:
            return "the state is saved again", "notice"
        return f"the state cannot be saved: {self._reported_problem}", "error"

    def _state(self, session: SessionCounters) -> SavedState:
        meta, arrays = self._monitor.save()
        whole: dict[str, Any] = {
            "version": __version__,
            "serial": self._serial,
            "settings": self._settings,
            "device": self._device,
            "started": session.started,
            "saved": stamp(datetime.now(UTC)),
            "boot": _boot_id(),
            "uptime_s": uptime_s(),
            "age_s": uptime_s() - self.fed_s if self.fed_s is not None else 0.0,
            "session": {name: getattr(session, name) for name in COUNTERS},
            "monitor": meta,
        }
        return SavedState(whole, dict(arrays))


def data_settings(info: DeviceInfo) -> dict[str, str]:
    """Return the settings that change the data, as far as they are known."""
    return {name: info.settings[name] for name in info.data_settings if name in info.settings}


def _saved_description(info: DeviceInfo) -> dict[str, Any]:
    """Return what the saved state holds of the device, for a report that is made from it alone."""
    names = ("driver", "model", "serial", "firmware", "port", "baud", "alias_factor")
    return {name: getattr(info, name) for name in names} | {"caveats": list(info.caveats)}


def differing(one: Mapping[str, str], other: Mapping[str, str]) -> list[str]:
    """Return the settings that both know and that differ, as text.

    >>> differing({"85 IMU filtering": "0"}, {"85 IMU filtering": "4", "23 magnetometer": "1"})
    ['85 IMU filtering 0, now 4']
    """
    return [f"{k} {one[k]}, now {other[k]}" for k in one if k in other and one[k] != other[k]]


def _quoted(value: Any) -> str:
    """Return a value of a state for a message."""
    return plain(str(value))[:40]


def _count(value: Any) -> int:
    """Return a counter of a state; raise ValueError if it is none."""
    if type(value) is not int or not 0 <= value < 1 << 62:
        raise ValueError("not a counter")
    return value


def _time(value: Any) -> str | None:
    """Return a time of a state; raise ValueError if it is none."""
    return None if value is None else stamp(datetime.fromisoformat(value))


def _boot_id() -> str | None:
    """Return the id of this boot of the machine; None if it is hidden."""
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return None


def uptime_s() -> float:
    """Return the seconds since the boot, including sleep if the system counts it (Linux does)."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


def _since(meta: Mapping[str, Any]) -> float:
    """Return the seconds since a state was saved: by the uptime, or by the calendar after a reboot."""
    if meta.get("boot") is not None and meta["boot"] == _boot_id():
        return uptime_s() - float(meta["uptime_s"])
    return (datetime.now(UTC) - datetime.fromisoformat(meta["saved"])).total_seconds()
