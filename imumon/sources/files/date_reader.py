"""Date reader: a column of dates or times of day as seconds."""

from __future__ import annotations

import re
from datetime import datetime, time, timedelta

from imumon.model.units import DAY, HOUR

_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")

_LOOSE_DATE = re.compile(
    r"(?:(?:(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})"
    r"|(?P<first>\d{1,2})(?P<mark>[-/.])(?P<second_part>\d{1,2}|[a-z]{3})[-/.](?P<last_year>\d{4}))[t ,]\s*)?"
    r"(?P<hour>\d{1,2})(?P<sign>[:.])(?P<minute>\d{1,2})(?P=sign)(?P<second>\d{1,2})"
    r"(?:(?:[:.,]|::)(?P<fraction>\d{1,9}))?\s*(?P<half>[ap]m)?",
    re.IGNORECASE,
)
"""Date or time of day of a logger: without zeros in front, with dots for colons, colons before the milliseconds, the
name of a month, the year last, or twelve hours."""

_OF_HOUR = re.compile(r"\d{1,2}:\d{2}[.,]\d{1,9}")
"""Minutes and seconds, as spreadsheets show a time."""


def _iso(match: re.Match[str]) -> str:
    """Return a date of a logger in the form of ISO 8601; of one that may be of two months, the time of day.

    >>> _iso(_LOOSE_DATE.fullmatch("2024-3-19 9:44:16:689")), _iso(_LOOSE_DATE.fullmatch("9:44:16.7"))
    ('2024-03-19T09:44:16.689', '09:44:16.7')
    >>> _iso(_LOOSE_DATE.fullmatch("19-Mar-2024 09:44:16.5")), _iso(_LOOSE_DATE.fullmatch("3/19/2024 1:44:16.5 PM"))
    ('2024-03-19T09:44:16.5', '2024-03-19T13:44:16.5')
    >>> _iso(_LOOSE_DATE.fullmatch("19.03.2024 09:44:16,5")), _iso(_LOOSE_DATE.fullmatch("3/4/2024 09:44:16"))
    ('2024-03-19T09:44:16.5', '09:44:16.0')
    """
    hour, minute, second = (int(match[part]) for part in ("hour", "minute", "second"))
    if match["half"] is not None:
        hour = hour % 12 + 12 * (match["half"].lower() == "pm")
    of_day = f"{hour:02}:{minute:02}:{second:02}.{match['fraction'] or 0}"
    day = _day(match)
    return of_day if day is None else f"{day}T{of_day}"


def _day(match: re.Match[str]) -> str | None:
    """Return the day of a date, ISO 8601; None: it has none, or one that may be of two months."""
    if match["year"] is not None:
        return f"{match['year']}-{int(match['month']):02}-{int(match['day']):02}"
    if match["last_year"] is None:
        return None
    first, other = int(match["first"]), match["second_part"].lower()
    if not other.isdigit():
        return f"{match['last_year']}-{_MONTHS.index(other) + 1:02}-{first:02}" if other in _MONTHS else None
    day, month = first, int(other)
    if match["mark"] != "." and max(day, month) <= 12:
        return None
    if month > 12:
        day, month = month, day
    return f"{match['last_year']}-{month:02}-{day:02}"


class DateReader:
    """Reads a column of dates or times of day, in any order, as seconds.

    It reads ISO 8601, ``2026-01-31T12:00:00.025Z`` or with a blank, the dates of loggers (`_LOOSE_DATE`), and a time
    of day, ``12:00:00.025``, which continues over midnight, or of an hour, ``44:16.5``, over its end. Of a date such as
    3/4/2024, the time of day is read.
    Seconds count from the first one, so that no digit is lost to the years since 1970. Digits beyond microseconds are
    ignored.
    """

    def __init__(self) -> None:
        self._first: datetime | None = None
        self._last = 0.0

    def seconds(self, text: str) -> float:
        """Return the seconds since the first date that was read; raise ValueError if it is no date.

        >>> dates = DateReader()
        >>> [dates.seconds(text) for text in ("23:59:59.5", "00:00:00.25", "23:59:59.75")]
        [0.0, 0.75, 0.25]
        """
        text = text.strip()
        cycle = HOUR if _OF_HOUR.fullmatch(text) else DAY
        text = f"0:{text}" if cycle == HOUR else text
        if (loose := _LOOSE_DATE.fullmatch(text)) is not None:
            text = _iso(loose)
        if ":" not in text:  # a number, such as 20260131, is no date
            raise ValueError(text)
        try:
            of_day = datetime.combine(datetime(1970, 1, 1), time.fromisoformat(text))
        except ValueError:
            return self._since_first(datetime.fromisoformat(text))
        seconds = self._since_first(of_day)
        # the day that is nearest to the last time: rows out of order around midnight do not add a day each
        self._last = seconds + cycle * round((self._last - seconds) / cycle)
        return self._last

    def _since_first(self, moment: datetime) -> float:
        if self._first is None:
            self._first = moment
        try:
            return (moment - self._first) / timedelta(seconds=1)
        except TypeError:  # one has a time zone, the other has none
            raise ValueError(str(moment)) from None
