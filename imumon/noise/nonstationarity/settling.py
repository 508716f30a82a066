"""Settling: whether means over stretches of time follow an exponential, as those of a sensor that warms up.

The Allan variance cannot distinguish a finished exponential from a random walk, but the order of the means in
time can. Three models of the means are compared by their likelihood: noise, noise with a steady slope, and
noise with A exp(-t/T). The noise is any mixture of white, flicker and random walk (`MeanCovariance`), each
model with the mixture and the size that fit it best. So a random walk supports none of them, and no fit of
the curve, which a warm-up bends, is needed.

Twice the logarithm of the ratio of the likelihoods (Wilks 1938), of the exponential and the better one of the
other two, is the evidence. Without an exponential it does not follow the law of Wilks, because the time
constant is searched and a walk has few degrees of freedom: `LEAST_EVIDENCE` is set on simulated records
(docs/THEORY.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imumon.noise.nonstationarity.mean_covariance import MeanCovariance
from imumon.samples import Floats

MOST_MEANS = 48
"""Most means that are compared; neighbours are joined. The cost grows with the cube. Not critical."""
LEAST_MEANS = 16
"""Fewest means that are compared: fewer do not distinguish an exponential from a walk. Not critical."""
FLICKER = (0.0, *(2.0**i for i in range(-1, 10)))
"""B sqrt(T) / N of the mixtures, T the length of the record. Not critical."""
WALK = (0.0, *(2.0**i for i in range(13)))
"""K T / N of the mixtures. Not critical."""
LEAST_EVIDENCE = 16.0
"""Twice the logarithm of the ratio of the likelihoods beyond which an exponential is significant. Of
simulated series without one, one in a hundred reaches 10 and about one in ten thousand 16. Not critical."""

_TINY = 1e-300
"""Least divisor. Not critical."""
_ROUNDING = 1e-12
"""Share of a sum of squares that rounding may leave. Not critical."""


@dataclass(frozen=True, slots=True)
class SettlingFit:
    """The exponential that fits some means best.

    Attributes
    ----------
    time_s : s, its time constant.
    start : channel unit, its value at the beginning.
    evidence : twice the logarithm of the ratio of the likelihoods with it and without.
    """

    time_s: float
    start: float
    evidence: float

    @property
    def significant(self) -> bool:
        """Whether noise alone does not explain it."""
        return self.evidence > LEAST_EVIDENCE


def fit_settling(
    at: np.ndarray, means: Floats, share: Floats, width_s: float, times_s: Floats
) -> list[SettlingFit | None]:
    """Return for each channel the exponential of the most likely time constant; None if there are too few means.

    Parameters
    ----------
    at : (k,) number of each stretch; the exponential begins with the first.
    means : (k, c) channel unit.
    share : (k,) valid share of the stretch, above 0.
    width_s : s, length of a stretch.
    times_s : (t,) s, possible time constants.
    """
    channels = means.shape[1]
    if len(at) < LEAST_MEANS:
        return [None] * channels
    at, means, share, width_s = _joined(at - at[0], means, share, width_s)
    if len(at) < LEAST_MEANS:
        return [None] * channels
    x = (at + 0.5) * width_s
    trial = np.column_stack((x / x[-1], np.exp(-x[:, None] / times_s)))
    steps = np.diff(np.column_stack((means, trial)), axis=0)
    # the size of the noise is the best one: -2 log L = n log(sum of squares) + log det, up to a constant
    n, column = len(steps), np.arange(channels)
    without, best = np.full(channels, np.inf), np.full(channels, np.inf)
    time_s, start = np.zeros(channels), np.zeros(channels)
    for noise, logs in _mixtures(at, share):
        white = noise @ steps  # (mixtures, k-1, c+1+t)
        y, shapes = white[..., :channels], white[..., channels:]
        whole = np.maximum((y**2).sum(axis=1), _TINY)[..., None]  # (mixtures, c, 1)
        power = np.maximum((shapes**2).sum(axis=1), _TINY)[:, None, :]
        product = y.transpose(0, 2, 1) @ shapes  # (mixtures, c, 1+t)
        residual = np.maximum(whole - product**2 / power, _ROUNDING * whole)
        fits = n * np.log(residual) + logs[:, None, None]
        bare = n * np.log(whole[..., 0]) + logs[:, None]
        without = np.minimum(without, np.minimum(bare, fits[..., 0]).min(axis=0))
        flat = fits[..., 1:].transpose(0, 2, 1).reshape(-1, channels)
        m, t = np.divmod(flat.argmin(axis=0), len(times_s))
        least = fits[m, column, t + 1]
        better = least < best
        best = np.where(better, least, best)
        time_s = np.where(better, times_s[t], time_s)
        start = np.where(better, product[m, column, t + 1] / power[m, 0, t + 1], start)
    return [SettlingFit(*map(float, each)) for each in zip(time_s, start, without - best, strict=True)]


def _joined(
    at: np.ndarray, means: Floats, share: Floats, width_s: float
) -> tuple[np.ndarray, Floats, Floats, float]:
    """Return the stretches, joined in pairs until they are at most `MOST_MEANS`."""
    while int(at[-1]) >= MOST_MEANS:
        at, first = np.unique(at // 2, return_index=True)
        weight = np.add.reduceat(share, first)
        means = np.add.reduceat(share[:, None] * means, first, axis=0) / weight[:, None]
        share, width_s = 0.5 * weight, 2.0 * width_s
    return at, means, share, width_s


def _mixtures(at: np.ndarray, share: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Yield the mixtures of each flicker, for stretches of unit length.

    Yields
    ------
    noise : (mixtures, k-1, k-1), whitens the differences of neighbouring means.
    logs : (mixtures,) logarithm of the determinant of their covariance.
    """
    span = float(at[-1] + 1)
    lags = np.abs(at[:, None] - at[None, :]).astype(np.float64)
    flicker_model, walk_model = MeanCovariance(0.0, span**-0.5, 0.0), MeanCovariance(0.0, 0.0, 1.0 / span)
    slow = (model.covariance(lags, 1.0, 1.0) for model in (flicker_model, walk_model))
    white, flicker, walk = (np.diff(np.diff(c, axis=0), axis=1) for c in (np.diag(1.0 / share), *slow))
    for b in FLICKER:
        roots: Floats = np.linalg.cholesky(np.stack([white + b**2 * flicker + k**2 * walk for k in WALK]))
        logs = 2.0 * np.log(np.diagonal(roots, axis1=1, axis2=2)).sum(axis=1)
        yield np.asarray(np.linalg.inv(roots), dtype=np.float64), logs
