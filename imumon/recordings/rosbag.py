"""Bags: `sensor_msgs/Imu` from rosbag 1, rosbag 2 and MCAP, by the optional package rosbags.

Time is the stamp in the header of each message: the driver's, better than that of the recording. What a
driver puts into a message (compensated or not) no bag says; it counts as uncompensated unless told.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imumon.errors import SourceError
from imumon.recordings.column_names import Column
from imumon.recordings.columns import ColumnLayout
from imumon.recordings.table import ROWS, ReadOptions, TableRows
from imumon.samples import ACCEL, AXES, GYRO, SampleBlock

IMU = "sensor_msgs/msg/Imu"
FIELDS = (("angular_velocity", "gyro", "rad/s"), ("linear_acceleration", "accel", "m/s2"))
"""Of a message, with the units that its definition says."""

MAGIC = {b"#ROSBAG V": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3": ".db3"}
"""How files of these kinds begin."""


def is_bag(path: str, head: bytes) -> bool:
    """Whether that is a bag: by its first bytes, a directory by what lies in it."""
    return Path(path, "metadata.yaml").exists() or any(head.startswith(magic) for magic in MAGIC)


class RosbagFile:
    """Messages of one topic as blocks of samples.

    Raises
    ------
    SourceError : rosbags is not installed, the bag cannot be read or has no IMU.
    """

    header: Mapping[str, Any] | None = None
    discarded = 0
    problem: str | None = None
    progress: float | None = None

    def __init__(self, path: str, wanted: ReadOptions) -> None:
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise SourceError(f"{path} is a bag: pip install rosbags to read it") from None
        self.path = path
        self.fed = 0
        self.bad_checksums = 0
        try:
            self._reader = AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            self._reader.open()
        except Exception as error:  # the package has many of its own
            raise SourceError(f"{path} cannot be read as a bag: {_line(error)}") from None
        self._connections = self._choose(wanted.topic)
        kind = wanted.kind or "uncompensated"
        if kind == "deltas":
            raise SourceError(f"{path}: a bag of {IMU} has no deltas")
        columns = tuple(
            Column(3 * k + i, f"{self._topic}.{name}.{axis}", quantity, axis, unit=unit)
            for k, (name, quantity, unit) in enumerate(FIELDS)
            for i, axis in enumerate(AXES)
        )
        time = Column(6, "header.stamp", "t", unit="ns")
        self._rows = TableRows(
            path, ColumnLayout(kind, (*GYRO, *ACCEL), columns, (time,)), "bag", wanted.rate_hz
        )

    def _choose(self, topic: str | None) -> list[Any]:
        """Connections of the topic that is asked for, or of the one there is."""
        found = [c for c in self._reader.connections if c.msgtype == IMU]
        topics = sorted({c.topic for c in found})
        if not topics:
            there = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in self._reader.connections}))
            raise SourceError(f"{self.path} has no {IMU}; there are {there or 'no messages'}")
        if topic is None and len(topics) > 1:
            raise SourceError(f"{self.path} has several: say --topic {' or '.join(topics)}")
        if topic is not None and topic not in topics:
            raise SourceError(f"{self.path} has no {topic}; there are {', '.join(topics)}")
        self._topic = topic or topics[0]
        return [c for c in found if c.topic == self._topic]

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        total = sum(c.msgcount for c in self._connections) or None
        done = 0
        gathered: list[tuple[float, ...]] = []
        first: int | None = None
        try:
            for connection, _, raw in self._reader.messages(self._connections):
                message: Any = self._reader.deserialize(raw, connection.msgtype)
                stamp = message.header.stamp
                now = stamp.sec * 1_000_000_000 + stamp.nanosec
                first = now if first is None else first  # a float holds a span to the ns, not the epoch
                gyro, accel = message.angular_velocity, message.linear_acceleration
                gathered.append((gyro.x, gyro.y, gyro.z, accel.x, accel.y, accel.z, float(now - first)))
                self.fed += len(raw)
                done += 1
                if len(gathered) >= ROWS:
                    self.progress = None if total is None else done / total
                    yield self._hand(gathered, done)
                    gathered = []
        except SourceError:
            raise
        except Exception as error:
            raise SourceError(f"{self.path} is damaged: {_line(error)}") from None
        finally:
            self._reader.close()
        if gathered:
            self.progress = None if total is None else 1.0
            yield self._hand(gathered, done)
        yield list(self._rows.finish())

    def _hand(self, gathered: list[tuple[float, ...]], done: int) -> list[SampleBlock]:
        places = range(done - len(gathered) + 1, done + 1)
        found = list(self._rows.blocks(self._rows.pick(np.array(gathered)), places))
        self.bad_checksums = self._rows.lost
        return found

    @property
    def remarks(self) -> Sequence[str]:
        return self._rows.remarks

    def verdict(self) -> str:
        return f"{self.path} has no message on {self._topic}"


def _line(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__
