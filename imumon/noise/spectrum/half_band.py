"""Half-band filter between the levels of the spectrum: every second sample, without what would fold.

The filter has 23 taps, of which every second one is zero except the middle one, and is computed for the samples that
are kept only. Shares of valid samples pass it too, so that a level knows how much of each sample is missing.
"""

from __future__ import annotations

import numpy as np

from imumon.noise.spectrum.spectral_lines import HOP
from imumon.samples import Floats

_OUTER = np.array([-0.0026544081, 0.0082231405, -0.0198700275, 0.042431558, -0.0920067759, 0.3133644193])
TAPS = 0.25 * _OUTER / _OUTER.sum()
"""Outer half of the half-band filter's taps other than the middle one, 0.5: equiripple, 23 taps, flat to 0.2 % up to
0.18 and down by 59 dB from 0.32 of its input rate, gain 1 at zero frequency."""
HISTORY = 22
"""Samples before a hop that the filter needs."""
FILTER_BLOCK = 4096
"""Values that are filtered together: they stay in the processor's cache from tap to tap."""


def decimated(history: Floats | None, x: Floats) -> tuple[Floats, Floats]:
    """Return (c, n/2) every second sample behind the half-band filter, and the history for the next ones.

    Parameters
    ----------
    history : (c, HISTORY) channel unit, samples before x; None: the mean of the first hop.
    x : (c, n) channel unit, n even.
    """
    if history is None:
        history = np.repeat(x[:, :HOP].mean(axis=1, keepdims=True), HISTORY, axis=1)
    n, last = x.shape[1] // 2, 2 * len(TAPS) - 1
    out = np.empty((len(x), n))
    together = max(1, FILTER_BLOCK // n)
    for start in range(0, len(x), together):
        part = slice(start, start + together)
        z = np.concatenate((history[part], x[part]), axis=1)
        even = np.ascontiguousarray(z[:, ::2])
        total = np.multiply(z[:, last : last + 2 * n : 2], 0.5, out=out[part])
        pair = np.empty_like(total)
        for u, tap in enumerate(TAPS.tolist()):
            np.add(even[:, u : u + n], even[:, last - u : last - u + n], out=pair)
            pair *= tap
            total += pair
    return out, x[:, -HISTORY:].copy()


def decimated_with_shares(
    history: Floats | None, history_share: Floats | None, x: Floats, share: Floats | None
) -> tuple[Floats, Floats | None, Floats, Floats | None]:
    """Return every second sample with its share of valid samples, and both histories for the next ones.

    Parameters
    ----------
    history_share : (g, HISTORY) shares of valid samples before x; None: all.
    share : (g, n) shares of valid samples of x; None: all.
    """
    out, later = decimated(history, x)
    if share is None and history_share is None:
        return out, None, later, None
    own = np.ones((len(history_share), x.shape[1])) if share is None else share  # type: ignore[arg-type]
    if history_share is None and history is not None:
        history_share = np.ones((len(own), HISTORY))
    shares, later_share = decimated(history_share, own)
    return out, shares, later, None if (later_share == 1.0).all() else later_share
