"""Live stamps: places for samples that arrive with stamps of any quality.

A recording shows all its stamps at once; here they come one after the other, and the rate may change. The first rows
show what the stamps are (`stamp_kinds.decide`), and the placer of their kind places these rows and all later ones.

Of a stream, there are up to three times of a row, the best first: the stamp that the sensor or its driver made, the
time of publication, and the time of arrival. Stamps that do not change, or show no possible rate, are missing: the time
of publication is used instead, as stamps of a host, and if that is no better, the time of arrival.

The decision is checked again and again: stamps that turn uneven, and a rate that changes, begin a new grid. This module
reads no clock: times in, times and steps out.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from imumon.grid.interval import CLOCK_SLACK_S, RATE_TOLERANCE
from imumon.grid.stamp_kinds import (
    CLOCK,
    FEW_STEPS,
    LONG_WINDOW,
    StampCandidate,
    StampDecision,
    decide,
)
from imumon.grid.stamp_placement import NO_ROWS, PlacedRows, StampPlacer
from imumon.model.samples import Ints

FIRST_ROWS = 128
"""Rows whose stamps are assessed first; the number doubles while they are uneven."""

DECIDE_S = 10.0
"""s of rows after which a decision is due."""

LATEST_S = 60.0
"""s after which it is taken with however many rows."""

CHECK_ROWS = 2048
"""Rows after which the decision is checked: 10 s at 200 Hz."""

DOUBTS = 2
"""Checks in a row that must contradict the decision: one alone may be that of a stall."""

WRONG_STAMPS = 8
"""Stamps in a row that differ by `CLOCK_SLACK_S` from the time of arrival, after which the clock was set."""

ROUGH_LOSSES = ", and single missing samples cannot be detected"
REPLACED = (
    None,
    "its header.stamp is not set: the time of publication is used",
    "neither header.stamp nor the time of publication is usable: the time of arrival is used",
)
"""Remark by the time that is used, a `RowColumn`."""


class RowColumn(IntEnum):
    """Columns of the rows that wait; the first three are times, the best first."""

    STAMPS = 0
    PUBLISHED = 1
    ARRIVED = 2
    LOST = 3


TIMES = (RowColumn.STAMPS, RowColumn.PUBLISHED, RowColumn.ARRIVED)
"""Candidates for the stamps, the best first."""


class LiveStamps:
    """Places of samples, from their stamps.

    Parameters
    ----------
    resolution : ns to which the stamps are rounded; 0: to much less than their steps.

    Attributes
    ----------
    remark : what is wrong with the stamps, one line; None: nothing, or not decided yet.
    """

    def __init__(self, resolution: float = 0.0) -> None:
        self.remark: str | None = None
        self._resolution = resolution
        self._decision: StampDecision | None = None  # None: undecided
        self._placer: StampPlacer | None = None  # of the decision
        self._waiting = np.empty((0, len(RowColumn)), np.int64)  # not decided
        self._next_rows = FIRST_ROWS  # with which the next decision is tried
        self._used = RowColumn.STAMPS  # column of the times that are used
        self._recent = np.empty(0, np.int64)  # these times since the last check
        self._doubts = 0  # checks in a row that contradict the decision
        self._last: tuple[int, int] | None = None  # time and arrival of the last good row
        self._wrong = 0  # times in a row that are far off

    @property
    def decided(self) -> bool:
        """Whether it is known what the stamps are."""
        return self._decision is not None

    def place(
        self, stamps: Ints, published: Ints, arrived: Ints, lost: Ints, *, final: bool = False
    ) -> PlacedRows:
        """Return the oldest rows that wait, with their places; the others wait for rows after them.

        Parameters
        ----------
        stamps : (n,) ns, of the next rows.
        published : (n,) ns, when they were published, by the clock of the publisher.
        arrived : (n,) ns, when they arrived, by the host clock.
        lost : (n,) messages known to be lost before each.
        final : these are the last rows.
        """
        rows = np.stack([stamps, published, arrived, lost], axis=1).astype(np.int64)
        earlier = NO_ROWS
        if self._placer is None:
            self._waiting = np.concatenate([self._waiting, rows])
            decision = self._first_decision(final)
            if decision is None:
                return earlier
            self._begin_grid(decision, self._waiting[:, decision.candidate])
            rows, self._waiting = self._waiting, self._waiting[:0]
        elif (recent := self._contradicting(rows)) is not None:
            earlier = self._place(rows[:0], final=True)
            self._begin_grid(self._decided_by(recent), recent)
        return earlier.then(self._place(rows, final))

    def _first_decision(self, final: bool) -> StampDecision | None:
        """Return the decision, if the waiting rows show it."""
        count = len(self._waiting)
        span_s = float(np.ptp(self._waiting[:, RowColumn.ARRIVED])) * 1e-9 if count else 0.0
        due = final or (span_s >= DECIDE_S and count >= LONG_WINDOW) or span_s >= LATEST_S
        if not count or (not due and (count < FEW_STEPS or (count < self._next_rows and span_s < DECIDE_S))):
            return None
        self._next_rows = max(self._next_rows, 2 * count)
        candidates = [
            StampCandidate(self._waiting[:, column], of_sensor=column == RowColumn.STAMPS) for column in TIMES
        ]
        decision = decide(candidates, self._resolution)
        # stamps of a clock show it in few rows; of a host, 128 rows may be within one stall
        return decision if due or decision.kind is CLOCK else None

    def _decided_by(self, recent: Ints) -> StampDecision:
        """Return the decision by (n,) later times, ns, of the column that is used."""
        return decide([StampCandidate(recent, of_sensor=self._used == RowColumn.STAMPS)], self._resolution)

    def _begin_grid(self, decision: StampDecision, times: Ints) -> None:
        """Place the next rows by a decision, on a grid that begins with (n,) `times`, ns."""
        if self._decision is None:
            self._used = RowColumn(decision.candidate)
        self._decision, self._placer, self._last = decision, decision.placer(times), None
        self.remark = REPLACED[self._used]
        if self._used == RowColumn.STAMPS and decision.kind.remark:
            self.remark = f"{decision.kind.remark}: only their mean rate is used"
            self.remark += ROUGH_LOSSES if self._placer.hides_losses else ""

    def _contradicting(self, rows: Ints) -> Ints | None:
        """Return the last times if they contradict the decision for the second time in a row."""
        self._recent = np.concatenate([self._recent, rows[:, self._used]])
        if len(self._recent) < CHECK_ROWS:
            return None
        recent, self._recent = self._recent, self._recent[:0]
        assert self._decision is not None
        assert self._placer is not None
        now = self._decided_by(recent)
        if now.interval is None:
            return None  # times that show no rate for a while do not show another one
        if self._decision.kind.keeps_stamps:
            differs = not now.kind.keeps_stamps
        else:
            differs = abs(now.interval / self._placer.interval - 1.0) > RATE_TOLERANCE
        if now.kind is self._decision.kind is CLOCK:
            self._placer.interval = now.interval  # of more rows than before, and the clock drifts
        self._doubts = self._doubts + 1 if differs else 0
        if self._doubts < DOUBTS:
            return None
        self._doubts = 0
        return recent

    def _place(self, rows: Ints, final: bool) -> PlacedRows:
        """Return the oldest rows that wait for the placer, after some more."""
        assert self._decision is not None
        assert self._placer is not None
        # the times of a clock are checked by the `SampleClock`, which knows restarts
        raw = self._decision.kind.keeps_stamps
        times = rows[:, RowColumn.STAMPS] if raw else self._plausible(rows)
        placed = self._placer.place(times, rows[:, RowColumn.LOST])
        return placed.then(self._placer.release()) if final else placed

    def _plausible(self, rows: Ints) -> Ints:
        """Return the times of rows, ns; those that are far off follow the arrival."""
        times = np.empty(len(rows), np.int64)
        for k, (time, arrived) in enumerate(rows[:, [self._used, RowColumn.ARRIVED]].tolist()):
            if self._last is not None:
                expected = self._last[0] + arrived - self._last[1]
                far = abs(time - expected) > CLOCK_SLACK_S * 1e9
                self._wrong = self._wrong + 1 if far else 0
                if far and self._wrong < WRONG_STAMPS:
                    times[k] = expected
                    continue
            self._last = (time, arrived)
            times[k] = time
        return times
