"""Record: the samples of one stream from its first one on, and everything that follows from them.

A record has an interval: it begins when the clock of its stream is known. What its samples show goes to the log of
events; the periods that end are returned.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.grid.sample_clock import BREAK, PlacedSamples
from imumon.model.coefficients import default_precision
from imumon.model.errors import ImumonError
from imumon.model.grading import LIMITS
from imumon.model.history_report import HistoryPeriod
from imumon.model.report import MAX_LOSS, Report, SessionCounters
from imumon.model.samples import Ints, Stream
from imumon.model.saved_state import restorable
from imumon.record import assessment
from imumon.record.accumulators import Accumulators, Happened
from imumon.record.analysis import Analysis, Renewal
from imumon.record.changes import hour_changes
from imumon.record.combined_limits import with_combined
from imumon.record.convergence import StatementLog, next_due_s
from imumon.record.events import EventLog
from imumon.record.loss import LossWindow
from imumon.record.periods import Periods
from imumon.record.report_builder import limit_curves

LIMIT_CURVES = limit_curves(LIMITS)


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
    periods : keep what happens in every hour and day until `Monitor.periods` returns it.
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


@restorable
@dataclass(frozen=True, slots=True)
class SavedRecord:
    """What a record continues from.

    Attributes
    ----------
    accumulators : statistics of its samples.
    statements : what was stated when it was shorter.
    counted : counters up to the last period, see `Periods.counted`; None: it kept no periods.
    """

    accumulators: Accumulators
    statements: StatementLog
    counted: dict[int, dict[str, int]] | None


class Record:
    """The samples of one stream, and their results.

    Parameters
    ----------
    interval_s : s between two samples.
    options : how to monitor.
    saved : an earlier record of such a stream and such options, which continues; None: a new one begins.

    Attributes
    ----------
    accumulators : statistics of the samples.
    loss : what was lost of the last minute.
    """

    def __init__(
        self, stream: Stream, interval_s: float, options: MonitorOptions, saved: SavedRecord | None = None
    ) -> None:
        self._options, self._stream, averaged = options, stream, stream.averaged
        self.accumulators = (
            saved.accumulators
            if saved is not None
            else Accumulators(stream.channels, interval_s, averaged=averaged, guarded=options.guarded)
        )
        self.loss = LossWindow(interval_s)
        self._analysis = Analysis(self.accumulators, averaged=averaged, precision=options.precision)
        if saved is not None:
            self._analysis.convergence = saved.statements
        self._due_s = next_due_s(self.accumulators.elapsed_s) if options.convergence else math.inf
        self._periods: Periods | None = None
        if options.periods:
            counted = None if saved is None else saved.counted
            self._periods = Periods(self.accumulators, self._analysis, counted, averaged=averaged)

    def mismatch(self, stream: Stream, interval_s: float | None) -> RecordMismatch | None:
        """Return why the record does not belong to a stream of a configured interval; None: it does."""
        known = self.accumulators.interval_s
        if self._stream != stream:
            return mismatch_of("other_stream", self._stream, known)
        # A stream with a clock shows its interval itself, once it is measured (`Monitor._accumulate`); a configured
        # rate does not count beside it.
        configured = interval_s if stream.clock == "none" else None
        if configured is not None and not math.isclose(configured, known):
            return mismatch_of("other_rate", stream, known)
        return None

    def feed(self, placed: PlacedSamples, log: EventLog) -> list[HistoryPeriod]:
        """Add samples; return the periods that have ended."""
        ended: list[HistoryPeriod] = []
        # The record is fitted at the very sample that is due, so that any chunking of the samples states the same.
        while (first := self._first_due(placed.steps)) < len(placed.steps):
            head, placed = _split(placed, first + 1)
            ended += self._feed(head, log)
            self._analysis.note_convergence()
            self._due_s = next_due_s(self.accumulators.elapsed_s)
        return ended + (self._feed(placed, log) if len(placed.steps) else [])

    def _first_due(self, steps: Ints) -> int:
        """Return the number of the sample with which the record is as long as it must be to be fitted."""
        ticks = self.accumulators.span + np.cumsum(np.where(steps == BREAK, 1, steps))
        return int(np.searchsorted(ticks * self.accumulators.interval_s, self._due_s))

    def _feed(self, placed: PlacedSamples, log: EventLog) -> list[HistoryPeriod]:
        """Add samples at whose end the record is shorter than it must be to be fitted, or just as long."""
        accumulators = self.accumulators
        happened = accumulators.feed(placed)
        ended = self._ended(happened)
        log.update_clock(placed.steps, accumulators)
        log.update_gaps(placed.steps, accumulators)
        log.update_happened(happened, accumulators)
        for age_s, share, full in self.loss.update(placed.steps):
            # A window that is half full needs twice the share: as many missing samples as in a full one.
            elapsed_s = accumulators.elapsed_s - age_s
            log.update_loss(share, self._options.max_loss / full, elapsed_s, ends=full >= 1.0)
        return ended

    def flush(self, log: EventLog) -> list[HistoryPeriod]:
        """Process the samples that the guard holds back; return the periods that have ended."""
        happened = self.accumulators.flush()
        ended = self._ended(happened)
        log.update_happened(happened, self.accumulators)
        log.report_gaps(self.accumulators.elapsed_s, self.accumulators)
        return ended

    def _ended(self, happened: Happened) -> list[HistoryPeriod]:
        return [] if self._periods is None else self._periods.update(happened.ended.stretches)

    def periods_in_progress(self, *, force: bool) -> list[HistoryPeriod]:
        """Return the periods in progress; those of an earlier call unless they have grown, or with `force`."""
        return [] if self._periods is None else self._periods.in_progress(force=force)

    def end(self) -> list[HistoryPeriod]:
        """Return the periods in progress as they are: no samples follow."""
        return [] if self._periods is None else self._periods.end()

    def report(self, bare: Report, caveats: tuple[str, ...], log: EventLog, renewal: Renewal) -> Report:
        """Return a report with the results of this record.

        Parameters
        ----------
        bare : identity and counters.
        caveats : from the stream and the settings of the sensor.
        renewal : see `Monitor.report`.
        """
        accumulators, analysis = self.accumulators, self._analysis
        analysis.update(renewal)
        caveats = (
            *caveats,
            *assessment.record_caveats(accumulators, analysis, guarded=self._options.guarded),
        )
        between_hours = hour_changes(accumulators.statistics.noise.changes())
        other_changes = assessment.detect_changes(analysis, self._options.baseline)
        changes = assessment.merged(between_hours, other_changes)
        reason = assessment.no_grade_reason(accumulators)
        channels = assessment.assess_channels(accumulators, analysis, caveats, changes, reason)
        measured = replace(bare, channels=channels)
        # Grades come after the combined limits: they are certain only within these.
        channels = with_combined(measured)
        grades = assessment.sensor_grades(accumulators, analysis, channels, reason)
        log.update_constant(assessment.constant_channels(analysis), accumulators)
        log.update_changes(other_changes, accumulators)  # the samples have reported those between hours
        log.update_grades(grades, accumulators)
        warming_up = any("warming_up" in channel.caveats for channel in channels.values())
        log.update_warmup(accumulators, warming_up, heats_up=analysis.heats_up)
        return replace(
            bare,
            grade=grades,
            channels=channels,
            caveats=tuple(dict.fromkeys(caveats)),
            limits=LIMITS,
            limit_curves=LIMIT_CURVES,
        )

    def counted(self, link: SessionCounters) -> SessionCounters:
        """Return the counters of the link with those of the record."""
        accumulators = self.accumulators
        return replace(
            link,
            elapsed_s=accumulators.elapsed_s,
            samples=accumulators.samples,
            missing=accumulators.missing,
            gaps=accumulators.gaps,
            disturbances=accumulators.disturbances,
            excluded_s=accumulators.excluded_s,
            excluded_by=accumulators.excluded_by,
            warmup_s=accumulators.warmup_s,
            recent_loss=self.loss.share,
        )

    def saved(self) -> SavedRecord:
        """Return what a record continues from. It shares the accumulators: pack it before samples follow."""
        counted = None if self._periods is None else self._periods.counted
        return SavedRecord(self.accumulators, self._analysis.convergence, counted)


def _split(placed: PlacedSamples, count: int) -> tuple[PlacedSamples, PlacedSamples]:
    """Return the first samples, and the others."""
    parts = []
    for rows in (slice(None, count), slice(count, None)):
        saturated = None if placed.saturated is None else placed.saturated[rows]
        parts.append(PlacedSamples(placed.values[rows], placed.steps[rows], saturated))
    return parts[0], parts[1]


def mismatch_of(code: str, stream: Stream, interval_s: float) -> RecordMismatch:
    """Return why a record of a stream and an interval, s, cannot be continued."""
    rate = f"rate, {1.0 / interval_s:g} Hz"
    other = rate if code == "other_rate" else f"stream, {stream.kind} from {stream.source}"
    return RecordMismatch(code, f"of another {other}")
