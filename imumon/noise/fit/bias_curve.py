"""Bias of one channel against the temperature, from the means of the whole record.

The same restricted likelihood as of N, B and K, of the block means alone, with other columns: a polynomial of the
temperature beside the drift of each segment. The degree is the highest whose last term is not near zero. A
record that warms and cools has one column more, the difference between the two directions: hysteresis. What the noise
may do between the blocks widens every limit. A warm-up is no part of N, B and K, and the best part of a record for this
curve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from imumon.coefficients import BIAS_TERMS, LIMIT_95
from imumon.noise.blocks import BlockMeans
from imumon.noise.fit import regressors as columns_of
from imumon.noise.fit.expected_curve import noise_variances
from imumon.noise.fit.likelihood import Likelihood, Surface, averaged, normal_matrix
from imumon.noise.fit.observations import SINGLE, BlockSeries, block_series, meeting_frequency
from imumon.noise.fit.regressors import COLLINEAR, Regressor
from imumon.noise.fit.slow_terms import SlowTerms
from imumon.report import BiasCurve, ModelColumn
from imumon.samples import Floats

NEGLECTED_P = 0.25
"""Probability by chance below which a term of a higher degree, or the variance between quarters, counts: the limits of
the others do not hold beside one in doubt that is neglected (Bancroft 1944; Biometrics 20, 1964). At 0.05 the limits of
a scatter as large as the statistics hold 88 %, at 0.25 92 %."""
SPAN_PER_DEGREE_DEGC = 2.0
"""degC, span that each degree above the first one needs: sensors bend little within less."""
LOWEST_DEGC, HIGHEST_DEGC = -60.0, 110.0
"""degC, of inertial sensors, which are rated for -55 to 110 at most (Murata SCHA634): what is beyond is none."""
JUMP_SHARE, JUMP_DEGC = 0.5, 2.0
"""Share of the span, and degC, that the temperature of a sensor does not change between two blocks."""
POINTS = 9
"""Temperatures at which the curve is given."""


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Regression with the noise that is likeliest beside it."""

    regressors: list[Regressor]
    value: Floats  # (q,) in the scale of each column, as is the covariance
    covariance: Floats  # (q, q)
    mean_variance: float  # (channel unit)^2, of the mean of the record against that of another one as long

    def sigma(self, at: int) -> float:
        return float(abs(self.value[at]) / math.sqrt(self.covariance[at, at]))


def bias_curve(
    blocks: BlockMeans,
    column: int,
    degrees: Floats | None,
    noise: Surface | None = None,
    extremes: tuple[float, float] | None = None,
) -> BiasCurve:
    """Return the bias against the temperature, or a curve without terms and with the reason why there is none.

    Parameters
    ----------
    blocks : means of the whole record.
    column : channel in them.
    degrees : (blocks,) degC, temperature of the blocks, NaN where missing; None: there is none.
    noise : likelihood of N, B and K of the channel; None: that of the blocks.
    extremes : degC, least and greatest sample of the temperature; None: unknown.
    """
    series = block_series(blocks, column, degrees)
    if series is None:
        return BiasCurve(reason="too_short")
    straight, reason = columns_of.temperature(series)
    if straight is None or series.degrees is None:
        return BiasCurve(reason=reason)
    low, high = float(np.nanmin(series.degrees)), float(np.nanmax(series.degrees))
    coldest, hottest = extremes or (low, high)
    if min(low, coldest) < LOWEST_DEGC or max(high, hottest) > HIGHEST_DEGC:
        return BiasCurve(reason="implausible")
    jumps = np.abs(np.diff(straight.series))
    jumps[series.begin[1:] - 1] = 0.0
    if jumps.max() > max(JUMP_SHARE * (high - low), JUMP_DEGC):
        return BiasCurve(reason="jumps")
    reference, half = 0.5 * (low + high), 0.5 * (high - low)
    u, loop = columns_of.unit_span(straight.series), columns_of.hysteresis(series, straight.series)
    fit = _fitted(series, u, loop, 1, noise)
    names = [each.name for each in fit.regressors]
    one, drift = names.index("temperature"), names.index("drift") if "drift" in names else None
    if drift is not None and _correlation(fit.covariance, one, drift) > COLLINEAR:
        return BiasCurve(reason="collinear")
    degree = 1
    for more in range(2, len(BIAS_TERMS) + 1):
        if high - low >= SPAN_PER_DEGREE_DEGC * more:
            other = _fitted(series, u, loop, more, noise)
            if 2.0 * ndtr(-other.sigma(one + more - 1)) < NEGLECTED_P:
                fit, degree = other, more
    return _stated(series, fit, blocks.offset[column], one, degree, reference, half, u)


def _fitted(
    series: BlockSeries, u: Floats, loop: Regressor | None, degree: int, noise: Surface | None
) -> _Fit:
    """Return the regression on a polynomial of u (n,), and on hysteresis where both directions occur."""
    heat = [columns_of.of_series(series, "temperature", u**power) for power in range(1, degree + 1)]
    if loop is not None:
        heat.append(loop)
    regressors = [*columns_of.drifts(series), *heat]
    masked = np.zeros(series.y.size, dtype=bool)
    terms = SlowTerms(series, regressors, masked, min(4 * SINGLE, masked.size // 3), [], 0.0, "")
    top = meeting_frequency(series)
    likelihood = Likelihood(*terms.observations(top, top))
    if noise is None:
        surface = likelihood.search(series.samples)
    else:
        surface = replace(likelihood.surface(noise.B, noise.K), log=noise.log, a=noise.a)
    mean, error = averaged(surface, surface.beta, surface.beta_variance)
    coefficients = likelihood.coefficients
    variance = surface.powers @ coefficients.variance
    inverse = np.linalg.inv(normal_matrix(1.0 / variance[None], coefficients.X)[0])
    # the noise is not known exactly: the errors are those over all N, B and K, the correlations of the likeliest
    wider = error / np.sqrt(np.diagonal(inverse))
    scale = np.array([each.scale for each in regressors])
    covariance = inverse * np.outer(wider * scale, wider * scale)
    powers = np.stack((surface.a, *surface.pairs), axis=1)
    apart = 2.0 * powers @ noise_variances(np.array([series.samples]), averaged=True)[:, 0]
    mean_variance = float(averaged(surface, np.sqrt(apart), np.zeros_like(apart))[0]) ** 2
    return _Fit(regressors, mean * scale, covariance, mean_variance)


def _stated(
    series: BlockSeries,
    fit: _Fit,
    offset: float,
    one: int,
    degree: int,
    reference: float,
    half: float,
    u: Floats,
) -> BiasCurve:
    """Return the curve of a regression whose temperature columns begin at number `one`."""
    columns = np.stack([each.series for each in fit.regressors], axis=1)
    own = slice(one, one + degree)
    # the bias at the reference temperature, in the middle of the record and between the two directions
    middle = columns.mean(axis=0)
    bias = float(offset + series.series.mean() - middle @ fit.value)
    rows = [(bias, fit.mean_variance + float(middle @ fit.covariance @ middle))]
    rows += [
        (
            float(fit.value[one + i]) / half ** (i + 1),
            float(fit.covariance[one + i, one + i]) / half ** (2 * i + 2),
        )
        for i in range(degree)
    ]
    at = np.linspace(-1.0, 1.0, POINTS)
    powers = at[:, None] ** np.arange(1, degree + 1)
    combined = np.tile(-middle, (POINTS, 1))
    combined[:, own] += powers
    curve = bias + powers @ fit.value[own]
    error = LIMIT_95 * np.sqrt(
        fit.mean_variance + np.einsum("pq,qr,pr->p", combined, fit.covariance, combined)
    )
    drifts = [i for i, each in enumerate(fit.regressors) if each.name == "drift"]
    without = series.series - columns[:, drifts] @ fit.value[drifts]
    hysteresis = None
    if fit.regressors[-1].name == "hysteresis":
        hysteresis = _column("hysteresis", float(fit.value[-1]), float(fit.covariance[-1, -1]))
    return BiasCurve(
        reference_degC=reference,
        terms=tuple(_column(f"degree {i}", *row) for i, row in enumerate(rows)),
        hysteresis=hysteresis,
        degC=tuple((reference + half * at).tolist()),
        bias=tuple(curve.tolist()),
        low=tuple((curve - error).tolist()),
        high=tuple((curve + error).tolist()),
        std_without=float(np.std(without)),
        std_with=float(np.std(series.series - columns @ fit.value)),
    )


def _column(name: str, value: float, variance: float) -> ModelColumn:
    error = LIMIT_95 * math.sqrt(variance)
    return ModelColumn(name=name, value=value, low=value - error, high=value + error)


def _correlation(covariance: Floats, i: int, j: int) -> float:
    return float(abs(covariance[i, j]) / math.sqrt(covariance[i, i] * covariance[j, j]))
