"""Quarters of a record: how much N, B and K move from one quarter to the next.

The limits of a fit say how far chance may have moved a coefficient in this record, if the sensor is constant.
Real sensors are not: N moves by 0.5 to 1 % within an hour, a multiple of its limits. The standard deviation
between the quarters shows that; `excess` says which part of it statistics do not explain.

K is another case. What moves the mean without being noise, a sensor that warms or a hand beside it, looks like a walk
and happens once. Then one half of the record has it and the other does not: `change` compares them.

The length of a record is not known in advance, so the places between its quarters cannot be marked at once. Marks lie
at equal distances instead. The ninth one makes every second one drop, and the distance doubles. So once the record is
long enough there are 5 to 8 marks, hence 4 to 7 equal lengths between them, and a quarter is one or two of these.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from scipy.special import gammaincc, gammainccinv

from imumon.model.coefficients import QUARTERS, Excess
from imumon.model.samples import Floats
from imumon.model.saved_state import restorable
from imumon.noise.blocks.block_means import BLOCK
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.stretches.parts import Parts
from imumon.noise.uncertainty import variance_between, weighted_squares

NEGLECTED_P = 0.25
"""The variance between quarters counts where chance makes as much in fewer records. Unit: probability.

Otherwise: at 0.05 limits beside a neglected term hold 88 %, at 0.25 92 %. Origin: Bancroft 1944; Biometrics 20, 1964.
"""

SHORTEST_S = 8.0
"""s, shortest distance of two marks: a quarter must be long enough for N."""


def excess(values: Floats, errors: Floats) -> Excess:
    """Return the scatter of a coefficient between quarters beyond their statistics.

    The logarithms of the values vary about a common mean by their errors and by the excess, all independent (random
    effects). Their weighted sum of squares is then chi-squared with 3 degrees of freedom, whatever the errors: the
    excess at which it has its mean is the value (Paule & Mandel, J. Res. NBS 87, 1982), those at which it has its
    quantiles are the limits (Viechtbauer, Statist. Med. 26, 2007), and at zero it is the test (Cochran's Q).

    Parameters
    ----------
    values : (q,) channel unit, above 0.
    errors : (q,) 1, standard errors of their logarithms, above 0.

    Examples
    --------
    >>> shown = excess(np.array([1.00, 1.02, 0.97, 1.01]), np.full(4, 0.001))
    >>> round(shown.value, 3), shown.low < 0.02 < shown.high
    (0.022, True)
    >>> excess(np.array([1.00, 1.02, 0.97, 1.01]), np.full(4, 0.03)).value is None
    True
    """
    logs, half_dof, variances = np.log(values), 0.5 * (len(values) - 1), errors**2
    squares = weighted_squares(logs, variances)

    def deviation_of(target: float) -> float:
        """Return the deviation with which the sum of squares has a value; 0.0 if it is smaller without any."""
        return math.sqrt(variance_between(logs, variances, target))

    def quantile(beyond: float) -> float:
        return 2.0 * float(gammainccinv(half_dof, beyond))

    p_value = float(gammaincc(half_dof, 0.5 * squares))
    if p_value >= NEGLECTED_P:
        # quarters that agree better than their errors do so by chance: the bound is that of errors as they should be
        by_chance = min(1.0, squares / (2.0 * half_dof))
        return Excess(low=0.0, high=deviation_of(by_chance * quantile(0.95)), p_value=p_value)
    value = deviation_of(2.0 * half_dof)
    low, high = deviation_of(quantile(0.025)), deviation_of(quantile(0.975))
    return Excess(value=value, low=low, high=high, p_value=p_value)


@restorable
class Quarters:
    """Marks at equal distances in a record.

    Parameters
    ----------
    parts : of the record.
    rate_hz : Hz, sampling rate.
    """

    def __init__(self, parts: Parts, rate_hz: float) -> None:
        self._parts = parts
        # whole blocks: there, all samples have been processed
        self._shortest = self._length = BLOCK * max(1, round(SHORTEST_S * rate_hz / BLOCK))
        self.places = [parts.mark()]

    @property
    def next_end(self) -> int:
        """Samples of the grid at which the length in progress ends."""
        return self.places[-1] + self._length

    def close_due(self) -> None:
        """End the length in progress if the record has reached its end."""
        if self._parts.position < self.next_end:
            return
        if self._parts.position > self.next_end:  # a gap of hours: the lengths are not neighbours any more
            self.places = []
        self.places.append(self._parts.mark())
        if len(self.places) > 2 * QUARTERS:
            del self.places[1::2]
            self._length *= 2

    def discard_before(self, position: int) -> None:
        """Forget the lengths that begin before a position, samples of the grid."""
        self.places = [place for place in self.places if place >= position] or [self._parts.mark()]

    def result(self, parts: int = QUARTERS) -> list[tuple[NoiseSums, int]] | None:
        """Return the sums of the quarters, or halves, and their lengths, samples; None: the record is too short."""
        lengths = len(self.places) - 1
        if lengths < QUARTERS:
            return None
        borders = np.linspace(0, lengths, parts + 1).round().astype(int).tolist()
        return [
            (self._parts.sums(begin, end), end - begin)
            for begin, end in pairwise(self.places[border] for border in borders)
        ]
