"""Pictures of the screen: every view and every state, small and large, dark and light.

    python tests/pictures.py [WORD ...]    draws anew those whose name holds one of the words, else all

Starting a screen takes longer than drawing it, so one screen draws them all: it is handed from feed to
feed, resized and given another theme between two pictures. Whoever changes what is seen draws the
pictures anew, looks at those that `git status` lists, and keeps them in the same commit.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import reports
from textual.pilot import Pilot
from textual.widgets import Input

from imumon.report import Report
from imumon.tui.app import ImumonApp
from imumon.tui.formatting import Notation
from imumon.tui.view_state import ViewState
from imumon.tui.widgets import Painted

FOLDER = Path(__file__).parent / "data" / "screen"
SMALL, LARGE, HUGE = (80, 24), (150, 40), (220, 60)
OTHER = "vn100-0100056799"

FEEDS: dict[str, Callable[[], reports.Recorded]] = {
    "running": lambda: reports.Recorded(reports.report()),
    "two": lambda: reports.Recorded(reports.report(), reports.report(900.0, id=OTHER, scale=2.0)),
    "nobody": lambda: reports.Recorded(connected=False),
    "silent": lambda: reports.Recorded(),
    "starting": lambda: reports.Recorded(reports.nothing_yet()),
    "early": lambda: reports.Recorded(reports.report(8.0, gaps=0)),
    "warming": lambda: reports.Recorded(reports.report(130.0, caveats=("warming_up", "aliased"))),
    "moving": lambda: reports.Recorded(reports.report(caveats=("not_at_rest",))),
    "stale": lambda: reports.Recorded(reports.report(), age=14.0),
    "lost": lambda: reports.Recorded(reports.report(), age=14.0, alive=False, connected=False),
    "gone": lambda: reports.Recorded(reports.report(), age=5.0, alive=False),
    "waiting": lambda: reports.Recorded(reports.report(state="waiting")),
    "finished": lambda: reports.Recorded(
        reports.report(state="stopped"), age=90.0, alive=False, connected=False
    ),
    "lapse": lambda: reports.Recorded(reports.report(400.0, speed=60.0)),
}


@dataclass(frozen=True)
class Picture:
    """What is to be drawn: keys pressed on a screen of that size that shows that feed."""

    name: str
    feed: str = "running"
    keys: tuple[str, ...] = ()
    size: tuple[int, int] = SMALL
    theme: str = "imumon-dark"
    ascii: bool = False
    baseline: Report | None = None


def _everywhere(name: str, feed: str, *keys: str) -> Iterator[Picture]:
    for size in (SMALL, LARGE):
        for theme in ("dark", "light"):
            yield Picture(f"{name}-{size[0]}-{theme}", feed, keys, size, f"imumon-{theme}")


def _all() -> Iterator[Picture]:
    views = ("overview", "signal", "device", "events", "sensors")
    for key, view in enumerate(views, 1):
        yield from _everywhere(view, "two" if view == "sensors" else "running", str(key))
    for state in FEEDS:
        if state not in ("running", "two"):
            yield from _everywhere(state, state)
    for key, view in enumerate(views[1:], 2):
        yield Picture(f"early-{view}", "early", (str(key),))
        yield Picture(f"lost-{view}", "lost", (str(key),), LARGE)
    yield from _everywhere("compared", "two", "5", "c")
    yield Picture("overlay-of-axes", keys=("o",), size=LARGE)
    yield Picture("grade-limits", keys=("down", "g"), size=LARGE)
    yield Picture("accel-y-left-out-octaves", keys=("right", "down"), size=LARGE)
    yield Picture("bounds-of-mag", keys=("right", "right"), size=LARGE)
    yield Picture("temperature", keys=("up", "up"), size=LARGE)
    yield Picture("chart-alone", keys=("z",))
    yield Picture("si-units", keys=("u",))
    yield Picture("si-units-large", keys=("u",), size=LARGE)
    yield Picture("frozen", keys=("f",))
    yield Picture("frozen-large", keys=("f",), size=LARGE)
    yield Picture("hour", keys=("2", "w"))
    yield Picture("help-overview", keys=("question_mark",))
    yield Picture("help-events", keys=("4", "question_mark"), size=LARGE)
    yield Picture("saving", keys=("s",))
    yield Picture("filter", keys=("4", "slash", "g", "a", "p", "enter"))
    yield Picture("filter-open", keys=("4", "slash", "g"))
    yield Picture("narrow", size=(44, 20))
    yield Picture("huge", size=HUGE)
    yield Picture("huge-light", size=HUGE, theme="imumon-light")
    yield Picture("baseline", size=LARGE, baseline=reports.report(3600.0, scale=1.7))
    yield Picture("ascii", ascii=True)
    yield Picture("ascii-large", ascii=True, size=LARGE)
    for theme in ("ansi-dark", "gruvbox", "solarized-light"):
        yield Picture(theme, theme=theme)


PICTURES = {picture.name: picture for picture in _all()}


class Handed:
    """A feed that stands for another, which may be exchanged."""

    def __init__(self) -> None:
        self.version = 0
        self.take("nobody")

    def take(self, name: str) -> None:
        self.feed = FEEDS[name]()
        self.version += 1

    def __getattr__(self, name: str) -> Any:
        return getattr(self.feed, name)


async def _draw(app: ImumonApp, pilot: Pilot[int], feed: Handed, wanted: Picture) -> str:
    """One picture, as of a screen that has just been started."""
    while len(app.screen_stack) > 1:
        app.pop_screen()
    box = app.query_one("#filter", Input)
    box.value = ""
    box.remove_class("open")
    app.theme = wanted.theme
    if app.size != wanted.size:
        await pilot.resize_terminal(*wanted.size)
    app.scene = ViewState(
        notation=Notation(ascii=wanted.ascii), baseline=wanted.baseline, baseline_name="saved"
    )
    app._asked = None
    feed.take(wanted.feed)
    app.look()
    for part in app.query(Painted):
        part.refresh()
    await pilot.pause()
    await pilot.press(*wanted.keys)
    await pilot.pause()
    return app.export_screenshot(title="imumon")


def drawn(wanted: Iterable[Picture]) -> dict[str, str]:
    """SVG of each picture by its name."""

    async def go() -> dict[str, str]:
        feed = Handed()
        app = ImumonApp(feed, clock=lambda: feed.clock())
        async with app.run_test(size=SMALL) as pilot:
            order = sorted(wanted, key=lambda p: (p.size, p.theme))
            return {p.name: await _draw(app, pilot, feed, p) for p in order}

    with patch("imumon.tui.app.here", lambda: "/home/you"):
        return asyncio.run(go())


if __name__ == "__main__":
    words = sys.argv[1:] or [""]
    FOLDER.mkdir(exist_ok=True)
    if words == [""]:
        for old in FOLDER.glob("*.svg"):
            if old.stem not in PICTURES:
                old.unlink()
    for name, svg in drawn(p for p in PICTURES.values() if any(w in p.name for w in words)).items():
        (FOLDER / f"{name}.svg").write_text(svg, encoding="utf-8")
