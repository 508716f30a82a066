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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.noise.allan.cascade import OctaveCascade
from imumon.noise.allan.curve import AllanCurve, WindowSums, padded
from imumon.noise.array_state import subset
from imumon.noise.blocks.block_means import BLOCK
from imumon.noise.spectrum.spectrum_accumulator import LEVELS, SpectrumMark
from imumon.samples import Bools, Floats, Ints

__all__ = ["Window", "WindowSums", "WindowedCascade"]


@dataclass(slots=True, eq=False)
class Window:
    """A part of the record that begins at a known position and has no end yet.

    Attributes
    ----------
    start : samples of the grid before it, a multiple of the block.
    valid : (c,) valid samples before it.
    segments : segments that ended before it.
    squares, terms, white_excess : (`LEVELS`, c) snapshot of the sums of each octave, taken when no later
        difference reaches back over the start.
    octaves : number of octaves whose snapshot has been taken.
    mark : the same place in the spectrum.
    """

    start: int
    valid: Ints
    segments: int
    squares: Floats
    terms: Ints
    white_excess: Ints
    octaves: int = 0
    mark: SpectrumMark | None = None


class WindowedCascade:
    """A cascade that also returns the sums of parts of its record.

    Parameters
    ----------
    cascade : the cascade; all later samples must be given to this object.
    """

    def __init__(self, cascade: OctaveCascade) -> None:
        self.cascade = cascade
        self._windows: list[Window] = []

    @property
    def position(self) -> int:
        """Samples of the grid so far."""
        return self.cascade.span

    @property
    def windows(self) -> Sequence[Window]:
        """Open windows in the order in which they were opened."""
        return tuple(self._windows)

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples, (n, c) channel unit, with their validity, (n, g); see `OctaveCascade.update`."""
        done = 0
        while done < len(values):
            stop = min(len(values), done + self._until_snapshot())
            self.cascade.update(values[done:stop], None if valid is None else valid[done:stop])
            self._take_due_snapshots()
            done = stop

    def skip(self, n: int) -> None:
        """Advance the grid; see `OctaveCascade.skip`."""
        while n > 0:
            part = min(n, self._until_snapshot())
            self.cascade.skip(part)
            self._take_due_snapshots()
            n -= part

    def break_(self) -> None:
        """Begin a new segment: no later difference reaches back over the start of any window."""
        self.cascade.break_()
        for window in self._windows:
            self._take_snapshot(window, LEVELS)

    def open_window(self) -> Window:
        """Begin a window at the last end of a block."""
        now = self.cascade.block_sums()
        rows = padded(now.squares[:0], LEVELS), padded(now.terms[:0], LEVELS)
        window = Window(now.span, now.valid, self.cascade.ended_segments, *rows, rows[1].copy())
        window.mark = self.cascade.add_mark()
        self._windows.append(window)
        if window.start == self.cascade.segment_start:
            self._take_snapshot(window, LEVELS)  # nothing lies before it in this segment
        return window

    def close_window(self, window: Window) -> None:
        """Drop a window that is no longer needed."""
        self._windows = [w for w in self._windows if w is not window]
        if window.mark is not None:
            self.cascade.spectrum.drop_mark(window.mark)

    def sums_since(self, window: Window) -> WindowSums:
        """Return the sums since the start of a window."""
        return _difference(window, self.cascade.sums())

    def curve_since(self, window: Window) -> AllanCurve:
        """Return the curve since the start of a window, with the sums of its noise up to the last end of a block."""
        assert window.mark is not None
        return self.sums_since(window).curve(self.cascade.tau0, self.cascade.part_sums(window.mark))

    def _until_snapshot(self) -> int:
        """Return the samples until the next snapshot, at least one."""
        due = [self._due(window, window.octaves) for window in self._windows if window.octaves < LEVELS]
        return max(1, min(due, default=1 << 62) - self.position)

    def _due(self, window: Window, octave: int) -> int:
        """Return the position of the snapshot of an octave: the first end of a block after start + 2m."""
        segment = self.cascade.segment_start
        return segment - (-(window.start + (2 << octave) - segment) // BLOCK) * BLOCK

    def _take_due_snapshots(self) -> None:
        for window in self._windows:
            octaves = window.octaves
            while octaves < LEVELS and self.position >= self._due(window, octaves):
                octaves += 1
            if octaves > window.octaves:
                self._take_snapshot(window, octaves)

    def _take_snapshot(self, window: Window, octaves: int) -> None:
        """Take the missing snapshots of the first `octaves` octaves."""
        now = self.cascade.block_sums()
        rows = slice(window.octaves, max(window.octaves, min(octaves, len(now.squares))))
        window.squares[rows], window.terms[rows] = now.squares[rows], now.terms[rows]
        window.white_excess[rows] = now.white_excess[rows]
        window.octaves = max(window.octaves, octaves)

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays; the windows in the order in which they were opened."""
        out = {f"cascade.{name}": array for name, array in self.cascade.save().items()}
        numbers = (self.cascade.segment_start, self.position, len(self._windows))
        out["numbers"] = np.array(numbers, dtype=np.int64)
        k, marks = len(self.cascade.block_sums().squares), list(self.cascade.spectrum.marks)
        for number, window in enumerate(self._windows):
            part = f"mark{number}."  # these names are part of the saved format
            place = -1 if window.mark is None else marks.index(window.mark)
            out[f"{part}numbers"] = np.array(
                (window.start, window.segments, window.octaves, place), dtype=np.int64
            )
            out[f"{part}valid"] = window.valid
            out[f"{part}squares"] = window.squares[:k].copy()
            out[f"{part}terms"] = window.terms[:k].copy()
            out[f"{part}lacks"] = window.white_excess[:k].copy()
        return out

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> WindowedCascade:
        """Return a cascade in a saved state; it continues identically."""
        self = cls(OctaveCascade.restore(subset(saved, "cascade.")))
        for number in range(int(saved["numbers"][2])):
            part = f"mark{number}."
            start, segments, octaves, place = (int(v) for v in saved[f"{part}numbers"])
            mark = self.cascade.spectrum.marks[place]
            squares, terms, excess = (
                padded(saved[part + name], LEVELS) for name in ("squares", "terms", "lacks")
            )
            valid = saved[f"{part}valid"]
            self._windows.append(Window(start, valid, segments, squares, terms, excess, octaves, mark))
        return self


def _difference(window: Window, now: WindowSums) -> WindowSums:
    """Return the sums now less those before the window."""
    k = min(len(now.squares), window.octaves)
    return WindowSums(
        now.squares[:k] - window.squares[:k],
        now.terms[:k] - window.terms[:k],
        now.white_excess[:k] - window.white_excess[:k],
        now.valid - window.valid,
        now.span - window.start,
        max(1, now.segments - window.segments),
        (now.record, window.start),
    )
