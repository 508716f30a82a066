"""Parameters that keep a Kalman filter consistent: white noise, random walk, Gauss-Markov terms.

N and K of a record are the right numbers for a channel without flicker. Flicker makes a filter with them
overconfident: it believes that it knows the bias better than it does. There are two cures:

- One number more: a random walk larger than K. `walk` is the smallest with a predicted NEES of at most
  `MOST_NEES` from 1 s to the horizon. It is no property of the sensor: it depends on the horizon.
- States more: first-order Gauss-Markov processes, one per decade, of variance B^2 ln(10)/pi each. Their sum has
  the spectrum of flicker, B^2/(2 pi f), over these decades.

A walk is never 0 because K is unseen: an unseen K counts with half its bound, and no walk is below a tenth of
it. docs/FILTERS.md explains how to use the numbers, docs/THEORY.md derives them.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.filter_report import (
    AssumedNoise,
    FilterChannel,
    FilterCurves,
    FilterReport,
    GaussMarkovTerm,
)
from imumon.noise.filter_consistency import FIX_STD, STEP_S, ChannelTruths, Consistency, FilterModels, predict
from imumon.report import Channel, Estimate, Report
from imumon.samples import Floats

MOST_NEES = 1.25
"""1, largest NEES of the recommended numbers, and one over the smallest of the filter with Gauss-Markov terms
(contract)."""

LEAST_N, MOST_SIZE = 1e-15, 1e6
"""unit/sqrt(Hz) and SI, N below and N, B or K above which a report describes no sensor."""

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
"""Gauss-Markov terms at most (contract)."""

TERM_RANGES = ((1.0, 1e4), (0.1, 1e4), (1.0, 1e5), (0.1, 1e5), (1.0, 1e6), (0.1, 1e6))
"""s, fastest and slowest correlation time, first choice first: one term per decade, wider only where these five
are not consistent."""

NEGLIGIBLE_TERM = 0.01
"""Share of N^2 below which the spectrum of a term, at most 2 sigma^2 tau, is left out."""


def filter_parameters(report: Report, horizon_s: float) -> FilterReport:
    """Return the parameters for filters of every gyroscope and accelerometer channel.

    A channel without a value or bound of N, B or K has no entry.
    """
    assumed = {
        name: noise
        for name, channel in report.channels.items()
        if name.partition("/")[0] in FIX_STD and (noise := assumed_noise(channel)) is not None
    }
    return FilterReport(
        time=report.time,
        device=report.device,
        horizon_s=horizon_s,
        elapsed_s=report.session.elapsed_s,
        channels=_channels(report, assumed, horizon_s) if assumed else {},
    )


def assumed_noise(channel: Channel) -> AssumedNoise | None:
    """Return the truth that the numbers of a channel are made for; None if it is unknown.

    A coefficient that is only bounded counts with half its bound, where it is about as likely above as below.
    """
    known = channel.coefficients
    n, b, k = (known[letter].size if letter in known else None for letter in "NBK")
    if n is None or b is None or k is None or n < LEAST_N or max(n, b, k) > MOST_SIZE:
        return None
    return AssumedNoise(N=n, B=b, K=k)


def horizons(horizon_s: float) -> Floats:
    """Return the horizons of the predictions, (h,) s, from 1 s to `horizon_s`."""
    decades = 10.0 ** np.arange(math.floor(math.log10(horizon_s)) + 1)
    below = np.outer(decades, HORIZON_DIGITS).ravel()
    last = STEP_S * math.floor(horizon_s / STEP_S + 1e-9)
    return np.append(below[below < last * 0.999], last)


def smallest_walk(truths: ChannelTruths, horizon_s: Floats) -> Floats:
    """Return the smallest walk, (c,), with a predicted NEES of at most `MOST_NEES`: it falls as the walk rises."""
    high = LARGEST_WALK * np.maximum(np.hypot(truths.K, truths.B), NO_WALK * truths.N)
    low = np.maximum(truths.K / LARGEST_WALK, NO_WALK * high)
    for _ in range(HALVINGS):
        middle = np.sqrt(low * high)
        found = predict(FilterModels.without_terms(truths.N, middle), truths, horizon_s)
        enough = found.nees.max(axis=1) <= MOST_NEES
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return high


def gauss_markov(truths: ChannelTruths, horizon_s: Floats) -> tuple[FilterModels, Consistency]:
    """Return filters with N, K and `TERMS` Gauss-Markov terms, and their consistency.

    A term of correlation time tau in a series of ratio q has the variance B^2 ln(q)/pi: the sum over the series
    of 2 sigma^2 tau / (1 + (2 pi f tau)^2) is then B^2 / (2 pi f).
    """
    tau = np.empty((len(truths.N), TERMS))
    sigma, missing = np.empty_like(tau), np.arange(len(truths.N))
    for fastest, slowest in TERM_RANGES:
        tau[missing] = np.geomspace(fastest, slowest, TERMS)
        ratio = (slowest / fastest) ** (1.0 / (TERMS - 1))
        sigma[missing] = truths.B[missing, None] * math.sqrt(math.log(ratio) / math.pi)
        slight = 2.0 * sigma**2 * tau < NEGLIGIBLE_TERM * truths.N[:, None] ** 2
        models = FilterModels(truths.N, truths.K, np.where(slight, 0.0, sigma), tau)
        found = predict(models, truths, horizon_s)
        missing = np.flatnonzero(
            (found.nees > MOST_NEES).any(axis=1) | (found.nees < 1.0 / MOST_NEES).any(axis=1)
        )
        if not len(missing):
            break
    return models, found


def _channels(report: Report, assumed: dict[str, AssumedNoise], horizon_s: float) -> dict[str, FilterChannel]:
    """Return the parameters of the channels whose truth is known."""
    fix = np.array([FIX_STD[name.partition("/")[0]] for name in assumed])
    n, b, k = np.array([(noise.N, noise.B, noise.K) for noise in assumed.values()]).T
    truths, at = ChannelTruths(n, b, k, fix), horizons(horizon_s)
    walk = smallest_walk(truths, at)
    plain = predict(FilterModels.without_terms(truths.N, truths.K), truths, at)
    walking = predict(FilterModels.without_terms(truths.N, walk), truths, at)
    models, with_terms = gauss_markov(truths, at)

    def curves(c: int, what: str) -> FilterCurves:
        white_walk, terms, alone = (
            tuple(float(f"{v:.5g}") for v in getattr(found, what)[c])
            for found in (walking, with_terms, plain)
        )
        times = tuple(float(f"{t:.6g}") for t in at)
        return FilterCurves(horizon_s=times, white_walk=white_walk, gauss_markov=terms, n_and_k=alone)

    return {
        name: FilterChannel(
            unit=report.channels[name].unit,
            assumed=noise,
            white=noise.N,
            walk=float(walk[c]),
            walk_factor=_factor(report.channels[name].coefficients["K"], float(walk[c])),
            white_gm=noise.N,
            walk_gm=noise.K,
            gauss_markov=tuple(
                GaussMarkovTerm(sigma=float(sigma), tau_s=float(f"{tau:.6g}"))
                for sigma, tau in zip(models.sigma[c], models.tau[c], strict=True)
                if sigma > 0.0
            ),
            nees=curves(c, "nees"),
            std=curves(c, "std"),
            caveats=(*report.channels[name].caveats, *_bounded(report.channels[name])),
        )
        for c, (name, noise) in enumerate(assumed.items())
    }


def _factor(k: Estimate, walk: float) -> float | None:
    return walk / k.value if k.status == "measured" and k.value else None


def _bounded(channel: Channel) -> list[str]:
    """Return a caveat for each coefficient of which only a bound is known."""
    return [f"bounded_{c}" for c, each in channel.coefficients.items() if each.status == "upper_bound"]
