"""Persistence: the record is restored at the start, saved regularly, and set aside where it does not fit.

A state belongs to one sensor (serial number), one stream and one set of the settings that change the data. A
state of another one is never mixed in and never overwritten: it is renamed, and its new name says why.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

from imumon import __version__
from imumon.checkpoint import (
    Checkpoint,
    SavedState,
    StateHeader,
)
from imumon.model.ledger import merged
from imumon.model.report import SessionCounters, stamp
from imumon.model.report_json import plain
from imumon.model.samples import DeviceInfo, Level
from imumon.model.saved_state import pack
from imumon.record import Record, RecordMismatch
from imumon.sources.clock import HostClock

COUNTERS = ("discarded_bytes", "bad_checksums", "received_bytes", "overruns", "restarts")
"""Counters of the link that continue in the next run."""
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class Persistence:
    """State of one device on disk.

    Parameters
    ----------
    directory : of the states; created if needed.
    device : name of the device.
    record : of the device.
    clock : of the host.
    fresh : start a new record; the old state is kept under another name.

    Attributes
    ----------
    started : when the record began; None for a new one.

    Raises
    ------
    StateError : another daemon uses the state of this device.
    """

    def __init__(
        self, directory: Path, device: str, record: Record, clock: HostClock, *, fresh: bool = False
    ) -> None:
        self._checkpoint = Checkpoint(directory, device)
        self._record = record
        self._clock, self._fresh = clock, fresh
        self._device: DeviceInfo | None = None
        self._settings: dict[str, str] = {}  # of the record
        self._before = SessionCounters()
        self._reported_problem: str | None = None
        self._reported_again = 0
        self.started: str | None = None

    @property
    def failed(self) -> str | None:
        """Why the last save failed, with the cure; None if it did not."""
        return self._checkpoint.failed

    @property
    def path(self) -> Path | None:
        """File of the state; None if the last save failed."""
        return None if self._checkpoint.failed else self._checkpoint.path

    def restore(self, info: DeviceInfo) -> list[tuple[str, Level]]:
        """Let the record continue the saved one, if it is one of this sensor with these settings.

        Returns
        -------
        What was decided, with the log level.
        """
        self._device, self._settings = info, data_settings(info)
        if self._fresh:
            if not self._checkpoint.exists:
                return []
            return [(f"new record; the old state is {self._checkpoint.set_aside('old').name}", "info")]
        state, problems = self._checkpoint.load()
        decisions: list[tuple[str, Level]] = [(text, "warning") for text in problems]
        if isinstance(state, SavedState):  # a state of `imumon.Live` has another name
            text = self._restore(state, info)
            decisions.append((text, "warning" if self.started is None else "info"))
        return decisions

    def _restore(self, state: SavedState, info: DeviceInfo) -> str:
        header = state.header
        try:
            if (serial := header.device.serial) != info.serial:
                return self._set_aside("other-sensor", f"of another sensor, {_quoted(serial)}")
            if changed := differing(header.settings, self._settings):
                return self._set_aside("other-settings", f"of other settings, {plain('; '.join(changed))}")
            away_s = self._clock.to_sample_s(max(0.0, _since(header, self._clock) + header.age_s))
            self._record.restore(state.record, away_s)
        except RecordMismatch as error:
            return self._set_aside("other-settings", plain(error.message))
        began = header.session.started
        self.started = None if began is None else _stamped(began)
        self._before = replace(header.session, restarts=header.session.restarts + 1)
        return f"the record that began {self.started} continues, saved {_stamped(header.saved)}"

    def _set_aside(self, name: str, why: str) -> str:
        self.started, self._before = None, SessionCounters()
        if not self._checkpoint.exists:  # it was never saved
            return f"the record is {why}: a new record starts"
        return f"the state is {why}: kept as {self._checkpoint.set_aside(name).name}, a new record starts"

    def set_aside_rejected(self, mismatch: RecordMismatch) -> str:
        """Set aside a record that the stream does not continue; return what was done."""
        return self._set_aside("other-stream", mismatch.message)

    def describe(self, info: DeviceInfo) -> None:
        """Keep what is known of the device now: a caveat may show when samples arrive."""
        self._device = info

    def differing(self, info: DeviceInfo) -> list[str]:
        """Return the settings that differ from those of the record, as text."""
        return differing(self._settings, data_settings(info))

    def start_new_record(self, info: DeviceInfo, session: SessionCounters, fed_s: float | None) -> str:
        """Set the record aside as it is and start another one; return what was done."""
        self.save(session, fed_s)
        self._checkpoint.flush()
        changed = "; ".join(self.differing(info))
        self._settings, self._device = data_settings(info), info
        return self._set_aside("other-settings", f"of other settings, {changed}")

    def with_earlier_runs(self, session: SessionCounters) -> SessionCounters:
        """Return the counters with those of earlier runs added."""
        sums = {name: getattr(session, name) + getattr(self._before, name) for name in COUNTERS}
        return replace(session, **sums, ledger=merged(session.ledger, self._before.ledger))

    def save(
        self, session: SessionCounters, fed_s: float | None, before: Callable[[], None] | None = None
    ) -> None:
        """Hand the state over to be written.

        Parameters
        ----------
        session : counters of the record.
        fed_s : s, `HostClock.uptime_s` of the last samples, from which a gap is counted; None before the first.
        before : returns when the history that belongs to the state is written.
        """
        self._checkpoint.save(self._state(session, fed_s), before)

    def close(
        self, session: SessionCounters, fed_s: float | None, before: Callable[[], None] | None = None
    ) -> None:
        """Write the last state and wait for the disk; the parameters are those of `save`."""
        state = self._state(session, fed_s) if self._record.samples else None
        self._checkpoint.close(state, before)

    def problems(self) -> Iterator[tuple[str, Level]]:
        """Yield what is new: that a removed state was made again, why the last save failed, that saving works again.

        Each is said once, though the reason of a failure may change meanwhile.
        """
        made_again, failed = self._checkpoint.made_again, self._checkpoint.failed
        if made_again != self._reported_again:
            self._reported_again = made_again
            yield f"the state in {self._checkpoint.path.parent} was removed: it is written again", "warning"
        if (failed is None) != (self._reported_problem is None):
            self._reported_problem = failed
            if failed is None:
                yield "the state is saved again", "notice"
            else:
                yield f"the state cannot be saved: {failed}", "error"

    def _state(self, session: SessionCounters, fed_s: float | None) -> bytes:
        assert self._device is not None
        header = StateHeader(
            version=__version__,
            settings=self._settings,
            device=self._device,
            saved=stamp(self._clock.now()),
            boot=_boot_id(),
            uptime_s=self._clock.uptime_s(),
            age_s=self._clock.uptime_s() - fed_s if fed_s is not None else 0.0,
            # what is counted of one run does not continue in the next one
            session=replace(session, kernel_overruns=None, most_queued_bytes=None),
        )
        return pack(SavedState(header, self._record.save()))


def data_settings(info: DeviceInfo) -> dict[str, str]:
    """Return the settings that change the data, as far as they are known."""
    return {name: info.settings[name] for name in info.data_settings if name in info.settings}


def differing(one: Mapping[str, str], other: Mapping[str, str]) -> list[str]:
    """Return the settings that both know and that differ, as text.

    >>> differing({"85 IMU filtering": "0"}, {"85 IMU filtering": "4", "23 magnetometer": "1"})
    ['85 IMU filtering 0, now 4']
    """
    return [f"{k} {one[k]}, now {other[k]}" for k in one if k in other and one[k] != other[k]]


def _quoted(value: Any) -> str:
    """Return a value of a state for a message."""
    return plain(str(value))[:40]


def _stamped(time: str) -> str:
    """Return a time of a state in the form of a report."""
    return stamp(datetime.fromisoformat(time))


@cache
def _boot_id() -> str | None:
    """Return the id of this boot of the machine; None if it is hidden. It is read once: each save needs it."""
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return None


def _since(header: StateHeader, clock: HostClock) -> float:
    """Return the seconds since a state was saved: by the uptime, or by the calendar after a reboot."""
    if header.boot is not None and header.boot == _boot_id():
        return clock.uptime_s() - header.uptime_s
    return (clock.now() - datetime.fromisoformat(header.saved)).total_seconds()
