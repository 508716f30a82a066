"""Covariance of means over stretches of time under the fitted noise.

A slope, a step between two hours or a warm-up is real only if N, B and K alone do not explain it: the mean of
a random walk always moves. The covariance of means over two stretches follows from the generalised
autocovariance G of the phase (the integral of the rate; Greenhall 1991, as in `fit.covariance`),

    white -|t|/2 N^2,  flicker t^2 ln|t| / (2 pi) B^2,  random walk |t|^3/12 K^2,

as G(p-r) - G(p-s) - G(q-r) + G(q-s) over the lengths, for the stretches [q, p] and [s, r]. For flicker and
random walk it has a meaning only in contrasts, combinations of means whose weights add up to zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.noise.fit import ChannelFit
from imumon.samples import Floats


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
    def of(cls, fit: ChannelFit) -> MeanCovariance | None:
        """Return the noise of a fit, at the upper limit where there is no value; None while it is pending."""
        n, b, k = (c.value if c.value is not None else c.high for c in (fit.N, fit.B, fit.K))
        return None if n is None or b is None or k is None else cls(n, b, k)

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
