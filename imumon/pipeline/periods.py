"""Periods: what the record showed in each 10 minutes, hour and day, for the history.

N, B and K belong to the period alone. Counters are read when a period ends, while the guard still holds some samples
back; so they may belong to samples of some seconds later, but their sums are those of the record. What is in progress
is fitted again every half minute.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from imumon.coefficients import BIAS_TERMS, Estimate
from imumon.history_report import HistoryPeriod, PeriodChannel
from imumon.noise.fit import Estimator
from imumon.noise.stretches.stretches import STEPS_S, Stretch
from imumon.pipeline.accumulators import Accumulators
from imumon.pipeline.analysis import Analysis

PAUSE_S = 30.0
"""s from one fit of the periods in progress to the next."""

COUNTED = ("samples", "missing", "excluded")


class Periods:
    """Periods of one record, those in progress included.

    Parameters
    ----------
    record : as it grows.
    analysis : of this record, for resolution, grades and settling.
    averaged : (c,) channels that are true averages over their interval.
    """

    def __init__(self, record: Accumulators, analysis: Analysis, *, averaged: Sequence[bool]) -> None:
        self._record, self._analysis = record, analysis
        self._estimators = {step: Estimator(averaged=averaged, time_to=False) for step in STEPS_S}
        self._counted = {step: dict.fromkeys(COUNTED, 0) for step in STEPS_S}  # up to the last period
        self._current: dict[int, HistoryPeriod] = {}
        self._due_s = 0.0

    def update(self, stretches: Iterable[Stretch]) -> list[HistoryPeriod]:
        """Return the periods of stretches that have just ended."""
        periods = []
        for stretch in stretches:
            periods.append(self._period(stretch, complete=True))
            self._counted[stretch.step_s] = self._counts()
            self._due_s = 0.0
        return periods

    def end(self) -> list[HistoryPeriod]:
        """Return the periods in progress as they are: the record ends here."""
        self._current = {}
        stretches = (self._stretch(step) for step in STEPS_S)
        return [self._period(stretch, complete=True) for stretch in stretches if stretch is not None]

    def in_progress(self, *, force: bool = False) -> list[HistoryPeriod]:
        """Return the periods in progress; those of the last call unless they have grown, or with `force`.

        Longer ones that began earlier are fitted again only when a shorter one has ended.
        """
        record = self._record
        if not force and record.elapsed_s < self._due_s:
            return list(self._current.values())
        again = force or self._due_s == 0.0
        for step in STEPS_S if again else STEPS_S[:1]:
            stretch = self._stretch(step)
            if stretch is None:
                self._current.pop(step, None)
            else:
                self._current[step] = self._period(stretch, complete=False)
        if (shortest := self._current.get(STEPS_S[0])) is not None:
            for step in STEPS_S[1:]:
                if self._counted[step] == self._counted[STEPS_S[0]]:  # both began together
                    number = shortest.number * STEPS_S[0] // step
                    self._current[step] = replace(shortest, step_s=step, number=number)
        self._due_s = record.elapsed_s + PAUSE_S if self._current else 0.0
        return list(self._current.values())

    def save(self) -> dict[str, Any]:
        """Return the state as JSON values."""
        return {"counted": {str(step): counts for step, counts in self._counted.items()}}

    def restore(self, saved: Mapping[str, Any] | None) -> None:
        """Continue from a saved state; None: the record had no periods, and its earlier samples belong to none."""
        for step in STEPS_S:
            counts = self._counts() if saved is None else saved["counted"][str(step)]
            self._counted[step] = {name: int(counts[name]) for name in COUNTED}

    def _stretch(self, step_s: int) -> Stretch | None:
        return self._record.noise.stretch_in_progress(step_s)

    def _counts(self) -> dict[str, int]:
        record = self._record
        return {
            "samples": record.samples,
            "missing": record.missing,
            "excluded": record.guard.excluded_samples,
        }

    def _period(self, stretch: Stretch, *, complete: bool) -> HistoryPeriod:
        record, interval_s = self._record, self._record.interval_s
        before, now = self._counted[stretch.step_s], self._counts()
        moments = stretch.moments.result().channels
        length = max(1, round(STEPS_S[0] / interval_s)) * (stretch.step_s // STEPS_S[0])
        temperature = None if record.temperature is None else moments[record.temperature].mean
        return HistoryPeriod(
            step_s=stretch.step_s,
            number=stretch.start // length,
            begin_age_s=(record.span - stretch.start) * interval_s,
            end_age_s=(record.span - stretch.end) * interval_s,
            complete=complete,
            samples=now["samples"] - before["samples"],
            missing=now["missing"] - before["missing"],
            excluded_s=(now["excluded"] - before["excluded"]) * interval_s,
            temperature=temperature,
            warming_up=self._analysis.warming_up,
            grades={sensor: grade.nearest for sensor, grade in self._analysis.grades.items()},
            channels=self._channels(stretch, moments),
        )

    def _channels(self, stretch: Stretch, moments: Sequence[Any]) -> dict[str, PeriodChannel]:
        record = self._record
        estimator, length = self._estimators[stretch.step_s], stretch.end - stretch.start
        fits = estimator.fit_sums(stretch.sums, length, self._analysis.resolution)
        heat = None if record.temperature is None else moments[record.temperature]
        extremes = None if heat is None or heat.min is None else (heat.min, heat.max)
        is_day = stretch.step_s == STEPS_S[-1]  # a shorter period seldom spans enough temperature
        curves = estimator.bias_curves(stretch.sums, extremes) if is_day else ()
        channels = {}
        for column, name in enumerate(record.channels):
            own = moments[column]
            known = dict(fits[column].coefficients) if column < len(fits) else {}
            for term, each in zip(
                BIAS_TERMS, curves[column].terms[1:] if column < len(curves) else (), strict=False
            ):
                known[term] = Estimate(value=each.value, low=each.low, high=each.high, status="measured")
            channels[name] = PeriodChannel(mean=own.mean, std=own.std, coefficients=known)
        return channels
