"""Snapshots of the screen, each of a state that matters.

    python tests/pictures.py [WORD ...]    redraws those whose name contains a word, by default all

Starting a screen takes longer than drawing it, so one screen draws all snapshots: between two of them it gets
another source, size and theme. After a change of the screen, redraw the snapshots, view those that `git
status` lists, and commit them with the change.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import reports
from paths import ROOT, TESTS
from textual.pilot import Pilot
from textual.widgets import Input

from imumon.model.report import Report
from imumon.tui.app import ImumonApp
from imumon.tui.view_state import ViewState
from imumon.tui.widgets import StyledWidget

FOLDER = TESTS / "data" / "screen"
IN_README = ("overview-large", ROOT / "docs" / "screen.svg")
"""The snapshot that the README shows, and its copy."""
SMALL, LARGE, HUGE = (80, 24), (150, 40), (220, 60)
OTHER = "vn100-0100056799"

SOURCES: dict[str, Callable[[], reports.FakeSource]] = {
    "running": lambda: reports.FakeSource(reports.report(caveats=("aliased",))),
    "two": lambda: reports.FakeSource(reports.report(), reports.report(900.0, id=OTHER)),
    "correlated": lambda: reports.FakeSource(reports.correlated()),
    "no-daemon": lambda: reports.FakeSource(connected=False),
    "no-report": lambda: reports.FakeSource(),
    "starting": lambda: reports.FakeSource(reports.nothing_yet()),
    "early": lambda: reports.FakeSource(reports.report(8.0)),
    "warming-up": lambda: reports.FakeSource(reports.warming_up()),
    "moving": lambda: reports.FakeSource(reports.moving()),
    "stale": lambda: reports.FakeSource(reports.report(), age=14.0),
    "lost": lambda: reports.FakeSource(reports.report(), age=14.0, alive=False, connected=False),
    "gone": lambda: reports.FakeSource(reports.report(), age=5.0, alive=False),
    "waiting": lambda: reports.FakeSource(reports.report(state="waiting")),
    "finished": lambda: reports.FakeSource(
        reports.report(state="stopped"), age=90.0, alive=False, connected=False
    ),
    "time-lapse": lambda: reports.FakeSource(reports.report(200.0, speed=60.0)),
}


@dataclass(frozen=True)
class Picture:
    """What to draw: keys pressed on a screen of that size that shows that source."""

    name: str
    source: str = "running"
    keys: tuple[str, ...] = ()
    size: tuple[int, int] = SMALL
    theme: str = "imumon-dark"
    baseline: Callable[[], Report] | None = None


PICTURES = {
    picture.name: picture
    for picture in (
        # every view once, alternating between the small and the large layout
        Picture("overview-large", size=LARGE),
        Picture("overview-small"),
        Picture("signal-large", keys=("2",), size=LARGE),
        Picture("device-large", keys=("3",), size=LARGE),
        Picture("events-small", keys=("4",)),
        Picture("over-time-small", keys=("6", "right", "down")),
        Picture("over-time-day-large", keys=("6", "plus"), size=LARGE),
        Picture("sensors-large", "two", keys=("5",), size=LARGE),
        # correlated noise: its own line, columns and what is open
        Picture("correlated-large", "correlated", size=LARGE),
        # what a chart can show: unused octaves, limits of the grades and a baseline; three axes
        Picture(
            "accel-y-limits-baseline",
            keys=("right", "down", "g"),
            size=LARGE,
            baseline=lambda: reports.report(900.0),
        ),
        Picture("overlay-huge", keys=("o",), size=HUGE),
        # states in which the numbers are missing or not current
        Picture("no-daemon", "no-daemon"),
        Picture("early", "early"),
        Picture("moving", "moving"),
        Picture("lost-light", "lost", size=LARGE, theme="imumon-light"),
        # notations and narrow terminals
        Picture("si", keys=("u",)),
        Picture("narrow", size=(44, 20)),
        # a window above the view
        Picture("help", keys=("question_mark",)),
    )
}
"""Everything else that a screen can show follows from these, and has laws in test_tui.py."""


class SwitchableSource:
    """A proxy for a source that can be exchanged."""

    def __init__(self) -> None:
        self.version = 0
        self.use("no-daemon")

    def use(self, name: str) -> None:
        self.source = SOURCES[name]()
        self.version += 1

    def __getattr__(self, name: str) -> Any:
        return getattr(self.source, name)


async def _draw(app: ImumonApp, pilot: Pilot[int], source: SwitchableSource, picture: Picture) -> str:
    """Return one picture as a freshly started screen draws it."""
    while len(app.screen_stack) > 1:
        app.pop_screen()
    box = app.query_one("#filter", Input)
    box.value = ""
    box.remove_class("open")
    app.theme = picture.theme
    if app.size != picture.size:
        await pilot.resize_terminal(*picture.size)
    baseline = picture.baseline() if picture.baseline is not None else None
    app.view_state = ViewState(baseline=baseline, baseline_name="saved")
    app._watched = None
    source.use(picture.source)
    app.poll()
    for part in app.query(StyledWidget):
        part.refresh()
    await pilot.pause()
    await pilot.press(*picture.keys)
    await pilot.pause()
    return app.export_screenshot(title="imumon")


def drawn(pictures: Iterable[Picture]) -> dict[str, str]:
    """Return the SVG of each picture by name."""

    async def go() -> dict[str, str]:
        source = SwitchableSource()
        app = ImumonApp(source, clock=lambda: source.clock())
        async with app.run_test(size=SMALL) as pilot:
            order = sorted(pictures, key=lambda p: (p.size, p.theme))
            return {p.name: await _draw(app, pilot, source, p) for p in order}

    return asyncio.run(go())


if __name__ == "__main__":
    names = sys.argv[1:] or [""]
    FOLDER.mkdir(exist_ok=True)
    if names == [""]:
        for old in FOLDER.glob("*.svg"):
            if old.stem not in PICTURES:
                old.unlink()
    for name, svg in drawn(p for p in PICTURES.values() if any(part in p.name for part in names)).items():
        (FOLDER / f"{name}.svg").write_text(svg, encoding="utf-8")
        if name == IN_README[0]:
            IN_README[1].write_text(svg, encoding="utf-8")
