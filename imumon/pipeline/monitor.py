"""Monitor: samples in, Report out.

    Monitor     chooses the stream, keeps its record, says what may be shown     monitor/__init__.py
    grid        steps to dense blocks, holes and breaks                          monitor/grid.py
    record      every accumulator of one stream                                  monitor/record.py
    findings    fits, spectra and shapes, renewed when the record has grown      monitor/findings.py
    trends      drift and comparisons, renewed now and then                      monitor/trends.py
    verdict     what may be said of all this: caveats, changes, grades           monitor/verdict.py
    describe    results in the words of the report                               monitor/describe.py
    events      what happened, each thing told once                              monitor/events.py

It touches no port, no clock and no log: time is handed in. When several streams are on the line, the best
is characterised (deltas, else uncompensated, else compensated); a better one that turns up later
starts the record anew, for nothing may be mixed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from typing import Any

import numpy.typing as npt

from imumon.noise.grading import LIMITS
from imumon.pipeline import assessment
from imumon.pipeline.accumulators import Accumulators
from imumon.pipeline.analysis import Analysis
from imumon.pipeline.events import DetectedEvent, EventLog
from imumon.pipeline.report_builder import limit_curves, signal
from imumon.report import DeviceDescription, Report, SessionCounters, Signal, State, stamp
from imumon.samples import SampleBlock, Stream
from imumon.timebase.sample_clock import BREAK, PlacedSamples, SampleClock

PATIENCE = 100
"""Samples of a stream without clock and rate after which no better one is waited for."""

PATIENCE_S = 5.0
"""s of such a stream after which none is waited for either: a hundred samples of a slow one take long."""

SAME_RATE = 1e-3
"""Relative difference up to which two intervals are one, learned twice."""

LIMIT_CURVES = limit_curves(LIMITS)

RANK = {"compensated": 0, "uncompensated": 1, "deltas": 2}


class RateRequired(Exception):
    """The stream has no clock and nobody told its rate."""


class RecordMismatch(ValueError):
    """A saved record is whole, but of a run that counted other samples."""


@dataclass(frozen=True, slots=True)
class MonitorOptions:
    """How to monitor.

    Attributes
    ----------
    guarded : cut out disturbances, motion and warm-up.
    precision : asked 95 % half-width by coefficient, as a share of its value.
    period_s : s, between two reports.
    baseline : an earlier report of this sensor, to compare with; None: there is none.
    """

    guarded: bool = True
    precision: Mapping[str, float] = field(default_factory=lambda: {"N": 0.01, "B": 0.2, "K": 0.5})
    period_s: float = 1.0
    baseline: Report | None = None


class Monitor:
    """Feed it sample blocks, ask it for a report.

    Attributes
    ----------
    stream : the one that is characterised, None before the first sample.
    refused : why a saved record could not be taken up, once it is known; None: it was, or there was none.
    rate_hz : told from outside: by the sensor's registers or by the user; None where nobody knows.
    """

    def __init__(self, wanted: MonitorOptions | None = None, *, rate_hz: float | None = None) -> None:
        self.wanted = wanted or MonitorOptions()
        self.rate_hz = rate_hz
        self.stream: Stream | None = None
        self.restarts = 0
        self._timeline: SampleClock | None = None
        self._record: Accumulators | None = None
        self._findings: Analysis | None = None
        self._events = EventLog()
        self._unrated = ""  # message of a stream that wants a rate
        self._waited, self._waited_s = 0, 0.0
        self._passed_s = 0.0  # of the room, with blocks of other streams
        self._resumed: tuple[Stream, SampleClock, Accumulators, int] | None = None
        self.refused: str | None = None

    def feed(self, block: SampleBlock, *, room_s: float | None = None) -> None:
        """Take a block; those of other streams than the characterised one are passed over.

        Parameters
        ----------
        room_s : s of the sensor's time since the last call by another clock; None where nobody knows.

        Raises
        ------
        RateNeeded : the stream has no clock and no rate was given.
        """
        passed = None if room_s is None else self._passed_s + room_s
        if not len(block) or not self._chosen(block.stream):
            self._passed_s = passed or 0.0
            self._without_rate(block, room_s or 0.0)
            return
        assert self._timeline is not None
        self._passed_s = 0.0
        for placed in self._timeline.place(block, room_s=passed):
            self._take(placed)
        rest = self._timeline.rest
        if self._timeline.changed and rest is not None:
            self._begin_anew(
                f"of another rate, {self.sample_rate_hz or 0.0:g} Hz", "the sensor's rate has changed"
            )
            self._timeline = SampleClock(rest.stream.clock)
            self.feed(rest)

    def _without_rate(self, block: SampleBlock, room_s: float) -> None:
        """Ask for the rate of a stream without a clock, unless another one comes soon."""
        if self.stream is None:
            self._unrated = block.stream.source
            self._waited += len(block)
            self._waited_s += room_s
            if self._waited > PATIENCE or self._waited_s > PATIENCE_S:
                raise self._rate_needed()

    def _rate_needed(self) -> RateRequired:
        return RateRequired(f"{self._unrated} has no clock: give its sample rate with --rate")

    def _begin_anew(self, refused: str, why: str) -> None:
        """The record that was is over; nothing of it goes on."""
        if self._record is not None:
            self.refused = refused
            self.restarts += 1
        self._events.tell("restart", f"{why}: a new record begins", self._record)
        self._record = self._findings = None

    def gap(self, length_s: float | None = None) -> None:
        """The link was lost, about so long by the room's clock; the sensor's tells exactly, later."""
        if self._timeline is not None:
            self._timeline.gap(length_s)

    def flush(self) -> None:
        """The stream has ended or stands still: let nothing be held back.

        Raises
        ------
        RateNeeded : there was nothing but a stream without a clock, and no rate was given.
        """
        if self.stream is None and self._unrated:
            raise self._rate_needed()
        if self._timeline is not None:
            for placed in self._timeline.finish():
                self._take(placed)
        if self._record is not None:
            self._record.flush()
            self._events.from_guards(self._record)

    def events(self) -> list[DetectedEvent]:
        """What happened since the last call, in order."""
        return self._events.take()

    @property
    def samples(self) -> int:
        """Samples received in the record so far."""
        return self._record.samples if self._record else 0

    @property
    def sample_rate_hz(self) -> float | None:
        """Rate of the grid, None before it is known."""
        return 1.0 / self._record.interval_s if self._record else None

    def report(
        self,
        now: datetime,
        device: DeviceDescription,
        state: State,
        session: SessionCounters,
        *,
        device_caveats: tuple[str, ...] = (),
        speed: float = 1.0,
    ) -> Report:
        """Everything known now.

        Parameters
        ----------
        now : time of the report.
        device, session : as the caller knows them (identity, link counters); the rest is filled in here.
        device_caveats : from the stream and the sensor's settings, such as ``aliased``.
        """
        session = self._session(session)
        device = self._device(device)
        bare = Report(
            time=stamp(now),
            device=device,
            state=state,
            session=session,
            period_s=self.wanted.period_s,
            speed=speed,
        )
        record, findings = self._record, self._findings
        if record is None or findings is None:
            return bare
        findings.renew(now=state != "running")
        caveats = (*device_caveats, *assessment.caveats(record, guarded=self.wanted.guarded))
        changes = assessment.changes(record, findings, self.wanted.baseline)
        obstacle = assessment.obstacle(record)
        grades = assessment.grades(findings, obstacle)
        self._events.from_constants(assessment.constants(findings), record)
        self._events.from_changes(changes, record)
        self._events.from_grades(grades, record)
        channels = assessment.channels(record, findings, caveats, changes, obstacle)
        self._events.from_warming(record, any("warming_up" in made.caveats for made in channels.values()))
        return replace(
            bare,
            grade=grades,
            channels=channels,
            caveats=tuple(dict.fromkeys(caveats)),
            limits=LIMITS,
            limit_curves=LIMIT_CURVES,
        )

    @property
    def renewals(self) -> int:
        """How often all that is dear was worked out, which takes memory that is free again then."""
        return self._findings.renewals if self._findings else 0

    def signals(self, channels: Iterable[str]) -> dict[str, Signal]:
        """What a signal view draws of some channels: strips; histogram and spectrum are in the report."""
        record = self._record
        if record is None:
            return {}
        return {
            name: signal(name, record.strip, record.channels.index(name), record.interval_s)
            for name in channels
            if name in record.channels
        }

    def save(self) -> tuple[dict[str, Any], Mapping[str, npt.NDArray[Any]]]:
        """State that `resume` continues from; only of a monitor that has samples.

        Returns
        -------
        meta : JSON values.
        arrays : small arrays by name.
        """
        assert self.stream is not None
        assert self._timeline is not None
        assert self._record is not None
        meta, arrays = self._record.save()
        whole = {
            "stream": asdict(self.stream),
            "timeline": self._timeline.save(),
            "record": meta,
            "guarded": self.wanted.guarded,
            "restarts": self.restarts,
        }
        return whole, arrays

    def resume(self, meta: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]], away_s: float) -> None:
        """Take up a saved record, once the first samples show that the stream is the same.

        Parameters
        ----------
        meta, arrays : as `save` gave them.
        away_s : s of the sensor's time since it was saved, as far as the room's clock tells.

        Raises
        ------
        OtherRun : it was made with the guards on, and they are off, or the other way round.
        KeyError, ValueError, TypeError : not a state of this version.
        """
        stream = Stream(**(dict(meta["stream"]) | {"channels": tuple(meta["stream"]["channels"])}))
        if bool(meta["guarded"]) != self.wanted.guarded:
            raise RecordMismatch("of a run with the guards " + ("on" if meta["guarded"] else "off"))
        timeline = SampleClock.restore(stream.clock, dict(meta["timeline"]))
        timeline.gap(away_s)
        interval = float(meta["timeline"]["interval_s"])
        record = self._new_record(stream, interval)
        record.resume(meta["record"], dict(arrays))
        self._resumed = (stream, timeline, record, int(meta["restarts"]))

    def take_up(self) -> None:
        """Stand by the record that `resume` took, with no sample to confirm it: to report, not to go on."""
        if self._resumed is not None:
            self._take_up(self._resumed[0], None)

    def _take_up(self, stream: Stream, interval: float | None) -> bool:
        """Whether the saved record is one of this stream; else it is refused, with the reason."""
        if self._resumed is None:
            return False
        saved, timeline, record, restarts = self._resumed
        self._resumed = None
        known = record.interval_s
        if saved != stream:
            self.refused = f"of another stream, {saved.kind} from {saved.source}"
        elif stream.clock == "none" and interval is not None and abs(interval / known - 1.0) > 1e-6:
            self.refused = f"of another rate, {1.0 / known:g} Hz"
        else:
            self.stream, self._timeline, self.restarts = stream, timeline, restarts
            self._begin(record)
            self._events.resumed(record)
            return True
        return False

    def _chosen(self, stream: Stream) -> bool:
        """Whether `stream` is the one to characterise; a better one starts a new record."""
        now = self.stream
        if now is not None:
            if stream == now:
                return True
            if _rank(stream) <= _rank(now):
                return False
            better = f"a better stream is on the line, {stream.kind} from {stream.source}"
            self._begin_anew(f"of another stream, {now.kind} from {now.source}", better)
        interval = stream.interval_s
        if interval is None and self.rate_hz is not None:
            interval = 1.0 / self.rate_hz
        if self._take_up(stream, interval):
            return True
        if stream.clock == "none" and interval is None:
            return False
        self.stream = stream
        self._timeline = SampleClock(stream.clock, interval)
        return True

    def _take(self, placed: PlacedSamples) -> None:
        """Samples with their place, into the record."""
        assert self.stream is not None
        assert self._timeline is not None
        if self._record is None:
            interval = self._timeline.interval_s
            assert interval is not None
            self._begin(self._new_record(self.stream, interval))
        elif abs(self._record.interval_s / (self._timeline.interval_s or 1.0) - 1.0) > SAME_RATE:
            known = f"of another rate, {1.0 / self._record.interval_s:g} Hz"
            self._begin_anew(known, "the sensor's rate is not that of the saved record")
            placed.steps[0] = 1
            self._take(placed)
            return
        assert self._record is not None
        breaks = int((placed.steps == BREAK).sum())
        if breaks:
            self.restarts += breaks
            self._events.tell(
                "restart", "the sensor's clock began anew: a gap of unknown length", self._record
            )
        self._record.feed(placed)
        self._events.from_guards(self._record)

    def _new_record(self, stream: Stream, interval_s: float) -> Accumulators:
        return Accumulators(
            stream.channels, interval_s, averaged=stream.averaged, guarded=self.wanted.guarded
        )

    def _begin(self, record: Accumulators) -> None:
        assert self.stream is not None
        self._record = record
        averaged = self.stream.averaged
        self._findings = Analysis(record, averaged=averaged, precision=self.wanted.precision)

    def _session(self, link: SessionCounters) -> SessionCounters:
        """The caller's counters with those of the record."""
        record, timeline = self._record, self._timeline
        if record is None:
            return link
        self._events.from_gaps(record)
        return replace(
            link,
            elapsed_s=record.elapsed_s,
            samples=record.samples,
            missing=record.missing,
            gaps=record.gaps,
            duplicates=timeline.duplicates if timeline else 0,
            disturbances=record.disturbances,
            excluded_s=record.excluded_s,
            excluded_by=record.excluded_by,
            warmup_s=record.warmup_s,
            restarts=link.restarts + self.restarts,
        )

    def _device(self, device: DeviceDescription) -> DeviceDescription:
        """The caller's facts, filled in with what the samples themselves say."""
        if self.stream is None:
            return device
        return replace(
            device,
            stream=self.stream.kind,
            source=self.stream.source,
            clock=self.stream.clock,
            sample_rate_hz=self.sample_rate_hz or device.sample_rate_hz,
            alias_factor=1.0 if self.stream.kind == "deltas" else device.alias_factor,
        )


def _rank(stream: Stream) -> tuple[int, int, int]:
    """Which of two streams is to be characterised: the greater."""
    return (
        RANK[stream.kind],
        sum(name.startswith(("gyro", "accel")) for name in stream.channels),
        len(stream.channels),
    )
