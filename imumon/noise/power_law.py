"""White noise, flicker and random walk of N = B = K = 1: density, autocovariance, variance of cosine coefficients.

In units of the interval between samples, two-sided, f in cycles per sample. All that is expected of N, B and K follows
from these: Allan variances, Welch sums, cosine coefficients of block means.

    noise          density of the rate    autocovariance of its integral at a lag t
    white          N^2                    -|t| / 2 N^2
    flicker        B^2 / (2 pi f)         t^2 ln|t| / (2 pi) B^2
    random walk    K^2 / (2 pi f)^2       |t|^3 / 12 K^2

The densities are those of IEEE Std 952, annex C. The autocovariances are generalised: the integrals are not stationary,
but the covariance of differences whose order is high enough follows from them as if they were (Greenhall, IEEE Trans.
Instrum. Meas. 40, 1991).

>>> sampled_density(np.array([0.01]), averaged=True)[:, 0].round(2).tolist()  # nearly 1, 1/(2 pi f), 1/(2 pi f)^2
[1.0, 15.91, 253.22]

In the basis of the discrete cosine transform (DCT-II) white noise and random walk have a diagonal covariance, flicker
nearly: correlations of its coefficients are at most 0.12 and enter the information squared. So the coefficients count
as independent. Coefficient k of n blocks belongs to the frequency k / (2 n) cycles per block. The variance of flicker
is its density times a factor close to one of the lowest coefficients, where the ends of the record show. That factor
depends on k only and is computed once, from the autocovariance.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import zeta

from imumon.model.samples import Floats

EXACT = 256
"""Blocks, or samples of a cluster, up to which flicker is computed exactly: beyond, what it tends to serves."""


def sampled_density(f: Floats, *, averaged: bool) -> Floats:
    """Return (3, k) the density of samples.

    A sample that is an average over its interval adds the factor sinc^2 and the aliases, a point sample is that of the
    discrete processes of Kasdin and Walter (1992).

    Parameters
    ----------
    f : (k,) cycles per sample, above 0 and at most 1/2.
    averaged : the samples are true averages over their interval, else point samples.
    """
    if not averaged:
        slope = 2.0 * np.sin(np.pi * f)
        return np.stack((np.ones_like(f), 1.0 / slope, 1.0 / slope**2))
    square = np.sin(np.pi * f) ** 2
    # sinc^2 times the sum of the aliases |f + k|^-3 over all k, which the Hurwitz zeta function has in closed form
    flicker = square * (zeta(3.0, f) + zeta(3.0, 1.0 - f)) / (2.0 * np.pi**3)
    return np.stack((np.ones_like(f), flicker, 0.25 / square - 1.0 / 6.0))


def phase_autocovariance(lag: Floats) -> Floats:
    """Return (3, k) the generalised autocovariance of the integral of the noise at a lag (Greenhall 1991)."""
    size = np.abs(lag)
    log = np.log(np.where(size > 0.0, size, 1.0))
    return np.stack((-0.5 * size, size**2 * log / (2.0 * np.pi), size**3 / 12.0))


def average_covariance(n: int) -> Floats:
    """Return (3, n, n) the covariance of n neighbouring averages, up to what is the same for all of them.

    >>> average_covariance(2)[0]
    array([[1., 0.],
           [0., 1.]])
    """
    lag = np.arange(float(n))
    by_lag = (
        2.0 * phase_autocovariance(lag) - phase_autocovariance(lag - 1.0) - phase_autocovariance(lag + 1.0)
    )
    return np.asarray(by_lag[:, np.abs(np.arange(n)[:, None] - np.arange(n))])


@lru_cache(maxsize=1)
def _edge_factors() -> Floats:
    """Return (EXACT - 1,) the variances of flicker over its density."""
    import scipy.fft

    matrix = average_covariance(EXACT)[1]
    matrix = scipy.fft.dct(scipy.fft.dct(matrix, axis=0, norm="ortho"), axis=1, norm="ortho")
    k = np.arange(1, EXACT)
    return np.asarray(np.diag(matrix)[1:] / sampled_density(k / (2.0 * EXACT), averaged=True)[1])


def cosine_variances_of(autocovariance: Floats) -> Floats:
    """Return (n - 1,) the variances of the cosine coefficients 1 to n - 1 of n values (DCT-II, orthonormal).

    Coefficient k has the angle x = pi k / n. Products of two cosines of it at a lag l sum to
    ((n - l) cos(l x) - sin(l x) / sin x) / n.

    Parameters
    ----------
    autocovariance : (n,) of the values, by lag.
    """
    n = autocovariance.size
    k = np.arange(1, n)
    cosines = np.fft.rfft(autocovariance * np.arange(n, 0, -1), 2 * n)[k].real
    sines = -np.fft.rfft(autocovariance, 2 * n)[k].imag
    return np.asarray(2.0 / n * (cosines - sines / np.sin(np.pi * k / n)) - autocovariance[0])


@lru_cache(maxsize=32)
def cosine_variances(n: int) -> Floats:
    """Return (3, n - 1) the variances of coefficients 1 to n - 1 of n block means, for N = B = K = 1.

    In units of a block. The edges of the highest coefficients of flicker are not modelled: 1.4 % of 16 means, less of
    more.

    >>> cosine_variances(8).round(3)[:, :3]
    array([[1.   , 1.   , 1.   ],
           [1.946, 1.097, 0.716],
           [6.402, 1.54 , 0.643]])
    """
    k = np.arange(1, n)
    edge = np.ones(n - 1)
    factors = _edge_factors()[: EXACT // 2]
    edge[: factors.size] = factors[: n - 1]
    return sampled_density(k / (2.0 * n), averaged=True) * np.stack((np.ones(n - 1), edge, np.ones(n - 1)))
