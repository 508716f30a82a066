"""Outputs: where the daemon sends its reports and events.

Events go to the log, the bus, the history and the alert command. Reports go to the bus and ROS 2. The bus has no name
before the device has one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping

from imumon.bus import Publisher
from imumon.config import Settings
from imumon.daemon.alert_command import CLOSE_S, AlertCommand
from imumon.daemon.keeper import Keeper
from imumon.daemon.log import LEVELS
from imumon.daemon.run_limits import RunOptions
from imumon.model.messages import EVENT_LEVELS
from imumon.model.report import Event, Report, Signal, stamp
from imumon.model.samples import DeviceInfo, Level
from imumon.record.events import DetectedEvent
from imumon.ros2.ros_output import RosOutput

log = logging.getLogger(__name__)


class Outputs:
    """Everything outside of the daemon that hears of its device.

    Attributes
    ----------
    bus : None while the device has no name.

    Raises
    ------
    RosError : what is to be published in ROS 2 is not possible.
    """

    def __init__(self, settings: Settings, options: RunOptions, keeper: Keeper) -> None:
        self._settings, self._keeper, self._clock = settings, keeper, options.clock
        self._alert = AlertCommand(settings.alert.command if self._clock.is_real_time else "")
        self._ros = RosOutput(settings.ros2, options.url)
        self.bus: Publisher | None = None

    def open(self, info: DeviceInfo) -> Publisher:
        """Return the bus under the name of a device.

        Raises
        ------
        BusError : an endpoint cannot be used, or another daemon has the name.
        """
        if self.bus is None:
            self.bus = Publisher(self._settings.device.id or info.id, self._settings.zenoh)
        return self.bus

    def release(self) -> None:
        """Give up the name."""
        if self.bus is not None:
            self.bus.close()
        self.bus = None

    def log(self, text: str, level: Level = "info", kind: str = "") -> None:
        """Write a line to the log only."""
        log.log(LEVELS[level], "%s", text, extra={"kind": kind})

    def event(self, kind: str, text: str, level: Level | None = None, channel: str | None = None) -> None:
        """Send an event of the daemon itself; level None: that of the kind."""
        name = self.bus.id if self.bus else self._settings.device.id
        known = level or EVENT_LEVELS.get(kind, "info")
        now = stamp(self._clock.now())
        self._send(Event(time=now, kind=kind, text=text, device=name, level=known, channel=channel))

    def detected(self, events: Iterable[DetectedEvent]) -> None:
        """Send what the samples have shown."""
        if self.bus is not None:
            for event in events:
                self._send(event.stamped(self._clock.now(), self.bus.id))

    def _send(self, event: Event) -> None:
        self.log(event.text, event.level, event.kind)
        self._alert.submit(event)
        if self.bus is not None:
            self.bus.event(event)
            self._keeper.event(event)

    def report(self, report: Report, signals: Mapping[str, Callable[[], Signal]]) -> None:
        """Send a report."""
        if self._ros.needed:
            self._ros.update(report)
        if self.bus is not None:
            self.bus.publish(report, signals)

    def problems(self) -> Iterator[tuple[str, Level | None]]:
        """Yield what is new about the connections, with its level; None: that of the kind ``bus``."""
        for text in self._ros.problems():
            yield text, None
        for text, over in self.bus.status_changes() if self.bus is not None else ():
            yield text, "notice" if over else None

    def leave(self) -> None:
        """Send the last report in ROS 2 and leave it."""
        self._ros.close()

    def end_alerts(self, within_s: float = CLOSE_S) -> None:
        """Pass on what waits for the alert command, for at most `within_s`."""
        self._alert.close(within_s)
