"""Fully overlapping Allan deviation of stored samples: exact at every averaging time, memory grows with the record.

The differences of the cascade are an eighth of tau apart, and it needs kilobytes. This module is what textbooks
and other tools compute, for comparison and for figures with more points: with the sums P of the samples,

    sigma^2(m) = sum over i of (P[i + 2m] - 2 P[i + m] + P[i])^2 / (2 m^2 terms)

(NIST SP 1065, section 5.2.4; IEEE Std 952 annex C). Where samples are missing or excluded, an average is that of those
that are there, and counts if nearly all are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.samples import Bools, Floats, Ints

POINTS_PER_DECADE = 10
"""Averaging times per decade of the finer grid."""
COMPLETE_SHARE = 0.9
"""Share of the samples of an average that must be there: the rest adds at most a tenth to white variance."""
BROKEN = -(1 << 40)
"""Count of a gap of unknown length: no average that holds it has enough samples."""


class SampleStore:
    """Keep all samples of some columns, and where the grid has gaps.

    Parameters
    ----------
    groups : (c,) group of each column; the samples of a group are valid together.
    """

    def __init__(self, groups: Sequence[int]) -> None:
        self._groups = list(groups)
        self._values: list[Floats] = []
        self._valid: list[Ints] = []

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add (n, c) consecutive samples, of which those with `valid` (n, g) count; None: all."""
        kept = np.array(values[:, : len(self._groups)])
        present = np.asarray(np.isfinite(kept))
        if valid is not None:
            present &= valid[:, self._groups]
        kept[~present] = 0.0  # NaN in one sample would be in every later cumulative sum
        self._values.append(kept)
        self._valid.append(present.astype(np.int64))

    def break_(self) -> None:
        """Note a gap, however long: no average and no difference spans it."""
        self._values.append(np.zeros((1, len(self._groups))))
        self._valid.append(np.full((1, len(self._groups)), BROKEN))

    def result(self) -> tuple[Floats, Ints]:
        """Return (n, c) samples, 0 where invalid, and (n, c) 1 where they are valid, 0 or less where not."""
        empty = np.zeros((0, len(self._groups)))
        return np.concatenate([empty, *self._values]), np.concatenate([empty.astype(np.int64), *self._valid])


def averaging_lengths(samples: int, *, octaves: bool) -> list[int]:
    """Return averaging times in samples, up to half the record: octaves, or ten points per decade.

    >>> averaging_lengths(20, octaves=True), averaging_lengths(20, octaves=False)
    ([1, 2, 4, 8], [1, 2, 3, 4, 5, 6, 8, 10])
    """
    if samples < 2:
        return []
    most = samples // 2
    if octaves:
        return [2**k for k in range(most.bit_length())]
    steps = range(math.floor(POINTS_PER_DECADE * math.log10(most)) + 1)
    return sorted({round(10 ** (k / POINTS_PER_DECADE)) for k in steps})


def overlapping_deviation(values: Floats, valid: Ints, lengths: Sequence[int]) -> tuple[Floats, Ints]:
    """Return the fully overlapping Allan deviation of one channel.

    Parameters
    ----------
    values : (n,) channel unit, samples at equal intervals, 0 where invalid.
    valid : (n,) 1 where they are valid, 0 where not, `BROKEN` in a gap of unknown length.
    lengths : (k,) averaging times in samples.

    Returns
    -------
    sigma : (k,) channel unit, 0 without a term.
    terms : (k,) differences that were averaged.

    >>> sigma, terms = overlapping_deviation(np.array([0.0, 1.0, 0.0, 1.0]), np.ones(4, int), [1, 2])
    >>> sigma.round(3).tolist(), terms.tolist()
    ([0.707, 0.0], [3, 1])
    """
    sigma, terms = np.zeros(len(lengths)), np.zeros(len(lengths), dtype=np.int64)
    there = valid > 0
    if not there.any():
        return sigma, terms
    centred = np.where(there, values - values[there].mean(), 0.0)  # keeps the digits of the sums
    sums, counts = (np.concatenate([[0], np.cumsum(column)]) for column in (centred, valid))
    for k, m in enumerate(lengths):
        count = (
            counts[m:] - counts[:-m]
        )  # negative across a break, by `BROKEN`: such an average is never whole
        mean, whole = (sums[m:] - sums[:-m]) / np.maximum(count, 1), count >= COMPLETE_SHARE * m
        difference = (mean[m:] - mean[:-m])[whole[m:] & whole[:-m]]
        terms[k] = len(difference)
        if terms[k]:
            sigma[k] = math.sqrt(float(difference @ difference) / (2.0 * terms[k]))
    return sigma, terms
