"""Classical slope readings of an Allan curve, beside the fit so that papers and other tools can be compared.

N is the line of slope -1/2 read at 1 s, K the line of slope +1/2 read at 3 s, B the flat part divided by
sqrt(2 ln 2 / pi) = 0.664 (IEEE Std 952 annex C; the same as in MATLAB's example). Each line is laid through
the octave whose slope to the next is nearest to the asked one; None where no slope is within `NEAR` of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.samples import Floats

NEAR = 0.2
FLAT = math.sqrt(2.0 * math.log(2.0) / math.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class Readings:
    """Readings of a curve in the units of N, B and K; None where the curve has none."""

    N: float | None = None
    B: float | None = None
    K: float | None = None


def read_slopes(tau: Floats, sigma: Floats) -> Readings:
    """Read N, B and K off a curve.

    Parameters
    ----------
    tau : (k,) s
    sigma : (k,) channel unit, all positive.

    >>> tau = 2.0 ** np.arange(-5, 16)
    >>> found = read_slopes(tau, np.sqrt(0.01**2 / tau + (0.664 * 3e-3) ** 2 + 1e-4**2 * tau / 3))
    >>> print(f"{found.N:.4f} {found.B:.4f} {found.K:.2e}")
    0.0100 0.0034 1.04e-04
    """
    if sigma.size < 3:
        return Readings()
    x, y = np.log(tau), np.log(sigma)
    slope = np.diff(y) / np.diff(x)

    def line(asked: float, at: float) -> float | None:
        nearest = int(np.argmin(np.abs(slope - asked)))
        if abs(slope[nearest] - asked) > NEAR:
            return None
        return float(np.exp(y[nearest] + asked * (math.log(at) - x[nearest])))

    floor = line(0.0, 1.0)
    return Readings(N=line(-0.5, 1.0), B=None if floor is None else floor / FLAT, K=line(0.5, 3.0))
