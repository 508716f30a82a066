"""Warm-up: whether a sensor has settled after it was switched on.

Statistics begin with the first sample; nothing waits. A warm-up is recognised afterwards: once the record is
two and a half times as long as a candidate time, the fit of the record shows whether the means settle along an
exponential that is over by then. What does not show is no warm-up that matters, and the exponential is part of the fit
in any case. A warm-up that is not over is reported as long as it is clear: by a temperature that has not come to rest,
or by means that settle. The temperature alone excludes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from imumon.noise.fit import ChannelFit
from imumon.noise.stretches.stretch_rules import (
    CANDIDATES_S,
    DECISION_LENGTH,
    HIGHEST_SHARE,
    STILL,
    WARMING_DEGC,
)
from imumon.samples import Floats


def is_over(time_constants_s: Iterable[float], candidate_s: float) -> bool:
    """Return whether one of some exponentials is over at a candidate, s."""
    return any(time_s <= STILL * DECISION_LENGTH * candidate_s for time_s in time_constants_s)


def still_settles(fits: Iterable[ChannelFit], length_s: float) -> bool:
    """Return whether some channel settles along an exponential that is not over after a record of this length, s."""
    columns = [fit.column("settling") for fit in fits]
    times_s = [column.time_constant_s for column in columns if column is not None]
    return any(time_s is not None and time_s > STILL * length_s for time_s in times_s)


def is_warming_up(degrees: Floats, block_s: float) -> bool:
    """Return whether the temperature of the sensor has not come to rest.

    Parameters
    ----------
    degrees : (n,) degC, means over blocks from the beginning of the record on; NaN: missing.
    block_s : s, of a block.
    """
    length = degrees.size * block_s
    known = degrees[np.isfinite(degrees)]
    if known.size < 4:  # too few to distinguish a rise from the noise of the thermometer
        return False
    # the first fiftieth: one block alone has the noise of the thermometer
    low, high = float(known[: max(1, known.size // 50)].mean()), float(known.max())
    rise = high - low
    if rise < WARMING_DEGC or known[-1] < high - HIGHEST_SHARE * rise:
        return False
    # 1 - 1/e of the rise, one time constant of an exponential
    reached = float(np.argmax(known > low + 0.632 * rise)) / known.size
    return reached > STILL and reached * length < CANDIDATES_S[-1]
