"""Replay: a recording through the same pipeline as the daemon.

Time is that of the recording; nothing waits unless a speed is given.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Literal, TypeAlias

from imumon import pipeline, report
from imumon.alarms import DEFAULT_LIMITS
from imumon.bus import Publisher
from imumon.coefficients import default_precision
from imumon.devices import registry
from imumon.devices.base import DeviceDriver
from imumon.errors import ImumonError
from imumon.evaluation import Evaluation
from imumon.pipeline import Monitor
from imumon.recordings import ReadOptions, Recording, open_recording
from imumon.recordings.base import BLOCK_BYTES
from imumon.replay.read_ahead import read_ahead
from imumon.report import DeviceDescription, Event
from imumon.samples import ALIASED, Gap, Kind, SampleBlock

PACED_BLOCK_BYTES = 1 << 12
"""Bytes that are decoded at once if a speed is kept: a second of samples or less."""


TauGrid: TypeAlias = Literal["octave", "decade"]


class FilterUnknown(ImumonError):
    """The effect of the filter that a user names is unknown for this device."""


@dataclass(frozen=True, slots=True)
class SensorFilter:
    """The filter of the sensor, as a user names it for a recording that does not say.

    Attributes
    ----------
    window : samples that it averages, 1: none; None: with the factory settings of the device.
    loop_hz : Hz, rate of the samples that it averages; None: that of the device.
    text : as it was given.
    """

    window: int | None
    loop_hz: float | None
    text: str

    def alias_factor(self, driver: DeviceDriver | None, rate_hz: float) -> float:
        """Return the nominal factor by which aliasing inflates N of point samples.

        Raises
        ------
        FilterUnknown : the device has no known filter, and no rate is given.
        """
        if self.loop_hz is not None and self.window is not None:
            return max(1.0, math.sqrt(self.loop_hz / (self.window * rate_hz)))
        factor = (driver or registry.driver()).alias_factor(self.window, rate_hz)
        if factor is None:
            message = f"--filter {self.text}: the filter of this device is not known"
            raise FilterUnknown("filter_unknown", message, "give its samples and their rate, such as 8@1000")
        return factor

    def assumption(self, driver: DeviceDriver | None) -> str | None:
        """Return what is assumed of a device that the recording does not name; None: nothing."""
        if driver is not None or self.loop_hz is not None:
            return None
        what = "filter is" if self.window is None else "rate before the filter is"
        how = "the factory setting" if self.window is None else "that"
        return f"the recording names no device: its {what} assumed to be {how} of a {registry.driver().title}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """How to replay a recording.

    Attributes
    ----------
    rate_hz : Hz, configured sample rate; None: not configured.
    speed : times real time; None: as fast as possible.
    guarded : exclude disturbances, motion and warm-up.
    precision : 95 % half-width to reach by coefficient, as a share of its value.
    alarm_limits : by name of the alarm; see `imumon.alarms`.
    baseline : an earlier report of the same sensor, to compare with.
    kind : stream of a table that has several; None: the best.
    columns : channel to ``COLUMN:UNIT`` of a table; empty: by its header.
    topic : of a bag or log.
    sensor : of a table or log, ``gyro`` or ``accel``, the only one that is read; None: all.
    filter : of the sensor; used where the recording does not say. None: not known.
    exact : grid of the exact Allan deviation, which needs memory for all samples; None: leave it out.
    """

    path: str
    rate_hz: float | None = None
    speed: float | None = None
    guarded: bool = True
    alarm_limits: Mapping[str, float] = field(default_factory=lambda: DEFAULT_LIMITS)
    precision: Mapping[str, float] = field(default_factory=default_precision)
    baseline: report.Report | None = None
    kind: Kind | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    topic: str | None = None
    sensor: str | None = None
    filter: SensorFilter | None = None
    exact: TauGrid | None = None

    def open(self) -> Recording:
        """Open the recording; see `open_recording`."""
        block_bytes = BLOCK_BYTES if self.speed is None else PACED_BLOCK_BYTES
        options = ReadOptions(self.kind, self.columns, self.rate_hz, self.topic, self.sensor, block_bytes)
        return open_recording(self.path, options)


def replay(
    options: ReplayOptions,
    *,
    progress: Callable[[float | None, float], None] | None = None,
    bus: Publisher | None = None,
    remark: Callable[[str], None] = lambda text: None,
) -> report.Report:
    """Run a recording through the pipeline and return the final report.

    Parameters
    ----------
    progress : called after each block with the share of the file that is done and the s of the recording.
    bus : publishes a report every period.
    remark : called with one line each about what is doubtful in the recording, and why it ended early.

    Raises
    ------
    RecordingError : the file cannot be read, or has no samples. RateRequired : its stream has no clock.
    """
    recording = options.open()
    run = _Run(options, recording)
    begun, due = time.monotonic(), 0.0
    with closing(read_ahead(recording)) as ahead:
        for items, share in ahead:
            for item in items:
                run.feed(item)
            if progress is not None:
                progress(share, run.elapsed_s)
            if bus is not None and time.monotonic() >= due:
                due = time.monotonic() + run.monitor.options.period_s
                run.publish(bus, "running")
            if options.speed is not None:
                time.sleep(max(0.0, run.elapsed_s / options.speed - (time.monotonic() - begun)))
    run.monitor.flush()
    final = run.report("stopped")
    final = replace(final, events=run.record_events())
    if options.exact is not None:
        curves = run.monitor.exact_curves(final, octaves=options.exact == "octave")
        final = replace(final, evaluation=Evaluation(exact=curves))
    if not final.session.samples:
        raise recording.no_samples()
    for text in final.device.remarks:
        remark(f"{options.path}: {text}")
    if recording.problem is not None:
        remark(recording.problem)
    if bus is not None:
        run.publish(bus, "stopped")
    return final


class _Run:
    """Monitor of one recording; events wait until they are published."""

    def __init__(self, options: ReplayOptions, recording: Recording) -> None:
        header = recording.header or {}
        self.recording = recording
        monitored = pipeline.MonitorOptions(
            guarded=options.guarded,
            precision=options.precision,
            alarm_limits=options.alarm_limits,
            baseline=options.baseline,
            stored=options.exact is not None,
        )
        self.monitor = Monitor(monitored, rate_hz=options.rate_hz or header.get("rate_hz"))
        serial, scheme = header.get("serial"), header.get("driver", registry.DEFAULT_SCHEME)
        id = header.get("id") or (f"{scheme}-{serial}" if serial else "replay")
        settings = header.get("settings", {})
        driver = registry.installed(header.get("driver"))
        self.device = report.DeviceDescription(
            id=id,
            driver=driver.scheme if driver is not None else header.get("driver", recording.driver),
            setting_texts=registry.setting_texts(driver, settings),
            topic=recording.topic,
            model=header.get("model"),
            serial=serial,
            firmware=header.get("firmware"),
            port=options.path,
            alias_factor=header.get("alias_factor"),
            settings=settings,
        )
        self.started = header.get("time")
        self._driver, self._filter = driver or _driver_of(recording), options.filter
        self._events: list[Event] = []  # not published yet
        self._record_events: list[Event] = []  # the first ones of the record
        self._unlisted = 0  # events of the record after these
        self._restarts: Counter[str] = Counter()  # breaks of the record by code
        self._restart_texts: dict[str, str] = {}  # the last one by code

    def feed(self, item: SampleBlock | Gap) -> None:
        """Feed an item to the monitor, as the daemon does."""
        if isinstance(item, SampleBlock):
            self.monitor.feed(item)
            return
        if item.length_s is not None:
            self.monitor.flush()
        self.monitor.gap(item.length_s)

    @property
    def elapsed_s(self) -> float:
        """Length of the recording so far, s."""
        rate = self.monitor.sample_rate_hz
        return self.monitor.samples / rate if rate else 0.0

    def publish(self, bus: Publisher, state: report.State) -> None:
        """Publish a report and the events since the last one; their time and name are those of the replay."""
        current = self.report(state)
        bus.publish(replace(current, device=replace(current.device, id=bus.id)))
        for event in self._events:
            bus.event(replace(event, device=bus.id))
        self._events.clear()

    def report(self, state: report.State) -> report.Report:
        """Return a report of what has been read so far."""
        session = report.SessionCounters(
            started=self.started or self.recording.started,
            discarded_bytes=self.recording.discarded,
            bad_checksums=self.recording.bad_checksums,
            received_bytes=self.recording.fed,
        )
        stream = self.monitor.stream
        own = stream.caveats if stream is not None else ()
        noted = (self.recording.header or {}).get("caveats", own)  # by the daemon, which could ask the device
        truncated = () if self.recording.problem is None else ("truncated",)
        compensated = (caveat for caveat in own if caveat == "compensated")
        device, remark = self._filtered()
        aliased = ("aliased",) if device is not self.device and (device.alias_factor or 1.0) > ALIASED else ()
        caveats = tuple(dict.fromkeys((*noted, *compensated, *aliased, *truncated)))
        now = datetime.now(UTC)
        current = self.monitor.report(now, device, state, session, device_caveats=caveats)
        for event in self.monitor.events():
            self._note(event.stamped(now, self.device.id))
            if event.kind == "restart":
                self._restarts[event.code] += 1
                self._restart_texts[event.code] = event.text
        breaks = [
            f"{self._restart_texts[code]}{f' (the last of {n:,} such events)' if n > 1 else ''}"
            for code, n in self._restarts.items()
        ]
        noted, assumed = list(self.recording.remarks), self.recording.assumed_unit
        if assumed in noted and current.session.mostly_excluded:
            noted[noted.index(assumed)] = f"most of it is excluded, as with a wrong unit: {assumed}"
        remarks = tuple(map(report.plain, (*noted, *breaks, *remark)))
        return replace(current, device=replace(current.device, remarks=remarks))

    def _filtered(self) -> tuple[DeviceDescription, tuple[str, ...]]:
        """Return the device with the filter that the user names, and why that is not used."""
        stream, rate = self.monitor.stream, self.monitor.sample_rate_hz
        if self._filter is None or stream is None or rate is None:
            return self.device, ()
        if stream.kind == "deltas":
            return self.device, ("deltas are true averages: --filter is not used",)
        if self.device.alias_factor is not None:
            return self.device, ("it names the filter of the sensor: --filter is not used",)
        factor = self._filter.alias_factor(self._driver, rate)
        given, assumed = f"{self._filter.text}, as given with --filter", self._filter.assumption(self._driver)
        settings = {**self.device.settings, "filter": f"{given}; {assumed}" if assumed else given}
        remark = f"--filter {self._filter.text}: {assumed}; give window and rate, such as 8@1000"
        return replace(self.device, alias_factor=factor, settings=settings), (remark,) if assumed else ()

    def _note(self, event: Event) -> None:
        self._events.append(event)
        if len(self._record_events) < report.MAX_ITEMS:
            self._record_events.append(event)
        else:
            self._unlisted += 1

    def record_events(self) -> tuple[Event, ...]:
        """Return the events of the record in the order of their time; the last one counts those left out."""
        events = sorted(self._record_events, key=lambda event: event.elapsed_s or 0.0)
        if self._unlisted:
            text = f"{self._unlisted + 1:,} later events are not listed"
            events[-1] = replace(events[-1], kind="remark", text=text, channel=None, length_s=None, size=None)
        return tuple(events)


def _driver_of(recording: Recording) -> DeviceDriver | None:
    """Return the driver whose format a recording without a header has; None for a table."""
    return registry.driver(recording.driver) if recording.driver is not None else None
