"""Disturbances: frames of the sensors on one table that differ from their baseline.

The detector assesses frame after frame against the `NoiseBaseline` and learns from the quiet ones. A frame
that differs by single samples has outliers (`outliers`). Any other frame is searched part by part; if some
parts explain it, only they are marked. Disturbed for most of ten frames means that everything is marked until
five quiet frames follow, or until sixteen frames at a new level or with a new noise can be rest by themselves
(a started engine, a tilted table). These become the baseline, and the record breaks behind them, because a
difference across the change is not noise. It is motion if more than one axis or a mean has changed in most
of the ten frames; a single axis whose noise changes does not move.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from imumon.noise.array_state import ArrayState, subset
from imumon.noise.detection.baseline import REST_FRAMES, NoiseBaseline
from imumon.noise.detection.frame_statistics import PARTS, FrameStatistics
from imumon.noise.detection.outliers import OutlierDetector, own_limit
from imumon.samples import Bools, Floats

Codes: TypeAlias = npt.NDArray[np.int8]
Reason: TypeAlias = Literal["glitch", "knock", "motion", "clipped", "stuck", "magnetic"]
REASONS: tuple[Reason, ...] = get_args(Reason)
"""Reasons in rising rank: if several apply, the last one counts. The code of a reason is its place, from 1."""


class ReasonCode(IntEnum):
    """Code of a reason."""

    GLITCH = 1
    KNOCK = 2
    MOTION = 3
    CLIPPED = 4
    STUCK = 5
    MAGNETIC = 6


INERTIAL = ("gyro", "accel")

WINDOW_FRAMES = 10
"""Frames by which motion is recognised, the last ones. Half of them, quiet and in a row, end it."""
MOTION_FRAMES = 8
"""Unusual frames among them that mean motion: a knock and its echo take fewer. Motion leaves as many usual frames as a
new baseline may have unusual ones."""
LARGEST_SHARE = 0.5
"""Share of the parts of a frame up to which single parts explain it."""
ONE_AXIS = 0.5
"""Repeats of the median axis over those of the most repeating one, below which that one alone is stuck."""


class Shows(IntEnum):
    """What a frame shows: the usual noise, another noise of one axis, or of several axes or another mean."""

    USUAL = 0
    ONE_CHANNEL = 1
    SEVERAL = 2


@dataclass(frozen=True, slots=True)
class Outlier:
    """A single sample that is excluded on its sensor.

    Attributes
    ----------
    place : on the grid.
    group, channel : its sensor and the axis that is farthest off.
    size : channel unit, distance from the middle of its frame.
    """

    place: int
    group: int
    channel: int
    size: float


@dataclass(frozen=True, slots=True)
class Disturbance:
    """An excluded stretch of samples, or the outliers of one sensor within a minute.

    Attributes
    ----------
    kind : the reason.
    start : samples on the grid since the guard began, margin included.
    length : excluded samples, margins included.
    size : channel unit, greatest distance from the level; None for a stuck output.
    channel : index of the channel whose distance is greatest relative to its noise, or which alone is stuck;
        None: no single one.
    """

    kind: Reason
    start: int
    length: int
    size: float | None
    channel: int | None


class DisturbanceDetector(ArrayState):
    """Assess the channels of some sensors together.

    Parameters
    ----------
    sensors : (c,) sensor of each channel of the stream.
    kinds : sensors that are assessed.
    frame : samples of a frame, a multiple of `PARTS`.

    Attributes
    ----------
    channels, groups : columns and groups of the stream that are assessed.
    baseline : the usual noise.
    moving : frames since everything is marked; 0 in usual noise.
    outliers : finds single samples, and knows the channels that have them as noise.
    found : outliers to exclude, in order; the guard takes them.
    rest_changes : places on the grid where motion begins (False) or ends (True); the guard takes them.
    open : start, end and code of the running disturbance; empty if there is none.
    latest : (2, c) channel unit, mean and deviation of the last undisturbed frame that was passed on.
    """

    _STATE = ("moving", "_reason", "latest")

    def __init__(self, sensors: Sequence[str], kinds: tuple[str, ...], frame: int) -> None:
        self.inertial = kinds == INERTIAL
        self.channels = [i for i, s in enumerate(sensors) if s in kinds]
        self.groups = [g for g, s in enumerate(dict.fromkeys(sensors)) if s in kinds]
        self._baseline_arguments = tuple(sensors[i] for i in self.channels), frame
        self.baseline = NoiseBaseline(*self._baseline_arguments)
        self._group_of = [list(dict.fromkeys(sensors)).index(sensors[i]) for i in self.channels]
        self.outliers = OutlierDetector(self._group_of, frame)
        self.found: list[Outlier] = []
        self.rest_changes: list[tuple[int, bool]] = []
        self.moving = 0
        self._reason = ReasonCode.MOTION  # why everything is marked
        self._unusual = [Shows.USUAL] * WINDOW_FRAMES  # the last frames, newest last
        self._candidates: list[FrameStatistics] = []  # while moving: frames for a new baseline
        self.open: list[int] = []
        self._range = np.zeros((2, len(self.channels)))  # channel unit, of the running disturbance
        self.latest = self._reference = np.zeros((2, len(self.channels)))
        self._repeats = np.zeros(len(self.channels), dtype=np.int64)  # within it: values equal to the last
        self._last = np.zeros((0, len(self.channels)))  # row of it

    @property
    def at_rest(self) -> bool:
        """False while the sensor moves or is handled."""
        return not (self.moving and self._reason == ReasonCode.MOTION)

    def assess(self, x: Floats, usable: Bools | None, codes: Codes, index: int) -> list[int]:
        """Assess frames and learn from the quiet ones; return the places of breaks on the grid.

        Parameters
        ----------
        x : (c, k, PARTS, part) channel unit.
        usable : (k, PARTS, part) rows that may be assessed; None: all.
        codes : (k, PARTS), output.
        index : place on the grid of the first row.
        """
        k, frame = x.shape[1], x.shape[2] * x.shape[3]
        if self.baseline.ready and not (self.moving or self.baseline.stale or any(self._unusual)):
            frames, _ = self._figures(x, usable)
            if frames.known.all() and not self.baseline.unusual(frames).any():
                self._learn(frames, codes)
                if not self.at_rest:  # the scales change with the last frame
                    self.rest_changes.append((index + k * frame, False))
                return []
        breaks = []
        for f in range(k):
            own = None if usable is None else usable[f : f + 1]
            place, before = index + f * frame, self.at_rest
            if self._assess_frame(x[:, f : f + 1], own, codes[f : f + 1], place):
                breaks.append(place + frame)
            if self.at_rest != before:
                self.rest_changes.append((place + frame, self.at_rest))
        return breaks

    def assess_first(self, x: Floats, usable: Bools | None, codes: Codes, index: int) -> None:
        """Assess the first frames by one another, because a record may begin with a knock; see `assess`."""
        frames, d = self._figures(x, usable)
        limit = own_limit(d, usable)
        outliers = np.zeros(d.shape, dtype=bool)
        for f in range(d.shape[1]):
            one = slice(f, f + 1)
            found = self.outliers.find(d[:, one], None if usable is None else usable[one], limit)
            if found is not None:
                outliers[:, one] = found
        if outliers.any():
            frames = self._without(outliers, d, usable)
        self.baseline.add(frames[frames.known])
        if not self.baseline.ready:
            return
        unusual = np.asarray(self.baseline.unusual(frames).any(axis=1), dtype=bool)
        for f in np.flatnonzero(unusual).tolist():
            own = None if usable is None else usable[f : f + 1]
            codes[f] = self._locate(self._figures(x[:, f : f + 1], own)[1], own)
        self._unusual = [*self._unusual, *np.where(unusual, Shows.SEVERAL, Shows.USUAL).tolist()][
            -WINDOW_FRAMES:
        ]
        quiet = frames.known & ~unusual
        if unusual.any() and quiet.sum() >= 2:
            self.baseline = NoiseBaseline(*self._baseline_arguments)
            self.baseline.add(frames[quiet])
        outliers &= quiet[:, None, None]
        self.outliers.count(outliers, int(quiet.sum()))
        self._note(x, outliers, index)
        self.latest = np.stack((self.baseline.level, frames.rms.min(axis=0)))
        if self._check_rest():
            codes[:] = ReasonCode.MOTION
            self.rest_changes.append((index + x.shape[1] * x.shape[2] * x.shape[3], False))

    def _without(self, outliers: Bools, d: Floats, usable: Bools | None) -> FrameStatistics:
        """Return the statistics of frames without outliers, all (c, k, PARTS, part)."""
        rest: Bools = np.logical_not(outliers.any(axis=0))
        if usable is not None:
            rest = rest & usable
        return FrameStatistics.of(d * rest, rest, self.baseline.origin)

    def _note(self, x: Floats, outliers: Bools, index: int) -> None:
        """Exclude outliers (c, k, PARTS, part) of channels in which they are not noise.

        Parameters
        ----------
        x : (c, k, PARTS, part) channel unit.
        index : place on the grid of the first sample.
        """
        own = outliers & ~self.outliers.noise[:, None, None, None]
        marked = own.reshape(len(own), -1)
        for row in np.flatnonzero(marked.any(axis=0)).tolist():
            distance = np.abs(x.reshape(len(x), -1)[:, row] - self.baseline.level)
            by_group: dict[int, Outlier] = {}
            for c in np.flatnonzero(marked[:, row]).tolist():
                group, size = self._group_of[c], float(distance[c])
                if group not in by_group or size > by_group[group].size:
                    by_group[group] = Outlier(index + row, group, self.channels[c], size)
            self.found += by_group.values()

    def _figures(self, x: Floats, usable: Bools | None) -> tuple[FrameStatistics, Floats]:
        d = x - self.baseline.origin[:, None, None, None]
        if usable is not None:
            d *= usable
        return FrameStatistics.of(d, usable, self.baseline.origin), d

    def _assess_frame(self, x: Floats, usable: Bools | None, codes: Codes, index: int) -> bool:
        """Assess one frame and return whether the record breaks behind it."""
        baseline = self.baseline
        frames, d = self._figures(x, usable)
        frames, unusual, outliers = self._without_outliers(frames, d, usable)
        several = np.count_nonzero(unusual) > 1 or bool(baseline.moved(frames).any())
        state = (Shows.SEVERAL if several else Shows.ONE_CHANNEL) if unusual.any() else Shows.USUAL
        self._unusual = [*self._unusual[1:], state]
        if state:
            codes[:] = self._locate(d, usable)
        if state or not frames.known[0]:
            baseline.skip(1)
        if self.moving:
            return self._continue_motion(frames, codes)
        if WINDOW_FRAMES - self._unusual.count(Shows.USUAL) >= MOTION_FRAMES:
            self.moving, self._candidates = 1, []
            self._reason = (
                ReasonCode.MOTION if self._unusual.count(Shows.SEVERAL) >= MOTION_FRAMES else ReasonCode.KNOCK
            )
            codes[:] = self._reason
        elif not state and frames.known[0]:
            self._learn(frames, codes, outliers)
            if outliers is not None:
                self._note(x, outliers, index)
        return False

    def _continue_motion(self, frames: FrameStatistics, codes: Codes) -> bool:
        """Mark a frame while everything is marked, and return whether the record breaks behind it."""
        self.moving += 1
        if self._unusual.count(Shows.SEVERAL) >= MOTION_FRAMES:
            self._reason = ReasonCode.MOTION
        codes[:] = self._reason
        if frames.known[0]:
            self._candidates.append(frames)
        if self.baseline.ready and not any(self._unusual[WINDOW_FRAMES // 2 :]):
            self.moving, self._candidates = 0, []
        elif len(self._candidates) >= REST_FRAMES:
            return self._try_new_baseline()
        return False

    def _without_outliers(
        self, frames: FrameStatistics, d: Floats, usable: Bools | None
    ) -> tuple[FrameStatistics, Bools, Bools | None]:
        """Return a frame without its outliers, what is unusual in it, and the outliers; None: they explain nothing."""
        baseline = self.baseline
        unusual = baseline.unusual(frames)
        untried = self.moving or not baseline.ready  # no usual noise, or not this one
        if not untried and not unusual.any():
            return frames, unusual, None
        limit = own_limit(d, usable)  # by a median, because outliers raise the usual deviation
        outliers = self.outliers.find(d, usable, limit if untried else np.minimum(limit, baseline.peak))
        if outliers is None:
            return frames, unusual, None
        without = self._without(outliers, d, usable)
        explained = baseline.unusual(without)
        return (without, explained, outliers) if untried or not explained.any() else (frames, unusual, None)

    def _learn(self, frames: FrameStatistics, codes: Codes, outliers: Bools | None = None) -> None:
        self.outliers.count(outliers, len(frames.mean))
        self.baseline.add(frames)
        if self._check_rest():
            codes[-1:] = ReasonCode.MOTION  # the scales change with the last frame that is learned

    def _check_rest(self) -> bool:
        """Discard a baseline that turns out to be motion, and return whether it was."""
        if not self.inertial or self.baseline.at_rest:
            return False
        self.baseline = NoiseBaseline(*self._baseline_arguments)
        self.moving, self._reason, self._candidates = 1, ReasonCode.MOTION, []
        return True

    def _try_new_baseline(self) -> bool:
        """Use the last frames as the baseline if they are rest; return whether the record breaks."""
        frames = FrameStatistics.joined(self._candidates)
        self._candidates = []
        trial = NoiseBaseline(*self._baseline_arguments)
        trial.add(frames)
        if not trial.at_rest or trial.unusual(frames).any(axis=1).sum() > WINDOW_FRAMES - MOTION_FRAMES:
            return False
        self.baseline, self.moving = trial, 0
        self._unusual = [Shows.USUAL] * WINDOW_FRAMES
        return self.inertial

    def _locate(self, d: Floats, usable: Bools | None) -> Codes:
        """Return (PARTS,) codes of an unusual frame: the parts that explain it, or all of them.

        Parameters
        ----------
        d : (c, 1, PARTS, part) channel unit, distance from the level; 0.0 if not usable.
        usable : (1, PARTS, part) or None.
        """
        baseline = self.baseline
        distance = d[:, 0] - (baseline.level - baseline.origin)[:, None, None]
        if usable is not None:
            distance *= usable[0]
        samples = np.abs(distance) > (baseline.sample + baseline.shift)[:, None, None]
        hit = samples.any(axis=(0, 2))
        means = np.abs(distance.mean(axis=2)) > (baseline.part + baseline.shift)[:, None]
        hit |= means.any(axis=0)
        if 0 < hit.sum() <= LARGEST_SHARE * PARTS:
            rest = np.array(np.broadcast_to(~hit[None, :, None], d.shape[1:]))
            if usable is not None:
                rest &= usable
            if not baseline.unusual(FrameStatistics.of(d * rest, rest, baseline.origin)).any():
                return np.where(hit, ReasonCode.KNOCK, 0).astype(np.int8)
        return np.full(PARTS, ReasonCode.KNOCK, dtype=np.int8)

    def extend(self, start: int, end: int, code: int, values: Floats) -> None:
        """Begin or extend the running disturbance.

        Parameters
        ----------
        start, end : places on the grid.
        values : (n, c) channel unit, its samples in all channels of the stream.
        """
        own = values[:, self.channels]
        if not self.open:
            self.open = [start, end, code]
            self._reference = self.latest
            self._range = np.repeat(self._reference[:1], 2, axis=0)
            self._repeats[:], self._last = 0, own[:0]
        self.open[1:] = [end, max(code, self.open[2])]
        if len(own):
            self._repeats += (np.diff(own, axis=0, prepend=self._last) == 0.0).sum(axis=0)
            self._last = own[-1:]
            self._range[0] = np.minimum(self._range[0], own.min(axis=0))
            self._range[1] = np.maximum(self._range[1], own.max(axis=0))

    def close(self) -> Disturbance:
        """End and return the running disturbance."""
        start, end, code = self.open
        self.open = []
        level, deviation = self._reference
        distance = np.maximum(self._range[1] - level, level - self._range[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            # a channel without noise is the worst that moves
            share = np.where(distance > 0.0, distance / deviation, 0.0)
        worst = int(np.argmax(share))
        sized = code != ReasonCode.STUCK and distance[worst] > 0.0
        size, channel = (float(distance[worst]), self.channels[worst]) if sized else (None, None)
        if code == ReasonCode.STUCK and np.median(self._repeats) < ONE_AXIS * self._repeats.max():
            channel = self.channels[int(np.argmax(self._repeats))]
        named = self.inertial or code in (ReasonCode.CLIPPED, ReasonCode.STUCK)
        return Disturbance(REASONS[code - 1] if named else "magnetic", start, end - start, size, channel)

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        out = super().save() | {"unusual": np.array(self._unusual)}
        out |= {f"outliers.{name}": value for name, value in self.outliers.save().items()}
        found = [[o.place, o.group, o.channel, o.size] for o in self.found]
        out["found"] = np.array(found, dtype=np.float64).reshape(-1, 4)
        if self._candidates:
            frames = FrameStatistics.joined(self._candidates)
            out |= {f"candidates.{name}": getattr(frames, name) for name in FrameStatistics.__slots__}
        return out | {f"baseline.{name}": value for name, value in self.baseline.save().items()}

    def load(self, saved: Mapping[str, np.ndarray]) -> None:
        """Continue from a saved state."""
        super().load(saved)
        self._unusual = [Shows(v) for v in saved["unusual"]]
        self.outliers.load(subset(saved, "outliers."))
        found = saved["found"].tolist()
        self.found = [Outlier(int(at), int(group), int(c), size) for at, group, c, size in found]
        self._candidates = []
        if candidates := subset(saved, "candidates."):
            frames = FrameStatistics(*(candidates[name] for name in FrameStatistics.__slots__))
            self._candidates = [frames[i : i + 1] for i in range(len(frames.mean))]
        self.baseline.load(subset(saved, "baseline."))
