"""Bag process: a program that reads a bag with limits on its memory and its time, for `rosbag`.

The package that reads bags is not made for hostile files: a kilobyte of metadata may expand to any size, a
chunk may decompress to any size, a database may contain a view without an end, and the definition of a type is
code. The program therefore runs as a process of its own, under limits that the kernel enforces, and uses the
definition of `sensor_msgs/Imu` that it knows. Whatever a bag breaks is this process.

Its standard input is one line of JSON, the topic or null. Its standard output is one line of JSON with the
connections of the bag; then, for each block, a line with the number of rows and of bytes read, and the rows. A
line with an error may take the place of each. The file is run by its path, so that it imports nothing else.
"""

from __future__ import annotations

import json
import resource
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

IMU = "sensor_msgs/msg/Imu"
ROW = struct.Struct("<7d")
"""Gyroscope, accelerometer and time in ns since the first message."""

ROWS = 1 << 15
"""Rows in a block. Not critical."""

BASE_BYTES = 1 << 30
"""Memory of the process beside a multiple of the size of the bag. Not critical."""

SIZE_FACTOR = 4
"""Bytes of memory per byte of the bag. Not critical."""

BASE_S = 20.0
"""s of processor time beside a share of the size of the bag. Not critical."""

BYTES_PER_S = 100e3
"""Bytes of the bag for which there is a second of processor time: an IMU has 10 MB/s. Not critical."""


def limit(path: Path) -> None:
    """Limit memory, processor time and the size of temporary files, by the size of the bag."""
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    size = sum(file.stat().st_size for file in files)
    memory, seconds = BASE_BYTES + SIZE_FACTOR * size, int(BASE_S + size / BYTES_PER_S)
    wanted = ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, seconds), (resource.RLIMIT_FSIZE, memory))
    for name, value in (*wanted, (resource.RLIMIT_CORE, 0)):
        _, hard = resource.getrlimit(name)
        value = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(name, (value, value))


class Bag:
    """Messages of a bag.

    Parameters
    ----------
    path : file, or directory with ``metadata.yaml``.

    Attributes
    ----------
    connections : topic, type and number of messages of each connection.
    """

    def __init__(self, path: Path) -> None:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore

        first = path.is_file() and path.open("rb").read(8) == b"#ROSBAG "
        self._reader: Any = rosbag1.Reader(path) if first else rosbag2.Reader(path)
        self._reader.open()
        store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
        self._decode = store.deserialize_ros1 if first else store.deserialize_cdr
        self._digest = store.generate_msgdef(IMU)[1] if first else store.hash_rihs01(IMU)
        self.connections = [(c.topic, c.msgtype, c.msgcount) for c in self._reader.connections]

    def blocks(self, topic: str) -> Iterator[tuple[bytes, int, int]]:
        """Yield the rows of a topic, their number, and the bytes of their messages."""
        chosen = [c for c in self._reader.connections if c.topic == topic and c.msgtype == IMU]
        if any(c.digest not in ("", self._digest) for c in chosen):
            raise ValueError(f"{topic} has another definition of {IMU}")
        rows, size, first = bytearray(), 0, None
        for _, _, raw in self._reader.messages(chosen):
            message: Any = self._decode(raw, IMU)
            stamp, gyro, accel = (
                message.header.stamp,
                message.angular_velocity,
                message.linear_acceleration,
            )
            now = stamp.sec * 1_000_000_000 + stamp.nanosec
            # as a float, a span is exact to the ns, an epoch is not
            first = now if first is None else first
            rows += ROW.pack(gyro.x, gyro.y, gyro.z, accel.x, accel.y, accel.z, float(now - first))
            size += len(raw)
            if len(rows) == ROWS * ROW.size:
                yield bytes(rows), ROWS, size
                rows, size = bytearray(), 0
        yield bytes(rows), len(rows) // ROW.size, size


def serve(path: Path, source: BinaryIO, sink: BinaryIO) -> None:
    """Send the connections of a bag, read the topic, and send its rows."""

    def send(fields: dict[str, Any]) -> None:
        sink.write(json.dumps(fields).encode() + b"\n")

    try:
        bag = Bag(path)
        send({"connections": bag.connections})
        sink.flush()
        topic = json.loads(source.readline() or b"null")
        if topic is None:
            return
        for rows, count, size in bag.blocks(topic):
            send({"rows": count, "bytes": size})
            sink.write(rows)
        send({"end": True})
        sink.flush()
    except BrokenPipeError:
        pass
    except Exception as error:  # the package has many of its own
        text = (
            "it needs far more memory than its size allows" if isinstance(error, MemoryError) else str(error)
        )
        send({"error": text.replace("\n", " ")[:500] or type(error).__name__})
        sink.flush()


if __name__ == "__main__":
    limit(Path(sys.argv[1]))
    serve(Path(sys.argv[1]), sys.stdin.buffer, sys.stdout.buffer)
