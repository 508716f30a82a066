"""Loss: the share of samples that a link loses, over the last minute.

A gap is an event for a reader of the log; a link that loses single messages all the time is a fault that needs
an alarm. The window is a minute of the sample clock in bins of a second, each with its missing samples. An
interruption (the device was disconnected, or restarted) has its own events, and the window starts again after it.

The share refers to all samples of a full window, also while the window is younger. A single lost sample shortly
after the start therefore is no alarm, and a link that loses a fifth is one after three seconds.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from imumon.samples import Ints

WINDOW_S = 60
"""s of the sample clock that the loss refers to."""

RECOVERED = 0.5
"""Share of the threshold below which a link has recovered."""


@dataclass(frozen=True, slots=True)
class LossChange:
    """Loss that begins or ends.

    Attributes
    ----------
    begins : the share has risen above the threshold, else it has fallen below half of it.
    missing, expected : samples of the window that did not arrive, and all of them.
    age_s : s of the sample clock before the end of the samples.
    """

    begins: bool
    missing: int
    expected: int
    age_s: float


class LossWindow:
    """Missing samples of the last minute.

    Parameters
    ----------
    interval_s : s between two samples.
    threshold : share of the samples above which the loss is reported.
    """

    def __init__(self, interval_s: float, threshold: float) -> None:
        self._interval_s, self._threshold = interval_s, threshold
        self._full = WINDOW_S / interval_s  # samples
        self._reported = False
        self.restart()

    def restart(self) -> None:
        """Forget the window: what is missing before the next sample belongs to an interruption."""
        self._ticks = 0
        self._bins: deque[tuple[int, int]] = deque()  # s since the restart, missing samples
        self._missing = 0

    @property
    def share(self) -> float:
        """Samples missing in the window over those of a full one, 0 to 1."""
        return min(self._missing / self._full, 1.0)

    def update(self, steps: Ints) -> list[LossChange]:
        """Add samples by their (n,) grid steps since the sample before; return what has begun or ended."""
        if not self._ticks and len(steps):
            steps = np.concatenate(([1], steps[1:]))
        begin, self._ticks = self._ticks, self._ticks + int(np.maximum(steps, 1).sum())
        if not self._bins and not self._reported and (steps <= 1).all():
            return []
        ends = begin + np.cumsum(np.maximum(steps, 1))
        seconds = (ends * self._interval_s).astype(np.int64)
        changes = []
        for second in np.unique(seconds):
            here = seconds == second
            changes += self._close(
                int(second), int((np.maximum(steps, 1) - 1)[here].sum()), int(ends[here][-1])
            )
        return changes

    def _close(self, second: int, missing: int, end: int) -> list[LossChange]:
        """Add the missing samples of one second, of which sample `end` is the last so far."""
        if missing:
            self._bins.append((second, missing))
            self._missing += missing
        while self._bins and self._bins[0][0] <= second - WINDOW_S:
            self._missing -= self._bins.popleft()[1]
        limit = self._threshold * (RECOVERED if self._reported else 1.0)
        if (self.share > limit) == self._reported or (self._reported and end < self._full):
            return []
        self._reported = not self._reported
        expected = round(min(end, self._full))
        age_s = (self._ticks - end) * self._interval_s
        return [LossChange(self._reported, min(self._missing, expected), expected, age_s)]
