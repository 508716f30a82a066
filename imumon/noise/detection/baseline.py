"""Baseline: the noise of a sensor at rest, learned robustly while it runs.

The detection of a knock requires the usual noise. Time is divided into *frames* of ten *parts*, about 1 s and
0.1 s. The baseline keeps five figures of every quiet frame and channel: the mean, the deviation of the samples
about it, that of the parts about it, the distance of the mean from the level (the median of the `LEVEL_FRAMES`
quiet frames before it), and what the mean would scatter by if the noise within 0.1 s were white. Medians over
the last `MEMORY_FRAMES` of them are the baseline: it does not move before half of those frames are disturbed.

The scales change at fixed frame numbers only (powers of two, then every `MEMORY_FRAMES`), so that decisions do
not depend on how the samples are chunked. As long as they rest on few frames, the thresholds are wider by the
uncertainty of the scales.

A record may begin in motion, and motion that lasts may be tried as a new baseline. The noise of the sensor itself
shows both: it is nearly white from 0.1 s on, so that its fast part predicts how much the means of neighbouring
frames differ, in any unit and for any quality of the sensor. Motion is slow, and they differ by more. Absolute
limits remain where this fails: coloured noise that is small is rest, and noise that no sensor has is motion.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from imumon.noise.array_state import ArrayState
from imumon.noise.detection.frame_statistics import (
    FIRST_FRAMES,
    MEMORY_FRAMES,
    PARTS,
    FrameStatistics,
    frames_to_change,
)
from imumon.noise.validity_groups import ROUNDING
from imumon.samples import Bools, Floats

LEVEL_FRAMES = 8
"""Frames that the level rests on: it must follow a random walk, and one disturbed frame must not move it."""

UNUSUAL_SIGMA = 7.0
"""Standard deviations of a sample, of the mean of a part, of that of a frame and of the logarithm of its deviation that
are unusual: 3e-12, less than one sample in a month at 800 Hz."""
LEAST_RATIO = 1.5
"""Factor by which the deviation of an unusual frame exceeds the usual one at least: less matters little."""

REST_LIMIT_GYRO = 1.5e-3
"""Rad/s, Allan deviation at 1 s up to which a gyroscope is at rest, whatever its spectrum: two to three times the
consumer grade. A parked car with its engine running stays below, a driven one does not."""
REST_LIMIT_ACCEL = 3e-2
"""M/s^2, the same limit of an accelerometer."""
REST_FACTOR = 2.2
"""Allan deviation at 1 s, over that predicted from the noise within 0.1 s, up to which a sensor is at rest too. It
is wider by n^-1/2 for n differences: 2.5 for three axes and `REST_FRAMES`, where a recorded hand exceeds 2.9."""
SHAKEN_FACTOR = 20.0
"""Factor on these limits above which a sensor is shaken, whatever its spectrum: 100 deg/sqrt(h) is no sensor."""
TURN_RATE = 0.1
"""Rad/s, length of the gyroscope's level above which it is turned: more than the bias of a sensor at rest.
Noise does not distinguish a steady turn from a bias."""
REST_FRAMES = 16
"""Last frames by which rest is assessed, or those of motion that are tried as a new baseline: enough for scales that
are right to 20 %."""

MAD_ERROR = 1.2
"""Relative standard error of a deviation from n median absolute distances, times sqrt(n)."""
MARGIN = 3.0
"""Standard errors of a scale, or of a count, by which its threshold is wider."""

MOST_SCATTER = 3.0
"""Factor by which the scatter of a scale may exceed that of white noise: beyond, disturbances are in it."""

COARSE_STEPS = 3.0
"""Quantisation steps that a channel may be off by which is mostly constant: its deviation is below a third of one."""


class NoiseBaseline(ArrayState):
    """Level and scales of each channel at rest.

    Parameters
    ----------
    sensors : (c,) sensor of each channel.
    frame : samples of a frame, a multiple of `PARTS`.

    Attributes
    ----------
    frames : quiet frames learned from, in all.
    stale : frames since the last quiet one.
    at_rest : whether the frames can be those of a sensor at rest.
    origin : (c,) channel unit, near the level: sums are relative to it and lose no digits.
    sample, part, shift : (c,) channel unit, thresholds for the distance of a sample from the mean of its
        frame, of a part from it, and of the mean of a frame from the level.
    """

    _STATE = (
        "_ring",
        "_recent_means",
        "_scale",
        "_scatter",
        "_step",
        "_limits",
        "origin",
        "sample",
        "part",
        "shift",
        "frames",
        "at_rest",
        "stale",
    )

    def __init__(self, sensors: tuple[str, ...], frame: int) -> None:
        c = len(sensors)
        limits = {"gyro": REST_LIMIT_GYRO, "accel": REST_LIMIT_ACCEL}
        self._frame = frame
        self._members = {name: [i for i, s in enumerate(sensors) if s == name] for name in sensors}
        self._axes = np.array([float(sensors.count(s)) for s in sensors])
        self._rest_limit = np.array([limits.get(s, np.inf) for s in sensors])
        # ring by frame number: mean, ln rms, ln parts, |mean - level|, white
        self._ring = np.full((MEMORY_FRAMES, 5, c), np.nan)
        self.frames = 0
        self.stale = 0
        self.at_rest = True
        self.origin = np.zeros(c)
        self._recent_means = np.zeros((LEVEL_FRAMES, c))  # newest first
        self._scale = np.zeros((2, c))  # ln rms, ln parts
        self._scatter = np.zeros((2, c))  # standard deviation of these
        self.sample = np.full(c, np.inf)
        self.part = np.full(c, np.inf)
        self.shift = np.full(c, np.inf)
        self._step = np.full(c, np.inf)  # least peak of a frame but 0: a step of a quantised channel
        self._limits = np.full((5, c), np.inf)

    @property
    def ready(self) -> bool:
        """Whether it has learned from enough quiet frames to assess others."""
        return bool(self.frames > 1)

    @property
    def next_change(self) -> int:
        """Frames until the scales change."""
        return frames_to_change(self.frames)

    @property
    def peak(self) -> Floats:
        """(c,) channel unit, greatest usual distance of a sample from the mean of its frame."""
        return np.asarray(self._limits[0])

    @property
    def level(self) -> Floats:
        """(c,) channel unit, median of the means of the last quiet frames."""
        return _median(self._recent_means[: min(self.frames, LEVEL_FRAMES)], self.origin)

    def _levels(self, means: Floats) -> Floats:
        """Return the level before each frame with the means (k, c), channel unit, if all were quiet."""
        k, before = len(means), min(self.frames, LEVEL_FRAMES)
        row = np.concatenate((self._recent_means[:before][::-1], means))
        if before == LEVEL_FRAMES:
            windows = row[np.arange(LEVEL_FRAMES)[:, None] + np.arange(k)]
            windows.sort(axis=0)
            middle = windows[(LEVEL_FRAMES - 1) // 2] + windows[LEVEL_FRAMES // 2]
            return np.asarray(0.5 * middle, dtype=np.float64)
        spans = [row[max(0, before + i - LEVEL_FRAMES) : before + i] for i in range(k)]
        return np.stack([_median(span, self.origin) for span in spans])

    def add(self, quiet: FrameStatistics) -> None:
        """Learn from quiet frames, all of them known."""
        step = self.next_change
        if len(quiet.mean) > step:
            self.add(quiet[:step])
            self.add(quiet[step:])
            return
        k = len(quiet.mean)
        if not k:
            return
        self._update_step(quiet)
        tiny = np.finfo(np.float64).tiny
        ring, at = self._ring, (self.frames + np.arange(k)) % MEMORY_FRAMES
        ring[at, 0] = quiet.mean
        ring[at, 1] = np.log(np.maximum(quiet.rms, tiny))
        ring[at, 2] = np.log(np.maximum(quiet.parts, tiny))
        ring[at, 3] = np.abs(quiet.mean - self._levels(quiet.mean))
        ring[at, 4] = quiet.white
        if not self.frames:
            ring[0, 3] = np.nan
        newest = quiet.mean[::-1][:LEVEL_FRAMES]
        self._recent_means = np.concatenate((newest, self._recent_means))[:LEVEL_FRAMES]
        self.stale = 0
        self.frames += k
        if k == step:
            self._update_scales()

    def skip(self, frames: int) -> None:
        """Note that `frames` frames were disturbed or missing: the level may have moved."""
        self.stale += frames

    def unusual(self, frames: FrameStatistics) -> Bools:
        """Return (k, c) the frames that are not the noise of this sensor."""
        self._update_step(frames)
        if not self.ready:
            return np.zeros(frames.mean.shape, dtype=bool)
        peak, part_peak, _, rms, parts = self._limits
        unusual = self.moved(frames)
        unusual |= (frames.peak > peak) | (frames.part_peak > part_peak)
        unusual |= (frames.rms > rms) | (frames.parts > parts)
        return np.asarray(unusual & frames.known[:, None], dtype=bool)

    def moved(self, frames: FrameStatistics) -> Bools:
        """Return (k, c) the frames whose mean is not at the level."""
        # a random walk continues during the frames that were not learned from
        shift = self._limits[2] * np.sqrt(1.0 + self.stale / LEVEL_FRAMES)
        return np.asarray(np.abs(frames.mean - self._levels(frames.mean)) > shift)

    def _update_step(self, frames: FrameStatistics) -> None:
        """Note the least step that a channel makes."""
        least = np.where(frames.peak > 0.0, frames.peak, np.inf).min(axis=0, initial=np.inf)
        np.minimum(self._step, least, out=self._step)

    def _update_scales(self) -> None:
        """Recompute scales and thresholds from the frames in the ring."""
        n = min(self.frames, MEMORY_FRAMES)
        self.origin = self.level
        logs = self._ring[:n, 1:3]
        self._scale = _median(logs, self._scale)
        floor = np.array([[(2.0 * self._frame) ** -0.5], [(2.0 * PARTS - 2.0) ** -0.5]])
        scatter = gaussian_deviation(_median(np.abs(logs - self._scale), np.zeros_like(self._scale)))
        self._scatter = np.minimum(np.maximum(scatter, floor), MOST_SCATTER * floor)
        wider = 1.0 + MARGIN * self._scatter * np.sqrt(0.5 * np.pi / n)  # of a median
        rms, parts = np.exp(self._scale)
        self.sample = UNUSUAL_SIGMA * wider[0] * rms
        self.part = UNUSUAL_SIGMA * wider[1] * parts
        shift = gaussian_deviation(_median(self._ring[:n, 3], np.zeros_like(rms)))
        # The mean of a frame scatters at least as white noise of the parts would. With few distances, the
        # scatter of the parts is the least that is assumed.
        shift = np.maximum(shift, parts / np.sqrt(PARTS)) * (1.0 + MARGIN * MAD_ERROR / np.sqrt(n))
        self.shift = UNUSUAL_SIGMA * (shift if n > LEVEL_FRAMES else np.maximum(parts, shift))
        # a constant channel differs from its level by rounding
        for limit in (self.sample, self.part, self.shift):
            np.maximum(limit, ROUNDING * np.abs(self.origin), out=limit)
        self._limits = self._thresholds()
        self.at_rest = self._is_rest(n)

    def _thresholds(self) -> Floats:
        """Return (5, c) thresholds for peak, part_peak, distance of the mean, rms and parts."""
        wider = np.maximum(UNUSUAL_SIGMA * self._scatter, np.log(LEAST_RATIO))
        limits = np.stack((self.sample, self.part, self.shift, *np.exp(self._scale + wider)))
        # A single step is no knock of a channel that is mostly constant.
        coarse = COARSE_STEPS * np.exp(self._scale[0]) < self._step
        allowed = np.array([COARSE_STEPS, COARSE_STEPS, COARSE_STEPS, 1.0, 1.0])
        steps = allowed[:, None] * np.where(coarse, self._step, 0.0)
        return np.asarray(np.maximum(np.maximum(limits, steps), ROUNDING * np.abs(self.origin)))

    def _is_rest(self, n: int) -> bool:
        """Return whether the last of `n` frames can be rest: squares are averaged over the axes of a sensor."""
        if float(np.linalg.norm(self.level[self._members.get("gyro", [])])) > TURN_RATE:
            return False
        k = min(n, REST_FRAMES)
        if k < FIRST_FRAMES:
            return True
        rows = self._ring[(self.frames - k + np.arange(k)) % MEMORY_FRAMES]
        step = np.sqrt(0.5 * np.mean(np.diff(rows[:, 0], axis=0) ** 2, axis=0))  # Allan deviation at 1 s
        white = _median(rows[:, 4], np.zeros(rows.shape[2]))
        factor = REST_FACTOR * (1.0 + ((k - 1) * self._axes) ** -0.5)
        limit = np.maximum(self._rest_limit, factor * white)
        excess = (step / np.minimum(limit, SHAKEN_FACTOR * self._rest_limit)) ** 2
        return all(float(excess[axes].mean()) <= 1.0 for axes in self._members.values())


def gaussian_deviation(median: Floats) -> Floats:
    """Return the standard deviation of Gaussians whose median absolute deviation is given."""
    return np.asarray(median / ndtri(0.75))


def _median(rows: Floats, otherwise: Floats) -> Floats:
    """Return the median of the finite numbers over the first axis, or `otherwise` without any.

    numpy's nanmedian takes fifty times as long on a few rows.
    """
    if not len(rows):
        return otherwise
    rows = np.sort(rows, axis=0)  # NaN last
    if not np.isnan(rows[-1]).any():
        return np.asarray(0.5 * (rows[(len(rows) - 1) // 2] + rows[len(rows) // 2]), dtype=np.float64)
    count = np.isfinite(rows).sum(axis=0)
    low = np.take_along_axis(rows, np.maximum((count - 1) // 2, 0)[None], axis=0)[0]
    high = np.take_along_axis(rows, np.minimum(count // 2, len(rows) - 1)[None], axis=0)[0]
    return np.where(count > 0, 0.5 * (low + high), otherwise)
