"""Time that a record must still grow until a coefficient is as precise as requested.

The Fisher information of a record of T samples about the logarithms of N^2, B^2 and K^2 is that of its spectrum
(Whittle 1953): T times the integral of s_i s_j over frequency, from three quarters of a cycle per record, which
constant and drift leave, to the highest frequency in use. s_i is the share of noise i in the density. The present
limits set the scale, and the information gives the change.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.samples import Floats
from imumon.units import YEAR

FREQUENCIES = 60
"""Points of the integral, even in the logarithm of frequency."""
LOWEST_CYCLES = 1.5
"""Half cycles per record, lowest frequency that is free of constant and drift."""


def relative_errors(powers: Floats, samples: Floats, highest: float) -> Floats:
    """Return (j, 3) relative standard errors of N, B and K of records; inf where nothing is known.

    Parameters
    ----------
    powers : (3,) N^2, B^2, K^2 in units of tau0.
    samples : (j,) lengths of the records.
    highest : cycles per sample.
    """
    lowest = LOWEST_CYCLES / (2.0 * samples)
    out, known, longer = np.full((samples.size, 3), np.inf), powers > 0.0, lowest < highest
    if not known.any() or not longer.any():
        return out
    rate = 2.0 * np.pi * np.geomspace(lowest[longer], highest, FREQUENCIES, axis=-1)
    density = np.stack([powers[i] / rate**i for i in np.flatnonzero(known)], axis=1)
    share = density / density.sum(axis=1, keepdims=True)
    weight = samples[longer, None] * rate / (2.0 * np.pi) * np.log(rate[:, 1:2] / rate[:, :1])
    inverse = np.linalg.pinv((share * weight[:, None]) @ share.swapaxes(1, 2))
    variances = np.maximum(np.diagonal(inverse, axis1=1, axis2=2), 0.0)
    out[np.ix_(longer, known)] = 0.5 * np.sqrt(variances)
    return out


def seconds_to(
    powers: Floats, widths: Floats, samples: float, tau0: float, highest: float, precision: Floats
) -> list[float | None]:
    """Return the seconds still to record until the half-widths of N, B and K are as requested.

    Parameters
    ----------
    powers : (3,) units of tau0.
    widths : (3,) 1, half-widths now, relative to the value; inf where not measured.
    samples : length of the record.
    tau0 : s
    highest : cycles per sample, highest frequency in use.
    precision : (3,) 1, requested relative half-widths.

    Returns
    -------
    s; None where a coefficient is not measured, or not as precise within a year: no sensor stays the same that long.
    """
    doublings = np.arange(2 + max(0, math.ceil(math.log2(1.0 + YEAR / (samples * tau0)))), dtype=np.float64)
    errors = relative_errors(powers, samples * np.exp2(doublings), highest)
    out: list[float | None] = []
    for term, (width, least) in enumerate(zip(widths.tolist(), precision.tolist(), strict=True)):
        known = math.isfinite(width) and math.isfinite(errors[0, term])
        reached = width * errors[:, term] / errors[0, term] if known else errors[:, term]
        at = int((reached <= least).argmax())
        if width <= least:
            out.append(0.0)
        elif not known or not at:
            out.append(None)
        else:
            part = math.log(reached[at - 1] / least) / math.log(reached[at - 1] / reached[at])
            seconds = samples * (2.0 ** (at - 1.0 + part) - 1.0) * tau0
            out.append(seconds if seconds < YEAR else None)
    return out
