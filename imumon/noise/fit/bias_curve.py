"""Bias of one channel against the temperature, from the means of the whole record.

The same restricted likelihood as of N, B and K, of the block means alone, with other regressors: the temperature beside
the drift of each segment. What the noise may do between the blocks widens every limit. A warm-up is no part of N, B and
K, and the best part of a record for this slope. A bend of the effect is no part of it: the line is the mean over the
span.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from imumon.model.coefficients import LIMIT_95
from imumon.model.samples import Floats
from imumon.noise.blocks import BlockMeans
from imumon.noise.fit import regressors
from imumon.noise.fit.likelihood import Likelihood, Surface, grid_mean
from imumon.noise.fit.observations import BlockSeries, block_series, meeting_frequency
from imumon.noise.fit.regressors import COLLINEAR, Regressor
from imumon.noise.fit.slow_terms import SlowTerms
from imumon.noise.fit.statement import RegressorEstimate

LOWEST_DEGC = -60.0
"""Below, a temperature is implausible and no bias curve is stated. Unit: degC.

Otherwise: a wrong unit or a broken thermometer gives a curve. Origin: sensors are rated from -55 degC on (Murata
SCHA634).
"""
HIGHEST_DEGC = 110.0
"""Above, a temperature is implausible and no bias curve is stated. Unit: degC.

Otherwise: see LOWEST_DEGC: Fahrenheit, kelvin and counts pass. Origin: sensors are rated to 110 degC at most (Murata
SCHA634).
"""
POINTS = 9
"""Points of the bias curve. Unit: temperatures.

Otherwise: the band, which bends, is drawn with corners. Origin: chosen for the figure and the size of the report.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasFit:
    """Bias of a channel against the temperature: a straight line.

    Attributes
    ----------
    reason : why there are no terms: ``too_short``, ``no_temperature``, ``small_range``, ``collinear``, ``implausible``
        or ``jumps``; None: there are some.
    reference_degC : degC, middle of the temperatures of the record.
    terms : ``degree 0`` (the bias at the reference, channel unit) and ``degree 1`` (the slope, channel unit per degC).
    degC, bias, low, high : temperatures of the line, and the line with its 95 % limits, channel unit.
    std_without, std_with : channel unit, standard deviation of the block means about their drift, and about drift and
        curve.
    """

    reason: str | None = None
    reference_degC: float | None = None
    terms: tuple[RegressorEstimate, ...] = ()
    degC: tuple[float, ...] = ()
    bias: tuple[float, ...] = ()
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    std_without: float | None = None
    std_with: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Regression with the noise that is likeliest beside it."""

    regressors: list[Regressor]
    value: Floats  # (q,) in the scale of each regressor, as is the covariance
    covariance: Floats  # (q, q)
    mean_variance: float  # (channel unit)^2, of the mean of the record against that of another one as long


def bias_curve(
    blocks: BlockMeans,
    channel: int,
    degrees: Floats | None,
    noise: Surface | None = None,
    extremes: tuple[float, float] | None = None,
) -> BiasFit:
    """Return the bias against the temperature, or a curve without terms and with the reason why there is none.

    Parameters
    ----------
    blocks : means of the whole record.
    channel : one of them.
    degrees : (blocks,) degC, temperature of the blocks, NaN where missing; None: there is none.
    noise : likelihood of N, B and K of the channel; None: that of the blocks.
    extremes : degC, least and greatest sample of the temperature; None: unknown.
    """
    series = block_series(blocks, channel, degrees)
    if series is None:
        return BiasFit(reason="too_short")
    straight, reason = regressors.temperature(series)
    if straight is None or series.degrees is None:
        return BiasFit(reason=reason)
    low, high = float(np.nanmin(series.degrees)), float(np.nanmax(series.degrees))
    coldest, hottest = extremes or (low, high)
    if min(low, coldest) < LOWEST_DEGC or max(high, hottest) > HIGHEST_DEGC:
        return BiasFit(reason="implausible")
    jumps = np.abs(np.diff(straight.series))
    jumps[series.begin[1:] - 1] = 0.0
    # A plug that is pulled makes a line through two clouds of points. No sensor warms by half of its span within a
    # block, and 2 degC are more than the steps of a coarse thermometer.
    if jumps.max() > max(0.5 * (high - low), 2.0):
        return BiasFit(reason="jumps")
    reference, half = 0.5 * (low + high), 0.5 * (high - low)
    fit = _fitted(series, regressors.unit_span(straight.series), noise)
    names = [regressor.name for regressor in fit.regressors]
    drift = names.index("drift") if "drift" in names else None
    if drift is not None and _correlation(fit.covariance, -1, drift) > COLLINEAR:
        return BiasFit(reason="collinear")
    return _stated(series, fit, blocks.offset[channel], reference, half)


def _fitted(series: BlockSeries, u: Floats, noise: Surface | None) -> _Fit:
    """Return the regression on the drifts and, last, on a temperature u (n,), -1 to 1 over the span."""
    present = [*regressors.drifts(series), regressors.of_series(series, "temperature", u)]
    masked = np.zeros(series.y.size, dtype=bool)
    terms = SlowTerms(series, present, masked, masked, [], 0.0, "")
    top = meeting_frequency(series)
    beside = {} if noise is None else noise.beside
    terms = terms.with_terms(list(beside))
    likelihood = Likelihood(*terms.observations(top, top), beside=beside)
    if noise is None:
        surface = likelihood.search(series.samples)
    else:
        # the noise of the fit, with its limits, and the regression of these regressors
        surface = replace(
            likelihood.surface(noise.grids), log=noise.log, scored=noise.scored, likeliest=noise.likeliest
        )
    mean, error = grid_mean(surface, surface.beta, surface.beta_variances)
    inverse = likelihood.covariance(surface)
    # the noise is not known exactly: the errors are those over all N, B and K, the correlations of the likeliest
    wider = error / np.sqrt(np.diagonal(inverse))
    scale = np.array([regressor.scale for regressor in present])
    covariance = inverse * np.outer(wider * scale, wider * scale)
    # another record as long differs by twice the Allan variance at the length of the record
    length, powers = np.array([series.samples]), surface.noise_powers
    variances = [power * term.allan_variances(length, averaged=True)[0] for term, power in powers.items()]
    apart = 2.0 * np.sum(variances, axis=0)
    mean_variance = float(grid_mean(surface, np.sqrt(apart), np.zeros_like(apart))[0]) ** 2
    return _Fit(present, mean * scale, covariance, mean_variance)


def _stated(
    series: BlockSeries,
    fit: _Fit,
    offset: float,
    reference: float,
    half: float,
) -> BiasFit:
    """Return the line of a regression whose last regressor is the temperature."""
    values = np.stack([regressor.series for regressor in fit.regressors], axis=1)
    # the bias at the reference temperature, in the middle of the record
    middle = values.mean(axis=0)
    bias = float(offset + series.series.mean() - middle @ fit.value)
    rise, variance = float(fit.value[-1]), float(fit.covariance[-1, -1])
    span = np.linspace(-1.0, 1.0, POINTS)
    # the bias at a temperature is that of the middle plus what the regressors say between the two: one linear
    # combination
    combination = np.tile(-middle, (POINTS, 1))
    combination[:, -1] += span
    curve = bias + span * rise
    spread = np.einsum("pq,qr,pr->p", combination, fit.covariance, combination)
    error = LIMIT_95 * np.sqrt(fit.mean_variance + spread)
    drifts = [i for i, regressor in enumerate(fit.regressors) if regressor.name == "drift"]
    without = series.series - values[:, drifts] @ fit.value[drifts]
    return BiasFit(
        reference_degC=reference,
        terms=(
            _regressor("degree 0", bias, fit.mean_variance + float(middle @ fit.covariance @ middle)),
            _regressor("degree 1", rise / half, variance / half**2),
        ),
        degC=tuple((reference + half * span).tolist()),
        bias=tuple(curve.tolist()),
        low=tuple((curve - error).tolist()),
        high=tuple((curve + error).tolist()),
        std_without=float(np.std(without)),
        std_with=float(np.std(series.series - values @ fit.value)),
    )


def _regressor(name: str, value: float, variance: float) -> RegressorEstimate:
    error = LIMIT_95 * math.sqrt(variance)
    return RegressorEstimate(name=name, value=value, low=value - error, high=value + error)


def _correlation(covariance: Floats, i: int, j: int) -> float:
    return float(abs(covariance[i, j]) / math.sqrt(covariance[i, i] * covariance[j, j]))
