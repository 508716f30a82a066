"""Sample clock: the grid steps of each sample, from the clock of its stream.

The package has the model. Time is always that of the sample clock, never that of arrival: USB delivers in batches. What
a step is, in intervals since the last sample that was placed:

| step | is | the sample |
|---|---|---|
| 1 | the next sample | is placed |
| 2 to `FAR_S` | a gap of known length: samples were lost | is placed |
| 0 | a duplicate, or the clock stood still | is excluded and counted |
| below 0 | a wrong stamp if the next sample continues the old time, else a restart | is excluded, or behind a `BREAK` |
| beyond `FAR_S` | a wrong stamp if the next sample continues the old time, else a gap | waits for the next sample |
| longer than the host clock allows | a clock that was set, or a device that restarted | is placed behind a `BREAK` |

A stream whose clock is not absolute has other steps: the length of a sample's own interval, and the messages that the
decoder saw damaged.

The interval of the grid is learned from the first samples:

- A device whose clock has a tick has an interval that is a multiple of it (`Stream.tick_s`); some ten samples
  show which.
- Without a tick, the interval is the slope of a line through the time stamps, which jitter does not bias.
  Learning continues until the standard error of the slope is small.
- A nominal interval is used if the samples agree with it, and decides where samples are missing from the
  start.
- An interval is one of `SLOWEST_HZ` to `FASTEST_HZ`. Samples that show another one are excluded and counted: their time
  has another unit.

A step between neighbours is unambiguous while the jitter of the stamps is far below one interval. Where it is
not, the mean deviation of the samples before decides, so neither jitter nor an error of the interval adds up.

This module knows no statistics and reads no clock: the time of the host is an argument.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from imumon.grid.interval import (
    AMBIGUOUS,
    CLOCK_SLACK_S,
    RATE_TOLERANCE,
    REFERENCE_SAMPLES,
    RateChange,
    counter_unit,
    estimate_interval,
    is_nominal,
    phase,
)
from imumon.model.samples import (
    FASTEST_HZ,
    SLOWEST_HZ,
    Bools,
    Clock,
    Floats,
    Ints,
    SampleBlock,
    concatenated,
    selected,
)
from imumon.model.saved_state import restorable

LEARN_STEPS = 32
"""Steps from which an interval is learned at first; without a tick the number doubles until it is precise."""

LEARN_STEPS_MAX = 1024
"""Steps after which a learned interval is used however imprecise: 10 s at 100 Hz."""

NOMINAL_STEPS = 3
"""Steps after which a nominal interval is used, if all of them agree with it."""

FAR_S = 60.0
"""s. A jump forward beyond this must be confirmed by the next sample: one damaged time stamp that passed its
checksum must not put a year of missing samples into the record."""

LONGEST_GAP_S = 31 * 86400.0
"""s. A gap longer than this, with no host clock to confirm it, is of unknown length."""

BREAK = -1
"""Step of a sample behind a gap of unknown length."""


@dataclass(frozen=True, slots=True)
class PlacedSamples:
    """Samples with their place on the grid.

    Attributes
    ----------
    values : (n, c) channel unit.
    steps : (n,) grid steps since the sample before; 1 next, > 1 behind a gap, `BREAK` behind a gap of
        unknown length. The first sample of all has 1.
    saturated : (n, s) or (n,) bool, or None, see `SampleBlock`.
    """

    values: Floats
    steps: Ints
    saturated: Bools | None

    def split(self, count: int) -> tuple[PlacedSamples, PlacedSamples]:
        """Return the first samples, and the others."""
        first, others = (
            PlacedSamples(
                self.values[rows],
                self.steps[rows],
                None if self.saturated is None else self.saturated[rows],
            )
            for rows in (slice(count), slice(count, None))
        )
        return first, others


@restorable
@dataclass(frozen=True, slots=True, kw_only=True)
class SavedClock:
    """State of a clock that has learned its interval."""

    interval_s: float  # s
    scale: float  # s, unit of the clock
    last: int | None  # unit of the clock, time of the last placed sample; null: there was none
    raw: int | None  # last value of a counter of 32 bits, before its wraps are undone; null: no counter
    wraps: int  # of the counter


class SampleClock:
    """Places the blocks of one stream on its grid.

    Parameters
    ----------
    clock : see `samples.Stream`.
    interval_s : s, nominal sampling interval. A stream without a clock has no other; where there is a clock,
        it is used only if the first samples agree.
    tick_s : s, see `samples.Stream`; the interval is a multiple of it, and a ``counter`` counts it or
        microseconds. None: the interval is as measured.

    Attributes
    ----------
    interval_s : s, or None while it is being learned; until then samples are held back.
    duplicates : samples with the time of the one before; excluded.
    wrong_times, out_of_order : samples whose time the next one refutes: beyond it, and before the time that continues;
        excluded.
    impossible_hz : Hz, the rate that no sensor has and that excluded samples have shown last; None: none has.
    rest : samples from a change of the rate on, which belong to another grid; None: it has not changed.
    """

    def __init__(self, clock: Clock, interval_s: float | None = None, tick_s: float | None = None) -> None:
        if clock == "none" and interval_s is None:
            raise ValueError("a stream without a clock needs its rate")
        self.clock = clock
        self.interval_s = interval_s if clock == "none" else None
        self.duplicates = self.wrong_times = self.out_of_order = 0
        self.impossible_hz: float | None = None
        self.rest: SampleBlock | None = None
        self._nominal_s = interval_s
        self._tick_s = tick_s
        self._unit_s = 1e-9  # s, unit of the clock
        self._learned = clock == "none"
        self._tried = 0  # steps that were not enough to learn the interval
        self._pending: list[SampleBlock] = []  # while the interval is being learned
        self._unconfirmed: SampleBlock | None = None  # one sample behind a jump
        self._last: int | None = None  # time of the last placed sample
        self._recent: deque[Ints] = deque(maxlen=REFERENCE_SAMPLES)  # (2, n) time and steps, by block
        self._unknown_gap = False
        self._expected_s: float | None = None  # length of a gap by the host clock
        self._open_s: float | None = 0.0  # s of the host clock that samples and gaps do not account for yet
        self._counter: int | None = None  # last value of a counter, before its wraps are undone
        self._wraps = 0
        self._previous: int | None = None  # time of the last sample, placed or not
        self._rates = RateChange()

    def gap(self, length_s: float | None = None) -> None:
        """Note that the stream was interrupted.

        An absolute clock shows the exact length itself. Of a stream with another clock, or none, the length is not
        used: the next sample follows a gap of unknown length.

        Parameters
        ----------
        length_s : s by the host clock since the last samples or the last call; None: unknown. `place` must
            not get this time again. If the sample clock differs, the device was restarted meanwhile, and the
            gap is of unknown length.
        """
        if self.clock in ("dt", "none"):
            self._unknown_gap = True
        elif self._last is not None:
            self._expected_s = None if length_s is None else (self._expected_s or 0.0) + length_s
            if length_s is not None and self._open_s is not None:
                self._open_s += length_s

    def place(
        self, block: SampleBlock, *, final: bool = False, host_s: float | None = None
    ) -> list[PlacedSamples]:
        """Return blocks with their steps; none while the interval is being learned.

        Parameters
        ----------
        block : samples in order.
        final : the stream ends here: decide on what is held back.
        host_s : s of sample time since the last call by the host clock; None: unknown. A jump of the sample
            clock far beyond the time that has passed and is not filled with samples (those from before a
            pause may come first) is no gap of known length.
        """
        self._open_s = None if host_s is None else (self._open_s or 0.0) + host_s
        block = self._without_wraps(block)
        if not self._learned:
            self._pending.append(block)
            self._learn(final)
            if not self._learned:
                return []
            block, self._pending = concatenated(self._pending), []
        if self._unconfirmed is not None:
            block, self._unconfirmed = concatenated([self._unconfirmed, block]), None
        if not len(block.values) or self.rest is not None:
            return []
        changed = self._rate_change(block)
        if changed is not None:
            # a grid has one interval: the caller begins another one with the rest
            self.rest = selected(block, slice(changed, None))
            block, final = selected(block, slice(0, changed)), True
        if not len(block.values):
            return []
        if self.clock not in ("startup", "counter"):
            return [self._relative(block)]
        placed = self._absolute(block, final)
        waiting = 0 if self._unconfirmed is None else 1
        if len(block.values) > waiting and block.time_ns is not None:
            self._previous = int(block.time_ns[-1 - waiting])
        return [placed] if len(placed.steps) else []

    def finish(self) -> list[PlacedSamples]:
        """Return what was held back, at the end of the stream."""
        rest = self._pending or ([self._unconfirmed] if self._unconfirmed is not None else [])
        self._pending, self._unconfirmed = [], None
        if not rest:
            return []
        block = concatenated(rest)
        if self._wraps:  # they have been undone already, and `place` would undo them again
            self._counter = int(block.time_ns[0]) & 0xFFFFFFFF if block.time_ns is not None else None
        return self.place(block, final=True, host_s=None if self._open_s is None else 0.0)

    @property
    def held(self) -> int:
        """Samples that wait: for the interval, or for the sample behind a jump."""
        return sum(map(len, self._pending)) + (0 if self._unconfirmed is None else len(self._unconfirmed))

    def save(self) -> SavedClock:
        """Return the state of a clock that has learned its interval."""
        # one that was restored learns it again, and keeps the saved one until then
        interval_s = self._nominal_s if self.interval_s is None else self.interval_s
        assert interval_s is not None
        return SavedClock(
            interval_s=interval_s,
            scale=self._unit_s,
            last=self._last,
            raw=self._counter,
            wraps=self._wraps,
        )

    @classmethod
    def restore(cls, clock: Clock, saved: SavedClock, tick_s: float | None = None) -> SampleClock:
        """Continue where `save` left off; a stream without absolute time continues behind an unknown gap.

        The interval is learned again: the first samples show whether it is still the saved one.
        """
        restored = cls(clock, saved.interval_s, tick_s)
        restored._unit_s, restored._last = saved.scale, saved.last
        restored._counter, restored._wraps = saved.raw, saved.wraps
        restored.gap()
        return restored

    # ------------------------------------------------------------------ the interval

    def _learn(self, final: bool) -> None:
        """Try to learn the interval from the pending samples; the result does not depend on the blocks."""
        block = concatenated(self._pending)
        while not self._learned:
            time = block.time_ns
            assert time is not None
            count = self._tried * 2 or LEARN_STEPS
            if self._nominal_agrees(time):
                self.interval_s, self._learned = self._nominal_s, True
                return
            if len(time) <= count and not final:
                return
            last = len(time) <= count or count >= LEARN_STEPS_MAX
            steps = time[:count] if self.clock == "dt" else np.diff(np.sort(time[: count + 1]))
            runs = bool((steps > 0).any())
            if runs and self._estimate(np.asarray(steps, np.float64), last):
                self._tried = count
            elif len(time) == 1 and self._nominal_s is not None:
                self.interval_s, self._learned = self._nominal_s, True  # nothing contradicts it
            else:  # the clock does not run, or at a rate that no sensor has: keep the last sample only
                useless = min(count, len(time) - 1)
                self._count_useless(useless, runs)
                block, self._tried = selected(block, slice(useless, None)), 0
                self._pending = [block]
                if not useless:
                    return

    def _count_useless(self, count: int, runs: bool) -> None:
        """Count samples whose clock does not run, or runs at a rate that no sensor has."""
        if runs:
            self.wrong_times += count
        else:
            self.duplicates += count

    def _nominal_agrees(self, time: Ints) -> bool:
        """Return whether the first steps are the nominal interval, so that there is no need to wait."""
        if self._nominal_s is None or len(time) <= NOMINAL_STEPS:
            return False
        if self.clock == "counter" and self._last is None:
            return False  # the unit of a count follows from its steps
        steps = time[:NOMINAL_STEPS] if self.clock == "dt" else np.diff(time[: NOMINAL_STEPS + 1])
        return is_nominal(np.asarray(steps, np.float64) * self._unit_s, self._nominal_s, self._tick_s)

    def _estimate(self, steps: Floats, last: bool) -> bool:
        """Estimate the interval from (n,) steps in units of the clock; return whether a sensor can have it.

        Everything behind the clock has arrays of the samples in a second: a time in another unit must not size them.

        Parameters
        ----------
        last : use it however imprecise.
        """
        if self.clock == "counter":
            self._unit_s = counter_unit(steps, self._tick_s)
        interval_s = estimate_interval(steps * self._unit_s, self._nominal_s, self._tick_s, last=last)
        if interval_s is not None and not SLOWEST_HZ <= 1.0 / interval_s <= FASTEST_HZ:
            self.impossible_hz = 1.0 / interval_s
            return False
        self.interval_s, self._learned = interval_s, interval_s is not None
        return True

    def _rate_change(self, block: SampleBlock) -> int | None:
        """Return where a new rate has shown; None: nowhere."""
        if self.clock == "none" or block.time_ns is None:
            return None
        assert self.interval_s is not None
        time = block.time_ns
        if self.clock != "dt":
            time = np.diff(time, prepend=time[0] if self._previous is None else self._previous)
        return self._rates.find(np.asarray(time, np.float64) * (self._unit_s / self.interval_s))

    # ------------------------------------------------------------------ the place of each sample

    def _without_wraps(self, block: SampleBlock) -> SampleBlock:
        """Return the block with a counter of 32 bits continued over its wraps."""
        if self.clock != "counter" or block.time_ns is None or not len(block.values):
            return block
        counter = block.time_ns
        # a step back by more than half of the period is a wrap; by less, the device restarted
        back = np.diff(counter, prepend=counter[0] if self._counter is None else self._counter) < -(1 << 31)
        wraps = self._wraps + np.cumsum(back)
        self._counter, self._wraps = int(counter[-1]), int(wraps[-1])
        return replace(block, time_ns=counter + (wraps << 32)) if self._wraps else block

    def _absolute(self, block: SampleBlock, final: bool) -> PlacedSamples:
        """Place samples by an absolute clock."""
        assert block.time_ns is not None
        assert self.interval_s is not None
        time = block.time_ns
        restarted = self._clock_restarted(int(time[0]))
        if self._last is None:
            self._recent.clear()
            self._open_s = None if self._open_s is None else 0.0  # time before the first sample is no gap
        before = time[0] if self._last is None else self._last
        exact = np.diff(time, prepend=before) * (self._unit_s / self.interval_s)
        steps = np.rint(exact).astype(np.int64)
        far = int(FAR_S / self.interval_s)
        doubtful = (steps < 1) | (steps > far) | (np.abs(exact - steps) > AMBIGUOUS)
        if self._last is None:
            steps[0], doubtful[0] = 1, False
        keep = np.ones(len(time), dtype=bool)
        if doubtful.any():
            self._decide(time, steps, keep, np.flatnonzero(doubtful), far, final)
            if not final and keep[-1] and (steps[-1] < 0 or steps[-1] > far):
                # a jump that nothing confirms yet: wait for the next sample
                self._unconfirmed = selected(block, slice(len(time) - 1, None))
                keep[-1] = False
            longest = LONGEST_GAP_S if self._open_s is None else _with_slack(self._open_s)
            steps[steps > max(far, int(longest / self.interval_s))] = BREAK
        if restarted:
            steps[0] = BREAK
        if not keep.all():
            block, time, steps = selected(block, keep), time[keep], steps[keep]
        self._note_placed(time, steps)
        return PlacedSamples(block.values, steps, block.saturated)

    def _note_placed(self, time: Ints, steps: Ints) -> None:
        """Keep the last samples, and the host time that samples and gaps do not account for."""
        if len(time):
            self._last = int(time[-1])
            if len(time) >= REFERENCE_SAMPLES:
                self._recent.clear()
            self._recent.append(np.stack([time[-REFERENCE_SAMPLES:], steps[-REFERENCE_SAMPLES:]]))
        if self._open_s is not None:
            known = int(steps.min(initial=0)) != BREAK
            filled = (1.0 + RATE_TOLERANCE) * int(steps.sum()) * float(self.interval_s or 0.0)
            self._open_s = max(0.0, self._open_s - filled) if known else 0.0

    def _clock_restarted(self, time: int) -> bool:
        """Return whether the first sample behind a gap is not where the host clock expects it."""
        expected, self._expected_s = self._expected_s, None
        if expected is None or self._last is None:
            return False
        if abs((time - self._last) * self._unit_s - expected) < _with_slack(expected) - expected:
            return False
        self._last = None
        return True

    def _decide(self, time: Ints, steps: Ints, keep: Bools, doubtful: Ints, far: int, final: bool) -> None:
        """Decide on doubtful steps: jitter, duplicate, wrong stamp, gap or restart."""
        scale = self._unit_s / float(self.interval_s or 1.0)
        n = len(time)
        recent = np.concatenate([np.empty((2, 0), np.int64), *self._recent], axis=1)
        todo = doubtful.tolist()[::-1]
        while todo:
            i = todo.pop()
            placed = _last_true(keep[:i])
            before = int(time[placed[-1]]) if len(placed) else self._last
            if before is None:
                continue
            latest = np.append(recent, [time[placed], steps[placed]], axis=1)[:, -REFERENCE_SAMPLES:]
            steps[i] = step = round((int(time[i]) - before) * scale - phase(latest[0], latest[1], scale))
            if 1 <= step <= far:
                continue  # the samples before show that it was jitter
            follows = i + 1 < n
            # where the next sample continues the old time, this stamp is wrong; elsewhere it is behind a gap, or behind
            # a restart, whose time is before the old one
            continues = follows and 1 <= round((int(time[i + 1]) - before) * scale) <= far
            if step != 0 and not continues:
                steps[i] = BREAK if step < 0 and (follows or final) else step
                continue
            self._count_misplaced(step)
            keep[i] = False
            if follows and todo[-1:] != [i + 1]:
                todo.append(i + 1)  # its step counts from the last sample that is kept

    def _count_misplaced(self, step: int) -> None:
        """Count a sample that is not kept, by the step that its stamp claims."""
        if step == 0:
            self.duplicates += 1
        elif step < 0:
            self.out_of_order += 1
        else:
            self.wrong_times += 1

    def _relative(self, block: SampleBlock) -> PlacedSamples:
        """Place samples that know their own interval only, or nothing of time."""
        assert self.interval_s is not None
        steps = 1 + block.lost
        if self.clock == "dt" and block.time_ns is not None:
            # a sample that covers n intervals counts as n ticks, of which it is the last
            intervals = np.rint(block.time_ns * (1e-9 / self.interval_s)).astype(np.int64)
            steps += np.maximum(0, intervals - 1)
        steps[steps > LONGEST_GAP_S / self.interval_s] = BREAK
        if self._last is None:
            steps[0] = 1
        elif self._unknown_gap:
            steps[0] = BREAK
        self._unknown_gap, self._last = False, 0
        return PlacedSamples(block.values, steps, block.saturated)


def _last_true(keep: Bools) -> npt.NDArray[np.intp]:
    """Return at least the last `REFERENCE_SAMPLES` places that are true; of a long array, these are found fast."""
    start = max(0, len(keep) - 4 * REFERENCE_SAMPLES)
    places = start + np.flatnonzero(keep[start:])
    return np.flatnonzero(keep) if start and len(places) < REFERENCE_SAMPLES else places


def _with_slack(length_s: float) -> float:
    """Return the longest time that a time by another clock may be, s."""
    return (1.0 + RATE_TOLERANCE) * length_s + CLOCK_SLACK_S
