"""The sensor's time grid: on which tick of its clock each sample lies.

Statistics over tau need equal steps, and real lines lose samples. Time is the sensor's own, never that of
arrival: USB delivers in batches. From the clock of a block follows, sample by sample, how many ticks lie
between it and the sample before it: 1 is the next one, more is a gap of known length, a clock that went
backwards is a gap of unknown length (the sensor restarted). A sample with the same tick as the one before
it came twice. Without an absolute clock, the messages that framing saw damaged count as lost ticks.

This file knows neither statistics nor the room's clock.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.samples import Bools, Clock, Floats, Ints, SampleBlock

LOOP_S = 1.0 / 800.0
"""Period of the sensor's inner loop: output intervals are multiples of it."""

LEARN = 32
"""Differences from which an unknown interval is read."""

AGREE = 3
"""Differences after which an interval that was told is believed, if they agree with it."""

FAR_TICKS_S = 60.0
"""A jump forward beyond this must be confirmed by the next sample: one damaged time stamp that passed
its check must not put a year of holes into the record."""

GAP_SLACK_S = 10.0
"""How far the room's clock may differ from the sensor's over a gap."""

BREAK = -1
"""Step of a sample behind a gap of unknown length."""


@dataclass(frozen=True, slots=True)
class Placed:
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


class Timeline:
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

    def gap(self, length_s: float | None = None) -> None:
        """The link was lost; how long, an absolute clock tells by itself.

        Parameters
        ----------
        length_s : s, about how long by another clock, None where nobody knows. Where the sensor's clock
            says something else, it was restarted meanwhile, and the gap is of unknown length.
        """
        if self.clock in ("dt", "none"):
            self._unknown_gap = True
        elif self._last is not None:
            self._expected_s = length_s

    def place(self, block: SampleBlock, *, final: bool = False) -> list[Placed]:
        """Blocks with their steps; empty while the interval is being learned.

        Parameters
        ----------
        block : samples in order.
        final : no more will come: settle what is held back.
        """
        if not self._known:
            self._held.append(block)
            block = _join(self._held)
            if len(block) > LEARN or final:
                self._learn(block)
            elif len(block) > AGREE:
                self._agree(block)
            if not self._known:
                self.unplaced = len(block)
                return []
            self._held, self.unplaced = [], 0
        if self._suspect is not None:
            block = _join([self._suspect, block])
            self._suspect = None
        if not len(block):
            return []
        placed = (
            self._absolute(block, final) if self.clock in ("startup", "counter") else self._relative(block)
        )
        return [placed] if len(placed.steps) else []

    def finish(self) -> list[Placed]:
        """What was held back, at the end of the stream."""
        rest = self._held or ([self._suspect] if self._suspect is not None else [])
        self._held, self._suspect = [], None
        return self.place(_join(rest), final=True) if rest else []

    def save(self) -> dict[str, object]:
        """State of a timeline that has learned its interval: JSON values."""
        return {"interval_s": self.interval_s, "scale": self._scale, "last": self._last, "known": self._known}

    @classmethod
    def restore(cls, clock: Clock, saved: dict[str, object]) -> Timeline:
        """Continue where `save` left off; a clock without absolute time resumes behind an unknown gap."""
        interval = saved["interval_s"]
        line = cls(clock, float(str(interval)) if interval is not None else None)
        line.interval_s = line._told
        line._known = bool(saved["known"])
        line._scale = float(str(saved["scale"]))
        last = saved["last"]
        line._last = int(str(last)) if last is not None else None
        line.gap()
        return line

    def _learn(self, held: SampleBlock) -> None:
        time = held.time_ns
        assert time is not None
        steps = (time if self.clock == "dt" else np.diff(time))[:LEARN]
        steps = steps[steps > 0]
        if not len(steps):
            return  # the clock stands still: nothing to go by
        typical = float(np.median(steps))
        if self.clock == "counter":
            self._scale = LOOP_S if typical <= 800 else 1e-6
        self.interval_s = _snap(float(np.mean(steps[steps < 1.5 * typical])) * self._scale)
        self._known = True

    def _agree(self, held: SampleBlock) -> None:
        """Believe what was told without waiting longer, where the first steps are just that."""
        time = held.time_ns
        assert time is not None
        if self._told is None or self.clock == "counter":
            return
        steps = (time if self.clock == "dt" else np.diff(time))[:AGREE] * self._scale
        if (np.abs(steps - self._told) < 0.02 * self._told).all():
            self.interval_s = _snap(self._told)
            self._known = True

    def _absolute(self, block: SampleBlock, final: bool) -> Placed:
        assert block.time_ns is not None
        assert self.interval_s is not None
        time, keep = block.time_ns, np.ones(len(block), dtype=bool)
        anew = self._is_anew(int(time[0]))
        before = np.empty_like(time)
        before[1:] = time[:-1]
        before[0] = time[0] if self._last is None else self._last
        steps = np.rint((time - before) * (self._scale / self.interval_s)).astype(np.int64)
        if self._last is None:
            steps[0] = 1
        far = int(FAR_TICKS_S / self.interval_s)
        odd = np.flatnonzero((steps < 1) | (steps > far))
        if len(odd):
            self._settle(time, steps, keep, odd, far, final)
            if not final and keep[-1] and len(block) - 1 in odd and steps[-1] != 0:
                # the last sample stands out and nothing confirms it yet: wait for the next
                self._suspect = _cut(block, len(block) - 1)
                keep[-1] = False
        if anew:
            steps[0] = BREAK
        if keep.any():
            self._last = int(time[np.flatnonzero(keep)[-1]])
        if keep.all():
            return Placed(block.values, steps, block.saturated)
        saturated = None if block.saturated is None else block.saturated[keep]
        return Placed(block.values[keep], steps[keep], saturated)

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

    def _relative(self, block: SampleBlock) -> Placed:
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
        return Placed(block.values, steps, block.saturated)


def _snap(interval: float) -> float:
    """Interval on a multiple of the sensor's loop where it lies near one."""
    loops = interval / LOOP_S
    near = round(loops)
    if near >= 1 and abs(loops - near) < min(0.1, 0.02 * near):
        return near * LOOP_S
    return interval


def _cut(block: SampleBlock, start: int) -> SampleBlock:
    return SampleBlock(
        block.stream,
        block.values[start:],
        None if block.time_ns is None else block.time_ns[start:],
        block.lost[start:],
        None if block.saturated is None else block.saturated[start:],
    )


def _join(blocks: list[SampleBlock]) -> SampleBlock:
    if len(blocks) == 1:
        return blocks[0]
    times = [b.time_ns for b in blocks if b.time_ns is not None]
    flags = [np.zeros(len(b), dtype=bool) if b.saturated is None else b.saturated for b in blocks]
    return SampleBlock(
        blocks[0].stream,
        np.concatenate([b.values for b in blocks]),
        np.concatenate(times) if times else None,
        np.concatenate([b.lost for b in blocks]),
        np.concatenate(flags) if any(b.saturated is not None for b in blocks) else None,
    )
