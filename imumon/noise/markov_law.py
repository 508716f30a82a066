"""First-order Gauss–Markov noise of standard deviation 1: density, autocovariance, Allan variance.

IEEE Std 952-1997, section C.1.4, calls it exponentially correlated noise. It forgets its value with the time constant
T: its autocovariance at a lag t is exp(-|t| / T). Everything is in units of the interval between samples, two-sided,
f in cycles per sample, as in `power_law`.

    density of the rate              2 T / (1 + (2 pi f T)^2)
    variance of its integral         2 T^2 (t/T - 1 + exp(-t/T))
    Allan variance                   (2 T / m) (1 - T / (2 m) (3 - 4 exp(-m/T) + exp(-2 m/T))), largest at m = 1.89 T

At clusters far below T it looks like a random walk with K^2 = 2/T, far above T like white noise with N^2 = 2 T. Point
samples are an autoregression of first order with a = exp(-1/T); averages over the interval have the autocovariance
T^2 (1 - a)^2 a^(l-1) at lags l >= 1.

>>> round(float(allan_variances(np.array([189]), 100.0, averaged=True)[0] ** 0.5), 4)
0.6174
"""

from __future__ import annotations

import numpy as np

from imumon.model.samples import Floats, Ints

SERIES_BELOW = 0.05
"""Lags in time constants below which differences of exponentials are computed by their series: they cancel."""


def average_autocovariance(time: float) -> tuple[float, float, float]:
    """Return the autocovariance of averages at lag 0 and lag 1, and the ratio a of one lag to the next beyond.

    Parameters
    ----------
    time : time constant in intervals.
    """
    x = 1.0 / time
    fall = -float(np.expm1(-x))  # 1 - a
    return float(2.0 * _rest(np.array([x]), 2)[0] / x**2), (fall / x) ** 2, float(np.exp(-x))


def _rest(x: Floats, order: int) -> Floats:
    """Return exp(-x) without the first `order` terms of its series, which is small where x is."""
    series, term = np.zeros_like(x), np.ones_like(x)
    for k in range(1, order + 9):
        term = term * -x / k
        if k >= order:
            series = series + term
    direct, term = np.exp(-x), np.ones_like(x)
    for k in range(order):
        direct = direct - term
        term = term * -x / (k + 1)
    return np.where(x < SERIES_BELOW, series, direct)


def sampled_density(f: Floats, time: float, *, averaged: bool) -> Floats:
    """Return (k,) the density of samples at f (k,) cycles per sample, above 0 and at most 1/2.

    >>> sampled_density(np.array([1e-6]), 50.0, averaged=True).round(1)  # 2 T
    array([100.])
    """
    a = float(np.exp(-1.0 / time))
    # 1 + a^2 - 2 a cos, without cancellation
    distance = (-np.expm1(-1.0 / time)) ** 2 + 4.0 * a * np.sin(np.pi * f) ** 2
    if not averaged:
        return np.asarray(-np.expm1(-2.0 / time) / distance)
    zero, one, _ = average_autocovariance(time)
    return np.asarray(zero + 2.0 * one * (np.cos(2.0 * np.pi * f) - a) / distance)


def allan_variances(m: Ints, time: float, *, averaged: bool) -> Floats:
    """Return (k,) the Allan variance at clusters of m (k,) samples."""
    clusters = m.astype(np.float64)
    x = clusters / time
    # 4 V(m) - V(2 m) of the variance V of the integral, in which constant and linear terms cancel
    of_averages = (4.0 * _rest(x, 3) - _rest(2.0 * x, 3)) / x**2
    if averaged:
        return np.asarray(of_averages)
    zero, one, a = average_autocovariance(time)
    return np.asarray((1.0 - a * zero / one) / clusters + a / one * of_averages)


def phase_autocovariance(lag: Floats, time: float | Floats) -> Floats:
    """Return (...) the generalised autocovariance of the integral at lags, without terms that differences remove.

    The variance of the integral over -2, plus t^2 / 2: second differences remove a constant and a square.
    """
    return np.asarray(-(time**2) * _rest(np.abs(lag) / time, 3))
