"""Expectation and degrees of freedom of Welch sums of noise with a given density.

Behind the half-band filters of a level it has the filters' power
response, and a bin sees it through the power of the Hann window. Images of the decimation are 59 dB down and count as
nothing.

Model of a bin k of level s, with the density S of the samples, the filters' response H and the window's W:

    E[P_k] = sum over d of S(f) |H_s(f)|^2 |W(d)|^2 / sum |W|^2,    f = (k + d) / 256 / 2^s

>>> seen_by_bins(np.ones_like, 0)[:2].round(6).tolist()  # white noise of N = 1 is 1 in every bin
[1.0, 1.0]

The mean over the bins of a band and over the segments is a sum of correlated squares. Its degrees of freedom are
2 (number)^2 over the sum of their squared correlations, of the bins of one segment and of those of two segments that
overlap by half (Welch 1967; Percival & Walden 1993, section 6.17).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from imumon.model.samples import Floats, Ints
from imumon.noise.spectrum.half_band import TAPS
from imumon.noise.spectrum.level_sums import (
    BINS,
    FIRST_BIN,
    HANN,
    HANN_POWER,
    HOP,
    SEGMENT,
    last_bin,
)
from imumon.noise.spectrum.spectral_lines import LOBE


def filter_power(f: Floats, level: int) -> Floats:
    """Return (k,) the power response of the filters above a level at frequencies of level 0, cycles per sample."""
    response = np.ones_like(f)
    lags = 2 * len(TAPS) - 1 - 2 * np.arange(len(TAPS))
    for s in range(level):
        phase = 2.0 * np.pi * f * 2.0**s  # per sample of the level that the filter reads
        # symmetric taps: the response is real, 0.5 from the middle tap and a cosine from each pair
        response = response * (0.5 + 2.0 * np.cos(np.multiply.outer(phase, lags)) @ TAPS) ** 2
    return response


def window_power(f: Floats, window: int) -> Floats:
    """Return (k,) the power response of a moving average over some samples, f in cycles per sample."""
    return np.asarray((np.sin(np.pi * f * window) / (window * np.sin(np.pi * f))) ** 2)


@lru_cache(maxsize=32)
def short_term_density(level: int) -> Floats:
    """Return (n,) 4 sin^2(pi f) at each bin in use: quantisation, or the first bend of a filter of unknown shape."""
    f = np.arange(FIRST_BIN, last_bin(level)) / SEGMENT / 2.0**level
    return np.asarray(4.0 * np.sin(np.pi * f) ** 2 * filter_power(f, level))


@lru_cache(maxsize=32)
def _bin_nodes(level: int) -> tuple[Floats, Floats, Floats]:
    """Return (n, d) the frequencies that a bin in use sees, (n, d) the response of the filters, (d,) the window."""
    # the power of a window is resolved by half bins
    offsets = 0.5 * np.arange(-2 * LOBE, 2 * LOBE + 1)
    t = np.arange(SEGMENT)
    lobe = np.abs(np.exp(-2j * np.pi * np.multiply.outer(offsets, t) / SEGMENT) @ HANN) ** 2
    lobe /= lobe.sum()
    bins = np.arange(FIRST_BIN, last_bin(level))
    f = np.abs(bins[:, None] + offsets) / SEGMENT
    f = np.where(f > 0.5, 1.0 - f, f) / 2.0**level  # the lobe reaches beyond half the rate and is folded back
    return f, filter_power(f.ravel(), level).reshape(f.shape), lobe


def seen_by_bins(density: Callable[[Floats], Floats], level: int, window: int = 1) -> Floats:
    """Return (n,) the expectation of the density of each bin in use.

    The density is that of level 0: the squared transform over the power of the window, times 2^level.

    Parameters
    ----------
    density : returns (k,) the density of the samples at (k,) frequencies, cycles per sample.
    window : samples of a moving average in the sensor; 1: none.
    """
    f, response, lobe = _bin_nodes(level)
    return np.asarray(density(f.ravel()).reshape(f.shape) * response * window_power(f, window) @ lobe)


@lru_cache(maxsize=1)
def _bin_correlation() -> tuple[Floats, Floats]:
    """Return (BINS, BINS) squared correlations of the bins of one segment, and of two that overlap by half."""
    t = np.arange(SEGMENT)
    waves = HANN * np.exp(-2j * np.pi * np.arange(BINS)[:, None] * t / SEGMENT)
    same = np.abs(waves.conj() @ waves.T / HANN_POWER) ** 2
    beside = np.abs(waves[:, HOP:].conj() @ waves[:, :HOP].T / HANN_POWER) ** 2
    return same, beside


def degrees_of_freedom(bins: Ints, segments: float) -> float:
    """Return the degrees of freedom of the mean over some bins, numbers of a segment, and some segments."""
    same, beside = (c[np.ix_(bins, bins)].sum() for c in _bin_correlation())
    return float(
        2.0 * (segments * len(bins)) ** 2 / (same * segments + 2.0 * beside * max(segments - 1.0, 0.0))
    )
