"""Time stamps: the grid index of the rows of a table, from stamps of any quality.

Stamps of a sample clock step by whole intervals; `sample_clock` places them one by one. Stamps of a host are
late, each by another delay: a scheduler, a bus that batches, a stall after which many rows arrive at once. No
single step says much, but a row that is late is not lost if later rows catch up. So the smallest delay within
the next second decides: it rises by whole intervals where samples were lost, and nowhere else.

This module knows no tables: times in, grid steps out.
"""

from __future__ import annotations

import math
from typing import Literal, TypeAlias

import numpy as np

from imumon.samples import Floats, Ints
from imumon.timebase.interval import (
    AMBIGUOUS,
    RATE_PRECISION,
    SINGLE_EXCESS,
    WHOLE,
    are_steady,
    round_to_hertz,
)

RateObstacle: TypeAlias = Literal["single_row", "time_descending", "time_constant", "time_too_coarse"]
"""Why time stamps show no rate."""

SHORT_WINDOW = 16
"""Rows of one of the two first estimates of the rate: more than a batch, fewer than from one lost sample to
the next. The estimate that fits better is used."""

LONG_WINDOW = 256
"""Rows of the other first estimate, for long delays, and among which the smallest delay is searched: more than arrive
at once."""

BURST_RATIO = 30.0
"""Ratio of the time in gaps to the time in single steps above which rows come in bursts and the stamps are
those of their arrival; a sensor that loses four of five samples has less."""

BURST_GAPS = 3
"""Longest gaps that do not count for this ratio."""

LOSS_DOUBTED = 0.01
"""Share of lost samples above which an estimate without losses is tried as well."""

AHEAD_S = 1.0
"""s. A stall that is made up for within this time is a delay; a longer one counts as lost samples."""

AHEAD_ROWS = 32
"""Rows that are looked ahead at least."""

FEW_STEPS = 10
"""Steps that are too few to show a rate: of batched stamps, the batches at both ends are incomplete."""

ROUGH_LOSS = 5.0
"""Intervals by which the smallest delay must rise to be lost samples, where single losses do not show."""

ROUGH_LOSS_S = 0.1
"""s, at least, of a loss where single losses do not show."""


def typical_step(times: Floats) -> float:
    """Return the mean step within most stretches of rows, roughly, whether they come singly or in batches.

    Parameters
    ----------
    times : (n,) in any unit, at least two of which one is greater than the one before.

    >>> typical_step(np.repeat(np.arange(20.0), 64)), typical_step(np.array([0.0, 1.0, 2.0, 90.0, 91.0]))
    (0.015625, 1.0)
    """
    count = len(times) - 1
    window = min(LONG_WINDOW, max(1, count // 4))
    while window <= count:
        step = float(np.median(times[window:] - times[:-window])) / window
        if step > 0.0:
            return step
        window *= 4
    return float(np.maximum(np.diff(times), 0.0).mean())


def rate_obstacle(times: Floats) -> RateObstacle | None:
    """Return why some times show no rate; None if they do.

    Parameters
    ----------
    times : (n,) in any unit.
    """
    steps = np.diff(times)
    forward = int((steps > 0.0).sum())
    if len(times) < 2:
        return "single_row"
    if not forward:
        return "time_descending" if (steps < 0.0).any() else "time_constant"
    return "time_too_coarse" if 2 * forward < len(steps) and forward < FEW_STEPS else None


def stamp_interval(times: Floats, resolution: float = 0.0) -> tuple[float, bool]:
    """Return the sampling interval, and whether the stamps are those of a sample clock.

    Parameters
    ----------
    times : (n,) ns, at least two that differ.
    resolution : ns to which they are rounded; 0: to much less than their steps.

    Returns
    -------
    ns, and True if nearly all steps are whole intervals.
    """
    steps = np.diff(times)
    ahead = steps[steps > 0.0]
    shortest = float(np.quantile(ahead, 0.1, method="lower"))
    interval = float(ahead[ahead < (1.0 + SINGLE_EXCESS) * shortest].mean())
    counts = steps / interval
    if are_steady(counts) and not is_coarse(interval, resolution) and not _in_bursts(counts):
        return _near_hertz(_refined(times, interval, 1)), True
    candidates = []
    for window in {min(window, len(times) - 1) for window in (SHORT_WINDOW, LONG_WINDOW)}:
        interval = _half_sample_mode(times[window:] - times[:-window]) / window
        if interval > 0.0:
            candidates.append(_near_hertz(_refined(times, interval, window)))
    best = min(((_misfit(times, interval), interval) for interval in candidates), default=None)
    if best is None or (best[0] > (False, LOSS_DOUBTED) and times[-1] > times[0]):
        level = _near_hertz(_lossless_interval(times))
        best = min(((_misfit(times, level), level), *([] if best is None else [best])))
    return best[1], False


def is_coarse(interval: float, resolution: float) -> bool:
    """Return whether stamps of a resolution do not show an interval; both in ns."""
    return resolution >= AMBIGUOUS * interval


def _in_bursts(counts: Floats) -> bool:
    """Return whether single steps are only those between rows that arrive at once."""
    single = float(counts[(counts > 0.0) & (counts < 1.0 + SINGLE_EXCESS)].sum())
    return float(np.sort(counts[counts >= 1.0 + SINGLE_EXCESS])[:-BURST_GAPS].sum()) > BURST_RATIO * single


def _lossless_interval(times: Floats) -> float:
    """Return the interval at which the smallest delay does not rise: as if no sample was lost."""
    rows, half = np.arange(len(times)), len(times) // 2
    interval = float(times[-1] - times[0]) / (len(times) - 1)
    for _ in range(4):
        edge = sliding_minimum(times / interval - rows, min(LONG_WINDOW, max(1, half)))
        interval *= 1.0 + float(np.median(edge[half:] - edge[: len(edge) - half])) / max(1, half)
    return interval


def _rise(times: Floats, interval: float) -> tuple[Floats, int]:
    """Return (k,) intervals by which the smallest delay rises within a second, and the rows of a second."""
    window = min(_ahead(interval), len(times) // 2)
    edge = sliding_minimum(times / interval - np.arange(len(times)), window)
    return edge[window:] - edge[:-window], window


def _misfit(times: Floats, interval: float) -> tuple[bool, float]:
    """Return, to compare intervals, whether the smallest delay leaves the grid or falls, and by how much; if
    it does neither, the share of lost samples."""
    rise, window = _rise(times, interval)
    off = float(np.minimum(np.abs(rise - np.maximum(np.rint(rise), 0.0)), 0.5).mean())
    return off > WHOLE, off if off > WHOLE else float(np.maximum(rise, 0.0).mean()) / window


def _half_sample_mode(values: Floats) -> float:
    """Return the half-sample mode of some values; windows with a lost sample lie an interval above it."""
    values = np.sort(values)
    while (half := len(values) // 2) > 1:
        at = int(np.argmin(values[half:] - values[:-half]))
        values = values[at : at + half + 1] if half + 1 < len(values) else values[at : at + half]
    return float(values.mean())


def _refined(times: Floats, interval: float, window: int) -> float:
    """Return an interval from longer and longer windows, counted in intervals of the last estimate.

    Lost samples count. The times are those of the rows with the smallest delay.
    """
    rows = np.arange(len(times))
    while 2 * window < len(times):
        window *= 2
        least = (sliding_minimum(times / interval - rows, min(window, LONG_WINDOW)) + rows) * interval
        spans = least[window:] - least[:-window]
        counts = np.rint(spans / interval)
        if (counts > 0.0).all():
            interval = float(np.median(spans / counts))
    return interval


def _near_hertz(interval: float) -> float:
    """Return the interval of a whole number of Hz if the rate is near to it, ns."""
    return round_to_hertz(interval * 1e-9, RATE_PRECISION) * 1e9


def _ahead(interval: float) -> int:
    """Return the number of rows in the next second."""
    return max(AHEAD_ROWS, math.ceil(AHEAD_S * 1e9 / interval))


def _roughness(times: Floats, interval: float) -> float:
    """Return how far from whole intervals the smallest delay rises within a second; 0.25: no grid at all."""
    rise, _ = _rise(times, interval)
    return float(np.median(np.abs(rise - np.rint(rise))))


class HostStamps:
    """Counts the samples that were lost before each row, from the time stamps of a host.

    Parameters
    ----------
    times : (n,) ns, the first rows; they show whether single losses can be seen.
    interval : ns, the sampling interval.

    Attributes
    ----------
    rough : single lost samples do not show, only longer gaps.
    back_s : s by which the host clock stepped back, in total.
    """

    def __init__(self, times: Floats, interval: float) -> None:
        self._tick = interval
        self._window = _ahead(interval)
        self.rough = _roughness(times, interval) > WHOLE
        self._least = max(ROUGH_LOSS, ROUGH_LOSS_S * 1e9 / interval) if self.rough else SINGLE_EXCESS
        self._pending = np.empty(0)
        self._rows = 0  # before the pending ones
        self._lost = 0
        self._level: float | None = None
        self.back_s = 0.0

    @property
    def next_ns(self) -> float:
        """Time at which the next row would be stamped with the smallest delay, ns."""
        return (self._rows + self._lost + (self._level or 0.0)) * self._tick

    def place(self, times: Floats, *, final: bool = False) -> Ints:
        """Return the samples lost before each row; rows of the last second wait for those after them.

        Parameters
        ----------
        times : (n,) ns, the next rows.
        final : these are the last rows.

        Returns
        -------
        (k,) for the oldest rows that wait.
        """
        times = np.concatenate([self._pending, times])
        ready = len(times) if final else max(0, len(times) - self._window)
        late = times / self._tick - (self._rows + np.arange(len(times)))
        edge = sliding_minimum(late, self._window)[:ready]
        lost = np.zeros(ready, dtype=np.int64)
        for k, height in enumerate(edge.tolist()):
            level = height if self._level is None else self._level
            above = height - self._lost - level
            if above > self._least:
                lost[k] = round(above)
                self._lost += int(lost[k])
                above -= int(lost[k])
            if above < -self._window:
                self.back_s -= above * self._tick * 1e-9
            # clocks drift apart slowly; a row that is early shows a smaller delay at once
            self._level = level + (above if above < -SINGLE_EXCESS else above / self._window)
        self._pending, self._rows = times[ready:], self._rows + ready
        return lost


def sliding_minimum(values: Floats, window: int) -> Floats:
    """Return (n,) the smallest of each value and the window - 1 after it.

    >>> sliding_minimum(np.array([3.0, 1.0, 2.0, 5.0, 4.0]), 2).tolist()
    [1.0, 1.0, 2.0, 4.0, 4.0]
    """
    padded = np.full((len(values) // window + 2) * window, np.inf)
    padded[: len(values)] = values
    blocks = padded.reshape(-1, window)
    to_end = np.minimum.accumulate(blocks[:, ::-1], axis=1)[:, ::-1].ravel()
    from_start = np.minimum.accumulate(blocks, axis=1).ravel()
    n = len(values)
    return np.asarray(np.minimum(to_end[:n], from_start[window - 1 : n + window - 1]))
