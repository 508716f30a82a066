"""Pictures of the screen: every view and every state, small and large, dark and light.

A picture that changes is looked at, and kept with `--snapshot-update`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import reports

from imumon.tui.app import Monitor

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

VIEWS = [
    pytest.param(feed, (key,), size, theme, id=f"{name}-{size[0]}-{theme}")
    for key, (name, feed) in enumerate(
        (
            ("overview", "running"),
            ("signal", "running"),
            ("device", "running"),
            ("events", "running"),
            ("sensors", "two"),
        ),
        1,
    )
    for size in (SMALL, LARGE)
    for theme in ("dark", "light")
]
STATES = [
    pytest.param(state, (), size, theme, id=f"{state}-{size[0]}-{theme}")
    for state in FEEDS
    if state not in ("running", "two")
    for size, theme in ((SMALL, "dark"), (LARGE, "light"))
    if size == SMALL or state in ("nobody", "early", "warming", "lost")
]
EXTRAS = [
    pytest.param("running", keys, size, "dark", id=name)
    for name, keys, size in (
        ("overlay-of-axes", ("o",), LARGE),
        ("grade-limits", ("down", "g"), LARGE),
        ("accel-y-left-out-octaves", ("right", "down"), LARGE),
        ("bounds-of-mag", ("right", "right"), LARGE),
        ("temperature", ("up", "up"), LARGE),
        ("chart-alone", ("z",), SMALL),
        ("si-units", ("u",), SMALL),
        ("frozen", ("f",), SMALL),
        ("hour", ("2", "w"), SMALL),
        ("help-overview", ("question_mark",), SMALL),
        ("help-events", ("4", "question_mark"), LARGE),
        ("saving", ("s",), SMALL),
        ("filter", ("4", "slash", "g", "a", "p", "enter"), SMALL),
        ("filter-open", ("4", "slash", "g"), SMALL),
        ("huge", (), HUGE),
    )
]


@pytest.mark.parametrize(("feed", "keys", "size", "theme"), [*VIEWS, *STATES, *EXTRAS])
def test_the_screen_looks_as_it_did(
    feed: str,
    keys: tuple[object, ...],
    size: tuple[int, int],
    theme: str,
    snap_compare: Any,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("imumon.tui.app.here", lambda: "/home/you")
    source = FEEDS[feed]()
    app = Monitor(source, theme=f"imumon-{theme}", clock=source.clock)
    assert snap_compare(app, press=[str(key) for key in keys], terminal_size=size)


def test_a_saved_report_lies_behind_the_live_one(snap_compare: Any) -> None:
    source = FEEDS["running"]()
    app = Monitor(source, clock=source.clock, baseline=reports.report(3600.0, scale=1.7))
    assert snap_compare(app, terminal_size=LARGE)


def test_two_sensors_are_compared(snap_compare: Any) -> None:
    source = FEEDS["two"]()
    app = Monitor(source, clock=source.clock)
    assert snap_compare(app, press=["5", "c"], terminal_size=LARGE)


@pytest.mark.parametrize("size", [SMALL, LARGE])
def test_ascii(size: tuple[int, int], snap_compare: Any) -> None:
    source = FEEDS["running"]()
    assert snap_compare(Monitor(source, clock=source.clock, ascii=True), terminal_size=size)


def test_without_colour(snap_compare: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    source = FEEDS["stale"]()
    assert snap_compare(Monitor(source, clock=source.clock), terminal_size=SMALL)


@pytest.mark.parametrize("theme", ["ansi-dark", "gruvbox", "solarized-light"])
def test_other_themes(theme: str, snap_compare: Any) -> None:
    source = FEEDS["running"]()
    assert snap_compare(Monitor(source, clock=source.clock, theme=theme), terminal_size=SMALL)
