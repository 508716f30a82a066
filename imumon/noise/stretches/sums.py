"""Sums of a record: everything that is added up over the samples that the guard passes on.

`Parts` has the sums of the noise, of the record and between any two marked places; histogram, differences and extremes
are those of the whole record. `Sums` decides which places are marked and what happens there:

| place | what happens |
|---|---|
| candidate end of a warm-up, c (`warmup.CANDIDATES_S`) | mark, until c is decided |
| 2.5 c | the fit of the record shows whether a warm-up ended at c; then the samples before c are excluded |
| end of hour, day | a stretch ends and the next one begins (`stretches`) |
| end of an hour | its noise is compared with that of all hours before it (`change`) |
| end of a length of the quarters | mark (`quarters`) |

All decisions fall at fixed places of the grid: the same record gives the same result for any chunking and whenever a
result is requested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import restorable
from imumon.noise.allan import AllanCurve
from imumon.noise.detection import GuardedSamples
from imumon.noise.fit import Estimator
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.statistics.differences import DifferenceAccumulator
from imumon.noise.statistics.extreme_values import ExtremeVisits
from imumon.noise.statistics.histogram import HistogramAccumulator
from imumon.noise.statistics.moments import MomentsResult
from imumon.noise.stretches.change import LEAST_CHANGE, CoefficientChange, detect_changes
from imumon.noise.stretches.parts import Parts
from imumon.noise.stretches.quarters import Quarters
from imumon.noise.stretches.stretches import LENGTHS_S, Stretch, Stretches
from imumon.noise.stretches.warmup import CANDIDATES_S, DECISION_LENGTH, has_settled, still_heats_up

HOUR_S, _ = LENGTHS_S
"""s, length of the parts that are compared with those before: long enough for B."""


@dataclass(slots=True)
class Ended:
    """What has ended in a record since it was last asked.

    Attributes
    ----------
    stretches : shorter ones first.
    warmups : time in s, and `Sums.warmup_s`, of each end of a warm-up that was decided.
    hours : time in s, and changes by column, of each hour that was compared.
    """

    stretches: list[Stretch] = field(default_factory=list)
    warmups: list[tuple[float, float]] = field(default_factory=list)
    hours: list[tuple[float, dict[int, tuple[CoefficientChange, ...]]]] = field(default_factory=list)


@restorable
class Sums:
    """Sums of a record, with its warm-up excluded and its hours compared.

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
    allan_channels, warmup_channels, temperature : as given.
    histogram : of all channels, warm-up included.
    differences, extremes : of neighbouring samples, and of the values, in the channels with a curve, warm-up included.
    """

    NOT_SAVED: ClassVar = {"_ended": Ended}  # whoever feeds samples asks at once

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
        self._interval = interval_s
        self.allan_channels, self.warmup_channels = allan_channels, tuple(warmup_channels)
        self._averaged = list(averaged)
        self.temperature = temperature
        rate = 1.0 / interval_s
        # the block means of the temperature are a regressor of the fit; `_without_temperature` takes them apart
        columns = [*range(allan_channels), *([] if temperature is None else [temperature])]
        self._parts = Parts(groups, columns, interval_s)
        with_curve = list(groups[:allan_channels])
        self._allan_groups = max(with_curve, default=-1) + 1  # their groups are the first ones, too
        self.histogram = HistogramAccumulator(groups)
        self.differences, self.extremes = DifferenceAccumulator(with_curve), ExtremeVisits(with_curve)
        # candidate end of a warm-up and the place at which it is decided, samples of the grid
        self._decisions = {
            (end := round(time_s * rate)): round(DECISION_LENGTH * end)
            for time_s in (CANDIDATES_S if warmup_channels else ())
        }
        self._hour = max(1, round(HOUR_S * rate))
        self._start = 0  # end of the warm-up
        self.warmup_s = 0.0
        self._quarters = Quarters(self._parts, rate)
        self._stretches = Stretches(self._parts, rate)
        self._ended = Ended()
        self._changes: dict[int, tuple[CoefficientChange, ...]] = {}

    @property
    def begin_s(self) -> float:
        """s since the first sample, end of the warm-up."""
        return self._start * self._interval

    @property
    def position(self) -> int:
        """Samples of the grid so far."""
        return self._parts.position

    def update(self, passed: GuardedSamples) -> None:
        """Add what the guard has passed on."""
        if passed.broken:
            self.break_()
        if passed.skipped:
            self.skip(passed.skipped)
        if len(passed.values):
            # None lets every accumulator take its short way without masks: nearly all blocks are complete
            self.add(passed.values, None if passed.valid.all() else passed.valid)

    def add(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples (n, c), channel unit, of which those with `valid` (n, g) count; None: all."""
        begin = 0
        while begin < len(values):
            end = min(len(values), begin + self._until_place())
            self._parts.update(values[begin:end], None if valid is None else valid[begin:end])
            self._at_place()
            begin = end
        self.histogram.update(values, valid)
        with_curve = values[:, : self.allan_channels]
        present = None if valid is None else valid[:, : self._allan_groups]
        self.differences.update(with_curve, present)
        self.extremes.update(with_curve, present)

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing."""
        self.differences.break_()  # a difference across the gap would hold the drift in it
        while n > 0:
            length = min(n, self._until_place())
            if n > self._hour and self.position % self._hour == 0 and len(self._own_places()) == 1:
                # no candidate is left: hours without samples are skipped at once, or a gap of months takes minutes
                length = n // self._hour * self._hour
            self._parts.skip(length)
            self._at_place()
            n -= length

    def break_(self) -> None:
        """Note a gap of unknown length."""
        self.differences.break_()
        self._parts.break_()

    # --- results --------------------------------------------------------------------------------------

    def curve(self) -> AllanCurve:
        """Return the Allan curve of everything after the warm-up, with the sums of its noise."""
        curve = self._parts.curve(self._start)
        return curve if self.temperature is None else curve.with_temperature()

    def whole_sums(self) -> NoiseSums | None:
        """Return the sums of the whole record, with its warm-up; None: there are none."""
        sums = self._parts.curve().sums
        return None if sums is None else self._without_temperature(sums)

    def moments(self) -> MomentsResult:
        """Return the moments of everything after the warm-up."""
        return self._parts.moments(self._start).result()

    def equal_parts(self, count: int) -> list[tuple[NoiseSums, int]] | None:
        """Return the sums of two halves or four quarters after the warm-up, and their lengths, samples.

        None: the record is too short.
        """
        parts = self._quarters.result(count)
        return None if parts is None else [(self._without_temperature(sums), n) for sums, n in parts]

    def stretch_in_progress(self, length_s: int) -> Stretch | None:
        """Return the stretch in progress of a length of `LENGTHS_S`; None without a sample in it."""
        stretch = self._stretches.in_progress(LENGTHS_S.index(length_s))
        return None if stretch is None else replace(stretch, sums=self._without_temperature(stretch.sums))

    def changes(self) -> dict[int, tuple[CoefficientChange, ...]]:
        """Return the changes of the last whole hour against those before, by column."""
        return dict(self._changes)

    def ended(self) -> Ended:
        """Return and forget what has ended since the last call."""
        ended, self._ended = self._ended, Ended()
        return ended

    def temperature_range(self) -> tuple[float, float] | None:
        """Return the least and the greatest temperature of the whole record, degC; None: there is none."""
        if self.temperature is None:
            return None
        temperature = self._parts.moments().result().channels[self.temperature]
        if temperature.min is None or temperature.max is None:
            return None
        return temperature.min, temperature.max

    def still_heats_up(self, curve: AllanCurve) -> bool:
        """Return whether the temperature of the sensor has not come to rest at the end of a curve of this record."""
        if curve.sums is None or curve.sums.degrees is None:
            return False
        return still_heats_up(curve.sums.degrees, curve.sums.blocks.length_s)

    def _without_temperature(self, sums: NoiseSums) -> NoiseSums:
        """Return sums of the parts as those of the channels with a curve, with the temperature beside them."""
        return sums if self.temperature is None else sums.with_temperature()

    # --- places ---------------------------------------------------------------------------------------

    def _own_places(self) -> tuple[int, ...]:
        """Return the next places of this module: candidates, their decisions, the end of the hour."""
        places = (*self._decisions, *self._decisions.values())
        ahead = (place for place in places if place > self.position)
        return (*ahead, (self.position // self._hour + 1) * self._hour)

    def _until_place(self) -> int:
        """Return the samples until the next place at which something happens."""
        return min(*self._own_places(), self._quarters.next_end, self._stretches.next_end) - self.position

    def _at_place(self) -> None:
        """Do what is due at the present place, if anything is."""
        place = self.position
        self._quarters.close_due()
        if place in self._decisions:
            self._parts.mark(curve=True)
        for candidate, decision in self._decisions.items():
            if place == decision:
                self._decide(candidate)
        hour_start = self._stretches.starts[LENGTHS_S.index(HOUR_S)]  # of the hour that may end now
        for stretch in self._stretches.close_due():
            finished = replace(stretch, sums=self._without_temperature(stretch.sums))
            self._ended.stretches.append(finished)
            if finished.length_s == HOUR_S and finished.start > self._start:
                self._changes = self._compare(finished, hour_start)
                self._ended.hours.append((place * self._interval, self._changes))
        undecided = [c for c, decision in self._decisions.items() if c <= place < decision]
        self._parts.keep({self._start, *undecided, *self._quarters.places}, finer=self._stretches.starts)

    def _decide(self, candidate: int) -> None:
        """Decide whether a warm-up ended at a candidate."""
        length_s = (candidate - self._start) * self._interval
        if has_settled(self._settling_times_s(), length_s):
            self._start = candidate
            self._quarters.discard_before(candidate)
            self.warmup_s = self._warmup_length_s()
            self._ended.warmups.append((self.position * self._interval, self.warmup_s))
            self._changes = {}  # those of an hour against hours that are excluded now

    def _settling_times_s(self) -> list[float]:
        """Return the time constants of the channels that settle along an exponential, s.

        What follows the temperature of a warm-up is a part of the warm-up here: with the temperature as a regressor, no
        exponential would be left. Beside a line or a hum, an exponential may be its beginning: a line never ends a
        warm-up.
        """
        sums = replace(self._without_temperature(self._parts.sums(self._start)), degrees=None)
        estimator = Estimator(averaged=self._averaged, time_to=False)
        fits = estimator.fit_sums(
            sums, self.position - self._start, channels=self.warmup_channels, only_with="settling"
        )
        settling = [fit.regressor("settling") for fit in fits if not (fit.oscillations_s or fit.hump_hz)]
        return [one.time_constant_s for one in settling if one and one.time_constant_s is not None]

    def _warmup_length_s(self) -> float:
        """Return the length of the valid samples before the end of the warm-up, s."""
        if not self._start:
            return 0.0
        before = self._parts.moments(0, self._start).result().channels
        return max(before[c].count for c in self.warmup_channels) * self._interval

    def _compare(self, hour: Stretch, hour_start: int) -> dict[int, tuple[CoefficientChange, ...]]:
        """Return the changes of an hour against all before it, by column."""
        before = self._without_temperature(self._parts.sums(self._start, hour_start))
        parts = ((before, hour.start - self._start), (hour.sums, hour.end - hour.start))
        old, new = (Estimator(averaged=self._averaged, time_to=False).fit_sums(*part) for part in parts)
        by_column = {}
        pairs = self.allan_channels * len(LEAST_CHANGE) * (self.position // self._hour)
        for column in range(self.allan_channels):
            if changes := detect_changes(old[column].coefficients, new[column].coefficients, pairs=pairs):
                by_column[column] = changes
        return by_column
