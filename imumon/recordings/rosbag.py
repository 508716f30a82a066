"""Bag: `sensor_msgs/Imu` messages from rosbag 1, rosbag 2 and MCAP.

The time of a sample is the stamp in the header of its message, which the driver makes: it is better than the
time of the recording. A bag does not say whether the values are compensated; they count as uncompensated
unless ``--stream`` says otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from imumon.errors import ImumonError
from imumon.recordings.base import ReadOptions, RecordingError
from imumon.recordings.column_names import Column
from imumon.recordings.columns import ColumnLayout
from imumon.recordings.table import ROWS, Table, TableRows
from imumon.report import plain
from imumon.samples import ACCEL, AXES, GYRO, SampleBlock

IMU = "sensor_msgs/msg/Imu"
REPAIR = "repair it with ros2 bag reindex, or record it again"
"""Cure for a bag that cannot be read."""
FIELDS = (("angular_velocity", "gyro", "rad/s"), ("linear_acceleration", "accel", "m/s2"))
"""Fields of a message, with the units of its definition."""

MAGIC = {b"#ROSBAG V": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3": ".db3"}
"""First bytes of the files of a bag, with their extension."""


def is_bag(path: str, head: bytes) -> bool:
    """Return whether a path is a bag: a file by its first bytes, a directory by what is in it."""
    return Path(path, "metadata.yaml").exists() or any(head.startswith(magic) for magic in MAGIC)


class RosbagFile(Table):
    """Messages of one topic as blocks of samples.

    Raises
    ------
    RecordingError : the bag cannot be read or has no IMU.
    """

    def __init__(self, path: str, options: ReadOptions) -> None:
        # imported here, because the daemon imports this package and needs no bags
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self.path = path
        try:
            self._reader = AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            self._reader.open()
        except Exception as error:  # the package has many of its own
            raise RecordingError(
                "bag_corrupt", f"{path} cannot be read as a bag: {_text(error)}", REPAIR
            ) from None
        self._connections = self._choose(options.topic)
        kind = options.kind or "uncompensated"
        if kind == "deltas":
            raise RecordingError("no_stream", f"{path}: a bag of {IMU} has no deltas", "leave --stream out")
        columns = tuple(
            Column(3 * k + i, f"{self._topic}.{name}.{axis}", quantity, axis, unit=unit)
            for k, (name, quantity, unit) in enumerate(FIELDS)
            for i, axis in enumerate(AXES)
        )
        time = Column(6, "header.stamp", "t", unit="ns")
        self._rows = TableRows(
            path, ColumnLayout(kind, (*GYRO, *ACCEL), columns, (time,)), "bag", options.rate_hz
        )

    def _choose(self, topic: str | None) -> list[Any]:
        """Return the connections of the given topic, or of the only one."""
        connections = [c for c in self._reader.connections if c.msgtype == IMU]
        topics = sorted({c.topic for c in connections})
        cure = f"choose --topic {' or '.join(topics)}"
        if not topics:
            others = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in self._reader.connections}))
            text = f"{self.path} has no {IMU}; there are {others or 'no messages'}"
            raise RecordingError("no_imu_topic", text, f"record a topic of type {IMU}")
        if topic is None and len(topics) > 1:
            text = f"{self.path} has several topics with {IMU}"
            raise RecordingError("several_topics", text, cure)
        if topic is not None and topic not in topics:
            raise RecordingError("unknown_topic", f"{self.path} has no topic {topic}", cure)
        self._topic = topic or topics[0]
        return [c for c in connections if c.topic == self._topic]

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        total = sum(c.msgcount for c in self._connections) or None
        done = 0
        rows: list[tuple[float, ...]] = []
        first: int | None = None
        try:
            for connection, _, raw in self._reader.messages(self._connections):
                message: Any = self._reader.deserialize(raw, connection.msgtype)
                stamp = message.header.stamp
                now = stamp.sec * 1_000_000_000 + stamp.nanosec
                # as a float, a span is exact to the ns, an epoch is not
                first = now if first is None else first
                gyro, accel = message.angular_velocity, message.linear_acceleration
                rows.append((gyro.x, gyro.y, gyro.z, accel.x, accel.y, accel.z, float(now - first)))
                self.fed += len(raw)
                done += 1
                if len(rows) >= ROWS:
                    self.progress = None if total is None else done / total
                    yield self._blocks(np.array(rows), range(done - len(rows) + 1, done + 1))
                    rows = []
        except ImumonError:
            raise
        except Exception as error:
            raise RecordingError("bag_corrupt", f"{self.path} is corrupt: {_text(error)}", REPAIR) from None
        finally:
            self._reader.close()
        if rows:
            self.progress = None if total is None else 1.0
            yield self._blocks(np.array(rows), range(done - len(rows) + 1, done + 1))
        yield self._finish()

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{self.path} has no message on {self._topic}", "record it again")


def _text(error: Exception) -> str:
    """Return an error of the library as one line."""
    return plain(str(error).replace("\n", " ")) or type(error).__name__
