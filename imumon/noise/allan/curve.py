"""Curve: the Allan variance of some channels, as a cascade or a part of its record gives it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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

    @classmethod
    def of_sums(
        cls,
        tau0: float,
        ratio: int,
        squares: Floats,
        terms: Ints,
        lacks: Ints,
        *,
        span: int,
        valid: Ints,
        segments: int,
    ) -> AllanCurve:
        """The curve of sums by octave, (j, c), as far as some channel has a difference; see `variances`."""
        seen = np.flatnonzero((terms > 0).any(axis=1))
        k = int(seen[-1]) + 1 if len(seen) else 0
        m = np.left_shift(1, np.arange(k, dtype=np.int64))
        avar = variances(squares[:k], terms[:k], lacks[:k], m)
        return cls(tau0, m, avar, terms[:k], np.maximum(1, m // ratio), span, valid, segments, ratio)

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
