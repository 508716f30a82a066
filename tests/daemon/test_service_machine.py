"""The service under a real systemd: start, watchdog, stop, restart, journal. Every test begins as it likes.

``pytest -m slow -s tests/daemon/test_service_machine.py`` prints the times that docs/SERVICE.md has.
"""

from __future__ import annotations

import ctypes
import json
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TypeAlias

import pytest
from machine import Machine, lacking

from imumon.model.report import Report, from_json

pytestmark = [pytest.mark.slow, pytest.mark.skipif(lacking() is not None, reason=str(lacking()))]
UNIT = "imumon@ttySIM.service"
WATCHDOG_S = 4.0
Freeze: TypeAlias = Callable[[Machine], AbstractContextManager[None]]
_SEIZE, _INTERRUPT, _ALL = 0x4206, 0x4207, 0x40000000  # ptrace(2), and __WALL of waitpid(2)


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    sooner = f"[Service]\nWatchdogSec={WATCHDOG_S:g}\n[Unit]\nStartLimitBurst=1000\n"
    with Machine(tmp_path_factory.mktemp("machine"), drop_in=sooner) as machine:
        yield machine


def start(machine: Machine) -> Report:
    """The service from its start; its first report."""
    machine.run("systemctl", "stop", UNIT)
    machine.run("systemctl", "reset-failed", check=False)
    machine.run("systemctl", "start", "sensor.service", UNIT)
    return status(machine)


def status(machine: Machine, samples: int = 1) -> Report:
    """First report with so many samples."""
    found: list[Report] = []

    def enough() -> bool:
        said = machine.run("imumon", "status", "--json", check=False)
        found[:] = [from_json(Report, said.encode())] if said else []
        return bool(found) and found[0].session.samples >= samples

    machine.until(enough)
    return found[0]


def tell(what: str, seconds: float) -> None:
    print(f"\n{what}: {seconds:.2f} s", flush=True)


def test_it_is_active_when_samples_come_and_shows_the_grade(machine: Machine) -> None:
    report = start(machine)
    tell("start to READY", machine.took_s(UNIT, "Starting", "Started"))
    tell("processor so far", int(machine.show(UNIT, "CPUUsageNSec")) / 1e9)
    assert report.session.started is not None
    machine.until(lambda: "industrial" in machine.show(UNIT, "StatusText"))
    assert 'Status: "running; gyro: meets ' in machine.run("systemctl", "status", UNIT)
    running = Path(f"/proc/{machine.process(UNIT)}")
    assert running.stat().st_uid >= 61184  # of the range of dynamic users
    assert (running / "root/proc/sys/kernel/random/boot_id").read_text()  # it tells restart from reboot
    for hidden in ("root", "home"):
        assert list((running / "root" / hidden).iterdir()) == []


def test_it_waits_for_a_sensor_that_comes_later(machine: Machine) -> None:
    machine.run("systemctl", "stop", UNIT, "sensor.service")
    machine.run("systemctl", "start", UNIT)
    assert machine.show(UNIT, "ActiveState") == "active"
    assert machine.show(UNIT, "StatusText").startswith("waiting: no port /dev/ttySIM")
    machine.run("systemctl", "start", "sensor.service")
    tell("sensor to first sample", machine.until(lambda: "running" in machine.show(UNIT, "StatusText")))
    assert machine.show(UNIT, "NRestarts") == "0"


@contextmanager
def all_of_it_stands_still(machine: Machine) -> Iterator[None]:
    """The daemon and all its threads."""
    machine.run("kill", "-STOP", machine.show(UNIT, "MainPID"))
    yield


@contextmanager
def its_loop_alone_stands_still(machine: Machine) -> Iterator[None]:
    """The thread of the loop; reader, writer and bus go on."""
    process = machine.process(UNIT)
    kernel = ctypes.CDLL(None, use_errno=True)
    for request in (_SEIZE, _INTERRUPT):
        assert kernel.ptrace(request, process, None, None) == 0, os.strerror(ctypes.get_errno())
    os.waitpid(process, _ALL)
    yield
    os.waitpid(process, _ALL)  # it has ended: until we have looked, its parent does not hear of it


@pytest.mark.parametrize("freeze", [all_of_it_stands_still, its_loop_alone_stands_still])
def test_a_frozen_loop_is_killed_and_started_again(machine: Machine, freeze: Freeze) -> None:
    start(machine)
    status(machine, 300)
    machine.run("journalctl", "--rotate", "--vacuum-time=1ms")
    with freeze(machine):
        noticed = machine.until(lambda: any("Watchdog timeout" in line for line in machine.journal(UNIT)))
    tell(f"{freeze.__name__}: noticed after", noticed)
    machine.until(lambda: machine.show(UNIT, "NRestarts") == "1")
    machine.until(lambda: machine.show(UNIT, "ActiveState") == "active")
    tell("start again, of a record", machine.took_s(UNIT, "Starting", "Started"))
    assert noticed < WATCHDOG_S + 2.0
    assert any("Fatal Python error: Aborted" in line for line in machine.journal(UNIT, "-p", "err"))
    status(machine)


def test_stop_is_quick_and_a_restart_goes_on_with_the_record(machine: Machine) -> None:
    took = []
    while not took or (len(took) < 3 and took[-1] >= 1.0):  # what else runs here only adds to it
        before = status(machine, start(machine).session.samples + 300)
        machine.run("systemctl", "stop", UNIT)
        took.append(machine.took_s(UNIT, "Stopping", "Stopped"))
        tell("stop", took[-1])
    assert took[-1] < 1.0
    assert machine.show(UNIT, "Result") == "success"
    machine.run("systemctl", "start", UNIT)
    kept = status(machine)  # with all that came between the last report and the stop
    after = status(machine, kept.session.samples + 100)
    tell("start with a record", machine.took_s(UNIT, "Starting", "Started"))
    assert after.session.started == before.session.started
    assert after.session.restarts == before.session.restarts + 1
    assert after.session.gaps == before.session.gaps + 1
    assert after.session.missing > before.session.missing  # as long as the sensor's clock says
    rate = after.device.sample_rate_hz
    assert round(after.session.elapsed_s * rate) == after.session.samples + after.session.missing


def _saved(machine: Machine) -> Report:
    """Start the service with a record that it has saved; return its report."""
    status(machine, start(machine).session.samples + 300)
    machine.run("systemctl", "restart", UNIT)
    return status(machine)


def _continues(machine: Machine, before: Report) -> None:
    machine.until(lambda: machine.show(UNIT, "NRestarts") != "0")
    machine.until(lambda: machine.show(UNIT, "ActiveState") == "active")
    after = status(machine)
    assert after.session.started == before.session.started
    assert after.session.missing > before.session.missing  # the record has a gap until now


def test_a_killed_service_is_started_again_and_its_record_continues(machine: Machine) -> None:
    before = _saved(machine)
    machine.run("kill", "-KILL", machine.show(UNIT, "MainPID"))  # as the kernel does beyond MemoryMax
    _continues(machine, before)


def test_faulty_settings_are_said_once_and_not_tried_again(machine: Machine) -> None:
    machine.run("sh", "-c", "mkdir -p /etc/imumon; echo 'nonsense = 1' > /etc/imumon/config.toml")
    try:
        machine.run("systemctl", "restart", UNIT, check=False)
        machine.until(lambda: machine.show(UNIT, "ActiveState") == "failed")
        assert machine.show(UNIT, "NRestarts") == "0"
        errors = [line for line in machine.journal(UNIT, "-p", "err") if line.startswith("imumon: ")]
        assert len(errors) == 1
        assert "/etc/imumon/config.toml:1: nonsense" in errors[0]
        checks = json.loads(machine.run("imumon", "doctor", "--port", "/dev/nix", "--json", check=False))
        service = next(c for c in checks["checks"] if c["name"] == "service")
        assert service["status"] == "failed"
        assert f"journalctl -u {UNIT}" in service["cure"]
    finally:
        machine.run("rm", "/etc/imumon/config.toml")
