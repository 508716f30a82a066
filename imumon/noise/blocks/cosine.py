"""Cosine transform of block means, and the variance of its coefficients.

In the basis of the discrete cosine transform (DCT-II) white noise and random walk have a diagonal covariance, flicker
nearly: correlations of its coefficients are at most 0.12 and enter the information squared. So the coefficients count
as independent. Coefficient k of n blocks belongs to the frequency k / (2 n) cycles per block.

The variance of flicker is its density over the aliases of a block average, times a factor close to one of the lowest
coefficients, where the ends of the record show. That factor depends on k only and is computed once, from the
autocovariance of the averages (Greenhall 1991).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from imumon.samples import Floats

EXACT = 256
"""Blocks for which the variances of flicker are computed from the covariance; their edge factor serves all others."""
ALIASES = 20
"""Aliases on each side that are added."""


def _flicker_density(f: Floats) -> Floats:
    """Return (k,) the density of averages over a block for B = 1, at frequencies in cycles per block."""
    at = np.abs(f[:, None] + np.arange(-ALIASES, ALIASES + 1))
    return np.asarray((np.sinc(at) ** 2 / (2.0 * np.pi * at)).sum(axis=1))


@lru_cache(maxsize=1)
def _edge_factors() -> Floats:
    """Return (EXACT - 1,) the variances of flicker over its density."""
    import scipy.fft

    lag = np.arange(EXACT + 1.0)
    phase = lag**2 * np.log(np.maximum(lag, 1.0)) / (2.0 * np.pi)
    by_lag = 2.0 * phase[:-1] - phase[np.abs(np.arange(EXACT) - 1)] - phase[1:]
    matrix = by_lag[np.abs(np.arange(EXACT)[:, None] - np.arange(EXACT))]
    matrix = scipy.fft.dct(scipy.fft.dct(matrix, axis=0, norm="ortho"), axis=1, norm="ortho")
    k = np.arange(1, EXACT)
    return np.asarray(np.diag(matrix)[1:] / _flicker_density(k / (2.0 * EXACT)))


@lru_cache(maxsize=32)
def coefficient_variances(n: int) -> Floats:
    """Return (3, n - 1) the variances of coefficients 1 to n - 1 of n block means, for N = B = K = 1.

    In units of a block. The edges of the highest coefficients of flicker are not modelled: 1.4 % of 16 means, less of
    more.

    >>> coefficient_variances(8).round(3)[:, :3]
    array([[1.   , 1.   , 1.   ],
           [1.946, 1.097, 0.716],
           [6.402, 1.54 , 0.643]])
    """
    k = np.arange(1, n)
    edge = np.ones(n - 1)
    factors = _edge_factors()[: EXACT // 2]
    edge[: factors.size] = factors[: n - 1]
    sine = np.sin(np.pi * k / (2.0 * n))
    # differences of averages of a walk have the variance 2/3 and the covariance 1/6 with the next one
    return np.stack((np.ones(n - 1), _flicker_density(k / (2.0 * n)) * edge, 0.25 / sine**2 - 1.0 / 6.0))
