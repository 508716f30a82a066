"""Exclusions: samples marked invalid, counted by their reason, and reported as disturbances.

The guard gives codes of parts, margins included, and the outliers. A sample is excluded once and counted once, under
the reason of highest rank; one that is excluded on gyroscope and accelerometer counts once, and so does one that is
excluded on one of them. What the magnetometer alone shows is
counted under "magnetic", whatever its code.

Neighbouring excluded parts are one disturbance, and so are the outliers of one sensor within a minute. Both are state
machines, one for each detector and one for each sensor:

    state   event                               next    by
    closed  an excluded part                    open    DisturbanceRecorder.extend: remember reference and start
    open    an excluded part                    open    DisturbanceRecorder.extend: grow
    open    a part that is not excluded, a gap  closed  DisturbanceRecorder.close: report it

    none    an outlier                          some    Exclusions._collect: remember the start
    some    an outlier within the minute        some    Exclusions._collect: count, keep the largest
    some    a minute after the start, a gap     none    Exclusions._end_outliers, end_all: report it

The size of a disturbance is its largest distance from the *reference*: mean and deviation of the last frame before it
that was passed on undisturbed. The level of the baseline will not do: it depends on how many of the held frames are
assessed already, and so on the division of the samples into blocks.

Example: 2 s at 100 Hz with codes for one part of the second frame.

>>> from imumon.noise.detection.disturbance import INERTIAL
>>> values, valid = np.zeros((200, 1)), np.ones((200, 1), dtype=bool)
>>> values[120:130] = 0.5
>>> codes = np.zeros((20, 1), dtype=np.int8)
>>> codes[12] = ReasonCode.KNOCK
>>> exclusions = Exclusions([DisturbanceDetector(("gyro",), INERTIAL, 100)], 10, 100)
>>> excluded = exclusions.mark(values, valid, codes, place=0)
>>> exclusions.events
[Disturbance(kind='knock', start=120, length=10, size=0.5, channel=0)]
>>> int(exclusions.counts[ReasonCode.KNOCK]), np.flatnonzero(~valid).tolist() == list(range(120, 130))
(10, True)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from imumon.model.samples import Bools, Floats
from imumon.model.saved_state import restorable
from imumon.noise.detection.disturbance import (
    REASONS,
    Codes,
    Disturbance,
    DisturbanceDetector,
    Outlier,
    Reason,
    ReasonCode,
)

OUTLIER_EVENT_FRAMES = 60
"""Outliers of a sensor within this time are one disturbance. Unit: frames.

Otherwise: a noisy cable floods the events. Chosen: a minute (`test_outliers.py`).
"""


@restorable
class DisturbanceRecorder:
    """Measure the running disturbance of the channels of one detector.

    Attributes
    ----------
    level, deviation : (c,) channel unit, of the last frame that was passed on undisturbed. Zero before the first: every
        distance is then infinite in units of the noise, and the first channel that moves is named.
    """

    def __init__(self, detector: DisturbanceDetector, frame_samples: int) -> None:
        self._channels, self._groups, self._inertial = detector.channels, detector.groups, detector.inertial
        self._sensor_of = [detector.groups.index(group) for group in detector.group_of]
        self._frame_samples, c = frame_samples, len(detector.channels)
        self.level = np.zeros(c)
        self.deviation = np.zeros(c)
        self._open = False
        self._start = self._end = 0  # places on the grid
        self._code = ReasonCode.NONE
        self._excluded = np.zeros(c, dtype=bool)  # channels of the sensors that are excluded
        self._reference = self.level, self.deviation  # of the beginning
        self._least = self._most = self.level  # values of the channels
        self._repeats = np.zeros(c, dtype=np.int64)  # values equal to the one before, by channel
        self._last = np.zeros((0, c))  # newest row; none yet

    @property
    def is_open(self) -> bool:
        """Whether a disturbance is running."""
        return self._open

    def refer(self, values: Floats, valid: Bools, end: int) -> None:
        """Keep mean and deviation of the last frame before row `end` of which at least half is valid.

        Without such a frame the reference before remains. `values` and `valid` begin with a frame.
        """
        for frame_end in range(end // self._frame_samples * self._frame_samples, 0, -self._frame_samples):
            rows = slice(frame_end - self._frame_samples, frame_end)
            received = np.asarray(valid[rows][:, self._groups].all(axis=1), dtype=bool)
            # half of a frame gives level and deviation to 10 % at 100 Hz
            if 2 * received.sum() >= self._frame_samples:
                quiet = values[rows][received][:, self._channels]
                self.level, self.deviation = quiet.mean(axis=0), quiet.std(axis=0)
                break

    def extend(self, start: int, end: int, codes: Codes, values: Floats) -> None:
        """Begin or extend the running disturbance.

        Parameters
        ----------
        start, end : places on the grid.
        codes : (sensors of the detector,) highest code of each; 0: this one is not excluded.
        values : (n, c) channel unit, its received samples in all channels of the stream; n may be 0.
        """
        samples, code = values[:, self._channels], ReasonCode(int(codes.max()))
        if not self._open:
            self._open, self._start, self._code = True, start, code
            self._excluded = np.zeros_like(self._excluded)
            self._reference = self.level, self.deviation
            self._least = self._most = self.level
            self._repeats, self._last = np.zeros_like(self._repeats), samples[:0]
        self._end, self._code = end, max(code, self._code)
        self._excluded |= codes[self._sensor_of] > 0
        if len(samples):
            self._repeats += (np.diff(samples, axis=0, prepend=self._last) == 0.0).sum(axis=0)
            self._last = samples[-1:]
            self._least = np.minimum(self._least, samples.min(axis=0))
            self._most = np.maximum(self._most, samples.max(axis=0))

    def close(self) -> Disturbance:
        """End and return the running disturbance."""
        self._open = False
        level, deviation = self._reference
        distance = np.maximum(self._most - level, level - self._least)
        with np.errstate(divide="ignore", invalid="ignore"):
            # A channel without noise is the worst that moves. One that does not move is 0/0, and never the worst.
            share = np.where((distance > 0.0) & self._excluded, distance / deviation, 0.0)
        worst = int(np.argmax(share))
        size: float | None = None  # of a stuck output, or of a disturbance whose samples are all lost
        channel: int | None = None
        if self._code == ReasonCode.STUCK:
            # an axis that hangs repeats always, the others by chance; an output that hangs repeats all of them
            if np.median(self._repeats) < 0.5 * self._repeats.max():
                channel = self._channels[int(np.argmax(self._repeats))]
        elif share[worst] > 0.0:
            size, channel = float(distance[worst]), self._channels[worst]
        # knocks and motion of a magnetometer are magnets
        named = self._inertial or self._code in (ReasonCode.CLIPPED, ReasonCode.STUCK)
        kind: Reason = REASONS[self._code - 1] if named else "magnetic"
        return Disturbance(kind, self._start, self._end - self._start, size, channel)


@restorable
class Exclusions:
    """What the guard has excluded.

    Parameters
    ----------
    detectors : that say what is unusual.
    part_samples, frame_samples : samples of a part and of a frame.

    Attributes
    ----------
    recorders : measure the running disturbance of each detector.
    counts : (reasons + 1,) samples excluded so far by code.
    disturbances : number of disturbances so far, running ones included.
    events : disturbances that ended, in order; the guard empties the list.
    """

    def __init__(
        self, detectors: Sequence[DisturbanceDetector], part_samples: int, frame_samples: int
    ) -> None:
        self._detectors, self._part_samples, self._frame_samples = detectors, part_samples, frame_samples
        self.recorders = [DisturbanceRecorder(detector, frame_samples) for detector in detectors]
        self._running_outliers: dict[int, Disturbance] = {}  # by group
        self.counts = np.zeros(len(REASONS) + 1, dtype=np.int64)
        self.disturbances = 0
        self.events: list[Disturbance] = []

    def mark(self, values: Floats, valid: Bools, codes: Codes, place: int) -> Bools:
        """Mark rows invalid by the codes (parts, g), count them, and follow the disturbances.

        Parameters
        ----------
        values : (n, c) channel unit, whole frames.
        valid : (n, g), changed in place.
        place : on the grid, of the first row.

        Returns
        -------
        counted : (n,) rows that are counted as excluded of gyroscope or accelerometer.
        """
        row_codes = np.repeat(codes, self._part_samples, axis=0)
        counted = np.zeros(len(values), dtype=bool)
        for w, detector in enumerate(self._detectors):
            sensors_valid, sensor_codes = valid[:, detector.groups], row_codes[:, detector.groups]
            received = np.asarray(sensors_valid.any(axis=1), dtype=bool)
            code = (sensor_codes * sensors_valid).max(axis=1)  # what was not received cannot be excluded
            hit = code > 0
            if detector.inertial:
                by_code = np.bincount(code[hit], minlength=ReasonCode.MAGNETIC)
                self.counts[: ReasonCode.MAGNETIC] += by_code[: ReasonCode.MAGNETIC]
                counted = hit
            else:
                self.counts[ReasonCode.MAGNETIC] += int((hit & ~counted).sum())
            valid[:, detector.groups] = sensors_valid & (sensor_codes == 0)
            self._follow(self.recorders[w], values, valid, received, codes[:, detector.groups], place)
        return counted

    def _follow(
        self,
        recorder: DisturbanceRecorder,
        values: Floats,
        valid: Bools,
        received: Bools,
        codes: Codes,
        place: int,
    ) -> None:
        """Open, extend and close the disturbance of one detector along the codes (parts, its sensors) of these rows."""
        excluded: Bools = np.asarray(codes.any(axis=1), dtype=bool)
        if not excluded[0]:  # what reached the end of the rows before ended there
            self.end([recorder])
        edges = np.flatnonzero(np.diff(excluded, prepend=False, append=False)).tolist()
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            rows = slice(begin * self._part_samples, end * self._part_samples)
            if not recorder.is_open:
                recorder.refer(values, valid, rows.start)
                self.disturbances += 1
            samples = values[rows][received[rows]]
            recorder.extend(place + rows.start, place + rows.stop, codes[begin:end].max(axis=0), samples)
            if end < len(codes):  # else it may continue in the next rows
                self.end([recorder])
        recorder.refer(values, valid, len(values))

    def mark_outliers(self, valid: Bools, counted: Bools, place: int, *, excludes: bool) -> None:
        """Mark the outliers of these rows invalid, count those of rows that are not `counted`, and report them."""
        end = place + len(valid)
        for detector in self._detectors:
            due = [outlier for outlier in detector.single_samples if outlier.place < end]
            detector.single_samples = detector.single_samples[len(due) :]
            code = ReasonCode.GLITCH if detector.inertial else ReasonCode.MAGNETIC
            for outlier in due if excludes else ():
                row = outlier.place - place
                if valid[row, outlier.group]:  # else the margin of a disturbance has excluded it
                    valid[row, outlier.group] = False
                    self.counts[code] += not counted[row]  # both sensors may have an outlier in one row
                    counted[row] = True
                    self._collect(outlier, REASONS[code - 1])
        self._end_outliers(end)

    def _collect(self, outlier: Outlier, kind: Reason) -> None:
        """Add an outlier to the running disturbance of its sensor, or begin one."""
        self._end_outliers(outlier.place)
        running = self._running_outliers.get(outlier.group)
        if running is None:
            running = Disturbance(kind, outlier.place, 0, 0.0, outlier.channel)
            self.disturbances += 1
        if outlier.size > (running.size or 0.0):
            running = replace(running, size=outlier.size, channel=outlier.channel)
        self._running_outliers[outlier.group] = replace(running, length=running.length + 1)

    def _end_outliers(self, place: int) -> None:
        """End the disturbances by outliers that began long before a place on the grid."""
        length = OUTLIER_EVENT_FRAMES * self._frame_samples
        old = [g for g, running in self._running_outliers.items() if place - running.start >= length]
        for group in old:
            self.events.append(self._running_outliers.pop(group))

    def refer(self, values: Floats, valid: Bools) -> None:
        """Note rows in which nothing is excluded: running disturbances end, references are renewed."""
        self.end(self.recorders)
        for recorder in self.recorders:
            recorder.refer(values, valid, len(values))

    def end_all(self) -> None:
        """End all running disturbances."""
        self.end(self.recorders)
        self.events += self._running_outliers.values()
        self._running_outliers = {}

    def end(self, recorders: Iterable[DisturbanceRecorder]) -> None:
        """End the running disturbances of some detectors."""
        self.events += [recorder.close() for recorder in recorders if recorder.is_open]
