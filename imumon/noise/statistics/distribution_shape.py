"""Shape of a distribution: is it Gaussian, or quantised?

The verdict is about effect size: with a million samples every real distribution fails a significance test,
but the question is whether a Gaussian model would mislead. Limits are on the Kolmogorov distance
to the Gaussian of the same mean and standard deviation, on skewness and on excess kurtosis, each widened by
its own sampling error: 1.5/sqrt(n) for the distance (a Gaussian exceeds 1.03/sqrt(n) once in a hundred times,
Lilliefors 1967), for the others four standard errors in large samples, sqrt(6/n) and sqrt(24/n) (Fisher
1930).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import ndtr

from imumon.model.samples import Ints

GAUSSIAN_DISTANCE = 0.025
"""Up to here a distribution counts as Gaussian. Unit: Kolmogorov distance.

Otherwise: long records reject every distribution: no sensor is exactly Gaussian. Chosen: probabilities are right to
2.5 %.
"""
GAUSSIAN_SKEWNESS = 0.25
"""Up to here a distribution counts as Gaussian. Unit: skewness.

Otherwise: see GAUSSIAN_DISTANCE: every long record is skewed.
"""
GAUSSIAN_KURTOSIS = 0.5
"""Up to here a distribution counts as Gaussian. Unit: excess kurtosis.

Otherwise: see GAUSSIAN_DISTANCE: every long record has heavy or light tails.
"""
DISTANCE_ERROR = 1.5
"""Sampling error of the distance that is allowed beside GAUSSIAN_DISTANCE. Unit: 1/sqrt(n).

Otherwise: short records are not Gaussian by chance.
"""
MOMENT_ERRORS = 4.0
"""Errors of skewness, kurtosis and a ratio of deviations that chance may make. Unit: standard errors.

Otherwise: short records have verdicts by chance.
"""
QUANTISED_STEPS = 1.5
"""A channel with a smaller standard deviation is called quantised. Unit: quantisation steps.

Otherwise: a distribution of two or three levels is compared with a bell.
"""
LEARN_SAMPLES = 256
"""The step of a quantised channel is read from this many; with fewer there is no verdict and no median. Unit:
samples.

Otherwise: a step is learned from values that chance has left out.
"""


@dataclass(frozen=True, slots=True)
class DistributionShape:
    """Distribution of one channel.

    Attributes
    ----------
    start, width : channel unit, lower edge of the first bin and width of each.
    counts : samples in each bin, without empty bins at the ends.
    gaussian : expected counts of a Gaussian with the same mean and deviation.
    is_gaussian : None with fewer than `LEARN_SAMPLES` samples.
    verdict : text, such as ``not Gaussian: heavy tails``.
    step : channel unit, quantisation step, or None.
    """

    start: float
    width: float
    counts: tuple[int, ...]
    gaussian: tuple[float, ...]
    is_gaussian: bool | None
    verdict: str
    step: float | None = None

    @property
    def constant(self) -> bool:
        """Whether the channel never changed in `LEARN_SAMPLES` samples or more."""
        return len(self.counts) == 1 and self.counts[0] >= LEARN_SAMPLES


def assessed(start: float, width: float, counts: Ints, step: float | None) -> DistributionShape:
    """Return the shape of the distribution from the counts of equal bins."""
    n = int(counts.sum())
    share = counts / n
    # in bins, because powers of tiny units underflow; about the middle, because those of large numbers lose digits
    d = np.arange(len(counts)) - float(len(counts) // 2)
    d = d - float(share @ d)
    m2 = float(share @ d**2)
    shape = partial(DistributionShape, start=start, width=width, counts=tuple(counts.tolist()), step=step)
    if n < 2 or m2 <= 0.0:
        return shape(
            gaussian=(float(n),) * len(counts),
            is_gaussian=None,
            verdict="constant" if n >= LEARN_SAMPLES else "too few samples",
        )
    # Grouping into bins adds 1/12 to the variance (Sheppard), unless the bins are the levels themselves.
    # It adds m2/2 - 7/240 to the fourth moment and nothing to the third.
    grouped = float(step is None or width > 1.5 * step)
    variance = max(m2 - grouped / 12.0, 0.25 * m2)  # of one or two bins, the correction is a guess
    skewness = float(share @ d**3) / variance**1.5
    kurtosis = (float(share @ d**4) - grouped * (m2 / 2.0 - 7.0 / 240.0)) / variance**2 - 3.0
    phi = ndtr((np.append(d, d[-1] + 1.0) - 0.5) / math.sqrt(variance))
    distance = float(np.abs(np.cumsum(share) - phi[1:]).max())
    deviations = _deviations(n, distance, skewness, kurtosis)
    coarse = step is not None and math.sqrt(variance) * width < QUANTISED_STEPS * step
    if coarse and step is not None:
        deviations = [f"quantised: {int(np.count_nonzero(counts))} levels"]
    if n < LEARN_SAMPLES:
        verdict = "too few samples"
    else:
        verdict = f"not Gaussian: {', '.join(deviations)}" if deviations else "Gaussian"
    return shape(
        gaussian=tuple((n * np.diff(phi)).tolist()),
        is_gaussian=None if n < LEARN_SAMPLES else not deviations,
        verdict=verdict,
    )


def _deviations(n: int, distance: float, skewness: float, kurtosis: float) -> list[str]:
    """Return how a distribution differs from a Gaussian, as text."""
    tails = GAUSSIAN_KURTOSIS + MOMENT_ERRORS * math.sqrt(24.0 / n)
    conditions = {
        "heavy tails": kurtosis > tails,
        "light tails": kurtosis < -tails,
        "skewed": abs(skewness) > GAUSSIAN_SKEWNESS + MOMENT_ERRORS * math.sqrt(6.0 / n),
    }
    deviations = [text for text, applies in conditions.items() if applies]
    # the distance has no direction: it only decides where nothing above explains it
    different = distance > GAUSSIAN_DISTANCE + DISTANCE_ERROR / math.sqrt(n)
    return deviations or (["shape"] if different else [])
