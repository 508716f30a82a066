"""The Allan curve that follows from a description: expectation, equivalent degrees of freedom, limits.

The expectation is that of N, B and K (IEEE Std 952 annex C; for point samples that of the discrete processes), of the
term in 1/tau^2, of the lines, and of what the regressors move. With d the second differences of one averaging time,
M of them at a stride of m/R, the estimate s = sum d^2 / (2 M) of Gaussian noise has (Isserlis; Greenhall 1991)

    Var s = 1 / (2 M^2) sum_lag count(lag) r(lag)^2

with r the autocovariance of d, nine terms of the generalised autocovariance of the phase. The equivalent degrees of
freedom are 2 s^2 / Var s. What is not random adds to the expectation and, as a product with the noise, to the variance.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import gammaincinv

from imumon.noise.allan.octave import RATIO
from imumon.noise.fit.observations import BlockSeries
from imumon.noise.power_law import EXACT, phase_autocovariance
from imumon.report import COEFFICIENTS
from imumon.samples import Floats, Ints

LAGS = 12
"""Clusters over which the covariance of differences is summed: that of flicker falls with the fourth power."""
LINE_NODES = np.linspace(-2.2, 2.2, 23)
"""Frequencies by which a line is represented, in widths: its frequency wanders."""

_FEW_EDF = (1.0, 1.02, 1.06, 1.14, 1.24, 1.45, 1.8, 2.4, 3.0, 3.6, 4.7, 6.4, 8.7, 12.2, 18.0)
_FEW_QUANTILE = (
    *(0.001, 0.0048, 0.0077, 0.0142, 0.02, 0.0305, 0.0475, 0.074),
    *(0.103, 0.132, 0.182, 0.245, 0.314, 0.39, 0.472),
)


def noise_variances(m: Ints, *, averaged: bool) -> Floats:
    """Return (3, k) the Allan variance of N = B = K = 1 in units of tau0 at clusters of m samples.

    >>> noise_variances(np.array([1, 2]), averaged=True)[1].round(4)
    array([0.4413, 0.4413])
    >>> noise_variances(np.array([1, 2]), averaged=False)[1].round(4)
    array([0.6366, 0.5093])
    """
    clusters = m.astype(np.float64)
    flicker, walk = np.full(m.size, COEFFICIENTS["B"].deviation(1.0) ** 2), clusters / 3.0
    if not averaged:
        walk = walk * (1.0 + 0.5 / clusters**2)
        short = m < EXACT  # beyond, point samples of flicker are like averages
        phase = _sampled_flicker(2 * EXACT)
        flicker[short] = (phase[2 * m[short]] - 4.0 * phase[m[short]]) / clusters[short] ** 2
    return np.stack((1.0 / clusters, flicker, walk))


@lru_cache(maxsize=4)
def _sampled_flicker(reach: int) -> Floats:
    """Return (reach + 1,) the generalised autocovariance of summed sampled flicker, up to a lag^2 term.

    That of (1 - z^-1)^(-1/2) w itself is -1/pi sum_{j=1..k} 1/(j - 1/2) (Kasdin & Walter 1992); it is summed twice.
    """
    rate = np.concatenate([[0.0], -np.cumsum(1.0 / (np.arange(1, reach + 1) - 0.5)) / np.pi])
    slopes = -np.cumsum(rate[:reach])  # S(k+1) - S(k), S even
    return np.concatenate([[0.0], np.cumsum(slopes)])


@lru_cache(maxsize=4)
def _difference_covariances() -> Floats:
    """Return (3, l) r of N = B = K = 1 by lag in strides of m/R, in units of the cluster."""
    lag = np.arange(LAGS * RATIO + 1) / RATIO

    weights = {-2: 1.0, -1: -4.0, 0: 6.0, 1: -4.0, 2: 1.0}
    return np.asarray(sum(weight * phase_autocovariance(lag + shift) for shift, weight in weights.items()))


def degrees_of_freedom(m: Ints, terms: Ints, span: int, powers: Floats) -> Floats:
    """Return (k,) the equivalent degrees of freedom of each octave; 0.0 where there is no difference.

    Parameters
    ----------
    m : (k,) samples of a cluster.
    terms : (k,) differences that there are.
    span : samples of the record, missing ones included.
    powers : (3,) N^2, B^2, K^2 in units of tau0.
    """
    unit = _difference_covariances()
    out = np.zeros(m.size)
    for at, (cluster, count) in enumerate(zip(m.tolist(), terms.tolist(), strict=True)):
        if not count:
            continue
        # in units of the cluster: N^2 / m, B^2, K^2 m
        r = powers * np.array([1.0 / cluster, 1.0, float(cluster)]) @ unit
        stride = max(1, cluster // RATIO)
        own = r[:: RATIO * stride // cluster] if cluster < RATIO else r
        full = max((span - 2 * cluster) // stride + 1, 1)
        counts = np.maximum(full - np.arange(own.size), 0.0)
        counts[1:] *= 2.0
        total = float(counts @ own**2) / full**2
        edf = float(own[0] ** 2 / max(total, 1e-300)) if own[0] > 0.0 else 0.0
        out[at] = max(edf * min(1.0, count / full), 1.0)
    return out


def line_variances(m: Ints, frequency: float, width: float, power: float) -> Floats:
    """Return (k,) the Allan variance of a line: 2 P sin^4(pi f m) / (m sin(pi f))^2 (IEEE Std 1139 annex B).

    Parameters
    ----------
    frequency, width : cycles per sample.
    power : (channel unit)^2, variance of the line.
    """
    f = np.clip(frequency + width * LINE_NODES, 1e-9, 0.5)
    weight = np.exp(-0.5 * LINE_NODES**2)
    weight /= weight.sum()
    sine = np.sin(np.pi * np.multiply.outer(m, f))
    return np.asarray(2.0 * power * (sine**4 / np.multiply.outer(m, np.sin(np.pi * f)) ** 2) @ weight)


def moved_variances(series: BlockSeries, moved: Floats) -> Floats:
    """Return (2, j) clusters in samples, and the Allan variance there of what the regressors move.

    Parameters
    ----------
    moved : (n,) channel unit at each block.
    """
    found = []
    size = 1
    while 2 * size <= series.count.max():
        squares, count = 0.0, 0
        for begin, number in zip(series.begin, series.count, strict=True):
            if number >= 2 * size:
                total = np.concatenate(([0.0], np.cumsum(moved[begin : begin + number])))
                steps = (total[2 * size :] - 2.0 * total[size:-size] + total[: -2 * size]) / size
                squares, count = squares + float(steps @ steps), count + steps.size
        found.append((float(size * series.length), 0.5 * squares / count))
        size *= 2
    return np.array(found).reshape(-1, 2).T


def moved_variances_at(m: Ints, variances: Floats) -> Floats:
    """Return (k,) the Allan variance of `moved_variances` at clusters of m samples."""
    clusters, shares = variances
    if not shares.any():
        return np.zeros(m.size)
    # over m^2 it is smooth; within a block it is a straight line
    smooth = np.log(np.maximum(shares, 1e-300) / clusters**2)
    return np.asarray(np.exp(np.interp(np.log(m), np.log(clusters), smooth)) * m.astype(np.float64) ** 2)


def limit_factors(edf: Floats) -> tuple[Floats, Floats]:
    """Return (k,) what an Allan deviation is multiplied by for its lower and upper 95 % limit."""
    dof = np.maximum(edf, 1.0)
    with np.errstate(divide="ignore"):  # too few differences for a limit: it is infinite
        low = 1.0 / np.sqrt(share_of_expectation(0.975, dof))
        high = 1.0 / np.sqrt(few_differences_quantile(dof))
    return low, high


def share_of_expectation(probability: float, dof: Floats) -> Floats:
    """Return the chi-square quantile over its expectation, for any positive degrees of freedom."""
    return np.asarray(2.0 * gammaincinv(dof / 2.0, probability) / dof)


def few_differences_quantile(dof: Floats) -> Floats:
    """Return the 2.5 % quantile of an Allan variance over its expectation, also for few differences.

    Chi-square of the same equivalent degrees of freedom has too long a tail towards zero there. Several
    squares of unequal weights are less often all small than one and a fraction of equal ones. The table is
    the distribution of the squares with their weights, the eigenvalues of the covariance of the differences
    at R = 8, for flicker and random walk (white noise is up to a third narrower); from 18 degrees of freedom
    on it is that of chi-square. It is lowered by a tenth, because the degrees of freedom are fitted too.

    >>> few_differences_quantile(np.array([1.0, 1.24, 100.0])).round(3)
    array([0.001, 0.02 , 0.742])
    """
    few = np.interp(np.log(dof), np.log(_FEW_EDF), _FEW_QUANTILE)
    return np.asarray(np.where(dof < _FEW_EDF[-1], few, share_of_expectation(0.025, dof)))


def density_variances(m: Ints, f: Floats, width: Floats, more: Floats) -> Floats:
    """Return (k,) what an additional density contributes: int 4 S sin^4(pi f m) / (m sin(pi f))^2 df.

    Parameters
    ----------
    f, width : (n,) cycles per sample, bins; the factor is averaged over each.
    more : (n,) (channel unit)^2 per cycle per sample, two-sided.
    """
    angle, spread = 2.0 * np.pi * np.multiply.outer(m, f), np.multiply.outer(m, width)
    fourth = (
        0.375 - 0.5 * np.cos(angle) * np.sinc(spread) + 0.125 * np.cos(2.0 * angle) * np.sinc(2.0 * spread)
    )
    scale = 4.0 * width * more / np.sin(np.pi * f) ** 2
    return np.asarray(fourth @ scale / m.astype(np.float64) ** 2)
