"""Differences of neighbouring samples: how far N depends on a few of them.

The Allan deviation at the shortest tau is that of a mean of squares, which rare great samples dominate. Its
robust companion takes the median instead: the median of |difference| of Gaussian noise, whatever its spectrum,
is 0.6745 sqrt(2) sigma(tau0). Both come from the same differences, so their ratio is 1 for Gaussian noise and
grows with heavy tails. Five per cent of outliers of ten deviations give 2.2.

The fourth moment gives the kurtosis of the samples. With it, the variance of N is right for noise that is not
Gaussian: for independent samples it gains g / n of N^2, g being the excess kurtosis.

After the first samples, one difference in sixteen counts, in bursts at fixed places: enough for any length.
The distribution of |difference| is counted in bins of 1/16 octave: constant memory, and the same counts for any
chunking.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from imumon.model.samples import Bools, Floats, Ints
from imumon.model.saved_state import restorable
from imumon.noise.statistics.distribution_shape import LEARN_SAMPLES, MOMENT_ERRORS
from imumon.noise.statistics.histogram import FEW_LEVELS

REPEATED = 0.25
"""With a larger share of zeros, the sensor is slower than its samples: their median is not used. Unit: of the
differences.

Otherwise: the robust deviation of repeated values is far too small, and all changes are outliers. Origin: rounding to
LEAST_STEPS gives a tenth.
"""
LEAST_STEPS = 3.0
"""Outliers are judged where the Allan deviation of one sample has at least as many. Unit: quantisation steps.

Otherwise: the median of fewer levels says little.
"""

PER_OCTAVE, BINS = 16, 1024
"""Bins in an octave, within which the density is taken as even: an error of 0.1 % of the median. And in all."""
LOWEST = -48.0
"""Binary logarithm of the lowest edge; values below share the first bin."""

DENSE = 8192
"""Samples from the beginning of which every difference counts."""
PERIOD, BURST = 1024, 64
"""Samples from one burst to the next, and of one, in which differences count afterwards. Differences within a burst
are neighbours, as at the beginning; single ones would need two samples each."""

RATIO_VARIANCE = 2.8
"""Variance of the ratio times the number of differences, for white Gaussian noise: 1.36 of the median and 0.5
of the mean square, 1.5 for the correlation of neighbouring differences."""


@dataclass(frozen=True, slots=True)
class RobustDeviation:
    """Robust companion of the Allan deviation at the sampling interval.

    Attributes
    ----------
    sigma : channel unit.
    ratio : Allan deviation of the same differences over `sigma`.
    disagrees : whether the ratio is significantly above 1: heavy tails dominate N.
    """

    sigma: float
    ratio: float
    disagrees: bool


@restorable
class DifferenceAccumulator:
    """Distribution and moments of the differences of neighbouring samples.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1, whose validity it shares.
    """

    def __init__(self, groups: Sequence[int]) -> None:
        self._groups = np.array(groups, dtype=np.int64)
        c = len(self._groups)
        self._counts = np.zeros((c, BINS), dtype=np.int64)
        self._sums = np.zeros((c, 2))  # of d^2 and d^4
        self._index = 0  # samples so far
        self._last = np.zeros((0, c))  # newest row
        self._last_valid = np.zeros((0, int(self._groups.max(initial=-1)) + 1), dtype=bool)

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples (n, c), channel unit, of which those with `valid` (n, g) count; None: all."""
        if not len(values) or not len(self._groups):
            return
        rows = self._counted(len(values))
        self._index += len(values)
        ok = np.ones((len(values), self._last_valid.shape[1]), dtype=bool) if valid is None else valid
        if rows.size:
            self._add_rows(values, ok, rows)
        self._last, self._last_valid = values[-1:].copy(), ok[-1:].copy()

    def _counted(self, n: int) -> Ints:
        """Return the rows of the next n samples whose difference from the one before counts."""
        first, end = self._index, self._index + n
        dense = np.arange(first, max(first, min(end, DENSE)))
        bursts = np.arange(max(first, DENSE) // PERIOD, -(-end // PERIOD)) * PERIOD
        later = (bursts[:, None] + np.arange(BURST)).ravel()
        later = later[(later >= max(first, DENSE)) & (later < end)]
        return np.concatenate((dense, later)) - first

    def _add_rows(self, values: Floats, ok: Bools, rows: Ints) -> None:
        """Add the differences of some rows of samples from the ones before them."""
        now, before = values.T.take(rows, axis=1), values.T.take(rows - 1, axis=1)
        both = ok[rows] & ok[rows - 1]
        if rows[0] == 0:  # of the samples before; at the beginning and after a gap, there are none
            before[:, :1] = self._last.T if len(self._last) else 0.0
            both[0] = ok[0] & self._last_valid.any(axis=0)
        for group in np.flatnonzero(both.any(axis=0)).tolist():
            # only these: one that is not valid may be infinite, and the difference of two has no value
            channels, some = np.flatnonzero(self._groups == group), np.flatnonzero(both[:, group])
            self._add(channels, now[channels].take(some, axis=1) - before[channels].take(some, axis=1))

    def break_(self) -> None:
        """Note a gap: no difference spans it."""
        self._last, self._last_valid = self._last[:0], self._last_valid[:0]

    def _add(self, channels: np.ndarray, d: Floats) -> None:
        """Count (c, n) differences of these channels."""
        if not d.size:
            return
        with np.errstate(divide="ignore"):
            place = PER_OCTAVE * (np.log2(np.abs(d)) - LOWEST)
        bins = np.clip(place, 0, BINS - 1).astype(np.int64) + np.arange(len(d))[:, None] * BINS
        self._counts[channels] += np.bincount(bins.ravel(), minlength=len(d) * BINS).reshape(-1, BINS)
        square = d * d
        self._sums[channels, 0] += square.sum(axis=1)
        self._sums[channels, 1] += np.einsum("cn,cn->c", square, square)

    def fast_kurtosis(self) -> Floats:
        """Return (c,) the excess kurtosis of the samples about slow changes; 0.0 with too few samples or no spread.

        It is twice that of the differences, as for independent samples: the fourth cumulant of a difference is twice
        that of a sample, the square of its variance four times. Slow drift does not enter.
        """
        n = self._counts.sum(axis=1)
        square, fourth = (self._sums / np.maximum(n, 1)[:, None]).T
        known = (n >= LEARN_SAMPLES) & (square > 0.0)
        excess = fourth / np.where(known, square, 1.0) ** 2 - 3.0
        return np.where(known, 2.0 * excess, 0.0)

    def result(self, steps: Sequence[float]) -> list[RobustDeviation | None]:
        """Return the robust deviation of each channel.

        None with few differences, where values repeat, and where the deviation has fewer than `LEAST_STEPS`
        quantisation steps.

        Parameters
        ----------
        steps : (c,) channel unit, quantisation step; 0.0 without.
        """
        excess = 0.5 * self.fast_kurtosis()
        return [self._robust(c, step, float(excess[c])) for c, step in enumerate(steps)]

    def _robust(self, c: int, step: float, excess: float) -> RobustDeviation | None:
        n = int(self._counts[c].sum())
        if n < LEARN_SAMPLES or not self._sums[c, 0] > 0.0:
            return None
        sigma = math.sqrt(0.5 * float(self._sums[c, 0]) / n)
        if sigma < LEAST_STEPS * step:
            return None
        if self._counts[c, 0] > REPEATED * n:  # the first bin has the differences of zero
            return None
        # A repeated value is no difference of the noise: without them, sigma grows as the median does. Zeros by
        # rounding are differences like others: step times the density of a difference at zero.
        rounded = step / (2.0 * math.sqrt(math.pi) * sigma)
        repeats = max(int(self._counts[c, 0] - rounded * n), 0)
        n, sigma = n - repeats, sigma * math.sqrt(n / (n - repeats))
        counts = self._counts[c].copy()
        counts[0] -= repeats
        below = np.concatenate(([0], np.cumsum(counts))) / n  # at the edges of the bins
        edges = _edges()
        if 0.0 < sigma < FEW_LEVELS * step:  # at the edges next to the middle between two levels
            levels = np.arange(0.5, 4.0 * FEW_LEVELS) * step
            below, edges = below[np.searchsorted(edges, levels)], levels
        upper = int(np.searchsorted(below, 0.5))  # first edge above the median
        if not 0 < upper < len(edges):
            return None  # beyond the bins, 2^-48 to 2^16
        # between two edges, |d| is linear in the quantile of a Gaussian
        low, high = (float(ndtri(0.5 * (1.0 + min(below[i], 1.0 - 0.5 / n)))) for i in (upper - 1, upper))
        share = (float(ndtri(0.75)) - low) / max(high - low, 1e-300)
        median = float(edges[upper - 1]) + share * float(edges[upper] - edges[upper - 1])
        robust = median / (math.sqrt(2.0) * float(ndtri(0.75)))
        if robust <= 0.0:
            return None
        error = math.sqrt((RATIO_VARIANCE + 0.25 * max(excess, 0.0)) / n)
        ratio = sigma / robust
        # at least 5 %: with a million samples, any small difference is significant
        return RobustDeviation(robust, ratio, ratio > 1.0 + max(0.05, MOMENT_ERRORS * error))


def _edges() -> Floats:
    """Return (BINS + 1,) channel unit, the lower edges of the bins; 0 for the first."""
    edges = np.exp2(np.arange(BINS + 1) / PER_OCTAVE + LOWEST)
    edges[0] = 0.0
    return edges
