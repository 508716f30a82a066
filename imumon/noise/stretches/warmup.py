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

from imumon.model.samples import Floats
from imumon.noise.fit import ChannelFit

CANDIDATES_S = (120.0, 300.0, 600.0, 1200.0, 2400.0, 3600.0, 5400.0)
"""Possible ends of a warm-up; beyond the last one, the temperature shows no warm-up. Unit: s.

Otherwise: with fewer, more is excluded than settles; a finer grid excludes little less. See `real_effects.py --only
warm-up`.
"""
DECISION_LENGTH = 2.5
"""Length of the record at which the candidate is decided. Unit: of a candidate.

Otherwise: a shorter record does not show its exponential; in a longer one, the decision comes late. See
`real_effects.py --only warm-up`.
"""
STILL = 0.22
"""Time constant up to which a settling is over at the end of the record. Unit: of the record.

Otherwise: what is excluded ends before the settling does, or a settling that is over is never excluded. Origin: of a
shorter one at most 1 % remains at the end, and a sixth at a candidate that is decided there (`real_effects.py --only
warm-up`).
"""
WARMING_DEGC = 1.0
"""A temperature that rises by less shows no warm-up. Unit: degC.

Otherwise: the noise of the thermometer is reported as a warm-up.
"""
HIGHEST_SHARE = 0.1
"""A last mean of the temperature that is farther below the highest shows no warm-up. Unit: of the rise.

Otherwise: a cycle of the ambient temperature is reported as a warm-up.
"""


def has_settled(time_constants_s: Iterable[float], candidate_s: float) -> bool:
    """Return whether one of some exponentials is over at a candidate, s."""
    return any(time_s <= STILL * DECISION_LENGTH * candidate_s for time_s in time_constants_s)


def still_settles(fits: Iterable[ChannelFit], length_s: float) -> bool:
    """Return whether some channel settles along an exponential that is not over after a record of this length, s."""
    settling = [fit.regressor("settling") for fit in fits]
    times_s = [one.time_constant_s for one in settling if one is not None]
    return any(time_s is not None and time_s > STILL * length_s for time_s in times_s)


def still_heats_up(degrees: Floats, block_s: float) -> bool:
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
