"""Moments: running mean, spread, shape and correlation of channels, in constant memory.

Each block is reduced to its own central moments, and two sets of them are joined by the update formulas of
Chan, Golub & LeVeque (1979) and Pébay (SAND2008-6212, eqs. 2.1, 3.1): no result is the small difference of
large sums. Means are kept relative to the first sample, so 9.8 m/s^2 costs no digits and a channel that never
changes has a deviation of exactly zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from imumon.model.samples import Bools, Floats, Ints
from imumon.model.saved_state import restorable
from imumon.noise.validity_groups import ValidityGroups

BATCH = 8192
"""Samples that are reduced, or counted in bins, together: their work arrays fit into the cache of the processor."""


@dataclass(frozen=True, slots=True)
class ChannelMoments:
    """Statistics of one channel; None if there are too few samples, or no spread.

    Attributes
    ----------
    count : valid samples.
    mean, min, max, last : channel unit; None without a sample.
    std : channel unit, with n - 1; None below two samples.
    skewness, excess_kurtosis : of the samples, m3 / m2^(3/2) and m4 / m2^2 - 3; None without spread.
    """

    count: int
    mean: float | None
    std: float | None
    min: float | None
    max: float | None
    skewness: float | None
    excess_kurtosis: float | None
    last: float | None


@dataclass(frozen=True, slots=True, eq=False)
class MomentsResult:
    """Statistics of all channels.

    Attributes
    ----------
    channels : one entry per channel.
    covariance : for each group of a channels (a, a) (channel unit)^2, with n - 1; None below two samples.
    """

    channels: tuple[ChannelMoments, ...]
    covariance: tuple[Floats | None, ...]


def deviation_limits(deviation: float, dof: float) -> tuple[float, float]:
    """Return the 95 % limits of a standard or Allan deviation whose square is chi-square with these degrees of freedom.

    Examples
    --------
    >>> [round(limit, 3) for limit in deviation_limits(1.0, 10.0)]
    [0.699, 1.755]
    """
    low, high = (deviation * math.sqrt(dof / float(chdtri(dof, side))) for side in (0.025, 0.975))
    return low, high


@restorable
class Moments:
    """Running moments of a stream.

    Parameters
    ----------
    channels : number of columns, c.
    groups : (c,) number of the group whose validity a channel shares; default: all in one.

    Examples
    --------
    >>> moments = Moments(1)
    >>> moments.update(np.array([[1.0], [2.0], [6.0]]))
    >>> moments.update(np.array([[7.0]]))
    >>> x = moments.result().channels[0]
    >>> x.count, x.mean, round(x.std, 6), x.min, x.last
    (4, 4.0, 2.94392, 1.0, 7.0)
    """

    def __init__(self, channels: int, groups: Sequence[int] | None = None) -> None:
        self._groups = ValidityGroups(channels, groups)
        self._count = np.zeros(channels, dtype=np.int64)
        self._origin = np.zeros(channels)  # first valid sample; mean is relative to it
        self._mean = np.zeros(channels)
        self._comoment = np.zeros((channels, channels))  # sum of products of deviations, within groups
        self._third = np.zeros(channels)  # sum of third powers of deviations
        self._fourth = np.zeros(channels)
        self._min = np.full(channels, np.inf)
        self._max = np.full(channels, -np.inf)
        self._last = np.zeros(channels)
        self._within = (self._groups.of[:, None] == self._groups.of).astype(np.float64)

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples.

        Parameters
        ----------
        values : (n, c) channel unit.
        valid : (n, g) samples that count, by group; None: all. Samples that are not finite never count.
        """
        values, present = self._groups.check(values, valid)
        for start in range(0, len(values), BATCH):
            part = values[start : start + BATCH]
            if present is None:
                self._add(part, self._groups.members)
                continue
            for group, members in enumerate(self._groups.members):
                self._add(part[present[start : start + BATCH, group]][:, members], [members])

    def merge(self, other: Moments) -> None:
        """Add the statistics of another record that follows this one.

        Raises
        ------
        ValueError : its channels or groups differ.
        """
        if self._groups != other._groups:
            raise ValueError("only moments of the same channels and groups merge")
        c = slice(0, self._groups.channels)
        mean = other._mean + self._move_origin(c, other._origin)
        self._join(c, other._count, mean, other._comoment, other._third, other._fourth)
        np.minimum(self._min, other._min, out=self._min)
        np.maximum(self._max, other._max, out=self._max)
        np.copyto(self._last, other._last, where=other._count > 0)

    def result(self) -> MomentsResult:
        """Return the statistics so far."""
        covariance: list[Floats | None] = []
        for c in self._groups.members:
            n = int(self._count[c][0])  # the channels of a group have the same samples
            covariance.append(self._comoment[c, c] / (n - 1) if n > 1 else None)
        channels = tuple(self._channel(c) for c in range(self._groups.channels))
        return MomentsResult(channels=channels, covariance=tuple(covariance))

    def _channel(self, c: int) -> ChannelMoments:
        n = int(self._count[c])
        if n == 0:
            return ChannelMoments(0, None, None, None, None, None, None, None)
        square = float(self._comoment[c, c])
        skewness = kurtosis = None
        variance = square / n
        if variance**2 > 0.0:  # of noise below 1e-81 the square underflows, and nothing is said of the shape
            skewness = float(self._third[c] / n) / variance**1.5
            kurtosis = float(self._fourth[c] / n) / variance**2 - 3.0
        return ChannelMoments(
            count=n,
            mean=float(self._origin[c] + self._mean[c]),
            std=(square / (n - 1)) ** 0.5 if n > 1 else None,
            min=float(self._min[c]),
            max=float(self._max[c]),
            skewness=skewness,
            excess_kurtosis=kurtosis,
            last=float(self._last[c]),
        )

    def _add(self, values: Floats, groups: list[slice]) -> None:
        """Reduce samples (n, a) of the channels of neighbouring groups, all valid, and join their moments."""
        n, a = values.shape
        c = slice(groups[0].start, groups[-1].stop)
        if n == 0:
            return
        x = np.array(values.T, order="C")
        np.minimum(self._min[c], x.min(axis=1), out=self._min[c])
        np.maximum(self._max[c], x.max(axis=1), out=self._max[c])
        self._last[c] = values[-1]
        shift = self._move_origin(c, values[0])
        # a constant channel becomes exactly zero, whatever its value: its deviation is then 0.0 and not rounding
        x -= values[0][:, None]
        mean = x.mean(axis=1)
        x -= mean[:, None]
        square = x * x
        third = (square[:, None, :] @ x[:, :, None])[:, 0, 0]
        fourth = (square[:, None, :] @ square[:, :, None])[:, 0, 0]
        comoment = np.zeros((a, a))
        for group in groups:
            rows = slice(group.start - c.start, group.stop - c.start)
            comoment[rows, rows] = x[rows] @ x[rows].T
        self._join(c, n, mean + shift, comoment, third, fourth)

    def _move_origin(self, c: slice, first: Floats) -> Floats:
        """Return (a,) `first` relative to the origin, channel unit; `first` is the origin of new channels."""
        np.copyto(self._origin[c], first, where=self._count[c] == 0)
        return np.asarray(first - self._origin[c])

    def _join(
        self, c: slice, n: int | Ints, mean: Floats, comoment: Floats, third: Floats, fourth: Floats
    ) -> None:
        """Join the central moments of `n` samples, or (a,) of each channel, of the channels `c`."""
        total = self._count[c] + n
        some = np.maximum(total, 1)  # two empty sets join to an empty one
        p = self._count[c] / some  # share of the old samples
        q = n / some
        pqn = p * n  # a b / (a + b)
        d = mean - self._mean[c]
        d2 = d * d
        old = np.diagonal(self._comoment[c, c])  # sums of squares
        new = np.diagonal(comoment)
        self._fourth[c] += (
            fourth
            + d2 * d2 * pqn * (1.0 - 3.0 * p * q)
            + 6.0 * d2 * (p * p * new + q * q * old)
            + 4.0 * d * (p * third - q * self._third[c])
        )
        self._third[c] += third + d * d2 * pqn * (p - q) + 3.0 * d * (p * new - q * old)
        weight = np.sqrt(pqn) * d
        # sensors lose samples of their own: between them there are no pairs to multiply
        self._comoment[c, c] += (comoment + np.outer(weight, weight)) * self._within[c, c]
        self._mean[c] += d * q
        self._count[c] = total
