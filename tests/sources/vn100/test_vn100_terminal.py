"""A session with a VN-100 on a real terminal: the emulator in a process of its own."""

from __future__ import annotations

import os
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from faulty_sensor import FaultySensorProcess, spawn

from imumon.config import DeviceSettings
from imumon.model.samples import SampleBlock
from imumon.sources.device import DeviceError, DeviceLost, DeviceOptions
from imumon.sources.serial_port import SerialPort
from imumon.sources.vn100.emulator import EmulatorSettings
from imumon.sources.vn100.vn100_session import Vn100Device, Vn100Session

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
            again = Vn100Session(port, DeviceSettings(), time.monotonic, decoder=session.decoder)
            assert again.connect().serial == serial
            again.save_settings(saved)
            again.configure()
            assert live(again, 3.0, 20) >= 20
            assert again.restore()
        for terminal in taken:
            os.close(terminal)


def test_another_sensor_in_the_place_of_a_lost_one_is_refused(tmp_path: Path) -> None:
    link = tmp_path / "sensor"
    device = Vn100Device(DeviceOptions(url=str(link), settings=DeviceSettings()))
    with spawn(EmulatorSettings(seed=1, link=str(link))):
        device.open()
        device.start()
    device.close()
    with (
        spawn(EmulatorSettings(seed=2, link=str(link), serial="0100000002")),
        pytest.raises(DeviceError) as error,
    ):
        device.open()
    assert error.value.code == "other_sensor"
    assert all(serial in error.value.message for serial in ("0100056785", "0100000002"))
