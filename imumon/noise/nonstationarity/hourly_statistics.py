"""History: the statistics of a record, cut where it may matter later: behind a warm-up, and every hour.

One cascade and one set of moments run. Marks (`marks`) give what came since a candidate end of a warm-up,
or in each hour, without running anything twice; moments are kept in pieces between the same cuts and joined
when asked for. All decisions fall at fixed times of the sensor's clock: the same record gives the same
result however it is fed and whenever it is asked.

- Warm-up: candidates are 2, 5, 10, 20 and 40 min. When the record is two and a half times as long as one,
  slopes before and behind it are compared (`warmup.settles`), and a decay that was over by then is looked for
  (`decay`); what came before a warm-up's end is left out from then on.
- Hours: as they age, neighbours of equal length are joined, so their number grows with the logarithm of the
  record. Each whole hour is compared with all before it (`stationarity.changes`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.noise.allan import AllanCurve, OctaveCascade
from imumon.noise.allan.windows import Window, WindowedCascade, WindowSums
from imumon.noise.detection.disturbance import under
from imumon.noise.nonstationarity.change import Behaviour, Change, changes
from imumon.noise.nonstationarity.drift import Drift
from imumon.noise.nonstationarity.mean_covariance import Fitted, MeanCovariance
from imumon.noise.nonstationarity.warmup import ENOUGH, OVER, TIMES_S, settles
from imumon.noise.statistics.moments import Moments, MomentsResult
from imumon.samples import Bools, Floats

HOUR_S = 3600.0

Fit = Callable[[AllanCurve], Sequence[Fitted]]


@dataclass(slots=True, eq=False)
class Hour:
    """One hour, or several joined.

    Attributes
    ----------
    start : samples of the grid.
    count : hours in it.
    stretch, moments : their sums.
    """

    start: int
    count: int
    stretch: WindowSums
    moments: Moments

    def joined(self, other: Hour) -> Hour:
        """Both, `other` the later one."""
        moments = self.moments.copy()
        moments.merge(other.moments)
        return Hour(self.start, self.count + other.count, self.stretch + other.stretch, moments)


@dataclass(frozen=True, slots=True)
class Moved:
    """A change of a channel from the hours before to the last one."""

    column: int
    change: Change


class HourlyStatistics:
    """Statistics of a record, with its warm-up left out and its hours compared.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1.
    noisy : the first so many channels have an Allan curve.
    interval_s : s, sampling interval.
    fit : fits a curve, for the decisions.
    warming : channels in which a warm-up may show; none: it is not looked for.
    temperature : channel that is the temperature, or None.

    Attributes
    ----------
    warmup_s : s, length of the samples that count but for the recognised warm-up: what is missing or cut out
        in it has its own account.
    drift : means of the whole record.
    """

    def __init__(
        self,
        groups: Sequence[int],
        noisy: int,
        interval_s: float,
        fit: Fit,
        *,
        warming: Sequence[int] = (),
        temperature: int | None = None,
    ) -> None:
        self._groups, self._noisy, self._interval = list(groups), noisy, interval_s
        self._fit, self._warming = fit, tuple(warming)
        rate = 1.0 / interval_s
        self.drift = Drift(groups, rate, temperature)
        self._cascade = WindowedCascade(OctaveCascade(noisy, interval_s, groups=self._groups[:noisy]))
        self._candidates = [round(t * rate) for t in TIMES_S] if warming else []
        self._hour = round(HOUR_S * rate)
        self._marks: dict[int, Window] = {0: self._cascade.open_window()}
        self._start = 0  # end of the warm-up
        self.warmup_s = 0.0
        self._hour_mark = self._cascade.open_window()
        self._pieces: list[tuple[int, Moments]] = [(0, self._new())]
        self._finished: Moments | None = None  # of the pieces that count but for the last, once asked for
        self._hours: list[Hour] = []
        self._moved: list[Moved] = []

    @property
    def begin_s(self) -> float:
        """s since the first sample, end of the warm-up."""
        return self._start * self._interval

    @property
    def position(self) -> int:
        """Samples of the grid so far."""
        return self._cascade.position

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Take samples, (n, c) channel unit, with what counts of them, (n, g)."""
        done = 0
        while done < len(values):
            stop = min(len(values), done + self._until_cut())
            part, ok = values[done:stop], None if valid is None else valid[done:stop]
            noisy_groups = max(self._groups[: self._noisy], default=-1) + 1
            self.drift.update(part, ok)
            self._pieces[-1][1].update(part, ok)
            self._cascade.update(part[:, : self._noisy], None if ok is None else ok[:, :noisy_groups])
            self._cut()
            done = stop

    def skip(self, n: int) -> None:
        """`n` samples are missing."""
        while n > 0:
            part = min(n, self._until_cut())
            if n > 2 * self._hour and self.position % self._hour == 0 and len(self._events()) == 1:
                part = n // self._hour * self._hour  # hours in which nothing came are not kept
            self.drift.skip(part)
            self._cascade.skip(part)
            self._cut()
            n -= part

    def break_(self) -> None:
        """A gap of unknown length."""
        self.drift.break_()
        self._cascade.break_()

    def curve(self) -> AllanCurve:
        """Allan curve of everything behind the warm-up."""
        if not self._start:
            return self._cascade.cascade.result()
        return self._curve(self._cascade.sums_since(self._marks[self._start]))

    def running(self) -> MomentsResult:
        """Moments of everything behind the warm-up."""
        if self._finished is None:
            self._finished = self._joined(self._start, self._pieces[-1][0])
        whole = self._finished.copy()
        whole.merge(self._pieces[-1][1])
        return whole.result()

    def hours(self) -> tuple[Hour, ...]:
        """Finished hours behind the warm-up, oldest first, older ones joined."""
        return tuple(self._hours)

    def moved(self) -> list[Moved]:
        """Changes from the hours before to the last whole one."""
        return list(self._moved)

    # ------------------------------------------------------------------ cuts

    def _events(self) -> tuple[int, ...]:
        """Places of the cuts that are still to come: candidates, their decisions, the end of the hour."""
        at = self.position
        whole = (*self._candidates, *(round(ENOUGH * c) for c in self._candidates))
        return (*(place for place in whole if place > at), (at // self._hour + 1) * self._hour)

    def _until_cut(self) -> int:
        return min(self._events()) - self.position

    def _cut(self) -> None:
        """What falls due at this place."""
        at = self.position
        if at in self._candidates:
            self._marks[at] = self._cascade.open_window()
            self._begin_piece(at)
        for candidate in self._candidates:
            if at == round(ENOUGH * candidate):
                self._decide(candidate)
        if at % self._hour == 0 and at > 0:
            self._end_hour(at)

    def _decide(self, candidate: int) -> None:
        """Whether a warm-up ended at a candidate."""
        begin, middle = self._start * self._interval, candidate * self._interval
        mark = self._marks[candidate]
        # noise fitted behind the candidate: what came before may be a ramp
        fits = self._fit(self._curve(self._cascade.sums_since(mark)).select(self._warming))
        over = [share * middle for share in OVER]
        settled = any(
            (found := self.drift.decay(c, over, begin)) is not None and found.plain for c in self._warming
        ) or any(
            settles(self.drift.slope(c, wander, begin, middle), self.drift.slope(c, wander, middle))
            for c, fit in zip(self._warming, fits, strict=True)
            if (wander := MeanCovariance.of(fit)) is not None
        )
        if settled:
            self._start, self._finished = candidate, None
            self.warmup_s = self._warmed()
            self._hours, self._moved = [], []
        for start in [s for s in self._marks if s != self._start and s <= candidate]:
            self._cascade.close_window(self._marks.pop(start))

    def _warmed(self) -> float:
        """s, length of the samples before the warm-up's end."""
        if not self._start:
            return 0.0
        before = self._joined(0, self._start).result().channels
        return max(before[c].count for c in self._warming) * self._interval

    def _end_hour(self, at: int) -> None:
        """An hour is over: keep it, and compare it with those before."""
        stretch = self._cascade.block_sums_since(self._hour_mark)
        start = max(self._start, at - self._hour)
        self._cascade.close_window(self._hour_mark)
        self._hour_mark = self._cascade.open_window()
        if at - self._hour >= self._start and stretch.valid.any():
            moments = self._joined(start, at).copy()
            last = Hour(start, 1, stretch, moments)
            if self._hours:
                self._moved = self._compared(last)
            self._hours.append(last)
            self._join_hours()
        self._begin_piece(at)
        self._join_pieces(at)

    def _compared(self, last: Hour) -> list[Moved]:
        """What differs between an hour and all before it."""
        before = self._hours[0]
        for hour in self._hours[1:]:
            before = before.joined(hour)
        fits = [self._fit(self._curve(hour.stretch)) for hour in (before, last)]
        means = [[m.mean for m in hour.moments.result().channels] for hour in (before, last)]
        seconds = [hour.stretch.span * self._interval for hour in (before, last)]
        found = []
        for column in range(self._noisy):
            old, new = (
                Behaviour.of(fits[which][column], means[which][column], seconds[which]) for which in (0, 1)
            )
            found += [Moved(column, change) for change in changes(old, new)]
        return found

    def _join_hours(self) -> None:
        """Join the older two of three hours of one length, from the youngest on."""
        size = 1
        while len(same := [i for i, hour in enumerate(self._hours) if hour.count == size]) >= 3:
            older, newer = same[0], same[1]
            self._hours[older] = self._hours[older].joined(self._hours[newer])
            del self._hours[newer]
            size *= 2

    def _begin_piece(self, at: int) -> None:
        """Moments of what comes from here on are kept apart."""
        self._pieces.append((at, self._pieces[-1][1].following()))
        self._finished = None

    def _join_pieces(self, at: int) -> None:
        """Pieces that no cut can separate any more become one."""
        needed = {self._start, *(c for c in self._candidates if ENOUGH * c > at), at - self._hour, at}
        kept: list[tuple[int, Moments]] = []
        for start, moments in self._pieces:
            if kept and start not in needed:
                kept[-1][1].merge(moments)
            else:
                kept.append((start, moments))
        self._pieces, self._finished = kept, None

    def _joined(self, begin: int, end: int) -> Moments:
        """Moments of the pieces that begin from `begin` on and before `end`."""
        pieces = [moments for start, moments in self._pieces if begin <= start < end]
        if len(pieces) == 1:
            return pieces[0]
        whole = self._new()
        for moments in pieces:
            whole.merge(moments)
        return whole

    def _curve(self, stretch: WindowSums) -> AllanCurve:
        return stretch.curve(self._interval, self._cascade.cascade.ratio)

    def _new(self) -> Moments:
        return Moments(len(self._groups), groups=self._groups)

    # ------------------------------------------------------------------ state

    def save(self) -> dict[str, np.ndarray]:
        """State as arrays."""
        out = {f"cascade.{k}": v for k, v in self._cascade.save().items()}
        out |= {f"drift.{k}": v for k, v in self.drift.save().items()}
        order = list(self._cascade.windows)
        marks = [[start, order.index(mark)] for start, mark in self._marks.items()]
        out["marks"] = np.array(marks, dtype=np.int64).reshape(-1, 2)
        hour = next(i for i, mark in enumerate(order) if mark is self._hour_mark)
        out["numbers"] = np.array([self._start, hour], dtype=np.int64)
        out["pieces"] = np.array([start for start, _ in self._pieces], dtype=np.int64)
        for number, (_, moments) in enumerate(self._pieces):
            out |= {f"piece{number}.{k}": v for k, v in moments.save().items()}
        out["hours"] = np.array([[h.start, h.count] for h in self._hours], dtype=np.int64).reshape(-1, 2)
        for number, each in enumerate(self._hours):
            part, s = f"hour{number}.", each.stretch
            out |= {f"{part}squares": s.squares, f"{part}terms": s.terms, f"{part}lacks": s.white_excess}
            out[f"{part}valid"] = s.valid
            out[f"{part}numbers"] = np.array([s.span, s.segments], dtype=np.int64)
            out |= {f"{part}moments.{k}": v for k, v in each.moments.save().items()}
        return out

    def resume(self, saved: Mapping[str, np.ndarray]) -> None:
        """Continue where `save` left off, in a history just made with the same arguments."""
        self._cascade = WindowedCascade.restore(under(saved, "cascade."))
        self.drift = Drift.restore(under(saved, "drift."))
        marks = self._cascade.windows
        self._start, hour = (int(v) for v in saved["numbers"])
        self._marks = {int(start): marks[int(number)] for start, number in saved["marks"]}
        self._hour_mark = marks[hour]
        self._pieces = [
            (int(start), Moments.restore(under(saved, f"piece{number}.")))
            for number, start in enumerate(saved["pieces"])
        ]
        self._finished = None
        self.warmup_s = self._warmed()
        self._hours = []
        for number, (start, count) in enumerate(saved["hours"]):
            own = under(saved, f"hour{number}.")
            span, segments = (int(v) for v in own["numbers"])
            stretch = WindowSums(own["squares"], own["terms"], own["lacks"], own["valid"], span, segments)
            moments = Moments.restore(under(own, "moments."))
            self._hours.append(Hour(int(start), int(count), stretch, moments))
