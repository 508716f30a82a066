"""Bag: `sensor_msgs/Imu` messages from rosbag 1, rosbag 2 and MCAP.

The time of a sample is the stamp in the header of its message, which the driver makes: it is better than the
time of the recording. A bag does not say whether the values are compensated; the stream is unknown
unless ``--stream`` says otherwise. A process of its own reads the bag (`bag_process`).
"""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from imumon.recordings import bag_process
from imumon.recordings.bag_process import IMU, ROW
from imumon.recordings.base import ReadOptions, RecordingError
from imumon.recordings.column_names import Column
from imumon.recordings.columns import ColumnLayout
from imumon.recordings.table import Table, TableRows
from imumon.report import plain
from imumon.samples import ACCEL, AXES, GYRO, SampleBlock

REPAIR = "repair it with ros2 bag reindex, or record it again"
"""Cure for a bag that cannot be read."""
FIELDS = (("angular_velocity", "gyro", "rad/s"), ("linear_acceleration", "accel", "m/s2"))
"""Fields of a message, with the units of its definition."""

LONGEST_LINE = 1 << 24
"""Bytes of a line from the process that reads the bag. Not critical."""

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
        self.path = path
        self._check_files()
        self._process = subprocess.Popen(
            # -P: the directory of the program has a module csv, which is not that of Python
            [sys.executable, "-P", bag_process.__file__, path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # a thread of it takes 64 MB of the limit
            start_new_session=True,  # ^C is for the reader
        )
        try:
            found = self._receive().get("connections", [])
            self._connections = [(plain(topic), topic, kind, count) for topic, kind, count in found]
            self._choose(options.topic)
        except BaseException:
            self._close()
            raise
        kind = options.kind or "unknown"
        if kind == "deltas":
            self._close()
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

    def _check_files(self) -> None:
        """Check that a bag has regular files only: opening a pipe in it would never return."""
        path = Path(self.path)
        try:
            files = list(path.iterdir()) if path.is_dir() else [path]
            other = [file for file in files if not stat.S_ISREG(file.stat().st_mode) and not file.is_dir()]
        except OSError as error:
            raise self._corrupt(error.strerror or str(error)) from None
        if other:
            raise self._corrupt(f"{other[0].name} is not a regular file")

    def _corrupt(self, why: str) -> RecordingError:
        return RecordingError("bag_corrupt", f"{self.path} cannot be read as a bag: {why}", REPAIR)

    def _receive(self) -> dict[str, Any]:
        """Return the next line of the process; raise `RecordingError` if it failed."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline(LONGEST_LINE)
        if not line.endswith(b"\n"):
            raise self._corrupt("it needs far more time or memory than its size allows")
        fields: dict[str, Any] = json.loads(line)
        if "error" in fields:
            raise self._corrupt(fields["error"])
        return fields

    def _close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()

    def _choose(self, topic: str | None) -> None:
        """Choose the given topic, or the only one."""
        topics = sorted({shown for shown, _, kind, _ in self._connections if kind == IMU})
        cure = f"choose --topic {' or '.join(topics)}"
        if not topics:
            others = ", ".join(sorted({f"{shown} ({kind})" for shown, _, kind, _ in self._connections}))
            text = f"{self.path} has no {IMU}; there are {others or 'no messages'}"
            raise RecordingError("no_imu_topic", text, f"record a topic of type {IMU}")
        if topic is None and len(topics) > 1:
            text = f"{self.path} has several topics with {IMU}"
            raise RecordingError("several_topics", text, cure)
        if topic is not None and topic not in topics:
            raise RecordingError("unknown_topic", f"{self.path} has no topic {topic}", cure)
        self._topic = topic or topics[0]

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        chosen = [c for c in self._connections if c[0] == self._topic and c[2] == IMU]
        total = sum(count for *_, count in chosen) or None
        done = 0
        try:
            self._process.stdin.write(json.dumps(chosen[0][1]).encode() + b"\n")
            self._process.stdin.flush()
            while not (received := self._receive()).get("end"):
                count = received["rows"]
                data = self._process.stdout.read(count * ROW.size)
                if len(data) < count * ROW.size:
                    raise self._corrupt("it needs far more time or memory than its size allows")
                rows = np.frombuffer(data, "<f8").reshape(count, -1).astype(np.float64)
                done += count
                self.fed += received["bytes"]
                self.progress = None if total is None else min(1.0, done / total)
                yield self._blocks(rows, range(done - count + 1, done + 1))
        except BrokenPipeError:
            raise self._corrupt("its reader ended") from None
        finally:
            self._close()
        yield self._finish()

    def no_samples(self) -> RecordingError:
        return RecordingError("no_rows", f"{self.path} has no message on {self._topic}", "record it again")
