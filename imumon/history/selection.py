"""Selection: which rows of the history are asked for, from the options of a command or the parameters of a query.

Times are those of Zenoh storages: ``_time=[START..END]`` with RFC 3339 times or ``now(-2h)``, and
``_time=[START;DURATION]``. A square bracket that faces outwards excludes that end. Commands also take a duration
before now (``30d``), a date, or a date and time, all in UTC.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime

from imumon.model.errors import ImumonError
from imumon.model.history_report import STEPS
from imumon.model.samples import ChannelName
from imumon.model.units import DAY, seconds

EVENTS = "event"
"""Name of the key of the events below that of the history."""
HOURS_S = 62.0 * DAY
"""s, longest span that is answered in steps of an hour if no step is asked for."""


class SelectionError(ImumonError):
    """What is asked for is not valid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Rows that are asked for.

    Attributes
    ----------
    since, until : s since 1970; a row belongs to it if it begins in between, or lasted into it.
    channels : names of channels, or of sensors; empty: all.
    step : one of `STEPS`.
    """

    since: float
    until: float
    channels: tuple[str, ...] = ()
    step: str = "1h"

    def wants(self, channel: ChannelName) -> bool:
        """Return whether a channel is asked for.

        >>> Selection(since=0.0, until=1.0, channels=("gyro",)).wants(ChannelName("gyro/x"))
        True
        """
        return not self.channels or channel in self.channels or channel.sensor in self.channels


def selection(
    now: float,
    *,
    since: float | None = None,
    until: float | None = None,
    channels: tuple[str, ...] = (),
    step: str | None = None,
) -> Selection:
    """Return a selection with the defaults: the last 24 h, and a step that suits the span.

    Parameters
    ----------
    now : s since 1970.
    since, until : s since 1970; None: not given.
    """
    until = now if until is None else until
    since = until - DAY if since is None else since
    if since > until:
        raise SelectionError("time_invalid", "the end is before the beginning", "exchange the two times")
    if step is None:
        step = "1h" if until - since <= HOURS_S else "1d"
    if step not in STEPS:
        raise SelectionError("step_invalid", f"{step[:20]!r} is not a step", f"give {', '.join(STEPS)}")
    return Selection(since=since, until=until, channels=channels, step=step)


def of_parameters(parameters: str, now: float) -> Selection:
    """Return the selection of the parameters of a query, such as ``_time=[now(-7d)..now()];channel=gyro/x``.

    >>> chosen = of_parameters("_time=[now(-2h)..now()];step=1h;channel=gyro", 7200.0)
    >>> chosen.since, chosen.until, chosen.step, chosen.channels
    (0.0, 7200.0, '1h', ('gyro',))
    """
    since, until = None, None
    if (time := re.search(r"(?:^|;)_time=([\[\]][^\[\]]*[\[\]])", parameters)) is not None:
        since, until = _time_range(time[1], now)
        parameters = parameters[: time.start()] + parameters[time.end() :]
    words = dict(part.partition("=")[::2] for part in parameters.split(";") if part)
    channels = tuple(name for name in words.get("channel", "").split(",") if name)
    return selection(now, since=since, until=until, channels=channels, step=words.get("step"))


def moment(text: str, now: float) -> float:
    """Return a time in s since 1970: RFC 3339, a date, ``now(-2h)``, or a duration before now.

    >>> moment("1970-01-02", 0.0), moment("1970-01-01T00:00:05Z", 0.0), moment("now(-1h)", 7200.0), moment("2h", 7200.0)
    (86400.0, 5.0, 3600.0, 0.0)
    """
    text = text.strip()
    relative = re.fullmatch(r"now\(\s*([+-]?)\s*([^()]*)\)", text)
    try:
        if relative is not None:
            length_s = seconds(relative[2]) if relative[2] else 0.0
            time = now - length_s if relative[1] == "-" else now + length_s
        else:
            try:
                known = datetime.fromisoformat(text)
            except ValueError:
                time = now - seconds(text)
            else:
                time = (known if known.tzinfo else known.replace(tzinfo=UTC)).timestamp()
        datetime.fromtimestamp(time, UTC)  # between the years 1 and 9999
    except (ValueError, OverflowError, OSError):
        raise _invalid(text) from None
    return time


def _time_range(text: str, now: float) -> tuple[float | None, float | None]:
    """Return beginning and end of a time range of Zenoh; None: open."""
    inner = text[1:-1]
    if ".." in inner:
        first, _, last = inner.partition("..")
        return (moment(first, now) if first else None), (moment(last, now) if last else None)
    first, separator, length = inner.partition(";")
    if not separator:
        raise _invalid(text)
    since = moment(first, now)
    try:
        return since, since + seconds(length)
    except ValueError:
        raise _invalid(length) from None


def _invalid(text: str) -> SelectionError:
    cure = "write 2h, 30d, 2026-11-03, or 2026-11-03T10:20:00Z"
    return SelectionError("time_invalid", f"{text[:40]!r} is not a time", cure)
