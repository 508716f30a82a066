"""Entry of the terminal UI.

Textual is imported in the functions: a command that only needs a status does not pay for it.
"""

from __future__ import annotations

import os
import sys
from typing import Any, Protocol, TypeAlias

from imumon.report import Event, Report, Signal
from imumon.tui import terminal

TERMINAL_GONE = 129
"""Exit code when the terminal is closed: 128 + SIGHUP."""


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


def run(source: ReportSource, *, ascii: bool = False, **options: Any) -> int:
    """Show a source until the user quits.

    Parameters
    ----------
    source : where reports come from.
    ascii : draw with ASCII characters only; implied if the terminal has no others.
    options : as for `imumon.tui.app.ImumonApp`.

    Returns
    -------
    int : exit code: 0, 1 without a terminal, 128 + n after signal n.
    """
    reason = terminal.obstacle()
    if reason is not None:
        print(f"imumon: {reason}", file=sys.stderr)
        return 1
    from imumon.tui.app import ImumonApp

    app = ImumonApp(source, ascii=ascii or terminal.only_ascii(), **options)
    app.run()
    return _flushed(app.return_code or 0)


def themes() -> tuple[str, ...]:
    """Return the names of the themes, those of imumon first."""
    from textual.theme import BUILTIN_THEMES

    from imumon.tui.app import THEMES

    return (*(theme.name for theme in THEMES), *sorted(BUILTIN_THEMES))


def _flushed(code: int) -> int:
    """Flush the output and return the exit code; with the terminal gone, exit without an error message."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os._exit(code or TERMINAL_GONE)
    return code
