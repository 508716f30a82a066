"""Doctor: the probes and checks of an installation, one line per check, with what to do.

doctor        all checks in order
observed      results of the probes
probe_device  what the device sends, or what the daemon that reads it counts
probe_host    the file of the port, the state directory, the service manager
probe_zenoh   daemons on Zenoh, and whether another one could listen
checks        observations to checks: pure functions

The doctor changes nothing: a device is opened and identified, never started, and a port that a daemon
reads is not opened. Checks that need knowledge of a kind of device come from its driver.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

from imumon.config import Settings
from imumon.doctor import checks, probe_host
from imumon.doctor.observed import PortObservation, ZenohObservation
from imumon.doctor.probe_device import observe_daemon, observe_device
from imumon.doctor.probe_zenoh import ZenohProbe
from imumon.model.report import Report
from imumon.sources import registry
from imumon.sources.device import Check, DeviceError, DeviceOptions
from imumon.sources.ports import find_ports

OBSERVE_S = 3.0
"""s for which a device is observed: 1 % of damaged messages show at 40 Hz."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What to examine."""

    settings: Settings  # of the daemon; the defaults if the file has faults
    faults: tuple[str, ...] = ()  # of the settings file, one line each
    port: str | None = None  # path or URL; None: of the settings, of a daemon, or the first with a device
    state_directory: Path  # of the daemon
    connect: tuple[str, ...] = ()  # endpoints of daemons; empty: those of the settings
    own: tuple[str, ...] = ()  # devices of daemons of the same user
    seconds: float = OBSERVE_S  # s for which a device is observed


def examine(case: Case, progress: Callable[[str], None] = lambda text: None) -> Iterator[Check]:
    """Yield all checks, each as soon as it is known.

    Parameters
    ----------
    progress : called with a short text before each step that takes long.
    """
    yield checks.config(case.settings, case.faults)
    progress("looking for daemons")
    with ZenohProbe(case.settings.zenoh, case.connect) as probe:
        zenoh = probe.observe()
        yield from _examine_ports(case, probe, zenoh, progress)
        yield checks.zenoh(zenoh)
    yield checks.state(probe_host.observe_state(case.state_directory))
    yield checks.service(probe_host.observe_service())


def _examine_ports(
    case: Case, probe: ZenohProbe, zenoh: ZenohObservation, progress: Callable[[str], None]
) -> Iterator[Check]:
    """Yield the checks of the port and of its device; without a configured port, try one after the other."""
    configured = case.port or case.settings.device.port
    paths = [configured] if configured else candidate_ports(zenoh, case.own)
    if not paths:
        yield checks.NO_PORT
    for path in paths:
        report = next((r for r in zenoh.reports if r.device.port and _same_port(r.device.port, path)), None)
        port_checks, has_device = _examine_port(case, path, report, probe, progress)
        if has_device or path == paths[-1]:
            yield from port_checks
            return
        yield checks.skipped_port(path, port_checks)


def candidate_ports(zenoh: ZenohObservation, own: Collection[str] = ()) -> list[str]:
    """Return the ports to try if none is configured: of own daemons, else of any daemon, else all serial ports."""
    used = {report.device.id: report.device.port for report in zenoh.reports if report.device.port}
    mine = [port for name, port in used.items() if name in own]
    return mine or list(used.values()) or [port.path for port in find_ports()]


def _examine_port(
    case: Case, path: str, report: Report | None, probe: ZenohProbe, progress: Callable[[str], None]
) -> tuple[list[Check], bool]:
    """Return the checks of one port, and whether it has a device.

    Parameters
    ----------
    report : of the daemon that reads the port; None: none does.
    """
    port = probe_host.observe_port(path, report.device.id if report else None)
    port_checks = list(checks.port(port))
    if any(check.status == "failed" for check in port_checks):
        return port_checks, False
    try:
        return [*port_checks, *_examine_device(case, port, report, probe, progress)], True
    except DeviceError as error:
        return [*port_checks, checks.no_device(error)], False


def _examine_device(
    case: Case,
    port: PortObservation,
    report: Report | None,
    probe: ZenohProbe,
    progress: Callable[[str], None],
) -> list[Check]:
    """Return the checks of the device on a port, or of the daemon that reads it."""
    driver = registry.driver_of(port.path)
    max_loss = case.settings.alert.max_loss if report is None else report.max_loss
    if report is not None and probe.subscriber is not None:
        progress(f"observing the daemon {report.device.id} for {case.seconds:g} s")
        observation = observe_daemon(probe.subscriber, report, case.seconds)
    else:
        # the check of the baud rate compares the configured one with that of the device: detect the latter
        settings = SimpleNamespace(**{**vars(case.settings.device), "baud": "auto"})
        table = getattr(case.settings, driver.scheme, None)
        options = DeviceOptions(url=port.path, settings=settings, table=table)
        device = driver.create(options)
        device.progress = progress
        with closing(device):
            device.open()
            progress(f"observing the device for {case.seconds:g} s")
            observation = observe_device(device, case.seconds)
    specific = driver.checks(observation, case.settings.device)
    return checks.device(observation, specific, max_loss)


def _same_port(one: str, other: str) -> bool:
    return one == other or Path(one).resolve() == Path(other).resolve()
