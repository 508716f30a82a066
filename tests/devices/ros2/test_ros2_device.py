"""The device ros2: messages to samples, and a topic that comes, goes and changes."""

from __future__ import annotations

import importlib.util
import json
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
import pytest
import ros2_actors
from daemons import Daemon
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import TESTS
from ros2_actors import free_router, imu_payload
from ros2_messages import encode, header
from waiting import until

from imumon.config import Settings
from imumon.devices import registry
from imumon.devices.base import Device, DeviceLost, DeviceNotFound, DeviceOptions, InvalidOption
from imumon.devices.ros2.imu_assembler import ImuAssembler
from imumon.pipeline import Monitor
from imumon.ros2.node import Publication, Received
from imumon.ros2.ros_messages import IMU, MAGNETIC_FIELD, TEMPERATURE, type_hash
from imumon.ros2.topic_url import open_node, parse_url
from imumon.ros2.zenoh_node import ZenohPublication
from imumon.samples import ACCEL, GYRO, Item, Notice, SampleBlock

UNIX_NS = 1_700_000_000_000_000_000
STEP_NS = 5_000_000
OTHER = imu_payload(UNIX_NS, [-1.0] * 3, [-1.0] * 3)


# ---------------------------------------------------------------------- messages to blocks


def received(
    index: int, *, sequence: int | None = None, publisher: bytes = b"a", payload: bytes | None = None
) -> Received:
    stamp = UNIX_NS + index * STEP_NS
    number = float(index + 1)
    made = payload if payload is not None else imu_payload(stamp, [number, 2.0, 3.0], [4.0, 5.0, number])
    return Received(made, index + 1 if sequence is None else sequence, stamp, publisher)


def assemble(url: str, messages: list[Received], **others: list[Received]) -> tuple[ImuAssembler, list[Item]]:
    """Everything that some messages become; 40 arrive at once."""
    made = ImuAssembler(parse_url(url))
    items: list[Item] = []
    for at in range(0, len(messages), 40):
        part = messages[at : at + 40]
        until = max(message.source_ns or 0 for message in part)
        now = {name: [m for m in others[name] if (m.source_ns or 0) <= until] for name in others}
        others = {name: [m for m in others[name] if (m.source_ns or 0) > until] for name in others}
        items += made.add(part, now, until)
    return made, items + made.finish()


def samples(items: list[Item]) -> np.ndarray[Any, Any]:
    return np.concatenate([item.values for item in items if isinstance(item, SampleBlock)])


def test_messages_become_samples_at_their_stamps() -> None:
    made, items = assemble("ros2:/imu", [received(k) for k in range(500)])
    assert made.stream is not None
    assert made.stream.channels == (*GYRO, *ACCEL)
    assert made.stream.kind == "unknown"
    assert samples(items)[:, 0].tolist() == [float(k + 1) for k in range(500)]
    times = np.concatenate(
        [item.time_ns for item in items if isinstance(item, SampleBlock) and item.time_ns is not None]
    )
    assert times.tolist() == [UNIX_NS + k * STEP_NS for k in range(500)]
    assert (made.messages, made.invalid, made.lost, made.remarks) == (500, 0, 0, [])


def test_lost_messages_are_not_missing_samples() -> None:
    """What the driver never published is missing; what the network lost is missing and counted as lost."""
    rows = [received(k, sequence=k + 1 if k < 100 else k - 9) for k in range(500) if not 100 <= k < 110]
    made, _ = assemble("ros2:/imu", rows)
    assert made.lost == 0
    lossy = [received(k) for k in range(500) if k not in (200, 300, 301)]
    made, items = assemble("ros2:/imu", lossy)
    assert (made.lost, made.losses) == (3, 2)
    notices = [item for item in items if isinstance(item, Notice)]
    assert [(notice.kind, notice.level) for notice in notices] == [("remark", "info")]  # the alarm is `loss`


def test_a_quantity_without_an_estimate_is_no_channel() -> None:
    def without_accel(index: int) -> bytes:
        data = bytearray(imu_payload(UNIX_NS + index * STEP_NS, [1.0, 2.0, float(index)], [0.0, 0.0, 0.0]))
        struct.pack_into("<d", data, 28 + 8 * 28, -1.0)
        return bytes(data)

    made, items = assemble("ros2:/imu", [received(k, payload=without_accel(k)) for k in range(300)])
    assert made.stream is not None
    assert made.stream.channels == GYRO
    assert samples(items).shape == (300, 3)


def test_a_sensor_that_is_always_zero_is_left_out_with_a_remark() -> None:
    rows = [
        received(k, payload=imu_payload(UNIX_NS + k * STEP_NS, [0.0] * 3, [1.0, 2.0, k])) for k in range(300)
    ]
    made, _ = assemble("ros2:/imu", rows)
    assert made.stream is not None
    assert made.stream.channels == ACCEL
    assert made.remarks == ["gyro is zero in all messages of /imu: left out"]


def test_invalid_messages_are_counted_and_their_samples_are_missing() -> None:
    rows = [received(k) for k in range(400)]
    rows[200] = received(200, payload=b"\0\1\0\0nonsense")
    rows[300] = received(
        300, payload=imu_payload(UNIX_NS + 300 * STEP_NS, [float("nan"), 0.0, 0.0], [0.0] * 3)
    )
    made, items = assemble("ros2:/imu", rows)
    assert made.invalid == 2
    assert len(samples(items)) == 398
    assert made.messages == len(samples(items)) + made.invalid


def test_two_publishers_are_not_mixed() -> None:
    other = [
        received(k, publisher=b"b", payload=imu_payload(UNIX_NS + k, [-1.0] * 3, [-1.0] * 3))
        for k in range(400)
    ]
    mixed = [each for pair in zip([received(k) for k in range(400)], other, strict=True) for each in pair]
    made, items = assemble("ros2:/imu", mixed)
    assert len(samples(items)) == 400
    assert made.invalid == 400
    assert (samples(items) > 0.0).all()
    assert any("several nodes" in item.text for item in items if isinstance(item, Notice))


def test_a_publisher_that_restarts_is_followed_after_half_a_second() -> None:
    rows = [received(k) for k in range(400)]
    rows += [received(k, sequence=k - 599, publisher=b"b") for k in range(600, 1000)]
    made, items = assemble("ros2:/imu", rows)
    assert len(samples(items)) == 800
    assert (made.lost, made.invalid) == (0, 0)


def test_a_late_batch_of_two_publishers_is_no_silence_of_the_first() -> None:
    """A host that is busy for a second takes the messages of both at once: the first one was not silent."""
    made = ImuAssembler(parse_url("ros2:/imu"))
    items = made.add([received(k) for k in range(100)], {}, UNIX_NS)
    both = [
        received(k, publisher=publisher, payload=None if publisher == b"a" else OTHER)
        for k in range(100, 400)
        for publisher in (b"b", b"a")
    ]
    items += made.add(both, {}, UNIX_NS + 1_500_000_000) + made.finish()
    assert samples(items)[:, 0].tolist() == [float(k + 1) for k in range(400)]
    assert (made.invalid, made.lost) == (300, 0)


@pytest.mark.parametrize("delay_ns", [0, 1_000_000])
def test_separate_topics_are_paired_by_their_stamps(delay_ns: int) -> None:
    gyro = [
        received(k, payload=imu_payload(UNIX_NS + k * STEP_NS, [1.0, 2.0, float(k)], [0.0] * 3))
        for k in range(600)
    ]
    accel = [
        received(k, payload=imu_payload(UNIX_NS + k * STEP_NS + delay_ns, [0.0] * 3, [float(k), 1.0, 9.81]))
        for k in range(600)
        if k != 450
    ]
    made, items = assemble("ros2:/gyro?accel=/accel", gyro, accel=accel)
    found = samples(items)
    assert made.stream is not None
    assert made.stream.channels == (*GYRO, *ACCEL)
    assert len(found) == 599
    assert (found[:, 2] == found[:, 3]).all()
    assert made.invalid == 1


def test_an_accelerometer_of_another_rate_is_left_out_with_a_remark() -> None:
    gyro = [received(k) for k in range(900)]
    accel = [
        received(k, payload=imu_payload(UNIX_NS + k * 16_000_000, [0.0] * 3, [1.0, 1.0, k]))
        for k in range(300)
    ]
    made, items = assemble("ros2:/gyro?accel=/accel", gyro, accel=accel)
    assert made.stream is not None
    assert made.stream.channels == GYRO
    assert len(samples(items)) == 900
    assert made.remarks[0].startswith("/accel (62.5 Hz) is left out")


def test_magnetic_field_and_temperature_have_the_units_of_channels() -> None:
    rows = [received(k) for k in range(600)]
    field = [
        Received(
            encode(
                MAGNETIC_FIELD,
                {
                    "header": header(UNIX_NS + k * STEP_NS),
                    "magnetic_field": {"x": 2e-5, "y": 0.0, "z": -4e-5},
                    "magnetic_field_covariance": [0.0] * 9,
                },
            ),
            k + 1,
            UNIX_NS + k * STEP_NS,
            b"m",
        )
        for k in range(600)
    ]
    warm = [
        Received(
            encode(TEMPERATURE, {"header": header(UNIX_NS), "temperature": 25.0 + k, "variance": 0.0}),
            k + 1,
            UNIX_NS + k * 1_000_000_000,
            b"t",
        )
        for k in range(3)
    ]
    made, items = assemble("ros2:/imu?mag=/mag&temperature=/temp", rows, mag=field, temperature=warm)
    assert made.stream is not None
    assert made.stream.channels[-4:] == ("mag/x", "mag/y", "mag/z", "temperature")
    found = samples(items)
    assert found[0, 6:9].tolist() == pytest.approx([0.2, 0.0, -0.4])
    assert (found[0, -1], found[-1, -1]) == (25.0, 27.0)
    assert len(found) == 600


# ---------------------------------------------------------------------- a system


@contextmanager
def system(*, rate_hz: float = 200.0, **options: object) -> Iterator[tuple[str, ros2_actors.Actor]]:
    """A router and a driver of /imu/data; gives the endpoint and the driver."""
    endpoint = free_router()
    with (
        ros2_actors.router(endpoint),
        ros2_actors.publisher(endpoint, "/imu/data", rate_hz, **options) as driver,
    ):
        yield endpoint, driver


def device(url: str) -> Device:
    given = Settings()
    return registry.driver("ros2").create(DeviceOptions(url=url, settings=given.device, table=given.ros2))


def read_until(made: Device, count: int, seconds: float = 60.0) -> list[Item]:
    items: list[Item] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end and sum(len(i) for i in items if isinstance(i, SampleBlock)) < count:
        items += made.read(0.1)
    return items


def test_the_id_is_that_of_the_topic() -> None:
    found = device("ros2:/imu/data").expected()
    assert found is not None
    assert found.id == "ros2-imu-data"
    assert found.baud is None


def test_a_wrong_url_is_an_invalid_option() -> None:
    with pytest.raises(InvalidOption):
        device("ros2:/imu/data?domain=abc")


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{"hash": "TypeHashNotSupported"}, {"tokens": "no"}, {"domain": "7"}],
    ids=["humble", "no tokens", "domain"],
)
def test_other_systems_are_read_too(options: dict[str, object]) -> None:
    """Humble has no hashes; a plain client declares no tokens; a system may have another domain."""
    with system(**options) as (endpoint, _):
        made = device(f"ros2:/imu/data?router={endpoint}&domain={options.get('domain', 0)}")
        made.open()
        assert len(samples(read_until(made, 100))) >= 100
        made.close()


@pytest.mark.slow
def test_a_router_that_restarts_is_found_again() -> None:
    endpoint = free_router()
    url = f"ros2:/imu/data?router={endpoint}"
    with ros2_actors.router(endpoint) as first, ros2_actors.publisher(endpoint, "/imu/data", 200.0):
        made = device(url)
        made.open()
        read_until(made, 50)
        first.kill()
        with pytest.raises(DeviceLost) as lost:
            read_until(made, 10_000)
        assert lost.value.code == "ros2_router_gone"
        made.close()
        with pytest.raises(DeviceNotFound) as missing:
            made.open()
        assert missing.value.code == "ros2_no_router"
        with ros2_actors.router(endpoint):
            made.open()
            assert len(samples(read_until(made, 100))) >= 100
            made.close()


def test_counters_add_up_over_losses() -> None:
    with system() as (endpoint, driver):
        made = device(f"ros2:/imu/data?router={endpoint}")
        made.open()
        read_until(made, 200)
        driver.ask("drop 7")
        items: list[Item] = []
        until(lambda: items.extend(made.read(0.1)) or any(isinstance(item, Notice) for item in items))
        read_until(made, 300)
        made.close()
    assert made.counters.overruns == 1
    assert made.counters.messages >= 500
    assert made.counters.bad_checksums == 0
    assert any(isinstance(item, Notice) and item.text.startswith("7 messages were lost") for item in items)


# ---------------------------------------------------------------------- the daemon


def test_the_daemon_waits_for_the_topic_and_follows_its_driver(tmp_path: Path) -> None:
    endpoint = free_router()
    with Daemon(f"ros2:/imu/data?router={endpoint}", tmp_path) as daemon:
        daemon.wait(lambda r: r.state == "waiting" and r.device.id == "ros2-imu-data")
        with ros2_actors.router(endpoint), ros2_actors.publisher(endpoint, "/other", 50.0, paused="yes"):
            until(lambda: "IMU topics: /other" in daemon.log)
            with ros2_actors.publisher(endpoint, "/imu/data", 200.0) as driver:
                first = daemon.samples(400)
                assert first.device.stream == "unknown"
                assert first.device.sample_rate_hz == pytest.approx(200.0, rel=1e-6)
                assert "unknown_compensation" in first.caveats
                driver.ask("hide 50")
                driver.ask("drop 30")
                gone = daemon.wait(lambda r: r.session.missing >= 80)
                assert gone.session.overruns == 1
                driver.ask("unplug")
                daemon.wait(lambda r: r.state == "waiting")
                driver.ask("replug")
                back = daemon.wait(lambda r: r.state == "running" and r.session.missing > 200)
                assert back.session.restarts == 0
                grid = round(back.session.elapsed_s * 200.0)
                assert grid == back.session.samples + back.session.missing
        code, _, log = daemon.stop()
    assert code == 0
    assert f"no Zenoh router at {endpoint}" in log
    assert "IMU topics: /other" in log
    assert "30 messages were lost" in log


@pytest.mark.slow
def test_a_run_without_a_topic_ends_with_the_list_of_topics(tmp_path: Path) -> None:
    with system() as (endpoint, _):
        command = [sys.executable, "-m", "imumon", "run", "--state", str(tmp_path), "--port"]
        done = subprocess.run(
            [*command, f"ros2:?router={endpoint}"], capture_output=True, text=True, timeout=120, check=False
        )
    assert done.returncode == 3
    assert "IMU topics: /imu/data" in done.stderr


@pytest.mark.slow
def test_a_duration_without_a_driver_is_exit_code_4(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "imumon", "run", "--state", str(tmp_path), "--duration", "1", "--port"]
    done = subprocess.run(
        [*command, f"ros2:/imu?router={free_router()}"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 4, done.stderr


@pytest.mark.slow
def test_doctor_shows_the_topic_and_lists_others() -> None:
    with system() as (endpoint, _):
        command = [sys.executable, "-m", "imumon", "doctor", "--json", "--port"]

        def checks(topic: str) -> dict[str, Any]:
            url = f"ros2:{topic}?router={endpoint}"
            done = subprocess.run([*command, url], capture_output=True, text=True, timeout=120, check=False)
            rows = json.loads(done.stdout)
            return {row["name"]: row for row in (rows["checks"] if isinstance(rows, dict) else rows)}

        there = checks("/imu/data")
        assert there["model"]["text"] == "published by /driver"
        assert there["rate"]["status"] == "ok"
        absent = checks("/absent")["sensor"]
    assert absent["status"] == "failed"
    assert "/imu/data" in absent["text"]


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
    assert pipe is not None
    return pipe.readline()


@pytest.mark.slow
def test_zenoh_ros2_sdk_reads_what_we_publish() -> None:
    endpoint = free_router()
    with ros2_actors.router(endpoint), sdk("listen", endpoint, "/imu/out", 5) as listener:
        assert line(listener.stdout) == "ready\n"
        node = open_node(parse_url(f"ros2:/x?router={endpoint}"))
        publication = node.advertise("/imu/out", IMU)
        until(lambda: is_heard(publication))
        for k in range(5):
            stamp = UNIX_NS + 123_456_789 + k
            publication.publish(imu_payload(stamp, [0.001, -0.002, 0.003], [0.25, -0.5, -9.8125]), stamp)
        got = json.loads(line(listener.stdout))
        node.close()
    assert [each["stamp"] for each in got] == [[1_700_000_000, 123_456_789 + k] for k in range(5)]
    assert got[0]["frame"] == "imu_link"
    assert got[0]["gyro"] == [0.001, -0.002, 0.003]
    assert got[0]["accel_z"] == -9.8125


def test_we_read_what_zenoh_ros2_sdk_publishes_and_it_sees_us() -> None:
    endpoint = free_router()
    with ros2_actors.router(endpoint), sdk("publish", endpoint, "/imu/sdk") as driver:
        assert line(driver.stdout) == "ready\n"
        made = device(f"ros2:/imu/sdk?router={endpoint}")
        info = made.open()
        assert info.settings["publisher"] == "/sdk_driver"
        assert driver.stdin is not None
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
    assert [message.hash for message in got] == ["TypeHashNotSupported"]
    assert type_hash(IMU) != "TypeHashNotSupported"
    assert got[0].sequence == 1


@pytest.mark.slow
def test_a_driver_that_restarts_or_changes_its_rate_is_handled_like_a_sensor(tmp_path: Path) -> None:
    """A restart is a gap of known length; another rate is another record; a restarted daemon continues."""
    endpoint = free_router()
    url = f"ros2:/imu/data?router={endpoint}"
    with ros2_actors.router(endpoint):
        with ros2_actors.publisher(endpoint, "/imu/data", 200.0), Daemon(url, tmp_path) as daemon:
            before = daemon.samples(1000)
            daemon.stop()
        with Daemon(url, tmp_path) as daemon:
            with ros2_actors.publisher(endpoint, "/imu/data", 200.0) as driver:
                after = daemon.wait(lambda r: r.state == "running" and r.session.samples > 1500)
                assert after.session.samples > before.session.samples
                assert after.session.missing > 100
                driver.kill()
                daemon.wait(lambda r: r.state == "waiting")
            with ros2_actors.publisher(endpoint, "/imu/data", 200.0) as driver:
                back = daemon.wait(
                    lambda r: r.state == "running" and r.session.missing > after.session.missing
                )
                assert back.session.samples >= after.session.samples
                driver.ask("rate 100")
                slower = daemon.wait(lambda r: 0.0 < (r.device.sample_rate_hz or 0.0) < 150.0)
                assert slower.device.sample_rate_hz == pytest.approx(100.0, rel=1e-3)
            _, _, log = daemon.stop()
    assert "/imu/data has no publisher any more" in log
    assert "sample rate" in log


def test_a_stream_continues_over_a_reconnection() -> None:
    """The temperature comes late after it: the stream is still the same, so the record can continue."""
    url = parse_url("ros2:/imu?temperature=/temp")
    warm = encode(TEMPERATURE, {"header": header(UNIX_NS), "temperature": 25.0, "variance": 0.0})
    first = ImuAssembler(url)
    first.add([received(k) for k in range(400)], {"temperature": [Received(warm, 1, UNIX_NS, b"t")]}, UNIX_NS)
    first.finish()
    again = ImuAssembler(url, first)
    items = again.add([received(k) for k in range(400)], {"temperature": []}, UNIX_NS) + again.finish()
    assert first.stream is not None
    assert again.stream == first.stream
    assert (samples(items)[:, -1] == 25.0).all()


@settings(max_examples=60)
@given(st.data())
def test_hostile_messages_never_raise_and_counts_add_up(data: st.DataObject) -> None:
    """Any stamps, sequence numbers, publishers and bytes: a message is a sample, a duplicate, or invalid."""
    stamps = st.one_of(
        st.integers(-(2**31), 2**31 - 1).map(lambda s: s * 10**9),
        st.integers(0, 400).map(lambda k: UNIX_NS + k * STEP_NS),
        st.sampled_from([0, 1, UNIX_NS]),
    )
    shape = data.draw(st.sampled_from(["steady", "bunched", "random", "zero"]))
    many = data.draw(st.integers(0, 700))
    seed = data.draw(st.randoms(use_true_random=False))
    odd = data.draw(st.lists(st.tuples(st.integers(0, 700), stamps), max_size=30))
    index = np.arange(many)
    times = {
        "steady": UNIX_NS + index * STEP_NS,
        "bunched": UNIX_NS + index // 7 * 7 * STEP_NS,
        "random": UNIX_NS + np.array([seed.randrange(10**12) for _ in index], np.int64),
        "zero": index * 0,
    }[shape].tolist()
    for at, stamp in odd:
        if at < many:
            times[at] = stamp
    rows = []
    for k, stamp in enumerate(times):
        payload = struct.pack("<4siII4x", b"\0\1\0\0", stamp // 10**9, stamp % 10**9, 1)
        payload += (
            struct.pack("<37d", *[k * 7919 % 101 / 7.0] * 37) if seed.random() < 0.98 else b"\0\1\0\0rubbish"
        )
        sequence = seed.choice([None, k, 2**62, -5, k + 1]) if seed.random() < 0.1 else k + 1
        rows.append(Received(payload, sequence, UNIX_NS + k * STEP_NS, seed.choice([b"a", b"a", b"b"])))
    made, items = assemble("ros2:/imu", rows)
    blocks = [item for item in items if isinstance(item, SampleBlock)]
    assert made.messages == len(rows) == sum(map(len, blocks)) + made.invalid
    monitor = Monitor()
    for block in blocks:
        monitor.feed(block)
    monitor.flush()
