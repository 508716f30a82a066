"""Random walk beside a straight drift and a temperature, by the restricted likelihood of block means.

A straight drift, a warm-up or a temperature bends the Allan deviation at long tau as a random walk does. Means
over equal stretches of the record (blocks) distinguish them. The model of the means is

    y = constant + drift t + c temperature + noise,    covariance N^2 W + B^2 F + K^2 R,

with W, F and R the covariances of block means under white noise, flicker and random walk (`unit_covariances`).
Restricted likelihood (Patterson & Thompson, Biometrika 58, 1971) uses only combinations of the means that are
free of constant, drift and temperature, so these cost nothing but their degrees of freedom. In the
combinations that diagonalise W and R together, F is diagonal within 0.12 of a row's own variance, and products
of correlations enter only squared. So the combinations z_i count as independent, with variances

    v_i = N^2 + B^2 f_i + K^2 r_i,

and all channels with the same missing samples share one decomposition.

Limits of K^2 come from tests of its values (`walk_limits`). Limits of the slopes average the normal distribution
over the distribution of K^2 that these tests define.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.special import ndtr

from imumon.noise.fit.walk_limits import HALVINGS, NODE_WEIGHTS, NODES, TAIL, Combinations, WalkLimits
from imumon.samples import Floats, Ints

LEAST_BLOCKS = 12
"""Fewest blocks: fewer leave too few combinations for N, B and K. Not critical."""
LEAST_SPAN_DEGC = 0.3
"""DegC, least range of temperature from which its effect is estimated. Not critical."""
COLLINEAR = 0.95
"""Correlation of the estimates of both slopes from which they count as not separable: each is then more than
three times less certain than alone. Not critical."""
TEMPERATURE_SNR = 3.0
"""Least ratio of the deviation of the temperature from a straight line to its own noise. Not critical."""
SETTLING_SHARES = np.array([0.04, 0.06, 0.09, 0.13, 0.19, 0.28, 0.4, 0.6])
"""Time constants of an exponential that still bends the record, as shares of its length. Not critical."""
SETTLING_EVIDENCE = 2.0
"""Twice the logarithm of the ratio of the likelihoods from which on K must survive an exponential. Low,
because it costs little: the limits of K become the union of those with it and without. At 3, K at twice the
smallest that shows is measured in 2 % more of the records, but also in 5 to 6 % of those with a warm-up of an
hour and no walk, instead of 4 %. Not critical."""
SETTLING_FLICKER = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0, 6.0)
"""B^2 over its expected value, at which the exponential is tried. Not critical."""
SETTLING_WALK = (0.0, *(2.0**i for i in range(-2, 16)))
"""K^2 over its standard deviation without a walk, at which the exponential is tried. Not critical."""

INSEPARABLE = "collinear"


@dataclass(frozen=True, slots=True, eq=False)
class BlockMeans:
    """Means of the first channels over neighbouring stretches, as `fit_slow_terms` takes them.

    Attributes
    ----------
    means : (n, c) channel unit, about an offset; NaN: too few samples.
    share : (n, c) valid share of each stretch.
    temperature : (n,) degC, about an offset; None: there is none.
    length_s : s, of a stretch.
    """

    means: Floats
    share: Floats
    temperature: Floats | None
    length_s: float

    def select(self, channels: list[int]) -> BlockMeans:
        """Return the means of some of the channels."""
        return replace(self, means=self.means[:, channels], share=self.share[:, channels])


@dataclass(frozen=True, slots=True, eq=False)
class SlowTerms:
    """Slow terms of each channel, (c,) arrays; NaN: unknown.

    Attributes
    ----------
    K2, K2_low, K2_high : (channel unit)^2/s, restricted likelihood estimate and 95 % limits. A low limit of 0
        means that drift, temperature, N and B alone explain the means.
    B2 : (channel unit)^2, best value beside `K2`.
    drift, drift_low, drift_high, drift_error : channel unit per s. Estimated together with the temperature
        slope if that has a value.
    temperature, temperature_low, temperature_high, temperature_error : channel unit per degC; NaN: no
        temperature, its range is too small, or not separable from time.
    correlation : of the estimates of both slopes; NaN without a temperature.
    settling_s : s, time constant of an exponential from the first block on that explains the means better than
        a walk; NaN: there is none, or it was not sought. K2 is then beside it, and the limits of K2 are the
        union of those with it and without.
    reasons : (c,) why there is no temperature slope: "", "no_temperature", "small_range" or
        "collinear". The last one applies to the drift, too: it includes what follows the temperature.
    """

    K2: Floats
    K2_low: Floats
    K2_high: Floats
    B2: Floats
    drift: Floats
    drift_low: Floats
    drift_high: Floats
    drift_error: Floats
    temperature: Floats
    temperature_low: Floats
    temperature_high: Floats
    temperature_error: Floats
    correlation: Floats
    settling_s: Floats
    reasons: tuple[str, ...]


def unit_covariances(n: int) -> tuple[Floats, Floats]:
    """Return (n, n) covariances of means over n neighbouring stretches of unit length, for B = 1 and K = 1.

    From the generalised autocovariance G of the phase (Greenhall 1991), t^2 ln|t| / (2 pi) and |t|^3 / 12, as
    2 G(l) - G(l-1) - G(l+1) at lag l. They have a meaning only in contrasts; their mean is removed.
    """
    lag = np.arange(n + 1.0)
    near = np.abs(np.arange(n)[:, None] - np.arange(n))
    out = []
    for g in (lag**2 * np.log(np.maximum(lag, 1.0)) / (2.0 * np.pi), lag**3 / 12.0):
        by_lag = 2.0 * g[:-1] - g[np.abs(np.arange(n) - 1)] - g[1:]
        out.append((by_lag - by_lag.mean())[near])
    return out[0], out[1]


def fit_slow_terms(
    means: Floats,
    length_s: float,
    N2: Floats,
    B2: Floats,
    *,
    B2_error: Floats | None = None,
    share: Floats | None = None,
    temperature: Floats | None = None,
    settling: bool = False,
) -> SlowTerms:
    """Return random walk, drift and temperature slope of channels from their block means.

    Parameters
    ----------
    means : (n, c) channel unit, means over neighbouring stretches; NaN: missing.
    length_s : s, length of a stretch.
    N2 : (c,) (channel unit)^2 s, of the fit; taken as known.
    B2, B2_error : (c,) (channel unit)^2, of the fit with its standard error. An error of 0 takes B^2 as known,
        of infinity, or None, estimates it from the blocks alone.
    share : (n,) or (n, c) valid share of each stretch, above 0 and at most 1; None: all.
    temperature : (n,) degC; None: there is none. NaN: missing, and the stretch does not count.
    settling : also seek an exponential, as of a warm-up.

    Returns
    -------
    SlowTerms
        In the units of the arguments. All values are NaN for channels with fewer than `LEAST_BLOCKS` means.
    """
    n, c = means.shape
    weights = np.ones((n, c)) if share is None else np.broadcast_to(share.T, (c, n)).T
    usable = np.isfinite(means) & (weights > 0.0)
    reason = _why_no_slope(temperature, np.asarray(usable.any(axis=1)))
    heat = temperature if not reason else None
    if heat is not None:
        usable &= np.isfinite(heat)[:, None]
    flicker, walk = unit_covariances(n)
    error = np.full(c, np.inf) if B2_error is None else np.asarray(B2_error, dtype=np.float64)
    out = np.full((14, c), np.nan)
    kinds, member = np.unique(np.where(usable, weights, 0.0), axis=1, return_inverse=True)
    for kind, own in enumerate(kinds.T):
        columns, rows = np.flatnonzero(member.ravel() == kind), np.flatnonzero(own)
        if len(rows) < LEAST_BLOCKS:
            continue
        y = means[np.ix_(rows, columns)]
        white, grid = np.diag(1.0 / own[rows]), np.ix_(rows, rows)
        slopes = [(rows - rows.mean()) / n]
        if heat is not None:
            slopes.append(heat[rows] - heat[rows].mean())
        x = np.stack(slopes, axis=1)
        # in units of the stretch: N^2 / s, B^2, K^2 s
        n2, b2 = N2[columns] / length_s, B2[columns]
        free = Combinations.of(np.column_stack((np.ones(len(rows)), x)), white, flicker[grid], walk[grid])
        search = WalkLimits(free, free.basis @ y, n2, b2, error[columns])
        contrasts = Combinations.of(np.ones((len(rows), 1)), white, flicker[grid], walk[grid])
        k2, at_b2 = search.result()
        lines = _slopes(contrasts, y, x, n2, at_b2, k2)
        out[:13, columns] = np.concatenate((k2[:3], at_b2[:1], lines))
        if not settling:
            continue
        curves = np.exp(-(rows - rows[0])[:, None] / (len(rows) * SETTLING_SHARES))
        best = _best_settling(free, free.basis @ y, free.basis @ curves, n2, b2, error[columns])
        for one in np.unique(best[best >= 0]):
            with_it = np.flatnonzero(best == one)
            curve = curves[:, one]
            # to first order, another time constant adds a multiple of the derivative
            line = np.column_stack((np.ones(len(rows)), x, curve, -curve * np.log(curve)))
            beside = Combinations.of(line, white, flicker[grid], walk[grid])
            z, own_n2, own_b2 = beside.basis @ y[:, with_it], n2[with_it], b2[with_it]
            k2, at_b2 = WalkLimits(beside, z, own_n2, own_b2, error[columns][with_it]).result()
            at = columns[with_it]
            out[0, at], out[3, at], out[13, at] = k2[0], at_b2[0], SETTLING_SHARES[one] * len(rows) * length_s
            out[1, at], out[2, at] = np.minimum(out[1, at], k2[1]), np.maximum(out[2, at], k2[2])
    out[:3] /= length_s
    out[4:8] /= n * length_s
    reasons = tuple(reason or (INSEPARABLE if np.isfinite(v[12]) and np.isnan(v[8]) else "") for v in out.T)
    names = [each.name for each in fields(SlowTerms)]
    return SlowTerms(**dict(zip(names, out, strict=False)), reasons=reasons)


def _best_settling(
    free: Combinations, z: Floats, curves: Floats, n2: Floats, b2: Floats, b2_error: Floats
) -> Ints:
    """Return (c,) the number of the exponential that explains each channel better than noise; -1: none.

    Twice the logarithm of the ratio of the likelihoods, with B^2 and K^2 the best of `SETTLING_FLICKER` and
    `SETTLING_WALK` for each; B^2 has its normal distribution where that is known.

    Parameters
    ----------
    z : (m, c) combinations of the means, units of the stretch.
    curves : (m, t) the same of the exponentials.
    """
    guess = np.where(np.isfinite(b2_error), b2, n2 / free.flicker.max() + (z**2).mean(axis=0))
    scale = 1.0 / np.sqrt(0.5 * np.sum((free.walk / (1.0 + free.flicker)[:, None].T) ** 2))
    best = np.full((2, z.shape[1]), np.inf)
    number = np.zeros(z.shape[1], dtype=np.int64)
    for flicker in SETTLING_FLICKER:
        at_b2 = flicker * guess
        prior = np.where(b2_error > 0.0, ((at_b2 - b2) / np.where(b2_error > 0.0, b2_error, 1.0)) ** 2, 0.0)
        base = n2 + at_b2 * free.flicker[:, None]
        for walk in SETTLING_WALK:
            v = base + walk * scale * (n2 + at_b2) * free.walk[:, None]
            weights = 1.0 / v
            without = np.sum(np.log(v) + z**2 * weights, axis=0) + prior
            gain = (curves.T @ (z * weights)) ** 2 / (curves.T**2 @ weights)
            one = np.argmax(gain, axis=0)
            fit = without - gain[one, np.arange(len(one))]
            number = np.where(fit < best[1], one, number)
            best = np.minimum(best, (without, fit))
    return np.where(best[0] - best[1] > SETTLING_EVIDENCE, number, -1)


def _why_no_slope(temperature: Floats | None, usable: np.ndarray) -> str:
    """Return why the temperature has no slope of its own; empty: it may have one."""
    if temperature is None:
        return "no_temperature"
    at = np.flatnonzero(usable & np.isfinite(temperature))
    if len(at) < LEAST_BLOCKS or np.ptp(temperature[at]) < LEAST_SPAN_DEGC:
        return "small_range"
    bend = temperature[at] - np.polyval(np.polyfit(at - at.mean(), temperature[at], 1), at - at.mean())
    noise = np.sqrt(np.mean(np.diff(bend, 2) ** 2) / 6.0)
    slow = np.convolve(bend, np.full(4, 0.25), mode="valid")
    return "" if np.std(slow) > TEMPERATURE_SNR * noise / 2.0 else INSEPARABLE


def _slopes(blocks: Combinations, y: Floats, x: Floats, n2: Floats, b2: Floats, k2: Floats) -> Floats:
    """Return value, low, high, error of drift and temperature slope, and their correlation, (9, c).

    Parameters
    ----------
    y, x : (k, c) means; (k, s) regressors.
    n2 : (c,) units of the stretch.
    b2, k2 : (3 + nodes, c) as `_WalkSearch.result` returns them.
    """
    z, regressors = blocks.basis @ y, blocks.basis @ x
    variance = n2 + b2[3:] * blocks.flicker[:, None, None] + k2[3:] * blocks.walk[:, None, None]
    both = _averaged_slopes(z, regressors, variance)
    if x.shape[1] == 1:
        return np.concatenate((both[:4], np.full((5, y.shape[1]), np.nan)))
    alone = np.concatenate(
        (_averaged_slopes(z, regressors[:, :1], variance)[:4], np.full((4, y.shape[1]), np.nan))
    )
    separable = np.abs(both[8]) < COLLINEAR
    return np.concatenate((np.where(separable, both[:8], alone), both[8:]))


def _averaged_slopes(z: Floats, x: Floats, variance: Floats) -> Floats:
    """Return value, low, high and error of each slope in turn, then the correlation of the first two.

    Parameters
    ----------
    z, x : (m, c) and (m, s) combinations of means and regressors.
    variance : (m, q, c) of the combinations, for each of `NODES`.
    """
    inverse = np.linalg.inv(np.einsum("mi,mqc,mj->qcij", x, 1.0 / variance, x, optimize=True))
    product = np.einsum("mi,mqc,mc->qci", x, 1.0 / variance, z, optimize=True)
    values = np.einsum("qcij,qcj->qci", inverse, product)
    errors = np.sqrt(np.diagonal(inverse, axis1=2, axis2=3))
    weights = NODE_WEIGHTS[:, None]
    out = []
    for value, error in zip(np.moveaxis(values, 2, 0), np.moveaxis(errors, 2, 0), strict=True):
        mean = np.sum(weights * value, axis=0)
        total = np.sqrt(np.sum(weights * (error**2 + (value - mean) ** 2), axis=0))
        limits = []
        for tail in (TAIL, 1.0 - TAIL):
            low, high = (
                np.broadcast_to(mean + sign * 12.0 * error.max(axis=0), mean.shape) for sign in (-1, 1)
            )
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                beyond = np.sum(weights * ndtr((middle - value) / error), axis=0) >= tail
                low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
            limits.append(high)
        out += [mean, *limits, total]
    if x.shape[1] > 1:
        middle = inverse[len(NODES) // 2]
        out.append(middle[:, 0, 1] / np.sqrt(middle[:, 0, 0] * middle[:, 1, 1]))
    return np.stack(out)
