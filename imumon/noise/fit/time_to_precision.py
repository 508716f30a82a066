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

MAX_SECONDS = 3.15576e7
"""s, one year: longer times are not reported, because no sensor stays the same that long."""
GROWTH = 2.0
"""Factor between the lengths of records that are compared."""
FREQUENCIES = 60
"""Points of the integral, even in the logarithm of frequency."""
LOWEST_CYCLES = 1.5
"""Half cycles per record, lowest frequency that is free of constant and drift."""


def relative_errors(powers: Floats, samples: float, highest: float) -> Floats:
    """Return (3,) relative standard errors of N, B and K of a record; inf where nothing is known.

    Parameters
    ----------
    powers : (3,) N^2, B^2, K^2 in units of tau0.
    highest : cycles per sample.
    """
    lowest = LOWEST_CYCLES / (2.0 * samples)
    if not lowest < highest:
        return np.full(3, np.inf)
    f = np.geomspace(lowest, highest, FREQUENCIES)
    rate = 2.0 * np.pi * f
    density = powers[:, None] * np.stack((np.ones_like(f), 1.0 / rate, 1.0 / rate**2))
    share = density / np.maximum(density.sum(axis=0), 1e-300)
    weight = samples * f * math.log(f[1] / f[0])
    information = (share * weight) @ share.T
    known = np.diag(information) > 0.0
    out = np.full(3, np.inf)
    if known.any():
        inverse = np.linalg.pinv(information[np.ix_(known, known)])
        out[known] = 0.5 * np.sqrt(np.maximum(np.diag(inverse), 0.0))
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
    s; None where a coefficient is not measured, or not as precise within `MAX_SECONDS`.
    """
    out: list[float | None] = [None, None, None]
    waiting = []
    for term, (width, least) in enumerate(zip(widths.tolist(), precision.tolist(), strict=True)):
        if width <= least:
            out[term] = 0.0
        elif math.isfinite(width):
            waiting.append(term)
    length, before = samples, relative_errors(powers, samples, highest)
    first = before
    while waiting and (length - samples) * tau0 < MAX_SECONDS:
        length *= GROWTH
        now = relative_errors(powers, length, highest)
        for term in list(waiting):
            reached, last = (widths[term] * errors[term] / first[term] for errors in (now, before))
            if reached <= precision[term]:
                part = math.log(last / precision[term]) / math.log(last / reached) if last > reached else 1.0
                seconds = (length * GROWTH ** (part - 1.0) - samples) * tau0
                out[term] = float(seconds) if seconds < MAX_SECONDS else None
                waiting.remove(term)
        before = now
    return out
