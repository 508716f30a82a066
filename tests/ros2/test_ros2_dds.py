"""ROS 2 over DDS: Cyclone DDS here and in another process."""

from __future__ import annotations

import importlib.util
import random
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from ros2_actors import imu_payload

from imumon.config import Settings
from imumon.model.samples import Item, SampleBlock
from imumon.ros2.node import RosError, RosNode
from imumon.ros2.ros_messages import IMU
from imumon.ros2.topic_url import open_node, parse_url
from imumon.sources import registry
from imumon.sources.device import Device, DeviceOptions

INSTALLED = importlib.util.find_spec("cyclonedds") is not None
needs_dds = pytest.mark.skipif(not INSTALLED, reason="Cyclone DDS is not installed (extra dds)")


@pytest.fixture
def domain() -> int:
    """A domain that no other test uses."""
    return random.SystemRandom().randint(100, 220)


@pytest.fixture
def node(domain: int) -> Iterator[RosNode]:
    made = open_node(parse_url(f"ros2:/imu/data?rmw=dds&domain={domain}"))
    yield made
    made.close()


def device(domain: int, topic: str = "/imu/data") -> Device:
    url = f"ros2:{topic}?rmw=dds&domain={domain}"
    return registry.driver("ros2").create(DeviceOptions(url=url, settings=Settings().device))


def test_a_missing_cyclone_dds_is_an_error_with_a_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cyclonedds.domain", None)
    with pytest.raises(RosError) as caught:
        open_node(parse_url("ros2:/imu?rmw=dds"))
    assert caught.value.code == "dds_not_installed"
    assert ".[dds]" in caught.value.cure


def publish(node: RosNode, stop: threading.Event, rate_hz: float = 100.0) -> None:
    """Publish an IMU at rest until the event: 1e-3 rad/s and 1e-2 m/s^2."""
    topic = node.advertise("/imu/data", IMU)
    noise, gravity = np.random.default_rng(1), np.array([0.0, 0.0, 9.81])
    begin, count = time.time_ns(), 0
    while not stop.is_set():
        stamp = begin + round(count * 1e9 / rate_hz)
        gyro, accel = noise.normal(scale=1e-3, size=3), noise.normal(gravity, 1e-2)
        topic.publish(imu_payload(stamp, gyro.tolist(), accel.tolist()), stamp)
        count += 1
        time.sleep(max(0.0, (begin + count * 1e9 / rate_hz - time.time_ns()) * 1e-9))


@needs_dds
def test_a_device_reads_what_another_participant_publishes(node: RosNode, domain: int) -> None:
    topic = node.advertise("/imu/data", IMU)
    made = device(domain)
    made.open()
    items: list[Item] = []
    for k in range(20_000):
        stamp = 1_700_000_000_000_000_000 + k * 5_000_000
        topic.publish(imu_payload(stamp, [float(k), 0.5, 0.25], [1.0, 2.0, 9.81]), stamp)
        items += made.read(0.002)
        if made.counters.messages > 150:  # the first ones are published before the reader is known
            break
    items += made.finish()
    made.close()
    values = np.concatenate([item.values for item in items if isinstance(item, SampleBlock)])
    assert len(values) > 100
    assert (np.diff(values[:, 0]) == 1.0).all()
