"""Watch: the channels that sit on one table, what is usual there, and what is not.

Judges frame after frame against the `NoiseBaseline` and learns from the quiet ones. A frame that differs is
searched part by part; where some parts explain it, only they are marked. Disturbed for most of ten frames
means not at rest: everything is marked until five quiet frames follow, or until sixteen frames at a new level
or with a new noise look like rest by themselves; they become the reference then (the engine was started, the
table was tilted), and the record breaks there, since a difference across would be no noise either.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from imumon.noise.detection.baseline import PARTS, Frames, NoiseBaseline
from imumon.samples import Bools, Floats

Codes: TypeAlias = npt.NDArray[np.int8]
Reason: TypeAlias = Literal["glitch", "knock", "motion", "clipped", "stuck", "loop", "magnetic"]
REASONS: tuple[Reason, ...] = ("glitch", "knock", "motion", "clipped", "stuck", "loop", "magnetic")
"""Reasons in rising order of rank: where several hold, the last one is told. Codes are their places, from
1."""

GLITCH, KNOCK, MOTION, CLIPPED, STUCK, LOOP, MAGNETIC = range(1, 8)
INERTIAL = ("gyro", "accel")
RESTLESS_OF_TEN = 8
QUIET_AGAIN = 5
SETTLED = 16
STRAY = 0.15
"""Share of frames that a new reference may find restless among those it was learned from."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A stretch that was cut out.

    Attributes
    ----------
    kind : the reason.
    start : samples on the grid since the guard began, margin included.
    length : samples, margins included.
    size : channel unit, greatest distance from the level; None where that says nothing (stuck, loop).
    channel : index of the channel where that distance is greatest against its noise, or which alone is
        stuck; None: no single one.
    """

    kind: Reason
    start: int
    length: int
    size: float | None
    channel: int | None


class DisturbanceDetector:
    """Guards the channels of some sensors together.

    Parameters
    ----------
    sensors : sensor of each channel of the stream.
    kinds : the sensors to watch.
    frame : samples of a frame, a multiple of `PARTS`.
    rate_hz : Hz.

    Attributes
    ----------
    channels, groups : what is watched, as places in the stream.
    reference : what is usual.
    moving : frames since the motion was recognised, 0 at rest.
    open : the disturbance that is running: start, end, code; empty when none is.
    """

    def __init__(self, sensors: Sequence[str], kinds: tuple[str, ...], frame: int, rate_hz: float) -> None:
        self.inertial = kinds == INERTIAL
        self.channels = [i for i, s in enumerate(sensors) if s in kinds]
        self.groups = [g for g, s in enumerate(dict.fromkeys(sensors)) if s in kinds]
        self._fresh = tuple(sensors[i] for i in self.channels), frame, rate_hz
        self.reference = NoiseBaseline(*self._fresh)
        self.moving = 0
        self._restless = [False] * 10  # the last frames, newest last
        self._lately: list[Frames] = []  # while moving: candidates for a new reference
        self.open: list[int] = []
        self._size = (0.0, 0.0, 0)  # of it: relative to the noise, in channel unit, channel
        self._repeats = np.zeros(len(self.channels), dtype=np.int64)  # of it: values like the one before

    def compare(self, x: Floats, seen: Bools | None, codes: Codes, index: int) -> list[int]:
        """Judge frames, learn from the quiet ones; returns where on the grid the record breaks.

        Parameters
        ----------
        x : (c, k, PARTS, part) channel unit.
        seen : (k, PARTS, part) rows that may be judged; None: all.
        codes : (k, PARTS), to be written.
        index : place on the grid of the first row.
        """
        k, frame = x.shape[1], x.shape[2] * x.shape[3]
        if not self.moving and not any(self._restless):
            frames, _ = self._figures(x, seen)
            if frames.known.all() and not self.reference.restless(frames).any():
                self._learn(frames, codes)
                return []
        breaks = []
        for f in range(k):
            one = None if seen is None else seen[f : f + 1]
            if self._one(x[:, f : f + 1], one, codes[f : f + 1]):
                breaks.append(index + (f + 1) * frame)
        return breaks

    def begin(self, x: Floats, seen: Bools | None, codes: Codes) -> None:
        """Judge the first frames by one another, so that a record may begin with a knock.

        Parameters
        ----------
        x, seen, codes : as of `compare`.
        """
        frames, _ = self._figures(x, seen)
        self.reference.add(frames[frames.known])
        if not self.reference.ready:
            return
        restless = self.reference.restless(frames).any(axis=1)
        for f in np.flatnonzero(restless).tolist():
            one = None if seen is None else seen[f : f + 1]
            codes[f] = self._search(self._figures(x[:, f : f + 1], one)[1], one)
        self._restless = [*self._restless, *np.ravel(restless).tolist()][-len(self._restless) :]
        quiet = frames.known & ~restless
        if restless.any() and quiet.sum() >= 2:
            self.reference = NoiseBaseline(*self._fresh)
            self.reference.add(frames[quiet])
        self._doubt(codes)

    def _figures(self, x: Floats, seen: Bools | None) -> tuple[Frames, Floats]:
        d = x - self.reference.origin[:, None, None, None]
        if seen is not None:
            d *= seen
        return Frames.of(d, seen, self.reference.origin), d

    def _one(self, x: Floats, seen: Bools | None, codes: Codes) -> bool:
        """Judge one frame; True where the record breaks behind it."""
        frames, d = self._figures(x, seen)
        restless = bool(self.reference.restless(frames).any())
        self._restless = [*self._restless[1:], restless]
        if restless:
            codes[:] = self._search(d, seen)
        if restless or not frames.known[0]:
            self.reference.miss(1)
        if self.moving:
            self.moving += 1
            codes[:] = MOTION
            if frames.known[0]:
                self._lately.append(frames)
            if self.reference.ready and not any(self._restless[-QUIET_AGAIN:]):
                self.moving, self._lately = 0, []
            elif len(self._lately) >= SETTLED:
                return self._settled()
        elif sum(self._restless) >= RESTLESS_OF_TEN:
            self.moving, self._lately = 1, []
            codes[:] = MOTION
        elif not restless and frames.known[0]:
            self._learn(frames, codes)
        return False

    def _learn(self, frames: Frames, codes: Codes) -> None:
        """Add quiet frames."""
        self.reference.add(frames)
        self._doubt(codes)

    def _doubt(self, codes: Codes) -> None:
        """Where what was taken for noise turns out to be motion, forget it."""
        if self.inertial and not self.reference.rests:
            self.reference = NoiseBaseline(*self._fresh)
            self.moving, self._lately = 1, []
            codes[:] = MOTION

    def _settled(self) -> bool:
        """Take the last frames as the new reference if they are rest by themselves."""
        frames = Frames.joined(self._lately)
        self._lately = []
        trial = NoiseBaseline(*self._fresh)
        trial.add(frames)
        if not trial.rests or trial.restless(frames).any(axis=1).mean() > STRAY:
            return False
        self.reference, self.moving = trial, 0
        self._restless = [False] * len(self._restless)
        return self.inertial

    def _search(self, d: Floats, seen: Bools | None) -> Codes:
        """(PARTS,) codes of a restless frame: the parts that explain it, or all of them.

        Parameters
        ----------
        d : (c, 1, PARTS, part) channel unit, distance from the level; 0.0 where not seen.
        seen : (1, PARTS, part) or None.
        """
        reference = self.reference
        far = d[:, 0] - (reference.level - reference.origin)[:, None, None]
        if seen is not None:
            far *= seen[0]
        samples = np.abs(far) > (reference.sample + reference.shift)[:, None, None]
        hit = samples.any(axis=(0, 2))
        rows = np.flatnonzero(samples.any(axis=0))
        glitch = len(rows) > 0 and bool(rows[-1] - rows[0] <= 1)
        if not glitch:
            means = np.abs(far.mean(axis=2)) > (reference.part + reference.shift)[:, None]
            hit |= means.any(axis=0)
        if 0 < hit.sum() <= PARTS // 2:
            rest = np.array(np.broadcast_to(~hit[None, :, None], d.shape[1:]))
            if seen is not None:
                rest &= seen
            if not reference.restless(Frames.of(d * rest, rest, reference.origin)).any():
                return np.where(hit, GLITCH if glitch else KNOCK, 0).astype(np.int8)
        return np.full(PARTS, KNOCK, dtype=np.int8)

    def miss(self, frames: int) -> None:
        """So many frames are missing altogether."""
        self.reference.miss(frames)

    def extend(self, start: int, end: int, code: int, values: Floats) -> None:
        """A disturbance begins or goes on; `values` (n, c) are its samples in all channels of the stream."""
        if not self.open:
            self.open, self._size = [start, end, code], (0.0, 0.0, 0)
            self._repeats[:] = 0
        self.open[1:] = [end, max(code, self.open[2])]
        if not len(values):
            return
        self._repeats += (np.diff(values[:, self.channels], axis=0) == 0.0).sum(axis=0)
        far = np.abs(values[:, self.channels] - self.reference.level).max(axis=0)
        relative = far / np.maximum(self.reference.sample, np.finfo(np.float64).tiny)
        worst = int(np.argmax(relative))
        if relative[worst] >= self._size[0]:
            self._size = (float(relative[worst]), float(far[worst]), self.channels[worst])

    def closed(self) -> Disturbance:
        """End of the running disturbance, which is then forgotten."""
        start, end, code = self.open
        self.open = []
        told = self.inertial or code in (CLIPPED, STUCK, LOOP)
        sized = code not in (STUCK, LOOP) and self._size[1] > 0.0
        size, channel = (self._size[1], self._size[2]) if sized else (None, None)
        if code == STUCK and np.median(self._repeats) < 0.5 * self._repeats.max():
            channel = self.channels[int(np.argmax(self._repeats))]  # one axis alone
        return Disturbance(REASONS[code - 1] if told else "magnetic", start, end - start, size, channel)

    def save(self) -> dict[str, np.ndarray]:
        """State as arrays."""
        out: dict[str, np.ndarray] = {"state": np.array([self.moving, *self._restless], dtype=np.int64)}
        if self._lately:
            frames = Frames.joined(self._lately)
            out |= {f"lately.{name}": getattr(frames, name) for name in Frames.__slots__}
        return out | {f"reference.{name}": value for name, value in self.reference.save().items()}

    def restore(self, saved: dict[str, np.ndarray]) -> None:
        """Continue where `save` left off."""
        self.moving = int(saved["state"][0])
        self._restless = [bool(v) for v in saved["state"][1:]]
        self._lately = []
        if lately := under(saved, "lately."):
            frames = Frames(*(lately[name] for name in Frames.__slots__))
            self._lately = [frames[i : i + 1] for i in range(len(frames.mean))]
        self.reference.restore(under(saved, "reference."))


def under(saved: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """The part of a saved state whose names begin with `prefix`, which is taken off."""
    return {name.removeprefix(prefix): value for name, value in saved.items() if name.startswith(prefix)}
