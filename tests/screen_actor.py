"""A screen in its own process with a growing report, for tests that need a real terminal."""

from __future__ import annotations

import sys
import time

import report_runs
import reports

from imumon.model.report import Event, Report, Signal
from imumon.tui import app, run

START_S = 60.0
"""s, elapsed time of the first report."""


class GrowingSource:
    """A new report every other second, of three seconds of the sensor per second."""

    def __init__(self) -> None:
        self._run = report_runs.Run(600.0)
        self._report = self._run.report_at(START_S)
        self._signal = self._run.monitor.signals()["gyro/x"]()
        self._begin = time.monotonic()

    @property
    def version(self) -> int:
        return int(0.5 * (time.monotonic() - self._begin))

    def reports(self) -> dict[str, tuple[Report, float]]:
        elapsed_s = START_S + 6.0 * self.version
        if elapsed_s > self._report.session.elapsed_s:
            self._report = self._run.report_at(elapsed_s)
        return {reports.ID: (self._report, time.monotonic())}

    def alive(self) -> set[str]:
        return {reports.ID}

    def events(self, id: str) -> list[Event]:
        return reports.events()

    def rivals(self) -> dict[str, tuple[str, ...]]:
        return {}

    def watch(self, id: str, channel: str | None) -> None:
        pass

    def signal(self) -> tuple[Signal, float] | None:
        return self._signal, time.monotonic()

    def watch_history(self, asked: object) -> None:
        pass

    def history_answer(self) -> None:
        return None

    def connected(self) -> bool:
        return True


if __name__ == "__main__":
    app.TERMINAL_POLL_S = 0.3
    sys.exit(run(GrowingSource()))
