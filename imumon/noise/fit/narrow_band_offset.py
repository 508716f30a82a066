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

Outliers leave the expectation alone. Noise of independent samples with excess kurtosis g has Allan variances
whose relative covariances all gain g/n (the fourth cumulant of the sum of squares), as if N^2 itself varied.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.noise.statistics.narrow_bands import NarrowBand
from imumon.samples import Floats, Ints

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
    sine = np.maximum(np.sin(x), 1e-300)
    return np.asarray(2.0 * np.sin(x * m) ** 4 / (m * sine) ** 2)


def band_offset(bands: Sequence[NarrowBand], m: Ints, tau0: float) -> tuple[Floats, Floats, Floats]:
    """Return the Allan variances of bands, their covariance, and what to add to it for lines that change.

    Parameters
    ----------
    m : (k,) cluster lengths, samples.
    tau0 : s

    Returns
    -------
    offset : (k,) unit^2.
    steady, changing : (k, k) unit^4.
    """
    offset, steady, changing = np.zeros(len(m)), np.zeros((len(m), len(m))), np.zeros((len(m), len(m)))
    for band in bands:
        nodes = np.clip(band.frequency_hz + band.width_hz * _STEPS, 0.0, 0.5 / tau0)
        response = transfer(nodes, m, tau0)
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
