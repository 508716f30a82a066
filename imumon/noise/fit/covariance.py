"""Exact covariance of the octave Allan variances of white noise, flicker, random walk and quantisation.

An Allan variance is half the mean square of second differences d of the phase x (the integral of the rate),
s_i = 1/(2 M_i) sum d_i^2. For Gaussian noise (Isserlis) the covariance of two octaves is

    Cov(s_i, s_j) = 1/(2 M_i M_j) sum_delta count(delta) r_ij(delta)^2,   (Greenhall 1991; NIST SP 1065, 5.4)

where r_ij(delta) is the covariance of two differences whose first clusters begin delta apart. It has nine
terms of the generalised autocovariance S of the phase, which depends on the type of noise:

    white  -|t|/2 N^2,   flicker  t^2 ln|t| / (2 pi) B^2,   random walk  |t|^3/12 K^2,   quantisation  Q^2
    at 0.

Since r is a sum over the types of noise, r = sum_a p_a r_a, the covariance is a quadratic form in the
powers p = (N^2, B^2, K^2, Q^2): its tables depend only on the length of the record and the octaves.

Point samples differ from true averages at the shortest octaves: there S is that of the sampled process,
(|k|^3 - |k|)/12 for the random walk and for flicker the one of (1 - z^-1)^(-1/2) (Kasdin 1995).

Powers are in units of tau0: p = (N^2/tau0, B^2, K^2 tau0, Q^2/tau0^2, R^2 tau0^2). The fifth term is
a rate ramp, R^2 tau^2/2, which has no noise of its own but multiplies that of the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from imumon.noise.allan.octave import RATIO
from imumon.samples import Floats, Ints

TERMS = ("N", "B", "K", "Q", "R")
"""Order of the terms of the model: white, flicker, random walk, quantisation, rate ramp."""

LEFT, RIGHT = np.triu_indices(4)
PAIRS = tuple(zip(LEFT.tolist(), RIGHT.tolist(), strict=True))  # Pairs of noise types that have a table
_HALF = np.where(LEFT == RIGHT, 0.5, 1.0)
_GROWTH = np.array([-1.0, 0.0, 1.0, -2.0])  # power of the cluster length with which r grows, by noise type
_SMOOTH = np.array([[0.0], [1.0], [1.0], [0.0]])  # noise types whose rate has a significant derivative
_DEGREE = np.repeat([2, 1], [len(PAIRS), 4])  # of r in `_sums`
FLICKER_FLOOR = 2.0 * np.log(2.0) / np.pi  # Allan variance of averaged flicker of B = 1

FAR_OCTAVES = 7
"""Octaves. If two octaves are further apart, the shorter difference acts as a derivative on the longer one,
which saves most of the lags. Sensitivity: halved 7.9 %, doubled 0.8 % (accel y K high of the record
"disturbed")."""

TAIL_CLUSTERS = 8
"""Cluster lengths after which the covariance of two differences is neglected (of flicker it falls as lag^-2).
Not critical."""

COARSE_LAGS = 16
"""Lags represented by one of them where the octaves are more than `FAR_OCTAVES` apart. Not critical."""

SCALED_FROM = 5
"""Octave. From here on octaves are scaled copies of one another. The tables then agree with the definition to
2e-4. Sensitivity: halved changes which values appear, doubled 0.1 % (a of the record "ValueError")."""

SAMPLED_OCTAVES = 12
"""Octaves whose flicker is computed for point samples; beyond, the difference is below 1e-7. Not critical."""

LINEAR_CLUSTERS = 16
"""Cluster lengths of the longer octave from which on a pair's sums grow linearly with the record. Not
critical."""

SPAN_BITS = 6
"""Bits to which the length of a record is rounded down for its tables: at most 3 % too short. Sensitivity:
halved 74 %, doubled 4.2 % (gyro x K high of the record "disturbed")."""


@dataclass(frozen=True, slots=True, eq=False)
class CovarianceTables:
    """Covariance of the octaves for one record length, by pairs of noise types.

    Attributes
    ----------
    averaged : for true averages, else for point samples.
    span : samples, length of the record.
    full : (k,) differences of an uninterrupted record.
    sums : (14, t) 1, lower triangles of `pairs` and `means`, by rows.
    design : (k, 5) 1, expectation of s by `TERMS`.
    """

    averaged: bool
    span: int
    full: Ints
    sums: Floats
    design: Floats

    @property
    def pairs(self) -> Floats:
        """(10, k, k) 1, Cov(s_i, s_j) = sum over `PAIRS` of p_a p_b pairs[ab, i, j]."""
        return self.sums[: len(PAIRS), triangle_index(self.full.size)]

    @property
    def means(self) -> Floats:
        """(4, k, k) 1, Cov of the mean differences at octaves i and j, by noise type."""
        return self.sums[len(PAIRS) :, triangle_index(self.full.size)]


@lru_cache(maxsize=8)
def triangle_index(octaves: int) -> Ints:
    """Return (k, k) the position of each element of a symmetric matrix in its lower triangle by rows."""
    rows = np.arange(octaves)
    low, high = np.minimum.outer(rows, rows), np.maximum.outer(rows, rows)
    return np.asarray(high * (high + 1) // 2 + low)


def design(octaves: int, *, averaged: bool) -> Floats:
    """Return the expectation of the Allan variance by terms.

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
    flicker = np.full(octaves, FLICKER_FLOOR)
    walk = m / 3.0
    if not averaged:
        walk = walk * (1.0 + 0.5 / m**2)
        short = min(octaves, SAMPLED_OCTAVES)
        phase = _sampled_flicker(2 << (short - 1))
        lags = (1 << np.arange(short)).astype(np.int64)
        flicker[:short] = (phase[2 * lags] - 4.0 * phase[lags]) / m[:short] ** 2
    return np.column_stack([1.0 / m, flicker, walk, 3.0 / m**2, m**2 / 2.0])


def _stride(octave: int) -> int:
    """Samples between the beginnings of two differences of an octave."""
    return max(1, (1 << octave) // RATIO)


def _strides(m: Ints) -> Ints:
    """Return the same by cluster length."""
    return np.maximum(1, m // RATIO)


def octaves_in(span: int) -> int:
    """Return the number of octaves that have a difference in a record of `span` samples."""
    return max(0, span.bit_length() - 1)


def tables(span: int, octaves: int, *, averaged: bool) -> CovarianceTables:
    """Return the tables for a record of `span` samples, or up to 3 % less, from a cache.

    Parameters
    ----------
    span : samples, length of the time grid.
    octaves : how many, from m = 1 on; at most `octaves_in(span)`.
    averaged : true cluster averages, else point samples.
    """
    step = max(0, span.bit_length() - SPAN_BITS)
    return _cached_tables(span >> step << step, octaves, averaged)


@lru_cache(maxsize=32)
def _cached_tables(span: int, octaves: int, averaged: bool) -> CovarianceTables:
    """Return the tables for exactly `span` samples."""
    m = 1 << np.arange(octaves, dtype=np.int64)
    full = (span - 2 * m) // _strides(m) + 1
    j, i = np.tril_indices(octaves)
    sums = _sums_of_pairs(i, j, span, averaged)
    sums[: len(PAIRS)] *= _HALF[:, None]
    sums /= full[i] * full[j].astype(np.float64)
    return CovarianceTables(averaged, span, full, sums, design(octaves, averaged=averaged))


def _sums_of_pairs(i: Ints, j: Ints, span: int, averaged: bool) -> Floats:
    """Return (14, t) `_sums` of pairs of octaves i <= j, (t,) each, in a record of `span` samples."""
    apart, first = j - i, np.minimum(i, SCALED_FROM)
    copies = i - first  # octaves by which i and j are above those of which they are scaled copies
    scales = _scales(copies)
    lines = np.stack([_lines(each, averaged) for each in range(int(apart.max()) + 1)], axis=-1)
    begin, slope = lines[:, :, first, apart]
    sums = np.asarray((begin + slope * (span >> copies)) * scales)
    # Pairs for which the record is too short. Those of one j with all far i are computed at once, and copies
    # of one pair too.
    m = 1 << j
    short = np.flatnonzero((span < LINEAR_CLUSTERS * m) | (span % _strides(m) != 0))
    group = np.where(apart[short] > FAR_OCTAVES, -j[short], 64 * apart[short] + first[short])
    for key in sorted(set(group.tolist())):
        at = short[group == key]
        if key < 0:
            sums[:, at] = _sums(i[at], -key, span, averaged).T
        else:
            base = key % 64
            sums[:, at] = _sums(base, base + key // 64, span >> copies[at], averaged).T * scales[:, at]
    return sums


@lru_cache(maxsize=128)
def _lines(apart: int, averaged: bool) -> Floats:
    """Return the lines along which the sums grow while the record is much longer than both octaves.

    Returns
    -------
    (2, 14, 6) sums of octaves i and i + apart extrapolated to a record of length 0, and growth per sample;
    all other octaves are scaled copies of these i = 0 to `SCALED_FROM`.
    """
    lines = []
    for i in range(SCALED_FROM + 1):
        step = LINEAR_CLUSTERS << (i + apart)
        one, two = (_sums(i, i + apart, span, averaged) for span in (step, 2 * step))
        lines.append((2.0 * one - two, (two - one) / step))
    return np.stack(lines, axis=-1).reshape(2, -1, SCALED_FROM + 1)


def _sums(i: int | Ints, j: int, span: int | Ints, averaged: bool) -> Floats:
    """Return (..., 14) sums over the lags: of the products of two noise types, and of the types alone.

    Parameters
    ----------
    i : octave, or several that are all more than `FAR_OCTAVES` below j. So short a difference acts as the
        derivative of a rate that the long one smooths, and r is proportional to m_i. That of white noise and
        quantisation is negligible.
    span : samples, length of the record, or several for one i.
    """
    highest = int(np.max(i))
    near = max(highest, j - FAR_OCTAVES)
    base = min(near, SCALED_FROM)
    core, tail = _differences(base, j - near, averaged)
    step = _stride(near)
    if near > highest:
        core, tail, step = core[:, ::COARSE_LAGS] * _SMOOTH, tail[::COARSE_LAGS], step * COARSE_LAGS
    cut = core.shape[1]
    count = _counts(i, j, span, step * np.arange(cut + tail.size))
    weighted, beyond = count[..., None, :cut] * core, count[..., cut:] * tail
    products, alone = weighted @ core.T, weighted.sum(axis=-1)
    products[..., 1, 1] += beyond @ tail
    alone[..., 1] += beyond.sum(axis=-1)
    sums = np.concatenate([products[..., LEFT, RIGHT], alone], axis=-1)
    if near > base:
        sums *= _scales(near - base)
    if near > highest:
        m = (1 << np.asarray(i))[..., None]
        sums *= step / _strides(m) * (m / (1 << near)) ** _DEGREE  # lags that each represents
    return np.asarray(sums)


def _scales(octaves: int | Ints) -> Floats:
    """Return (14, ...) the factors of `_sums` if clusters and record are longer by a number of octaves."""
    growth = 2.0 ** np.multiply.outer(_GROWTH, octaves)
    return np.concatenate([growth[LEFT] * growth[RIGHT], growth])


def _counts(i: int | Ints, j: int, span: int | Ints, steps: Ints) -> Floats:
    """Return the number of pairs of differences at octaves i <= j by the distance of their middles.

    When the middles coincide, the shorter difference begins m_j - m_i after the longer. By that much, plus n
    strides for the nth longer difference, it can begin earlier and still lie in the record. The count for
    later ones is the same counted from the end of the record, where the samples that the longer differences
    leave over are available too. Distance 0 is on both sides but counts once.

    Parameters
    ----------
    steps : (l,) samples, multiples of the stride of octave i.

    Returns
    -------
    (..., l)

    >>> _counts(0, 1, 6, np.array([0, 1, 2, 3]))
    array([3., 6., 4., 2.])
    """
    m, span = (1 << np.asarray(i))[..., None], np.asarray(span)[..., None]
    stride_i, stride_j = _strides(m), _stride(j)
    terms = (span - (2 << j)) // stride_j + 1
    left = (span - span % stride_i) % stride_j
    slack = (1 << j) - m - steps
    shift = stride_j.bit_length() - 1
    before = np.minimum(np.maximum((slack >> shift) + terms, 0), terms)
    after = np.minimum(np.maximum((slack + left >> shift) + terms, 0), terms) if left.any() else before
    count = (before + after).astype(np.float64)
    count[..., 0] *= 0.5
    return np.asarray(count)


@lru_cache(maxsize=64)
def _differences(i: int, apart: int, averaged: bool) -> tuple[Floats, Floats]:
    """Return the covariance r of differences at octaves i and i + apart by the distance of their middles.

    Distances from 0 on, in strides of octave i; r is the same on both sides.

    Returns
    -------
    core : (4, c) units of tau0, by noise type, at least as far as the two differences overlap.
    tail : (l,) units of tau0, of flicker beyond that; of the others it is 0.
    """
    stride = _stride(i)
    short = (1 << i) // stride
    long = short << apart
    size = TAIL_CLUSTERS * long + 1
    phase = _phase(size + long + short, averaged, stride)
    phase = np.concatenate([phase[:, long + short : 0 : -1], phase], axis=1)
    # white noise, random walk and quantisation end where the differences separate; both parts can be thinned
    cut = min(-(-(long + short + 1) // COARSE_LAGS) * COARSE_LAGS, size)
    core, tail = np.zeros((4, cut)), np.zeros(size - cut)
    for (p, weight_p), (q, weight_q) in product(enumerate((1.0, -2.0, 1.0)), repeat=2):
        begin = q * long + (2 - p) * short
        core += weight_p * weight_q * phase[:, begin : begin + cut]
        tail += weight_p * weight_q * phase[1, begin + cut : begin + size]
    clusters = float(1 << i) * float(1 << (i + apart))
    return core / clusters, tail / clusters


def _phase(size: int, averaged: bool, stride: int = 1) -> Floats:
    """Return (4, size) the generalised autocovariance of the phase at multiples of a lag, by noise type."""
    lag = stride * np.arange(size, dtype=np.float64)
    phase = np.zeros((4, size))
    phase[0] = -0.5 * lag
    if averaged:
        phase[1, 1:] = lag[1:] ** 2 * np.log(lag[1:]) / (2.0 * np.pi)
        phase[2] = lag * lag * lag / 12.0
    else:
        phase[1] = _sampled_flicker(stride * (size - 1))[::stride]
        phase[2] = (lag * lag * lag - lag) / 12.0
    phase[3, 0] = 1.0
    return phase


def _sampled_flicker(reach: int) -> Floats:
    """Return (reach + 1,) the generalised autocovariance of summed sampled flicker, up to a lag^2 term.

    That of (1 - z^-1)^(-1/2) w itself is -1/pi sum_{j=1..k} 1/(j - 1/2); it is summed twice.
    """
    rate = np.concatenate([[0.0], -np.cumsum(1.0 / (np.arange(1, reach + 1) - 0.5)) / np.pi])
    slopes = -np.cumsum(rate[:reach])  # S(k+1) - S(k), S even
    return np.concatenate([[0.0], np.cumsum(slopes)])
