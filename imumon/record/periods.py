"""Periods: what the record showed in each hour and day, for the history.

N, B and K belong to the period alone. Counters are read when a period ends, while the guard still holds some samples
back; so they may belong to samples of some seconds later, but their sums are those of the record. What is in progress
is fitted again every half minute.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from imumon.model.coefficients import BIAS_SLOPE, Estimate, by_letter
from imumon.model.history_report import HistoryPeriod, PeriodChannel
from imumon.noise.fit import Estimator
from imumon.noise.stretches.stretches import LENGTHS_S, Stretch
from imumon.record.accumulators import Accumulators
from imumon.record.analysis import Analysis

PAUSE_S = 30.0
"""s from one fit of the periods in progress to the next."""


class Periods:
    """Periods of one record, those in progress included.

    Parameters
    ----------
    record : as it grows.
    analysis : of this record, for resolution, grades and settling.
    counted : those of a saved record, which continues; None: a record begins, or the earlier samples of this one belong
        to no period.
    averaged : (c,) channels that are true averages over their interval.

    Attributes
    ----------
    counted : counters of the record when the last period of each length ended, by that length in s, and by name.
    """

    def __init__(
        self,
        record: Accumulators,
        analysis: Analysis,
        counted: dict[int, dict[str, int]] | None = None,
        *,
        averaged: Sequence[bool],
    ) -> None:
        self._record, self._analysis = record, analysis
        self._estimators = {step: Estimator(averaged=averaged, time_to=False) for step in LENGTHS_S}
        self.counted = counted or {step: self._counts() for step in LENGTHS_S}
        self._current: dict[int, HistoryPeriod] = {}
        self._due_s = 0.0

    def update(self, stretches: Iterable[Stretch]) -> list[HistoryPeriod]:
        """Return the periods of stretches that have just ended."""
        periods = []
        for stretch in stretches:
            periods.append(self._period(stretch, complete=True))
            self.counted[stretch.length_s] = self._counts()
            self._due_s = 0.0  # a period in progress begins here: the next call shows it at once
        return periods

    def end(self) -> list[HistoryPeriod]:
        """Return the periods in progress as they are: the record ends here."""
        self._current = {}
        stretches = (self._stretch(step) for step in LENGTHS_S)
        return [self._period(stretch, complete=True) for stretch in stretches if stretch is not None]

    def in_progress(self, *, force: bool = False) -> list[HistoryPeriod]:
        """Return the periods in progress; those of the last call unless they have grown, or with `force`.

        Longer ones that began earlier are fitted again only when a shorter one has ended.
        """
        record = self._record
        if not force and record.elapsed_s < self._due_s:
            return list(self._current.values())
        # The fit of a day in progress costs as much as that of a whole one, and half a minute hardly changes it.
        again = force or self._due_s == 0.0
        for step in LENGTHS_S if again else LENGTHS_S[:1]:
            stretch = self._stretch(step)
            if stretch is None:
                self._current.pop(step, None)
            else:
                self._current[step] = self._period(stretch, complete=False)
        if (shortest := self._current.get(LENGTHS_S[0])) is not None:
            for step in LENGTHS_S[1:]:
                # Both began together, so they hold the same samples: one fit serves both.
                if self.counted[step] == self.counted[LENGTHS_S[0]]:
                    number = shortest.number * LENGTHS_S[0] // step
                    self._current[step] = replace(shortest, step_s=step, number=number)
        self._due_s = record.elapsed_s + PAUSE_S if self._current else 0.0
        return list(self._current.values())

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
        before, now = self.counted[stretch.length_s], self._counts()
        moments = stretch.moments.result().channels
        length = max(1, round(LENGTHS_S[0] / interval_s)) * (stretch.length_s // LENGTHS_S[0])
        temperature = None if record.temperature is None else moments[record.temperature].mean
        return HistoryPeriod(
            step_s=stretch.length_s,
            number=stretch.start // length,
            begin_age_s=(record.span - stretch.start) * interval_s,
            end_age_s=(record.span - stretch.end) * interval_s,
            complete=complete,
            samples=now["samples"] - before["samples"],
            missing=now["missing"] - before["missing"],
            excluded_s=(now["excluded"] - before["excluded"]) * interval_s,
            temperature=temperature,
            warming_up=self._analysis.warming_up,
            grades={sensor: grade.meets for sensor, grade in self._analysis.grades.items()},
            channels=self._channels(stretch, moments),
        )

    def _channels(self, stretch: Stretch, moments: Sequence[Any]) -> dict[str, PeriodChannel]:
        record = self._record
        estimator, length = self._estimators[stretch.length_s], stretch.end - stretch.start
        fits = estimator.fit_sums(stretch.sums, length, self._analysis.resolution)
        heat = None if record.temperature is None else moments[record.temperature]
        extremes = None if heat is None or heat.min is None else (heat.min, heat.max)
        is_day = stretch.length_s == LENGTHS_S[-1]  # a shorter period seldom spans enough temperature
        curves = estimator.bias_curves(stretch.sums, extremes) if is_day else ()
        channels = {}
        for column, name in enumerate(record.channels):
            fit = fits[column] if column < len(fits) else None
            known = {} if fit is None else by_letter(fit.coefficients, fit.markov)
            if column < len(curves) and curves[column].terms:
                _, slope = curves[column].terms  # `mean` shows the bias at the reference
                known[BIAS_SLOPE] = Estimate(
                    value=slope.value, low=slope.low, high=slope.high, status="measured"
                )
            mean, std = moments[column].mean, moments[column].std
            channels[name] = PeriodChannel(mean=mean, std=std, coefficients=known)
        return channels
