"""Sizes at rest: what the numbers of a sensor at rest say about their unit.

A wrong unit makes every result wrong, by a factor that no later check can see: noise has no natural size. But the
sensor is at rest.

acceleration
    The size of the three axes is one g in any attitude: |a| = 9.81 m/s2 = 1 g = 1000 mg. Its median decides, because a
    few wrong numbers say nothing of the unit. The errors of scale and bias of an accelerometer are below a fifth.
rate of rotation
    Its mean is the bias and the rotation of the earth. The bias of a MEMS gyroscope is up to some tens of deg/s, so
    that the mean says nothing of the unit. What the single sample adds to it does: the noise of a sample is
    N * sqrt(bandwidth), at most about a degree per second. Numbers in deg/s that are read as rad/s have 57 times as
    much. The third difference of the samples shows the noise, and no motion of a hand or a vehicle.

>>> import numpy as np
>>> noise = np.random.default_rng(1).normal(0.0, 1.0, (500, 3))
>>> round(sample_noise(noise + 90.0 * np.sin(np.arange(500) / 30.0)[:, None]))
1
>>> too_noisy(0.08 * noise), too_noisy(np.radians(0.08 * noise))
(True, False)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imumon.model.units import STANDARD_GRAVITY

if TYPE_CHECKING:
    from imumon.model.samples import Floats

ONE_G = (0.8, 1.25)
"""Sizes of an acceleration that are one g, in g: the errors of scale and bias of an accelerometer are smaller."""

NOISIEST = 0.02
"""rad/s, noise of a sample of a gyroscope at most, chosen: 1.1 deg/s. Numbers in deg/s that are read as rad/s exceed it
where the noise of the sensor is above 0.02 deg/s a sample, as that of most consumer sensors is."""

FEWEST = 20
"""Samples from which the noise is assessed."""


def median_size(rows: Floats) -> float | None:
    """Return the median length of (n, k) vectors, those that are finite; None: there is none."""
    import numpy as np

    valid = rows[np.isfinite(rows).all(axis=1)]
    return float(np.median(np.linalg.norm(valid, axis=1))) if len(valid) else None


def is_one_g(size: float) -> bool:
    """Return whether an acceleration, m/s2, is one g."""
    return ONE_G[0] <= size / STANDARD_GRAVITY <= ONE_G[1]


def sample_noise(rows: Floats) -> float:
    """Return the standard deviation of the noise of (n, k) samples, the median of their columns; 0.0 of too few."""
    import numpy as np

    valid = rows[np.isfinite(rows).all(axis=1)]
    if len(valid) < FEWEST:
        return 0.0
    # third differences of white noise have 1 + 9 + 9 + 1 times its variance; 0.6745: the median of |normal|
    spread = np.median(np.abs(np.diff(valid, n=3, axis=0)), axis=0) / (0.6745 * 20.0**0.5)
    return float(np.median(spread))


def too_noisy(rates: Floats) -> bool:
    """Return whether (n, k) samples, as rad/s, have more noise than any gyroscope at rest."""
    return sample_noise(rates) > NOISIEST


def are_counts(rows: Floats) -> bool:
    """Return whether all of (n, k) numbers are whole, and not all the same."""
    import numpy as np

    valid = rows[np.isfinite(rows).all(axis=1)]
    return bool(len(valid) >= FEWEST and np.ptp(valid) > 1.0 and (valid == np.rint(valid)).all())
