"""Monitor: samples in, Report out.

    monitor         chooses the stream, keeps its record, makes the report
    gap_fill        steps of the sample clock to dense blocks, long gaps and breaks
    accumulators    every accumulator of one stream
    analysis        fits, spectra and shapes, recomputed when the record has grown
    assessment      what the results mean: caveats, changes, grades
    report_builder  results as parts of the report
    events          what happened, each thing once
    exact_curve     Allan deviation of all samples, on request
    periods         10 minutes, hours and days, for the history
    loss            the share of samples that the link loses

The pipeline does no I/O and reads no clock: time is an argument. If several streams arrive, the best one is
characterised: deltas, else uncompensated, else compensated. A better stream that appears later starts a new
record, because streams must not be mixed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from typing import Any

import numpy.typing as npt

from imumon.alarms import DEFAULT_LIMITS
from imumon.errors import ImumonError, RateRequired
from imumon.evaluation import ExactCurve
from imumon.history_report import HistoryPeriod
from imumon.noise.grading import LIMITS
from imumon.pipeline import assessment
from imumon.pipeline.accumulators import Accumulators
from imumon.pipeline.analysis import Analysis
from imumon.pipeline.events import DetectedEvent, EventLog
from imumon.pipeline.exact_curve import exact_curves
from imumon.pipeline.loss import LossWindow
from imumon.pipeline.periods import Periods
from imumon.pipeline.report_builder import limit_curves, signal
from imumon.report import DeviceDescription, Report, SessionCounters, Signal, State, stamp
from imumon.samples import SampleBlock, Stream
from imumon.timebase.sample_clock import BREAK, PlacedSamples, SampleClock

NO_CLOCK_SAMPLES = 100
"""Samples of a stream without clock and rate after which the monitor stops waiting for another stream: a
device that sends several streams has sent all of them by then."""

NO_CLOCK_S = 5.0
"""s, the same limit by the host clock, because 100 samples of a slow stream take long."""

SAME_INTERVAL = 1e-3
"""Relative difference up to which a measured interval is that of the record: clocks agree to 1e-4."""

SAME_GIVEN_RATE = 1e-6
"""Relative difference up to which two configured rates are the same: they are equal but for rounding."""

LIMIT_CURVES = limit_curves(LIMITS)

STREAM_RANK = {"compensated": 0, "unknown": 1, "uncompensated": 2, "deltas": 3}
"""Rank of a kind of stream: the highest is characterised."""


class RecordMismatch(ImumonError):
    """A record cannot be continued: ``other_guards``, ``other_stream`` or ``other_rate``.

    The message completes "the record is ...".
    """


@dataclass(frozen=True, slots=True)
class MonitorOptions:
    """How to monitor.

    Attributes
    ----------
    guarded : exclude disturbances, motion and warm-up.
    precision : target of the 95 % half-width by coefficient, as a share of the value.
    period_s : s, between two reports.
    baseline : an earlier report of this sensor to compare with; None: there is none.
    stored : keep all samples, for `Monitor.exact_curves`: memory grows with the record.
    periods : keep what happens in every 10 minutes, hour and day until `Monitor.periods` returns it.
    alarm_limits : by name of the alarm; see `imumon.alarms`.
    """

    guarded: bool = True
    precision: Mapping[str, float] = field(default_factory=lambda: {"N": 0.01, "B": 0.2, "K": 0.5})
    period_s: float = 1.0
    baseline: Report | None = None
    stored: bool = False
    periods: bool = False
    alarm_limits: Mapping[str, float] = field(default_factory=lambda: DEFAULT_LIMITS)


@dataclass(frozen=True, slots=True)
class _RestoredRecord:
    """A restored record that waits for the first samples to confirm its stream."""

    stream: Stream
    clock: SampleClock
    record: Accumulators
    restarts: int
    periods: Mapping[str, Any] | None


class Monitor:
    """Turn sample blocks into reports.

    Parameters
    ----------
    rate_hz : Hz, configured rate, for a stream without a clock; None: unknown.

    Attributes
    ----------
    options : how to monitor.
    stream : the stream that is characterised; None before the first sample.
    mismatch : why the record before this one could not be continued; None: it was, or there was none. The
        caller resets it.
    rate_hz : Hz; the caller may set it when the device reports its rate.
    restarts : breaks of unknown length and new records.
    """

    def __init__(self, options: MonitorOptions | None = None, *, rate_hz: float | None = None) -> None:
        self.options = options or MonitorOptions()
        self.rate_hz = rate_hz
        self.stream: Stream | None = None
        self.mismatch: RecordMismatch | None = None
        self.restarts = 0
        self._clock: SampleClock | None = None
        self._record: Accumulators | None = None
        self._analysis: Analysis | None = None
        self._periods: Periods | None = None
        self._finished_periods: list[HistoryPeriod] = []
        self._events = EventLog()
        self._loss: LossWindow | None = None
        self._restored: _RestoredRecord | None = None
        self._no_clock_source = ""  # message of a stream that needs a rate
        self._no_clock_samples, self._no_clock_s = 0, 0.0
        self._other_streams_s = 0.0  # by the host clock, since the last block of this stream

    def feed(self, block: SampleBlock, *, host_s: float | None = None) -> None:
        """Process a block. Blocks of other streams than the characterised one are ignored.

        Parameters
        ----------
        host_s : s of device time since the last call, by the host clock; None: unknown.

        Raises
        ------
        RateRequired : the stream has no clock and no rate is configured.
        """
        passed = None if host_s is None else self._other_streams_s + host_s
        if not len(block) or not self._select(block.stream):
            self._other_streams_s = passed or 0.0
            self._count_without_rate(block, host_s or 0.0)
            return
        assert self._clock is not None
        self._other_streams_s = 0.0
        for placed in self._clock.place(block, host_s=passed):
            self._accumulate(placed)
        if (rest := self._clock.rest) is not None:
            self._start_new_record("other_rate", "the sample rate of the sensor has changed")
            self._clock = SampleClock(rest.stream.clock, tick_s=rest.stream.tick_s)
            self.feed(rest)

    def gap(self, length_s: float | None = None) -> None:
        """Note that the connection was interrupted for `length_s` by the host clock; None: unknown."""
        if self._clock is not None:
            self._clock.gap(length_s)
        if self._loss is not None:
            self._loss.restart()

    def flush(self) -> None:
        """Process everything that is held back: the stream has ended or is interrupted.

        Raises
        ------
        RateRequired : there was only a stream without a clock, and no rate is configured.
        """
        if self.stream is None and self._no_clock_source:
            raise self._rate_required()
        if self._clock is not None:
            for placed in self._clock.finish():
                self._accumulate(placed)
        if self._record is not None:
            self._flush_record(self._record)

    def _flush_record(self, record: Accumulators) -> None:
        """Process the samples that the guard holds back, and report what waits for later ones."""
        record.flush()
        self._update_periods(record)
        self._events.update_guard(record)
        self._events.report_gaps(record.elapsed_s, record)

    def events(self) -> list[DetectedEvent]:
        """Return what happened since the last call, in order."""
        return self._events.drain()

    def periods(self) -> list[HistoryPeriod]:
        """Return the periods that ended since the last call, of `MonitorOptions.periods`."""
        finished, self._finished_periods = self._finished_periods, []
        return finished

    def _update_periods(self, record: Accumulators) -> None:
        if self._periods is None:
            record.history.finished_stretches()
        else:
            self._periods.update()
            self._finished_periods += self._periods.drain()

    def periods_in_progress(self, *, force: bool = False) -> list[HistoryPeriod]:
        """Return the periods in progress; those of an earlier call unless they have grown, or with `force`."""
        return [] if self._periods is None else self._periods.in_progress(force=force)

    def end_record(self) -> None:
        """End the periods in progress: no samples follow in this record."""
        if self._periods is not None:
            self._periods.end()
            self._finished_periods += self._periods.drain()

    @property
    def samples(self) -> int:
        """Samples received in the record so far."""
        return self._record.samples if self._record else 0

    @property
    def sample_rate_hz(self) -> float | None:
        """Rate of the grid; None before it is known."""
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
        """Return everything known at the time `now`.

        Parameters
        ----------
        device, session : what the caller knows (identity, link counters); the monitor adds the rest.
        device_caveats : from the stream and the settings of the sensor, such as ``aliased``.
        speed : device seconds per second of the host clock.
        """
        counters, described = self._counters(session), self._described(device)
        period_s = self.options.period_s
        bare = Report(
            time=stamp(now),
            device=described,
            state=state,
            session=counters,
            period_s=period_s,
            speed=speed,
            precision=self.options.precision,
            alarm_limits=self.options.alarm_limits,
        )
        record, analysis = self._record, self._analysis
        if record is None or analysis is None:
            return bare
        analysis.update(force=state != "running")
        caveats = (
            *device_caveats,
            *assessment.record_caveats(record, analysis, guarded=self.options.guarded),
        )
        changes = assessment.detect_changes(record, analysis, self.options.baseline)
        reason = assessment.no_grade_reason(record)
        grades = assessment.sensor_grades(analysis, reason)
        self._events.update_constant(assessment.constant_channels(analysis), record)
        self._events.update_changes(changes, record)
        self._events.update_grades(grades, record)
        channels = assessment.assess_channels(record, analysis, caveats, changes, reason)
        warming_up = any("warming_up" in each.caveats for each in channels.values())
        self._events.update_warmup(record, warming_up, heats_up=analysis.heats_up)
        made = replace(
            bare,
            grade=grades,
            channels=channels,
            caveats=tuple(dict.fromkeys(caveats)),
            limits=LIMITS,
            limit_curves=LIMIT_CURVES,
        )
        self._events.update_alarms(made, record)
        return made

    def signals(self, channels: Iterable[str]) -> dict[str, Signal]:
        """Return minimum and maximum per time column of some channels."""
        record = self._record
        return {
            name: signal(name, record.envelope, record.channels.index(name), record.interval_s)
            for name in channels
            if record is not None and name in record.channels
        }

    def exact_curves(self, report: Report, *, octaves: bool = True) -> dict[str, ExactCurve]:
        """Return the fully overlapping Allan deviation by channel; empty unless the samples are stored."""
        record = self._record
        if record is None or record.store is None:
            return {}
        channels = {name: report.channels[name] for name in record.channels[: record.allan_channels]}
        return exact_curves(record.store, channels, record.interval_s, octaves=octaves)

    # ------------------------------------------------------------------ saved state

    def save(self) -> tuple[dict[str, Any], Mapping[str, npt.NDArray[Any]]]:
        """Return the state that `restore` continues from. The monitor must have samples.

        Returns
        -------
        meta : JSON values.
        arrays : small arrays by name.
        """
        assert self.stream is not None
        assert self._clock is not None
        assert self._record is not None
        record, arrays = self._record.save()
        meta = {
            "stream": asdict(self.stream),
            "clock": self._clock.save(),
            "record": record,
            "guarded": self.options.guarded,
            "restarts": self.restarts,
            "periods": self._periods.save() if self._periods is not None else None,
        }
        return meta, arrays

    def restore(self, meta: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]], away_s: float) -> None:
        """Continue a saved record as soon as the first samples show that the stream is the same.

        Parameters
        ----------
        meta, arrays : from `save`.
        away_s : s of device time since it was saved, by the host clock.

        Raises
        ------
        RecordMismatch : it was made with guards and they are off, or the other way round.
        KeyError, ValueError, TypeError : not a state of this version.
        """
        stream = Stream(**(dict(meta["stream"]) | {"channels": tuple(meta["stream"]["channels"])}))
        if bool(meta["guarded"]) != self.options.guarded:
            setting = "on" if meta["guarded"] else "off"
            raise RecordMismatch("other_guards", f"of a run with the guards {setting}")
        clock = SampleClock.restore(stream.clock, dict(meta["clock"]), stream.tick_s)
        clock.gap(away_s)
        record = self._new_record(stream, float(meta["clock"]["interval_s"]))
        record.restore(meta["record"], dict(arrays))
        restarts, periods = int(meta["restarts"]), meta.get("periods")
        self._restored = _RestoredRecord(stream, clock, record, restarts, periods)

    def accept_restored(self) -> None:
        """Use the restored record without samples that confirm its stream: to report, not to continue."""
        if self._restored is not None:
            self._continue_restored(self._restored.stream, None)

    def _continue_restored(self, stream: Stream, interval_s: float | None) -> bool:
        """Return whether the restored record belongs to `stream` and is continued; else note why not."""
        restored, self._restored = self._restored, None
        if restored is None:
            return False
        known = restored.record.interval_s
        if restored.stream != stream:
            self.mismatch = _mismatch("other_stream", restored.stream, known)
            return False
        configured = interval_s if stream.clock == "none" else None
        if configured is not None and abs(configured / known - 1.0) > SAME_GIVEN_RATE:
            self.mismatch = _mismatch("other_rate", stream, known)
            return False
        self.stream, self._clock, self.restarts = stream, restored.clock, restored.restarts
        self._set_record(restored.record)
        if self._periods is not None:
            self._periods.restore(restored.periods)
        self._events.record_restored(restored.record)
        return True

    # ------------------------------------------------------------------ streams and records

    def _select(self, stream: Stream) -> bool:
        """Return whether `stream` is the one to characterise. A better one starts a new record."""
        current = self.stream
        if current is not None:
            if stream == current:
                return True
            if _rank(stream) <= _rank(current):
                return False
            cause = f"there is a better stream, {stream.kind} from {stream.source}"
            self._start_new_record("other_stream", cause)
        interval = stream.interval_s
        if interval is None and self.rate_hz is not None:
            interval = 1.0 / self.rate_hz
        if self._continue_restored(stream, interval):
            return True
        if stream.clock == "none" and interval is None:
            return False
        self.stream = stream
        self._clock = SampleClock(stream.clock, interval, stream.tick_s)
        return True

    def _count_without_rate(self, block: SampleBlock, host_s: float) -> None:
        """Require a rate for a stream without a clock, unless another stream appears soon."""
        if self.stream is None:
            self._no_clock_source = block.stream.source
            self._no_clock_samples += len(block)
            self._no_clock_s += host_s
            if self._no_clock_samples > NO_CLOCK_SAMPLES or self._no_clock_s > NO_CLOCK_S:
                raise self._rate_required()

    def _rate_required(self) -> RateRequired:
        text = f"{self._no_clock_source} has no clock"
        return RateRequired("rate_required", text, "give its sample rate with --rate")

    def _accumulate(self, placed: PlacedSamples) -> None:
        """Add placed samples to the record; samples of another interval start a new one."""
        assert self.stream is not None
        assert self._clock is not None
        interval = self._clock.interval_s
        record = self._record
        if record is not None and abs(record.interval_s / (interval or 1.0) - 1.0) > SAME_INTERVAL:
            cause = "the sample rate of the sensor is not that of the saved record"
            self._start_new_record("other_rate", cause)
            placed.steps[0] = 1
        if self._record is None:
            assert interval is not None
            self._set_record(self._new_record(self.stream, interval))
        assert self._record is not None
        self.restarts += int((placed.steps == BREAK).sum())
        assert self._loss is not None
        self._record.feed(placed)
        self._update_periods(self._record)
        self._events.update_clock(placed.steps, self._record)
        self._events.update_gaps(placed.steps, self._record)
        self._events.update_guard(self._record)
        for age_s, share, full in self._loss.update(placed.steps):
            elapsed_s = self._record.elapsed_s - age_s
            self._events.update_alarm("loss", share, self.options.alarm_limits["loss"], elapsed_s, ends=full)

    def _new_record(self, stream: Stream, interval_s: float) -> Accumulators:
        guarded, stored = self.options.guarded, self.options.stored
        averaged = stream.averaged
        return Accumulators(stream.channels, interval_s, averaged=averaged, guarded=guarded, stored=stored)

    def _set_record(self, record: Accumulators) -> None:
        assert self.stream is not None
        self._record = record
        self._loss = LossWindow(record.interval_s)
        averaged, precision = self.stream.averaged, self.options.precision
        self._analysis = Analysis(record, averaged=averaged, precision=precision)
        self._periods = None
        if self.options.periods:
            self._periods = Periods(record, self._analysis, averaged=averaged)

    def _start_new_record(self, code: str, cause: str) -> None:
        """End the record; the next samples start a new one. `code` is that of a `RecordMismatch`."""
        if self._record is not None and self.stream is not None:
            self.mismatch = _mismatch(code, self.stream, self._record.interval_s)
            self.restarts += 1
            self._flush_record(self._record)
        self._events.add("restart", f"{cause}: a new record begins", self._record, code=code)
        self.end_record()
        self._events.record_began()
        self._record = self._analysis = self._periods = self._loss = None

    # ------------------------------------------------------------------ parts of the report

    def _counters(self, link: SessionCounters) -> SessionCounters:
        """Return the counters of the caller with those of the record."""
        record, clock = self._record, self._clock
        if record is None:
            return link
        return replace(
            link,
            elapsed_s=record.elapsed_s,
            samples=record.samples,
            missing=record.missing,
            gaps=record.gaps,
            duplicates=clock.duplicates if clock else 0,
            disturbances=record.disturbances,
            excluded_s=record.excluded_s,
            excluded_by=record.excluded_by,
            warmup_s=record.warmup_s,
            restarts=link.restarts + self.restarts,
            recent_loss=self._loss.share if self._loss else None,
        )

    def _described(self, device: DeviceDescription) -> DeviceDescription:
        """Return the description of the caller with what the samples show."""
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


def _mismatch(code: str, stream: Stream, interval_s: float) -> RecordMismatch:
    """Return why a record of a stream and an interval, s, cannot be continued."""
    rate = f"rate, {1.0 / interval_s:g} Hz"
    other = rate if code == "other_rate" else f"stream, {stream.kind} from {stream.source}"
    return RecordMismatch(code, f"of another {other}")


def _rank(stream: Stream) -> tuple[int, int, int]:
    """Return the rank of a stream: the stream of the highest rank is characterised."""
    return (
        STREAM_RANK[stream.kind],
        sum(name.startswith(("gyro", "accel")) for name in stream.channels),
        len(stream.channels),
    )
