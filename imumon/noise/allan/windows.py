"""Allan sums since a moment, or between two moments, from one cascade and without cost per sample.

A warm-up is detected long after it has ended, and an hour is compared with the hours before it. Running one
cascade from each moment that may matter would be expensive. But the sums of a cascade only grow: the sum of
octave m over the samples after position p is the sum now, less the sum at p + 2m, where the last difference
that reaches back over p has been added. So a window is a set of snapshots, one per octave, each taken when
its position is reached. The difference to the current sums is a `WindowSums`; windows add up like merged
cascades.

Windows begin on the cascade's blocks of 256 samples, and snapshots are taken there: any chunking gives the
same result.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.noise.allan.cascade import OctaveCascade
from imumon.noise.allan.curve import AllanCurve
from imumon.noise.allan.octave import BLOCK
from imumon.samples import Bools, Floats, Ints

MAX_OCTAVES = 48  # Octaves that a window has space for: 2^47 samples are 5,000 years at 800 Hz. Not critical


@dataclass(frozen=True, slots=True, eq=False)
class WindowSums:
    """Sums of a part of the record.

    Attributes
    ----------
    squares : (k, c) (channel unit)^2, sums of squared differences by octave.
    terms : (k, c) number of differences.
    white_excess : (k, c) 1/`EXCESS_SCALE`, sums of their excess of white noise, see `octave`.
    valid : (c,) valid samples.
    span : samples of the grid.
    segments : parts with gaps of unknown length between them.
    record : identity of the growing part of the record, see `AllanCurve`; None: unknown.
    """

    squares: Floats
    terms: Ints
    white_excess: Ints
    valid: Ints
    span: int
    segments: int
    record: Hashable = None

    def __add__(self, other: WindowSums) -> WindowSums:
        """Return the sums of both, with a gap of unknown length between them."""
        k = max(len(self.squares), len(other.squares))
        return WindowSums(
            _padded(self.squares, k) + _padded(other.squares, k),
            _padded(self.terms, k) + _padded(other.terms, k),
            _padded(self.white_excess, k) + _padded(other.white_excess, k),
            self.valid + other.valid,
            self.span + other.span,
            self.segments + other.segments,
        )

    def curve(self, tau0: float, ratio: int) -> AllanCurve:
        """Return the Allan curve of these sums."""
        return AllanCurve.from_sums(
            tau0,
            ratio,
            self.squares,
            self.terms,
            self.white_excess,
            span=self.span,
            valid=self.valid,
            segments=self.segments,
            record=self.record,
        )


@dataclass(slots=True, eq=False)
class Window:
    """A part of the record that begins at a known position and has no end yet.

    Attributes
    ----------
    start : samples of the grid before it, a multiple of the block.
    valid : (c,) valid samples before it.
    segments : segments that ended before it.
    squares, terms, white_excess : (`MAX_OCTAVES`, c) snapshot of the sums of each octave, taken when no later
        difference reaches back over the start.
    octaves : number of octaves whose snapshot has been taken.
    """

    start: int
    valid: Ints
    segments: int
    squares: Floats
    terms: Ints
    white_excess: Ints
    octaves: int = 0


class WindowedCascade:
    """A cascade that also returns the sums of parts of its record.

    Parameters
    ----------
    cascade : the cascade; all later samples must be given to this object.
    """

    def __init__(self, cascade: OctaveCascade) -> None:
        self.cascade = cascade
        self._windows: list[Window] = []
        self._segment = 0  # samples of the grid before this segment
        self._position = 0  # samples of the grid so far

    @property
    def position(self) -> int:
        """Samples of the grid so far."""
        return self._position

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples, (n, c) channel unit, with their validity, (n, g); see `OctaveCascade.update`."""
        done = 0
        while done < len(values):
            stop = min(len(values), done + self._until_snapshot())
            self.cascade.update(values[done:stop], None if valid is None else valid[done:stop])
            self._advance(stop - done)
            done = stop

    def skip(self, n: int) -> None:
        """Advance the grid; see `OctaveCascade.skip`."""
        while n > 0:
            part = min(n, self._until_snapshot())
            self.cascade.skip(part)
            self._advance(part)
            n -= part

    def break_(self) -> None:
        """Begin a new segment: no later difference reaches back over the start of any window."""
        self.cascade.break_()
        self._segment = self._position
        for window in self._windows:
            self._take_snapshot(window, MAX_OCTAVES)

    def open_window(self) -> Window:
        """Begin a window at the last end of a block."""
        squares, _, _, valid, segments = self.cascade.sums()
        window = Window(
            self._position - self._incomplete(),
            valid,
            segments - (self._position > self._segment),
            np.zeros((MAX_OCTAVES, squares.shape[1])),
            np.zeros((MAX_OCTAVES, squares.shape[1]), dtype=np.int64),
            np.zeros((MAX_OCTAVES, squares.shape[1]), dtype=np.int64),
        )
        self._windows.append(window)
        if window.start == self._segment:
            self._take_snapshot(window, MAX_OCTAVES)  # nothing lies before it in this segment
        return window

    def close_window(self, window: Window) -> None:
        """Drop a window that is no longer needed."""
        self._windows = [w for w in self._windows if w is not window]

    def sums_since(self, window: Window) -> WindowSums:
        """Return the sums since the start of a window."""
        whole = self.cascade.copy()
        whole.flush()
        return self._difference(window, *whole.sums(), self._position)

    def block_sums_since(self, window: Window) -> WindowSums:
        """Return the sums from the start of a window to the last end of a block."""
        return self._difference(window, *self.cascade.sums(), self._position - self._incomplete())

    def _difference(
        self,
        window: Window,
        squares: Floats,
        terms: Ints,
        white_excess: Ints,
        valid: Ints,
        segments: int,
        position: int,
    ) -> WindowSums:
        k = min(len(squares), window.octaves)
        return WindowSums(
            squares[:k] - window.squares[:k],
            terms[:k] - window.terms[:k],
            white_excess[:k] - window.white_excess[:k],
            valid - window.valid,
            position - window.start,
            max(1, segments - window.segments),
            (self.cascade.record, window.start),
        )

    def _incomplete(self) -> int:
        """Samples since the last end of a block."""
        return (self._position - self._segment) % BLOCK

    def _until_snapshot(self) -> int:
        """Samples until the next snapshot, at least one."""
        due = [self._due(window, window.octaves) for window in self._windows if window.octaves < MAX_OCTAVES]
        return max(1, min(due, default=1 << 62) - self._position)

    def _due(self, window: Window, octave: int) -> int:
        """Position at which the snapshot of an octave is taken: the first end of a block after start + 2m."""
        after = window.start + (2 << octave) - self._segment
        return self._segment - (-after // BLOCK) * BLOCK

    def _advance(self, n: int) -> None:
        self._position += n
        for window in self._windows:
            octaves = window.octaves
            while octaves < MAX_OCTAVES and self._position >= self._due(window, octaves):
                octaves += 1
            if octaves > window.octaves:
                self._take_snapshot(window, octaves)

    def _take_snapshot(self, window: Window, octaves: int) -> None:
        """Take the missing snapshots of the first `octaves` octaves."""
        squares, terms, white_excess, _, _ = self.cascade.sums()
        rows = slice(window.octaves, min(octaves, len(squares)))
        if rows.start < rows.stop:
            window.squares[rows], window.terms[rows] = squares[rows], terms[rows]
            window.white_excess[rows] = white_excess[rows]
        window.octaves = max(window.octaves, octaves)

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays; the windows in the order in which they were opened."""
        out = {f"cascade.{name}": array for name, array in self.cascade.save().items()}
        out["numbers"] = np.array([self._segment, self._position, len(self._windows)], dtype=np.int64)
        k = len(self.cascade.sums()[0])
        for number, window in enumerate(self._windows):
            part = f"mark{number}."  # these names are part of the saved format
            numbers = (window.start, window.segments, window.octaves)
            out[f"{part}numbers"] = np.array(numbers, dtype=np.int64)
            out[f"{part}valid"] = window.valid
            out[f"{part}squares"] = window.squares[:k].copy()
            out[f"{part}terms"] = window.terms[:k].copy()
            out[f"{part}lacks"] = window.white_excess[:k].copy()
        return out

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> WindowedCascade:
        """Return a cascade in a saved state; it continues identically."""
        own = {k.removeprefix("cascade."): v for k, v in saved.items() if k.startswith("cascade.")}
        self = cls(OctaveCascade.restore(own))
        self._segment, self._position, count = (int(v) for v in saved["numbers"])
        for number in range(count):
            part = f"mark{number}."
            start, segments, octaves = (int(v) for v in saved[f"{part}numbers"])
            squares, terms, white_excess = (
                _padded(saved[part + name], MAX_OCTAVES) for name in ("squares", "terms", "lacks")
            )
            valid = saved[f"{part}valid"]
            self._windows.append(Window(start, valid, segments, squares, terms, white_excess, octaves))
        return self

    @property
    def windows(self) -> Sequence[Window]:
        """Open windows in the order in which they were opened."""
        return tuple(self._windows)


def _padded(rows: np.ndarray, k: int) -> np.ndarray:
    """(k, c), with rows of zeros appended."""
    return np.concatenate([rows, np.zeros((k - len(rows), rows.shape[1]), dtype=rows.dtype)])
