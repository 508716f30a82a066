"""Allan curve: the variances that follow from the sums of the octaves, with what else is known of the same samples."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.model.samples import Floats, Ints
from imumon.model.saved_state import restorable
from imumon.noise.allan.octave import RATIO, variances
from imumon.noise.noise_sums import NoiseSums


@dataclass(frozen=True, slots=True, eq=False)
class AllanCurve:
    """Allan variance of some channels at octave-spaced averaging times.

    Attributes
    ----------
    tau0 : s, interval of the time grid.
    m : (k,) averaging factors 1, 2, 4 ... 2^(k-1); every octave for which some channel has a difference.
    avar : (k, c) (channel unit)^2, Allan variance; 0.0 where `terms` is 0.
    terms : (k, c) number of squared second differences of phase in each value; 0 where there is none.
    span : samples, length of the time grid, missing samples included, over all sections.
    valid : (c,) valid samples.
    sections : of the grid, between gaps of unknown length.
    sums : what the likelihood of the noise is made of, of the same samples; None: unknown, and nothing can be fitted.
    record : identity of the growing record; two curves with equal identities belong to the same record at two
        moments. None: unknown. It is not an argument, so that a curve made by `dataclasses.replace` or by
        `select` has none: its values are no longer those of the record.
    """

    tau0: float
    m: Ints
    avar: Floats
    terms: Ints
    span: int
    valid: Ints
    sections: int
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
        sums = None if self.sums is None else self.sums.with_temperature()
        curve = replace(self.select(channels), sums=sums)
        # frozen, and `record` is no argument: the same samples are left out of every curve of this record
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


@restorable
@dataclass(frozen=True, slots=True, eq=False)
class AllanSums:
    """Sums of the octaves over a record or a part of it.

    Attributes
    ----------
    squares : (k, c) (channel unit)^2, sums of squared differences by octave.
    terms : (k, c) number of differences.
    white_excess : (k, c) 1/`EXCESS_SCALE`, sums of their relative excess of white noise, see `octave`.
    valid : (c,) valid samples.
    span : samples of the grid.
    sections : of the grid, between gaps of unknown length.
    record : identity of the growing record, see `AllanCurve`; None: unknown.
    """

    squares: Floats
    terms: Ints
    white_excess: Ints
    valid: Ints
    span: int
    sections: int
    record: Hashable = None

    def since(self, before: AllanSums, octaves: int) -> AllanSums:
        """Return these sums less earlier ones of the same record, of the first `octaves` octaves.

        Octaves beyond have no difference yet whose samples all lie after `before`.
        """
        k = min(len(self.squares), octaves)
        return AllanSums(
            self.squares[:k] - before.squares[:k],
            self.terms[:k] - before.terms[:k],
            self.white_excess[:k] - before.white_excess[:k],
            self.valid - before.valid,
            self.span - before.span,
            max(1, self.sections - before.sections),  # the section in which `before` lies counts for both
            (self.record, before.span),
        )

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
        curve = AllanCurve(tau0, m, avar, self.terms[:k], self.span, self.valid, self.sections, sums)
        object.__setattr__(curve, "record", self.record)  # see `AllanCurve.record`
        return curve
