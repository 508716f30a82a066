"""Stuck output: whole samples and single axes that repeat instead of being measured.

A sensor that hangs repeats the same sample, and an axis that hangs repeats its value. Neither adds information, and
both distort every statistic without exceeding any limit. Some repeats are normal: a magnetometer that updates at 250 Hz
and is read at 800 Hz, a quantised temperature, a constant channel. The detector therefore learns the usual share p of
repeats.

- A run of r samples that repeat as a whole is stuck if p^r is below `CHANCE`.
- An axis is compared where other axes of its sensor change. It is stuck if it keeps its value for two frames, unless
  it usually repeats: an axis whose noise is hardly wider than one quantisation step may be constant at some levels, and
  one that never changed is constant. That is reported elsewhere and excludes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from imumon.noise.array_state import ArrayState
from imumon.noise.detection.baseline import UNUSUAL_SIGMA
from imumon.noise.detection.frame_statistics import MEMORY_FRAMES, frames_to_change
from imumon.samples import Bools, Floats

CHANCE = float(ndtr(-UNUSUAL_SIGMA))
"""Probability below which a run is not chance: that of an unusual sample."""
LEAST_REPEATS = 5
"""Samples, shortest run of repeats that counts, however rare repeats are: a driver may send one twice."""
LEAST_FRAMES = 2
"""Frames, shortest run of an axis: a smooth signal keeps its rounded value for a while where it turns."""
USUAL_REPEATS = 1.0 / 3.0
"""Share of repeats from which an axis is never stuck: that of noise of 0.85 steps, below which it depends on the
level."""

_NEVER = int(np.iinfo(np.int64).max)


class RepeatDetector(ArrayState):
    """Find groups of channels that repeat whole samples, and axes that repeat their value.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1.
    frame : samples of a frame.
    """

    _STATE = ("_last", "_started", "_run", "_repeats", "_rows", "_longest", "_frames")

    def __init__(self, groups: Sequence[int], frame: int) -> None:
        self._channels = [[c for c, g in enumerate(groups) if g == group] for group in range(max(groups) + 1)]
        self._frame, size = frame, len(self._channels) + len(groups)
        self._last = np.zeros(len(groups))  # channel unit, last sample
        self._started = np.zeros(len(self._channels), dtype=bool)
        # of each group, then of each channel
        self._run = np.zeros(size, dtype=np.int64)  # repeats in a row
        self._repeats, self._rows = np.zeros(size), np.zeros(size)  # samples learned from: repeats, all
        self._longest = np.full(size, _NEVER, dtype=np.int64)  # repeats in a row that count as stuck
        self._frames = np.zeros(1, dtype=np.int64)

    @property
    def next_change(self) -> int:
        """Frames until the usual share of repeats changes."""
        return frames_to_change(int(self._frames[0]))

    def update(self, values: Floats, valid: Bools) -> Bools:
        """Return the rows (n, g) in which a group, or an axis of it, is stuck.

        Parameters
        ----------
        values : (n, c) channel unit.
        valid : (n, g) received rows of each group.
        """
        stuck = np.zeros(valid.shape, dtype=bool)
        for g, channels in enumerate(self._channels):
            rows = slice(None) if valid[:, g].all() else np.flatnonzero(valid[:, g])
            x = values[rows].T[channels]
            if not x.shape[1]:
                continue
            same = np.empty(x.shape, dtype=bool)
            np.equal(x[:, 1:], x[:, :-1], out=same[:, 1:])
            same[:, 0] = self._started[g] & (x[:, 0] == self._last[channels])
            self._last[channels], self._started[g] = x[:, -1], True
            whole = np.asarray(same.all(axis=0))
            found = self._compare(g, whole)
            changes = np.flatnonzero(~whole) if whole.any() else slice(None)
            for c, own in zip(channels, same, strict=True):
                found[changes] |= self._compare(len(self._channels) + c, own[changes])
            stuck[rows, g] = found
        return stuck

    def learn(self, frames: int) -> None:
        """Count `frames` frames, up to `next_change`; then update the usual share. Older samples fade."""
        due = frames >= self.next_change
        self._frames += frames
        if not due:
            return
        for i in np.flatnonzero(self._rows).tolist():
            share = float(self._repeats[i] / self._rows[i])
            if i < len(self._channels):
                self._longest[i] = run_beyond_chance(share, LEAST_REPEATS)
            else:
                self._longest[i] = LEAST_FRAMES * self._frame - 1 if share < USUAL_REPEATS else _NEVER
        if self._frames[0] % MEMORY_FRAMES == 0:
            self._rows *= 0.5
            self._repeats *= 0.5

    def _compare(self, i: int, same: Bools) -> Bools:
        """Return the stuck rows (n,) of group or channel i, of those that repeat; learn from the others."""
        stuck, repeats = np.zeros(len(same), dtype=bool), int(np.count_nonzero(same))
        if repeats:
            place = np.arange(1, len(same) + 1)
            since = np.maximum.accumulate(np.where(same, 0, place))
            run = place - since
            run[since == 0] += self._run[i]
            self._run[i] = run[-1]
            stuck = run >= self._longest[i]
        elif len(same):
            self._run[i] = 0
        excluded = int(np.count_nonzero(stuck))
        self._rows[i] += len(same) - excluded
        self._repeats[i] += repeats - excluded
        return stuck


def run_beyond_chance(share: float, least: int) -> int:
    """Return the length of a run, at least `least`, that is too long for chance; `share` is the usual one.

    >>> run_beyond_chance(0.0, 5), run_beyond_chance(0.69, 5), run_beyond_chance(1.0, 5) > 10**12
    (5, 74, True)
    """
    if share <= 0.0:
        return least
    return max(least, math.ceil(math.log(CHANCE) / math.log(share))) if share < 1.0 else _NEVER
