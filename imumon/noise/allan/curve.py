"""Sums of squared differences by octave, and the Allan curve that follows from them."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.noise.allan.octave import RATIO, variances
from imumon.noise.noise_sums import NoiseSums
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
    span : samples, length of the time grid, missing samples included, over all segments.
    valid : (c,) valid samples.
    segments : parts of the grid with gaps of unknown length between them.
    record : identity of the growing record; two curves with equal identities belong to the same record at two
        moments. None: unknown. It is not an argument, so that a curve made by `dataclasses.replace` or by
        `select` has none: its values are no longer those of the record.
    sums : what the likelihood of the noise is made of, of the same samples; None: unknown, and nothing can be fitted.
    """

    tau0: float
    m: Ints
    avar: Floats
    terms: Ints
    span: int
    valid: Ints
    segments: int
    sums: NoiseSums | None = None
    record: Hashable = field(default=None, init=False)

    def select(self, channels: Sequence[int]) -> AllanCurve:
        """Return the curve of some of the channels, which has no `record`."""
        columns = list(channels)
        avar, terms, valid = self.avar[:, columns], self.terms[:, columns], self.valid[columns]
        sums = None if self.sums is None else self.sums.select(columns)
        return replace(self, avar=avar, terms=terms, valid=valid, sums=sums)

    def with_temperature(self) -> AllanCurve:
        """Return the curve of all channels but the last one, which is the temperature, of the same record."""
        channels = range(self.valid.size - 1)
        curve = replace(
            self.select(channels), sums=None if self.sums is None else self.sums.with_temperature()
        )
        object.__setattr__(curve, "record", self.record)
        return curve

    @property
    def tau(self) -> Floats:
        """(k,) s, averaging times."""
        return np.asarray(self.m * self.tau0, dtype=np.float64)

    @property
    def sigma(self) -> Floats:
        """(k, c) channel unit, Allan deviation; 0.0 where `terms` is 0."""
        return np.asarray(np.sqrt(self.avar), dtype=np.float64)

    @property
    def stride(self) -> Ints:
        """(k,) samples between successive differences."""
        return np.maximum(1, self.m // RATIO)


@dataclass(frozen=True, slots=True, eq=False)
class WindowSums:
    """Sums of a record or of a part of it.

    Attributes
    ----------
    squares : (k, c) (channel unit)^2, sums of squared differences by octave.
    terms : (k, c) number of differences.
    white_excess : (k, c) 1/`EXCESS_SCALE`, sums of their relative excess of white noise, see `octave`.
    valid : (c,) valid samples.
    span : samples of the grid.
    segments : parts with gaps of unknown length between them.
    record : identity of the growing part of the record, see `AllanCurve`; None: unknown.
    """

    squares: Floats
    terms: Ints
    white_excess: Ints
    valid: Ints
    span: int
    segments: int
    record: Hashable = None

    def __add__(self, other: WindowSums) -> WindowSums:
        """Return the sums of both, with a gap of unknown length between them."""
        k = max(len(self.squares), len(other.squares))
        return WindowSums(
            padded(self.squares, k) + padded(other.squares, k),
            padded(self.terms, k) + padded(other.terms, k),
            padded(self.white_excess, k) + padded(other.white_excess, k),
            self.valid + other.valid,
            self.span + other.span,
            self.segments + other.segments,
        )

    def save(self) -> dict[str, np.ndarray]:
        """Return the sums as arrays; channels of one sensor share their counts."""
        counts = np.concatenate([self.terms, self.white_excess, self.valid[None]])
        counts, kind = np.unique(counts, axis=1, return_inverse=True)
        numbers = np.array([self.span, self.segments], dtype=np.int64)
        return {"squares": self.squares, "counts": counts, "kind": kind.ravel(), "numbers": numbers}

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> WindowSums:
        """Return saved sums."""
        k = len(saved["squares"])
        counts = saved["counts"][:, saved["kind"]]
        span, segments = (int(value) for value in saved["numbers"])
        return cls(saved["squares"], counts[:k], counts[k : 2 * k], counts[-1], span, segments)

    def curve(self, tau0: float, sums: NoiseSums | None = None) -> AllanCurve:
        """Return the Allan curve of these sums, up to the last octave with a difference.

        Parameters
        ----------
        tau0 : s
        sums : of the noise of the same samples; None: unknown.
        """
        k = int(np.flatnonzero((self.terms > 0).any(axis=1)).max(initial=-1)) + 1
        m = np.left_shift(1, np.arange(k, dtype=np.int64))
        avar = variances(self.squares[:k], self.terms[:k], self.white_excess[:k], m)
        curve = AllanCurve(tau0, m, avar, self.terms[:k], self.span, self.valid, self.segments, sums)
        object.__setattr__(curve, "record", self.record)
        return curve


def padded(rows: np.ndarray, k: int) -> np.ndarray:
    """Return (k, c) the rows, and rows of zeros below them."""
    return np.pad(rows, ((0, k - len(rows)), (0, 0)))
