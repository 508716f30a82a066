"""Views: the five pages of the screen and the two small windows above them.

A view arranges papers and owns the keys that make sense on it; what the papers show is drawn by pure
functions. The help of a view is made from its own bindings, so it cannot be out of date.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, cast

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Horizontal, Vertical
from textual.events import Click
from textual.screen import ModalScreen
from textual.widgets import Input

from imumon.messages import uncertainty
from imumon.tui import channel_table, charts, panels, text_panels
from imumon.tui.formatting import Line, Notation, padded, wrap
from imumon.tui.view_state import WINDOWS, ViewState
from imumon.tui.widgets import Paper, StyledLines

if TYPE_CHECKING:
    from imumon.tui.app import ImumonApp


class View(Container, can_focus=True):
    """One page: gets a scene and hands it to its papers."""

    title = ""

    @property
    def monitor(self) -> ImumonApp:
        return cast("ImumonApp", self.app)

    def show(self, scene: ViewState) -> None:
        for paper in self.query(Paper):
            paper.show(scene)
        for sheet in self.query(StyledLines):
            sheet.show(scene)


_CHANNEL_KEYS: list[BindingType] = [
    Binding("down,j", "channel(1)", "next channel"),
    Binding("up,k", "channel(-1)", "previous channel"),
]


class ChannelView(View):
    """A page about one channel, which the arrows choose."""

    BINDINGS: ClassVar[list[BindingType]] = _CHANNEL_KEYS

    def action_channel(self, step: int) -> None:
        self.monitor.step_channel(step)


class Overview(ChannelView):
    """All numbers and the Allan deviation of one channel."""

    title = "overview"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("right,l", "sensor(1)", "next group: gyro, accel, mag"),
        Binding("left,h", "sensor(-1)", "previous group"),
        Binding("z,enter", "zoom", "the chart alone, and back"),
        Binding("o", "overlay", "all three axes in one chart"),
        Binding("g", "limits", "curves that just meet each grade"),
        Binding("b", "baseline", "keep this curve behind the live one"),
    ]

    def compose(self) -> ComposeResult:
        with Vertical(id="numbers"):
            yield Paper(panels.plates, id="plates")
            yield Paper(channel_table.table, id="table")
            yield Paper(panels.detail, id="detail")
        yield Paper(charts.allan, id="allan")

    def show(self, scene: ViewState) -> None:
        """The table takes what it needs, where the chart beside or below it leaves room."""
        size = self.app.size
        airy = size.height >= 38
        rows = len(channel_table.rows_of(scene, airy=airy))
        if size.width < 132 and size.height < 34:
            rows = min(rows, 12)
        self.query_one("#table", Paper).styles.height = max(rows, 1)
        self.set_class(scene.zoomed, "zoomed")
        super().show(scene)

    def action_sensor(self, step: int) -> None:
        self.monitor.step_sensor(step)

    def action_zoom(self) -> None:
        self.monitor.toggle("zoomed")

    def action_overlay(self) -> None:
        self.monitor.toggle("overlay")

    def action_limits(self) -> None:
        self.monitor.toggle("limits")

    def action_baseline(self) -> None:
        self.monitor.toggle_baseline()

    def on_click(self, event: Click) -> None:
        """A row of the table chooses its channel."""
        paper = self.query_one("#table", Paper)
        if event.widget is paper:
            at = event.get_content_offset(paper)
            rows = channel_table.table_rows(self.monitor.scene, *paper.size)
            if at is not None and at.y < len(rows) and rows[at.y][1] is not None:
                self.monitor.choose(channel=rows[at.y][1])


class SignalView(ChannelView):
    """The chosen channel over time; its shape and its drift."""

    title = "signal"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("w,right", "window(1)", "longer window: minute, hour, everything"),
        Binding("left", "window(-1)", "shorter window"),
    ]

    def compose(self) -> ComposeResult:
        yield Paper(charts.strip, id="strip")
        with Horizontal(id="shapes"):
            yield Paper(charts.histogram, id="histogram")
            yield Paper(charts.spectrum, id="spectrum")
        yield Paper(text_panels.drift, id="drift")

    def action_window(self, step: int) -> None:
        at = (WINDOWS.index(self.monitor.scene.window) + step) % len(WINDOWS)
        self.monitor.change(window=WINDOWS[at])


class ScrolledView(View):
    """A page with a long sheet."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("pagedown", "scroll(10)", "a page down"),
        Binding("pageup", "scroll(-10)", "a page up"),
        Binding("home", "scroll(-100000)", "to the top"),
        Binding("end", "scroll(100000)", "to the end"),
    ]

    def action_scroll(self, step: int) -> None:
        sheet = self.query_one(StyledLines)
        sheet.scroll_to(y=sheet.scroll_offset.y + step, animate=False)


_LINE_KEYS: list[BindingType] = [
    Binding("down,j", "scroll(1)", "down"),
    Binding("up,k", "scroll(-1)", "up"),
]


class DeviceView(ScrolledView):
    """Who the sensor is, what its numbers describe, how the line does."""

    title = "device"
    BINDINGS: ClassVar[list[BindingType]] = _LINE_KEYS

    def compose(self) -> ComposeResult:
        yield StyledLines(text_panels.device, id="device-sheet")


class EventsView(ScrolledView):
    """What happened, newest first."""

    title = "events"
    BINDINGS: ClassVar[list[BindingType]] = [
        *_LINE_KEYS,
        Binding("slash", "filter", "filter by words", key_display="/"),
        Binding("escape", "clear", "drop the filter"),
    ]

    def compose(self) -> ComposeResult:
        yield StyledLines(text_panels.events, id="events-sheet")
        yield Input(placeholder="words that must occur: gap gyro/x …", id="filter")

    def action_filter(self) -> None:
        box = self.query_one("#filter", Input)
        box.add_class("open")
        box.focus()

    def action_clear(self) -> None:
        box = self.query_one("#filter", Input)
        box.value = ""
        box.remove_class("open")
        self.monitor.change(needle="")
        self.focus()

    def on_input_changed(self, event: Input.Changed) -> None:
        self.monitor.change(needle=event.value)

    def on_input_submitted(self, event: Input.Submitted) -> None:
        self.query_one("#filter", Input).remove_class("open")
        self.focus()


class SensorsView(ScrolledView):
    """Every sensor that is heard, and two of them compared."""

    title = "sensors"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("down,j", "device(1)", "next sensor"),
        Binding("up,k", "device(-1)", "previous sensor"),
        Binding("enter", "open", "its numbers"),
        Binding("c", "compare", "compare with the next one, and no more"),
    ]

    def compose(self) -> ComposeResult:
        yield StyledLines(text_panels.sensors, id="sensors-sheet")
        yield Paper(charts.allan, id="sensors-allan")

    def action_device(self, step: int) -> None:
        self.monitor.step_device(step)

    def action_open(self) -> None:
        self.monitor.action_view("overview")

    def action_compare(self) -> None:
        self.monitor.step_other()


WINDOW = 58
"""Cells for text in a window."""


class Window(ModalScreen[str | None]):
    """A small window above the page, closed by any key that means nothing else."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,enter,question_mark,f1", "dismiss(None)", "close")
    ]

    def __init__(self, title: str, lines: list[Line], notation: Notation) -> None:
        super().__init__()
        self._heading = title
        self._text = lines
        self._notation = notation

    def compose(self) -> ComposeResult:
        sheet = StyledLines(
            lambda scene, width, height: [padded(line, width) for line in self._text], id="window"
        )
        sheet.border_title = self._heading
        sheet.styles.height = len(self._text) + 4
        yield sheet

    def on_mount(self) -> None:
        self.query_one(StyledLines).show(ViewState(notation=self._notation))

    def on_click(self, event: Click) -> None:
        if event.widget is self:
            self.dismiss(None)


class Saving(Window):
    """Asks in which form to save what is seen."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("v", "dismiss('svg')", "picture, SVG"),
        Binding("p", "dismiss('png')", "picture, PNG"),
        Binding("c", "dismiss('csv')", "numbers, CSV"),
        Binding("j", "dismiss('json')", "whole report, JSON"),
    ]


def keys_of(bindings: list[BindingType], ascii: bool) -> list[tuple[str, str]]:
    """Keys and what they do, as people write them."""
    arrows = {"down": "↓", "up": "↑", "left": "←", "right": "→"} if not ascii else {}
    names = {"slash": "/", "question_mark": "?", "pagedown": "page down", "pageup": "page up", **arrows}
    shown: list[tuple[str, str]] = []
    for binding in bindings:
        if isinstance(binding, Binding) and binding.description:
            keys = [k.strip() for k in binding.key.split(",")]
            text = " ".join(names.get(k, k.replace("ctrl+", "^")) for k in keys)
            shown.append((text, binding.description))
    return shown


def help_lines(view: View, everywhere: list[BindingType], ascii: bool) -> list[Line]:
    """Help of the view that is seen: what it is, its keys, and the keys that work everywhere."""
    own = [
        b for c in reversed(type(view).__mro__) if issubclass(c, View) for b in c.__dict__.get("BINDINGS", [])
    ]
    about = (type(view).__doc__ or "").strip().partition("\n")[0]
    lines: list[Line] = [*([(text, "text")] for text in wrap(about, WINDOW)), []]
    if isinstance(view, Overview):
        notation = Notation(ascii=ascii)
        lines.insert(-1, [(uncertainty(notation.about, notation.times), "muted")])
    lines += [[(f"{keys:<12}", "key"), (text, "text")] for keys, text in keys_of(own, ascii)]
    lines += [[], [("everywhere", "title")]]
    shown = keys_of([b for b in everywhere if not (isinstance(b, Binding) and b.key.isdigit())], ascii)
    shown.insert(0, ("1 to 5", "views"))
    half = (len(shown) + 1) // 2
    for k in range(half):
        line: Line = [(f"{shown[k][0]:<12}", "key"), (f"{shown[k][1]:<22}", "text")]
        if k + half < len(shown):
            line += [(f"{shown[k + half][0]:<9}", "key"), (shown[k + half][1], "text")]
        lines.append(line)
    return lines
