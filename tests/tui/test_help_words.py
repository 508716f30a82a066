"""The key `?`: the keys of a view, and below them what the words on it mean."""

from __future__ import annotations

import reports
from screen_driver import driven
from textual.pilot import Pilot

from imumon.tui.app import ImumonApp
from imumon.tui.widgets import ScrolledPanel


def _words(app: ImumonApp) -> str:
    lines = app.screen.query_one("#window", ScrolledPanel).lines()
    text = "\n".join("".join(part for part, _ in line) for line in lines)
    return " ".join(text.partition("words of this view")[2].split())


EXPECTED = {
    "1": ("K is random walk of the rate.", "open: ", "consumer: ", "aliased: "),
    "2": ("kurtosis: ", "drift: "),
    "3": ("alias factor: The factor by which N is too high", "overrun: "),
    "6": ("open: ", "ready, ✓: "),
}
"""Beginnings of explanations by the key of a view of 80 x 24 cells."""


@driven(lambda: reports.FakeSource(reports.report(caveats=("aliased",))), size=(80, 24))
async def test_it_explains_the_words_of_each_view(app: ImumonApp, pilot: Pilot[int]) -> None:
    for key in "123456":
        await pilot.press(key)
        await pilot.pause()
        await pilot.press("question_mark")
        await pilot.pause()
        words = _words(app)
        assert "gap: Samples that the clock of the sensor shows" in words  # of the status line
        for beginning in EXPECTED.get(key, ()):
            assert beginning in words, (key, beginning)
        if key != "1":  # a view that names no caveat explains none
            assert ("aliased: " in words) is (key == "3")
        window = app.screen.query_one("#window", ScrolledPanel)
        if window.max_scroll_y > 0:  # the words are below what is visible: the key shows them, then closes
            await pilot.press("question_mark")
            await pilot.pause()
            assert window.scroll_offset.y > 0
        await pilot.press("question_mark")
        await pilot.pause()
        assert len(app.screen_stack) == 1
