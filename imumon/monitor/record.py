"""Record: the statistics of one stream, from its first sample on.

Placed samples go in; they pass the guard, which may cut some out, and then every accumulator in the same
order. Each accumulator sees each tick of the grid once: as a valid sample, an invalid one, or in a hole.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from imumon.monitor.grid import Break, Hole, stretches
from imumon.noise.allan import AllanCurve, OctaveCascade
from imumon.noise.guards import Guard, Passed
from imumon.noise.moments import Moments, MomentsResult
from imumon.noise.watch import Disturbance
from imumon.samples import Bools, Floats, sensor_of
from imumon.timeline import Placed

NOISE = ("gyro", "accel", "mag")
"""Sensors with an Allan curve; the others have running statistics only."""

COUNTS = ("samples", "missing", "gaps", "span")

Saved = dict[str, npt.NDArray[Any]]


class Record:
    """Statistics of one stream.

    Parameters
    ----------
    channels : names of the columns.
    interval_s : s between two ticks.
    guarded : whether disturbances are cut out.

    Attributes
    ----------
    samples, missing, gaps, span : see INTERFACE: samples + missing = span, ticks of the grid.
    """

    def __init__(self, channels: tuple[str, ...], interval_s: float, *, guarded: bool) -> None:
        self.channels = channels
        self.interval_s = interval_s
        sensors = [sensor_of(name) for name in channels]
        names = list(dict.fromkeys(sensors))
        self.groups = [names.index(s) for s in sensors]
        self.noisy = sum(s in NOISE for s in sensors)  # the first so many columns
        self.samples = self.missing = self.gaps = self.span = 0
        self._guard = Guard(sensors, 1.0 / interval_s) if guarded else None
        self._cascade = OctaveCascade(self.noisy, interval_s, groups=self.groups[: self.noisy])
        self._moments = Moments(len(channels), groups=self.groups)

    def feed(self, placed: Placed) -> None:
        """Take samples with their places on the grid."""
        n = len(placed.steps)
        self.samples += n
        self.gaps += int(np.count_nonzero(placed.steps != 1))
        for part in stretches(placed):
            if isinstance(part, Break):
                self._apply(self._guard.break_() if self._guard else [_gap(self, broken=True)])
            elif isinstance(part, Hole):
                self.span += part.ticks
                self._apply(self._guard.skip(part.ticks) if self._guard else [_gap(self, part.ticks)])
            else:
                self.span += len(part.values)
                valid = self._valid(part.present)
                if self._guard:
                    self._apply(self._guard.update(part.values, valid, part.saturated))
                else:
                    self._account(part.values, valid)
        self.missing = self.span - self.samples

    def flush(self) -> None:
        """Let out what the guard holds back: the stream has ended, or stands still."""
        if self._guard:
            self._apply(self._guard.flush())

    @property
    def elapsed_s(self) -> float:
        """Length of the grid, holes included."""
        return self.span * self.interval_s

    @property
    def at_rest(self) -> bool:
        return self._guard is None or self._guard.at_rest

    @property
    def disturbances(self) -> int:
        return self._guard.disturbances if self._guard else 0

    @property
    def excluded_s(self) -> float:
        """Seconds of received samples that were cut out."""
        return self._guard.excluded_samples * self.interval_s if self._guard else 0.0

    @property
    def excluded_by(self) -> dict[str, float]:
        """The same by reason."""
        cut = self._guard.excluded if self._guard else {}
        return {str(reason): n * self.interval_s for reason, n in cut.items()}

    def found(self) -> list[Disturbance]:
        """Disturbances that ended since the last call."""
        return self._guard.events() if self._guard else []

    def running(self) -> MomentsResult:
        return self._moments.result()

    def curve(self) -> AllanCurve:
        return self._cascade.result()

    def _valid(self, present: Bools | None) -> Bools | None:
        if present is None:
            return None
        return np.repeat(present[:, None], max(self.groups) + 1, axis=1)

    def _apply(self, pieces: Iterable[Passed]) -> None:
        for piece in pieces:
            if piece.broken:
                self._cascade.break_()
            if piece.skipped:
                self._cascade.skip(piece.skipped)
            if len(piece.values):
                self._account(piece.values, None if piece.valid.all() else piece.valid)

    def _account(self, values: Floats, valid: Bools | None) -> None:
        """Every accumulator takes these ticks."""
        noisy = values[:, : self.noisy]
        self._cascade.update(noisy, None if valid is None else valid[:, : max(self.groups[: self.noisy]) + 1])
        self._moments.update(values, valid)

    def save(self) -> tuple[dict[str, Any], Saved]:
        """State that `restore` continues from: JSON values and small arrays."""
        meta = {name: getattr(self, name) for name in COUNTS}
        parts = {"cascade": self._cascade.save(), "moments": self._moments.save()}
        if self._guard:
            parts["guard"] = self._guard.save()
        return meta, {f"{part}.{name}": array for part, own in parts.items() for name, array in own.items()}

    def resume(self, meta: Mapping[str, Any], arrays: Saved) -> None:
        """Continue from a state, in a record just made with the same arguments."""
        for name in COUNTS:
            setattr(self, name, int(meta[name]))

        def own(part: str) -> Saved:
            return {k.removeprefix(f"{part}."): v for k, v in arrays.items() if k.startswith(f"{part}.")}

        self._cascade = OctaveCascade.restore(own("cascade"))
        self._moments = Moments.restore(own("moments"))
        if self._guard:
            self._guard.restore(own("guard"))


def _gap(record: Record, skipped: int = 0, *, broken: bool = False) -> Passed:
    nothing = np.zeros((0, len(record.channels)))
    return Passed(nothing, np.zeros((0, max(record.groups) + 1), dtype=bool), skipped, broken)
