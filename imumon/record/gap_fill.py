"""Gap filling: from steps of the sample clock to dense blocks, long gaps and breaks.

The accumulators need equal steps. A few missing samples become rows that are marked as missing, so that a
lossy stream is still processed in whole blocks. A long gap of known length is one `LongGap`, however long. A
gap of unknown length is a `Break`. Samples that are no numbers are missing, too.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from imumon.grid.sample_clock import BREAK, PlacedSamples
from imumon.model.samples import INERTIAL, Bools, Floats, Ints, SampleBlock, Stream, selected
from imumon.noise.validity_groups import LARGEST

LONG_GAP = 256
"""Ticks, longest step that is filled row by row: a longer gap would cost more than two calls do."""

MOST_ROWS = 1 << 15
"""Ticks after which a dense block ends: a block of samples with a gap before each would be `LONG_GAP` times as long.
Blocks of a recording have half of it; cut, they would leave short ones, which cost as much as long ones.
"""


class InvalidSamples:
    """Takes the samples whose gyroscope or accelerometer is no number out of a stream: they are lost.

    Attributes
    ----------
    any : whether there was one.
    """

    def __init__(self) -> None:
        self.any = False
        self._lost = 0  # since the last sample that was kept
        self._stream: Stream | None = None  # of the last block
        self._inertial: list[int] = []  # columns of it that must be numbers

    def remove(self, block: SampleBlock) -> SampleBlock:
        """Return the block without them; the next sample counts them as lost before it."""
        if block.stream is not self._stream:
            self._stream = block.stream
            self._inertial = [k for k, sensor in enumerate(block.stream.sensors) if sensor in INERTIAL]
        with np.errstate(over="ignore", invalid="ignore"):
            all_valid = bool(abs(block.values.sum()) < LARGEST)  # one fast pass, which NaN and inf fail, too
            if all_valid and not self._lost:
                return block
            keep = np.asarray((np.abs(block.values[:, self._inertial]) < LARGEST).all(axis=1))
        if keep.all() and not self._lost:
            return block  # only a magnetometer or a thermometer has none
        self.any = self.any or not keep.all()
        # A sample that is taken out is lost, and so is what was lost before it: the next one that stays has the sum.
        before = self._lost + np.cumsum(block.lost + ~keep)  # lost up to each sample, itself included
        lost = np.diff(before[keep], prepend=0)
        self._lost = int(before[-1] - lost.sum()) if len(block) else self._lost
        return replace(selected(block, keep), lost=lost)


@dataclass(frozen=True, slots=True)
class DenseBlock:
    """Consecutive ticks of the grid.

    Attributes
    ----------
    values : (n, c) channel unit; 0 where the sample is missing.
    present : (n,) ticks with a sample; None: all.
    saturated : (n, s) or (n,) samples beyond a range, see `SampleBlock`; None: unknown.
    """

    values: Floats
    present: Bools | None
    saturated: Bools | None

    def valid(self, groups: int) -> Bools | None:
        """Return (n, groups) ticks with a sample; None: all."""
        return None if self.present is None else np.repeat(self.present[:, None], groups, axis=1)


@dataclass(frozen=True, slots=True)
class LongGap:
    """`ticks` consecutive ticks without a sample."""

    ticks: int


@dataclass(frozen=True, slots=True)
class Break:
    """A gap of unknown length."""


Part: TypeAlias = DenseBlock | LongGap | Break


def fill_gaps(placed: PlacedSamples) -> list[Part]:
    """Return the grid of placed samples in order."""
    steps = placed.steps
    if (steps == 1).all() and len(steps) <= MOST_ROWS:
        return [DenseBlock(placed.values, None, placed.saturated)]
    return list(_parts(placed, steps))


def _parts(placed: PlacedSamples, steps: Ints) -> Iterator[Part]:
    """Yield dense blocks, long gaps and breaks."""
    cuts = set(np.flatnonzero((steps == BREAK) | (steps > LONG_GAP)).tolist())
    # in ticks, with long gaps as one: where a dense block is full, another one begins
    full = np.diff((np.cumsum(np.clip(steps, 1, LONG_GAP)) - 1) // MOST_ROWS, prepend=0) > 0
    edges = sorted(
        {0, len(steps), *cuts, *np.flatnonzero(full).tolist()}
    )  # a set: the first may be a cut, too
    for start, end in itertools.pairwise(edges):
        if start in cuts:
            yield Break() if steps[start] == BREAK else LongGap(int(steps[start]) - 1)
        yield _dense(placed, start, end, missing=0 if start in cuts else int(steps[start]) - 1)


def _dense(placed: PlacedSamples, start: int, end: int, missing: int) -> DenseBlock:
    """Return rows `start` to `end` with their short gaps filled, after `missing` missing ticks."""
    steps = placed.steps[start:end].copy()
    steps[0] = missing + 1
    saturated = None if placed.saturated is None else placed.saturated[start:end]
    if (steps == 1).all():
        return DenseBlock(placed.values[start:end], None, saturated)
    rows = np.cumsum(steps) - 1
    values = np.zeros((placed.values.shape[1], int(rows[-1]) + 1)).T  # column-major: channels are contiguous
    values[rows] = placed.values[start:end]
    present = np.zeros(len(values), dtype=bool)
    present[rows] = True
    if saturated is not None:
        flags = np.zeros((len(values), *saturated.shape[1:]), dtype=bool)
        flags[rows] = saturated
        saturated = flags
    return DenseBlock(values, present, saturated)
