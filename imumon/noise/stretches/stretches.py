"""Stretches of a record: the sums of every 10 minutes, hour and day alone, for the history.

A record of months hides what happens in it: its N is the mean over all of its time. The history therefore keeps
the noise of each stretch alone. N shows in 10 minutes, B needs an hour, K a day; so there are stretches of three
lengths, and none is computed from another one. They begin at multiples of their length on the grid of the record.
A stretch without samples, as in a long gap, is left out.

Spectra are differences of the sums of the one cascade between two marks, which cost nothing per sample. Blocks of a
record of months are longer than a stretch, so each stretch in progress has blocks of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from imumon.noise.allan.windows import WindowedCascade
from imumon.noise.array_state import subset
from imumon.noise.blocks import BlockAccumulator
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.spectrum.spectrum_accumulator import SpectrumMark
from imumon.noise.statistics.moments import Moments

STEPS_S = (600, 3600, 86400)
"""s, lengths of the stretches; each is a multiple of the one before."""
BLOCKS = 256
"""Most blocks of a stretch, for the memory: B loses 3 %."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """One stretch, finished or in progress.

    Attributes
    ----------
    step_s : s, its full length, one of `STEPS_S`.
    start, end : samples of the grid before it, and before what follows it.
    sums : of the noise of its channels with a curve.
    moments : moments of all channels.
    """

    step_s: int
    start: int
    end: int
    sums: NoiseSums
    moments: Moments


@dataclass(slots=True, eq=False)
class _InProgress:
    start: int
    mark: SpectrumMark
    blocks: BlockAccumulator


class Stretches:
    """The stretches in progress of one record.

    Parameters
    ----------
    cascade : of the record.
    rate_hz : Hz, sampling rate.
    moments : returns the moments between two positions of which stretches began, samples of the grid.
    """

    def __init__(
        self, cascade: WindowedCascade, rate_hz: float, moments: Callable[[int, int], Moments]
    ) -> None:
        self._cascade, self._moments = cascade, moments
        shortest = max(1, round(STEPS_S[0] * rate_hz))
        self._lengths = [shortest * (step // STEPS_S[0]) for step in STEPS_S]
        self._current = [self._begin() for _ in STEPS_S]

    @property
    def next_end(self) -> int:
        """Samples of the grid at which the shortest stretch in progress ends."""
        return (self._current[0].start // self._lengths[0] + 1) * self._lengths[0]

    @property
    def starts(self) -> tuple[int, ...]:
        """Samples of the grid before each stretch in progress."""
        return tuple(each.start for each in self._current)

    def mark(self, step_s: int) -> SpectrumMark:
        """Return the mark at the beginning of the stretch in progress of a length of `STEPS_S`."""
        return self._current[STEPS_S.index(step_s)].mark

    def close_due(self) -> list[Stretch]:
        """End the stretches whose end the record has reached, and return them, shorter ones first."""
        at, finished = self._cascade.position, []
        for number, length in enumerate(self._lengths):
            current = self._current[number]
            if at // length == current.start // length:
                continue
            stretch = self.in_progress(number)
            if stretch is not None:
                finished.append(stretch)
            self._cascade.cascade.drop_part(current.mark, current.blocks)
            self._current[number] = self._begin()
        return finished

    def in_progress(self, number: int) -> Stretch | None:
        """Return the stretch in progress of ``STEPS_S[number]``; None without a sample in it."""
        current, end = self._current[number], self._cascade.position
        moments = self._moments(current.start, end)
        if not any(channel.count for channel in moments.result().channels):
            return None
        sums = self._cascade.cascade.part_sums(current.mark, blocks=current.blocks.result())
        return Stretch(STEPS_S[number], current.start, end, sums, moments)

    def _begin(self) -> _InProgress:
        """Begin a stretch at the present place."""
        mark, blocks = self._cascade.cascade.add_part(BLOCKS)
        return _InProgress(self._cascade.position, mark, blocks)

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        marks = list(self._cascade.cascade.spectrum.marks)
        numbers = [[each.start, marks.index(each.mark)] for each in self._current]
        out = {"numbers": np.array(numbers, dtype=np.int64)}
        for number, each in enumerate(self._current):
            out |= {f"{number}.{name}": value for name, value in each.blocks.save().items()}
        return out

    def restore(self, cascade: WindowedCascade, saved: Mapping[str, np.ndarray]) -> None:
        """Continue from a saved state; the cascade is restored already."""
        self._cascade = cascade
        for number, (start, mark) in enumerate(saved["numbers"].tolist()):
            blocks = BlockAccumulator.restore(subset(saved, f"{number}."))
            cascade.cascade.parts.append(blocks)
            self._current[number] = _InProgress(start, cascade.cascade.spectrum.marks[mark], blocks)
