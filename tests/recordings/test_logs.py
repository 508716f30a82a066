"""Logs of autopilots and bags of other types: the samples of their own readers, with a remark on each choice."""

from __future__ import annotations

import json
import os
import re
import struct
import subprocess
import sys
import threading
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import imu, write_bag2
from commands import imumon
from logs import COMBINED, FIFO, SENSOR, VEHICLE_IMU, DataFlash, ulog
from paths import RECORDINGS, needs_recordings
from tables import read, replayed, truth

from imumon.sources.files import RecordingError
from imumon.sources.files.columns import parse_map
from imumon.sources.files.log_process.__main__ import serve

pyulog = pytest.importorskip("pyulog", reason="pyulog is not installed (extra px4)")
DFReader = pytest.importorskip("pymavlink.DFReader", reason="pymavlink is not installed (extra ardupilot)")


class InThread:
    """The log process as a thread: to start Python takes longer than most of these tests."""

    def __init__(self, command: list[str], **_: object) -> None:
        *_, kind, path, end = command
        pipe = Connection(os.dup(int(end)))

        def run() -> None:
            with pipe:
                serve(kind, Path(path), pipe)

        self._thread = threading.Thread(target=run)
        self._thread.start()

    def kill(self) -> None:
        pass

    def wait(self) -> None:
        self._thread.join()


REAL = ("selected",)
"""Words in the names of tests with the real process; tests/hostile and tests/recordings/test_tables.py have others."""


@pytest.fixture(autouse=True)
def _in_thread(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if not any(word in request.node.name for word in REAL):
        monkeypatch.setattr("imumon.sources.files.log_file.Popen", InThread)


def combined(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, dt: int = 4000) -> list[tuple[Any, ...]]:
    return [(int(u), *g, dt, *a, dt) for u, g, a in zip(t, gyro, accel, strict=True)]


def integrals(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, dt: int = 4000) -> list[tuple[Any, ...]]:
    rows = zip(t, gyro * dt * 1e-6, accel * dt * 1e-6, strict=True)
    return [(int(u) + 700, int(u), *g, *a, dt, dt) for u, g, a in rows]


def points(t: np.ndarray, values: np.ndarray) -> list[tuple[Any, ...]]:
    return [(int(u) + 700, int(u), *v, 25.0) for u, v in zip(t, values, strict=True)]


N = 500
_, RATE_RAD, FORCE = truth(N)
T4 = 10**7 + np.arange(N) * 4000


# ---------------------------------------------------------------- real logs


@needs_recordings
@pytest.mark.parametrize("path", sorted(RECORDINGS.glob("px4_*.ulg")), ids=lambda path: path.stem)
def test_a_real_px4_log_has_the_samples_of_pyulog(path: Path) -> None:
    log = pyulog.ULog(str(path))
    expected = log.get_dataset("sensor_combined").data
    report, remarks = replayed(path)
    assert report.session.samples == len(expected["timestamp"])
    known = any(each.name == "sensor_gyro" for each in log.data_list)
    has = "gyro, accel, temperature" if known else "gyro, accel"
    assert report.device.source == f"px4 sensor_combined/0 ({has})"
    assert "sensor_combined/0 is used" in remarks
    found = read(path)
    for k in range(3):
        np.testing.assert_array_equal(found.values[:, k], expected[f"gyro_rad[{k}]"])
        np.testing.assert_array_equal(found.values[:, 3 + k], expected[f"accelerometer_m_s2[{k}]"])
    others = [each for each in log.data_list if each.name == "vehicle_imu"]
    for other in others[-1:]:
        chosen, remarks = replayed(path, topic=f"{other.name}/{other.multi_id}")
        assert chosen.session.samples == len(other.data["timestamp"])
        assert chosen.device.stream == "unknown"
        covered = re.search(r"its integrals cover ([\d.]+) % of the time", remarks)
        assert covered is not None
        assert 0.5 <= float(covered[1]) < 1.5
        assert "not used" not in remarks


@needs_recordings
def test_a_real_ardupilot_log_has_the_samples_of_pymavlink() -> None:
    path = RECORDINGS / "ardupilot_backend_log_80k.bin"
    log = DFReader.DFReader_binary(str(path))
    found: dict[str, list[Any]] = {"IMU": [], "ISBD": []}
    while (message := log.recv_msg()) is not None:
        if message.get_type() in found:
            found[message.get_type()].append(message)
    for instance in (0, 1):
        mine = [m for m in found["IMU"] if instance == m.I]
        ours = read(path, topic=f"IMU/{instance}")
        fields = ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ", "T")
        np.testing.assert_array_equal(ours.values, [[getattr(m, f) for f in fields] for m in mine])
    batch = read(path, topic="ISBD/gyro/0")
    assert len(batch) == 32 * len(found["ISBD"]) == 576
    expected = np.concatenate([np.column_stack([m.x, m.y, m.z]) for m in found["ISBD"]]) / 938
    np.testing.assert_allclose(batch.values[:, :3], expected, rtol=1e-12)
    of_imu = [m.T for m in found["IMU"] if m.I == 0]
    assert min(of_imu) <= batch.values[:, 3].min() <= batch.values[:, 3].max() <= max(of_imu)
    report, remarks = replayed(path)
    assert report.session.samples == 10
    assert report.device.model == "ArduPilot Pixhawk4"
    assert (report.device.firmware or "").startswith("ArduCopter V4.6.2")
    assert "--topic selects another: IMU/1, ISBD/gyro/0" in remarks


# ---------------------------------------------------------------- PX4: choice of the topic


def test_integrals_that_cover_the_time_are_used_first(tmp_path: Path) -> None:
    topics = [
        ("sensor_combined", 0, COMBINED, combined(T4, RATE_RAD + 1.0, FORCE)),
        ("vehicle_imu", 0, VEHICLE_IMU, integrals(T4, RATE_RAD, FORCE)),
        ("vehicle_imu", 1, VEHICLE_IMU, integrals(T4, RATE_RAD + 2.0, FORCE)),
    ]
    path = ulog(tmp_path / "a.ulg", topics)
    report, remarks = replayed(path)
    assert (report.device.stream, report.device.sample_rate_hz) == ("deltas", 250.0)
    assert report.device.model == "PX4 TEST_UNIT"
    assert "vehicle_imu/0 is used: averages over the interval at 250 Hz" in remarks
    assert "--topic selects another: vehicle_imu/1, sensor_combined/0" in remarks
    np.testing.assert_allclose(read(path).values, np.hstack([RATE_RAD, FORCE]), rtol=1e-5)
    for topic, more in (("vehicle_imu/1", 2.0), ("sensor_combined", 1.0)):
        np.testing.assert_allclose(read(path, topic=topic).values[:, :3], RATE_RAD + more, rtol=1e-5)
    with pytest.raises(RecordingError, match="vehicle_imu/1") as error:
        read(path, topic="vehicle_imu/2")
    assert error.value.code == "unknown_topic"


def test_averages_have_the_temperature_of_their_gyroscope(tmp_path: Path) -> None:
    rare = [(t, t, 0.0, 0.0, 0.0, 20.0 + k) for k, t in enumerate(T4[:: len(T4) // 4].tolist())]
    topics = [
        ("vehicle_imu", 0, VEHICLE_IMU, integrals(T4, RATE_RAD, FORCE)),
        ("sensor_gyro", 0, SENSOR, rare),
    ]
    samples = read(ulog(tmp_path / "a.ulg", topics), topic="vehicle_imu/0")
    degrees = samples.values[:, -1]
    assert samples.values.shape[1] == 7
    assert degrees[0] == 20.0
    assert degrees[-1] == 20.0 + len(rare) - 1
    assert (np.diff(degrees) >= 0.0).all()
    both = [*topics, ("sensor_gyro", 1, SENSOR, rare)]  # without numbers of chips, nobody knows which
    assert read(ulog(tmp_path / "b.ulg", both), topic="vehicle_imu/0").values.shape[1] == 6
    numbered = [(*row, 7 + k) for k in (0, 1) for row in rare]
    chips = [
        ("sensor_gyro", k, f"{SENSOR};uint32_t device_id", numbered[k * len(rare) :][: len(rare)])
        for k in (0, 1)
    ]
    chips.append(("sensor_combined", 0, COMBINED, combined(T4, RATE_RAD, FORCE)))
    assert read(ulog(tmp_path / "c.ulg", chips), topic="sensor_combined/0").values.shape[1] == 6
    chips.append(("sensor_selection", 0, "uint64_t timestamp;uint32_t gyro_device_id", [(0, 8)]))
    assert read(ulog(tmp_path / "d.ulg", chips), topic="sensor_combined/0").values[-1, -1] == degrees[-1]


@pytest.mark.parametrize(("dt", "used"), [(3700, "vehicle_imu/0"), (3520, "sensor_gyro/0")])
def test_integrals_with_pauses_are_not_used(tmp_path: Path, dt: int, used: str) -> None:
    times = np.repeat(T4, 2)[: 2 * N - 1].astype(float)
    times[1::2] += 2000
    # samples between those of the integrals: rows that repeat would be no samples
    gyro, accel = (
        np.insert(values, np.arange(1, N), 0.5 * (values[1:] + values[:-1]), axis=0)
        for values in (RATE_RAD, FORCE)
    )
    topics = [
        ("vehicle_imu", 0, VEHICLE_IMU, integrals(T4, RATE_RAD, FORCE, dt)),
        ("sensor_combined", 0, COMBINED, combined(T4[::2], RATE_RAD[::2], FORCE[::2])),
        ("sensor_gyro", 0, SENSOR, points(times, gyro)),
        ("sensor_accel", 0, SENSOR, points(times, accel)),
    ]
    report, remarks = replayed(ulog(tmp_path / "a.ulg", topics))
    assert f"{used} is used" in remarks
    assert ("vehicle_imu/0 not used: its integrals cover 88 % of the time" in remarks) == (dt == 3520)
    assert report.session.samples == (N if dt == 3700 else 2 * N - 1)
    assert set(report.channels) >= {"gyro/x", "accel/z"}


def test_the_parts_of_a_flight_at_rest_are_found_and_the_report_says_how_long_they_are(
    tmp_path: Path,
) -> None:
    """A minute at rest, 20 s of flight, a minute at rest; N of the gyroscope is 7e-4 rad/s at 100 Hz."""
    n, rng = 14_000, np.random.default_rng(8)
    t = 10**7 + np.arange(n) * 10_000
    gyro, accel = rng.normal(0.001, 7e-4, (n, 3)), rng.normal((0.1, -0.2, -9.8), 0.013, (n, 3))
    flight = slice(6000, 8000)
    swing = np.sin(np.arange(2000)[:, None] / [40.0, 55.0, 70.0])
    gyro[flight] += 0.5 * swing
    accel[flight] += 2.0 * swing
    path = ulog(tmp_path / "a.ulg", [("vehicle_imu", 0, VEHICLE_IMU, integrals(t, gyro, accel, 10_000))])
    shown = imumon("replay", path)
    found = re.search(r"Excluded: [^)]*?motion ([\d.]+)\s", shown)
    assert found
    assert 18.0 < float(found[1]) < 32.0
    report = json.loads(imumon("replay", path, "--json", "--stream", "deltas"))
    assert report["channels"]["gyro/x"]["N"]["value"] == pytest.approx(7e-5, rel=0.05)


def test_an_accelerometer_at_other_times_is_not_joined(tmp_path: Path) -> None:
    topics = [
        ("sensor_gyro", 0, SENSOR, points(T4, RATE_RAD)),
        ("sensor_accel", 0, SENSOR, points(T4[0] + np.arange(N // 2) * 7300, FORCE[: N // 2])),
    ]
    path = ulog(tmp_path / "a.ulg", topics)
    report, remarks = replayed(path)
    assert "sensor_accel not used: its samples are at other times" in remarks
    assert set(report.channels) == {"gyro/x", "gyro/y", "gyro/z", "temperature"}
    assert replayed(path, topic="sensor_accel")[0].session.samples == N // 2


def test_a_fifo_gives_all_samples_of_the_chip(tmp_path: Path) -> None:
    counts = np.rint(RATE_RAD[:400] / 1e-5).astype(int).reshape(100, 4, 3)
    rows = [
        (10**7 + k * 1000, 10**7 + k * 1000, 250.0, 1e-5, 4, *counts[k].T.ravel().tolist())
        for k in range(100)
    ]
    path = ulog(tmp_path / "a.ulg", [("sensor_gyro_fifo", 0, FIFO, rows)])
    found = read(path)
    assert found.stream.interval_s == pytest.approx(250e-6)
    np.testing.assert_allclose(found.values, counts.reshape(-1, 3) * 1e-5, rtol=1e-6)
    rare = [(t, t, 0.0, 0.0, 0.0, 20.0 + k) for k, t in enumerate((10**7, 10**7 + 99_000))]
    both = [
        ("sensor_gyro_fifo", 0, FIFO, rows),
        ("sensor_gyro", 0, SENSOR, rare),
        ("sensor_accel", 0, SENSOR, rare[:1]),
    ]
    degrees = read(ulog(tmp_path / "b.ulg", both), topic="sensor_gyro_fifo/0").values[:, -1]
    np.testing.assert_allclose(degrees, np.interp(np.arange(400) - 3, [0, 396], [20.0, 21.0]))


def test_a_truncated_log_is_read_to_where_it_ends(tmp_path: Path) -> None:
    path = ulog(tmp_path / "a.ulg", [("sensor_combined", 0, COMBINED, combined(T4, RATE_RAD, FORCE))])
    path.write_bytes(path.read_bytes()[:-7])
    assert len(read(path)) == N - 1
    path.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8))
    with pytest.raises(RecordingError) as error:
        read(path)
    assert error.value.code == "no_imu_topic"


# ---------------------------------------------------------------- ArduPilot


def test_instances_can_be_selected(tmp_path: Path) -> None:
    log = DataFlash()
    log.imu(RATE_RAD, FORCE, instances=3)
    path = log.write(tmp_path / "00000042.BIN")
    report, remarks = replayed(path)
    assert report.session.samples == N
    assert "IMU/0 is used: point samples at 200 Hz; --topic selects another: IMU/1, IMU/2" in remarks
    for k in (1, 2):
        np.testing.assert_allclose(read(path, topic=f"IMU/{k}").values[:, :3], RATE_RAD + k, rtol=1e-6)
    assert "ardupilot IMU/1 (gyro, accel, temperature)" in imumon(
        "replay", path, "--topic", "IMU/1", "--verbose"
    )


@pytest.mark.parametrize(
    ("suffix", "accel_us", "name"), [("", 0, "GYR/0"), ("", 300, "GYR/0"), ("1", 300, "GYR1")]
)
def test_raw_samples_take_the_place_of_an_imu(tmp_path: Path, suffix: str, accel_us: int, name: str) -> None:
    log = DataFlash()
    log.raw_samples(RATE_RAD, FORCE, suffix=suffix, accel_us=accel_us)
    path = log.write(tmp_path / "a.BIN")
    reader = DFReader.DFReader_binary(str(path))
    expected = {"GYR": [], "ACC": []}  # type: dict[str, list[Any]]
    while (message := reader.recv_match(type=[f"GYR{suffix}", f"ACC{suffix}"])) is not None:
        expected[message.get_type()[:3]].append(message)
    report, remarks = replayed(path)
    assert report.session.samples == len(expected["GYR"]) == N
    assert report.session.missing == 0
    assert report.device.sample_rate_hz == pytest.approx(1000.0)
    assert report.device.source == f"ardupilot {name} (gyro, accel)"
    assert f"{name} is used: point samples at 1000 Hz; --topic selects another: ACC{name[3:]}" in remarks
    found = read(path)
    np.testing.assert_array_equal(found.values[:, :3], [[m.GyrX, m.GyrY, m.GyrZ] for m in expected["GYR"]])
    np.testing.assert_array_equal(found.values[:, 3:], [[m.AccX, m.AccY, m.AccZ] for m in expected["ACC"]])
    alone = read(path, topic=f"ACC{name[3:]}")
    np.testing.assert_array_equal(alone.values, found.values[:, 3:])


def test_raw_samples_of_two_sensors_are_not_mixed(tmp_path: Path) -> None:
    log = DataFlash()
    log.raw_samples(RATE_RAD, FORCE, instances=2)
    path = log.write(tmp_path / "a.BIN")
    for k in (0, 1):
        found = read(path, topic=f"GYR/{k}").values
        np.testing.assert_allclose(found[:, :3], RATE_RAD + k, rtol=1e-6)
        np.testing.assert_allclose(found[:, 3:], FORCE + k, rtol=1e-6)


@pytest.mark.parametrize("topic", ["GYR/1", "ACC/1", "ISBD/gyro/0"])
def test_raw_samples_have_the_temperature_of_their_imu(tmp_path: Path, topic: str) -> None:
    log = DataFlash()
    log.raw_samples(RATE_RAD, FORCE, instances=2)
    log.imu(RATE_RAD[: N // 10], FORCE[: N // 10], instances=2, step_us=10_000, degrees=20.0)
    log.batch(1, 1, 10**6, 1000.0, 938, np.rint(1e3 * RATE_RAD).astype(int))
    degrees = read(log.write(tmp_path / "a.BIN"), topic=topic).values[:, -1]
    expected = 20.0 + int(topic[-1]) + 1e-4 * np.minimum(np.arange(N), N - 10)
    np.testing.assert_allclose(degrees, expected, rtol=1e-6)


def test_a_raw_accelerometer_of_another_rate_is_a_topic_of_its_own(tmp_path: Path) -> None:
    log = DataFlash()
    log.raw_samples(RATE_RAD, FORCE, accel_every=4)
    path = log.write(tmp_path / "a.BIN")
    report, remarks = replayed(path)
    assert report.device.source == "ardupilot GYR/0 (gyro)"
    assert "ACC/0 not used: its samples are at other times; as the chosen topic it is read alone" in remarks
    assert len(read(path, topic="ACC/0")) == N // 4


def test_the_imu_of_a_log_with_raw_samples_is_used_first(tmp_path: Path) -> None:
    log = DataFlash()
    log.raw_samples(RATE_RAD, FORCE)
    log.imu(RATE_RAD, FORCE)
    report, remarks = replayed(log.write(tmp_path / "a.BIN"))
    assert report.device.source == "ardupilot IMU/0 (gyro, accel, temperature)"
    assert "--topic selects another: GYR/0, ACC/0" in remarks


def test_batches_are_samples_with_pauses(tmp_path: Path) -> None:
    """Raw batches of gyroscope and accelerometer in turn, at 2 kHz, one message of which is lost."""
    log, rng = DataFlash(), np.random.default_rng(4)
    gyro = np.rint(rng.normal(5.0, 3.0, (6, 1000, 3))).astype(int)
    for k in range(6):
        log.batch(1, 2 * k, 10**6 + k * 2_000_000, 2000.0, 938, gyro[k])
        log.batch(0, 2 * k + 1, 2 * 10**6 + k * 2_000_000, 2000.0, 208, np.full((1000, 3), [0, 0, -2040]))
    path = log.write(tmp_path / "a.BIN")
    report, remarks = replayed(path, topic="ISBD/gyro/0")
    assert "pauses between them count as missing samples" in remarks
    assert report.session.samples == 6000
    assert report.session.missing == 5 * 3000
    np.testing.assert_allclose(read(path, topic="ISBD/gyro/0").values, gyro.reshape(-1, 3) / 938)
    size = 3 + 8 + 2 + 2 + 3 * 64
    data = path.read_bytes()
    at = data.rfind(bytes((0xA3, 0x95, 3)), 0, len(data) - 40 * size)
    path.write_bytes(data[:at] + data[at + size :])
    lost = replayed(path, topic="ISBD/gyro/0")[0].session
    assert lost.samples + replayed(path, topic="ISBD/accel/0")[0].session.samples == 12000 - 32


def test_foreign_bytes_in_a_log_are_skipped(tmp_path: Path) -> None:
    log = DataFlash()
    log.imu(RATE_RAD[:250], FORCE[:250])
    log.raw(bytes(700))
    log.imu(RATE_RAD[250:], FORCE[250:], define=False)
    path = log.write(tmp_path / "a.BIN")
    reader = DFReader.DFReader_binary(str(path))
    count = sum(1 for _ in iter(lambda: reader.recv_match(type="IMU"), None))
    assert len(read(path)) == count == N


# ---------------------------------------------------------------- packages, options, damage


@pytest.mark.parametrize(
    ("name", "package", "extra"), [("a.ulg", "pyulog", "px4"), ("a.BIN", "pymavlink", "ardupilot")]
)
def test_without_its_package_a_log_is_an_error_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, package: str, extra: str
) -> None:
    path = tmp_path / name
    path.write_bytes({"px4": b"ULog\x01\x12\x35", "ardupilot": b"\xa3\x95\x80"}[extra] + bytes(100))
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(RecordingError, match=package) as error:
        read(path)
    assert error.value.code == "package_missing"
    assert error.value.cure == f"pip install '.[{extra}]'"


def test_fields_of_a_log_can_be_named(tmp_path: Path) -> None:
    log = DataFlash()
    log.define("XYZ", "QBffffff", "TimeUS,I,p,q,r,u,v,w")
    for k in range(N):
        log.add("XYZ", 10**6 + k * 5000, 0, *np.degrees(RATE_RAD[k]), *FORCE[k])
    path = log.write(tmp_path / "a.BIN")
    with pytest.raises(RecordingError, match="XYZ") as error:
        read(path)
    assert error.value.code == "no_imu_topic"
    with pytest.raises(RecordingError) as error:
        read(path, topic="XYZ/0")
    assert error.value.code == "unknown_fields"
    assert "TimeUS, I, p, q, r, u, v, w" in error.value.cure
    given = "gyro/x=p:deg/s,gyro/y=q:deg/s,gyro/z=r:deg/s,accel/x=u,accel/y=v,accel/z=w"
    found = read(path, topic="XYZ", columns=parse_map(given))
    np.testing.assert_allclose(found.values, np.hstack([RATE_RAD, FORCE]), rtol=1e-5)
    assert found.stream.interval_s == pytest.approx(0.005)


# ---------------------------------------------------------------- bags of other types

FUSED = """string label
float64[] weights
my_msgs/Status[] states
sensor_msgs/Imu imu
uint8 quality
================================================================================
MSG: my_msgs/Status
string text
int64 code
"""
VECTORS = """builtin_interfaces/Time when
int16[3] gyro_counts
float32[3] force
string label
"""


def bag_of(
    path: Path, kind: str, definition: str, make: Any, *, ros: int = 2, n: int = 200, topic: str = "/fused"
) -> Path:
    """Write a bag of messages of another type."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    if ros == 1:
        definition = definition.replace("builtin_interfaces/Time", "time")
    store.register(get_types_from_msg(definition, kind))
    writer: Any = (
        rosbag1.Writer(path.with_suffix(".bag"))
        if ros == 1
        else rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin.MCAP)
    )
    with writer as bag:
        connection = bag.add_connection(topic, kind, typestore=store)
        for k in range(n):
            message = make(store, k)
            data = store.serialize_ros1(message, kind) if ros == 1 else store.serialize_cdr(message, kind)
            bag.write(connection, 1_700_000_000_000_000_000 + k * 10_000_000, bytes(data))
    return path.with_suffix(".bag") if ros == 1 else path


def fused(store: Any, k: int) -> Any:
    """Return a message whose strings and sequences have many lengths, also of equal sum."""
    status = store.types["my_msgs/msg/Status"]
    more = {"seq": k} if "seq" in {f[0] for f in store.fielddefs["std_msgs/msg/Header"][1]} else {}
    return store.types["my_msgs/msg/Fused"](
        label="a" * (k % 7),
        weights=np.arange(k % 3, dtype=float),
        states=[status(text="b" * ((6 - k) % 7), code=k)] * (k % 2),
        imu=imu(store, 1_700_000_000_000_000_000 + k * 10_000_000, RATE_RAD[k], FORCE[k], **more),
        quality=3,
    )


@pytest.mark.parametrize("ros", [1, 2])
def test_an_imu_inside_another_message_is_found(tmp_path: Path, ros: int) -> None:
    path = bag_of(tmp_path / "bag", "my_msgs/msg/Fused", FUSED, fused, ros=ros)
    found = read(path)
    np.testing.assert_array_equal(found.values, np.hstack([RATE_RAD, FORCE])[:200])
    assert found.time_ns is not None
    np.testing.assert_array_equal(found.time_ns, np.arange(200) * 10_000_000)


@pytest.mark.parametrize("ros", [1, 2])
def test_fields_of_a_bag_can_be_named(tmp_path: Path, ros: int) -> None:
    def make(store: Any, k: int) -> Any:
        time = store.types["builtin_interfaces/msg/Time"](
            sec=1_700_000_000 + k // 100, nanosec=k % 100 * 10**7
        )
        counts = np.rint(np.degrees(RATE_RAD[k]) * 1e3).astype(np.int16)
        force = (FORCE[k] / 9.80665).astype(np.float32)
        return store.types["my_msgs/msg/Raw"](when=time, gyro_counts=counts, force=force, label="x" * (k % 5))

    path = bag_of(tmp_path / "bag", "my_msgs/msg/Raw", VECTORS, make, ros=ros)
    with pytest.raises(RecordingError, match=r"/fused \(my_msgs/msg/Raw\)") as error:
        read(path)
    assert error.value.code == "no_imu_topic"
    with pytest.raises(RecordingError, match=r"gyro_counts\[0\], gyro_counts\[1\]") as error:
        read(path, topic="/fused")
    assert error.value.code == "unknown_fields"
    given = ",".join(f"gyro/{a}=gyro_counts[{k}]:mdeg/s,accel/{a}=force[{k}]:g" for k, a in enumerate("xyz"))
    found = read(path, topic="/fused", columns=parse_map(given))
    np.testing.assert_allclose(found.values[:, :3], RATE_RAD[:200], atol=np.radians(0.6e-3))
    np.testing.assert_allclose(found.values[:, 3:], FORCE[:200], rtol=1e-5)
    assert found.stream.interval_s == pytest.approx(0.01)
    by_arrival = read(path, topic="/fused", columns=parse_map(f"{given},t=log_time:ns"))
    assert by_arrival.stream.interval_s == pytest.approx(0.01)


def test_an_accelerometer_in_g_can_be_corrected(tmp_path: Path) -> None:
    stamps = 1_700_000_000_000_000_000 + np.arange(200) * 10_000_000
    path = write_bag2(
        tmp_path / "bag", [(int(s), g, a / 9.80665) for s, g, a in zip(stamps, RATE_RAD, FORCE, strict=False)]
    )
    with pytest.raises(RecordingError) as error:
        read(path)
    assert error.value.code == "wrong_unit"
    cure = error.value.cure.partition("--map ")[2]
    np.testing.assert_allclose(read(path, columns=parse_map(cure)).values[:, 3:], FORCE[:200], rtol=1e-9)


def test_a_telemetry_log_is_named_with_a_conversion_that_works(tmp_path: Path) -> None:
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    rng = np.random.default_rng(1)
    sender, path = mavlink.MAVLink(None, srcSystem=1), tmp_path / "a.tlog"
    with path.open("wb") as file:
        for k in range(600):
            gyro, accel = rng.normal(0.0, 30.0, 3), rng.normal((0.0, 0.0, -1000.0), 20.0, 3)
            numbers = (round(x) for x in (*accel, *gyro, 0.0, 0.0, 0.0))
            message = mavlink.MAVLink_scaled_imu2_message(10 * k, *numbers)
            file.write(struct.pack(">Q", 1_700_000_000_000_000 + 10_000 * k) + message.pack(sender))
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert error.value.code == "format_tlog"
    options = error.value.cure.partition("--map ")[2]
    dump = Path(sys.executable).parent / "mavlogdump.py"
    if not dump.exists():
        pytest.skip("the programs of pymavlink are not installed")
    words = [sys.executable, str(dump), "--types", "SCALED_IMU2", "--format", "csv", str(path)]
    table = tmp_path / "imu.csv"
    table.write_bytes(subprocess.run(words, capture_output=True, check=True).stdout)
    report, _ = replayed(table, columns=parse_map(options))
    assert report.session.samples >= 599
    assert report.channels["gyro/x"].coefficients["N"].value == pytest.approx(0.030 * 0.1, rel=0.15)


def test_a_bag_without_the_definition_of_its_messages_says_so(tmp_path: Path) -> None:
    import sqlite3

    from rosbags import rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("float64 x\nfloat64 y\nfloat64 z\n", "my_msgs/msg/Rates"))
    path = tmp_path / "bag"
    plugin = rosbag2.StoragePlugin.SQLITE3
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as bag:
        connection = bag.add_connection("/rates", "my_msgs/msg/Rates", typestore=store)
        for k in range(20):
            message = store.types["my_msgs/msg/Rates"](*map(float, RATE_RAD[k]))
            data = store.serialize_cdr(message, "my_msgs/msg/Rates")
            bag.write(connection, 1_700_000_000_000_000_000 + k * 10_000_000, bytes(data))
    database = sqlite3.connect(next(path.glob("*.db3")))
    database.execute("delete from message_definitions")
    database.commit()
    database.close()
    with pytest.raises(RecordingError) as error:
        read(path, topic="/rates")
    assert error.value.code == "no_definition"
    assert "my_msgs/msg/Rates" in error.value.message
