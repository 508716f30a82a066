"""Monitor: samples in, Report out.

The monitor does no I/O and reads no clock: time is an argument. If several streams arrive, the best one is
characterised: deltas, else uncompensated, else compensated. A better stream that appears later starts a new record.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial

from imumon.grid.sample_clock import BREAK, PlacedSamples, SampleClock, SavedClock
from imumon.model.cures import option
from imumon.model.errors import RateRequired
from imumon.model.history_report import HistoryPeriod
from imumon.model.ledger import RECEIVED, SAMPLES, Ledger, merged, with_received
from imumon.model.report import (
    DeviceDescription,
    Report,
    SessionCounters,
    Signal,
    State,
    stamp,
)
from imumon.model.samples import SampleBlock, Stream
from imumon.model.saved_state import restorable
from imumon.record.analysis import Renewal
from imumon.record.events import DetectedEvent, EventLog
from imumon.record.gap_fill import InvalidSamples
from imumon.record.record import MonitorOptions, Record, RecordMismatch, SavedRecord, mismatch_of
from imumon.record.report_builder import signal

NO_CLOCK_SAMPLES = 100
"""Samples of a stream without clock and rate after which the monitor stops waiting for another stream: a
device that sends several streams has sent all of them by then."""

NO_CLOCK_S = 5.0
"""s, the same limit by the host clock, because 100 samples of a slow stream take long."""

SAME_INTERVAL = 1e-3
"""Relative difference up to which a measured interval is that of the record: clocks agree to 1e-4."""

STREAM_RANK = {"compensated": 0, "unknown": 1, "uncompensated": 2, "deltas": 3}
"""Rank of a kind of stream: the highest is characterised."""


@restorable
@dataclass(frozen=True, slots=True, kw_only=True)
class SavedMonitor:
    """What a monitor continues from, in another process."""

    stream: Stream  # that is characterised
    clock: SavedClock  # of it
    guarded: bool  # disturbances were excluded
    restarts: int  # breaks of unknown length and new records
    record: SavedRecord


restorable(Stream)


@dataclass(frozen=True, slots=True)
class _Source:
    """The stream that is characterised, and its clock."""

    stream: Stream
    clock: SampleClock


@dataclass(frozen=True, slots=True)
class _Restored:
    """A restored record that waits for the first samples to confirm its stream."""

    source: _Source
    record: Record
    restarts: int


@dataclass(slots=True)
class _WithoutRate:
    """Samples of streams that need a rate, before any other stream appears."""

    source: str = ""  # message that needs a rate
    samples: int = 0
    seconds: float = 0.0  # by the host clock

    def error(self) -> RateRequired:
        text = f"{self.source} has no clock"
        return RateRequired("rate_required", text, f"give its sample rate with {option('rate_hz')}")


class Monitor:
    """Turn sample blocks into reports.

    Parameters
    ----------
    rate_hz : Hz, configured rate, for a stream without a clock; None: unknown.

    Attributes
    ----------
    options : how to monitor.
    rate_hz : Hz; the caller may set it when the device reports its rate.
    restarts : breaks of unknown length and new records.
    """

    def __init__(self, options: MonitorOptions | None = None, *, rate_hz: float | None = None) -> None:
        self.options = options or MonitorOptions()
        self.rate_hz = rate_hz
        self.restarts = 0
        self._source: _Source | None = None  # None before the first sample
        self._record: Record | None = None  # None before the interval is known
        self._restored: _Restored | None = None
        self._events = EventLog()
        self._ended_periods: list[HistoryPeriod] = []
        self._without_rate = _WithoutRate()
        self._other_streams_s = 0.0  # by the host clock, since the last block of this stream
        self._invalid = InvalidSamples()
        self._ledger = Ledger()  # of samples that are in no record, and of clocks that have ended
        self._restored_samples = 0  # of the record, received by an earlier run

    def feed(self, block: SampleBlock, *, host_s: float | None = None) -> RecordMismatch | None:
        """Process a block. Blocks of other streams than the characterised one are ignored.

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
        # The host clock bridges gaps of a stream without a clock: blocks of other streams took their part of the time.
        passed = None if host_s is None else self._other_streams_s + host_s
        block = self._of_numbers(block)
        mismatch = self._choose(block.stream) if len(block) else None
        if not len(block) or self._source is None or self._source.stream != block.stream:
            self._other_streams_s = passed or 0.0
            self._ledger.add("start" if self._source is None else "other_message", len(block))
            self._count_without_rate(block, host_s or 0.0)
            return mismatch
        self._other_streams_s = 0.0
        clock, impossible_hz = self._source.clock, self._source.clock.impossible_hz
        for placed in clock.place(block, host_s=passed):
            mismatch = self._accumulate(placed) or mismatch
        if impossible_hz is None and (remark := _doubt_of_clock(clock)) is not None:
            self._events.add(DetectedEvent("remark", remark))
        # The clock stops placing where the interval changes: what follows belongs to a new record with a clock of its
        # own, and may hold another change.
        if (rest := clock.rest) is not None:
            mismatch = self._start_new_record("other_rate", "the sample rate of the sensor has changed")
            self._replace_source(
                _Source(rest.stream, SampleClock(rest.stream.clock, tick_s=rest.stream.tick_s))
            )
            mismatch = self.feed(rest) or mismatch
        return mismatch

    def _of_numbers(self, block: SampleBlock) -> SampleBlock:
        """Return the samples whose values are numbers, and count the others; the first one is an event."""
        any_before, received = self._invalid.any, len(block)
        block = self._invalid.remove(block)
        self._ledger.add("not_finite", received - len(block))
        if self._invalid.any and not any_before:
            text = "a gyroscope or accelerometer value is no number: such samples count as missing"
            elapsed_s = self._record.accumulators.elapsed_s if self._record else None
            self._events.add(DetectedEvent("garbage", text, elapsed_s))
        return block

    def gap(self, length_s: float | None = None) -> None:
        """Note that the connection was interrupted for `length_s` by the host clock; None: unknown."""
        if self._source is not None:
            self._source.clock.gap(length_s)
        if self._record is not None:
            self._record.loss.restart()  # an interruption is an event of its own, and no loss of the link

    def flush(self) -> RecordMismatch | None:
        """Process everything that is held back: the stream has ended or is interrupted.

        Returns
        -------
        As `feed`.

        Raises
        ------
        RateRequired : there was only a stream without a clock, and no rate is configured.
        """
        if self._source is None and self._without_rate.source:
            raise self._without_rate.error()
        mismatch = None
        for placed in self._source.clock.finish() if self._source is not None else ():
            mismatch = self._accumulate(placed) or mismatch
        if self._record is not None:
            self._ended_periods += self._record.flush(self._events)
        return mismatch

    def events(self) -> list[DetectedEvent]:
        """Return what happened since the last call, in order."""
        return self._events.drain()

    def periods(self) -> list[HistoryPeriod]:
        """Return the periods that ended since the last call, of `MonitorOptions.periods`."""
        ended, self._ended_periods = self._ended_periods, []
        return ended

    def periods_in_progress(self, *, force: bool = False) -> list[HistoryPeriod]:
        """Return the periods in progress; those of an earlier call unless they have grown, or with `force`."""
        return [] if self._record is None else self._record.periods_in_progress(force=force)

    def end_record(self) -> None:
        """End the periods in progress: no samples follow in this record."""
        if self._record is not None:
            self._ended_periods += self._record.end()

    @property
    def stream(self) -> Stream | None:
        """The stream that is characterised; None before the first sample."""
        return self._source.stream if self._source else None

    @property
    def samples(self) -> int:
        """Samples received in the record so far."""
        return self._record.accumulators.samples if self._record else 0

    @property
    def sample_rate_hz(self) -> float | None:
        """Rate of the grid; None before it is known."""
        return 1.0 / self._record.accumulators.interval_s if self._record else None

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
        device, session : what the caller knows (identity, link counters); the monitor adds the rest.
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
        if self._record is None:
            return bare
        renewal = renewal or ("due" if state == "running" else "all")
        return self._record.report(bare, device_caveats, self._events, renewal)

    def signals(self) -> dict[str, Callable[[], Signal]]:
        """Return what makes the minimum and maximum per time column of each channel, as they are now."""
        if self._record is None:
            return {}
        record = self._record.accumulators
        # The columns are copies, which the thread of the bus may use: it makes a message only where a query asks.
        strips = record.envelope.minute(), record.envelope.hour(), record.envelope.everything()
        return {
            name: partial(signal, name, strips, column, record.interval_s)
            for column, name in enumerate(record.channels)
        }

    # ------------------------------------------------------------------ saved state

    def save(self) -> SavedMonitor:
        """Return the state that `restore` continues from, to be packed at once. The monitor must have samples."""
        assert self._source is not None
        assert self._record is not None
        return SavedMonitor(
            stream=self._source.stream,
            clock=self._source.clock.save(),
            guarded=self.options.guarded,
            restarts=self.restarts,
            record=self._record.saved(),
        )

    def restore(self, saved: SavedMonitor, away_s: float) -> None:
        """Continue a saved record as soon as the first samples show that the stream is the same.

        Parameters
        ----------
        saved : from `save`; the monitor keeps its accumulators.
        away_s : s of device time since it was saved, by the host clock.

        Raises
        ------
        RecordMismatch : it was made with guards and they are off, or the other way round.
        """
        stream, guarded = saved.stream, saved.guarded
        if guarded != self.options.guarded:
            raise RecordMismatch("other_guards", f"of a run with the guards {'on' if guarded else 'off'}")
        clock = SampleClock.restore(stream.clock, saved.clock, stream.tick_s)
        clock.gap(away_s)  # the time without the daemon is a gap; the sample clock shows its length if it can
        record = Record(stream, saved.clock.interval_s, self.options, saved.record)
        self._restored = _Restored(_Source(stream, clock), record, saved.restarts)

    def accept_restored(self) -> None:
        """Use the restored record without samples that confirm its stream: to report, not to continue."""
        if self._restored is not None:
            self._use(self._restored)

    def _use(self, restored: _Restored) -> None:
        self._replace_source(restored.source)
        self._record, self.restarts = restored.record, restored.restarts
        self._restored_samples = restored.record.accumulators.samples
        self._restored = None
        self._events.record_restored(restored.record.accumulators)

    # ------------------------------------------------------------------ streams and records

    def _choose(self, stream: Stream) -> RecordMismatch | None:
        """Characterise `stream` from now on, if it is better than the present one; that starts a new record."""
        mismatch = None
        if (current := self.stream) is not None:
            if stream == current or _rank(stream) <= _rank(current):
                return None
            cause = f"there is a better stream, {stream.kind} from {stream.source}"
            mismatch = self._start_new_record("other_stream", cause)
        interval = stream.interval_s
        if interval is None and self.rate_hz is not None:
            interval = 1.0 / self.rate_hz
        # The first stream decides about a restored record: a later one cannot continue what this one has ended.
        restored, self._restored = self._restored, None
        if restored is not None:
            other = restored.record.mismatch(stream, interval)
            if other is None:
                self._use(restored)
                return mismatch
            mismatch = other
        if stream.clock != "none" or interval is not None:
            self._replace_source(_Source(stream, SampleClock(stream.clock, interval, stream.tick_s)))
        return mismatch

    def _replace_source(self, source: _Source) -> None:
        """Characterise another stream, or the same one on another grid; what the clock before it holds is not used."""
        if self._source is not None:
            for reason, count in _left_out_by(self._source.clock, held="other_message").items():
                self._ledger.add(reason, count)
        self._source = source

    def _count_without_rate(self, block: SampleBlock, host_s: float) -> None:
        """Require a rate for a stream without a clock, unless another stream appears soon."""
        known = self._without_rate
        if self._source is None and (len(block) or known.source):
            known.source = block.stream.source
            known.samples += len(block)
            known.seconds += host_s
            if known.samples > NO_CLOCK_SAMPLES or known.seconds > NO_CLOCK_S:
                raise known.error()

    def _accumulate(self, placed: PlacedSamples) -> RecordMismatch | None:
        """Add placed samples to the record; samples of another interval start a new one."""
        assert self._source is not None
        interval, mismatch = self._source.clock.interval_s, None
        record = self._record
        if (
            record is not None
            and abs(record.accumulators.interval_s / (interval or 1.0) - 1.0) > SAME_INTERVAL
        ):
            # only a restored record can differ here: its clock measures the interval of the stream again
            cause = "the sample rate of the sensor is not that of the saved record"
            mismatch = self._start_new_record("other_rate", cause)
            placed.steps[0] = 1  # the first sample of a record has no gap before it
        if self._record is None:
            assert interval is not None
            self._record = Record(self._source.stream, interval, self.options)
        self.restarts += int((placed.steps == BREAK).sum())
        self._ended_periods += self._record.feed(placed, self._events)
        return mismatch

    def _start_new_record(self, code: str, cause: str) -> RecordMismatch | None:
        """End the record, if there is one; the next samples start a new one. `code` is that of the mismatch."""
        mismatch, elapsed_s = None, None
        if self._record is not None and self._source is not None:
            record = self._record.accumulators
            self._ledger.add("earlier_record", record.samples - self._restored_samples)
            mismatch = mismatch_of(code, self._source.stream, record.interval_s)
            self.restarts += 1
            self._ended_periods += self._record.flush(self._events)
            elapsed_s = record.elapsed_s  # after the flush, which adds what the guard has held back
        self._events.add(DetectedEvent("restart", f"{cause}: a new record begins", elapsed_s, code=code))
        self.end_record()
        self._events.record_began()
        self._record, self._restored_samples = None, 0
        return mismatch

    # ------------------------------------------------------------------ parts of the report

    def left_out(self) -> dict[str, int]:
        """Return what became of the samples that were fed and are not in the record, by reason (`ledger`)."""
        of_clock = {} if self._source is None else _left_out_by(self._source.clock, held="pending")
        waiting = 0 if self._restored is None else self._restored.record.accumulators.samples
        return merged(self._ledger.counts(), of_clock, {"pending": waiting})

    def ended_samples(self) -> int:
        """Return how many samples of the record this run has received: those that a record after it does not have."""
        return self.samples - self._restored_samples

    def _counted(self, link: SessionCounters) -> SessionCounters:
        """Return the counters of the caller with those of the record."""
        ledger = merged(link.ledger, {SAMPLES: self.samples})
        # a device that counts nothing has delivered what arrived here
        link = replace(link, ledger=ledger if link.ledger.get(RECEIVED) else with_received(ledger))
        if self._record is None or self._source is None:
            return link
        restarts, duplicates = link.restarts + self.restarts, self._source.clock.duplicates
        return replace(self._record.counted(link), restarts=restarts, duplicates=duplicates)

    def _described(self, device: DeviceDescription) -> DeviceDescription:
        """Return the description of the caller with what the samples show."""
        if self._source is None:
            return device
        stream, clock = self._source.stream, self._source.clock
        return replace(
            device,
            stream=stream.kind,
            source=stream.source,
            clock=stream.clock,
            sample_rate_hz=self.sample_rate_hz or device.sample_rate_hz,
            remarks=device.remarks
            if (remark := _doubt_of_clock(clock)) is None
            else (*device.remarks, remark),
            alias_factor=1.0 if stream.kind == "deltas" else device.alias_factor,
        )


def _doubt_of_clock(clock: SampleClock) -> str | None:
    """Return why samples are excluded whose time has another unit than the device says; None: there are none."""
    if clock.impossible_hz is None:
        return None
    return f"the time of some samples shows {clock.impossible_hz:.3g} Hz, a rate of no sensor: check its unit"


def _left_out_by(clock: SampleClock, *, held: str) -> dict[str, int]:
    """Return what a clock has placed nowhere, by reason; `held`: reason of what still waits in it."""
    return {
        "repeated": clock.duplicates,
        "wrong_time": clock.wrong_times,
        "out_of_order": clock.out_of_order,
        held: clock.held,
    }


def _rank(stream: Stream) -> tuple[int, int, int]:
    """Return the rank of a stream: the stream of the highest rank is characterised."""
    return (
        STREAM_RANK[stream.kind],
        sum(name.startswith(("gyro", "accel")) for name in stream.channels),
        len(stream.channels),
    )
