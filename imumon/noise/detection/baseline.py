"""Reference: what a sensor's own noise looks like, learned robustly while it runs.

To tell a knock from noise one must know the noise. Time is cut into *frames* of ten *parts*, about 1 s and
0.1 s. Of every quiet frame four figures are kept for each channel: its mean, the deviation of the samples
about it, that of the parts about it, and how far the mean lies from the level, the median of the `NEAR` quiet
frames before it. Medians over the last `FRAMES` of them are the reference: half of those frames may be
disturbed before it moves.

The scales change at fixed frame numbers only (2, 3, 4, 6, 8, 12, 16, 32, 64, 128, then every `FRAMES`), so
that decisions do not depend on how the samples were handed in. While few frames stand behind them, the
thresholds are wider by the uncertainty of the scales themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.samples import Bools, Floats

PARTS = 10
FRAMES = 128
NEAR = 8
SCHEDULE = (2, 3, 4, 6, 8, 12, 16, 32, 64, 128)
REST_FRAMES = 16
"""Frames that are asked whether they are rest."""

SAMPLE_SIGMA = 7.0
PART_SIGMA = 7.0
MEAN_SIGMA = 7.0
SPREAD_SIGMA = 6.0
LEAST_RATIO = 1.5
"""A frame is called restless when its deviation exceeds the usual one by `SPREAD_SIGMA` of the usual scatter
of its logarithm, and by this factor at least."""

REST_LIMIT = {"gyro": 1.5e-3, "accel": 3e-2}
"""Allan deviation at 1 s, rad/s and m/s^2, above which a sensor with a coloured spectrum is not at rest: two
to three times what the consumer grade has; a parked car with its engine running stays below, a driven one
does not."""
ABSURD = 20.0
"""Times `REST_LIMIT`: 100 deg/sqrt(h), above which a sensor with a white spectrum is not at rest either. No
sensor is so noisy; one that is shaken is."""
TURNING = 0.1
"""rad/s that the gyroscope reads on end, by its length: more than the bias of a sensor at rest."""

ROUNDING = 1e-12
"""Of the level: what sums of equal numbers may be off by."""


@dataclass(frozen=True, slots=True)
class Frames:
    """Figures of some frames, in channel units, one row a frame.

    Attributes
    ----------
    mean : (k, c) about zero.
    rms : (k, c) deviation of the samples about the frame's mean.
    parts : (k, c) deviation of the parts' means about the frame's mean.
    peak : (k, c) greatest distance of a sample from the frame's mean.
    part_peak : (k, c) greatest distance of a part's mean from the frame's mean.
    known : (k,) enough samples are valid to say so.
    """

    mean: Floats
    rms: Floats
    parts: Floats
    peak: Floats
    part_peak: Floats
    known: Bools

    def __getitem__(self, rows: slice | Bools) -> Frames:
        return Frames(*(getattr(self, name)[rows] for name in self.__slots__))

    @classmethod
    def joined(cls, frames: list[Frames]) -> Frames:
        """Several in a row as one."""
        return cls(*(np.concatenate([getattr(f, name) for f in frames]) for name in cls.__slots__))

    @classmethod
    def of(cls, d: Floats, seen: Bools | None, level: Floats) -> Frames:
        """Figures of frames given as parts.

        Parameters
        ----------
        d : (c, k, PARTS, part) channel unit, distance from `level`; 0.0 where not seen.
        seen : (k, PARTS, part) samples that may be judged; None: all.
        level : (c,) channel unit.
        """
        c, k, parts, part = d.shape
        if seen is None:
            means = (d.reshape(-1, part) @ np.full(part, 1.0 / part)).reshape(c, k, parts)
            mean = means.mean(axis=2)
            flat = d.reshape(c, k, parts * part)
            square = np.einsum("ckf,ckf->ck", flat, flat) / (parts * part)
            peak = np.maximum(flat.max(axis=2) - mean, mean - flat.min(axis=2))
            means -= mean[:, :, None]
            spread = np.einsum("ckp,ckp->ck", means, means) / parts
            part_peak = np.abs(means).max(axis=2)
            known = np.ones(k, dtype=bool)
        else:
            count = seen.sum(axis=2)  # (k, PARTS)
            n = np.maximum(count.sum(axis=1), 1)
            filled = np.maximum((count > 0).sum(axis=1), 1)
            mean = d.sum(axis=(2, 3)) / n
            square = np.einsum("ckpm,ckpm->ck", d, d) / n
            peak = (np.abs(d - mean[:, :, None, None]) * seen).max(axis=(2, 3))
            # A part with few samples scatters more: weighted so that full parts give the plain deviation.
            means = d.sum(axis=3) / np.maximum(count, 1) - mean[:, :, None]
            spread = (count * means**2).sum(axis=2) / n * (n / (filled * part))
            part_peak = np.abs(means * np.sqrt(count / part)).max(axis=2)
            known = n >= 0.25 * parts * part
        rms = np.sqrt(np.maximum(square - mean**2, 0.0))
        return cls((mean + level[:, None]).T, rms.T, np.sqrt(spread).T, peak.T, part_peak.T, known)


class NoiseBaseline:
    """Level and scales of each channel at rest.

    Parameters
    ----------
    sensors : sensor of each channel.
    frame : samples of a frame, a multiple of `PARTS`.
    rate_hz : Hz.

    Attributes
    ----------
    frames : quiet frames learned from, in all.
    rests : what was learned can be a sensor at rest.
    stale : frames since the last quiet one.
    origin : (c,) channel unit, near the level: a place to count from, so that no digits are lost.
    sample, part, shift : (c,) channel unit, thresholds for a sample's distance from its frame's mean, a
        part's
        from it, and the frame's mean from the level.
    """

    def __init__(self, sensors: tuple[str, ...], frame: int, rate_hz: float) -> None:
        c = len(sensors)
        self._frame = frame
        self._gyro = [i for i, s in enumerate(sensors) if s == "gyro"]
        self._limit = np.array([REST_LIMIT.get(s, np.inf) for s in sensors])
        # Behind the sensor's own filter of 5 ms, samples faster than 200 Hz are not independent.
        self._white = np.sqrt(PARTS / frame * max(1.0, rate_hz / 200.0))
        self._ring = np.full((FRAMES, 4, c), np.nan)  # mean, ln rms, ln parts, |mean - level|
        self.frames = 0
        self.stale = 0
        self.origin = np.zeros(c)
        self._near = np.zeros((NEAR, c))
        self._scale = np.zeros((2, c))  # ln rms, ln parts
        self._scatter = np.zeros((2, c))
        self.rests = True
        self.sample = np.full(c, np.inf)
        self.part = np.full(c, np.inf)
        self.shift = np.full(c, np.inf)
        self._step = np.full(c, np.inf)  # least peak of a frame other than 0: one step of a quantised channel
        self._allowed = np.full((5, c), np.inf)

    @property
    def ready(self) -> bool:
        """Whether enough quiet frames were learned from to judge others."""
        return bool(self.frames >= SCHEDULE[0])

    @property
    def next_change(self) -> int:
        """Frames until the scales change."""
        for at in SCHEDULE:
            if self.frames < at:
                return at - self.frames
        return FRAMES - self.frames % FRAMES

    @property
    def level(self) -> Floats:
        """(c,) channel unit, median of the means of the last quiet frames."""
        return _median(self._near[: min(self.frames, NEAR)], self.origin)

    def levels(self, means: Floats) -> Floats:
        """(k, c) Level before each of some frames, were they all quiet.

        Parameters
        ----------
        means : (k, c) channel unit.
        """
        k, before = len(means), min(self.frames, NEAR)
        row = np.concatenate((self._near[:before][::-1], means))
        if before == NEAR:
            windows = np.empty((NEAR, *means.shape))
            for i in range(NEAR):
                windows[i] = row[i : i + k]
            windows.sort(axis=0)
            return np.asarray(0.5 * (windows[NEAR // 2 - 1] + windows[NEAR // 2]), dtype=np.float64)
        return np.stack([_median(row[max(0, before + i - NEAR) : before + i], self.origin) for i in range(k)])

    def add(self, quiet: Frames) -> None:
        """Learn from quiet frames, all of them known."""
        step = self.next_change
        if len(quiet.mean) > step:
            self.add(quiet[:step])
            self.add(quiet[step:])
            return
        k = len(quiet.mean)
        if not k:
            return
        self._see(quiet)
        tiny = np.finfo(np.float64).tiny
        ring = self._ring
        at = (self.frames + np.arange(k)) % FRAMES
        ring[at, 0] = quiet.mean
        ring[at, 1] = np.log(np.maximum(quiet.rms, tiny))
        ring[at, 2] = np.log(np.maximum(quiet.parts, tiny))
        ring[at, 3] = np.abs(quiet.mean - self.levels(quiet.mean))
        if not self.frames:
            ring[0, 3] = np.nan
        self._near = np.concatenate((quiet.mean[::-1][:NEAR], self._near))[:NEAR]
        self.stale = 0
        self.frames += k
        if k == step:
            self._change()

    def _see(self, frames: Frames) -> None:
        """Note the least step that a channel makes."""
        least = np.where(frames.peak > 0.0, frames.peak, np.inf).min(axis=0, initial=np.inf)
        np.minimum(self._step, least, out=self._step)

    def miss(self, frames: int) -> None:
        """So many frames were disturbed or missing: the level may have moved on."""
        self.stale += frames

    def _change(self) -> None:
        n = min(self.frames, FRAMES)
        self.origin = self.level
        logs = self._ring[:n, 1:3]
        self._scale = _median(logs, self._scale)
        floor = np.array([[(2.0 * self._frame) ** -0.5], [(2.0 * PARTS - 2.0) ** -0.5]])
        scatter = 1.4826 * _median(np.abs(logs - self._scale), np.zeros_like(self._scale))
        self._scatter = np.minimum(np.maximum(scatter, floor), 3.0 * floor)
        unsure = 1.0 + 4.0 * 1.25 * self._scatter / np.sqrt(n)
        rms, parts = np.exp(self._scale)
        self.sample = SAMPLE_SIGMA * unsure[0] * rms
        self.part = PART_SIGMA * unsure[1] * parts
        shift = 1.4826 * _median(self._ring[:n, 3], np.zeros_like(rms))
        # A frame's mean scatters by at least what white noise leaves of the parts; before some distances
        # are known, by no more than the parts themselves.
        known = np.maximum(shift, parts / np.sqrt(PARTS)) * (1.0 + 3.0 * 1.2 / np.sqrt(n))
        self.shift = MEAN_SIGMA * (known if n > NEAR else np.maximum(parts, known))
        # what is constant differs from its level by rounding
        for limit in (self.sample, self.part, self.shift):
            np.maximum(limit, ROUNDING * np.abs(self.origin), out=limit)
        self._allowed = self._limits()
        self.rests = self._looks_like_rest(n)

    def restless(self, frames: Frames) -> Bools:
        """(k, c) Frames that are not this sensor's noise."""
        self._see(frames)
        if not self.ready:
            return np.zeros(frames.mean.shape, dtype=bool)
        allowed = self._allowed
        odd = (frames.peak > allowed[0]) | (frames.part_peak > allowed[1])
        # A random walk goes on while nobody looks.
        shift = allowed[2] * np.sqrt(1.0 + self.stale / NEAR)
        odd |= np.abs(frames.mean - self.levels(frames.mean)) > shift
        odd |= (frames.rms > allowed[3]) | (frames.parts > allowed[4])
        return np.asarray(odd & frames.known[:, None], dtype=bool)

    def _limits(self) -> Floats:
        """(5, c) Thresholds for peak, part_peak, distance of the mean, rms and parts."""
        rms, parts = np.exp(self._scale + np.maximum(SPREAD_SIGMA * self._scatter, np.log(LEAST_RATIO)))
        limits = np.stack((self.sample, self.part, self.shift, rms, parts))
        # A channel that mostly stands still and now and then moves by one step is not knocked by that step.
        coarse = np.exp(self._scale[0]) < 0.3 * self._step
        steps = np.array([3.0, 2.0, 2.0, 1.0, 1.0])[:, None] * np.where(coarse, self._step, 0.0)
        return np.asarray(np.maximum(np.maximum(limits, steps), ROUNDING * np.abs(self.origin)))

    def _looks_like_rest(self, n: int) -> bool:
        """By absolute measure, over the last `REST_FRAMES` of `n` frames: see `REST_LIMIT`, `ABSURD`
        and `TURNING`."""
        if float(np.linalg.norm(self.level[self._gyro])) > TURNING:
            return False
        k = min(n, REST_FRAMES)
        if k < 4:
            return True
        rows = self._ring[(self.frames - k + np.arange(k)) % FRAMES]
        nothing = np.zeros(rows.shape[2])
        step = _median(np.abs(np.diff(rows[:, 0], axis=0)), nothing) * (1.4826 / np.sqrt(2.0))
        rms, parts = np.exp(_median(rows[:, 1], nothing)), np.exp(_median(rows[:, 2], nothing))
        coloured = (step > 2.0 * parts / np.sqrt(PARTS)) | (parts > 1.5 * self._white * rms)
        return not bool(np.any((step > self._limit) & (coloured | (step > ABSURD * self._limit))))

    def save(self) -> dict[str, np.ndarray]:
        """State as arrays."""
        return {n.strip("_"): getattr(self, n).copy() for n in _STATE} | {
            "frames": np.array([self.frames, self.rests, self.stale])
        }

    def restore(self, saved: dict[str, np.ndarray]) -> None:
        """Continue where `save` left off."""
        for name in _STATE:
            setattr(self, name, np.array(saved[name.strip("_")]))
        self.frames, rests, self.stale = (int(v) for v in saved["frames"])
        self.rests = bool(rests)


_STATE = ("_ring", "_near", "origin", "_scale", "_scatter", "sample", "part", "shift", "_step", "_allowed")


def _median(rows: Floats, otherwise: Floats) -> Floats:
    """Median over the first axis of what is finite; `otherwise` where nothing is."""
    if not len(rows):
        return otherwise
    rows = np.sort(rows, axis=0)  # NaN last
    if not np.isnan(rows[-1]).any():
        return np.asarray(0.5 * (rows[(len(rows) - 1) // 2] + rows[len(rows) // 2]), dtype=np.float64)
    count = np.isfinite(rows).sum(axis=0)
    low = np.take_along_axis(rows, np.maximum((count - 1) // 2, 0)[None], axis=0)[0]
    high = np.take_along_axis(rows, np.minimum(count // 2, len(rows) - 1)[None], axis=0)[0]
    return np.where(count > 0, 0.5 * (low + high), otherwise)
