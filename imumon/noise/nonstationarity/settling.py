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
    at: np.ndarray, mean: Floats, share: Floats, width_s: float, times_s: Floats
) -> SettlingFit | None:
    """Return the exponential of the most likely time constant; None if there are too few means.

    Parameters
    ----------
    at : (k,) number of each stretch; the exponential begins with the first.
    mean, share : (k,) channel unit; valid share of the stretch, above 0.
    width_s : s, length of a stretch.
    times_s : (t,) s, possible time constants.
    """
    if len(at) < LEAST_MEANS:
        return None
    at, mean, share, width_s = _joined(at - at[0], mean, share, width_s)
    if len(at) < LEAST_MEANS:
        return None
    x = (at + 0.5) * width_s
    trial = np.column_stack((x / x[-1], np.exp(-x[:, None] / times_s)))
    steps = np.diff(np.column_stack((mean, trial)), axis=0)
    # the size of the noise is the best one: -2 log L = n log(sum of squares) + log det, up to a constant
    n, without, best = len(steps), np.inf, (np.inf, 0.0, 0.0)
    for noise, logs in _mixtures(at, share):
        white = noise @ steps  # (mixtures, k-1, 2+t)
        y, shapes = white[..., 0], white[..., 1:]
        whole = np.maximum(np.einsum("mk,mk->m", y, y), _TINY)[:, None]
        power = np.maximum(np.einsum("mkt,mkt->mt", shapes, shapes), _TINY)
        product = np.einsum("mkt,mk->mt", shapes, y)
        residual = np.maximum(whole - product**2 / power, _ROUNDING * whole)
        fits = n * np.log(residual) + logs[:, None]
        without = min(without, float((n * np.log(whole[:, 0]) + logs).min()), float(fits[:, 0].min()))
        m, t = divmod(int(np.argmin(fits[:, 1:])), len(times_s))
        size = float(product[m, t + 1] / power[m, t + 1])
        best = min(best, (float(fits[m, t + 1]), float(times_s[t]), size))
    return SettlingFit(best[1], best[2], without - best[0])


def _joined(
    at: np.ndarray, mean: Floats, share: Floats, width_s: float
) -> tuple[np.ndarray, Floats, Floats, float]:
    """Return the stretches, joined in pairs until they are at most `MOST_MEANS`."""
    while int(at[-1]) >= MOST_MEANS:
        pair = at // 2
        weight = np.bincount(pair, share)
        total = np.bincount(pair, share * mean)
        at = np.unique(pair)
        mean, share, width_s = total[at] / weight[at], 0.5 * weight[at], 2.0 * width_s
    return at, mean, share, width_s


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
