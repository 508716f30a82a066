"""Conformance of devices: what the daemon may expect of every device, whatever its transport."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import distribution
from pathlib import Path

import forked
import numpy as np
import pytest
import ros2_actors
from daemons import Daemon
from device_conformance import Bench, DeviceConformance
from fake_device import FakeDriver, install
from faulty_sensor import spawn
from free_ports import free_endpoint, free_port
from line_sender import LineSender
from paths import ROOT
from waiting import until

from imumon.model.samples import DeviceCounters, DeviceInfo, Gap, Item
from imumon.sources import registry
from imumon.sources.clock import HostClock
from imumon.sources.device import (
    Device,
    DeviceEnded,
    DeviceError,
    DeviceLost,
    DeviceOptions,
    Interrupted,
)
from imumon.sources.device_reader import DeviceReader, EndOfStream, Items, Opened, Started
from imumon.sources.vn100.emulator import EmulatorSettings


class TestConformance(DeviceConformance):
    """Every device of the trunk, and the fake."""

    @pytest.fixture(
        params=[
            "vn100", "ros2", "fake", "lines over pty",
            *(pytest.param(f"lines over {kind}", marks=pytest.mark.slow) for kind in ("tcp", "udp")),
        ]
    )  # fmt: skip
    def bench(self, request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
        scheme, _, transport = request.param.partition(" over ")
        with {"vn100": vn100, "ros2": ros2, "fake": fake, "lines": lines}[scheme](
            tmp_path, transport
        ) as made:
            yield made


@contextmanager
def fake(directory: Path, _: str) -> Iterator[Bench]:
    path = directory / "device"
    path.touch()
    yield Bench(
        driver=FakeDriver(), url=f"fake:{path}", missing_url=f"fake:{directory / 'missing'}", state=directory,
        unplug=path.unlink, replug=path.touch, lose_samples=lambda: None,
    )  # fmt: skip


@contextmanager
def ros2(directory: Path, _: str) -> Iterator[Bench]:
    endpoint = free_endpoint()
    with ros2_actors.router(endpoint), ros2_actors.Driver(endpoint, "/imu/data", 200.0) as driver:
        yield Bench(
            driver=registry.driver("ros2"), state=directory,
            url=f"ros2:/imu/data?router={endpoint}", missing_url=f"ros2:/missing?router={endpoint}",
            unplug=driver.unplug, replug=driver.replug,
            lose_samples=lambda: setattr(driver, "hide", 9),
        )  # fmt: skip


class Vn100Bench(Bench):
    def opened(self, device: Device) -> DeviceInfo:
        """Open a VN-100; again if it was too slow to say its serial number, as on a busy machine."""
        info = device.open()
        for _ in range(3):
            if info.serial is not None:
                break
            device.close()
            info = device.open()
        return info


@contextmanager
def vn100(directory: Path, _: str) -> Iterator[Bench]:
    path = directory / "device"
    with spawn(EmulatorSettings(seed=1, link=str(path))) as sensor:
        yield Vn100Bench(
            driver=registry.driver("vn100"), state=directory,
            url=str(path), missing_url=str(directory / "missing"),
            unplug=lambda: sensor.ask("unplug"), replug=lambda: sensor.ask("replug"),
            lose_samples=lambda: sensor.ask("fault drop=0.05"),
        )  # fmt: skip


@contextmanager
def lines(directory: Path, transport: str) -> Iterator[Bench]:
    missing = {
        "pty": "lines:/dev/missing",
        "tcp": "lines:tcp://127.0.0.1:1",
        "udp": "lines:udp://192.0.2.1:4000",
    }
    lost = transport != "udp"  # a socket for datagrams does not see that their sender is gone
    with LineSender(transport, directory) as sender:  # type: ignore[arg-type]
        yield Bench(
            driver=registry.driver("lines"), state=directory, url=sender.url, missing_url=missing[transport],
            unplug=sender.unplug if lost else None, replug=sender.replug if lost else None,
            lose_samples=sender.lose_samples,
        )  # fmt: skip


def test_every_device_of_this_distribution_is_registered_and_has_a_bench() -> None:
    points = distribution("imumon").entry_points.select(group=registry.GROUP)
    own = {"vn100", "ros2", "lines", "xsens"}  # tests/sources/xsens has the bench of the last
    assert {point.name for point in points} == own
    assert set(registry.schemes()) >= own


class BrokenDevice(Device):
    """A device whose methods fail on request, or whose stream ends; it notes what is called."""

    def __init__(self, failing: str, ends: type[DeviceLost] | None = None) -> None:
        super().__init__()
        self.failing, self.ends, self.calls = failing, ends, list[str]()

    def _call(self, name: str) -> None:
        self.calls.append(name)
        if name == self.failing:
            raise OSError(name)

    def open(self) -> DeviceInfo:
        return self.info()

    def info(self) -> DeviceInfo:
        return DeviceInfo(id="broken")

    def start(self) -> DeviceInfo:
        if self.failing == "start" and "start" not in self.calls:
            self.calls.append("start")
            raise DeviceError("broken", "it does not start", "nothing")
        self.calls.append("start")
        return self.info()

    def read(self, timeout_s: float) -> list[Item]:
        if self.ends is not None:
            self._call("read")
            raise self.ends("short", "that was all", "start it again")
        if timeout_s > 0.0:
            if self.failing == "read":
                self._call("read")
            self.wait(timeout_s)
        else:
            self._call("rest")
        return []

    def finish(self) -> list[Item]:
        self._call("finish")
        return [Gap(None)]

    @property
    def counters(self) -> DeviceCounters:
        return DeviceCounters()

    def restore(self) -> bool:
        self._call("restore")
        time.sleep(0.3)
        if self.interrupted.is_set():
            raise Interrupted
        return True

    def close(self) -> None:
        self._call("close")


def up_to(reader: DeviceReader, kind: type) -> list[object]:
    """Return the events up to the first of a kind; the device begins when it is open."""
    events: list[object] = []

    def has_come() -> bool:
        event = reader.get(0.1)
        events.extend([] if event is None else [event])
        if isinstance(event, Opened):
            reader.begin()
        return isinstance(event, kind)

    until(has_come)
    return events


@pytest.mark.parametrize("failing", ["read", "rest", "finish", "restore", "close"])
def test_a_device_is_restored_and_closed_whatever_fails(failing: str) -> None:
    device = BrokenDevice(failing)
    reader = DeviceReader(device)
    reader.start()
    if failing != "read":
        up_to(reader, Started)
        reader.stop()
    end = up_to(reader, EndOfStream)[-1]
    if failing in ("read", "rest", "finish"):
        assert (type(end.error), end.error.code) == (DeviceError, "device_failed")  # type: ignore[attr-defined]
    reader.stop(discard=True)  # what the daemon does with an error: it must not interrupt the restoring
    assert reader.join(60.0)
    assert device.calls[-2:] == ["restore", "close"]
    assert reader.restored is (failing != "restore")


def test_a_failed_start_is_restored_before_the_next_try(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.sources.device_reader.FIRST_RETRY_S", 0.1)
    device = BrokenDevice("start")
    reader = DeviceReader(device)
    reader.start()
    up_to(reader, Started)
    assert device.calls == ["start", "restore", "close", "start"]
    reader.stop(discard=True)
    assert reader.join(60.0)


def test_a_full_queue_holds_the_reader_and_the_run_can_still_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "plug").touch()
    monkeypatch.setattr("imumon.sources.device_reader.BATCHES", 2)
    reader = DeviceReader(FakeDriver().create(DeviceOptions(url=f"fake:{tmp_path / 'plug'}")))
    reader.start()
    up_to(reader, Started)
    until(reader._queue.full)
    reader.stop(discard=True)
    assert reader.join(60.0)
    assert reader.restored is True


def test_the_end_of_a_stream_ends_the_reader_behind_what_was_held_back() -> None:
    device = BrokenDevice("", DeviceEnded)
    reader = DeviceReader(device)
    reader.start()
    events = up_to(reader, EndOfStream)
    assert [type(event) for event in events] == [Opened, Started, Items, EndOfStream]
    assert isinstance(events[-1].error, DeviceEnded)  # type: ignore[attr-defined]
    assert reader.join(60.0)
    assert device.calls == ["start", "read", "finish", "restore", "close"]


def test_a_device_that_is_lost_again_at_once_is_opened_ever_less_often(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reader, wait, waits = DeviceReader(BrokenDevice("", DeviceLost)), DeviceReader._wait, list[float]()

    def no_wait(self: DeviceReader, seconds: float | None) -> None:
        waits.extend([] if seconds is None else [self._retry_s])
        wait(self, None if seconds is None else 0.0)

    monkeypatch.setattr(DeviceReader, "_wait", no_wait)
    reader.start()
    up_to(reader, Opened)
    until(lambda: reader.get(0.0) and len(waits) >= 7)
    reader.stop(discard=True)
    assert reader.join(60.0)
    assert waits[:7] == [1.0, 2.0, 4.0, 8.0, 16.0, 16.0, 16.0]


# ---------------------------------------------------------------------- a device of another distribution


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """Environment in which a distribution with the fake device is installed."""
    site = tmp_path / "site"
    install(site, "imumon-fake", {"fake": "fake_device:FakeDriver"})
    (site / "fake_device.py").write_text((ROOT / "tests" / "fake_device.py").read_text())
    return {"PYTHONPATH": str(site)}


def test_what_a_device_cannot_use_is_refused_by_name(installed: dict[str, str], tmp_path: Path) -> None:
    config = tmp_path / "config.toml"
    config.write_text("[device]\nbaud = 'auto'\nlisten_only = true\n")
    words = ("run", "--port", "fake:x", "--config", str(config), "--state", str(tmp_path))
    done = forked.run(*words, environment=installed)
    assert done.returncode == 2
    assert done.stderr.startswith(f"imumon: fake:x cannot use listen_only in {config}:3: ")


def test_a_broken_driver_disturbs_no_other(installed: dict[str, str], tmp_path: Path) -> None:
    site = Path(installed["PYTHONPATH"])
    (site / "fake_device.py").write_text("raise RuntimeError('broken')\n")
    done = forked.run("run", "--port", "fake:x", "--state", str(tmp_path), environment=installed)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "broken" in done.stderr
    assert forked.run("--version", environment=installed).returncode == 0


def code_block(language: str, number: int = 0) -> str:
    text = (ROOT / "docs" / "DEVICES.md").read_text()
    found: list[str] = re.findall(rf"```{language} example\n(.*?)```", text, re.S)
    return found[number]


def test_a_third_party_holds_its_device_to_the_contract(tmp_path: Path) -> None:
    (tmp_path / "imumon_udp.py").write_text(code_block("python"))
    (tmp_path / "test_udp.py").write_text(code_block("python", 1))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-rA", "test_udp.py"]
    shutil.copy(ROOT / "tests" / "device_conformance.py", tmp_path)
    path = os.pathsep.join([str(ROOT), str(tmp_path)])
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert "5 passed, 5 skipped" in done.stdout


def test_the_example_of_the_documentation_runs(tmp_path: Path) -> None:
    points = tomllib.loads(code_block("toml"))["project"]["entry-points"]["imumon.devices"]
    install(tmp_path / "site", "imumon-udp", points)
    (tmp_path / "site" / "imumon_udp.py").write_text(code_block("python"))
    port, ending = free_port(), threading.Event()

    def send() -> None:
        random, begin, k = np.random.default_rng(1), time.monotonic(), 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not ending.wait(max(0.0, begin + k / 200.0 - time.monotonic())):
                row = [k / 200.0, *random.normal(0.0, 1e-3, 6)]
                if k % 300:  # the others are lost
                    sender.sendto(" ".join(f"{x:.9g}" for x in row).encode(), ("127.0.0.1", port))
                k += 1

    path = {"PYTHONPATH": str(tmp_path / "site")}
    thread = threading.Thread(target=send)
    with Daemon(f"udp:{port}", tmp_path / "state", environment=path) as daemon:
        thread.start()
        try:
            made = daemon.wait(lambda report: report.session.missing > 0)
        finally:
            ending.set()
            thread.join()
    assert made.device.id == f"udp-{port}"
    assert made.device.sample_rate_hz == pytest.approx(200.0, rel=1e-3)
    assert made.session.samples > 200
    assert made.session.received_bytes > 0


@pytest.mark.parametrize("factor", [0.5, 1.0, 60.0, 5000.0])
def test_a_length_of_the_record_and_back_is_the_same(factor: float) -> None:
    clock = HostClock(factor)
    assert clock.to_host_s(clock.to_sample_s(3.0)) == pytest.approx(3.0, rel=1e-15)
    assert clock.is_real_time == (factor == 1.0)


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan")])
def test_a_factor_that_is_none_is_refused(factor: float) -> None:
    with pytest.raises(ValueError, match="above 0"):
        HostClock(factor)


def test_a_system_that_does_not_count_its_sleep_has_an_uptime_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(time, "CLOCK_BOOTTIME", raising=False)
    before = HostClock().uptime_s()
    assert before <= HostClock().uptime_s() < before + 60.0
