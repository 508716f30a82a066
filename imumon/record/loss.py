"""Loss: the share of samples that a link loses, over the last minute.

A gap is an event for a reader of the log; a link that loses single messages all the time is a fault that needs
an alarm. The window is a minute of the sample clock in bins of a second, each with its missing samples. An
interruption (the device was disconnected, or restarted) has its own events, and the window starts again after it.

The share refers to the samples of the window. The alarm needs as many missing samples as in a full window: a single
lost sample shortly after the start is no alarm, and a link that loses a fifth is one after three seconds.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from imumon.model.samples import Ints

WINDOW_S = 60
"""s of the sample clock that the loss refers to."""


class LossWindow:
    """Missing samples of the last minute.

    Parameters
    ----------
    interval_s : s between two samples.
    """

    def __init__(self, interval_s: float) -> None:
        self._interval_s = interval_s
        self._full = WINDOW_S / interval_s  # samples
        self.restart()

    def restart(self) -> None:
        """Forget the window: what is missing before the next sample belongs to an interruption."""
        self._ticks = 0
        self._bins: deque[tuple[int, int]] = deque()  # s since the restart, missing samples
        self._missing = 0

    @property
    def share(self) -> float:
        """Samples missing in the window over all of it, 0 to 1."""
        return self._share(self._ticks)

    def _share(self, ticks: int) -> float:
        return min(self._missing / max(min(ticks, self._full), 1.0), 1.0)

    def update(self, steps: Ints) -> list[tuple[float, float, float]]:
        """Add samples by their (n,) grid steps since the sample before.

        Returns
        -------
        shares : of each second, its age, s before the end of the samples, the share at its end, and the share of
            the window that is full. While nothing is missing, only the second in which it becomes full is there.
        """
        # The step to the first sample leads back over the interruption, which is not a loss.
        if not self._ticks and len(steps):
            steps = np.concatenate(([1], steps[1:]))
        ticks = np.maximum(steps, 1)  # BREAK is below 0: a gap of unknown length counts as one step
        begin, self._ticks = self._ticks, self._ticks + int(ticks.sum())
        # The usual case of a link without losses needs no sums by second. The block in which the window becomes full
        # goes through all the same: an alarm may only end at a full window.
        if not self._bins and (ticks == 1).all() and not begin < self._full <= self._ticks:
            return []
        ends = begin + np.cumsum(ticks)
        seconds = (ends * self._interval_s).astype(np.int64)
        shares = []
        for second in np.unique(seconds).tolist():
            here = seconds == second
            self._add(second, int((ticks - 1)[here].sum()))
            end = int(ends[here][-1])
            shares.append(
                ((self._ticks - end) * self._interval_s, self._share(end), min(end / self._full, 1.0))
            )
        return shares

    def _add(self, second: int, missing: int) -> None:
        if missing:
            self._bins.append((second, missing))
            self._missing += missing
        while self._bins and self._bins[0][0] <= second - WINDOW_S:
            self._missing -= self._bins.popleft()[1]
