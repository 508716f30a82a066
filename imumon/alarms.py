"""Alarms: what of a report is too much, each with its setting and its limit.

An alarm is one row of `ALARMS` and its setting in the table ``[alert]``. The row reaches every place that judges:
the event of the pipeline, `imumon check`, diagnostics of ROS 2, metrics, screen and documents. The limits travel in
the report (`Report.alarm_limits`), so that all readers use those of the daemon.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from imumon.units import share_text

if TYPE_CHECKING:
    from imumon.report import Report


@dataclass(frozen=True, slots=True)
class Alarm:
    """A number of the report that must not exceed a limit.

    Attributes
    ----------
    name : kind of its event, and label of its number for monitoring systems.
    setting : its limit in the table ``[alert]``, 0 to 1; `imumon check` has it as an option, ``--max-NAME``.
    limit : default of the setting.
    what : completes "3 % ...".
    value : share, 0 to 1, in a report; None: not known.
    by_samples : the pipeline judges it where it happens in the record, not once per report.
    """

    name: str
    setting: str
    limit: float
    what: str
    value: Callable[[Report], float | None]
    by_samples: bool = False

    def text(self, value: float) -> str:
        """Return a value as a sentence, such as ``3 % of the samples of the last minute are missing``."""
        return f"{share_text(value)} {self.what}"

    def label(self, value: float | None) -> str:
        """Return a value in a few words, such as ``loss 3 %``."""
        return f"{self.name} {'not known' if value is None else share_text(value)}"


ALARMS: tuple[Alarm, ...] = (
    Alarm(
        "loss",
        "max_loss",
        0.01,
        "of the samples of the last minute are missing",
        lambda report: report.session.recent_loss,
        by_samples=True,
    ),
)
DEFAULT_LIMITS: Mapping[str, float] = {alarm.name: alarm.limit for alarm in ALARMS}
"""Limits by name of the alarm without settings."""

RECOVERED = 0.5
"""Share of the limit below which an alarm is over: a value near the limit crosses it all the time."""


def limits(settings: Any) -> dict[str, float]:
    """Return the configured limits by name of the alarm. `settings` is the table ``[alert]``."""
    return {alarm.name: getattr(settings, alarm.setting) for alarm in ALARMS}


def known(report: Report) -> Iterator[tuple[Alarm, float, float]]:
    """Yield each alarm whose value is known, with value and limit."""
    for alarm in ALARMS:
        value = alarm.value(report)
        if value is not None:
            yield alarm, value, report.alarm_limits.get(alarm.name, alarm.limit)


def exceeded(report: Report) -> list[str]:
    """Return a sentence for each alarm whose value is above its limit."""
    return [alarm.text(value) for alarm, value, limit in known(report) if value > limit]


def labels(report: Report) -> list[str]:
    """Return each alarm with its value in a few words."""
    return [alarm.label(alarm.value(report)) for alarm in ALARMS]
