"""Wander: how far means over stretches of time stray by the fitted noise alone.

A slope, a step between two hours or a warm-up is real only against what N, B and K do by themselves: a random
walk always goes somewhere. The covariance of means over two stretches follows from the generalised
autocovariance G of the phase (the integral of the rate; Greenhall 1991, as in `fit.covariance`),

    white -|t|/2 N^2,  flicker t^2 ln|t| / (2 pi) B^2,  random walk |t|^3/12 K^2,

as G(p-r) - G(p-s) - G(q-r) + G(q-s) over the lengths, stretches being [q, p] and [s, r]. For flicker and
random walk it has a meaning only in contrasts, combinations of means whose weights add up to zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imumon.samples import Floats


class WanderTables(Protocol):
    """A fitted coefficient: its value where measured, and its upper limit."""

    @property
    def value(self) -> float | None: ...
    @property
    def high(self) -> float | None: ...


class Fitted(Protocol):
    """What a fit says of a channel."""

    @property
    def N(self) -> WanderTables: ...
    @property
    def B(self) -> WanderTables: ...
    @property
    def K(self) -> WanderTables: ...


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
    def of(cls, fit: Fitted) -> MeanCovariance | None:
        """From a fit, with the upper limit where a coefficient was not seen: it may be that large; None while
        a coefficient is pending."""
        parts = []
        for known in (fit.N, fit.B, fit.K):
            value = known.value if known.value is not None else known.high
            if value is None:
                return None
            parts.append(value)
        return cls(*parts)

    def covariance(self, lag: Floats, first: float, second: float) -> Floats:
        """(channel unit)^2, of the mean over `first` seconds with that over `second` seconds, beginning `lag`
        later.

        Parameters
        ----------
        lag : s, any shape.
        """
        g = self._phase
        total = g(first - lag - second) - g(first - lag) - g(-lag - second) + g(-lag)
        return np.asarray(total / (first * second), dtype=np.float64)

    def step(self, first: float, second: float, apart: float = 0.0) -> float:
        """Channel unit, standard deviation of the difference of the means over two stretches.

        Parameters
        ----------
        first, second : s, their lengths.
        apart : s, from the end of the first to the beginning of the second.
        """
        zero = np.zeros(1)
        variance = self.covariance(zero, first, first) + self.covariance(zero, second, second)
        variance -= 2.0 * self.covariance(np.full(1, first + apart), first, second)
        return math.sqrt(max(float(variance[0]), 0.0))

    def _phase(self, t: Floats) -> Floats:
        size = np.abs(t)
        log = np.log(np.where(size > 0.0, size, 1.0))
        flicker = (self.B**2 / (2.0 * np.pi)) * size**2 * log
        return np.asarray(
            (-0.5 * self.N**2) * size + flicker + (self.K**2 / 12.0) * size**3, dtype=np.float64
        )
