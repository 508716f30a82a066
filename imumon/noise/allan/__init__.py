"""Octave cascade: Allan variance of an endless stream, in memory that grows with the log of its length.

The statistic is Allan's, sigma^2(tau) = 1/2 <(ybar(t + tau) - ybar(t))^2> (IEEE Std 952; NIST SP 1065,
section 5.2), at octaves tau = m tau0, m = 1, 2, 4 ... Octaves up to m = R are fully overlapping; beyond, a
cluster begins at every m/R-th sample, which for R = 8 keeps 98 % of the equivalent degrees of freedom of
full overlap on white noise, and all of them on flicker and random walk.

Rules:

* Time is a grid. A missing sample is one that does not count; a sample that a caller excludes is the same.
  Validity belongs to the sensor's sample, so it is kept by group of channels.
* A lossy link costs precision, not averaging times: from 16 samples on a cluster counts when 45 % of
  it are valid, and the white noise that the others would have averaged away is taken off (`octave`).
* A gap of unknown length begins a new segment; no difference spans it.
* Samples wait until a block on the grid is full, so any chunking gives the same bits.
* The median of a segment's first block is taken off each sample (9.8 m/s^2 costs no digits), and no sum of
  samples runs since the start: 10^10 samples lose no precision.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.noise.allan.octave import BLOCK, Octave, variances
from imumon.noise.groups import Groups
from imumon.samples import Bools, Floats, Ints

BATCH = 32  # blocks worked on at once
RATIOS = (1, 2, 4, 8, 16)


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """Allan variance of some channels at octave-spaced averaging times.

    Attributes
    ----------
    tau0 : s, interval of the time grid.
    m : (k,) averaging factors 1, 2, 4 ... 2^(k-1); every octave for which some channel has a difference.
    avar : (k, c) (channel unit)^2, Allan variance; 0.0 where `terms` is 0.
    terms : (k, c) number of squared second differences of phase behind each value; 0 where none.
    stride : (k,) samples between successive differences, max(1, m // ratio).
    span : samples, length of the time grid, missing ones included, over all segments.
    valid : (c,) valid samples.
    segments : stretches of the grid with gaps of unknown length between them.
    ratio : sub-clusters per cluster, R.
    """

    tau0: float
    m: Ints
    avar: Floats
    terms: Ints
    stride: Ints
    span: int
    valid: Ints
    segments: int
    ratio: int

    def of(self, channels: Sequence[int]) -> AllanCurve:
        """The same of some channels alone."""
        chosen = list(channels)
        return replace(self, avar=self.avar[:, chosen], terms=self.terms[:, chosen], valid=self.valid[chosen])

    @property
    def tau(self) -> Floats:
        """(k,) s, averaging times."""
        return np.asarray(self.m * self.tau0, dtype=np.float64)

    @property
    def sigma(self) -> Floats:
        """(k, c) channel unit, Allan deviation; 0.0 where `terms` is 0."""
        return np.asarray(np.sqrt(self.avar), dtype=np.float64)


class OctaveCascade:
    """Allan variance of a stream, at every octave.

    Accumulate with `update`, `skip` and `break_`, ask with `result`.

    Parameters
    ----------
    channels : number of columns, c.
    tau0 : s, sampling interval.
    groups : (c,) index of the group (0 .. g-1) whose validity a channel shares; default: all in one.
    ratio : sub-clusters per cluster, R, a power of two.
    threshold : share of a cluster that must be valid for it to count; shorter ones than 16 must be full.

    Raises
    ------
    ValueError : `tau0` is not positive and finite, `ratio` not one of `RATIOS`, `threshold` not in (0, 1], or
        `channels` and `groups` not as `Groups` takes them.

    Examples
    --------
    NIST SP 1065, table 31: nine frequencies.

    >>> nine = np.array([892.0, 809, 823, 798, 671, 644, 883, 903, 677])
    >>> cascade = OctaveCascade(1, tau0=1.0)
    >>> cascade.update(nine[:, None])
    >>> cascade.result().sigma[:2, 0].round(5)
    array([91.22945, 85.95287])
    """

    def __init__(
        self,
        channels: int,
        tau0: float,
        *,
        groups: Sequence[int] | None = None,
        ratio: int = 8,
        threshold: float = 0.45,
    ) -> None:
        if not 0.0 < tau0 < math.inf:
            raise ValueError(f"the sampling interval must be positive, not {tau0} s")
        if ratio not in RATIOS or not 0.0 < threshold <= 1.0:
            raise ValueError(f"ratio must be one of {RATIOS} and threshold in (0, 1]: {ratio}, {threshold}")
        self._groups = Groups(channels, groups)
        self.tau0 = float(tau0)
        self.ratio = ratio
        self.threshold = float(threshold)
        self._octaves: list[Octave] = []
        self._valid = np.zeros(len(self._groups), dtype=np.int64)
        self._closed = 0  # samples of the grid in finished segments
        self._segments = 0  # finished segments
        self._position = 0  # samples of this segment that have been through the octaves
        self._offset = np.zeros(channels)  # subtracted from every sample of this segment
        self._settled = np.zeros(len(self._groups), dtype=bool)  # groups whose offset is chosen
        self._pending = np.zeros((channels, BLOCK))
        self._present = np.zeros((len(self._groups), BLOCK), dtype=bool)
        self._fill = 0
        self._scratch: list[Floats] = []

    @property
    def channels(self) -> int:
        """Number of columns."""
        return self._groups.channels

    @property
    def nbytes(self) -> int:
        """Bytes of state: sums, histories and one block; the working space, of fixed size, is not in it."""
        octaves = sum(
            o.squares.nbytes + o.terms.nbytes + o.lacks.nbytes + o.history.nbytes + o.counts.nbytes
            for o in self._octaves
        )
        own = (self._groups.of, self._valid, self._offset, self._settled, self._pending, self._present)
        return octaves + sum(array.nbytes for array in own)

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Take consecutive samples.

        Parameters
        ----------
        values : (n, c) channel unit.
        valid : (n, g) which of them count, by group; None: all. What is not finite never counts.
        """
        values, present = self._groups.check(values, valid)
        n, done = len(values), 0
        if self._fill:
            done = min(n, BLOCK - self._fill)
            self._wait(values[:done], None if present is None else present[:done])
        while self._fill == BLOCK or n - done >= BLOCK:
            # The offset comes from the first block alone, however many arrive at once.
            waiting = self._fill // BLOCK
            most = BATCH if self._settled.all() else 1
            stop = done + min((n - done) // BLOCK, most - waiting) * BLOCK
            self._take(values[done:stop].T, None if present is None else present[done:stop].T)
            done = stop
        if done < n:
            self._wait(values[done:], None if present is None else present[done:])

    def skip(self, n: int) -> None:
        """Move the time grid on by `n` missing samples, at a cost that grows with log n alone.

        Raises
        ------
        ValueError : `n` is negative.
        """
        if n < 0:
            raise ValueError(f"time runs forward: cannot skip {n} samples")
        if self._fill:
            head = min(n, BLOCK - self._fill)
            self._wait_missing(head)
            n -= head
        if n >= BLOCK:
            self._climb(n - n % BLOCK, 0, None)
        self._wait_missing(n % BLOCK)

    def break_(self) -> None:
        """A gap of unknown length: differences never span it, the sums are kept."""
        self._flush()
        self._segments += self._position > 0
        self._closed += self._position
        self._position = 0
        self._settled[:] = False
        for octave in self._octaves:
            octave.forget()

    def merge(self, other: OctaveCascade) -> None:
        """Append the record of another cascade, behind a gap of unknown length; `other` is left as it is.

        Raises
        ------
        ValueError : its interval, ratio, threshold or groups are others.
        """
        mine, its = self._setting(), other._setting()
        if mine[1:] != its[1:] or not math.isclose(mine[0], its[0], rel_tol=1e-6):
            raise ValueError("only cascades of the same interval, ratio, threshold and groups merge")
        self.break_()
        other = other.copy()
        while len(other._octaves) < len(self._octaves):
            other._octaves.append(self._octave(len(other._octaves)))
        for ours, theirs in zip(self._octaves, other._octaves, strict=False):
            theirs.squares += ours.squares
            theirs.terms += ours.terms
            theirs.lacks += ours.lacks
        self._octaves = other._octaves
        self._valid += other._valid
        self._closed += other._closed
        self._segments += other._segments
        self._position = other._position
        self._offset, self._settled = other._offset, other._settled
        self._pending, self._present, self._fill = other._pending, other._present, other._fill

    def result(self) -> AllanCurve:
        """The curve so far; the cascade is left as it is."""
        if self._fill:
            whole = self.copy()
            whole._scratch = self._scratch  # holds nothing from one call to the next
            whole._flush()
            return whole.result()
        seen = [bool(octave.terms.any()) for octave in self._octaves]
        k = len(seen) - seen[::-1].index(True) if any(seen) else 0
        m = np.left_shift(1, np.arange(k, dtype=np.int64))
        squares, terms, lacks, _, _ = self.sums()
        return AllanCurve(
            tau0=self.tau0,
            m=m,
            avar=variances(squares[:k], terms[:k], lacks[:k], m),
            terms=terms[:k],
            stride=np.maximum(1, m // self.ratio),
            span=self._closed + self._position,
            valid=self._valid[self._groups.of],
            segments=self._segments + (self._position > 0),
            ratio=self.ratio,
        )

    def settle(self) -> None:
        """Send what waits for a full block through the octaves: nothing further will come."""
        self._flush()

    def sums(self) -> tuple[Floats, Ints, Ints, Ints, int]:
        """Sums of what has been through the octaves: (k, c) squared differences, (k, c) their number, (k, c)
        what they lack, (c,) valid samples, and segments begun."""
        members = self._groups.of
        k = len(self._octaves)
        squares = np.array([o.squares for o in self._octaves]).reshape(k, self.channels)
        terms = np.array([o.terms[members] for o in self._octaves], dtype=np.int64).reshape(k, self.channels)
        lacks = np.array([o.lacks[members] for o in self._octaves], dtype=np.int64).reshape(k, self.channels)
        return squares, terms, lacks, self._valid[members], self._segments + (self._position > 0)

    def copy(self) -> OctaveCascade:
        """An independent cascade in the same state."""
        other = copy.copy(self)
        other._scratch = []  # of its own: it may be asked in another thread
        other._octaves = [octave.copy() for octave in self._octaves]
        for name in ("_valid", "_offset", "_settled", "_pending", "_present"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def save(self) -> dict[str, npt.NDArray[Any]]:
        """Everything the cascade knows, as small arrays; the histories of all octaves lie end to end."""
        octaves = self._octaves
        nothing, none = np.zeros((self.channels, 0)), np.zeros((len(self._valid), 0))
        numbers = (self._closed, self._segments, self._position)
        return {
            "setting": np.array([self.tau0, self.ratio, self.threshold]),
            "group": self._groups.of.astype(np.int64),
            "numbers": np.array(numbers, dtype=np.int64),
            "valid": self._valid.copy(),
            "squares": np.array([o.squares for o in octaves]),
            "terms": np.array([o.terms for o in octaves]),
            "lacks": np.array([o.lacks for o in octaves]),
            "history": np.concatenate([nothing, *(o.history for o in octaves)], axis=1),
            "counts": np.concatenate([none, *(o.counts for o in octaves)], axis=1),
            "offset": self._offset.copy(),
            "settled": self._settled.copy(),
            "pending": self._pending[:, : self._fill].copy(),
            "present": self._present[:, : self._fill].copy(),
        }

    @classmethod
    def restore(cls, state: Mapping[str, npt.NDArray[Any]]) -> OctaveCascade:
        """The cascade that was saved; it continues as if nothing had happened."""
        tau0, ratio, threshold = (float(x) for x in state["setting"])
        groups = [int(g) for g in state["group"]]
        self = cls(len(groups), tau0, groups=groups, ratio=int(ratio), threshold=threshold)
        self._closed, self._segments, self._position = (int(x) for x in state["numbers"])
        self._valid[:] = state["valid"]
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
        self._offset[:] = state["offset"]
        self._settled[:] = state["settled"]
        self._fill = state["pending"].shape[1]
        self._pending[:, : self._fill] = state["pending"]
        self._present[:, : self._fill] = state["present"]
        return self

    def _setting(self) -> tuple[float, int, float, tuple[int, ...]]:
        return self.tau0, self.ratio, self.threshold, tuple(self._groups.of.tolist())

    # --- blocks on the grid ---------------------------------------------------------------------------

    def _wait(self, values: Floats, present: Bools | None) -> None:
        """Hold samples back, at most until the block is full."""
        part = slice(self._fill, self._fill + len(values))
        self._pending[:, part] = values.T
        self._present[:, part] = True if present is None else present.T
        self._fill = part.stop

    def _wait_missing(self, n: int) -> None:
        """Hold missing samples back; a block that is full goes its way."""
        part = slice(self._fill, self._fill + n)
        self._pending[:, part] = 0.0
        self._present[:, part] = False
        self._fill = part.stop
        if self._fill == BLOCK:
            self._flush()

    def _flush(self) -> None:
        """Send what waits through the octaves; less than a block only where the segment ends."""
        if self._fill:
            self._take(self._pending[:, :0], None)

    def _take(self, values: Floats, present: Bools | None) -> None:
        """Send what waits, and samples (c, n), present (g, n), through the octaves."""
        fill, self._fill = self._fill, 0
        n = fill + values.shape[1]
        samples = self._frame(0, 1 + n)[:, 1:]
        waiting = self._present[:, :fill]
        if present is None and waiting.all():
            known = None
        else:
            known = np.ones((len(self._valid), n), dtype=bool)
            known[:, :fill] = waiting
            known[:, fill:] = True if present is None else present
        if not self._settled.all():
            self._settle(self._pending[:, :fill] if fill else values, known)
        if fill:
            np.subtract(self._pending[:, :fill], self._offset[:, None], out=samples[:, :fill])
        np.subtract(values, self._offset[:, None], out=samples[:, fill:])
        if known is None:
            self._valid += n
            self._climb(n, n, None)
        else:
            self._valid += known.sum(axis=1)
            np.copyto(samples, 0.0, where=~known[self._groups.of])
            self._climb(n, n, known.astype(np.float64))

    def _settle(self, values: Floats, present: Bools | None) -> None:
        """Choose the offset of groups that have their first valid samples in this block.

        The median: one wild sample does not spoil it, and near it the subtraction is exact.
        """
        for group in np.flatnonzero(~self._settled):
            mine = self._groups.members[group]
            seen = values[mine] if present is None else values[mine][:, present[group]]
            if seen.shape[1]:
                self._offset[mine] = np.median(seen, axis=1)
                self._settled[group] = True

    # --- octaves --------------------------------------------------------------------------------------

    def _climb(self, length: int, n: int, counts: Floats | None) -> None:
        """Carry a stretch of the grid through the octaves.

        Parameters
        ----------
        length : samples of the grid; all beyond the first `n` are missing.
        n : samples written to the first frame, missing ones as zero.
        counts : (g, n) 1 where valid, 0 where missing; None: all valid.
        """
        start = self._position  # entries of the octave before this stretch
        self._position += length
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
            lag = min(2 * octave.m, self.ratio)
            above = self._frame(index % 2, lag + n)
            np.add(x[:, ends], x[:, begins], out=above[:, lag:])
            x = above

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
        longer = np.zeros((len(self._valid), more))
        longer[:, :n] = octave.m if counts is None else counts
        return x, longer

    def _octave(self, index: int) -> Octave:
        return Octave(index, self._groups, self.ratio, self.threshold)

    def _frame(self, which: int, columns: int) -> Floats:
        """(c, columns) contiguous working space: 0, 1 for entries of even, odd octaves, 2 for differences."""
        c = self._groups.channels
        if not self._scratch:
            self._scratch = [np.empty(c * (max(RATIOS) + BATCH * BLOCK)) for _ in range(3)]
        return self._scratch[which][: c * columns].reshape(c, columns)
