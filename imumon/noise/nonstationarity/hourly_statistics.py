"""Statistics of a record, split at the possible ends of a warm-up and at every hour.

One cascade and one set of moments run. Windows of the cascade (`windows`) give the sums since a candidate end
of a warm-up, or of an hour. Moments are kept in segments between the same splits and merged on request. All
decisions fall at fixed times of the sample clock: the same record gives the same result for any chunking and
whenever a result is requested.

- Warm-up: candidates are 2, 5, 10, 20 and 40 min. When the record is two and a half times as long as one, the
  slopes before and after it are compared (`warmup.has_settled`), and an exponential that was over by then is
  sought (`settling`). From then on, the samples before the end of a warm-up are excluded.
- Hours: as they age, neighbours of equal length are joined, so their number grows with the logarithm of the
  record. Each whole hour is compared with all before it (`change.detect_changes`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.noise.allan import AllanCurve, OctaveCascade
from imumon.noise.allan.windows import Window, WindowedCascade, WindowSums
from imumon.noise.detection.disturbance import subset
from imumon.noise.fit import ChannelFit
from imumon.noise.nonstationarity.change import NoiseSummary, detect_changes
from imumon.noise.nonstationarity.drift import DriftAccumulator
from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.noise.nonstationarity.quarters import Quarters
from imumon.noise.nonstationarity.stretches import Stretches
from imumon.noise.nonstationarity.warmup import (
    CANDIDATES_S,
    DECISION_LENGTH,
    EARLY_PROBABILITY,
    OVER_SHARES,
    has_settled,
    wandered_early,
)
from imumon.noise.statistics.moments import Moments, MomentsResult
from imumon.report import Change
from imumon.samples import Bools, Floats

HOUR_S = 3600.0
"""s, length of the stretches that are compared with those before: long enough for B. Not critical."""
LONG_GAP_HOURS = 2
"""Hours of a gap from which its hours are skipped as one. Not critical."""

HOURS_BEFORE = "hours before"
QUANTITIES = ("N", "B", "bias")
"""Quantities of a change, by number in the saved state."""

FitCurve = Callable[[AllanCurve], Sequence[ChannelFit]]


@dataclass(slots=True, eq=False)
class Hour:
    """One hour, or several joined.

    Attributes
    ----------
    start : samples of the grid before it.
    count : number of hours.
    stretch, moments : their sums.
    """

    start: int
    count: int
    stretch: WindowSums
    moments: Moments

    def joined(self, other: Hour) -> Hour:
        """Return both as one, `other` being the later one."""
        moments = self.moments.copy()
        moments.merge(other.moments)
        return Hour(self.start, self.count + other.count, self.stretch + other.stretch, moments)


class HourlyStatistics:
    """Statistics of a record, with its warm-up excluded and its hours compared.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1.
    allan_channels : number of leading channels with an Allan curve.
    interval_s : s, sampling interval.
    fit : function that fits a curve, for the decisions.
    warmup_channels : channels in which a warm-up may show; empty: none is excluded.
    temperature : column of the temperature; None: there is none.

    Attributes
    ----------
    warmup_s : s, valid samples that are excluded as a warm-up, without the missing or otherwise excluded ones
        within it.
    drift : means of the whole record.
    decisions : time in s, and `warmup_s`, of each end of a warm-up that was found; the monitor takes them.
    comparisons : time in s, and changes by column, of each hour that was compared; the monitor takes them.
    stretches : every 10 minutes, hour and day.
    warmup_channels : as given.
    """

    def __init__(
        self,
        groups: Sequence[int],
        allan_channels: int,
        interval_s: float,
        fit: FitCurve,
        *,
        warmup_channels: Sequence[int] = (),
        temperature: int | None = None,
    ) -> None:
        self._groups, self._interval, self._fit = list(groups), interval_s, fit
        self._allan_channels, self.warmup_channels = allan_channels, tuple(warmup_channels)
        self._allan_groups = max(self._groups[:allan_channels], default=-1) + 1
        rate = 1.0 / interval_s
        self.drift = DriftAccumulator(groups, rate, temperature)
        cascade = OctaveCascade(allan_channels, interval_s, groups=self._groups[:allan_channels])
        self._cascade = WindowedCascade(cascade)
        self._candidates = [round(t * rate) for t in CANDIDATES_S] if warmup_channels else []
        self._hour = round(HOUR_S * rate)
        self._marks: dict[int, Window] = {0: self._cascade.open_window()}
        self._start = 0  # end of the warm-up
        self.warmup_s = 0.0
        self.decisions: list[tuple[float, float]] = []
        self.comparisons: list[tuple[float, dict[int, tuple[Change, ...]]]] = []
        self._hour_mark = self._cascade.open_window()
        self._quarters = Quarters(self._cascade, rate)
        self._segments: list[tuple[int, Moments]] = [(0, self._new())]
        self.stretches = Stretches(self._cascade, rate, self._merged)
        self._hours: list[Hour] = []
        self._changes: dict[int, tuple[Change, ...]] = {}

    @property
    def begin_s(self) -> float:
        """s since the first sample, end of the warm-up."""
        return self._start * self._interval

    @property
    def position(self) -> int:
        """Samples of the grid so far."""
        return self._cascade.position

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples (n, c), channel unit, of which those with `valid` (n, g) count; None: all."""
        done = 0
        while done < len(values):
            stop = min(len(values), done + self._until_split())
            part, ok = values[done:stop], None if valid is None else valid[done:stop]
            self.drift.update(part, ok)
            self._segments[-1][1].update(part, ok)
            allan_ok = None if ok is None else ok[:, : self._allan_groups]
            self._cascade.update(part[:, : self._allan_channels], allan_ok)
            self._split()
            done = stop

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing."""
        while n > 0:
            part = min(n, self._until_split())
            long = n > LONG_GAP_HOURS * self._hour and self.position % self._hour == 0
            if long and len(self._splits()) == 1:
                part = n // self._hour * self._hour  # hours without samples are skipped
            self.drift.skip(part)
            self._cascade.skip(part)
            self._split()
            n -= part

    def break_(self) -> None:
        """Note a gap of unknown length."""
        self._cascade.break_()

    def curve(self) -> AllanCurve:
        """Return the Allan curve of everything after the warm-up."""
        if not self._start:
            return self._cascade.cascade.result()
        return self._curve(self._cascade.sums_since(self._marks[self._start]))

    def moments(self) -> MomentsResult:
        """Return the moments of everything after the warm-up."""
        return self._merged(self._start, self.position + 1).result()

    def hours(self) -> tuple[Hour, ...]:
        """Return the finished hours after the warm-up, oldest first; older ones are joined."""
        return tuple(self._hours)

    def quarters(self) -> list[AllanCurve] | None:
        """Return the Allan curves of the four quarters after the warm-up; None while the record is too short."""
        sums = self._quarters.result()
        return None if sums is None else [self._curve(quarter) for quarter in sums]

    def changes(self) -> dict[int, tuple[Change, ...]]:
        """Return the changes of the last whole hour against those before, by column."""
        return dict(self._changes)

    def _splits(self) -> tuple[int, ...]:
        """Return the places of the next splits: candidates, their decisions, the end of the hour."""
        at = self.position
        places = (*self._candidates, *(round(DECISION_LENGTH * c) for c in self._candidates))
        return (*(place for place in places if place > at), (at // self._hour + 1) * self._hour)

    def _until_split(self) -> int:
        return min(*self._splits(), self._quarters.next_end, self.stretches.next_end) - self.position

    def _split(self) -> None:
        """Open windows, decide candidates, end the hour and a stretch of a quarter if due at this place."""
        at = self.position
        self._quarters.close_stretch()
        if at in self._candidates:
            self._marks[at] = self._cascade.open_window()
            self._segments.append((at, self._new()))
        for candidate in self._candidates:
            if at == round(DECISION_LENGTH * candidate) and candidate in self._marks:
                self._decide(candidate)
        if at % self._hour == 0 and at > 0:
            self._end_hour(at)
        if self.stretches.close_due() and self._segments[-1][0] != at:
            self._segments.append((at, self._new()))

    def _decide(self, candidate: int) -> None:
        """Decide whether a warm-up ended at a candidate."""
        begin, middle = self._start * self._interval, candidate * self._interval
        mark = self._marks[candidate]
        times = [share * middle for share in OVER_SHARES]
        settled = wandered_early(self.drift, self.warmup_channels, begin, middle, EARLY_PROBABILITY)
        settled = settled or any(
            fit is not None and fit.significant
            for fit in self.drift.settling(self.warmup_channels, times, begin)
        )
        if settled or self._slopes_settled(mark, begin, middle):
            self._start = candidate
            self._quarters.discard_before(candidate)
            self.warmup_s = self._warmup_length_s()
            self.decisions.append((self.position * self._interval, self.warmup_s))
            self._hours, self._changes = [], {}
        for start in [s for s in self._marks if s != self._start and s <= candidate]:
            self._cascade.close_window(self._marks.pop(start))

    def _slopes_settled(self, mark: Window, begin: float, middle: float) -> bool:
        """Return whether the drift of a channel clearly ended at `middle`, s; `mark` begins there."""
        # the noise is fitted after the candidate: a warm-up raises the fitted K
        fits = self._fit(self._curve(self._cascade.sums_since(mark)).select(self.warmup_channels))
        return any(
            has_settled(self.drift.slope(c, noise, begin, middle), self.drift.slope(c, noise, middle))
            for c, fit in zip(self.warmup_channels, fits, strict=True)
            if (noise := MeanCovariance.of(fit)) is not None
        )

    def _warmup_length_s(self) -> float:
        """Return the length of the valid samples before the end of the warm-up, s."""
        if not self._start:
            return 0.0
        before = self._merged(0, self._start).result().channels
        return max(before[c].count for c in self.warmup_channels) * self._interval

    def _end_hour(self, at: int) -> None:
        """Keep the hour that ended and compare it with those before."""
        stretch = self._cascade.block_sums_since(self._hour_mark)
        start = max(self._start, at - self._hour)
        self._cascade.close_window(self._hour_mark)
        self._hour_mark = self._cascade.open_window()
        if at - self._hour >= self._start and stretch.valid.any():
            last = Hour(start, 1, stretch, self._merged(start, at))
            if self._hours:
                self._changes = self._compare(last)
                self.comparisons.append((at * self._interval, self._changes))
            self._hours.append(last)
            self._join_hours()
        self._segments.append((at, self._new()))
        self._merge_segments(at)

    def _compare(self, last: Hour) -> dict[int, tuple[Change, ...]]:
        """Return the changes of an hour against all before it, by column."""
        before = self._hours[0]
        for hour in self._hours[1:]:
            before = before.joined(hour)
        fits = [self._fit(self._curve(hour.stretch)) for hour in (before, last)]
        means = [[m.mean for m in hour.moments.result().channels] for hour in (before, last)]
        seconds = [hour.stretch.span * self._interval for hour in (before, last)]
        by_column = {}
        for column in range(self._allan_channels):
            old, new = (NoiseSummary.of(fits[i][column], means[i][column], seconds[i]) for i in (0, 1))
            if changes := detect_changes(old, new, HOURS_BEFORE):
                by_column[column] = tuple(changes)
        return by_column

    def _join_hours(self) -> None:
        """Join the older two of three stretches of one length, shortest stretches first."""
        size = 1
        while len(same := [i for i, hour in enumerate(self._hours) if hour.count == size]) >= 3:
            older, newer = same[0], same[1]
            self._hours[older] = self._hours[older].joined(self._hours[newer])
            del self._hours[newer]
            size *= 2

    def _merge_segments(self, at: int) -> None:
        """Merge segments that no later split separates."""
        pending = (c for c in self._candidates if DECISION_LENGTH * c > at)
        needed = {self._start, *pending, at - self._hour, at, *self.stretches.starts}
        merged: list[tuple[int, Moments]] = []
        for start, moments in self._segments:
            if merged and start not in needed:
                merged[-1][1].merge(moments)
            else:
                merged.append((start, moments))
        self._segments = merged

    def _merged(self, begin: int, end: int) -> Moments:
        """Return the moments of the segments that begin from `begin` on and before `end`."""
        whole = self._new()
        for start, moments in self._segments:
            if begin <= start < end:
                whole.merge(moments)
        return whole

    def _curve(self, stretch: WindowSums) -> AllanCurve:
        return stretch.curve(self._interval)

    def _new(self) -> Moments:
        return Moments(len(self._groups), groups=self._groups)

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        out = {f"cascade.{k}": v for k, v in self._cascade.save().items()}
        out |= {f"drift.{k}": v for k, v in self.drift.save().items()}
        out |= {f"quarters.{k}": v for k, v in self._quarters.save().items()}
        out |= {f"stretches.{k}": v for k, v in self.stretches.save().items()}
        order = list(self._cascade.windows)
        marks = [[start, order.index(mark)] for start, mark in self._marks.items()]
        out["marks"] = np.array(marks, dtype=np.int64).reshape(-1, 2)
        changes = [
            [column, QUANTITIES.index(c.quantity), c.before, c.now, c.ratio or np.nan, c.sigma]
            for column, changes in self._changes.items()
            for c in changes
        ]
        out["changes"] = np.array(changes, dtype=np.float64).reshape(-1, 6)
        out["numbers"] = np.array([self._start, order.index(self._hour_mark)], dtype=np.int64)
        out["segments"] = np.array([start for start, _ in self._segments], dtype=np.int64)
        for number, (_, moments) in enumerate(self._segments):
            out |= {f"segment{number}.{k}": v for k, v in moments.save().items()}
        out["hours"] = np.array([[h.start, h.count] for h in self._hours], dtype=np.int64).reshape(-1, 2)
        for number, each in enumerate(self._hours):
            part, s = f"hour{number}.", each.stretch
            out |= {f"{part}squares": s.squares, f"{part}terms": s.terms, f"{part}lacks": s.white_excess}
            out[f"{part}valid"] = s.valid
            out[f"{part}numbers"] = np.array([s.span, s.segments], dtype=np.int64)
            out |= {f"{part}moments.{k}": v for k, v in each.moments.save().items()}
        return out

    def restore(self, saved: Mapping[str, np.ndarray]) -> None:
        """Continue from a saved state; the object is new and has the same arguments."""
        self._cascade = WindowedCascade.restore(subset(saved, "cascade."))
        self.drift = DriftAccumulator.restore(subset(saved, "drift."))
        rate = 1.0 / self._interval
        self._quarters = Quarters.restore(self._cascade, rate, subset(saved, "quarters."))
        self.stretches.restore(self._cascade, subset(saved, "stretches."))
        marks = self._cascade.windows
        self._start, hour = (int(v) for v in saved["numbers"])
        self._marks = {int(start): marks[int(number)] for start, number in saved["marks"]}
        self._hour_mark = marks[hour]
        self._segments = [
            (int(start), Moments.restore(subset(saved, f"segment{number}.")))
            for number, start in enumerate(saved["segments"])
        ]
        self.warmup_s = self._warmup_length_s()
        self._changes = {}
        for column, quantity, before, now, ratio, sigma in saved["changes"].tolist():
            name, known = QUANTITIES[int(quantity)], None if np.isnan(ratio) else ratio
            change = Change(
                against=HOURS_BEFORE, quantity=name, before=before, now=now, ratio=known, sigma=sigma
            )
            self._changes[int(column)] = (*self._changes.get(int(column), ()), change)
        self._hours = []
        for number, (start, count) in enumerate(saved["hours"]):
            own = subset(saved, f"hour{number}.")
            span, segments = (int(v) for v in own["numbers"])
            stretch = WindowSums(own["squares"], own["terms"], own["lacks"], own["valid"], span, segments)
            moments = Moments.restore(subset(own, "moments."))
            self._hours.append(Hour(int(start), int(count), stretch, moments))
