"""Record: the samples of one stream from its first one on, and everything that follows from them.

A record has an interval: it begins when the clock of its stream is known. What its samples show goes to the log of
events; the periods that end are returned.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy.typing as npt

from imumon.alarms import DEFAULT_LIMITS
from imumon.coefficients import default_precision
from imumon.errors import ImumonError
from imumon.history_report import HistoryPeriod
from imumon.noise.grading import LIMITS
from imumon.noise.uncertainty import uncertainty_budgets, with_combined
from imumon.pipeline import assessment
from imumon.pipeline.accumulators import Accumulators, Happened
from imumon.pipeline.analysis import Analysis
from imumon.pipeline.events import EventLog
from imumon.pipeline.loss import LossWindow
from imumon.pipeline.periods import Periods
from imumon.pipeline.report_builder import limit_curves
from imumon.report import Report, SessionCounters
from imumon.samples import Stream
from imumon.timebase.sample_clock import PlacedSamples

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
    stored : keep all samples, for `Monitor.exact_curves`: memory grows with the record.
    periods : keep what happens in every 10 minutes, hour and day until `Monitor.periods` returns it.
    alarm_limits : by name of the alarm; see `imumon.alarms`.
    """

    guarded: bool = True
    precision: Mapping[str, float] = field(default_factory=default_precision)
    period_s: float = 1.0
    baseline: Report | None = None
    stored: bool = False
    periods: bool = False
    alarm_limits: Mapping[str, float] = field(default_factory=lambda: DEFAULT_LIMITS)


class Record:
    """The samples of one stream, and their results.

    Parameters
    ----------
    interval_s : s between two samples.
    options : how to monitor.

    Attributes
    ----------
    accumulators : statistics of the samples.
    loss : what was lost of the last minute.
    """

    def __init__(self, stream: Stream, interval_s: float, options: MonitorOptions) -> None:
        self._options, self._stream, averaged = options, stream, stream.averaged
        self.accumulators = Accumulators(
            stream.channels, interval_s, averaged=averaged, guarded=options.guarded, stored=options.stored
        )
        self.loss = LossWindow(interval_s)
        self._analysis = Analysis(self.accumulators, averaged=averaged, precision=options.precision)
        self._periods: Periods | None = None
        if options.periods:
            self._periods = Periods(self.accumulators, self._analysis, averaged=averaged)

    def mismatch(self, stream: Stream, interval_s: float | None) -> RecordMismatch | None:
        """Return why the record does not belong to a stream of a configured interval; None: it does."""
        known = self.accumulators.interval_s
        if self._stream != stream:
            return mismatch_of("other_stream", self._stream, known)
        configured = interval_s if stream.clock == "none" else None
        if configured is not None and not math.isclose(configured, known):
            return mismatch_of("other_rate", stream, known)
        return None

    def feed(self, placed: PlacedSamples, log: EventLog) -> list[HistoryPeriod]:
        """Add samples; return the periods that have ended."""
        own = self.accumulators
        happened = own.feed(placed)
        ended = self._ended(happened)
        log.update_clock(placed.steps, own)
        log.update_gaps(placed.steps, own)
        log.update_happened(happened, own)
        limit = self._options.alarm_limits["loss"]
        for age_s, share, full in self.loss.update(placed.steps):
            log.update_alarm("loss", share, limit / full, own.elapsed_s - age_s, ends=full >= 1.0)
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

    def report(self, bare: Report, caveats: tuple[str, ...], log: EventLog) -> Report:
        """Return a report with the results of this record.

        Parameters
        ----------
        bare : identity and counters.
        caveats : from the stream and the settings of the sensor.
        """
        own, analysis = self.accumulators, self._analysis
        analysis.update(force=bare.state != "running")
        caveats = (*caveats, *assessment.record_caveats(own, analysis, guarded=self._options.guarded))
        changes = assessment.detect_changes(own, analysis, self._options.baseline)
        reason = assessment.no_grade_reason(own)
        channels = assessment.assess_channels(own, analysis, caveats, changes, reason)
        measured = replace(bare, channels=channels)
        channels = with_combined(measured, uncertainty_budgets(measured))
        grades = assessment.sensor_grades(analysis, channels, reason)
        log.update_constant(assessment.constant_channels(analysis), own)
        log.update_changes(changes, own)
        log.update_grades(grades, own)
        warming_up = any("warming_up" in each.caveats for each in channels.values())
        log.update_warmup(own, warming_up, heats_up=analysis.heats_up)
        made = replace(
            bare,
            grade=grades,
            channels=channels,
            caveats=tuple(dict.fromkeys(caveats)),
            limits=LIMITS,
            limit_curves=LIMIT_CURVES,
        )
        log.update_alarms(made, own)
        return made

    def counted(self, link: SessionCounters) -> SessionCounters:
        """Return the counters of the link with those of the record."""
        own = self.accumulators
        return replace(
            link,
            elapsed_s=own.elapsed_s,
            samples=own.samples,
            missing=own.missing,
            gaps=own.gaps,
            disturbances=own.disturbances,
            excluded_s=own.excluded_s,
            excluded_by=own.excluded_by,
            warmup_s=own.warmup_s,
            recent_loss=self.loss.share,
        )

    def save(self) -> tuple[dict[str, Any], dict[str, npt.NDArray[Any]]]:
        """Return the state that `restore` continues from: JSON values and small arrays."""
        meta, arrays = self.accumulators.save()
        periods = None if self._periods is None else self._periods.save()
        return {"record": meta, "periods": periods}, arrays

    def restore(self, meta: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
        """Continue from a saved state; this record is new and made with the same arguments."""
        self.accumulators.restore(meta["record"], dict(arrays))
        if self._periods is not None:
            self._periods.restore(meta.get("periods"))


def mismatch_of(code: str, stream: Stream, interval_s: float) -> RecordMismatch:
    """Return why a record of a stream and an interval, s, cannot be continued."""
    rate = f"rate, {1.0 / interval_s:g} Hz"
    other = rate if code == "other_rate" else f"stream, {stream.kind} from {stream.source}"
    return RecordMismatch(code, f"of another {other}")
