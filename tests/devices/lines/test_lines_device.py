"""Sensors that print lines, as a user runs them: serial, TCP, UDP, standard input, recordings."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import forked
import pytest
from daemons import Daemon, free_endpoint
from line_sender import COLUMNS, LineSender
from waiting import until

from imumon.devices.base import DeviceEnded, DeviceLost, DeviceOptions
from imumon.devices.registry import driver
from imumon.devices.serial_port import SerialPort
from imumon.samples import SampleBlock


def run(state: Path, *words: str, text: bytes) -> subprocess.CompletedProcess[str]:
    words = ("run", *words, "--state", str(state), "--listen", free_endpoint(), "--json")
    return forked.run(*words, text=text)


def error_of(done: subprocess.CompletedProcess[str]) -> str:
    """Code of the error, which is the last line."""
    code: str = json.loads(done.stderr.splitlines()[-1])["error"]["code"]
    return code


def lines(count: int, time: bool = True) -> bytes:
    stamp = (lambda k: b"%d," % (10 * k)) if time else (lambda k: b"")
    return b"".join(
        stamp(k) + b"%d,2,%d,0,%d,9810\n" % (k * 7 % 5, k * 3 % 7, k * 5 % 11) for k in range(count)
    )


MILLI = "gyro=mrad/s&accel=mg"


@pytest.mark.parametrize("kind", ["pty", "tcp", "udp"])
def test_the_daemon_reads_lines_and_loses_none(kind: str, tmp_path: Path) -> None:
    sender = LineSender(kind, tmp_path)  # type: ignore[arg-type]
    try:
        with Daemon(sender.url, tmp_path / "state", "--duration", "60") as daemon:
            before = daemon.wait(lambda made: made.session.samples > 300).session.samples
            sender.lose_samples(3)
            sender.insert(b"half a li\n")
            made = daemon.wait(lambda made: made.session.samples > before + 500)
            assert made.device.sample_rate_hz == 200.0
            assert made.session.missing == 3
            assert made.session.bad_checksums == 1
            assert made.device.settings["columns"] == COLUMNS
            assert "a line is no sample" in " ".join(made.device.remarks)
    finally:
        sender.close()


def test_the_end_of_standard_input_ends_the_run_with_its_report(tmp_path: Path) -> None:
    done = run(tmp_path, "--port", f"lines:-?{MILLI}", text=lines(1000) + b"oops\n")
    assert done.returncode == 0, done.stderr
    made = json.loads(done.stdout)
    assert made["session"]["samples"] == 1000
    assert made["session"]["missing"] == 0
    assert made["session"]["bad_checksums"] == 1
    assert made["device"]["sample_rate_hz"] == 100.0
    assert made["state"] == "stopped"
    assert made["channels"]["gyro/y"]["mean"] == pytest.approx(2e-3)


@pytest.mark.parametrize("text", [b"", b"no numbers\n" * 10])
def test_standard_input_without_a_sample_is_an_error(text: bytes, tmp_path: Path) -> None:
    done = run(tmp_path, "--port", "lines:-", text=text)
    assert done.returncode == 3
    assert error_of(done) == "stream_without_samples"


@pytest.mark.parametrize("given", ["option", "parameter", "nothing", "file"])
def test_lines_without_a_time_need_a_rate(given: str, tmp_path: Path) -> None:
    config = tmp_path / "config.toml"
    config.write_text("[device]\nrate_hz = 50.0\n" if given == "file" else "")
    url = f"lines:-?columns=gx,gy,gz,ax,ay,az&{MILLI}{'&rate=50' if given == 'parameter' else ''}"
    words = ["--port", url, "--config", str(config), *(["--rate", "50"] if given == "option" else [])]
    done = run(tmp_path, *words, text=lines(1000, time=False))
    if given == "nothing":
        assert done.returncode == 2
        assert error_of(done) == "rate_required"
        return
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["device"]["sample_rate_hz"] == 50.0


def test_a_recording_is_replayed_with_the_same_numbers(tmp_path: Path) -> None:
    capture, header = tmp_path / "capture", b"millis,gx,gy,gz,ax,ay,az\n"
    url = f"lines:-?{MILLI}"
    live = run(tmp_path, "--port", url, "--record", str(capture), text=header + lines(3000) + b"bad\n")
    replayed = forked.run("replay", str(capture), "--json")
    assert replayed.returncode == 0, replayed.stderr
    one, other = json.loads(live.stdout), json.loads(replayed.stdout)
    assert capture.read_bytes().endswith(header + lines(3000) + b"bad\n")
    assert other["session"]["samples"] == one["session"]["samples"] == 3000
    for name, channel in one["channels"].items():
        assert other["channels"][name]["mean"] == channel["mean"]
        assert other["channels"][name]["N"] == channel["N"]
    assert other["session"]["bad_checksums"] == 1


def test_what_a_line_cannot_use_is_refused(tmp_path: Path) -> None:
    done = forked.run("run", "--port", "lines:-", "--set-baud", "9600", "--state", str(tmp_path))
    assert done.returncode == 2
    assert "lines:- cannot use --set-baud" in done.stderr


def test_a_url_that_is_wrong_is_one_line(tmp_path: Path) -> None:
    done = forked.run("run", "--port", "lines:/dev/x?columns=gx,speed", "--state", str(tmp_path))
    assert done.returncode == 2
    assert done.stderr.startswith("imumon: ")
    assert done.stderr.count("\n") == 1


def test_the_first_line_of_a_port_may_be_half_of_one(tmp_path: Path) -> None:
    """A half line may have all columns: only its first number is short."""
    sender = LineSender("tcp", tmp_path, rate_hz=1000.0)
    try:
        device = driver("lines").create(DeviceOptions(url=sender.url))
        sender.insert(b"2345,1,2,3,4,5,6\n")
        device.open()
        device.start()
        while not (blocks := [i for i in device.read(0.1) if hasattr(i, "values")]):
            pass
        assert abs(blocks[0].values).max() < 0.1
        device.close()
    finally:
        sender.close()


def test_a_header_that_a_server_sends_first_is_used() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            client, _ = server.accept()
            with client:
                client.sendall(b"Booting v1.2\r\ntime_ms,gyro_x,gyro_y,gyro_z,battery\r\n")
                client.sendall(b"".join(b"%d,1,2,3,3.7\r\n" % (10 * k) for k in range(300)))
                time.sleep(0.5)

        thread = threading.Thread(target=serve)
        thread.start()
        device = driver("lines").create(DeviceOptions(url=f"lines:tcp://127.0.0.1:{server.getsockname()[1]}"))
        device.open()
        device.start()
        count = 0
        with suppress(DeviceLost):
            while True:
                count += sum(len(item) for item in device.read(0.2) if isinstance(item, SampleBlock))
        thread.join()
    assert count == 300
    assert device.counters.bad_checksums == 1
    assert device.info().source == "lines of time_ms,gyro_x,gyro_y,gyro_z,-"
    device.close()


@pytest.mark.parametrize("wrong", ["columns=t_ms,gx,gy,gz,ax,ay,az", "columns=-,gx,gy,gz,ax,ay,az&rate=50"])
def test_a_wrong_unit_of_the_time_or_a_wrong_rate_is_doubted(
    wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("imumon.devices.lines.lines_device.CLOCK_S", 1.0)
    monkeypatch.setattr("imumon.devices.port_device.RATE_SHORTEST_S", 1.0)
    sender = LineSender("pty", tmp_path)
    try:
        device = driver("lines").create(DeviceOptions(url=f"lines:{tmp_path / 'board'}?{wrong}"))
        device.open()
        device.start()
        told = "the time of the lines advances by" if "t_ms" in wrong else "not at the configured 50 Hz"
        until(lambda: (device.read(0.1), any(told in remark for remark in device.info().remarks))[1])
        device.close()
    finally:
        sender.close()


def test_a_full_queue_does_not_join_two_halves(tmp_path: Path) -> None:
    sender = LineSender("pty", tmp_path, rate_hz=5000.0)
    try:
        with SerialPort(str(tmp_path / "board"), queue_bytes=2000, mark=b"\n?") as port:
            until(lambda: port.dropped_bytes > 0)
            data = [port.read(0.1)]
            until(lambda: data.append(port.read(0.1)) or b"\n?" in b"".join(data))
    finally:
        sender.close()


def test_a_port_that_is_only_read_ends(tmp_path: Path) -> None:
    script = (
        "from imumon.devices.base import *; from imumon.devices.registry import driver\n"
        "d = driver('lines').create(DeviceOptions(url='lines:-')); d.open(); d.start(); n = 0\n"
        "try:\n    while True: n += sum(len(i) for i in d.read(0.2) if hasattr(i, 'values'))\n"
        "except DeviceEnded: print(n)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], input=lines(100_000), capture_output=True, timeout=60, check=False
    )
    assert done.stdout == b"100000\n", done.stderr
    assert issubclass(DeviceEnded, Exception)
