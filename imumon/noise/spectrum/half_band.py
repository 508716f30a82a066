"""Half-band filter between the levels of the spectrum: every second sample, without what would fold.

Halving the rate folds f onto 1/2 - f of the old rate. Bins are used up to 0.36 of the new rate, 0.18 of the old one,
onto which 0.32 and more would fold: there the filter is 59 dB down. An average over two samples takes away 5 dB at
0.32, so that a strong line would show again in the levels below it.

The filter has 23 taps, of which every second one is zero except the middle one, and is computed for the samples that
are kept only. Shares of valid samples pass it too, so that a level knows how much of each sample is missing.
"""

from __future__ import annotations

import numpy as np

from imumon.model.samples import Floats
from imumon.noise.spectrum.level_sums import HOP

TAPS = np.array(
    [
        -0.0026598564829913764,
        0.008240019147573408,
        -0.0199108123061755,
        0.04251865213556446,
        -0.09219562709922025,
        0.3140076246052493,
    ]
)
"""Outer half of the half-band filter's taps other than the middle one, 0.5: equiripple, 23 taps, flat to 0.2 % up to
0.18 and down by 59 dB from 0.32 of its input rate, gain 1 at zero frequency."""


def decimated(before: Floats | None, x: Floats) -> Floats:
    """Return (c, n/2) every second sample behind the half-band filter.

    Parameters
    ----------
    before : (c, HOP) channel unit, samples before x; None: the mean of the first hop.
    x : (c, n) channel unit, n even.
    """
    if before is None:
        # as if the stream had been there before at its mean: zeros would be a step, which every level shows
        before = np.repeat(x[:, :HOP].mean(axis=1, keepdims=True), HOP, axis=1)
    z = np.concatenate((_reached(before), x), axis=1)
    n, last = x.shape[1] // 2, 2 * len(TAPS) - 1
    even = np.ascontiguousarray(z[:, ::2])
    total = 0.5 * z[:, last : last + 2 * n : 2]
    pair = np.empty_like(total)  # one buffer for all taps
    for u, tap in enumerate(TAPS.tolist()):
        np.add(even[:, u : u + n], even[:, last - u : last - u + n], out=pair)
        pair *= tap
        total += pair
    return total


def decimated_with_shares(
    before: Floats | None, share_before: Floats | None, x: Floats, share: Floats | None
) -> tuple[Floats, Floats | None]:
    """Return every second sample with its share of valid samples.

    Parameters
    ----------
    share_before : (g, HOP) shares of valid samples before x; None: all.
    share : (g, n) shares of valid samples of x; None: all.
    """
    out = decimated(before, x)
    if share is None:
        if share_before is None or (_reached(share_before) == 1.0).all():
            return out, None  # nothing is missing: the rest of the way needs no shares
        share = np.ones((len(share_before), x.shape[1]))
    if share_before is None and before is not None:
        share_before = np.ones((len(share), HOP))
    return out, decimated(share_before, share)


def _reached(before: Floats) -> Floats:
    """Return the last samples of those before, which the filter reaches."""
    return before[:, 2 - 4 * len(TAPS) :]
