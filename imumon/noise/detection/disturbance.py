"""Disturbances: frames of the sensors on one table that differ from their usual noise.

The detector compares frame after frame with the `NoiseBaseline` and learns from the quiet ones. It gives a code to
every part of every frame: 0, or the reason to exclude it (`ReasonCode`). Margins, order and counts are not its
business (`guard`, `exclusions`).

One frame
---------
    1. The frame is usual, or it has too few usable samples (it is "unknown"): no code.
    2. Without its outliers it is usual (`outliers`): these samples are excluded alone.
    3. Some parts, up to half of them, explain what is unusual: without them it is usual. They are a knock.
    4. Otherwise the whole frame is a knock.

Many frames
-----------
A knock takes a second or two. What lasts needs a decision: does the sensor move, or has its usual noise changed? The
detector has three states (`DetectorState`):

    state      next       by                 what happens
    QUIET      DISTURBED  _begin             8 of the last 10 frames are unusual
    QUIET      MOVING     _begin             8 of 10 in several axes, or by a new mean
    QUIET      MOVING     _discard_baseline  the usual noise turns out to be motion
    DISTURBED  MOVING     _begin             8 of 10 in several axes, or by a new mean
    both       QUIET      _return            usual again: 5 frames without anything unusual, or a gap
    both       QUIET      _adopt             new rest: 16 frames can be rest by themselves

In QUIET, single frames are excluded and the others are learned from. In DISTURBED and MOVING everything is excluded, as
knock or as motion, usual and unknown frames included, and nothing is learned; a moving sensor is also reported as not
at rest. Only several axes, or a mean that has changed, are motion: an axis whose noise grows does not move.

Five frames without anything unusual may be unknown ones, and a gap of four whole frames or more, or of unknown length,
does as much at once: what was seen to move is not seen any more. Motion that continues behind it is excluded frame
by frame until it is recognised again. A gap also ends both windows, of ten frames and of sixteen, because they are of
neighbours. Before there is a baseline, only a new rest ends motion.

A new rest is a started engine or a tilted table: the last 16 frames become the baseline, and the record breaks behind
them, because a difference across the change is not noise.

Example: 20 s of noise, then the level of one axis jumps by 10 sigma and stays there, as on a tilted table. The eighth
frame at the new level shows that this is no knock. The sixteen frames from there on become the new baseline.

>>> noise = np.random.default_rng(1).standard_normal((3, 60, PARTS, 10))  # channels, frames, parts, samples
>>> noise[0, 20:] += 10.0
>>> detector = DisturbanceDetector(("accel",) * 3, INERTIAL, frame_samples=100)
>>> noise *= 1e-3  # m/s^2
>>> codes, usable = np.zeros((60, PARTS), dtype=np.int8), np.ones((60, PARTS, 10), dtype=bool)
>>> detector.assess_first(noise[:, :4], usable[:4], codes[:4], 0) is not None
True
>>> for frame in range(4, 60):
...     rows = slice(frame, frame + 1)
...     breaks = detector.assess(noise[:, rows], usable[rows], codes[rows], 100 * frame)
...     if breaks or frame in (19, 26, 27):
...         print(frame, detector.state.name, ReasonCode(codes[frame, 0]).name, breaks)
19 QUIET NONE []
26 QUIET KNOCK []
27 MOVING MOTION []
43 QUIET MOTION [4400]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import restorable
from imumon.noise.detection.baseline import (
    FIRST_FRAMES,
    PARTS,
    READY_FRAMES,
    REST_FRAMES,
    FrameStatistics,
    NoiseBaseline,
)
from imumon.noise.detection.outliers import TAIL_REACH, OutlierDetector, limit_of_samples

LOCATED_SHARE = 0.5
"""Up to this, single parts are excluded instead of the whole unusual frame. Unit: of the parts of a frame.

Otherwise: a knock of 0.1 s costs a second; if most parts are off, the rest is too short to be called quiet. Chosen:
the other half still has five means.
"""
WINDOW_FRAMES = 10
"""Motion is recognised by the unusual ones among the last ten; a gap empties this window. Unit: frames, about s.

Otherwise: two knocks of an hour would count together, or every pause would end motion. Chosen: longer than a knock
with its echo.
"""
MOTION_FRAMES = 8
"""From here on everything is excluded, also the frames between that look quiet. Unit: unusual frames of
WINDOW_FRAMES.

Otherwise: a moving sensor that is quiet for a moment counts for that moment. Chosen: a knock and its echo take fewer,
and two quiet moments in ten seconds do not end motion.
"""
SEVERAL_AXES = 2
"""This many unusual axes of a frame can be motion; fewer only if a mean has changed. Unit: axes.

Otherwise: an axis whose noise grows is called motion, and the sensor loses its grade. Origin: a body that moves turns
and accelerates more than one axis (`test_outliers.py`).
"""
RETURN_FRAMES = WINDOW_FRAMES // 2
"""A disturbance or motion ends when these, in a row, show nothing unusual; unknown ones count. Unit: frames, about
s.

Otherwise: a car at a crossing is at rest for two seconds. Chosen: half of the window.
"""

# ---------------------------------------------------------------------- reasons

Codes: TypeAlias = npt.NDArray[np.int8]
Reason: TypeAlias = Literal["glitch", "knock", "motion", "clipped", "stuck", "magnetic"]
REASONS: tuple[Reason, ...] = get_args(Reason)
"""Reasons in rising rank: if several apply, the last one counts. The code of a reason is its place, from 1."""


@restorable
class ReasonCode(IntEnum):
    """Code of a reason."""

    NONE = 0
    GLITCH = 1  # a single sample
    KNOCK = 2  # unusual for some frames
    MOTION = 3  # unusual for most frames, in several axes or by its mean
    CLIPPED = 4  # the sensor itself says that its range was exceeded
    STUCK = 5  # repeated values: above the others, because they mean nothing on such samples
    MAGNETIC = 6  # anything that the magnetometer alone shows


INERTIAL = ("gyro", "accel")


@restorable
@dataclass(frozen=True, slots=True)
class Outlier:
    """A single sample that is excluded on its sensor.

    Attributes
    ----------
    place : on the grid.
    group, channel : its sensor and the axis that is farthest off.
    size : channel unit, distance from the level.
    """

    place: int
    group: int
    channel: int
    size: float


@restorable
@dataclass(frozen=True, slots=True)
class Disturbance:
    """Consecutive samples that are excluded, or the outliers of one sensor within a minute.

    Attributes
    ----------
    kind : the reason.
    start : samples on the grid since the guard began, margin included.
    length : samples, margins included: of a stretch from its first to its last one, those that were lost in between
        too; of outliers, how many there are.
    size : channel unit, largest distance from the level; None for a stuck output, which has none.
    channel : index of the channel whose distance is largest relative to its noise, or which alone is stuck;
        None: no single one.
    """

    kind: Reason
    start: int
    length: int
    size: float | None
    channel: int | None


# ---------------------------------------------------------------------- states and transitions


@restorable
class DetectorState(IntEnum):
    """What a detector does with the next frame."""

    QUIET = 0
    """Excludes it if it is unusual, else learns from it."""
    DISTURBED = 1
    """Excludes it as a knock: most frames are unusual, but not by what moves."""
    MOVING = 2
    """Excludes it as motion."""


@restorable
class Verdict(IntEnum):
    """What one frame shows. Above `USUAL` is unusual."""

    UNKNOWN = -1
    """Nothing: too few usable samples, or no baseline yet. It counts as nothing unusual: it is excluded only where
    everything is, in `DISTURBED` and `MOVING`, and `RETURN_FRAMES` of them end both states."""
    USUAL = 0
    ONE_AXIS = 1
    """Another noise of one axis."""
    SEVERAL = 2
    """Another noise of several axes, or another mean."""


@dataclass(frozen=True, slots=True)
class AssessedFrame:
    """One frame, compared with the baseline.

    Attributes
    ----------
    statistics : of one frame, without the outliers if these explain what is unusual.
    unusual : (1, c) channels that are unusual all the same.
    outliers : (c, 1, PARTS, part) single samples; None: there are none, or they do not explain it.
    """

    statistics: FrameStatistics
    unusual: Bools
    outliers: Bools | None = None


# ---------------------------------------------------------------------- detector


@restorable
class DisturbanceDetector:
    """Assess the channels of some sensors together: a table that is knocked moves all of them.

    Parameters
    ----------
    sensors : (c,) sensor of each channel of the stream.
    kinds : sensors that are assessed.
    frame_samples : samples of a frame, a multiple of `PARTS`.

    Attributes
    ----------
    channels, groups : columns and groups of the stream that are assessed.
    inertial : the sensors are gyroscope and accelerometer, which move; a magnetometer can only be disturbed.
    baseline : the usual noise.
    outliers : finds single samples, and knows the channels that have them as noise.
    group_of : (c,) group of each of these channels.
    single_samples : outliers to exclude, in order; the guard empties the list.
    rest_changes : places on the grid where motion begins (False) or ends (True); the guard empties the list. A
        magnetometer has none: no caller reads them, and the list would grow without bound.
    state : what happens with the next frame.
    """

    def __init__(self, sensors: Sequence[str], kinds: tuple[str, ...], frame_samples: int) -> None:
        names = list(dict.fromkeys(sensors))
        self.inertial = kinds == INERTIAL
        self.channels = [i for i, s in enumerate(sensors) if s in kinds]
        self.groups = [g for g, s in enumerate(names) if s in kinds]
        self.group_of = [names.index(sensors[i]) for i in self.channels]
        self._sensors, self._frame_samples = tuple(sensors[i] for i in self.channels), frame_samples
        self._held = np.zeros(len(self.channels), dtype=bool)
        self.baseline = self._new_baseline()
        self.outliers = OutlierDetector(self.group_of, frame_samples)
        self.single_samples: list[Outlier] = []
        self.rest_changes: list[tuple[int, bool]] = []
        self.state = DetectorState.QUIET
        self._window = [Verdict.USUAL] * WINDOW_FRAMES  # the last frames, newest last
        self._candidates: list[
            FrameStatistics
        ] = []  # frames for a new baseline, while everything is excluded
        self._unknown_frames = 0  # in a row, up to now

    def _new_baseline(self) -> NoiseBaseline:
        baseline = NoiseBaseline(self._sensors, self._frame_samples)
        baseline.held = self._held
        return baseline

    @property
    def at_rest(self) -> bool:
        """False while the sensor moves or is handled."""
        return self.state is not DetectorState.MOVING

    def hold(self, held: Bools) -> None:
        """Say which channels (c,) keep their value for many samples, before frames are assessed."""
        self._held = self.baseline.held = held

    def end(self, frames: int, place: int) -> None:
        """Note that `frames` whole frames are missing from `place` on: what runs does not continue behind them.

        Frames on both sides of a gap are no neighbours: they are not counted in one window, and their means may differ
        by more than noise. Motion ends as after `RETURN_FRAMES` unknown frames, and for the same reason.
        """
        self.baseline.skip(frames)
        self._window = [Verdict.UNKNOWN] * WINDOW_FRAMES
        self._candidates, self._unknown_frames = [], 0
        if self.state is not DetectorState.QUIET and self.baseline.ready:
            at_rest_before = self.at_rest
            self._return()
            self._note_rest(at_rest_before, place)

    def _note_rest(self, before: bool, place: int) -> None:
        """Note a change of `at_rest`, which was `before`, at a place on the grid."""
        if self.inertial and self.at_rest != before:
            self.rest_changes.append((place, self.at_rest))

    # ------------------------------------------------------------------ frames

    def assess(self, values: Floats, usable: Bools, codes: Codes, place: int) -> list[int]:
        """Assess frames and learn from the quiet ones; return the places of breaks on the grid.

        Parameters
        ----------
        values : (c, k, PARTS, part) channel unit; the baseline must not change before the last frame.
        usable : (k, PARTS, part) samples that may be assessed.
        codes : (k, PARTS), output.
        place : on the grid, of the first sample.
        """
        frames = values.shape[1]
        if self._assess_quiet(values, usable, codes, place):
            return []
        breaks = []
        for f in range(frames):
            frame_usable = usable[f : f + 1]
            begin, at_rest_before = place + f * self._frame_samples, self.at_rest
            if self._assess_frame(values[:, f : f + 1], frame_usable, codes[f : f + 1], begin):
                breaks.append(begin + self._frame_samples)
            self._note_rest(at_rest_before, begin + self._frame_samples)
        return breaks

    def _assess_quiet(self, values: Floats, usable: Bools, codes: Codes, place: int) -> bool:
        """Assess frames at once and return True, or return False: they need one decision after the other.

        This is the usual case, and a whole block costs hardly more than a frame. After a frame that was skipped,
        the limit of the level depends on how many were; an unusual frame in the window may complete a transition.
        """
        if (
            self.state is not DetectorState.QUIET
            or not self.baseline.ready
            or self.baseline.frames_since_quiet
        ):
            return False
        if max(self._window) > Verdict.USUAL:
            return False
        frames, _ = self._statistics(values, usable)
        if not frames.known.all() or self.baseline.unusual(frames).any():
            return False
        self._learn(frames, codes)
        if not self.at_rest:  # the baseline changes with the last frame only
            self.rest_changes.append((place + values.shape[1] * self._frame_samples, False))
        return True

    def assess_first(
        self, values: Floats, usable: Bools, codes: Codes, place: int
    ) -> tuple[Floats, Floats] | None:
        """Assess the first frames by one another, because a record may begin with a knock; see `assess`.

        Returns
        -------
        (c,) level and (c,) least deviation of the frames, channel unit, by which the size of a disturbance is measured;
        None: fewer than `READY_FRAMES` frames are known, nothing is assessed, and the next frames are learned from.
        """
        frames, distance = self._statistics(values, usable)
        outliers = self._first_outliers(distance, usable)
        if outliers.any():
            frames = self._without(outliers, distance, usable)
        self.baseline.add(frames[frames.known])
        if not self.baseline.ready:
            return None
        unusual = np.asarray(self.baseline.unusual(frames).any(axis=1), dtype=bool)
        for f in np.flatnonzero(unusual).tolist():
            frame_usable = usable[f : f + 1]
            codes[f] = self._locate(self._statistics(values[:, f : f + 1], frame_usable)[1], frame_usable)
        verdicts = np.where(unusual, Verdict.SEVERAL, Verdict.USUAL).tolist()
        self._window = [*self._window, *(Verdict(verdict) for verdict in verdicts)][-WINDOW_FRAMES:]
        quiet = frames.known & ~unusual
        if unusual.any() and quiet.sum() >= READY_FRAMES:  # a second pass, without the knock in the scales
            self.baseline = self._new_baseline()
            self.baseline.add(frames[quiet])
        outliers &= quiet[:, None, None]  # those of an excluded frame are excluded with it
        self.outliers.count(outliers, int(quiet.sum()))
        self._exclude_outliers(values, outliers, place)
        reference = self.baseline.level, frames.rms.min(axis=0)
        if not self._still_rests():
            codes[:] = ReasonCode.MOTION
            self.rest_changes.append((place + values.shape[1] * self._frame_samples, False))
        return reference

    def _first_outliers(self, distance: Floats, usable: Bools) -> Bools:
        """Return (c, k, PARTS, part) the outliers of the first frames, each compared with itself."""
        outliers = np.zeros(distance.shape, dtype=bool)
        limit = limit_of_samples(distance, usable)
        for f in range(distance.shape[1]):
            frame = slice(f, f + 1)
            single = self.outliers.search(distance[:, frame], usable[frame], limit)
            if single is not None:
                outliers[:, frame] = single
        return outliers

    def _statistics(self, values: Floats, usable: Bools) -> tuple[FrameStatistics, Floats]:
        """Return statistics of frames, and the distance of their samples from the origin, 0.0 if not usable."""
        distance = values - self.baseline.origin[:, None, None, None]
        if not usable.all():
            distance *= usable
        return FrameStatistics.of(distance, usable, self.baseline.origin), distance

    def _without(self, outliers: Bools, distance: Floats, usable: Bools) -> FrameStatistics:
        """Return the statistics of frames without outliers, all (c, k, PARTS, part)."""
        rest = usable & ~outliers.any(axis=0)
        return FrameStatistics.of(distance * rest, rest, self.baseline.origin)

    def _assess_frame(self, values: Floats, usable: Bools, codes: Codes, place: int) -> bool:
        """Assess one frame and return whether the record breaks behind it."""
        frames, distance = self._statistics(values, usable)
        frame = self._without_outliers(frames, distance, usable)
        verdict = self._verdict(frame)
        self._window = [*self._window[1:], verdict]
        if verdict > Verdict.USUAL:
            codes[:] = self._locate(distance, usable)
        known = bool(frame.statistics.known[0])
        self._unknown_frames = 0 if known else self._unknown_frames + 1
        if verdict > Verdict.USUAL or not known:
            self.baseline.skip(1)
        if self.state is not DetectorState.QUIET:
            return self._exclude_frame(frame.statistics, codes)
        if self._unusual_frames() >= MOTION_FRAMES:
            self._begin(codes)
        elif verdict <= Verdict.USUAL and known:
            self._learn(frame.statistics, codes, frame.outliers)
            if frame.outliers is not None:
                self._exclude_outliers(values, frame.outliers, place)
        return False

    def _without_outliers(self, frames: FrameStatistics, distance: Floats, usable: Bools) -> AssessedFrame:
        """Compare a frame with the baseline, without its outliers if these explain what is unusual."""
        unusual = self.baseline.unusual(frames)
        # While everything is excluded, or before anything is known, the baseline is not that of this frame. It may
        # become one of the next baseline, in which outliers would raise the scales: they are always removed.
        untried = self.state is not DetectorState.QUIET or not self.baseline.ready
        if not untried and not unusual.any():
            return AssessedFrame(frames, unusual)
        limit = limit_of_samples(distance, usable)
        if not untried:  # a knock fills a part of its frame and raises the frame's own scale
            limit = np.minimum(limit, self.baseline.peak_limit)
        outliers = self.outliers.search(distance, usable, limit)
        if outliers is None:
            return AssessedFrame(frames, unusual)
        rest = self._without(outliers, distance, usable)
        still_unusual = self.baseline.unusual(rest)
        if still_unusual.any() and not untried:
            return AssessedFrame(frames, unusual)
        return AssessedFrame(rest, still_unusual, outliers)

    def _verdict(self, frame: AssessedFrame) -> Verdict:
        """Return what a frame shows."""
        if not frame.unusual.any():
            known = self.baseline.ready and bool(frame.statistics.known[0])
            return Verdict.USUAL if known else Verdict.UNKNOWN
        if np.count_nonzero(frame.unusual) >= SEVERAL_AXES or self.baseline.moved(frame.statistics).any():
            return Verdict.SEVERAL
        return Verdict.ONE_AXIS

    def _learn(self, frames: FrameStatistics, codes: Codes, outliers: Bools | None = None) -> None:
        """Learn from quiet frames."""
        self.outliers.count(outliers, len(frames.mean))
        baseline = self.baseline
        # the steps of a coarse channel end anywhere: its peaks say nothing of a tail
        limit = np.where(baseline.peak_limit > baseline.usual_sample, np.inf, baseline.usual_sample)
        self.outliers.count_tails(frames.peak, limit, outliers)
        self.baseline.add(frames)
        if not self._still_rests():
            codes[-1:] = ReasonCode.MOTION  # the scales change with the last frame that is learned

    def _exclude_outliers(self, values: Floats, outliers: Bools, place: int) -> None:
        """Exclude outliers (c, k, PARTS, part) of channels in which they are not noise, and those beyond heavy tails.

        Parameters
        ----------
        values : (c, k, PARTS, part) channel unit.
        place : on the grid, of the first sample.
        """
        excluded = outliers & ~self.outliers.noise[:, None, None, None]
        if self.outliers.tails.any():
            distance = np.abs(values - self.baseline.level[:, None, None, None])
            reach = np.where(self.outliers.tails, TAIL_REACH * self.baseline.usual_sample, 0.0)
            excluded &= distance > reach[:, None, None, None]
        by_channel = excluded.reshape(len(excluded), -1)
        if not by_channel.any():
            return
        distances = np.abs(values.reshape(len(values), -1) - self.baseline.level[:, None])
        # one bit error of any size counts as no more than the farthest sample that a tail may have
        reached = np.minimum(distances, TAIL_REACH * self.baseline.usual_sample[:, None])
        self.outliers.excluded_squares += np.square(reached).sum(axis=1, where=by_channel)
        for row in np.flatnonzero(by_channel.any(axis=0)).tolist():
            farthest: dict[int, Outlier] = {}  # by group: a sample of a sensor is excluded once
            for c in np.flatnonzero(by_channel[:, row]).tolist():
                group, size = self.group_of[c], float(distances[c, row])
                if group not in farthest or size > farthest[group].size:
                    farthest[group] = Outlier(place + row, group, self.channels[c], size)
            self.single_samples += farthest.values()

    def _locate(self, distance: Floats, usable: Bools) -> Codes:
        """Return (PARTS,) codes of an unusual frame: the parts that explain it, or all of them.

        Parameters
        ----------
        distance : (c, 1, PARTS, part) channel unit, from the origin; 0.0 if not usable.
        usable : (1, PARTS, part).
        """
        baseline = self.baseline
        from_level = distance[:, 0] - (baseline.level - baseline.origin)[:, None, None]
        from_level *= usable[0]
        # The mean of this frame contains the knock, so distances are from the level; the usual distance between
        # the two is added to the limits.
        sample_limit = baseline.usual_sample + baseline.usual_level
        part_limit = baseline.usual_part + baseline.usual_level
        differs = (np.abs(from_level) > sample_limit[:, None, None]).any(axis=(0, 2))
        differs |= (np.abs(from_level.mean(axis=2)) > part_limit[:, None]).any(axis=0)
        if 0 < differs.sum() <= LOCATED_SHARE * PARTS:
            rest = usable & ~differs[None, :, None]
            # If the other parts are unusual without these, the disturbance reaches beyond them.
            if not baseline.unusual(FrameStatistics.of(distance * rest, rest, baseline.origin)).any():
                return np.where(differs, ReasonCode.KNOCK, ReasonCode.NONE).astype(np.int8)
        return np.full(PARTS, ReasonCode.KNOCK, dtype=np.int8)

    # ------------------------------------------------------------------ transitions

    def _unusual_frames(self, least: Verdict = Verdict.ONE_AXIS) -> int:
        """Return how many of the last frames show at least this."""
        return sum(verdict >= least for verdict in self._window)

    def _mostly_several(self) -> bool:
        return self._unusual_frames(Verdict.SEVERAL) >= MOTION_FRAMES

    def _begin(self, codes: Codes) -> None:
        """Begin to exclude everything: most frames are unusual."""
        self.state = DetectorState.MOVING if self._mostly_several() else DetectorState.DISTURBED
        self._candidates = []
        codes[:] = self._code

    @property
    def _code(self) -> ReasonCode:
        """Code of every frame in a state that excludes everything."""
        return ReasonCode.KNOCK if self.at_rest else ReasonCode.MOTION

    def _exclude_frame(self, frames: FrameStatistics, codes: Codes) -> bool:
        """Exclude a frame as the state says; return whether a new baseline begins behind it, and the record breaks."""
        if self.state is DetectorState.DISTURBED and self._mostly_several():
            self.state = DetectorState.MOVING  # what began in one axis is motion
        codes[:] = self._code
        if frames.known[0]:
            self._candidates.append(frames)
        elif self._unknown_frames >= FIRST_FRAMES:  # as long as the gaps for which the guard calls `end`
            self._candidates = []
        if self._window[-2:] == [Verdict.USUAL] * 2:
            # The old noise between two bursts of another one is no part of a new rest. One frame alone may be usual by
            # chance.
            self._candidates = []
        # Unknown frames count as usual here. Nothing is seen to move any more: otherwise a sensor that was put down
        # while its samples were lost would be "not at rest" for as long as they are. Motion that continues is compared
        # with the same baseline, excluded frame by frame, and recognised again. Without a baseline nothing is unusual,
        # so that five such frames say nothing: only a new one ends motion.
        if self.baseline.ready and max(self._window[-RETURN_FRAMES:]) <= Verdict.USUAL:
            self._return()
            return False
        if len(self._candidates) < REST_FRAMES:
            return False
        candidates, self._candidates = FrameStatistics.joined(self._candidates), []
        trial = self._new_baseline()
        trial.add(candidates)
        if not trial.at_rest:
            return False
        self._adopt(trial)
        # a break is one of all sensors: a magnet nearby must not break the gyroscope's record
        return self.inertial

    def _return(self) -> None:
        """Return to learning: the baseline still holds."""
        self.state, self._candidates = DetectorState.QUIET, []

    def _adopt(self, baseline: NoiseBaseline) -> None:
        """Take the noise of the last frames as the usual one from now on."""
        self.state, self.baseline = DetectorState.QUIET, baseline
        self._window = [Verdict.USUAL] * WINDOW_FRAMES  # the old verdicts compare with the old baseline

    def _still_rests(self) -> bool:
        """Return whether the baseline can still be rest; else discard it."""
        if not self.inertial or self.baseline.at_rest:
            return True
        self._discard_baseline()
        return False

    def _discard_baseline(self) -> None:
        """Begin again: what was learned is motion."""
        self.state = DetectorState.MOVING
        self.baseline = self._new_baseline()
        self._candidates = []
