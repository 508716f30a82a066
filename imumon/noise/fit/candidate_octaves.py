"""Octaves and terms of the descriptions that the selection tries, see `model_selection`."""

from __future__ import annotations

from itertools import product

import numpy as np

from imumon.noise.fit.covariance import TERMS
from imumon.noise.fit.leastsquares import RAMP, SIGNED
from imumon.samples import Bools

MAX_SHORT = 7
"""Octaves that may be excluded at the short end. A correlation over more samples is not that of a filter. Not
critical."""

MAX_LONG = 6
"""Octaves that may be excluded at the long end: the rest describes a record of a 64th of the length. Not
critical."""

MAX_BLOCK = 10
"""Octaves in the middle that may be excluded where no spectrum is known: a strong line bends about ten. Not
critical."""

MAX_SHORT_BESIDE_BLOCK = 2
"""Octaves that may be excluded at the short end together with a block, for the processor time. Not critical."""

LEAST_OCTAVES = 5
"""Octaves that must stay for the three terms: two degrees of freedom are left to test. Sensitivity: halved 0
%, doubled changes which values appear (gyro x drift steady_B value of the record "warm-up")."""

QUANTISATION = SIGNED
BASE = np.arange(len(TERMS)) < 3
"""(5,) terms of every description: N, B and K."""


def candidates_without_short(available: Bools) -> list[tuple[Bools, Bools]]:
    """Return octaves, (k,), and terms, (5,), of the descriptions without some of the shortest octaves."""
    choices = product(range(MAX_SHORT + 1), (False, True))
    candidates = [_candidate(available, short, 0, 0, ramp=ramp) for short, ramp in choices]
    return [each for each in candidates if _enough(*each)]


def candidates_without_block(available: Bools, *, only_end: bool) -> list[tuple[Bools, Bools]]:
    """Return the same without a block of octaves: at the long end, or anywhere beside the short end."""
    count = int(available.sum())
    if only_end:
        choices = product(range(MAX_SHORT + 1), range(1, MAX_LONG + 1))
        cuts = [(short, count - length, length) for short, length in choices]
    else:
        choices = product(range(MAX_SHORT_BESIDE_BLOCK + 1), range(1, MAX_BLOCK + 1))
        cuts = [
            (short, begin, length)
            for short, length in choices
            for begin in range(short + 1, count - length + 1)
        ]
    candidates = [_candidate(available, short, begin, length, ramp=False) for short, begin, length in cuts]
    return [each for each in candidates if _enough(*each)]


def _candidate(available: Bools, short: int, begin: int, length: int, *, ramp: bool) -> tuple[Bools, Bools]:
    """Return octaves and terms without the shortest octaves, and without `length` from the `begin`-th on."""
    used, free = available.copy(), BASE.copy()
    octaves = np.flatnonzero(available)
    used[octaves[:short]] = used[octaves[begin : begin + length]] = False
    free[QUANTISATION], free[RAMP] = short > 0, ramp
    return used, free


def _enough(used: Bools, free: Bools) -> bool:
    return bool(used.sum() >= LEAST_OCTAVES - 3 + free.sum())
