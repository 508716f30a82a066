"""Daemon: read a device, feed its record, report, publish and save.

The device runs in the thread of its `DeviceReader`. This loop is the only consumer of its queue, and it owns the
time, the `Record`, what keeps it (`Keeper`) and the outputs (`Outputs`). What may stall has a thread of its own:
sending, and writing to disk. A report is due every period, whatever the device does.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

from imumon.bus import BusError
from imumon.checkpoint import check_directory
from imumon.config import Settings
from imumon.daemon.connection import Connection
from imumon.daemon.keeper import Keeper
from imumon.daemon.outputs import Outputs
from imumon.daemon.run_limits import RunOptions, RunResult, Shutdown, Timer
from imumon.daemon.sd_notify import ServiceNotifier, status_line
from imumon.model import report
from imumon.model.messages import EVENT_LEVELS
from imumon.model.samples import DeviceCounters, DeviceInfo, Gap, Item, Level, Notice, RawBytes, SampleBlock
from imumon.record import Record, RecordMismatch, RecordOptions
from imumon.sources.device import DeviceEnded, DeviceError, DeviceNotFound, DeviceOptions, InvalidOption
from imumon.sources.device_reader import (
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
from imumon.sources.registry import driver_of

WAIT_S = 0.25
"""s that the loop waits for the device before it looks at signals. It wakes for data and reports anyway, and each time
costs as much as a dozen samples."""
HANG_S = 60.0
"""s without activity of the device's thread after which the watchdog is not answered any more: a device must not wait
so long in one call. The service manager then restarts the daemon."""
END_S = 3.0
"""s from a stop to the end of what the daemon waits for, on a machine that has time for it."""
DRAIN_S = 1.0
"""s of them that the device may take to deliver what has arrived."""
LEAST_S = 1.0
"""s that the settings of the device, and then the alert command, get at least, however long the last report takes."""


class Daemon:
    """One device, read and published until the end of the run."""

    def __init__(self, settings: Settings, options: RunOptions) -> None:
        self.settings, self.options, self._clock = settings, options, options.clock
        driver = driver_of(options.url)
        if settings.record.file and driver.decoder() is None:
            text = f"{options.url} sends no bytes that could be recorded"
            raise InvalidOption("record_not_possible", text, "leave --record out")
        device_options = DeviceOptions(
            url=options.url,
            settings=settings.device,
            table=getattr(settings, driver.scheme, None),
            state_directory=options.state_directory,
            time_lapse=not options.clock.is_real_time,
        )
        self._reader = DeviceReader(create_device(driver, device_options))
        self._connection = Connection(driver, self._clock)
        record_options = RecordOptions(
            guarded=settings.guards.enabled,
            precision=settings.report.precision,
            period_s=settings.report.period_s,
            baseline=options.baseline,
            periods=settings.history.enabled,
            max_loss=settings.alert.max_loss,
        )
        self._record = Record(record_options, rate_hz=settings.device.rate_hz or None)
        self._real_time = options.clock.is_real_time
        self._fed_at: float | None = None  # s, `HostClock.uptime_s` of the last samples
        self._keeper = Keeper(settings, options, self._record)
        self._outputs = Outputs(settings, options, self._keeper)
        self._notifier = ServiceNotifier()
        self._shutdown = Shutdown(options.duration_s, self._clock)
        self._report_timer = Timer(settings.report.period_s)
        self._wait_s = WAIT_S  # until a report is due, if that is earlier
        self._watchdog_timer = Timer(self._notifier.watchdog_s or HANG_S)

    def run(self) -> RunResult:
        """Read until a signal arrives or the duration is over.

        Raises
        ------
        ImumonError : there is no device at the start (a service manager's daemon waits for one), the address or
            the state belongs to another daemon, the recording cannot be written, or a rate is required.
        """
        if not self._notifier.enabled:
            self._keeper.recorder.check_file()
            check_directory(self.options.state_directory)
        with self._shutdown.handling_signals():
            try:
                self._reader.start()
                while not (self._shutdown.requested or self._reader.ended):
                    self._handle(self._reader.get(self._wait_s))
                    self._do_duties()
                ended = self._reader.ended
                final = self._finish()
                kept = self._keeper
                return RunResult(final, self._shutdown.signal, ended, kept.unsaved(), kept.recorder.failed)
            except BaseException:
                self._abort()
                raise

    def _handle(self, event: ReaderEvent | None) -> None:
        match event:
            case None:
                self._check_silence(data=False, samples=False)
            case Items(items):
                self._on_items(items)
            case Opened(info):
                self._on_opened(info)
            case Started(info, again):
                (self._on_reconnect if again else self._on_connect)(info)
            case OpenFailed(error, again, expected):
                (self._on_reopen_failed(error) if again else self._on_open_failed(error, expected))
            case Disconnected(error):
                self._on_disconnect(error)
            case Progress(text):
                self._on_progress(text)
            case EndOfStream(DeviceEnded() as end):
                self._outputs.event("disconnect", str(end), "notice")
            case EndOfStream(error) if error is not None:
                raise error

    # ------------------------------------------------------------------ connection

    def _on_progress(self, text: str) -> None:
        if (
            not self._connection.searched
        ):  # a port that opens at once needs no line; identifying takes seconds
            self._connection.searched = True
            self._outputs.log(f"searching for a sensor on {self.options.url or 'all serial ports'}")
        self._outputs.log(text, "debug")

    def _on_opened(self, info: DeviceInfo) -> None:
        """The device is identified: its name decides the keys and the state. Nothing of it is changed yet."""
        self._keeper.open(self._outputs.open(info).id)
        self._connection.identify(info)
        self._reader.begin()

    def _on_connect(self, info: DeviceInfo) -> None:
        bus, connection = self._outputs.open(info), self._connection
        for text, level in self._keeper.begin(info, bus):
            self._outputs.event("state", text, level)
        connection.connected, connection.state = True, "starting"
        where = f"{info.title} on {info.port}"
        self._outputs.log(f"reading {where}{f' at {info.baud} baud' if info.baud else ''}")
        self._outputs.log(f"publishing as {bus.id} on {', '.join(bus.endpoints)}")
        self._on_info(info)
        self._outputs.event("connect", where, "notice" if connection.problem else "debug")

    def _on_open_failed(self, error: DeviceError, expected: DeviceInfo | None) -> None:
        """The device is not there. A service waits for it, and everybody for one that is expected; otherwise a
        command that was just started fails."""
        if not self._notifier.enabled and expected is None:
            raise error
        if expected is None:  # another device may take its place
            self._keeper.release()
            self._outputs.release()
        else:
            self._outputs.open(expected)
            self._connection.state = "waiting"
        self._connection.identify(expected)
        text = f"waiting: {error}"
        if self._connection.failed(error):
            self._outputs.event("waiting", text)
        self._notifier.ready()
        self._notifier.status(text)

    def _on_reopen_failed(self, error: DeviceError) -> None:
        if self._connection.failed(error) and not isinstance(error, DeviceNotFound):
            self._outputs.event("waiting", f"the device cannot be opened again yet: {error}")

    def _on_disconnect(self, error: DeviceError) -> None:
        self._connection.lost()
        self._flush()
        self._outputs.event("disconnect", str(error))

    def _on_reconnect(self, info: DeviceInfo) -> None:
        away_s = self._connection.regained()
        now = self._clock.uptime_s()
        unfed_s, self._fed_at = now - (self._fed_at or now), now  # longer than the connection was away
        self._gap(self._clock.to_sample_s(unfed_s))
        if (other_settings := self._keeper.resume(info, self._connection.counters)) is not None:
            self._record.rate_hz = self.settings.device.rate_hz or None
            self._outputs.event("state", other_settings, "warning")
        self._on_info(info, "warning")  # it was otherwise before
        text = f"{info.title} is back on {info.port} after {away_s:.1f} s"
        self._outputs.event("connect", text, "notice")

    # ------------------------------------------------------------------ data

    def _on_items(self, items: list[Item]) -> None:
        record, connection = self._record, self._connection
        samples_before, bytes_before = record.samples, connection.counters.received_bytes
        data = False
        for item in items:
            match item:
                case SampleBlock():
                    data = True
                    self._feed(item)
                case RawBytes():
                    data = True
                    self._on_bytes(item.data)
                case Gap(length_s):
                    self._gap(length_s)
                case Notice(kind, text, level):
                    self._outputs.event(kind, text, level)
                case DeviceInfo():
                    self._on_info(item)
                    self._keeper.describe(connection.info or item)
                case DeviceCounters():
                    connection.counters = item
        samples = record.samples not in (0, samples_before)
        if samples:
            self._keeper.fed_s = self._fed_at
            if connection.state != "running" or self._keeper.started is None:
                self._on_running()
        if self.settings.record.file:
            self._start_recording()
        data |= connection.counters.received_bytes > bytes_before
        self._check_silence(data=data, samples=samples)

    def _feed(self, block: SampleBlock) -> None:
        record, keeper, now = self._record, self._keeper, self._clock.uptime_s()
        passed_s, self._fed_at = now - (self._fed_at or now), now
        # in time-lapse the host clock proves nothing
        mismatch = record.feed(block, host_s=passed_s if self._real_time else None)
        keeper.newest = block, self._clock.time_s()
        if record.ended_periods:
            keeper.keep()
        if mismatch is not None:
            self._set_aside(mismatch)

    def _flush(self) -> None:
        """Process everything that the record holds back."""
        if (mismatch := self._record.flush()) is not None:
            self._set_aside(mismatch)

    def _set_aside(self, mismatch: RecordMismatch) -> None:
        """Set the record aside that the stream does not continue, and send why."""
        if (text := self._keeper.set_aside(mismatch)) is not None:
            self._outputs.event("state", text, "warning")

    def _gap(self, length_s: float | None) -> None:
        """Note that the stream was interrupted; None: for an unknown time."""
        self._record.gap(length_s)
        self._keeper.recorder.gap(length_s)

    def _on_bytes(self, data: bytes) -> None:
        if self.settings.record.file:
            self._keeper.recorder.write(data)
        if not self._record.samples:
            self._connection.note_bytes(data)

    def _on_running(self) -> None:
        if self._connection.state != "running":
            self._report_timer.expire()  # publish the first numbers at once
            self._notifier.ready()
        self._connection.runs()
        self._keeper.running()

    def _on_info(self, info: DeviceInfo, level: Level | None = None) -> None:
        """Keep what is known of the device; each new remark is an event of this level, None: that of the kind."""
        for remark in self._connection.update(info):
            self._outputs.event("remark", remark, level)
        if self._record.rate_hz is None:
            self._record.rate_hz = info.sample_rate_hz

    def _start_recording(self) -> None:
        """Start to record when it is known what."""
        recorder, info, bus = self._keeper.recorder, self._connection.info, self._outputs.bus
        if not recorder.needs_header or info is None or bus is None:
            return
        if (self._record.samples or recorder.full) and (path := self._keeper.start_recording(bus.id, info)):
            renamed = path != self.settings.record.file
            self._outputs.log(f"recording to {path}{': the given file exists' if renamed else ''}")

    def _check_silence(self, *, data: bool, samples: bool) -> None:
        """Send that the device is silent, or that what it sends is no sample."""
        record = self._record
        if not record.samples:
            ledger = self._keeper.session(self._connection.counters).ledger
            if remark := self._connection.unexplained(ledger):
                self._outputs.event("remark", remark, "warning")
        if problem := self._connection.silence(data=data, samples=samples, rate_hz=record.sample_rate_hz):
            self._outputs.event("silent", problem)

    # ------------------------------------------------------------------ duties

    def _do_duties(self) -> None:
        now = self._clock.monotonic_s()
        hangs = now - self._reader.active_at > HANG_S
        if self._notifier.watchdog_s is not None and not hangs and self._watchdog_timer.is_due(now):
            self._notifier.watchdog()
        self._wait_s = WAIT_S
        if self._outputs.bus is not None:
            if self._report_timer.is_due(now):
                self._publish()
            self._wait_s = max(min(self._report_timer.next_s - now, WAIT_S), 0.0)
        self._keeper.save(now, self._connection.counters)

    def _publish(self) -> report.Report:
        keeper, outputs = self._keeper, self._outputs
        assert outputs.bus is not None
        if self._connection.state == "waiting":
            self._notifier.ready()
        current = keeper.annotated(self._report(outputs.bus.id))
        outputs.report(current, self._record.signals())
        keeper.keep(in_progress=True)
        outputs.detected(self._record.events())
        for kind, text, level in keeper.problems():
            outputs.event(kind, text, level)
        for text, level in outputs.problems():
            outputs.event("bus", text, level)
        for channel, text in keeper.new_changes():
            outputs.event("change", text, "warning", channel)
        self._notifier.status(status_line(current))
        return current

    def _report(self, name: str) -> report.Report:
        connection = self._connection
        current = self._record.report(
            self._clock.now(),
            connection.description(name),
            connection.state,
            self._keeper.session(connection.counters),
            device_caveats=connection.info.caveats if connection.info else (),
            # a fit of all channels may take longer than a daemon has to end
            renewal="none" if connection.state == "stopped" else "due",
        )
        columns = connection.info.columns if connection.info else ()
        recording = report.RecordingDescription(columns=columns) if columns else None
        return replace(current, speed=self._clock.time_lapse, recording=recording)

    # ------------------------------------------------------------------ end

    def _finish(self) -> report.Report | None:
        """Save, take what has arrived, save it too, and publish the last report.

        What was measured is on its way to the disk before anything is waited for. Meanwhile the device gets its
        settings back.
        """
        self._notifier.stopping()
        self._reader.stop()
        begin = self._clock.monotonic_s()
        self._keeper.save_now(self._connection.counters)
        while not self._reader.ended and self._clock.monotonic_s() < begin + DRAIN_S:
            self._handle(self._reader.get(WAIT_S))
        # On a busy machine, the last counts may come when the time is over: what is there already costs little time. An
        # emulator in time-lapse has filled the queue with hours, which no sensor measured.
        real = self._clock.is_real_time
        while real and not self._reader.ended and (event := self._reader.get(0.0)) is not None:
            self._handle(event)
        self._reader.stop(discard=True)
        self._flush()
        self._keeper.save_now(self._connection.counters)  # the last report may take seconds
        final = None
        self._connection.state = "stopped"
        if self._outputs.bus is not None:
            with suppress(BusError):
                final = self._publish()
        identified = self._keeper.persistence is not None
        self._keeper.close(self._connection.counters)
        for kind, text, level in self._keeper.problems():
            self._outputs.log(text, level or EVENT_LEVELS[kind])
        self._outputs.leave()
        self._wait_for_restore(max(begin + END_S - self._clock.monotonic_s(), LEAST_S))
        self._outputs.end_alerts(max(begin + END_S - self._clock.monotonic_s(), LEAST_S))
        self._outputs.release()
        self._outputs.log(self._keeper.end_text())
        return final if identified else None  # None: no device was ever there

    def _wait_for_restore(self, within_s: float = END_S) -> None:
        self._reader.join(within_s)
        if self._reader.restored is False:
            text = "the sensor does not have its own settings back; the next run restores them at its end"
            self._outputs.log(text, "warning")

    def _abort(self) -> None:
        """Restore the device after an error. The last saved state stays: samples may be counted by half."""
        self._notifier.stopping()
        with suppress(Exception):
            self._reader.stop(discard=True)
            self._outputs.leave()
            self._wait_for_restore()
            self._outputs.end_alerts()
