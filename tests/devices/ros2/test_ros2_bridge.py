"""A VN-100 through its port and, by a bridge, through a ROS 2 topic: the same numbers."""

from __future__ import annotations

import struct
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import ros2_actors
import zenoh
from daemons import Daemon
from ros2_actors import IMU_HASH, free_router, imu_payload
from waiting import until

from imumon.config import Settings
from imumon.model.report import DeviceDescription, Report, SessionCounters
from imumon.model.samples import ACCEL, GYRO, SampleBlock
from imumon.record import Record
from imumon.sources import registry
from imumon.sources.device import DeviceOptions
from imumon.sources.vn100.emulator import EmulatorSettings, spawn

RATE_HZ = 200.0
BAUD = 230400
"""bit/s at which imumon requests deltas at this rate."""
SPEED = 10.0
SECONDS = 60.0
UNIX_NS = 1_700_000_000_000_000_000


class Bridge:
    """Publishes samples of a VN-100 as a driver of ROS 2 would, with the stamps of the sensor."""

    def __init__(self, endpoint: str, topic: str) -> None:
        self.session: Any = ros2_actors._open({**ros2_actors.PEER, "connect/endpoints": [endpoint]})
        key = f"0/{topic.strip('/')}/sensor_msgs::msg::dds_::Imu_/{IMU_HASH}"
        block = zenoh.CongestionControl.BLOCK  # reliable and keep all: the emulator runs faster than time
        self.publisher = self.session.declare_publisher(key, congestion_control=block)
        tail = f"{topic.replace('/', '%')}/sensor_msgs::msg::dds_::Imu_/{IMU_HASH}/::,7:,:,:,,"
        token = f"@ros2_lv/0/{self.session.zid()}/0/10/MP/%/%/vectornav/{tail}"
        self.token = self.session.liveliness().declare_token(token)
        self.sent = 0

    def send(self, block: SampleBlock) -> None:
        assert block.time_ns is not None
        columns = [block.stream.channels.index(name) for name in (*GYRO, *ACCEL)]
        for row, stamp in zip(block.values[:, columns].tolist(), block.time_ns.tolist(), strict=True):
            self.sent += 1
            attachment = struct.pack("<qqB16s", self.sent, time.time_ns(), 16, b"vectornav-bridge")
            self.publisher.put(imu_payload(UNIX_NS + stamp, row[:3], row[3:]), attachment=attachment)


def overlapping(a: Any, b: Any) -> bool:
    """Whether the 95 % limits of two coefficients overlap; a bound is an interval from 0."""
    if "pending" in (a.status, b.status):
        return a.status == b.status
    return bool((a.low or 0.0) <= b.high and (b.low or 0.0) <= a.high)


@pytest.mark.slow
def test_a_bridged_sensor_has_the_numbers_of_its_port(tmp_path: Path) -> None:
    endpoint = free_router()
    settings = EmulatorSettings(seed=5, rate=40.0, baud=BAUD, speed=SPEED)
    with (
        ros2_actors.router(endpoint),
        Daemon(f"ros2:/vectornav/imu?router={endpoint}", tmp_path / "ros2") as daemon,
        spawn(settings) as emulator,
    ):
        sensor = registry.driver("vn100").create(
            DeviceOptions(url=emulator.path, settings=replace(Settings().device, baud=BAUD), time_lapse=True)
        )
        sensor.open()
        sensor.start()
        bridge, monitor = Bridge(endpoint, "/vectornav/imu"), Record()
        daemon.wait(lambda r: r.state != "waiting")
        until(lambda: bridge.publisher.matching_status.matching)
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            for item in sensor.read(0.2):
                if isinstance(item, SampleBlock):
                    monitor.feed(item)
                    bridge.send(item)
        sensor.restore()
        sensor.close()
        monitor.flush()
        port: Report = monitor.report(
            datetime.now(UTC), DeviceDescription(id="x"), "stopped", SessionCounters()
        )
        bridged = daemon.wait(lambda r: r.session.samples + r.session.missing >= bridge.sent)
        _, _, log = daemon.stop()
        bridge.session.close()
    assert bridged.device.sample_rate_hz == pytest.approx(RATE_HZ, rel=1e-4)
    assert bridged.session.samples == port.session.samples == bridge.sent, log
    assert bridged.session.missing == 0
    for name in (*GYRO, *ACCEL):
        a, b = port.channels[name], bridged.channels[name]
        assert a.coefficients["N"].value is not None
        assert b.coefficients["N"].value == pytest.approx(a.coefficients["N"].value, rel=0.01)
        for letter in "BK":
            one, other = a.coefficients[letter], b.coefficients[letter]
            assert overlapping(one, other), (name, one, other)
