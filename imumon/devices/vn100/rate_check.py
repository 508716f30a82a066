"""Arrival: the rate at which samples come, against the one that was told.

A stream without a clock has its time from a told rate alone, and a wrong one puts all of N, B and K in the
wrong place. So it is compared with the clock of the room. Bytes wait in queues, hence a slack beside the
tolerance; a pause says nothing about the rate and begins the comparison anew, as does its growing old.
"""

from __future__ import annotations

TOLERANCE = 0.02
LEAST_S, LONGEST_S = 5.0, 120.0
PAUSE_S = 3.0
SLACK_S, SLACK = 0.2, 1.5
"""Seconds, and samples, by which a right rate may seem wrong."""


class RateCheck:
    """Counts samples against the clock.

    Attributes
    ----------
    rate_hz : at which samples come, where that is not the rate that was told; else None.
    """

    def __init__(self) -> None:
        self.rate_hz: float | None = None
        self._begun: float | None = None
        self._last = 0.0
        self._count = 0

    def begin(self) -> None:
        """What came before does not count."""
        self._begun = None

    def take(self, count: int, now: float, told_hz: float) -> None:
        """So many samples have come, lost ones included, at `now`, s monotonic."""
        if self._begun is None or now - self._last > max(PAUSE_S, 4.0 / told_hz):
            self._begun, self._last, self._count = now, now, 0
            return
        self._last = now
        self._count += count
        span = now - self._begun
        if span < LEAST_S:
            return
        off = abs(self._count / told_hz - span)
        if off > TOLERANCE * span + SLACK_S + SLACK / told_hz:
            rate = self._count / span
            if self.rate_hz is None or abs(rate / self.rate_hz - 1.0) > TOLERANCE:
                self.rate_hz = rate
        elif off < TOLERANCE * span:
            self.rate_hz = None
        if span > LONGEST_S:
            self._begun = None

    def remark(self, told_hz: float) -> str | None:
        """What there is to say."""
        if self.rate_hz is None:
            return None
        return f"samples come at {self.rate_hz:.3g} Hz, not at the told {told_hz:g} Hz: correct the rate"
