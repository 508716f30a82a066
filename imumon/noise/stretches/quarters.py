"""Quarters of a record: how much N, B and K move from one quarter to the next.

The limits of a fit say how far chance may have moved a coefficient in this record, if the sensor is constant.
Real sensors are not: N moves by 0.5 to 1 % within an hour, a multiple of its limits. The standard deviation
between the quarters shows that; `excess` says which part of it statistics do not explain. The record has 4 to 7 marks
at equal distances; when there are 8, every second one is dropped. A quarter is one or two of the parts between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from scipy.special import gammaincc, gammainccinv

from imumon.coefficients import QUARTERS, Excess
from imumon.noise.allan.windows import WindowedCascade
from imumon.noise.blocks.block_means import BLOCK
from imumon.noise.fit.bias_curve import NEGLECTED_P
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.spectrum.spectrum_accumulator import SpectrumMark
from imumon.samples import Floats

PART_S = 8.0
"""s, shortest part: a quarter must be long enough for N."""


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
    >>> found = excess(np.array([1.00, 1.02, 0.97, 1.01]), np.full(4, 0.001))
    >>> round(found.value, 3), found.low < 0.02 < found.high
    (0.022, True)
    >>> excess(np.array([1.00, 1.02, 0.97, 1.01]), np.full(4, 0.03)).value is None
    True
    """
    logs, half_dof = np.log(values), 0.5 * (len(values) - 1)

    def squares(variance: float) -> float:
        weight = 1.0 / (errors**2 + variance)
        return float(weight @ (logs - weight @ logs / weight.sum()) ** 2)

    def at(target: float) -> float:
        """Return the deviation at which the sum of squares has a value; 0.0 if it is smaller without any."""
        if squares(0.0) <= target:
            return 0.0
        low, high = 0.0, float(np.sum((logs - logs.mean()) ** 2)) / target
        while low < (middle := 0.5 * (low + high)) < high:
            low, high = (middle, high) if squares(middle) > target else (low, middle)
        return float(np.sqrt(high))

    def quantile(beyond: float) -> float:
        return 2.0 * float(gammainccinv(half_dof, beyond))

    p_value = float(gammaincc(half_dof, 0.5 * squares(0.0)))
    if p_value >= NEGLECTED_P:
        by_chance = min(
            1.0, squares(0.0) / (2.0 * half_dof)
        )  # agree better than their errors: bound as if not
        return Excess(low=0.0, high=at(by_chance * quantile(0.95)), p_value=p_value)
    return Excess(
        value=at(2.0 * half_dof), low=at(quantile(0.025)), high=at(quantile(0.975)), p_value=p_value
    )


class Quarters:
    """Marks at equal distances in a record.

    Parameters
    ----------
    cascade : of the record.
    rate_hz : Hz, sampling rate.
    """

    def __init__(self, cascade: WindowedCascade, rate_hz: float) -> None:
        self._cascade = cascade
        self._length = BLOCK * max(1, round(PART_S * rate_hz / BLOCK))  # where all samples are processed
        self._marks: list[tuple[int, SpectrumMark]] = []
        self._begin()

    @property
    def next_end(self) -> int:
        """Samples of the grid at which the part in progress ends."""
        return self._marks[-1][0] + self._length

    def close_part(self) -> None:
        """End the part in progress if the record has reached its end."""
        if self._cascade.position < self.next_end:
            return
        if self._cascade.position > self.next_end:  # a gap of hours: the parts are not neighbours any more
            self._drop(len(self._marks))
        self._begin()
        if len(self._marks) > 2 * QUARTERS:
            for number in range(2 * QUARTERS - 1, 0, -2):
                self._cascade.cascade.spectrum.drop_mark(self._marks.pop(number)[1])
            self._length *= 2

    def discard_before(self, position: int) -> None:
        """Forget the parts that begin before a position, samples of the grid."""
        self._drop(sum(start < position for start, _ in self._marks))
        if not self._marks:
            self._begin()

    def result(self) -> list[tuple[NoiseSums, int]] | None:
        """Return the sums of the four quarters and their lengths, samples; None while the record is too short."""
        parts = len(self._marks) - 1
        if parts < QUARTERS:
            return None
        cascade, quarters = self._cascade.cascade, []
        for first, last in pairwise(np.linspace(0, parts, QUARTERS + 1).round().astype(int).tolist()):
            (begin, one), (end, two) = self._marks[first], self._marks[last]
            quarters.append((cascade.part_sums(one, two), end - begin))
        return quarters

    def _begin(self) -> None:
        self._marks.append((self._cascade.position, self._cascade.cascade.add_mark()))

    def _drop(self, count: int) -> None:
        for _, mark in self._marks[:count]:
            self._cascade.cascade.spectrum.drop_mark(mark)
        self._marks = self._marks[count:]

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        order = list(self._cascade.cascade.spectrum.marks)
        marks = [[start, order.index(mark)] for start, mark in self._marks]
        return {"length": np.array(self._length), "marks": np.array(marks, dtype=np.int64)}

    @classmethod
    def restore(cls, cascade: WindowedCascade, saved: Mapping[str, np.ndarray]) -> Quarters:
        """Return the quarters in a saved state; the cascade is restored already."""
        self = cls.__new__(cls)
        self._cascade, self._length = cascade, int(saved["length"])
        order = cascade.cascade.spectrum.marks
        self._marks = [(int(start), order[int(number)]) for start, number in saved["marks"]]
        return self
