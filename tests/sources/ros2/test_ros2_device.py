"""The device ros2: messages to samples, and a topic that comes, goes and changes."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, cast

import pytest
import ros2_actors
from daemons import Daemon
from free_ports import free_endpoint
from paths import TESTS
from ros2_actors import imu_payload
from ros2_messages import samples
from waiting import until

from imumon.config import Settings
from imumon.model.samples import Item
from imumon.ros2.node import Publication
from imumon.ros2.ros_messages import IMU, type_hash
from imumon.ros2.topic_url import open_node, parse_url
from imumon.ros2.zenoh_node import ZenohPublication
from imumon.sources import registry
from imumon.sources.device import Device, DeviceOptions

UNIX_NS = 1_700_000_000_000_000_000


# ---------------------------------------------------------------------- a system


@contextmanager
def system(*, rate_hz: float = 200.0, **options: Any) -> Iterator[tuple[str, ros2_actors.Driver]]:
    """A router and a driver of /imu/data; gives the endpoint and the driver."""
    endpoint = free_endpoint()
    with (
        ros2_actors.router(endpoint),
        ros2_actors.Driver(endpoint, "/imu/data", rate_hz, **options) as driver,
    ):
        yield endpoint, driver


def device(url: str) -> Device:
    given = Settings()
    return registry.driver("ros2").create(DeviceOptions(url=url, settings=given.device, table=given.ros2))


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{"hash": "TypeHashNotSupported"}, {"tokens": False}, {"domain": 7}],
    ids=["humble", "no tokens", "domain"],
)
def test_other_systems_are_read_too(options: dict[str, object]) -> None:
    """Humble has no hashes; a plain client declares no tokens; a system may have another domain."""
    with system(**options) as (endpoint, _):
        made = device(f"ros2:/imu/data?router={endpoint}&domain={options.get('domain', 0)}")
        made.open()
        items: list[Item] = []
        until(lambda: items.extend(made.read(0.1)) or made.counters.messages >= 100)
        made.close()


def test_the_daemon_waits_for_the_topic_and_follows_its_driver(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with Daemon(f"ros2:/imu/data?router={endpoint}", tmp_path) as daemon:
        daemon.wait(lambda r: r.state == "waiting" and r.device.id == "ros2-imu-data")
        with ros2_actors.router(endpoint), ros2_actors.Driver(endpoint, "/other", 50.0, paused=True):
            until(lambda: "IMU topics: /other" in daemon.log)
            with ros2_actors.Driver(endpoint, "/imu/data", 200.0) as driver:
                first = daemon.samples(400)
                assert first.device.stream == "unknown"
                assert first.device.sample_rate_hz == pytest.approx(200.0, rel=1e-6)
                assert "unknown_compensation" in first.caveats
                driver.hide = 50
                driver.drop = 30
                gone = daemon.wait(lambda r: r.session.missing >= 80)
                assert gone.session.overruns == 1
                driver.unplug()
                daemon.wait(lambda r: r.state == "waiting")
                driver.replug()
                back = daemon.wait(lambda r: r.state == "running" and r.session.missing > 200)
                assert back.session.restarts == 0
                grid = round(back.session.elapsed_s * 200.0)
                assert grid == back.session.samples + back.session.missing
        code, _, log = daemon.stop()
    assert code == 0
    assert f"no Zenoh router at {endpoint}" in log
    assert "IMU topics: /other" in log


# ---------------------------------------------------------------------- zenoh-ros2-sdk


@contextmanager
def sdk(command: str, endpoint: str, topic: str, *words: object) -> Iterator[subprocess.Popen[str]]:
    if importlib.util.find_spec("zenoh_ros2_sdk") is None:
        pytest.skip("zenoh-ros2-sdk is not installed (extra peers)")
    host, _, port = endpoint.removeprefix("tcp/").partition(":")
    program = [sys.executable, str(TESTS / "ros2_sdk.py"), command, host, port, topic]
    process = subprocess.Popen(
        [*program, *map(str, words)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def is_heard(publication: Publication) -> bool:
    """Whether a topic of imumon has a subscription."""
    return bool(cast("ZenohPublication", publication)._publisher.matching_status.matching)


def line(pipe: IO[str] | None) -> str:
    return pipe.readline()


def test_we_read_what_zenoh_ros2_sdk_publishes_and_it_sees_us() -> None:
    endpoint = free_endpoint()
    with ros2_actors.router(endpoint), sdk("publish", endpoint, "/imu/sdk") as driver:
        assert line(driver.stdout) == "ready\n"
        made = device(f"ros2:/imu/sdk?router={endpoint}")
        info = made.open()
        assert info.settings["publisher"] == "/sdk_driver"
        driver.stdin.write("go\n")
        driver.stdin.flush()
        items: list[Item] = []
        assert line(driver.stdout) == "sent\n"
        until(lambda: items.extend(made.read(0.1)) or made.counters.messages >= 400)
        with sdk("info", endpoint, "/imu/sdk") as asked:
            shown = json.loads(line(asked.stdout))
        items += made.finish()
        made.close()
    found = samples(items)
    assert found[:, 0].tolist() == [float(k) for k in range(400)]
    assert found[:, 5].tolist() == [9.8125 + k for k in range(400)]
    assert shown["topics"]["/imu/sdk"] == ["sensor_msgs/msg/Imu"]
    assert sorted(shown["nodes"]) == ["imumon", "sdk_driver"]


def test_a_publication_has_the_hash_of_the_distribution() -> None:
    with system(hash="TypeHashNotSupported") as (endpoint, _):
        node = open_node(parse_url(f"ros2:/x?router={endpoint}"))
        listener = open_node(parse_url(f"ros2:/x?router={endpoint}"))
        heard = listener.subscribe("/out", IMU)
        until(node.publishers)
        publication = node.advertise("/out", IMU)
        until(lambda: is_heard(publication))
        publication.publish(imu_payload(1, [0.0] * 3, [0.0] * 3), 1)
        got = until(heard.take)
        node.close()
        listener.close()
    assert publication._hash == "TypeHashNotSupported"
    assert len(got) == 1
    assert type_hash(IMU) != "TypeHashNotSupported"
    assert got[0].sequence == 1


@pytest.mark.slow
def test_a_driver_that_restarts_or_changes_its_rate_is_handled_like_a_sensor(tmp_path: Path) -> None:
    """A restart is a gap of known length; another rate is another record; a restarted daemon continues."""
    endpoint = free_endpoint()
    url = f"ros2:/imu/data?router={endpoint}"
    with ros2_actors.router(endpoint):
        with ros2_actors.Driver(endpoint, "/imu/data", 200.0), Daemon(url, tmp_path) as daemon:
            before = daemon.samples(1000)
            daemon.stop()
        with Daemon(url, tmp_path) as daemon:
            with ros2_actors.Driver(endpoint, "/imu/data", 200.0) as driver:
                after = daemon.wait(lambda r: r.state == "running" and r.session.samples > 1500)
                assert after.session.samples > before.session.samples
                assert after.session.missing > 100
                driver.end()
                daemon.wait(lambda r: r.state == "waiting")
            with ros2_actors.Driver(endpoint, "/imu/data", 200.0) as driver:
                back = daemon.wait(
                    lambda r: r.state == "running" and r.session.missing > after.session.missing
                )
                assert back.session.samples >= after.session.samples
                driver.set_rate(100.0)
                slower = daemon.wait(lambda r: 0.0 < (r.device.sample_rate_hz or 0.0) < 150.0)
                assert slower.device.sample_rate_hz == pytest.approx(100.0, rel=1e-3)
            _, _, log = daemon.stop()
    assert "/imu/data has no publisher any more" in log
    assert "sample rate" in log
