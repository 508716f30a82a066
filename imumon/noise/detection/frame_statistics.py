"""Statistics of frames, by which disturbances are assessed.

Time is divided into *frames* of ten *parts*, about 1 s and 0.1 s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.noise.validity_groups import LEAST_SHARE
from imumon.samples import Bools, Floats, Ints

PARTS = 10
"""Parts of a frame: of about 0.1 s, the shortest time that is excluded."""
INDEPENDENT_SAMPLES = 100
"""Independent samples of a frame that are assumed at most: the filter of the sensor may end at 50 Hz."""
FIRST_FRAMES = 4
"""Frames that are assessed together at the beginning, because one may be disturbed; rest is not doubted before."""
MEMORY_FRAMES = 128
"""Frames that usual figures rest on: two minutes give scales to 10 %, and follow a change within a few minutes."""


def frames_to_change(frames: int) -> int:
    """Return the frames until usual figures change, which do not depend on how samples are chunked.

    >>> [frames_to_change(frames) for frames in (0, 1, 2, 5, 127, 128, 200)]
    [1, 1, 2, 3, 1, 128, 56]
    """
    return min(1 << frames.bit_length(), (frames // MEMORY_FRAMES + 1) * MEMORY_FRAMES) - frames


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """Figures of some frames, in channel units, one row per frame.

    Attributes
    ----------
    mean : (k, c) about zero.
    rms : (k, c) deviation of the samples about the mean of the frame.
    parts : (k, c) deviation of the means of the parts about the mean of the frame.
    peak : (k, c) greatest distance of a sample from the mean of the frame.
    part_peak : (k, c) greatest distance of the mean of a part from the mean of the frame.
    white : (k, c) deviation that the mean of the frame has if its noise is white. The noise is that within the
        parts, or the difference of neighbouring parts if that is less: motion is slow and adds little to it.
    known : (k,) enough samples are valid.
    """

    mean: Floats
    rms: Floats
    parts: Floats
    peak: Floats
    part_peak: Floats
    white: Floats
    known: Bools

    def __getitem__(self, rows: slice | Bools) -> FrameStatistics:
        return FrameStatistics(*(getattr(self, name)[rows] for name in self.__slots__))

    @classmethod
    def joined(cls, frames: list[FrameStatistics]) -> FrameStatistics:
        """Return consecutive frames as one object."""
        return cls(*(np.concatenate([getattr(f, name) for f in frames]) for name in cls.__slots__))

    @classmethod
    def of(cls, d: Floats, usable: Bools | None, level: Floats) -> FrameStatistics:
        """Return the statistics of frames.

        Parameters
        ----------
        d : (c, k, PARTS, part) channel unit, distance from `level`; 0.0 if not usable.
        usable : (k, PARTS, part) samples that may be assessed; None: all.
        level : (c,) channel unit.
        """
        c, k, parts, part = d.shape
        size, within = parts * part, np.inf
        independent = min(size, INDEPENDENT_SAMPLES)
        if usable is None:
            means = (d.reshape(-1, part) @ np.full(part, 1.0 / part)).reshape(c, k, parts)
            mean = means.mean(axis=2)
            flat = d.reshape(c, k, size)
            square = np.einsum("ckf,ckf->ck", flat, flat) / size
            peak = np.maximum(flat.max(axis=2) - mean, mean - flat.min(axis=2))
            means -= mean[:, :, None]
            spread = np.einsum("ckp,ckp->ck", means, means) / parts
            part_peak = np.abs(means).max(axis=2)
            known = np.ones(k, dtype=bool)
            variance = square - mean**2
            steps = means[:, :, 1:] - means[:, :, :-1]
            between = np.einsum("ckp,ckp->ck", steps, steps) * (0.5 / (parts * (parts - 1)))
            if part > 1:
                within = (variance - spread) * (part / ((part - 1) * independent))
        else:
            count = usable.sum(axis=2)  # (k, PARTS)
            n = np.maximum(count.sum(axis=1), 1)
            filled = np.maximum((count > 0).sum(axis=1), 1)
            sums = d.sum(axis=3)
            mean = sums.sum(axis=2) / n
            square = np.einsum("ckpm,ckpm->ck", d, d) / n
            peak = (np.abs(d - mean[:, :, None, None]) * usable).max(axis=(2, 3))
            # A part with few samples scatters more: weighted so that full parts give the plain deviation.
            means = sums / np.maximum(count, 1) - mean[:, :, None]
            weighted = np.einsum("ckp,kp->ck", means * means, count)
            spread = weighted / (filled * part)
            part_peak = np.abs(means * np.sqrt(count / part)).max(axis=2)
            known = n >= LEAST_SHARE * size
            variance = square - mean**2
            left, right = count[:, :-1], count[:, 1:]
            weight = left * right / np.maximum(left + right, 1)
            steps = means[:, :, 1:] - means[:, :, :-1]
            squares = np.einsum("ckp,kp->ck", steps * steps, weight)
            between = _mean(squares, np.count_nonzero(weight, axis=1)) / size
            within = _mean(variance * n - weighted, n - filled) / independent
        variances = np.stack((variance, spread, np.minimum(between, within)))
        rms, deviation, white = np.sqrt(np.maximum(variances, 0.0))
        return cls((mean + level[:, None]).T, rms.T, deviation.T, peak.T, part_peak.T, white.T, known)


def _mean(sums: Floats, counts: Ints) -> Floats:
    """Return the mean of sums (c, k) over counts (k,); inf where nothing was counted."""
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.inf)
