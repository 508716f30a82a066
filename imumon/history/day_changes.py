"""Changes of a sensor over days: the daily rows of its history, tested for a step in N, B and the temperature slope.

A day counts once it is over, with at least an hour of samples, which B needs, and without the warm-up. The days of
several records are one series: it is the same sensor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from imumon.clock import REAL_TIME, HostClock
from imumon.coefficients import BIAS_TERMS, LIMIT_95
from imumon.history.store import TimedPeriod
from imumon.noise.stretches.change import LEAST_CHANGE
from imumon.noise.stretches.day_change import find_day_change
from imumon.report import Against, Change, stamp
from imumon.samples import sensor_of
from imumon.units import DAY, HOUR

DAYS_KEPT = 90
"""Days of the history that are compared. Unit: days.

Otherwise: an old step is reported again every day, and hides a new one. See `history_study.py`.
"""

AGAINST: Against = "history"
"""What such a change is a change against, in the report."""
SLOPE = BIAS_TERMS[0]


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
            self._find()
        return bool(counted)

    def _find(self) -> None:
        days = list(self._days.values())
        names = dict.fromkeys(name for day in days for name in day.period.channels)
        by_channel: dict[str, tuple[Change, ...]] = {}
        for name in names:
            if sensor_of(name) not in ("gyro", "accel", "mag"):
                continue
            letters = (*LEAST_CHANGE, SLOPE)
            changes = [change for letter in letters if (change := _change(days, name, letter)) is not None]
            if changes:
                by_channel[name] = tuple(changes)
        self.changes = by_channel


def _counts(timed: TimedPeriod, clock: HostClock) -> bool:
    period = timed.period
    length_s = min(clock.to_sample_s(timed.end - timed.begin), DAY)
    sampled_s = length_s * period.samples / max(period.samples + period.missing, 1)
    return period.step_s == DAY and period.complete and not period.warming_up and sampled_s >= HOUR


def _change(days: Sequence[TimedPeriod], name: str, letter: str) -> Change | None:
    """Return the step in a coefficient of a channel; None if there is none."""
    known, errors = [], []
    for day in days:
        channel = day.period.channels.get(name)
        part = channel.coefficients.get(letter) if channel is not None else None
        if part is not None and part.value and (width := (part.high or 0.0) - (part.low or 0.0)) > 0.0:
            known.append((day, part.value))
            errors.append(width / (2.0 * LIMIT_95))
    values = np.array([value for _, value in known], dtype=np.float64)
    heat = [day.period.temperature for day, _ in known]
    temperatures = np.array([math.nan if t is None else t for t in heat], dtype=np.float64)
    # a slope has an error that depends on the temperatures of the day; those of N and B are alike
    own_errors = np.array(errors, dtype=np.float64) if letter == SLOPE else None
    step = find_day_change(values, temperatures, LEAST_CHANGE.get(letter, 0.0), own_errors)
    if step is None:
        return None
    return Change(
        against=AGAINST,
        quantity=letter,
        before=step.before,
        now=step.now,
        ratio=None if letter == SLOPE else step.ratio,
        sigma=step.sigma,
        since=stamp(datetime.fromtimestamp(known[step.day][0].begin, UTC)),
        p_value=step.p_value,
    )
