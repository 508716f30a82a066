"""App: the live screen.

It owns the scene: twice a second it asks the feed whether anything is new, and only then makes a new
scene and hands it to the view that is seen. Threads of the bus never call in here.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import ClassVar

from textual.app import App, ComposeResult, SystemCommand
from textual.binding import Binding, BindingType
from textual.containers import Container
from textual.events import Click
from textual.screen import Screen
from textual.theme import Theme

from imumon.report import Report
from imumon.samples import sensor_of
from imumon.tui import export, terminal
from imumon.tui.formatting import Line, Notation, length, on, padded
from imumon.tui.panels import status, welcome
from imumon.tui.report_source import ReportSource
from imumon.tui.svg_export import redrawn
from imumon.tui.view_state import VIEWS, ViewState
from imumon.tui.views import (
    DeviceView,
    EventsView,
    Overview,
    Saving,
    SensorsView,
    SignalView,
    View,
    Window,
    help_lines,
)
from imumon.tui.widgets import Inks, Paper

PERIOD = 0.5
"""Seconds between two looks at the feed: the screen is drawn at most so often."""
EAGER = 0.1
"""Seconds between two looks while there is nothing to show yet: looking costs nothing."""
POLL = 5.0
"""Seconds between two looks whether the terminal is still there."""

_TEXT = ("text-primary", "text-secondary", "text-accent", "text-success", "text-warning", "text-error")


def _theme(name: str, dark: bool, colours: str, texts: str) -> Theme:
    """Theme of this screen: grounds and colours, and the same colours as they are written in."""
    primary, secondary, success, warning, error, foreground, background, surface, panel = colours.split()
    return Theme(
        name=name,
        dark=dark,
        primary=primary,
        secondary=secondary,
        accent=primary,
        success=success,
        warning=warning,
        error=error,
        foreground=foreground,
        background=background,
        surface=surface,
        panel=panel,
        variables=dict(zip(_TEXT, texts.split(), strict=True)),
    )


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


def here() -> Path:
    """Folder into which is saved."""
    return Path.cwd()


class ImumonApp(App[int]):
    """The screen of one or several sensors.

    Parameters
    ----------
    feed : where reports come from.
    id : device to show first; None: the first that is heard.
    baseline : report whose curves are drawn behind the live ones.
    clock : s, monotonic, the same as that of the feed's arrivals.
    """

    CSS_PATH = "app.tcss"
    TITLE = "imumon"
    ENABLE_COMMAND_PALETTE = True
    HORIZONTAL_BREAKPOINTS = [(0, "-narrow"), (132, "-wide")]  # noqa: RUF012
    VERTICAL_BREAKPOINTS = [(0, "-short"), (34, "-tall")]  # noqa: RUF012
    BINDINGS: ClassVar[list[BindingType]] = [
        *(Binding(str(k), f"view('{name}')", name) for k, name in enumerate(VIEWS, 1)),
        Binding("tab", "turn(1)", "next view", priority=True),
        Binding("shift+tab", "turn(-1)", "previous view", priority=True),
        Binding("n", "device(1)", "next sensor"),
        Binding("u", "units", "readable units or SI"),
        Binding("f", "freeze", "freeze, go on"),
        Binding("s", "save", "save this view"),
        Binding("t", "dark", "light or dark"),
        Binding("ctrl+p", "command_palette", "command palette"),
        Binding("question_mark,f1", "help", "this help"),
        Binding("q,ctrl+c", "quit", "quit"),
        Binding("ctrl+c", "quit", "", priority=True, show=False),
    ]

    def __init__(
        self,
        feed: ReportSource,
        *,
        id: str | None = None,
        ascii: bool = False,
        theme: str | None = None,
        baseline: Report | None = None,
        endpoint: str | None = None,
        starting: str | None = None,
        ended: Callable[[], str | None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        for own in THEMES:
            self.register_theme(own)
        self.theme = theme if theme in self.available_themes else THEMES[0].name
        self.feed = feed
        self.clock = clock
        self.scene = ViewState(
            wanted=id,
            notation=Notation(ascii=ascii),
            baseline=baseline,
            baseline_name="saved",
            endpoint=endpoint,
            starting=starting,
        )
        self._ended = ended
        self._built = False
        self._asked: tuple[str, str | None] | None = None
        self._seen: tuple[int, tuple[object, ...]] | None = None

    # ------------------------------------------------------------------ life

    def compose(self) -> ComposeResult:
        yield Inks()
        yield Paper(status, id="status")
        with Container(id="body"):
            yield Paper(welcome, id="welcome")
            for view in (Overview, SignalView, DeviceView, EventsView, SensorsView):
                yield view(id=view.title)
        yield Paper(foot, id="foot")

    def on_mount(self) -> None:
        self._built = True
        self.set_interval(PERIOD, self.look)
        self._eager = self.set_interval(EAGER, self.look)
        self.look()
        if not self.is_headless:
            terminal.on_signals(lambda code: self.exit(code, return_code=code))
            terminal.watch(POLL)

    def on_resize(self) -> None:
        self._spread()

    # ------------------------------------------------------------------ the feed

    def look(self) -> None:
        """See what is new in the feed; draw only when something is."""
        if self.scene.frozen:
            return
        arrived = self.feed.reports()
        now = self.clock()
        alive, connected = frozenset(self.feed.alive()), self.feed.connected()
        ages = {name: max(now - moment, 0.0) for name, (_, moment) in arrived.items()}
        old = {name: round(age) for name, age in ages.items() if age > 3.0 * arrived[name][0].period_s}
        ended = self._ended() if self._ended is not None else None
        seen = (self.feed.version, (alive, connected, tuple(sorted(old.items())), ended))
        if seen == self._seen:
            return
        self._seen = seen
        scene = self.scene.after(
            reports={name: arrived[name][0] for name in sorted(arrived)},
            ages=ages,
            alive=alive,
            connected=connected,
            ended=ended,
        )
        self._show(_settled(scene))
        if self.scene.channels:
            self._eager.stop()

    def _show(self, scene: ViewState) -> None:
        """Take what belongs to the chosen device and channel from the feed, then draw."""
        if scene.id is not None and not scene.frozen:
            asked = (scene.id, scene.channel)
            if asked != self._asked:
                self._asked = asked
                self.feed.watch(*asked)
            signal = self.feed.signal()
            fits = signal is not None and signal[0].channel == scene.channel
            scene = scene.after(
                events=tuple(self.feed.events(scene.id)), signal=signal[0] if signal and fits else None
            )
        self.scene = scene
        self._spread()

    def _spread(self) -> None:
        """Hand the scene to the parts that are seen."""
        if not self._built:
            return
        base = self.screen_stack[0]
        base.query_one("#status", Paper).show(self.scene)
        base.query_one("#foot", Paper).show(self.scene)
        there = bool(self.scene.channels)
        body = base.query_one("#body")
        body.set_class(there and not self.scene.situation().live, "stale")
        body.set_class(not there, "empty")
        for view in base.query(View):
            shown = there and view.id == self.scene.view
            if view.display != shown:
                view.display = shown
                if shown and base is self.screen:
                    view.focus()
        if there:
            base.query_one(f"#{self.scene.view}", View).show(self.scene)
        else:
            base.query_one("#welcome", Paper).show(self.scene)

    # ------------------------------------------------------------------ choices

    def change(self, **changes: object) -> None:
        """Change what is chosen and draw it."""
        self._show(self.scene.after(**changes))

    def choose(self, *, id: str | None = None, channel: str | None = None) -> None:
        """Choose another device or channel."""
        scene = self.scene.after(id=id or self.scene.id, channel=channel or self.scene.channel)
        if id is not None and scene.other == id:
            scene = scene.after(other=None)
        self._show(_settled(scene))

    def step_channel(self, step: int) -> None:
        names = self.scene.channels
        if names and self.scene.channel in names:
            self.choose(channel=names[(names.index(self.scene.channel) + step) % len(names)])

    def step_sensor(self, step: int) -> None:
        names = [c for c in self.scene.channels if "/" in c]
        groups = list(dict.fromkeys(map(sensor_of, names)))
        if not groups or self.scene.channel is None:
            return
        here = sensor_of(self.scene.channel)
        at = groups.index(here) + step if here in groups else 0
        wanted = f"{groups[at % len(groups)]}/{self.scene.channel[-1]}"
        self.choose(
            channel=wanted
            if wanted in names
            else next(c for c in names if c.startswith(groups[at % len(groups)]))
        )

    def step_device(self, step: int) -> None:
        names = list(self.scene.reports)
        if self.scene.id in names:
            self.choose(id=names[(names.index(self.scene.id) + step) % len(names)])

    def step_other(self) -> None:
        """Compare with the next device after the one compared with, then with none."""
        names: list[str | None] = [None, *(n for n in self.scene.reports if n != self.scene.id)]
        at = names.index(self.scene.other) if self.scene.other in names else 0
        other = names[(at + 1) % len(names)]
        baseline = self.scene.reports.get(other) if other is not None else None
        self.change(other=other, baseline=baseline, baseline_name="compared" if other else "saved")

    def toggle(self, name: str) -> None:
        self.change(**{name: not getattr(self.scene, name)})

    def toggle_baseline(self) -> None:
        """Keep the present report as the baseline, or drop the one there is."""
        kept = self.scene.report if self.scene.baseline is None else None
        name = f"at {kept.time[11:16]}" if kept is not None else "saved"
        self.change(baseline=kept, baseline_name=name, other=None)

    # ------------------------------------------------------------------ keys

    def action_view(self, name: str) -> None:
        self.change(view=name)

    def action_turn(self, step: int) -> None:
        if len(self.screen_stack) == 1:
            self.action_view(VIEWS[(VIEWS.index(self.scene.view) + step) % len(VIEWS)])

    def action_device(self, step: int) -> None:
        self.step_device(step)

    def action_units(self) -> None:
        notation = self.scene.notation
        self.change(notation=Notation(si=not notation.si, ascii=notation.ascii))

    def action_freeze(self) -> None:
        if self.scene.frozen:
            self.scene, self._seen = self.scene.after(frozen=False), None
            self.look()
        else:
            self.change(frozen=True)

    def action_dark(self) -> None:
        self.theme = THEMES[1 if self.current_theme.dark else 0].name

    async def action_quit(self) -> None:
        self.exit(0)

    def action_help(self) -> None:
        view = self.screen_stack[0].query_one(f"#{self.scene.view}", View)
        lines = help_lines(view, list(self.BINDINGS), self.scene.notation.ascii)
        self.push_screen(Window(f"{view.title}: keys", lines, self.scene.notation))

    def action_save(self) -> None:
        self.clear_notifications()  # what the last save said is no part of the next picture
        where = here()
        lines: list[Line] = [
            [("v", "key"), ("   picture, SVG", "text")],
            [("p", "key"), ("   picture, PNG", "text")],
            [("c", "key"), ("   numbers of this view, CSV", "text")],
            [("j", "key"), ("   the whole report, JSON (a baseline for later)", "text")],
            [],
            [(f"into {where}"[:56], "muted")],
        ]
        self.push_screen(
            Saving("save what is seen", lines, self.scene.notation), partial(self.save_view, where)
        )

    def save_view(self, where: Path, form: str | None) -> None:
        """Write what is seen into a folder and say where; what fails is said in one line."""
        if form is None:
            return
        try:
            target = where / export.name_of(self.scene, "svg" if form == "png" else form)
            if form in ("svg", "png"):
                target.write_text(self.export_screenshot(), encoding="utf-8")
                made = export.png(target) if form == "png" else target
                said = (
                    f"saved {made}"
                    if made
                    else f"saved {target} (no converter to PNG: apt install librsvg2-bin)"
                )
            else:
                target.write_text(export.text(self.scene, form), encoding="utf-8")
                said = f"saved {target}"
            self.notify(said, markup=False)
        except (OSError, ValueError) as error:
            self.notify(f"not saved: {error}", severity="error", markup=False)

    def export_screenshot(self, *, title: str | None = None, simplify: bool = True) -> str:
        """Picture of the screen as SVG."""
        return redrawn(super().export_screenshot(title=title or "imumon", simplify=simplify))

    def get_system_commands(self, screen: Screen[object]) -> Iterable[SystemCommand]:
        for k, name in enumerate(VIEWS, 1):
            yield SystemCommand(f"View: {name}", f"key {k}", partial(self.action_view, name))
        yield SystemCommand("Units", "readable or SI", self.action_units)
        yield SystemCommand("Freeze", "hold the view, and go on", self.action_freeze)
        yield SystemCommand("Save", "what is seen, as SVG, PNG, CSV or JSON", self.action_save)
        yield SystemCommand("Help", "keys of this view", self.action_help)
        yield SystemCommand("Theme", "choose another theme", self.action_change_theme)
        yield SystemCommand("Quit", "leave the screen; the daemon goes on", self.action_quit)

    def on_click(self, event: Click) -> None:
        """The names of the views at the foot can be clicked."""
        if event.widget is not None and event.widget.id == "foot":
            at = 0
            for name, (text, _) in zip(VIEWS, _tabs(self.scene, self.size.width), strict=True):
                if at <= event.x < at + len(text):
                    self.action_view(name)
                at += len(text)


def _settled(scene: ViewState) -> ViewState:
    """Scene whose device and channel exist."""
    reports = scene.reports
    if scene.id not in reports:
        found = scene.wanted if scene.wanted is not None else next(iter(reports), None)
        scene = scene.after(id=found if found in reports else None)
    if scene.channel not in scene.channels:
        scene = scene.after(channel=next(iter(scene.channels), None))
    if scene.other is not None:
        scene = scene.after(baseline=reports.get(scene.other))
    return scene


ROOMY, TIGHT = 100, 66
"""Cells from which on the views at the foot, and the keys, stand apart by two blanks; and from which on
all views have their names."""


def _tabs(scene: ViewState, width: int) -> Line:
    """The views by name, the one that is seen on a ground of its own."""
    roles = ["tab" if name == scene.view else "muted" for name in VIEWS]
    named = width >= TIGHT
    names = [f"{k} {name}" if named or name == scene.view else str(k) for k, name in enumerate(VIEWS, 1)]
    if width >= ROOMY:
        return [(f" {name} ", role) for name, role in zip(names, roles, strict=True)]
    before = ["muted", *roles]
    return [
        (f"{'' if left == 'tab' else ' '}{name}{' ' if role == 'tab' else ''}", role)
        for name, role, left in zip(names, roles, before, strict=False)
    ]


def foot(scene: ViewState, width: int, height: int = 1) -> list[Line]:
    """Views and the keys one needs to find all others."""
    line = _tabs(scene, width)
    keys = (("?", "help"), ("q", "quit"), ("s", "save"), ("u", "units"), ("f", "freeze"), ("^p", "palette"))
    right: Line = []
    for key, name in keys:
        item: Line = [(f"  {key} " if width >= ROOMY else f" {key} ", "key"), (name, "muted")]
        if length(line) + length(right) + length(item) < width:
            right += item
    return [on([*padded(line, max(width - length(right) - 1, 0)), *right, (" ", "text")], "foot")]
