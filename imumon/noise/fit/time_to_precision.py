"""Time that a record must still grow until a coefficient is as precise as requested.

The Fisher information of a record of T samples about the logarithms of the powers is that of its spectrum (Whittle
1953): T times the integral of s_i s_j over frequency, from three quarters of a cycle per record, which constant and
drift leave, to the highest frequency in use. s_i is the share of term i in the density.

The information gives the change with the length. The scale is that of the present limits, for N. Half-widths of B and
K scatter by a quarter between records of one truth, and so little of what a half-width has beyond the expected one is
left in a record that is twice as long: the prediction returns to the expected half-width (`WIDTH_MEMORY`). B and K that
are hardly known have no time (`PROMISED`).

Example: of white noise alone, the relative error of N is 1 / sqrt(2 T).

>>> errors = relative_errors({WHITE: 1.0}, np.array([1e4, 4e4]), 0.5)[WHITE]
>>> (errors * np.sqrt([2e4, 8e4])).round(1)
array([1., 1.])
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from imumon.model.coefficients import LIMIT_95
from imumon.model.samples import Floats
from imumon.model.units import YEAR
from imumon.noise.fit.model import WHITE, NoiseTerm, TermPowers

FREQUENCIES = 60
"""Points of the integral of the Fisher information, even in the logarithm. Unit: frequencies.

Otherwise: times are off by the error of the integral. Origin: 30 or 240 change times by 1.4 %.
"""
LOWEST_HALF_CYCLES = 1.5
"""Lowest frequency that counts in `time_to`. Unit: half cycles per record.

Otherwise: constant and drift take the lowest two coefficients: with 0.5 the promised time is a fifth too short.
Origin: half a cycle is the constant, one is the drift.
"""
WIDTH_OVER_BOUND = 1.15
"""Half-widths of B and K that a longer record is expected to have, over those of the Cramér-Rao bound.

Otherwise: a half-width that is wide or narrow by chance shifts the whole prediction: half of the lengths that are
promised for B are wrong by more than a factor of 1.5. Origin: medians over simulated records are 1.03 to 1.25, the
larger ones while the half-width is above 20 %.
"""
WIDTH_MEMORY = 1.5
"""Power of the ratio of two lengths of a record with which the longer one keeps what its half-width has beyond the
expected one.

Otherwise: 0: the prediction jumps with each half-width; infinite: it does not learn from the record. Origin: 1 to 2
are alike; with 0.5 or 4, up to 10 % fewer lengths promised for B are within a factor of 1.5.
"""
PROMISED = 2.5
"""B and K with a wider half-width have no time until they are precise enough. Unit: requested half-widths.

Otherwise: B and K that show early are those that are estimated too high: their times are too short. Origin: of the
lengths promised for B, 92 and 82 % are within a factor of 1.5 with 2.5, and 88 and 79 % with 3, for two K.
"""

__all__ = ["WHITE", "relative_errors", "seconds_to"]


def relative_errors(powers: TermPowers, samples: Floats, highest: float) -> dict[NoiseTerm, Floats]:
    """Return (j,) relative standard errors of the coefficient of each term, in records of some lengths.

    Parameters
    ----------
    powers : of the terms; those with power 0 have no error: inf.
    samples : (j,) lengths of the records.
    highest : cycles per sample.
    """
    lowest = LOWEST_HALF_CYCLES / (2.0 * samples)
    out = {term: np.full(samples.size, np.inf) for term in powers}
    present, longer = [term for term, power in powers.items() if power > 0.0], lowest < highest
    if not present or not longer.any():
        return out
    f = np.geomspace(lowest[longer], highest, FREQUENCIES, axis=-1)
    density = np.stack([powers[term] * term.rate_density(f) for term in present], axis=1)
    share = density / density.sum(axis=1, keepdims=True)
    weight = samples[longer, None] * f * np.log(f[:, 1:2] / f[:, :1])  # T df on a logarithmic axis
    # powers that look alike have no finite error, but a pseudoinverse: it says what is known together
    inverse = np.linalg.pinv((share * weight[:, None]) @ share.swapaxes(1, 2))
    variances = np.maximum(np.diagonal(inverse, axis1=1, axis2=2), 0.0)
    for i, term in enumerate(present):
        out[term][longer] = 0.5 * np.sqrt(variances[:, i])  # of a coefficient half that of its power
    return out


def seconds_to(
    powers: TermPowers,
    widths: Mapping[str, float],
    samples: float,
    tau0: float,
    highest: float,
    precision: Mapping[str, float],
) -> dict[str, float | None]:
    """Return the seconds still to record until the half-widths of coefficients are as requested.

    Parameters
    ----------
    powers : of the terms.
    widths : 1, half-widths now by letter, relative to the value; inf where not measured.
    samples : length of the record.
    tau0 : s
    highest : cycles per sample, highest frequency in use.
    precision : 1, requested relative half-widths by letter.

    Returns
    -------
    s by letter; None where a coefficient is not measured, hardly known, or not as precise within a year: no sensor
    stays the same that long.
    """
    doublings = np.arange(2 + max(0, math.ceil(math.log2(1.0 + YEAR / (samples * tau0)))), dtype=np.float64)
    # What does not show has no value: its most likely power comes and goes, and would move the times of the others.
    shown = {
        term: power if math.isfinite(widths.get(term.letter, 0.0)) else 0.0 for term, power in powers.items()
    }
    errors = {
        term.letter: e for term, e in relative_errors(shown, samples * np.exp2(doublings), highest).items()
    }
    return {
        letter: _seconds(
            widths[letter], precision[letter], errors[letter], samples * tau0, letter != WHITE.letter
        )
        for letter in precision
    }


def _seconds(width: float, least: float, errors: Floats, length_s: float, forgets: bool) -> float | None:
    """Return the seconds until one half-width is reached; see `seconds_to`.

    Parameters
    ----------
    errors : (j,) relative errors of records of the present length times 1, 2, 4 ...
    forgets : the half-width scatters, and a longer record keeps a part of what it has beyond the expected one.
    """
    if width <= least:
        return 0.0
    if not (math.isfinite(width) and math.isfinite(errors[0])) or (forgets and width > PROMISED * least):
        return None
    expected = LIMIT_95 * WIDTH_OVER_BOUND * errors
    kept = np.exp2(-WIDTH_MEMORY * np.arange(errors.size)) if forgets else 1.0
    reached = expected * (width / expected[0]) ** kept
    later = int((reached <= least).argmax())
    if not later:  # the first is today, which is not enough: none of them is
        return None
    part = math.log(reached[later - 1] / least) / math.log(reached[later - 1] / reached[later])
    seconds = length_s * (2.0 ** (later - 1.0 + part) - 1.0)
    return seconds if seconds < YEAR else None
