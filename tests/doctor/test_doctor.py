"""`imumon doctor` names every fault, changes nothing, and does not disturb a running daemon."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import forked
import pytest
import reports
from daemons import Daemon
from emulated_sensor import ForeignDevice
from fake_device import FakeDriver
from faulty_sensor import spawn
from free_ports import free_endpoint
from waiting import until

from imumon.config import DeviceSettings, Settings, ZenohSettings
from imumon.doctor import Case, checks, examine
from imumon.doctor.doctor import daemon_port
from imumon.doctor.observed import ServiceObservation, StateObservation, ZenohObservation
from imumon.doctor.probe_host import observe_state
from imumon.model.errors import ImumonError
from imumon.model.samples import DeviceInfo
from imumon.sources import registry
from imumon.sources.device import Check, Observation
from imumon.sources.registry import driver
from imumon.sources.serial_port import SerialPort
from imumon.sources.vn100.emulator import EmulatorSettings


@pytest.fixture
def case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Case:
    """A case without any daemon on the bus."""
    endpoint = free_endpoint()
    monkeypatch.setattr("imumon.doctor.probe_zenoh.ANSWER_S", 0.05)
    settings = Settings(zenoh=ZenohSettings(listen=(endpoint,)))
    return Case(settings=settings, state_directory=tmp_path / "state", connect=(endpoint,), seconds=1.0)


def with_device(case: Case, device: DeviceSettings) -> Case:
    return replace(case, settings=Settings(zenoh=case.settings.zenoh, device=device))


def by_name(case: Case, port: str) -> dict[str, Check]:
    return {check.name: check for check in examine(replace(case, port=port))}


def failed(results: dict[str, Check]) -> set[str]:
    return {name for name, check in results.items() if check.status == "failed"}


# ---------------------------------------------------------------------- a sensor and its faults


def test_a_factory_sensor_has_two_warnings(case: Case) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor:

        def examined() -> dict[str, Check]:
            """Return the checks once the rate is right: on a busy machine, the sensor is late for a second."""
            results = by_name(case, sensor.path)
            return results if results["rate"].status == "ok" else {}

        results = until(examined)
    assert not failed(results)
    warnings = {name for name, check in results.items() if check.status == "warning"}
    assert warnings == {"aliasing", "compensation"}
    assert "2.24 times" in results["aliasing"].text
    assert "115200" in results["baud"].text
    assert "0100056785" in results["model"].text
    assert set(results) >= {"config", "port", "load", "checksums", "rate", "zenoh"}


CLOCKED = EmulatorSettings(seed=1, rate=160.0)
"""Binary, with a sample clock, and within the factory baud rate."""


def test_damaged_messages_are_detected(case: Case) -> None:
    with spawn(CLOCKED) as sensor:
        sensor.ask("fault corrupt=0.005")
        results = by_name(replace(case, seconds=0.5), sensor.path)  # 80 messages: some are certainly damaged
    assert results["checksums"].status == "failed", results
    assert results["checksums"].cure


@pytest.mark.few
@pytest.mark.parametrize("fault", ["drop=0.25", "duplicate=0.5"])
def test_the_rate_of_a_stream_without_a_clock_is_checked(case: Case, fault: str) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor:
        sensor.ask(f"fault {fault}")
        results = by_name(replace(case, seconds=2.0), sensor.path)
    assert results["rate"].status != "ok", results
    assert results["rate"].cure


@pytest.mark.few
@pytest.mark.parametrize(
    ("command", "name", "status", "text"),
    [
        ("jump 5000", "clock", "failed", "jumped"),
        ("jump -0.5", "clock", "failed", "jumped"),
        ("stall 600", "stream", "warning", "no data"),
        ("silence 600", "stream", "warning", "no data"),
        ("unplug", "sensor", "failed", "unplugged"),
        ("reboot", "sensor", "failed", ""),
    ],
)
def test_events_during_the_observation_are_detected(
    case: Case, command: str, name: str, status: str, text: str
) -> None:
    with spawn(CLOCKED) as sensor:
        answers: list[str] = []

        def act(step: str) -> None:
            if step.startswith("observing"):
                threading.Timer(0.15, lambda: answers.append(str(sensor.ask(command)))).start()

        # a busy machine may act late: a second of silence is left all the same
        seconds = 4.0 if name == "stream" else 1.5
        results = {c.name: c for c in examine(replace(case, port=sensor.path, seconds=seconds), act)}
    assert answers
    if command == "reboot":  # it sends its factory stream again: one of the two shows
        assert results["stream"].status == "warning" or failed(results), results
    else:
        assert results[name].status == status, results
        assert text in results[name].text


def test_a_foreign_device_is_recognised(case: Case) -> None:
    with ForeignDevice("nmea") as device:
        results = by_name(case, device.path)
    assert failed(results) == {"sensor"}
    assert "GPGGA" in results["sensor"].text
    assert results["sensor"].cure


def test_listen_only_sends_no_command(case: Case) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor:
        results = by_name(with_device(case, DeviceSettings(listen_only=True)), sensor.path)
        assert sensor.ask("counters")["replies"] == 0
    assert results["model"].status == "warning"
    assert results["aliasing"].status == "warning"


def test_a_port_in_use_by_another_program_is_not_read(case: Case) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor, SerialPort(sensor.path):
        results = by_name(case, sensor.path)
    assert failed(results) == {"port"}
    assert "in use" in results["port"].text


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """URL of a device without bytes, registers and serial port."""
    load = registry.driver
    monkeypatch.setattr(registry, "driver", lambda scheme: FakeDriver() if scheme == "fake" else load(scheme))
    (tmp_path / "device").touch()
    return f"fake:{tmp_path / 'device'}"


def test_the_generic_checks_apply_to_any_device(case: Case, fake: str) -> None:
    results = by_name(case, fake)
    names = [name for name in results if name not in ("config", "zenoh", "state", "service")]
    assert names == ["port", "model", "stream", "aliasing", "compensation", "rate", "clock"]
    # its filter and its rate are unknown, and every 50th of its samples is missing
    assert {name for name in names if results[name].status != "ok"} == {"aliasing", "rate"}
    assert "missing" in results["rate"].text


# ---------------------------------------------------------------------- the other checks


OBSERVATION = Observation(
    info=DeviceInfo(id="x", baud=115200, stream="deltas", sample_rate_hz=100.0), seconds=3.0
)


def device_checks(observation: Observation) -> dict[str, Check]:
    """Checks of a VN-100 by name."""
    specific = driver().checks(observation, DeviceSettings())
    return {check.name: check for check in checks.device(observation, specific)}


@pytest.mark.parametrize(("ratio", "status"), [(1.0, "ok"), (0.99, "ok"), (1.2, "warning"), (0.5, "warning")])
def test_a_wrong_sample_clock_is_a_warning(ratio: float, status: str) -> None:
    results = device_checks(replace(OBSERVATION, samples=300, rate_hz=100.0, clock_ratio=ratio))
    assert results["clock"].status == status


@pytest.mark.parametrize(
    ("zenoh", "status"),
    [
        (lambda: ZenohObservation(free="tcp/127.0.0.1:7448"), "ok"),
        (lambda: ZenohObservation(reports=(reports.report(),)), "ok"),
        (
            lambda: ZenohObservation(error=ImumonError("address_in_use", "it is taken", "choose another")),
            "failed",
        ),
        (lambda: ZenohObservation(free="tcp/127.0.0.1:7448", unreachable=("tcp/10.0.0.9:7447",)), "warning"),
        (
            lambda: ZenohObservation(free="tcp/127.0.0.1:7448", reports=(reports.report(state="waiting"),)),
            "warning",
        ),
    ],
)
def test_zenoh(zenoh: Callable[[], ZenohObservation], status: str) -> None:
    check = checks.zenoh(zenoh())
    assert check.status == status
    assert (check.cure is None) == (status == "ok")


def test_no_port_at_all(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.sources.port_device.find_ports", list)
    results = {check.name: check for check in examine(case)}
    assert failed(results) == {"sensor"}
    assert results["sensor"].text == "no serial port on this machine"


def test_the_port_that_a_daemon_waits_for_is_examined() -> None:
    lost = reports.report(state="waiting")
    zenoh = ZenohObservation(reports=(lost,))
    assert daemon_port(zenoh) == lost.device.port
    own = replace(lost, device=replace(lost.device, id="mine", port="/dev/mine"))
    assert daemon_port(replace(zenoh, reports=(lost, own)), ["mine"]) == "/dev/mine"
    assert daemon_port(ZenohObservation()) == ""
    text = f"the daemon {lost.device.id} waits for its sensor on {lost.device.port}"
    assert checks.zenoh(zenoh).text == text
    other = reports.report(id="other")
    assert checks.zenoh(ZenohObservation(reports=(other, lost))).text == f"{text}; also running: other"


def test_the_state_directory(tmp_path: Path) -> None:
    assert checks.state(observe_state(tmp_path / "new" / "one")).status == "ok"
    assert list(tmp_path.iterdir()) == []
    file = tmp_path / "file"
    file.write_text("")
    assert checks.state(observe_state(file / "below")).status == "failed"
    assert checks.state(StateObservation(path=tmp_path, free_bytes=1000)).status == "warning"
    if os.getuid():
        tmp_path.chmod(0o500)
        assert checks.state(observe_state(tmp_path)).status == "failed"
        tmp_path.chmod(0o700)


@pytest.mark.parametrize(
    ("service", "status"),
    [
        (ServiceObservation(running=False), "ok"),
        (ServiceObservation(running=True), "ok"),
        (ServiceObservation(running=True, installed=True), "warning"),
        (
            ServiceObservation(running=True, installed=True, units=(("imumon@ttyUSB0.service", "active"),)),
            "ok",
        ),
        (
            ServiceObservation(running=True, installed=True, units=(("imumon@ttyUSB0.service", "failed"),)),
            "failed",
        ),
    ],
)
def test_the_service(service: ServiceObservation, status: str) -> None:
    assert checks.service(service).status == status


# ---------------------------------------------------------------------- the command


def doctor(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return forked.run("doctor", *arguments, directory=cwd)


def test_a_running_daemon_is_queried_and_not_disturbed(tmp_path: Path) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor, Daemon(sensor.path, tmp_path / "state") as daemon:
        before = daemon.samples()

        def examined() -> dict[str, dict[str, str]]:
            """Return the checks once the rate is right, as for a factory sensor."""
            done = doctor("--port", sensor.path, "--connect", daemon.endpoint, "--json", cwd=tmp_path)
            output = json.loads(done.stdout)
            assert (done.returncode, output["schema"]) == (0, "imumon.doctor/1"), done.stdout
            results = {check["name"]: check for check in output["checks"]}
            return results if results["rate"]["status"] == "ok" else {}

        results = until(examined)
        after = daemon.wait(lambda r: r.session.samples > before.session.samples + 50)
        daemon.stop()
    assert "its counters are checked" in results["port"]["text"]
    assert results["compensation"]["status"] == "ok"
    assert (after.session.missing, after.session.gaps, after.session.bad_checksums) == (0, 0, 0)


READER = "import sys; port = open(sys.argv[1], 'rb', buffering=0); print(flush=True); sys.stdin.read()"


def test_another_reader_of_the_port_is_named(case: Case, tmp_path: Path) -> None:
    """It locks nothing, as `cat` and most ROS drivers do, and takes a part of the bytes."""
    with spawn(EmulatorSettings(seed=1)) as sensor:
        with subprocess.Popen(
            [sys.executable, "-c", READER, sensor.path, "driver"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        ) as other:
            other.stdout.readline()
            used = by_name(case, sensor.path)["port"]
            done = forked.run("run", "--port", sensor.path, "--state", str(tmp_path))
            other.communicate()
        free = by_name(replace(case, seconds=0.3), sensor.path)["port"]
    assert used.status == "failed"
    assert f"({other.pid})" in used.text
    assert "end it first" in str(used.cure)
    assert done.returncode == 1
    assert f"({other.pid}): end it first: kill {other.pid}\n" in done.stderr
    assert free.status == "ok"
