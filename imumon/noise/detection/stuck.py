"""Stuck output: whole samples and single axes that repeat instead of being measured.

A sensor that hangs repeats the same sample, and an axis that hangs repeats its value. Neither adds information, and
both make every statistic too small without exceeding any limit. Some repeats are normal: a magnetometer that
updates at 250 Hz and is read at 800 Hz, a quantised temperature, a constant channel. The usual share p of repeats is
therefore learned, for each sensor (a repeat of the whole sample) and for each axis.

    of      state      stuck after                                  enters it when usual repeats change
    sensor  learning   never                                        at the beginning
    sensor  watched    r repeats in a row, p^r < 1.3e-12, r >= 5    p is known, p < 1
    sensor  constant   never                                        p = 1
    axis    learning   never                                        at the beginning
    axis    watched    2 frames, while other axes change            p < 1/3
    axis    exempt     never                                        p >= 1/3

p^r is the probability that r independent samples repeat, and 1.3e-12 that of an unusual sample
(`UNUSUAL_CHANCE`).

An axis that usually repeats 7 of 8 samples while others change is also *held* (`RepeatDetector.held`): it is constant,
coarse or updated rarely. Which of these it is, and what it decides, `baseline` finds by its steps.

An axis is compared only in samples in which another axis of its sensor changes: where the whole sample repeats, the
sensor hangs, or is read faster than it measures. Otherwise every axis of such a sensor would usually repeat, and none
of them could be found stuck. An axis whose noise is hardly wider than one quantisation step may be constant at some
levels of it and toggle at others, and one that never changed is constant: both are exempt.

So two dead axes end differently. One that is constant from the beginning excludes nothing: its repeats are usual, the
other axes go on, and its own fit says "the channel is constant" (`fit.estimator`). One that had noise and dies is
stuck: what the other axes say is not known either, so that all of both sensors is excluded until it changes again.

A group or axis is stuck from sample to sample:

    state      sample      next state
    changing   repeats     repeating (1 in a row)
    repeating  repeats     repeating; stuck from r in a row on
    stuck      repeats     stuck
    any        changes     changing

Samples that count as stuck are not learned from, else a sensor that hangs for long would make repeats usual.

`StuckWatch` follows whether gyroscope or accelerometer are stuck at the end of a frame, and notes the changes:

    state      last received sample of the frame     next state
    changing   stuck                                 stuck
    stuck      not stuck                             changing
    any        none received                         unchanged: a gap says nothing about repeats

Example: at 10 Hz, a sensor that repeats for 3 s after 20 s of noise. Four repeats pass, then it is stuck.

>>> values = np.random.default_rng(1).standard_normal((200, 3))
>>> detector, received = RepeatDetector([0, 0, 0], frame_samples=10), np.ones((10, 1), dtype=bool)
>>> for second in range(20):
...     stuck = detector.update(values[10 * second : 10 * second + 10], received)
...     detector.learn(1)
>>> detector.update(values[-1:].repeat(10, axis=0), received)[:, 0].tolist()
[False, False, False, False, True, True, True, True, True, True]
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import restorable
from imumon.noise.detection.baseline import MEMORY_FRAMES, UNUSUAL_SIGMA, frames_to_change

UNUSUAL_CHANCE = float(ndtr(-UNUSUAL_SIGMA))
"""Repeats, or outliers in a row or of two sensors at once, that are less probable are not chance. Unit:
probability.

Otherwise: a magnetometer that is read three times for each value is stuck, and rare outliers by chance are a knock.
Origin: ndtr(-UNUSUAL_SIGMA), 1.3e-12: that of an unusual sample, to one side. `likelihood.CHANCE` is another one
(`test_guard.py`).
"""
STUCK_SAMPLES = 5
"""Fewer are not stuck, however rare repeats are. Unit: repeats in a row.

Otherwise: a sample that a driver sends twice is a fault of the sensor. Chosen: drivers repeat one or two samples
while they wait.
"""
STUCK_AXIS_FRAMES = 2
"""An axis that keeps its value so long, while other axes change, is stuck. Unit: frames.

Otherwise: a smooth signal keeps its rounded value where it turns, and is stuck. Chosen: shorter than any use of a
stuck axis, longer than such a turn.
"""
HELD_AXIS_SHARE = 7.0 / 8.0
"""An axis that usually repeats as often while others change, in steps of any size, decides no disturbance. Unit: of
the samples.

Otherwise: one axis that is updated once a second makes a knock or motion of all axes of both sensors. Origin: values
of eight samples; noise of a third of a step, the least that is not coarse, repeats at most 78 %
(`test_guard_silent.py`).
"""

_NEVER = int(np.iinfo(np.int64).max)  # repeats in a row that no record reaches


@restorable
class RepeatDetector:
    """Find groups of channels that repeat whole samples, and axes that repeat their value.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1.
    frame_samples : samples of a frame.

    Attributes
    ----------
    held : (c,) axes that usually keep their value for many samples while another axis of their sensor changes.
    """

    def __init__(self, groups: Sequence[int], frame_samples: int) -> None:
        self._channels = [[c for c, g in enumerate(groups) if g == group] for group in range(max(groups) + 1)]
        self._frame_samples, size = frame_samples, len(self._channels) + len(groups)
        self._last = np.zeros(len(groups))  # channel unit, last sample
        self._started = np.zeros(len(self._channels), dtype=bool)
        # of each group, then of each channel
        self._run = np.zeros(size, dtype=np.int64)  # repeats in a row
        self._repeats, self._samples = np.zeros(size), np.zeros(size)  # learned from: repeats, all samples
        self._stuck_after = np.full(size, _NEVER, dtype=np.int64)  # repeats in a row; learning
        self._frames = np.zeros(1, dtype=np.int64)
        self.held = np.zeros(len(groups), dtype=bool)

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
        for group, channels in enumerate(self._channels):
            # a lost sample is no sample: the next one is compared with the one before the gap
            rows = slice(None) if valid[:, group].all() else np.flatnonzero(valid[:, group])
            samples = values[rows].T[channels]
            if not samples.shape[1]:
                continue
            same = np.empty(samples.shape, dtype=bool)
            np.equal(samples[:, 1:], samples[:, :-1], out=same[:, 1:])
            same[:, 0] = self._started[group] & (samples[:, 0] == self._last[channels])
            self._last[channels], self._started[group] = samples[:, -1], True
            whole = np.asarray(same.all(axis=0))
            group_stuck = self._follow(group, whole)
            other_axes_change = np.flatnonzero(~whole) if whole.any() else slice(None)
            for channel, repeats in zip(channels, same, strict=True):
                axis_stuck = self._follow(len(self._channels) + channel, repeats[other_axes_change])
                group_stuck[other_axes_change] |= axis_stuck
            stuck[rows, group] = group_stuck
        return stuck

    def learn(self, frames: int) -> None:
        """Count `frames` frames, up to `next_change`; then update the usual share. Older samples fade."""
        due = frames >= self.next_change
        self._frames += frames
        if not due:
            return
        for i in np.flatnonzero(self._samples).tolist():
            share = float(self._repeats[i] / self._samples[i])
            axis = i - len(self._channels)
            if axis < 0:
                self._stuck_after[i] = run_beyond_chance(share, STUCK_SAMPLES)
                continue
            # An axis whose noise is below a step repeats often, and always while its level is in the middle of one: it
            # is never stuck. Of the others, n equal values are n - 1 repeats.
            self._stuck_after[i] = (
                STUCK_AXIS_FRAMES * self._frame_samples - 1 if share < 1.0 / 3.0 else _NEVER
            )
            self.held[axis] = share >= HELD_AXIS_SHARE
        if self._frames[0] % MEMORY_FRAMES == 0:
            self._samples *= 0.5
            self._repeats *= 0.5

    def _follow(self, i: int, same: Bools) -> Bools:
        """Return the stuck samples (n,) of group or channel i, of which `same` repeat; learn from the others."""
        stuck, repeats = np.zeros(len(same), dtype=bool), np.flatnonzero(same)
        if repeats.size:
            begins = np.where(np.diff(repeats, prepend=-2) > 1, repeats, 0)
            run = repeats - np.maximum.accumulate(begins) + 1  # repeats in a row at each of them
            run[repeats < run] += self._run[i]  # the run began in an earlier block
            self._run[i] = run[-1] if same[-1] else 0
            stuck[repeats[run >= self._stuck_after[i]]] = True
        elif len(same):
            self._run[i] = 0
        excluded = int(np.count_nonzero(stuck))
        self._samples[i] += len(same) - excluded
        self._repeats[i] += repeats.size - excluded
        return stuck


@restorable
class StuckWatch:
    """Follow whether some groups are stuck, and where on the grid that changes.

    Parameters
    ----------
    groups : groups that are watched, as one: one stuck axis is enough. Without any, nothing is ever stuck.
    frame_samples : samples of a frame.

    Attributes
    ----------
    stuck : whether one of the groups is stuck now.
    changes : places on the grid where `stuck` changed, and its new value; the guard empties the list.
    """

    def __init__(self, groups: Sequence[int], frame_samples: int) -> None:
        self._groups, self._frame_samples = list(groups), frame_samples
        self.stuck = False
        self.changes: list[tuple[int, bool]] = []

    def update(self, stuck: Bools, valid: Bools, place: int) -> None:
        """Follow the rows (n, g) of whole frames, of which the first is at `place` on the grid."""
        if not self._groups or not (self.stuck or stuck.any()):
            return
        group_stuck: Bools = np.asarray(stuck[:, self._groups].any(axis=1))
        received: Bools = np.asarray(valid[:, self._groups].any(axis=1))
        for begin in range(0, len(stuck), self._frame_samples):
            rows = slice(begin, begin + self._frame_samples)
            known = np.flatnonzero(received[rows])
            if not len(known):
                continue
            now = bool(group_stuck[rows][known[-1]])
            if now != self.stuck:
                self._change(place + rows.stop, now)

    def _change(self, place: int, stuck: bool) -> None:
        self.stuck = stuck
        self.changes.append((place, stuck))


def run_beyond_chance(share: float, least: int) -> int:
    """Return the length of a run, at least `least`, that is too long for chance; `share` is the usual one.

    >>> run_beyond_chance(0.0, 5), run_beyond_chance(0.69, 5), run_beyond_chance(1.0, 5) > 10**12
    (5, 74, True)
    """
    if share <= 0.0:
        return least
    return max(least, math.ceil(math.log(UNUSUAL_CHANCE) / math.log(share))) if share < 1.0 else _NEVER
