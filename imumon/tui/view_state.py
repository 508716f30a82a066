"""Everything that the screen shows at one moment, frozen.

The app makes a new state when something has changed. Every part of the screen is a pure function from a
state and a size to lines, so a view can be tested without a terminal, and freezing the screen means keeping a
state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from imumon.model.messages import matching
from imumon.model.report import Channel, DeviceDescription, Event, Report, SessionCounters, Signal
from imumon.model.samples import ChannelName, Floats
from imumon.tui.formatting import Notation, approximate_duration

READABLE = Notation()
VIEWS = ("overview", "signal", "device", "events", "sensors", "over time")
RECORD = "record"
"""Span of the view over time: the record itself. The others are of the history."""
SPANS = {"day": (86400.0, "1h"), "month": (31 * 86400.0, "1h"), "year": (366 * 86400.0, "1d")}
"""Spans of the history: s, and step of its rows."""
WINDOWS = ("minute", "hour", "everything")
SHOWN_CAVEATS = {"moving": "not_at_rest", "warming_up": "warming_up"}
"""Caveats that the status line shows, by the kind of the status."""


NOTHING = ChannelName("")
"""Name of the channel that is selected before there is any."""

NO_CHANNEL = Channel(unit="")
NO_REPORT = Report(time="", device=DeviceDescription(id=""), state="starting", session=SessionCounters())
"""What is drawn before there is a report: nothing is known in it."""


@dataclass(frozen=True, slots=True)
class ConnectionStatus:
    """Status of a device, of its daemon, and of the connection to it.

    Attributes
    ----------
    kind : ``no_daemon``, ``no_report``, ``starting``, ``warming_up``, ``live``, ``moving``, ``waiting``,
        ``stale``, ``lost``, ``finished``.
    mark, title, text : symbol, one or two words, and a sentence if one is needed.
    role : role of its colour.
    live : whether the numbers are current; others are drawn dimmed.
    """

    kind: str
    mark: str
    title: str
    text: str
    role: str
    live: bool


@dataclass(frozen=True, slots=True, eq=False)
class HistorySeries:
    """The history of one channel.

    Attributes
    ----------
    channel : its name.
    begin, end : s since 1970, of the first and last row.
    time : (n,) s since 1970, middle of each row, rising.
    sizes : (3, n) SI by quantity, value and 95 % limits, NaN where unknown; of a bound, the upper limit alone is known.
    period_s : s, longest row.
    events : time, s since 1970, and kind of the events.
    """

    channel: ChannelName
    begin: float
    end: float
    time: Floats
    sizes: dict[str, Floats]
    events: tuple[tuple[float, str], ...]
    period_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewState:
    """What is to be drawn.

    Attributes
    ----------
    reports, ages : by device id; ages in s since the arrival.
    alive : ids of devices with a running daemon.
    requested_id : device that the user asked for; None: any.
    id, channel : selected device and channel.
    detailed : the selected channel is shown in full beside the chart.
    compact : there is little room: the grades are in the table.
    folded : sensors without a grade are left out of the table, until one of their channels is selected.
    program : that the numbers are for.
    starting : message while a daemon is known to start and does not answer yet.
    ended : last message of that daemon after it has ended.
    """

    reports: Mapping[str, Report] = field(default_factory=dict)
    ages: Mapping[str, float] = field(default_factory=dict)
    alive: frozenset[str] = frozenset()
    connected: bool = False
    requested_id: str | None = None
    id: str | None = None
    channel: ChannelName = NOTHING
    signal: Signal | None = None
    events: Sequence[Event] = ()
    notation: Notation = READABLE
    view: str = "overview"
    window: str = "minute"
    history: HistorySeries | None = None
    span: str = RECORD
    show_limits: bool = False
    detailed: bool = True
    compact: bool = False
    folded: bool = False
    program: str = "kalibr"
    overlay: bool = False
    zoomed: bool = False
    baseline: Report | None = None
    baseline_name: str = "baseline"
    filter_text: str = ""
    frozen: bool = False
    endpoint: str | None = None
    starting: str | None = None
    ended: str | None = None

    @property
    def has_report(self) -> bool:
        """Whether there is a report of the selected device."""
        return self.id in self.reports

    @property
    def report(self) -> Report:
        """Report of the selected device; an empty one before there is any."""
        return self.reports.get(self.id or "", NO_REPORT)

    @property
    def selected(self) -> Channel:
        """The selected channel; an empty one before there is any."""
        return self.report.channels.get(self.channel, NO_CHANNEL)

    @property
    def channels(self) -> tuple[ChannelName, ...]:
        """Names of the channels of the selected device, in display order."""
        return tuple(self.report.channels)

    def sensor_channels(self) -> tuple[ChannelName, ...]:
        """Return the channels of the same sensor as the selected one."""
        return tuple(c for c in self.channels if c.sensor == self.channel.sensor)

    def of_other_sensor(self, step: int) -> ChannelName:
        """Return the same axis of another sensor of the device, `step` sensors behind; the same if there is none."""
        names = [name for name in self.channels if name.axis]
        sensors = list(dict.fromkeys(name.sensor for name in names))
        if not sensors:
            return self.channel
        current = self.channel.sensor
        index = sensors.index(current) + step if current in sensors else 0
        axes = [name for name in names if name.sensor == sensors[index % len(sensors)]]
        # a sensor may lack the axis: then its first one
        same = [name for name in axes if name[-1] == self.channel[-1]]
        return (same or axes)[0]

    def with_existing_selection(self) -> ViewState:
        """Return the state with a device and a channel that exist."""
        state = self
        if state.id not in state.reports:
            state = state.updated(id=next(iter(matching(state.requested_id, state.reports)), None))
        if state.channel not in state.channels:
            state = state.updated(channel=next(iter(state.channels), NOTHING))
        return state

    def connection_status(self, id: str | None = None) -> ConnectionStatus:
        """Return the status of a device, by default the selected one."""
        id = self.id if id is None else id
        report = None if id is None else self.reports.get(id)
        if id is None or report is None:
            return _without_report(self)
        # The age of the report decides, not whether the daemon is alive: one that hangs stays alive for Zenoh, and its
        # numbers must not look current.
        age = self.ages.get(id, 0.0)
        if report.state == "stopped":
            text = "the daemon has ended; this is its last report"
            return ConnectionStatus("finished", "■", "finished", text, "muted", True)
        if age > report.late_s:
            old = f"no report for {approximate_duration(age)}"
            if self.ended:
                text = f"{old}; it ended: {self.ended}"
                return ConnectionStatus("lost", "✕", "daemon gone", text, "bad", False)
            if id in self.alive:
                return ConnectionStatus("stale", "○", "stale", f"{old}; the daemon is alive", "warn", False)
            if self.connected:
                return ConnectionStatus("lost", "✕", "daemon gone", f"{old}; waiting for it", "bad", False)
            return ConnectionStatus("lost", "✕", "daemon lost", f"{old}; reconnecting", "bad", False)
        return _of_report(report)

    def updated(self, **changes: object) -> ViewState:
        """Return a copy with some fields changed."""
        return replace(self, **changes)  # type: ignore[arg-type]


def _without_report(state: ViewState) -> ConnectionStatus:
    """Return the status while there is no report."""
    if state.alive or state.connected:
        text = "a daemon is running; waiting for its first report"
        return ConnectionStatus("no_report", "◌", "connected", text, "warn", False)
    return ConnectionStatus("no_daemon", "◌", "no daemon", "no daemon answers yet", "warn", False)


def _of_report(report: Report) -> ConnectionStatus:
    """Return the status that a fresh report shows."""
    caveats = set(report.caveats).union(*(channel.caveats for channel in report.channels.values()))
    if report.state == "waiting":
        text = f"waiting for {report.device.port or 'its port'}"
        return ConnectionStatus("waiting", "✕", "sensor gone", text, "bad", False)
    if report.state == "starting":
        text = "looking for the sensor and its stream"
        return ConnectionStatus("starting", "◌", "starting", text, "warn", True)
    if SHOWN_CAVEATS["moving"] in caveats:
        return ConnectionStatus("moving", "◐", "not at rest", "motion is excluded", "warn", True)
    if SHOWN_CAVEATS["warming_up"] in caveats:
        text = "the part that shows is excluded at its end"
        return ConnectionStatus("warming_up", "◐", "warming up", text, "warn", True)
    return ConnectionStatus("live", "●", "live", "", "good", True)
