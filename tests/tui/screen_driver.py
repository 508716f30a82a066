"""The screen without a terminal, driven by a script of a test."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable

import reports
from textual.app import App
from textual.pilot import Pilot

from imumon.model.report import Report
from imumon.tui.app import ImumonApp
from imumon.tui.formatting import Line, Notation
from imumon.tui.widgets import DrawnPanel, ScrolledPanel

Script = Callable[[ImumonApp, Pilot[int]], Awaitable[None]]


def drive(
    source: reports.FakeSource, script: Script, size: tuple[int, int] = (150, 40), **options: object
) -> ImumonApp:
    """Run the screen without a terminal and let the script use it."""

    async def go() -> ImumonApp:
        app = ImumonApp(source, clock=source.clock, **options)
        async with app.run_test(size=size) as pilot:
            await pilot.pause()
            await script(app, pilot)
        return app

    return asyncio.run(go())


def driven(
    source: Callable[[], reports.FakeSource] = lambda: reports.FakeSource(reports.report()),
    size: tuple[int, int] = (150, 40),
    **options: object,
) -> Callable[[Script], Callable[[], None]]:
    """Make a test of a script that uses the screen of a source."""
    return lambda script: lambda: drive(source(), script, size, **options) and None


def text_of(lines: Iterable[Line]) -> str:
    return "\n".join("".join(text for text, _ in line) for line in lines)


def visible_text(app: App[int]) -> str:
    """Return the text of the visible panels."""
    parts = [*app.screen_stack[0].query(DrawnPanel), *app.screen.query(ScrolledPanel)]
    return text_of(line for p in parts if p.display and p.size.area and p.is_on_screen for line in p.lines())


def status(app: ImumonApp) -> str:
    return text_of(app.query_one("#status", DrawnPanel).lines())


def table_number(report: Report, channel: str, letter: str) -> str:
    """Return N, B or K as the table shows it."""
    return Notation().coefficient(report.channels[channel].coefficients.get(letter), None)[0]
