"""Replay: the same loop over a file.

Bytes come from a recording instead of a port and go through the same decoder and monitor. Time is the
record's own; nothing waits unless a speed is asked for.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TextIO

from imumon import report
from imumon.bus import Publisher
from imumon.monitor import Monitor, Wanted
from imumon.samples import SampleBlock
from imumon.sensors.vn100 import Decoder
from imumon.sources import Recording, SourceError, read_file

BAR_S = 0.1
BAR_WIDTH = 32


class NotARecording(SourceError):
    """The file holds nothing that can be characterised."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """How to replay.

    Attributes
    ----------
    speed : times real time; None: as fast as it goes.
    baseline : an earlier report of the same sensor, to compare with.
    """

    path: str
    rate_hz: float | None = None
    speed: float | None = None
    guarded: bool = True
    baseline: report.Report | None = None


def replay(
    task: Replay,
    *,
    progress: Callable[[float | None, float], None] | None = None,
    bus: Publisher | None = None,
) -> report.Report:
    """Run a recording through the pipeline; the final report.

    Parameters
    ----------
    progress : told the share of the file that is done and the sensor seconds so far, now and then.
    bus : publishes a report every second.

    Raises
    ------
    SourceError : the file cannot be read, or holds no samples. RateNeeded : its stream has no clock.
    """
    recording = read_file(task.path)
    run = _Run(task, recording)
    pace = _Pace(task.speed)
    due = 0.0
    for data in recording:
        run.take(data)
        if progress is not None:
            progress(recording.progress, run.elapsed_s)
        if bus is not None and time.monotonic() >= due:
            due = time.monotonic() + 1.0
            bus.publish(run.report("running"))
        pace.keep(run.elapsed_s)
    run.finish()
    final = run.report("stopped")
    if not final.session.samples:
        raise NotARecording(run.verdict())
    if bus is not None:
        bus.publish(final)
    return final


class _Run:
    """Decoder and monitor of one recording."""

    def __init__(self, task: Replay, recording: Recording) -> None:
        header = recording.header or {}
        self.recording = recording
        self.decoder = Decoder()
        rate = task.rate_hz or _number(header.get("rate_hz"))
        self.monitor = Monitor(Wanted(guarded=task.guarded, baseline=task.baseline), rate_hz=rate)
        self.device = report.Device(
            id=header.get("id") or (f"vn100-{header['serial']}" if header.get("serial") else "replay"),
            model=header.get("model"),
            serial=header.get("serial"),
            firmware=header.get("firmware"),
            port=task.path,
            alias_factor=_number(header.get("alias_factor")),
            settings=header.get("settings") or {},
        )
        self.started = header.get("time")

    @property
    def elapsed_s(self) -> float:
        rate = self.monitor.sample_rate_hz
        return self.monitor.samples / rate if rate else 0.0

    def take(self, data: bytes) -> None:
        for item in self.decoder.feed(data):
            if isinstance(item, SampleBlock):
                self.monitor.feed(item)

    def finish(self) -> None:
        for item in self.decoder.finish():
            if isinstance(item, SampleBlock):
                self.monitor.feed(item)
        self.monitor.flush()

    def report(self, state: report.State) -> report.Report:
        decoder = self.decoder
        session = report.Session(
            started=self.started,
            discarded_bytes=decoder.discarded,
            bad_checksums=decoder.bad_checksums,
            received_bytes=decoder.fed,
        )
        stream = self.monitor.stream
        noted = (self.recording.header or {}).get("caveats", ())
        caveats = ("compensated",) if stream is not None and stream.kind == "compensated" else ()
        caveats = tuple(dict.fromkeys((*noted, *caveats)))
        return self.monitor.report(datetime.now(UTC), self.device, state, session, device_caveats=caveats)

    def verdict(self) -> str:
        """Why there is nothing to characterise."""
        path, decoder = self.recording.path, self.decoder
        if decoder.messages:
            return f"{path} has {decoder.messages} valid messages but none with gyroscope or accelerometer"
        return f"{path} is no recording of a VN-100: not one valid message in {decoder.fed} bytes"


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


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and value > 0 else None
