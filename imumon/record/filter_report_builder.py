"""Filter report: the noise of the channels of a report as parameters for Kalman filters.

`noise.filter_parameters` computes with numbers; this module reads them from a `Report` and writes a `FilterReport`. It
decides what counts as the noise of a channel:

- a measured coefficient: its value.
- a bounded one: half its bound, where it is about as likely above as below. A caveat, such as ``bounded_K``, names it.
  B, K and M that the record does not separate count so, too: each alone explains what shows, and half of each adds up
  to about as much. The time constant is then the geometric mean of its limits.
- a pending one, or one that no sensor has: the channel has no parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from imumon.model.coefficients import COEFFICIENTS, Estimate, MarkovEstimate
from imumon.model.filter_report import (
    AssumedNoise,
    FilterChannel,
    FilterCurves,
    FilterReport,
    GaussMarkovTerm,
    MarkovTerm,
)
from imumon.model.report import Channel, Report
from imumon.model.samples import ChannelName, Floats
from imumon.noise.filter_consistency import FIX_STD, ChannelTruths
from imumon.noise.filter_parameters import FilterParameters, filter_parameters

LEAST_N, MOST_SIZE = 1e-15, 1e6
"""unit/sqrt(Hz) and SI, N below and N, B or K above which a report describes no sensor: the prediction would divide by
zero or overflow, and a report may come from any program."""

LEAST_TIME_S, MOST_TIME_S = 1e-3, 1e7
"""s, of the time constant of correlated noise; beyond, it is white noise, or a walk of years."""

CURVE_DIGITS, TIME_DIGITS = 5, 6
"""Significant digits of the curves and of times: rounding errors of the processor are not published."""


def filter_report(report: Report, horizon_s: float) -> FilterReport:
    """Return the parameters for filters of every gyroscope and accelerometer channel.

    A channel without a value or bound of N, B or K has no entry.

    Parameters
    ----------
    horizon_s : s, 1 or more: longest time without a fix for which the numbers hold.
    """
    assumed = {
        name: noise
        for name, channel in report.channels.items()
        # a magnetometer is not integrated: it has no fix in the reference scenario
        if name.sensor in FIX_STD and (noise := assumed_noise(channel)) is not None
    }
    return FilterReport(
        time=report.time,
        device=report.device,
        horizon_s=horizon_s,
        elapsed_s=report.session.elapsed_s,
        channels=_channels(report, assumed, horizon_s) if assumed else {},
    )


def assumed_noise(channel: Channel) -> AssumedNoise | None:
    """Return the noise that the numbers of a channel are for; None if it is unknown."""
    known = channel.coefficients
    n, b, k = (known[letter].size if letter in known else None for letter in "NBK")
    if n is None or b is None or k is None or n < LEAST_N or max(n, b, k) > MOST_SIZE:
        return None
    m, time_s = _assumed_markov(channel.M)
    return AssumedNoise(N=n, B=b, K=k, M=m, T=time_s)


def _assumed_markov(markov: MarkovEstimate | None) -> tuple[float, float] | tuple[None, None]:
    """Return standard deviation and time constant, s, of the correlated noise of a channel; None where it has none."""
    if markov is None:
        return None, None
    time, size = markov.time_constant_s, markov.sigma.size
    time_s = time.value
    if time_s is None and time.low and time.high:
        time_s = math.sqrt(time.low * time.high)
    if not size or size > MOST_SIZE or time_s is None or not LEAST_TIME_S <= time_s <= MOST_TIME_S:
        return None, None
    return size, time_s


def _channels(
    report: Report, assumed: Mapping[ChannelName, AssumedNoise], horizon_s: float
) -> dict[ChannelName, FilterChannel]:
    """Return the parameters of the channels whose noise is known, computed together."""
    fix = np.array([FIX_STD[name.sensor] for name in assumed])
    n, b, k = np.array([(noise.N, noise.B, noise.K) for noise in assumed.values()]).T
    m = time = None
    if any(noise.M is not None for noise in assumed.values()):
        m, time = np.array([(noise.M or 0.0, noise.T or 1.0) for noise in assumed.values()]).T
    parameters = filter_parameters(ChannelTruths(n, b, k, fix, m, time), horizon_s)
    return {
        name: _channel(report.channels[name], noise, parameters, row)
        for row, (name, noise) in enumerate(assumed.items())
    }


def _channel(channel: Channel, noise: AssumedNoise, parameters: FilterParameters, row: int) -> FilterChannel:
    """Return the parameters of one channel, `row` of `parameters`."""
    walk, terms = float(parameters.walk[row]), parameters.terms
    return FilterChannel(
        unit=channel.unit,
        assumed=noise,
        white=noise.N,
        walk=walk,
        walk_factor=_factor(channel.coefficients["K"], walk),
        white_gm=noise.N,
        walk_gm=noise.K,
        gauss_markov=tuple(
            GaussMarkovTerm(sigma=float(sigma), tau_s=float(f"{tau:.{TIME_DIGITS}g}"))
            for tau, sigma in sorted(zip(terms.tau[row], terms.sigma[row], strict=True))
            if sigma > 0.0
        ),
        markov=_markov_term(noise),
        nees=_curves(
            parameters.horizon_s,
            parameters.white_walk.nees[row],
            parameters.gauss_markov.nees[row],
            parameters.n_and_k.nees[row],
        ),
        std=_curves(
            parameters.horizon_s,
            parameters.white_walk.std[row],
            parameters.gauss_markov.std[row],
            parameters.n_and_k.std[row],
        ),
        caveats=(
            *channel.caveats,
            *(
                f"bounded_{c}"
                for c, part in channel.estimates.items()
                if part.is_bound and COEFFICIENTS[c].level
            ),
            *(() if parameters.terms_hold[row] else ("inconsistent_terms",)),
        ),
    )


def _markov_term(noise: AssumedNoise) -> MarkovTerm | None:
    """Return the correlated noise as a state of a filter."""
    if noise.M is None or noise.T is None:
        return None
    return MarkovTerm(sigma=noise.M, time_constant_s=noise.T, drive=noise.M * math.sqrt(2.0 / noise.T))


def _curves(horizon_s: Floats, white_walk: Floats, gauss_markov: Floats, n_and_k: Floats) -> FilterCurves:
    """Return one number of each filter at each horizon, (h,)."""
    return FilterCurves(
        horizon_s=tuple(float(f"{t:.{TIME_DIGITS}g}") for t in horizon_s),
        white_walk=_rounded(white_walk),
        gauss_markov=_rounded(gauss_markov),
        n_and_k=_rounded(n_and_k),
    )


def _rounded(values: Floats) -> tuple[float, ...]:
    return tuple(float(f"{v:.{CURVE_DIGITS}g}") for v in values)


def _factor(k: Estimate, walk: float) -> float | None:
    """Return the walk over the measured K; None where K is only bounded: half a bound is no value to compare with."""
    return walk / k.value if k.status == "measured" and k.value else None
