"""Stamps: which ticks of the sensor's grid the rows of a table are, by time stamps of whatever quality.

Stamps of a sensor step by whole ticks; the timeline places them one by one. Those of a host come late, each
by another delay: a scheduler, a bus that batches, a stall behind which many rows come at once. No step of
theirs tells much, but rows are late, not lost, if later ones catch up. So the least lateness of the next
second is looked at: it rises by whole ticks where samples were lost, and nowhere else.

This file knows no tables: times in, ticks out.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.samples import Floats, Ints

STEADY, MOSTLY = 0.1, 0.95
"""Stamps are a sensor's where that share of the steps is whole ticks within this part of one."""

WINDOWS = (16, 256)
"""Rows of the first look at the rate: more than a batch and fewer than from one lost sample to the next; many
where the delays are long. What leaves less unrest is right."""

EDGE = 256
"""Rows among which the least late is looked for while the rate is: more than come at once."""

SCARCE = 30.0
"""So many times longer than all single steps are the holes between them where rows come in bursts, and each
has the time of its arrival; a sensor that loses four of five samples has fewer."""

CRYSTAL = 1e-4
"""A rate as near as this to whole Hz is that: no two clocks agree better."""

DOUBTED = 0.01
"""Share of lost samples from which it is asked whether there were none, and the rate another."""

AHEAD_S = 1.0
"""A stall that is made up for within this is a delay; a longer one counts as lost samples."""

FEW = 10
"""Steps of stamps in batches that are too few to tell a rate: what came before the first and behind the last
is not known."""

ROUGH = 0.1
"""Unrest of the least lateness, ticks, from which a single lost sample cannot be told."""


def typical_step(times: Floats) -> float:
    """About the mean step within most stretches of rows, whether they come one by one or in batches.

    Parameters
    ----------
    times : (n,) in any unit, at least two of which one is greater than the one before.

    >>> typical_step(np.repeat(np.arange(20.0), 64)), typical_step(np.array([0.0, 1.0, 2.0, 90.0, 91.0]))
    (0.015625, 1.0)
    """
    count = len(times) - 1
    window = min(WINDOWS[1], max(1, count // 4))
    while window <= count:
        step = float(np.median(times[window:] - times[:-window])) / window
        if step > 0.0:
            return step
        window *= 4
    return float(np.maximum(np.diff(times), 0.0).mean())


def why_no_rate(times: Floats) -> str | None:
    """Why some times tell no rate; None where they do.

    Parameters
    ----------
    times : (n,) in any unit.
    """
    steps = np.diff(times)
    ahead = int((steps > 0.0).sum())
    if len(times) < 2:
        return "is of one row, and two are needed to tell a rate"
    if not ahead:
        return (
            "runs backwards, sort its rows by it"
            if (steps < 0.0).any()
            else "stands still: write it with more digits"
        )
    if 2 * ahead < len(steps) and ahead < FEW:
        return f"hardly steps, {ahead} in {len(times):,} rows: write it with more digits"
    return None


def interval_of(times: Floats) -> tuple[float, bool]:
    """Sampling interval, and whether the stamps are a sensor's.

    Parameters
    ----------
    times : (n,) ns, at least two that differ.

    Returns
    -------
    ns, and True where nearly all steps are whole ticks.
    """
    steps = np.diff(times)
    ahead = steps[steps > 0.0]
    shortest = float(np.quantile(ahead, 0.1, method="lower"))
    tick = float(ahead[ahead < 1.5 * shortest].mean())
    ticks = steps / tick
    steady = float(np.mean((np.abs(ticks - np.rint(ticks)) < STEADY) & (ticks > 0.5))) >= MOSTLY
    if steady and not _bursts(ticks):
        return _round(_refined(times, tick, 1)), True
    tried = []
    for window in {min(window, len(times) - 1) for window in WINDOWS}:
        tick = _densest(times[window:] - times[:-window]) / window
        if tick > 0.0:
            tried.append(_round(_refined(times, tick, window)))
    best = min(((_wrongness(times, tick), tick) for tick in tried), default=None)
    if best is None or (best[0] > (False, DOUBTED) and times[-1] > times[0]):
        level = _round(_level(times))
        best = min(((_wrongness(times, level), level), *([] if best is None else [best])))
    return best[1], False


def _bursts(ticks: Floats) -> bool:
    """Whether single steps are but the haste between rows that come at once; three holes are forgiven."""
    single = float(ticks[(ticks > 0.0) & (ticks < 1.5)].sum())
    return float(np.sort(ticks[ticks >= 1.5])[:-3].sum()) > SCARCE * single


def _level(times: Floats) -> float:
    """Interval at which the least lateness is as high at the end as at the begin: if no sample was lost."""
    rows, half = np.arange(len(times)), len(times) // 2
    tick = float(times[-1] - times[0]) / (len(times) - 1)
    for _ in range(4):
        edge = least_ahead(times / tick - rows, min(EDGE, max(1, half)))
        tick *= 1.0 + float(np.median(edge[half:] - edge[: len(edge) - half])) / max(1, half)
    return tick


def _wrongness(times: Floats, tick: float) -> tuple[bool, float]:
    """For comparing intervals: whether the least lateness leaves the grid, or falls, and by how much; where
    it does neither, how many samples must have been lost."""
    window = min(_window(tick), len(times) // 2)
    edge = least_ahead(times / tick - np.arange(len(times)), window)
    risen = edge[window:] - edge[:-window]
    off = float(np.minimum(np.abs(risen - np.maximum(np.rint(risen), 0.0)), 0.5).mean())
    return off > ROUGH, off if off > ROUGH else float(np.maximum(risen, 0.0).mean()) / window


def _densest(values: Floats) -> float:
    """Where most of them lie: ever the shortest half. Windows in which a sample was lost lie a tick above."""
    values = np.sort(values)
    while (half := len(values) // 2) > 1:
        at = int(np.argmin(values[half:] - values[:-half]))
        values = values[at : at + half + 1] if half + 1 < len(values) else values[at : at + half]
    return float(values.mean())


def _refined(times: Floats, tick: float, window: int) -> float:
    """Interval from ever longer windows, counted in ticks of the last: what is lost within counts too.

    Times are those of the least late, which is what a delay leaves of them.
    """
    rows = np.arange(len(times))
    while 2 * window < len(times):
        window *= 2
        least = (least_ahead(times / tick - rows, min(window, EDGE)) + rows) * tick
        spans = least[window:] - least[:-window]
        counts = np.rint(spans / tick)
        if (counts > 0.0).all():
            tick = float(np.median(spans / counts))
    return tick


def _round(tick: float) -> float:
    rate = 1e9 / tick
    near = round(rate)
    return 1e9 / near if near and abs(rate / near - 1.0) < CRYSTAL else tick


def _window(tick: float) -> int:
    """Rows of the next second."""
    return max(32, math.ceil(AHEAD_S * 1e9 / tick))


def _unrest(times: Floats, tick: float) -> float:
    """How far from whole ticks the least lateness mostly rises within a second; 0.25 is no grid at all."""
    window = min(_window(tick), len(times) // 2)
    edge = least_ahead(times / tick - np.arange(len(times)), window)
    risen = edge[window:] - edge[:-window]
    return float(np.median(np.abs(risen - np.rint(risen))))


class Late:
    """Rows of late stamps, given their ticks.

    Parameters
    ----------
    times : (n,) ns, the first rows, by which the unrest of the stamps is judged.
    tick : ns, the sampling interval.

    Attributes
    ----------
    rough : a single lost sample cannot be told, only a hole.
    back_s : s that the clock was put back by, in all.
    """

    def __init__(self, times: Floats, tick: float) -> None:
        self._tick = tick
        self._window = _window(tick)
        self.rough = _unrest(times, tick) > ROUGH
        self._least = 0.5 if not self.rough else max(5.0, 0.1e9 / tick)
        self._held = np.empty(0)
        self._rows = 0  # before the held ones
        self._lost = 0
        self._level: float | None = None
        self.back_s = 0.0

    def place(self, times: Floats, *, final: bool = False) -> Ints:
        """Samples lost before each row; those of the last second wait for what comes behind them.

        Parameters
        ----------
        times : (n,) ns, the next rows.
        final : no more will come.

        Returns
        -------
        (k,) for the oldest rows that waited.
        """
        times = np.concatenate([self._held, times])
        ready = len(times) if final else max(0, len(times) - self._window)
        late = times / self._tick - (self._rows + np.arange(len(times)))
        edge = least_ahead(late, self._window)[:ready]
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
            # clocks drift apart, slowly; what was early before is early at once
            self._level = level + (above if above < -0.5 else above / self._window)
        self._held, self._rows = times[ready:], self._rows + ready
        return lost


def least_ahead(values: Floats, window: int) -> Floats:
    """(n,) the least of each value and the window - 1 behind it.

    >>> least_ahead(np.array([3.0, 1.0, 2.0, 5.0, 4.0]), 2).tolist()
    [1.0, 1.0, 2.0, 4.0, 4.0]
    """
    padded = np.full((len(values) // window + 2) * window, np.inf)
    padded[: len(values)] = values
    pieces = padded.reshape(-1, window)
    to_end = np.minimum.accumulate(pieces[:, ::-1], axis=1)[:, ::-1].ravel()
    from_start = np.minimum.accumulate(pieces, axis=1).ravel()
    n = len(values)
    return np.asarray(np.minimum(to_end[:n], from_start[window - 1 : n + window - 1]))
