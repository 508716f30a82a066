"""Histogram: how the values of each channel are distributed, in bins that adapt to their range.

Bins are equal and lie on a fixed lattice: the width is a power of two (times the step of a quantised channel,
so that every bin holds the same number of levels and no comb appears), the edges are multiples of it. When a
value is outside, pairs of bins are merged until it fits. So counts stay exact, the number of bins stays
bounded, and the result depends on the values alone, not on their order or chunking. numpy.histogram needs all
samples at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imumon.model.samples import Bools, Floats, Ints
from imumon.model.saved_state import restorable
from imumon.noise.statistics.distribution_shape import LEARN_SAMPLES, DistributionShape, assessed
from imumon.noise.statistics.moments import BATCH
from imumon.noise.validity_groups import LARGEST

FEW_LEVELS = 8
"""A channel with more, whose step could not be learned, is not called quantised; with fewer in a standard
deviation, a median is sought between levels. Unit: levels.

Otherwise: the least difference of many levels may be several steps.
"""

HISTOGRAM_BINS = 256
"""Bins of a channel: at least half of them are in use."""
ROUNDED_GAP = 1e-9
"""Share of the largest value below which a difference of two values is rounding, such as that of ten printed digits."""
LATTICE_ERROR = 0.1
"""Steps by which a difference may miss a multiple of the quantisation step: nine random levels do not in 3e-6."""
MOST_MULTIPLE = 1e6
"""Steps, largest difference with which a step is recognised: beyond, any number is a multiple."""
PRECISE_BITS = 44
"""Bits of a place on the lattice that are exact: a float has 53, and sums of places need some."""


@restorable
class HistogramAccumulator:
    """Histograms of some channels.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1; the channels of a group share their validity.
    """

    def __init__(self, groups: Sequence[int]) -> None:
        self._groups = list(groups)
        c = len(self._groups)
        self._held: list[tuple[Floats, Bools | None]] = []
        self._holding = 0
        self._step = np.zeros(c)  # 0: not quantised
        self._exponent = np.zeros(c, dtype=np.int64)  # width = unit * 2^exponent
        self._unit = np.ones(c)
        self._low = np.zeros(c, dtype=np.int64)  # lattice number of the first bin
        self._counts = np.zeros((c, HISTOGRAM_BINS), dtype=np.int64)
        self._started = np.zeros(c, dtype=bool)

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples.

        Parameters
        ----------
        values : (n, c) channel unit, finite where valid.
        valid : (n, g); None: all.
        """
        if self._holding < LEARN_SAMPLES:
            n = min(len(values), LEARN_SAMPLES - self._holding)
            self._held.append((np.array(values[:n]), None if valid is None else np.array(valid[:n])))
            self._holding += n
            if self._holding < LEARN_SAMPLES:
                return
            self._learn()
            values, valid = values[n:], None if valid is None else valid[n:]
        self._add(values, valid)

    def _learn(self) -> None:
        """Estimate the steps from the samples that are held back, and count these."""
        blocks, self._held = self._held, []
        for c, group in enumerate(self._groups):
            x = np.concatenate([v[:, c] if ok is None else v[ok[:, group], c] for v, ok in blocks])
            self._step[c] = quantum(x)
            self._unit[c] = self._step[c] or 1.0
        for values, ok in blocks:
            self._add(values, ok)

    def _add(self, values: Floats, valid: Bools | None) -> None:
        for start in range(0, len(values), BATCH):
            rows = slice(start, start + BATCH)
            self._add_batch(values[rows], None if valid is None else valid[rows])

    def _add_batch(self, values: Floats, valid: Bools | None) -> None:
        groups = np.array(self._groups)
        if valid is None or valid.all():
            self._count(np.arange(len(groups)), np.ascontiguousarray(values.T))
            return
        for group in np.flatnonzero(valid.any(axis=0)).tolist():
            channels = np.flatnonzero(groups == group)
            self._count(channels, np.ascontiguousarray(values[valid[:, group]][:, channels].T))

    def _count(self, channels: Ints, x: Floats) -> None:
        """Count (c, n) values of these channels."""
        if not self._started[channels].all():
            self._fit_range(channels, x.min(axis=1), x.max(axis=1))
        place = self._places(channels, x)
        if place.min() < 0.0 or place.max() >= HISTOGRAM_BINS:
            self._fit_range(channels, x.min(axis=1), x.max(axis=1))
            place = np.clip(self._places(channels, x), 0, HISTOGRAM_BINS - 1)
        bins = place.astype(np.int64)
        # The base of each channel is added as an integer: a rounded sum could cross into the next channel.
        bins += np.arange(len(channels))[:, None] * HISTOGRAM_BINS
        counts = np.bincount(bins.ravel(), minlength=len(channels) * HISTOGRAM_BINS)
        self._counts[channels] += counts.reshape(-1, HISTOGRAM_BINS)

    def _places(self, channels: Ints, x: Floats) -> Floats:
        """Return (c, n) the bin of each value with its fraction; values beyond the bins are outside 0 ... 256."""
        scale = np.ldexp(1.0 / self._unit[channels], -self._exponent[channels])
        # A quantised value belongs in the middle of its level's bin.
        offset = np.ldexp(self._shift(channels), -self._exponent[channels]) - self._low[channels]
        place = x * scale[:, None]
        place += offset[:, None]
        return np.asarray(place, dtype=np.float64)

    def _shift(self, channels: Ints) -> Floats:
        return np.where(self._step[channels] > 0, 0.5, 0.0)

    def _fit_range(self, channels: Ints, low: Floats, high: Floats) -> None:
        """Widen the bins of channels until their least and greatest values (c,), channel unit, fit."""
        low = low / self._unit[channels] + self._shift(channels)
        high = high / self._unit[channels] + self._shift(channels)
        for i, c in enumerate(channels.tolist()):
            if not self._started[c]:
                self._started[c] = True
                # the finest lattice on which places are exact integers in a float
                finest = math.frexp(max(abs(low[i]), abs(high[i]), 1e-30))[1] - PRECISE_BITS
                self._exponent[c] = 0 if self._step[c] else finest
            exponent, used = int(self._exponent[c]), np.flatnonzero(self._counts[c])
            numbers, counts = used + self._low[c], self._counts[c, used]
            ends = [math.floor(math.ldexp(value, -exponent)) for value in (low[i], high[i])]
            ends += numbers.tolist()
            first, last = min(ends), max(ends)
            merges = 0  # of pairs of bins on the lattice, until all of them fit
            while (last >> merges) - (first >> merges) >= HISTOGRAM_BINS:
                merges += 1
            first, last = first >> merges, last >> merges
            self._exponent[c], self._low[c] = (
                exponent + merges,
                first - (HISTOGRAM_BINS - 1 - (last - first)) // 2,
            )
            self._counts[c] = 0
            np.add.at(self._counts[c], (numbers >> merges) - self._low[c], counts)

    def result(self) -> list[DistributionShape | None]:
        """Return the shape of each channel; None without samples."""
        counted = self
        if self._held:
            counted = HistogramAccumulator(self._groups)
            counted._held = list(self._held)
            counted._learn()
        return [counted._shape(c) for c in range(len(self._groups))]

    def _shape(self, c: int) -> DistributionShape | None:
        used = np.flatnonzero(self._counts[c])
        if not len(used):
            return None
        counts = self._counts[c, used[0] : used[-1] + 1]
        width = math.ldexp(float(self._unit[c]), int(self._exponent[c]))
        step = float(self._step[c]) or None
        start = (int(self._low[c]) + int(used[0])) * width - (0.5 * step if step else 0.0)
        return assessed(start, width, counts, step or _sparse(counts, width))


def quantum(x: Floats) -> float:
    """Return the step of a quantised channel; 0.0 if the values are constant or lie on no lattice.

    Parameters
    ----------
    x : (n,) some values.

    >>> quantum(np.array([0.3, 0.1, 0.7, 0.3])), quantum(np.array([2.0, 2.0]))
    (0.2, 0.0)
    """
    levels = np.unique(x)
    if len(levels) < 2:
        return 0.0
    gaps = np.diff(levels)
    step = float(gaps[gaps > ROUNDED_GAP * np.abs(levels).max()].min(initial=np.inf))
    if not 1.0 / LARGEST < step < math.inf:
        return 0.0
    for divisor in (1, 2, 3):  # the least difference may itself be several steps
        fine = step / divisor
        multiples = gaps / fine
        if np.all(np.abs(multiples - np.rint(multiples)) < LATTICE_ERROR) and (
            multiples.max() < MOST_MULTIPLE and (len(levels) > FEW_LEVELS or divisor == 1)
        ):
            # the whole range determines the step better than the least difference
            total = (levels[-1] - levels[0]) / np.rint((levels[-1] - levels[0]) / fine)
            return float(f"{total:.9g}")
    return 0.0


def _sparse(counts: Ints, width: float) -> float | None:
    """Return the step of a channel that was constant while steps were learned: few levels, far apart."""
    levels = np.flatnonzero(counts)
    if not 1 < len(levels) <= FEW_LEVELS:
        return None
    apart = int(np.diff(levels).min())
    return apart * width if apart > 1 else None
