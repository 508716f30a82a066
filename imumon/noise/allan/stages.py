"""Ladder: the octaves one above the other, and how a stretch of the time grid is carried up them.

Two entries of an octave make one of the next (`octave`). So a stretch goes in at the bottom as samples, and
at each octave leaves its differences and goes on, beyond m = R with half as many entries. What is missing at
its end is carried up as far as it touches what is valid: a hole of a month costs no more than its octaves.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.noise.allan.octave import BLOCK, Octave
from imumon.noise.validity_groups import ValidityGroups
from imumon.samples import Floats, Ints

BATCH = 32  # blocks worked on at once, at most
RATIOS = (1, 2, 4, 8, 16)


class OctaveStages:
    """The octaves of a stream, as many as its length has reached.

    Write samples to `room`, then `climb`.

    Parameters
    ----------
    groups : channels that share their validity.
    ratio : sub-clusters per cluster, R, one of `RATIOS`.
    threshold : share of a cluster that must be valid for it to count; see `Octave`.

    Attributes
    ----------
    position : samples of this segment that have been through.
    scratch : working space, of fixed size; holds nothing from one call to the next.
    """

    def __init__(self, groups: ValidityGroups, ratio: int, threshold: float) -> None:
        self._groups, self._ratio, self._threshold = groups, ratio, threshold
        self._octaves: list[Octave] = []
        self.position = 0
        self.scratch: list[Floats] = []

    @property
    def nbytes(self) -> int:
        """Bytes of state: sums and histories."""
        return sum(
            o.squares.nbytes + o.terms.nbytes + o.lacks.nbytes + o.history.nbytes + o.counts.nbytes
            for o in self._octaves
        )

    def room(self, n: int) -> Floats:
        """(c, n) channel unit, where the next samples are to be written, `BATCH` blocks at most."""
        return self._frame(0, 1 + n)[:, 1:]

    def climb(self, length: int, n: int, counts: Floats | None) -> None:
        """Carry a stretch of the grid through the octaves.

        Parameters
        ----------
        length : samples of the grid; all beyond the first `n` are missing.
        n : samples written to `room`, missing ones as zero.
        counts : (g, n) 1 where valid, 0 where missing; None: all valid.
        """
        start = self.position  # entries of the octave before this stretch
        self.position += length
        index = 0
        x = self._frame(0, 1 + n)
        while length:
            if index == len(self._octaves):
                self._octaves.append(self._octave(index))
            octave = self._octaves[index]
            if n < length:
                x, counts = self._extend(octave, index, x, length, counts)
                n = x.shape[1] - octave.lag
            all_counts = octave.take(x, counts, self._frame(2, n))
            # Every `step`-th end of a cluster, counted from the segment's start, is one of the next octave.
            step = octave.step
            first = (start + 1) % step
            begins, ends = slice(first, n, step), slice(octave.lag + first, None, step)
            n = (start + n) // step - start // step
            start, length = start // step, (start + length) // step - start // step
            counts = None
            if all_counts is not None:
                counts = all_counts[:, ends] + all_counts[:, begins]
                if (counts == 2 * octave.m).all():
                    counts = None
            index += 1
            lag = min(2 * octave.m, self._ratio)
            above = self._frame(index % 2, lag + n)
            np.add(x[:, ends], x[:, begins], out=above[:, lag:])
            x = above

    def forget(self) -> None:
        """A segment begins: before it nothing has ever been."""
        self.position = 0
        for octave in self._octaves:
            octave.forget()

    def add(self, other: OctaveStages) -> None:
        """Add the sums of another ladder of the same kind."""
        while len(self._octaves) < len(other._octaves):
            self._octaves.append(self._octave(len(self._octaves)))
        for ours, theirs in zip(self._octaves, other._octaves, strict=False):
            ours.squares += theirs.squares
            ours.terms += theirs.terms
            ours.lacks += theirs.lacks

    def sums(self) -> tuple[Floats, Ints, Ints]:
        """(k, c) squared differences, their number, and what they lack, by octave."""
        members, shape = self._groups.of, (len(self._octaves), self._groups.channels)
        squares = np.array([o.squares for o in self._octaves]).reshape(shape)
        terms = np.array([o.terms[members] for o in self._octaves], dtype=np.int64).reshape(shape)
        lacks = np.array([o.lacks[members] for o in self._octaves], dtype=np.int64).reshape(shape)
        return squares, terms, lacks

    def copy(self) -> OctaveStages:
        """An independent ladder in the same state."""
        other = copy.copy(self)
        other.scratch = []  # of its own: it may be asked in another thread
        other._octaves = [octave.copy() for octave in self._octaves]
        return other

    def save(self) -> dict[str, npt.NDArray[Any]]:
        """Everything but the position, as small arrays; the histories of all octaves lie end to end."""
        octaves = self._octaves
        nothing, none = np.zeros((self._groups.channels, 0)), np.zeros((len(self._groups), 0))
        return {
            "squares": np.array([o.squares for o in octaves]),
            "terms": np.array([o.terms for o in octaves]),
            "lacks": np.array([o.lacks for o in octaves]),
            "history": np.concatenate([nothing, *(o.history for o in octaves)], axis=1),
            "counts": np.concatenate([none, *(o.counts for o in octaves)], axis=1),
        }

    def load(self, state: Mapping[str, npt.NDArray[Any]], position: int) -> None:
        """Take the place of one that was saved at a position; this one is new."""
        self.position = position
        start = 0
        for j in range(len(state["squares"])):
            octave = self._octave(j)
            part = slice(start, start + octave.lag)
            octave.squares[:] = state["squares"][j]
            octave.terms[:] = state["terms"][j]
            octave.lacks[:] = state["lacks"][j]
            octave.history[:] = state["history"][:, part]
            octave.set_counts(state["counts"][:, part])
            self._octaves.append(octave)
            start = part.stop

    def _extend(
        self, octave: Octave, index: int, x: Floats, length: int, counts: Floats | None
    ) -> tuple[Floats, Floats]:
        """Write missing entries behind those of a frame, in whole groups, until nothing valid is touched.

        What lies further on, up to `length`, leaves no trace: missing clusters in the histories, as these do.
        """
        known = x[:, octave.lag :].copy()
        n = known.shape[1]
        more = min(length, -(-(n + octave.lag) // octave.group) * octave.group)
        x = self._frame(index % 2, octave.lag + more)
        x[:, octave.lag : octave.lag + n] = known
        x[:, octave.lag + n :] = 0.0
        longer = np.zeros((len(self._groups), more))
        longer[:, :n] = octave.m if counts is None else counts
        return x, longer

    def _octave(self, index: int) -> Octave:
        return Octave(index, self._groups, self._ratio, self._threshold)

    def _frame(self, which: int, columns: int) -> Floats:
        """(c, columns) contiguous working space: 0, 1 for entries of even, odd octaves, 2 for differences."""
        c = self._groups.channels
        if not self.scratch:
            self.scratch = [np.empty(c * (max(RATIOS) + BATCH * BLOCK)) for _ in range(3)]
        return self.scratch[which][: c * columns].reshape(c, columns)
