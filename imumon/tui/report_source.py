"""Where the screen gets its reports from: the interface that the receiver of the bus has, and that tests imitate."""

from __future__ import annotations

from typing import Protocol, TypeAlias

from imumon.report import Event, Report, Signal

HistoryQuestion: TypeAlias = tuple[str, str, float, str]
"""Device, channel, span in s before now, and step of the rows."""
HistoryAnswer: TypeAlias = tuple[HistoryQuestion, bytes, bytes]
"""The question, and the rows and events of the reply as JSON."""


class ReportSource(Protocol):
    """Where the screen gets its reports from: a slot for the latest value.

    The receiver writes into it from its own threads, and the screen reads it when it is about to draw. Nothing
    is queued, so a slow terminal delays no thread and a fast sensor does not flood the screen.

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

    def rivals(self) -> dict[str, tuple[str, ...]]:
        """Return the devices that several programs publish, with the sessions of these."""

    def watch(self, id: str, channel: str | None) -> None:
        """Choose the channel whose signal is requested from now on; None: none."""

    def signal(self) -> tuple[Signal, float] | None:
        """Return the newest signal of the watched channel, with its arrival in s of the monotonic clock."""

    def watch_history(self, asked: HistoryQuestion | None) -> None:
        """Choose the history that is requested every now and then from now on; None: none."""

    def history_answer(self) -> HistoryAnswer | None:
        """Return the newest replies, with the question."""

    def connected(self) -> bool:
        """Return whether any daemon or router can be reached."""
