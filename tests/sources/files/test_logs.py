"""Logs of autopilots and bags of other types: the samples of their own readers, with a remark on each choice."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import imu, write_bag
from commands import imumon
from logs import COMBINED, FIFO, SENSOR, VEHICLE_IMU, DataFlash, ulog
from paths import RECORDINGS, needs_recordings
from tables import read, replayed, truth

from imumon.sources.files import RecordingError
from imumon.sources.files.columns import parse_map

pyulog = pytest.importorskip("pyulog", reason="pyulog is not installed (extra px4)")
DFReader = pytest.importorskip("pymavlink.DFReader", reason="pymavlink is not installed (extra ardupilot)")
pytestmark = pytest.mark.usefixtures("log_in_thread")


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


@pytest.mark.few
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
    found: dict[str, list[Any]] = {"IMU": []}
    while (message := log.recv_msg()) is not None:
        if message.get_type() in found:
            found[message.get_type()].append(message)
    for instance in (0, 1):
        mine = [m for m in found["IMU"] if instance == m.I]
        ours = read(path, topic=f"IMU/{instance}")
        fields = ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ", "T")
        np.testing.assert_array_equal(ours.values, [[getattr(m, f) for f in fields] for m in mine])
    report, remarks = replayed(path)
    assert report.session.samples == 10
    assert report.device.model == "ArduPilot Pixhawk4"
    assert (report.device.firmware or "").startswith("ArduCopter V4.6.2")
    assert "--topic selects another: IMU/1" in remarks


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
    assert error.value.cure == f"pip install 'imumon[{extra}]'"


def test_fields_of_a_log_can_be_named(tmp_path: Path) -> None:
    log = DataFlash()
    log.define("XYZ", "QBffffff", "TimeUS,I,p,q,r,u,v,w")
    for k in range(N):
        log.add("XYZ", 10**6 + k * 5000, 0, *np.degrees(RATE_RAD[k]), *FORCE[k])
    path = log.write(tmp_path / "a.BIN")
    with pytest.raises(RecordingError) as error:
        read(path, topic="XYZ/0", accept=False)
    assert error.value.code == "columns_unclear"
    given = "gyro/x=p:deg/s,gyro/y=q:deg/s,gyro/z=r:deg/s,accel/x=u,accel/y=v,accel/z=w"
    found = read(path, topic="XYZ", columns=parse_map(given))
    np.testing.assert_allclose(found.values, np.hstack([RATE_RAD, FORCE]), rtol=1e-5)
    assert found.stream.interval_s == pytest.approx(0.005)


# ---------------------------------------------------------------- bags of other types

TIMES = [1_700_000_000_000_000_000 + k * 10_000_000 for k in range(200)]
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


def fused(store: Any, k: int) -> Any:
    """Return a message whose strings and sequences have many lengths, also of equal sum."""
    status = store.types["my_msgs/msg/Status"]
    return store.types["my_msgs/msg/Fused"](
        label="a" * (k % 7),
        weights=np.arange(k % 3, dtype=float),
        states=[status(text="b" * ((6 - k) % 7), code=k)] * (k % 2),
        imu=imu(store, TIMES[k], RATE_RAD[k], FORCE[k]),
        quality=3,
    )


@pytest.mark.parametrize("plugin", ["ROS1", "MCAP"])
def test_an_imu_inside_another_message_is_found(tmp_path: Path, plugin: str) -> None:
    path = write_bag(
        tmp_path / "bag", fused, TIMES, kind="my_msgs/msg/Fused", definition=FUSED, plugin=plugin
    )
    found = read(path)
    np.testing.assert_array_equal(found.values, np.hstack([RATE_RAD, FORCE])[:200])
    assert found.time_ns is not None
    np.testing.assert_array_equal(found.time_ns, np.arange(200) * 10_000_000)


@pytest.mark.parametrize("plugin", ["ROS1", "MCAP"])
def test_fields_of_a_bag_can_be_named(tmp_path: Path, plugin: str) -> None:
    def make(store: Any, k: int) -> Any:
        time = store.types["builtin_interfaces/msg/Time"](
            sec=1_700_000_000 + k // 100, nanosec=k % 100 * 10**7
        )
        counts = np.rint(np.degrees(RATE_RAD[k]) * 1e3).astype(np.int16)
        force = (FORCE[k] / 9.80665).astype(np.float32)
        return store.types["my_msgs/msg/Raw"](when=time, gyro_counts=counts, force=force, label="x" * (k % 5))

    path = write_bag(tmp_path / "bag", make, TIMES, kind="my_msgs/msg/Raw", definition=VECTORS, plugin=plugin)
    with pytest.raises(RecordingError, match=r"gyro_counts\[0\], gyro_counts\[1\]") as error:
        read(path, topic="/imu/data", accept=False)
    assert error.value.code == "columns_unclear"
    given = ",".join(f"gyro/{a}=gyro_counts[{k}]:mdeg/s,accel/{a}=force[{k}]:g" for k, a in enumerate("xyz"))
    found = read(path, topic="/imu/data", columns=parse_map(given))
    np.testing.assert_allclose(found.values[:, :3], RATE_RAD[:200], atol=np.radians(0.6e-3))
    np.testing.assert_allclose(found.values[:, 3:], FORCE[:200], rtol=1e-5)
    assert found.stream.interval_s == pytest.approx(0.01)
    by_arrival = read(path, topic="/imu/data", columns=parse_map(f"{given},t=log_time:ns"))
    assert by_arrival.stream.interval_s == pytest.approx(0.01)
