"""A screen in a process of its own, fed by a report that grows; for tests that need a real terminal."""

from __future__ import annotations

import sys
import time

import reports

from imumon.report import Event, Report, Signal
from imumon.tui import app, run


class Growing:
    """A daemon in small: a new report twice a second, three of sensor time in a second."""

    def __init__(self) -> None:
        self._begin = time.monotonic()

    @property
    def version(self) -> int:
        return int(2.0 * (time.monotonic() - self._begin))

    def reports(self) -> dict[str, tuple[Report, float]]:
        report = reports.report(600.0 + 1.5 * self.version)
        return {report.device.id: (report, time.monotonic())}

    def alive(self) -> set[str]:
        return {reports.ID}

    def events(self, id: str) -> list[Event]:
        return reports.events()

    def watch(self, id: str, channel: str | None) -> None:
        self._channel = channel

    def signal(self) -> tuple[Signal, float] | None:
        return reports.signal(), time.monotonic()

    def connected(self) -> bool:
        return True


if __name__ == "__main__":
    app.POLL = 0.3
    sys.exit(run(Growing(), ascii="--ascii" in sys.argv))
