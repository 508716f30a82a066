"""Allan variance of some channels at octave-spaced averaging times."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.noise.allan.octave import variances
from imumon.samples import Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """Allan variance of some channels at octave-spaced averaging times.

    Attributes
    ----------
    tau0 : s, interval of the time grid.
    m : (k,) averaging factors 1, 2, 4 ... 2^(k-1); every octave for which some channel has a difference.
    avar : (k, c) (channel unit)^2, Allan variance; 0.0 where `terms` is 0.
    terms : (k, c) number of squared second differences of phase in each value; 0 where there is none.
    stride : (k,) samples between successive differences, max(1, m // ratio).
    span : samples, length of the time grid, missing samples included, over all segments.
    valid : (c,) valid samples.
    segments : parts of the grid with gaps of unknown length between them.
    ratio : sub-clusters per cluster, R.
    record : identity of the growing record; two curves with equal identities belong to the same record at two
        moments. None: unknown. It is not an argument, so that a curve made by `dataclasses.replace` or by
        `select` has none: its values are no longer those of the record.
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
    record: Hashable = field(default=None, init=False)

    @classmethod
    def from_sums(
        cls,
        tau0: float,
        ratio: int,
        squares: Floats,
        terms: Ints,
        white_excess: Ints,
        *,
        span: int,
        valid: Ints,
        segments: int,
        record: Hashable = None,
    ) -> AllanCurve:
        """Return the curve of sums by octave, (j, c), up to the last octave with a difference.

        See `imumon.noise.allan.octave.variances` for the sums.
        """
        present = np.flatnonzero((terms > 0).any(axis=1))
        k = int(present[-1]) + 1 if len(present) else 0
        m = np.left_shift(1, np.arange(k, dtype=np.int64))
        avar = variances(squares[:k], terms[:k], white_excess[:k], m)
        curve = cls(tau0, m, avar, terms[:k], np.maximum(1, m // ratio), span, valid, segments, ratio)
        object.__setattr__(curve, "record", record)
        return curve

    def select(self, channels: Sequence[int]) -> AllanCurve:
        """Return the curve of some of the channels, which has no `record`."""
        columns = list(channels)
        return replace(
            self, avar=self.avar[:, columns], terms=self.terms[:, columns], valid=self.valid[columns]
        )

    @property
    def tau(self) -> Floats:
        """(k,) s, averaging times."""
        return np.asarray(self.m * self.tau0, dtype=np.float64)

    @property
    def sigma(self) -> Floats:
        """(k, c) channel unit, Allan deviation; 0.0 where `terms` is 0."""
        return np.asarray(np.sqrt(self.avar), dtype=np.float64)
