"""Laws of the serial port: bytes, baud rate, loss and errors."""

from __future__ import annotations

import fcntl
import os
import pty
import socket
import subprocess
import sys
import termios
import threading
import time
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from waiting import until

from imumon.sources import linux_tty
from imumon.sources.device import DeviceError, DeviceLost
from imumon.sources.linux_tty import holders
from imumon.sources.ports import PortInfo, find_again
from imumon.sources.serial_port import SerialPort


def gather(port: SerialPort, size: int, seconds: float = 60.0) -> bytes:
    """Return at most this many bytes of a port."""
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


def test_bytes_pass_unchanged_in_both_directions(line: Line) -> None:
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
        assert port.kernel_overruns is None, "a pseudo-terminal does not count overruns: None, not 0"


@pytest.mark.parametrize("baud", [9600, 115200, 128000, 921600])
def test_baud_is_that_of_the_terminal(line: Line, baud: int) -> None:
    with SerialPort(line.path, 57600) as port:
        assert port.set_baud(baud)
        assert port.baud == baud
        speed = termios.tcgetattr(line.slave)[5]
        known = getattr(termios, f"B{baud}", None)
        assert speed == known if known is not None else linux_tty.actual_baud(line.slave) == baud


def test_baud_that_the_adapter_rounds_is_refused_and_the_old_one_stays(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    with SerialPort(line.path, 115200) as port:
        actual = linux_tty.actual_baud
        monkeypatch.setattr(linux_tty, "actual_baud", lambda fd: min(actual(fd) or 0, 460800))
        assert not port.set_baud(921600)
        assert port.baud == 115200
        assert actual(line.slave) == 115200
    with pytest.raises(DeviceError) as refused:
        SerialPort(line.path, 921600)
    assert refused.value.code == "baud_unsupported"


def test_unplugged_port_is_lost_after_its_last_byte(line: Line) -> None:
    with SerialPort(line.path) as port:
        os.write(line.master, b"last")
        until(lambda: port.received_bytes == 4)
        line.unplug()
        until(lambda: port.waits)
        assert port.read(0.1) == b"last"
        for use in (lambda: port.read(1.0), lambda: port.write(b"x")):
            with pytest.raises(DeviceLost) as error:
                use()
            assert error.value.code == "device_lost"
        with pytest.raises(DeviceLost):
            port.set_baud(9600)


def _send(fd: int, data: bytes) -> None:
    while data:
        data = data[os.write(fd, data[:4096]) :]


def test_full_queue_drops_and_counts_bytes(line: Line) -> None:
    with SerialPort(line.path, queue_bytes=1000) as port:
        for _ in range(40):
            before = port.received_bytes
            os.write(line.master, bytes(100))
            until(lambda before=before: port.received_bytes == before + 100)
        kept = port.read(0.1)
        assert len(kept) + port.dropped_bytes == 4000
        assert len(kept) <= 1000
        assert port.overruns == 1, "one overrun for consecutive dropped bytes"
        os.write(line.master, b"after")
        assert gather(port, 5) == b"after"


def test_lossless_port_blocks_the_other_end(line: Line) -> None:
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
        with pytest.raises(DeviceLost):
            gather(port, 1)


def test_invalid_port_is_one_line_with_a_code_and_a_cure(tmp_path: Path, line: Line) -> None:
    file = tmp_path / "run.bin"
    file.write_bytes(b"x")
    for path, code in {
        str(tmp_path / "ttyUSB9"): "port_not_found",
        str(tmp_path): "port_not_serial",
        str(file): "port_not_serial",
        "/dev/null": "port_not_serial",
        "socket://127.0.0.1:1": "port_url_unreachable",
        "what://ever": "port_url_unreachable",
        "bad\0name": "port_not_found",
    }.items():
        with pytest.raises(DeviceError) as refused:
            SerialPort(path)
        assert refused.value.code == code
        assert refused.value.cure
        assert "\n" not in str(refused.value)


def test_port_in_use_names_who_has_it(line: Line) -> None:
    code = (
        "import fcntl, os, sys; fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY);"
        "fcntl.flock(fd, fcntl.LOCK_EX); print('locked', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, line.path]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        other.stdout.readline()
        assert list(holders(line.path)) == [other.pid]
        with pytest.raises(DeviceError, match=rf"\({other.pid}\)") as refused:
            SerialPort(line.path)
        assert refused.value.code == "port_busy"
    finally:
        other.kill()
        other.communicate()
    SerialPort(line.path).close()


def test_open_port_is_locked(line: Line) -> None:
    with SerialPort(line.path):
        fd = os.open(line.path, os.O_RDWR | os.O_NOCTTY)
        with pytest.raises(BlockingIOError):
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.close(fd)


def test_replugged_adapter_is_identified_by_its_serial_number(tmp_path: Path) -> None:
    here = str(tmp_path)  # a path that exists
    ours, other = (0x0403, 0x6001, "FT1"), (0x0403, 0x6001, "FT2")
    before = [PortInfo("/dev/ttyUSB7", "", ours), PortInfo("/dev/ttyUSB8", "", other)]
    now = [PortInfo("/dev/ttyUSB8", "", other), PortInfo("/dev/ttyUSB9", "", ours)]
    assert find_again("/dev/ttyUSB7", before, now) == ["/dev/ttyUSB9"]
    assert find_again(here, [PortInfo(here, "", ours)], now) == [here, "/dev/ttyUSB9"]
    assert find_again("/dev/ttyS99", [PortInfo("/dev/ttyS99", "", None)], now) == []
    assert find_again("socket://a:1", [], now) == ["socket://a:1"]
