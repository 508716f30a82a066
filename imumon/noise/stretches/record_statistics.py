"""Statistics of a record, split at the possible ends of a warm-up and at every hour.

One cascade and one set of moments run. Marks in the cascade give the sums since a candidate end of a warm-up, or of an
hour. Moments are kept in segments between the same splits and merged on request. All decisions fall at fixed times of
the sample clock: the same record gives the same result for any chunking and whenever a result is requested.

- Warm-up: when the record is two and a half times as long as a candidate, the fit shows whether a warm-up has ended
  there (`warmup`). From then on, the samples before are excluded.
- Hours: each whole hour is compared with all before it (`change.detect_changes`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.noise.allan import AllanCurve, OctaveCascade
from imumon.noise.allan.windows import Window, WindowedCascade
from imumon.noise.array_state import subset
from imumon.noise.fit import Estimator
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.spectrum.spectrum_accumulator import SpectrumMark
from imumon.noise.statistics.moments import Moments, MomentsResult
from imumon.noise.stretches.change import detect_changes
from imumon.noise.stretches.quarters import Quarters
from imumon.noise.stretches.stretches import STEPS_S, Stretch, Stretches
from imumon.noise.stretches.warmup import CANDIDATES_S, DECISION_LENGTH, is_over, is_warming_up
from imumon.report import Change
from imumon.samples import Bools, Floats

_, HOUR_S, _ = STEPS_S
"""s, length of the parts that are compared with those before: long enough for B."""

HOURS_BEFORE = "hours before"
QUANTITIES = ("N", "B")
"""Quantities of a change, by number in the saved state."""


@dataclass(slots=True)
class Ended:
    """What has ended in a record since it was last asked.

    Attributes
    ----------
    stretches : shorter ones first.
    warmups : time in s, and `RecordStatistics.warmup_s`, of each end of a warm-up that was found.
    hours : time in s, and changes by column, of each hour that was compared.
    """

    stretches: list[Stretch] = field(default_factory=list)
    warmups: list[tuple[float, float]] = field(default_factory=list)
    hours: list[tuple[float, dict[int, tuple[Change, ...]]]] = field(default_factory=list)


class RecordStatistics:
    """Statistics of a record, with its warm-up excluded and its hours compared.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1.
    allan_channels : number of leading channels with an Allan curve.
    interval_s : s, sampling interval.
    averaged : (c,) channels that are true averages over their interval.
    warmup_channels : channels in which a warm-up may show; empty: none is excluded.
    temperature : column of the temperature; None: there is none.

    Attributes
    ----------
    warmup_s : s, valid samples that are excluded as a warm-up, without the missing or otherwise excluded ones
        within it.
    stretches : every 10 minutes, hour and day.
    warmup_channels : as given.
    """

    def __init__(
        self,
        groups: Sequence[int],
        allan_channels: int,
        interval_s: float,
        *,
        averaged: Sequence[bool],
        warmup_channels: Sequence[int] = (),
        temperature: int | None = None,
    ) -> None:
        self._groups, self._interval = list(groups), interval_s
        self._allan_channels, self.warmup_channels = allan_channels, tuple(warmup_channels)
        self._allan_groups = max(self._groups[:allan_channels], default=-1) + 1
        rate = 1.0 / interval_s
        self._averaged = list(averaged)
        self._estimator = Estimator(averaged=self._averaged, time_to=False)
        self._temperature = temperature
        own = self._groups[:allan_channels] + ([] if temperature is None else [self._allan_groups])
        self._cascade = WindowedCascade(OctaveCascade(len(own), interval_s, groups=own))
        self._candidates = [round(t * rate) for t in CANDIDATES_S] if warmup_channels else []
        self._hour = round(HOUR_S * rate)
        self._marks: dict[int, Window] = {0: self._cascade.open_window()}
        self._start = 0  # end of the warm-up
        self.warmup_s = 0.0
        self._quarters = Quarters(self._cascade, rate)
        self._segments: list[tuple[int, Moments]] = [(0, self._new())]
        self._stretches = Stretches(self._cascade, rate, self._merged)
        self._ended = Ended()
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
            self._segments[-1][1].update(part, ok)
            columns, groups = list(range(self._allan_channels)), list(range(self._allan_groups))
            if self._temperature is not None:
                columns, groups = [*columns, self._temperature], [*groups, self._groups[self._temperature]]
            self._cascade.update(part[:, columns], None if ok is None else ok[:, groups])
            self._split()
            done = stop

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing."""
        while n > 0:
            part = min(n, self._until_split())
            if n > self._hour and self.position % self._hour == 0 and len(self._splits()) == 1:
                part = n // self._hour * self._hour  # hours without samples are skipped
            self._cascade.skip(part)
            self._split()
            n -= part

    def break_(self) -> None:
        """Note a gap of unknown length."""
        self._cascade.break_()

    def curve(self) -> AllanCurve:
        """Return the Allan curve of everything after the warm-up, with the sums of its noise."""
        curve = (
            self._cascade.curve_since(self._marks[self._start])
            if self._start
            else self._cascade.cascade.result()
        )
        return curve if self._temperature is None else curve.with_temperature()

    def whole_sums(self) -> NoiseSums | None:
        """Return the sums of the whole record, with its warm-up; None: there are none."""
        sums = self._cascade.cascade.result().sums
        return None if sums is None else self._own(sums)

    def temperature_range(self) -> tuple[float, float] | None:
        """Return the least and the greatest temperature of the whole record, degC; None: there is none."""
        if self._temperature is None:
            return None
        own = self._merged(0, self.position + 1).result().channels[self._temperature]
        return None if own.min is None or own.max is None else (own.min, own.max)

    def is_warming_up(self, curve: AllanCurve) -> bool:
        """Return whether the temperature of the sensor has not come to rest at the end of a curve of this record."""
        if curve.sums is None or curve.sums.degrees is None:
            return False
        return is_warming_up(curve.sums.degrees, curve.sums.blocks.length_s)

    def moments(self) -> MomentsResult:
        """Return the moments of everything after the warm-up."""
        return self._merged(self._start, self.position + 1).result()

    def quarters(self) -> list[tuple[NoiseSums, int]] | None:
        """Return the sums of the four quarters after the warm-up, and their lengths, samples; None: too short."""
        quarters = self._quarters.result()
        return None if quarters is None else [(self._own(sums), span) for sums, span in quarters]

    def _own(self, sums: NoiseSums) -> NoiseSums:
        """Return sums of the cascade as those of the channels with a curve."""
        return sums if self._temperature is None else sums.with_temperature()

    def ended(self) -> Ended:
        """Return and forget what has ended since the last call."""
        ended, self._ended = self._ended, Ended()
        return ended

    def stretch_in_progress(self, step_s: int) -> Stretch | None:
        """Return the stretch in progress of a length of `STEPS_S`; None without a sample in it."""
        stretch = self._stretches.in_progress(STEPS_S.index(step_s))
        return None if stretch is None else replace(stretch, sums=self._own(stretch.sums))

    def changes(self) -> dict[int, tuple[Change, ...]]:
        """Return the changes of the last whole hour against those before, by column."""
        return dict(self._changes)

    def _splits(self) -> tuple[int, ...]:
        """Return the places of the next splits: candidates, their decisions, the end of the hour."""
        at = self.position
        places = (*self._candidates, *(round(DECISION_LENGTH * c) for c in self._candidates))
        return (*(place for place in places if place > at), (at // self._hour + 1) * self._hour)

    def _until_split(self) -> int:
        return min(*self._splits(), self._quarters.next_end, self._stretches.next_end) - self.position

    def _split(self) -> None:
        """Open windows, decide candidates, end the stretches and parts that are due at this place."""
        at = self.position
        self._quarters.close_part()
        if at in self._candidates:
            self._marks[at] = self._cascade.open_window()
            self._segments.append((at, self._new()))
        for candidate in self._candidates:
            if at == round(DECISION_LENGTH * candidate) and candidate in self._marks:
                self._decide(candidate)
        hour_begin = self._stretches.mark(HOUR_S)
        finished = [replace(each, sums=self._own(each.sums)) for each in self._stretches.close_due()]
        self._ended.stretches += finished
        for stretch in finished:
            if stretch.step_s == HOUR_S and stretch.start > self._start:
                self._changes = self._compare(stretch, hour_begin)
                self._ended.hours.append((at * self._interval, self._changes))
        if finished and self._segments[-1][0] != at:
            self._segments.append((at, self._new()))
            self._merge_segments(at)

    def _decide(self, candidate: int) -> None:
        """Decide whether a warm-up ended at a candidate."""
        curve = self.curve()
        # what follows the temperature of a warm-up is a part of the warm-up
        unknown = None if curve.sums is None else np.full(len(curve.sums.blocks.means), np.nan)
        fits = self._estimator.fit(curve, renew=True, degrees=unknown)
        if is_over((fits[c] for c in self.warmup_channels), (candidate - self._start) * self._interval):
            self._start = candidate
            self._quarters.discard_before(candidate)
            self.warmup_s = self._warmup_length_s()
            self._ended.warmups.append((self.position * self._interval, self.warmup_s))
            self._changes = {}
        for start in [s for s in self._marks if s != self._start and s <= candidate]:
            self._cascade.close_window(self._marks.pop(start))

    def _warmup_length_s(self) -> float:
        """Return the length of the valid samples before the end of the warm-up, s."""
        if not self._start:
            return 0.0
        before = self._merged(0, self._start).result().channels
        return max(before[c].count for c in self.warmup_channels) * self._interval

    def _compare(self, hour: Stretch, hour_begin: SpectrumMark) -> dict[int, tuple[Change, ...]]:
        """Return the changes of an hour against all before it, by column."""
        begin = self._marks[self._start].mark
        assert begin is not None
        before = self._own(self._cascade.cascade.part_sums(begin, hour_begin))
        parts = ((before, hour.start - self._start), (hour.sums, hour.end - hour.start))
        old, new = (Estimator(averaged=self._averaged, time_to=False).fit_sums(*part) for part in parts)
        by_column = {}
        for column in range(self._allan_channels):
            if changes := detect_changes(old[column], new[column], HOURS_BEFORE):
                by_column[column] = tuple(changes)
        return by_column

    def _merge_segments(self, at: int) -> None:
        """Merge segments that no later split separates."""
        pending = (c for c in self._candidates if DECISION_LENGTH * c > at)
        needed = {self._start, *pending, at, *self._stretches.starts}
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

    def _new(self) -> Moments:
        return Moments(len(self._groups), groups=self._groups)

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        out = {f"cascade.{k}": v for k, v in self._cascade.save().items()}
        out |= {f"quarters.{k}": v for k, v in self._quarters.save().items()}
        out |= {f"stretches.{k}": v for k, v in self._stretches.save().items()}
        order = list(self._cascade.windows)
        marks = [[start, order.index(mark)] for start, mark in self._marks.items()]
        out["marks"] = np.array(marks, dtype=np.int64).reshape(-1, 2)
        changes = [
            [column, QUANTITIES.index(c.quantity), c.before, c.now, c.ratio or np.nan, c.sigma]
            for column, changes in self._changes.items()
            for c in changes
        ]
        out["changes"] = np.array(changes, dtype=np.float64).reshape(-1, 6)
        out["numbers"] = np.array([self._start], dtype=np.int64)
        out["segments"] = np.array([start for start, _ in self._segments], dtype=np.int64)
        for number, (_, moments) in enumerate(self._segments):
            out |= {f"segment{number}.{k}": v for k, v in moments.save().items()}
        return out

    def restore(self, saved: Mapping[str, np.ndarray]) -> None:
        """Continue from a saved state; the object is new and has the same arguments."""
        self._cascade = WindowedCascade.restore(subset(saved, "cascade."))
        self._quarters = Quarters.restore(self._cascade, subset(saved, "quarters."))
        self._stretches.restore(self._cascade, subset(saved, "stretches."))
        marks = self._cascade.windows
        self._start = int(saved["numbers"][0])
        self._marks = {int(start): marks[int(number)] for start, number in saved["marks"]}
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
