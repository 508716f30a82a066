"""The Allan curve that a description states: noise, what the spectrum has beside it, and what the regressors move."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from imumon.noise.allan import AllanCurve
from imumon.noise.fit.description import Description
from imumon.noise.fit.expected_curve import (
    degrees_of_freedom,
    density_variances,
    limit_factors,
    line_variances,
    moved_variances_at,
    noise_variances,
)
from imumon.noise.fit.observations import meeting_frequency, observed_density
from imumon.noise.fit.results import ChannelFit, read_slopes
from imumon.noise.fit.slow_terms import CERTAIN
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.power_law import sampled_density
from imumon.noise.spectrum.expectation import window_power
from imumon.noise.spectrum.spectral_lines import SEGMENT
from imumon.samples import Floats, Ints

BENDS = 0.1
"""Share of the Allan variance at some tau from which lines or a drift bend the curve visibly."""

ALIAS_WIDTHS, ALIAS_SHARE = 3.0, 0.1
"""Widths of a line within which its alias lies, and the least share of an oscillation that remains of the line."""


@dataclass(frozen=True, slots=True, eq=False)
class Stated:
    """What one description of a channel states, whatever the curve.

    Attributes
    ----------
    found : the description.
    fit : without a curve.
    moved : (2, j) the Allan variance of what the regressors move; see `moved_variances`.
    """

    found: Description
    fit: ChannelFit
    moved: Floats


def with_curve(
    stated: Stated, curve: AllanCurve, sums: NoiseSums, channel: int, averaged: bool
) -> ChannelFit:
    """Return a fit with the Allan deviations that it states, the limits of the measured ones, and their caveats.

    Parameters
    ----------
    curve, sums : of the record.
    averaged : the samples are true averages over their interval, else point samples.
    """
    found, fit, m, lines = stated.found, stated.fit, curve.m, line_bands(sums, channel)
    powers = found.surface.powers
    line_shares = np.array([line_variances(m, *line) for line in lines.tolist()]).reshape(-1, m.size)
    noise = powers @ noise_variances(m, averaged=averaged)
    departure = _departure(m, sums, channel, found, averaged, line_shares.sum(axis=0))
    random = np.maximum(noise + departure, 1e-3 * noise)
    present = curve.terms[:, channel] > 0
    fixed = moved_variances_at(m, stated.moved)
    edf = degrees_of_freedom(m, curve.terms[:, channel], curve.span, powers)
    # a product of noise and what is not random adds twice its share; a line is noise of its own width, with
    # 4 sqrt(pi) degrees of freedom over width and time in a band with a Gaussian shape
    share = np.where(edf > 0.0, (random**2 + 2.0 * random * fixed) / np.maximum(edf, 1e-9), 1.0)
    share = share + (line_shares**2 / (4.0 * math.sqrt(math.pi) * lines[:, 1:2] * curve.span + 1.0)).sum(
        axis=0
    )
    edf = np.where(present, (random + fixed) ** 2 / share, 0.0)
    low, high = limit_factors(np.maximum(edf, 1.0))
    sigma = curve.sigma[:, channel]
    positive = present & (sigma > 0.0)
    visible, drift = BENDS * (random + fixed), fit.column("drift")
    caveats = list(fit.caveats)
    if (line_shares.sum(axis=0) > visible).any():
        caveats.append("vibration")
    if "R" in fit.coefficients and drift and (0.5 * (drift.value * curve.tau) ** 2 > visible).any():
        caveats.append("ramp")
    return replace(
        fit,
        model=np.sqrt(random + fixed),
        noise=np.sqrt(noise),
        used=present & (m >= 1 << found.first),
        low=np.where(present, sigma * low, 0.0),
        high=np.where(present, sigma * high, 0.0),
        edf=edf,
        readings=read_slopes(curve.tau[positive], sigma[positive]),
        caveats=tuple(caveats),
    )


def _departure(
    m: Ints, sums: NoiseSums, channel: int, found: Description, averaged: bool, line_share: Floats
) -> Floats:
    """Return (k,) what the spectrum has beyond N, B and K.

    Its shape where the fit uses it, what was observed above the highest frequency in use, and everywhere where the fit
    counts an error of the model. The lines are as observed at the shortest octaves. At longer ones the bins are too
    wide for the oscillation of their contribution with tau, and each line has its frequency and width.
    """
    likelihood, surface = found.likelihood, found.surface
    whole = likelihood.powers.top.max() > 0.499 and not likelihood.shape and found.window == 1
    if whole and not found.error and not line_share.any():
        return np.zeros(m.size)
    f, width, density, lines = observed_density(sums, channel)
    above = f > meeting_frequency(found.slow.series)
    f, width, density, lines = f[above], width[above], density[above], lines[above]
    noise = surface.powers @ sampled_density(f, averaged=averaged)
    c = float(surface.c[surface.best]) * 4.0 * np.sin(np.pi * f) ** 2
    stated = noise * window_power(f, found.window)
    stated = stated / (1.0 + c) if likelihood.shape == "filtered" else stated
    stated = stated + c if likelihood.shape == "quantised" else stated
    if found.error or not lines.all():
        quiet = (
            np.interp(f, *np.stack((f, density))[:, ~lines][:, np.argsort(f[~lines])])
            if lines.any()
            else density
        )
        stated = np.where((f > float(likelihood.powers.top.max())) | bool(found.error), quiet, stated)
    long = density_variances(m, f, width, stated - noise)
    if not lines.any():
        return long
    long = long + line_share
    short = density_variances(m, f, width, np.where(lines, density, stated) - noise)
    # a contribution hardly changes within a quarter of its period, which a bin is at most
    return np.where(4 * m <= SEGMENT, short, long)


def line_bands(sums: NoiseSums, channel: int) -> Floats:
    """Return (l, 3) frequency and width, cycles per sample, and power of the lines of a channel, strongest first."""
    bands = () if sums.spectrum is None else sums.spectrum.bands[channel]
    scaled = [(band.frequency_hz * sums.tau0, band.width_hz * sums.tau0, band.power) for band in bands]
    return np.array(scaled).reshape(-1, 3)


def oscillations(found: Description, lines: Floats) -> list[Ints]:
    """Return the coefficients of each oscillation that is beyond chance and no alias of a line.

    A block averages over most of a line, and what remains of a strong one shows at the wrong frequency.

    Parameters
    ----------
    lines : (l, 3) frequency and width, cycles per sample, and power of each line of the spectrum.
    """
    series, out = found.slow.series, []
    f, width, power = lines.T
    noise = found.surface.powers @ series.variance
    aliases = np.abs(f - np.round(f * series.length) / series.length)
    remains = power / (np.pi * f * series.length) ** 2
    for begin, count in zip(series.begin - np.arange(series.begin.size), series.count - 1, strict=True):
        own = np.flatnonzero(found.slow.masked[begin : begin + count])
        step = 0.5 / ((count + 1) * series.length)
        for group in np.split(own, np.flatnonzero(np.diff(own) > 1) + 1):
            at = begin + group
            if float((found.excess[at] / noise[at]).sum()) > CERTAIN:
                low, high = series.f[at[[0, -1]]] + np.array([-step, step])
                near = (low - ALIAS_WIDTHS * width <= aliases) & (aliases <= high + ALIAS_WIDTHS * width)
                own_power = float(found.excess[at].sum()) / (count + 1)
                if not (near & (remains > ALIAS_SHARE * own_power)).any():
                    out.append(at)
    return out


def moved(found: Description, lines: Floats) -> Floats:
    """Return (n,) channel unit, what the regressors move at each block, and the oscillations as they are."""
    import scipy.fft

    series, beta = found.slow.series, found.surface.beta[found.surface.best]
    out = np.zeros(series.series.size)
    for each, value in zip(found.slow.regressors, beta.tolist(), strict=True):
        out = out + value * each.scale * each.series
    left_out = np.zeros(series.y.size)
    for group in oscillations(found, lines):
        left_out[group] = np.sqrt(found.excess[group])
    if left_out.any():
        left_out = np.copysign(left_out, series.y - series.transform(out))
        for number, (begin, count) in enumerate(zip(series.begin, series.count, strict=True)):
            own = np.concatenate(([0.0], left_out[begin - number : begin - number + count - 1]))
            out[begin : begin + count] += scipy.fft.idct(own, norm="ortho")
    return out
