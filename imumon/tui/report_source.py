"""Where the screen gets its reports from.

A slot for the latest value: the receiver writes into it from its own threads, and the screen reads it when
it is about to draw. Nothing is queued, so a slow terminal delays no thread and a fast sensor does not flood
the screen.
"""

from __future__ import annotations

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
