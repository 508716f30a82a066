"""Sampling interval: its estimate from the steps between time stamps, and changes of it.

The package has the model. The steps s(i) - s(i - 1) hold the interval T, but jitter, gaps and duplicates too:

- A mean over single steps is biased: a step that jitter makes long looks like a lost sample and is left out. So every
  sample gets an index first, by the steps that can be counted, and T is the slope of the line through the stamps over
  the index (`regression_interval`).
- A step of n intervals can be counted if n times the relative error of T is far below one interval. Where it cannot, a
  new line with the same slope begins. Each pass makes T more precise, so that longer steps can be counted.
- A step near half an interval is decided by the mean deviation of the samples before from the grid (`phase`).
- The clock of a device may have a tick of which T is a multiple; the multiple is then exact (`common_multiple`).
- A rate within its own standard error of a whole number of hertz is that number (`round_to_hertz`).

Example: steps of a clock at 1 Hz with jitter, of which one is a gap of six lost samples.

>>> interval, error = regression_interval(np.array([0.9, 1.1, 1.0, 7.0, 1.0]), guess=1.04)
>>> abs(interval - 1.0) < 0.01, error < 0.05
(True, True)
"""

from __future__ import annotations

import numpy as np

from imumon.model.samples import Floats, Ints

RATE_PRECISION = 1e-4
"""Relative standard error at which a learned interval is good enough: it moves N by 0.005 %."""

RATE_TOLERANCE = 0.02
"""Share by which a rate may differ from a nominal one, or a sample clock from the host clock: less than between the
neighbouring output rates of any device."""

CLOCK_SLACK_S = 10.0
"""s by which a clock may differ from the host clock over a time, beside `RATE_TOLERANCE` of it, or step over the wrap
of its counter: with more, it was set or has restarted."""

SIGNIFICANT = 3.0
"""Standard errors by which a learned interval differs from a nominal one, or from whole Hz."""

SINGLE_EXCESS = 0.5
"""Intervals by which a step may exceed one, or the smallest delay may rise, before a sample is missing."""

RATE_CHANGE_STEPS = 64
"""Equal steps in a row that are not one interval, after which the rate of the device has changed. Jitter
does not make them all longer, or all shorter. They need not be whole intervals: from 100 Hz to 80 Hz they are 1.25."""

BURST_STEP = 0.025
"""Intervals; shorter steps are a burst and no change of rate."""

PASSES = 8
"""Passes of counting and fitting; two are enough without jitter."""

GUESS_ERROR = 0.15
"""Share by which the first guess of an interval may be wrong."""

WHOLE = 0.1
"""Intervals, or ticks, by which a length may differ from a whole number of them and be one."""

STEADY_SHARE = 0.95
"""Share of steps that must be whole intervals for the stamps to be those of a sample clock."""

AMBIGUOUS = 0.25
"""Intervals by which a step may be off a whole number, or uncertain, so that it can be counted. A step further off
is decided by the samples before."""

REFERENCE_SAMPLES = 16
"""Samples over which the deviation from the grid is averaged for such a step: enough to make its jitter
small, few enough that an error of the interval does not show. Samples before a gap of more intervals are no
reference, because the error of the interval adds up in it."""

ROUNDING = 1e-9
"""Relative error of arithmetic and of stamps in whole ns."""


def estimate_interval(
    steps: Floats, nominal_s: float | None, tick_s: float | None, *, last: bool
) -> float | None:
    """Return the interval of a clock, s; None if more steps are needed.

    Parameters
    ----------
    steps : (n,) s between consecutive time stamps, in order, at least one of them positive.
    nominal_s : s, nominal interval; None: there is none.
    tick_s : s, tick of the clock, of which the interval is a multiple; None: there is none.
    last : return an estimate however imprecise.
    """
    positive = steps[steps > 0.0]
    shortest = _shortest(positive)
    singles = positive[positive < (1.0 + SINGLE_EXCESS) * shortest]
    # steps that are whole nominal intervals start the count there, even if every other sample is lost
    guess = nominal_s if nominal_s is not None and are_steady(positive / nominal_s) else None
    if tick_s is not None and (multiple := guess or common_multiple(singles, tick_s)):
        return multiple
    interval, error = regression_interval(steps, guess or float(np.mean(singles)))
    if error > RATE_PRECISION and not last:
        return None
    # however wide the error, another output rate of the device must not pass for the nominal one
    tolerance = min(max(SIGNIFICANT * error, RATE_PRECISION), RATE_TOLERANCE)
    if nominal_s is not None and abs(interval / nominal_s - 1.0) <= tolerance:
        return nominal_s
    return round_to_hertz(interval, min(SIGNIFICANT * error, RATE_PRECISION))


def is_nominal(steps: Floats, nominal_s: float, tick_s: float | None) -> bool:
    """Return whether all of (n,) steps, s, are the nominal interval, as far as the tick of the clock shows."""
    # with a tick, the interval is one of few multiples, and a step near one is that one
    share = RATE_PRECISION if tick_s is None else RATE_TOLERANCE
    return bool((np.abs(steps / nominal_s - 1.0) < share).all())


def counter_unit(steps: Floats, tick_s: float | None) -> float:
    """Return the unit of a counter, s: the tick of the device or a microsecond.

    >>> counter_unit(np.full(9, 20.0), 1 / 800), counter_unit(np.full(9, 5000.0), 1 / 800)
    (0.00125, 1e-06)
    """
    # read as microseconds, its steps would be shorter than a tick, which the device cannot make
    if tick_s is not None and _shortest(steps[steps > 0.0]) * 1e-6 < (1.0 - WHOLE) * tick_s:
        return tick_s
    return 1e-6


def _shortest(steps: Floats) -> float:
    """Return about the shortest of (n,) positive steps: samples may be missing between the others."""
    return float(np.quantile(steps, 0.1, method="lower"))


def regression_interval(steps: Floats, guess: float) -> tuple[float, float]:
    """Return the interval of a grid by linear regression, and its relative standard error.

    Parameters
    ----------
    steps : (n,) s between consecutive time stamps, in order; jitter, gaps and duplicates may be among them.
    guess : s, within about `GUESS_ERROR`.
    """
    time = np.concatenate([[0.0], np.cumsum(steps)])
    interval, uncertain, error = guess, GUESS_ERROR, float("inf")
    for _ in range(PASSES):
        counts = _counts(time, interval, settled=error < GUESS_ERROR)
        # a single step is counted however uncertain the interval is; the error of a long one grows with its length
        countable = (counts >= 1.0) & ((counts == 1.0) | (counts * uncertain < AMBIGUOUS))
        line = np.concatenate([[0], np.cumsum(~countable)])  # number of the line of each sample
        index = np.concatenate([[0.0], np.cumsum(np.where(countable, counts, 0.0))])
        x, y = _centred(index, line), _centred(time, line)
        spread = float(x @ x)
        if spread == 0.0:
            break  # no step can be counted: the guess is all that is known
        interval = float(x @ y) / spread
        freedom = len(time) - int(line[-1]) - 2  # a mean of each line, and the slope
        if freedom > 0:
            error = float(np.sqrt(np.sum((y - interval * x) ** 2) / freedom / spread)) / interval
            # four standard errors; not at once, because wrong counts may fit a wrong interval well
            uncertain = max(4.0 * error, uncertain / 4.0)
    return interval, error


def _counts(time: Floats, interval: float, *, settled: bool) -> Floats:
    """Return (n - 1,) intervals between (n,) time stamps; `settled`: the interval is no guess any more."""
    exact = np.diff(time) / interval
    counts = np.rint(exact)
    if settled:
        for k in np.flatnonzero(np.abs(exact - counts) > AMBIGUOUS).tolist():
            start = max(0, k + 1 - REFERENCE_SAMPLES)
            before = counts[start - 1 : k] if start else np.concatenate([[1.0], counts[:k]])
            counts[k] = np.rint(exact[k] - phase(time[start : k + 1], before, 1.0 / interval))
    return counts


def phase(time: Floats | Ints, steps: Floats | Ints, scale: float) -> float:
    """Return the mean deviation of some samples from the grid through the last one, intervals.

    Parameters
    ----------
    time : (n,) units of a clock, the last samples, at most `REFERENCE_SAMPLES`.
    steps : (n,) intervals before each.
    scale : intervals in a unit of the clock.

    >>> round(phase(np.array([0.0, 1.0, 2.0, 3.4]), np.ones(4), 1.0), 6)
    -0.3
    """
    if len(time) < 2:
        return 0.0
    unusable = np.flatnonzero((steps[1:] < 1) | (steps[1:] > REFERENCE_SAMPLES))
    start = int(unusable[-1]) + 1 if len(unusable) else 0
    behind = np.append(np.cumsum(steps[start + 1 :][::-1])[::-1], 0)  # intervals from each to the last
    return float(np.mean(behind - (time[-1] - time[start:]) * scale))


def _centred(values: Floats, line: Ints) -> Floats:
    """Return values less the mean of their line."""
    means: Floats = np.bincount(line, values) / np.bincount(line)
    return values - means[line]


def round_to_hertz(interval_s: float, tolerance: float) -> float:
    """Return the interval of a whole number of Hz if the relative difference is within the tolerance.

    >>> round_to_hertz(0.00990098, 1e-4) == 1 / 101, round_to_hertz(1 / 199.9, 1e-4) == 1 / 199.9
    (True, True)
    """
    rate = 1.0 / interval_s
    near = round(rate)
    return 1.0 / near if near and abs(rate / near - 1.0) <= max(tolerance, ROUNDING) else interval_s


def common_multiple(steps: Floats, tick_s: float) -> float | None:
    """Return the multiple of a tick that all of (n,) steps, s, are near to; None: they differ.

    Steps of different multiples are those of stamps that are rounded to the tick, of a clock that does not have it.

    >>> common_multiple(np.array([0.0251, 0.0249]), 0.00125), common_multiple(np.array([0.009, 0.010]), 0.001)
    (0.025, None)
    """
    ticks = steps / tick_s
    near = round(float(np.mean(ticks)))
    if (
        near < 1
        or (np.rint(ticks) != near).any()
        or abs(float(np.mean(ticks)) - near) >= min(WHOLE, RATE_TOLERANCE * near)
    ):
        return None
    return near * tick_s


def are_steady(steps: Floats) -> bool:
    """Return whether nearly all of (n,) steps, intervals, are whole."""
    return bool(np.mean((np.abs(steps - np.rint(steps)) < WHOLE) & (steps > 0.5)) >= STEADY_SHARE)


class RateChange:
    """Finds where the rate of a stream changes: many equal steps in a row, none of them one interval."""

    def __init__(self) -> None:
        self._count = 0  # steps in a row that were the same, and not one interval
        self._last = 1.0  # intervals, the last of them

    def find(self, steps: Floats) -> int | None:
        """Return which of (n,) steps, intervals, is the last that shows a new rate; None: none."""
        other = (np.abs(steps - 1.0) > RATE_TOLERANCE) & (steps > BURST_STEP)
        if not other.any():
            self._count, self._last = 0, 1.0
            return None
        follows = np.concatenate(([self._count > 0], other[:-1]))
        same = other & follows & (np.abs(np.diff(steps, prepend=self._last)) < WHOLE)
        # length of the run of equal steps that ends in each step: from where the run began, without a loop
        places = np.arange(1, len(same) + 1)
        starts = np.maximum.accumulate(np.where(same, 0, places))  # 0: the run began in an earlier block
        lengths = np.where(
            starts > 0, places - starts + other[np.maximum(starts - 1, 0)], self._count + places
        )
        lengths = np.where(other, lengths, 0)
        reached = np.flatnonzero(lengths >= RATE_CHANGE_STEPS)
        if len(reached):
            return int(reached[0])
        self._count, self._last = int(lengths[-1]), float(steps[-1])
        return None
