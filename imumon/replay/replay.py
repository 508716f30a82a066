"""Replay: the same loop over a file.

Samples come from a recording instead of a port: raw bytes by the same decoder, tables and bags of others
by their readers, and all of them through the same monitor. Time is the record's own; nothing waits unless a
speed is asked for.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Protocol, TextIO

from imumon import pipeline, report
from imumon.bus import Publisher
from imumon.devices import registry
from imumon.devices.vn100 import Vn100Decoder
from imumon.pipeline import Monitor
from imumon.recordings import (
    LinkLoss,
    OptionNotApplicable,
    RateUnknown,
    RawCapture,
    ReadOptions,
    RosbagFile,
    SourceError,
    open_file,
)
from imumon.samples import Kind, SampleBlock

FAST, PACED = 1 << 20, 1 << 12
"""Bytes decoded at once: as many samples as make the work on arrays worth the name; a second or less when a
speed is kept to."""
BAR_S = 0.1
BAR_WIDTH = 32


class NotARecording(SourceError):
    """The file holds nothing that can be characterised."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayOptions:
    """How to replay.

    Attributes
    ----------
    speed : times real time; None: as fast as it goes.
    precision : asked 95 % half-width by coefficient, as a share of its value.
    baseline : an earlier report of the same sensor, to compare with.
    kind : which stream of a table that has several; None: the best.
    columns : channel to ``COLUMN:UNIT`` of a table; empty: by its header.
    topic : of a bag.
    """

    path: str
    rate_hz: float | None = None
    speed: float | None = None
    guarded: bool = True
    precision: Mapping[str, float] = field(default_factory=lambda: {"N": 0.01, "B": 0.2, "K": 0.5})
    baseline: report.Report | None = None
    kind: Kind | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    topic: str | None = None


class Samples(Protocol):
    """A recording of whatever form: iterate to get blocks of samples, and where the link to them was lost.

    Attributes
    ----------
    header : what is known of the sensor, or None.
    problem : after reading: why it ended early, or None.
    remarks : after reading: what was passed over or is doubtful in it, a line each.
    fed, discarded, bad_checksums : bytes read, bytes of no message, messages or rows that were no good.
    """

    @property
    def header(self) -> Mapping[str, Any] | None: ...
    @property
    def problem(self) -> str | None: ...
    @property
    def remarks(self) -> Sequence[str]: ...
    @property
    def fed(self) -> int: ...
    @property
    def discarded(self) -> int: ...
    @property
    def bad_checksums(self) -> int: ...
    @property
    def progress(self) -> float | None: ...
    def __iter__(self) -> Iterator[Sequence[SampleBlock | LinkLoss]]: ...
    def verdict(self) -> str:
        """Why there is nothing to characterise."""


class CaptureSamples:
    """Raw bytes of a sensor.

    Parameters
    ----------
    piece : bytes that are decoded at once.
    """

    remarks: Sequence[str] = ()

    def __init__(self, recording: RawCapture, piece: int) -> None:
        self.header = recording.header
        self._recording = recording
        self._piece = piece
        self._decoder = Vn100Decoder()

    @property
    def problem(self) -> str | None:
        return self._recording.problem

    @property
    def progress(self) -> float | None:
        return self._recording.progress

    @property
    def fed(self) -> int:
        return self._decoder.fed

    @property
    def discarded(self) -> int:
        return self._decoder.discarded

    @property
    def bad_checksums(self) -> int:
        return self._decoder.bad_checksums

    def __iter__(self) -> Iterator[Sequence[SampleBlock | LinkLoss]]:
        for data in _pieces(self._recording.pieces(), self._piece):
            if isinstance(data, LinkLoss):
                yield [data]
                continue
            yield [item for item in self._decoder.feed(data) if isinstance(item, SampleBlock)]
        yield [item for item in self._decoder.finish() if isinstance(item, SampleBlock)]

    def verdict(self) -> str:
        path, decoder = self._recording.path, self._decoder
        if decoder.messages:
            return f"{path} has {decoder.messages} valid messages but none with gyroscope or accelerometer"
        return f"{path} is no recording of a VN-100: not one valid message in {decoder.fed} bytes"


def _pieces(chunks: Iterable[bytes | LinkLoss], size: int) -> Iterator[bytes | LinkLoss]:
    """The same bytes in pieces of about that size, none across a lost link."""
    waiting: list[bytes] = []
    for chunk in chunks:
        if isinstance(chunk, LinkLoss):
            yield b"".join(waiting)
            yield chunk
            waiting = []
            continue
        for at in range(0, len(chunk), size):
            waiting.append(chunk[at : at + size])
            if sum(map(len, waiting)) >= size:
                yield b"".join(waiting)
                waiting = []
    yield b"".join(waiting)


def open_samples(task: ReplayOptions) -> Samples:
    """A recording by what it holds, not by its name alone.

    Raises
    ------
    SourceError : it cannot be read, or is plainly something else. Misused : it is no bag, and has no topic.
    """
    wanted = ReadOptions(task.kind, task.columns, task.rate_hz, task.topic)
    found = open_file(task.path, wanted)
    if task.topic is not None and not isinstance(found, RosbagFile):
        raise OptionNotApplicable(f"--topic is of a bag, and {task.path} is none: leave it out")
    if isinstance(found, RawCapture):
        return CaptureSamples(found, FAST if task.speed is None else PACED)
    return found


def replay(
    task: ReplayOptions,
    *,
    progress: Callable[[float | None, float], None] | None = None,
    bus: Publisher | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> report.Report:
    """Run a recording through the pipeline; the final report.

    Parameters
    ----------
    progress : told the share of the file that is done and the sensor seconds so far, now and then.
    bus : publishes a report every second.
    tell : told in one line each what is doubtful in the recording, and why it ended before its end.

    Raises
    ------
    SourceError : the file cannot be read, or holds no samples. RateNeeded : its stream has no clock.
    """
    samples = open_samples(task)
    run = _Run(task, samples)
    pace = _Pace(task.speed)
    due = 0.0
    try:
        for items in samples:
            for item in items:
                run.take(item)
            if progress is not None:
                progress(samples.progress, run.elapsed_s)
            if bus is not None and time.monotonic() >= due:
                due = time.monotonic() + 1.0
                run.publish(bus, "running")
            pace.keep(run.elapsed_s)
    except RateUnknown as error:
        raise pipeline.RateRequired(str(error)) from None
    run.monitor.flush()
    final = run.report("stopped")
    if not final.session.samples:
        raise NotARecording(samples.verdict())
    for text in final.device.remarks:
        tell(f"{task.path}: {text}")
    if samples.problem is not None:
        tell(samples.problem)
    if bus is not None:
        run.publish(bus, "stopped")
    return final


class _Run:
    """Monitor of one recording; what happened waits until it is published."""

    def __init__(self, task: ReplayOptions, samples: Samples) -> None:
        header = samples.header or {}
        self.samples = samples
        wanted = pipeline.MonitorOptions(
            guarded=task.guarded, precision=task.precision, baseline=task.baseline
        )
        self.monitor = Monitor(wanted, rate_hz=task.rate_hz or header.get("rate_hz"))
        id = header.get("id") or (f"vn100-{header['serial']}" if header.get("serial") else "replay")
        settings = header.get("settings", {})
        driver = registry.driver_of_record(header.get("driver"), header.get("model"), id)
        self.device = report.DeviceDescription(
            id=id,
            driver=driver.scheme if driver is not None else header.get("driver"),
            setting_texts=registry.setting_texts(driver, settings),
            model=header.get("model"),
            serial=header.get("serial"),
            firmware=header.get("firmware"),
            port=task.path,
            alias_factor=header.get("alias_factor"),
            settings=settings,
        )
        self.started = header.get("time")
        self._waiting: list[report.Event] = []
        self._restarts: dict[str, int] = {}  # why the record has a break, and how often

    def take(self, item: SampleBlock | LinkLoss) -> None:
        """As the daemon does."""
        if isinstance(item, SampleBlock):
            self.monitor.feed(item)
            return
        if item.away_s is not None:
            self.monitor.flush()
        self.monitor.gap(item.away_s)

    @property
    def elapsed_s(self) -> float:
        rate = self.monitor.sample_rate_hz
        return self.monitor.samples / rate if rate else 0.0

    def publish(self, bus: Publisher, state: report.State) -> None:
        """A report, and what happened since the last one; their time and name are those of the replay."""
        made = self.report(state)
        bus.publish(replace(made, device=replace(made.device, id=bus.id)))
        for event in self._waiting:
            bus.event(replace(event, device=bus.id))
        self._waiting.clear()

    def _happened(self, now: datetime) -> None:
        """Take what happened since the last call; where the record began anew its reader must know."""
        for found in self.monitor.events():
            self._waiting.append(found.stamped(now, self.device.id))
            if found.kind == "restart":
                self._restarts[found.text] = self._restarts.get(found.text, 0) + 1

    def report(self, state: report.State) -> report.Report:
        session = report.SessionCounters(
            started=self.started,
            discarded_bytes=self.samples.discarded,
            bad_checksums=self.samples.bad_checksums,
            received_bytes=self.samples.fed,
        )
        stream = self.monitor.stream
        noted = (self.samples.header or {}).get("caveats")  # by whoever could ask the sensor
        own = stream.caveats if stream is not None else ()
        caveats = (*(own if noted is None else noted), *(word for word in own if word == "compensated"))
        cut = ("truncated",) if self.samples.problem is not None else ()
        caveats = tuple(dict.fromkeys((*caveats, *cut)))
        now = datetime.now(UTC)
        made = self.monitor.report(now, self.device, state, session, device_caveats=caveats)
        self._happened(now)
        breaks = [f"{text} ({many:,} times)" if many > 1 else text for text, many in self._restarts.items()]
        remarks = tuple(map(report.plain, (*self.samples.remarks, *breaks)))
        return replace(made, device=replace(made.device, remarks=remarks))


class _Pace:
    """Keeps to a multiple of real time."""

    def __init__(self, speed: float | None) -> None:
        self._speed, self._begun = speed, time.monotonic()

    def keep(self, elapsed_s: float) -> None:
        if self._speed is not None:
            ahead = elapsed_s / self._speed - (time.monotonic() - self._begun)
            if ahead > 0.0:
                time.sleep(ahead)


def bar(stream: TextIO = sys.stderr) -> Callable[[float | None, float], None] | None:
    """A progress bar on a terminal; None in a pipe."""
    if not stream.isatty():
        return None
    shown = 0.0

    def draw(share: float | None, elapsed_s: float) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown < BAR_S and share != 1.0:
            return
        shown = now
        if share is None:
            line = f"{elapsed_s:,.0f} s"
        else:
            done = round(share * BAR_WIDTH)
            line = f"{'━' * done}{'╌' * (BAR_WIDTH - done)} {share:4.0%}  {elapsed_s:,.0f} s of record"
        stream.write(f"\r{line}\x1b[K" + ("\r\x1b[K" if share == 1.0 else ""))
        stream.flush()

    return draw
