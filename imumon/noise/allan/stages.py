"""The octaves of a cascade, and how a part of the time grid is passed through them.

Two entries of an octave make one of the next (`octave`). So a part of the grid enters the first octave as
samples; each octave adds its differences and passes the sums on, beyond m = R half as many. Missing samples
at its end are passed on only as far as they touch valid ones: a gap of a month costs no more than its
octaves.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.noise.allan.octave import RATIO, Octave
from imumon.noise.validity_groups import ValidityGroups
from imumon.samples import Floats, Ints

BATCH = 32
"""Blocks processed at once at most."""


class OctaveStages:
    """The octaves of a stream, as many as its length has reached.

    Write samples to `input_buffer`, then call `update`.

    Parameters
    ----------
    groups : channels that share their validity.

    Attributes
    ----------
    position : samples of this segment that have been processed.
    """

    def __init__(self, groups: ValidityGroups) -> None:
        self._groups = groups
        self._octaves: list[Octave] = []
        self.position = 0
        self._buffers = [np.empty(0)] * 3  # reused: fresh arrays double the time per sample

    @property
    def nbytes(self) -> int:
        """Bytes of state: sums and histories."""
        return sum(octave.nbytes for octave in self._octaves)

    def input_buffer(self, n: int) -> Floats:
        """Return (c, n) channel unit, where to write the next samples, at most `BATCH` blocks."""
        return self._buffer(0, 1 + n)[:, 1:]

    def update(self, length: int, n: int, counts: Floats | None) -> None:
        """Pass a part of the grid through the octaves.

        Parameters
        ----------
        length : samples of the grid; all after the first n are missing.
        n : samples written to `input_buffer`, missing ones as zero.
        counts : (g, n) 1 where valid, 0 where missing; None: all valid.
        """
        start = self.position  # entries of the octave before this part
        self.position += length
        index = 0
        x = self._buffer(0, 1 + n)
        while length:
            if index == len(self._octaves):
                self._octaves.append(Octave(index, self._groups))
            octave = self._octaves[index]
            if n < length:
                x, counts = self._with_missing(octave, index, x, length, counts)
                n = x.shape[1] - octave.lag
            all_counts = octave.update(x, counts, self._buffer(2, n))
            # Every `step`-th end of a cluster, counted from the segment's start, is one of the next octave.
            step = octave.step
            first = (start + 1) % step
            begins, ends = slice(first, n, step), slice(octave.lag + first, None, step)
            n = (start + n) // step - start // step
            start, length = start // step, (start + length) // step - start // step
            counts = None if all_counts is None else all_counts[:, ends] + all_counts[:, begins]
            if counts is not None and (counts == 2 * octave.m).all():
                counts = None
            index += 1
            lag = min(2 * octave.m, RATIO)
            above = self._buffer(index % 2, lag + n)
            np.add(x[:, ends], x[:, begins], out=above[:, lag:])
            x = above

    def start_segment(self) -> None:
        """Clear all histories but keep the sums."""
        self.position = 0
        for octave in self._octaves:
            octave.start_segment()

    def add_sums(self, other: OctaveStages) -> None:
        """Add the sums of other stages with the same parameters."""
        while len(self._octaves) < len(other._octaves):
            self._octaves.append(Octave(len(self._octaves), self._groups))
        for ours, theirs in zip(self._octaves, other._octaves, strict=False):
            ours.squares += theirs.squares
            ours.terms += theirs.terms
            ours.white_excess += theirs.white_excess

    def sums(self) -> tuple[Floats, Ints, Ints]:
        """Return the sums by octave, (k, c) each: squared differences, their number, their white excess."""
        of, octaves = self._groups.of, self._octaves
        squares = np.array([o.squares for o in octaves]).reshape(-1, of.size)
        terms = np.array([o.terms for o in octaves], dtype=np.int64).reshape(-1, len(self._groups))
        excess = np.array([o.white_excess for o in octaves], dtype=np.int64).reshape(-1, len(self._groups))
        return squares, terms[:, of], excess[:, of]

    def copy(self) -> OctaveStages:
        """Return independent stages in the same state."""
        other = copy.copy(self)
        other._octaves = [octave.copy() for octave in self._octaves]
        other._buffers = [np.empty(0)] * 3
        return other

    def save(self) -> dict[str, npt.NDArray[Any]]:
        """Return the state except the position; the histories of all octaves are concatenated."""
        octaves = self._octaves
        no_history, no_counts = np.zeros((self._groups.channels, 0)), np.zeros((len(self._groups), 0))
        return {
            "squares": np.array([o.squares for o in octaves]),
            "terms": np.array([o.terms for o in octaves]),
            "lacks": np.array([o.white_excess for o in octaves]),  # the name is part of the saved format
            "history": np.concatenate([no_history, *(o.history for o in octaves)], axis=1),
            "counts": np.concatenate([no_counts, *(o.counts for o in octaves)], axis=1),
        }

    def load(self, state: Mapping[str, npt.NDArray[Any]], position: int) -> None:
        """Load a saved state into these stages, which are new."""
        self.position = position
        start = 0
        for j in range(len(state["squares"])):
            octave = Octave(j, self._groups)
            part = slice(start, start + octave.lag)
            octave.squares[:] = state["squares"][j]
            octave.terms[:] = state["terms"][j]
            octave.white_excess[:] = state["lacks"][j]
            octave.history[:] = state["history"][:, part]
            octave.set_counts(state["counts"][:, part])
            self._octaves.append(octave)
            start = part.stop

    def _with_missing(
        self, octave: Octave, index: int, x: Floats, length: int, counts: Floats | None
    ) -> tuple[Floats, Floats]:
        """Return `x` and its counts with missing entries appended until no difference reaches a valid one.

        They are appended in whole groups. The rest up to `length` has no effect: the histories then hold
        missing clusters only.
        """
        n = x.shape[1] - octave.lag
        total = min(length, -(-(n + octave.lag) // octave.group) * octave.group)
        known = x[:, octave.lag :].copy()  # in the same buffer with another width
        longer = self._buffer(index % 2, octave.lag + total)
        longer[:, octave.lag : octave.lag + n] = known
        longer[:, octave.lag + n :] = 0.0
        all_counts = np.zeros((len(self._groups), total))
        all_counts[:, :n] = octave.m if counts is None else counts
        return longer, all_counts

    def _buffer(self, index: int, columns: int) -> Floats:
        """Return (c, columns) working space: 0, 1 for entries of even, odd octaves, 2 for differences."""
        c = self._groups.channels
        if len(self._buffers[index]) < c * columns:
            self._buffers[index] = np.empty(c * columns)
        return self._buffers[index][: c * columns].reshape(c, columns)
