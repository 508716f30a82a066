"""States of devices: what a subscriber knows of each device on the bus, and whose reports it shows.

If several sessions publish one device, the first with a valid report is shown until it ends or is silent for `GONE_S`;
`DeviceState.rivals` names them while they publish, and its reports have the caveat ``rival``.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field, replace

from imumon.bus.queryable import EVENTS_KEPT
from imumon.report import Event, Report

GONE_S = 5.0
"""s without a report after which a daemon counts as ended; three periods if that is longer."""
_MAX_DEVICES = 256  # devices; bounds the time that invented names can take
_MAX_RIVALS = 8  # sessions that are named of one device
RIVAL = "rival"
"""Caveat of a report whose device several sessions publish."""
_NO_ID = "a program that hides its session"


@dataclass(slots=True)
class DeviceState:
    """What is known of a device; `session` is the Zenoh id of the session whose reports are shown."""

    seen_s: float  # s of the monotonic clock, last message
    alive: bool = False
    session: str | None = None
    clock: str = ""  # id in the timestamps of that session: the same on all routes of a daemon
    heard_s: dict[str, float] = field(
        default_factory=dict
    )  # monotonic, of the other sessions that publish it
    data: bytes | None = None  # newest report while it is not parsed
    size: int = 0  # bytes of the newest report
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
        if session in self.heard_s or len(self.heard_s) < _MAX_RIVALS:
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


class DeviceStates(dict[str, DeviceState]):
    """The devices that were seen, by name: at most `_MAX_DEVICES`."""

    def seen(self, id: str, now: float) -> DeviceState | None:
        """Return a device that has sent a message at `now`, s of the monotonic clock; None: there are too many.

        A name that is seen for the first time takes the place of the device that is gone for the longest time.
        """
        device = self.get(id)
        if device is None:
            if len(self) >= _MAX_DEVICES:
                gone = {name: device.seen_s for name, device in self.items() if not device.alive}
                oldest = min(gone, key=gone.__getitem__, default=None)
                if oldest is None or now - gone[oldest] < GONE_S:
                    return None
                del self[oldest]
            device = self[id] = DeviceState(now)
        device.seen_s = now
        return device
