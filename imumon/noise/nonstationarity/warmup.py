"""Warm-up: whether a sensor has settled after it was switched on.

Statistics begin with the first sample; nothing waits. A warm-up is recognised after it has passed: at a few
candidate times (2, 5, 10, 20, 40 min), once the record is two and a half times as long, it has ended there if
one of two things holds.

- The mean drifted before and drifts clearly less after. Slopes are by generalised least squares against the
  fitted noise (`drift`), so a random walk is not mistaken for one, nor is a steady drift.
- The mean settles along an exponential that is over by then (`settling`). This also detects what is faint,
  where the limits of K after so short a time would allow for as great a drift.

A warm-up that is not over is reported while it is clear: by a rising temperature, or by a mean that settles.
What the temperature shows need not show in the record, and then nothing is excluded.
"""

from __future__ import annotations

import numpy as np

from imumon.noise.nonstationarity.drift import DriftAccumulator, Slope
from imumon.noise.nonstationarity.settling import SettlingFit

CANDIDATES_S = (120.0, 300.0, 600.0, 1200.0, 2400.0)
"""s, possible ends of a warm-up: a finer grid would exclude little less."""
DECISION_LENGTH = 2.5
"""Length of the record, as a multiple of a candidate, at which the candidate is decided: later, the slope
after it is known better, but the results carry the warm-up for longer."""
CHANGED_SIGMA = 5.0
"""Standard errors by which the slopes before and after must differ."""
SETTLED_SLOPE = 0.5
"""Ratio of the slope after to the slope before, at most, for a warm-up that is over."""
OVER_SHARES = (0.0625, 0.125, 0.25, 0.5)
"""Time constants of an exponential that is over at a candidate, as shares of its time: at most a seventh is
left."""
LASTING_SHARES = (0.05, 0.1, 0.2, 0.35, 0.5)
"""Time constants of an exponential that still bends the record, as shares of its length."""
LEAST_WARMUP_S = 120.0
"""s, record below which nothing is called a warm-up. Not critical."""
WARMING_DEGC = 0.5
"""degC, least rise of the temperature over the last tenth of the record that is called warming up."""
WARMING_SHARE = 0.1
"""Share of the record over which the rise counts. Not critical."""
WARMING_S = 60.0
"""s, shortest time over which the rise counts. Not critical."""


def has_settled(before: Slope | None, after: Slope | None) -> bool:
    """Return whether a drift has clearly ended between two stretches."""
    if before is None or after is None:
        return False
    # before, a line need not fit: a sensor that warms up settles along a curve
    error = float(np.hypot(before.least_error, after.error))
    changed = abs(before.value - after.value) > CHANGED_SIGMA * error
    return changed and abs(after.value) < SETTLED_SLOPE * abs(before.value)


def find_settling(drift: DriftAccumulator, column: int, begin_s: float) -> SettlingFit | None:
    """Return the exponential along which a channel still settles after `begin_s`; None if noise explains
    it."""
    length = drift.elapsed_s - begin_s
    if length < LEAST_WARMUP_S:
        return None
    times = [share * length for share in LASTING_SHARES if share * length <= CANDIDATES_S[-1]]
    found = drift.settling(column, times, begin_s) if times else None
    return found if found is not None and found.significant else None


def is_warming_up(drift: DriftAccumulator, temperature: int | None) -> bool:
    """Return whether the temperature still rises to where it never was before.

    It must rise by `WARMING_DEGC` over the last tenth of the record, at least over a minute. A room that
    grows warm again is no warm-up.
    """
    if temperature is None or drift.elapsed_s < LEAST_WARMUP_S:
        return False
    span = max(WARMING_S, WARMING_SHARE * drift.elapsed_s)
    rise = drift.mean_change(temperature, drift.elapsed_s - span, drift.elapsed_s)
    return rise is not None and rise > WARMING_DEGC and drift.is_highest(temperature)
