"""What missing samples let leak into the bins of a level from other frequencies.

A segment with missing samples is the noise x times the share w of valid samples. The density of a product is the
convolution of both densities (Parzen, Sankhya A 25, 1963):

    E[P_k] = sum over f of S(f) D(k - f)

with the density S of the noise, and D that of h w of the mean segment, h the window. D has three parts:

- near 0, D is the window and what the share of valid samples varies by slowly. S there is that of the bin k, so that
  the sum over these D is one number, `LevelSums.slow`.
- beyond, up to half the rate of the level, D is known from `LevelSums.holes`: of this level from bin 46 on, and of the
  next level, at half the rate, for bins 23 to 45. The noise of a segment has the frequencies from bin 8 on, because the
  lower ones are subtracted as waves (`level_sums.SLOW_WAVES`).
- above half the rate of the level, noise leaks before the filters of the levels, with the D of the levels above. Of
  scattered losses this is as much as from all others. Of a hole it is nothing, because D falls with the square of the
  frequency. So the leak of a hole does not depend on what noise does between two samples of a level.

Everything is in units of level 0: cycles per sample, densities per cycle per sample.

Example: of white noise, half of the samples of a segment missing at random double the density. A share of it is that of
the bin itself, and what leaks from all other frequencies is the rest.

>>> sums = LevelSums(*(np.ones((1, 11)),) * 2, np.full(1, 2.0), np.ones(1), np.ones(1, dtype=int))
>>> float(leaked((sums,), 0, 0, lambda level: np.ones(SEGMENT // 2 + 1))[0].round(1))
1.0
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from imumon.noise.spectrum.level_sums import (
    FIRST_BIN,
    NEAR,
    SEGMENT,
    SLOW_WAVES,
    SUB_BAND,
    LevelSums,
    last_bin,
)
from imumon.samples import Floats

HALF = SEGMENT // 2
"""Bin at half the rate of a level."""
LOWEST = 0.5 * (len(SLOW_WAVES) - 0.5)
"""Bins, frequency from which on the noise of a segment remains. The waves are half a bin apart, and the first one that
is not subtracted stands for what is up to a quarter of a bin below it."""
WITHOUT_WAVES = math.ceil(LOWEST)
"""Lowest bin that remains."""
WAVES_SHARE = len(SLOW_WAVES) / SEGMENT
"""Share of the degrees of freedom of a segment that the slow waves take."""


def leaked(levels: Sequence[LevelSums], s: int, group: int, density: Callable[[int], Floats]) -> Floats:
    """Return (n,) the density that leaks into each bin in use of level s from other frequencies.

    Parameters
    ----------
    levels : of a record; without missing samples in level s, nothing leaks.
    group : of the channel, for the shares of valid samples.
    density : returns (HALF + 1,) the density of the noise at the bins of a level, 0 included, without filters.
    """
    bins, f = np.arange(FIRST_BIN, last_bin(s)), np.arange(WITHOUT_WAVES, HALF + 1)
    weight = np.ones(f.size)
    weight[0], weight[-1] = WITHOUT_WAVES + 0.5 - LOWEST, 0.5
    if s == 0:
        # a sample is missing as a whole, and there the waves leave more of what is near them
        weight[f < HALF // 4] /= 1.0 - WAVES_SHARE
    of_shares = _density_of_shares(levels, s, group)
    distances = of_shares[np.abs(bins[:, None] - f)] + of_shares[bins[:, None] + f]
    out = distances @ (weight * density(s)[f]) / (SEGMENT * 2.0**s)
    for above in range(s):
        # up to half the rate of the level below it, which is `s` or has been counted
        first = HALF // 2 if above == s - 1 else FIRST_BIN
        row = np.arange(first, last_bin(above))
        weight = np.ones(row.size)
        weight[0] = 0.5 if above == s - 1 else 1.0
        shares = _by_bin(levels, above, group)[first - FIRST_BIN :]
        # both signs of the frequency
        out += 2.0 * float((weight * density(above)[row]) @ shares) / (SEGMENT * 2.0**above)
    return np.asarray(out)


def _by_bin(levels: Sequence[LevelSums], s: int, group: int) -> Floats:
    """Return (n,) the density of the share of valid samples at each bin in use of a level."""
    sums = levels[s]
    count = max(float(sums.averages[group]), 1.0)
    return np.repeat(sums.holes[group] / count * 2.0**s, SUB_BAND)[: last_bin(s) - FIRST_BIN]


def _density_of_shares(levels: Sequence[LevelSums], s: int, group: int) -> Floats:
    """Return (SEGMENT,) the density of the share of valid samples at distances of 0, 1, ... bins of level s.

    Up to `NEAR` it is what `LevelSums.slow` does not count, the mean of the bins in use.
    """
    own = _by_bin(levels, s, group)
    places: list[Floats] = [np.arange(float(FIRST_BIN), float(last_bin(s)))]
    values = [own]
    if s + 1 < len(levels) and levels[s + 1].averages[group]:
        places.insert(0, np.arange(FIRST_BIN, last_bin(s + 1)) / 2.0)
        values.insert(0, _by_bin(levels, s + 1, group))
    if s:
        places.append(np.arange(float(HALF), 2.0 * last_bin(s - 1), 2.0))
        values.append(_by_bin(levels, s - 1, group)[HALF // 2 - FIRST_BIN :])
    distance = np.arange(SEGMENT)
    if not s:
        distance = np.minimum(distance, SEGMENT - distance)  # the spectrum of samples is periodic
    out = np.interp(distance, np.concatenate(places), np.concatenate(values))
    out[distance <= NEAR] = own.mean()
    return np.asarray(out)
