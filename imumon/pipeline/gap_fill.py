"""Samples on the grid: from steps to dense blocks with a mask, holes and breaks.

The accumulators want equal steps. A few missing samples become rows that are marked invalid, so that a lossy
line is still worked through in whole blocks; a long hole is one `Hole`, however long; a gap of unknown
length is a `Break`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from imumon.samples import Bools, Floats
from imumon.timebase.sample_clock import BREAK, PlacedSamples

LONG = 256
"""Missing samples from which a gap is not filled row by row."""


@dataclass(frozen=True, slots=True)
class Run:
    """Consecutive ticks.

    Attributes
    ----------
    values : (n, c) channel unit; 0 where nothing came.
    present : (n,) whether a sample came, or None where all did.
    saturated : (n,) or None.
    """

    values: Floats
    present: Bools | None
    saturated: Bools | None


@dataclass(frozen=True, slots=True)
class Hole:
    """So many ticks without a sample."""

    ticks: int


@dataclass(frozen=True, slots=True)
class Break:
    """A gap of unknown length."""


Stretch: TypeAlias = Run | Hole | Break


def stretches(placed: PlacedSamples) -> Iterator[Stretch]:
    """The grid of some placed samples, in order."""
    steps = placed.steps
    if not len(steps):
        return
    if (steps == 1).all():
        yield Run(placed.values, None, placed.saturated)
        return
    cuts = set(np.flatnonzero((steps == BREAK) | (steps > LONG)).tolist())
    edges = sorted({0, len(steps), *cuts})
    for start, end in itertools.pairwise(edges):
        if start in cuts:
            yield Break() if steps[start] == BREAK else Hole(int(steps[start]) - 1)
        yield _dense(placed, start, end, first=0 if start in cuts else int(steps[start]) - 1)


def _dense(placed: PlacedSamples, start: int, end: int, first: int) -> Run:
    """Rows `start` to `end` with their short gaps filled; `first` ticks are missing before them."""
    steps = placed.steps[start:end].copy()
    steps[0] = first + 1
    saturated = placed.saturated
    if (steps == 1).all():
        return Run(placed.values[start:end], None, None if saturated is None else saturated[start:end])
    rows = np.cumsum(steps) - 1
    values = np.zeros((placed.values.shape[1], int(rows[-1]) + 1)).T  # one channel behind the other
    values[rows] = placed.values[start:end]
    present = np.zeros(len(values), dtype=bool)
    present[rows] = True
    flags = None
    if saturated is not None:
        flags = np.zeros(len(values), dtype=bool)
        flags[rows] = saturated[start:end]
    return Run(values, present, flags)
