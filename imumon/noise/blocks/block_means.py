"""Means of a stream over equal blocks, which merge in pairs: the slow statistics of a record.

Model
-----
The mean over a block of n samples keeps what changes slowly and averages out what changes fast: white noise of density
N^2 leaves a variance of N^2 / (n tau0), flicker and random walk nearly all of theirs. The fit takes the discrete cosine
transform of the means, in which white noise and random walk are uncorrelated and flicker nearly (`power_law`;
Greenhall 1991 for the covariances of averages). So block means are the spectrum below the lowest level that has
segments enough, and the series on which drift, temperature, settling and steps are regressed.

The record is kept as at most 1,024 sums over 2^j samples with their counts; when they are full, neighbours are joined.
So the memory is bounded, and any chunking gives the same sums.

>>> blocks = BlockAccumulator([0], interval_s=1.0, most=4)
>>> blocks.update(np.arange(6.0)[None], None, np.zeros(1))
>>> means = blocks.result()
>>> means.length, means.means[:, 0].tolist()
(2, [0.5, 2.5, 4.5])

Gaps
----
A missing sample has weight 0, and a block with fewer than `LEAST_SHARE` of its samples has no mean. A gap of unknown
length begins a new segment at a new block. Where two segments meet in one block after a merge, the block counts as
missing: it has no place in time.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.model.samples import Floats, Ints
from imumon.model.saved_state import restorable
from imumon.noise.validity_groups import LEAST_SHARE

BLOCKS = 1024
"""Most blocks. Half of them widen the limits of B by 2 %, twice as many narrow them by 3 %."""
BLOCK = 256
"""Samples whose sums lie on one grid, here and in the Allan cascade, so that any chunking gives the same bits."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockMeans:
    """Means over neighbouring blocks of a record, or of a part of it.

    Attributes
    ----------
    means : (n, c) channel unit, about an offset; NaN: too few samples.
    share : (n, c) share of valid samples, 0 to 1.
    segment : (n,) number of the segment; between two of them lies a gap of unknown length.
    length : samples of a block.
    interval_s : s, of a sample.
    offset : (c,) channel unit, what the means are about.
    """

    means: Floats
    share: Floats
    segment: Ints
    length: int
    interval_s: float
    offset: Floats

    @property
    def length_s(self) -> float:
        """s, length of a block."""
        return self.length * self.interval_s

    def joined(self) -> BlockMeans:
        """Return the means over pairs of blocks; a pair of two segments counts as missing."""
        n = len(self.segment) // 2 * 2
        shares, segment = self.share[:n].reshape(-1, 2, self.share.shape[1]), self.segment[:n].reshape(-1, 2)
        total = shares.sum(axis=1)
        sums = np.nansum(shares * self.means[:n].reshape(shares.shape), axis=1)
        known = (0.5 * total >= LEAST_SHARE) & (segment[:, 0] == segment[:, 1])[:, None]
        means = np.where(known, sums / np.where(known, total, 1.0), np.nan)
        share = np.where(known, 0.5 * total, 0.0)
        return replace(self, means=means, share=share, segment=segment[:, 0], length=2 * self.length)

    def part(self, begin: int, end: int) -> BlockMeans:
        """Return the blocks that lie between two samples of the record, counted from its beginning."""
        rows = slice(-(-begin // self.length), end // self.length)
        return replace(self, means=self.means[rows], share=self.share[rows], segment=self.segment[rows])

    def select(self, channels: Sequence[int]) -> BlockMeans:
        """Return the means of some of the channels."""
        columns = list(channels)
        means, share = self.means[:, columns], self.share[:, columns]
        return replace(self, means=means, share=share, offset=self.offset[columns])


@restorable
class BlockAccumulator:
    """Sums over blocks of a stream.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1; the channels of a group share their validity.
    interval_s : s between two samples.
    most : most blocks, a power of two.
    """

    def __init__(self, groups: Sequence[int], interval_s: float, most: int = BLOCKS) -> None:
        self._groups = np.array(groups, dtype=np.int64)
        g = int(self._groups.max()) + 1 if len(groups) else 0
        self.interval_s, self._most = interval_s, most
        self._length = 1
        self._n = 0  # samples of the grid, including those between the end of a segment and the next block
        self._sums = np.zeros((len(groups), most))
        self._counts = np.zeros((g, most))
        self._offset = np.full(len(groups), np.nan)  # of the record: segments may have others
        self._segment = np.zeros(most, dtype=np.int64)
        self._segments = 0

    @property
    def position(self) -> int:
        """Samples of the grid so far."""
        return self._n

    def update(self, x: Floats, valid: Floats | None, offset: Floats) -> None:
        """Add consecutive samples.

        Parameters
        ----------
        x : (c, n) channel unit about `offset`, 0.0 where missing.
        valid : (g, n) 1.0 where valid, 0.0 where missing; None: all.
        offset : (c,) channel unit.
        """
        n, done = x.shape[1], 0
        if n:
            seen = np.ones(len(self._counts), dtype=bool) if valid is None else np.asarray(valid.any(axis=1))
            self._offset = np.where(np.isnan(self._offset) & seen[self._groups], offset, self._offset)
        while done < n:
            room = self._room()
            part = slice(done, min(n, done + room))
            self._add(x[:, part], None if valid is None else valid[:, part], offset, done)
            done = part.stop

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing."""
        while n > 0:
            part = min(n, self._room())
            first, self._n = self._n // self._length, self._n + part
            self._segment[first : (self._n - 1) // self._length + 1] = self._segments
            n -= part

    def break_(self) -> None:
        """Begin a new segment at the next block."""
        if self._n:
            self._segments += 1
            self._n = -(-self._n // self._length) * self._length

    def append(self, other: BlockAccumulator) -> None:
        """Append the blocks of another accumulator after a gap of unknown length; `other` is not changed."""
        self.break_()
        other = copy.deepcopy(other)
        while self._length < other._length:  # both lengths are powers of two
            self._join()
        while other._length < self._length:
            other._join()
        self._n = -(-self._n // self._length) * self._length
        while self._n // self._length + -(-other._n // other._length) > self._most:
            self._join()
            other._join()
            self._n = -(-self._n // self._length) * self._length
        begin, count = self._n // self._length, -(-other._n // other._length)
        here = slice(begin, begin + count)
        self._offset = np.where(np.isnan(self._offset), other._offset, self._offset)
        shift = np.nan_to_num(other._offset - self._offset)
        self._counts[:, here] = other._counts[:, :count]
        self._sums[:, here] = other._sums[:, :count] + shift[:, None] * self._counts[self._groups][:, here]
        self._segment[here] = np.where(
            other._segment[:count] < 0, -1, other._segment[:count] + self._segments
        )
        self._segments += other._segments
        self._n += other._n

    def result(self) -> BlockMeans:
        """Return the means so far.

        A block in progress, and one in which a segment ends, do not count: a line averages out over whole blocks only.
        """
        n = self._n // self._length
        counts, segment = self._counts[self._groups, :n].T, self._segment[:n].copy()
        share = counts / self._length
        known = (share >= LEAST_SHARE) & (segment >= 0)[:, None]
        if self._length > 1:
            # a segment ends within the block before the next one begins
            known[:-1][(segment[:-1] != segment[1:]) & (segment[1:] >= 0)] = False
        means = np.where(known, self._sums[:, :n].T / np.maximum(counts, 1.0), np.nan)
        share = np.where(known, share, 0.0)
        return BlockMeans(means, share, segment, self._length, self.interval_s, np.nan_to_num(self._offset))

    def _add(self, x: Floats, valid: Floats | None, offset: Floats, done: int) -> None:
        """Add samples for which there is room, `done` of the update already.

        Sums are of at most `BLOCK` samples from the beginning of the update on, added one after the other.
        """
        n = x.shape[1]
        # one sum over all would depend on how many samples arrive together, in its last bits
        pieces = np.arange(-done % BLOCK, n, BLOCK)
        edges = np.unique(np.concatenate(([0], pieces, np.arange(-self._n % self._length, n, self._length))))
        sums, blocks = np.add.reduceat(x, edges, axis=1), (self._n + edges) // self._length
        if valid is None:
            counts = np.diff(edges, append=n)[None].repeat(len(self._counts), axis=0)
        else:
            counts = np.add.reduceat(valid, edges, axis=1)
        if (offset != self._offset).any():  # of a later segment; all means are about one offset
            sums += np.nan_to_num(offset - self._offset)[:, None] * counts[self._groups]
        # the total of each block so far, then its pieces in their order, which `accumulate` adds one after the other
        first, end = int(blocks[0]), int(blocks[-1]) + 1
        order = 1 + np.arange(len(blocks)) - np.searchsorted(blocks, blocks)
        for total, added in ((self._sums, sums), (self._counts, counts)):
            in_order = np.zeros((len(total), end - first, int(order.max()) + 1))
            in_order[:, :, 0] = total[:, first:end]
            in_order[:, blocks - first, order] = added
            total[:, first:end] = np.add.accumulate(in_order, axis=2)[:, :, -1]
        self._segment[first:end] = self._segments
        self._n += n

    def _room(self) -> int:
        """Return how many samples fit, at least one; blocks join only when they are full."""
        if self._n == self._most * self._length:
            self._join()
        return self._most * self._length - self._n

    def _join(self) -> None:
        """Join neighbouring blocks."""
        half = self._most // 2
        # -1: two segments in one block; an empty second half has none of its own
        first, second = self._segment[::2], self._segment[1::2]
        empty = ~(self._counts[:, 1::2].any(axis=0))
        segment = np.where((first == second) | empty, first, -1)
        for array in (self._sums, self._counts):
            array[:, :half] = array[:, ::2] + array[:, 1::2]
            array[:, :half][:, segment < 0] = 0.0
            array[:, half:] = 0.0
        self._segment[:half] = segment
        self._segment[half:] = 0
        self._length *= 2
