"""Allan curve: Allan variance at octave-spaced averaging times, with what stands behind each value."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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

    @property
    def tau(self) -> Floats:
        """(k,) s, averaging times."""
        return np.asarray(self.m * self.tau0, dtype=np.float64)

    @property
    def sigma(self) -> Floats:
        """(k, c) channel unit, Allan deviation; 0.0 where `terms` is 0."""
        return np.asarray(np.sqrt(self.avar), dtype=np.float64)
