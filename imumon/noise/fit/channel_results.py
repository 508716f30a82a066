"""What a description states about a channel, in SI: coefficients and regressors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from imumon.coefficients import LIMIT_95, SIGNIFICANT
from imumon.noise.fit.description import Description
from imumon.noise.fit.expected_curve import moved_variances
from imumon.noise.fit.likelihood import averaged as average_over
from imumon.noise.fit.likelihood import evidence, normal_matrix, quantiles
from imumon.noise.fit.regressors import BENT, COLLINEAR, OSCILLATION
from imumon.noise.fit.results import ChannelFit
from imumon.noise.fit.slow_terms import CHANCE
from imumon.noise.fit.stated_curve import BENDS, Stated, line_bands, moved, oscillations
from imumon.noise.fit.time_to_precision import seconds_to
from imumon.noise.noise_sums import NoiseSums
from imumon.report import COEFFICIENTS, NOISE, Change, Estimate, ModelColumn
from imumon.samples import Floats

LEAST_B_K_S = 10.0
"""s, shortest record for B and K: before, a filter, a vibration, and the start look like them."""
EVIDENCE = 4.8
"""Twice the log likelihood ratio against zero from which a coefficient is measured: 1.4 % false detections (half of the
records have the best value at zero). Of N^2 and Q^2 it is the square over that of the standard error."""
SAME_PERIOD = 0.2
"""Relative difference up to which two periods are those of one oscillation."""

NOT_SHOWN = "the record does not show it"
TOO_SHORT = "the record is too short"


def stated(
    sums: NoiseSums, channel: int, found: Description, kurtosis: float, precision: Floats | None
) -> Stated:
    """Return what a description of one channel states.

    Parameters
    ----------
    sums : those of the description.
    kurtosis : 1, excess kurtosis of the samples.
    precision : (3,) 1, requested relative half-widths of N, B and K; None: no times are wanted.
    """
    tau0, samples = sums.tau0, found.slow.series.samples
    coefficients = {
        letter: each.scaled(math.pow(tau0, -COEFFICIENTS[letter].slope))
        for letter, each in _coefficients(found, kurtosis / samples, samples * tau0).items()
    }
    columns, collinear = _columns(found, tau0)
    drift = next((each for each in reversed(columns) if each.name == "drift"), None)
    if drift is not None and drift.sigma > SIGNIFICANT and not collinear:
        coefficients["R"] = _ramp(drift)
    highest = float(found.likelihood.powers.top.max())
    none, lines = np.zeros(0), line_bands(sums, channel)
    periods_s = _periods(found, lines, tau0)
    holds = {
        "misfit": found.p_value < CHANCE,
        "correlated": found.window > 1 or found.likelihood.shape == "filtered",
        "quantised": "Q" in coefficients,
        "oscillation": bool(periods_s),
    }
    fit = ChannelFit(
        coefficients=coefficients,
        chi2=found.misfit,
        dof=round(found.dof),
        p_value=found.p_value,
        model=none,
        noise=none,
        used=none > 0.0,
        low=none,
        high=none,
        edf=none,
        caveats=tuple(caveat for caveat, true in holds.items() if true),
        columns=columns,
        no_slope="collinear" if collinear else found.slow.no_temperature,
        explained=_explained(found),
        step=_step(found, columns),
        lines_hz=tuple((lines[:, 0] / tau0).tolist()),
        oscillations_s=periods_s,
        highest_hz=highest / tau0,
    )
    if precision is not None:
        widths = np.array([coefficients[letter].half_width or math.inf for letter in NOISE])
        seconds = seconds_to(found.surface.powers, widths, samples, tau0, highest, precision)
        fit = replace(fit, time_to=dict(zip(NOISE, seconds, strict=True)))
    return Stated(found, fit, moved_variances(found.slow.series, moved(found, lines)))


def _coefficients(found: Description, kurtosis: float, length_s: float) -> dict[str, Estimate]:
    """Return N, B and K, and Q where it shows, in units of tau0.

    Noise of independent samples with excess kurtosis g has powers whose relative covariances all gain g over the
    number of samples (the fourth cumulant of a sum of squares), as if N^2 itself varied.
    """
    surface = found.surface
    mean, error = (float(v) for v in average_over(surface, surface.a, surface.a_variance))
    error = math.hypot(error, mean * math.sqrt(max(kurtosis, 0.0)))

    def root(errors: float) -> float:
        return math.sqrt(max(mean + errors * error, 0.0))

    if mean > math.sqrt(EVIDENCE) * error:
        half = math.exp(0.5 * LIMIT_95 * error / mean)  # a variance is nearly log-normal
        value = root(0.0)
        white = Estimate(value=value, low=value / half, high=value * half, status="measured")
    else:
        white = _bound(root(LIMIT_95))
    out = {"N": white}
    for axis, letter in enumerate("BK"):
        value, low, high = quantiles(surface, axis, np.array([0.5, 0.025, 0.975])).tolist()
        if length_s < LEAST_B_K_S:
            out[letter] = Estimate(reason=TOO_SHORT)
        elif evidence(surface, axis) > EVIDENCE and low < value < high:
            out[letter] = Estimate(value=value, low=low, high=high, status="measured")
        else:
            out[letter] = _bound(high)
    if found.likelihood.shape == "quantised" and (quantised := _quantised(found)) is not None:
        out["Q"] = quantised
    return out


def _bound(high: float) -> Estimate:
    return Estimate(low=0.0, high=high, status="upper_bound", reason=NOT_SHOWN)


def _columns(found: Description, tau0: float) -> tuple[tuple[ModelColumn, ...], bool]:
    """Return the regressors with their coefficients, and whether time and temperature are not separable."""
    mean, error = average_over(found.surface, found.surface.beta, found.surface.beta_variance)
    length_s = found.slow.series.length * tau0
    out = []
    for each, value, deviation in zip(found.slow.regressors, mean.tolist(), error.tolist(), strict=True):
        if each.name == "settling_time" or each.name in OSCILLATION:
            continue
        scale = each.scale / length_s if each.name == "drift" else each.scale
        size, half = value * scale, LIMIT_95 * (deviation * scale)
        settles_s = each.at * length_s if each.name == "settling" else None
        out.append(
            ModelColumn(
                name=each.name, value=size, low=size - half, high=size + half, time_constant_s=settles_s
            )
        )
    collinear = False
    # beside its square, its cube and hysteresis a slope is always less certain: its limits say by how much
    names = [each.name for each in found.slow.regressors if each.name not in BENT]
    if "temperature" in names:
        own = [each.name not in BENT for each in found.slow.regressors]
        X = found.likelihood.coefficients.X[:, own]
        v = found.surface.powers @ found.likelihood.coefficients.variance
        inverse = np.linalg.inv(normal_matrix(1.0 / v[None], X)[0])
        one, two = names.index("drift"), names.index("temperature")
        collinear = abs(inverse[one, two]) > COLLINEAR * math.sqrt(inverse[one, one] * inverse[two, two])
    if collinear:
        out = [each for each in out if each.name != "temperature"]
    return tuple(out), bool(collinear)


def _step(found: Description, columns: tuple[ModelColumn, ...]) -> Change | None:
    """Return the step of a description as a change of the bias, with the means before and after it."""
    column = next((each for each in columns if each.name == "step"), None)
    if column is None:
        return None
    series = found.slow.series
    regressor = next(each for each in found.slow.regressors if each.name == "step")
    segment = int(np.searchsorted(series.begin, regressor.at, side="right")) - 1
    begin, at = int(series.begin[segment]), int(regressor.at)
    before = found.offset + float(series.series[begin:at].mean())
    return Change(
        against="time before",
        quantity="bias",
        before=before,
        now=before + column.value,
        ratio=None,
        sigma=column.sigma,
    )


def _ramp(drift: ModelColumn) -> Estimate:
    """Return R, the size of the drift."""
    low, high = sorted((abs(drift.low), abs(drift.high)))  # a significant drift excludes 0
    return Estimate(value=abs(drift.value), low=low, high=high, status="measured")


def _quantised(found: Description) -> Estimate | None:
    """Return Q of the term c 4 sin^2(pi f) = Q^2 (2 pi f)^2 in units of tau0, with the error of c."""
    likelihood, surface = found.likelihood, found.surface
    c = float(surface.c[surface.best])
    own = likelihood.powers.expected[:, [0, 3]] / likelihood.model(surface)[:, None]
    error = math.sqrt(np.linalg.pinv((0.5 * likelihood.dof[:, None] * own).T @ own)[1, 1])
    if c < math.sqrt(EVIDENCE) * error:
        return None
    low, high = (math.sqrt(max(c + sign * LIMIT_95 * error, 0.0)) for sign in (-1, 1))
    return Estimate(value=math.sqrt(c), low=low, high=high, status="measured")


def _periods(found: Description, lines: Floats, tau0: float) -> tuple[float, ...]:
    """Return the periods, s, of the oscillations that are left out: the middle of each."""
    out = []
    for group in oscillations(found, lines):
        weight = found.excess[group]
        out.append(float(tau0 * weight.sum() / (weight @ found.slow.series.f[group])))
    described = [
        each.at * found.slow.series.length * tau0
        for each in found.slow.regressors
        if each.name == OSCILLATION[0]
    ]
    for period in described:  # what is left of one beside its regressors is no other one
        out = [other for other in out if abs(other / period - 1.0) > SAME_PERIOD]
    out += described
    return tuple(sorted(out))


def _explained(found: Description) -> float | None:
    """Return the share of the variance of the means beyond white noise that follows the temperature."""
    names = [each.name for each in found.slow.regressors]
    if "temperature" not in names:
        return None
    at = names.index("temperature")
    each, value = found.slow.regressors[at], float(found.surface.beta[found.surface.best, at])
    total = float(np.var(found.slow.series.series))
    rest = float(np.var(found.slow.series.series - value * each.scale * each.series))
    white = float(found.surface.powers[0] * found.slow.series.variance[0].mean())
    if total - white <= BENDS * total:
        return None
    return min(1.0, max(0.0, (total - rest) / (total - white)))
