"""Guard: find the samples that are not the sensor's own noise and exclude them.

Tables are knocked, lines glitch, ranges clip and sensors hang. One sample of +1 rad/s in five hours triples
N. The guard holds samples back for one to two frames (four at the beginning; a frame is about a second, and
ten samples at low rates). The detectors assess each frame (`disturbance` by the noise of the sensor, `stuck`
by repeats), and the guard passes all samples on in order. Excluded samples are marked invalid, with a margin
before and after. Every exclusion has a reason, is counted by samples and reported as a `Disturbance`.

Rules:

- Gyroscope and accelerometer share a table: a disturbance of one excludes both. The magnetometer is assessed
  by itself. Other sensors (temperature, pressure) pass unchanged.
- A single sample that is far off (`outliers`) is excluded by itself, on its own sensor and without a margin.
- The result depends on the grid alone: any chunking of the input gives the same exclusions.
- Statistics do not wait for the first assessment: until then, `pending` holds the samples that it will pass
  on, unfiltered. Later results differ by the excluded samples only.
- The guard applies margins and order, and `exclusions` counts. The detectors decide which samples are unusual.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.noise.array_state import ArrayState, subset
from imumon.noise.detection.disturbance import (
    INERTIAL,
    REASONS,
    Codes,
    Disturbance,
    DisturbanceDetector,
    Reason,
    ReasonCode,
)
from imumon.noise.detection.exclusions import Exclusions
from imumon.noise.detection.frame_statistics import FIRST_FRAMES, PARTS
from imumon.noise.detection.stuck import RepeatDetector
from imumon.samples import Bools, Floats


@dataclass(frozen=True, slots=True)
class GuardedSamples:
    """Output of the guard: a break, a gap, or samples, to be applied in this order.

    Attributes
    ----------
    values : (n, c) channel unit.
    valid : (n, g) received and not excluded.
    skipped : missing samples before `values`.
    broken : a gap of unknown length, or a new level, precedes it: differences must not span it.
    """

    values: Floats
    valid: Bools
    skipped: int = 0
    broken: bool = False


class Guard(ArrayState):
    """Delay line that marks disturbed samples invalid.

    Parameters
    ----------
    sensors : (c,) sensor of each channel ("gyro", "accel", "mag", ...). Each sensor is a group, in the order
        of the first channels.
    rate_hz : Hz, sampling rate.
    excludes : False: only detect whether the sensor is at rest; everything passes unchanged.

    Attributes
    ----------
    sensors, groups : (c,) sensor and group of each channel.
    """

    _STATE = ("_values", "_valid", "_saturated", "_codes", "_tail", "_index", "_started", "_was_stuck")

    def __init__(self, sensors: Sequence[str], rate_hz: float, *, excludes: bool = True) -> None:
        self.sensors, self._rate, self._excludes = tuple(sensors), rate_hz, excludes
        names = list(dict.fromkeys(sensors))
        self.groups = tuple(names.index(s) for s in sensors)
        self._part = max(1, round(rate_hz / PARTS))
        self._frame = self._part * PARTS
        self._detectors = [
            DisturbanceDetector(sensors, kinds, self._frame)
            for kinds in (INERTIAL, ("mag",))
            if any(s in kinds for s in names)
        ]
        self._exclusions = Exclusions(self._detectors, self._part, self._frame)
        self._repeats = RepeatDetector(self.groups, self._frame)
        self._values = np.zeros((len(self.groups), 0)).T  # column-major: channels are contiguous
        self._valid = np.zeros((0, len(names)), dtype=bool)
        self._saturated = np.zeros(0, dtype=bool)
        self._codes = np.zeros((0, len(self._detectors)), dtype=np.int8)  # of the parts assessed
        self._tail = np.zeros((PARTS, len(self._detectors)), dtype=np.int8)  # of the parts passed on last
        self._index = 0  # place on the grid of the first row that is held back
        self._started = False
        self._breaks: list[int] = []  # places on the grid before which the record breaks
        self._stuck_changes: list[tuple[int, bool]] = []
        self._was_stuck = False

    @property
    def at_rest(self) -> bool:
        """False while the sensor moves or is handled."""
        return all(detector.at_rest for detector in self._detectors if detector.inertial)

    @property
    def disturbances(self) -> int:
        """Number of disturbances so far, a running one included."""
        return self._exclusions.disturbances

    @property
    def noisy_outliers(self) -> Bools:
        """(c,) Channels whose outliers are noise and are not excluded."""
        noisy = np.zeros(len(self.groups), dtype=bool)
        for detector in self._detectors:
            noisy[detector.channels] = detector.outliers.noise
        return noisy

    @property
    def stuck(self) -> bool:
        """Whether gyroscope or accelerometer, or an axis of them, repeats its values now."""
        return self._was_stuck

    @property
    def excluded(self) -> dict[Reason, int]:
        """Samples excluded so far by reason; those of the magnetometer alone are "magnetic"."""
        return {reason: int(n) for reason, n in zip(REASONS, self._exclusions.counts[1:], strict=True) if n}

    @property
    def excluded_samples(self) -> int:
        """Excluded samples of gyroscope and accelerometer, or of a stream that has neither."""
        inertial = any(detector.inertial for detector in self._detectors)
        counts = self._exclusions.counts
        return int(counts[: ReasonCode.MAGNETIC].sum() if inertial else counts.sum())

    @property
    def held(self) -> int:
        """Samples that are held back."""
        return len(self._values)

    @property
    def pending(self) -> GuardedSamples | None:
        """Samples that the first assessment will pass on; None after it."""
        if self._started:
            return None
        rows = slice((FIRST_FRAMES - 1) * self._frame)
        return GuardedSamples(self._values[rows], self._valid[rows])

    def events(self) -> list[Disturbance]:
        """Return the disturbances that ended since the last call, in order."""
        ended, self._exclusions.events = self._exclusions.events, []
        return ended

    def rest_changes(self) -> list[tuple[int, bool]]:
        """Return the places on the grid where motion began (False) or ended (True) since the last call."""
        changes: list[tuple[int, bool]] = []
        for detector in self._detectors:
            if detector.inertial:
                changes, detector.rest_changes = detector.rest_changes, []
        return changes

    def stuck_changes(self) -> list[tuple[int, bool]]:
        """Return the places on the grid where `stuck` changed since the last call, and its new value."""
        changes, self._stuck_changes = self._stuck_changes, []
        return changes

    def update(
        self, values: Floats, valid: Bools | None = None, saturated: Bools | None = None
    ) -> list[GuardedSamples]:
        """Add samples and return those that are assessed.

        Parameters
        ----------
        values : (n, c) channel unit.
        valid : (n, g) received; None: all.
        saturated : (n,) samples that the sensor reports as out of range; None: unknown.
        """
        n, groups = len(values), self._valid.shape[1]
        received = np.ones((n, groups), dtype=bool) if valid is None else valid
        flags = np.zeros(n, dtype=bool) if saturated is None else saturated
        self._values = np.concatenate((self._values.T, values.T), axis=1).T
        self._valid = np.concatenate((self._valid, received))
        self._saturated = np.concatenate((self._saturated, flags))
        self._assess_ready(FIRST_FRAMES)
        return self._pass_on(len(self._codes) // PARTS - 1)

    def skip(self, n: int) -> list[GuardedSamples]:
        """Note that `n` samples are missing; return the samples that are assessed."""
        fill = -len(self._values) % self._frame
        whole = max(0, n - fill) // self._frame
        if whole < FIRST_FRAMES:
            return self._missing(n)
        out, rows = self._drain(fill), whole * self._frame
        out.append(GuardedSamples(self._values, self._valid, skipped=rows))
        self._index += rows
        for detector in self._detectors:
            detector.baseline.skip(whole)
        return out + self._missing(n - fill - rows)

    def break_(self) -> list[GuardedSamples]:
        """Note a gap of unknown length; return all samples that are held back, and the break."""
        return [*self.flush(), GuardedSamples(self._values, self._valid, broken=True)]

    def flush(self) -> list[GuardedSamples]:
        """Return all samples that are held back; the next sample starts a new grid of frames."""
        fill = -len(self._values) % self._frame
        out = self._drain(fill)
        if fill:
            out[-1] = replace(out[-1], values=out[-1].values[:-fill], valid=out[-1].valid[:-fill])
        self._index -= fill
        self._breaks = [min(place, self._index) for place in self._breaks]
        self._stuck_changes = [(min(place, self._index), now) for place, now in self._stuck_changes]
        for detector in self._detectors:
            detector.rest_changes = [(min(place, self._index), now) for place, now in detector.rest_changes]
        events = self._exclusions.events
        self._exclusions.events = [replace(e, length=min(e.length, self._index - e.start)) for e in events]
        return out

    def _drain(self, fill: int) -> list[GuardedSamples]:
        """Complete the last frame with `fill` missing samples; return all samples, and end disturbances."""
        out = self._missing(fill)
        self._assess_ready(min(FIRST_FRAMES, max(1, len(self._values) // self._frame)))
        out += self._pass_on(len(self._codes) // PARTS)
        self._exclusions.end_all()
        self._tail = np.zeros_like(self._tail)
        return out

    def _missing(self, n: int) -> list[GuardedSamples]:
        if n <= 0:
            return []
        groups = self._valid.shape[1]
        return self.update(np.zeros((n, len(self.groups))), np.zeros((n, groups), dtype=bool))

    def _assess_ready(self, least: int) -> None:
        """Assess the complete frames; assess the first `least` of them together."""
        while (ready := len(self._values) // self._frame - len(self._codes) // PARTS) > 0:
            if self._started:
                changes = [self._repeats.next_change, *(d.baseline.next_change for d in self._detectors)]
                self._assess(min(ready, *changes))
            elif ready >= least:
                self._assess(least)
                self._started = True
            else:
                return

    def _assess(self, k: int) -> None:
        """Determine the codes of the parts of the next `k` frames."""
        done = len(self._codes) * self._part
        rows = slice(done, done + k * self._frame)
        values, valid, saturated = self._values[rows], self._valid[rows], self._saturated[rows]
        stuck = self._repeats.update(values, valid)
        self._note_stuck(stuck, valid, self._index + done)
        codes = np.zeros((k, PARTS, len(self._detectors)), dtype=np.int8)
        clean = bool(valid.all()) and not (stuck.any() or saturated.any())
        shape = (k, PARTS, self._part)
        for w, detector in enumerate(self._detectors):
            x, own, usable = values.T[detector.channels].reshape(-1, *shape), codes[..., w], None
            if not clean:
                received = np.asarray(valid[:, detector.groups].all(axis=1), dtype=bool)
                repeats = np.asarray(stuck[:, detector.groups].any(axis=1), dtype=bool)
                usable = (received & ~(repeats | saturated)).reshape(shape)
            if self._started:
                self._breaks += detector.assess(x, usable, own, self._index + done)
            else:
                detector.assess_first(x, usable, own, self._index + done)
            if not clean:
                for code, hit in ((ReasonCode.CLIPPED, saturated), (ReasonCode.STUCK, repeats)):
                    own[np.any((hit & received).reshape(shape), axis=2)] = code
        self._repeats.learn(k)
        self._codes = np.concatenate((self._codes, codes.reshape(-1, len(self._detectors))))

    def _note_stuck(self, stuck: Bools, valid: Bools, index: int) -> None:
        """Note in which frames gyroscope or accelerometer begin or end to repeat their values.

        Parameters
        ----------
        stuck, valid : (n, g) rows of whole frames; one without a valid row changes nothing.
        index : place on the grid of the first row.
        """
        inertial = next((each for each in self._detectors if each.inertial), None)
        if inertial is None or not (self._was_stuck or stuck.any()):
            return
        repeats: Bools = np.asarray(stuck[:, inertial.groups].any(axis=1))
        received: Bools = np.asarray(valid[:, inertial.groups].any(axis=1))
        for f in range(len(stuck) // self._frame):
            rows = slice(f * self._frame, (f + 1) * self._frame)
            known = np.flatnonzero(received[rows])
            if not len(known):
                continue
            now = bool(repeats[rows][known[-1]])
            if now != self._was_stuck:
                self._was_stuck = now
                self._stuck_changes.append((index + (f + 1) * self._frame, now))

    def _pass_on(self, frames: int) -> list[GuardedSamples]:
        """Return the first `frames` frames, with their exclusions and margins."""
        if frames <= 0:
            return []
        parts = frames * PARTS
        n = parts * self._part
        values, valid = self._values[:n], self._valid[:n]
        around = np.concatenate((self._tail, self._codes[: parts + PARTS]))
        taken = np.zeros(n, dtype=bool)
        if not self._excludes:
            self._breaks = []
        elif around.any():
            marked = np.stack([_with_margins(column) for column in around.T], axis=1)
            taken = self._exclusions.mark(values, valid, marked[PARTS : PARTS + parts], self._index)
        else:
            self._exclusions.end(self._detectors)
            for detector in self._detectors:
                self._exclusions.refer(detector, values, valid, n)
        self._exclusions.mark_outliers(valid, taken, self._index, excludes=self._excludes)
        self._tail = self._codes[parts - PARTS : parts]
        self._codes, self._saturated = self._codes[parts:], self._saturated[n:]
        self._values, self._valid = self._values[n:].copy(order="F"), self._valid[n:].copy()
        begin, self._index = self._index, self._index + n
        out, last = [], 0
        for place in [b for b in self._breaks if b < self._index]:
            at = max(0, place - begin)
            if at > last:
                out.append(GuardedSamples(values[last:at], valid[last:at]))
            out.append(GuardedSamples(values[:0], valid[:0], broken=True))
            last = at
        self._breaks = [b for b in self._breaks if b >= self._index]
        out.append(GuardedSamples(values[last:], valid[last:]))
        return out

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays, without running disturbances and unread events."""
        out = super().save() | {"sensors": np.array(self.sensors), "rate": np.array(self._rate)}
        out |= {"excludes": np.array(self._excludes), "breaks": np.array(self._breaks, dtype=np.int64)}
        for prefix, part in self._parts().items():
            out |= {prefix + name: value for name, value in part.save().items()}
        return out

    @classmethod
    def restore(cls, saved: Mapping[str, np.ndarray]) -> Guard:
        """Return a guard that continues from a saved state."""
        self = cls([str(s) for s in saved["sensors"]], float(saved["rate"]), excludes=bool(saved["excludes"]))
        self.load(saved)
        self._breaks = saved["breaks"].tolist()
        for prefix, part in self._parts().items():
            part.load(subset(saved, prefix))
        return self

    def _parts(self) -> dict[str, ArrayState]:
        """Return the objects that are saved with the guard, by the prefix of their arrays."""
        parts: dict[str, ArrayState] = {f"detector{w}.": d for w, d in enumerate(self._detectors)}
        return parts | {"repeats.": self._repeats, "exclusions.": self._exclusions}


def _with_margins(codes: Codes) -> Codes:
    """Return the codes of parts with margins; if several apply, the highest.

    Half a frame before, because a disturbance begins below the threshold, and a frame after, while it rings down and
    the filter of the sensor settles.
    """
    out, before = codes.copy(), PARTS // 2
    for code in np.unique(codes[codes > 0]).tolist():
        reach = np.convolve(codes == code, np.ones(before + PARTS + 1)) > 0.5
        reach = reach[before : before + len(codes)]
        np.maximum(out, np.int8(code), out=out, where=reach)
    return out
