"""`imumon doctor`: every fault is found and named, nothing is changed, a running daemon is left alone."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
import reports
from daemons import Daemon, free_endpoint

from imumon.config import DeviceSettings, Settings, ZenohSettings, load
from imumon.devices.vn100.device_info import Vn100Info
from imumon.devices.vn100.emulator import EmulatorSettings, spawn
from imumon.doctor import Case, Check, _candidates, checks, examine
from imumon.doctor.observations import BusLook, Heard, PortLook, ServiceLook, StateLook
from imumon.doctor.probe_device import listen
from imumon.doctor.probe_host import look_at_port, look_at_state, with_latency
from imumon.recordings import SerialPort


@pytest.fixture
def case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Case:
    """An examination that meets nobody else on this machine's bus."""
    place = free_endpoint()
    monkeypatch.setattr("imumon.doctor.probe_zenoh.HEAR_S", 0.05)
    settings = Settings(zenoh=ZenohSettings(listen=(place,)))
    return Case(settings=settings, state_directory=tmp_path / "state", connect=(place,), seconds=1.0)


def by_name(case: Case, port: str) -> dict[str, Check]:
    return {check.name: check for check in examine(replace(case, port=port))}


def failed(found: dict[str, Check]) -> set[str]:
    return {name for name, check in found.items() if check.status == "failed"}


# ---------------------------------------------------------------------- a sensor, and all that can ail it


def test_a_factory_sensor_is_well_and_its_traps_are_told(case: Case) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor:
        found = by_name(case, sensor.path)
    assert not failed(found)
    assert {name for name, check in found.items() if check.status == "warning"} == {
        "aliasing",
        "compensation",
    }
    assert "2.24 times" in found["aliasing"].text
    assert "115200" in found["baud"].text
    assert "0100056785" in found["identity"].text
    assert set(found) >= {"config", "port", "permission", "holder", "bandwidth", "checksums", "rate", "zenoh"}


def test_the_sensor_is_left_as_it_was() -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor:
        one, _ = listen(PortLook(path=sensor.path), False, 0.3)
        other, _ = listen(PortLook(path=sensor.path), False, 0.3)
        assert one.facts == other.facts
        assert other.samples > 5  # it streams as before


CLOCKED = EmulatorSettings(seed=1, rate=160.0)
"""In binary, with the sensor's clock, and within the factory baud."""


@pytest.mark.parametrize("fault", ["crc=0.2", "corrupt=0.005", "cut=0.2"])
def test_damage_on_the_line_is_found(case: Case, fault: str) -> None:
    with spawn(CLOCKED) as sensor:
        sensor.ask(f"fault {fault}")
        found = by_name(replace(case, seconds=0.5), sensor.path)  # 80 messages: some are hit for certain
    assert found["checksums"].status == "failed", found
    assert found["checksums"].cure


@pytest.mark.parametrize("fault", ["drop=0.25", "duplicate=0.5"])
def test_a_stream_without_a_clock_is_counted(case: Case, fault: str) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor:
        sensor.ask(f"fault {fault}")
        found = by_name(replace(case, seconds=2.0), sensor.path)
    assert found["rate"].status != "ok", found
    assert found["rate"].cure


def test_a_stream_with_a_clock_counts_what_is_missing(case: Case) -> None:
    with spawn(CLOCKED) as sensor:
        sensor.ask("fault drop=0.08")
        found = by_name(case, sensor.path)
    assert found["rate"].status != "ok", found
    assert "missing" in found["rate"].text


@pytest.mark.parametrize(
    ("command", "name", "status", "says"),
    [
        ("jump 5000", "clock", "failed", "leapt"),
        ("jump -5", "clock", "failed", "leapt"),
        ("stall 1.3", "stream", "warning", "nothing came"),
        ("silence 1.3", "stream", "warning", "nothing came"),
        ("unplug", "sensor", "failed", "unplugged"),
        ("reboot", "sensor", "failed", ""),
    ],
)
def test_what_happens_while_it_listens_is_told(
    case: Case, command: str, name: str, status: str, says: str
) -> None:
    with spawn(CLOCKED) as sensor:
        heard: list[str] = []

        def act(text: str) -> None:
            if text.startswith("listening"):
                threading.Timer(0.15, lambda: heard.append(str(sensor.ask(command)))).start()

        found = {c.name: c for c in examine(replace(case, port=sensor.path, seconds=1.5), act)}
    assert heard
    if command == "reboot":  # it comes back with its sentences: either shows
        assert found["stream"].status == "warning" or failed(found), found
    else:
        assert found[name].status == status, found
        assert says in found[name].text


def test_another_device_is_told_apart(case: Case) -> None:
    with spawn(EmulatorSettings(seed=1, impostor="nmea")) as sensor:
        found = by_name(case, sensor.path)
    assert failed(found) == {"sensor"}
    assert "NMEA" in found["sensor"].text
    assert "GNSS" in str(found["sensor"].cure)


def test_another_model_is_told(case: Case) -> None:
    with spawn(EmulatorSettings(seed=1, model="VN-200T-CR")) as sensor:
        found = by_name(case, sensor.path)
    assert found["identity"].status == "warning"


def test_a_wrong_baud_in_the_settings_is_told(case: Case) -> None:
    settings = replace(case.settings, device=DeviceSettings(baud=9600))
    with spawn(EmulatorSettings(seed=1)) as sensor:
        found = by_name(replace(case, settings=settings), sensor.path)
    assert failed(found) == {"baud"}
    assert "115200" in found["baud"].text


def test_listen_only_asks_nothing(case: Case) -> None:
    settings = replace(case.settings, device=DeviceSettings(listen_only=True))
    with spawn(EmulatorSettings(seed=1)) as sensor:
        found = by_name(replace(case, settings=settings), sensor.path)
        assert sensor.ask("counters")["replies"] == 0
    assert found["identity"].status == "warning"
    assert found["aliasing"].status == "warning"


# ---------------------------------------------------------------------- ports


def test_a_port_that_is_none(case: Case, tmp_path: Path) -> None:
    file = tmp_path / "capture.bin"
    file.write_bytes(b"x")
    assert "no port" in by_name(case, str(tmp_path / "nothing"))["port"].text
    assert "imumon replay" in str(by_name(case, str(file))["port"].cure)


def test_a_port_in_use_by_another_program_is_left_alone(case: Case) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor, SerialPort(sensor.path):
        found = by_name(case, sensor.path)
    assert failed(found) == {"sensor"}
    assert "in use" in found["sensor"].text


@pytest.mark.parametrize(("rubbish", "says"), [(b"", "silent"), (b"\x5a\x81" * 99, "nothing valid")])
def test_silence_and_rubbish_are_told_apart(case: Case, rubbish: bytes, says: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def send() -> None:
            with server.accept()[0] as client:
                client.sendall(rubbish)
                client.recv(1000)  # until it is asked something

        sender = threading.Thread(target=send)
        sender.start()
        found = by_name(case, f"socket://127.0.0.1:{server.getsockname()[1]}")
        sender.join()
    assert found["port"].status == "ok"
    assert failed(found) == {"sensor"}
    assert says in found["sensor"].text or "gone" in found["sensor"].text


def test_no_port_at_all(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.doctor.find_ports", list)
    found = {check.name: check for check in examine(case)}
    assert found["port"] == checks.NO_PORT


PORT = PortLook(path="/dev/ttyUSB0", group="dialout", user="ada")


@pytest.mark.parametrize(
    ("look", "cure"),
    [
        (replace(PORT, accessible=False), "sudo usermod -aG dialout ada, then log in again"),
        (replace(PORT, accessible=False, member=True), "log out and in again: the group is new"),
        (replace(PORT, accessible=False, group="root"), "udev"),
        (replace(PORT, holders=("ModemManager (7)",)), "systemctl disable --now ModemManager"),
        (replace(PORT, holders=("minicom (7)",)), "end that program first"),
        (replace(PORT, holders=("imumon (7)",)), "--connect"),
    ],
)
def test_a_port_that_may_not_be_used(look: PortLook, cure: str) -> None:
    bad = [check for check in checks.port(look) if check.status == "failed"]
    assert len(bad) == 1
    assert cure in str(bad[0].cure)


def test_the_latency_timer_is_read_where_there_is_one(tmp_path: Path) -> None:
    timer = tmp_path / "ttyUSB0" / "device" / "latency_timer"
    timer.parent.mkdir(parents=True)
    timer.write_text("16\n")
    look = with_latency(PORT, tmp_path)
    (slow,) = checks.latency(look)
    assert (slow.status, look.latency_ms) == ("warning", 16)
    assert "latency_timer" in str(slow.cure)
    (good,) = checks.latency(replace(look, latency_ms=1))
    assert good.status == "ok"
    assert list(checks.latency(with_latency(PORT, tmp_path / "none"))) == []


def test_a_port_without_permission_is_seen(tmp_path: Path) -> None:
    assert look_at_port("/dev/null").accessible
    assert not look_at_port(str(tmp_path / "none")).exists


# ---------------------------------------------------------------------- the other checks


HEARD = Heard(facts=Vn100Info(id="x", baud=115200, stream="deltas", sample_rate_hz=100.0), seconds=3.0)


@pytest.mark.parametrize(
    ("bytes_a_second", "status"), [(5000, "ok"), (10_000, "warning"), (11_300, "failed")]
)
def test_a_full_line_is_told(bytes_a_second: int, status: str) -> None:
    heard = replace(HEARD, bytes=3 * bytes_a_second, messages=9)
    found = {check.name: check for check in checks.sensor(heard, Settings())}
    assert found["bandwidth"].status == status


def test_a_slow_baud_is_told() -> None:
    heard = replace(HEARD, facts=replace(HEARD.facts, baud=9600))
    found = {check.name: check for check in checks.sensor(heard, Settings())}
    assert found["baud"].status == "warning"
    assert "--set-baud" in str(found["baud"].cure)


def test_compensated_deltas_are_told() -> None:
    facts = replace(HEARD.facts, settings={"82 delta control": "0,1,0,0,0"}, alias_factor=1.0)
    found = {check.name: check for check in checks.sensor(replace(HEARD, facts=facts), Settings())}
    assert found["compensation"].status == "warning"
    assert found["aliasing"].status == "ok"


@pytest.mark.parametrize(("ratio", "status"), [(1.0, "ok"), (0.99, "ok"), (1.2, "warning"), (0.5, "warning")])
def test_a_clock_that_runs_wrong_is_told(ratio: float, status: str) -> None:
    heard = replace(HEARD, samples=300, rate_hz=100.0, clock_ratio=ratio)
    found = {check.name: check for check in checks.sensor(heard, Settings())}
    assert found["clock"].status == status


@pytest.mark.parametrize(
    ("look", "status"),
    [
        (BusLook(free="tcp/127.0.0.1:7448"), "ok"),
        (BusLook(reports=(reports.report(),)), "ok"),
        (BusLook(fault="tcp/127.0.0.1:7448: is taken; choose another with --listen"), "failed"),
        (BusLook(free="tcp/0.0.0.0:7448", exposed=("tcp/0.0.0.0:7448",)), "warning"),
        (BusLook(free="tcp/127.0.0.1:7448", unreachable=("tcp/10.0.0.9:7447",)), "warning"),
        (BusLook(free="tcp/127.0.0.1:7448", reports=(reports.report(state="waiting"),)), "warning"),
    ],
)
def test_the_bus(look: BusLook, status: str) -> None:
    check = checks.zenoh(look)
    assert check.status == status
    assert (check.cure is None) == (status == "ok")


def test_a_sensor_that_its_daemon_has_lost_is_what_is_examined() -> None:
    lost = reports.report(state="waiting")
    look = BusLook(reports=(lost,))
    assert _candidates(look) == [lost.device.port]  # and not what else is plugged in
    told = f"{lost.device.id} answers, but waits for its sensor on {lost.device.port}"
    assert checks.zenoh(look).text == told
    other = reports.report(id="other")
    assert checks.zenoh(BusLook(reports=(other, lost))).text == f"{told}; other answers too"
    (check,) = checks.port(replace(PORT, exists=False, daemon=lost.device.id))
    assert check.status == "failed"
    assert f"{lost.device.id} waits for it" in check.text
    assert "plug" in str(check.cure)


def test_an_endpoint_that_is_taken_and_one_that_is_none(case: Case) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        for listen_at in (taken, "nonsense"):
            settings = replace(case.settings, zenoh=ZenohSettings(listen=(listen_at,)))
            found = {c.name: c for c in examine(replace(case, settings=settings, port="/dev/null0"))}
            assert found["zenoh"].status == "failed"
            assert found["zenoh"].cure


def test_the_state_directory(tmp_path: Path) -> None:
    assert checks.state(look_at_state(tmp_path / "new" / "one")).status == "ok"
    assert list(tmp_path.iterdir()) == []
    file = tmp_path / "file"
    file.write_text("")
    assert checks.state(look_at_state(file / "below")).status == "failed"
    assert checks.state(StateLook(path=tmp_path, writable=True, free_bytes=1000)).status == "warning"
    if os.getuid():
        tmp_path.chmod(0o500)
        assert checks.state(look_at_state(tmp_path)).status == "failed"
        tmp_path.chmod(0o700)


@pytest.mark.parametrize(
    ("look", "status"),
    [
        (ServiceLook(running=False), "ok"),
        (ServiceLook(running=True), "ok"),
        (ServiceLook(running=True, installed=True), "warning"),
        (ServiceLook(running=True, installed=True, units=(("imumon@ttyUSB0.service", "active"),)), "ok"),
        (ServiceLook(running=True, installed=True, units=(("imumon@ttyUSB0.service", "failed"),)), "failed"),
    ],
)
def test_the_service(look: ServiceLook, status: str) -> None:
    assert checks.service(look).status == status


# ---------------------------------------------------------------------- the command


def doctor(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "imumon", "doctor", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60, cwd=cwd)


def test_a_running_daemon_is_asked_and_not_disturbed(tmp_path: Path) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor, Daemon(sensor.path, tmp_path / "state") as daemon:
        before = daemon.samples()
        done = doctor("--port", sensor.path, "--connect", daemon.endpoint, "--json", cwd=tmp_path)
        after = daemon.wait(lambda r: r.session.samples > before.session.samples + 50)
        daemon.stop()
    told = json.loads(done.stdout)
    found = {check["name"]: check for check in told["checks"]}
    assert done.returncode == 0, done.stdout
    assert told["schema"] == "imumon.doctor/1"
    assert "asked instead" in found["holder"]["text"]
    assert found["rate"]["status"] == "ok"
    assert found["compensation"]["status"] == "ok"
    assert (after.session.missing, after.session.gaps, after.session.bad_checksums) == (0, 0, 0)


@pytest.fixture
def bad_config(tmp_path: Path) -> Path:
    file = tmp_path / "config.toml"
    file.write_text("[device]\nbuad = 9600\n\n[report]\nperiod_s = 0\n")
    return file


def test_faults_of_the_settings_are_one_check_of_many(bad_config: Path) -> None:
    done = doctor("--port", "/dev/none", cwd=bad_config.parent)
    lines = done.stdout.splitlines()
    assert done.returncode == 1
    assert done.stderr == ""
    assert lines[0].startswith("failed  config       config.toml:2: device.buad: no such setting")
    assert "(and 1 more)" in lines[0]
    assert all(line.split()[0] in ("ok", "warning", "failed") for line in lines)


def test_config_shows_origins_and_tells_faults(bad_config: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "imumon", "config"]

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*command, *words], capture_output=True, text=True, check=False, cwd=tmp_path)

    wrong = run("check")
    assert wrong.returncode == 2
    assert len(wrong.stderr.splitlines()) == 2
    good = tmp_path / "good.toml"
    good.write_text('[zenoh]\nuser = "ada"\npassword = "secret"\n')
    assert run("check", "--config", "good.toml").stdout == "good.toml: no faults\n"
    shown = run("show", "--config", "good.toml").stdout
    assert "good.toml:2" in shown
    assert "default" in shown
    assert "secret" not in shown
    (tmp_path / "shown.toml").write_text(shown)
    assert load(tmp_path / "shown.toml").zenoh.user == "ada"  # what is shown is itself a file of settings
