"""Normal equations of small regressions, at all points of a grid in one call.

The points are the last axis, so that each operation runs over a row of memory. Matrices are positive definite and
small: elimination over all points at once takes a tenth of the time of a call of LAPACK for each point.
"""

from __future__ import annotations

import numpy as np

from imumon.model.samples import Floats
from imumon.noise.validity_groups import ROUNDING

LEAST_VARIANCE = 1e-100
"""Floor of every variance; a channel with less is constant. Unit: (channel unit)^2.

Otherwise: squares of variances underflow, and a constant channel gives 0/0. Origin: the square of 1e-100 is above the
least number of 64 bits.
"""


def normal_matrix(w: Floats, X: Floats) -> Floats:
    """Return (q, q, m) X^T W X for weights (n, m) and columns (n, q), invertible also where columns are alike."""
    n, q = X.shape
    pairs = (X[:, :, None] * X[:, None, :]).reshape(n, q * q)
    return invertible((pairs.T @ w).reshape(q, q, w.shape[1]))


def invertible(matrices: Floats) -> Floats:
    """Return information matrices (q, q, m) with a ridge that rounding hides; writes into them."""
    diagonal = np.einsum("iim->im", matrices)
    diagonal += ROUNDING * diagonal + LEAST_VARIANCE
    return matrices


def inverse_and_log(matrices: Floats) -> tuple[Floats, Floats]:
    """Return the inverses (q, q, m) of positive definite matrices, and (m,) the logarithms of their determinants.

    Gauss–Jordan elimination in place. The pivots of a positive definite matrix need no order (Higham 2002, section 9).

    >>> inverse, log = inverse_and_log(np.array([[[4.0], [2.0]], [[2.0], [3.0]]]))
    >>> inverse[:, :, 0], round(float(np.exp(log[0])), 12)
    (array([[ 0.375, -0.25 ],
           [-0.25 ,  0.5  ]]), 8.0)
    """
    inverse, log = matrices.copy(), np.zeros(matrices.shape[2])
    for i in range(len(inverse)):
        pivot, column = inverse[i, i].copy(), inverse[:, i].copy()
        log += np.log(pivot)
        column[i] = inverse[:, i] = 0.0
        inverse[i, i] = 1.0
        inverse[i] /= pivot
        inverse -= column[:, None] * inverse[i]
    return inverse, log
