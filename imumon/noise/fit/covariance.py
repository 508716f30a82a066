"""Covariance of the octave Allan variances, exact, for white noise, flicker, random walk and quantisation.

An Allan variance is half the mean square of second differences d of the phase x (the integral of the rate),
s_i = 1/(2 M_i) sum d_i^2. For Gaussian noise (Isserlis) the covariance of two octaves is

    Cov(s_i, s_j) = 1/(2 M_i M_j) sum_delta count(delta) r_ij(delta)^2,   (Greenhall 1991; NIST SP 1065, 5.4)

r_ij(delta) being the covariance of two differences whose first clusters begin delta apart: nine terms of the
generalised autocovariance S of the phase, each noise's own:

    white  -|t|/2 N^2,   flicker  t^2 ln|t| / (2 pi) B^2,   random walk  |t|^3/12 K^2,   quantisation  Q^2
    at 0.

Since r is a sum over the kinds of noise, r = sum_a p_a r_a, the covariance is a quadratic form in the
powers p = (N^2, B^2, K^2, Q^2): its tables depend on nothing but the length of the record and the octaves.

Point samples differ from true averages at the shortest octaves: there S is that of the sampled process,
(|k|^3 - |k|)/12 for the random walk and for flicker the one of (1 - z^-1)^(-1/2) (Kasdin 1995).

Everything here is in units of tau0: p = (N^2/tau0, B^2, K^2 tau0, Q^2/tau0^2, R^2 tau0^2). The fifth term is
a rate ramp, R^2 tau^2/2, which has no noise of its own but multiplies that of the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from imumon.samples import Floats, Ints

TERMS = ("N", "B", "K", "Q", "R")
"""Order of the terms of the model: white, flicker, random walk, quantisation, rate ramp."""

PAIRS = tuple((a, b) for a in range(4) for b in range(a, 4))
"""Pairs of noise types of which a table is kept."""
_LEFT, _RIGHT = ([pair[side] for pair in PAIRS] for side in (0, 1))

REACH = 7  # octaves further apart than this: the shorter difference is a derivative beside the longer one
TAIL = 8  # cluster lengths after which the covariance of two differences is neglected (flicker: lag^-2)
_COARSE = 16  # lags taken together beyond that reach
_SHARED = 5  # octaves from here on are taken as scaled copies of one another
_LN2_PI = 2.0 * np.log(2.0) / np.pi


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """Covariance of the octaves of one record length, by pairs of noise types.

    Attributes
    ----------
    averaged : of true averages, else of point samples.
    span : samples, length of the record.
    full : (k,) differences of an uninterrupted record.
    pairs : (10, k, k) 1, tables of `PAIRS`; Cov(s_i, s_j) = sum over pairs of p_a p_b pairs[ab, i, j].
    means : (4, k, k) 1, Cov of the mean differences at octaves i and j, by noise type.
    design : (k, 5) 1, expectation of s by `TERMS`.
    """

    averaged: bool
    span: int
    full: Ints
    pairs: Floats
    means: Floats
    design: Floats

    def covariance(self, p: Floats, thinning: Floats) -> Floats:
        """Covariance of the Allan variances.

        Parameters
        ----------
        p : (..., 5) powers in units of tau0, in the order of `TERMS`.
        thinning : (..., k) sqrt(full differences / differences there are), 1 without gaps.

        Returns
        -------
        (..., k, k) unit of p squared.
        """
        k = self.full.size
        products = p[..., _LEFT] * p[..., _RIGHT]
        total = (products @ self.pairs.reshape(len(PAIRS), k * k)).reshape(*p.shape[:-1], k, k)
        ramp = p[..., 4]
        if np.any(ramp > 0.0):
            m = 2.0 ** np.arange(k)
            means = (p[..., :4] @ self.means.reshape(4, k * k)).reshape(*p.shape[:-1], k, k)
            total = total + ramp[..., None, None] * means * (m[:, None] * m)
        return np.asarray(total * (thinning[..., :, None] * thinning[..., None, :]))


def design(octaves: int, *, averaged: bool) -> Floats:
    """Expectation of the Allan variance by terms.

    IEEE Std 952 annex C for true averages; for point samples the discrete expectation.

    Returns
    -------
    (k, 5) 1, columns of `TERMS` in units of tau0.

    >>> design(2, averaged=True)[:, 1].round(4)
    array([0.4413, 0.4413])
    >>> (design(2, averaged=False)[:, 1] / design(2, averaged=True)[:, 1]).round(2)
    array([1.44, 1.15])
    """
    m = 2.0 ** np.arange(octaves)
    flicker = np.full(octaves, _LN2_PI)
    walk = m / 3.0
    if not averaged:
        walk = walk * (1.0 + 0.5 / m**2)
        short = min(octaves, 12)  # beyond, the difference is below 1e-7
        phase = _sampled_flicker(2 << (short - 1))
        lags = (1 << np.arange(short)).astype(np.int64)
        flicker[:short] = (phase[2 * lags] - 4.0 * phase[lags]) / m[:short] ** 2
    return np.column_stack([1.0 / m, flicker, walk, 3.0 / m**2, m**2 / 2.0])


def octaves_in(span: int) -> int:
    """Number of octaves that have a difference in so many samples."""
    return max(0, int(span).bit_length() - 1)


def tables(span: int, octaves: int, *, averaged: bool) -> Tables:
    """Tables for a record of so many samples, from a cache that a growing record refreshes every 3 %.

    Parameters
    ----------
    span : samples, length of the time grid.
    octaves : how many, from m = 1 on; at most `octaves_in(span)`.
    averaged : true cluster averages, else point samples.
    """
    span = max(int(span), 1 << octaves)
    step = max(0, span.bit_length() - 6)
    return _tables(span >> step << step, octaves, averaged)


@lru_cache(maxsize=16)
def _tables(span: int, octaves: int, averaged: bool) -> Tables:
    m = 1 << np.arange(octaves, dtype=np.int64)
    full = (span - 2 * m) // np.maximum(1, m // 8) + 1
    sums = np.zeros((len(PAIRS) + 4, octaves, octaves))
    for first in range(min(octaves, _SHARED + 1)):
        for apart in range(octaves - first):
            last = octaves if first == _SHARED else first + apart + 1
            j = np.arange(first + apart, last)
            i = j - apart
            sums[:, i, j] = sums[:, j, i] = _copies(first, apart, span >> (i - first), averaged)
    for index, (a, b) in enumerate(PAIRS):
        sums[index] *= 0.5 if a == b else 1.0
    sums /= np.multiply.outer(full.astype(np.float64), full)
    pairs, means = sums[: len(PAIRS)], sums[len(PAIRS) :]
    return Tables(averaged, span, full, pairs, means, design(octaves, averaged=averaged))


def _copies(i: int, apart: int, spans: Ints, averaged: bool) -> Floats:
    """Sums of `_sums` of octaves that are scaled copies of i and i + apart, i + n of the nth.

    While the record is much longer than both, every sum grows with its length along a straight line.

    Parameters
    ----------
    spans : (n,) length of the record, in samples of the scaled copy: halved for each octave.

    Returns
    -------
    (14, n)
    """
    j = i + apart
    line = (spans >= 16 << j) & (spans % max(1, (1 << j) // 8) == 0)
    found = np.empty((len(PAIRS) + 4, spans.size))
    if line.any():
        begin, slope = _line(i, apart, averaged)
        found[:, line] = begin[:, None] + slope[:, None] * spans[line]
    for at in np.flatnonzero(~line):
        found[:, at] = _sums(i, j, int(spans[at]), averaged)
    scale = 2.0 ** (np.arange(spans.size) * np.array([[-1.0], [0.0], [1.0], [-2.0]]))
    found[: len(PAIRS)] *= scale[_LEFT] * scale[_RIGHT]
    found[len(PAIRS) :] *= scale
    return found


@lru_cache(maxsize=1024)
def _line(i: int, apart: int, averaged: bool) -> tuple[Floats, Floats]:
    """(14,) sums of octaves i and i + apart at a record of no length, and their growth with each sample."""
    step = 16 << (i + apart)
    one, two = (_sums(i, i + apart, span, averaged) for span in (step, 2 * step))
    return 2.0 * one - two, (two - one) / step


def _sums(i: int, j: int, span: int, averaged: bool) -> Floats:
    """(14,) sums over the lags: of the products of two noise types, by `PAIRS`, and of the types alone."""
    (stride_i, terms_i), (stride_j, terms_j) = (
        (stride, (span - (2 << octave)) // stride + 1)
        for octave in (i, j)
        for stride in [max(1, (1 << octave) // 8)]
    )
    steps, r, each = _differences(i, j, averaged)
    centre = (1 << i) - (1 << j)
    before, after = (_counts(centre + side * steps, stride_i, stride_j, terms_i, terms_j) for side in (-1, 1))
    weighted = r * ((before + after) * each)
    return np.concatenate([(weighted @ r.T)[_LEFT, _RIGHT], weighted.sum(axis=1)])


def _counts(lags: Ints, stride_i: int, stride_j: int, terms_i: int, terms_j: int) -> Ints:
    """How many pairs of differences begin `lags` samples apart (octave j after octave i).

    >>> _counts(np.array([-1, 0, 1]), 1, 1, 5, 3)
    array([3, 3, 2])
    """
    first = np.maximum(0, -(-lags // stride_j))
    last = np.minimum(terms_j - 1, (lags + (terms_i - 1) * stride_i) // stride_j)
    return np.asarray(np.maximum(0, last - first + 1))


def _differences(i: int, j: int, averaged: bool) -> tuple[Ints, Floats, Floats]:
    """Covariance of differences at octaves i <= j by the distance of their middles, the same on both sides.

    Returns
    -------
    steps : (l,) samples, from the middle of the one at octave i to that of the one at octave j.
    r : (4, l) units of tau0, by noise type.
    each : (l,) lags that each of these stands for; half as many at distance 0, which is on both sides.
    """
    near = max(i, j - REACH)
    base = min(near, _SHARED)
    steps, r = _base(base, j - near, averaged)
    scale = 2.0 ** (near - base)
    r = r * np.array([1.0 / scale, 1.0, scale, 1.0 / scale**2])[:, None]
    steps = steps * (1 << (near - base))
    each = np.where(steps == 0, 0.5, 1.0)
    if near == i:
        return steps, r, each
    # So short a difference takes the derivative of a rate that the long one smooths: r goes with m_i. White
    # noise and quantisation have none to speak of.
    r = r[:, ::_COARSE] * np.array([0.0, 1.0, 1.0, 0.0])[:, None] / 2.0 ** (near - i)
    stride_i, stride_near = max(1, (1 << i) // 8), max(1, (1 << near) // 8)
    return steps[::_COARSE], r, each[::_COARSE] * (_COARSE * stride_near / stride_i)


@lru_cache(maxsize=64)
def _base(i: int, apart: int, averaged: bool) -> tuple[Ints, Floats]:
    """`_differences` of the octaves that all others are scaled copies of."""
    short = 1 << i
    long = short << apart
    stride = max(1, short // 8)
    steps = np.arange(0, TAIL * long + 1, stride, dtype=np.int64)
    phase = _phase(TAIL * long + long + short + 1, averaged)
    r = np.zeros((4, steps.size))
    for p, weight_p in enumerate((1.0, -2.0, 1.0)):
        for q, weight_q in enumerate((1.0, -2.0, 1.0)):
            r += weight_p * weight_q * phase[:, np.abs(steps + (q - 1) * long - (p - 1) * short)]
    return steps, r / (float(short) * float(long))


def _phase(size: int, averaged: bool) -> Floats:
    """(4, size) generalised autocovariance of the phase by lag, one row a noise type."""
    lag = np.arange(size, dtype=np.float64)
    phase = np.zeros((4, size))
    phase[0] = -0.5 * lag
    if averaged:
        phase[1, 1:] = lag[1:] ** 2 * np.log(lag[1:]) / (2.0 * np.pi)
        phase[2] = lag**3 / 12.0
    else:
        phase[1] = _sampled_flicker(size - 1)
        phase[2] = (lag**3 - lag) / 12.0
    phase[3, 0] = 1.0
    return phase


def _sampled_flicker(reach: int) -> Floats:
    """(reach + 1,) generalised autocovariance of the running sum of sampled flicker, but for a lag^2.

    That of (1 - z^-1)^(-1/2) w itself is -1/pi sum_{j=1..k} 1/(j - 1/2); it is summed twice.
    """
    rate = np.concatenate([[0.0], -np.cumsum(1.0 / (np.arange(1, reach + 1) - 0.5)) / np.pi])
    slopes = -np.cumsum(rate[:reach])  # S(k+1) - S(k), S even
    return np.concatenate([[0.0], np.cumsum(slopes)])
