"""Convergence: what was stated of each coefficient when the record was shorter.

A number that has stopped to move is worth more than one that has not, and only its past shows which it is. So the
record keeps what it stated of N, B, K and M, against its length, on a logarithmic axis: `PER_DECADE` cells a decade,
each with the last statement in it. The newest point is what is stated now. A year fills `MOST_POINTS` cells, so the
memory is bounded.

Statements are made when somebody asks for a report. A record without reports, such as that of a replay, is fitted
whenever its length has doubled (`next_due_s`) if a document shows the convergence (`RecordOptions.convergence`): its
curve then has a point in each octave of its length. Such fits take a fifth of the time of a replay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from imumon.model import report
from imumon.model.coefficients import CONVERGING, STATUSES, Estimate
from imumon.model.saved_state import restorable
from imumon.model.units import YEAR
from imumon.noise.fit import ChannelFit

PER_DECADE = 8
"""Points per decade of the length: one for each third by which it grows."""
FIRST_S = 1.0
"""s, length from which points are kept: nothing but N has a value before."""
MOST_POINTS = 1 + math.ceil(PER_DECADE * math.log10(YEAR / FIRST_S))
"""Points of a year. A longer record renews the last one."""
FIRST_DUE_S = 60.0
"""s, length at which a record is first analysed for its convergence alone; then at each of its doublings. Below, B and
K are bounds, and an analysis costs as much as all else."""
DIGITS = 5
"""Significant digits of a number in a report, for the size of the message."""

SIZES = ("value", "low", "high")
_UNKNOWN = len(STATUSES)
"""Number of the status of a coefficient that a channel did not have."""


@restorable
class StatementLog:
    """Statements of all channels with a curve, by the length of the record.

    Parameters
    ----------
    channels : number of channels with a curve.
    """

    NOT_SAVED: ClassVar = {"_newest": tuple}

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self._elapsed_s: list[float] = []
        self._sizes: list[npt.NDArray[np.float32]] = []  # (c, letter, size) SI, NaN where unknown
        self._statuses: list[npt.NDArray[np.int8]] = []  # (c, letter)
        self._newest: Sequence[ChannelFit] = ()  # with all digits; none after a restart

    def add(self, elapsed_s: float, fits: Sequence[ChannelFit]) -> None:
        """Add what is stated of a record of this length, which is not shorter than any before."""
        if elapsed_s < FIRST_S or len(fits) != self._channels:
            return
        sizes = np.full((self._channels, len(CONVERGING), len(SIZES)), np.nan, dtype=np.float32)
        statuses = np.full(sizes.shape[:2], _UNKNOWN, dtype=np.int8)
        for channel, fit in enumerate(fits):
            for row, letter in enumerate(CONVERGING):
                if (part := _stated(fit, letter)) is not None:
                    sizes[channel, row] = [getattr(part, size) for size in SIZES]  # None becomes NaN
                    statuses[channel, row] = STATUSES.index(part.status)
        if self._elapsed_s and _cell(self._elapsed_s[-1]) == _cell(elapsed_s):
            self._drop_last()
        self._elapsed_s.append(elapsed_s)
        self._sizes.append(sizes)
        self._statuses.append(statuses)
        self._newest = fits

    def _drop_last(self) -> None:
        for points in (self._elapsed_s, self._sizes, self._statuses):
            points.pop()

    def is_lasting(self, channel: int, letter: str) -> bool:
        """Return whether a coefficient is measured now and was in every statement since half of the present length.

        One that has just appeared is likelier to be estimated too high than one that has stayed.
        """
        row, measured = CONVERGING.index(letter), STATUSES.index("measured")
        since_half = [
            int(point[channel, row])
            for length, point in zip(self._elapsed_s, self._statuses, strict=True)
            if length >= 0.5 * self._elapsed_s[-1]
        ]
        return bool(since_half) and all(status == measured for status in since_half)

    def of_channel(self, channel: int) -> report.Convergence | None:
        """Return the statements of one channel; None before the first."""
        if not self._elapsed_s:
            return None
        parts = {}
        for row, letter in enumerate(CONVERGING):
            statuses = [int(point[channel, row]) for point in self._statuses]
            if all(status == _UNKNOWN for status in statuses):
                continue
            sizes = np.stack([point[channel, row] for point in self._sizes])
            columns = [
                [float(f"{size:.{DIGITS}g}") if math.isfinite(size) else None for size in column]
                for column in sizes.T.tolist()
            ]
            if self._newest and (part := _stated(self._newest[channel], letter)) is not None:
                for name, column in zip(SIZES, columns, strict=True):
                    column[-1] = getattr(part, name)
            value, low, high = map(tuple, columns)
            names = tuple(None if status == _UNKNOWN else STATUSES[status] for status in statuses)
            parts[letter] = report.StatedSeries(value=value, low=low, high=high, status=names)
        return report.Convergence(elapsed_s=tuple(self._elapsed_s), coefficients=parts)


def next_due_s(elapsed_s: float) -> float:
    """Return the length, s, at which a record is fitted next even if there is no report.

    >>> next_due_s(0.0), next_due_s(60.0), next_due_s(200.0)
    (60.0, 120.0, 240.0)
    """
    due_s = FIRST_DUE_S
    while due_s <= elapsed_s:
        due_s *= 2.0
    return due_s


def _stated(fit: ChannelFit, letter: str) -> Estimate | None:
    if letter in fit.coefficients:
        return fit.coefficients[letter]
    return None if fit.markov is None else fit.markov.sigma


def _cell(elapsed_s: float) -> int:
    """Return the number of the cell of a length; all beyond a year share the last one."""
    return min(math.floor(PER_DECADE * math.log10(elapsed_s / FIRST_S)), MOST_POINTS - 1)
