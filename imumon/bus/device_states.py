"""States of devices: what a subscriber knows of each device on the bus, and whose reports it shows.

If several sessions publish one device, the first with a valid report is shown until it ends or is silent for `GONE_S`;
`DeviceState.rivals` names them while they publish, and its reports have the caveat ``rival``.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field, replace

from imumon.bus.queryable import EVENTS_KEPT
from imumon.model.report import Event, Report

GONE_S = 5.0
"""s without a report after which a daemon counts as ended; three periods if that is longer."""
RIVAL = "rival"
"""Caveat of a report whose device several sessions publish."""
_NO_ID = "a program that hides its session"


@dataclass(slots=True)
class DeviceState:
    """What is known of a device; `session` is the Zenoh id of the session whose reports are shown."""

    alive: bool = False
    session: str | None = None
    clock: str = ""  # id in the timestamps of that session: the same on all routes of a daemon
    heard_s: dict[str, float] = field(
        default_factory=dict
    )  # monotonic, of the other sessions that publish it
    data: bytes | None = None  # newest report while it is not parsed
    report: tuple[Report, float] | None = None
    marked: tuple[Report, Report] | None = None  # the newest report, and the same with the caveat of rivals
    arrived_s: float = 0.0  # s of the monotonic clock, newest report
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=EVENTS_KEPT))
    event_counts: Counter[str] = field(default_factory=Counter)  # of the known kinds that were received

    @property
    def gone_s(self) -> float:
        """Time without a report after which a session counts as ended, s."""
        period_s = self.report[0].period_s if self.report is not None else 0.0
        return max(GONE_S, min(3.0 * period_s, 60.0))

    def silent(self, now: float) -> bool:
        """Return whether its session counts as ended."""
        return now - self.arrived_s > self.gone_s

    def add_rival(self, session: str, clock: str, now: float) -> None:
        """Record a report of a second session at `now`, unless it is another route of the same daemon."""
        if clock and clock == self.clock:
            return
        self.heard_s[session] = now

    def rivals(self, now: float) -> tuple[str, ...]:
        """Return the sessions that publish the device at `now`, the one that is shown first; empty: there is one."""
        late = now - self.gone_s
        self.heard_s = {name: heard for name, heard in self.heard_s.items() if heard > late}
        others = [name or _NO_ID for name in self.heard_s if name != self.session]
        return (self.session or _NO_ID, *others) if others else ()

    def shown(self, now: float) -> tuple[Report, float] | None:
        """Return the newest report with its arrival, marked while there are rivals; the same object each time."""
        if self.report is None or not self.rivals(now):
            return self.report
        report, arrived_s = self.report
        if self.marked is None or self.marked[0] is not report:
            self.marked = report, replace(report, caveats=(*report.caveats, RIVAL))
        return self.marked[1], arrived_s
