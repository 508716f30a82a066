"""What missing samples let leak into the bins of a level from other frequencies.

A segment with missing samples holds the noise x times the share w of valid samples. The density of a product is the
convolution of the two densities (Parzen, Sankhya A 25, 1963):

    E[P_k] = sum over f of S(f) D(k - f) / 256

where f runs over the bins of both signs. S is the density of the noise. D(d) = |F(h w)[d]|^2 over sum h^2 and the
square of the mean share is the density of the shares under the window h, as a mean over the segments. The sum has three
parts:

- Near: f is up to `NEAR` bins from k. S is nearly that of bin k, so that the sum over these D is one number,
  `LevelSums.slow`. That is no leak. Only what scattered losses have at all distances alike is counted here.
- Up to half the rate of the level: `LevelSums.holes` of this level has D at distances of 46 to 91 bins, on level 0 to
  127. That of the next level, at half the rate, has it at 23 to 45. That of the level above has it from half the rate
  on. Between 91 bins and half the rate, D is interpolated. The sum begins at bin 8, because lower frequencies are
  subtracted from a segment as waves (`level_sums.SLOW_WAVES`).
- Above half the rate: this noise leaks before the filters of the levels remove it. D is that of the levels above, at
  the frequency of the noise instead of its distance from k. Scattered losses let every octave of flicker leak alike, so
  that this part grows with each level. Of a hole it is almost nothing, because D falls with the square of the distance.

Everything is in units of level 0: frequencies in cycles per sample, densities per cycle per sample.

Example: white noise, half of the samples of a segment missing at random. The relative variance of w is 1, so that D is
1 at all distances, and the density of the noise doubles: 1 is that of the bin itself, and as much leaks from all
frequencies. The lowest ones, which are subtracted, would be 5 % of that.

>>> one = np.ones((1, 11))
>>> sums = LevelSums(power=one, holes=one, white=np.full(1, 2.0), slow=np.ones(1), averages=np.ones(1, dtype=int))
>>> float(leaked((sums,), 0, 0, lambda level: np.ones(SEGMENT // 2 + 1))[0].round(2))
0.95
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from imumon.model.samples import Floats
from imumon.noise.spectrum.level_sums import (
    FIRST_BIN,
    NEAR,
    SEGMENT,
    SLOW_WAVES,
    SUB_BAND,
    LevelSums,
    last_bin,
)

HALF = SEGMENT // 2
"""Bin at half the rate of a level."""
LOWEST = 0.5 * (len(SLOW_WAVES) - 0.5)
"""Bins, lowest frequency of the noise that remains in a segment. The waves are half a bin apart, so that what the first
remaining one describes begins a quarter of a bin below it."""
WITHOUT_WAVES = math.ceil(LOWEST)
"""First bin that remains."""
WAVES_SHARE = len(SLOW_WAVES) / SEGMENT
"""Share of the degrees of freedom of a segment that the slow waves take."""


def leaked(levels: Sequence[LevelSums], s: int, group: int, density: Callable[[int], Floats]) -> Floats:
    """Return (n,) the density that leaks into each bin in use of level s from other frequencies.

    Parameters
    ----------
    levels : sums of all levels of a record, or of a part of it; samples are missing in level s.
    group : of the channel; channels of a group have the same missing samples.
    density : returns (HALF + 1,) the density of the noise at the bins of a level, bin 0 included, before the filters of
        the levels.
    """
    bins, f = np.arange(FIRST_BIN, last_bin(s)), np.arange(WITHOUT_WAVES, HALF + 1)
    weight = np.ones(f.size)
    # a bin reaches half a bin to each side; the first one begins at `LOWEST`, and the last one ends at half the rate
    weight[0], weight[-1] = WITHOUT_WAVES + 0.5 - LOWEST, 0.5
    if s == 0:
        # here a sample is missing as a whole: beside those that the waves are fitted to, they leave more of the noise
        # at frequencies near theirs; up to a quarter of the band, so that flicker and walk hold in `test_spectrum`
        weight[f < HALF // 4] /= 1.0 - WAVES_SHARE
    of_shares = _density_of_shares(levels, s, group)
    # from both signs of the frequency
    both_signs = of_shares[np.abs(bins[:, None] - f)] + of_shares[bins[:, None] + f]
    out = both_signs @ (weight * density(s)[f]) / (SEGMENT * 2.0**s)
    for above in range(s):
        # each level has the octave above that of the next one; the last begins at half the rate of level s
        first = HALF // 2 if above == s - 1 else FIRST_BIN
        f = np.arange(first, last_bin(above))
        weight = np.ones(f.size)
        weight[0] = 0.5 if above == s - 1 else 1.0
        shares = _by_bin(levels, above, group)[first - FIRST_BIN :]
        # from both signs of the frequency
        out += 2.0 * float((weight * density(above)[f]) @ shares) / (SEGMENT * 2.0**above)
    return np.asarray(out)


def _by_bin(levels: Sequence[LevelSums], s: int, group: int) -> Floats:
    """Return (n,) the density D of the shares at the bins in use of a level, which are distances here."""
    sums = levels[s]
    count = max(float(sums.averages[group]), 1.0)
    return np.repeat(sums.holes[group] / count * 2.0**s, SUB_BAND)[: last_bin(s) - FIRST_BIN]


def _density_of_shares(levels: Sequence[LevelSums], s: int, group: int) -> Floats:
    """Return (SEGMENT,) the density D of the shares at distances of 0, 1, ... bins of level s, in units of level 0.

    Up to `NEAR` it is the mean of the bins in use: `LevelSums.slow` counts what exceeds that.
    """
    of_level = _by_bin(levels, s, group)
    places: list[Floats] = [np.arange(float(FIRST_BIN), float(last_bin(s)))]
    values = [of_level]
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
    out[distance <= NEAR] = of_level.mean()
    return np.asarray(out)
