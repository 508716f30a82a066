"""Changes of a sensor over days: each day of its history is compared with the days before it.

The limits of a fit say how well a day determines N, if the sensor is constant. Real sensors scatter more from day to
day, and only that scatter says whether a difference is one. So the days before are known as well as they predict a
further day: by their mean, with the error sqrt(1 + 1/n) of their standard deviation, and n - 1 degrees of freedom.
Days that resemble their neighbours differ from the mean of all by more than from each other, so a sensor that wanders
makes no changes: of 1,000 random walks of 30 days, at most three have one.

A day counts once it is over, with at least an hour of samples, which B needs, and without the warm-up. The days of
several records are one series: it is the same sensor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from imumon.history.store import TimedPeriod
from imumon.model.coefficients import BIAS_SLOPE, LIMIT_95, Estimate
from imumon.model.report import Against, Change, stamp
from imumon.model.samples import ChannelName
from imumon.model.units import DAY, HOUR
from imumon.noise.stretches.change import LEAST_CHANGE, CoefficientChange, compare
from imumon.sources.clock import REAL_TIME, HostClock

AGAINST: Against = "history"
"""What such a change is a change against, in the report."""
SLOPE = BIAS_SLOPE
DAYS_BEFORE = 7
"""Days that must precede one that is compared: the scatter of fewer is not known."""
DAYS_KEPT = 90
"""Days that are compared. Otherwise: an old step hides a new one."""
LEAST_SCATTER = 2e-3
"""Scatter of N and B between days that is assumed at least, as a share: days that agree by chance make any difference a
change."""


class DayChanges:
    """The days of one sensor, and the changes that they show.

    Parameters
    ----------
    clock : of the host.

    Attributes
    ----------
    changes : by channel.
    """

    def __init__(self, clock: HostClock = REAL_TIME) -> None:
        self._clock = clock
        self._days: dict[tuple[str, int], TimedPeriod] = {}
        self.changes: dict[str, tuple[Change, ...]] = {}

    def add(self, days: Sequence[TimedPeriod]) -> bool:
        """Add periods of which days that are over count; return whether there were any."""
        counted = [day for day in days if _counts(day, self._clock)]
        for day in counted:
            self._days[day.record, day.period.number] = day
        kept = sorted(self._days.items(), key=lambda item: item[1].begin)[-DAYS_KEPT:]
        self._days = dict(kept)
        if counted:
            self._compare()
        return bool(counted)

    def _compare(self) -> None:
        days = list(self._days.values())
        names = dict.fromkeys(name for day in days for name in day.period.channels)
        graded = [name for name in names if name.sensor in ("gyro", "accel", "mag")]
        letters = (*LEAST_CHANGE, SLOPE)
        pairs = len(graded) * len(letters) * max(1, len(days) - DAYS_BEFORE)
        self.changes = {}
        for name in graded:
            changes = (_change(days, name, letter, pairs) for letter in letters)
            if known := tuple(change for change in changes if change is not None):
                self.changes[name] = known


def _counts(timed: TimedPeriod, clock: HostClock) -> bool:
    period = timed.period
    length_s = min(clock.to_sample_s(timed.end - timed.begin), DAY)
    sampled_s = length_s * period.samples / max(period.samples + period.missing, 1)
    return period.step_s == DAY and period.complete and not period.warming_up and sampled_s >= HOUR


def _change(days: Sequence[TimedPeriod], name: ChannelName, letter: str, pairs: int) -> Change | None:
    """Return the least likely change of a coefficient of a channel; None if no day differs from those before."""
    parts = [
        (day, day.period.channels[name].coefficients.get(letter))
        for day in days
        if name in day.period.channels
    ]
    known = [(day, part) for day, part in parts if part is not None and part.value and part.low != part.high]
    changes: list[tuple[CoefficientChange, TimedPeriod]] = []
    for number in range(DAYS_BEFORE, len(known)):
        day, part = known[number]
        before = _predicted([part for _, part in known[:number]], 0.0 if letter == SLOPE else LEAST_SCATTER)
        if (change := compare(letter, before, part, pairs=pairs, dof=number - 1)) is not None:
            changes.append((change, day))
    if not changes:
        return None
    change, day = min(changes, key=lambda item: (item[0].p_value, item[1].begin))
    return Change(
        against=AGAINST,
        quantity=letter,
        before=change.before,
        now=change.now,
        ratio=None if letter == SLOPE else change.ratio,
        sigma=change.sigma,
        since=stamp(datetime.fromtimestamp(day.begin, UTC)),
        p_value=change.p_value,
    )


def _predicted(days: Sequence[Estimate], least: float) -> Estimate:
    """Return what some days predict of a further one, with its 95 % limits as of a normal distribution.

    Parameters
    ----------
    least : least scatter of the days, as a share of their mean.
    """
    values = np.array([day.value for day in days], dtype=np.float64)
    mean = float(values.mean())
    scatter = max(float(values.std(ddof=1)), least * abs(mean))
    width = LIMIT_95 * scatter * math.sqrt(1.0 + 1.0 / len(values))
    return Estimate(value=mean, low=mean - width, high=mean + width, status="measured")
