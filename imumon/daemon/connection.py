"""Connection: what the daemon knows of its device, from the first attempt to open it to the end of the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from imumon.daemon.run_limits import DataTimeout
from imumon.model.ledger import ledger_text
from imumon.model.report import DeviceDescription, State
from imumon.model.samples import DeviceCounters, DeviceInfo
from imumon.sources import registry
from imumon.sources.clock import HostClock
from imumon.sources.device import DeviceDriver, DeviceError

UNEXPLAINED_S = 3.0
"""s from the first byte on after which a report without a sample says what arrives. Samples at 100 Hz show after half a
second."""
SHOWN_BYTES = 60
"""Bytes of the first line that are shown."""


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
        self._first_bytes = b""  # of the stream, before its first sample
        self._first_bytes_at: float | None = None  # s, monotonic
        self._without_samples = ""  # remark on these bytes

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

    def runs(self) -> None:
        """Note that samples arrive."""
        self.state, self._without_samples = "running", ""

    def note_bytes(self, data: bytes) -> None:
        """Keep how a stream without a sample begins."""
        if self._first_bytes_at is None:
            self._first_bytes_at = self._clock.monotonic_s()
        if len(self._first_bytes) < SHOWN_BYTES:
            self._first_bytes += data[:SHOWN_BYTES]

    def unexplained(self, ledger: Mapping[str, int]) -> str | None:
        """Return, once, that nothing that was received is a sample, with what became of it and how it begins.

        Parameters
        ----------
        ledger : what became of everything that was received.
        """
        begin_s = self._first_bytes_at
        if self._without_samples or begin_s is None:
            return None
        if self._clock.monotonic_s() - begin_s < UNEXPLAINED_S:
            return None
        received = ledger_text(ledger) or f"{self.counters.received_bytes:,} bytes received"
        # as Python writes bytes: each of them is a printable character or an escape
        first = repr(self._first_bytes.partition(b"\n")[0][:SHOWN_BYTES])[1:]
        self._without_samples = f"no sample yet: {received}; the first line is {first}"
        return self._without_samples

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
        known = registry.description(info, name)
        if self._without_samples:
            known = replace(known, remarks=(*known.remarks, self._without_samples))
        return known
