"""Parts of a record: everything that is known between two of its places, without cost per sample.

The problem
-----------
A warm-up is recognised long after it has ended, an hour is compared with all hours before it, the scatter of N needs
the quarters of the record, and the history needs every hour alone. Each of these is a part of the record, from
one place to another or to now. The plain solution is a copy of all sums that is fed from the place on. With ten
channels, a copy costs 80 % of the time per sample that the record itself does, and up to nine would run at once.

The rule
--------
All sums are sums of terms: squared differences of an octave, squared transforms of a level of the spectrum. A term
belongs to the part in which its first sample lies. So the sums of a part are the sums at its end less those at its
begin, each taken at the moment when the last term that begins before the place has been added:

    octave of m samples    a difference reaches over 2 m samples        complete 2 m samples after the place
    level s                a segment reaches over 256 * 2^s samples     complete as many samples after it

A `Mark` is a place with these snapshots. Marks are few (candidates for the end of a warm-up, ends of quarters, begins
of hour and day), and the state of one is bounded: about 4 kB in a file for ten channels.

Two statistics are not differences:

* Moments have extremes, which cannot be subtracted. They are kept from each mark to the next, and joined.
* Block means are rows, of which a part has those that lie within it. The blocks of a record of months are longer than
  an hour; a part that must resolve more has finer blocks of its own, fed from its begin on.

Moments begin exactly at a place, the other sums at the last end of a block of 256 samples before it, where the cascade
has processed all samples. So any chunking gives the same sums.

>>> noise = np.random.default_rng(1).standard_normal((20 * BLOCK, 1))
>>> parts = Parts([0], [0], interval_s=0.01)
>>> parts.update(noise)
>>> middle = parts.mark(curve=True)
>>> parts.update(3.0 * noise)
>>> [round(float(parts.curve(place).sigma[0, 0]), 1) for place in (0, middle)]
[2.2, 3.0]
>>> [parts.moments(place).result().channels[0].count for place in (0, middle)]
[10240, 5120]
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import restorable
from imumon.noise.allan import AllanCurve, OctaveCascade
from imumon.noise.allan.curve import AllanSums
from imumon.noise.blocks import BlockAccumulator, BlockMeans
from imumon.noise.blocks.block_means import BLOCK
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.spectrum import PowerSpectrum
from imumon.noise.spectrum.spectrum_accumulator import LEVELS, SpectrumMark
from imumon.noise.statistics.moments import Moments

FINER_BLOCKS = 256
"""Most finer blocks of a part, a quarter of those of a record: for the memory; B loses 3 %."""
NEVER = 1 << 62
"""Samples, a place beyond any record."""


@restorable
class OctaveSnapshots:
    """Sums of the octaves over the differences that begin before a place, each taken when it is complete.

    Parameters
    ----------
    cascade : at the place.

    Attributes
    ----------
    sums : (`LEVELS`, c) rows of octaves that are not complete are zero.
    complete : number of octaves that are.
    """

    def __init__(self, cascade: OctaveCascade) -> None:
        now = cascade.block_sums()
        rows = (LEVELS, now.valid.size)
        terms, excess = np.zeros(rows, dtype=np.int64), np.zeros(rows, dtype=np.int64)
        sections = cascade.ended_sections  # the section of the place counts for what follows it
        self.sums = AllanSums(np.zeros(rows), terms, excess, now.valid, now.span, sections)
        self.complete = 0
        if now.span == cascade.section_start:
            self.take(cascade, LEVELS)  # no difference of this section begins before the place

    def next_due(self, cascade: OctaveCascade) -> int:
        """Return the place at which the next octave is complete; beyond any record if all are."""
        return NEVER if self.complete == LEVELS else self._end(cascade, self.complete)

    def take_due(self, cascade: OctaveCascade) -> None:
        """Keep the sums of the octaves that are complete now."""
        octaves = self.complete
        while octaves < LEVELS and cascade.span >= self._end(cascade, octaves):
            octaves += 1
        if octaves > self.complete:
            self.take(cascade, octaves)

    def take(self, cascade: OctaveCascade, octaves: int) -> None:
        """Keep the present sums of the first `octaves` octaves, where there are none yet."""
        now = cascade.block_sums()
        rows = slice(self.complete, max(self.complete, min(octaves, len(now.squares))))
        self.sums.squares[rows], self.sums.terms[rows] = now.squares[rows], now.terms[rows]
        self.sums.white_excess[rows] = now.white_excess[rows]
        self.complete = octaves

    def _end(self, cascade: OctaveCascade, octave: int) -> int:
        """Return the first end of a block from the place + 2m on.

        The differences between both begin after the place and count as before it, because octaves add whole blocks:
        at most one block of them.
        """
        section = cascade.section_start
        return section - (-(self.sums.span + (2 << octave) - section) // BLOCK) * BLOCK


@restorable
@dataclass(slots=True, eq=False)
class Mark:
    """A place in a record at which a part may begin or end.

    Attributes
    ----------
    levels : sums of the levels of the spectrum over the segments that begin before the mark.
    block_position : the place in the blocks of the record, which a gap of unknown length moves.
    moments : of the samples from the mark to the next one.
    octaves : sums of the octaves over the differences that begin before the mark; None: no curve begins here.
    finer : means of what follows the mark over finer blocks; None: the blocks of the record serve.
    """

    levels: SpectrumMark
    block_position: int
    moments: Moments
    octaves: OctaveSnapshots | None = None
    finer: BlockAccumulator | None = None


@restorable
class Parts:
    """Sums of a record and of its parts.

    A place is a number of samples of the grid. Place 0 is always marked.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1.
    columns : channels with a curve, or whose block means are needed; the others have moments only.
    interval_s : s, sampling interval.

    Attributes
    ----------
    cascade : of `columns`, over the whole record.
    """

    NOT_SAVED: ClassVar = {"_spectrum": lambda: None}

    def __init__(self, groups: Sequence[int], columns: Sequence[int], interval_s: float) -> None:
        self._groups, self._columns = list(groups), list(columns)
        group_of = [self._groups[column] for column in self._columns]
        self._used_groups = list(dict.fromkeys(group_of))
        renumbered = [self._used_groups.index(group) for group in group_of]
        self.cascade = OctaveCascade(len(renumbered), interval_s, groups=renumbered)
        self._marks: dict[int, Mark] = {}  # by place, rising
        self._next_snapshot = NEVER
        self._spectrum: PowerSpectrum | None = None  # of the record as it is; None: not computed yet
        self.mark()

    @property
    def position(self) -> int:
        """Samples of the grid so far."""
        return self.cascade.span

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples (n, c), channel unit, of which those with `valid` (n, g) count; None: all."""
        newest = next(reversed(self._marks.values()))
        newest.moments.update(values, valid)
        columns = values[:, self._columns]
        present = None if valid is None else valid[:, self._used_groups]
        begin = 0
        while begin < len(values):
            end = min(len(values), begin + self._until_snapshot())
            self.cascade.update(columns[begin:end], None if present is None else present[begin:end])
            self._take_snapshots()
            begin = end
        self._spectrum = None

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing."""
        while n > 0:
            length = min(n, self._until_snapshot())
            self.cascade.skip(length)
            self._take_snapshots()
            n -= length
        self._spectrum = None

    def break_(self) -> None:
        """Note a gap of unknown length: no later term begins before any mark."""
        self.cascade.break_()
        for octaves in self._octaves():
            octaves.take(self.cascade, LEVELS)
        self._next_snapshot, self._spectrum = NEVER, None

    # --- marks ----------------------------------------------------------------------------------------

    def mark(self, *, curve: bool = False, finer: bool = False) -> int:
        """Mark the present place, and return it.

        Parameters
        ----------
        curve : an Allan curve begins here.
        finer : finer blocks begin here.
        """
        place, cascade = self.position, self.cascade
        if place not in self._marks:
            levels, moments = cascade.spectrum.add_mark(), Moments(len(self._groups), groups=self._groups)
            self._marks[place] = Mark(levels, cascade.blocks.position, moments)
        mark = self._marks[place]
        if curve and mark.octaves is None:
            mark.octaves = OctaveSnapshots(cascade)
            self._next_snapshot = min(self._next_snapshot, mark.octaves.next_due(cascade))
        if finer and mark.finer is None:
            mark.finer = BlockAccumulator(cascade.groups.of.tolist(), cascade.tau0, FINER_BLOCKS)
            cascade.finer_blocks.append(mark.finer)
        return place

    def keep(self, places: Collection[int], *, finer: Collection[int] = ()) -> None:
        """Forget all marks but those at 0 and at some places, and the finer blocks but those from `finer` on.

        The samples after a mark that is forgotten belong to the one before it.
        """
        kept: dict[int, Mark] = {}
        for place, mark in self._marks.items():
            if place not in finer:
                mark.finer = None
            if place == 0 or place in places or place in finer:
                kept[place] = mark
            else:
                next(reversed(kept.values())).moments.merge(mark.moments)
                self.cascade.spectrum.drop_mark(mark.levels)
        self._marks = kept
        self.cascade.finer_blocks = [mark.finer for mark in kept.values() if mark.finer is not None]

    # --- results --------------------------------------------------------------------------------------

    def curve(self, begin: int = 0) -> AllanCurve:
        """Return the Allan curve since 0 or a place that is marked for it, with the sums of its noise.

        Those of the whole record are by bin. Those of a part are by sub-band, up to the last end of a block.
        """
        if begin == 0:
            return self.cascade.result()
        octaves = self._marks[begin].octaves
        assert octaves is not None
        sums = self.cascade.sums().since(octaves.sums, octaves.complete)
        return sums.curve(self.cascade.tau0, self.sums(begin))

    def sums(self, begin: int, end: int | None = None) -> NoiseSums:
        """Return the sums of the noise between two marked places, by sub-band; None: now."""
        first, last = self._marks[begin], None if end is None else self._marks[end]
        return self._noise_sums(first, last, self.blocks(begin, end))

    def blocks(self, begin: int, end: int | None = None) -> BlockMeans:
        """Return the means over blocks between two marked places; None: now."""
        first = self._marks[begin].block_position
        stop = self.cascade.blocks.position if end is None else self._marks[end].block_position
        return self.cascade.blocks.result().part(first, stop)

    def finer_sums(self, begin: int) -> NoiseSums:
        """Return the sums of the noise since a place that is marked for it, with its finer blocks."""
        first = self._marks[begin]
        assert first.finer is not None
        return self._noise_sums(first, None, first.finer.result())

    def _noise_sums(self, first: Mark, last: Mark | None, blocks: BlockMeans) -> NoiseSums:
        cascade = self.cascade
        levels = cascade.spectrum.sums_between(first.levels, None if last is None else last.levels)
        if self._spectrum is None:  # the lines are those of the record: in a part, weak ones do not show
            self._spectrum = cascade.spectrum.result()
        return NoiseSums(cascade.tau0, tuple(levels), True, blocks, cascade.groups.of, self._spectrum)

    def moments(self, begin: int = 0, end: int | None = None) -> Moments:
        """Return the moments of all channels between two marked places; None: now."""
        joined = Moments(len(self._groups), groups=self._groups)
        for place, mark in self._marks.items():
            if begin <= place and (end is None or place < end):
                joined.merge(mark.moments)
        return joined

    # --- snapshots of the octaves ---------------------------------------------------------------------

    def _octaves(self) -> Iterator[OctaveSnapshots]:
        """Iterate over the snapshots of all marks at which a curve begins."""
        return (mark.octaves for mark in self._marks.values() if mark.octaves is not None)

    def _until_snapshot(self) -> int:
        """Return the samples until the next snapshot, at least one."""
        return max(1, self._next_snapshot - self.position)

    def _take_snapshots(self) -> None:
        """Take the snapshots that are due."""
        if self.position < self._next_snapshot:
            return
        for octaves in self._octaves():
            octaves.take_due(self.cascade)
        self._next_snapshot = self._first_due()

    def _first_due(self) -> int:
        return min((octaves.next_due(self.cascade) for octaves in self._octaves()), default=NEVER)
