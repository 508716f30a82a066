"""Warm-up: whether a sensor has come to rest after it was switched on.

Statistics begin with the first sample; nothing waits. A warm-up is recognised when it has passed: at a few
candidate times (2, 5, 10, 20, 40 min), once the record is two and a half times as long, one of two things
shows that it ended there.

- The mean drifted before, and drifts clearly less behind. Slopes are by generalised least squares against
  the fitted noise (`drift`), so a random walk does not pass for one; a steady drift does not either.
- The mean settles along an exponential that was over by then (`decay`): this also sees what is faint, where
  the limits of K after so short a time would allow for as great a drift.

A warm-up that is not over is told, as long as it is plain: by a temperature that rises, or by a mean that
settles. What the temperature says need not show in the record, and then nothing is cut.
"""

from __future__ import annotations

import numpy as np

from imumon.noise.nonstationarity.drift import Drift, Slope
from imumon.noise.nonstationarity.settling import SettlingFit

TIMES_S = (120.0, 300.0, 600.0, 1200.0, 2400.0)
ENOUGH = 2.5
"""A candidate is decided when the record is so many times as long."""
CHANGED = 5.0
"""Standard errors by which the slopes before and behind must differ."""
OVER = (0.0625, 0.125, 0.25, 0.5)
"""Time constants of an exponential that is over at a candidate, as shares of its time: a seventh is left at
most."""
LASTING = (0.05, 0.1, 0.2, 0.35, 0.5)
"""Time constants of one that still bends the record, as shares of its length."""
LEAST_S = 120.0
"""s before which nothing is called warming up."""
SETTLED = 0.5
"""The slope behind is at most this share of the one before."""
WARMING_DEGC = 0.5
"""Rise of temperature over the last tenth of the time since the start, at least, that is called warming
up."""


def settles(before: Slope | None, behind: Slope | None) -> bool:
    """Whether a drift has clearly come to rest between two stretches."""
    if before is None or behind is None:
        return False
    # before, a line need not fit: a sensor that warms up settles along a curve
    error = float(np.hypot(before.least_error, behind.error))
    return abs(before.value - behind.value) > CHANGED * error and abs(behind.value) < SETTLED * abs(
        before.value
    )


def lasting(drift: Drift, column: int, begin_s: float) -> SettlingFit | None:
    """The decay in what counts of a channel, from `begin_s` on, that no cut has taken out; None where noise
    may be all."""
    length = drift.elapsed_s - begin_s
    if length < LEAST_S:
        return None
    times = [share * length for share in LASTING if share * length <= TIMES_S[-1]]
    found = drift.decay(column, times, begin_s) if times else None
    return found if found is not None and found.plain else None


def warming(drift: Drift, temperature: int | None) -> bool:
    """Whether the temperature still rises: by `WARMING_DEGC` over the last tenth of the record, one minute at
    least, to where it never was before. A room that grows warm again is no warm-up."""
    if temperature is None or drift.elapsed_s < LEAST_S:
        return False
    span = max(60.0, 0.1 * drift.elapsed_s)
    rise = drift.change(temperature, drift.elapsed_s - span, drift.elapsed_s)
    return rise is not None and rise > WARMING_DEGC and drift.highest(temperature)
