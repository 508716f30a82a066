"""Guard: find the samples that are not the sensor's own noise and exclude them.

Tables are knocked, lines glitch, ranges clip and sensors hang. One sample of +1 rad/s in five hours triples N. The
guard holds samples back for one to two frames, lets the detectors assess them, and passes all of them on in order: the
disturbed ones marked invalid, with a margin before and after.

Words
-----
    sample, row    one tick of the grid, of all channels; rows of an array are samples
    frame, part    about 1 s, and a tenth of it. At 10 Hz and less a part is one sample
    place          number of a sample on the grid since the guard began, lost samples included
    sensor, group  gyroscope, accelerometer, ...; a group is the number of a sensor, and its axes share their validity
    valid          received and not excluded
    usable         received on all sensors that are assessed together, and not stuck: it may be assessed
    known          a frame with enough usable samples
    code           of a part: 0, or why it is excluded (`ReasonCode`)

Life of a frame
---------------
    held      its samples arrive; later ones do not change what they are
    assessed  `stuck` and `disturbance` give codes to its parts. The frame waits for the next one, because the margin
              before a disturbance reaches half a frame back
    passed    margins are applied, the samples leave, and `exclusions` counts and reports

A record begins once: its first four frames, or fewer if it ends or breaks before, are assessed by one another
(`_assess_first`). Each frame behind them is compared with the noise before it (`_assess_next`).

Statistics do not wait for the first assessment: until then, `pending` holds the samples that it will pass on,
unfiltered. Later results differ by the excluded samples only.

Missing samples are rows without a valid one, so that frames keep their length. A gap that leaves less than four
whole frames is filled with such rows. A longer one ends everything that runs: disturbances, their margins, motion, and
the windows of frames by which detectors decide (`DisturbanceDetector.end`). It is passed on as a number, and the level
may have moved the farther the longer it was (`NoiseBaseline.skip`). A gap of unknown length does the same, begins a new
grid of frames, and does not widen the limit of the level, because the necessary width is unknown.

Order of the decisions on one frame. Of the codes that a part gets, the one with the highest rank counts (`REASONS`):

    1. `stuck` finds the samples that repeat, but for those at the end of their range. They are not assessed by 2
    2. `disturbance` compares what is left with the noise before: usual, outliers, knock of parts or frame, motion
    3. clipping: the range that the device says is exceeded replaces the code of 2 on its own sensor
    4. stuck replaces both
    5. margins, where the codes of parts meet, and last the outliers, in what is still valid

An exclusion does not reach the fit. The fit sees missing samples, as if they had never arrived.

Rules
-----
- Gyroscope and accelerometer share a table: a disturbance of one excludes both. The magnetometer is assessed by
  itself. Other sensors (temperature, pressure) pass unchanged.
- A range that is exceeded excludes its own sensor, with margins. The blow behind it is a knock for both, if it is one.
- An outlier is excluded alone, on its sensor and without a margin.
- Every exclusion has a reason, is counted by samples and reported as a `Disturbance`.
- The result depends on the grid alone: any division of the input into blocks gives the same exclusions.

What passes unassessed
----------------------
    what                                              why it passes
    the last fraction of a frame of a record          missing samples complete it: assessed if a fifth is there
    frames with fewer than a fifth of their samples   they are compared with nothing; excluded in a knock or motion
    a sample whose neighbour sensor has none          gyroscope and accelerometer are assessed where both were received
    a record with fewer than two known frames         no noise is usual yet
    less than 7 sigma, or 1.5 times the noise         noise does the same; a knock of 3 sigma shows in the mean of 0.1 s
    slow motion                                       the level follows over 8 s; noise of 1.5e-3 rad/s or 0.03 m/s^2 at
                                                      1 s is rest whatever it is, and so is a turn below 0.1 rad/s
    single samples of an axis with heavy tails        above 1 %, or where the tail reaches them, they are its noise
    anything on an axis that was never live           constant from the beginning, or held for eight samples and more
                                                      (`baseline`); one that dies later is stuck, and excludes all axes
    the first repeats of a stuck output               a sample repeats four times, an axis for 2 s, before it is stuck;
                                                      the margin takes 0.5 s of them; a coarse axis is never stuck
    the first frames of slow trouble                  motion that is recognised after 8 or 16 frames begins there
    clipping                                          only the device knows its range; if it does not say, nothing does
    motion, on a magnetometer                         it is assessed by its own field alone
    temperature, pressure                             nothing assesses them
    everything, with `excludes=False`                 rest and motion are only reported
    what `pending` shows before the first assessment  a report should not wait; it is assessed with the first frames

Example: a minute at 40 Hz. One sample of +1 rad/s is excluded alone; a knock of 2 s with a margin before and after.

>>> random = np.random.default_rng(1)
>>> gyro = 4e-4 * random.standard_normal((2400, 3))  # rad/s
>>> gyro[800, 1] += 1.0
>>> gyro[1600:1680] += 0.1 * random.standard_normal((80, 3))
>>> guard = Guard(("gyro",) * 3, rate_hz=40.0)
>>> passed = guard.update(gyro) + guard.flush()
>>> for event in guard.events():
...     print(event.kind, event.start, event.length, f"{event.size:.1f}")
knock 1580 140 0.3
glitch 800 1 1.0
>>> guard.excluded, sum(len(samples.values) for samples in passed)
({'glitch': 1, 'knock': 140}, 2400)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import restorable
from imumon.noise.detection.baseline import FIRST_FRAMES, PARTS
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
from imumon.noise.detection.stuck import RepeatDetector, StuckWatch

MARGIN_BEFORE = PARTS // 2
"""So much is excluded before the first part that is unusual. Unit: parts of 0.1 s.

Otherwise: the onset stays: a hand that comes near begins below the threshold. Chosen: half a frame. The guard holds
one frame back, so more than a whole one is impossible.
"""
MARGIN_AFTER = PARTS
"""So much is excluded after the last part that is unusual. Unit: parts of 0.1 s.

Otherwise: the end stays: a table rings down below the threshold, and the filter of the sensor settles. Chosen: a
frame, ten times as long as a table rings (PARTS).
"""


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


@restorable
class Guard:
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

    def __init__(self, sensors: Sequence[str], rate_hz: float, *, excludes: bool = True) -> None:
        self.sensors, self._rate, self._excludes = tuple(sensors), rate_hz, excludes
        names = list(dict.fromkeys(sensors))
        self.groups = tuple(names.index(s) for s in sensors)
        self._part_samples = max(1, round(rate_hz / PARTS))
        self._frame_samples = self._part_samples * PARTS
        self._detectors = [
            DisturbanceDetector(sensors, kinds, self._frame_samples)
            for kinds in (INERTIAL, ("mag",))
            if any(s in kinds for s in names)
        ]
        self._inertial = next((detector for detector in self._detectors if detector.inertial), None)
        self._exclusions = Exclusions(self._detectors, self._part_samples, self._frame_samples)
        self._repeats = RepeatDetector(self.groups, self._frame_samples)
        inertial_groups = self._inertial.groups if self._inertial else []
        self._stuck_watch = StuckWatch(inertial_groups, self._frame_samples)
        self._begun = False  # whether the first frames are assessed
        # Held samples, and codes of the assessed parts of them. Column-major, because detectors read one channel
        # after the other.
        self._values = np.zeros((len(self.groups), 0)).T
        self._valid = np.zeros((0, len(names)), dtype=bool)
        self._saturated = np.zeros((0, len(names)), dtype=bool)
        self._codes = np.zeros((0, len(names)), dtype=np.int8)
        self._passed_codes = np.zeros((PARTS, len(names)), dtype=np.int8)  # of the last frame: its margin
        self._place = 0  # on the grid, of the first sample that is held back
        self._breaks: list[int] = []  # places on the grid before which the record breaks

    # ------------------------------------------------------------------ what is known

    @property
    def at_rest(self) -> bool:
        """False while the sensor moves or is handled."""
        return self._inertial is None or self._inertial.at_rest

    @property
    def disturbances(self) -> int:
        """Number of disturbances so far, a running one included."""
        return self._exclusions.disturbances

    @property
    def noisy_outliers(self) -> Bools:
        """(c,) Channels whose outliers are noise and are not excluded."""
        noisy = np.zeros(len(self.groups), dtype=bool)
        for detector in self._detectors:
            noisy[detector.channels] = detector.outliers.noise | detector.outliers.tails
        return noisy

    @property
    def excluded_squares(self) -> Floats:
        """(c,) (channel unit)^2, sum of the squares of excluded outliers of the channels whose outliers are noise.

        They are those that came before this was known, and those beyond the reach of a tail, which count as at its end.
        """
        squares = np.zeros(len(self.groups))
        for detector in self._detectors if self._excludes else ():
            noisy = detector.outliers.noise | detector.outliers.tails
            squares[detector.channels] = np.where(noisy, detector.outliers.excluded_squares, 0.0)
        return squares

    @property
    def stuck(self) -> bool:
        """Whether gyroscope or accelerometer, or an axis of them, repeats its values now."""
        return self._stuck_watch.stuck

    @property
    def excluded(self) -> dict[Reason, int]:
        """Samples excluded so far by reason; those of the magnetometer alone are "magnetic"."""
        return {reason: int(n) for reason, n in zip(REASONS, self._exclusions.counts[1:], strict=True) if n}

    @property
    def excluded_samples(self) -> int:
        """Excluded samples of gyroscope and accelerometer, or of a stream that has neither."""
        counts = self._exclusions.counts
        return int(counts.sum() if self._inertial is None else counts[: ReasonCode.MAGNETIC].sum())

    @property
    def held(self) -> int:
        """Samples that are held back."""
        return len(self._values)

    @property
    def pending(self) -> GuardedSamples | None:
        """Samples that the first assessment will pass on; None after it."""
        if self._begun:
            return None
        rows = slice((FIRST_FRAMES - 1) * self._frame_samples)  # the last of these frames waits for the next
        return GuardedSamples(self._values[rows], self._valid[rows])

    def events(self) -> list[Disturbance]:
        """Return the disturbances that ended since the last call, in order."""
        ended, self._exclusions.events = self._exclusions.events, []
        return ended

    def rest_changes(self) -> list[tuple[int, bool]]:
        """Return the places on the grid where motion began (False) or ended (True) since the last call."""
        if self._inertial is None:
            return []
        changes, self._inertial.rest_changes = self._inertial.rest_changes, []
        return changes

    def stuck_changes(self) -> list[tuple[int, bool]]:
        """Return the places on the grid where `stuck` changed since the last call, and its new value."""
        changes, self._stuck_watch.changes = self._stuck_watch.changes, []
        return changes

    # ------------------------------------------------------------------ input

    def update(
        self, values: Floats, valid: Bools | None = None, saturated: Bools | None = None
    ) -> list[GuardedSamples]:
        """Add samples and return those that are assessed.

        Parameters
        ----------
        values : (n, c) channel unit.
        valid : (n, g) received; None: all.
        saturated : (n, g) samples that a sensor reports as out of range; (n,): it does not say which sensor, and all of
            them may be; None: unknown.
        """
        n, groups = len(values), self._valid.shape[1]
        received = np.ones((n, groups), dtype=bool) if valid is None else valid
        out_of_range = np.zeros((n, groups), dtype=bool)
        if saturated is not None:
            out_of_range |= saturated if saturated.ndim > 1 else saturated[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            if not np.isfinite(values.sum()):
                # A magnetometer may send NaN. Detectors weigh a sample that is not valid with zero, and zero times NaN
                # is NaN: the figures of its frame would be unknown, and a disturbance in it would pass.
                values = np.where(received[:, list(self.groups)], values, 0.0)
        self._values = np.concatenate((self._values.T, values.T), axis=1).T
        self._valid = np.concatenate((self._valid, received))
        self._saturated = np.concatenate((self._saturated, out_of_range))
        unassessed = self._unassessed_frames
        if not self._begun and unassessed >= FIRST_FRAMES:
            self._assess_first(FIRST_FRAMES)
        if not unassessed:  # nearly every block of a live stream ends within the frame in which it begins
            return []
        self._assess_next()
        return self._pass_on(len(self._codes) // PARTS - 1)

    def skip(self, n: int) -> list[GuardedSamples]:
        """Note that `n` samples are missing; return the samples that are assessed."""
        fill = -len(self._values) % self._frame_samples
        whole_frames = max(0, n - fill) // self._frame_samples
        if whole_frames < FIRST_FRAMES:
            return self._missing(n)
        # A long gap costs no memory, and nothing that runs before it continues behind it.
        out, rows = self._drain(fill), whole_frames * self._frame_samples
        for detector in self._detectors:
            detector.end(whole_frames, self._place)
        out.append(GuardedSamples(self._values, self._valid, skipped=rows))
        self._place += rows
        return out + self._missing(n - fill - rows)

    def break_(self) -> list[GuardedSamples]:
        """Note a gap of unknown length; return all samples that are held back, and the break."""
        out = self.flush()
        for detector in self._detectors:
            detector.end(
                0, self._place
            )  # how many frames are missing, and how far the level may have moved, is unknown
        return [*out, GuardedSamples(self._values, self._valid, broken=True)]

    def flush(self) -> list[GuardedSamples]:
        """Return all samples that are held back; the next sample starts a new grid of frames."""
        fill = -len(self._values) % self._frame_samples
        out = self._drain(fill)
        if fill:
            out[-1] = replace(out[-1], values=out[-1].values[:-fill], valid=out[-1].valid[:-fill])
        self._retract(fill)
        return out

    def _retract(self, fill: int) -> None:
        """Move back what lies within the `fill` samples that completed the last frame and were never there."""
        self._place -= fill
        end = self._place
        self._breaks = [min(place, end) for place in self._breaks]
        self._stuck_watch.changes = [(min(place, end), now) for place, now in self._stuck_watch.changes]
        for detector in self._detectors:
            detector.rest_changes = [(min(place, end), now) for place, now in detector.rest_changes]
        events = self._exclusions.events
        self._exclusions.events = [replace(e, length=min(e.length, end - e.start)) for e in events]

    def _drain(self, fill: int) -> list[GuardedSamples]:
        """Complete the last frame with `fill` missing samples; return all samples, and end disturbances."""
        out = self._missing(fill)
        if not self._begun and self._unassessed_frames:  # the record ends or breaks before
            self._assess_first(self._unassessed_frames)
        out += self._pass_on(len(self._codes) // PARTS)
        self._exclusions.end_all()
        self._passed_codes = np.zeros_like(self._passed_codes)  # a margin does not reach over a gap
        return out

    def _missing(self, n: int) -> list[GuardedSamples]:
        """Add `n` missing samples; return those that are assessed."""
        if n <= 0:
            return []
        groups = self._valid.shape[1]
        return self.update(np.zeros((n, len(self.groups))), np.zeros((n, groups), dtype=bool))

    # ------------------------------------------------------------------ assess frames

    @property
    def _unassessed_frames(self) -> int:
        """Complete frames without codes."""
        return len(self._values) // self._frame_samples - len(self._codes) // PARTS

    def _assess_first(self, frames: int) -> None:
        """Assess the first frames together."""
        self._assess(frames)
        self._begun = True

    def _assess_next(self) -> None:
        """Assess complete frames, up to the next change of the usual noise or repeats at once."""
        while self._begun and (frames := self._unassessed_frames):
            changes = [self._repeats.next_change, *(d.baseline.next_change for d in self._detectors)]
            self._assess(min(frames, *changes))

    def _assess(self, frames: int) -> None:
        """Determine the codes of the parts of the next frames."""
        done = len(self._codes) * self._part_samples
        rows = slice(done, done + frames * self._frame_samples)
        values, valid, saturated = self._values[rows], self._valid[rows], self._saturated[rows]
        place = self._place + done
        # at the end of its range an axis repeats one value, but it does not hang
        within_range = valid & ~saturated if saturated.any() else valid
        stuck = self._repeats.update(values, within_range)
        self._repeats.learn(frames)
        self._stuck_watch.update(stuck, within_range, place)
        codes = np.zeros((frames, PARTS, valid.shape[1]), dtype=np.int8)
        by_part = (frames, PARTS, self._part_samples)
        for w, detector in enumerate(self._detectors):
            samples = values.T[detector.channels].reshape(-1, *by_part)
            detector_codes = np.zeros((frames, PARTS), dtype=np.int8)
            received = np.asarray(valid[:, detector.groups].all(axis=1), dtype=bool)
            repeats = np.asarray(stuck[:, detector.groups].any(axis=1), dtype=bool)
            # A sample at the end of the range is assessed like others. It says too little of its own sensor, but
            # enough for a knock, and the sensor beside it must not pass unassessed.
            usable = (received & ~repeats).reshape(by_part)
            detector.hold(self._repeats.held[detector.channels])
            if self._begun:
                self._breaks += detector.assess(samples, usable, detector_codes, place)
            elif (reference := detector.assess_first(samples, usable, detector_codes, place)) is not None:
                recorder = self._exclusions.recorders[w]
                recorder.level, recorder.deviation = reference
            # After the detector, whose codes have a lower rank. A range is that of one sensor, and its excess says
            # nothing of the others; a knock and a stuck output exclude all sensors of the detector.
            for group in detector.groups:
                codes[..., group] = detector_codes
                clipped = saturated[:, group] & valid[:, group]
                codes[clipped.reshape(by_part).any(axis=2), group] = ReasonCode.CLIPPED
                codes[(repeats & received).reshape(by_part).any(axis=2), group] = ReasonCode.STUCK
        self._codes = np.concatenate((self._codes, codes.reshape(frames * PARTS, -1)))

    # ------------------------------------------------------------------ output: pass frames on

    def _pass_on(self, frames: int) -> list[GuardedSamples]:
        """Return the first `frames` frames, with their exclusions and margins."""
        if frames <= 0:
            return []
        parts = frames * PARTS
        n = parts * self._part_samples
        values, valid = self._values[:n], self._valid[:n]
        # margins reach into these frames from the frame before and from the frame behind
        around = np.concatenate((self._passed_codes, self._codes[: parts + PARTS]))
        counted = np.zeros(n, dtype=bool)
        if not self._excludes:
            self._breaks = []  # the change of a level is part of what the statistics shall contain
        elif around.any():
            marked = np.stack([_with_margins(column) for column in around.T], axis=1)
            counted = self._exclusions.mark(values, valid, marked[PARTS : PARTS + parts], self._place)
        else:
            self._exclusions.refer(values, valid)
        self._exclusions.mark_outliers(valid, counted, self._place, excludes=self._excludes)
        self._passed_codes = self._codes[parts - PARTS : parts]
        self._codes, self._saturated = self._codes[parts:], self._saturated[n:]
        # copies, so that the samples that were passed on are not kept by what is held
        self._values, self._valid = self._values[n:].copy(order="F"), self._valid[n:].copy()
        self._place += n
        return self._split(values, valid, self._place - n)

    def _split(self, values: Floats, valid: Bools, place: int) -> list[GuardedSamples]:
        """Return samples with the breaks between them; the first is at `place` on the grid."""
        due = [b for b in self._breaks if b < self._place]
        self._breaks = [b for b in self._breaks if b >= self._place]
        out, begin = [], 0
        for break_place in due:
            row = max(0, break_place - place)  # a long gap may have followed the break
            if row > begin:
                out.append(GuardedSamples(values[begin:row], valid[begin:row]))
            out.append(GuardedSamples(values[:0], valid[:0], broken=True))
            begin = row
        out.append(GuardedSamples(values[begin:], valid[begin:]))
        return out


def _with_margins(codes: Codes) -> Codes:
    """Return the codes of parts with margins; if several apply, the highest.

    `MARGIN_BEFORE` parts before, because a disturbance begins below the threshold, and `MARGIN_AFTER` behind, while it
    rings down and the filter of the sensor settles.
    """
    out, window = codes.copy(), np.ones(MARGIN_BEFORE + MARGIN_AFTER + 1)
    for code in np.unique(codes[codes > 0]).tolist():
        reach = np.convolve(codes == code, window) > 0.5
        reach = reach[MARGIN_BEFORE : MARGIN_BEFORE + len(codes)]
        np.maximum(out, np.int8(code), out=out, where=reach)
    return out
