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

This file knows samples, blocks and segments; how they are carried up the octaves is `ladder`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.noise.allan.curve import AllanCurve
from imumon.noise.allan.octave import BLOCK
from imumon.noise.allan.stages import BATCH, RATIOS, OctaveStages
from imumon.noise.validity_groups import ValidityGroups
from imumon.samples import Bools, Floats, Ints

__all__ = ["AllanCurve", "OctaveCascade"]


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
        `channels` and `groups` not as `ValidityGroups` takes them.

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
        self._groups = ValidityGroups(channels, groups)
        self.tau0 = float(tau0)
        self.ratio = ratio
        self.threshold = float(threshold)
        self._ladder = OctaveStages(self._groups, ratio, self.threshold)
        self._valid = np.zeros(len(self._groups), dtype=np.int64)
        self._closed = 0  # samples of the grid in finished segments
        self._segments = 0  # finished segments
        self._offset = np.zeros(channels)  # subtracted from every sample of this segment
        self._settled = np.zeros(len(self._groups), dtype=bool)  # groups whose offset is chosen
        self._pending = np.zeros((channels, BLOCK))
        self._present = np.zeros((len(self._groups), BLOCK), dtype=bool)
        self._fill = 0

    @property
    def channels(self) -> int:
        """Number of columns."""
        return self._groups.channels

    @property
    def nbytes(self) -> int:
        """Bytes of state: sums, histories and one block; the working space, of fixed size, is not in it."""
        own = (self._groups.of, self._valid, self._offset, self._settled, self._pending, self._present)
        return self._ladder.nbytes + sum(array.nbytes for array in own)

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
            self._ladder.climb(n - n % BLOCK, 0, None)
        self._wait_missing(n % BLOCK)

    def break_(self) -> None:
        """A gap of unknown length: differences never span it, the sums are kept."""
        self._flush()
        self._segments += self._ladder.position > 0
        self._closed += self._ladder.position
        self._settled[:] = False
        self._ladder.forget()

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
        other._ladder.add(self._ladder)
        self._ladder = other._ladder
        self._valid += other._valid
        self._closed += other._closed
        self._segments += other._segments
        self._offset, self._settled = other._offset, other._settled
        self._pending, self._present, self._fill = other._pending, other._present, other._fill

    def result(self) -> AllanCurve:
        """The curve so far; the cascade is left as it is."""
        if self._fill:
            whole = self.copy()
            whole._ladder.scratch = self._ladder.scratch
            whole._flush()
            return whole.result()
        squares, terms, lacks, valid, segments = self.sums()
        span = self._closed + self._ladder.position
        return AllanCurve.of_sums(
            self.tau0, self.ratio, squares, terms, lacks, span=span, valid=valid, segments=segments
        )

    def settle(self) -> None:
        """Send what waits for a full block through the octaves: nothing further will come."""
        self._flush()

    def sums(self) -> tuple[Floats, Ints, Ints, Ints, int]:
        """Sums of what has been through the octaves: (k, c) squared differences, (k, c) their number, (k, c)
        what they lack, (c,) valid samples, and segments begun."""
        segments = self._segments + (self._ladder.position > 0)
        return *self._ladder.sums(), self._valid[self._groups.of], segments

    def copy(self) -> OctaveCascade:
        """An independent cascade in the same state."""
        other = copy.copy(self)
        other._ladder = self._ladder.copy()
        for name in ("_valid", "_offset", "_settled", "_pending", "_present"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def save(self) -> dict[str, npt.NDArray[Any]]:
        """Everything the cascade knows, as small arrays."""
        numbers = (self._closed, self._segments, self._ladder.position)
        return {
            "setting": np.array([self.tau0, self.ratio, self.threshold]),
            "group": self._groups.of.astype(np.int64),
            "numbers": np.array(numbers, dtype=np.int64),
            "valid": self._valid.copy(),
            **self._ladder.save(),
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
        self._closed, self._segments, position = (int(x) for x in state["numbers"])
        self._valid[:] = state["valid"]
        self._ladder.load(state, position)
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
        samples = self._ladder.room(n)
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
            self._ladder.climb(n, n, None)
        else:
            self._valid += known.sum(axis=1)
            np.copyto(samples, 0.0, where=~known[self._groups.of])
            self._ladder.climb(n, n, known.astype(np.float64))

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
