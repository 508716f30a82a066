"""Conformance of devices: what the daemon may expect of every device, whatever its transport."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import ros2_actors
from daemons import free_endpoint
from fake_device import RATE_HZ, FakeDriver, install_fake
from paths import ROOT
from waiting import until

from imumon.config import Settings
from imumon.devices import registry
from imumon.devices.base import (
    Device,
    DeviceDriver,
    DeviceEnded,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceOptions,
    Interrupted,
)
from imumon.devices.device_reader import DeviceReader, Disconnected, EndOfStream, Items, Opened, Started
from imumon.devices.vn100.emulator import EmulatorSettings, spawn
from imumon.pipeline import Monitor
from imumon.report import DeviceDescription, SessionCounters
from imumon.samples import DeviceCounters, DeviceInfo, Gap, Item, SampleBlock


@dataclass
class Bench:
    """A device that can be unplugged."""

    driver: DeviceDriver
    url: str
    missing_url: str
    unplug: Callable[[], object]
    replug: Callable[[], object]
    lose_samples: Callable[[], object]
    state: Path

    def device(self, url: str | None = None) -> Device:
        options = DeviceOptions(url=url or self.url, settings=Settings().device, state_directory=self.state)
        return self.driver.create(options)


@pytest.fixture(params=["vn100", "ros2", "fake"])
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    """Every registered device, and the fake."""
    path = tmp_path / "device"
    if request.param == "fake":
        path.touch()
        url, missing = f"fake:{path}", f"fake:{tmp_path / 'missing'}"
        yield Bench(FakeDriver(), url, missing, path.unlink, path.touch, lambda: None, tmp_path)
        return
    if request.param == "ros2":
        endpoint = ros2_actors.free_router()
        with (
            ros2_actors.router(endpoint),
            ros2_actors.publisher(endpoint, "/imu/data", 200.0) as driver,
        ):
            yield Bench(
                registry.driver("ros2"),
                f"ros2:/imu/data?router={endpoint}",
                f"ros2:/missing?router={endpoint}",
                lambda: driver.ask("unplug"),
                lambda: driver.ask("replug"),
                lambda: driver.ask("hide 9"),
                tmp_path,
            )
        return
    with spawn(EmulatorSettings(seed=1, link=str(path))) as sensor:

        def ask(command: str) -> Callable[[], object]:
            return lambda: sensor.ask(command)

        yield Bench(
            registry.driver("vn100"),
            str(path),
            str(tmp_path / "missing"),
            ask("unplug"),
            ask("replug"),
            ask("fault drop=0.05"),
            tmp_path,
        )


def identified(bench: Bench, device: Device) -> DeviceInfo:
    """Open a device; a VN-100 again if it was too slow to say its serial number, as on a busy machine."""
    info = device.open()
    for _ in range(3 if bench.driver.scheme == "vn100" else 0):
        if info.serial is not None:
            break
        device.close()
        info = device.open()
    return info


def test_every_registered_device_has_a_bench() -> None:
    assert set(registry.schemes()) == {"vn100", "ros2"}


def read_for(device: Device, seconds: float, enough: int = 10**9) -> list[Item]:
    items: list[Item] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end and sum(map(len, blocks(items))) < enough:
        items += device.read(0.1)
    return items


def blocks(items: list[Item]) -> list[SampleBlock]:
    return [item for item in items if isinstance(item, SampleBlock)]


def test_it_opens_identifies_itself_and_streams(bench: Bench) -> None:
    device = bench.device()
    info = identified(bench, device)
    assert info.id
    assert info.port
    assert device.start().id == info.id
    items = read_for(device, 30.0, enough=100)
    for block in blocks(items):
        assert block.values.shape == (len(block), len(block.stream.channels))
        assert np.isfinite(block.values).all()
        assert block.lost.shape == (len(block),)
        assert block.stream.clock == "none" or block.time_ns is not None
    assert sum(map(len, blocks(items))) >= 100
    assert device.info().id == info.id
    assert device.restore()
    device.close()
    device.close()


def test_reading_works_without_start(bench: Bench) -> None:
    """`imumon doctor` changes nothing."""
    device = bench.device()
    device.open()
    assert read_for(device, 30.0, enough=1)
    device.close()


def test_a_device_that_is_not_there_is_an_error_with_a_cure(bench: Bench) -> None:
    device = bench.device(bench.missing_url)
    with pytest.raises(DeviceNotFound) as missing:
        device.open()
    assert missing.value.code
    assert missing.value.cure
    device.close()


def test_lost_samples_show_in_the_clock(bench: Bench) -> None:
    device = bench.device()
    device.open()
    device.start()
    items = read_for(device, 30.0, enough=50)
    bench.lose_samples()
    monitor = Monitor()
    for block in blocks(items):
        monitor.feed(block)
    end = time.monotonic() + 30.0
    while session_of(monitor).missing == 0 and time.monotonic() < end:
        some = device.read(0.1)
        items += some
        for block in blocks(some):
            monitor.feed(block)
    monitor.flush()
    made = session_of(monitor)
    assert made.missing > 0
    assert made.samples == sum(map(len, blocks(items)))
    rate = monitor.sample_rate_hz
    assert rate is not None
    assert round(made.elapsed_s * rate) == made.samples + made.missing
    device.restore()
    device.close()


def session_of(monitor: Monitor) -> SessionCounters:
    made = monitor.report(datetime.now(UTC), DeviceDescription(id="x"), "running", SessionCounters())
    return made.session


def test_the_rate_of_the_fake_is_its_own(tmp_path: Path) -> None:
    (tmp_path / "device").touch()
    device = FakeDriver().create(DeviceOptions(url=f"fake:{tmp_path / 'device'}"))
    device.open()
    monitor = Monitor()
    for block in blocks(read_for(device, 4.0)):
        monitor.feed(block)
    assert monitor.sample_rate_hz == pytest.approx(RATE_HZ, rel=2e-3)


def test_a_lost_device_is_an_error_and_comes_back_as_the_same(bench: Bench) -> None:
    device = bench.device()
    info = identified(bench, device)
    device.start()
    read_for(device, 30.0, enough=20)
    before = device.counters
    bench.unplug()
    with pytest.raises(DeviceLost):
        read_for(device, 30.0)
    device.close()
    with pytest.raises(DeviceError):
        device.open()
    bench.replug()
    assert identified(bench, device).id == info.id
    device.start()
    assert blocks(read_for(device, 30.0, enough=20))
    assert device.counters.received_bytes >= before.received_bytes
    device.restore()
    device.close()


def test_an_interrupt_ends_a_wait(bench: Bench) -> None:
    device = bench.device()
    device.open()
    device.start()
    device.interrupt()
    begin = time.monotonic()
    with pytest.raises(Interrupted):
        read_for(device, 60.0)
    assert time.monotonic() - begin < 30.0
    device.interrupted.clear()
    device.restore()
    device.close()


def test_the_reader_runs_it_from_open_to_close(bench: Bench) -> None:
    reader, events = DeviceReader(bench.device()), []
    reader.start()

    def read_to(kind: type, seconds: float = 60.0) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            event = reader.get(0.1)
            if event is not None:
                events.append(event)
                if isinstance(event, kind):
                    return
        raise AssertionError(f"no {kind.__name__} among {[type(event).__name__ for event in events]}")

    read_to(Opened)
    assert not any(isinstance(event, Started) for event in events)
    reader.begin()
    read_to(Started)
    read_to(Items)
    bench.unplug()
    read_to(Disconnected)
    bench.replug()
    read_to(Started)
    read_to(Items)
    reader.stop()
    read_to(EndOfStream)
    assert events[-1].error is None
    assert reader.join(10.0)
    assert reader.restored is True
    kinds = (SampleBlock, DeviceInfo, DeviceCounters, Gap)
    items = [item for event in events if isinstance(event, Items) for item in event.items]
    assert any(isinstance(item, kinds) for item in items)


def test_a_full_queue_holds_the_reader_and_loses_nothing_of_the_device(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("imumon.devices.device_reader.BATCHES", 2)
    reader = DeviceReader(bench.device())
    reader.start()
    while not isinstance(reader.get(10.0), Opened):
        pass
    reader.begin()
    while not isinstance(reader.get(10.0), Started):
        pass
    until(reader._queue.full)
    reader.stop(discard=True)
    assert reader.join(10.0)
    assert reader.restored is True


class BrokenDevice(Device):
    """A device whose methods fail on request; it notes what is called."""

    def __init__(self, failing: str) -> None:
        super().__init__()
        self.failing, self.calls = failing, list[str]()

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
        if timeout_s > 0.0:
            if self.failing == "read":
                self._call("read")
            self.wait(timeout_s)
        else:
            self._call("rest")
        return []

    def finish(self) -> list[Item]:
        self._call("finish")
        return []

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


@pytest.mark.parametrize("failing", ["read", "rest", "finish", "restore", "close"])
def test_a_device_is_restored_and_closed_whatever_fails(failing: str) -> None:
    device = BrokenDevice(failing)
    reader = DeviceReader(device)
    reader.start()
    events: list[object] = []
    end = time.monotonic() + 10.0
    while not (events and isinstance(events[-1], EndOfStream)) and time.monotonic() < end:
        event = reader.get(0.05)
        events += [] if event is None else [event]
        if isinstance(event, Opened):
            reader.begin()
        if isinstance(event, Started) and failing != "read":
            reader.stop()
    assert isinstance(events[-1], EndOfStream)
    if failing in ("read", "rest", "finish"):
        assert isinstance(events[-1].error, DeviceError)
        assert events[-1].error.code == "device_failed"
    reader.stop(discard=True)  # what the daemon does with an error: it must not interrupt the restoring
    assert reader.join(5.0)
    assert device.calls[-2:] == ["restore", "close"]
    assert reader.restored is (failing != "restore")


def test_a_failed_start_is_restored_before_the_next_try(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.devices.device_reader.FIRST_RETRY_S", 0.1)
    device = BrokenDevice("start")
    reader = DeviceReader(device)
    reader.start()
    for event in iter(lambda: reader.get(5.0), None):
        if isinstance(event, Opened):
            reader.begin()
        if isinstance(event, Started):
            break
    assert device.calls == ["start", "restore", "close", "start"]
    reader.stop(discard=True)
    assert reader.join(5.0)


class ShortDevice(BrokenDevice):
    """A device whose stream has some items and then ends, or is lost."""

    def __init__(self, end: type[DeviceLost]) -> None:
        super().__init__("")
        self.end = end

    def read(self, timeout_s: float) -> list[Item]:
        self._call("read")
        raise self.end("short", "that was all", "start it again")

    def finish(self) -> list[Item]:
        self._call("finish")
        return [Gap(None)]

    def close(self) -> None:
        self._call("close")


def test_the_end_of_a_stream_ends_the_reader_behind_what_was_held_back() -> None:
    device = ShortDevice(DeviceEnded)
    reader = DeviceReader(device)
    reader.start()
    events = []
    while not reader.ended:
        event = reader.get(5.0)
        assert event is not None
        reader.begin()
        events.append(event)
    assert [type(event) for event in events] == [Opened, Started, Items, EndOfStream]
    assert isinstance(events[-1].error, DeviceEnded)
    assert reader.join(5.0)
    assert device.calls == ["start", "read", "finish", "restore", "close"]


def test_a_device_that_is_lost_again_at_once_is_opened_ever_less_often(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("imumon.devices.device_reader.RETRY_S", 0.05)
    device = ShortDevice(DeviceLost)
    reader = DeviceReader(device)
    reader.start()
    until(lambda: isinstance(reader.get(0.1), Opened))
    reader.begin()
    end = time.monotonic() + 1.5
    while time.monotonic() < end:
        reader.get(0.1)
    assert 3 <= device.calls.count("start") <= 6  # after 0.1, 0.3, 0.7, 1.5 s
    reader.stop(discard=True)
    assert reader.join(5.0)


@pytest.mark.parametrize("scheme", registry.schemes())
@pytest.mark.parametrize("chunk", [1, 13, 100_000])
def test_a_decoder_discards_garbage_to_the_byte(scheme: str, chunk: int) -> None:
    decoder = registry.driver(scheme).decoder()
    if decoder is None:
        pytest.skip("this device has no bytes")
    data = np.random.default_rng(11).integers(0, 256, 20_000, np.uint8).tobytes()
    items: list[object] = []
    for at in range(0, len(data), chunk):
        items += decoder.feed(data[at : at + chunk])
        assert decoder.fed == decoder.message_bytes + decoder.discarded + decoder.pending
        assert decoder.pending < 4096
    items += decoder.finish()
    assert not any(isinstance(item, SampleBlock) for item in items)
    assert (decoder.fed, decoder.messages, decoder.discarded, decoder.pending) == (len(data), 0, len(data), 0)


# ---------------------------------------------------------------------- a device of another distribution


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """Environment in which a distribution with the fake device is installed."""
    site = tmp_path / "site"
    install_fake(site)
    return {**os.environ, "PYTHONPATH": str(site)}


def imumon(*arguments: str, env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "imumon", *arguments],
        capture_output=True,
        text=True,
        env=env,
        timeout=60,
        check=False,
    )


def test_run_reads_a_device_of_another_distribution(installed: dict[str, str], tmp_path: Path) -> None:
    (tmp_path / "device").touch()
    done = imumon(
        *("run", "--port", f"fake:{tmp_path / 'device'}", "--duration", "5", "--json"),
        *("--state", str(tmp_path / "state"), "--listen", free_endpoint()),
        env=installed,
    )
    assert done.returncode == 0, done.stderr
    made = json.loads(done.stdout)
    assert made["device"]["id"] == "fake-1"
    assert made["device"]["baud"] is None
    assert made["device"]["sample_rate_hz"] == pytest.approx(RATE_HZ, rel=2e-3)
    session = made["session"]
    assert session["samples"] > 300
    assert session["missing"] > 0
    assert round(session["elapsed_s"] * made["device"]["sample_rate_hz"]) == (
        session["samples"] + session["missing"]
    )
    assert "VN-100" not in done.stderr


def test_a_device_that_is_missing_ends_run_with_one_line(installed: dict[str, str], tmp_path: Path) -> None:
    done = imumon("run", "--port", f"fake:{tmp_path / 'none'}", "--state", str(tmp_path), env=installed)
    assert done.returncode == 3
    assert done.stderr.strip() == f"imumon: no file {tmp_path / 'none'}: create it"


@pytest.mark.parametrize("given", ["option", "file"])
def test_what_a_device_cannot_use_is_refused_by_name(
    given: str, installed: dict[str, str], tmp_path: Path
) -> None:
    config = tmp_path / "config.toml"
    config.write_text("[device]\nbaud = 'auto'\n" + ("listen_only = true\n" if given == "file" else ""))
    words = ["run", "--port", "fake:x", "--config", str(config), "--state", str(tmp_path)]
    done = imumon(*words, *(["--listen-only"] if given == "option" else []), env=installed)
    assert done.returncode == 2
    named = "--listen-only" if given == "option" else f"listen_only in {config}:3"
    assert done.stderr.startswith(f"imumon: fake:x cannot use {named}: ")


def test_a_recording_of_a_device_without_bytes_is_refused_at_the_start(
    installed: dict[str, str], tmp_path: Path
) -> None:
    (tmp_path / "device").touch()
    words = ("--record", str(tmp_path / "file"), "--state", str(tmp_path))
    done = imumon("run", "--port", f"fake:{tmp_path / 'device'}", *words, env=installed)
    assert done.returncode == 2
    assert "sends no bytes that could be recorded" in done.stderr
    assert not (tmp_path / "file").exists()


def test_an_unknown_scheme_ends_run_with_one_line(tmp_path: Path) -> None:
    done = imumon("run", "--port", "nonsense:x", "--state", str(tmp_path), env=dict(os.environ))
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "nonsense" in done.stderr


def test_a_broken_driver_disturbs_no_other(installed: dict[str, str], tmp_path: Path) -> None:
    site = Path(installed["PYTHONPATH"])
    (site / "fake_device.py").write_text("raise RuntimeError('broken')\n")
    done = imumon("run", "--port", "fake:x", "--state", str(tmp_path), env=installed)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "broken" in done.stderr
    with suppress(subprocess.TimeoutExpired):
        assert imumon("--version", env=installed).returncode == 0


def code_block(language: str) -> str:
    text = (ROOT / "docs" / "DEVICES.md").read_text()
    found = re.search(rf"```{language} example\n(.*?)```", text, re.S)
    assert found is not None
    return found[1]


def test_the_example_of_the_documentation_runs(tmp_path: Path) -> None:
    project = tomllib.loads(code_block("toml"))["project"]
    info = tmp_path / "site" / "imumon_udp-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 1.0\n")
    points = project["entry-points"]["imumon.devices"]
    lines = [f"{name} = {value}" for name, value in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[imumon.devices]", *lines, ""]))
    (tmp_path / "site" / "imumon_udp.py").write_text(code_block("python"))
    env = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "imumon", "run", "--port", f"udp:{port}", "--duration", "4", "--json"]
    command += ["--state", str(tmp_path / "state"), "--listen", free_endpoint()]
    daemon = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        random = np.random.default_rng(1)
        begin = time.monotonic()
        k = 0
        while daemon.poll() is None and time.monotonic() < begin + 30.0:
            if k != 300:  # one is lost
                row = [k / 200.0, *random.normal(0.0, 1e-3, 6)]
                sender.sendto(" ".join(f"{x:.9g}" for x in row).encode(), ("127.0.0.1", port))
            k += 1
            time.sleep(max(0.0, begin + k / 200.0 - time.monotonic()))
    out, err = daemon.communicate(timeout=20)
    assert daemon.returncode == 0, err
    made = json.loads(out)
    assert made["device"]["id"] == f"udp-{port}"
    assert made["device"]["sample_rate_hz"] == pytest.approx(200.0, rel=1e-3)
    assert made["session"]["samples"] > 200
    assert made["session"]["received_bytes"] > 0
