"""Marks: the same cascade, asked for what came since a moment, or between two, at no cost a sample.

A warm-up is recognised long after it has passed, and an hour is compared with the hours before it. Running a
cascade from every moment that may matter would cost as often as there are moments. But the sums of a cascade
only grow: the sum of octave m over what came after a mark at p is the sum now, less the sum at p + 2m, where
the last difference that reaches back over the mark has gone in. So a mark is a set of small snapshots, one an
octave, each taken when its moment comes; and the difference of two sets is a `Stretch`, which adds up with
others as merged cascades do.

The mark lies on the cascade's blocks of 256 samples, and so do the snapshots: any chunking gives the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.noise.allan import AllanCurve, OctaveCascade
from imumon.noise.allan.octave import BLOCK
from imumon.samples import Bools, Floats, Ints

OCTAVES = 48
"""Room for octaves in a mark: 2^47 samples are 5,000 years at 800 Hz."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Sums of a part of the record.

    Attributes
    ----------
    squares : (k, c) (channel unit)^2, sums of squared differences by octave.
    terms : (k, c) how many they are.
    lacks : (k, c) what they lack, see `octave`.
    valid : (c,) valid samples.
    span : samples of the grid.
    segments : parts with breaks between them.
    """

    squares: Floats
    terms: Ints
    lacks: Ints
    valid: Ints
    span: int
    segments: int

    def __add__(self, other: Stretch) -> Stretch:
        """Both together, as behind a break of unknown length."""
        k = max(len(self.squares), len(other.squares))
        return Stretch(
            _tall(self.squares, k) + _tall(other.squares, k),
            _tall(self.terms, k) + _tall(other.terms, k),
            _tall(self.lacks, k) + _tall(other.lacks, k),
            self.valid + other.valid,
            self.span + other.span,
            self.segments + other.segments,
        )

    def curve(self, tau0: float, ratio: int) -> AllanCurve:
        """The Allan curve of these sums."""
        return AllanCurve.of_sums(
            tau0,
            ratio,
            self.squares,
            self.terms,
            self.lacks,
            span=self.span,
            valid=self.valid,
            segments=self.segments,
        )


@dataclass(slots=True, eq=False)
class Mark:
    """A moment of the record.

    Attributes
    ----------
    start : samples of the grid before it, on a block.
    valid : (c,) valid samples before it.
    segments : segments that ended before it.
    squares, terms, lacks : (`OCTAVES`, c) sums of each octave when nothing that comes reaches over the mark;
        the first `taken` of them are there.
    """

    start: int
    valid: Ints
    segments: int
    squares: Floats
    terms: Ints
    lacks: Ints
    taken: int = 0


class WindowedCascade:
    """A cascade that can be asked for parts of its record.

    Parameters
    ----------
    cascade : the cascade; from now on it is fed here.
    """

    def __init__(self, cascade: OctaveCascade) -> None:
        self.cascade = cascade
        self._marks: list[Mark] = []
        self._segment = 0  # samples of the grid before this segment
        self._position = 0  # samples of the grid so far

    @property
    def position(self) -> int:
        """Samples of the grid so far."""
        return self._position

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Take samples, (n, c) channel unit, with what counts of them, (n, g); see `OctaveCascade.update`."""
        done = 0
        while done < len(values):
            stop = min(len(values), done + self._until_due())
            self.cascade.update(values[done:stop], None if valid is None else valid[done:stop])
            self._move(stop - done)
            done = stop

    def skip(self, n: int) -> None:
        """Move the grid on; see `OctaveCascade.skip`."""
        while n > 0:
            part = min(n, self._until_due())
            self.cascade.skip(part)
            self._move(part)
            n -= part

    def break_(self) -> None:
        """A gap of unknown length: no difference to come reaches over any mark."""
        self.cascade.break_()
        self._segment = self._position
        for mark in self._marks:
            self._take(mark, OCTAVES)

    def mark(self) -> Mark:
        """Mark this moment, or rather the last end of a block before it."""
        behind = (self._position - self._segment) % BLOCK
        squares, _, _, valid, begun = self.cascade.sums()
        made = Mark(
            self._position - behind,
            valid,
            begun - (self._position > self._segment),
            np.zeros((OCTAVES, squares.shape[1])),
            np.zeros((OCTAVES, squares.shape[1]), dtype=np.int64),
            np.zeros((OCTAVES, squares.shape[1]), dtype=np.int64),
        )
        self._marks.append(made)
        if made.start == self._segment:
            self._take(made, OCTAVES)  # nothing lies before it in this segment
        return made

    def forget(self, mark: Mark) -> None:
        """The mark is of no more use."""
        self._marks = [m for m in self._marks if m is not mark]

    def since(self, mark: Mark) -> Stretch:
        """What came since a mark."""
        whole = self.cascade.copy()
        whole.settle()
        return self._between(mark, *whole.sums(), self._position)

    def ended(self, mark: Mark) -> Stretch:
        """What came since a mark up to the last end of a block."""
        behind = (self._position - self._segment) % BLOCK
        return self._between(mark, *self.cascade.sums(), self._position - behind)

    def _between(
        self, mark: Mark, squares: Floats, terms: Ints, lacks: Ints, valid: Ints, segments: int, position: int
    ) -> Stretch:
        k = min(len(squares), mark.taken)
        return Stretch(
            squares[:k] - mark.squares[:k],
            terms[:k] - mark.terms[:k],
            lacks[:k] - mark.lacks[:k],
            valid - mark.valid,
            position - mark.start,
            max(1, segments - mark.segments),
        )

    def _until_due(self) -> int:
        """Samples until the next snapshot, at least one."""
        due = [self._due(mark, mark.taken) for mark in self._marks if mark.taken < OCTAVES]
        return max(1, min(due, default=1 << 62) - self._position)

    def _due(self, mark: Mark, octave: int) -> int:
        """Where an octave of a mark is to be taken: at the first end of a block behind start + 2m."""
        wanted = mark.start + (2 << octave) - self._segment
        return self._segment - (-wanted // BLOCK) * BLOCK

    def _move(self, n: int) -> None:
        self._position += n
        for mark in self._marks:
            reached = mark.taken
            while reached < OCTAVES and self._position >= self._due(mark, reached):
                reached += 1
            if reached > mark.taken:
                self._take(mark, reached)

    def _take(self, mark: Mark, upto: int) -> None:
        """Snapshots of the octaves up to `upto` (not included) that are still wanting."""
        squares, terms, lacks, _, _ = self.cascade.sums()
        rows = slice(mark.taken, min(upto, len(squares)))
        if rows.start < rows.stop:
            mark.squares[rows], mark.terms[rows] = squares[rows], terms[rows]
            mark.lacks[rows] = lacks[rows]
        mark.taken = max(mark.taken, upto)

    def save(self) -> dict[str, np.ndarray]:
        """State as arrays; the marks in the order they were made."""
        out = {f"cascade.{name}": array for name, array in self.cascade.save().items()}
        out["numbers"] = np.array([self._segment, self._position, len(self._marks)], dtype=np.int64)
        for number, mark in enumerate(self._marks):
            k = len(self.cascade.sums()[0])
            out[f"mark{number}.numbers"] = np.array([mark.start, mark.segments, mark.taken], dtype=np.int64)
            out[f"mark{number}.valid"] = mark.valid
            out[f"mark{number}.squares"] = mark.squares[:k].copy()
            out[f"mark{number}.terms"] = mark.terms[:k].copy()
            out[f"mark{number}.lacks"] = mark.lacks[:k].copy()
        return out

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> WindowedCascade:
        """Continue where `save` left off."""
        own = {k.removeprefix("cascade."): v for k, v in saved.items() if k.startswith("cascade.")}
        self = cls(OctaveCascade.restore(own))
        self._segment, self._position, count = (int(v) for v in saved["numbers"])
        for number in range(count):
            start, segments, taken = (int(v) for v in saved[f"mark{number}.numbers"])
            squares, terms, lacks = (
                _tall(saved[f"mark{number}.{name}"], OCTAVES) for name in ("squares", "terms", "lacks")
            )
            valid = saved[f"mark{number}.valid"]
            self._marks.append(Mark(start, valid, segments, squares, terms, lacks, taken))
        return self

    @property
    def marks(self) -> Sequence[Mark]:
        """Marks not yet forgotten, in the order they were made."""
        return tuple(self._marks)


def _tall(rows: np.ndarray, k: int) -> np.ndarray:
    """(k, c) with zeros below."""
    return np.concatenate([rows, np.zeros((k - len(rows), rows.shape[1]), dtype=rows.dtype)])
