"""Strip: least and greatest value of each channel in columns of time, for drawing a signal.

Three strips run together: the last minute in columns of half a second, the last hour in columns of half a
minute, and everything in at most 240 columns that double in length when they are full. The columns
of the last minute also carry sums, so that its mean and deviation stand beside those of everything.

Columns lie on the sample grid: any chunking gives the same columns, and a gap leaves empty ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.samples import Bools, Floats

COLUMN_S = 0.5
RECENT = 120
PER_HOUR_COLUMN = 60
EVERYTHING = 240


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Columns of equal length, oldest first; the last one may still be filling.

    Attributes
    ----------
    start : samples on the grid, begin of the first column.
    width : samples, length of a column.
    low, high : (k, c) channel unit; NaN where nothing came.
    """

    start: int
    width: int
    low: Floats
    high: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Recent:
    """Running figures of the last minute.

    Attributes
    ----------
    count : (c,) valid samples.
    mean, std : (c,) channel unit; NaN where `count` is 0 (below 2 for std).
    """

    count: Floats
    mean: Floats
    std: Floats


class Strip:
    """Columns of the last minute, the last hour, and everything.

    Parameters
    ----------
    groups : group of each channel, 0 ... g-1: validity is told by group.
    rate_hz : Hz, sampling rate.
    """

    def __init__(self, groups: Sequence[int], rate_hz: float) -> None:
        self._groups = list(groups)
        c = len(self._groups)
        self.column = max(1, round(COLUMN_S * rate_hz))
        self._n = 0  # samples on the grid
        self._offset: Floats | None = None  # (c,) near the values, so that sums lose no digits
        self._minute = np.full((RECENT, 2, c), np.nan)  # ring by column number: low, high
        self._sums = np.zeros((RECENT, 3, c))  # count, sum, sum of squares, about the offset
        self._hour = np.full((RECENT, 2, c), np.nan)
        self._all = np.full((EVERYTHING, 2, c), np.nan)
        self._wide = 1  # columns of the minute in one of everything

    def update(self, values: Floats, valid: Bools | None = None) -> None:
        """Take samples.

        Parameters
        ----------
        values : (n, c) channel unit.
        valid : (n, g); None: all.
        """
        n = len(values)
        if not n:
            return
        if self._offset is None:
            self._offset = np.where(np.isfinite(values[0]), values[0], 0.0)
        x = np.ascontiguousarray(values.T)
        ok = None
        if valid is not None and not valid.all():
            ok = np.ascontiguousarray(valid[:, self._groups].T)
        first, last = self._n // self.column, (self._n + n - 1) // self.column
        edges = np.maximum(np.arange(first, last + 1) * self.column - self._n, 0)
        low = np.minimum.reduceat(x if ok is None else np.where(ok, x, np.inf), edges, axis=1)
        high = np.maximum.reduceat(x if ok is None else np.where(ok, x, -np.inf), edges, axis=1)
        low[np.isinf(low)], high[np.isinf(high)] = np.nan, np.nan
        d = x - self._offset[:, None]
        if ok is not None:
            d[~ok] = 0.0
            count = np.add.reduceat(ok, edges, axis=1, dtype=np.float64)
        else:
            count = np.broadcast_to(np.diff(edges, append=n).astype(np.float64), low.shape)
        total = np.add.reduceat(d, edges, axis=1)
        np.multiply(d, d, out=d)
        square = np.add.reduceat(d, edges, axis=1)
        extremes = np.stack((low.T, high.T), axis=1)
        self._n += n
        self._fit(last)
        old = (self._n - n + self.column - 1) // self.column  # first column that begins in this block
        keep = slice(max(0, last + 1 - first - RECENT), None)
        numbers = np.arange(first, last + 1)[keep]
        fresh = numbers >= old
        self._minute[numbers[fresh] % RECENT] = np.nan
        self._sums[numbers[fresh] % RECENT] = 0.0
        _widen(self._minute, numbers % RECENT, extremes[keep])
        self._sums[numbers % RECENT] += np.stack((count.T, total.T, square.T), axis=1)[keep]
        self._coarser(self._hour, PER_HOUR_COLUMN, RECENT, first, last, old, extremes)
        self._coarser(self._all, self._wide, EVERYTHING, first, last, old, extremes)

    def skip(self, n: int) -> None:
        """`n` samples are missing."""
        first, last = -(-self._n // self.column), (self._n + n - 1) // self.column
        self._n += n
        if last < first:
            return
        self._fit(last)
        numbers = np.arange(max(first, last + 1 - RECENT), last + 1)
        self._minute[numbers % RECENT] = np.nan
        self._sums[numbers % RECENT] = 0.0
        hours = np.arange(-(-first // PER_HOUR_COLUMN), last // PER_HOUR_COLUMN + 1)[-RECENT:]
        self._hour[hours % RECENT] = np.nan

    def break_(self) -> None:
        """A gap of unknown length: drawn as none."""

    def _coarser(
        self, ring: Floats, wide: int, size: int, first: int, last: int, old: int, extremes: Floats
    ) -> None:
        """Put columns of the minute into the wider ones of `ring`."""
        begin, end = first // wide, last // wide
        edges = np.maximum(np.arange(begin, end + 1) * wide - first, 0)
        low = np.fmin.reduceat(extremes[:, 0], edges, axis=0)
        high = np.fmax.reduceat(extremes[:, 1], edges, axis=0)
        keep = slice(max(0, end + 1 - begin - size), None)
        numbers = np.arange(begin, end + 1)[keep]
        ring[numbers[numbers * wide >= old] % size] = np.nan
        _widen(ring, numbers % size, np.stack((low, high), axis=1)[keep])

    def _fit(self, last: int) -> None:
        """Double the columns of everything until column `last` of the minute has a place."""
        while last // self._wide >= EVERYTHING:
            pairs = self._all.reshape(EVERYTHING // 2, 2, 2, -1)
            half = np.stack(
                (np.fmin(*pairs[:, :, 0].swapaxes(0, 1)), np.fmax(*pairs[:, :, 1].swapaxes(0, 1))), 1
            )
            self._all = np.concatenate((half, np.full_like(half, np.nan)))
            self._wide *= 2

    def minute(self) -> Columns:
        """The last 60 s."""
        return self._last(self._minute, 1)

    def hour(self) -> Columns:
        """The last hour."""
        return self._last(self._hour, PER_HOUR_COLUMN)

    def everything(self) -> Columns:
        """All since the first sample."""
        return self._last(self._all, self._wide)

    def _last(self, ring: Floats, wide: int) -> Columns:
        end = -(-self._n // (self.column * wide))
        numbers = np.arange(max(0, end - len(ring)), end)
        rows = ring[numbers % len(ring)]
        width = self.column * wide
        return Columns(int(numbers[0]) * width if len(numbers) else 0, width, rows[:, 0], rows[:, 1])

    def recent(self) -> Recent:
        """Mean and deviation over the last minute."""
        count, total, square = self._sums.sum(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = total / count
            variance = np.where(count > 1, (square - count * mean**2) / (count - 1), np.nan)
        offset = 0.0 if self._offset is None else self._offset
        return Recent(count, mean + offset, np.sqrt(np.maximum(variance, 0.0)))

    def save(self) -> dict[str, np.ndarray]:
        """State as arrays."""
        out = {
            "minute": self._minute.copy(),
            "sums": self._sums.copy(),
            "hour": self._hour.copy(),
            "all": self._all.copy(),
            "numbers": np.array([self._n, self._wide], dtype=np.int64),
            "groups": np.array(self._groups),
            "column": np.array(self.column),
        }
        return out if self._offset is None else out | {"offset": self._offset.copy()}

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> Strip:
        """Continue where `save` left off."""
        self = cls(saved["groups"].tolist(), 1.0)
        self.column = int(saved["column"])
        self._minute, self._sums = saved["minute"].copy(), saved["sums"].copy()
        self._hour, self._all = saved["hour"].copy(), saved["all"].copy()
        self._n, self._wide = (int(v) for v in saved["numbers"])
        self._offset = saved["offset"].copy() if "offset" in saved else None
        return self


def _widen(ring: Floats, at: np.ndarray, extremes: Floats) -> None:
    """Let (k, 2, c) extremes into the rows of `ring`."""
    rows = ring[at]
    rows[:, 0] = np.fmin(rows[:, 0], extremes[:, 0])
    rows[:, 1] = np.fmax(rows[:, 1], extremes[:, 1])
    ring[at] = rows
