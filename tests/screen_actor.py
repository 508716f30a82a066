"""A screen in its own process with a growing report, for tests that need a real terminal."""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import reports

from imumon.model.report import Report, Signal
from imumon.tui import app, run

START_S = 60.0
"""s, elapsed time of the first report."""


class GrowingSource(reports.FakeSource):
    """A new report every other second, of three seconds of the sensor per second: the saved one with other times."""

    def __init__(self) -> None:
        super().__init__(reports.report())
        self._begin = time.monotonic()

    @property
    def version(self) -> int:  # type: ignore[override]
        return int(0.5 * (time.monotonic() - self._begin))

    def reports(self) -> dict[str, tuple[Report, float]]:
        saved = reports.report()
        session = replace(saved.session, elapsed_s=START_S + 6.0 * self.version)
        return {reports.ID: (replace(saved, session=session), time.monotonic())}

    def signal(self) -> tuple[Signal, float]:
        return reports.signal(), time.monotonic()


if __name__ == "__main__":
    app.TERMINAL_POLL_S = 0.3
    sys.exit(run(GrowingSource()))
