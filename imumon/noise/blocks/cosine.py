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

from imumon.noise.power_law import average_covariance, sampled_density
from imumon.samples import Floats

EXACT = 256
"""Blocks for which the variances of flicker are computed from the covariance; their edge factor serves all others."""


@lru_cache(maxsize=1)
def _edge_factors() -> Floats:
    """Return (EXACT - 1,) the variances of flicker over its density."""
    import scipy.fft

    matrix = average_covariance(EXACT)[1]
    matrix = scipy.fft.dct(scipy.fft.dct(matrix, axis=0, norm="ortho"), axis=1, norm="ortho")
    k = np.arange(1, EXACT)
    return np.asarray(np.diag(matrix)[1:] / sampled_density(k / (2.0 * EXACT), averaged=True)[1])


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
    return np.stack(
        (np.ones(n - 1), sampled_density(k / (2.0 * n), averaged=True)[1] * edge, 0.25 / sine**2 - 1.0 / 6.0)
    )
