"""Feed: where the screen gets its reports from.

A latest-value slot: whoever receives writes into it from its own threads, the screen reads it when it
is about to draw. Nothing is queued, so a slow terminal never holds anybody up and a fast sensor never
floods the screen.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol

from imumon.report import Event, Report, Signal


class ReportSource(Protocol):
    """What the screen asks for.

    Attributes
    ----------
    version : grows with every change, so that a screen draws only when there is something new.
    """

    version: int

    def reports(self) -> dict[str, tuple[Report, float]]:
        """Newest report of each device by its id, with its arrival in s of the monotonic clock."""

    def alive(self) -> set[str]:
        """Ids of the devices whose daemon is known to live."""

    def events(self, id: str) -> list[Event]:
        """Events of a device, newest last, at most 100."""

    def watch(self, id: str, channel: str | None) -> None:
        """Choose the channel whose signal is wanted from now on; None: no channel's."""

    def signal(self) -> tuple[Signal, float] | None:
        """Newest signal of the watched channel, with its arrival in s of the monotonic clock."""

    def connected(self) -> bool:
        """Whether any daemon or router can be reached."""


class FixedReport:
    """A feed of one report that never changes: a saved one, or the one a picture is made of."""

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
        """Nothing can be asked for."""

    def signal(self) -> tuple[Signal, float] | None:
        return None if self._signal is None else (self._signal, self._arrival)

    def connected(self) -> bool:
        return True
