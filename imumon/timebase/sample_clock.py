"""The sensor's time grid: on which tick of its clock each sample lies.

Statistics over tau need equal steps, and real lines lose samples. Time is the sensor's own, never that of
arrival: USB delivers in batches. From the clock of a block follows, sample by sample, how many ticks lie
between it and the sample before it: 1 is the next one, more is a gap of known length, a clock that went
backwards is a gap of unknown length (the sensor restarted). A sample with the same tick as the one before
it came twice. Without an absolute clock, the messages that framing saw damaged count as lost ticks.

This file knows neither statistics nor the room's clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imumon.samples import Bools, Clock, Floats, Ints, SampleBlock, concatenated

LOOP_S = 1.0 / 800.0
"""Period of the sensor's inner loop: output intervals are multiples of it."""

LEARN = 32
"""Differences from which an unknown interval is read."""

AGREE = 3
"""Differences after which an interval that was told is believed, if they agree with it."""

FAR_TICKS_S = 60.0
"""A jump forward beyond this must be confirmed by the next sample: one damaged time stamp that passed
its check must not put a year of holes into the record."""

LONGEST_S = 31 * 86400.0
"""A hole longer than this, with no other clock to confirm it, is a gap of unknown length."""

STEADY = 64
"""Equal steps in a row that are not one tick, after which the sensor's rate has changed."""

OTHER, ALIKE = 0.02, 0.1
"""Ticks by which a step is not one tick, and by which two steps are equal: 64 in a row that are all longer,
or all shorter, are no jitter, be they whole ticks or not (from 100 Hz to 80 Hz they are 1.25)."""

FASTEST, SLOWEST = 0.025, 100.0
"""Ticks: shorter or longer steps are no rate, but a burst or holes."""

GAP_SLACK_S = 10.0
"""How far the room's clock may differ from the sensor's over a gap."""

BREAK = -1
"""Step of a sample behind a gap of unknown length."""


@dataclass(frozen=True, slots=True)
class PlacedSamples:
    """Samples with their place.

    Attributes
    ----------
    values : (n, c) channel unit.
    steps : (n,) ticks since the sample before; 1 next, > 1 behind a gap, `BREAK` behind a gap of
        unknown length. The first sample of all has 1.
    saturated : (n,) bool or None.
    """

    values: Floats
    steps: Ints
    saturated: Bools | None


class SampleClock:
    """Places blocks of one stream on its grid.

    Parameters
    ----------
    clock : see `samples.Stream`.
    interval_s : s, the sampling interval as asked of the sensor or given by the user. A stream without a
        clock has no other; where there is a clock, it is believed only if the first samples agree.

    Attributes
    ----------
    interval_s : s, or None while it is still being learned; then samples are held back.
    duplicates : samples that came twice, left out.
    implausible : samples whose time stamp the next sample contradicted, left out.
    unplaced : samples held back because the interval is not known yet.
    changed : the steps have steadily become others: the sensor's rate has changed, and `rest` holds the
        samples from there on, which belong to another grid.
    """

    def __init__(self, clock: Clock, interval_s: float | None = None) -> None:
        self.clock = clock
        self.interval_s = interval_s if clock == "none" else None
        self._told = interval_s
        self.duplicates = 0
        self.implausible = 0
        self.unplaced = 0
        self._scale = 1e-9  # seconds of one unit of the clock
        self._known = clock == "none"
        if clock == "none" and interval_s is None:
            raise ValueError("a stream without a clock needs its rate")
        self._last: int | None = None
        self._held: list[SampleBlock] = []
        self._suspect: SampleBlock | None = None
        self._unknown_gap = False
        self._expected_s: float | None = None
        self._room_s: float | None = 0.0  # that has passed, and that the sensor's clock has not filled yet
        self._raw: int | None = None  # last value of a counter, before its wraps are undone
        self._wraps = 0
        self._seen: int | None = None  # time of the last sample, kept or not
        self._steady = (0, 1.0)  # how many steps in a row were the same other one, and the last step, ticks
        self.changed = False
        self.rest: SampleBlock | None = None

    def gap(self, length_s: float | None = None) -> None:
        """The link was lost; how long, an absolute clock tells by itself.

        Parameters
        ----------
        length_s : s, about how long by another clock since the last samples or the last call, None where
            nobody knows; `place` is not told of it again. Where the sensor's clock says something else, it
            was restarted meanwhile, and the gap is of unknown length.
        """
        if self.clock in ("dt", "none"):
            self._unknown_gap = True
        elif self._last is not None:
            self._expected_s = None if length_s is None else (self._expected_s or 0.0) + length_s
            if length_s is not None and self._room_s is not None:
                self._room_s += length_s

    def place(
        self, block: SampleBlock, *, final: bool = False, room_s: float | None = None
    ) -> list[PlacedSamples]:
        """Blocks with their steps; empty while the interval is being learned.

        Parameters
        ----------
        block : samples in order.
        final : no more will come: settle what is held back.
        room_s : s of the sensor's time that passed since the last call by another clock, None where nobody
            knows. A leap of the sensor's clock far beyond what has passed and is not filled with samples
            (those from before a standstill may come first) is no hole, but a gap of unknown length.
        """
        self._room_s = None if room_s is None else (self._room_s or 0.0) + room_s
        block = self._unwrapped(block)
        if not self._known:
            self._held.append(block)
            block = concatenated(self._held)
            if len(block) > LEARN or final:
                self._learn(block)
            elif len(block) > AGREE:
                self._agree(block)
            if not self._known:
                self.unplaced = sum(map(len, self._held))
                return []
            self._held, self.unplaced = [], 0
        if self._suspect is not None:
            block = concatenated([self._suspect, block])
            self._suspect = None
        if not len(block) or self.changed:
            return []
        absolute = self.clock in ("startup", "counter")
        cut = self._rate_change(block)
        if cut is not None:
            self.changed, self.rest = True, _cut(block, cut)
            block, final = _cut(block, 0, cut), True
        if not len(block):
            return []
        placed = self._absolute(block, final) if absolute else self._relative(block)
        if absolute and block.time_ns is not None:
            waiting = 0 if self._suspect is None else 1
            if len(block) > waiting:
                self._seen = int(block.time_ns[-1 - waiting])
        return [placed] if len(placed.steps) else []

    def _rate_change(self, block: SampleBlock) -> int | None:
        """Where a new rate has shown in `STEADY` equal steps, none of them one tick."""
        if self.clock == "none" or block.time_ns is None:
            return None
        assert self.interval_s is not None
        time = block.time_ns
        if self.clock == "dt":
            ticks = time * (1e-9 / self.interval_s)
        else:
            before = time[0] if self._seen is None else self._seen
            ticks = _steps(time, before) * (self._scale / self.interval_s)
        other = np.abs(ticks - 1.0) > OTHER
        if other.any():
            other &= (ticks > FASTEST) & (ticks < SLOWEST)
        if not other.any():
            self._steady = (0, 1.0)
            return None
        count, last = self._steady
        follows = np.concatenate(([count > 0], other[:-1]))
        same = other & follows & (np.abs(np.diff(ticks, prepend=last)) < ALIKE)
        runs = np.arange(1, len(same) + 1)
        starts = np.maximum.accumulate(np.where(same, 0, runs))
        lengths = np.where(starts > 0, runs - starts + other[np.maximum(starts - 1, 0)], count + runs)
        lengths = np.where(other, lengths, 0)
        reached = np.flatnonzero(lengths >= STEADY)
        if len(reached):
            return int(reached[0])
        self._steady = (int(lengths[-1]), float(ticks[-1]))
        return None

    def _unwrapped(self, block: SampleBlock) -> SampleBlock:
        """A counter of 32 bits, carried on over its wraps."""
        if self.clock != "counter" or block.time_ns is None or not len(block):
            return block
        raw = block.time_ns
        back = _steps(raw, raw[0] if self._raw is None else self._raw) < -(1 << 31)
        wraps = self._wraps + np.cumsum(back)
        self._raw, self._wraps = int(raw[-1]), int(wraps[-1])
        if not self._wraps:
            return block
        return replace(block, time_ns=raw + (wraps << 32))

    def finish(self) -> list[PlacedSamples]:
        """What was held back, at the end of the stream."""
        rest = self._held or ([self._suspect] if self._suspect is not None else [])
        self._held, self._suspect = [], None
        if not rest:
            return []
        block = concatenated(rest)
        if self._wraps:  # they have been undone already
            self._raw = int(block.time_ns[0]) & 0xFFFFFFFF if block.time_ns is not None else None
        return self.place(block, final=True, room_s=None if self._room_s is None else 0.0)

    def save(self) -> dict[str, object]:
        """State of a timeline that has learned its interval: JSON values."""
        return {
            "interval_s": self.interval_s,
            "scale": self._scale,
            "last": self._last,
            "raw": self._raw,
            "wraps": self._wraps,
        }

    @classmethod
    def restore(cls, clock: Clock, saved: dict[str, object]) -> SampleClock:
        """Continue where `save` left off; a clock without absolute time resumes behind an unknown gap.

        The interval is learned anew: whether it is still the saved one, the first samples show.
        """
        interval, last, raw = (saved[name] for name in ("interval_s", "last", "raw"))
        line = cls(clock, float(str(interval)) if interval is not None else None)
        line._scale = float(str(saved["scale"]))
        line._last = int(str(last)) if last is not None else None
        line._raw = int(str(raw)) if raw is not None else None
        line._wraps = int(str(saved["wraps"]))
        line.gap()
        return line

    def _learn(self, held: SampleBlock) -> None:
        time = held.time_ns
        assert time is not None
        gaps = time if self.clock == "dt" else np.diff(np.sort(time[: LEARN + 1]))
        steps = np.asarray(gaps[:LEARN], dtype=np.float64)
        steps = steps[steps > 0]
        if not len(steps):
            if len(held) == 1 and self._told is not None:
                self.interval_s, self._known = self._told, True  # one sample: nothing contradicts it
            else:  # the clock stands still: nothing to go by, and no more to keep than where it stands
                self.duplicates += len(held) - 1
                self._held = [_cut(held, len(held) - 1)]
            return
        # samples may be missing: the shortest steps are those of one tick
        shortest = float(np.quantile(steps, 0.1, method="lower"))
        if self.clock == "counter":
            self._scale = LOOP_S if shortest <= 800 else 1e-6
        interval = _snap(float(np.mean(steps[steps < 1.5 * shortest])) * self._scale)
        if self._told is not None and _multiples(steps * self._scale, self._told):
            interval = self._told
        self.interval_s, self._known = interval, True

    def _agree(self, held: SampleBlock) -> None:
        """Believe what was told without waiting longer, where the first steps are just that."""
        time = held.time_ns
        assert time is not None
        if self._told is None or (self.clock == "counter" and self._last is None):
            return  # the unit of a count is read from its step
        steps = (time if self.clock == "dt" else np.diff(time))[:AGREE] * self._scale
        if (np.abs(steps - self._told) < 0.02 * self._told).all():
            self.interval_s = self._told
            self._known = True

    def _absolute(self, block: SampleBlock, final: bool) -> PlacedSamples:
        assert block.time_ns is not None
        assert self.interval_s is not None
        time = block.time_ns
        anew = self._is_anew(int(time[0]))
        if self._last is None and self._room_s is not None:
            self._room_s = 0.0  # what passed before the first sample of all is no hole
        before = time[0] if self._last is None else self._last
        steps = np.rint(_steps(time, before) * (self._scale / self.interval_s)).astype(np.int64)
        if self._last is None:
            steps[0] = 1
        far = int(FAR_TICKS_S / self.interval_s)
        odd = np.flatnonzero((steps < 1) | (steps > far))
        if not len(odd):
            if anew:
                steps[0] = BREAK
            self._last = int(time[-1])
            self._fill(steps)
            return PlacedSamples(block.values, steps, block.saturated)
        keep = np.ones(len(block), dtype=bool)
        self._settle(time, steps, keep, odd, far, final)
        if not final and keep[-1] and (steps[-1] < 0 or steps[-1] > far):
            # the last sample stands out and nothing confirms it yet: wait for the next
            self._suspect = _cut(block, len(block) - 1)
            keep[-1] = False
        most = LONGEST_S if self._room_s is None else 1.02 * self._room_s + GAP_SLACK_S
        steps[steps > max(far, int(most / self.interval_s))] = BREAK
        if anew:
            steps[0] = BREAK
        if keep.any():
            self._last = int(time[np.flatnonzero(keep)[-1]])
        self._fill(steps[keep])
        if keep.all():
            return PlacedSamples(block.values, steps, block.saturated)
        saturated = None if block.saturated is None else block.saturated[keep]
        return PlacedSamples(block.values[keep], steps[keep], saturated)

    def _fill(self, steps: Ints) -> None:
        """The room's time that samples and holes between them account for is no longer open."""
        if self._room_s is not None:
            known = int(steps.min(initial=0)) != BREAK
            filled = int(steps.sum()) * (self.interval_s or 0.0)
            self._room_s = max(0.0, self._room_s - 1.02 * filled) if known else 0.0

    def _is_anew(self, time: int) -> bool:
        """Whether the first sample behind a lost link is not where another clock expects it."""
        expected, self._expected_s = self._expected_s, None
        if expected is None or self._last is None:
            return False
        if abs((time - self._last) * self._scale - expected) < GAP_SLACK_S + 0.02 * expected:
            return False
        self._last = None
        return True

    def _settle(self, time: Ints, steps: Ints, keep: Bools, odd: Ints, far: int, final: bool) -> None:
        """Decide on samples that are not simply a few ticks on: duplicate, bad stamp, hole, restart."""
        scale = self._scale / float(self.interval_s or 1.0)
        last, n = self._last, len(time)
        todo = odd.tolist()[::-1]
        while todo:
            i = todo.pop()
            j = i - 1
            while j >= 0 and not keep[j]:
                j -= 1
            before = int(time[j]) if j >= 0 else last
            if before is None:
                continue
            step = round((int(time[i]) - before) * scale)
            if 1 <= step <= far:
                steps[i] = step  # what looked odd was the sample before it
                continue
            damaged = i + 1 < n and step != 0 and 1 <= round((int(time[i + 1]) - before) * scale) <= far
            if step == 0:
                self.duplicates += 1
            elif damaged:  # the next sample continues the old time: this stamp is wrong
                self.implausible += 1
            elif i + 1 < n or final:
                steps[i] = BREAK if step < 0 else step
            if step == 0 or damaged:
                keep[i] = False
                if i + 1 < n and (not todo or todo[-1] != i + 1):
                    todo.append(i + 1)  # its step counts from the last sample that stays

    def _relative(self, block: SampleBlock) -> PlacedSamples:
        assert self.interval_s is not None
        steps = 1 + block.lost
        if self.clock == "dt" and block.time_ns is not None:
            steps = (
                np.maximum(1, np.rint(block.time_ns * (1e-9 / self.interval_s)).astype(np.int64)) + block.lost
            )
        if self._last is None and not self._unknown_gap:
            steps[0] = 1
        elif self._unknown_gap:
            steps[0] = 1 if self._last is None else BREAK
        self._unknown_gap, self._last = False, 0
        return PlacedSamples(block.values, steps, block.saturated)


def _steps(time: Ints, before: int) -> Ints:
    """(n,) How much later each sample is than the one before it, the first than `before`."""
    steps = np.empty_like(time)
    steps[0] = time[0] - before
    np.subtract(time[1:], time[:-1], out=steps[1:])
    return steps


def _multiples(steps: Floats, interval: float) -> bool:
    """Whether nearly all steps are whole multiples of an interval."""
    ticks = steps / interval
    return bool(np.mean((np.abs(ticks - np.rint(ticks)) < 0.1) & (ticks > 0.5)) > 0.9)


def _snap(interval: float) -> float:
    """Interval on a multiple of the sensor's loop where it lies near one."""
    loops = interval / LOOP_S
    near = round(loops)
    if near >= 1 and abs(loops - near) < min(0.1, 0.02 * near):
        return near * LOOP_S
    return interval


def _cut(block: SampleBlock, start: int, stop: int | None = None) -> SampleBlock:
    rows = slice(start, stop)
    return SampleBlock(
        block.stream,
        block.values[rows],
        None if block.time_ns is None else block.time_ns[rows],
        block.lost[rows],
        None if block.saturated is None else block.saturated[rows],
    )
