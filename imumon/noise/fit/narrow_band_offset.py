"""Contribution of narrow bands of the spectrum, and of outliers, to the Allan variances of a record.

Samples whose one-sided density is S(f) have, exactly and also above the Nyquist frequency of the process,

    sigma^2(m tau0) = 2 int S(f) sin^4(pi f m tau0) / (m^2 sin^2(pi f tau0)) df    (IEEE Std 1139, annex B)

over 0 to 1/(2 tau0); a sinusoid of amplitude a therefore contributes a^2 sin^4(pi f tau)/(pi f tau)^2 at long
tau. What the spectrum shows as a band is subtracted, and its uncertainty is added to the covariance: that of
the power raises or lowers all octaves together, that of the frequency each by itself.

Spectrum and octaves see the same line in the same samples, so its power need not be that of a stationary
process: a line that is steady, or wanders within its width many times, is subtracted to a few per mille. A line
that comes and goes, or whose shape is not that of its band, is not. The fit takes the errors of the first kind,
and those of the second where chi-square rejects them (`model_selection`).

Beside a strong line even these errors exceed the statistics of the shortest octaves. Their noise then comes from
the spectrum itself: the same integral over the density without the bands has no error of the line, only that of
the segments which the spectrum leaves out (`quiet_octaves`). Each octave takes the way with the smaller error.

Outliers leave the expectation alone. Noise of independent samples with excess kurtosis g has Allan variances
whose relative covariances all gain g/n (the fourth cumulant of the sum of squares), as if N^2 itself varied.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from imumon.noise.statistics.narrow_bands import LEVEL_ERROR, NarrowBand, QuietDensity
from imumon.noise.statistics.spectral_lines import HOP, MEDIAN_ERROR, OVERLAP_DOF, SEGMENT, SIDE
from imumon.samples import Bools, Floats, Ints

STEADY_POWER_ERROR, STEADY_SHAPE_ERROR = 0.005, 0.002
"""1, relative errors of the power of a band beyond its statistics, and of the contribution at each octave, of a
line whose size changes by 20 % in the course of a minute. Not critical."""
STEADY_PLACE_ERROR = 0.05
"""1, error of the centroid in widths of the band, and relative error of its width. Not critical."""
STEADY_PLACES = 25.0
"""Independent frequencies that a line has in a record. Not critical."""
POWER_ERROR, SHAPE_ERROR = 0.1, 0.05
"""1, the same errors of a line that changes. Not critical."""
REACH = 2.2
"""Widths to either side of the centre over which a band extends. Not critical."""
NODES = 41
"""Frequencies by which a band is represented. Not critical."""

QUIET_AVERAGES = 256
"""Segments from which the density without bands is used: what they leave beside a band shows from 6 % of the
density on. Not critical."""
QUIET_OCTAVES = 4
"""Octaves that the spectrum may replace, up to 8 samples: longer ones need bins that the window disturbs. Not
critical."""
WINDOW_EFFICIENCY = 0.95
"""1, share of the samples of its segments that an average over many bins uses: Hann windows with half overlap
weight samples by 1 +- 1/3. Not critical."""
UNEVEN_ERROR = 0.01
"""1, relative change of the noise power in a long record, of which the spectrum uses the beginning more. Not
critical."""

_STEPS = np.linspace(-REACH, REACH, NODES)
_WEIGHTS = np.exp(-0.5 * _STEPS**2) / np.exp(-0.5 * _STEPS**2).sum()
_ROOTS = np.sqrt(_WEIGHTS)[:, None]
_MOMENTS = np.linalg.qr(_ROOTS * np.vander(_STEPS, 3, increasing=True))[0]
"""(NODES, 3) what the power, the centroid and the width of a band determine."""


def transfer(frequency: Floats, m: Ints, tau0: float) -> Floats:
    """Return (f, k) 1, the Allan variance that unit power at each frequency makes, at cluster lengths m.

    >>> transfer(np.array([0.25]), np.array([1, 2, 4]), 1.0).round(3)
    array([[1., 1., 0.]])
    """
    x = np.pi * tau0 * np.asarray(frequency)[:, None]
    sine = np.maximum(np.sin(x), 1e-100)
    return np.asarray(2.0 * np.sin(x * m) ** 4 / (m * sine) ** 2)


def band_offset(
    bands: Sequence[NarrowBand], m: Ints, tau0: float, without: Callable[[NarrowBand], Bools] | None = None
) -> tuple[Floats, Floats, Floats]:
    """Return the Allan variances of bands, their covariance, and what to add to it for lines that change.

    Parameters
    ----------
    m : (k,) cluster lengths, samples.
    tau0 : s
    without : returns (k,) the octaves that do not contain a band; None: each contains all.

    Returns
    -------
    offset : (k,) unit^2.
    steady, changing : (k, k) unit^4.
    """
    offset, steady, changing = np.zeros(len(m)), np.zeros((len(m), len(m))), np.zeros((len(m), len(m)))
    for band in bands:
        nodes = np.clip(band.frequency_hz + band.width_hz * _STEPS, 0.0, 0.5 / tau0)
        response = transfer(nodes, m, tau0)
        if without is not None:
            response[:, without(band)] = 0.0
        mean = _WEIGHTS @ response
        deviation = _ROOTS * response
        moments = _MOMENTS.T @ deviation
        whole, spread = _WEIGHTS @ (response - mean) ** 2, ((deviation - _MOMENTS @ moments) ** 2).sum(axis=0)
        offset += band.power * mean
        together = np.outer(mean, mean)
        steady += (band.error**2 + (STEADY_POWER_ERROR * band.power) ** 2) * together
        steady += (STEADY_PLACE_ERROR * band.power) ** 2 * (moments[1:].T * (1.0, 2.0)) @ moments[1:]
        steady += np.diag(band.power**2 * (spread / STEADY_PLACES + (STEADY_SHAPE_ERROR * mean) ** 2))
        changing += (POWER_ERROR * band.power) ** 2 * together
        changing += np.diag(band.power**2 * (whole + (SHAPE_ERROR * mean) ** 2))
    return offset, steady, changing


def quiet_octaves(quiet: QuietDensity, m: Ints, samples: int, span: int) -> tuple[Floats, Floats]:
    """Return the Allan variances of the density without bands, and what to add to the covariance of the octaves.

    The segments are part of the samples, so that only the rest of them adds an error.

    Parameters
    ----------
    m : (k,) cluster lengths, samples; the first `QUIET_OCTAVES` are computed.
    samples, span : valid samples of the record, and all of its grid. Where samples are missing, the density is
        too low by up to their share.

    Returns
    -------
    variance : (q,) unit^2, q at most `QUIET_OCTAVES`.
    error : (q, q) unit^4.
    """
    width = quiet.rate_hz / SEGMENT
    frequency = np.asarray(np.arange(1.0, len(quiet.density)) * width)  # a constant has no Allan variance
    response = transfer(frequency, m[:QUIET_OCTAVES], 1.0 / quiet.rate_hz)
    power = quiet.density[1:, None] * width * response
    variance = power.sum(axis=0)
    share = min(1.0, quiet.averages * HOP / max(samples, 1))
    outside = 2.0 / (WINDOW_EFFICIENCY * quiet.averages) * (1.0 - WINDOW_EFFICIENCY * share)
    common = 1.0 - samples / max(span, 1) + UNEVEN_ERROR * (1.0 - share)
    median_error = MEDIAN_ERROR * np.sqrt(1.0 / (OVERLAP_DOF * quiet.averages * SIDE))
    level = np.hypot(LEVEL_ERROR, median_error) * power[quiet.replaced[1:]].sum(axis=0)
    hidden = (quiet.tails[1:, None] * width * response).sum(axis=0)
    error = outside * power.T @ power + common**2 * np.outer(variance, variance)
    return variance, error + np.outer(level, level) + np.outer(hidden, hidden)


def with_quiet_octaves(
    bands: Sequence[NarrowBand],
    quiet: QuietDensity,
    m: Ints,
    variance: Floats,
    steady: Floats,
    samples: int,
    span: int,
) -> tuple[Floats, Floats, Floats]:
    """Return the Allan variances with those of the density where these have the smaller error.

    Parameters
    ----------
    variance : (k,) unit^2, Allan variances of the samples.
    steady : (k, k) unit^4, as `band_offset` returns it.
    m, samples, span : as in `quiet_octaves`.

    Returns
    -------
    variance : (k,) unit^2.
    offset, steady : as of `band_offset`, of the bands that these variances contain.
    """
    own, error = quiet_octaves(quiet, m, samples, span)
    better = np.zeros(len(m), dtype=bool)
    better[: len(own)] = np.diag(error) < np.diag(steady)[: len(own)]
    at = np.flatnonzero(better)
    variance, added = variance.copy(), np.zeros(steady.shape)
    variance[at], added[np.ix_(at, at)] = own[at], error[np.ix_(at, at)]

    def without(band: NarrowBand) -> Bools:
        place = min(round(band.frequency_hz / quiet.rate_hz * SEGMENT), len(quiet.replaced) - 1)
        return np.asarray(better & quiet.replaced[place])

    offset, rest, _ = band_offset(bands, m, 1.0 / quiet.rate_hz, without)
    return variance, offset, rest + added


def kurtosis_covariance(variance: float, kurtosis: float, samples: int, m: Ints) -> Floats:
    """Return (k, k) unit^4, what the excess kurtosis of white noise adds to the covariance of the octaves.

    Parameters
    ----------
    variance : unit^2, Allan variance of the noise at one sample.
    kurtosis : 1, excess kurtosis of the samples.
    samples : valid samples.
    m : (k,) cluster lengths, samples.
    """
    white = variance / m
    return np.asarray(max(kurtosis, 0.0) / max(samples, 1) * np.outer(white, white))
