"""A session with a VN-100 on a real terminal: the emulator in a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from faulty_sensor import FaultySensorProcess, spawn
from vn100_bench import kinds

from imumon.config import DeviceSettings
from imumon.model.samples import Notice, SampleBlock
from imumon.sources.device import DeviceLost
from imumon.sources.serial_port import SerialPort
from imumon.sources.vn100.emulator import EmulatorSettings
from imumon.sources.vn100.vn100_session import Vn100Session

# ---------------------------------------------------------------------- emulator process


@pytest.fixture
def emulator() -> Iterator[FaultySensorProcess]:
    with spawn(EmulatorSettings(seed=1)) as running:
        yield running


def live(session: Vn100Session, seconds: float, enough: int) -> int:
    """Samples until there are enough, or so long."""
    count, until = 0, time.monotonic() + seconds
    while count < enough and time.monotonic() < until:
        for item in session.decode(session.read(0.1)):
            count += len(item) if isinstance(item, SampleBlock) else 0
        session.check_health()
    return count


@pytest.mark.few
@pytest.mark.parametrize("baud", [115200, 921600, 230400])
def test_first_connection_on_a_terminal(baud: int) -> None:
    with spawn(EmulatorSettings(seed=1, baud=baud)) as running, SerialPort(running.path) as port:
        session = Vn100Session(port, DeviceSettings(), time.monotonic)
        session.connect()
        session.configure()
        assert live(session, 3.0, 50) >= 50
        fd = os.open(running.path, os.O_RDWR | os.O_NOCTTY)
        assert termios.tcgetattr(fd)[5] == getattr(termios, f"B{baud}")
        os.close(fd)
        assert session.decoder.bad_checksums == session.decoder.discarded == 0
        assert session.restore()


def test_replugged_sensor_under_another_name(tmp_path: Path) -> None:
    link = tmp_path / "sensor"
    with spawn(EmulatorSettings(seed=1, link=str(link))) as running:
        with SerialPort(str(link)) as port:
            session = Vn100Session(port, DeviceSettings(), time.monotonic)
            serial = session.connect().serial
            saved = session.save_settings()
            session.configure()
            assert live(session, 3.0, 20) >= 20
            first = os.path.realpath(link)
            running.ask("unplug")
            with pytest.raises(DeviceLost):
                live(session, 5.0, 10**6)
        taken = []  # the old name must be taken: another process may have freed a lower one
        while not os.path.exists(first):
            taken.append(os.open("/dev/ptmx", os.O_RDWR | os.O_NOCTTY))
        running.ask("replug")
        assert os.path.realpath(link) != first
        with SerialPort(str(link)) as port:
            again = Vn100Session(
                port, DeviceSettings(), time.monotonic, decoder=session.decoder, serial=serial
            )
            again.connect()
            again.save_settings(saved)
            again.configure()
            assert live(again, 3.0, 20) >= 20
            assert again.restore()
        for terminal in taken:
            os.close(terminal)


def test_reboot_on_a_terminal(emulator: FaultySensorProcess) -> None:
    with SerialPort(emulator.path) as port:
        session = Vn100Session(port, DeviceSettings(), time.monotonic)
        session.connect()
        session.configure()
        assert live(session, 3.0, 20) >= 20
        emulator.ask("reboot")
        notices: list[Notice] = []
        until = time.monotonic() + 60.0
        while "reconfigured" not in kinds(notices) and time.monotonic() < until:
            session.decode(session.read(0.1))
            notices += session.check_health()
        assert "reconfigured" in kinds(notices)
        assert live(session, 3.0, 50) >= 50


def test_settings_of_a_killed_process_are_restored(emulator: FaultySensorProcess) -> None:
    code = """
import sys, time
from imumon.config import DeviceSettings
from imumon.sources.vn100.vn100_session import Vn100Session
from imumon.sources.serial_port import SerialPort
session = Vn100Session(SerialPort(sys.argv[1]), DeviceSettings(), time.monotonic)
session.connect(); session.save_settings(); session.configure()
print("streaming", flush=True)
while True:
    session.read(1.0)
"""
    command = [sys.executable, "-c", code, emulator.path]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as victim:
        assert victim.stdout is not None
        assert victim.stdout.readline() == b"streaming\n"
        victim.send_signal(signal.SIGKILL)
    with SerialPort(emulator.path) as port:
        session = Vn100Session(port, DeviceSettings(), time.monotonic)
        assert session.connect().settings["6 async data output type"] == "0"
        assert session.save_settings()["6"] == "14"
        session.configure()
        assert live(session, 3.0, 20) >= 20
        assert session.restore()
        after = Vn100Session(port, DeviceSettings(), time.monotonic).connect()
        assert after.settings["6 async data output type"] == "14"
        assert after.settings["75 binary output 1"] == "0,0,00"
