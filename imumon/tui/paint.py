"""Paint: lines of pieces onto the terminal, each role in the colour that the theme gives it.

The only place where roles become styles. Colours live in `app.tcss` as component classes made of theme
variables, so every theme works. Text never passes through markup: a unit such as ``[s]`` stays.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from rich.segment import Segment
from rich.style import Style
from textual.geometry import Size
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.widget import Widget

from imumon.tui.scene import Scene
from imumon.tui.words import Line, plain

Draw = Callable[[Scene, int, int], list[Line]]

ROLES = (
    *("text", "strong", "title", "muted", "faint", "accent", "key", "tab", "chip", "bound", "paper"),
    *("band", "bandkey", "bar", "signal", "grid", "axis", "limit", "model", "point", "leftout", "baseline"),
    *("good", "warn", "bad", "good-strong", "warn-strong", "bad-strong", "muted-strong"),
    *("N", "B", "K", "N-strong", "B-strong", "K-strong", "axis-x", "axis-y", "axis-z"),
    *("grade-navigation", "grade-tactical", "grade-industrial", "grade-consumer"),
    *("grade-navigation-strong", "grade-tactical-strong", "grade-industrial-strong", "grade-consumer-strong"),
)
GROUNDS = ("band", "bar", "chosen", "status", "alarm", "foot")


class Palette:
    """Styles of one widget by role, looked up once a theme."""

    def __init__(self, widget: Widget) -> None:
        self._widget = widget
        self._styles: dict[str, Style] = {}

    def __getitem__(self, role: str) -> Style:
        found = self._styles.get(role)
        if found is None:
            name, _, ground = role.partition("/")
            found = self._widget.get_component_rich_style(f"ink-{name}")
            if ground:
                under = self._widget.get_component_rich_style(f"ground-{ground}")
                found = found + Style(bgcolor=under.bgcolor)
            self._styles[role] = found
        return found

    def forget(self) -> None:
        self._styles.clear()

    def strip(self, line: Line, width: int, ascii: bool) -> Strip:
        """One line of the terminal, exactly `width` cells."""
        segments = [Segment(plain(text) if ascii else text, self[role]) for text, role in line if text]
        return Strip(segments).adjust_cell_length(width, self["text"])


class Paper(Widget):
    """A part of the screen that a pure function draws.

    Parameters
    ----------
    draw : from a scene, a width and a height in cells to lines.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = {f"ink-{r}" for r in ROLES} | {f"ground-{g}" for g in GROUNDS}

    def __init__(self, draw: Draw, *, id: str | None = None, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes)
        self._draw = draw
        self._palette = Palette(self)
        self._scene = Scene()
        self._lines: list[Line] = []
        self._drawn: tuple[Scene, int, int] | None = None

    def show(self, scene: Scene) -> None:
        """Draw this from now on; drawing itself waits until it is seen."""
        if scene is not self._scene:
            self._scene = scene
            self.refresh()

    def notify_style_update(self) -> None:
        self._palette.forget()
        super().notify_style_update()

    def lines(self) -> list[Line]:
        """What stands on the paper at its present size."""
        width, height = self.content_size
        drawn = (self._scene, width, height)
        if self._drawn is None or self._drawn[0] is not self._scene or self._drawn[1:] != drawn[1:]:
            self._lines = self._draw(self._scene, width, height)
            self._drawn = drawn
        return self._lines

    def render_line(self, y: int) -> Strip:
        lines = self.lines()
        width = self.content_size.width
        return self._palette.strip(lines[y] if y < len(lines) else [], width, self._scene.notation.ascii)


class Sheet(ScrollView):
    """Lines of which only a part may be seen at once."""

    COMPONENT_CLASSES: ClassVar[set[str]] = Paper.COMPONENT_CLASSES
    can_focus = False

    def __init__(self, draw: Draw, *, id: str | None = None, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes)
        self._draw = draw
        self._palette = Palette(self)
        self._scene = Scene()
        self._lines: list[Line] = []

    def show(self, scene: Scene) -> None:
        self._scene = scene
        self._compose_lines()

    def on_resize(self) -> None:
        self._compose_lines()

    def _compose_lines(self) -> None:
        width = max(self.scrollable_content_region.width, 1)
        self._lines = self._draw(self._scene, width, self.size.height)
        self.virtual_size = Size(width, len(self._lines))
        self.refresh()

    def notify_style_update(self) -> None:
        self._palette.forget()
        super().notify_style_update()

    def lines(self) -> list[Line]:
        return self._lines

    def render_line(self, y: int) -> Strip:
        row = y + self.scroll_offset.y
        line = self._lines[row] if row < len(self._lines) else []
        return self._palette.strip(line, self.size.width, self._scene.notation.ascii)
