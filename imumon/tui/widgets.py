"""Widgets that draw lines of styled text in the colours of the theme.

The only place where roles become styles. The colours are in `app.tcss` as component classes made of theme
variables, so every theme works. Text is never parsed as markup: a unit such as ``[s]`` is shown as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import zip_longest
from typing import Any, ClassVar

from rich.color import Color
from rich.segment import Segment
from rich.style import Style
from textual.geometry import Region, Size
from textual.scroll_view import ScrollView
from textual.strip import Strip
from textual.theme import Theme
from textual.widget import Widget

from imumon.model.coefficients import COEFFICIENTS, GRADES
from imumon.model.report_json import plain
from imumon.tui.formatting import Line, to_ascii
from imumon.tui.view_state import ViewState

_COLOURS = [
    "primary",
    "secondary",
    "success",
    "warning",
    "error",
    "foreground",
    "background",
    "surface",
    "panel",
]
_TEXTS = ["text-primary", "text-secondary", "text-accent", "text-success", "text-warning", "text-error"]


def _theme(name: str, dark: bool, colours: str, texts: str) -> Theme:
    """Return a theme: backgrounds and colours, and the same colours for text."""
    named: dict[str, Any] = dict(zip(_COLOURS, colours.split(), strict=True))
    variables = dict(zip(_TEXTS, texts.split(), strict=True))
    return Theme(name=name, dark=dark, accent=named["primary"], variables=variables, **named)


THEMES = (
    _theme(
        "imumon-dark",
        True,
        "#6ea8fe #b9a3e3 #7fd1ae #f0b866 #f2777a #d5dae3 #11151c #161b24 #1d2430",
        "#82b4ff #c0a6f0 #7cc4f5 #86d6b4 #f0b866 #f58a8c",
    ),
    _theme(
        "imumon-light",
        False,
        "#1f5fbf #7448b5 #14795a #9a5b00 #b3261e #20262e #fbfbf9 #f3f3ef #e6e7e3",
        "#1f5fbf #7448b5 #0f6e9c #14795a #9a5b00 #b3261e",
    ),
)

DrawFunction = Callable[[ViewState, int, int], list[Line]]
"""From a state, a width and a height in cells to lines."""

ROLES = (
    *("text", "strong", "title", "muted", "faint", "accent", "key", "tab", "chip", "bound", "page"),
    *("band", "bar", "signal", "grid", "axis", "limit", "model", "point", "unused", "baseline"),
    *("good", "warn", "bad", "good-strong", "warn-strong", "bad-strong", "muted-strong"),
    *("axis-x", "axis-y", "axis-z"),
    *(f"{letter}{strong}" for letter in COEFFICIENTS for strong in ("", "-strong")),
    *(f"grade-{grade}{strong}" for grade in GRADES for strong in ("", "-strong")),
)
BACKGROUNDS = ("band", "bar", "selected", "status", "alarm", "footer")


class RoleStyles(Widget):
    """Hidden widget that holds the style of each role for all others, and whether they draw ASCII alone.

    The component classes are on this widget alone, so that a theme change matches the style sheet once.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = {f"role-{r}" for r in ROLES} | {
        f"background-{b}" for b in BACKGROUNDS
    }

    def __init__(self, ascii: bool) -> None:
        super().__init__(id="role-styles")
        self.ascii = ascii
        self._styles: dict[tuple[str, Color | None], Style] = {}

    def notify_style_update(self) -> None:
        self._styles.clear()
        super().notify_style_update()

    def style(self, role: str, page: Color | None) -> Style:
        """Return the style of a role, or of a role on a background (``text/band``), on a page of a colour."""
        style = self._styles.get((role, page))
        if style is None:
            name, _, background = role.partition("/")
            if name not in ROLES:  # a grade of a newer daemon
                name = "text"
            foreground = self.get_component_rich_style(f"role-{name}")
            if background:
                bgcolor = self.get_component_rich_style(f"background-{background}").bgcolor
            else:
                bgcolor = page
            style = Style(
                color=foreground.color, bgcolor=bgcolor, bold=foreground.bold, reverse=foreground.reverse
            )
            self._styles[role, page] = style
        return style


class StyledWidget(Widget):
    """Base of the widgets that draw lines."""

    _role_styles: RoleStyles | None = None
    _page: Color | None = None
    _view_state = ViewState()

    def notify_style_update(self) -> None:
        self._role_styles = None
        super().notify_style_update()

    def strip(self, line: Line, width: int) -> Strip:
        """Return one line of the terminal, exactly `width` cells."""
        styles = self._role_styles
        if styles is None:
            styles = self._role_styles = self.app.screen_stack[0].query_one("#role-styles", RoleStyles)
            self._page = self.rich_style.bgcolor
        page = self._page
        # `plain`: names and texts come from the network, and may contain control characters of a terminal
        segments = [
            Segment(to_ascii(plain(text)) if styles.ascii else plain(text), styles.style(role, page))
            for text, role in line
            if text
        ]
        # the rest of the line has a style, too: with NO_COLOR, Textual fails at a segment without one
        return Strip(segments).adjust_cell_length(width, styles.style("text", page))


class DrawnPanel(StyledWidget):
    """Part of the screen that a pure function draws."""

    def __init__(self, draw: DrawFunction, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._draw = draw
        self._lines: list[Line] = []
        self._drawn: tuple[ViewState, Size] | None = None

    def show(self, state: ViewState) -> None:
        """Draw this state; only lines that differ are sent to the terminal."""
        if state is self._view_state:  # states are frozen: the same object is the same picture
            return
        self._view_state = state
        if self._drawn is None or self._drawn[1] != self.content_size or not self.content_size.area:
            self.refresh()
            return
        # over a slow line, a screen of which all is sent four times a second would lag behind
        before, after = self._lines, self.lines()
        pairs = enumerate(zip_longest(before, after))
        changed = [Region(0, y, self.content_size.width, 1) for y, (old, new) in pairs if old != new]
        if changed:
            self.refresh(*changed)

    def lines(self) -> list[Line]:
        """Return the lines at the present size."""
        drawn = self._drawn
        if drawn is None or drawn[0] is not self._view_state or drawn[1] != self.content_size:
            self._lines = self._draw(self._view_state, *self.content_size)
            self._drawn = (self._view_state, self.content_size)
        return self._lines

    def render_line(self, y: int) -> Strip:
        lines = self.lines()
        return self.strip(lines[y] if y < len(lines) else [], self.content_size.width)


class ScrolledPanel(ScrollView, StyledWidget, can_focus=False):
    """Lines that scroll if they do not fit."""

    def __init__(self, draw: DrawFunction, *, id: str | None = None) -> None:
        super().__init__(id=id)
        self._draw = draw
        self._lines: list[Line] = []

    def show(self, state: ViewState) -> None:
        self._view_state = state
        self._draw_lines()

    def on_resize(self) -> None:
        self._draw_lines()

    def _draw_lines(self) -> None:
        width = max(self.scrollable_content_region.width, 1)
        before, self._lines = self._lines, self._draw(self._view_state, width, self.size.height)
        self.virtual_size = Size(width, len(self._lines))
        if self._lines != before:
            self.refresh()

    def lines(self) -> list[Line]:
        return self._lines

    def scroll_by(self, rows: int) -> None:
        """Scroll by some rows, as far as there are any."""
        self.scroll_to(y=self.scroll_offset.y + rows, animate=False)

    def render_line(self, y: int) -> Strip:
        row = y + self.scroll_offset.y
        return self.strip(self._lines[row] if row < len(self._lines) else [], self.size.width)
