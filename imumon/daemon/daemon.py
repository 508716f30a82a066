"""Daemon: read, feed, ask, publish, save.

    Daemon      the loop                                          daemon/__init__.py
    task        what to run, and how it ended                     daemon/task.py
    stop        a signal, or the time is over                     daemon/stop.py
    link        the sensor on its port, lost and found again      daemon/link.py
    silence     no bytes, or no samples, for too long             daemon/silence.py
    account     what is said of the sensor, and where             daemon/account.py
    keeping     the state: taken up, saved, set aside             daemon/keeping.py
    tape        the raw bytes, kept if that is wanted             daemon/tape.py
    service     service manager and log                           daemon/service.py

One thread does all of it but three things that may stall: draining the port, sending on the bus, and writing
to disk. A report is due every period whatever the sensor does, so the duties run in a beat that goes
on wherever the daemon waits for bytes.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime

from imumon import heap, report
from imumon.bus import BusError, Publisher
from imumon.config import Settings
from imumon.daemon import metadata
from imumon.daemon.connection import BEAT_S, DeviceConnection, NoDevice
from imumon.daemon.data_timeout import DataTimeout
from imumon.daemon.log import DaemonLog, Level, ServiceNotifier, status_line
from imumon.daemon.persistence import Persistence, uptime_s
from imumon.daemon.recorder import Recorder
from imumon.daemon.run_options import RunOptions, RunResult
from imumon.daemon.shutdown import Shutdown, ShutdownRequested
from imumon.devices.vn100.vn100_session import SensorChanged, SessionError, StreamRequest, Vn100Info
from imumon.pipeline import Monitor
from imumon.pipeline import MonitorOptions as Watched
from imumon.recordings import PortError, PortGone, SourceError
from imumon.samples import SampleBlock, Stream

__all__ = ["Daemon", "RunOptions", "RunResult"]

RETRY_S = 0.5
GATHER_S, LOOK_S = 0.5, 0.1  # bytes gather so long at most; how often to look whether they still may
AHEAD_S = 0.01  # before a report is due they are taken in, so that it has them
INTERRUPTED = ("reconfigured", "found", "lost", "garbage", "silent")
"""Notices of the session behind which a stream without a clock has a gap of unknown length."""


class Daemon:
    """One sensor, read and published until told to stop."""

    def __init__(self, settings: Settings, task: RunOptions) -> None:
        device = settings.device
        self.settings, self.task = settings, task
        self.log = DaemonLog(settings.log.level, settings.log.format)
        self._notifier = ServiceNotifier()
        precision = settings.report
        rate = device.rate_hz or None
        self._watched = Watched(
            guarded=settings.guards.enabled,
            precision={"N": precision.precision_n, "B": precision.precision_b, "K": precision.precision_k},
            period_s=precision.period_s,
            baseline=task.baseline,
        )
        self._monitor = Monitor(self._watched, rate_hz=rate)
        wanted = StreamRequest(
            stream=device.stream,
            listen_only=device.listen_only,
            baud=None if device.baud == "auto" else device.baud,
            set_baud=device.set_baud or None,
            rate_hz=rate,
        )
        self._link = DeviceConnection(
            task.path, wanted, self._beat, self._progress, lossless=task.speed != 1.0
        )
        self._facts: Vn100Info | None = None
        self._bus: Publisher | None = None
        self._keeping: Persistence | None = None
        self._tape = Recorder(settings.record)
        self._stop = Shutdown(task.duration_s)
        self._silence = DataTimeout()
        self._next_report = self._next_save = self._next_alive = 0.0
        self._fed_at: float | None = None
        self._lost_at: float | None = None
        self._obstacle: str | None = None  # as it was told last
        self._state: report.State = "starting"
        self._started: str | None = None
        self._streams: set[Stream] = set()
        self._remarked: set[str] = set()

    def run(self) -> RunResult:
        """Read until a signal comes or the time is over.

        Raises
        ------
        NoSensor, PortError, SessionError : there is no sensor to read at the start (under a service manager
            it is waited for instead). BusError, StateError : the address or the state is another daemon's.
        SourceError : what is to be recorded can never be written there.
        RateNeeded : the stream has no clock and no rate was given.
        """
        heap.bypass_cache()
        if not self._notifier.listens:
            self._tape.check()
        with self._stop.listening():
            try:
                try:
                    self._first()
                    heap.settle()
                    while True:
                        self._serve()
                except ShutdownRequested:
                    return RunResult(self._end(), self._stop.signal)
            except BaseException:
                self._give_up()
                raise

    # ------------------------------------------------------------------ getting there

    def _first(self) -> None:
        """Wait for the sensor where a service manager started us; else it must be there."""
        complaint = ""
        while True:
            try:
                self._meet(self._link.open())
                return
            except (NoDevice, PortError, PortGone, SessionError) as error:
                if not self._notifier.listens:
                    raise
                self._part()
                if str(error) != complaint:
                    complaint = str(error)
                    self.log.say(f"waiting: {complaint}", "warning")
                self._notifier.ready()
                self._notifier.status(f"waiting: {complaint}")
                self._pause(2.0)

    def _meet(self, facts: Vn100Info) -> None:
        """The sensor is known for the first time: who it is decides the keys and the state."""
        name = self.settings.device.id or facts.id
        self._bus = Publisher(name, settings=self.settings.zenoh)
        self._keeping = Persistence(
            self.task.state_directory, self._bus.id, facts.id, self._monitor, self.task
        )
        assert self._link.session is not None
        self._keeping.remember(self._link.session)
        self._facts = self._link.session.configure()
        for text, level in self._keeping.take_up(self._facts):
            self._tell("state", text, level)
        self._started = self._keeping.started
        who = f"{metadata.who(self._facts)} on {self._facts.port}"
        self.log.say(f"reading {who} at {self._facts.baud} baud")
        self.log.say(f"publishing as {self._bus.id} on {', '.join(self._bus.endpoints)}")
        self._learn(self._facts)
        self._tell("connect", who, "debug")
        self._next_save = time.monotonic() + self.settings.state.save_period_s

    def _part(self) -> None:
        """Have not met: the sensor went while it was being set up; another may come in its place."""
        self._link.close()
        if self._keeping is not None:
            self._keeping.close(self._session(), None)
        if self._bus is not None:
            self._bus.close()
        self._bus = self._keeping = self._facts = None

    def _record(self, data: bytes) -> None:
        """Keep the raw bytes, if that is wanted; it begins when the stream is known, with the first byte."""
        tape, facts, bus = self._tape, self._facts, self._bus
        tape.take(data)
        if facts is not None and bus is not None and tape.waits and (self._monitor.samples or tape.full):
            tape.begin(metadata.header(bus.id, facts, self._monitor.rate_hz, self._started))

    # ------------------------------------------------------------------ the loop

    def _serve(self) -> None:
        """Bytes to samples to statistics, until the port goes."""
        session = self._link.session
        if session is None:
            self._reconnect()
            return
        self._stop.ask()
        try:
            data = session.read(self._gathered())
            self._heard(data, self._take(data))
            for notice in session.tick():
                self._tell(notice.kind, notice.text, "warning")
                if notice.kind in INTERRUPTED:
                    self._gap(None)
            self._learn(session.facts())
        except (PortGone, SensorChanged) as error:
            self._lose(str(error))
        self._duties(time.monotonic() + AHEAD_S)

    def _gathered(self) -> float:
        """Let bytes gather until a report wants them, for each round costs as much as its bytes.

        Returns
        -------
        Seconds to wait for the first of them; a little though it is late, for the reader may be later still.
        """
        if self._state == "starting":
            return min(BEAT_S, self.settings.report.period_s)
        until = min(self._next_report - AHEAD_S, time.monotonic() + GATHER_S)
        while not self._link.waits and (left := until - time.monotonic()) > 0.0:
            self._beat()
            time.sleep(min(left, LOOK_S))
        return LOOK_S / 2

    def _heard(self, data: bytes, samples: bool = False) -> None:
        """Whether the sensor is silent; it is not while the daemon itself is busy."""
        lack = self._silence.lack(
            time.monotonic(),
            data=bool(data),
            samples=samples,
            rate_hz=self._monitor.sample_rate_hz,
            learning=self._state == "starting",
        )
        if lack is not None and self._state != "waiting":
            self._state = "waiting"
            self._tell("silent", lack, "warning")

    def _learn(self, facts: Vn100Info) -> Vn100Info:
        """What is known of the sensor by now; remarks are told when they arise, each once."""
        self._facts = facts
        for remark in facts.remarks:
            if remark not in self._remarked:
                self._remarked.add(remark)
                self._tell("remark", remark, "warning")
        return facts

    def _take(self, data: bytes) -> bool:
        """Whether there are samples in these bytes."""
        session = self._link.session
        if not data or session is None:
            return False
        before = self._monitor.samples
        for item in session.decode(data):
            if not isinstance(item, SampleBlock):
                continue
            if item.stream not in self._streams:
                self._streams.add(item.stream)
                facts = self._learn(session.facts())
                if self._monitor.rate_hz is None:
                    self._monitor.rate_hz = facts.sample_rate_hz
            self._feed(item)
            if self._monitor.mismatch is not None and self._keeping is not None:
                self._tell("state", self._keeping.refuse() or "", "warning")
                self._started = None
        arrived = self._monitor.samples not in (0, before)
        if arrived:
            self._arrived()
        self._record(data)
        return arrived

    def _feed(self, block: SampleBlock) -> None:
        """Hand samples over, with the room's time that has passed; in time-lapse that proves nothing."""
        now = uptime_s()
        passed, self._fed_at = now - (self._fed_at or now), now
        before = self._monitor.samples
        self._monitor.feed(block, host_s=passed if self.task.speed == 1.0 else None)
        if self._keeping is not None and self._monitor.samples != before:
            self._keeping.fed_s = now

    def _arrived(self) -> None:
        if self._state != "running":
            self._next_report = 0.0  # the first numbers are published at once
            self._notifier.ready()
        self._state = "running"
        if self._started is None:
            self._started = report.stamp(datetime.now(UTC))

    def _lose(self, why: str) -> None:
        self._lost_at = self._lost_at or uptime_s()
        self._obstacle = self._link.obstacle = None
        self._state = "waiting"
        self._link.close()
        self._monitor.flush()
        self._tell("disconnect", why, "warning")

    def _reconnect(self) -> None:
        """Look for the sensor where it may be back."""
        facts = self._link.open_again()
        session = self._link.session
        if facts is None or session is None or self._keeping is None:
            if self._link.obstacle not in (None, self._obstacle):
                self._obstacle = self._link.obstacle
                self._tell("waiting", f"the port is there again, but {self._obstacle}", "warning")
            self._pause(RETRY_S)
            return
        try:
            self._keeping.remember(session)
            self._facts = session.configure()
        except (PortGone, SessionError) as error:
            self._lose(str(error))
            return
        assert self._lost_at is not None
        now = uptime_s()
        away, self._lost_at = now - self._lost_at, None
        unfed, self._fed_at = now - (self._fed_at or now), now  # longer than the link was away
        self._gap(unfed * self.task.speed)
        self._streams.clear()
        if self._keeping.differing(self._facts) and self._monitor.samples:
            self._begin_anew(self._facts)
        who, where = metadata.who(self._facts), self._facts.port
        self._tell("connect", f"{who} is back on {where} after {away:.1f} s", "info")

    def _gap(self, away_s: float | None) -> None:
        """The stream was interrupted, s of the sensor's time, None where nobody knows."""
        self._monitor.gap(away_s)
        self._tape.lost(away_s)

    def _begin_anew(self, facts: Vn100Info) -> None:
        """The sensor came back with other settings: another record."""
        assert self._keeping is not None
        self._monitor = Monitor(self._watched, rate_hz=self.settings.device.rate_hz or None)
        self._tape.begin_anew()
        self._tell("state", self._keeping.begin_anew(facts, self._monitor, self._session()), "warning")
        self._started = None

    def _pause(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self._beat()
            time.sleep(min(0.05, seconds))

    # ------------------------------------------------------------------ the beat

    def _beat(self) -> None:
        """What must go on wherever the daemon waits; raises `ShutdownRequested` when it is to stop."""
        self._stop.ask()
        self._duties(time.monotonic())

    def _duties(self, now: float) -> None:
        if self._notifier.watchdog_s is not None and now >= self._next_alive:
            self._notifier.alive()
            self._next_alive = now + self._notifier.watchdog_s
        if self._bus is not None and now >= self._next_report:
            period = self.settings.report.period_s
            self._next_report += period
            if self._next_report <= now:  # late is late: no two at once
                self._next_report = now + period
            self._publish()
            heap.give_back()
        if self._keeping is not None and now >= self._next_save and self._monitor.samples:
            self._next_save = now + self.settings.state.save_period_s
            self._keeping.save(self._session(), self._started)

    def _publish(self) -> report.Report:
        assert self._bus is not None
        if self._state == "waiting":
            self._notifier.ready()
        made = self._report()
        self._bus.publish(made, self._monitor.signals(self._bus.wanted()))
        for found in self._monitor.events():
            self._bus.event(found.stamped(datetime.now(UTC), self._bus.id))
            self.log.say(found.text, "debug" if found.kind == "gap" else "info", found.kind)
        for lack in self._tape.complaints():
            self._tell("recording", lack, "error")
        for trouble in self._bus.troubles():
            self._tell("bus", trouble, "warning")
        if self._keeping is not None and (complaint := self._keeping.complaint()):
            self._tell("state", complaint, self._keeping.level)
        self._notifier.status(status_line(made))
        return made

    def _report(self) -> report.Report:
        assert self._bus is not None
        facts = self._facts
        return self._monitor.report(
            datetime.now(UTC),
            metadata.device(self._bus.id, facts),
            self._state,
            self._session(),
            device_caveats=facts.caveats if facts else (),
            speed=self.task.speed,
        )

    def _session(self) -> report.SessionCounters:
        """Counters of the link, with those of the runs before."""
        now = replace(self._link.counted(), started=self._started)
        return self._keeping.added_up(now) if self._keeping else now

    def _tell(self, kind: str, text: str, level: Level = "info") -> None:
        """An event of the daemon's own, to the bus and the log."""
        self.log.say(text, level, kind)
        if self._bus is not None:
            stamp = report.stamp(datetime.now(UTC))
            self._bus.event(report.Event(time=stamp, kind=kind, text=text, device=self._bus.id))

    def _progress(self, text: str) -> None:
        self.log.say(text, "debug")

    # ------------------------------------------------------------------ the end

    def _end(self) -> report.Report | None:
        """Leave the sensor as it was, keep the state, say goodbye."""
        self._notifier.stopping()
        if self._fed_at is not None and self._lost_at is None:  # else it was being set up
            self._take_the_rest()
        self._link.decoder.finish()
        self._monitor.flush()
        final = None
        self._state = "stopped"
        if self._bus is not None:
            with suppress(BusError):
                final = self._publish()
        if self._keeping is not None:
            self._keeping.close(self._session(), self._started)
            if complaint := self._keeping.complaint():
                self.log.say(complaint, self._keeping.level)
        self._put_back()
        self._tape.close()
        for lack in self._tape.complaints():
            self.log.say(lack, "error")
        if self._bus is not None:
            self._bus.close()
        return final

    def _take_the_rest(self) -> None:
        """What has come by now still counts; a moment is enough, for more may come all the time."""
        end = time.monotonic() + LOOK_S
        with suppress(PortGone, SessionError):
            while self._link.session is not None and time.monotonic() < end:
                if not (data := self._link.session.read(0.0)):
                    break
                self._take(data)

    def _give_up(self) -> None:
        """Leave the sensor as it was; what was saved last stays, for samples may be counted by half.

        Nothing is waited for: where memory is out, not even a thread begins.
        """
        self._notifier.stopping()
        with suppress(Exception):
            self._put_back()

    def _put_back(self) -> None:
        """Restore the sensor's settings; a beat would end it at once, so it goes without."""
        session = self._link.session
        if session is not None and self._keeping is not None:
            self._link.still()
            with suppress(PortGone, SessionError, SourceError):
                if session.restore():
                    self._keeping.forget()
                else:
                    self.log.say(
                        "the sensor did not take its settings back; the end of the next run will give them",
                        "warning",
                    )
        self._link.close()
