"""Predicted consistency of a Kalman filter that integrates a channel: NEES without simulation.

A filter that knows only white noise and a random walk is overconfident where the channel has flicker. How much
follows without any random number, because filter and truth are linear:

1. The gains of the filter depend on its own parameters alone (Riccati recursion).
2. With these gains the error of every state is a sum of the increments of the integrated noise, one per second,
   and of the errors of the fixes, with weights that one backward recursion gives.
3. The covariance of the increments is exact for white noise, flicker and random walk: second differences of
   the generalised autocovariance of the integrated noise, -|t|/2 N^2, t^2 ln|t|/(2 pi) B^2, |t|^3/12 K^2
   (docs/THEORY.md). It holds for weights that sum to zero, and they do: the bias has no prior information.
4. NEES(h) = E[(error of the angle at h)^2] / (variance that the filter states), both in closed form.

All filters of a call are computed together, so that a search costs little more than one prediction.
Reference: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 5.4 (NEES).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from imumon.noise.power_law import phase_autocovariance
from imumon.samples import Floats

STEP_S = 0.2
"""s, step of the filter in the reference scenario (contract, 5 Hz); it divides 1 s."""

FIXES = 900
"""Fixes of the reference scenario, one per second (contract)."""

FIX_STD = {"gyro": 1e-3, "accel": 1e-2}
"""rad and m/s, standard deviation of a fix (contract)."""

UNKNOWN_BIAS = 1e3
"""Fixes' standard deviations per second that the bias may have at the start: it is unknown."""


@dataclass(frozen=True, slots=True)
class FilterModels:
    """Parameters of r filters with p Gauss-Markov terms each."""

    white: Floats  # (r,) unit/sqrt(Hz)
    walk: Floats  # (r,) unit*sqrt(Hz)
    sigma: Floats  # (r, p) unit, standard deviations
    tau: Floats  # (r, p) s, correlation times

    @classmethod
    def without_terms(cls, white: Floats, walk: Floats) -> FilterModels:
        """Return filters with white noise and random walk alone."""
        empty = np.empty((len(white), 0))
        return cls(white, walk, empty, empty)


@dataclass(frozen=True, slots=True)
class ChannelTruths:
    """True noise of the channels that r filters integrate, and the fixes that they get."""

    N: Floats  # (r,) unit/sqrt(Hz)
    B: Floats  # (r,) unit
    K: Floats  # (r,) unit*sqrt(Hz)
    fix: Floats  # (r,) integrated unit, standard deviation of a fix


@dataclass(frozen=True, slots=True)
class Consistency:
    """What the filters state, and how far it is from the truth."""

    nees: Floats  # (r, h) 1
    std: Floats  # (r, h) integrated unit, that the filter states


def predict(models: FilterModels, truths: ChannelTruths, horizon_s: Floats) -> Consistency:
    """Return NEES and stated standard deviation of r filters at h times after their last fix.

    Parameters
    ----------
    horizon_s : (h,) s, multiples of `STEP_S`.
    """
    step = _step_matrices(models)
    gains, stated = _filter_through_fixes(models, truths.fix, step)
    rows, driven = _open_loop(models, horizon_s)
    variance = np.einsum("rhi,rij,rhj->rh", rows, stated, rows) + driven
    error = _squared_error(truths, _weights(gains, step[0]), rows, horizon_s)
    return Consistency(error / variance, np.sqrt(variance))


def _step_matrices(models: FilterModels) -> tuple[Floats, Floats]:
    """Return transition and driven covariance of one second, (r, m, m) each; states: angle, bias, terms."""
    r, p = models.sigma.shape
    m, term = 2 + p, np.arange(2, 2 + p)
    decay = np.exp(-STEP_S / models.tau)
    one, drive = np.zeros((r, m, m)), np.zeros((r, m, m))
    one[:] = np.eye(m)
    one[:, 0, 1:] = -STEP_S
    one[:, term, term] = decay
    drive[:, 0, 0] = models.white**2 * STEP_S
    drive[:, 1, 1] = models.walk**2 * STEP_S
    drive[:, term, term] = models.sigma**2 * -np.expm1(-2.0 * STEP_S / models.tau)
    transition, covariance = one, drive
    for _ in range(round(1.0 / STEP_S) - 1):  # between two fixes
        covariance = one @ covariance @ one.swapaxes(1, 2) + drive
        transition = one @ transition
    return transition, covariance


def _filter_through_fixes(
    models: FilterModels, fix: Floats, step: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return the gain of every fix, (FIXES, r, m), and the covariance after the last, (r, m, m)."""
    transition, driven = step
    r, m, _ = transition.shape
    term = np.arange(2, m)
    noise = fix**2
    stated = np.zeros((r, m, m))
    stated[:, 0, 0] = noise
    stated[:, 1, 1] = UNKNOWN_BIAS**2 * noise
    stated[:, term, term] = models.sigma**2
    transposed = np.ascontiguousarray(transition.swapaxes(1, 2))
    gains = np.empty((FIXES, r, m))
    for k in range(FIXES):
        stated = transition @ stated @ transposed + driven
        gain = stated[:, :, 0] / (stated[:, 0, 0] + noise)[:, None]
        stated = stated - gain[:, :, None] * stated[:, :1, :]
        gains[k] = gain
    return gains, stated


def _weights(gains: Floats, transition: Floats) -> tuple[Floats, Floats]:
    """Return the weights of the increments, (FIXES, r, m), and of the fixes, (FIXES + 1, r, m).

    The error after fix k is (1 - gain e') (transition error + e increment) + gain fix, e the unit vector of the
    angle. From the last fix back, `later` is the effect of the error after fix k on the error after the last.
    """
    n, r, m = gains.shape
    increments, fixes = np.empty((n, r, m)), np.empty((n + 1, r, m))
    later = np.zeros((r, m, m))
    later[:] = np.eye(m)
    for k in range(n - 1, -1, -1):
        fixes[k + 1] = (later @ gains[k][:, :, None])[:, :, 0]
        increments[k] = later[:, :, 0] - fixes[k + 1]
        later[:, :, 0] = increments[k]
        later = later @ transition
    fixes[0] = later[:, :, 0]
    return increments, fixes


def _open_loop(models: FilterModels, horizon_s: Floats) -> tuple[Floats, Floats]:
    """Return the effect of the states at the last fix on the angle at each horizon, and the driven variance.

    Geometric sums over the steps since the last fix.

    Returns
    -------
    rows : (r, h, m)
    driven : (r, h) integrated unit squared
    """
    steps = horizon_s / STEP_S
    lost = -np.expm1(-STEP_S / models.tau)[:, None, :]  # (r, 1, p), of a term in one step
    twice = -np.expm1(-2.0 * STEP_S / models.tau)[:, None, :]
    gone = -np.expm1(-horizon_s[:, None] / models.tau[:, None, :])  # (r, h, p), of a term until the horizon
    gone_twice = -np.expm1(-2.0 * horizon_s[:, None] / models.tau[:, None, :])
    rows = np.empty((len(models.white), len(horizon_s), 2 + models.sigma.shape[1]))
    rows[:, :, 0] = 1.0
    rows[:, :, 1] = -horizon_s
    rows[:, :, 2:] = -STEP_S * gone / lost
    squares = (steps - 1.0) * steps * (2.0 * steps - 1.0) / 6.0
    driven = models.white[:, None] ** 2 * horizon_s + models.walk[:, None] ** 2 * STEP_S**3 * squares
    sums = steps[:, None] - 2.0 * gone / lost + gone_twice / twice
    terms = (STEP_S * models.sigma[:, None, :] / lost) ** 2 * twice * sums
    return rows, driven + terms.sum(axis=2)


def _squared_error(
    truths: ChannelTruths, weights: tuple[Floats, Floats], rows: Floats, horizon_s: Floats
) -> Floats:
    """Return the mean square of the true error of the angle, (r, h)."""
    increments, fixes = weights
    n, r, m = increments.shape
    flat, strength = increments.reshape(n, r * m), (truths.B**2, truths.K**2)
    start, now = np.arange(float(n)), float(n)

    def product(a: Floats, b: Floats) -> Floats:
        return np.asarray(np.matmul(a.transpose(1, 2, 0), b.transpose(1, 0, 2)))

    covariance = truths.N[:, None, None] ** 2 * product(increments, increments)
    covariance += truths.fix[:, None, None] ** 2 * product(fixes, fixes)
    mixed, ahead = np.zeros((r, len(horizon_s))), truths.N[:, None] ** 2 * horizon_s
    for noise, square in enumerate(strength, start=1):
        within = (_increments(noise) @ flat).reshape(n, r, m)
        covariance += square[:, None, None] * product(increments, within)
        later = _covariance(start[:, None], start[:, None] + 1.0, now, now + horizon_s, noise)
        crossing = (later.T @ flat).reshape(len(horizon_s), r, m).transpose(1, 0, 2)
        mixed += square[:, None] * (rows * crossing).sum(axis=2)
        ahead = ahead + square[:, None] * _covariance(0.0 * horizon_s, horizon_s, 0.0, horizon_s, noise)
    return np.asarray(np.einsum("rhi,rij,rhj->rh", rows, covariance, rows) + 2.0 * mixed + ahead)


def _covariance(a: Floats | float, b: Floats, c: Floats | float, d: Floats, noise: int) -> Floats:
    """Return the generalised covariance of the increments over [a, b] and [c, d], s, of N, B or K = 1 by number."""
    near, far = phase_autocovariance(b - d)[noise], phase_autocovariance(np.asarray(a - c))[noise]
    return np.asarray(near - phase_autocovariance(b - c)[noise] - phase_autocovariance(a - d)[noise] + far)


@cache
def _increments(noise: int) -> Floats:
    """Return the covariance of the increments between the fixes, (FIXES, FIXES)."""
    start = np.arange(float(FIXES))
    return _covariance(start[:, None], start[:, None] + 1.0, start, start + 1.0, noise)
