"""Dates: times that a table writes as people read them, in seconds.

ISO 8601, ``2026-01-31T12:00:00.025Z`` or with a blank between, and a time of day alone, ``12:00:00.025``,
which goes on over midnight. They count from the first one, so that no digit is lost to the years since 1970.
Digits beyond microseconds are cut off.
"""

from __future__ import annotations

from datetime import datetime, time, timedelta

DAY_S = 86_400.0
_MIDNIGHT = datetime(1970, 1, 1)


class Dates:
    """Times of one column, in any order."""

    def __init__(self) -> None:
        self._first: datetime | None = None
        self._last = 0.0

    def seconds(self, text: str) -> float:
        """Seconds since the first time that was asked for.

        Raises
        ------
        ValueError : it is no such time.

        >>> dates = Dates()
        >>> [dates.seconds(text) for text in ("23:59:59.5", "00:00:00.25", "23:59:59.75")]
        [0.0, 0.75, 0.25]
        """
        text = text.strip()
        if ":" not in text:  # a number, such as 20260131, is none
            raise ValueError(text)
        try:
            of_day = datetime.combine(_MIDNIGHT, time.fromisoformat(text))
        except ValueError:
            return self._since(datetime.fromisoformat(text))
        seconds = self._since(of_day)
        self._last = seconds + DAY_S * round((self._last - seconds) / DAY_S)
        return self._last

    def _since(self, moment: datetime) -> float:
        if self._first is None:
            self._first = moment
        try:
            return (moment - self._first) / timedelta(seconds=1)
        except TypeError:  # one tells its zone, the other does not
            raise ValueError(str(moment)) from None
