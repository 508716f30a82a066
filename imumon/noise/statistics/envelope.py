"""Envelope: minimum and maximum of each channel in columns of time, for drawing a signal.

Three envelopes run together: the last minute in columns of half a second, the last hour in columns of half a
minute, and everything in at most twice as many columns, which double in length when they are full. The columns of the
last minute also have sums, for its mean and standard deviation.

Columns lie on the sample grid: any chunking gives the same columns, and a gap leaves empty ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.model.samples import Bools, Floats, Ints
from imumon.model.saved_state import restorable
from imumon.model.units import HOUR, MINUTE
from imumon.noise.validity_groups import LARGEST

RECENT_COLUMNS = 120
"""Columns of the last minute and of the last hour: more than a terminal is wide."""
COLUMN_S = MINUTE / RECENT_COLUMNS
"""s, length of a column of the last minute."""
HOUR_COLUMN = round(HOUR / MINUTE)
"""Columns of the minute in one of the hour."""


@dataclass(frozen=True, slots=True, eq=False)
class EnvelopeColumns:
    """Columns of equal length, oldest first; the last one may still be filling.

    Attributes
    ----------
    start : samples on the grid before the first column.
    width : samples, length of a column.
    low, high : (k, c) channel unit; NaN without a sample.
    """

    start: int
    width: int
    low: Floats
    high: Floats


@dataclass(frozen=True, slots=True, eq=False)
class RecentStatistics:
    """Statistics of the last minute.

    Attributes
    ----------
    count : (c,) valid samples.
    mean, std : (c,) channel unit; NaN if `count` is 0 (below 2 for std).
    """

    count: Floats
    mean: Floats
    std: Floats


@restorable
class Envelope:
    """Columns of the last minute, the last hour, and everything.

    Parameters
    ----------
    groups : (c,) group of each channel, 0 ... g-1; the channels of a group share their validity.
    rate_hz : Hz, sampling rate.
    """

    def __init__(self, groups: Sequence[int], rate_hz: float) -> None:
        self._groups = list(groups)
        c = len(self._groups)
        self.column = max(1, round(COLUMN_S * rate_hz))
        self._n = 0  # samples on the grid
        self._offset = np.full(c, np.nan)  # near the values, so that sums lose no digits
        self._minute = np.full((RECENT_COLUMNS, 2, c), np.nan)  # ring by column number: low, high
        self._sums = np.zeros((RECENT_COLUMNS, 3, c))  # count, sum, sum of squares, about the offset
        self._hour = np.full((RECENT_COLUMNS, 2, c), np.nan)
        self._all = np.full((2 * RECENT_COLUMNS, 2, c), np.nan)
        self._wide = 1  # columns of the minute in one of everything

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Add samples (n, c), channel unit, of which those with `valid` (n, g) count; None: all."""
        n = len(values)
        if not n:
            return
        if np.isnan(self._offset).any():
            # the first row may be invalid
            self._offset = np.where(np.abs(values[0]) < LARGEST, values[0], 0.0)
        x = np.ascontiguousarray(values.T)
        ok = None
        if valid is not None and not valid.all():
            ok = np.ascontiguousarray(valid[:, self._groups].T)
        first, last = self._n // self.column, (self._n + n - 1) // self.column
        bounds = np.arange(first, last + 2) * self.column - self._n
        bounds[0], bounds[-1] = 0, n
        edges = bounds[:-1]
        extremes, sums = np.empty((len(edges), 2, len(x))), np.empty((len(edges), 3, len(x)))
        low = x if ok is None else np.where(ok, x, np.inf)
        np.minimum.reduceat(low, edges, axis=1, out=extremes[:, 0].T)
        high = x if ok is None else np.where(ok, x, -np.inf)
        np.maximum.reduceat(high, edges, axis=1, out=extremes[:, 1].T)
        extremes[np.isinf(extremes)] = np.nan  # no valid sample in the column
        d = x - self._offset[:, None]
        if ok is not None:
            d[~ok] = 0.0
            np.add.reduceat(ok, edges, axis=1, dtype=np.float64, out=sums[:, 0].T)
        else:
            sums[:, 0] = (bounds[1:] - edges)[:, None]
        np.add.reduceat(d, edges, axis=1, out=sums[:, 1].T)
        np.multiply(d, d, out=d)
        np.add.reduceat(d, edges, axis=1, out=sums[:, 2].T)
        new = -(-self._n // self.column)  # first column that begins in this block
        self._n += n
        if first == last < new:  # nearly every block of a live stream lies within one column
            self._widen_newest(first, extremes[0])
            self._sums[first % RECENT_COLUMNS] += sums[0]
            return
        self._join_columns(last)
        _widen(self._minute, first, last, new, extremes)
        kept = max(first, last + 1 - RECENT_COLUMNS)  # a long block overwrites its own first columns
        self._sums[_places(max(kept, new), last, RECENT_COLUMNS)] = 0.0
        self._sums[_places(kept, last, RECENT_COLUMNS)] += sums[kept - first :]
        for ring, wide in ((self._hour, HOUR_COLUMN), (self._all, self._wide)):
            begin, end = first // wide, last // wide
            _widen(ring, begin, end, -(-new // wide), _coarser(extremes, wide, first, end - begin + 1))

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing."""
        first, last = -(-self._n // self.column), (self._n + n - 1) // self.column
        self._n += n
        if last < first:
            return
        self._join_columns(last)
        numbers = np.arange(max(first, last + 1 - RECENT_COLUMNS), last + 1)
        self._minute[numbers % RECENT_COLUMNS] = np.nan
        self._sums[numbers % RECENT_COLUMNS] = 0.0
        first, last = -(-first // HOUR_COLUMN), last // HOUR_COLUMN
        hours = np.arange(max(first, last + 1 - RECENT_COLUMNS), last + 1)
        self._hour[hours % RECENT_COLUMNS] = np.nan

    def _widen_newest(self, number: int, extremes: Floats) -> None:
        """Add (2, c) extremes to column `number` of the minute, and to those that it belongs to."""
        for ring, wide in ((self._minute, 1), (self._hour, HOUR_COLUMN), (self._all, self._wide)):
            low, high = ring[number // wide % len(ring)]
            np.fmin(low, extremes[0], out=low)
            np.fmax(high, extremes[1], out=high)

    def _join_columns(self, last: int) -> None:
        """Double the columns of everything until column `last` of the minute fits."""
        while last // self._wide >= 2 * RECENT_COLUMNS:
            pairs = self._all.reshape(RECENT_COLUMNS, 2, 2, -1)
            half = np.stack(
                (np.fmin(*pairs[:, :, 0].swapaxes(0, 1)), np.fmax(*pairs[:, :, 1].swapaxes(0, 1))), 1
            )
            self._all = np.concatenate((half, np.full_like(half, np.nan)))
            self._wide *= 2

    def minute(self) -> EnvelopeColumns:
        """Return the columns of the last 60 s."""
        return self._last(self._minute, 1)

    def hour(self) -> EnvelopeColumns:
        """Return the columns of the last hour."""
        return self._last(self._hour, HOUR_COLUMN)

    def everything(self) -> EnvelopeColumns:
        """Return the columns since the first sample."""
        return self._last(self._all, self._wide)

    def _last(self, ring: Floats, wide: int) -> EnvelopeColumns:
        end = -(-self._n // (self.column * wide))
        numbers = np.arange(max(0, end - len(ring)), end)
        rows = ring[numbers % len(ring)]
        width = self.column * wide
        return EnvelopeColumns(int(numbers[0]) * width if len(numbers) else 0, width, rows[:, 0], rows[:, 1])

    def recent(self) -> RecentStatistics:
        """Return mean and standard deviation over the last minute."""
        count, total, square = self._sums.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = total / count
            variance = np.where(count > 1, (square - count * mean**2) / (count - 1), np.nan)
        return RecentStatistics(count, mean + self._offset, np.sqrt(np.maximum(variance, 0.0)))


def _coarser(extremes: Floats, wide: int, first: int, k: int) -> Floats:
    """Return (k, 2, c) extremes of columns that are `wide` times as long; `extremes` begin at `first`."""
    edges = np.arange(first // wide, first // wide + k) * wide - first
    edges[0] = 0
    out = np.empty((k, *extremes.shape[1:]))
    np.fmin.reduceat(extremes[:, 0], edges, axis=0, out=out[:, 0])
    np.fmax.reduceat(extremes[:, 1], edges, axis=0, out=out[:, 1])
    return out


def _widen(ring: Floats, first: int, last: int, new: int, extremes: Floats) -> None:
    """Add (k, 2, c) extremes to columns `first` to `last` of a ring; from `new` on, they replace old ones."""
    kept = max(first, last + 1 - len(ring))
    ring[_places(max(kept, new), last, len(ring))] = np.nan
    columns = _places(kept, last, len(ring))
    rows, added = ring[columns], extremes[kept - first :]
    np.fmin(rows[:, 0], added[:, 0], out=rows[:, 0])
    np.fmax(rows[:, 1], added[:, 1], out=rows[:, 1])
    ring[columns] = rows  # a copy if the columns wrap


def _places(first: int, last: int, size: int) -> slice | Ints:
    """Return the places of columns in a ring of that size: contiguous unless it wraps among them."""
    begin, k = first % size, last + 1 - first
    return slice(begin, begin + k) if begin + k <= size else np.arange(first, last + 1) % size
