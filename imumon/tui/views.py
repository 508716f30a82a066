"""The six views of the screen and the two dialog windows above them.

A view arranges panels and owns its keys; pure functions draw the panels. The help of a view is made from its
own bindings, so it cannot be out of date.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container, Horizontal, Vertical
from textual.events import Click
from textual.message import Message
from textual.screen import ModalScreen
from textual.widgets import Input

from imumon.model.glossary import Explanation
from imumon.model.messages import uncertainty
from imumon.tui import channel_table, charts, over_time, panels, text_panels
from imumon.tui.formatting import Line, padded, wrap
from imumon.tui.view_state import VIEWS, ViewState
from imumon.tui.widgets import DrawnPanel, ScrolledPanel


class View(Container, can_focus=True):
    """One view: passes the state to its panels."""

    title = ""
    names_caveats: ClassVar[bool] = False

    class Changed(Message):
        """The user changed fields of the state in a view."""

        def __init__(self, **changes: object) -> None:
            super().__init__()
            self.changes = changes

    def __init__(self) -> None:
        super().__init__(id=self.title.replace(" ", "-"))
        self.shown = ViewState()

    def show(self, state: ViewState) -> None:
        """Draw a state."""
        self.shown = state
        for panel in self.query(DrawnPanel):
            panel.show(state)
        for scrolled in self.query(ScrolledPanel):
            scrolled.show(state)


class ChannelView(View):
    """A view of one channel, which the arrows select."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("down,j", "app.channel(1)", "next channel"),
        Binding("up,k", "app.channel(-1)", "previous channel"),
    ]


UNFOLDED_ROWS = 46
"""Rows of a terminal from which the table has every sensor above a chart, which still has 20 rows."""


class Overview(ChannelView):
    """All numbers and the Allan deviation of one channel."""

    title = "overview"
    names_caveats = True
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("right,l", "app.sensor(1)", "next quantity: gyro, accel, mag"),
        Binding("left,h", "app.sensor(-1)", "previous quantity"),
        Binding("z,enter", "app.switch('zoomed')", "only the chart, or all"),
        Binding("escape", "app.all_panels", ""),
        Binding("o", "app.switch('overlay')", "all three axes in one chart"),
        Binding("g", "app.switch('show_limits')", "limits of the grades"),
        Binding("b", "app.baseline", "keep this curve for comparison"),
        Binding("c", "app.copy", "copy N and K for other programs"),
    ]

    def compose(self) -> ComposeResult:
        with Vertical(id="numbers"):
            yield DrawnPanel(panels.headlines, id="headlines")
            yield DrawnPanel(channel_table.table, id="table")
            yield DrawnPanel(panels.detail, id="detail")
        yield DrawnPanel(charts.allan_chart, id="allan")

    def show(self, state: ViewState) -> None:
        """Draw a state; the table gets the height it needs, as far as the chart permits."""
        size = self.app.size
        spaced = size.height >= 38
        beside = size.width >= 132  # the chart has its own column
        state = state.updated(
            compact=not beside and size.height < 34, folded=not beside and size.height < UNFOLDED_ROWS
        )
        rows = len(channel_table.rows_of(state, spaced=spaced))
        self.query_one("#table", DrawnPanel).styles.height = max(rows, 1)
        self.set_class(state.zoomed, "zoomed")
        super().show(state.updated(detailed=size.width >= 132 and not state.zoomed))

    def on_click(self, event: Click) -> None:
        """Select the channel of a row of the table."""
        table = self.query_one("#table", DrawnPanel)
        if event.widget is table:
            offset = event.get_content_offset(table)
            rows = channel_table.table_rows(self.shown, *table.size)
            if offset is not None and offset.y < len(rows) and rows[offset.y][1] is not None:
                self.post_message(self.Changed(channel=rows[offset.y][1]))


class SignalView(ChannelView):
    """The selected channel over time, its distribution and its drift."""

    title = "signal"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("w,right", "app.window(1)", "next window of time"),
        Binding("left", "app.window(-1)", "previous window of time"),
    ]

    def compose(self) -> ComposeResult:
        yield DrawnPanel(charts.signal_chart, id="signal-chart")
        with Horizontal(id="shapes"):
            yield DrawnPanel(charts.histogram_chart, id="histogram")
            yield DrawnPanel(charts.spectrum_chart, id="spectrum")
        yield DrawnPanel(text_panels.drift, id="drift")


class OverTimeView(ChannelView):
    """The selected channel while the record grew, or over a day, a month or a year."""

    title = "over time"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("right,l", "app.sensor(1)", "next quantity: gyro, accel, mag"),
        Binding("left,h", "app.sensor(-1)", "previous quantity"),
        Binding("plus,equals_sign,w", "app.span(1)", "longer: record, day, month, year"),
        Binding("minus", "app.span(-1)", "shorter"),
    ]

    def compose(self) -> ComposeResult:
        yield DrawnPanel(over_time.over_time_chart, id="over-time-chart")


class ScrolledView(View):
    """A view that scrolls."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("pagedown", "scroll(10)", "a page down"),
        Binding("pageup", "scroll(-10)", "a page up"),
        Binding("home", "scroll(-100000)", "to the top"),
        Binding("end", "scroll(100000)", "to the end"),
    ]

    def action_scroll(self, step: int) -> None:
        self.query_one(ScrolledPanel).scroll_by(step)


_LINE_KEYS: list[BindingType] = [
    Binding("down,j", "scroll(1)", "down"),
    Binding("up,k", "scroll(-1)", "up"),
]


class DeviceView(ScrolledView):
    """Identity and settings of the sensor, and the quality of its transmission."""

    title = "device"
    names_caveats = True
    BINDINGS: ClassVar[list[BindingType]] = _LINE_KEYS

    def compose(self) -> ComposeResult:
        yield ScrolledPanel(text_panels.device, id="device-sheet")


class EventsView(ScrolledView):
    """Events, newest first."""

    title = "events"
    BINDINGS: ClassVar[list[BindingType]] = [
        *_LINE_KEYS,
        Binding("slash", "filter", "show only events with these words", key_display="/"),
        Binding("escape", "clear", "remove the filter"),
    ]

    def compose(self) -> ComposeResult:
        yield ScrolledPanel(text_panels.events, id="events-sheet")
        yield Input(placeholder="only events with these words: gap gyro/x …", id="filter")

    def action_filter(self) -> None:
        box = self.query_one("#filter", Input)
        box.add_class("open")
        box.focus()

    def action_clear(self) -> None:
        box = self.query_one("#filter", Input)
        box.value = ""
        box.remove_class("open")
        self.post_message(self.Changed(filter_text=""))
        self.focus()

    def on_input_changed(self, event: Input.Changed) -> None:
        self.post_message(self.Changed(filter_text=event.value))

    def on_input_submitted(self, event: Input.Submitted) -> None:
        self.query_one("#filter", Input).remove_class("open")
        self.focus()


class SensorsView(ScrolledView):
    """All sensors with their status and grades."""

    title = "sensors"
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("down,j", "app.device(1)", "next sensor"),
        Binding("up,k", "app.device(-1)", "previous sensor"),
        Binding("enter", "app.view('overview')", "open its overview"),
    ]

    def compose(self) -> ComposeResult:
        yield ScrolledPanel(text_panels.sensors, id="sensors-sheet")


SYMBOL_WORDS = "✓: ready. ↗: not yet. ↓: bound."
"""Meaning of the symbols in the table."""
WINDOW_WIDTH = 55
"""Cells of text in a dialog window: it fits a terminal of 60 cells."""


class DialogWindow(ModalScreen[None]):
    """A small window above the view."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape,q,enter,question_mark,f1", "dismiss(None)", "close"),
        *(Binding(str(k), f"app.view('{name}')", "") for k, name in enumerate(VIEWS, 1)),
    ]

    def __init__(self, title: str, lines: list[Line]) -> None:
        super().__init__()
        self._heading = title
        self._text = lines

    def compose(self) -> ComposeResult:
        panel = ScrolledPanel(
            lambda state, width, height: [padded(line, width) for line in self._text], id="window"
        )
        panel.border_title = self._heading
        short = self.app.size.height < 34  # as in the style sheet, without padding
        panel.styles.height = len(self._text) + (2 if short else 4)
        yield panel

    def on_mount(self) -> None:
        self.query_one(ScrolledPanel).show(ViewState())

    def on_click(self, event: Click) -> None:
        if event.widget is self:
            self.dismiss(None)


class HelpWindow(DialogWindow):
    """The keys of a view, and below them its words.

    Parameters
    ----------
    keys, words : lines; `words` begins with its title.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("question_mark,f1", "words", "words of this view"),
        Binding("down,j", "scroll(1)", ""),
        Binding("up,k", "scroll(-1)", ""),
        Binding("pagedown,space", "scroll(10)", ""),
        Binding("pageup", "scroll(-10)", ""),
    ]

    def __init__(self, title: str, keys: list[Line], words: list[Line]) -> None:
        super().__init__(title, [*keys, [], *words] if words else keys)
        self._words_row = len(keys) + 1 if words else 0

    def on_mount(self) -> None:
        super().on_mount()
        if self._words_row:
            self.query_one(ScrolledPanel).border_subtitle = "? words of this view · ↑ ↓ · esc"

    def action_scroll(self, step: int) -> None:
        self.query_one(ScrolledPanel).scroll_by(step)

    def action_words(self) -> None:
        """Show the words; close the window where they are shown."""
        panel = self.query_one(ScrolledPanel)
        place = min(self._words_row, int(panel.max_scroll_y))
        if panel.scroll_offset.y >= place:
            self.dismiss(None)
        else:
            panel.scroll_to(y=place, animate=False)


def keys_of(bindings: list[BindingType]) -> list[tuple[str, str]]:
    """Return keys and what they do."""
    arrows = {"down": "↓", "up": "↑", "left": "←", "right": "→"}
    names = {"slash": "/", "question_mark": "?", "pagedown": "page down", "pageup": "page up", **arrows}
    names |= {"plus": "+", "minus": "-", "equals_sign": "="}
    shown: list[tuple[str, str]] = []
    for binding in bindings:
        if isinstance(binding, Binding) and binding.description:
            keys = [k.strip() for k in binding.key.split(",")]
            text = " ".join(names.get(k, k.replace("ctrl+", "^")) for k in keys)
            shown.append((text, binding.description))
    return shown


def help_lines(view: View, everywhere: list[BindingType]) -> list[Line]:
    """Return the help of a view: what it is, its keys, and the keys that work everywhere."""
    bindings = [
        b for c in reversed(type(view).__mro__) if issubclass(c, View) for b in c.__dict__.get("BINDINGS", [])
    ]
    summary = (type(view).__doc__ or "").strip().partition("\n")[0]
    lines: list[Line] = [*([(text, "text")] for text in wrap(summary, WINDOW_WIDTH)), []]
    if isinstance(view, Overview):
        signs = f"{uncertainty(indistinct=True)} {SYMBOL_WORDS}"
        lines[-1:-1] = [[(text, "muted")] for text in wrap(signs, WINDOW_WIDTH)]
    lines += [[(f"{keys:<14}", "key"), (text, "text")] for keys, text in _paired(keys_of(bindings))]
    lines += [[("everywhere", "title")]]
    shown = keys_of([b for b in everywhere if not (isinstance(b, Binding) and b.key.isdigit())])
    shown = _paired([(f"1 to {len(VIEWS)}", "views"), *shown])
    half = (len(shown) + 1) // 2
    for k in range(half):
        line: Line = [(f"{shown[k][0]:<14}", "key"), (f"{shown[k][1]:<20}", "text")]
        if k + half < len(shown):
            line += [(f"{shown[k + half][0]:<7}", "key"), (shown[k + half][1], "text")]
        lines.append(line)
    return lines


def word_lines(entries: Sequence[Explanation]) -> list[Line]:
    """Return the words of a view with their meanings, as the window shows them; empty without words."""
    lines: list[Line] = [[("words of this view", "title")]] if entries else []
    for entry in entries:
        name = entry.word.replace("_", " ")
        first, *rest = wrap(entry.sentence, WINDOW_WIDTH)
        lines += [[(name, "key"), (first[len(name) :], "text")], *([(text, "text")] for text in rest)]
    return lines


def _paired(keys: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return the keys with "next" and "previous" of the same thing in one entry."""
    out: list[tuple[str, str]] = []
    for key, text in keys:
        word, _, what = text.partition(" ")
        if word == "previous" and out and out[-1][1].startswith(f"next {what}"):
            out[-1] = (f"{out[-1][0]} {key}", f"next, previous {out[-1][1].removeprefix('next ')}")
        else:
            out.append((key, text))
    return out
