"""The Allan curve that follows from a model: expectation, equivalent degrees of freedom, limits.

The expectation is the sum of

- the terms: power times `NoiseTerm.allan_variances` (IEEE Std 952 annex C; for point samples that of the discrete
  processes);
- a density S beside them, such as a line or what a filter takes (IEEE Std 1139 annex B):
  sigma^2(m) = 4 int S(f) sin^4(pi f m) / (m sin(pi f))^2 df, 0 to 1/2 cycle per sample;
- what the regressors and the slow oscillations move, which is no noise: its Allan variance is computed from its values.

With d the second differences of one averaging time, M of them at a stride of m/R, the estimate s = sum d^2 / (2 M) of
Gaussian noise has (Isserlis 1918; Greenhall 1991)

    Var s = 1 / (2 M^2) sum_lag count(lag) r(lag)^2,        EDF = 2 s^2 / Var s

with r the autocovariance of d. What is not random adds to the expectation and, as a product with the noise, to the
variance. The 95 % limits are those of chi-square with EDF degrees of freedom, below 18 with a shorter lower tail.

Example: 1,000 samples of white noise have 998 differences of one sample, which are not independent.

>>> from imumon.noise.fit.model import WHITE
>>> edf = degrees_of_freedom(np.array([1]), np.array([998]), 1000, {WHITE: 1.0})
>>> edf.round(0), [round(float(factor[0]), 3) for factor in limit_factors(edf)]
(array([666.]), [0.949, 1.057])
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from imumon.model.samples import Floats, Ints
from imumon.noise.allan.octave import RATIO
from imumon.noise.fit.model import TermPowers, total
from imumon.noise.fit.observations import BlockSeries

VISIBLE = 0.1
"""From here on lines (`vibration`) or a drift (`ramp`) are named, and a temperature explains a share. Unit: of the
Allan variance.

Otherwise: each hum of a microvolt is a caveat. Origin: 5 % of the deviation: about the width of the line of a figure.
"""

DRAWN_WIDTHS = 2.2
"""Half of the band by which the drawn model represents a line. Unit: widths.

Otherwise: a line as one frequency oscillates with tau, the measured curve does not: its frequency wanders. Origin: 97
% of a Gaussian line.
"""
LINE_NODES = np.linspace(-DRAWN_WIDTHS, DRAWN_WIDTHS, 23)

_FEW_EDF = (1.0, 1.02, 1.06, 1.14, 1.24, 1.45, 1.8, 2.4, 3.0, 3.6, 4.7, 6.4, 8.7, 12.2, 18.0)
_FEW_QUANTILE = (
    *(0.001, 0.0048, 0.0077, 0.0142, 0.02, 0.0305, 0.0475, 0.074),
    *(0.103, 0.132, 0.182, 0.245, 0.314, 0.39, 0.472),
)
"""2.5 % quantiles of an Allan variance over its expectation, by equivalent degrees of freedom: eigenvalues of the
covariance of the differences at R = 8, for flicker and random walk."""


def degrees_of_freedom(m: Ints, differences: Ints, span: int, powers: TermPowers) -> Floats:
    """Return (k,) the equivalent degrees of freedom of each octave; 0.0 where there is no difference.

    Parameters
    ----------
    m : (k,) samples of a cluster.
    differences : (k,) differences that there are.
    span : samples of the record, missing ones included.
    powers : of the terms.
    """
    out = np.zeros(m.size)
    covariances = total(powers, lambda term: term.difference_covariances(m))
    possible = possible_differences(m, span).tolist()
    for octave, (cluster, count) in enumerate(zip(m.tolist(), differences.tolist(), strict=True)):
        if not count:
            continue
        r = covariances[octave]
        stride = max(1, cluster // RATIO)
        if cluster < RATIO:  # one difference per sample: fewer strides in a cluster than the table has
            r = r[:: RATIO * stride // cluster]
        full = possible[octave]
        counts = np.maximum(full - np.arange(r.size), 0.0)
        counts[1:] *= 2.0  # a lag occurs in both directions
        variance = float(counts @ r**2) / full**2
        edf = float(r[0] ** 2 / max(variance, 1e-300)) if r[0] > 0.0 else 0.0
        # missing differences reduce it in proportion: they are scattered
        out[octave] = max(edf * min(1.0, count / full), 1.0)
    return out


def possible_differences(m: Ints, span: int) -> Ints:
    """Return (k,) the differences of clusters of m samples in a record of `span` samples without a missing one."""
    stride = np.maximum(1, m // RATIO)
    return np.maximum((span - 2 * m) // stride + 1, 1)


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
    variances = []
    size = 1
    while 2 * size <= series.count.max():
        squares, count = 0.0, 0  # differences do not reach over a gap between segments
        for begin, number in zip(series.begin, series.count, strict=True):
            if number >= 2 * size:
                sums = np.concatenate(([0.0], np.cumsum(moved[begin : begin + number])))
                steps = (sums[2 * size :] - 2.0 * sums[size:-size] + sums[: -2 * size]) / size
                squares, count = squares + float(steps @ steps), count + steps.size
        variances.append((float(size * series.length), 0.5 * squares / count))
        size *= 2
    return np.array(variances).reshape(-1, 2).T


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
