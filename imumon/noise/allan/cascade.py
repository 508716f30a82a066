"""Octave cascade: Allan variance of an endless stream, in memory that grows with the log of its length.

The statistic is Allan's,

    sigma^2(tau) = 1/2 <(ybar(t + tau) - ybar(t))^2>

with ybar(t) the average over tau before t (IEEE Std 952; NIST SP 1065, section 5.2), at octaves tau = m tau0,
m = 1, 2, 4 ... Octaves up to m = R overlap fully; beyond, a cluster begins at every m/R-th sample, which for R = 8
keeps 98 % of the equivalent degrees of freedom of full overlap on white noise, and all of them on flicker and random
walk.

Rules:

* Time is a grid. A missing sample does not count, nor does one that a caller excludes. Validity belongs to the sample
  of a sensor, so it is stored by group of channels.
* A lossy link costs precision, not averaging times: from 16 samples on a cluster counts if 45 % of it are valid, and
  the excess of white noise is subtracted (`octave`).
* A gap of unknown length begins a new section; no difference spans it.
* Samples are buffered until a block on the grid is full, so any chunking gives the same bits.
* The median of a section's first block is subtracted from each sample (9.8 m/s^2 costs no digits), and no sum of
  samples runs since the start: 10^10 samples lose no precision.

This module handles samples, blocks and sections; `octave` passes them through the octaves. The same blocks feed the
Welch sums and the block means, so that curve and fit belong to the same samples.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Hashable, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import restorable
from imumon.noise.allan.curve import AllanCurve, AllanSums
from imumon.noise.allan.octave import BATCH, OctaveStages
from imumon.noise.blocks import BlockAccumulator
from imumon.noise.blocks.block_means import BLOCK
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.spectrum import SpectrumAccumulator
from imumon.noise.validity_groups import ValidityGroups


@restorable
class OctaveCascade:
    """Allan variance of a stream at every octave.

    Accumulate with `update`, `skip` and `break_`; `result` returns the curve.

    Parameters
    ----------
    channels : number of columns, c.
    tau0 : s, sampling interval.
    groups : (c,) index of the group (0 .. g-1) whose validity a channel shares; default: all in one.

    Attributes
    ----------
    groups : channels that share their validity.
    record : identity of the record; a copy has another one.
    spectrum, blocks : Welch sums and block means of the same samples.
    finer_blocks : block means of parts of the record, fed from now on like `blocks`; the caller adds and removes them.
    section_start : samples of the grid in finished sections.
    ended_sections : their number.

    Raises
    ------
    ValueError : `tau0` is not positive and finite, or `ValidityGroups` refuses `channels` and `groups`.

    Examples
    --------
    NIST SP 1065, table 31: nine frequencies.

    >>> nine = np.array([892.0, 809, 823, 798, 671, 644, 883, 903, 677])
    >>> cascade = OctaveCascade(1, tau0=1.0)
    >>> cascade.update(nine[:, None])
    >>> cascade.result().sigma[:2, 0].round(5)
    array([91.22945, 85.95287])
    """

    NOT_SAVED: ClassVar = {"record": object}

    def __init__(self, channels: int, tau0: float, *, groups: Sequence[int] | None = None) -> None:
        if not 0.0 < tau0 < math.inf:
            raise ValueError(f"the sampling interval must be positive, not {tau0} s")
        self.groups = ValidityGroups(channels, groups)
        self.tau0 = float(tau0)
        self.record: Hashable = object()
        self._stages = OctaveStages(self.groups)
        group_of = self.groups.of.tolist()
        self.spectrum = SpectrumAccumulator(group_of, 1.0 / self.tau0)
        self.blocks = BlockAccumulator(group_of, self.tau0)
        self.finer_blocks: list[BlockAccumulator] = []
        self._valid = np.zeros(len(self.groups), dtype=np.int64)
        self.section_start = 0
        self.ended_sections = 0
        self._offset = np.zeros(channels)  # subtracted from every sample of this section
        self._has_offset = np.zeros(len(self.groups), dtype=bool)
        self._pending = np.zeros((channels, BLOCK))
        self._pending_valid = np.zeros((len(self.groups), BLOCK), dtype=bool)
        self._fill = 0

    @property
    def channels(self) -> int:
        """Number of columns."""
        return self.groups.channels

    @property
    def span(self) -> int:
        """Samples of the grid so far, over all sections."""
        return self.section_start + self._stages.position + self._fill

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add consecutive samples.

        Parameters
        ----------
        values : (n, c) channel unit, or (n,) of one channel.
        valid : (n, g) whether each sample counts, by group; None: all. Non-finite and masked samples never count.
        """
        values, present = self.groups.check(values, valid)
        n, done = len(values), 0
        if self._fill:
            done = min(n, BLOCK - self._fill)
            self._buffer(values[:done], None if present is None else present[:done])
        while self._fill == BLOCK or n - done >= BLOCK:
            # The offset is that of the first block, also where many blocks arrive at once.
            pending = self._fill // BLOCK
            most = BATCH if self._has_offset.all() else 1
            stop = done + min((n - done) // BLOCK, most - pending) * BLOCK
            self._process(values[done:stop].T, None if present is None else present[done:stop].T)
            done = stop
        if done < n:
            self._buffer(values[done:], None if present is None else present[done:])

    def skip(self, n: int) -> None:
        """Advance the grid by `n` missing samples, at a cost that grows with log n.

        Raises
        ------
        ValueError : `n` is negative.
        """
        if n < 0:
            raise ValueError(f"the number of samples to skip must not be negative, not {n}")
        if self._fill:
            head = min(n, BLOCK - self._fill)
            self._buffer_missing(head)
            n -= head
        if n >= BLOCK:
            self._stages.update(n - n % BLOCK, 0, None)
            self.spectrum.skip(n - n % BLOCK)
            for blocks in (self.blocks, *self.finer_blocks):
                blocks.skip(n - n % BLOCK)
        self._buffer_missing(n % BLOCK)

    def break_(self) -> None:
        """Begin a new section after a gap of unknown length: keep the sums, but let no difference span it."""
        self._flush()
        self.ended_sections += self._stages.position > 0  # two breaks in a row end one section
        self.section_start += self._stages.position
        self._has_offset[:] = False  # the sensor may have been turned meanwhile
        self._stages.start_section()
        self.spectrum.break_()
        for blocks in (self.blocks, *self.finer_blocks):
            blocks.break_()

    def merge(self, other: OctaveCascade) -> None:
        """Append the record of another cascade after a gap of unknown length; `other` is not changed.

        Raises
        ------
        ValueError : its interval or groups differ.
        """
        if self.groups != other.groups or not math.isclose(self.tau0, other.tau0, rel_tol=1e-6):
            raise ValueError("only cascades of the same interval and groups merge")
        self.break_()
        other = other.copy()
        # the delay lines are those of the later record, whose section continues
        other._stages.add_sums(self._stages)
        other.spectrum.add_sums(self.spectrum)
        self.blocks.append(other.blocks)
        self._stages, self.spectrum = other._stages, other.spectrum
        self._valid += other._valid
        self.section_start += other.section_start
        self.ended_sections += other.ended_sections
        self._offset, self._has_offset = other._offset, other._has_offset
        self._pending, self._pending_valid, self._fill = other._pending, other._pending_valid, other._fill

    def result(self) -> AllanCurve:
        """Return the curve so far, with the sums of its noise; the cascade does not change."""
        whole = self if not self._fill else self._flushed()
        # the copy has another identity, but its values are those of this record
        return replace(whole.block_sums(), record=self.record).curve(self.tau0, whole.noise_sums())

    def sums(self) -> AllanSums:
        """Return the sums of the octaves so far; the cascade does not change."""
        if not self._fill:
            return self.block_sums()
        return replace(self._flushed().block_sums(), record=self.record)

    def block_sums(self) -> AllanSums:
        """Return the sums of the octaves over the blocks processed so far, without the buffered samples."""
        valid, sections = self._valid[self.groups.of], self.ended_sections + (self._stages.position > 0)
        return AllanSums(*self._stages.sums(), valid, self.span - self._fill, sections, self.record)

    def noise_sums(self) -> NoiseSums:
        """Return what the likelihood of the noise is made of, of the blocks processed so far."""
        levels, blocks = tuple(self.spectrum.sums()), self.blocks.result()
        return NoiseSums(self.tau0, levels, False, blocks, self.groups.of, self.spectrum.result())

    def copy(self) -> OctaveCascade:
        """Return an independent cascade in the same state; from now on it is another record."""
        # what is known of the parts of this record stays with it
        beside: dict[int, Any] = {id(parts): [] for parts in (self.finer_blocks, self.spectrum.marks)}
        return copy.deepcopy(self, beside)  # its identity is another object, too

    # --- blocks on the grid ---------------------------------------------------------------------------

    def _flushed(self) -> OctaveCascade:
        """Return a copy that has processed the buffered samples."""
        whole = self.copy()
        whole._flush()
        return whole

    def _buffer(self, values: Floats, present: Bools | None) -> None:
        """Append samples to the buffer, at most until the block is full."""
        columns = slice(self._fill, self._fill + len(values))
        self._pending[:, columns] = values.T
        self._pending_valid[:, columns] = True if present is None else present.T
        self._fill = columns.stop

    def _buffer_missing(self, n: int) -> None:
        """Append missing samples to the buffer, and process it when the block is full."""
        columns = slice(self._fill, self._fill + n)
        self._pending[:, columns] = 0.0
        self._pending_valid[:, columns] = False
        self._fill = columns.stop
        if self._fill == BLOCK:
            self._flush()

    def _flush(self) -> None:
        """Process the buffered samples; if their block is not full, the section ends here."""
        if self._fill:
            self._process(self._pending[:, :0], None)

    def _process(self, values: Floats, present: Bools | None) -> None:
        """Pass the buffer, and samples (c, n) with their validity (g, n), through the octaves."""
        fill, self._fill = self._fill, 0
        n = fill + values.shape[1]
        samples = self._stages.input_buffer(n)
        pending = self._pending_valid[:, :fill]
        if present is None and pending.all():
            known = None
        else:
            known = np.ones((len(self._valid), n), dtype=bool)
            known[:, :fill] = pending
            known[:, fill:] = True if present is None else present
        if not self._has_offset.all():
            self._choose_offset(self._pending[:, :fill] if fill else values, known)
        if fill:
            np.subtract(self._pending[:, :fill], self._offset[:, None], out=samples[:, :fill])
        np.subtract(values, self._offset[:, None], out=samples[:, fill:])
        if known is None:
            self._valid += n
            weights = None
        else:
            self._valid += known.sum(axis=1)
            # after the subtraction: a missing sample is the offset, whatever number is in its place
            np.copyto(samples, 0.0, where=~known[self.groups.of])
            weights = known.astype(np.float64)
        self.spectrum.update(samples, weights)
        for blocks in (self.blocks, *self.finer_blocks):
            blocks.update(samples, weights, self._offset)
        self._stages.update(n, n, weights)  # last: the octaves overwrite the samples

    def _choose_offset(self, values: Floats, present: Bools | None) -> None:
        """Set the offset of groups that have their first valid samples in this block.

        The median: an outlier does not move it, and near it the subtraction is exact.
        """
        for group in np.flatnonzero(~self._has_offset):
            members = self.groups.members[group]
            first = values[members] if present is None else values[members][:, present[group]]
            if first.shape[1]:
                self._offset[members] = np.median(first, axis=1)
                self._has_offset[group] = True
