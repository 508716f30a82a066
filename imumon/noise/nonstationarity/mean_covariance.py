"""Covariance of means over stretches of time under the fitted noise.

A slope, a step between two hours or a warm-up is real only if N, B and K alone do not explain it: a random
walk always goes somewhere. The covariance of means over two stretches follows from the generalised
autocovariance G of the phase (the integral of the rate; Greenhall 1991, as in `fit.covariance`),

    white -|t|/2 N^2,  flicker t^2 ln|t| / (2 pi) B^2,  random walk |t|^3/12 K^2,

as G(p-r) - G(p-s) - G(q-r) + G(q-s) over the lengths, for the stretches [q, p] and [s, r]. For flicker and
random walk it has a meaning only in contrasts, combinations of means whose weights add up to zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imumon.samples import Floats


class LimitedValue(Protocol):
    """A coefficient: its value if measured, and its 95 % limits."""

    @property
    def value(self) -> float | None: ...
    @property
    def low(self) -> float | None: ...
    @property
    def high(self) -> float | None: ...


class FittedNoise(Protocol):
    """The coefficients of a fit."""

    @property
    def N(self) -> LimitedValue: ...
    @property
    def B(self) -> LimitedValue: ...
    @property
    def K(self) -> LimitedValue: ...


@dataclass(frozen=True, slots=True)
class MeanCovariance:
    """Noise of a channel.

    Attributes
    ----------
    N, B, K : channel unit times sqrt(s), 1, 1/sqrt(s).
    """

    N: float
    B: float
    K: float

    @classmethod
    def of(cls, fit: FittedNoise) -> MeanCovariance | None:
        """Return the noise of a fit, with the upper limit of a coefficient without a value: it may be that
        large. None while a coefficient is pending."""
        parts = []
        for coefficient in (fit.N, fit.B, fit.K):
            value = coefficient.value if coefficient.value is not None else coefficient.high
            if value is None:
                return None
            parts.append(value)
        return cls(*parts)

    def covariance(self, lag: Floats, first: float, second: float) -> Floats:
        """Return the covariance of two means, (channel unit)^2.

        Parameters
        ----------
        lag : s, any shape, from the beginning of the first stretch to that of the second.
        first, second : s, lengths of the stretches.
        """
        g = self._phase
        total = g(first - lag - second) - g(first - lag) - g(-lag - second) + g(-lag)
        return np.asarray(total / (first * second), dtype=np.float64)

    def difference(self, first: float, second: float, apart: float = 0.0) -> float:
        """Return the standard deviation of the difference of two means, channel unit.

        Parameters
        ----------
        first, second : s, lengths of the stretches.
        apart : s, from the end of the first to the beginning of the second.
        """
        zero = np.zeros(1)
        variance = self.covariance(zero, first, first) + self.covariance(zero, second, second)
        variance -= 2.0 * self.covariance(np.full(1, first + apart), first, second)
        return math.sqrt(max(float(variance[0]), 0.0))

    def _phase(self, t: Floats) -> Floats:
        """Return the generalised autocovariance G at the lags `t`, s."""
        size = np.abs(t)
        log = np.log(np.where(size > 0.0, size, 1.0))
        flicker = (self.B**2 / (2.0 * np.pi)) * size**2 * log
        phase = (-0.5 * self.N**2) * size + flicker + (self.K**2 / 12.0) * size**3
        return np.asarray(phase, dtype=np.float64)
