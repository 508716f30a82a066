"""Daemon: read a device, feed the pipeline, report, publish and save.

The device runs in the thread of its `DeviceReader`. This loop is the only consumer of its queue, and it owns the
time, the bus and the state. Three more things may stall and have threads of their own: sending on the bus,
writing the state, writing the recording. A report is due every period, whatever the device does.
"""

from __future__ import annotations

import logging
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from imumon import alarms, report
from imumon.bus import BusError, Publisher
from imumon.checkpoint import check_directory
from imumon.config import Settings
from imumon.daemon import metadata
from imumon.daemon.alert_command import AlertCommand
from imumon.daemon.history_feed import HistoryFeed
from imumon.daemon.log import LEVELS
from imumon.daemon.persistence import Persistence, uptime_s
from imumon.daemon.recorder import Recorder
from imumon.daemon.run_limits import DataTimeout, Shutdown
from imumon.daemon.sd_notify import ServiceNotifier, status_line
from imumon.devices.base import DeviceError, DeviceOptions
from imumon.devices.device_reader import (
    DeviceReader,
    Disconnected,
    EndOfStream,
    Items,
    Opened,
    OpenFailed,
    Progress,
    ReaderEvent,
    Started,
    create_device,
)
from imumon.devices.registry import driver_of
from imumon.evaluation import Provenance
from imumon.messages import EVENT_LEVELS
from imumon.pipeline import Monitor, MonitorOptions
from imumon.ros2.ros_output import RosOutput
from imumon.samples import DeviceCounters, DeviceInfo, Gap, Item, Level, Notice, RawBytes, SampleBlock, Stream

WAIT_S = 0.1
"""s that the loop waits for the device before it looks at signals and duties."""
HANG_S = 60.0
"""s without activity of the device's thread after which the watchdog is not answered any more: a device must not wait
so long in one call. The service manager then restarts the daemon."""
END_S = 3.0
"""s that the device may take at the end to deliver what has arrived."""
RESTORE_S = 6.0
"""s that the device may take at the end to get its settings back: a sensor on a bad line takes some tries. With
`END_S` it is below the 10 s after which the service manager kills the daemon."""
IGNORED_LOG_S = 1.0
"""s between two log lines on ignored signals."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """What to run, beside the settings.

    Attributes
    ----------
    url : of the device, see `imumon.devices.registry.driver_of`; empty: the only one that is found.
    state_directory : of the accumulated statistics.
    duration_s : s of the host clock; None: unlimited.
    fresh : start a new record; the old state is kept under another name.
    temporary : the state directory is deleted after the run.
    speed : seconds of the sample clock per second of the host clock; not 1 for an emulator in time-lapse.
    baseline : an earlier report of the same sensor, to compare with.
    provenance : program and host, for the reports; None: they do not name them.
    """

    url: str
    state_directory: Path
    duration_s: float | None = None
    fresh: bool = False
    temporary: bool = False
    speed: float = 1.0
    baseline: report.Report | None = None
    provenance: Provenance | None = None


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended: the final report, None if no device was ever there, and the signal that ended it."""

    report: report.Report | None
    signal: int | None


class Daemon:
    """One device, read and published until the end of the run."""

    def __init__(self, settings: Settings, options: RunOptions) -> None:
        self.settings, self.options = settings, options
        self._notifier = ServiceNotifier()
        driver = driver_of(options.url)
        self._scheme = driver.scheme
        self._has_raw_bytes = driver.decoder() is not None
        self._reader = DeviceReader(
            create_device(
                driver,
                DeviceOptions(
                    url=options.url,
                    settings=settings.device,
                    table=getattr(settings, driver.scheme, None),
                    state_directory=options.state_directory,
                    speed=options.speed,
                ),
            )
        )
        precision = settings.report
        self._monitor_options = MonitorOptions(
            guarded=settings.guards.enabled,
            precision={"N": precision.precision_n, "B": precision.precision_b, "K": precision.precision_k},
            period_s=precision.period_s,
            baseline=options.baseline,
            periods=settings.history.enabled,
            alarm_limits=alarms.limits(settings.alert),
        )
        self._monitor = self._new_monitor()
        self._recorder = Recorder(settings.record)
        self._alert = AlertCommand(settings.alert.command if options.speed == 1.0 else "")
        self._shutdown = Shutdown(options.duration_s)
        self._timeout = DataTimeout()
        self._ros = RosOutput(settings.ros2, options.url)
        self._bus: Publisher | None = None
        self._persistence: Persistence | None = None
        self._history = HistoryFeed(settings, speed=options.speed)
        self._info: DeviceInfo | None = None
        self._counters = DeviceCounters()
        self._state: report.State = "starting"
        self._started: str | None = None  # when the record began
        self._connected = self._ended = self._searched = False
        self._streams: set[Stream] = set()
        self._fed_at: float | None = None  # `uptime_s` of the last samples
        self._lost_at: float | None = None  # `uptime_s` of the loss
        self._known_remarks: set[str] = set()
        self._last_open_error = ""
        self._next_report = self._next_save = self._next_watchdog = self._next_ignored = 0.0

    def run(self) -> RunResult:
        """Read until a signal arrives or the duration is over.

        Raises
        ------
        ImumonError : there is no device at the start (a service manager's daemon waits for one), the address or
            the state belongs to another daemon, the recording cannot be written, or a rate is required.
        """
        if not self._notifier.enabled:
            self._recorder.check_file()
            check_directory(self.options.state_directory)
        with self._shutdown.handling_signals():
            try:
                self._reader.start()
                while not self._shutdown.requested:
                    self._step(WAIT_S)
                return RunResult(self._finish(), self._shutdown.signal)
            except BaseException:
                self._abort()
                raise

    def _step(self, wait_s: float) -> None:
        """Handle one event of the device, then what is due."""
        event = self._reader.get(wait_s)
        self._handle(event)
        self._do_duties(time.monotonic())

    def _handle(self, event: ReaderEvent | None) -> None:
        match event:
            case None:
                self._check_timeout(data=False, samples=False)
            case Items(items):
                self._on_items(items)
            case Opened(info):
                self._on_opened(self._with_driver(info))
            case Started(info, again):
                (self._on_reconnect if again else self._on_connect)(self._with_driver(info))
            case OpenFailed(error, again, expected):
                self._on_open_failed(error, again, expected and self._with_driver(expected))
            case Disconnected(error):
                self._on_disconnect(error)
            case Progress(text):
                if not self._searched:  # a port that opens at once needs no line; identifying takes seconds
                    self._searched = True
                    self._log(f"searching for a sensor on {self.options.url or 'all serial ports'}")
                self._log(text, "debug")
            case EndOfStream(error):
                self._ended = True
                if error is not None:
                    raise error

    def _with_driver(self, info: DeviceInfo) -> DeviceInfo:
        return replace(info, driver=self._scheme)

    # ------------------------------------------------------------------ connection

    def _on_opened(self, info: DeviceInfo) -> None:
        """The device is identified: its name decides the keys and the state. Nothing of it is changed yet."""
        options = self.options
        self._bus = self._bus or self._new_bus(info)
        self._persistence = Persistence(
            options.state_directory, self._bus.id, self._monitor, fresh=options.fresh, speed=options.speed
        )
        self._info = info
        self._reader.begin()

    def _new_bus(self, info: DeviceInfo) -> Publisher:
        return Publisher(self.settings.device.id or info.id, settings=self.settings.zenoh)

    def _on_connect(self, info: DeviceInfo) -> None:
        assert self._bus is not None
        assert self._persistence is not None
        for text, level in self._persistence.restore(info):
            self._event("state", text, level)
        self._started = self._persistence.started
        self._history.open(self.options.state_directory, self._bus)
        self._connected, self._state = True, "starting"
        where = f"{info.title} on {info.port}"
        self._log(f"reading {where}{f' at {info.baud} baud' if info.baud else ''}")
        self._log(f"publishing as {self._bus.id} on {', '.join(self._bus.endpoints)}")
        self._on_info(info)
        self._event("connect", where, "notice" if self._last_open_error else "debug")
        self._next_save = time.monotonic() + self.settings.state.save_period_s

    def _on_open_failed(self, error: DeviceError, again: bool, expected: DeviceInfo | None) -> None:
        """The device is not there. A service waits for it, and everybody for one that is expected; otherwise a
        command that was just started fails."""
        text = str(error)
        if again:
            if text != self._last_open_error and error.code != "port_not_found":
                self._event("waiting", f"the device cannot be opened again yet: {text}")
            self._last_open_error = text
            return
        if not self._notifier.enabled and expected is None:
            raise error
        if expected is None:
            self._release_name()
        else:
            self._bus = self._bus or self._new_bus(expected)
            self._info, self._state = expected, "waiting"
        if text != self._last_open_error:
            self._last_open_error = text
            self._event("waiting", f"waiting: {text}")
        self._notifier.ready()
        self._notifier.status(f"waiting: {text}")

    def _release_name(self) -> None:
        """Give up bus and state: the device went while it was started, and another one may take its place."""
        if self._persistence is not None:
            self._persistence.close(self._session(), None)
        if self._bus is not None:
            self._bus.close()
        self._bus = self._persistence = self._info = None

    def _on_disconnect(self, error: DeviceError) -> None:
        self._lost_at = self._lost_at or uptime_s()
        self._last_open_error = ""
        self._connected = False
        self._state = "waiting"
        self._monitor.flush()
        self._event("disconnect", str(error))

    def _on_reconnect(self, info: DeviceInfo) -> None:
        assert self._persistence is not None
        now = uptime_s()
        away = now - (self._lost_at or now)
        unfed = now - (self._fed_at or now)  # longer than the connection was away
        self._lost_at, self._fed_at = None, now
        self._connected = True
        self._gap(unfed * self.options.speed)
        self._streams.clear()
        if self._persistence.differing(info) and self._monitor.samples:
            self._start_new_record(info)
        self._on_info(info, "warning")  # it was otherwise before
        self._event("connect", f"{info.title} is back on {info.port} after {away:.1f} s", "notice")

    def _start_new_record(self, info: DeviceInfo) -> None:
        """The device is back with other settings."""
        assert self._persistence is not None
        self._monitor.end_record()
        self._history.keep(self._monitor, self._started)
        self._monitor = self._new_monitor()
        self._recorder.start_new_record()
        text = self._persistence.start_new_record(info, self._monitor, self._session())
        self._event("state", text, "warning")
        self._started = None

    def _new_monitor(self) -> Monitor:
        return Monitor(self._monitor_options, rate_hz=self.settings.device.rate_hz or None)

    # ------------------------------------------------------------------ data

    def _on_items(self, items: list[Item]) -> None:
        before, bytes_before = self._monitor.samples, self._counters.received_bytes
        for item in items:
            match item:
                case SampleBlock():
                    self._on_samples(item)
                case RawBytes():
                    self._recorder.write(item.data)
                case Gap(length_s):
                    self._gap(length_s)
                case Notice(kind, text, level):
                    self._event(kind, text, level)
                case DeviceInfo():
                    self._on_info(self._with_driver(item))
                case DeviceCounters():
                    self._counters = item
        samples = self._monitor.samples not in (0, before)
        if samples:
            self._on_running()
        recorder = self._recorder
        raw = any(isinstance(item, RawBytes) for item in items)
        if samples and recorder.needs_header and not raw and not self._has_raw_bytes:
            recorder.needs_header = False
            self._event("recording", "nothing is recorded: this device has no raw bytes")
        if recorder.needs_header and (self._monitor.samples or recorder.full):
            self._start_recording()
        data = raw or any(isinstance(item, SampleBlock) for item in items)
        data |= self._counters.received_bytes > bytes_before
        self._check_timeout(data=data, samples=samples)

    def _on_samples(self, block: SampleBlock) -> None:
        if block.stream not in self._streams:
            self._streams.add(block.stream)
            if self._monitor.rate_hz is None and self._info is not None:
                self._monitor.rate_hz = self._info.sample_rate_hz
        now = uptime_s()
        passed, self._fed_at = now - (self._fed_at or now), now
        before = self._monitor.samples
        # in time-lapse the host clock proves nothing
        mismatch = self._monitor.feed(block, host_s=passed if self.options.speed == 1.0 else None)
        self._history.clock(block)
        self._history.keep(self._monitor, self._started)
        if self._persistence is None:
            return
        if self._monitor.samples != before:
            self._persistence.fed_s = now
        if mismatch is not None:
            self._event("state", self._persistence.set_aside_rejected(mismatch), "warning")
            self._started = None

    def _on_running(self) -> None:
        if self._state != "running":
            self._next_report = 0.0  # publish the first numbers at once
            self._notifier.ready()
        self._state = "running"
        if self._started is None:
            self._started = report.stamp(datetime.now(UTC))

    def _on_info(self, info: DeviceInfo, level: Level | None = None) -> None:
        """Keep what is known of the device; each new remark is an event of this level, None: that of the kind."""
        self._info = info
        for remark in info.remarks:
            if remark not in self._known_remarks:
                self._known_remarks.add(remark)
                self._event("remark", remark, level)

    def _gap(self, length_s: float | None) -> None:
        self._monitor.gap(length_s)
        self._recorder.gap(length_s)

    def _start_recording(self) -> None:
        if self._info is not None and self._bus is not None:
            rate = self._monitor.rate_hz
            header = metadata.recording_header(self._bus.id, self._info, rate, self._started)
            if path := self._recorder.start(header):
                taken = path != self.settings.record.file
                self._log(f"recording to {path}{': the given file exists' if taken else ''}")

    def _check_timeout(self, *, data: bool, samples: bool) -> None:
        if not self._connected:
            return
        problem = self._timeout.update(
            time.monotonic(),
            data=data,
            samples=samples,
            rate_hz=self._monitor.sample_rate_hz,
            starting=self._state == "starting",
        )
        if problem is not None and self._state != "waiting":
            self._state = "waiting"
            self._event("silent", problem)

    # ------------------------------------------------------------------ duties

    def _do_duties(self, now: float) -> None:
        ignored, self._shutdown.ignored = self._shutdown.ignored, None
        if ignored is not None and now >= self._next_ignored:
            self._next_ignored = now + IGNORED_LOG_S
            self._log(f"signal {ignored} ignored: SIGTERM ends the daemon", "notice")
        hangs = now - self._reader.active_at > HANG_S
        if self._notifier.watchdog_s is not None and now >= self._next_watchdog and not hangs:
            self._notifier.watchdog()
            self._next_watchdog = now + self._notifier.watchdog_s
        if self._bus is not None and now >= self._next_report:
            period = self.settings.report.period_s
            self._next_report += period
            if self._next_report <= now:  # late: do not catch up
                self._next_report = now + period
            self._publish()
        if self._persistence is not None and now >= self._next_save and self._monitor.samples:
            self._next_save = now + self.settings.state.save_period_s
            self._persistence.save(self._session(), self._started)
            self._history.save()

    def _publish(self) -> report.Report:
        assert self._bus is not None
        if self._state == "waiting":
            self._notifier.ready()
        made = metadata.traced(self._history.annotated(self._report()), self.options.provenance)
        if self._ros.needed:
            self._ros.update(made)
        self._bus.publish(made, self._monitor.signals(self._bus.requested_signals()))
        self._history.report(made)
        self._history.keep(self._monitor, self._started, in_progress=True)
        for event in self._monitor.events():
            self._emit(event.stamped(datetime.now(UTC), self._bus.id))
        for problem in self._recorder.problems():
            self._event("recording", problem)
        for problem in self._ros.problems():
            self._event("bus", problem)
        for problem, over in self._bus.status_changes():
            self._event("bus", problem, "notice" if over else None)
        if self._persistence is not None and (state_problem := self._persistence.problem()):
            self._event("state", *state_problem)
        for channel, text in self._history.new_changes():
            self._event("change", text, "warning", channel)
        for history_problem in self._history.problems():
            self._event("history", *history_problem)
        self._notifier.status(status_line(made))
        return made

    def _report(self) -> report.Report:
        assert self._bus is not None
        return self._monitor.report(
            datetime.now(UTC),
            metadata.description(self._bus.id, self._info),
            self._state,
            self._session(),
            device_caveats=self._info.caveats if self._info else (),
            speed=self.options.speed,
        )

    def _session(self) -> report.SessionCounters:
        """Return the counters of the device, with those of earlier runs."""
        counters = self._counters
        now = report.SessionCounters(
            started=self._started,
            discarded_bytes=counters.discarded_bytes,
            bad_checksums=counters.bad_checksums,
            received_bytes=counters.received_bytes,
            overruns=counters.overruns,
            kernel_overruns=counters.kernel_overruns,
            most_queued_bytes=counters.most_queued_bytes,
        )
        return self._persistence.with_earlier_runs(now) if self._persistence else now

    def _event(self, kind: str, text: str, level: Level | None = None, channel: str | None = None) -> None:
        """Log and publish an event of the daemon itself; level None: that of the kind."""
        stamp, name = report.stamp(datetime.now(UTC)), self._bus.id if self._bus else self.settings.device.id
        known = level or EVENT_LEVELS.get(kind, "info")
        self._emit(report.Event(time=stamp, kind=kind, text=text, device=name, level=known, channel=channel))

    def _emit(self, event: report.Event) -> None:
        """Log, publish and keep an event, and pass it on to the alert command."""
        self._log(event.text, event.level, event.kind)
        self._alert.submit(event)
        if self._bus is not None:
            self._bus.event(event)
            self._history.event(event)

    def _log(self, text: str, level: Level = "info", kind: str = "") -> None:
        log.log(LEVELS[level], "%s", text, extra={"kind": kind})

    # ------------------------------------------------------------------ end

    def _finish(self) -> report.Report | None:
        """Take what has arrived, publish and save the last report; meanwhile the device gets its settings back."""
        self._notifier.stopping()
        self._reader.stop()
        end = time.monotonic() + END_S
        while not self._ended and time.monotonic() < end:
            self._handle(self._reader.get(WAIT_S))
        self._reader.stop(discard=True)
        self._monitor.flush()
        final = None
        self._state = "stopped"
        if self._bus is not None:
            with suppress(BusError):
                final = self._publish()
        if self._persistence is not None:
            self._persistence.close(self._session(), self._started)
            if problem := self._persistence.problem():
                self._log(problem[0], problem[1])
        self._history.keep(self._monitor, self._started, in_progress=True)
        self._history.close()
        self._recorder.close()
        for text in self._recorder.problems():
            self._log(text, "error")
        self._ros.close()
        self._wait_for_restore()
        self._alert.close(end + RESTORE_S - time.monotonic())
        if self._bus is not None:
            self._bus.close()
        self._log(self._end_text())
        return final if self._persistence is not None else None  # None: no device was ever there

    def _end_text(self) -> str:
        """Return what the run leaves behind, for the log."""
        samples = self._monitor.samples
        if not samples:
            return "stopped: no sample arrived"
        text = f"stopped: the record has {samples:,} sample{'s' * (samples > 1)}"
        if self.options.temporary:
            return f"{text} and is not kept: --state DIR keeps it"
        path = self._persistence.path if self._persistence is not None else None
        return f"{text}, saved in {path}" if path is not None else f"{text} and is not saved"

    def _wait_for_restore(self) -> None:
        self._reader.join(RESTORE_S)
        if self._reader.restored is False:
            text = "the sensor does not have its own settings back; the next run restores them at its end"
            self._log(text, "warning")

    def _abort(self) -> None:
        """Restore the device after an error. The last saved state stays: samples may be counted by half."""
        self._notifier.stopping()
        with suppress(Exception):
            self._reader.stop(discard=True)
            self._ros.close()
            self._wait_for_restore()
            self._alert.close()
