"""Sources: ports that behave and ports that do not, recordings and what is left of damaged ones."""

from __future__ import annotations

import contextlib
import fcntl
import gzip
import os
import pty
import random
import socket
import subprocess
import sys
import termios
import threading
import time
import tty
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from imumon.daemon.connection import _others
from imumon.devices import serial_port as port_module
from imumon.recordings import (
    CaptureWriter,
    PortError,
    PortGone,
    PortInfo,
    RawCapture,
    SerialPort,
    SourceError,
    find_again,
    holders,
    read_file,
)
from imumon.recordings.raw_capture import part_path


def wait_for(condition: Callable[[], object], seconds: float = 5.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not come about in time"
        time.sleep(0.002)


def gather(port: SerialPort, size: int, seconds: float = 5.0) -> bytes:
    """So many bytes from a port."""
    data, deadline = b"", time.monotonic() + seconds
    while len(data) < size and time.monotonic() < deadline:
        data += port.read(0.1)
    return data


@dataclass
class Line:
    """The two ends of a pseudo-terminal."""

    master: int
    slave: int
    path: str

    def unplug(self) -> None:
        os.close(self.slave)
        os.close(self.master)
        self.master = self.slave = -1


@pytest.fixture
def line() -> Iterator[Line]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    ends = Line(master, slave, os.ttyname(slave))
    yield ends
    if ends.master >= 0:
        ends.unplug()


# ---------------------------------------------------------------------- ports


def test_bytes_go_both_ways_unchanged(line: Line) -> None:
    every = bytes(range(256)) * 4
    with SerialPort(line.path) as port:
        os.write(line.master, every)
        assert gather(port, len(every)) == every
        port.write(every)
        got = b""
        while len(got) < len(every):
            got += os.read(line.master, 4096)
        assert got == every
        assert port.received_bytes == len(every)
        assert port.dropped_bytes == port.overruns == 0
        assert port.kernel_overruns is None, "a pseudo-terminal counts none, which is not the same as none"


def test_read_without_bytes_waits_as_long_as_asked_and_no_longer(line: Line) -> None:
    with SerialPort(line.path) as port:
        begun = time.monotonic()
        assert port.read(0.05) == b""
        assert port.read(0.0) == b""
        assert 0.04 < time.monotonic() - begun < 1.0


@pytest.mark.parametrize("baud", [9600, 115200, 128000, 921600])
def test_baud_is_that_of_the_terminal(line: Line, baud: int) -> None:
    with SerialPort(line.path, 57600) as port:
        assert port.set_baud(baud)
        assert port.baud == baud
        speed = termios.tcgetattr(line.slave)[5]
        known = getattr(termios, f"B{baud}", None)
        assert speed == known if known is not None else port_module._actual_baud(line.slave) == baud


def test_baud_that_the_adapter_rounds_is_refused_and_the_old_one_stays(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SerialPort(line.path, 115200) as port:
        actual = port_module._actual_baud
        monkeypatch.setattr(port_module, "_actual_baud", lambda fd: min(actual(fd) or 0, 460800))
        assert not port.set_baud(921600)
        assert port.baud == 115200
        assert actual(line.slave) == 115200
        with pytest.raises(PortError, match=r"cannot do 921600 baud: choose another --baud"):
            SerialPort.__init__(port, _second_name(line), 921600)


def _second_name(line: Line) -> str:
    """Another terminal, so that the first one's lock is not in the way."""
    master, slave = pty.openpty()
    os.dup2(slave, line.slave)
    os.dup2(master, line.master)
    return os.ttyname(line.slave)


def test_changing_the_baud_forgets_what_was_received(line: Line) -> None:
    with SerialPort(line.path) as port:
        os.write(line.master, b"old")
        wait_for(lambda: port.received_bytes == 3)
        assert port.set_baud(9600)
        os.write(line.master, b"new")
        assert gather(port, 3) == b"new"


def test_changing_the_baud_amid_a_stream_is_no_unplugging(line: Line) -> None:
    with SerialPort(line.path) as port:
        stop = threading.Event()

        def stream() -> None:
            while not stop.is_set():
                os.write(line.master, bytes(64))
                time.sleep(0)

        sender = threading.Thread(target=stream)
        sender.start()
        for turn in range(300):
            assert port.set_baud((9600, 115200)[turn % 2])
            port.write(b"x")
        stop.set()
        assert not port.gone
        while sender.is_alive():
            port.read(0.01)
        sender.join()


def test_unplugging_is_gone_after_the_last_byte(line: Line) -> None:
    with SerialPort(line.path) as port:
        os.write(line.master, b"last")
        wait_for(lambda: port.received_bytes == 4)
        line.unplug()
        wait_for(lambda: port.gone)
        assert port.read(0.1) == b"last"
        with pytest.raises(PortGone, match="unplugged"):
            port.read(1.0)
        with pytest.raises(PortGone, match="unplugged"):
            port.write(b"x")
        with pytest.raises(PortGone):
            port.set_baud(9600)
        with pytest.raises(PortGone):
            port.reopen()


def test_reopening_goes_on_with_the_same_baud(line: Line) -> None:
    with SerialPort(line.path, 230400) as port:
        port.reopen()
        os.write(line.master, b"again")
        assert gather(port, 5) == b"again"
        assert port.baud == 230400


def test_reading_goes_on_while_nobody_asks(line: Line) -> None:
    size = 1 << 20
    with SerialPort(line.path, 921600) as port:
        sender = threading.Thread(target=_send, args=(line.master, bytes(size)))
        sender.start()
        wait_for(lambda: port.received_bytes == size, 20.0)
        assert port.most_queued == size
        first = port.read(0.1)
        assert 0 < len(first) < 1 << 17, "after a stall memory must not grow by what has gathered"
        assert len(gather(port, size - len(first))) == size - len(first)
        assert port.overruns == 0
        sender.join()


def _send(fd: int, data: bytes) -> None:
    while data:
        data = data[os.write(fd, data[:4096]) :]


def test_full_queue_drops_counts_and_goes_on(line: Line) -> None:
    with SerialPort(line.path, queue_bytes=1000) as port:
        for _ in range(40):
            before = port.received_bytes
            os.write(line.master, bytes(100))
            wait_for(lambda before=before: port.received_bytes == before + 100)
        kept = port.read(0.1)
        assert len(kept) + port.dropped_bytes == 4000
        assert len(kept) <= 1000
        assert port.overruns == 1, "one episode, however many bytes"
        os.write(line.master, b"after")
        assert gather(port, 5) == b"after"


def test_lossless_port_makes_the_far_end_wait(line: Line) -> None:
    with SerialPort(line.path, queue_bytes=4096, lossless=True) as port:
        size = 1 << 18
        sender = threading.Thread(target=_send, args=(line.master, bytes(size)))
        sender.start()
        time.sleep(0.05)
        assert len(gather(port, size)) == size
        assert port.overruns == port.dropped_bytes == 0
        sender.join()


def test_socket_is_a_port() -> None:
    server = socket.create_server(("127.0.0.1", 0))
    with server, SerialPort(f"socket://127.0.0.1:{server.getsockname()[1]}") as port:
        far, _ = server.accept()
        assert port.fixed_baud
        far.sendall(b"hello")
        assert gather(port, 5) == b"hello"
        port.write(b"ho")
        assert far.recv(10) == b"ho"
        far.close()
        with pytest.raises(PortGone):
            gather(port, 1)


def test_what_is_no_port_is_one_line_with_a_cure(tmp_path: Path, line: Line) -> None:
    file = tmp_path / "run.bin"
    file.write_bytes(b"x")
    for path, said in {
        str(tmp_path / "ttyUSB9"): "no port .*: (there is|no serial port found)",
        str(tmp_path): "is a directory, not a serial port",
        str(file): "is a file, not a serial port; .*imumon replay",
        "/dev/null": "is not a serial port",
        "socket://127.0.0.1:1": "is the server running",
        "what://ever": "is the server running, and the URL right",
        "bad\0name": "no port",
    }.items():
        with pytest.raises(PortError, match=said) as refused:
            SerialPort(path)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("url", ["socket://", "socket://host", "socket://:", "rfc2217://host:port"])
def test_a_url_without_a_host_or_port_says_what_to_write(url: str) -> None:
    with pytest.raises(PortError, match="HOST:PORT"):
        SerialPort(url, 115200)


def test_no_permission_says_how_to_get_it() -> None:
    refused = port_module._refusal("/dev/null", PermissionError(13, "Permission denied"))
    assert refused.startswith("no permission for /dev/null: sudo usermod -aG dialout ")


def test_a_user_without_a_name_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("USER", "LOGNAME", "LNAME", "USERNAME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", lambda _: {}["nobody"])
    refused = port_module._refusal("/dev/null", PermissionError(13, "Permission denied"))
    assert "usermod -aG dialout $USER, then" in refused


def test_port_that_vanishes_while_opening_says_so(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    real = port_module.pyserial.Serial

    def unplugged(*args: object, **kwargs: object) -> object:
        opened = real(*args, **kwargs)
        line.unplug()
        return opened

    monkeypatch.setattr(port_module.pyserial, "Serial", unplugged)
    with pytest.raises(PortError, match="while it was being opened"):
        SerialPort(line.path)


def test_port_in_use_names_who_has_it(line: Line) -> None:
    code = (
        "import fcntl, os, sys; fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY);"
        "fcntl.flock(fd, fcntl.LOCK_EX); print('locked', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, line.path]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert other.stdout is not None
        other.stdout.readline()
        assert any(f"({other.pid})" in holder for holder in holders(line.path))
        with pytest.raises(PortError, match=rf"in use by .*\({other.pid}\).*: end that program first"):
            SerialPort(line.path)
    finally:
        other.kill()
        other.communicate()
    SerialPort(line.path).close()


def test_who_else_reads_a_port_that_gives_nothing_is_named(tmp_path: Path) -> None:
    place = tmp_path / "port"
    place.touch()
    assert _others(str(place)) == ""
    with place.open() as file, subprocess.Popen(["sleep", "60"], stdin=file) as other:
        said = _others(str(place))
        other.kill()
    assert said == f"; sleep ({other.pid}) has it open too: end that program first"


def test_a_port_is_ours_alone(line: Line) -> None:
    with SerialPort(line.path):
        fd = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
        with pytest.raises(BlockingIOError):
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.close(fd)


def test_a_replugged_adapter_is_known_by_its_serial_number(tmp_path: Path) -> None:
    here = str(tmp_path)  # stands for a path that exists
    ours, other = (0x0403, 0x6001, "FT1"), (0x0403, 0x6001, "FT2")
    before = [PortInfo("/dev/ttyUSB7", "", ours), PortInfo("/dev/ttyUSB8", "", other)]
    now = [PortInfo("/dev/ttyUSB8", "", other), PortInfo("/dev/ttyUSB9", "", ours)]
    assert find_again("/dev/ttyUSB7", before, now) == ["/dev/ttyUSB9"]
    assert find_again(here, [PortInfo(here, "", ours)], now) == [here, "/dev/ttyUSB9"]
    assert find_again("/dev/ttyS99", [PortInfo("/dev/ttyS99", "", None)], now) == []
    assert find_again("socket://a:1", [], now) == ["socket://a:1"]


# ---------------------------------------------------------------------- recordings


def contents(path: Path | str) -> bytes:
    return b"".join(read_file(str(path)))


@pytest.fixture(scope="module")
def noise() -> bytes:
    return random.Random(5).randbytes(700_000)


@pytest.mark.parametrize("name", ["run.bin", "run.bin.gz"])
@pytest.mark.parametrize("rotate", [0, 100_000])
def test_what_is_recorded_is_read_back(tmp_path: Path, noise: bytes, name: str, rotate: int) -> None:
    path = str(tmp_path / name)
    recorder = CaptureWriter(
        path, {"time": "2026-01-01T00:00:00Z", "serial": "0100056785"}, rotate_bytes=rotate
    )
    for at in range(0, len(noise), 70_000):
        recorder.write(noise[at : at + 70_000])
        if rotate:
            wait_for(lambda at=at: recorder.written_bytes >= at)
    recorder.close()
    assert recorder.stopped is None
    assert recorder.written_bytes == len(noise)
    recording = RawCapture(path)
    assert recording.header is not None
    assert recording.header["serial"] == "0100056785"
    assert b"".join(recording) == noise
    assert recording.problem is None
    assert recording.progress == 1.0


@pytest.fixture(autouse=True)
def _brisk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write through at once: these tests wait for what is on disk."""
    monkeypatch.setattr("imumon.recordings.capture_writer.FLUSH_S", 0.01)


def test_rotation_makes_numbered_parts_that_follow_by_themselves(tmp_path: Path) -> None:
    path = str(tmp_path / "run.bin")
    recorder = CaptureWriter(path, {}, rotate_bytes=10)
    for number in range(5):
        recorder.write(b"%d-------" % number)
        wait_for(lambda number=number: recorder.written_bytes == 8 * (number + 1))
    recorder.close()
    assert sorted(os.listdir(tmp_path)) == [*(f"run.000{i}.bin" for i in range(1, 5)), "run.bin"]
    assert contents(path) == b"".join(b"%d-------" % number for number in range(5))
    assert contents(part_path(path, 3)) == b"3-------4-------"


def test_an_old_recording_is_never_overwritten_nor_mixed_in(tmp_path: Path) -> None:
    path = str(tmp_path / "run.bin")
    for words in (b"first", b"second"):
        recorder = CaptureWriter(path, {})
        recorder.write(words)
        recorder.close()
    assert contents(path) == b"first"
    assert contents(tmp_path / "run.0001.bin") == b"second"


@pytest.mark.parametrize("name", ["run.bin", "run.bin.gz"])
def test_a_recording_that_is_removed_goes_on_in_its_next_part(tmp_path: Path, name: str) -> None:
    recorder = CaptureWriter(str(tmp_path / name), {})
    (tmp_path / name).unlink()
    recorder.write(b"what comes next")
    recorder.close()
    assert recorder.stopped is None
    assert contents(part_path(str(tmp_path / name), 1)) == b"what comes next"


def test_a_pipe_that_nobody_reads_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(SourceError, match="nobody reads that pipe"):
        CaptureWriter(str(tmp_path / "pipe"), {})


def test_full_disk_ends_the_recording_and_nothing_else() -> None:
    with pytest.raises(SourceError, match=r"cannot record to /dev/full: no space left on device"):
        CaptureWriter("/dev/full", {})


def test_disk_that_fills_up_ends_the_recording_and_says_so(tmp_path: Path) -> None:
    code = """
import resource, signal, sys, time
from imumon.recordings import Recorder
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
recorder = Recorder(sys.argv[1], {})
begun = time.monotonic()
while recorder.stopped is None and time.monotonic() < begun + 10:
    recorder.write(bytes(1000))
    time.sleep(0.01)
recorder.write(b"ignored")
recorder.close()
print(recorder.stopped)
"""
    path = tmp_path / "run.bin"
    said = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert "has ended: file too large; " in said.stdout
    assert 0 < len(contents(path)) <= 5000


def test_slow_disk_never_holds_up_the_reading(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.recordings.capture_writer.BACKLOG", 10_000)
    fifo = tmp_path / "slow"
    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    recorder = CaptureWriter(str(fifo), {})
    longest = 0.0
    for _ in range(200):
        begun = time.monotonic()
        recorder.write(bytes(1000))
        longest = max(longest, time.monotonic() - begun)
        if recorder.stopped is not None:
            break
        time.sleep(0.001)
    assert recorder.stopped is not None
    assert "too slow" in recorder.stopped
    assert longest < 0.1
    os.close(reader)
    recorder.close()


def test_recording_that_was_killed_is_readable_to_the_last_second(tmp_path: Path, noise: bytes) -> None:
    path = tmp_path / "run.bin.gz"
    recorder = CaptureWriter(str(path), {})
    recorder.write(noise[:1000])
    wait_for(lambda: recorder.written_bytes == 1000)
    os.link(path, tmp_path / "as killed")
    (tmp_path / "copy.gz").write_bytes(path.read_bytes())
    recording = RawCapture(str(tmp_path / "copy.gz"))
    assert b"".join(recording) == noise[:1000]
    assert recording.problem is not None
    assert "cut off" in recording.problem
    recorder.close()


def test_raw_and_compressed_captures_need_no_header(tmp_path: Path, noise: bytes) -> None:
    (tmp_path / "raw").write_bytes(noise)
    (tmp_path / "zipped").write_bytes(
        gzip.compress(noise[:300_000]) + gzip.compress(noise[300_000:]) + bytes(512)
    )
    for name in ("raw", "zipped"):
        recording = RawCapture(str(tmp_path / name))
        assert recording.header is None
        assert b"".join(recording) == noise
        assert recording.problem is None


@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_damaged_gzip_gives_what_is_readable_and_says_so(tmp_path: Path, noise: bytes, damage: str) -> None:
    path, data = tmp_path / "run.gz", bytearray(gzip.compress(noise, 1))
    if damage == "cut":
        del data[500_000:]
    else:
        data[500_000:500_100] = bytes(100)
    path.write_bytes(data)
    recording = RawCapture(str(path))
    got = b"".join(recording)
    assert len(got) > 300_000
    assert got[:400_000] == noise[: len(got)][:400_000]
    assert recording.problem is not None
    assert str(path) in recording.problem


def test_nothing_that_comes_before_a_damage_is_lost(tmp_path: Path, noise: bytes) -> None:
    path, data = tmp_path / "run.gz", bytearray(gzip.compress(noise, 1))
    data[300_000:300_100] = bytes(100)
    path.write_bytes(data)
    member, readable = zlib.decompressobj(wbits=31), bytearray()
    with contextlib.suppress(zlib.error):
        for byte in data:
            readable += member.decompress(bytes([byte]))
    assert b"".join(RawCapture(str(path))) == readable


def test_a_bomb_is_unpacked_in_bounded_chunks(tmp_path: Path) -> None:
    path = tmp_path / "zeros.gz"
    path.write_bytes(gzip.compress(bytes(50 << 20)))
    largest = total = 0
    for chunk in RawCapture(str(path)):
        largest, total = max(largest, len(chunk)), total + len(chunk)
    assert total == 50 << 20
    assert largest <= 256 << 10


def test_what_is_no_recording_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "zip").write_bytes(b"PK\x03\x04 and so on")
    for name, said in {
        "missing": "cannot read .*: no such file or directory",
        ".": "cannot read .*: is a directory",
        "empty": "is empty: nothing was recorded",
        "zip": "is not a recording but a ZIP archive: unpack it first",
    }.items():
        with pytest.raises(SourceError, match=said):
            RawCapture(str(tmp_path / name))


def test_progress_is_that_of_the_bytes_on_disk(tmp_path: Path, noise: bytes) -> None:
    path = tmp_path / "raw"
    path.write_bytes(noise)
    recording = RawCapture(str(path))
    shares = [recording.progress for _ in recording]
    assert shares == sorted(shares)
    assert shares[0] is not None
    assert 0.0 < shares[0] < 1.0
    assert shares[-1] == 1.0


def test_standard_input_is_a_recording(noise: bytes) -> None:
    code = "from imumon.recordings import Recording; r = Recording('-'); print(sum(map(len, r)), r.progress)"
    said = subprocess.run(
        [sys.executable, "-c", code], input=gzip.compress(noise), capture_output=True, check=True
    )
    assert said.stdout.split() == [b"700000", b"None"]
