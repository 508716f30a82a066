"""Silence: a sensor of which no bytes come, or no samples, for longer than either may take.

Bytes without samples of the stream are no sign of life, but at the start they may need their time. The
clock is handed in, and asked only when the port was read: the daemon's own business is no silence.
"""

from __future__ import annotations

STALE_S = 2.0
LEARNING_S = 30.0
"""In which bytes become samples, be they ever so slow; a service manager waits longer for a start."""


class DataTimeout:
    """What was heard of one sensor."""

    def __init__(self) -> None:
        self._mute_since: float | None = None  # no bytes
        self._silent_since: float | None = None  # no samples

    def lack(
        self, now: float, *, data: bool, samples: bool, rate_hz: float | None, learning: bool
    ) -> str | None:
        """What does not come, in words, None while all is well.

        Parameters
        ----------
        now : s, monotonic.
        data, samples : whether bytes, and samples in them, came just now.
        rate_hz : of the samples, as far as it is known.
        learning : no sample ever came.
        """
        stale = stale_s(rate_hz)
        self._mute_since = None if data else self._mute_since or now
        self._silent_since = None if samples else self._silent_since or now
        if now - (self._mute_since or now) > stale:
            return "nothing comes from the sensor"
        if now - (self._silent_since or now) > (LEARNING_S if learning else stale):
            return "bytes come, but no samples of the stream"
        return None


def stale_s(rate_hz: float | None) -> float:
    """Silence that is longer than any sample takes to come.

    >>> stale_s(100.0), stale_s(None), stale_s(0.5)
    (2.0, 5.0, 10.0)
    """
    return max(STALE_S, 5.0 / (rate_hz or 1.0))
