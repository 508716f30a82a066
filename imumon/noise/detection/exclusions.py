"""Exclusions: samples marked invalid, counted by their reason, and reported as disturbances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.noise.array_state import ArrayState
from imumon.noise.detection.disturbance import (
    REASONS,
    Codes,
    Disturbance,
    DisturbanceDetector,
    Outlier,
    Reason,
    ReasonCode,
)
from imumon.samples import Bools, Floats

OUTLIER_EVENT_FRAMES = 60
"""Frames within which the outliers of a sensor are one disturbance: a minute, so that they do not flood the
events."""


class Exclusions(ArrayState):
    """What the guard has excluded.

    Parameters
    ----------
    detectors : that say what is unusual.
    part, frame : samples of each.

    Attributes
    ----------
    counts : (reasons + 1,) samples excluded so far by code.
    disturbances : number of disturbances so far, running ones included.
    events : disturbances that ended and were not read yet, in order.
    """

    _STATE = ("counts", "disturbances")

    def __init__(self, detectors: Sequence[DisturbanceDetector], part: int, frame: int) -> None:
        self._detectors, self._part, self._frame = detectors, part, frame
        self._outliers: dict[int, Disturbance] = {}  # running disturbances by group
        self.counts = np.zeros(len(REASONS) + 1, dtype=np.int64)
        self.disturbances = 0
        self.events: list[Disturbance] = []

    def mark(self, values: Floats, valid: Bools, codes: Codes, index: int) -> Bools:
        """Mark rows invalid by the codes (parts, detectors), count them, and track the disturbances.

        Parameters
        ----------
        index : place on the grid of the first row.

        Returns
        -------
        taken : (n,) rows that are counted as excluded of gyroscope and accelerometer.
        """
        rows = np.repeat(codes, self._part, axis=0)
        inertial = np.zeros(len(values), dtype=bool)
        for w, detector in enumerate(self._detectors):
            received = np.asarray(valid[:, detector.groups].any(axis=1), dtype=bool)
            hit = received & (rows[:, w] > 0)
            if detector.inertial:
                self.counts[: ReasonCode.MAGNETIC] += np.bincount(
                    rows[hit, w], minlength=ReasonCode.MAGNETIC
                )[: ReasonCode.MAGNETIC]
                inertial = hit
            else:
                self.counts[ReasonCode.MAGNETIC] += int((hit & ~inertial).sum())
            valid[np.ix_(np.flatnonzero(rows[:, w]), np.array(detector.groups))] = False
            if not codes[0, w]:
                self.end([detector])
            edges = np.flatnonzero(np.diff(codes[:, w] > 0, prepend=False, append=False)).tolist()
            for begin, end in zip(edges[::2], edges[1::2], strict=True):
                here = slice(begin * self._part, end * self._part)
                if not detector.open:
                    self.refer(detector, values, valid, here.start)
                    self.disturbances += 1
                span = (index + here.start, index + here.stop)
                detector.extend(*span, int(codes[begin:end, w].max()), values[here][received[here]])
                if end < len(codes):
                    self.end([detector])
            self.refer(detector, values, valid, len(values))
        return inertial

    def mark_outliers(self, valid: Bools, taken: Bools, index: int, *, excludes: bool) -> None:
        """Mark the outliers of these rows invalid, count those of rows that are not `taken`, and report them."""
        end = index + len(valid)
        for detector in self._detectors:
            due = [outlier for outlier in detector.found if outlier.place < end]
            detector.found = detector.found[len(due) :]
            code = ReasonCode.GLITCH if detector.inertial else ReasonCode.MAGNETIC
            for outlier in due if excludes else ():
                row = outlier.place - index
                if valid[row, outlier.group]:
                    valid[row, outlier.group] = False
                    self.counts[code] += not taken[row]
                    taken[row] = True
                    self._collect(outlier, REASONS[code - 1])
        self._end_outliers(end)

    def _collect(self, outlier: Outlier, kind: Reason) -> None:
        """Add an outlier to the running disturbance of its sensor, or begin one."""
        self._end_outliers(outlier.place)
        running = self._outliers.get(outlier.group)
        if running is None:
            running = Disturbance(kind, outlier.place, 0, 0.0, outlier.channel)
            self.disturbances += 1
        if outlier.size > (running.size or 0.0):
            running = replace(running, size=outlier.size, channel=outlier.channel)
        self._outliers[outlier.group] = replace(running, length=running.length + 1)

    def _end_outliers(self, place: int) -> None:
        """End the disturbances by outliers that began long before a place on the grid."""
        length = OUTLIER_EVENT_FRAMES * self._frame
        for group in [g for g, running in self._outliers.items() if place - running.start >= length]:
            self.events.append(self._outliers.pop(group))

    def refer(self, detector: DisturbanceDetector, values: Floats, valid: Bools, end: int) -> None:
        """Keep mean and deviation of the last frame before row `end` of which at least half is valid."""
        for last in range(end // self._frame * self._frame, 0, -self._frame):
            rows = slice(last - self._frame, last)
            ok = np.asarray(valid[rows][:, detector.groups].all(axis=1), dtype=bool)
            if 2 * int(ok.sum()) >= self._frame:
                own = values[rows][ok][:, detector.channels]
                detector.latest = np.stack((own.mean(axis=0), own.std(axis=0)))
                break

    def end_all(self) -> None:
        """End all running disturbances."""
        self.end(self._detectors)
        self.events += self._outliers.values()
        self._outliers = {}

    def end(self, detectors: Sequence[DisturbanceDetector]) -> None:
        """End the running disturbances of some detectors."""
        self.events += [detector.close() for detector in detectors if detector.open]
