"""The curve of a fit: what it states beside the measured Allan deviations, and what they say of it.

The drawn model is the Allan deviation of everything that is stated: noise, lines and filters as a density beside it,
and what regressors and oscillations move (`model_curve`). Each part has its share, and the shares add up. The curve is
a judge, too: where the model leaves its limits, the terms that decide it there become bounds.

Example: the classical readings of a curve, for comparison with papers and other tools.

>>> tau = 2.0 ** np.arange(-5, 16)
>>> readings = read_slopes(tau, np.sqrt(0.01**2 / tau + (0.664 * 3e-3) ** 2 + 1e-4**2 * tau / 3))
>>> print(f"{readings['N']:.4f} {readings['B']:.4f} {readings['K']:.2e}")
0.0100 0.0034 1.04e-04
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from imumon.model.coefficients import COEFFICIENTS, NOISE, Estimate, MarkovEstimate
from imumon.model.samples import Bools, Floats, Ints
from imumon.noise.allan import AllanCurve
from imumon.noise.fit.hump import line_bands
from imumon.noise.fit.model import NoiseTerm, UpperShape, total
from imumon.noise.fit.model_curve import (
    VISIBLE,
    degrees_of_freedom,
    density_variances,
    limit_factors,
    line_variances,
    moved_variances_at,
    possible_differences,
)
from imumon.noise.fit.observations import observed_density
from imumon.noise.fit.statement import ChannelFit, FittedModel
from imumon.noise.noise_sums import NoiseSums
from imumon.noise.spectrum.expectation import window_power
from imumon.noise.spectrum.level_sums import SEGMENT

MOST_OUTSIDE = 3
"""The drawn model misses the curve where it is outside of its limits at this number of octaves, or at the longest
two; B, K and M that decide it there become bounds. Unit: octaves.

Otherwise: a coefficient is stated of a noise of another kind, whose curve is beside the model. Origin: of noise that
the model has, 9 of 400 channels miss by chance (`markov.py`).
"""
COLUMN_SLACK = 0.05
"""The drawn model may be outside of the limits of the curve by as much. Unit: of the Allan deviation of the
regressors.

Otherwise: a strong temperature, known to a per cent, misses limits that are narrower, and N, B and K become bounds.
Chosen: a regressor describes what moves the mean to some per cent (`temperature.py`).
"""
SLOPE_TOLERANCE = 0.2
"""A classical reading is taken where the slope of the curve is this near to the nominal one. Unit: slope.

Otherwise: a flat curve has a reading of N. Origin: halfway to the next nominal slope is 0.25.
"""

CURVE_DIFFERS = "the model leaves the limits of the measured curve"


def with_curve(
    fitted: FittedModel, curve: AllanCurve, sums: NoiseSums, channel: int, averaged: bool
) -> ChannelFit:
    """Return a fit with the Allan deviations that it states, the limits of the measured ones, and their caveats.

    Parameters
    ----------
    curve, sums : of the record.
    averaged : the samples are true averages over their interval, else point samples.
    """
    fit, m, lines = fitted.fit, curve.m, line_bands(sums, channel)
    noise_powers = fitted.surface.sensor_powers
    line_shares = np.array([line_variances(m, *line) for line in lines.tolist()]).reshape(-1, m.size)
    terms = {
        term: power * term.allan_variances(m, averaged=averaged)
        for term, power in fitted.surface.powers.items()
    }
    noise = np.sum([terms[term] for term in noise_powers if term.is_stated], axis=0)
    bent, of_lines = _departure(m, sums, channel, fitted, averaged, line_shares.sum(axis=0))
    of_lines = of_lines + sum(share for term, share in terms.items() if not term.is_stated)
    hump = fitted.hump
    if hump is not None:
        lines = np.append(lines, [[hump.frequency, hump.width, hump.power]], axis=0)
        line_shares = np.append(line_shares, [density_variances(m, hump.f, hump.size, hump.density)], axis=0)
        of_lines = of_lines + line_shares[-1]
    # a filter takes from the noise, but an Allan variance is never zero
    random = np.maximum(noise + bent + of_lines, 1e-3 * noise)
    present = curve.terms[:, channel] > 0
    fixed = moved_variances_at(m, fitted.moved)
    shares = {term.letter: share for term, share in terms.items() if term.is_stated}
    shares |= {"lines": of_lines, "columns": fixed}
    # a filter takes away from the noise: its share is what is left, and may be negative
    shares["filter"] = random + fixed - np.sum(list(shares.values()), axis=0)
    edf = degrees_of_freedom(m, curve.terms[:, channel], curve.span, noise_powers)
    # a product of noise and what is not random adds twice its share; a line is noise of its own width, with
    # 4 sqrt(pi) degrees of freedom over width and time in a band with a Gaussian shape
    share = np.where(edf > 0.0, (random**2 + 2.0 * random * fixed) / np.maximum(edf, 1e-9), 1.0)
    line_dof = 4.0 * math.sqrt(math.pi) * lines[:, 1:2] * curve.span + 1.0
    share = share + (line_shares**2 / line_dof).sum(axis=0)
    edf = np.where(present, (random + fixed) ** 2 / share, 0.0)
    low, high = limit_factors(np.maximum(edf, 1.0))
    sigma = curve.sigma[:, channel]
    positive = present & (sigma > 0.0)
    caveats = [
        *fit.caveats,
        *_visible(fit, curve.tau, line_shares.sum(axis=0), VISIBLE * (random + fixed)),
    ]
    used = present & (m >= 1 << fitted.choice.upper_end.octaves_left_out)
    low, high = (np.where(present, sigma * factor, 0.0) for factor in (low, high))
    drawn = np.sqrt(random + fixed)
    # the limits are those of noise: where a regressor moves the mean much more, they are narrower than it is known
    slack = COLUMN_SLACK * np.sqrt(fixed)
    # the model is fitted to all samples: of those that the differences miss, it has an error of its own
    known = np.minimum(curve.terms[:, channel] / possible_differences(m, curve.span), 1.0)
    least, most = (sigma * factor for factor in limit_factors(np.maximum(known * edf, 1.0)))
    outside = np.flatnonzero(used & ((drawn < least - slack) | (drawn > most + slack)))
    if _misses(outside, np.flatnonzero(used)):
        caveats.append("model_misses")
        fit = bounded_by_curve(fit, terms, outside, high)
        if fit.jumps is None and "popcorn" in caveats:
            caveats.remove("popcorn")
    return replace(
        fit,
        model=drawn,
        shares=shares,
        noise=np.sqrt(noise),
        used=used,
        low=low,
        high=high,
        edf=edf,
        readings=read_slopes(curve.tau[positive], sigma[positive]),
        caveats=tuple(caveats),
    )


def _visible(fit: ChannelFit, tau: Floats, lines: Floats, visible: Floats) -> Iterator[str]:
    """Yield the caveats of what bends the curve by more than is visible in it.

    Parameters
    ----------
    lines : (k,) Allan variance of the lines that have a name.
    visible : (k,) Allan variance from which on something shows.
    """
    if fit.hump_hz is not None or (lines > visible).any():
        yield "vibration"
    drift = fit.regressor("drift")
    if "R" in fit.coefficients and drift and (0.5 * (drift.value * tau) ** 2 > visible).any():
        yield "ramp"


def _misses(outside: Ints, used: Ints) -> bool:
    """Return whether a model is outside of the limits of the curve at too many octaves, or at the end of the record.

    The end is the two longest octaves in use: there the curve alone shows what B, K and M decide, and the 95 % limits
    of one octave miss by chance in one channel of twenty.
    """
    return outside.size >= MOST_OUTSIDE or (outside.size >= 2 and bool((outside[-2:] == used[-2:]).all()))


def bounded_by_curve(
    fit: ChannelFit, terms: Mapping[NoiseTerm, Floats], outside: Ints, high: Floats
) -> ChannelFit:
    """Return a fit with bounds of the correlated terms that decide the drawn model where it leaves the curve.

    Where white noise or rounding is the largest part, no correlated term decides: its bound would be that of N.

    Parameters
    ----------
    terms : (k,) Allan variance of each term.
    outside : octaves at which the model is outside.
    high : (k,) upper limits of the curve.
    """
    deciding: dict[NoiseTerm, list[int]] = defaultdict(list)
    for octave in outside.tolist():
        term = max(terms, key=lambda each: float(terms[each][octave]))
        if term.is_correlated:
            deciding[term].append(octave)

    def bound(estimate: Estimate, term: NoiseTerm) -> Estimate:
        share, octaves = terms[term], deciding[term]
        if estimate.high is None or not share[octaves].any():
            return estimate
        # the size with which the term alone would reach the upper limit of the curve, if that is more
        value = estimate.value or estimate.high
        reach = value * float(np.max(high[octaves] / np.sqrt(share[octaves])))
        high_limit = max(estimate.high, reach) if math.isfinite(reach) else estimate.high
        return Estimate(low=0.0, high=high_limit, status="upper_bound", reason=CURVE_DIFFERS)

    coefficients = dict(fit.coefficients)
    for term in deciding:
        if term.letter in coefficients:
            coefficients[term.letter] = bound(coefficients[term.letter], term)
    markov = next((term for term in deciding if term.time_letter), None)
    if fit.markov is not None and markov is not None:
        time = replace(fit.markov.time_constant_s, value=None, status="indistinct", reason=CURVE_DIFFERS)
        stated = MarkovEstimate(sigma=bound(fit.markov.sigma, markov), time_constant_s=time)
        return replace(fit, coefficients=coefficients, markov=stated, jumps=None)
    return replace(fit, coefficients=coefficients)


def _departure(
    m: Ints, sums: NoiseSums, channel: int, fitted: FittedModel, averaged: bool, line_share: Floats
) -> tuple[Floats, Floats]:
    """Return (k,) what the spectrum has beyond the noise: its shape, and its lines.

    Its shape where the fit uses it, what was observed above the highest frequency in use, and everywhere where the fit
    counts an error of the model. The lines are as observed at the shortest octaves. At longer ones the bins are too
    wide for the oscillation of their contribution with tau, and each line has its frequency and width.
    """
    surface, upper_end, highest = fitted.surface, fitted.choice.upper_end, fitted.highest
    # the top of the highest band is half the sampling rate up to rounding
    flat = highest > 0.499 and upper_end.shape is UpperShape.FLAT and upper_end.window == 1
    if flat and not fitted.error and not line_share.any():
        return np.zeros(m.size), np.zeros(m.size)
    f, width, density, lines = observed_density(sums, channel)
    above = f > fitted.meeting
    if fitted.hump is not None:
        above &= ~fitted.hump.band.holds(f)  # what a hump holds is a line
    f, width, density, lines = f[above], width[above], density[above], lines[above]
    powers = surface.powers
    noise = total(surface.sensor_powers, lambda term: term.density(f, averaged=averaged))
    bend = float(surface.corner[surface.best]) * 4.0 * np.sin(np.pi * f) ** 2
    stated = noise * window_power(f, upper_end.window) / (1.0 + bend)
    added = {term: power for term, power in powers.items() if not term.is_of_sensor}
    stated = stated + total(added, lambda term: term.density(f, averaged=averaged))
    if fitted.error or not lines.all():
        # what lies under a line is taken from the bins beside it
        quiet = np.interp(f, *_beside_lines(f, density, lines)) if lines.any() else density
        stated = np.where((f > highest) | bool(fitted.error), quiet, stated)
    long = density_variances(m, f, width, stated - noise)
    if not lines.any():
        return long, np.zeros(m.size)
    short = density_variances(m, f, width, np.where(lines, density - stated, 0.0))
    # a contribution hardly changes within a quarter of its period, which a bin is at most
    return long, np.where(4 * m <= SEGMENT, short, line_share)


def _beside_lines(f: Floats, density: Floats, lines: Bools) -> Floats:
    """Return (2, n) frequencies and densities of the bins without a line, lowest first."""
    quiet = np.stack((f, density))[:, ~lines]
    return np.asarray(quiet[:, np.argsort(quiet[0])])


def read_slopes(tau: Floats, sigma: Floats) -> dict[str, float | None]:
    """Return N, B and K read off a curve in the classical way, for comparison with papers and other tools.

    N is the line of slope -1/2 read at 1 s, K the line of slope +1/2 read at 3 s, B the flat part divided by
    sqrt(2 ln 2 / pi) = 0.664 (IEEE Std 952 annex C; the same as in MATLAB's example). Each line goes through
    the octave whose slope to the next is nearest to the nominal one; None where no slope is within
    `SLOPE_TOLERANCE` of it.

    Parameters
    ----------
    tau : (k,) s
    sigma : (k,) channel unit, all positive.
    """
    readings: dict[str, float | None] = dict.fromkeys(NOISE)
    slope = np.diff(np.log(sigma)) / np.diff(np.log(tau))
    for letter in NOISE if slope.size > 1 else ():
        row = COEFFICIENTS[letter]
        nearest = int(np.argmin(np.abs(slope - row.slope)))
        if abs(slope[nearest] - row.slope) <= SLOPE_TOLERANCE:
            readings[letter] = float(sigma[nearest]) / row.deviation(float(tau[nearest]))
    return readings
