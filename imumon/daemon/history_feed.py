"""History feed: what the daemon gives to its history and its metrics.

The daemon calls it whether these are kept or not. There is no history before the device is known, because its name is
that of the file.
"""

from __future__ import annotations

import logging
import time
from pathlib import Path

from imumon.bus import Publisher
from imumon.config import Settings
from imumon.history import History
from imumon.history.metrics import MetricsServer
from imumon.pipeline import Monitor
from imumon.report import Event, Report
from imumon.samples import Level, SampleBlock

log = logging.getLogger(__name__)

UNKEPT = ("gap",)
"""Kinds of events that are not kept: a lossy link has thousands, and the rows count what is missing."""


class HistoryFeed:
    """The history and the metrics of the device of a daemon, as far as they are kept.

    Parameters
    ----------
    speed : seconds of the sample clock per second of the host clock.

    Raises
    ------
    MetricsError : metrics are configured and cannot be served.
    """

    def __init__(self, settings: Settings, *, speed: float) -> None:
        self._settings, self._speed = settings.history, speed
        self._history: History | None = None
        self._metrics: MetricsServer | None = None
        if settings.metrics.listen:
            self._metrics = MetricsServer(settings.metrics.listen)
            log.info("%s", f"metrics on http://{self._metrics.address}/metrics")

    def open(self, directory: Path, bus: Publisher) -> None:
        """Begin to keep the history of the device that is published on a bus, and to answer questions there."""
        if self._settings.enabled and self._history is None:
            keep_days = self._settings.keep_days
            self._history = History(directory, bus.id, keep_days=keep_days, speed=self._speed)
            bus.answer_history(self._history.answer)

    def clock(self, block: SampleBlock) -> None:
        """Note the clock of the sensor, if it counts from the power-up."""
        if self._history is not None and block.stream.clock == "startup" and block.time_ns is not None:
            self._history.clock(float(block.time_ns[-1]) * 1e-9, time.time())

    def keep(self, monitor: Monitor, started: str | None, *, in_progress: bool = False) -> None:
        """Keep the periods of a monitor that have ended, and with `in_progress` also those that have not.

        Parameters
        ----------
        started : when the record began, as text; None: there is no sample yet.
        """
        ended = monitor.periods()
        if self._history is None or started is None:
            return
        now = time.time()
        self._history.add(ended, started, now)
        if in_progress:
            self._history.add(monitor.periods_in_progress(), started, now)

    def report(self, report: Report) -> None:
        """Serve a report as metrics."""
        if self._metrics is not None:
            self._metrics.update(report)

    def event(self, event: Event) -> None:
        """Keep and count an event."""
        if self._metrics is not None:
            self._metrics.event(event)
        if self._history is not None and event.kind not in UNKEPT:
            self._history.event(event)

    def annotated(self, report: Report) -> Report:
        """Return a report with what the history shows."""
        return report if self._history is None else self._history.annotated(report)

    def new_changes(self) -> list[tuple[str, str]]:
        """Return the changes over days that are new: channel and text."""
        return [] if self._history is None else self._history.new_changes()

    def save(self) -> None:
        """Let it be written."""
        if self._history is not None:
            self._history.save()

    def problems(self) -> list[tuple[str, Level]]:
        """Return what is new about writing it, with the log level."""
        return [] if self._history is None else self._history.problems()

    def close(self) -> None:
        """Write what is new, and serve no metrics any more."""
        if self._metrics is not None:
            self._metrics.close()
        if self._history is not None:
            self._history.close()
