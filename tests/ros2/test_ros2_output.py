"""What the daemon publishes in a ROS 2 system, and ROS 2 over DDS."""

from __future__ import annotations

import importlib.util
import random
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ros2_actors
from daemons import Daemon, n_is_within_a_tenth
from free_ports import free_endpoint
from reports import nothing_yet, report, with_coefficients
from ros2_actors import imu_payload
from ros2_messages import decode
from waiting import until

from imumon.cli.exit_codes import exit_code
from imumon.config import Settings
from imumon.model.report import Report
from imumon.model.samples import Item, SampleBlock
from imumon.ros2.diagnostics import DIAGNOSTICS, DiagnosticLevel, diagnostics, sample_variances
from imumon.ros2.node import RosError, RosNode
from imumon.ros2.ros_messages import DIAGNOSTIC_ARRAY, IMU
from imumon.ros2.ros_output import RosOutput
from imumon.ros2.topic_url import open_node, parse_url
from imumon.sources import registry
from imumon.sources.device import Device, DeviceOptions


def statuses(report: Report) -> dict[str, dict[str, Any]]:
    """Statuses of a report by name, with their values as a dict."""
    fields = decode(DIAGNOSTIC_ARRAY, diagnostics(report, 1_700_000_000_000_000_000, "imumon"))
    assert fields["header"]["stamp"]["sec"] == 1_700_000_000
    return {
        each["name"]: {**each, "values": {pair["key"]: pair["value"] for pair in each["values"]}}
        for each in fields["status"]
    }


def test_each_sensor_and_the_stream_have_a_status() -> None:
    made = report(200.0)
    shown = statuses(made)
    assert list(shown) == ["imumon: stream", "imumon: gyro", "imumon: accel"]
    gyro = shown["imumon: gyro"]
    assert gyro["hardware_id"] == made.device.serial
    assert gyro["values"]["grade"] == made.grade["gyro"].meets
    assert gyro["values"]["provisional"] == str(made.grade["gyro"].provisional).lower()
    n = made.channels["gyro/x"].coefficients["N"]
    assert gyro["values"]["N x"].startswith(f"{n.readable.value:.3g}"[:4])
    assert "deg/sqrt(h)" in gyro["values"]["N x"]
    drift = made.channels["gyro/x"].drift
    assert ("drift x" in gyro["values"]) == (drift is not None and drift.per_hour is not None)
    stream = shown["imumon: stream"]["values"]
    assert stream["samples"] == str(made.session.samples)
    assert stream["missing"] == str(made.session.missing)
    assert stream["gaps"] == str(made.session.gaps)


def test_the_level_follows_the_severity() -> None:
    calm = replace(report(200.0), session=replace(report(200.0).session, missing=0))
    assert statuses(calm)["imumon: stream"]["level"] == DiagnosticLevel.OK
    lossy = replace(calm, session=replace(calm.session, recent_loss=0.02))
    assert (
        statuses(replace(lossy, alarm_limits={"loss": 0.05}))["imumon: stream"]["level"] == DiagnosticLevel.OK
    )
    assert statuses(lossy)["imumon: stream"]["level"] == DiagnosticLevel.WARN
    assert "missing" in statuses(lossy)["imumon: stream"]["message"]
    gone = statuses(replace(calm, state="waiting"))
    assert {each["level"] for each in gone.values()} == {DiagnosticLevel.ERROR}
    assert statuses(nothing_yet())["imumon: stream"]["level"] == DiagnosticLevel.STALE
    axes = {name: replace(each, caveats=("not_at_rest",)) for name, each in calm.channels.items()}
    assert statuses(replace(calm, channels=axes))["imumon: gyro"]["level"] == DiagnosticLevel.WARN


def test_variances_are_those_of_measured_coefficients_only() -> None:
    made = report(200.0)
    found = sample_variances(made, "gyro")
    n, rate = made.channels["gyro/y"].coefficients["N"], made.device.sample_rate_hz
    assert found[1] == pytest.approx(n.value**2 * rate)
    std = made.channels["gyro/y"].std
    assert std is not None
    bounded = replace(n, value=None, status="upper_bound")
    channels = {**made.channels, "gyro/y": with_coefficients(made.channels["gyro/y"], N=bounded)}
    assert sample_variances(replace(made, channels=channels), "gyro") is None
    assert sample_variances(nothing_yet(), "gyro") is None


# ---------------------------------------------------------------------- a system


def variances_of(payload: bytes) -> tuple[list[float], list[float]]:
    """Return the variances of the three axes of both sensors; empty: unknown, all zero in the message."""
    fields = decode(IMU, payload)
    found = (fields[f"{name}_covariance"][0::4] for name in ("angular_velocity", "linear_acceleration"))
    gyro, accel = (list(each) if any(each) else [] for each in found)
    return gyro, accel


def test_a_daemon_publishes_diagnostics_and_covariances(tmp_path: Path) -> None:
    endpoint, settings = free_endpoint(), tmp_path / "config.toml"
    settings.write_text('[ros2]\ncovariance = "/imu/data_cov"\n')
    with (
        ros2_actors.router(endpoint),
        ros2_actors.Driver(endpoint, "/imu/data", 200.0),
        Daemon(
            f"ros2:/imu/data?router={endpoint}",
            tmp_path,
            *("--publish-diagnostics", "--config", str(settings)),
        ) as daemon,
    ):
        # the first report may hold half a second of samples, whose N is known to a quarter only
        daemon.wait(lambda r: bool(r.channels) and all(map(n_is_within_a_tenth, r.channels.values())))
        node = open_node(parse_url(f"ros2:/x?router={endpoint}"), "listener")
        given, out, shown = (
            node.subscribe(topic, kind)
            for topic, kind in (("/imu/data", IMU), ("/imu/data_cov", IMU), (DIAGNOSTICS, DIAGNOSTIC_ARRAY))
        )
        inputs: dict[bytes, Any] = {}
        outputs: list[Any] = []
        arrays: list[Any] = []

        def enough() -> bool:
            inputs.update((each.payload[:28], each.payload) for each in given.take())
            outputs.extend(out.take())
            arrays.extend(shown.take())
            known = sum(all(variances_of(each.payload)) for each in outputs if each.payload[:28] in inputs)
            return bool(arrays) and known > 300

        until(enough)
        graph = {(each.topic, each.type, each.node) for each in node.publishers()}
        node.close()
        code, _, log = daemon.stop()
    assert code == 0, log
    assert ("/imu/data_cov", IMU, "/imumon_output") in graph
    assert (DIAGNOSTICS, DIAGNOSTIC_ARRAY, "/imumon_output") in graph
    sequences = [each.sequence for each in outputs]
    assert sequences == list(range(sequences[0] or 0, (sequences[0] or 0) + len(sequences)))
    both = [each.payload for each in outputs if each.payload[:28] in inputs]
    assert len(both) > 300
    for payload in both:
        fields = decode(IMU, payload)
        before = decode(IMU, inputs[payload[:28]])
        assert fields["angular_velocity"] == before["angular_velocity"]
        assert fields["orientation_covariance"] == before["orientation_covariance"]
        assert fields["orientation_covariance"][0] == -1.0
        gyro, accel = variances_of(payload)  # of the driver's noise; none while one of its axes is unknown
        assert not gyro or gyro == pytest.approx([1e-6] * 3, rel=0.5)
        assert not accel or accel == pytest.approx([1e-4] * 3, rel=0.5)
    names = {each["name"] for each in decode(DIAGNOSTIC_ARRAY, arrays[-1].payload)["status"]}
    assert names == {"imumon: stream", "imumon: gyro", "imumon: accel"}


def test_the_accelerometer_of_another_topic_is_not_that_of_the_messages() -> None:
    """The main topic has an accelerometer of its own: what was measured of another one does not describe it."""
    endpoint = free_endpoint()
    settings = replace(Settings().ros2, covariance="/out")
    with ros2_actors.router(endpoint), ros2_actors.Driver(endpoint, "/gyro", 200.0):
        made = RosOutput(settings, f"ros2:/gyro?accel=/accel&router={endpoint}")
        node = open_node(parse_url(f"ros2:/x?router={endpoint}"), "listener")
        heard = node.subscribe("/out", IMU)
        made.update(report(200.0))
        fields = decode(IMU, until(heard.take)[0].payload)
        made.close()
        node.close()
    assert fields["angular_velocity_covariance"][0] > 0.0
    assert fields["linear_acceleration_covariance"] == [0.0] * 9


@pytest.mark.parametrize(
    ("port", "topic", "words"),
    [
        ("sim", "/out", "needs messages"),
        ("ros2:/imu", "imu", "is the topic"),
        ("ros2:/imu", "a b", "no name"),
    ],
)
def test_covariances_need_another_topic(port: str, topic: str, words: str) -> None:
    with pytest.raises(RosError) as caught:
        RosOutput(replace(Settings().ros2, covariance=topic), port)
    assert words in caught.value.message
    assert caught.value.cure
    assert exit_code(caught.value) == 2


# ---------------------------------------- ROS 2 over DDS


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
    assert "[dds]" in caught.value.cure


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
