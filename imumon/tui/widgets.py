"""Paint: lines of pieces onto the terminal, each role in the colour that the theme gives it.

The only place where roles become styles. Colours live in `app.tcss` as component classes made of theme
variables, so every theme works. Text never passes through markup: a unit such as ``[s]`` stays.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import zip_longest
from typing import ClassVar

from rich.color import Color
from rich.segment import Segment
from rich.style import Style
from textual.geometry import Region, Size
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widget import Widget

from imumon.tui.formatting import Line, plain
from imumon.tui.view_state import ViewState

Draw = Callable[[ViewState, int, int], list[Line]]

ROLES = (
    *("text", "strong", "title", "muted", "faint", "accent", "key", "tab", "chip", "bound", "paper"),
    *("band", "bandkey", "bar", "signal", "grid", "axis", "limit", "model", "point", "leftout", "baseline"),
    *("good", "warn", "bad", "good-strong", "warn-strong", "bad-strong", "muted-strong"),
    *("N", "B", "K", "N-strong", "B-strong", "K-strong", "axis-x", "axis-y", "axis-z"),
    *("grade-navigation", "grade-tactical", "grade-industrial", "grade-consumer"),
    *("grade-navigation-strong", "grade-tactical-strong", "grade-industrial-strong", "grade-consumer-strong"),
)
GROUNDS = ("band", "bar", "chosen", "status", "alarm", "foot")


class Inks(Widget):
    """Widget that is never seen: it holds the style of each role for all the others.

    The component classes live here once, and not in every widget that draws, so that the style sheet
    is matched against them once a theme.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = {f"ink-{r}" for r in ROLES} | {f"ground-{g}" for g in GROUNDS}

    def __init__(self) -> None:
        super().__init__(id="inks")
        self._styles: dict[tuple[str, Color | None], Style] = {}

    def notify_style_update(self) -> None:
        self._styles.clear()
        super().notify_style_update()

    def style(self, role: str, page: Color | None) -> Style:
        """Style of a role, or of a role upon a ground (``text/band``), on a page of some colour."""
        found = self._styles.get((role, page))
        if found is None:
            name, _, ground = role.partition("/")
            if name not in ROLES:  # a grade that a later daemon knows
                name = "text"
            ink = self.get_component_rich_style(f"ink-{name}")
            under = self.get_component_rich_style(f"ground-{ground}").bgcolor if ground else page
            found = Style(color=ink.color, bgcolor=under, bold=ink.bold, reverse=ink.reverse)
            self._styles[role, page] = found
        return found


class Painted(Widget):
    """What all widgets that draw lines have in common."""

    _inks: Inks | None = None
    _page: Color | None = None
    _scene = ViewState()

    def notify_style_update(self) -> None:
        self._inks = None
        super().notify_style_update()

    def strip(self, line: Line, width: int) -> Strip:
        """One line of the terminal, exactly `width` cells."""
        inks = self._inks
        if inks is None:
            inks = self._inks = self.app.screen_stack[0].query_one("#inks", Inks)
            self._page = self.rich_style.bgcolor
        page, ascii = self._page, self._scene.notation.ascii
        segments = [
            Segment(plain(text) if ascii else text, inks.style(role, page)) for text, role in line if text
        ]
        return Strip(segments).adjust_cell_length(width, inks.style("text", page))


class Paper(Painted):
    """A part of the screen that a pure function draws.

    Parameters
    ----------
    draw : from a scene, a width and a height in cells to lines.
    """

    def __init__(self, draw: Draw, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._draw = draw
        self._lines: list[Line] = []
        self._drawn: tuple[ViewState, Size] | None = None

    def show(self, scene: ViewState) -> None:
        """Draw this from now on; only the lines that differ are painted again."""
        if scene is self._scene:
            return
        self._scene = scene
        if self._drawn is None or self._drawn[1] != self.content_size or not self.content_size.area:
            self.refresh()
            return
        before, after = self._lines, self.lines()
        pairs = enumerate(zip_longest(before, after))
        changed = [Region(0, y, self.content_size.width, 1) for y, (old, new) in pairs if old != new]
        if changed:
            self.refresh(*changed)

    def lines(self) -> list[Line]:
        """What stands on the paper at its present size."""
        drawn = self._drawn
        if drawn is None or drawn[0] is not self._scene or drawn[1] != self.content_size:
            self._lines = self._draw(self._scene, *self.content_size)
            self._drawn = (self._scene, self.content_size)
        return self._lines

    def render_line(self, y: int) -> Strip:
        lines = self.lines()
        return self.strip(lines[y] if y < len(lines) else [], self.content_size.width)


class StyledLines(ScrollView, Painted, can_focus=False):
    """Lines of which only a part may be seen at once."""

    def __init__(self, draw: Draw, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._draw = draw
        self._lines: list[Line] = []

    def show(self, scene: ViewState) -> None:
        self._scene = scene
        self._draw_lines()

    def on_resize(self) -> None:
        self._draw_lines()

    def _draw_lines(self) -> None:
        width = max(self.scrollable_content_region.width, 1)
        before, self._lines = self._lines, self._draw(self._scene, width, self.size.height)
        self.virtual_size = Size(width, len(self._lines))
        if self._lines != before:
            self.refresh()

    def lines(self) -> list[Line]:
        return self._lines

    def render_line(self, y: int) -> Strip:
        row = y + self.scroll_offset.y
        return self.strip(self._lines[row] if row < len(self._lines) else [], self.size.width)
