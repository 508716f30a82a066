"""The live screen: draws reports, computes nothing.

`run` shows a feed on the terminal, `picture` draws one report into an SVG without one. Textual is
imported late: whoever only asks for a status does not pay for it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from imumon.report import Event, Report, Signal
from imumon.tui.report_source import FixedReport, ReportSource

__all__ = ["FixedReport", "ReportSource", "picture", "run", "themes"]


def run(
    feed: ReportSource,
    *,
    id: str | None = None,
    ascii: bool = False,
    theme: str | None = None,
    baseline: Report | None = None,
    endpoint: str | None = None,
    starting: str | None = None,
    ended: Callable[[], str | None] | None = None,
) -> int:
    """Show a feed until the user leaves.

    Parameters
    ----------
    feed : where reports come from.
    id : device to show; None: the first that is heard.
    ascii : draw with ASCII characters only; implied where the terminal knows no others.
    theme : name of a theme, such as ``imumon-light``.
    baseline : report whose curves are drawn behind the live ones.
    endpoint : what was tried, for the page that is shown while nobody answers.
    starting : what that page says where a daemon is known to start.
    ended : asked now and then: the last word of that daemon when it has ended, else None.

    Returns
    -------
    int : exit code: 0, 1 without a terminal, 128 + n after signal n.
    """
    from imumon.tui import terminal

    reason = terminal.missing()
    if reason is not None:
        print(f"imumon: {reason}", file=sys.stderr)
        return 1
    from imumon.tui.app import ImumonApp

    app = ImumonApp(
        feed,
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
    """Names of the themes there are, our own first."""
    from textual.theme import BUILTIN_THEMES

    from imumon.tui.app import THEMES

    return (*(theme.name for theme in THEMES), *sorted(BUILTIN_THEMES))


def _flushed(code: int) -> int:
    """The exit code; where the terminal has gone, what is still unwritten would spoil it at the end."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os._exit(code or 129)
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
