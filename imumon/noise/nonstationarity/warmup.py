"""Warm-up: whether a sensor has settled after it was switched on.

Statistics begin with the first sample; nothing waits. A warm-up is recognised afterwards: once the record is
two and a half times as long as a candidate time (2, 5, 10, 20, 40, 60, 90 min), a warm-up has ended there if one
of three conditions holds.

- The mean drifts clearly less after it than before. Slopes are by generalised least squares against the
  fitted noise (`drift`), so neither a random walk nor a steady drift is mistaken for a warm-up.
- The mean settles along an exponential that is over by then (`settling`). This also detects faint warm-ups
  that the limits of K after a short time allow for.

A warm-up that is not over is reported as long as it is clear: by a rising temperature, or by a mean that
settles. The temperature alone excludes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.noise.nonstationarity.drift import DriftAccumulator, Slope
from imumon.noise.nonstationarity.early_walk import early_walk_probability

CANDIDATES_S = (120.0, 300.0, 600.0, 1200.0, 2400.0, 3600.0, 5400.0)
"""s, possible ends of a warm-up: a finer grid would exclude little less."""
DECISION_LENGTH = 2.5
"""Length of the record, as a multiple of a candidate, at which the candidate is decided: later, the slope
after it is more precise, but the results include the warm-up for longer. Not critical."""
CHANGED_SIGMA = 5.0
"""Standard errors by which the slopes before and after must differ. Not critical."""
SETTLED_SLOPE = 0.5
"""Ratio of the slope after to the slope before, at most, for a warm-up that is over. Not critical."""
EARLY_PROBABILITY = 5e-4
"""Probability, without a warm-up, of an early walk that counts: seven candidates are decided once. Not
critical."""
LASTING_PROBABILITY = 5e-5
"""The same for a warm-up that is not over, which is sought again whenever the record has grown. Not critical."""
EARLY_SHARES = (0.15, 0.3, 0.5)
"""Ends of an early walk that is not excluded, as shares of the record."""
LONGEST_WARMUP_S = 7200.0
"""s, longest time after which a sensor may still warm up. Not critical."""
OVER_SHARES = (0.0625, 0.125, 0.25, 0.5)
"""Time constants of an exponential that is over at a candidate, as shares of its time: at most a seventh
remains."""
LASTING_SHARES = (0.05, 0.1, 0.2, 0.35, 0.5)
"""Time constants of an exponential that still bends the record, as shares of its length."""
LEAST_WARMUP_S = 120.0
"""s, shortest record in which a warm-up is sought. Not critical."""
WARMING_DEGC = 0.5
"""DegC, least rise of the temperature over the last tenth of the record during a warm-up. Not critical."""
WARMING_SHARE = 0.1
"""Share of the record over which the rise counts. Not critical."""
WARMING_S = 60.0
"""s, shortest time over which the rise counts. Not critical."""


def has_settled(before: Slope | None, after: Slope | None) -> bool:
    """Return whether a drift has clearly ended between two stretches."""
    if before is None or after is None:
        return False
    # before the candidate, a line need not fit: a sensor that warms up settles along a curve
    error = float(np.hypot(before.least_error, after.error))
    changed = abs(before.value - after.value) > CHANGED_SIGMA * error
    return changed and abs(after.value) < SETTLED_SLOPE * abs(before.value)


def find_settling(drift: DriftAccumulator, columns: Sequence[int], begin_s: float) -> list[bool]:
    """Return whether each channel settles along an exponential after `begin_s`, s, that noise does not explain."""
    length = drift.elapsed_s - begin_s
    times = [share * length for share in LASTING_SHARES if share * length <= CANDIDATES_S[-1]]
    if length < LEAST_WARMUP_S or not times:
        return [False] * len(columns)
    return [fit is not None and fit.significant for fit in drift.settling(columns, times, begin_s)]


def wandered_early(
    drift: DriftAccumulator, columns: Sequence[int], begin_s: float, end_s: float, most: float
) -> bool:
    """Return whether the means of some channels wander more from `begin_s` to `end_s` than afterwards, with a
    probability of at most `most` if they do not."""
    columns = list(columns)
    if not columns:
        return False
    blocks = drift.blocks(max(columns) + 1, begin_s)
    own = replace(blocks, means=blocks.means[:, columns], share=blocks.share[:, columns])
    return early_walk_probability(own, end_s - begin_s) < most


def still_wanders_less(drift: DriftAccumulator, columns: Sequence[int], begin_s: float) -> bool:
    """Return whether the means of some channels wandered more in the beginning of what follows `begin_s`."""
    length = drift.elapsed_s - begin_s
    ends = [share * length for share in EARLY_SHARES if share * length >= LEAST_WARMUP_S]
    return any(
        wandered_early(drift, columns, begin_s, begin_s + end, LASTING_PROBABILITY)
        for end in ends
        if begin_s + end <= LONGEST_WARMUP_S
    )


def is_warming_up(drift: DriftAccumulator, temperature: int | None) -> bool:
    """Return whether the temperature still rises above its highest value so far.

    It must rise by `WARMING_DEGC` over the last tenth of the record, at least over a minute. A cycle of the
    ambient temperature is no warm-up.
    """
    if temperature is None or drift.elapsed_s < LEAST_WARMUP_S:
        return False
    span = max(WARMING_S, WARMING_SHARE * drift.elapsed_s)
    rise = drift.mean_change(temperature, drift.elapsed_s - span, drift.elapsed_s)
    return rise is not None and rise > WARMING_DEGC and drift.is_highest(temperature)
