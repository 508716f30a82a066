"""Warm-up: whether a sensor has come to rest after it was switched on.

Statistics begin with the first sample; nothing waits. A warm-up is recognised while it passes: at a few
candidate times (2, 5, 10, 20, 40 min) the slope of the mean before is compared with the slope behind, once
the record is two and a half times as long. If the mean drifted, and drifts clearly less now, what came
before was warm-up. Slopes are by generalised least squares against the fitted noise (`drift`), so a random
walk does not pass for one; a steady drift does not either.
"""

from __future__ import annotations

import numpy as np

from imumon.noise.history.drift import Drift, Slope

TIMES_S = (120.0, 300.0, 600.0, 1200.0, 2400.0)
ENOUGH = 2.5
"""A candidate is decided when the record is so many times as long."""
CHANGED = 5.0
"""Standard errors by which the slopes before and behind must differ."""
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


def warming(drift: Drift, temperature: int | None) -> bool:
    """Whether the temperature still rises: by `WARMING_DEGC` over the last tenth of the record, one minute at
    least, to where it never was before. A room that grows warm again is no warm-up."""
    if temperature is None or drift.elapsed_s < 120.0:
        return False
    span = max(60.0, 0.1 * drift.elapsed_s)
    rise = drift.change(temperature, drift.elapsed_s - span, drift.elapsed_s)
    return rise is not None and rise > WARMING_DEGC and drift.highest(temperature)
