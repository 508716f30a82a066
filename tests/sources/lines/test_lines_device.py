"""Sensors that print lines, as a user runs them: serial, TCP, UDP, standard input, recordings."""

from __future__ import annotations

import json
import socket
import subprocess
import threading
import time
from collections import Counter
from contextlib import ExitStack, suppress
from pathlib import Path

import forked
import numpy as np
import pytest
from daemons import Daemon
from free_ports import free_endpoint, free_port
from line_sender import COLUMNS, LineSender, datagrams
from waiting import until

from imumon.model.samples import SampleBlock
from imumon.sources.device import DeviceLost, DeviceOptions
from imumon.sources.registry import driver
from imumon.sources.serial_port import SerialPort


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
PLAIN = "t_ms,gx,gy,gz,ax,ay,az"


@pytest.mark.few
@pytest.mark.parametrize("kind", ["pty", "tcp", "udp"])
def test_the_daemon_reads_lines_and_loses_none(kind: str, tmp_path: Path) -> None:
    with (
        LineSender(kind, tmp_path) as sender,  # type: ignore[arg-type]
        Daemon(sender.url, tmp_path / "state") as daemon,
    ):
        before = daemon.wait(lambda made: made.session.samples > 300).session.samples
        sender.lose_samples(3)
        sender.insert(b"half a li\n")
        made = daemon.wait(lambda made: made.session.samples > before + 500)
        assert made.device.sample_rate_hz == 200.0
        assert made.session.missing == 3
        assert made.session.bad_checksums == 1
        assert made.device.settings["columns"] == COLUMNS
        assert "a line is no sample" in " ".join(made.device.remarks)


def sent(sender: socket.socket, port: int, count: int, value: int) -> None:
    for _ in range(count):
        sender.sendto(b"%d\n" % value, ("127.0.0.1", port))


def test_of_two_senders_of_datagrams_the_first_is_the_sensor(monkeypatch: pytest.MonkeyPatch) -> None:
    """The lines of the other are counted. One that was started again has another port of the same address."""
    monkeypatch.setattr("imumon.sources.ports.SENDER_S", 60.0)
    port = free_port()
    with SerialPort(f"udp://:{port}") as reader, ExitStack() as sockets:
        first, other, far = (
            sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(3)
        )
        far.bind(("127.0.0.2", 0))
        for _ in range(50):
            sent(first, port, 3, 1)
            sent(other, port, 2, 2)
            sent(far, port, 1, 3)
        assert received(reader, 150) == {b"1": 150}
        assert until(lambda: reader.other_lines == 150)
        assert reader.other_sender == f"127.0.0.1 port {other.getsockname()[1]}"
        assert reader.has_rival
        monkeypatch.setattr("imumon.sources.ports.RIVAL_S", 0.1)
        assert until(lambda: not reader.has_rival)
        monkeypatch.setattr("imumon.sources.ports.SENDER_S", 0.0)
        sent(far, port, 10, 3)  # of another address: it never follows
        sent(other, port, 10, 2)
        assert received(reader, 10) == {b"2": 10}


def received(reader: SerialPort, lines: int) -> Counter[bytes]:
    """How often each line has arrived, of so many."""
    data, end = b"", time.monotonic() + 60.0
    while data.count(b"\n") < lines and time.monotonic() < end:
        data += reader.read(0.1)
    return Counter(data.split())


def test_the_address_of_the_sender_may_be_given(tmp_path: Path) -> None:
    """The report and the log name the other one once, and its lines are no samples."""
    with (
        LineSender("udp", tmp_path) as sender,
        datagrams(sender.port, b"1,5,5,5,5,5,5\n", host="127.0.0.2"),
        Daemon(sender.url.replace("?", "?from=127.0.0.1&"), tmp_path / "state", "--no-guards") as daemon,
    ):
        made = daemon.wait(
            lambda made: made.session.samples > 200 and "127.0.0.2" in " ".join(made.device.remarks)
        )
        assert daemon.log.count("another sender") == 1
    assert abs(made.channels["gyro/x"].mean) < 0.1


def test_the_end_of_standard_input_ends_the_run_with_its_report(tmp_path: Path) -> None:
    done = run(tmp_path, "--port", f"lines:-?columns={PLAIN}&{MILLI}", text=lines(1000) + b"oops\n")
    assert done.returncode == 0, done.stderr
    made = json.loads(done.stdout)
    assert made["session"]["samples"] == 1000
    assert made["session"]["missing"] == 0
    assert made["session"]["bad_checksums"] == 1
    assert made["device"]["sample_rate_hz"] == 100.0
    assert made["state"] == "stopped"
    assert made["channels"]["gyro/y"]["mean"] == pytest.approx(2e-3)


@pytest.mark.few
@pytest.mark.parametrize("text", [b"no numbers\n" * 10, b""])
def test_standard_input_without_a_sample_is_an_error(text: bytes, tmp_path: Path) -> None:
    done = run(tmp_path, "--port", "lines:-", text=text)
    assert done.returncode == 3
    assert error_of(done) == "stream_without_samples"


@pytest.mark.few
@pytest.mark.parametrize("sent", [b"no numbers\n", b""])
def test_a_run_without_a_sample_in_its_time_is_an_error(sent: bytes, tmp_path: Path) -> None:
    """Nobody ends the stream: the time does, whether nothing arrives or nothing that is a sample."""
    port = free_port()
    with datagrams(port, sent):
        done = run(tmp_path, "--port", f"lines:udp://:{port}", "--duration", "2", text=b"")
    assert (done.returncode, error_of(done)) == (4, "no_samples_in_time")


def test_lines_that_are_no_samples_are_an_error_that_proposes_their_columns(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = rng.normal((0.0, 0.0, 1.0, 25.0), 1e-3, (60, 4))
    text = "".join(f"{10 * k},{','.join(map(str, row))}\n" for k, row in enumerate(rows.tolist()))
    done = run(tmp_path, "--port", "lines:-", text=text.encode())
    assert (done.returncode, error_of(done)) == (3, "stream_without_samples")
    assert "map=accel=2,3,4:g,t=1:ms" in done.stderr
    done = run(tmp_path, "--port", "lines:-?columns=t_ms,ax,ay,az,-&accel=g", text=text.encode())
    assert (done.returncode, json.loads(done.stdout)["session"]["samples"]) == (0, 60)


def test_lines_without_a_time_need_a_rate(tmp_path: Path) -> None:
    words = ("--port", f"lines:-?columns=gx,gy,gz,ax,ay,az&{MILLI}")
    done = run(tmp_path, *words, text=lines(1000, time=False))
    assert (done.returncode, error_of(done)) == (2, "rate_required")
    done = run(tmp_path, *words, "--rate", "50", text=lines(1000, time=False))
    assert json.loads(done.stdout)["device"]["sample_rate_hz"] == 50.0


def test_a_recording_is_replayed_with_the_same_numbers(tmp_path: Path) -> None:
    capture, header = tmp_path / "capture", b"millis,gx,gy,gz,ax,ay,az\n"
    url = f"lines:-?columns={PLAIN}&{MILLI}"
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


def test_the_first_line_of_a_port_may_be_half_of_one(tmp_path: Path) -> None:
    """A half line may have all columns: only its first number is short."""
    with LineSender("tcp", tmp_path, rate_hz=1000.0) as sender:
        device = driver("lines").create(DeviceOptions(url=sender.url))
        sender.insert(b"2345,1,2,3,4,5,6\n")
        device.open()
        device.start()
        while not (blocks := [i for i in device.read(0.1) if hasattr(i, "values")]):
            pass
        assert abs(blocks[0].values).max() < 0.1
        device.close()


def test_a_header_that_a_server_sends_first_is_used() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            client, _ = server.accept()
            with client:
                client.sendall(b"Booting v1.2\r\ntime_ms,gyro_x_rps,gyro_y_rps,gyro_z_rps,battery\r\n")
                client.sendall(b"".join(b"%d,%d,2,3,3.7\r\n" % (10 * k, k % 2) for k in range(300)))

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
    assert device.counters.other_sender == 0
    assert device.info().source == "lines of time_ms,gyro_x_rps,gyro_y_rps,gyro_z_rps,-"
    device.close()


@pytest.mark.few
@pytest.mark.parametrize("wrong", ["columns=t_ms,gx,gy,gz,ax,ay,az", "columns=-,gx,gy,gz,ax,ay,az&rate=50"])
def test_a_wrong_unit_of_the_time_or_a_wrong_rate_is_doubted(
    wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("imumon.sources.port_device.RATE_SHORTEST_S", 1.0)
    with LineSender("pty", tmp_path) as sender:
        device = driver("lines").create(DeviceOptions(url=f"lines:{sender.path}?{wrong}"))
        device.open()
        device.start()
        told = "the time of the lines advances by" if "t_ms" in wrong else "not at the configured 50 Hz"
        until(lambda: (device.read(0.1), any(told in remark for remark in device.info().remarks))[1])
        assert "doubtful_rate" in device.info().caveats
        if "t_ms" in wrong:
            assert any("check its unit in the URL" in remark for remark in device.info().remarks)
        device.close()


def test_a_full_queue_does_not_join_two_halves(tmp_path: Path) -> None:
    with (
        LineSender("pty", tmp_path, rate_hz=5000.0) as sender,
        SerialPort(sender.path, queue_bytes=2000, mark=b"\n?") as port,
    ):
        until(lambda: port.dropped_bytes > 0)
        data = [port.read(0.1)]
        until(lambda: data.append(port.read(0.1)) or b"\n?" in b"".join(data))
