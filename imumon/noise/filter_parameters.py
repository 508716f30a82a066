"""Parameters that keep a Kalman filter consistent: white noise, random walk, Gauss-Markov terms.

The problem
-----------
N and K of a record are the right numbers for a channel without flicker. Flicker makes a filter with them
overconfident: it believes that it knows the bias better than it does (`filter_consistency`). There are two cures:

- One number more: a random walk larger than K. `smallest_walk` is the smallest with a predicted NEES of at most
  `MOST_NEES` from 1 s to the horizon. It is no property of the sensor: it depends on the horizon.
- States more: first-order Gauss-Markov processes, about one per decade of time. They are right at every horizon.

The model
---------
Why a walk depends on the horizon: a filter averages the bias over some time T0 and uses it for h without a fix. With
r = h / T0, a walk has the same variance at h as flicker and walk of the channel together if

    K_eff^2 = K^2 + (3 / pi) (B^2 / h) [(1 + r) ln(1 + r) - r ln r]

by the autocovariances of `filter_consistency`. The walk of flicker falls with h, so none is right everywhere. T0
follows from the gains, so the walk is searched with the prediction itself: its NEES falls as the walk rises.

Why terms describe flicker: a Gauss-Markov process of variance sigma^2 and correlation time tau has the two-sided
density 2 sigma^2 tau / (1 + (2 pi f tau)^2). Over a geometric series of tau of ratio q with sigma^2 = B^2 ln(q) / pi
the sum is a Riemann sum over ln(tau), and its integral is B^2 / (2 pi f), the density of flicker (Keshner, Proc. IEEE
70, 212, 1982). With one term per decade the NEES stays between 0.99 and 1.02 for the sensors of docs/FILTERS.md.

Gauss-Markov noise of the sensor itself (M, T) is a term as it is. A filter without terms covers it by its walk, as it
covers flicker: the prediction has the exact growth of its variance.

docs/FILTERS.md explains how to use the numbers.

Example
-------
A gyroscope whose K is too small to be seen needs a walk of 34 times that K for ten minutes without a fix:

>>> truths = ChannelTruths(np.array([6.1e-5]), np.array([2.4e-5]), np.array([1e-7]), np.array([1e-3]))
>>> numbers = filter_parameters(truths, 600.0)
>>> f"{numbers.walk[0]:.1e}", [f"{filters.nees.max():.2f}" for filters in (numbers.n_and_k, numbers.white_walk)]
('3.4e-06', ['32.79', '1.25'])
>>> numbers.terms.tau[0].tolist(), f"{numbers.gauss_markov.nees.max():.2f}"
([1.0, 10.0, 100.0, 1000.0, 10000.0], '1.02')
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.model.samples import Bools, Floats
from imumon.noise.filter_consistency import STEP_S, ChannelTruths, Consistency, FilterModels, predict

MOST_NEES = 1.25
"""1, largest NEES of the recommended numbers, and one over the smallest of the filter with Gauss-Markov terms
(contract)."""

LARGEST_WALK = 10.0
"""Share of sqrt(K^2 + B^2/s) where the search for a walk begins, and of the walk that K is at most: none goes below,
where the reference scenario needs none."""

NO_WALK = 1e-6
"""1/s, share of N that stands for B and K in a channel without them, and share of the largest walk where the search
ends."""

HALVINGS = 16
"""Halvings of the search on a logarithmic scale: 0.02 %."""

HORIZON_DIGITS = (1.0, 1.4, 2.0, 3.0, 4.0, 6.0)
"""Horizons of a decade, s: multiples of the step of the filter."""

TERMS = 5
"""Gauss-Markov terms at most that stand for flicker (contract)."""

TERM_RANGES = ((1.0, 1e4), (0.1, 1e4), (1.0, 1e5), (0.1, 1e5), (1.0, 1e6), (0.1, 1e6))
"""s, fastest and slowest correlation time, first choice first: one term per decade, wider only where these five
are not consistent."""

NEGLIGIBLE_TERM = 0.01
"""Share of N^2 below which the spectrum of a term, at most 2 sigma^2 tau, is left out."""


@dataclass(frozen=True, slots=True)
class FilterParameters:
    """Numbers for filters of c channels, and what filters with them achieve at h horizons."""

    horizon_s: Floats  # (h,) s since the last fix
    walk: Floats  # (c,) unit*sqrt(Hz), for a filter without terms: the smallest that is consistent
    # for a filter with N, K and Gauss-Markov terms, that of M last if a channel has it; sigma 0: it is not needed
    terms: FilterModels
    terms_hold: Bools  # (c,) whether those terms are consistent at every horizon; else they are the widest
    n_and_k: Consistency  # of a filter with N and K alone
    white_walk: Consistency  # of a filter with N and `walk`
    gauss_markov: Consistency  # of a filter with `terms`


def filter_parameters(truths: ChannelTruths, horizon_s: float) -> FilterParameters:
    """Return the numbers for filters of channels whose noise is known.

    Parameters
    ----------
    horizon_s : s, 1 or more: longest time without a fix for which the numbers hold.
    """
    times = horizons(horizon_s)
    walk = smallest_walk(truths, times)
    terms, gauss_markov = gauss_markov_terms(truths, times)
    return FilterParameters(
        horizon_s=times,
        walk=walk,
        terms=terms,
        terms_hold=~_is_inconsistent(gauss_markov),
        n_and_k=predict(FilterModels.without_terms(truths.N, truths.K), truths, times),
        white_walk=predict(FilterModels.without_terms(truths.N, walk), truths, times),
        gauss_markov=gauss_markov,
    )


def horizons(horizon_s: float) -> Floats:
    """Return the horizons of the predictions, (h,) s, from 1 s to `horizon_s`."""
    decades = 10.0 ** np.arange(math.floor(math.log10(horizon_s)) + 1)
    below = np.outer(decades, HORIZON_DIGITS).ravel()
    # The last one is rounded down to a step of the filter; 1e-9: 0.6 s / 0.2 s is 2.9999999999999996.
    last = STEP_S * math.floor(horizon_s / STEP_S + 1e-9)
    return np.append(below[below < last * 0.999], last)


def smallest_walk(truths: ChannelTruths, horizon_s: Floats) -> Floats:
    """Return the smallest walk, (c,), with a predicted NEES of at most `MOST_NEES`.

    A walk is never 0 because K is unseen: none is below a tenth of K, or a millionth of where the search begins.
    """
    # Over 1 s, the shortest horizon, flicker is worth a walk of about B/sqrt(s), and Gauss-Markov noise one of
    # M/sqrt(s), if its time constant is shorter sqrt(2/T) M. Ten times that is enough in every channel of the tests, so
    # the search begins with an interval whose upper end is consistent.
    slow = np.hypot(truths.K, truths.B)
    if truths.M is not None and truths.T is not None:
        slow = np.hypot(slow, truths.M * np.maximum(np.sqrt(2.0 / truths.T), 1.0))
    high = LARGEST_WALK * np.maximum(slow, NO_WALK * truths.N)
    low = np.maximum(truths.K / LARGEST_WALK, NO_WALK * high)
    for _ in range(HALVINGS):
        middle = np.sqrt(low * high)
        trial = predict(FilterModels.without_terms(truths.N, middle), truths, horizon_s)
        enough = trial.nees.max(axis=1) <= MOST_NEES
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return high  # the end of the interval that is known to be enough


def gauss_markov_terms(truths: ChannelTruths, horizon_s: Floats) -> tuple[FilterModels, Consistency]:
    """Return filters with N, K and `TERMS` Gauss-Markov terms, with M one more, and their consistency.

    Terms of one decade each are the most accurate, so wider ranges replace them only in channels where they fail.
    Where the widest fails too, it is returned: of a gyroscope, where B is above 0.7 rad/s and the horizon a day.
    """
    tau = np.empty((len(truths.N), TERMS))
    sigma, missing = np.empty_like(tau), np.arange(len(truths.N))
    for fastest, slowest in TERM_RANGES:
        tau[missing] = np.geomspace(fastest, slowest, TERMS)
        ratio = (slowest / fastest) ** (1.0 / (TERMS - 1))
        sigma[missing] = truths.B[missing, None] * math.sqrt(math.log(ratio) / math.pi)
        # A term below the white noise is a state that costs time and shows nothing.
        slight = 2.0 * sigma**2 * tau < NEGLIGIBLE_TERM * truths.N[:, None] ** 2
        models = FilterModels(truths.N, truths.K, np.where(slight, 0.0, sigma), tau)
        if truths.M is not None and truths.T is not None:
            with_markov = (np.column_stack(pair) for pair in ((models.sigma, truths.M), (tau, truths.T)))
            models = FilterModels(truths.N, truths.K, *with_markov)
        consistency = predict(models, truths, horizon_s)
        missing = np.flatnonzero(_is_inconsistent(consistency))
        if not len(missing):
            break
    return models, consistency


def _is_inconsistent(consistency: Consistency) -> Bools:
    """Return (c,) whether the NEES is beyond `MOST_NEES`, or below one over it, at any horizon."""
    nees = consistency.nees
    return np.asarray((nees > MOST_NEES).any(axis=1) | (nees < 1.0 / MOST_NEES).any(axis=1))
