"""Baseline: the noise of a sensor at rest, learned robustly while it runs.

A knock is what differs from the usual noise, so the usual noise must be known, for a sensor of any quality, within
seconds, and although some of the samples that it is learned from are disturbed.

Frames
------
Time is divided into *frames* of ten *parts*, about 1 s and 0.1 s. Of n samples x in p = 10 parts with means m_j, a
frame keeps five figures of each channel (`FrameStatistics`):

    mean       m = mean of x
    rms        s, s^2 = mean of (x - m)^2                        noise of single samples
    part_rms   s_p, s_p^2 = mean of (m_j - m)^2                  noise of 0.1 s
    peaks      largest |x - m| and |m_j - m|
    white      w, what m scatters by if the noise is white; w^2 is the lesser of two estimates:
                 within the parts     (s^2 - s_p^2) · q/(q-1) / min(n, 100), of q = n/p samples each
                 between neighbours   mean of (m_j+1 - m_j)^2 / 2 / p      (von Neumann, Ann. Math. Stat. 12, 1941)

Motion is slow. It adds little to either estimate, but much to what the means of frames really scatter by.

Usual noise
-----------
The memory keeps these figures of the last 128 quiet frames, and the distance of each mean from the *level*: the
median of the means of the eight quiet frames before. Medians over the memory are the baseline; they do not move
before half of the frames are disturbed. Deviations are compared as logarithms, because ln s of n Gaussian samples has
a standard deviation of (2 n)^-1/2 whatever s is. The scatter of a median absolute deviation d is d / 0.6745 (Hampel,
J. Am. Stat. Assoc. 69, 1974). A frame is unusual if, with 7 sigma (`UNUSUAL_SIGMA`),

    a peak         > 7 · usual deviation · (1 + 3 standard errors of it)
    |m - level|    > 7 · usual distance · (1 + 3 standard errors), at least that of white noise
    ln s, ln s_p   > usual + max(7 · scatter, ln 1.5)

The standard error of the median of n logarithms is scatter · sqrt(pi / 2 n).

An axis without noise within its frames, because it is constant or updated once a second, is *silent*: it has no usual
noise, nothing of it is unusual, and it has no part in rest and motion (`NoiseBaseline._silent`).

    frames learned from    what is known
    0, 1                   nothing: no frame is unusual
    2, 3                   thresholds, wide; rest is not doubted yet
    4 to 8                 the last ones are rest or motion; few distances from the level: the parts stand in for them
    16, 32, 64, 128, ...   thresholds change (at powers of two, then every 128 frames), so that decisions do not
                           depend on how the samples are divided into blocks

Rest
----
A record may begin in motion, and motion that lasts may be tried as a new baseline. The noise of the sensor itself shows
both: it is nearly white from 0.1 s on, so w predicts how much the means of neighbouring frames differ, their Allan
deviation at 1 s (IEEE Std 952), in any unit and for any quality of the sensor. Motion exceeds w by more than a factor
of 2.2. Absolute limits remain where this fails: coloured noise that is small is rest, and noise that no sensor has is
motion, as is a level of the gyroscope that no bias has.

Example: 64 frames of white noise, sigma = 1, of a hundred samples. Single samples may be 7 sigma off, wider by the
error of the scale. The mean of a frame scatters by 0.1, so it may be 0.7 off, wider by 45 %, the error of 64 distances,
and by what the level itself scatters. A knock of 3 sigma that lasts shows in no sample, but in the mean.

>>> noise = np.random.default_rng(1).standard_normal((1, 64, PARTS, 10))  # channels, frames, parts, samples
>>> usual = NoiseBaseline(("mag",), frame_samples=100)
>>> usable = np.ones(noise.shape[1:], dtype=bool)
>>> usual.add(FrameStatistics.of(noise, usable, usual.origin))
>>> float(usual.usual_sample[0].round(1)), float(usual.usual_level[0].round(1))
(7.2, 1.2)
>>> knock = FrameStatistics.of(noise[:, :1] + 3.0, usable[:1], np.zeros(1))
>>> bool(knock.peak[0, 0] > usual.usual_sample[0]), usual.moved(knock).tolist()
(False, [[True]])
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from imumon.model.samples import Bools, Floats, Ints
from imumon.model.saved_state import restorable
from imumon.noise.validity_groups import LEAST_SHARE, ROUNDING

PARTS = 10
"""A part, about 0.1 s, is the shortest time that is excluded with margins; ten of them are a frame. Unit: parts of
a frame.

Otherwise: one knock of 20 ms costs a whole second, or every sample needs a threshold of its own. Origin: a knock on a
table rings for about 0.1 s; ten means give their deviation to 24 %.
"""
INDEPENDENT_SAMPLES = 100
"""How many samples of a frame count as independent, at most, in the noise that its mean must have. Unit: samples of
a frame.

Otherwise: behind the filter of a sensor, neighbouring samples are alike: rest at 400 Hz counts as motion. Origin: a
filter that ends at 50 Hz leaves 2 · 50 Hz · 1 s of them (Nyquist) (`test_guard_motion.py`).
"""
FIRST_FRAMES = 4
"""The first frames of a record are assessed together, and rest is not doubted before. Unit: frames.

Otherwise: a record that begins with a knock takes the knock for its usual noise. Origin: one of four may be
disturbed, and the median of the others still shows the noise (`test_guard.py`).
"""
LEVEL_FRAMES = 8
"""The level of a channel is the median of the means of the last quiet frames. Unit: frames.

Otherwise: a longer memory calls the random walk of a bias a knock; a shorter one follows a single bad frame. Origin:
a median of eight is moved by no three of them, and a random walk goes sqrt(8) steps in that time.
"""
MEMORY_FRAMES = 128
"""Usual noise is that of the last 128 quiet frames; counts of repeats halve every 128, of outliers at 128. Unit:
frames.

Otherwise: no noise that changes would become usual, or the usual noise itself would be uncertain. Origin: two
minutes: the median of 128 deviations is right to 10 %, and half of them may be disturbed.
"""
UNUSUAL_SIGMA = 7.0
"""A sample, a mean or the logarithm of a deviation farther off is not usual; it also sets UNUSUAL_CHANCE. Unit:
sigma.

Otherwise: at 5 sigma, noise is excluded every hour; at 10, a knock of the size of the noise stays. Origin: chosen
between the two; Gaussian noise exceeds it with 3e-12: less than one sample in a month at 800 Hz.
"""
LEAST_UNUSUAL_RATIO = 1.5
"""A frame is not unusual by its deviation before it exceeds this. Unit: times the usual deviation.

Otherwise: at high rates, deviations scatter by 1 %, and every harmless change of the noise is excluded. Origin: 1.5
times for one second adds 7e-6 to N of a day: less matters little.
"""
ERROR_MARGIN = 3.0
"""How much wider a threshold is while its scale, or a count, is uncertain itself. Unit: standard errors.

Otherwise: thresholds from the first frames are too narrow by chance, and exclude noise. Origin: Gaussian: one of 700
scales is farther off (`test_guard_motion.py`).
"""
MAD_ERROR = 1.2
"""How uncertain a deviation is that rests on n median absolute distances. Unit: relative standard error times
sqrt(n).

Otherwise: see ERROR_MARGIN. Origin: 1 / sqrt(2 · 0.37): the efficiency is 37 % (Rousseeuw and Croux, J. Am. Stat.
Assoc. 88, 1993) (`test_guard_motion.py`).
"""
MOST_SCATTER = 3.0
"""The logarithms of deviations scatter from frame to frame; more than this does not widen their thresholds. Unit:
times the scatter of white noise.

Otherwise: knock after knock widens the thresholds until knocks are usual. Chosen: flicker noise and drift scatter
less, and half of the frames disturbed scatter more (`test_guard_reasons.py`).
"""
COARSE_STEPS = 3.0
"""A channel that is mostly constant may be off by this; its sigma is less than a third of a step. Unit:
quantisation steps.

Otherwise: every step of a coarse channel is more than 7 sigma and is excluded as a knock. Chosen: one step of noise
to each side, and one of drift (`test_guard.py`).
"""
READY_FRAMES = 2
"""With fewer, the usual noise is unknown, and nothing is unusual. Unit: quiet frames.

Otherwise: the second frame of a record is compared with a single one. Origin: a scatter needs two (`test_guard.py`).
"""
REST_FRAMES = 16
"""Rest is judged by the last ones; as many at a new level or with a new noise are tried as the baseline. Unit:
frames.

Otherwise: a tilted table or a started engine stays excluded for all time. Origin: scales from sixteen frames are
right to 20 % (`test_guard.py`).
"""
REST_FACTOR = 2.2
"""Up to this Allan deviation of the frames, noise of any size is rest. Unit: times the deviation that white noise
predicts.

Otherwise: the noise of a cheap sensor, 1 to 5 deg/s, is motion. Origin: 2.5 for three axes and sixteen frames, wider
by n^-1/2 for n differences; a recorded hand exceeds 2.9.
"""
REST_LIMIT_GYRO = 1.5e-3
"""Up to this, a gyroscope is at rest, whatever its spectrum. Unit: rad/s, Allan deviation at 1 s.

Otherwise: flicker noise above the white noise, or a running engine, is motion. Origin: two to three times the
consumer grade; a parked car with its engine running stays below, a drive does not.
"""
REST_LIMIT_ACCEL = 3e-2
"""The same for an accelerometer. Unit: m/s^2, Allan deviation at 1 s.

Otherwise: see REST_LIMIT_GYRO. Origin: see REST_LIMIT_GYRO.
"""
SHAKEN_FACTOR = 20.0
"""Above this Allan deviation at 1 s, a sensor is shaken, whatever its spectrum. Unit: times REST_LIMIT_GYRO and
REST_LIMIT_ACCEL.

Otherwise: a shaker or a drone, whose motion is white, is rest. Chosen: 0.03 rad/s, 100 deg/sqrt(h), is more than the
noise of any sensor (`test_guard_motion.py`).
"""
TURN_RATE = 0.1
"""Above, it is turned. Unit: rad/s, length of the level of a gyroscope.

Otherwise: a steady turn is rest: noise does not distinguish it from a bias. Origin: more than the bias of a sensor:
5.7 deg/s (`test_guard.py`).
"""

# ---------------------------------------------------------------------- frames


def frames_to_change(frames: int) -> int:
    """Return the frames until usual figures change: at powers of two, then every `MEMORY_FRAMES`.

    A fixed schedule makes decisions independent of how the samples are divided into blocks.

    >>> [frames_to_change(frames) for frames in (0, 1, 2, 5, 127, 128, 200)]
    [1, 1, 2, 3, 1, 128, 56]
    """
    return min(1 << frames.bit_length(), (frames // MEMORY_FRAMES + 1) * MEMORY_FRAMES) - frames


@restorable
@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """Figures of some frames, in channel units, one row per frame.

    Attributes
    ----------
    mean : (k, c) about zero.
    rms : (k, c) deviation of the samples about the mean of the frame.
    part_rms : (k, c) deviation of the means of the parts about the mean of the frame.
    peak : (k, c) largest distance of a sample from the mean of the frame.
    part_peak : (k, c) largest distance of the mean of a part from the mean of the frame.
    white : (k, c) deviation that the mean of the frame has if its noise is white; inf if no part has two samples and
        no two neighbouring parts have any.
    known : (k,) enough samples are usable. The figures of other frames mean nothing.
    """

    mean: Floats
    rms: Floats
    part_rms: Floats
    peak: Floats
    part_peak: Floats
    white: Floats
    known: Bools

    def __getitem__(self, frames: slice | Bools) -> FrameStatistics:
        return FrameStatistics(*(getattr(self, name)[frames] for name in self.__slots__))

    @classmethod
    def joined(cls, frames: list[FrameStatistics]) -> FrameStatistics:
        """Return consecutive frames as one object."""
        return cls(*(np.concatenate([getattr(f, name) for f in frames]) for name in cls.__slots__))

    @classmethod
    def of(cls, distance: Floats, usable: Bools, origin: Floats) -> FrameStatistics:
        """Return the statistics of frames; see the formulas at the top of the file.

        Parameters
        ----------
        distance : (c, k, PARTS, part) channel unit, samples less `origin`; 0.0 if not usable.
        usable : (k, PARTS, part) samples that may be assessed.
        origin : (c,) channel unit, near the level: sums of squares lose no digits to a large level.
        """
        parts, part = distance.shape[2:]
        size = parts * part
        count = usable.sum(axis=2)  # (k, PARTS)
        n = np.maximum(count.sum(axis=1), 1)
        filled = np.maximum((count > 0).sum(axis=1), 1)
        # a product with a vector adds along the last axis faster than `sum` does
        sums = (distance.reshape(-1, part) @ np.ones(part)).reshape(distance.shape[:3])
        mean = sums.sum(axis=2) / n
        square = np.einsum("ckpm,ckpm->ck", distance, distance) / n
        # nearly always every sample is usable
        seen = distance if (n == size).all() else np.where(usable, distance, mean[:, :, None, None])
        peak = np.maximum(seen.max(axis=(2, 3)) - mean, mean - seen.min(axis=(2, 3)))
        # A part with few samples scatters more: weighted so that full parts give the plain deviation.
        means = sums / np.maximum(count, 1) - mean[:, :, None]
        weighted = np.einsum("ckp,kp->ck", means * means, count)
        spread = weighted / (filled * part)
        part_peak = np.abs(means * np.sqrt(count / part)).max(axis=2)
        variance = square - mean**2
        # The difference of two means of l and r samples has the variance s^2 (1/l + 1/r): its square times
        # l r / (l + r) estimates s^2, and an empty part has no weight.
        left, right = count[:, :-1], count[:, 1:]
        weight = left * right / np.maximum(left + right, 1)
        squares = np.einsum("ckp,kp->ck", np.diff(means) ** 2, weight)
        between = _mean_or_inf(squares, np.count_nonzero(weight, axis=1)) / size
        # at 10 Hz and below, a part is one sample, and nothing is within it
        within = _mean_or_inf(variance * n - weighted, n - filled) / min(size, INDEPENDENT_SAMPLES)
        # A variance is a difference of sums: rounding makes it less than zero where a channel is constant.
        variances = np.stack((variance, spread, np.minimum(between, within)))
        rms, part_rms, white = np.sqrt(np.maximum(variances, 0.0))
        level, known = mean + origin[:, None], n >= LEAST_SHARE * size
        return cls(level.T, rms.T, part_rms.T, peak.T, part_peak.T, white.T, known)


def _mean_or_inf(sums: Floats, counts: Ints) -> Floats:
    """Return the mean of sums (c, k) over counts (k,); inf where nothing was counted, so that a minimum ignores it."""
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.inf)


# ---------------------------------------------------------------------- usual noise

LIMITED = ("peak", "part_peak", "rms", "part_rms")
"""Figures of a frame that have a limit of their own; its mean has one by the level."""


@restorable
class NoiseBaseline:
    """Level and scales of each channel at rest.

    Parameters
    ----------
    sensors : (c,) sensor of each channel.
    frame_samples : samples of a frame, a multiple of `PARTS`.

    Attributes
    ----------
    frames : quiet frames learned from, in all.
    frames_since_quiet : frames since the last quiet one, disturbed or missing.
    at_rest : whether the frames can be those of a sensor at rest; before `FIRST_FRAMES` nothing says that they are not.
    origin : (c,) channel unit, near the level: sums are relative to it and lose no digits.
    usual_sample, usual_part, usual_level : (c,) channel unit, largest usual distance of a sample and of the mean of
        a part from the mean of their frame, and of the mean of a frame from the level. inf: unknown.
    held : (c,) axes that keep their value for many samples while others change; set from outside before each frame.
    """

    def __init__(self, sensors: tuple[str, ...], frame_samples: int) -> None:
        c = len(sensors)
        limits = {"gyro": REST_LIMIT_GYRO, "accel": REST_LIMIT_ACCEL}
        self._frame_samples = frame_samples
        self._members = {name: [i for i, s in enumerate(sensors) if s == name] for name in sensors}
        self._sensors = sensors
        # a magnetometer has no limit: its field may change while it rests, so it is always at rest
        self._rest_limit = np.array([limits.get(s, np.inf) for s in sensors])
        # the memory: row i of each array belongs to quiet frame i, i + MEMORY_FRAMES, ...
        self._means, self._log_rms, self._log_part_rms, self._distances, self._white = (
            np.full((MEMORY_FRAMES, c), np.nan) for _ in range(5)
        )
        self.frames = 0
        self.frames_since_quiet = 0
        self.at_rest = True
        self.held = np.zeros(c, dtype=bool)
        self.origin = np.zeros(c)
        self._recent_means = np.zeros((LEVEL_FRAMES, c))  # newest first
        self._step = np.full(c, np.inf)  # least peak of a frame but 0: a step of a quantised channel
        # before anything is learned, nothing is unusual
        self.usual_sample, self.usual_part, self.usual_level = np.full((3, c), np.inf)
        self._level_limit, self._limits = np.full(c, np.inf), np.full((len(LIMITED), c), np.inf)

    @property
    def ready(self) -> bool:
        """Whether it has learned from enough quiet frames to assess others."""
        return bool(self.frames >= READY_FRAMES)

    @property
    def peak_limit(self) -> Floats:
        """(c,) channel unit, largest usual peak of a frame: `usual_sample`, or some steps of a coarse channel."""
        return np.asarray(self._limits[0])

    @property
    def next_change(self) -> int:
        """Frames until the scales change."""
        return frames_to_change(self.frames)

    @property
    def level(self) -> Floats:
        """(c,) channel unit, median of the means of the last quiet frames."""
        return _median(self._recent_means[: min(self.frames, LEVEL_FRAMES)], self.origin)

    # ------------------------------------------------------------------ learn

    def add(self, quiet: FrameStatistics) -> None:
        """Learn from quiet frames, all of them known."""
        until_change = self.next_change
        if len(quiet.mean) > until_change:
            self.add(quiet[:until_change])
            self.add(quiet[until_change:])
            return
        k = len(quiet.mean)
        if not k:  # of the first frames, none may be known
            return
        self._note_step(quiet)
        tiny = np.finfo(np.float64).tiny  # the logarithm of a constant channel is finite
        rows = (self.frames + np.arange(k)) % MEMORY_FRAMES
        self._means[rows] = quiet.mean
        self._log_rms[rows] = np.log(np.maximum(quiet.rms, tiny))
        self._log_part_rms[rows] = np.log(np.maximum(quiet.part_rms, tiny))
        self._distances[rows] = np.abs(quiet.mean - self._levels_before(quiet.mean))
        self._white[rows] = quiet.white
        if not self.frames:
            self._distances[0] = np.nan  # no level precedes the first frame
        newest = quiet.mean[::-1][:LEVEL_FRAMES]
        self._recent_means = np.concatenate((newest, self._recent_means))[:LEVEL_FRAMES]
        self.frames_since_quiet = 0
        self.frames += k
        if k == until_change:
            self._update_scales()

    def skip(self, frames: int) -> None:
        """Note that `frames` frames were disturbed or missing: the level may have moved."""
        self.frames_since_quiet += frames

    def _levels_before(self, means: Floats) -> Floats:
        """Return the level before each frame with the means (k, c), channel unit, if all were quiet."""
        k, known = len(means), min(self.frames, LEVEL_FRAMES)
        series = np.concatenate((self._recent_means[:known][::-1], means))  # oldest first
        if known == LEVEL_FRAMES:  # as below, for all frames at once
            spans = series[np.arange(LEVEL_FRAMES)[:, None] + np.arange(k)]
            spans.sort(axis=0)
            middle = spans[(LEVEL_FRAMES - 1) // 2] + spans[LEVEL_FRAMES // 2]
            return np.asarray(0.5 * middle, dtype=np.float64)
        windows = [series[max(0, known + i - LEVEL_FRAMES) : known + i] for i in range(k)]
        return np.stack([_median(window, self.origin) for window in windows])

    def _note_step(self, frames: FrameStatistics) -> None:
        """Note the least step that a channel makes."""
        # the mean of equal values differs from them by rounding, which is no step
        steps = frames.peak > ROUNDING * np.abs(frames.mean)
        least = np.where(steps, frames.peak, np.inf).min(axis=0, initial=np.inf)
        np.minimum(self._step, least, out=self._step)

    def _update_scales(self) -> None:
        """Recompute scales and thresholds from the frames in the memory."""
        n = min(self.frames, MEMORY_FRAMES)
        self.origin = self.level
        log_rms, rms_scatter = _log_scale(self._log_rms[:n], (2.0 * self._frame_samples) ** -0.5)
        log_part_rms, part_scatter = _log_scale(self._log_part_rms[:n], (2.0 * PARTS - 2.0) ** -0.5)
        rms, part_rms = np.exp(log_rms), np.exp(log_part_rms)
        median_error = np.sqrt(0.5 * np.pi / n)  # relative to the scatter of what the median is taken of
        scales = (
            (1.0 + ERROR_MARGIN * rms_scatter * median_error) * rms,
            (1.0 + ERROR_MARGIN * part_scatter * median_error) * part_rms,
            self._level_scale(n, part_rms),
        )
        # A constant channel has no noise, but its mean differs from its level by rounding.
        rounding = ROUNDING * np.abs(self.origin)
        usual = np.maximum(UNUSUAL_SIGMA * np.stack(scales), rounding)
        # A single step is no knock of a channel that is mostly constant: its peaks may be some steps, and its
        # deviation one, where it begins to toggle. A channel that never changed has no step yet (inf) and no limit.
        coarse = COARSE_STEPS * rms < self._step
        steps = np.maximum(COARSE_STEPS * np.where(coarse, self._step, 0.0), rounding)
        rises = np.maximum(UNUSUAL_SIGMA * np.stack((rms_scatter, part_scatter)), np.log(LEAST_UNUSUAL_RATIO))
        one_step = np.maximum(np.where(coarse, self._step, 0.0), rounding)
        deviations = np.maximum(np.exp(np.stack((log_rms, log_part_rms)) + rises), one_step)
        silent = self._silent(n, coarse)
        self.usual_sample, self.usual_part, self.usual_level = np.where(silent, np.inf, usual)
        *peaks, level = np.maximum(usual, steps)
        limits = np.where(silent, np.inf, np.stack((*peaks, *deviations, level)))
        self._limits, self._level_limit = limits[:-1], limits[-1]
        self.at_rest = self._rests(n, silent)

    def _silent(self, n: int, coarse: Bools) -> Bools:
        """Return (c,) the axes without noise in their frames, by n frames; nothing of them is ever unusual.

        An axis that is updated once a second is constant within its frames, or has one step. Each of the larger steps
        would be a knock, and the scatter of the means motion, of all axes on the table. A `coarse` axis (c,) repeats
        its values as often, but toggles between neighbouring ones, so that its means stay within a step. An axis that
        never changed within a frame has nothing to be judged by.
        """
        shift = gaussian_deviation(_median(self._distances[:n], np.zeros(len(coarse))))
        silent = (self.held & ~(coarse & (shift < self._step))) | np.isinf(self._step)
        return np.asarray(silent, dtype=bool)

    def _level_scale(self, n: int, part_rms: Floats) -> Floats:
        """Return (c,) the deviation of the mean of a frame from the level, by n frames, wider by its error."""
        shift = gaussian_deviation(_median(self._distances[:n], np.zeros_like(part_rms)))
        # The mean of a frame scatters at least as white noise of the parts would: eight distances may all be small
        # by chance.
        shift = np.maximum(shift, part_rms / np.sqrt(PARTS)) * (1.0 + ERROR_MARGIN * MAD_ERROR / np.sqrt(n))
        # Until the level itself rests on all its frames, the scatter of the parts is the least that is assumed: a
        # mean drifts by about as much as its parts do.
        return np.asarray(shift if n > LEVEL_FRAMES else np.maximum(part_rms, shift))

    # ------------------------------------------------------------------ compare

    def unusual(self, frames: FrameStatistics) -> Bools:
        """Return (k, c) the frames that are not the noise of this sensor; none before `ready`, none if unknown."""
        self._note_step(frames)
        if not self.ready:
            return np.zeros(frames.mean.shape, dtype=bool)
        unusual = self.moved(frames)
        for name, limit in zip(LIMITED, self._limits, strict=True):
            unusual |= getattr(frames, name) > limit
        return np.asarray(unusual & frames.known[:, None], dtype=bool)

    def moved(self, frames: FrameStatistics) -> Bools:
        """Return (k, c) the frames whose mean is not at the level."""
        # A random walk continues during the frames that were not learned from: its variance grows with time, and
        # the usual distance contains about LEVEL_FRAMES of it. The first quiet frame ends this allowance, although
        # the level still rests on frames before the gap: a mean that is farther off by then is disturbed, and
        # becomes a new baseline.
        limit = self._level_limit * np.sqrt(1.0 + self.frames_since_quiet / LEVEL_FRAMES)
        return np.asarray(np.abs(frames.mean - self._levels_before(frames.mean)) > limit)

    def _rests(self, n: int, silent: Bools) -> bool:
        """Return whether the last of `n` frames can be rest: squares are averaged over the axes of a sensor.

        `silent` axes (c,) have no noise that would predict how their means may differ; they do not count.
        """
        members = {name: [i for i in axes if not silent[i]] for name, axes in self._members.items()}
        if float(np.linalg.norm(self.level[members.get("gyro", [])])) > TURN_RATE:
            return False  # the mean of a gyroscope is no bias: a steady turn
        k = min(n, REST_FRAMES)
        if k < FIRST_FRAMES:  # one or two differences exceed any factor by chance
            return True
        rows = (self.frames - k + np.arange(k)) % MEMORY_FRAMES
        allan_deviation = np.sqrt(
            0.5 * np.mean(np.diff(self._means[rows], axis=0) ** 2, axis=0)
        )  # of tau = 1 s
        axes_of = np.array([max(1.0, len(members[name])) for name in self._sensors])
        white = _median(self._white[rows], np.zeros(len(axes_of)))
        # k - 1 differences of each axis have a relative error: more frames, or more axes, allow a lower limit
        factor = REST_FACTOR * (1.0 + ((k - 1) * axes_of) ** -0.5)
        limit = np.minimum(np.maximum(self._rest_limit, factor * white), SHAKEN_FACTOR * self._rest_limit)
        excess = (allan_deviation / limit) ** 2
        # else the means of the frames differ by more than the noise of a sensor explains
        return all(float(excess[axes].mean()) <= 1.0 for axes in members.values() if axes)


def _log_scale(logs: Floats, least_scatter: float) -> tuple[Floats, Floats]:
    """Return (c,) the median of the logarithms (n, c) of deviations, and their scatter.

    The scatter is at least that of white noise, because few frames may agree by chance, and at most `MOST_SCATTER`
    times that, because beyond it disturbances are in it.
    """
    scale = _median(logs, np.zeros(logs.shape[1]))
    scatter = gaussian_deviation(_median(np.abs(logs - scale), np.zeros_like(scale)))
    return scale, np.minimum(np.maximum(scatter, least_scatter), MOST_SCATTER * least_scatter)


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
