"""Stretches of a record: Allan sums and moments of every 10 minutes, hour and day, for the history.

A record of months hides what happens in it: its N is the mean over all of its time. The history therefore keeps
the noise of each stretch alone. N shows in 10 minutes, B needs an hour, K a day; so there are stretches of three
lengths, and none is computed from another one. They begin at multiples of their length on the grid of the record.
A stretch without samples, as in a long gap, is left out.

The Allan sums come from windows of the one cascade (`imumon.noise.allan.windows`), which costs nothing per sample.
Windows begin at the end of a block of 256 samples, so the sums of a stretch may lie up to that much before its
moments.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from imumon.noise.allan.curve import WindowSums
from imumon.noise.allan.windows import Window, WindowedCascade
from imumon.noise.statistics.moments import Moments

STEPS_S = (600, 3600, 86400)
"""s, lengths of the stretches; each is a multiple of the one before."""


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """One stretch, finished or in progress.

    Attributes
    ----------
    step_s : s, its full length, one of `STEPS_S`.
    start, end : samples of the grid before it, and before what follows it.
    sums : Allan sums of its channels with a curve.
    moments : moments of all channels.
    """

    step_s: int
    start: int
    end: int
    sums: WindowSums
    moments: Moments


class Stretches:
    """The stretches in progress of one record.

    Parameters
    ----------
    cascade : of the record.
    rate_hz : Hz, sampling rate.
    moments : returns the moments between two positions of which stretches began, samples of the grid.
    """

    def __init__(
        self, cascade: WindowedCascade, rate_hz: float, moments: Callable[[int, int], Moments]
    ) -> None:
        self._cascade, self._moments = cascade, moments
        shortest = max(1, round(STEPS_S[0] * rate_hz))
        self._lengths = [shortest * (step // STEPS_S[0]) for step in STEPS_S]
        self._windows: list[Window] = [cascade.open_window() for _ in STEPS_S]
        self._starts = [cascade.position] * len(STEPS_S)
        self._finished: list[Stretch] = []

    @property
    def next_end(self) -> int:
        """Samples of the grid at which the shortest stretch in progress ends."""
        return (self._starts[0] // self._lengths[0] + 1) * self._lengths[0]

    @property
    def starts(self) -> tuple[int, ...]:
        """Samples of the grid before each stretch in progress."""
        return tuple(self._starts)

    def close_due(self) -> bool:
        """End the stretches whose end the record has reached; return whether there were any."""
        at = self._cascade.position
        due = [k for k, n in enumerate(self._lengths) if at // n != self._starts[k] // n]
        for k in due:
            stretch = self.in_progress(k)
            if stretch is not None:
                self._finished.append(stretch)
            self._cascade.close_window(self._windows[k])
            self._windows[k], self._starts[k] = self._cascade.open_window(), at
        return bool(due)

    def drain(self) -> list[Stretch]:
        """Return and forget the stretches that have ended since the last call, shorter ones first."""
        finished, self._finished = self._finished, []
        return finished

    def in_progress(self, number: int) -> Stretch | None:
        """Return the stretch in progress of ``STEPS_S[number]``; None without a sample in it."""
        start, end = self._starts[number], self._cascade.position
        moments = self._moments(start, end)
        if not any(channel.count for channel in moments.result().channels):
            return None
        sums = self._cascade.block_sums_since(self._windows[number])
        return Stretch(STEPS_S[number], start, end, sums, moments)

    def save(self) -> dict[str, np.ndarray]:
        """Return the state as arrays."""
        order = list(self._cascade.windows)
        return {
            "windows": np.array([order.index(window) for window in self._windows], dtype=np.int64),
            "starts": np.array(self._starts, dtype=np.int64),
        }

    def restore(self, cascade: WindowedCascade, saved: Mapping[str, np.ndarray]) -> None:
        """Continue from a saved state; the cascade is restored already."""
        self._cascade = cascade
        self._windows = [cascade.windows[int(number)] for number in saved["windows"]]
        self._starts = [int(start) for start in saved["starts"]]
