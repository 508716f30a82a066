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
from imumon.noise.fit.likelihood import Likelihood, Surface, grid_mean
from imumon.noise.fit.model import total
from imumon.noise.fit.normal_equations import inverse_and_log, normal_matrix
from imumon.noise.fit.observations import BlockSeries, block_series, meeting_frequency
from imumon.noise.fit.regressors import COLLINEAR, Regressor
from imumon.noise.fit.slow_terms import SlowTerms
from imumon.noise.fit.statement import RegressorEstimate
from imumon.samples import Floats

NEGLECTED_P = 0.25
"""A higher degree of the bias curve, or the variance between quarters, counts where chance makes as much in fewer
records. Unit: probability.

Otherwise: at 0.05 limits beside a neglected term hold 88 %, at 0.25 92 %. Origin: Bancroft 1944; Biometrics 20, 1964
(`temperature.py`).
"""

SPAN_PER_DEGREE_DEGC = 2.0
"""Span of temperatures that each degree above the first needs. Unit: degC.

Otherwise: a cubic through 1 degC is extrapolated to 40 degC by whoever compensates with it. Origin: sensors bend
little within 2 degC (`temperature.py`).
"""
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
JUMP_SHARE = 0.5
"""A temperature that changes more between two blocks, and by JUMP_DEGC, is an error of the thermometer. Unit: of
the span.

Otherwise: a plug that is pulled makes a line through two clouds of points. Chosen: no sensor warms by half of its
span within a block.
"""
JUMP_DEGC = 2.0
"""Least jump of a temperature that counts as one, see JUMP_SHARE. Unit: degC.

Otherwise: the steps of a coarse thermometer count as jumps. Chosen: twenty steps of a tenth of a degree.
"""
POINTS = 9
"""Points of the bias curve. Unit: temperatures.

Otherwise: a cubic is drawn with corners. Origin: chosen for the figure and the size of the report.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasFit:
    """Bias of a channel against the temperature: a polynomial about a reference.

    Attributes
    ----------
    reason : why there are no terms: ``too_short``, ``no_temperature``, ``small_range``, ``collinear``, ``implausible``
        or ``jumps``; None: there are some.
    reference_degC : degC, middle of the temperatures of the record.
    terms : ``degree 0`` (the bias at the reference, channel unit) to at most ``degree 3`` (channel unit per degC^3).
    hysteresis : channel unit, greatest difference, warming less cooling; None: not both in the record.
    degC, bias, low, high : temperatures of the curve, and the curve with its 95 % limits, channel unit.
    std_without, std_with : channel unit, standard deviation of the block means about their drift, and about drift and
        curve.
    """

    reason: str | None = None
    reference_degC: float | None = None
    terms: tuple[RegressorEstimate, ...] = ()
    hysteresis: RegressorEstimate | None = None
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
    value: Floats  # (q,) in the scale of each column, as is the covariance
    covariance: Floats  # (q, q)
    mean_variance: float  # (channel unit)^2, of the mean of the record against that of another one as long

    def sigma(self, number: int) -> float:
        """Return the standard errors by which a coefficient differs from zero."""
        return float(abs(self.value[number]) / math.sqrt(self.covariance[number, number]))


def bias_curve(
    blocks: BlockMeans,
    column: int,
    degrees: Floats | None,
    noise: Surface | None = None,
    extremes: tuple[float, float] | None = None,
) -> BiasFit:
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
        return BiasFit(reason="too_short")
    straight, reason = columns_of.temperature(series)
    if straight is None or series.degrees is None:
        return BiasFit(reason=reason)
    low, high = float(np.nanmin(series.degrees)), float(np.nanmax(series.degrees))
    coldest, hottest = extremes or (low, high)
    if min(low, coldest) < LOWEST_DEGC or max(high, hottest) > HIGHEST_DEGC:
        return BiasFit(reason="implausible")
    jumps = np.abs(np.diff(straight.series))
    jumps[series.begin[1:] - 1] = 0.0
    if jumps.max() > max(JUMP_SHARE * (high - low), JUMP_DEGC):
        return BiasFit(reason="jumps")
    reference, half = 0.5 * (low + high), 0.5 * (high - low)
    u, loop = columns_of.unit_span(straight.series), columns_of.hysteresis(series, straight.series)
    fit = _fitted(series, u, loop, 1, noise)
    names = [column.name for column in fit.regressors]
    one, drift = names.index("temperature"), names.index("drift") if "drift" in names else None
    if drift is not None and _correlation(fit.covariance, one, drift) > COLLINEAR:
        return BiasFit(reason="collinear")
    degree = 1
    for more in range(2, len(BIAS_TERMS) + 1):
        if high - low >= SPAN_PER_DEGREE_DEGC * more:
            other = _fitted(series, u, loop, more, noise)
            if 2.0 * ndtr(-other.sigma(one + more - 1)) < NEGLECTED_P:
                fit, degree = other, more
    return _stated(series, fit, blocks.offset[column], one, degree, reference, half)


def _fitted(
    series: BlockSeries, u: Floats, loop: Regressor | None, degree: int, noise: Surface | None
) -> _Fit:
    """Return the regression on a polynomial of u (n,), and on hysteresis where both directions occur."""
    heat = [columns_of.of_series(series, "temperature", u**power) for power in range(1, degree + 1)]
    if loop is not None:
        heat.append(loop)
    regressors = [*columns_of.drifts(series), *heat]
    masked = np.zeros(series.y.size, dtype=bool)
    terms = SlowTerms(series, regressors, masked, [], 0.0, "")
    top = meeting_frequency(series)
    beside = {} if noise is None else noise.beside
    terms = terms.with_terms(list(beside))
    likelihood = Likelihood(*terms.observations(top, top), beside=beside)
    if noise is None:
        surface = likelihood.search(series.samples)
    else:
        # the noise of the fit, with its limits, and the regression of these columns
        surface = replace(
            likelihood.surface(noise.grids), log=noise.log, scored=noise.scored, likeliest=noise.likeliest
        )
    mean, error = grid_mean(surface, surface.beta, surface.beta_variances)
    coefficients = likelihood.coefficients
    variance = total(surface.powers, lambda term: coefficients.variances[term])
    inverse = inverse_and_log(normal_matrix(1.0 / variance[:, None], coefficients.X))[0][:, :, 0]
    # the noise is not known exactly: the errors are those over all N, B and K, the correlations of the likeliest
    wider = error / np.sqrt(np.diagonal(inverse))
    scale = np.array([column.scale for column in regressors])
    covariance = inverse * np.outer(wider * scale, wider * scale)
    # another record as long differs by twice the Allan variance at the length of the record
    length, powers = np.array([series.samples]), surface.noise_powers
    variances = [power * term.allan_variances(length, averaged=True)[0] for term, power in powers.items()]
    apart = 2.0 * np.sum(variances, axis=0)
    mean_variance = float(grid_mean(surface, np.sqrt(apart), np.zeros_like(apart))[0]) ** 2
    return _Fit(regressors, mean * scale, covariance, mean_variance)


def _stated(
    series: BlockSeries,
    fit: _Fit,
    offset: float,
    one: int,
    degree: int,
    reference: float,
    half: float,
) -> BiasFit:
    """Return the curve of a regression whose temperature columns begin at number `one`."""
    columns = np.stack([column.series for column in fit.regressors], axis=1)
    polynomial = slice(one, one + degree)
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
    span = np.linspace(-1.0, 1.0, POINTS)
    powers = span[:, None] ** np.arange(1, degree + 1)
    # the bias at a temperature is that of the middle plus what the columns say between the two: one linear combination
    combination = np.tile(-middle, (POINTS, 1))
    combination[:, polynomial] += powers
    curve = bias + powers @ fit.value[polynomial]
    spread = np.einsum("pq,qr,pr->p", combination, fit.covariance, combination)
    error = LIMIT_95 * np.sqrt(fit.mean_variance + spread)
    drifts = [i for i, column in enumerate(fit.regressors) if column.name == "drift"]
    without = series.series - columns[:, drifts] @ fit.value[drifts]
    hysteresis = None
    if fit.regressors[-1].name == "hysteresis":
        hysteresis = _column("hysteresis", float(fit.value[-1]), float(fit.covariance[-1, -1]))
    return BiasFit(
        reference_degC=reference,
        terms=tuple(_column(f"degree {i}", *row) for i, row in enumerate(rows)),
        hysteresis=hysteresis,
        degC=tuple((reference + half * span).tolist()),
        bias=tuple(curve.tolist()),
        low=tuple((curve - error).tolist()),
        high=tuple((curve + error).tolist()),
        std_without=float(np.std(without)),
        std_with=float(np.std(series.series - columns @ fit.value)),
    )


def _column(name: str, value: float, variance: float) -> RegressorEstimate:
    error = LIMIT_95 * math.sqrt(variance)
    return RegressorEstimate(name=name, value=value, low=value - error, high=value + error)


def _correlation(covariance: Floats, i: int, j: int) -> float:
    return float(abs(covariance[i, j]) / math.sqrt(covariance[i, i] * covariance[j, j]))
