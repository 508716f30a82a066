"""White noise, flicker and random walk of N = B = K = 1: their density and their autocovariance.

In units of the interval between samples, two-sided, f in cycles per sample. All that is expected of N, B and K follows
from these two: Allan variances, Welch sums, cosine coefficients of block means.
"""

from __future__ import annotations

import numpy as np

from imumon.samples import Floats

ALIASES = 20
"""Aliases on each side that are added for averages."""


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
    at = np.abs(f[:, None] + np.arange(-ALIASES, ALIASES + 1))
    rate = 2.0 * np.pi * at
    average = np.sinc(at) ** 2
    return np.stack((np.ones_like(f), (average / rate).sum(axis=1), (average / rate**2).sum(axis=1)))


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
