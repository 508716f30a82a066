"""The emulator on its pseudo-terminal, as clients see it."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import signal
import socket
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import forked
import numpy as np
import pytest
import serial
from waiting import until

from imumon.devices.vn100 import ascii
from imumon.devices.vn100.binary import BinaryLayout
from imumon.devices.vn100.decoder import Vn100Decoder
from imumon.devices.vn100.emulator import EmulatorProcess, EmulatorSettings, Noise, spawn
from imumon.devices.vn100.emulator.faults import Faults
from imumon.devices.vn100.emulator.main_loop import CATCH_UP
from imumon.devices.vn100.emulator.uart import OUTPUT_BUFFER, Uart
from imumon.devices.vn100.registers import BAUDS, REGISTERS
from imumon.samples import SampleBlock

WHITE = Noise((6.1e-5,) * 3, (0.0,) * 3, (0.0,) * 3)
TIME_AND_DELTAS = BinaryLayout.of({2: 0x0001, 3: 0x00C0})
TIME_MAGPRES_DELTAS = BinaryLayout.of({1: 0x0C01})


@contextlib.contextmanager
def emulator(**settings: object) -> Iterator[EmulatorProcess]:
    quick = {"seed": 7, "gyro": WHITE, "accel": WHITE, "mag": WHITE}
    with spawn(EmulatorSettings(**{**quick, **settings})) as process:  # type: ignore[arg-type]
        yield process


@pytest.fixture(scope="module")
def shared() -> Iterator[EmulatorProcess]:
    with emulator(rate=50) as process:
        yield process


@pytest.fixture
def sensor(shared: EmulatorProcess) -> Iterator[EmulatorProcess]:
    """A sensor with factory settings, but at 50 Hz; restored afterwards."""
    yield shared
    shared.ask("fault")
    with Client(shared.path) as client:
        for command in ("VNWRG,75,0,0,00", "VNWRG,06,14", "VNASY,1"):
            assert client.ask(command) == command


class Client:
    """A minimal client: it sends lines and searches the input for the reply.

    Parameters
    ----------
    check : checksum of its commands: ``xor``, ``crc`` or none (``XX``).
    """

    def __init__(self, path: str, baud: int = 115200, check: str = "xor") -> None:
        self.port = serial.Serial(path, baud, timeout=0.02)
        self._check = check

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.port.close()

    def send(self, body: str) -> None:
        line = b"$%s*XX\r\n" % body.encode() if self._check == "XX" else ascii.encode(body, self._check)  # type: ignore[arg-type]
        self.port.write(line)

    def ask(self, body: str, timeout: float = 1.0) -> str:
        """Reply to a command, without its frame; other input is discarded."""
        self.send(body)
        answer = self.wait_for(
            re.compile(rb"\$(%s(?:,[^*$]*)?|VNERR,..)\*\w+\r\n" % body[:5].encode()), timeout
        )
        return answer.group(1).decode()

    def wait_for(self, pattern: re.Pattern[bytes], timeout: float) -> re.Match[bytes]:
        received, end = b"", time.monotonic() + timeout
        while time.monotonic() < end:
            received += self.port.read(max(1, self.port.in_waiting))
            if match := pattern.search(received):
                return match
        raise AssertionError(f"no answer in {timeout} s; received {received[-200:]!r}")

    def collect(self, seconds: float) -> bytes:
        received, end = [], time.monotonic() + seconds
        while time.monotonic() < end:
            received.append(self.port.read(max(1, self.port.in_waiting)))
        return b"".join(received)

    def stream(self, *commands: str) -> None:
        """Switch the ASCII output off and send `commands`; discard the input before."""
        for command in ("VNASY,0", "VNWRG,06,0", *commands):
            assert not self.ask(command).startswith("VNERR")
        time.sleep(0.02)
        self.port.reset_input_buffer()
        self.ask("VNASY,1")


def packets(data: bytes, layout: BinaryLayout) -> np.ndarray:
    """Whole packets of a capture that begins and ends at any byte and contains nothing else."""
    start = data.index(layout.header)
    count = (len(data) - start) // layout.length
    assert layout.count_valid(data, start, count) == count
    return layout.decode(data, start, count)


def conserved(counters: dict[str, object]) -> bool:
    produced = sum(int(counters[name]) for name in ("made", "replies", "duplicated"))  # type: ignore[call-overload]
    accounted = ("sent", "lost", "dropped", "unheard", "overflowed", "queued")
    return produced == sum(int(counters[name]) for name in accounted)  # type: ignore[call-overload]


# ---------------------------------------------------------------- behaviour of other client software


def test_a_client_that_scans_and_writes_back_every_register(sensor: EmulatorProcess) -> None:
    # It sends unpadded ids with CRC16, pauses the streams, and increments the port of registers 5-7 until
    # error 07.
    with Client(sensor.path, check="crc") as client:
        assert client.ask("VNASY,0") == "VNASY,0"
        for number in range(256):
            if number in (5, 6, 7):
                answers = [client.ask(f"VNRRG,{number:02d},{port}") for port in (1, 2, 3)]
                assert answers[2] == "VNERR,07"
                assert [answer.split(",")[-1] for answer in answers[:2]] == ["1", "2"]
                continue
            answer = client.ask(f"VNRRG,{number}")
            if answer == "VNERR,08":
                continue
            written = client.ask("VNWRG" + answer[5:])
            assert written == ("VNWRG" + answer[5:] if REGISTERS[number].access == "setting" else "VNERR,09")
        assert client.ask("VNASY,1") == "VNASY,1"
        assert conserved(sensor.ask("counters"))


def test_a_client_scans_the_bauds_and_bytes_take_their_time() -> None:
    with emulator(baud=9600, rate=0) as sensor, Client(sensor.path) as client:
        baud = None
        for guess in (115200, 57600, 9600):
            client.port.baudrate = guess
            with contextlib.suppress(AssertionError):
                client.ask("VNRRG,01", timeout=0.2)
                baud = guess
                break
        assert baud == 9600
        start = time.monotonic()
        for _ in range(5):
            client.send("VNRRG,27")
        client.wait_for(re.compile(rb"(\$VNRRG,27,.*\r\n.*){5}", re.DOTALL), 30.0)
        assert time.monotonic() - start > 5 * 120 * 10 / 9600


def test_a_client_at_another_baud_reads_garbage(sensor: EmulatorProcess) -> None:
    with Client(sensor.path, 57600) as client:
        data = client.collect(0.3)
        assert data
        assert b"$VN" not in data
        decoder = Vn100Decoder()
        decoder.feed(data)
        assert decoder.messages == 0
        client.port.baudrate = 115200
        assert client.ask("VNRRG,01") == "VNRRG,01,VN-100T-CR"


def test_a_change_of_the_baud_is_answered_at_the_old_one() -> None:
    with emulator() as sensor, Client(sensor.path) as client:
        assert client.ask("VNWRG,05,921600") == "VNWRG,05,921600"
        time.sleep(0.05)
        client.port.baudrate = 921600
        assert client.ask("VNRRG,05") == "VNRRG,05,921600"
        assert sensor.ask("counters")["baud"] == 921600


@pytest.mark.parametrize(
    ("output", "layout", "rate"),
    [("VNWRG,75,1,4,06,0001,00C0", TIME_AND_DELTAS, 200), ("VNWRG,75,1,8,1,C01", TIME_MAGPRES_DELTAS, 100)],
)
def test_no_packet_is_lost_at_115200(
    sensor: EmulatorProcess, output: str, layout: BinaryLayout, rate: int
) -> None:
    with Client(sensor.path, check="XX") as client:
        client.stream(output)
        before = sensor.ask("counters")
        data = client.collect(1.5)
        received_packets = packets(data, layout)
        assert rate < len(received_packets) < 1.7 * rate  # a busy machine reads for less or more than 1.5 s
        name = next(name for name in layout.fields if name.endswith("timeStartup"))
        steps = np.diff(received_packets[name][:, 0].astype(np.int64))
        assert (np.abs(steps - 1e9 / rate) < 50_000).all()
        after = sensor.ask("counters")
        assert (before["dropped"], before["overflowed"]) == (after["dropped"], after["overflowed"])


def test_replies_are_sent_between_messages(sensor: EmulatorProcess) -> None:
    reply = b"$VNRRG,85,0,4,4,4,0,0,3,3,3,0*"
    with Client(sensor.path) as client:
        client.stream("VNWRG,75,1,4,06,0001,00C0")
        captured = b""
        for _ in range(20):
            client.send("VNRRG,85")
            captured += client.collect(0.05)
        end = time.monotonic() + 60.0  # a busy machine sends the last replies later
        while captured.count(reply) < 20 and time.monotonic() < end:
            captured += client.collect(0.05)
        decoder = Vn100Decoder()
        decoder.feed(captured[captured.index(TIME_AND_DELTAS.header) :])
        assert decoder.discarded == 0
        assert captured.count(reply) == 20


def test_a_repeated_command_is_answered_twice(sensor: EmulatorProcess) -> None:
    with Client(sensor.path) as client:
        client.send("VNRRG,01")
        client.send("VNRRG,01")
        client.wait_for(re.compile(rb"\$VNRRG,01,.*\r\n.*\$VNRRG,01,[^\n]*\r\n", re.DOTALL), 0.5)


# ---------------------------------------------------------------- connecting and disconnecting


def test_clients_may_disconnect_and_reconnect(sensor: EmulatorProcess) -> None:
    for _ in range(3):
        fd = os.open(sensor.path, os.O_RDWR | os.O_NOCTTY)
        fcntl.ioctl(fd, termios.TIOCEXCL)
        os.write(fd, b"$VNRR")
        time.sleep(0.02)
        os.close(fd)
    with Client(sensor.path) as client:
        assert client.ask("VNRRG,03") == "VNRRG,03,0100056785"


def test_a_client_that_does_not_read_loses_messages_and_nothing_hangs() -> None:
    with emulator(baud=921600, rate=800) as sensor, Client(sensor.path, 921600) as client:
        until(lambda: sensor.ask("counters")["dropped"] > 0)
        client.port.read(client.port.in_waiting)  # else the answer may be lost like the rest
        assert client.ask("VNRRG,01") == "VNRRG,01,VN-100T-CR"
        assert conserved(sensor.ask("counters"))


def test_a_stopped_emulator_loses_nothing_and_catches_up() -> None:
    with emulator(rate=400, baud=460800) as sensor, Client(sensor.path, 460800) as client:
        client.stream("VNWRG,75,1,2,06,0001,00C0")
        started = time.monotonic()
        received = client.collect(0.3)
        os.kill(sensor.pid, signal.SIGSTOP)
        time.sleep(2.0)  # 800 messages of 44 bytes, more than the terminal and the pending buffer hold
        os.kill(sensor.pid, signal.SIGCONT)
        first, rest = client.collect(0.5), client.collect(2.5)
        passed, counted = time.monotonic() - started, sensor.ask("counters")
    clock = packets(received + first + rest, TIME_AND_DELTAS)["2.timeStartup"][:, 0].astype(np.int64)
    assert counted["dropped"] == counted["overflowed"] == 0
    assert (np.abs(np.diff(clock) - 2_500_000) < 100_000).all()
    assert len(first) < 0.8 * CATCH_UP * 400 * 44
    assert len(clock) / 400 == pytest.approx(passed, abs=0.2)


def test_a_stopped_emulator_without_output_catches_up() -> None:
    def ahead(sensor: EmulatorProcess) -> float:
        return float(sensor.ask("counters")["ticks"]) / 800 - time.monotonic()

    with emulator(rate=0) as sensor:
        before = ahead(sensor)
        os.kill(sensor.pid, signal.SIGSTOP)
        time.sleep(1.0)
        os.kill(sensor.pid, signal.SIGCONT)
        until(lambda: ahead(sensor) > before - 0.1)


def test_a_new_client_reads_no_old_bytes() -> None:
    with emulator(baud=460800, rate=400) as sensor:
        until(lambda: sensor.ask("counters")["unheard"] > 100)
        for _ in range(2):  # the first closes while bytes arrive; the second reads none of them
            age = sensor.ask("counters")["ticks"] / 800
            fd = os.open(sensor.path, os.O_RDWR | os.O_NOCTTY)
            received = b""
            while len(received) < 1000:
                received += os.read(fd, 4096)
            os.close(fd)
            assert packets(received, TIME_AND_DELTAS)["2.timeStartup"][0, 0] / 1e9 > age + 0.5
            time.sleep(0.2)


def test_the_sensor_clock_follows_the_host_clock() -> None:
    with emulator(rate=800, baud=921600) as sensor:
        before, start = sensor.ask("counters")["ticks"], time.monotonic()
        time.sleep(0.8)
        after, end = sensor.ask("counters")["ticks"], time.monotonic()
        assert (after - before) / 800 == pytest.approx(end - start, abs=0.1)


def test_the_emulator_exits_with_its_parent(tmp_path: Path) -> None:
    code = "import time; from imumon.devices.vn100.emulator import spawn; print(spawn().pid, flush=True); "
    code += "time.sleep(60)"
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    until(
        lambda: (
            not Path(f"/proc/{child}").exists() or "Z" in Path(f"/proc/{child}/stat").read_text().split()[2]
        )
    )


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_signals_end_the_emulator_and_remove_the_link(number: int, code: int, tmp_path: Path) -> None:
    link = tmp_path / "vn100"
    command = [
        sys.executable,
        "-m",
        "imumon",
        "sim",
        "--link",
        str(link),
        "--control",
        str(tmp_path / "control"),
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    path = process.stdout.readline().strip()
    assert os.readlink(link) == path
    with socket.socket(socket.AF_UNIX) as control:
        control.connect(str(tmp_path / "control"))
        control.sendall(b"counters\nnonsense\n")
        answers = _lines(control, 2)
        assert answers[0]["path"] == path
        assert "error" in answers[1]
    process.send_signal(number)
    assert process.wait(60) == code
    assert not link.is_symlink()
    process.stdout.close()


def _lines(control: socket.socket, count: int) -> list[dict[str, object]]:
    held = b""
    while held.count(b"\n") < count:
        held += control.recv(4096)
    return [json.loads(line) for line in held.splitlines()]


def test_a_link_replaces_no_other_file(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.write_text("mine")
    (tmp_path / "linked").symlink_to(kept)
    for arguments in (["--link", str(kept)], ["--link", str(tmp_path / "linked")], ["--control", str(kept)]):
        done = forked.run("sim", *arguments)
        assert done.returncode == 2
        assert str(kept) in done.stderr
        assert done.stderr.count("\n") == 1
    assert kept.read_text() == "mine"


def test_a_link_to_a_used_terminal_is_kept_and_a_stale_one_is_replaced(tmp_path: Path) -> None:
    link = tmp_path / "vn100"
    with spawn(EmulatorSettings(seed=1, link=str(link))) as sensor:
        done = forked.run("sim", "--link", str(link))
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.count("\n") == 1
        assert f"{sensor.path} is in use" in done.stderr
        assert os.readlink(link) == sensor.path
        os.kill(sensor.pid, signal.SIGKILL)
        assert os.readlink(link) == sensor.path
        # The kernel gives the number of a closed terminal again, perhaps to another test at once:
        # this stale link names a terminal that no system has.
        link.unlink()
        link.symlink_to("/dev/pts/4000000000")
        with spawn(EmulatorSettings(seed=1, link=str(link))) as successor:
            assert os.readlink(link) == successor.path
            link.unlink()
            link.symlink_to("elsewhere")
    assert os.readlink(link) == "elsewhere"


def test_usage_errors_are_one_line() -> None:
    for arguments in (["--rate", "300"], ["--rate", "200", "--baud", "115200"]):
        done = forked.run("sim", *arguments)
        assert done.returncode != 0
        assert re.match(rf"imumon( sim)?: --rate {arguments[1]}", done.stderr)
        assert done.stderr.count("\n") == 1
        assert done.stdout == ""


@pytest.mark.parametrize("words", [(), ("--help",), ("--rate", "40")])
def test_the_process_of_the_emulator_is_no_command(words: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "imumon.devices.vn100.emulator", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.endswith("start one with imumon sim\n")
    assert done.stderr.count("\n") == 1


# ---------------------------------------------------------------- time-lapse


def test_time_lapse_waits_for_its_reader_and_loses_nothing() -> None:
    with emulator(speed=200, rate=0) as sensor, Client(sensor.path) as client:
        client.stream("VNWRG,75,1,8,06,0001,00C0")
        time.sleep(0.4)  # nothing reads: the sensor clock stops when the terminal is full
        data = client.collect(0.6)
        received_packets = packets(data, TIME_AND_DELTAS)
        steps = np.diff(received_packets["2.timeStartup"][:, 0].astype(np.int64))
        assert (np.abs(steps - 10_000_000) < 50_000).all()
        assert received_packets["3.deltaTheta"][1:, 0] == pytest.approx(
            np.full(len(received_packets) - 1, 0.01)
        )
        assert len(received_packets) > 2000
        assert client.ask("VNRRG,01") == "VNRRG,01,VN-100T-CR"
        counters = sensor.ask("counters")
        assert counters["dropped"] == counters["overflowed"] == 0


# ---------------------------------------------------------------- faults


def test_faults_have_their_probabilities() -> None:
    rng = np.random.default_rng(5)
    message = ascii.encode("VNYPR,+000.000,+000.000,+000.000")
    count = 5_000

    def arriving(**faults: float) -> list[bytes]:
        return [each for _ in range(count) for each in Faults(**faults).apply(message, rng)]

    assert len(arriving(drop=0.1)) == pytest.approx(0.9 * count, abs=5 * (0.09 * count) ** 0.5)
    assert len(arriving(duplicate=0.1)) == pytest.approx(1.1 * count, abs=5 * (0.09 * count) ** 0.5)
    decoder = Vn100Decoder()
    decoder.feed(b"".join(arriving(crc=1.0)))
    assert (decoder.messages, decoder.bad_checksums) == (0, count)
    assert {len(each) for each in arriving(cut=1.0)} == {len(message) // 2}
    changed = sum(a != b for each in arriving(corrupt=0.01) for a, b in zip(each, message, strict=True))
    assert changed == pytest.approx(0.01 * count * len(message), rel=0.05)


def test_damaged_messages_give_no_wrong_sample_and_are_counted() -> None:
    faults = Faults(drop=0.02, duplicate=0.02, cut=0.02, crc=0.02, corrupt=1e-4)
    with emulator(rate=50, faults=faults, speed=60) as sensor, Client(sensor.path) as client:
        data = client.collect(0.5)
        sensor.ask("fault")
        assert client.ask("VNRRG,01") == "VNRRG,01,VN-100T-CR"
        counters = sensor.ask("counters")
        assert conserved(counters)
        assert counters["lost"]
        assert counters["duplicated"]
    decoder = Vn100Decoder()
    items = [*decoder.feed(data), *decoder.finish()]
    assert decoder.messages * 1.0 == pytest.approx(data.count(b"$VNYMR") * 0.95, rel=0.05)
    for block in items:
        if isinstance(block, SampleBlock):
            accel = [i for i, name in enumerate(block.stream.channels) if name == "accel/z"]
            assert block.values[:, accel] == pytest.approx(-9.79, abs=0.3)


def test_wrong_checksums_for_some_time(sensor: EmulatorProcess) -> None:
    with Client(sensor.path) as client:
        sensor.ask("fault crc=1")
        client.port.reset_input_buffer()
        client.collect(0.05)
        decoder = Vn100Decoder()
        decoder.feed(client.collect(0.3))
        assert decoder.messages == 0
        assert decoder.bad_checksums > 5
        sensor.ask("fault")
        assert client.ask("VNRRG,01") == "VNRRG,01,VN-100T-CR"


def startup_times(client: Client, seconds: float) -> np.ndarray:
    return packets(client.collect(seconds), TIME_AND_DELTAS)["2.timeStartup"][:, 0].astype(np.int64)


def test_silence_stall_clock_jump_and_reboot() -> None:
    with emulator(rate=100, baud=460800) as sensor, Client(sensor.path, 460800) as client:
        client.stream("VNWRG,75,1,8,06,0001,00C0")
        time.sleep(0.1)
        sensor.ask("silence 0.3")
        steps = np.diff(startup_times(client, 0.6))
        assert 0.2e9 < steps.max() < 0.5e9
        assert conserved(sensor.ask("counters"))

        sensor.ask("stall 0.3")
        assert (np.diff(startup_times(client, 0.6)) < 11_000_000).all()

        time.sleep(0.1)
        sensor.ask("jump 5")
        assert 4.9e9 < np.diff(startup_times(client, 0.3)).max() < 5.1e9

        sensor.ask("reboot")
        client.wait_for(re.compile(rb"\$VNYMR"), 3.0)
        assert sensor.ask("counters")["restarts"] == 1


def test_a_truncated_message(sensor: EmulatorProcess) -> None:
    with Client(sensor.path) as client:
        client.collect(0.1)
        sensor.ask("cut")
        decoder = Vn100Decoder()
        decoder.feed(client.collect(0.3))
        assert decoder.discarded >= 61


def test_unplug_and_replug_under_another_name(tmp_path: Path) -> None:
    link = tmp_path / "vn100"
    with emulator(link=str(link)) as sensor, Client(sensor.path) as client:
        client.collect(0.05)
        sensor.ask("unplug")
        with pytest.raises((OSError, serial.SerialException)):
            client.collect(1.0)
        assert not link.is_symlink()
        path = sensor.ask("replug")["path"]
        assert path != sensor.path
        assert os.readlink(link) == path
        with Client(str(link)) as again:
            assert again.ask("VNRRG,03") == "VNRRG,03,0100056785"
        assert conserved(sensor.ask("counters"))


@pytest.mark.parametrize(("kind", "pattern"), [("nmea", rb"\$GPGGA,"), ("garbage", rb"."), ("silent", None)])
def test_foreign_devices(kind: str, pattern: bytes | None) -> None:
    with emulator(impostor=kind) as sensor, Client(sensor.path) as client:
        client.send("VNRRG,01")
        data = client.collect(0.4)
        assert b"VN" not in data
        assert bool(data) == (pattern is not None)
        assert pattern is None or re.search(pattern, data)


# ---------------------------------------------------------------- transmitter


@pytest.mark.parametrize("baud", BAUDS)
def test_a_message_takes_ten_bits_per_byte(baud: int) -> None:
    uart = Uart(baud)
    uart.queue(b"x" * 100, 0.0)
    uart.queue(b"y" * 50, 0.0)
    one, both = 1000 / baud, 1500 / baud
    assert uart.transmitted(one * 0.999) == []
    assert [message[:1] for message, _ in uart.transmitted(one * 1.001)] == [b"x"]
    assert uart.next_transmitted() == pytest.approx(both)
    assert [message[:1] for message, _ in uart.transmitted(both * 1.001)] == [b"y"]


def test_the_transmitter_buffers_two_kilobytes() -> None:
    uart = Uart(9600)
    for _ in range(100):
        uart.queue(b"z" * 100, 1.0)
    assert uart.overflowed == 100 - len(uart)
    assert len(uart) * 100 == pytest.approx(OUTPUT_BUFFER, abs=100)
