"""Outliers: single samples of one sensor that are far from the others.

A bit error or a coarse converter gives single samples of many standard deviations. Each is excluded by itself,
on its own sensor. Outliers that crowd are not single: they are a knock.

If outliers are more than `NOISE_SHARE` of the samples of a channel, they are the noise of the sensor and stay
in the statistics, which then describe what the sensor really gives. The decision is made frame by frame from
counts that halve every `MEMORY_FRAMES` frames, so it is a function of the samples alone. Until the decision, at
most `NOISE_SHARE` and three standard errors of the counted samples are excluded; they stay excluded.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.noise.array_state import ArrayState
from imumon.noise.detection.baseline import MARGIN, UNUSUAL_SIGMA, gaussian_deviation
from imumon.noise.detection.frame_statistics import MEMORY_FRAMES, PARTS
from imumon.noise.detection.stuck import CHANCE, run_beyond_chance
from imumon.samples import Bools, Floats, Ints

NOISE_SHARE = 0.01
"""Share of the samples of a channel above which outliers are its noise."""
LEAST_RUN = 3
"""Samples in a row, or nearly, that are a knock where outliers are rare."""


class OutlierDetector(ArrayState):
    """Find the outliers of the sensors on one table, and decide which channels have them as noise.

    Parameters
    ----------
    groups : (c,) group of each channel.
    frame : samples of a frame.

    Attributes
    ----------
    noise : (c,) channels whose outliers are noise.
    """

    _STATE = ("_channels", "_rows", "_frames", "noise")

    def __init__(self, groups: list[int], frame: int) -> None:
        names = list(dict.fromkeys(groups))
        self._members = [[c for c, group in enumerate(groups) if group == name] for name in names]
        self._frame = frame
        self._channels = np.zeros(len(groups))  # outliers of each channel
        self._rows = np.zeros(len(names))  # samples of each sensor with an outlier
        self._frames = np.zeros(1, dtype=np.int64)  # frames in which they were counted
        self.noise = np.zeros(len(groups), dtype=bool)

    def find(self, d: Floats, usable: Bools | None, limit: Floats) -> Bools | None:
        """Return (c, k, PARTS, part) the outliers of frames; None if there are none, or if they crowd.

        Parameters
        ----------
        d : (c, k, PARTS, part) channel unit.
        usable : (k, PARTS, part) samples that may be assessed; None: all.
        limit : (c,) channel unit, distance from the middle of a frame.
        """
        far = np.abs(d - _middle(d, usable)[:, :, None, None]) > limit[:, None, None, None]
        if usable is not None:
            far &= usable
        if not far.any():
            return None
        shares = self._rows / max(int(self._frames[0]) * self._frame, 1)
        sensors = [far[members].any(axis=0).reshape(-1) for members in self._members]
        for rows, share in zip(sensors, shares.tolist(), strict=True):
            least = run_beyond_chance(share, LEAST_RUN)
            if np.convolve(rows, np.ones(min(2 * least - 1, len(rows)))).max() > least - 0.5:
                return None
        if len(sensors) > 1:  # a bit error is in one sensor, a knock in both
            both = np.logical_and.reduce([np.convolve(rows, np.ones(3), "same") > 0.5 for rows in sensors])
            likely = float(np.prod(np.minimum(9.0 * shares, 1.0)))
            if both.any() and (likely <= 0.0 or likely ** int(both.sum()) < CHANCE):
                return None
        return far

    def count(self, outliers: Bools | None, frames: int) -> None:
        """Count the outliers (c, k, PARTS, part) of some frames, and decide at the end of each counting."""
        if outliers is not None:
            self._channels += outliers.sum(axis=(1, 2, 3))
            self._rows += [outliers[members].any(axis=0).sum() for members in self._members]
        while frames:
            step = min(frames, MEMORY_FRAMES - int(self._frames[0]))
            self._frames += step
            frames -= step
            if self._frames[0] >= MEMORY_FRAMES:
                self._frames //= 2
                self._channels *= 0.5
                self._rows *= 0.5
        n = float(self._frames[0]) * self._frame
        most = NOISE_SHARE * n + MARGIN * math.sqrt(NOISE_SHARE * n)
        self.noise = self._channels > most


def _middle(d: Floats, usable: Bools | None) -> Floats:
    """Return (c, k) the median of the means of the parts of each frame, which no single sample moves."""
    if usable is None:
        return np.asarray(np.median(d.mean(axis=3), axis=2))
    count = usable.sum(axis=2)
    means = np.where(count > 0, (d * usable).sum(axis=3) / np.maximum(count, 1), np.inf)
    filled = (count > 0).sum(axis=1)
    ordered = np.sort(means, axis=2)
    frames: Ints = np.arange(d.shape[1])
    low, high = np.maximum(filled - 1, 0) // 2, np.minimum(filled // 2, PARTS - 1)
    middle = 0.5 * (ordered[:, frames, low] + ordered[:, frames, high])
    return np.where(np.isfinite(middle), middle, 0.0)


def own_limit(d: Floats, usable: Bools | None) -> Floats:
    """Return (c,) the distance of an outlier, channel unit, from the samples (c, k, PARTS, part) themselves.

    The scale is the median absolute deviation. Where it is 0, most values are equal, and the deviation counts.
    """
    x = d.reshape(len(d), -1) if usable is None else d[:, usable]
    n = x.shape[1]
    if n < PARTS:
        return np.full(len(d), np.inf)
    median = np.median(x, axis=1, keepdims=True)
    scale = gaussian_deviation(np.median(np.abs(x - median), axis=1))
    scale = np.where(scale > 0.0, scale, x.std(axis=1))
    return np.asarray(UNUSUAL_SIGMA * scale)
