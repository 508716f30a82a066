"""Stuck output: whole samples and single axes that repeat instead of being measured.

A sensor that hangs repeats the same sample, and an axis that hangs repeats its value. Neither adds
information, and both distort every statistic without exceeding any limit. Some repeats are normal: a
magnetometer that updates at 250 Hz and is read at 800 Hz, a quantised temperature, a constant channel. The
detectors therefore learn the usual share p of repeats. A run of r repeats counts as stuck only if p^r is below
`CHANCE`.

- `RepeatDetector` compares whole samples of a group of channels.
- `StuckAxisDetector` compares the values of one axis over whole frames. An axis that never changed is
  constant, not stuck: it is reported elsewhere and excludes nothing. An axis whose noise is hardly wider than
  one quantisation step may be constant at some levels, and is never stuck.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.noise.detection.frame_statistics import ArrayState
from imumon.samples import Bools, Floats

CHANCE = 1e-12
"""Probability below which a run of repeats is not chance: less than one false run in a month at 800 Hz."""

LEAST_REPEATS = 5
"""Samples, shortest run of repeats that counts, however rare repeats are: a driver may send one twice."""
LEAST_FRAMES = 2
"""Frames, shortest run in which a stuck axis does not change at all: one may be split by a restart."""
LAWFUL_SHARE = 0.999
"""Share of repeats from which a channel counts as constant: no run of it is unusual."""

LEARN_ROWS = 8
"""Samples from which the share of repeats is taken as usual."""
LEARN_EVERY = 32
"""Frames between two updates of the usual share, after powers of two at first."""
FADE_ROWS = 4096
"""Samples after which older ones count half, so that the usual share follows the sensor."""

LEARN_FRAMES = 8
"""Most frames of one run without a change that are learned as usual; changing frames in which the
quantisation step is determined."""
FADE_FRAMES = 4096
"""Frames, memory of the usual share of frames without a change."""
WIDE_STEPS = 4.0
"""Quantisation steps that a frame of an axis must span before a constant value counts: a narrower axis may
stay in the middle of a step."""
LEAST_VALID = 0.5
"""Valid share of a frame from which it is compared."""

HASH_MULTIPLIER = 0x9E3779B97F4A7C15
"""2^64 over the golden ratio, for multiplicative hashing (Knuth, TAOCP 3, section 6.4)."""

_NEVER = int(np.iinfo(np.int64).max)


class RepeatDetector(ArrayState):
    """Find groups of channels that repeat whole samples.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1.
    """

    _STATE = ("_previous", "_started", "_run", "_repeats", "_rows", "_longest", "_frames")

    def __init__(self, groups: Sequence[int]) -> None:
        self._channels = [[c for c, g in enumerate(groups) if g == group] for group in range(max(groups) + 1)]
        # odd multipliers, different for each channel, so that a sum of products identifies a sample
        keys = [HASH_MULTIPLIER * (2 * c + 3) ** 2 | 1 for c in range(len(groups))]
        self._keys = np.array([key % 2**64 for key in keys], dtype=np.uint64)
        g = len(self._channels)
        self._previous = np.zeros(g, dtype=np.uint64)  # hash of the last sample
        self._started = np.zeros(g, dtype=bool)
        self._run = np.zeros(g, dtype=np.int64)  # repeats in a row
        self._repeats = np.zeros(g)  # samples learned from: repeats, all
        self._rows = np.zeros(g)
        self._longest = np.full(g, _NEVER, dtype=np.int64)  # repeats in a row that count as stuck
        self._frames = np.zeros(1, dtype=np.int64)

    @property
    def next_change(self) -> int:
        """Frames until the usual share of repeats changes: at powers of two and multiples of `LEARN_EVERY`."""
        frames = int(self._frames[0])
        return min(1 << frames.bit_length(), (frames // LEARN_EVERY + 1) * LEARN_EVERY) - frames

    def update(self, values: Floats, valid: Bools) -> Bools:
        """Return the rows (n, g) that repeat the one before, in a run that is too long for chance.

        Parameters
        ----------
        values : (n, c) channel unit.
        valid : (n, g) received rows of each group.
        """
        stuck = np.zeros(valid.shape, dtype=bool)
        bits = values.T.view(np.uint64)
        for g, channels in enumerate(self._channels):
            mixed = bits[channels[0]] * self._keys[channels[0]]
            for c in channels[1:]:
                mixed += bits[c] * self._keys[c]
            self._compare(g, mixed, valid[:, g], stuck[:, g])
        return stuck

    def learn(self, frames: int) -> None:
        """Count `frames` frames, up to `next_change`; then update the usual share. Older samples fade."""
        due = frames >= self.next_change
        self._frames += frames
        if not due:
            return
        for g in range(len(self._rows)):
            if self._rows[g] < LEARN_ROWS:
                continue
            self._longest[g] = run_beyond_chance(self._repeats[g] / self._rows[g])
            if self._rows[g] > FADE_ROWS:
                self._rows[g] *= 0.5
                self._repeats[g] *= 0.5

    def _compare(self, g: int, mixed: np.ndarray, valid: Bools, out: Bools) -> None:
        """Mark the stuck rows of group `g` in `out`, (n,)."""
        index = None if valid.all() else np.flatnonzero(valid)
        row = mixed if index is None else mixed[index]
        if not len(row):
            return
        same = np.empty(len(row), dtype=bool)
        same[1:] = row[1:] == row[:-1]
        same[0] = bool(self._started[g]) and row[0] == self._previous[g]
        self._previous[g], self._started[g] = row[-1], True
        usual, repeats = len(row), int(np.count_nonzero(same))
        if repeats:
            place = np.arange(1, len(row) + 1)
            since = np.maximum.accumulate(np.where(same, 0, place))
            run = place - since
            run[since == 0] += self._run[g]
            self._run[g] = run[-1]
            stuck = run >= self._longest[g]
            if stuck.any():
                usual -= int(stuck.sum())
                repeats -= int(stuck.sum())
                out[slice(None) if index is None else index] = stuck
        else:
            self._run[g] = 0
        self._rows[g] += usual
        self._repeats[g] += repeats


class StuckAxisDetector(ArrayState):
    """Find axes that do not change at all.

    Parameters
    ----------
    channels : columns that are compared.
    groups : (c,) group of each channel of the stream.

    Attributes
    ----------
    unclear : frames of the last update with too few valid rows to decide whether a stuck axis still is.
    """

    _STATE = ("_run", "_flat", "_frames", "_step", "_span")

    def __init__(self, channels: Sequence[int], groups: Sequence[int]) -> None:
        span = range(channels[0], channels[-1] + 1) if channels else range(0)
        contiguous = list(span) == list(channels)
        self._rows = slice(span.start, span.stop) if contiguous else np.array(channels, dtype=np.intp)
        self._groups = [groups[c] for c in channels]
        c = len(channels)
        self.unclear: set[int] = set()
        self._run = np.zeros(c, dtype=np.int64)  # frames in a row without a change
        self._flat = np.zeros(c)  # frames learned from: those without a change, all
        self._frames = np.zeros(c)
        self._step = np.full(c, np.inf)  # channel unit, least step
        self._span = np.zeros(c)  # channel unit, of the values of a moving frame

    @property
    def stuck(self) -> Bools:
        """(c,) Compared channels that are stuck now."""
        return np.asarray(self._run >= self._needed())

    def update(self, values: Floats, valid: Bools, frames: int) -> list[tuple[int, int]]:
        """Return frame and group of each axis that is stuck.

        Parameters
        ----------
        values : (n, c) channel unit, of whole frames.
        valid : (n, g).
        """
        x = values.T[self._rows].reshape(len(self._groups), frames, -1)
        half = x.shape[2] // 2
        suspect = (x[:, :, 0] == x[:, :, half]) & (x[:, :, 0] == x[:, :, -1])
        ok = None if valid.all() else valid.T[self._groups].reshape(x.shape)
        if ok is not None:
            suspect |= ~ok.all(axis=2)
        stuck, self.unclear = [], set()
        for f in range(frames):
            examined = suspect[:, f] | (self._run > 0) | (self._frames < LEARN_FRAMES)
            if not examined.any():
                self._learn(np.ones(len(x)))
                continue
            moved = ~examined
            for c in np.flatnonzero(examined).tolist():
                row = x[c, f] if ok is None else x[c, f][ok[c, f]]
                if len(row) < LEAST_VALID * x.shape[2]:
                    if self._run[c] >= LEAST_FRAMES and self.stuck[c]:
                        self.unclear.add(f)
                    continue
                span = float(row.max() - row.min())
                if span > 0.0:
                    moved[c] = True
                    self._end_run(c, row, span)
                    continue
                self._run[c] += 1
                if self._run[c] >= LEAST_FRAMES and self.stuck[c]:
                    stuck.append((f, self._groups[c]))
            self._learn(moved.astype(np.float64))
        return stuck

    def _end_run(self, c: int, row: Floats, span: float) -> None:
        """Note that a channel changes: the constant frames before were usual."""
        if self._frames[c] < LEARN_FRAMES:
            self._step[c] = min(self._step[c], float(np.diff(np.unique(row)).min()))
        usual = min(int(self._run[c]), LEARN_FRAMES)
        self._run[c], self._span[c] = 0, span
        self._frames[c] += usual
        self._flat[c] += usual

    def _learn(self, frames: Floats) -> None:
        """Count (c,) more frames in which each channel changed; older frames fade."""
        self._frames += frames
        self._flat *= np.where(self._frames > FADE_FRAMES, 1.0 - 1.0 / FADE_FRAMES, 1.0)
        np.minimum(self._frames, FADE_FRAMES, out=self._frames)

    def _needed(self) -> Floats:
        """Return (c,) frames in a row without a change that are too many for chance; inf if unknown."""
        share = np.where(self._frames > 0, self._flat / np.maximum(self._frames, 1.0), 1.0)
        lawful = (share >= LAWFUL_SHARE) | (self._span < WIDE_STEPS * self._step)
        needed = math.log(CHANCE) / np.log(np.clip(share, CHANCE, LAWFUL_SHARE))
        return np.where(lawful, np.inf, np.maximum(LEAST_FRAMES, np.ceil(needed)))


def run_beyond_chance(share: float) -> int:
    """Return the length of a run of repeats that is too long for chance; `share` is the usual one.

    >>> run_beyond_chance(0.0), run_beyond_chance(0.69), run_beyond_chance(1.0) > 10**12
    (5, 75, True)
    """
    if share >= LAWFUL_SHARE:
        return _NEVER
    if share <= 0.0:
        return LEAST_REPEATS
    return max(LEAST_REPEATS, math.ceil(math.log(CHANCE) / math.log(share)))
