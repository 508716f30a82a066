"""Where the screen gets its reports from.

A slot for the latest value: the receiver writes into it from its own threads, and the screen reads it when
it is about to draw. Nothing is queued, so a slow terminal delays no thread and a fast sensor does not flood
the screen.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol

from imumon.report import Event, Report, Signal


class ReportSource(Protocol):
    """What the screen reads.

    Attributes
    ----------
    version : grows with every change, so that the screen draws only when something is new.
    """

    version: int

    def reports(self) -> dict[str, tuple[Report, float]]:
        """Return the newest report of each device by id, with its arrival in s of the monotonic clock."""

    def alive(self) -> set[str]:
        """Return the ids of the devices with a running daemon."""

    def events(self, id: str) -> list[Event]:
        """Return the events of a device, newest last, at most 100."""

    def watch(self, id: str, channel: str | None) -> None:
        """Choose the channel whose signal is requested from now on; None: none."""

    def signal(self) -> tuple[Signal, float] | None:
        """Return the newest signal of the watched channel, with its arrival in s of the monotonic clock."""

    def connected(self) -> bool:
        """Return whether any daemon or router can be reached."""


class FixedReport:
    """Source of one report that never changes, such as a saved one."""

    def __init__(self, report: Report, signal: Signal | None = None, events: Sequence[Event] = ()) -> None:
        self.version = 1
        self._report = report
        self._signal = signal
        self._events = list(events)
        self._arrival = time.monotonic()

    def reports(self) -> dict[str, tuple[Report, float]]:
        return {self._report.device.id: (self._report, self._arrival)}

    def alive(self) -> set[str]:
        return {self._report.device.id}

    def events(self, id: str) -> list[Event]:
        return self._events

    def watch(self, id: str, channel: str | None) -> None:
        """Do nothing: the signal is fixed too."""

    def signal(self) -> tuple[Signal, float] | None:
        return None if self._signal is None else (self._signal, self._arrival)

    def connected(self) -> bool:
        return True
