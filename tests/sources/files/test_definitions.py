"""Messages that a bag does not define, and messages in JSON: read, or named with what to do."""

from __future__ import annotations

import json
import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import write_bag
from commands import imumon
from tables import csv, replayed, truth

from imumon.sources.files import OptionNotApplicable, RecordingError
from imumon.sources.files.base import OptionError

pytestmark = pytest.mark.usefixtures("log_in_thread")
T, GYRO, ACCEL = truth(600)
NS = 1_700_000_000_000_000_000 + np.rint(T * 1e9).astype(np.int64)

# ---------------------------------------------------------------- JSON in MCAP


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _record(kind: int, content: bytes) -> bytes:
    return bytes([kind]) + struct.pack("<Q", len(content)) + content


def mcap(path: Path, contents: list[bytes], encoding: str = "json", compression: str | None = None) -> Path:
    """Write an MCAP file of no ROS program, with or without chunks; see the specification of MCAP."""
    records = _record(3, struct.pack("<H", 1) + _text("my.Imu") + _text("jsonschema") + _text("{}"))
    records += _record(4, struct.pack("<HH", 1, 1) + _text("/imu") + _text(encoding) + struct.pack("<I", 0))
    for k, (time, content) in enumerate(zip(NS.tolist(), contents, strict=True)):
        records += _record(5, struct.pack("<HIQQ", 1, k, time, time) + content)
    if compression is not None:
        packed = records
        if compression == "lz4":
            from lz4.frame import compress

            packed = compress(records)
        head = struct.pack("<QQQI", int(NS[0]), int(NS[-1]), len(records), 0) + _text(compression)
        records = _record(6, head + struct.pack("<Q", len(packed)) + packed)
    begin = b"\x89MCAP0\r\n" + _record(1, _text("") + _text("a test"))
    path.write_bytes(begin + records + _record(15, bytes(4)) + b"\x89MCAP0\r\n")
    return path


def objects(gyro: str = "angular_velocity", *, stamp: bool = True) -> list[bytes]:
    return [
        json.dumps(
            {
                **({"timestamp": {"sec": t // 10**9, "nsec": t % 10**9}} if stamp else {}),
                gyro: dict(zip("xyz", g, strict=True)),
                "linear_acceleration": dict(zip("xyz", a, strict=True)),
            }
        ).encode()
        for t, g, a in zip(NS.tolist(), GYRO.tolist(), ACCEL.tolist(), strict=True)
    ]


@pytest.mark.few(2)
@pytest.mark.parametrize("compression", [None, "", "lz4"])
@pytest.mark.parametrize("stamp", [True, False])
def test_messages_in_json_are_read(tmp_path: Path, compression: str | None, stamp: bool) -> None:
    report, _ = replayed(mcap(tmp_path / "a.mcap", objects(stamp=stamp), compression=compression))
    plain, _ = replayed(
        csv(tmp_path / "a.csv", ["t", *(f"{s}{a}" for s in "ga" for a in "xyz")], T, GYRO, ACCEL)
    )
    assert report.session.ledger == {"received": 600, "samples": 600}
    assert report.device.sample_rate_hz == pytest.approx(100.0)
    for name, channel in plain.channels.items():
        assert report.channels[name].N.value == pytest.approx(channel.N.value, rel=1e-6)


def test_names_in_json_that_show_no_sensor_are_a_map(tmp_path: Path) -> None:
    path = mcap(tmp_path / "a.mcap", [o.replace(b"linear_acceleration", b"p") for o in objects("q")])
    with pytest.raises(RecordingError) as error:
        replayed(path)
    assert error.value.code == "no_imu_topic"
    columns = {f"gyro/{a}": f"q.{a}" for a in "xyz"}
    assert replayed(path, topic="/imu", columns=columns)[0].session.samples == 600


def test_a_message_that_is_no_json_is_a_lost_sample_and_another_encoding_is_named(tmp_path: Path) -> None:
    damaged = [b"{" if k == 5 else content for k, content in enumerate(objects())]
    report, _ = replayed(mcap(tmp_path / "a.mcap", damaged))
    assert report.session.ledger == {"received": 600, "samples": 599, "not_finite": 1}
    with pytest.raises(RecordingError) as error:
        replayed(mcap(tmp_path / "b.mcap", damaged, encoding="protobuf"), topic="/imu")
    assert error.value.code == "no_definition"
    assert "my.Imu in protobuf" in error.value.message


def test_a_cut_file_is_read_up_to_the_cut(tmp_path: Path) -> None:
    path = mcap(tmp_path / "a.mcap", objects())
    path.write_bytes(path.read_bytes()[:-2000])
    assert 500 < replayed(path)[0].session.samples < 600


# ---------------------------------------------------------------- definitions of messages

RATES = "std_msgs/Header header\nfloat64[3] angularrate\ngeometry_msgs/Vector3 accel\n"


def bag_without_definitions(path: Path) -> Path:
    """Write a bag as rosbag2 of Humble does: a database without definitions."""

    def make(store: Any, k: int) -> object:
        stamp = store.types["builtin_interfaces/msg/Time"](
            sec=int(NS[k]) // 10**9, nanosec=int(NS[k]) % 10**9
        )
        header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        vector = store.types["geometry_msgs/msg/Vector3"](*ACCEL[k].tolist())
        return store.types["vendor_msgs/msg/Rates"](header, GYRO[k], vector)

    received = (NS + 10**6).tolist()
    write_bag(path, make, received, kind="vendor_msgs/msg/Rates", definition=RATES, topic="/rates")
    with closing(sqlite3.connect(next(path.glob("*.db3")))) as database, database:
        database.execute("delete from message_definitions")
    return path


@pytest.mark.few
@pytest.mark.parametrize("place", ["Rates.msg", "vendor_msgs/msg/Rates.msg", "vendor_msgs"])
def test_a_definition_that_the_user_names_reads_the_bag(tmp_path: Path, place: str) -> None:
    path = bag_without_definitions(tmp_path / "bag")
    file = tmp_path / (place if place.endswith(".msg") else "vendor_msgs/msg/Rates.msg")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(RATES)
    with pytest.raises(RecordingError, match=r"--msg Rates\.msg"):
        replayed(path, topic="/rates")
    report, _ = replayed(path, topic="/rates", definitions=str(tmp_path / place))
    assert report.session.samples == 600
    for k, a in enumerate("xyz"):
        assert report.channels[f"gyro/{a}"].mean == pytest.approx(GYRO[:, k].mean())
        assert report.channels[f"accel/{a}"].mean == pytest.approx(ACCEL[:, k].mean())


def test_a_definition_that_cannot_be_used_is_an_error(tmp_path: Path) -> None:
    path = bag_without_definitions(tmp_path / "bag")
    (tmp_path / "a.msg").write_bytes(bytes(range(256)))
    for name, kind, code in (
        ("a.msg", RecordingError, "bag_corrupt"),
        ("b.msg", OptionError, "no_such_file"),
    ):
        with pytest.raises(kind) as error:
            replayed(path, topic="/rates", definitions=str(tmp_path / name))
        assert error.value.code == code
    table = csv(tmp_path / "a.csv", ["t", "gx", "gy", "gz"], T, GYRO)
    with pytest.raises(OptionNotApplicable):
        replayed(table, definitions=str(tmp_path / "a.msg"))
    assert "--msg" in imumon("replay", path, "--topic", "/rates", code=1)
