"""Periods: what the record showed in each hour and day, for the history.

N, B and K belong to the period alone. Counters are read when a period ends, while the guard still holds some samples
back; so they may belong to samples of some seconds later, but their sums are those of the record. What is in progress
is shown as it was a minute ago at most, with fits that may be older (`fit_pause_s`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from imumon.model.coefficients import BIAS_SLOPE, Estimate, by_letter
from imumon.model.history_report import HistoryPeriod, PeriodChannel
from imumon.model.samples import ChannelName
from imumon.noise.fit import ChannelFit, Estimator
from imumon.noise.stretches import Sums
from imumon.noise.stretches.stretches import LENGTHS_S, Stretch
from imumon.record.counts import Counts
from imumon.record.fits import LONGEST_PAUSE_S, Fits, fit_pause_s


class Periods:
    """Periods of one record, those in progress included.

    Parameters
    ----------
    sums : of the record, as it grows.
    fits : of this record, for resolution, grades and settling.
    counts : of this record as it is now.
    counted : those of a saved record, which continues; None: a record begins, or the earlier samples of this one belong
        to no period.

    Attributes
    ----------
    counted : counters of the record when the last period of each length ended, by that length in s, and by name.
    """

    def __init__(
        self,
        sums: Sums,
        fits: Fits,
        counts: Counts,
        counted: dict[int, dict[str, int]] | None = None,
    ) -> None:
        self._sums, self._fits = sums, fits
        self._estimators = {
            step: Estimator(averaged=fits.stream.averaged, time_to=False) for step in LENGTHS_S
        }
        self.counted = counted or {step: _totals(counts) for step in LENGTHS_S}
        self._current: dict[int, HistoryPeriod] = {}
        # of the stretch of each length that was fitted last: its start and length, samples, and the fits
        self._fitted: dict[int, tuple[int, int, tuple[ChannelFit, ...]]] = {}
        self._due_s = 0.0

    def update(self, stretches: Iterable[Stretch], counts: Counts) -> list[HistoryPeriod]:
        """Return the periods of stretches that have just ended."""
        periods = []
        for stretch in stretches:
            periods.append(self._period(stretch, counts, complete=True))
            self.counted[stretch.length_s] = _totals(counts)
            self._due_s = 0.0  # a period in progress begins here: the next call shows it at once
        return periods

    def end(self, counts: Counts) -> list[HistoryPeriod]:
        """Return the periods in progress as they are: the record ends here."""
        self._current = {}
        stretches = (self._sums.stretch_in_progress(step) for step in LENGTHS_S)
        return [self._period(stretch, counts, complete=True) for stretch in stretches if stretch is not None]

    def in_progress(self, counts: Counts) -> list[HistoryPeriod]:
        """Return the periods in progress; those of the last call unless they have grown.

        Longer ones that began earlier are fitted again only when a shorter one has ended.
        """
        if counts.elapsed_s < self._due_s:
            return list(self._current.values())
        # The fit of a day in progress costs as much as that of a whole one, and a minute hardly changes it.
        for step in LENGTHS_S[:1] if self._due_s else LENGTHS_S:
            stretch = self._sums.stretch_in_progress(step)
            if stretch is None:
                self._current.pop(step, None)
            else:
                self._current[step] = self._period(stretch, counts, complete=False)
        if (shortest := self._current.get(LENGTHS_S[0])) is not None:
            for step in LENGTHS_S[1:]:
                # Both began together, so they hold the same samples: one fit serves both.
                if self.counted[step] == self.counted[LENGTHS_S[0]]:
                    number = shortest.number * LENGTHS_S[0] // step
                    self._current[step] = replace(shortest, step_s=step, number=number)
        self._due_s = counts.elapsed_s + LONGEST_PAUSE_S if self._current else 0.0
        return list(self._current.values())

    def _period(self, stretch: Stretch, counts: Counts, *, complete: bool) -> HistoryPeriod:
        fits, interval_s = self._fits, counts.interval_s
        before, now = self.counted[stretch.length_s], _totals(counts)
        moments = stretch.moments.result().channels
        length = max(1, round(LENGTHS_S[0] / interval_s)) * (stretch.length_s // LENGTHS_S[0])
        heat = self._sums.temperature
        return HistoryPeriod(
            step_s=stretch.length_s,
            number=stretch.start // length,
            begin_age_s=(counts.span - stretch.start) * interval_s,
            end_age_s=(counts.span - stretch.end) * interval_s,
            complete=complete,
            samples=now["samples"] - before["samples"],
            missing=now["missing"] - before["missing"],
            excluded_s=(now["excluded"] - before["excluded"]) * interval_s,
            temperature=None if heat is None else moments[heat].mean,
            warming_up=fits.warming_up,
            grades={sensor: grade.meets for sensor, grade in fits.grades.items()},
            channels=self._channels(stretch, moments, self._fits_of(stretch, interval_s, complete=complete)),
        )

    def _fits_of(self, stretch: Stretch, interval_s: float, *, complete: bool) -> tuple[ChannelFit, ...]:
        """Return the fits of a stretch, of one in progress those of when it was a little shorter."""
        length = stretch.end - stretch.start
        if not complete and (known := self._fitted.get(stretch.length_s)) is not None:
            start, earlier, fits = known
            is_new = (length - earlier) * interval_s < fit_pause_s(earlier * interval_s)
            if start == stretch.start and is_new:
                return fits
        fits = self._estimators[stretch.length_s].fit_sums(stretch.sums, length, self._fits.resolution)
        self._fitted[stretch.length_s] = stretch.start, length, fits
        return fits

    def _channels(
        self, stretch: Stretch, moments: Sequence[Any], fits: Sequence[ChannelFit]
    ) -> dict[ChannelName, PeriodChannel]:
        estimator = self._estimators[stretch.length_s]
        heat = None if self._sums.temperature is None else moments[self._sums.temperature]
        extremes = None if heat is None or heat.min is None else (heat.min, heat.max)
        is_day = stretch.length_s == LENGTHS_S[-1]  # a shorter period seldom spans enough temperature
        curves = estimator.bias_curves(stretch.sums, extremes) if is_day else ()
        channels = {}
        for column, name in enumerate(self._fits.stream.channels):
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


def _totals(counts: Counts) -> dict[str, int]:
    """Return what is counted by period."""
    return {"samples": counts.samples, "missing": counts.missing, "excluded": counts.excluded_samples}
