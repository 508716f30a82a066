"""Outliers: single samples of one sensor that are far from the others.

A bit error or a coarse converter gives single samples of many standard deviations. Each of them is excluded alone, on
its sensor and without margins: the samples beside it are good. What is far and not single is a knock, which
`disturbance` excludes with margins and on both sensors.

Which samples are far
---------------------
The scale is that of the frame itself, 1.48 median |x - median| (Hampel, J. Am. Stat. Assoc. 69, 1974), because the
usual deviation contains the outliers: with 5 % of ten sigma it is 2.4 times too large, and most outliers would hide
behind it. Far is 7 of these (`baseline.UNUSUAL_SIGMA`) from the *middle* of the frame, the median of the means
of its parts.

Which far samples are single
----------------------------
Let q be the share of samples of a sensor with an outlier so far. What chance alone does not explain is a knock:

    a run           r outliers within 2 r - 1 samples, with q^r < 1.3e-12, and r = 3 where outliers are rare
    a coincidence   outliers of gyroscope and accelerometer beside each other: independent faults of two sensors
                    rarely meet, but a knock shows in both
    a burst         more noise beside a far sample than in the rest of its frame

Which channels have outliers as noise
-------------------------------------
    state    event                                                               next state
    rare     more than 1 % of its samples, and three standard errors of it, are outliers    noise
    noise    they are fewer again                                                rare
    any      as many frames end just short of far as have an outlier             tails, for the record

Tails are the other sign of noise. A bit error has any size, but noise with heavy tails has the more samples the nearer
they are: where the largest sample of a frame is often just short of far, the far ones are the continuation of the same
noise, and without them N would be that of a sensor with other noise. They stay up to `TAIL_REACH` times the limit.

Outliers of a channel are excluded while they are rare. If they are its noise they stay, and the statistics
then describe what the sensor really gives. Counts fade: they halve when they are of 128 frames, which is after the
first 128 and every 64 from there on, so that they rest on 64 to 128 frames. They are compared after every frame, so
that the decision is a function of the samples alone and not of their division into blocks. Before it, at most 1 % and
three standard errors of the counted samples are excluded; they stay excluded. Where outliers are noise, N may be as
large as with them, so that the sum of their squares is kept (`excluded_squares`).

Example: ten parts of ten samples; one bit error is single, five in a row are a knock.

>>> detector = OutlierDetector([0], frame_samples=100)
>>> frame = np.random.default_rng(1).standard_normal((1, 1, PARTS, 10))
>>> frame[0, 0, 4, 2], usable = 50.0, np.ones((1, PARTS, 10), dtype=bool)
>>> np.argwhere(detector.search(frame, usable, limit_of_samples(frame, usable))).tolist()
[[0, 0, 4, 2]]
>>> frame[0, 0, 4, 2:7] = 50.0
>>> detector.search(frame, usable, limit_of_samples(frame, usable)) is None
True
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import fdtri

from imumon.model.samples import Bools, Floats, Ints
from imumon.model.saved_state import restorable
from imumon.noise.detection.baseline import (
    ERROR_MARGIN,
    MEMORY_FRAMES,
    PARTS,
    UNUSUAL_SIGMA,
    gaussian_deviation,
)
from imumon.noise.detection.stuck import UNUSUAL_CHANCE, run_beyond_chance

TAIL_REACH = 5.0
"""Farther samples are excluded also where the tails are heavy. Unit: limits of an outlier.

Otherwise: one bit error of 1 rad/s triples N of a sensor with heavy tails. Origin: 35 standard deviations: beyond,
t(4) has 0.3 % of its variance; t(3), whose N no record shows, has 12 % (`sample_errors.py`).
"""

OUTLIER_NOISE_SHARE = 0.01
"""Above, its outliers are its noise and stay in the statistics. Unit: of the samples of a channel.

Otherwise: N of a sensor with heavy tails is that of its best samples, several times too small. Chosen: an error of
the transmission is rarer; 1 % of ten sigma doubles N^2 (`test_outliers.py`).
"""
NOISY_CHANCE = 3e-4
"""A far sample is a knock, and no outlier, if chance makes as much noise beside it in this share of frames. Unit:
probability.

Otherwise: of a burst only the tallest samples are excluded: N is 0.3 % too high with one of five sigma a minute.
Origin: a quarter of what stays of bursts of 0.1 to 1 s without it stays; with 1e-3 a twentieth, but one single
outlier of a hundred of a coarse axis is a knock (`sample_errors.py`).
"""
TAIL_BEGIN = 6.0 / UNUSUAL_SIGMA
"""A frame whose largest sample is between here and the limit counts as one with a tail. Unit: of the limit of an
outlier.

Otherwise: nearer to the noise, Gaussian samples count: 6e-7 of them exceed 5 standard deviations. Origin: 6 standard
deviations: in a day at 800 Hz, Gaussian noise has 0.1 such samples (`sample_errors.py`).
"""
TAIL_SHARE = 0.3
"""From here on, frames with a tail show that the outliers of the channel are its noise, and they stay. Unit: of the
frames with an outlier.

Otherwise: N of noise with the tails of Student's t(3) is 11 % low, and no limit holds. Origin: t(3) has 0.6, t(4)
0.9; half a per cent of ten deviations has 0.13, bit errors of any size 0 (`sample_errors.py`).
"""
LEAST_TAIL_FRAMES = 10
"""Frames with a tail, and frames with an outlier, that a channel with heavy tails has at least. Unit: frames.

Otherwise: bit errors of nine deviations, of which a tenth falls short of the limit, count as noise by chance. Origin:
with a share of a tenth, 33 outliers have ten such frames in 0.2 % of records (`sample_errors.py`).
"""
KNOCK_SAMPLES = 3
"""This many outliers in a row, or nearly, are a knock where outliers are rare; so are those of gyroscope and
accelerometer within as many, unless both have many. Unit: samples.

Otherwise: a knock is excluded sample by sample, without margins and on one sensor, and the ringing of a short one
stays. Origin: a bit error changes no three samples in a row (`test_guard.py`); the filters of two sensors delay by
different times, a sample to each side (`test_outliers.py`).
"""


@restorable
class OutlierDetector:
    """Find the outliers of the sensors on one table, and decide which channels have them as noise.

    Parameters
    ----------
    groups : (c,) group of each channel.
    frame_samples : samples of a frame.

    Attributes
    ----------
    noise : (c,) channels whose outliers are noise, because there are many.
    tails : (c,) channels whose outliers are the end of heavy tails.
    excluded_squares : (c,) (channel unit)^2, sum over the outliers that were excluded, none beyond the reach of a tail.
    """

    def __init__(self, groups: list[int], frame_samples: int) -> None:
        names = list(dict.fromkeys(groups))
        self._members = [[c for c, group in enumerate(groups) if group == name] for name in names]
        self._frame_samples = frame_samples
        self._channel_counts = np.zeros(len(groups))  # outliers of each channel
        self._sensor_counts = np.zeros(len(names))  # samples of each sensor with an outlier
        self._frames = np.zeros(1, dtype=np.int64)  # frames in which they were counted
        self.noise = np.zeros(len(groups), dtype=bool)
        # frames whose largest sample is just short of far, and frames with an outlier
        self._tail_frames = np.zeros((2, len(groups)), dtype=np.int64)
        self.tails = np.zeros(len(groups), dtype=bool)
        self.excluded_squares = np.zeros(len(groups))

    def search(self, distance: Floats, usable: Bools, limit: Floats) -> Bools | None:
        """Return (c, k, PARTS, part) the outliers of frames; None: no sample is far, or the far ones are a knock.

        Parameters
        ----------
        distance : (c, k, PARTS, part) channel unit, from any origin.
        usable : (k, PARTS, part) samples that may be assessed.
        limit : (c,) channel unit, from where on a sample is far from the middle of its frame.
        """
        size = np.abs(distance - _middle(distance, usable)[:, :, None, None])
        far = size > limit[:, None, None, None]
        far &= usable
        if not far.any() or self._are_together(far):
            return None
        rare = ~(self.noise | self.tails)  # where outliers are noise, so is what is just short of them
        return None if _noisy_beside(size[rare], usable, far[rare]) else far

    def _are_together(self, far: Bools) -> bool:
        """Return whether far samples (c, k, PARTS, part) are a knock: a run, or in both sensors at once."""
        shares = self._sensor_counts / max(int(self._frames[0]) * self._frame_samples, 1)
        # An axis that is far makes its sensor far: a transmission error changes one axis or all of them.
        sensors = [far[members].any(axis=0).reshape(-1) for members in self._members]
        for sensor_far, share in zip(sensors, shares.tolist(), strict=True):
            run = run_beyond_chance(share, KNOCK_SAMPLES)
            # A ringing knock crosses zero, so that only every other sample of a run is far. Sums of zeros and ones
            # are whole numbers, so half a sample below decides like "at least".
            window = np.ones(min(2 * run - 1, len(sensor_far)))
            if np.convolve(sensor_far, window).max() > run - 0.5:
                return True
        return len(sensors) > 1 and self._coincide(sensors, shares)

    def _coincide(self, sensors: list[Bools], shares: Floats) -> bool:
        """Return whether far samples (n,) of all sensors meet more often than by chance.

        Parameters
        ----------
        shares : (sensors,) share of samples with an outlier so far.
        """
        window = np.ones(KNOCK_SAMPLES)
        near = np.logical_and.reduce([np.convolve(far, window, "same") > 0.5 for far in sensors])
        # By chance, a sample is near to outliers of both sensors with (3 q1)(3 q2) = 9 q1 q2. The square of 3 on each
        # share makes 81 q1 q2, because one pair in the same sample is near in three samples and enters
        # below with the third power: it is a knock while both shares are below 0.12 %; a pair of neighbours, near in
        # two, below 0.012 %. Where a sensor had no outlier before, any pair is one.
        chance = float(np.prod(np.minimum(KNOCK_SAMPLES**2 * shares, 1.0)))
        return bool(near.any()) and (chance <= 0.0 or chance ** int(near.sum()) < UNUSUAL_CHANCE)

    def count(self, outliers: Bools | None, frames: int) -> None:
        """Count the outliers (c, k, PARTS, part) of some frames, None: none; then decide what is noise."""
        if outliers is not None:
            self._channel_counts += outliers.sum(axis=(1, 2, 3))
            self._sensor_counts += [outliers[members].any(axis=0).sum() for members in self._members]
        while frames:
            until_halved = min(frames, MEMORY_FRAMES - int(self._frames[0]))
            self._frames += until_halved
            frames -= until_halved
            if self._frames[0] >= MEMORY_FRAMES:
                self._frames //= 2
                self._channel_counts *= 0.5
                self._sensor_counts *= 0.5
        self._decide_noise()

    def count_tails(self, peaks: Floats, limit: Floats, outliers: Bools | None) -> None:
        """Count frames at the end of the usual noise and beyond, and decide which channels have heavy tails.

        Parameters
        ----------
        peaks : (k, c) channel unit, largest distance of a sample in each frame, without its outliers.
        limit : (c,) channel unit, from where on a sample is far.
        outliers : (c, k, PARTS, part) of the frames; None: there are none.
        """
        self._tail_frames[0] += ((peaks > TAIL_BEGIN * limit) & (peaks <= limit)).sum(axis=0)
        if outliers is not None:
            self._tail_frames[1] += outliers.any(axis=(2, 3)).sum(axis=1)
            short, beyond = self._tail_frames
            enough = np.minimum(short, beyond) >= LEAST_TAIL_FRAMES
            self.tails |= enough & (short >= TAIL_SHARE * beyond)

    def _decide_noise(self) -> None:
        """Decide which channels have outliers as noise: the transitions between rare and noise."""
        n = float(self._frames[0]) * self._frame_samples
        # The standard error of a count is its root (Poisson): without it, the first outlier of a record is noise.
        most = OUTLIER_NOISE_SHARE * n + ERROR_MARGIN * math.sqrt(OUTLIER_NOISE_SHARE * n)
        self.noise = self._channel_counts > most


def _middle(distance: Floats, usable: Bools) -> Floats:
    """Return (c, k) the median of the means of the parts of each frame, which no single sample moves."""
    count = usable.sum(axis=2)
    means = np.where(count > 0, (distance * usable).sum(axis=3) / np.maximum(count, 1), np.inf)
    filled = (count > 0).sum(axis=1)
    ordered = np.sort(means, axis=2)  # parts without a sample come last
    frames: Ints = np.arange(distance.shape[1])
    low, high = np.maximum(filled - 1, 0) // 2, np.minimum(filled // 2, PARTS - 1)
    middle = 0.5 * (ordered[:, frames, low] + ordered[:, frames, high])
    return np.where(np.isfinite(middle), middle, 0.0)  # a frame without any sample has no outlier either


def _noisy_beside(size: Floats, usable: Bools, far: Bools) -> bool:
    """Return whether the samples beside a far one have more noise than the others of their frame.

    A burst of noise is far at its tallest samples only. Beside is what lies in the same part and in the parts next to
    it. Of normal noise, the ratio of the mean squares has an F distribution, and the square of that of the mean sizes
    nearly the same. Both count: tails widen the one, coarse steps the other.

    Parameters
    ----------
    size, usable, far : (c, k, PARTS, part) channel unit, distance from the middle; see `OutlierDetector.search`.
    """
    channels = np.flatnonzero(far.any(axis=(1, 2, 3)))
    near = ~far[channels] & usable
    count, sizes = near.sum(axis=3), np.where(near, size[channels], 0.0)
    number, others = _beside_and_rest(count)
    judged = far[channels].any(axis=3) & (number > 0.0) & (others > 0.0)
    most = fdtri(number[judged], others[judged], 1.0 - NOISY_CHANCE)
    noisy = np.ones(most.size, dtype=bool)
    for power in (1, 2):
        beside, rest = (total[judged] for total in _beside_and_rest((sizes**power).sum(axis=3)))
        noisy &= (beside * others[judged]) ** (2 / power) > most * (rest * number[judged]) ** (2 / power)
    return bool(noisy.any())


def _beside_and_rest(parts: Floats | Ints) -> tuple[Floats, Floats]:
    """Return (c, k, PARTS) the sums of each part and the parts beside it, and those of the rest of the frame."""
    padded = np.pad(parts.astype(np.float64), ((0, 0), (0, 0), (1, 1)))
    beside = padded[:, :, :-2] + padded[:, :, 1:-1] + padded[:, :, 2:]
    return beside, padded.sum(axis=2, keepdims=True) - beside


def limit_of_samples(distance: Floats, usable: Bools) -> Floats:
    """Return (c,) the distance of an outlier, channel unit, by the samples (c, k, PARTS, part) themselves.

    inf if fewer than `PARTS` samples are usable: their scatter says nothing, so that none of them is an outlier.
    """
    samples = distance[:, usable]
    if samples.shape[1] < PARTS:
        return np.full(len(distance), np.inf)
    median = np.median(samples, axis=1, keepdims=True)
    scale = gaussian_deviation(np.median(np.abs(samples - median), axis=1))
    # Most values of a coarse channel are equal, and their median distance is 0: without the deviation, every step
    # of it would be an outlier.
    scale = np.where(scale > 0.0, scale, samples.std(axis=1))
    return np.asarray(UNUSUAL_SIGMA * scale)
