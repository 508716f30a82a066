"""Popcorn noise: a mean that jumps between two levels.

A random telegraph signal with mean times d0 and d1 in its levels has the autocovariance of Gauss–Markov noise with the
time constant T = 1 / (1/d0 + 1/d1) and the variance h^2 p (1 - p), with the distance h of the levels and the share p of
the time in the upper one (Machlup, J. Appl. Phys. 25, 1954). No spectrum and no Allan variance distinguishes the two.
The distribution does: means over less than T have two peaks, and their excess kurtosis is negative, down to -2, where
that of Gauss–Markov noise is zero.

>>> rng = np.random.default_rng(1)
>>> upper = np.cumsum(rng.random(1000) < 0.05) % 2
>>> jumps = two_levels(2.0 * upper + 0.2 * rng.standard_normal(1000), deviation=1.0, time=10.0)
>>> round(jumps.levels[1] - jumps.levels[0], 1)
2.0
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imumon.model.samples import Floats

LEVELS_SIGMA = 4.0
"""Gauss–Markov noise is popcorn noise where the excess kurtosis of the block means is below zero by as much. Unit:
standard deviations.

Otherwise: Gauss–Markov noise is described by two levels that it does not have. Origin: 3e-5 if the kurtosis is
normal, because every channel is tested in every fit; none of 60 records of Gauss–Markov noise is one (`markov.py`).
"""
LEVELS_SPAN = 20.0
"""Levels are about a mean over this time. Unit: time constants.

Otherwise: a walk beside the jumps smears the levels. Chosen: ten times in each level (`markov.py`).
"""


class TwoLevels(NamedTuple):
    """Levels of a mean that jumps.

    Attributes
    ----------
    levels : channel unit, lower and upper one.
    dwell : mean time in each, in the unit of the time constant.
    """

    levels: tuple[float, float]
    dwell: tuple[float, float]


def two_levels(means: Floats, deviation: float, time: float) -> TwoLevels | None:
    """Return the two levels of a series; None where its distribution does not show them.

    Parameters
    ----------
    means : (n,) channel unit, means over blocks.
    deviation : channel unit, standard deviation of the jumps, which means over blocks do not show in full.
    time : time constant of the correlation, blocks.
    """
    # Slower noise moves both levels: about a mean over several time constants they stay where they are. Where it
    # reaches over a border of two segments, it moves the levels by the difference of their means, which broadens the
    # peaks.
    width = min(means.size, 2 * round(0.5 * LEVELS_SPAN * time) + 1)
    counts = np.convolve(np.ones(means.size), np.ones(width), mode="same")
    values = means - np.convolve(means, np.ones(width), mode="same") / counts
    variance = float(values.var())
    if not variance:
        return None
    kurtosis = float(np.mean(values**4)) / variance**2 - 3.0
    # the variance of the kurtosis of correlated normal numbers is 24 / n times the sum of the fourth powers of their
    # correlations, which is half a time constant (Lobato and Velasco, Econometric Theory 20, 2004)
    independent = means.size * min(1.0, 2.0 / time)
    if kurtosis > -LEVELS_SIGMA * np.sqrt(24.0 / independent):
        return None
    share = _upper_share(values)
    distance = deviation / float(np.sqrt(share * (1.0 - share)))
    low = float(means.mean()) - share * distance
    return TwoLevels((low, low + distance), (time / share, time / (1.0 - share)))


def _upper_share(values: Floats) -> float:
    """Return the share of the upper of two normal distributions with one variance (Day, Biometrika 56, 1969)."""
    low, high = np.quantile(values, [0.25, 0.75]).tolist()
    share, variance = 0.5, 0.25 * float(values.var())
    for _ in range(60):
        odds = (values - 0.5 * (low + high)) * (high - low) / variance
        upper = share / (share + (1.0 - share) * np.exp(-np.clip(odds, -500.0, 500.0)))
        share = float(np.clip(upper.mean(), 1e-3, 1.0 - 1e-3))
        high = float(upper @ values) / (values.size * share)
        low = float((1.0 - upper) @ values) / (values.size * (1.0 - share))
        spread = upper @ (values - high) ** 2 + (1.0 - upper) @ (values - low) ** 2
        variance = max(float(spread) / values.size, 1e-12 * float(values.var()))
    return share
