"""Contribution of narrow bands of the spectrum, and of outliers, to the Allan variances of a record.

Samples whose one-sided density is S(f) have, exactly and also above the Nyquist frequency of the process,

    sigma^2(m tau0) = 2 int S(f) sin^4(pi f m tau0) / (m^2 sin^2(pi f tau0)) df    (IEEE Std 1139, annex B)

over 0 to 1/(2 tau0); a sinusoid of amplitude a therefore contributes a^2 sin^4(pi f tau)/(pi f tau)^2 at long
tau. What the spectrum shows as a band is subtracted, and its uncertainty is added to the covariance: that of
the power raises or lowers all octaves together, that of the frequency each by itself.

Outliers leave the expectation alone. Noise of independent samples with excess kurtosis g has Allan variances
whose relative covariances all gain g/n (the fourth cumulant of the sum of squares), as if N^2 itself varied.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.noise.statistics.narrow_bands import NarrowBand
from imumon.samples import Floats, Ints

POWER_ERROR = 0.1
"""1, relative error of the power of a band beyond its statistics: the line changes. Not critical."""
SHAPE_ERROR = 0.05
"""1, relative error of the contribution at each octave: the band has no Gaussian shape. Not critical."""
REACH = 2.2
"""Widths to either side of the centre over which a band extends. Not critical."""
NODES = 41
"""Frequencies by which a band is represented. Not critical."""

_STEPS = np.linspace(-REACH, REACH, NODES)
_WEIGHTS = np.exp(-0.5 * _STEPS**2) / np.exp(-0.5 * _STEPS**2).sum()


def transfer(frequency: Floats, m: Ints, tau0: float) -> Floats:
    """Return (f, k) 1, the Allan variance that unit power at each frequency makes, at cluster lengths m.

    >>> transfer(np.array([0.25]), np.array([1, 2, 4]), 1.0).round(3)
    array([[1., 1., 0.]])
    """
    x = np.pi * tau0 * np.asarray(frequency)[:, None]
    sine = np.maximum(np.sin(x), 1e-300)
    return np.asarray(2.0 * np.sin(x * m) ** 4 / (m * sine) ** 2)


def band_offset(bands: Sequence[NarrowBand], m: Ints, tau0: float) -> tuple[Floats, Floats]:
    """Return the Allan variances of bands, (k,) unit^2, and their covariance, (k, k) unit^4.

    Parameters
    ----------
    m : (k,) cluster lengths, samples.
    tau0 : s
    """
    offset, covariance = np.zeros(len(m)), np.zeros((len(m), len(m)))
    for band in bands:
        nodes = np.clip(band.frequency_hz + band.width_hz * _STEPS, 0.0, 0.5 / tau0)
        response = transfer(nodes, m, tau0)
        mean = _WEIGHTS @ response
        spread = _WEIGHTS @ (response - mean) ** 2
        offset += band.power * mean
        covariance += (band.error**2 + (POWER_ERROR * band.power) ** 2) * np.outer(mean, mean)
        covariance += np.diag(band.power**2 * (spread + (SHAPE_ERROR * mean) ** 2))
    return offset, covariance


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
