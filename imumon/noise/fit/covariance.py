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

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from imumon.samples import Floats, Ints

TERMS = ("N", "B", "K", "Q", "R")
"""Order of the terms of the model: white, flicker, random walk, quantisation, rate ramp."""

PAIRS = tuple((a, b) for a in range(4) for b in range(a, 4))
"""Pairs of noise types of which a table is kept."""
LEFT, RIGHT = (np.array([pair[side] for pair in PAIRS]) for side in (0, 1))
_ROWS = len(PAIRS) + 4
_HALF = np.array([0.5 if a == b else 1.0 for a, b in PAIRS])
_GROWTH = np.array([-1.0, 0.0, 1.0, -2.0])  # of r with the cluster length: powers of it, by noise type
_SMOOTH = np.array([[0.0], [1.0], [1.0], [0.0]])  # noise types whose rate has a derivative to speak of
_DEGREE = np.repeat([2, 1], [len(PAIRS), 4])  # of r in `_sums`

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
        return self.sums[: len(PAIRS), square(self.full.size)]

    @property
    def means(self) -> Floats:
        """(4, k, k) 1, Cov of the mean differences at octaves i and j, by noise type."""
        return self.sums[len(PAIRS) :, square(self.full.size)]


@lru_cache(maxsize=8)
def square(octaves: int) -> Ints:
    """(k, k) where each element of a symmetric matrix is in its lower triangle by rows."""
    rows = np.arange(octaves)
    low, high = np.minimum.outer(rows, rows), np.maximum.outer(rows, rows)
    return np.asarray(high * (high + 1) // 2 + low)


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


def _stride(octave: int) -> int:
    """Samples between the beginnings of two differences of an octave."""
    return max(1, (1 << octave) // 8)


def _strides(m: Ints) -> Ints:
    """`_stride` by cluster length."""
    return np.maximum(1, m // 8)


def octaves_in(span: int) -> int:
    """Number of octaves that have a difference in so many samples."""
    return max(0, int(span).bit_length() - 1)


def tables(span: int, octaves: int, *, averaged: bool) -> Tables:
    """Tables for a record of so many samples, or up to 3 % less, from a cache: one more in 3 % of growth.

    Parameters
    ----------
    span : samples, length of the time grid.
    octaves : how many, from m = 1 on; at most `octaves_in(span)`.
    averaged : true cluster averages, else point samples.
    """
    span = max(int(span), 1 << octaves)
    step = max(0, span.bit_length() - 6)
    return _tables(span >> step << step, octaves, averaged)


@lru_cache(maxsize=2)  # those of the record, of each kind
def _tables(span: int, octaves: int, averaged: bool) -> Tables:
    return _made(span, octaves, averaged)


def doublings(octaves: int, *, averaged: bool) -> Iterator[Tables]:
    """Tables for a record of 2^octaves samples, for one of twice as many, and so on, all octaves in them.

    They are not kept: those that an outlook takes would hold half a megabyte, and one is made in 1 ms.
    """
    table = _made(1 << octaves, octaves, averaged)
    while True:
        yield table
        table = _made(2 * table.span, table.full.size + 1, averaged, table)


def _made(span: int, octaves: int, averaged: bool, half: Tables | None = None) -> Tables:
    """Tables for just so many samples.

    Parameters
    ----------
    half : tables of the same kind, of half as many samples and an octave less: most pairs are theirs, scaled.
    """
    m = 1 << np.arange(octaves, dtype=np.int64)
    full = (span - 2 * m) // _strides(m) + 1
    j, i = np.tril_indices(octaves)
    sums = np.empty((_ROWS, i.size))
    anew = np.full(i.size, True)
    if half is not None:
        anew = i <= _SHARED
        sums[:, ~anew] = half.sums[:, np.tril_indices(octaves - 1)[1] >= _SHARED] * _scales(1)[:, None]
    i, j = i[anew], j[anew]
    mine = _sums_of_pairs(i, j, span, averaged)
    mine[: len(PAIRS)] *= _HALF[:, None]
    mine /= full[i] * full[j].astype(np.float64)
    sums[:, anew] = mine
    return Tables(averaged, span, full, sums, design(octaves, averaged=averaged))


def _sums_of_pairs(i: Ints, j: Ints, span: int, averaged: bool) -> Floats:
    """(14, t) `_sums` of pairs of octaves i <= j, (t,) each, in a record of so many samples."""
    apart, first = j - i, np.minimum(i, _SHARED)
    copies = i - first  # how many octaves i and j are above those that they are scaled copies of
    scales = _scales(copies)
    lines = np.stack([_lines(each, averaged) for each in range(int(apart.max()) + 1)], axis=-1)
    begin, slope = lines[:, :, first, apart]
    sums = np.asarray((begin + slope * (span >> copies)) * scales)
    # pairs too long for the line: at once those of one j with all far i, or the copies of one pair
    m = 1 << j
    bent = np.flatnonzero((span < 16 * m) | (span % _strides(m) != 0))
    kin = np.where(apart[bent] > REACH, -j[bent], 8 * apart[bent] + first[bent])
    for key in sorted(set(kin.tolist())):
        at = bent[kin == key]
        if key < 0:
            sums[:, at] = _sums(i[at], -key, span, averaged).T
        else:
            base = key % 8
            sums[:, at] = _sums(base, base + key // 8, span >> copies[at], averaged).T * scales[:, at]
    return sums


@lru_cache(maxsize=128)
def _lines(apart: int, averaged: bool) -> Floats:
    """Straight lines along which the sums grow while the record is much longer than both octaves.

    Returns
    -------
    (2, 14, 6) sums of octaves i and i + apart at a record of no length, and their growth with each sample;
    all other octaves are scaled copies of these i = 0 to 5.
    """
    lines = []
    for i in range(_SHARED + 1):
        step = 16 << (i + apart)
        one, two = (_sums(i, i + apart, span, averaged) for span in (step, 2 * step))
        lines.append((2.0 * one - two, (two - one) / step))
    return np.stack(lines, axis=-1).reshape(2, -1, _SHARED + 1)


def _sums(i: int | Ints, j: int, span: int | Ints, averaged: bool) -> Floats:
    """(..., 14) sums over the lags: of the products of two noise types, by `PAIRS`, and of the types alone.

    Parameters
    ----------
    i : octave, or several that are all more than `REACH` below j. So short a difference takes the derivative
        of a rate that the long one smooths, and r goes with m_i. White noise and quantisation have none to
        speak of.
    span : samples, length of the record, or several for one i.
    """
    highest = int(np.max(i))
    near = max(highest, j - REACH)
    base = min(near, _SHARED)
    core, tail = _differences(base, j - near, averaged)
    step = _stride(near)
    if near > highest:
        core, tail, step = core[:, ::_COARSE] * _SMOOTH, tail[::_COARSE], step * _COARSE
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
        sums *= step / _strides(m) * (m / (1 << near)) ** _DEGREE  # lags that each stands for
    return np.asarray(sums)


def _scales(octaves: int | Ints) -> Floats:
    """(14, ...) growth of `_sums` with clusters so many octaves longer, in a record so many times as long."""
    growth = 2.0 ** np.multiply.outer(_GROWTH, octaves)
    return np.concatenate([growth[LEFT] * growth[RIGHT], growth])


def _counts(i: int | Ints, j: int, span: int | Ints, steps: Ints) -> Floats:
    """How many pairs of differences at octaves i <= j have their middles so far apart, on either side.

    When the middles meet, the shorter difference begins m_j - m_i after the longer: by so much, and n strides
    with the nth of the longer ones, it can be put earlier and still be in the record. Later is the same seen
    from the end, where it has as room besides what the longer ones leave over. Distance 0 is on both sides
    but once.

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
    room = (1 << j) - m - steps
    shift = stride_j.bit_length() - 1
    before = np.minimum(np.maximum((room >> shift) + terms, 0), terms)
    after = np.minimum(np.maximum((room + left >> shift) + terms, 0), terms) if left.any() else before
    count = (before + after).astype(np.float64)
    count[..., 0] *= 0.5
    return np.asarray(count)


@lru_cache(maxsize=16)  # of long records: i = 5 and what is near to it, of each kind
def _differences(i: int, apart: int, averaged: bool) -> tuple[Floats, Floats]:
    """Covariance r of differences at octaves i and i + apart by the distance of their middles.

    Distances from 0 on, in strides of octave i; r is the same on both sides.

    Returns
    -------
    core : (4, c) units of tau0, by noise type, at least as far as the two differences overlap.
    tail : (l,) units of tau0, of flicker beyond that; the others have none.
    """
    stride = _stride(i)
    short = (1 << i) // stride
    long = short << apart
    size = TAIL * long + 1
    phase = _phase(size + long + short, averaged, stride)
    phase = np.concatenate([phase[:, long + short : 0 : -1], phase], axis=1)
    # white noise, random walk and quantisation end where the differences part; both parts can be thinned
    cut = min(-(-(long + short + 1) // _COARSE) * _COARSE, size)
    core, tail = np.zeros((4, cut)), np.zeros(size - cut)
    for p, weight_p in enumerate((1.0, -2.0, 1.0)):
        for q, weight_q in enumerate((1.0, -2.0, 1.0)):
            begin = q * long + (2 - p) * short
            core += weight_p * weight_q * phase[:, begin : begin + cut]
            tail += weight_p * weight_q * phase[1, begin + cut : begin + size]
    clusters = float(1 << i) * float(1 << (i + apart))
    return core / clusters, tail / clusters


def _phase(size: int, averaged: bool, stride: int = 1) -> Floats:
    """(4, size) generalised autocovariance of the phase at multiples of a lag, one row a noise type."""
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
    """(reach + 1,) generalised autocovariance of the running sum of sampled flicker, but for a lag^2.

    That of (1 - z^-1)^(-1/2) w itself is -1/pi sum_{j=1..k} 1/(j - 1/2); it is summed twice.
    """
    rate = np.concatenate([[0.0], -np.cumsum(1.0 / (np.arange(1, reach + 1) - 0.5)) / np.pi])
    slopes = -np.cumsum(rate[:reach])  # S(k+1) - S(k), S even
    return np.concatenate([[0.0], np.cumsum(slopes)])
