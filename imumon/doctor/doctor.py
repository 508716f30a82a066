"""Doctor: the probes and checks of an installation, one line per check, with what to do.

doctor        all checks in order
observed      results of the probes
probe_device  what the device sends, or what the daemon that reads it counts
probe_host    the state directory, the service manager
probe_zenoh   daemons on Zenoh, and whether another one could listen
checks        observations to checks: pure functions

The doctor changes nothing: a device is opened and identified, never started, and a port that a daemon
reads is not opened. Why a port does not open is what `imumon run` says, too. Checks that need knowledge of a kind of
device come from its driver.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

from imumon.config import Settings
from imumon.doctor import checks, probe_host
from imumon.doctor.observed import ZenohObservation
from imumon.doctor.probe_device import observe_daemon, observe_device
from imumon.doctor.probe_zenoh import ZenohProbe
from imumon.sources import registry
from imumon.sources.device import Check, DeviceError, DeviceOptions, Observation

OBSERVE_S = 3.0
"""s for which a device is observed: 1 % of damaged messages show at 40 Hz."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What to examine."""

    settings: Settings  # of the daemon; the defaults if the file has faults
    faults: tuple[str, ...] = ()  # of the settings file, one line each
    port: str | None = None  # path or URL; None: of the settings, of a daemon, or the only sensor there is
    state_directory: Path  # of the daemon
    connect: tuple[str, ...] = ()  # endpoints of daemons; empty: those of the settings
    own_devices: tuple[str, ...] = ()  # devices of daemons of the same user
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
        yield from _examine_device(case, probe, zenoh, progress)
        yield checks.zenoh(zenoh)
    yield checks.state(probe_host.observe_state(case.state_directory))
    yield checks.service(probe_host.observe_service())


def _examine_device(
    case: Case, probe: ZenohProbe, zenoh: ZenohObservation, progress: Callable[[str], None]
) -> list[Check]:
    """Return the checks of the port and of its device, or of the daemon that reads it."""
    path = case.port or case.settings.device.port or daemon_port(zenoh, case.own_devices)
    report = next((r for r in zenoh.reports if r.device.port and _same_port(r.device.port, path)), None)
    try:
        if report is not None and probe.subscriber is not None:
            progress(f"observing the daemon {report.device.id} for {case.seconds:g} s")
            observation = observe_daemon(probe.subscriber, report, case.seconds)
        else:
            observation = _observe(case, path, progress)
        specific = registry.driver_of(path).checks(observation, case.settings.device)
    except DeviceError as error:
        return [checks.no_device(error)]
    max_loss = case.settings.alert.max_loss if report is None else report.max_loss
    opened = checks.port(observation.info.port or path, observation.daemon)
    return [opened, *checks.device(observation, specific, max_loss)]


def daemon_port(zenoh: ZenohObservation, own_devices: Collection[str] = ()) -> str:
    """Return the port to examine if none is configured: of an own daemon, else of any; empty: there is none."""
    used = {report.device.id: report.device.port for report in zenoh.reports if report.device.port}
    mine = [port for name, port in used.items() if name in own_devices]
    return next(iter(mine or used.values()), "")


def _observe(case: Case, path: str, progress: Callable[[str], None]) -> Observation:
    """Open a device and return what it sends."""
    driver = registry.driver_of(path)
    # the check of the baud rate compares the configured one with that of the device: detect the latter
    settings = SimpleNamespace(**{**vars(case.settings.device), "baud": "auto"})
    table = getattr(case.settings, driver.scheme, None)
    device = driver.create(DeviceOptions(url=path, settings=settings, table=table))
    device.progress = progress
    with closing(device):
        device.open()
        progress(f"observing the device for {case.seconds:g} s")
        return observe_device(device, case.seconds)


def _same_port(one: str, other: str) -> bool:
    return one == other or Path(one).resolve() == Path(other).resolve()
