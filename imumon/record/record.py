"""Record: the samples of one stream from its first one on, and everything that follows from them.

A block of samples goes through four parts:

    clock   gives each sample its place on a grid of equal steps
    guard   holds the samples back until they are assessed, and passes them on, some of them excluded
    sums    are added up over what the guard passes on, for the whole record and for parts of it
    fits    say which coefficients explain the sums; they are renewed when the record has grown

Beside them stands what sees every sample that arrives: the signal view and the loss of the link. What the samples show
goes to a log of events, and each hour and day to a list of periods. A record has five verbs: `feed`, `flush`, `report`,
`save` and `restore`. It does no I/O and reads no clock: time is an argument.

If several streams arrive, the best one is characterised: deltas, else uncompensated, else compensated. A better stream
that appears later begins the record again, and so does another sample rate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np

from imumon.grid.sample_clock import BREAK, PlacedSamples, SampleClock, SavedClock
from imumon.model.coefficients import default_precision
from imumon.model.errors import ImumonError
from imumon.model.grading import LIMITS
from imumon.model.history_report import HistoryPeriod
from imumon.model.ledger import RECEIVED, SAMPLES, Ledger, merged, with_received
from imumon.model.report import (
    MAX_LOSS,
    Channel,
    DeviceDescription,
    Report,
    SensorGrade,
    SessionCounters,
    Signal,
    State,
    stamp,
)
from imumon.model.samples import INERTIAL, WITH_CURVE, ChannelName, SampleBlock, Stream
from imumon.model.saved_state import restorable
from imumon.noise.detection import Guard, GuardedSamples
from imumon.noise.statistics.envelope import Envelope
from imumon.noise.stretches import Sums
from imumon.noise.validity_groups import ValidityGroups
from imumon.record.assessment import Assessment
from imumon.record.convergence import StatementLog, next_due_s
from imumon.record.counts import Counts
from imumon.record.events import DetectedEvent, EventLog
from imumon.record.fits import Fits, Renewal
from imumon.record.gap_fill import Break, InvalidSamples, LongGap, Part, fill_gaps
from imumon.record.loss import LossWindow
from imumon.record.periods import Periods
from imumon.record.report_builder import LIMIT_CURVES, signals
from imumon.record.stream_choice import WithoutRate, rank

SAME_INTERVAL = 1e-3
"""Relative difference up to which a measured interval is that of the record: clocks agree to 1e-4."""


class RecordMismatch(ImumonError):
    """A record cannot be continued: ``other_guards``, ``other_stream`` or ``other_rate``.

    The message completes "the record is ...".
    """


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """What a record does with its samples.

    Attributes
    ----------
    guarded : exclude disturbances, motion and warm-up.
    precision : target of the 95 % half-width by coefficient, as a share of the value.
    period_s : s, between two reports.
    baseline : an earlier report of this sensor to compare with; None: there is none.
    periods : keep what happens in every hour and day until `Record.periods` returns it.
    convergence : fit the record at each doubling of its length, for `Channel.convergence`; fits that happen anyway are
        noted in any case.
    max_loss : share of missing samples in a minute from which there is an alarm.
    """

    guarded: bool = True
    precision: Mapping[str, float] = field(default_factory=default_precision)
    period_s: float = 1.0
    baseline: Report | None = None
    periods: bool = False
    convergence: bool = False
    max_loss: float = MAX_LOSS


restorable(Stream)


@restorable
@dataclass(frozen=True, slots=True, kw_only=True)
class SavedRecord:
    """What a record continues from, in another process.

    Attributes
    ----------
    stream : that is characterised.
    clock : of it.
    guarded : disturbances were excluded.
    restarts, samples, gaps, span : counts of the record.
    guard, sums, envelope : its parts.
    statements : what was stated when it was shorter.
    counted : counts up to the last period, see `Periods.counted`; None: it kept no periods.
    """

    stream: Stream
    clock: SavedClock
    guarded: bool
    restarts: int
    samples: int
    gaps: int
    span: int
    guard: Guard
    sums: Sums
    envelope: Envelope
    statements: StatementLog
    counted: dict[int, dict[str, int]] | None


class Record:
    """The samples of one stream, and their results.

    Parameters
    ----------
    rate_hz : Hz, configured rate, for a stream without a clock; None: unknown.

    Attributes
    ----------
    options : what to do with the samples.
    rate_hz : Hz; the caller may set it when the device reports its rate.
    stream : that is characterised; None before the first sample.
    clock : of this stream; there is none before the first sample.
    begun : whether the interval of the stream is known. What follows is there only then.
    interval_s : s between two ticks of the grid.
    guard, sums, fits : parts of the record, see above.
    samples, gaps, span : received samples; interruptions of them; ticks of the grid.
    restarts : breaks of unknown length, and records that began again.
    ended_periods : that ended since `periods` was called.
    """

    clock: SampleClock
    interval_s: float
    guard: Guard
    sums: Sums
    fits: Fits
    _sensors: ValidityGroups  # channels that share their validity
    _envelope: Envelope
    _loss: LossWindow
    _periods: Periods | None
    _due_s: float  # length at which the record is fitted even if there is no report

    def __init__(self, options: RecordOptions | None = None, *, rate_hz: float | None = None) -> None:
        self.options = options or RecordOptions()
        self.rate_hz = rate_hz
        self.stream: Stream | None = None
        self.begun = False
        self.samples = self.gaps = self.span = self.restarts = 0
        self.ended_periods: list[HistoryPeriod] = []
        self._log = EventLog()
        self._ledger = Ledger()  # of samples that are in no record, and of clocks that have ended
        self._invalid = InvalidSamples()
        self._without_rate = WithoutRate()
        self._other_streams_s = 0.0  # by the host clock, since the last block of this stream
        self._restored: tuple[SavedRecord, float] | None = None  # waits for its stream; s since it was saved
        self._restored_samples = 0  # of the record, received by an earlier run

    # ------------------------------------------------------------------ a block

    def feed(self, block: SampleBlock, *, host_s: float | None = None) -> RecordMismatch | None:
        """Add a block of samples. Blocks of other streams than the characterised one are left out.

        Parameters
        ----------
        host_s : s of device time since the last call, by the host clock; None: unknown.

        Returns
        -------
        Why the record before could not be continued; None: it was, or there was none.

        Raises
        ------
        RateRequired : the stream has no clock and no rate is configured.
        """
        # The host clock limits jumps of the sample clock: blocks of other streams took their part of the time.
        passed_s = None if host_s is None else self._other_streams_s + host_s
        block = self._of_numbers(block)
        mismatch = None
        if len(block.values) and block.stream is not self.stream:
            mismatch = self._choose(block.stream)
        if not len(block.values) or self.stream is None or block.stream != self.stream:
            self._leave_out(block, host_s or 0.0, passed_s or 0.0)
            return mismatch
        self._other_streams_s = 0.0
        clock, impossible_hz = self.clock, self.clock.impossible_hz
        for placed in clock.place(block, host_s=passed_s):
            mismatch = self._add(placed) or mismatch
        if impossible_hz is None and clock.impossible_hz is not None:
            self._log.add(DetectedEvent("remark", _doubt_of_clock(clock.impossible_hz)))
        # The clock stops placing where the interval changes: what follows belongs to a new record with a clock of its
        # own, and may hold another change.
        if (rest := clock.rest) is not None:
            mismatch = self._begin_again("other_rate", "the sample rate of the sensor has changed")
            self._use_clock(rest.stream, SampleClock(rest.stream.clock, tick_s=rest.stream.tick_s))
            mismatch = self.feed(rest) or mismatch
        return mismatch

    def _add(self, placed: PlacedSamples) -> RecordMismatch | None:
        """Add placed samples; those of another interval begin the record again."""
        interval_s, mismatch = self.clock.interval_s, None
        assert interval_s is not None
        if self.begun and abs(self.interval_s / interval_s - 1.0) > SAME_INTERVAL:
            # only a restored record can differ here: its clock measures the interval of the stream again
            cause = "the sample rate of the sensor is not that of the saved record"
            mismatch = self._begin_again("other_rate", cause)
            placed.steps[0] = 1  # the first sample of a record has no gap before it
        if not self.begun:
            self._begin(interval_s)
        # The record is fitted at the very sample that is due, so that any chunking of the samples states the same.
        while self._due_s < math.inf and (first := self._first_due(placed)) < len(placed.steps):
            due, placed = placed.split(first + 1)
            self._pass_through(due)
            self.fits.note_convergence(self._shown_sums(), self.counts())
            self._due_s = next_due_s(self.elapsed_s)
        if len(placed.steps):
            self._pass_through(placed)
        return mismatch

    def _first_due(self, placed: PlacedSamples) -> int:
        """Return the number of the sample with which the record is as long as it must be to be fitted."""
        ticks = self.span + np.cumsum(np.where(placed.steps == BREAK, 1, placed.steps))
        return int(np.searchsorted(ticks * self.interval_s, self._due_s))

    def _pass_through(self, placed: PlacedSamples) -> None:
        """Pass placed samples through the guard to the sums, and note what they show."""
        steps = placed.steps
        self.samples += len(steps)
        passed = False
        for part in fill_gaps(placed):
            for samples in self._guarded(part):
                self.sums.update(samples)
                passed = True
        if (steps != 1).any():
            # a step above 1 is a gap of known length, BREAK one of unknown length
            self.gaps += int(np.count_nonzero(steps != 1))
            self.restarts += int(np.count_nonzero(steps == BREAK))
        self._log.update_steps(steps, self.span)
        if passed:
            self._note_what_happened()
        for age_s, share, full in self._loss.update(steps):
            # A window that is half full needs twice the share: as many missing samples as in a full one.
            limit = self.options.max_loss / full
            self._log.update_loss(share, limit, self.elapsed_s - age_s, ends=full >= 1.0)

    def _guarded(self, part: Part) -> list[GuardedSamples]:
        """Return what the guard passes on with a part of the grid."""
        match part:
            case Break():  # it has no ticks: its length is unknown, and nothing is known to be missing
                return self.guard.break_()
            case LongGap(ticks):
                self.span += ticks
                self._envelope.skip(ticks)
                return self.guard.skip(ticks)
        self.span += len(part.values)
        # one without a number is no sample of its sensor
        present = None if part.present is None else part.valid(len(self._sensors.members))
        valid = self._sensors.check(part.values, present)[1]
        # The signal view shows what arrived, disturbances included: it does not pass the guard.
        self._envelope.update(part.values, valid)
        return self.guard.update(part.values, valid, part.saturated)

    def _note_what_happened(self) -> None:
        """Add to the log what the samples have shown; it happened before them if the guard held them back."""
        guard, ended = self.guard, self.sums.ended()
        if self._periods is not None and ended.stretches:
            self.ended_periods += self._periods.update(ended.stretches, self.counts())
        disturbances, rest, stuck = guard.events(), guard.rest_changes(), guard.stuck_changes()
        if not self.options.guarded:  # noticed also then, but nothing was excluded that an event could report
            disturbances, stuck = [], []
        self._log.update_happened(disturbances, rest, stuck, ended)

    def _of_numbers(self, block: SampleBlock) -> SampleBlock:
        """Return the samples whose values are numbers, and count the others; the first one is an event."""
        any_before, received = self._invalid.any, len(block.values)
        block = self._invalid.remove(block)
        if len(block.values) < received:
            self._ledger.add("not_finite", received - len(block.values))
        if self._invalid.any and not any_before:
            text = "a gyroscope or accelerometer value is no number: such samples count as missing"
            elapsed_s = self.elapsed_s if self.begun else None
            self._log.add(DetectedEvent("garbage", text, elapsed_s))
        return block

    # ------------------------------------------------------------------ interruptions

    def gap(self, length_s: float | None = None) -> None:
        """Note that the connection was interrupted for `length_s` by the host clock; None: unknown."""
        if self.stream is not None:
            self.clock.gap(length_s)
        if self.begun:
            self._loss.restart()  # an interruption is an event of its own, and no loss of the link

    def flush(self) -> RecordMismatch | None:
        """Process everything that is held back: the stream has ended or is interrupted.

        Returns
        -------
        As `feed`.

        Raises
        ------
        RateRequired : there was only a stream without a clock, and no rate is configured.
        """
        if self.stream is None and self._without_rate.source:
            raise self._without_rate.error()
        mismatch = None
        for placed in self.clock.finish() if self.stream is not None else ():
            mismatch = self._add(placed) or mismatch
        self._flush_guard()
        return mismatch

    def _flush_guard(self) -> None:
        """Pass on what the guard holds back."""
        if self.begun:
            for samples in self.guard.flush():
                self.sums.update(samples)
            self._note_what_happened()
            self._log.report_gaps(self.elapsed_s)

    def end(self) -> None:
        """End the periods in progress: no samples follow in this record."""
        if self.begun and self._periods is not None:
            self.ended_periods += self._periods.end(self.counts())

    def forget(self) -> None:
        """Forget the record: what follows is another one, of other settings. What became of its samples is known."""
        self._ledger.add("earlier_record", self.samples - self._restored_samples)
        self._count_left_out_by_clock()
        self.stream, self.begun, self._restored = None, False, None
        self.samples = self.restarts = self._restored_samples = 0
        self._other_streams_s = 0.0

    # ------------------------------------------------------------------ begin

    def _choose(self, stream: Stream) -> RecordMismatch | None:
        """Characterise `stream` from now on, if it is better than the present one; that begins the record again."""
        mismatch = None
        if (current := self.stream) is not None:
            if stream == current or rank(stream) <= rank(current):
                return None
            cause = f"there is a better stream, {stream.kind} from {stream.source}"
            mismatch = self._begin_again("other_stream", cause)
        interval_s = stream.interval_s
        if interval_s is None and self.rate_hz is not None:
            interval_s = 1.0 / self.rate_hz
        # The first stream decides about a restored record: a later one cannot continue what this one has ended.
        if self._restored is not None:
            other = self._mismatch(self._restored[0], stream, interval_s)
            if other is None:
                self.accept_restored()
                return mismatch
            mismatch, self._restored = other, None
        if stream.clock != "none" or interval_s is not None:
            self._use_clock(stream, SampleClock(stream.clock, interval_s, stream.tick_s))
        return mismatch

    def _use_clock(self, stream: Stream, clock: SampleClock) -> None:
        """Characterise another stream, or the same one on another grid; what the clock before it holds is not used."""
        self._count_left_out_by_clock()
        self.stream, self.clock = stream, clock

    def _count_left_out_by_clock(self) -> None:
        if self.stream is not None:
            for reason, count in _left_out_by(self.clock, held="other_message").items():
                self._ledger.add(reason, count)

    def _begin(self, interval_s: float, saved: SavedRecord | None = None) -> None:
        """Begin a record of the stream on a grid, or continue a saved one."""
        assert self.stream is not None
        stream, options = self.stream, self.options
        self.begun, self.interval_s = True, interval_s
        self._sensors = ValidityGroups(len(stream.channels), stream.groups)
        self._loss = LossWindow(interval_s)
        self.fits = Fits(stream, precision=options.precision, guarded=options.guarded)
        if saved is None:
            self.samples = self.gaps = self.span = 0
            # a guard that excludes nothing still detects motion
            self.guard = Guard(stream.sensors, 1.0 / interval_s, excludes=options.guarded)
            self._envelope = Envelope(stream.groups, 1.0 / interval_s)
            self.sums = self._new_sums()
        else:
            self.samples, self.gaps, self.span = saved.samples, saved.gaps, saved.span
            self.guard, self._envelope, self.sums = saved.guard, saved.envelope, saved.sums
            self.fits.convergence = saved.statements
        self._log.begin(stream.channels, interval_s)
        self._due_s = next_due_s(self.elapsed_s) if options.convergence else math.inf
        self._periods = None
        if options.periods:
            counted = None if saved is None else saved.counted
            self._periods = Periods(self.sums, self.fits, self.counts(), counted)

    def _new_sums(self) -> Sums:
        """Return empty sums of the stream."""
        assert self.stream is not None
        stream, sensors = self.stream, self.stream.sensors
        # `Stream.channels` has the sensors with a curve first, so a count says which columns these are
        with_curve = sum(sensor in WITH_CURVE for sensor in sensors)
        inertial = [column for column, sensor in enumerate(sensors) if sensor in INERTIAL]
        return Sums(
            stream.groups,
            with_curve,
            self.interval_s,
            averaged=stream.averaged[:with_curve],
            # A magnetometer sees currents and steel nearby, not the heat of the sensor: its mean shows no warm-up.
            warmup_channels=inertial if self.options.guarded else (),
            temperature=sensors.index("temperature") if "temperature" in sensors else None,
        )

    def _begin_again(self, code: str, cause: str) -> RecordMismatch | None:
        """End the record, if there is one; the next samples begin another. `code` is that of the mismatch."""
        mismatch, elapsed_s = None, None
        if self.begun and self.stream is not None:
            self._ledger.add("earlier_record", self.samples - self._restored_samples)
            mismatch = _mismatch_of(code, self.stream, self.interval_s)
            self.restarts += 1
            self._flush_guard()
            elapsed_s = self.elapsed_s  # after the flush, which adds what the guard has held back
        self._log.add(DetectedEvent("restart", f"{cause}: a new record begins", elapsed_s, code=code))
        self.end()
        self.begun, self.samples, self._restored_samples = False, 0, 0
        return mismatch

    def _leave_out(self, block: SampleBlock, host_s: float, passed_s: float) -> None:
        """Count a block without samples of the stream; require a rate unless a stream with a clock appears soon."""
        self._other_streams_s = passed_s
        self._ledger.add("start" if self.stream is None else "other_message", len(block.values))
        if self.stream is None:
            self._without_rate.add(block.stream, len(block.values), host_s)

    # ------------------------------------------------------------------ saved state

    def save(self) -> SavedRecord:
        """Return what `restore` continues from. It shares the parts: pack it before samples follow."""
        assert self.stream is not None
        return SavedRecord(
            stream=self.stream,
            clock=self.clock.save(),
            guarded=self.options.guarded,
            restarts=self.restarts,
            samples=self.samples,
            gaps=self.gaps,
            span=self.span,
            guard=self.guard,
            sums=self.sums,
            envelope=self._envelope,
            statements=self.fits.convergence,
            counted=None if self._periods is None else self._periods.counted,
        )

    def restore(self, saved: SavedRecord, away_s: float) -> None:
        """Continue a saved record as soon as the first samples show that the stream is the same.

        Parameters
        ----------
        saved : from `save`; its parts become those of this record.
        away_s : s of device time since it was saved, by the host clock.

        Raises
        ------
        RecordMismatch : it was made with guards and they are off, or the other way round.
        """
        if saved.guarded != self.options.guarded:
            guards = "on" if saved.guarded else "off"
            raise RecordMismatch("other_guards", f"of a run with the guards {guards}")
        self._restored = saved, away_s

    def accept_restored(self) -> None:
        """Use the restored record. Without samples that confirm its stream: to report, not to continue."""
        if self._restored is None:
            return
        (saved, away_s), self._restored = self._restored, None
        clock = SampleClock.restore(saved.stream.clock, saved.clock, saved.stream.tick_s)
        clock.gap(away_s)  # the time without the daemon is a gap; the sample clock shows its length if it can
        self._use_clock(saved.stream, clock)
        self._begin(saved.clock.interval_s, saved)
        self.restarts, self._restored_samples = saved.restarts, saved.samples
        self._log.restored(self.sums.changes())

    @staticmethod
    def _mismatch(saved: SavedRecord, stream: Stream, interval_s: float | None) -> RecordMismatch | None:
        """Return why a saved record does not belong to a stream of a configured interval; None: it does."""
        known = saved.clock.interval_s
        if saved.stream != stream:
            return _mismatch_of("other_stream", saved.stream, known)
        # A stream with a clock shows its interval itself, once it is measured (`_add`); a configured rate does not
        # count beside it.
        configured = interval_s if stream.clock == "none" else None
        if configured is not None and not math.isclose(configured, known):
            return _mismatch_of("other_rate", stream, known)
        return None

    # ------------------------------------------------------------------ results

    @property
    def elapsed_s(self) -> float:
        """s, length of the grid, gaps included."""
        return self.span * self.interval_s

    @property
    def sample_rate_hz(self) -> float | None:
        """Rate of the grid; None before it is known."""
        return 1.0 / self.interval_s if self.begun else None

    def counts(self) -> Counts:
        """Return what became of the ticks of the grid so far."""
        guard, guarded = self.guard, self.options.guarded
        return Counts(
            interval_s=self.interval_s,
            span=self.span,
            samples=self.samples,
            gaps=self.gaps,
            excluded={str(reason): count for reason, count in guard.excluded.items()},
            excluded_samples=guard.excluded_samples,
            excluded_squares=guard.excluded_squares,
            noisy=guard.noisy_outliers,
            disturbances=guard.disturbances if guarded else 0,
            at_rest=guard.at_rest,
            stuck=guarded and guard.stuck,
            warmup_s=self.sums.warmup_s,
        )

    def _shown_sums(self) -> Sums:
        """Return the sums of what the guard has passed on; before that, of what it will assess first.

        The guard assesses its first frames together, after four seconds or forty samples. Until then, a report shows
        the samples that it holds back, through sums that are thrown away: they are few, and none is counted twice.
        """
        if (pending := self.guard.pending) is None:
            return self.sums
        preview = self._new_sums()
        preview.update(pending)
        return preview

    def report(
        self,
        now: datetime,
        device: DeviceDescription,
        state: State,
        session: SessionCounters,
        *,
        device_caveats: tuple[str, ...] = (),
        renewal: Renewal | None = None,
    ) -> Report:
        """Return everything known at the time `now`.

        Parameters
        ----------
        device, session : what the caller knows (identity, link counters); the record adds the rest.
        device_caveats : from the stream and the settings of the sensor, such as ``aliased``.
        renewal : of the results that are expensive; None: ``due`` of a record that is running, else ``all``.
        """
        bare = Report(
            time=stamp(now),
            device=self._described(device),
            state=state,
            session=self._counted(session),
            period_s=self.options.period_s,
            precision=self.options.precision,
            alarm_limits={"loss": self.options.max_loss},
        )
        if not self.begun:
            return bare
        counts, sums = self.counts(), self._shown_sums()
        self.fits.update(sums, counts, renewal or ("due" if state == "running" else "all"), bare)
        assessment = Assessment(self.fits, sums, counts, self._envelope.recent(), self.options.baseline)
        channels = assessment.channels(device_caveats)
        grades = assessment.sensor_grades(channels)
        self._log_results(assessment, channels, grades, counts)
        return replace(
            bare,
            grade=grades,
            channels=channels,
            caveats=tuple(dict.fromkeys((*device_caveats, *assessment.caveats))),
            limits=LIMITS,
            limit_curves=LIMIT_CURVES,
        )

    def _log_results(
        self,
        assessment: Assessment,
        channels: Mapping[ChannelName, Channel],
        grades: Mapping[str, SensorGrade],
        counts: Counts,
    ) -> None:
        """Add to the log what a report shows for the first time."""
        log, elapsed_s = self._log, counts.elapsed_s
        log.update_constant(assessment.constant, elapsed_s)
        log.update_changes(assessment.changes, elapsed_s)
        log.update_grades(grades, elapsed_s)
        warming_up = any("warming_up" in channel.caveats for channel in channels.values())
        log.update_warmup(elapsed_s, counts.warmup_s, warming_up, heats_up=self.fits.heats_up)

    def _described(self, device: DeviceDescription) -> DeviceDescription:
        """Return the description of the caller with what the samples show."""
        if (stream := self.stream) is None:
            return device
        impossible_hz = self.clock.impossible_hz
        doubts = () if impossible_hz is None else (_doubt_of_clock(impossible_hz),)
        return replace(
            device,
            stream=stream.kind,
            source=stream.source,
            clock=stream.clock,
            sample_rate_hz=self.sample_rate_hz or device.sample_rate_hz,
            remarks=(*device.remarks, *doubts),
            alias_factor=1.0 if stream.kind == "deltas" else device.alias_factor,
        )

    def _counted(self, link: SessionCounters) -> SessionCounters:
        """Return the counters of the caller with those of the record."""
        ledger = merged(link.ledger, {SAMPLES: self.samples})
        # a device that counts nothing has delivered what arrived here
        link = replace(link, ledger=ledger if link.ledger.get(RECEIVED) else with_received(ledger))
        if not self.begun:
            return link
        return replace(
            self.counts().added_to(link),
            recent_loss=self._loss.share,
            restarts=link.restarts + self.restarts,
            duplicates=self.clock.duplicates,
        )

    def left_out(self) -> dict[str, int]:
        """Return what became of the samples that were fed and are not in the record, by reason (`ledger`)."""
        of_clock = {} if self.stream is None else _left_out_by(self.clock, held="pending")
        waiting = 0 if self._restored is None else self._restored[0].samples
        return merged(self._ledger.counts(), of_clock, {"pending": waiting})

    def own_samples(self) -> int:
        """Return how many samples of the record this run has received."""
        return self.samples - self._restored_samples

    def events(self) -> list[DetectedEvent]:
        """Return what happened since the last call, in order."""
        if self.begun:
            self._note_what_happened()
        return self._log.drain()

    def periods(self) -> list[HistoryPeriod]:
        """Return the periods that ended since the last call, of `RecordOptions.periods`."""
        ended, self.ended_periods = self.ended_periods, []
        return ended

    def periods_in_progress(self) -> list[HistoryPeriod]:
        """Return the periods in progress; those of an earlier call unless they have grown."""
        if not self.begun or self._periods is None:
            return []
        return self._periods.in_progress(self.counts())

    def signals(self) -> dict[str, Callable[[], Signal]]:
        """Return what makes the minimum and maximum per time column of each channel, as they are now."""
        if not self.begun or self.stream is None:
            return {}
        return signals(self.stream.channels, self._envelope, self.interval_s)


def _mismatch_of(code: str, stream: Stream, interval_s: float) -> RecordMismatch:
    """Return why a record of a stream and an interval, s, cannot be continued."""
    rate = f"rate, {1.0 / interval_s:g} Hz"
    other = rate if code == "other_rate" else f"stream, {stream.kind} from {stream.source}"
    return RecordMismatch(code, f"of another {other}")


def _doubt_of_clock(impossible_hz: float) -> str:
    """Return why samples are excluded whose time has another unit than the device says."""
    return f"the time of some samples shows {impossible_hz:.3g} Hz, a rate of no sensor: check its unit"


def _left_out_by(clock: SampleClock, *, held: str) -> dict[str, int]:
    """Return what a clock has placed nowhere, by reason; `held`: reason of what still waits in it."""
    return {
        "repeated": clock.duplicates,
        "wrong_time": clock.wrong_times,
        "out_of_order": clock.out_of_order,
        held: clock.held,
    }
