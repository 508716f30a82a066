"""Scene: everything the screen shows at one moment, frozen.

The app makes a new scene when something has changed; every part of the screen is a pure function from
a scene and a size to lines. So a view can be tested without a terminal, and freezing the view is
keeping a scene.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from imumon.report import Channel, Event, Report, Signal
from imumon.samples import sensor_of
from imumon.tui.formatting import Notation, about

READABLE = Notation()
VIEWS = ("overview", "signal", "device", "events", "sensors")
WINDOWS = ("minute", "hour", "everything")
MOVING = frozenset({"not_at_rest", "motion", "moving"})
WARMING = frozenset({"warming_up", "warm_up", "warmup"})


@dataclass(frozen=True, slots=True)
class Situation:
    """How things stand with a device, in words.

    Attributes
    ----------
    kind : ``nobody``, ``silent``, ``starting``, ``warming``, ``running``, ``moving``, ``waiting``,
        ``stale``, ``lost``, ``finished``.
    mark, word, text : symbol, one or two words, and a sentence for where it needs one.
    role : colour of it.
    live : whether the numbers are of this moment; what is not live is drawn dimmed.
    """

    kind: str
    mark: str
    word: str
    text: str
    role: str
    live: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewState:
    """What is to be drawn.

    Attributes
    ----------
    reports, ages : by device id; ages in s since the arrival.
    other : id of the device that is compared with the chosen one.
    starting : what is said of a daemon that is known to start, while it does not answer.
    ended : the last word of that daemon, when it has ended.
    """

    reports: Mapping[str, Report] = field(default_factory=dict)
    ages: Mapping[str, float] = field(default_factory=dict)
    alive: frozenset[str] = frozenset()
    connected: bool = False
    wanted: str | None = None
    id: str | None = None
    channel: str | None = None
    signal: Signal | None = None
    events: Sequence[Event] = ()
    notation: Notation = READABLE
    view: str = "overview"
    window: str = "minute"
    limits: bool = False
    overlay: bool = False
    zoomed: bool = False
    baseline: Report | None = None
    baseline_name: str = "baseline"
    other: str | None = None
    needle: str = ""
    frozen: bool = False
    endpoint: str | None = None
    starting: str | None = None
    ended: str | None = None

    @property
    def report(self) -> Report | None:
        return None if self.id is None else self.reports.get(self.id)

    @property
    def chosen(self) -> Channel | None:
        report = self.report
        return None if report is None or self.channel is None else report.channels.get(self.channel)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels of the chosen device, in the order they are shown."""
        return () if self.report is None else tuple(self.report.channels)

    def siblings(self) -> tuple[str, ...]:
        """Channels of the same sensor as the chosen one."""
        if self.channel is None:
            return ()
        sensor = sensor_of(self.channel)
        return tuple(c for c in self.channels if sensor_of(c) == sensor)

    def situation(self, id: str | None = None) -> Situation:
        """How things stand with a device, by default the chosen one."""
        id = self.id if id is None else id
        report = None if id is None else self.reports.get(id)
        if id is None or report is None:
            return _without(self)
        age = self.ages.get(id, 0.0)
        if report.state == "stopped":
            return Situation(
                "finished", "■", "finished", "the daemon has ended; this is its last report", "muted", True
            )
        patience = max(3.0, 3.0 * report.period_s)
        if age > patience:
            ago = f"no news for {about(age)}"
            if self.ended:
                return Situation("lost", "✕", "daemon gone", f"{ago}; it ended: {self.ended}", "bad", False)
            if id in self.alive:
                return Situation("stale", "○", "stale", f"{ago}; the daemon lives", "warn", False)
            if self.connected:
                return Situation("lost", "✕", "daemon gone", f"{ago}; waiting for it", "bad", False)
            return Situation("lost", "✕", "daemon lost", f"{ago}; reconnecting", "bad", False)
        return _present(report)

    def after(self, **changes: object) -> ViewState:
        return replace(self, **changes)  # type: ignore[arg-type]


def _without(scene: ViewState) -> Situation:
    """Situation while there is no report to show."""
    if scene.alive or scene.connected:
        text = "a daemon is there; waiting for its first report"
        return Situation("silent", "◌", "connected", text, "warn", False)
    return Situation("nobody", "◌", "no daemon", "nobody answers yet", "warn", False)


def _present(report: Report) -> Situation:
    """Situation by a report that has just come."""
    caveats = set(report.caveats).union(*(channel.caveats for channel in report.channels.values()))
    if report.state == "waiting":
        port = report.device.port or "its port"
        return Situation("waiting", "✕", "sensor gone", f"waiting for {port}", "bad", False)
    if report.state == "starting":
        return Situation("starting", "◌", "starting", "looking for the sensor and its stream", "warn", True)
    if caveats & MOVING:
        return Situation("moving", "◐", "not at rest", "it moves: what moves is cut out", "warn", True)
    if caveats & WARMING:
        return Situation("warming", "◐", "warming up", "cut out later, if it shows", "warn", True)
    return Situation("running", "●", "live", "", "good", True)
