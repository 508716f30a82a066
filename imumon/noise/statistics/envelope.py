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
        self._minute = np.full(
            (RECENT_COLUMNS, 2, c), np.nan
        )  # ring by column number: low, and high with its sign changed
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
        for side, signed in enumerate((x, -x)):
            seen = signed if ok is None else np.where(ok, signed, np.inf)
            np.minimum.reduceat(seen, edges, axis=1, out=extremes[:, side].T)
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
        self._add(np.arange(first, last + 1), new, extremes, sums)

    def skip(self, n: int) -> None:
        """Note that `n` samples are missing."""
        first, last = -(-self._n // self.column), (self._n + n - 1) // self.column
        self._n += n
        if last >= first:
            # of a long gap, the last hour
            columns = np.arange(max(first, last + 1 - RECENT_COLUMNS * HOUR_COLUMN), last + 1)
            c = len(self._groups)
            self._add(columns, first, np.full((len(columns), 2, c), np.nan), np.zeros((len(columns), 3, c)))

    def _add(self, columns: Ints, new: int, extremes: Floats, sums: Floats) -> None:
        """Add extremes (k, 2, c) and sums (k, 3, c) to columns (k,) of the minute; those from `new` on begin."""
        self._join_columns(int(columns[-1]))
        rings = (self._minute, 1), (self._hour, HOUR_COLUMN), (self._all, self._wide), (self._sums, 1)
        for ring, wide in rings:
            numbers, empty = columns // wide, 0.0 if ring is self._sums else np.nan
            kept = numbers > numbers[-1] - len(ring)  # a long block overwrites its own first columns
            ring[numbers[kept & (numbers >= -(-new // wide))] % len(ring)] = empty
            places = numbers[kept] % len(ring)
            if ring is self._sums:
                ring[places] += sums[kept]
            else:
                np.fmin.at(ring, places, extremes[kept])

    def _join_columns(self, last: int) -> None:
        """Double the columns of everything until column `last` of the minute fits."""
        while last // self._wide >= 2 * RECENT_COLUMNS:
            half = np.fmin(self._all[::2], self._all[1::2])
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
        return EnvelopeColumns(int(numbers[0]) * width if len(numbers) else 0, width, rows[:, 0], -rows[:, 1])

    def recent(self) -> RecentStatistics:
        """Return mean and standard deviation over the last minute."""
        count, total, square = self._sums.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = total / count
            variance = np.where(count > 1, (square - count * mean**2) / (count - 1), np.nan)
        return RecentStatistics(count, mean + self._offset, np.sqrt(np.maximum(variance, 0.0)))
