"""State of running daemons: how old a report is, why a sensor delivers nothing, and one line about each.

A report says what the daemon knew; its age shows whether the daemon still measures. The age is the difference of
the host clocks. Those of two machines may differ, so a report that looks old is given the time of the next ones:
if a newer one arrives, it is not old.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from imumon.model.messages import caveats, grade_text, loss_label
from imumon.model.report import Report
from imumon.model.units import duration, in_columns

GRACE_S = 0.5
"""s beyond two periods that a report may be old, and that the next one is waited for."""

_TROUBLES = {
    "disconnect": "disconnected",
    "waiting": "disconnected",
    "silent": "silent",
}
"""State of the sensor by the kind of the last event about it."""


def current_reports(subscriber: Any, names: Sequence[str]) -> dict[str, tuple[Report, float]]:
    """Return the newest report of each device with its age, s."""
    reports: dict[str, tuple[Report, float]] = {name: subscriber.report(name) for name in names}
    old = {name: first for name, (first, _) in reports.items() if not _is_fresh(first)}
    end_s = time.monotonic() + max((_patience_s(report) for report in old.values()), default=0.0)
    while time.monotonic() < end_s and any(
        subscriber.report(name)[0].time == first.time for name, first in old.items()
    ):
        time.sleep(0.05)
    now_s, ages = time.monotonic(), {}
    for name in names:
        report, arrived_s = subscriber.report(name)
        renewed = name in old and report.time != old[name].time
        ages[name] = report, now_s - arrived_s if renewed else abs(_clock_age_s(report))
    return ages


def _clock_age_s(report: Report) -> float:
    return (datetime.now(UTC) - datetime.fromisoformat(report.time)).total_seconds()


def _patience_s(report: Report) -> float:
    return 2.0 * report.period_s + GRACE_S


def _is_fresh(report: Report) -> bool:
    return 0.0 <= _clock_age_s(report) <= _patience_s(report)


def current_trouble(subscriber: Any, report: Report, end_s: float) -> str | None:
    """Return why the sensor delivers nothing; None if it does.

    Its events may come after its first report: wait for them until `end_s`, monotonic.
    """
    while report.state == "waiting":
        if troubles := [event for event in subscriber.events(report.device.id) if event.kind in _TROUBLES]:
            return f"the sensor is {_TROUBLES[troubles[-1].kind]}: {troubles[-1].text}"
        if time.monotonic() >= end_s:
            return "the sensor is disconnected or silent"
        time.sleep(0.02)
    return None


def grades_text(report: Report) -> str:
    """Return the grades in a few words, such as ``gyro industrial, accel tactical provisional``."""
    parts = [f"{sensor} {grade_text(grade).replace(',', '')}" for sensor, grade in report.grade.items()]
    return ", ".join(parts) or "no grade"


def status_lines(reports: dict[str, tuple[Report, float]]) -> list[str]:
    """Return a line about each device: name, state, age, grades, loss and caveats, in columns."""
    return in_columns(
        (
            name,
            report.state,
            f"{duration(age_s) if age_s >= 1.0 else f'{age_s:.1f} s'} old",
            grades_text(report),
            loss_label(report),
            ", ".join(caveats(report)) or "no caveats",
        )
        for name, (report, age_s) in reports.items()
    )
