"""Entry of the terminal UI.

Textual is imported in the functions: a command that only needs a status does not pay for it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from imumon.report import Event, Report, Signal
from imumon.tui import terminal
from imumon.tui.report_source import FixedReport, ReportSource

TERMINAL_GONE = 129
"""Exit code when the terminal is closed: 128 + SIGHUP."""


def run(
    source: ReportSource,
    *,
    id: str | None = None,
    ascii: bool = False,
    theme: str | None = None,
    baseline: Report | None = None,
    endpoint: str | None = None,
    starting: str | None = None,
    ended: Callable[[], str | None] | None = None,
) -> int:
    """Show a source until the user quits.

    Parameters
    ----------
    source : where reports come from.
    id : device to show; None: the first that answers.
    ascii : draw with ASCII characters only; implied if the terminal has no others.
    theme : name of a theme, such as ``imumon-light``.
    baseline : report whose curves are drawn behind the live ones.
    endpoint : endpoints that were tried, for the page that is shown while no daemon answers.
    starting : text of that page if a daemon is known to start.
    ended : polled now and then: last message of that daemon when it has ended, else None.

    Returns
    -------
    int : exit code: 0, 1 without a terminal, 128 + n after signal n.
    """
    reason = terminal.obstacle()
    if reason is not None:
        print(f"imumon: {reason}", file=sys.stderr)
        return 1
    from imumon.tui.app import ImumonApp

    app = ImumonApp(
        source,
        id=id,
        ascii=ascii or terminal.only_ascii(),
        theme=theme,
        baseline=baseline,
        endpoint=endpoint,
        starting=starting,
        ended=ended,
    )
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


def picture(
    report: Report,
    path: Path,
    *,
    signal: Signal | None = None,
    events: Sequence[Event] = (),
    size: tuple[int, int] = (150, 40),
    keys: Sequence[str] = (),
    theme: str | None = None,
) -> None:
    """Draw the screen of a report into an SVG file, without a terminal.

    Parameters
    ----------
    size : columns and rows.
    keys : keys to press first, such as ``2`` for the signal view.
    """
    import asyncio

    from imumon.tui.app import ImumonApp

    async def draw() -> str:
        app = ImumonApp(FixedReport(report, signal, events), theme=theme)
        async with app.run_test(size=size) as pilot:
            await pilot.press(*keys)
            await pilot.pause()
            return app.export_screenshot()

    path.write_text(asyncio.run(draw()), encoding="utf-8")
