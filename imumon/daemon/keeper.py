"""Keeper: what keeps the record of the device beyond the run.

The state of the record is saved to disk, its periods go to the history, and the raw bytes to a recording, if the
settings want them. No block of samples passes through here: the daemon feeds the record itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from imumon.bus import Publisher
from imumon.config import Settings
from imumon.daemon.persistence import Persistence
from imumon.daemon.recorder import Recorder
from imumon.daemon.run_limits import RunOptions, Timer
from imumon.history.history import History
from imumon.model.ledger import RECEIVED, SAMPLES, merged
from imumon.model.report import Event, Report, SessionCounters, stamp
from imumon.model.samples import DeviceCounters, DeviceInfo, Level, SampleBlock
from imumon.record import Record, RecordMismatch

UNKEPT = ("gap",)
"""Kinds of events that are not kept: a lossy link has thousands, and the rows count what is missing."""


class Keeper:
    """Keeps one record after the other, of one device.

    Parameters
    ----------
    record : of the device.

    Attributes
    ----------
    started : when the record began; None before its first sample.
    recorder : of this device.
    history : of this device; None: none is kept, or the device has no name yet, which is that of the file.
    persistence : state on disk; None while no device has a name.
    newest : last block of samples, and the s since 1970 when it came; None: there was none.
    fed_s : s, `HostClock.uptime_s` of the last samples of the record, from which a gap is counted; None: none yet.
    """

    def __init__(self, settings: Settings, options: RunOptions, record: Record) -> None:
        self._options, self._clock, self._record = options, options.clock, record
        self.started: str | None = None
        self.recorder = Recorder(settings.record)
        self.history: History | None = None
        self._history_settings = settings.history
        self.persistence: Persistence | None = None
        self.newest: tuple[SampleBlock, float] | None = None
        self.fed_s: float | None = None
        self._save_timer = Timer(settings.state.save_period_s)

    # ------------------------------------------------------------------ life

    def open(self, name: str) -> None:
        """Claim the state of a device.

        Raises
        ------
        StateError : another daemon uses it.
        """
        directory, fresh = self._options.state_directory, self._options.fresh
        self.persistence = Persistence(directory, name, self._record, self._clock, fresh=fresh)

    def release(self) -> None:
        """Give up the state: the device went while it was started."""
        if self.persistence is not None:
            self.persistence.close(SessionCounters(), self.fed_s)
        self.persistence = None

    def begin(self, info: DeviceInfo, bus: Publisher) -> list[tuple[str, Level]]:
        """Continue the saved record, if there is one; return what was decided, with the log level."""
        assert self.persistence is not None
        decisions = self.persistence.restore(info)
        self.started = self.persistence.started
        if self._history_settings.enabled and self.history is None:
            directory, keep_days = self._options.state_directory, self._history_settings.keep_days
            self.history = History(directory, bus.id, keep_days=keep_days, clock=self._clock)
            bus.answer_history(self.history.answer)
        self._save_timer.restart(self._clock.monotonic_s())
        return decisions

    def describe(self, info: DeviceInfo) -> None:
        """Keep what is known of the device now for the saved state."""
        if self.persistence is not None:
            self.persistence.describe(info)

    def resume(self, info: DeviceInfo, counters: DeviceCounters) -> str | None:
        """Continue after an interruption; return why the device begins a new record, None if it does not."""
        assert self.persistence is not None
        if not self.persistence.differing(info) or not self._record.samples:
            return None
        self._record.end()
        self.keep()
        text = self.persistence.start_new_record(info, self.session(counters), self.fed_s)
        self._record.forget()
        self.recorder.start_new_record()
        self.started = None
        return text

    def close(self, counters: DeviceCounters) -> None:
        """Write everything, and wait for it."""
        self.keep(in_progress=True)
        if self.persistence is not None:
            self.persistence.close(self.session(counters), self.fed_s, self._history_barrier())
        if self.history is not None:
            self.history.close()
        self.recorder.close()

    def set_aside(self, mismatch: RecordMismatch) -> str | None:
        """Set aside the record that the stream does not continue; return what was done, None: it has no name yet."""
        if self.persistence is None:
            return None
        self.started = None
        return self.persistence.set_aside_rejected(mismatch)

    def running(self) -> None:
        """Note that samples arrive: the record begins now, unless it continues."""
        if self.started is None:
            self.started = stamp(self._clock.now())

    def start_recording(self, name: str, info: DeviceInfo) -> str | None:
        """Start to record the raw bytes; return the path of the file, None if there is a problem."""
        known = ("driver", "model", "serial", "firmware", "stream", "alias_factor", "caveats")
        header = {
            "time": stamp(self._clock.now()),
            "record": self.started,  # it continues in the next recording after a restart
            "id": name,
            "rate_hz": self._record.rate_hz,  # of a stream without a clock
            "settings": dict(info.settings),
            **{field: getattr(info, field) for field in known},
        }
        return self.recorder.start(header)

    # ------------------------------------------------------------------ keeping

    def keep(self, *, in_progress: bool = False) -> None:
        """Keep the periods that have ended, and with `in_progress` also the others."""
        if self.history is None:
            self._record.periods()  # without a history none is kept
            return
        if self.newest is not None:
            (block, received_s), self.newest = self.newest, None
            if block.stream.clock == "startup" and block.time_ns is not None:
                self.history.clock(float(block.time_ns[-1]) * 1e-9, received_s)
        if self.started is None:
            return  # those of the first block wait until the record has a name
        periods = self._record.periods()
        if in_progress:
            periods += self._record.periods_in_progress()
        self.history.add(periods, self.started, self._clock.time_s())

    def event(self, event: Event) -> None:
        """Keep an event."""
        if self.history is not None and event.kind not in UNKEPT:
            self.history.event(event)

    def annotated(self, report: Report) -> Report:
        """Return a report with what the history shows."""
        return report if self.history is None else self.history.annotated(report)

    def new_changes(self) -> list[tuple[str, str]]:
        """Return the changes over days that are new: channel and text."""
        return [] if self.history is None else self.history.new_changes()

    def save(self, now: float, counters: DeviceCounters) -> None:
        """Let the state and the history be written, if that is due at `now`, s, monotonic."""
        if self.persistence is not None and self._record.samples and self._save_timer.is_due(now):
            self.save_now(counters)

    def save_now(self, counters: DeviceCounters) -> None:
        """Let the state and the history be written; return at once."""
        if self.persistence is not None and self._record.samples:
            self.keep()
            self.persistence.save(self.session(counters), self.fed_s, self._history_barrier())

    def _history_barrier(self) -> Callable[[], None] | None:
        """Let the history be written; return what a state has to wait for, None: there is no history."""
        return None if self.history is None else self.history.barrier()

    def session(self, counters: DeviceCounters) -> SessionCounters:
        """Return the counters of the device, with those of earlier runs."""
        now = SessionCounters(
            started=self.started,
            discarded_bytes=counters.discarded_bytes,
            bad_checksums=counters.bad_checksums,
            received_bytes=counters.received_bytes,
            overruns=counters.overruns,
            kernel_overruns=counters.kernel_overruns,
            most_queued_bytes=counters.most_queued_bytes,
            ledger=self._ledger(counters),
        )
        return now if self.persistence is None else self.persistence.with_earlier_runs(now)

    def _ledger(self, counters: DeviceCounters) -> dict[str, int]:
        """Return what became of what the device received in this run, without the samples of the record."""
        others = {RECEIVED: counters.other_sender, "other_sender": counters.other_sender}
        left_out = self._record.left_out()
        if counters.ledger:
            return merged(counters.ledger, others, left_out)
        delivered = sum(merged(left_out, {SAMPLES: self._record.own_samples()}).values())
        return merged({RECEIVED: delivered}, others, left_out)

    def problems(self) -> Iterator[tuple[str, str, Level | None]]:
        """Yield what is new about keeping the record: kind, text and level of an event; None: that of the kind."""
        for text in self.recorder.problems():
            yield "recording", text, None
        for about_state in self.persistence.problems() if self.persistence is not None else ():
            yield "state", *about_state
        for about_history in self.history.problems() if self.history is not None else ():
            yield "history", *about_history

    def unsaved(self) -> str | None:
        """Return why the last state could not be saved; None if it was, or if there is none to keep."""
        kept = self.persistence if self._record.samples and not self._options.temporary else None
        return None if kept is None else kept.failed

    def end_text(self) -> str:
        """Return what the run leaves behind, for the log."""
        samples = self._record.samples
        if not samples:
            return "stopped: no sample arrived"
        text = f"stopped: the record has {samples:,} sample{'s' * (samples > 1)}"
        if self._options.temporary:
            return f"{text} and is not kept: --state DIR keeps it"
        path = self.persistence.path if self.persistence is not None else None
        return f"{text}, saved in {path}" if path is not None else f"{text} and is not saved"
