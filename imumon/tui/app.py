"""Textual application of the terminal UI.

It owns the state. Four times a second it polls the source, and only if something is new it makes a new state and
passes it to the visible view. Threads of the bus never call it.
"""

from __future__ import annotations

import io
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar

from textual import work
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container
from textual.events import Click

from imumon.files import replace_file
from imumon.model.errors import why
from imumon.model.glossary import words_in
from imumon.model.messages import caveats
from imumon.model.report import Report
from imumon.model.report_json import to_json
from imumon.model.samples import ChannelName
from imumon.model.system_errors import cure_of_writing
from imumon.tui import export, terminal
from imumon.tui.formatting import Line, Notation, wrap
from imumon.tui.over_time import parse
from imumon.tui.panels import footer, status, tabs, welcome
from imumon.tui.view_state import RECORD, SPANS, VIEWS, WINDOWS, HistorySeries, ViewState
from imumon.tui.views import (
    WINDOW_WIDTH,
    DeviceView,
    DialogWindow,
    EventsView,
    HelpWindow,
    OverTimeView,
    Overview,
    SensorsView,
    SignalView,
    View,
    help_lines,
    word_lines,
)
from imumon.tui.widgets import THEMES, DrawnPanel, RoleStyles, ScrolledPanel

if TYPE_CHECKING:
    from imumon.bus.subscriber import HistoryAnswer, Subscriber

T = TypeVar("T")

POLL_S = 0.25
"""s between two polls of the source: the screen is drawn at most this often."""
FORGET_S = 60.0
"""s after which a daemon that has finished is no longer listed, unless it is selected."""
TERMINAL_POLL_S = 5.0
"""s between two checks whether the terminal, or the server of the browser, is still there."""


def save_directory() -> Path:
    """Return the directory of saved files."""
    return Path.cwd()


def _neighbour(names: Sequence[T], name: T, step: int) -> T:
    """Return the name that is `step` places behind another, in a ring; the same if it is not there."""
    return names[(names.index(name) + step) % len(names)] if name in names else name


class ImumonApp(App[int]):
    """The screen of one or several sensors.

    Parameters
    ----------
    source : where reports come from.
    id : device to show; None: the first that answers.
    ascii : draw with ASCII characters only.
    theme : name of a theme, such as ``imumon-light``.
    baseline : report whose curves are drawn behind the live ones.
    endpoint : endpoints that were tried, for the page that is shown while no daemon answers.
    program : that the numbers are for.
    starting : text of that page if a daemon is known to start.
    ended : polled now and then: last message of that daemon when it has ended, else None.
    clock : s, monotonic, the clock of the arrivals of `source`.
    """

    CSS_PATH = "app.tcss"
    TITLE = "imumon"
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (132, "-wide")]  # noqa: RUF012
    VERTICAL_BREAKPOINTS = [(0, "-short"), (34, "-tall")]  # noqa: RUF012
    BINDINGS: ClassVar[list[BindingType]] = [
        *(Binding(str(k), f"view('{name}')", name) for k, name in enumerate(VIEWS, 1)),
        Binding("tab", "turn(1)", "next view", priority=True),
        Binding("shift+tab", "turn(-1)", "previous view", priority=True),
        Binding("n", "device(1)", "next sensor"),
        Binding("u", "units", "usual or SI units"),
        Binding("f", "freeze", "freeze, or resume"),
        Binding("s", "save", "save report"),
        Binding("t", "dark", "light or dark"),
        Binding("ctrl+p", "command_palette", "palette"),
        Binding("question_mark,f1", "help", "this help"),
        Binding("q,ctrl+c", "quit", "quit"),
        # without it, ctrl+c shows a note about ctrl+q: Textual binds it itself
        Binding("ctrl+c", "quit", "", priority=True, show=False),
    ]

    def __init__(
        self,
        source: Subscriber,
        *,
        id: str | None = None,
        ascii: bool = False,
        theme: str | None = None,
        baseline: Report | None = None,
        endpoint: str | None = None,
        starting: str | None = None,
        program: str = "kalibr",
        ended: Callable[[], str | None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        for imumon_theme in THEMES:
            self.register_theme(imumon_theme)
        self.theme = theme if theme in self.available_themes else THEMES[0].name
        self.source = source
        self.clock = clock
        self.view_state = ViewState(
            requested_id=id,
            baseline=baseline,
            baseline_name="saved",
            endpoint=endpoint,
            starting=starting,
            program=program,
        )
        self._ended = ended
        self._ascii = ascii
        self._watched: tuple[str, str | None] | None = None
        # version of the source and everything else that a poll has shown: while both are the same, nothing is drawn
        self._seen: tuple[int, tuple[object, ...]] | None = None
        self._parsed: tuple[HistoryAnswer | None, HistorySeries | None] = (None, None)

    # ------------------------------------------------------------------ start

    def compose(self) -> ComposeResult:
        yield RoleStyles(self._ascii)
        yield DrawnPanel(status, id="status")
        with Container(id="body"):
            yield DrawnPanel(welcome, id="welcome")
            for view in (
                Overview,
                SignalView,
                DeviceView,
                EventsView,
                SensorsView,
                OverTimeView,
            ):
                yield view()
        yield DrawnPanel(footer, id="footer")

    def on_mount(self) -> None:
        self.set_interval(POLL_S, self.poll)
        self.poll()
        if self.is_web:
            parent = os.getppid()
            terminal.exit_when(lambda: os.getppid() != parent, TERMINAL_POLL_S)
        elif not self.is_headless:
            terminal.on_signals(lambda code: self.exit(code, return_code=code))
            terminal.exit_when(terminal.closed, TERMINAL_POLL_S)

    def on_resize(self) -> None:
        self._redraw()

    # ------------------------------------------------------------------ source

    def poll(self) -> None:
        """Read the source; draw only if something is new."""
        if self.view_state.frozen:
            return
        now = self.clock()
        alive, connected = frozenset(self.source.alive()), self.source.connected()
        selected = self.view_state.id
        # before a device is selected, the last report of one that has finished is better than an empty screen
        reports = {
            name: (report, moment)
            for name, (report, moment) in self.source.reports().items()
            if report.state != "stopped" or now - moment < FORGET_S or selected in (None, name)
        }
        ages = {name: max(now - moment, 0.0) for name, (_, moment) in reports.items()}
        # in whole seconds, and only where the age is shown: a report on time must not redraw the screen
        shown_ages = {name: round(age) for name, age in ages.items() if age > reports[name][0].late_s}
        ended = self._ended() if self._ended is not None else None
        seen = (self.source.version, (alive, connected, tuple(sorted(shown_ages.items())), ended))
        if seen == self._seen:
            return
        self._seen = seen
        state = self.view_state.updated(
            reports={name: reports[name][0] for name in sorted(reports)},
            ages=ages,
            alive=alive,
            connected=connected,
            ended=ended,
        )
        self._show(state.with_existing_selection())

    def _show(self, state: ViewState) -> None:
        """Add signal and events of the selected device and channel, then draw."""
        if state.id is not None and not state.frozen:
            watched = (state.id, state.channel)
            if watched != self._watched:
                self._watched = watched
                self.source.watch(*watched)
            signal = self.source.signal()
            matches = signal is not None and signal[0].channel == state.channel
            state = state.updated(
                events=tuple(self.source.events(state.id)), signal=signal[0] if signal and matches else None
            )
        self.view_state = self._with_history(state)
        self._redraw()

    def _with_history(self, state: ViewState) -> ViewState:
        """Return the state with the history of its channel, which is asked for while it is shown."""
        shown = state.view == "over time" and state.span != RECORD
        asked = (
            (state.id, state.channel, *SPANS[state.span]) if shown and state.id and state.channel else None
        )
        self.source.watch_history(asked)
        answer = self.source.history_answer()
        if answer is None or answer[0] != asked:
            return state.updated(history=None)
        if answer is not self._parsed[0]:
            self._parsed = (answer, parse(answer[0][1], *answer[1:]))
        return state.updated(history=self._parsed[1])

    def _redraw(self) -> None:
        """Pass the state to the visible widgets."""
        # below a dialog window, which is the active screen; before and after the run there are no widgets
        base = self.screen_stack[0] if self.screen_stack else None
        if base is None or not base.query("#status"):
            return
        base.query_one("#status", DrawnPanel).show(self.view_state)
        base.query_one("#footer", DrawnPanel).show(self.view_state)
        has_channels = bool(self.view_state.channels)
        body = base.query_one("#body")
        body.set_class(has_channels and not self.view_state.connection_status().live, "stale")
        body.set_class(not has_channels, "empty")
        for view in base.query(View):
            shown = has_channels and view.title == self.view_state.view
            if view.display != shown:
                view.display = shown
                if shown and base is self.screen:
                    view.focus()
        if has_channels:
            self._view().show(self.view_state)
        else:
            base.query_one("#welcome", DrawnPanel).show(self.view_state)

    def _view(self) -> View:
        """Return the view that is selected."""
        return next(view for view in self.screen_stack[0].query(View) if view.title == self.view_state.view)

    # ------------------------------------------------------------------ selection

    def change(self, **changes: object) -> None:
        """Change the state and draw it."""
        self._show(self.view_state.updated(**changes))

    def on_view_changed(self, event: View.Changed) -> None:
        """Change the state as the visible view asks for it."""
        self.change(**event.changes)

    def select(self, *, id: str | None = None, channel: ChannelName | None = None) -> None:
        """Select another device or channel."""
        state = self.view_state.updated(
            id=id or self.view_state.id, channel=channel or self.view_state.channel
        )
        self._show(state.with_existing_selection())

    def action_channel(self, step: int) -> None:
        self.select(channel=_neighbour(self.view_state.channels, self.view_state.channel, step))

    def action_sensor(self, step: int) -> None:
        """Select the same axis of another sensor of the device."""
        self.select(channel=self.view_state.of_other_sensor(step))

    def action_device(self, step: int) -> None:
        self.select(id=_neighbour(list(self.view_state.reports), self.view_state.id, step))

    def action_switch(self, name: str) -> None:
        """Toggle a field of the state."""
        self.change(**{name: not getattr(self.view_state, name)})

    def action_all_panels(self) -> None:
        """Leave the chart that fills the screen."""
        if self.view_state.zoomed:
            self.change(zoomed=False)

    def action_baseline(self) -> None:
        """Use the present report as the baseline, or remove the baseline."""
        state = self.view_state
        baseline = state.report if state.baseline is None and state.has_report else None
        name = f"at {baseline.time[11:16]}" if baseline is not None else "saved"
        self.change(baseline=baseline, baseline_name=name)

    def action_span(self, step: int) -> None:
        spans = [RECORD, *SPANS]
        self.change(span=spans[min(max(spans.index(self.view_state.span) + step, 0), len(spans) - 1)])

    def action_window(self, step: int) -> None:
        self.change(window=_neighbour(WINDOWS, self.view_state.window, step))

    # ------------------------------------------------------------------ keys

    def action_view(self, name: str) -> None:
        """Show a view, also from a window above another one, which closes."""
        if len(self.screen_stack) > 1:
            self.pop_screen()
        self.change(view=name)

    def action_turn(self, step: int) -> None:
        if len(self.screen_stack) == 1:
            self.change(view=_neighbour(VIEWS, self.view_state.view, step))

    def action_units(self) -> None:
        self.change(notation=Notation(si=not self.view_state.notation.si))

    def action_freeze(self) -> None:
        if self.view_state.frozen:
            self.view_state, self._seen = self.view_state.updated(frozen=False), None
            self.poll()
        else:
            self.change(frozen=True)

    def action_dark(self) -> None:
        self.theme = THEMES[1 if self.current_theme.dark else 0].name

    async def action_quit(self) -> None:
        self.exit(0)

    def action_help(self) -> None:
        view = self._view()
        keys = help_lines(view, list(self.BINDINGS))
        shown = list(caveats(self.view_state.report)) if view.names_caveats else []
        words = word_lines(words_in(self._text_of(view), shown))
        self.push_screen(HelpWindow(f"{view.title}: keys and words", keys, words))

    def _text_of(self, view: View) -> str:
        """Return the text of the status line and of a view."""
        status_line = self.screen_stack[0].query_one("#status", DrawnPanel)
        panels = [status_line, *view.query(DrawnPanel), *view.query(ScrolledPanel)]
        lines = [line for panel in panels if panel.display for line in panel.lines()]
        return "\n".join("".join(text for text, _ in line) for line in lines)

    @work(thread=True, exclusive=True)
    def action_copy(self) -> None:
        """Compute the numbers for the program of the settings, which takes a second, then copy them."""
        if self.view_state.has_report:
            lines = export.copied_lines(self.view_state.report, self.view_state.program)
            self.call_from_thread(self._copied, lines)

    def _copied(self, lines: list[str]) -> None:
        """Copy lines through the terminal (OSC 52), and show them: not all terminals copy."""
        self.copy_to_clipboard("\n".join([*lines, ""]))
        shown: list[Line] = [[(text, "text")] for line in lines for text in wrap(line, WINDOW_WIDTH)]
        notice = "Copied, if the terminal allows it (OSC 52)."
        shown += [[], *([(text, "muted")] for text in wrap(notice, WINDOW_WIDTH))]
        self.push_screen(DialogWindow("copied", shown))

    def action_save(self) -> None:
        """Save the report as JSON, a baseline for later, and notify of the file or of the error."""
        report = self.view_state.report
        if not self.view_state.has_report:
            return
        target, content = save_directory() / export.file_name(report), f"{to_json(report, indent=1)}\n"
        if self.is_web:  # nothing is written here: the browser saves it
            self.deliver_text(io.StringIO(content), save_filename=target.name, open_method="download")
            return
        try:
            replace_file(target, content.encode())
            self.notify(f"saved {target}", markup=False)
        except OSError as error:
            cure = cure_of_writing(error, "start the screen in another directory")
            self.notify(f"not saved: {why(error)}: {cure}", severity="error", markup=False)

    def on_click(self, event: Click) -> None:
        """Select a view by a click on its name in the footer."""
        if event.widget is not None and event.widget.id == "footer":
            left = 0
            for name, (text, _) in zip(VIEWS, tabs(self.view_state, self.size.width), strict=True):
                if left <= event.x < left + len(text):
                    self.action_view(name)
                left += len(text)
