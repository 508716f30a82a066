"""Stamp kinds: which of several times the stamps of a stream are, and what places its rows.

The decision is taken in one place, `decide`, for streams and for recordings: a stream decides on its first rows and
again if later ones contradict (`live_stamps`), a recording on all rows of its first block. `KINDS` is the table of it.
To know another kind of stamps is to add a row.

A kind follows from what the stamps show (`StampEvidence`):

- The steps forward and back. A time that shows no rate is refused; the next candidate is then tried.
- The interval, and whether nearly all steps are whole intervals. Of a clock, the interval is the mean of the short
  steps, refined over longer and longer windows. Of a host, single steps say nothing, but a window of rows has about the
  same delay at both ends: the mode of (s(i + w) - s(i)) / w is the interval, because windows with a lost sample lie an
  interval above it. The mode is the half-sample mode (Bickel and Frühwirth 2006, Comput. Stat. Data Anal. 50:3500).
  Where samples are so often lost that most windows have one, single steps do: the line through the stamps, counted from
  the mode of the steps on, is another candidate (`interval.regression_interval`).
  The candidate that leaves the smallest delay on the grid, and loses the fewest samples, is used.
- The resolution to which the stamps are rounded.

Rows whose stamps stood still for a part of the record (`stuck_rows`) are no evidence of any kind.

This module reads no clock: times in, a decision out.

Example: a sensor at 100 Hz, stamped by its clock, and in batches of ten rows by a host.

>>> clock = 10_000_000 * np.arange(1000)
>>> batches = -(-clock // 100_000_000) * 100_000_000
>>> zero = np.zeros(1000, np.int64)
>>> for times in (clock, batches, zero):
...     decision = decide([StampCandidate(times)])
...     print(decision.kind.name, decision.interval)
clock 10000000.0
host 10000000.0
time_constant None
>>> decide([StampCandidate(zero), StampCandidate(clock, of_sensor=False)]).candidate
1
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imumon.grid.interval import (
    AMBIGUOUS,
    RATE_PRECISION,
    RATE_TOLERANCE,
    SINGLE_EXCESS,
    WHOLE,
    are_steady,
    regression_interval,
    round_to_hertz,
)
from imumon.grid.stamp_placement import (
    HostStamps,
    LateStamps,
    StampPlacer,
    delay_rise,
    sliding_minimum,
)
from imumon.model.samples import FASTEST_HZ, SLOWEST_HZ, Bools, Floats, Ints

FEW_STEPS = 10
"""Steps that are too few to show a rate: of batched stamps, the batches at both ends are incomplete."""

SHORT_WINDOW = 16
"""Rows of one of the two first estimates of the rate: more than a batch, fewer than from one lost sample to
the next. The estimate that fits better is used."""

LONG_WINDOW = 256
"""Rows of the other first estimate, for long delays, and among which the smallest delay is searched: more than arrive
at once."""

LINE_STEPS = 4096
"""Steps that are counted one by one for an estimate of the rate where samples are often lost."""

BURST_RATIO = 30.0
"""Ratio of the time in gaps to the time in single steps above which rows come in bursts and the stamps are
those of their arrival; a sensor that loses four of five samples has less."""

BURST_GAPS = 3
"""Longest gaps that do not count for this ratio."""

STUCK_RUNS = 4.0
"""Ratio of the length of a run of rows with one stamp to that of most runs, above which the stamps were stuck, chosen:
where rows arrive in batches, runs differ by less."""

LOSS_DOUBTED = 0.01
"""Share of lost samples above which an estimate without losses is tried as well."""


# ---------------------------------------------------------------- the table


def _place_as_stamped(stamps: Ints, interval: float) -> StampPlacer:
    """Return a placer that leaves each stamp as it is: no step is longer than an infinite interval."""
    return LateStamps(math.inf)


def _place_by_clock(stamps: Ints, interval: float) -> StampPlacer:
    return LateStamps(interval)


@dataclass(frozen=True, slots=True)
class StampKind:
    """A kind of stamps.

    Attributes
    ----------
    name : of one that shows no rate, also the code of the error in a recording.
    holds : whether some stamps are of this kind, if they are of none before it in `KINDS`.
    placer : what places rows with them, from the first stamps and the interval, ns.
    remark : what is wrong with them, for people; empty: nothing.
    """

    name: str
    holds: Callable[[StampEvidence], bool]
    placer: Callable[[Ints, float], StampPlacer] = _place_as_stamped
    remark: str = ""

    @property
    def has_rate(self) -> bool:
        """Whether they show an interval."""
        return self.placer is not _place_as_stamped

    @property
    def keeps_stamps(self) -> bool:
        """Whether rows keep their stamps, but for late ones; others are placed on an even grid."""
        return self.placer is not HostStamps


WITHOUT_STEPS = (
    StampKind("single_row", lambda shown: shown.rows < 2),
    StampKind("time_descending", lambda shown: not shown.forward and shown.backward > 0),
    StampKind("time_constant", lambda shown: not shown.forward),
    # rows in batches have few steps, too; only where there are fewer than ten batches they show no rate
    StampKind(
        "time_too_coarse", lambda shown: 2 * shown.forward < shown.rows - 1 and shown.forward < FEW_STEPS
    ),
)
"""Kinds of stamps that step too seldom to show a rate, in any unit."""

CLOCK = StampKind("clock", lambda shown: shown.of_sensor and shown.steady, _place_by_clock)
"""Stamps of a sample clock: whole intervals, but for single late ones, losses and wrong ones."""

KINDS = (
    *WITHOUT_STEPS,
    StampKind("time_rate_impossible", lambda shown: not SLOWEST_HZ <= 1e9 / shown.interval <= FASTEST_HZ),
    CLOCK,
    StampKind(
        "coarse", lambda shown: shown.coarse, HostStamps, "its time stamps are too coarse for its rate"
    ),
    StampKind(
        "host",
        lambda shown: True,
        HostStamps,
        "its time stamps are late or in batches, as those of a host",
    ),
)
"""Kinds of stamps: the first that holds applies."""


@dataclass(frozen=True, slots=True)
class StampCandidate:
    """Times of the first rows that may be their stamps.

    Attributes
    ----------
    times : (n,) ns since any moment; as floats, they have at most 53 bits.
    of_sensor : the sensor or its driver may have taken them; False: a host did when the rows came, so that they are
        never those of a sample clock, however even they look.
    """

    times: Ints | Floats
    of_sensor: bool = True


@dataclass(frozen=True, slots=True)
class StampDecision:
    """What the stamps of a stream are.

    Attributes
    ----------
    candidate : index of the times that are used; 0 if none shows a rate.
    kind : of these.
    interval : ns; None: they show no rate.
    """

    candidate: int
    kind: StampKind
    interval: float | None

    def placer(self, first: Ints) -> StampPlacer:
        """Return what places the rows.

        Parameters
        ----------
        first : (n,) ns, first stamps of the candidate.
        """
        return self.kind.placer(first, self.interval or math.inf)


def decide(candidates: Sequence[StampCandidate], resolution: float = 0.0) -> StampDecision:
    """Decide which of several times the stamps are, and of which kind.

    Parameters
    ----------
    candidates : the best first; the first that shows a rate is used.
    resolution : ns to which the times are rounded; 0: to much less than their steps.
    """
    first: StampKind | None = None
    for index, candidate in enumerate(candidates):
        shown = StampEvidence(candidate, resolution)
        kind = next(kind for kind in KINDS if kind.holds(shown))
        if kind.has_rate:
            return StampDecision(index, kind, shown.interval)
        first = first or kind
    assert first is not None
    return StampDecision(0, first, None)


class StampEvidence:
    """What some times show; the interval is estimated when a row of `KINDS` asks for it.

    Attributes
    ----------
    rows, forward, backward : rows, steps forward and steps back.
    of_sensor : see `StampCandidate`.
    """

    rows: int
    forward: int
    backward: int
    of_sensor: bool

    def __init__(self, candidate: StampCandidate, resolution: float) -> None:
        times = candidate.times
        # before the conversion: floats of nanoseconds since 1970 would have steps of 256 ns
        relative = (times - times[0]).astype(np.float64) if len(times) else np.empty(0)
        self._times = relative[~stuck_rows(relative)]
        self._resolution = resolution
        self.rows, self.of_sensor = len(times), candidate.of_sensor
        steps = np.diff(self._times)
        self.forward, self.backward = int((steps > 0.0).sum()), int((steps < 0.0).sum())

    @property
    def interval(self) -> float:
        """Sampling interval, ns, of times of which at least one steps forward."""
        return self._estimate[0]

    @property
    def steady(self) -> bool:
        """Whether nearly all steps are whole intervals."""
        return self._estimate[1]

    @property
    def coarse(self) -> bool:
        """Whether the resolution hides the interval."""
        return _is_coarse(self.interval, self._resolution)

    @cached_property
    def _estimate(self) -> tuple[float, bool]:
        return stamp_interval(self._times, self._resolution)


def stuck_rows(times: Floats) -> Bools:
    """Return (n,) which rows have the stamp of the row before because the clock stood still.

    Such rows are many more than arrive at once elsewhere, and no long step is before them, as after a stall. What their
    time was is not known: `SampleClock` places none of them.

    Parameters
    ----------
    times : (n,) in any unit.

    >>> ticks = np.arange(2000.0)
    >>> ticks[600:1000] = 600.0
    >>> int(stuck_rows(ticks).sum()), int(stuck_rows(np.ceil(np.arange(2000.0) / 300.0)).sum())
    (399, 0)
    """
    steps = np.diff(times)
    begins = np.concatenate([[0], np.flatnonzero(steps) + 1]) if len(times) else np.empty(0, np.int64)
    lengths = np.diff(np.append(begins, len(times)))
    stuck = np.zeros(len(times), dtype=bool)
    if len(begins) <= FEW_STEPS or not (steps > 0.0).any():
        return stuck
    longest = max(float(LONG_WINDOW), STUCK_RUNS * float(np.median(lengths)))
    step = float(np.median(steps[steps > 0.0])) / float(np.median(lengths))
    for begin, length in zip(begins[lengths > longest], lengths[lengths > longest], strict=True):
        before = float(steps[begin - 1]) if begin else 0.0
        if before < 0.5 * length * step:
            stuck[begin + 1 : begin + length] = True
    return stuck


def shows_rate(times: Floats) -> bool:
    """Return whether (n,) times, in any unit, show a rate, so that their unit can be inferred from it.

    The limits of a rate do not count: they need the unit.
    """
    shown = StampEvidence(StampCandidate(times), 0.0)
    return not any(kind.holds(shown) for kind in WITHOUT_STEPS)


# ---------------------------------------------------------------- the interval


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
        window *= 4  # all rows of most windows have one stamp
    return float(np.maximum(np.diff(times), 0.0).mean())


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
    forward = steps[steps > 0.0]
    shortest = float(np.quantile(forward, 0.1, method="lower"))  # the minimum may be that of a wrong stamp
    interval = float(forward[forward < (1.0 + SINGLE_EXCESS) * shortest].mean())
    counts = steps / interval
    # coarse stamps of 249 Hz in ms are steady, too: 4 ms, now and then 5 ms, a step that cannot be counted
    if are_steady(counts) and not _is_coarse(interval, resolution) and not _in_bursts(counts):
        return _near_hertz(_refined(times, interval, 1)), True
    candidates = []
    # where every window has a lost sample, single steps show the interval: most of them are one
    single = _half_sample_mode(forward)
    slope, error = regression_interval(steps[:LINE_STEPS], single)
    if error < RATE_TOLERANCE:
        candidates.append(_near_hertz(_refined(times, slope, SHORT_WINDOW)))
    for window in {min(window, len(times) - 1) for window in (SHORT_WINDOW, LONG_WINDOW)}:
        interval = _half_sample_mode(times[window:] - times[:-window]) / window
        if interval > 0.0:
            candidates.append(_near_hertz(_refined(times, interval, window)))
    best = min(((_misfit(times, interval), interval) for interval in candidates), default=None)
    # an interval that is too short explains any delay with losses: doubt it, unless the time runs back as a whole
    if best is None or (best[0] > (False, LOSS_DOUBTED) and times[-1] > times[0]):
        # a time that ends where it began, or before, has no mean interval: only single steps show one
        whole = _lossless_interval(times) if times[-1] > times[0] else float(np.median(forward))
        level = _near_hertz(whole)
        best = min(((_misfit(times, level), level), *([] if best is None else [best])))
    return best[1], False


def _is_coarse(interval: float, resolution: float) -> bool:
    """Return whether stamps of a resolution do not show an interval; both in ns."""
    return resolution >= AMBIGUOUS * interval


def _in_bursts(counts: Floats) -> bool:
    """Return whether single steps are only those between rows that arrive at once.

    Parameters
    ----------
    counts : (n,) steps, in intervals by the single ones.
    """
    single = float(counts[(counts > 0.0) & (counts < 1.0 + SINGLE_EXCESS)].sum())
    return float(np.sort(counts[counts >= 1.0 + SINGLE_EXCESS])[:-BURST_GAPS].sum()) > BURST_RATIO * single


def _lossless_interval(times: Floats) -> float:
    """Return the interval at which the smallest delay does not rise: as if no sample was lost."""
    rows, half = np.arange(len(times)), len(times) // 2
    interval = float(times[-1] - times[0]) / (len(times) - 1)
    for _ in range(4):  # which rows are the least delayed depends on the interval
        edge = sliding_minimum(times / interval - rows, min(LONG_WINDOW, max(1, half)))
        scaled = interval * (1.0 + float(np.median(edge[half:] - edge[: len(edge) - half])) / max(1, half))
        if scaled <= 0.0:  # one half does not step at all
            break
        interval = scaled
    return interval


def _misfit(times: Floats, interval: float) -> tuple[bool, float]:
    """Return, to compare intervals, whether the smallest delay leaves the grid or falls, and by how much; if
    it does neither, the share of lost samples."""
    rise, window = delay_rise(times, interval)
    off = float(np.minimum(np.abs(rise - np.maximum(np.rint(rise), 0.0)), 0.5).mean())
    return off > WHOLE, off if off > WHOLE else float(np.maximum(rise, 0.0).mean()) / window


def _half_sample_mode(values: Floats) -> float:
    """Return the half-sample mode of some values; windows with a lost sample lie an interval above it.

    >>> _half_sample_mode(np.array([1.0, 1.1, 1.05, 2.0, 5.0]))
    1.05
    """
    values = np.sort(values)
    while (half := len(values) // 2) > 1:
        start = int(np.argmin(values[half:] - values[:-half]))  # of the densest half
        values = values[start : start + half + 1] if half + 1 < len(values) else values[start : start + half]
    return float(values.mean())


def _refined(times: Floats, interval: float, window: int) -> float:
    """Return an interval from longer and longer windows, counted in intervals of the last estimate.

    Lost samples count. The times are those of the rows with the smallest delay.
    """
    rows = np.arange(len(times))
    while 2 * window < len(times):
        window *= 2  # the error of the last estimate must stay below half an interval over the window
        least = (sliding_minimum(times / interval - rows, min(window, LONG_WINDOW)) + rows) * interval
        spans = least[window:] - least[:-window]
        counts = np.rint(spans / interval)
        if (counts > 0.0).all():
            interval = float(np.median(spans / counts))
    return interval


def _near_hertz(interval: float) -> float:
    """Return the interval of a whole number of Hz if the rate is near to it, ns."""
    return round_to_hertz(interval * 1e-9, RATE_PRECISION) * 1e9
