"""Doctor: one check a line, what is wrong and how to mend it.

    examine     all checks in order                               doctor/__init__.py
    looks       what was seen, as plain facts                     doctor/looks.py
    machine     looks at the port's file, the disk, the services  doctor/machine.py
    line        listens to the sensor, or asks its daemon         doctor/line.py
    bus         asks who is on Zenoh, and whether there is room   doctor/bus.py
    judge       facts in, checks out: pure functions              doctor/judge.py

It changes nothing: the sensor is asked for its registers and none is written; a port that a daemon of ours
holds is left alone, and the daemon is asked instead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from imumon.config import Settings
from imumon.doctor import checks, probe_host
from imumon.doctor.checks import Check
from imumon.doctor.observations import BusLook
from imumon.doctor.probe_device import Unheard, ask_daemon, listen
from imumon.doctor.probe_zenoh import Network
from imumon.recordings import find_ports
from imumon.report import Report

__all__ = ["Case", "Check", "examine"]

LISTEN_S = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """What to examine.

    Attributes
    ----------
    settings : as the daemon would have them, the defaults where the file is at fault.
    faults : of the file; empty: none.
    port : the port; None: that of the settings, of a daemon that answers, or the first with a sensor.
    state_directory : where the daemon would keep its state.
    connect : endpoints of daemons; empty: those of the settings.
    seconds : s, how long to listen.
    """

    settings: Settings
    faults: tuple[str, ...] = ()
    port: str | None = None
    state_directory: Path
    connect: tuple[str, ...] = ()
    seconds: float = LISTEN_S


def examine(case: Case, progress: Callable[[str], None] = lambda text: None) -> Iterator[Check]:
    """All checks, each as soon as it is known; `progress` is told what takes long."""
    yield checks.config(case.settings, case.faults)
    progress("asking on the bus")
    with Network(case.settings.zenoh, case.connect) as network:
        look = network.look()
        yield from _sensor(case, network, look, progress)
        yield checks.zenoh(look)
    yield checks.state(probe_host.look_at_state(case.state_directory))
    yield checks.service(probe_host.look_at_service())


def _sensor(case: Case, network: Network, bus: BusLook, progress: Callable[[str], None]) -> Iterator[Check]:
    """Checks of the port and of the sensor on it."""
    given = case.port or case.settings.device.port
    paths = [given] if given else _candidates(bus)
    if not paths:
        yield checks.NO_PORT
        return
    for number, path in enumerate(paths):
        daemon = next((r for r in bus.reports if r.device.port and _same(r.device.port, path)), None)
        last = number == len(paths) - 1
        seen, found = _look(case, path, daemon, network, progress)
        if found or last:
            yield from seen
            return
        yield checks.passed_over(path, seen)


def _candidates(bus: BusLook) -> list[str]:
    """Ports to try where none is named: those that daemons read or wait for, else all there are."""
    held = [r.device.port for r in bus.reports if r.device.port]
    return held or [port.path for port in find_ports()]


def _look(
    case: Case, path: str, daemon: Report | None, network: Network, progress: Callable[[str], None]
) -> tuple[list[Check], bool]:
    """Checks of one port, and whether there is a sensor on it."""
    look = probe_host.look_at_port(path, daemon.device.id if daemon else None)
    seen = list(checks.port(look))
    if any(check.status == "failed" for check in seen):
        return seen, False
    try:
        if daemon is not None:
            progress(f"asking {daemon.device.id} for {case.seconds:g} s")
            heard, look = ask_daemon(network.feed, daemon, case.seconds), probe_host.with_latency(look)
        else:
            heard, look = listen(look, case.settings.device.listen_only, case.seconds, progress)
    except Unheard as error:
        return [*seen, checks.unheard(str(error))], False
    return [*seen, *checks.latency(look), *checks.sensor(heard, case.settings)], True


def _same(one: str, other: str) -> bool:
    return one == other or Path(one).resolve() == Path(other).resolve()
