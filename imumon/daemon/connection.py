"""Connection: what the daemon knows of its device, from the first attempt to open it to the end of the run."""

from __future__ import annotations

from dataclasses import fields, replace

from imumon.clock import HostClock
from imumon.daemon.run_limits import DataTimeout
from imumon.devices import registry
from imumon.devices.base import DeviceDriver, DeviceError
from imumon.report import DeviceDescription, State
from imumon.samples import DeviceCounters, DeviceInfo


class Connection:
    """Identity, state and counters of a device, and how long it is away or silent.

    Attributes
    ----------
    info : what is known of the device; None before it is found or expected.
    state : as in a report.
    connected : it is open and was started.
    counters : of the device, in this run.
    searched : the log says that the daemon looks for a device.
    problem : why it could not be opened; empty: it could, or was not tried since it was there.
    """

    def __init__(self, driver: DeviceDriver, clock: HostClock) -> None:
        self._clock = clock
        self.info: DeviceInfo | None = None
        self.state: State = "starting"
        self.connected = False
        self.counters = DeviceCounters()
        self.searched = False
        self.problem = ""
        self._scheme = driver.scheme
        self._timeout = DataTimeout()
        self._lost_at: float | None = None  # s, `HostClock.uptime_s`
        self._known_remarks: set[str] = set()

    def update(self, info: DeviceInfo) -> list[str]:
        """Keep what is known of the device; return its remarks that are new."""
        self.identify(info)
        new = [remark for remark in info.remarks if remark not in self._known_remarks]
        self._known_remarks.update(new)
        return new

    def identify(self, info: DeviceInfo | None) -> None:
        """Keep which device it is, or will be; None: it is not known."""
        self.info = None if info is None else replace(info, driver=self._scheme)

    def failed(self, error: DeviceError) -> bool:
        """Note that the device cannot be opened; return whether the reason is a new one."""
        before, self.problem = self.problem, str(error)
        return self.problem != before

    def lost(self) -> None:
        """Note that the device is gone."""
        self._lost_at = self._lost_at or self._clock.uptime_s()
        self.problem, self.connected, self.state = "", False, "waiting"

    def regained(self) -> float:
        """Note that the device sends again; return the s that it was away."""
        now = self._clock.uptime_s()
        away_s = now - (self._lost_at or now)
        self._lost_at, self.connected = None, True
        return away_s

    def silence(self, *, data: bool, samples: bool, rate_hz: float | None) -> str | None:
        """Return that a connected device is silent, once; None otherwise.

        Parameters
        ----------
        data, samples : whether data, and samples in them, arrived just now.
        rate_hz : Hz, of the samples if it is known.
        """
        if not self.connected:
            return None
        starting = self.state == "starting"
        problem = self._timeout.update(
            self._clock.monotonic_s(), data=data, samples=samples, rate_hz=rate_hz, starting=starting
        )
        if problem is None or self.state == "waiting":
            return None
        self.state = "waiting"
        return problem

    def description(self, name: str) -> DeviceDescription:
        """Return the device in a report, under its name on the bus."""
        info = self.info
        if info is None:
            return DeviceDescription(id=name)
        shared = {f.name for f in fields(DeviceDescription)} & {f.name for f in fields(info)}
        driver = registry.driver(info.driver) if info.driver else None
        known = DeviceDescription(**{field: getattr(info, field) for field in shared})
        return replace(known, id=name, setting_texts=registry.setting_texts(driver, info.settings))
