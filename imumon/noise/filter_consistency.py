"""Predicted consistency of a Kalman filter that integrates a channel: NEES without simulation.

The problem
-----------
A filter with the states angle and bias (of an accelerometer: velocity and bias) assumes white noise N and a random
walk of the bias. A sensor also has flicker B, which no such filter describes. Then the variance that the filter states
is not that of its error. Their ratio is the NEES, the normalised estimation error squared (Bar-Shalom, Li, Kirubarajan,
Estimation with Applications to Tracking and Navigation, 2001, section 5.4): 1 is consistent, above 1 is overconfident.

The scenario
------------
The filter integrates the channel at 5 Hz. It gets a fix of the angle once a second, `FIXES` times, and none for the
horizon h after the last one. The numbers of the scenario are part of the contract (docs/FILTERS.md).

The model
---------
Filter and truth are linear, so the error follows without any random number. With Phi the integral of the noise of the
channel, dPhi_k its increment over second k, v_k the error of fix k, and T the time of the last fix:

    e(h)    = sum_k w_k dPhi_k  +  sum_k u_k v_k  +  Phi(T + h) - Phi(T)
    NEES(h) = E[e(h)^2] / P(h)

1. The gains of the filter depend on its own parameters alone, not on the truth (Riccati recursion). So does P, the
   variance that it states.
2. One backward recursion over these gains gives the weights w_k and u_k.
3. The covariance of two increments is exact. With g the generalised autocovariance of Phi, which is -N^2 |t| / 2,
   B^2 t^2 ln|t| / (2 pi) and K^2 |t|^3 / 12 (`power_law.phase_autocovariance`; Greenhall, IEEE Trans. Instrum. Meas.
   40, 994, 1991):

       cov(Phi(b) - Phi(a), Phi(d) - Phi(c)) = g(b - d) - g(b - c) - g(a - d) + g(a - c)

   For flicker this holds only for weights that sum to zero: its increments alone have no finite variance. They do sum
   to zero, because the bias has no prior information: an error of a constant rate is corrected. Of Gauss–Markov noise
   of standard deviation M and time constant T, g is -M^2 T^2 (|t|/T - 1 + exp(-|t|/T)) (IEEE Std 952-1997, section
   C.1.4), up to a multiple of t^2, which these weights remove.
4. Both moments of NEES(h) are then closed forms.

All filters of a call are computed together, so that a search over parameters costs little more than one prediction.

Example
-------
N and K are the right numbers for a channel without flicker. With flicker they make a filter overconfident, the more
the longer it has no fix:

>>> def nees(B):
...     truths = ChannelTruths(np.array([6.1e-5]), np.array([B]), np.array([1e-7]), np.array([1e-3]))
...     filters = FilterModels.without_terms(truths.N, truths.K)
...     return predict(filters, truths, np.array([1.0, 1800.0])).nees[0].round(1).tolist()
>>> nees(B=0.0), nees(B=2.4e-5)
([1.0, 1.0], [3.9, 34.9])
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from imumon.model.samples import Floats
from imumon.noise import markov_law
from imumon.noise.power_law import phase_autocovariance

STEP_S = 0.2
"""s, step of the filter in the reference scenario (contract, 5 Hz); it divides 1 s."""

FIXES = 900
"""Fixes of the reference scenario, one per second (contract)."""

FIX_STD = {"gyro": 1e-3, "accel": 1e-2}
"""rad and m/s, standard deviation of a fix (contract)."""

UNKNOWN_BIAS = 1e3
"""Fixes' standard deviations per second that the bias may have at the start: it is unknown. A hundred times as much
changes no NEES by more than 1e-5."""

Autocovariance: TypeAlias = Callable[[Floats], Floats]
"""Returns (r, ...) the generalised autocovariance of the integral of a noise of size 1 at lags (...), s."""


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
    M: Floats | None = None  # (r,) unit, standard deviation of Gauss–Markov noise; None: there is none
    T: Floats | None = None  # (r,) s, its time constant, above 0 also where M is 0


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
    second = _second_matrices(models)
    gains, stated = _filter_through_fixes(models, truths.fix, second)
    effects, driven = _open_loop(models, horizon_s)
    variance = np.einsum("rhi,rij,rhj->rh", effects, stated, effects) + driven
    error = _squared_error(truths, _weights(gains, second[0]), effects, horizon_s)
    return Consistency(error / variance, np.sqrt(variance))


def _second_matrices(models: FilterModels) -> tuple[Floats, Floats]:
    """Return transition and driven covariance of one second, (r, m, m) each; states: angle, bias, terms."""
    r, p = models.sigma.shape
    m, term = 2 + p, np.arange(2, 2 + p)
    decay = np.exp(-STEP_S / models.tau)
    step, drive = np.zeros((r, m, m)), np.zeros((r, m, m))
    step[:] = np.eye(m)
    # The angle is the integral of the reading less the bias and the terms, which the filter estimates.
    step[:, 0, 1:] = -STEP_S
    step[:, term, term] = decay
    drive[:, 0, 0] = models.white**2 * STEP_S
    drive[:, 1, 1] = models.walk**2 * STEP_S
    # What a term loses by its decay is driven again, so that its variance stays sigma^2. expm1: a correlation time
    # of 1e6 s decays by 2e-7 in a step, and 1 - exp would keep nine digits of it.
    drive[:, term, term] = models.sigma**2 * -np.expm1(-2.0 * STEP_S / models.tau)
    transition, covariance = step, drive
    for _ in range(
        round(1.0 / STEP_S) - 1
    ):  # between two fixes nothing but time passes: one matrix for all steps
        covariance = step @ covariance @ step.swapaxes(1, 2) + drive
        transition = step @ transition
    return transition, covariance


def _filter_through_fixes(
    models: FilterModels, fix: Floats, second: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return the gain of every fix, (FIXES, r, m), and the covariance after the last, (r, m, m)."""
    transition, driven = second
    r, m, _ = transition.shape
    term = np.arange(2, m)
    noise = fix**2
    stated = np.zeros((r, m, m))
    stated[:, 0, 0] = noise  # the first fix gives the angle at the start
    stated[:, 1, 1] = UNKNOWN_BIAS**2 * noise
    stated[:, term, term] = models.sigma**2  # a Gauss-Markov term begins stationary
    transposed = np.ascontiguousarray(transition.swapaxes(1, 2))
    gains = np.empty((FIXES, r, m))
    for k in range(FIXES):
        stated = transition @ stated @ transposed + driven
        gain = stated[:, :, 0] / (stated[:, 0, 0] + noise)[:, None]
        # The short form of the update holds for the optimal gain, which this is.
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
        # later (1 - gain e') differs from `later` in the column of the angle only, which is that of the increment
        later[:, :, 0] = increments[k]
        later = later @ transition
    fixes[0] = later[:, :, 0]  # the error of the first fix is the error of the angle at the start
    return increments, fixes


def _open_loop(models: FilterModels, horizon_s: Floats) -> tuple[Floats, Floats]:
    """Return the effect of the states at the last fix on the angle at each horizon, and the driven variance.

    Without fixes each state adds to the angle by a geometric sum over the n = h / `STEP_S` steps. With d the decay
    of a term in one step, its value now adds -STEP_S (1 - d^n) / (1 - d). What drives it j steps before the horizon
    adds STEP_S (1 - d^j) / (1 - d), whose squares sum to n - 2 (1 - d^n) / (1 - d) + (1 - d^2n) / (1 - d^2). What
    drives the bias j steps before the horizon adds j STEP_S, whose squares sum to (n - 1) n (2 n - 1) / 6.

    Returns
    -------
    effects : (r, h, m)
    driven : (r, h) integrated unit squared
    """
    steps = horizon_s / STEP_S
    # 1 - d, 1 - d^2, 1 - d^n and 1 - d^2n, by expm1 because d is close to 1
    lost = -np.expm1(-STEP_S / models.tau)[:, None, :]  # (r, 1, p)
    twice = -np.expm1(-2.0 * STEP_S / models.tau)[:, None, :]
    gone = -np.expm1(-horizon_s[:, None] / models.tau[:, None, :])  # (r, h, p)
    gone_twice = -np.expm1(-2.0 * horizon_s[:, None] / models.tau[:, None, :])
    effects = np.empty((len(models.white), len(horizon_s), 2 + models.sigma.shape[1]))
    effects[:, :, 0] = 1.0
    effects[:, :, 1] = -horizon_s
    effects[:, :, 2:] = -STEP_S * gone / lost
    squares = (steps - 1.0) * steps * (2.0 * steps - 1.0) / 6.0
    driven = models.white[:, None] ** 2 * horizon_s + models.walk[:, None] ** 2 * STEP_S**3 * squares
    sums = steps[:, None] - 2.0 * gone / lost + gone_twice / twice
    terms = (STEP_S * models.sigma[:, None, :] / lost) ** 2 * twice * sums
    return effects, driven + terms.sum(axis=2)


def _squared_error(
    truths: ChannelTruths, weights: tuple[Floats, Floats], effects: Floats, horizon_s: Floats
) -> Floats:
    """Return the mean square of the true error of the angle, (r, h).

    Parameters
    ----------
    weights : of `_weights`, on the error after the last fix.
    effects : (r, h, m) of `_open_loop`.
    """
    increments, fixes = (part.transpose(1, 0, 2) for part in weights)  # (r, n, m): matmul of stacks
    # Increments of white noise over 1 s are independent, of variance N^2, and so are the errors of the fixes.
    covariance = truths.N[:, None, None] ** 2 * (increments.swapaxes(1, 2) @ increments)
    covariance += truths.fix[:, None, None] ** 2 * (fixes.swapaxes(1, 2) @ fixes)
    mixed, ahead = np.zeros((len(truths.N), len(horizon_s))), truths.N[:, None] ** 2 * horizon_s
    for strength, autocovariance in _with_memory(truths):
        square = strength**2
        within = _within(autocovariance, increments)
        covariance += square[:, None, None] * (increments.swapaxes(1, 2) @ within)
        # what follows the last fix depends on the increments before it
        crossing, following = _beyond_the_fixes(autocovariance, horizon_s)
        mixed += square[:, None] * (effects * (crossing @ increments)).sum(axis=2)
        ahead = ahead + square[:, None] * following
    return np.asarray(np.einsum("rhi,rij,rhj->rh", effects, covariance, effects) + 2.0 * mixed + ahead)


def _with_memory(truths: ChannelTruths) -> Iterator[tuple[Floats, Autocovariance]]:
    """Yield the strength (r,) of each noise with a memory, and the generalised autocovariance of its integral."""
    yield truths.B, lambda lag: phase_autocovariance(lag)[1, None]
    yield truths.K, lambda lag: phase_autocovariance(lag)[2, None]
    if truths.M is not None and truths.T is not None:
        times = truths.T
        yield truths.M, lambda lag: markov_law.phase_autocovariance(lag, times.reshape(-1, *[1] * lag.ndim))


def _within(autocovariance: Autocovariance, increments: Floats) -> Floats:
    """Return the covariance of the increments between the fixes times weights (r, n, m)."""
    # it depends on the lag alone: the product is a circular convolution over twice as many seconds
    by_lag = -np.diff(autocovariance(np.abs(np.arange(-1.0, FIXES + 1.0))), 2)
    circle = np.concatenate((by_lag, np.zeros((len(by_lag), 1)), by_lag[:, :0:-1]), axis=1)
    product = np.fft.rfft(circle)[:, :, None] * np.fft.rfft(increments, 2 * FIXES, axis=1)
    return np.asarray(np.fft.irfft(product, 2 * FIXES, axis=1)[:, :FIXES])


def _beyond_the_fixes(autocovariance: Autocovariance, horizon_s: Floats) -> tuple[Floats, Floats]:
    """Return the covariance of what follows the last fix with the increments before, and the variance of the former.

    Returns
    -------
    crossing : (r, h, FIXES), following : (r, h); the first axis is 1 where all channels have the same.
    """
    since = np.arange(float(FIXES), -1.0, -1.0)  # s from each fix to the last
    to_horizon = autocovariance(since + horizon_s[:, None]) - autocovariance(since)[:, None]
    return np.diff(to_horizon), 2.0 * (autocovariance(np.zeros(1)) - autocovariance(horizon_s))
