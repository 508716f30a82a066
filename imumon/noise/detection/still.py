"""Still: single axes that hang while their neighbours go on.

A sensor that hangs repeats whole samples (`repeats`); an axis that hangs repeats its own number, and what
follows is no noise of it. An axis is called stuck when it does not change at all through more frames in a
row than chance makes of the share that is usual for it, two at least.

The rules:
- An axis that never changed is not stuck but constant: that is told elsewhere, and disturbs nobody.
- Where the noise is hardly wider than a step of the values, standing still is lawful, and how much of it
  there is depends on where the level happens to lie: such an axis is never called stuck.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from imumon.samples import Bools, Floats

CHANCE = 1e-12
LEAST = 2
LEARNED = 8
"""Flat frames of one run that are learned as usual, at most; and moving frames in which steps are sought."""
WIDE = 4.0
"""Steps that the values of a frame span at least where standing still says something."""
FADE = 4096


class StuckAxisDetector:
    """Finds axes that stand still.

    Parameters
    ----------
    channels : which are watched.
    groups : (c,) group of each channel of the stream.
    """

    def __init__(self, channels: Sequence[int], groups: Sequence[int]) -> None:
        every = range(channels[0], channels[-1] + 1) if channels else range(0)
        contiguous = list(every) == list(channels)
        self._rows = slice(every.start, every.stop) if contiguous else np.array(channels, dtype=np.intp)
        self._groups = [groups[c] for c in channels]
        c = len(channels)
        self._run = np.zeros(c, dtype=np.int64)  # flat frames in a row
        self._flat = np.zeros(c)  # frames learned from: flat ones, all
        self._frames = np.zeros(c)
        self._step = np.full(c, np.inf)  # channel unit, least step seen
        self._span = np.zeros(c)  # channel unit, of the values of a moving frame

    @property
    def stuck(self) -> Bools:
        """(c,) Watched channels that are stuck now."""
        if not (self._run >= LEAST).any():  # as nearly always
            return np.zeros(len(self._run), dtype=bool)
        return np.asarray(self._run >= self._needed())

    def update(self, values: Floats, valid: Bools, frames: int) -> list[tuple[int, int]]:
        """Frame and group of every axis that was found stuck.

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
        found = []
        for f in range(frames):
            looked = suspect[:, f] | (self._run > 0) | (self._frames < LEARNED)
            if not looked.any():
                self._learn(np.ones(len(x)))
                continue
            moved = ~looked
            for c in np.flatnonzero(looked).tolist():
                row = x[c, f] if ok is None else x[c, f][ok[c, f]]
                if len(row) < 0.5 * x.shape[2]:
                    continue
                span = float(row.max() - row.min())
                if span > 0.0:
                    moved[c] = True
                    self._move(c, row, span)
                    continue
                self._run[c] += 1
                if self.stuck[c]:
                    found.append((f, self._groups[c]))
            self._learn(moved.astype(np.float64))
        return found

    def _move(self, c: int, row: Floats, span: float) -> None:
        """A channel moves, perhaps again: what it stood still until now was usual."""
        if self._frames[c] < LEARNED:
            self._step[c] = min(self._step[c], float(np.diff(np.unique(row)).min()))
        usual = min(int(self._run[c]), LEARNED)
        self._run[c], self._span[c] = 0, span
        self._frames[c] += usual
        self._flat[c] += usual

    def _learn(self, frames: Floats) -> None:
        """So many frames more of each channel in which it moved; old ones fade."""
        self._frames += frames
        self._flat *= np.where(self._frames > FADE, 1.0 - 1.0 / FADE, 1.0)
        np.minimum(self._frames, FADE, out=self._frames)

    def _needed(self) -> Floats:
        """(c,) Flat frames in a row that chance does not make; infinite where nothing can be said."""
        share = np.where(self._frames > 0, self._flat / np.maximum(self._frames, 1.0), 1.0)
        lawful = (share >= 0.999) | (self._span < WIDE * self._step)
        needed = math.log(CHANCE) / np.log(np.clip(share, CHANCE, 0.999))
        return np.where(lawful, np.inf, np.maximum(LEAST, np.ceil(needed)))

    def save(self) -> dict[str, np.ndarray]:
        """State as arrays."""
        return {name.strip("_"): getattr(self, name).copy() for name in _STATE}

    def restore(self, saved: Mapping[str, np.ndarray]) -> None:
        """Continue where `save` left off."""
        for name in _STATE:
            setattr(self, name, np.array(saved[name.strip("_")]))


_STATE = ("_run", "_flat", "_frames", "_step", "_span")
