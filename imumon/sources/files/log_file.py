"""Log file: one topic of a bag or of the log of an autopilot as blocks of samples.

A log has topics: series of messages with fields. The log process knows which of them are an IMU, and with which
fields and units; ``--topic`` selects another one, and ``--map`` names other fields. The times are those in the
messages, which the driver makes: they are better than the time of the recording. Such a log does not say whether
the values are compensated; the stream is unknown unless ``--stream`` says otherwise, or averages of unknown
compensation. A process of its own reads the file (`log_process`).
"""

from __future__ import annotations

import importlib.util
import json
import os
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from multiprocessing.connection import Pipe
from pathlib import Path
from subprocess import DEVNULL, Popen
from typing import Any

import numpy as np

from imumon.model.cures import option, option_text
from imumon.model.report_json import plain
from imumon.model.samples import AXES, Floats, SampleBlock
from imumon.sources.files.array_table import HEAD_ROWS
from imumon.sources.files.base import (
    SQLITE,
    OptionError,
    ReadOptions,
    RecordingError,
    RowSource,
)
from imumon.sources.files.column_names import names_sensor
from imumon.sources.files.column_reader import read_columns
from imumon.sources.files.columns import LISTED, ColumnLayout, find, parse_map
from imumon.sources.files.formats import known_format
from imumon.sources.files.log_process.base import LOG_TIME, Topic
from imumon.sources.files.table import Table

NOUNS = {"bag": "a bag", "px4": "a PX4 log", "ardupilot": "an ArduPilot log"}
"""Kinds of logs in messages."""

PACKAGES = {"px4": "pyulog", "ardupilot": "pymavlink"}
"""Packages that are not installed with imumon, but with the extra of the same name as the kind."""

CURES = {"bag": "repair it with ros2 bag reindex, or record it again"}
"""Cure for a log that cannot be read."""

MAGIC = {
    b"#ROSBAG V": "bag",
    b"\x89MCAP0\r\n": "bag",
    SQLITE: "bag",
    b"ULog\x01\x12\x35": "px4",
    b"\xa3\x95\x80": "ardupilot",  # a message that defines a format is the first one
}
"""First bytes of the files of each kind."""

IMU = "sensor_msgs/msg/Imu"
PROGRAM = (sys.executable, "-P", "-m", "imumon.sources.files.log_process")
"""The program that reads a log; its arguments are kind, path, and the descriptor of a connection."""
LONGEST_MESSAGE = 1 << 24
"""Bytes of a message from the process that reads the log: topics, or a block of rows."""


def log_kind(path: str, head: bytes) -> str | None:
    """Return the kind of a log: of a file by its first bytes, of a directory by what is in it."""
    if Path(path, "metadata.yaml").exists():
        return "bag"
    if head.startswith(SQLITE) and not path.endswith(".db3"):
        return None  # any program has databases, and no reader takes a bag by another name
    return next((kind for magic, kind in MAGIC.items() if head.startswith(magic)), None)


def _definitions(path: str | None) -> list[str]:
    """Return the path of definitions as an argument, if one is given; raise `OptionError` if there is no such file."""
    if path is not None and not os.path.exists(path):
        text = f"no file or directory {path} for {option('definitions')}"
        raise OptionError("no_such_file", text, "check its name")
    return [] if path is None else [path]


class LogFile(Table):
    """Messages of one topic as blocks of samples.

    Raises
    ------
    RecordingError : the log cannot be read or has no IMU.
    """

    def __init__(self, path: str, kind: str, options: ReadOptions) -> None:
        self.path, self._kind = path, kind
        package = PACKAGES.get(kind)
        if package is not None and importlib.util.find_spec(package) is None:
            text = f"{path} is {NOUNS[kind]}, and the package {package} that reads it is not installed"
            raise RecordingError("package_missing", text, f"pip install 'imumon[{kind}]'")
        self._check_files()
        self._pipe, other_end = Pipe()
        with other_end:
            self._process = Popen(
                [*PROGRAM, kind, path, str(other_end.fileno()), *_definitions(options.definitions)],
                pass_fds=[other_end.fileno()],
                stdin=DEVNULL,
                stdout=DEVNULL,
                stderr=DEVNULL,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},  # a thread of it takes 64 MB of the limit
                start_new_session=True,  # ^C is for the reader
            )
        try:
            received = self._receive()
            topics = (Topic(**fields) for fields in received["topics"])
            self._topics = [
                replace(topic, name=plain(topic.name), type=plain(topic.type)) for topic in topics
            ]
            self._topic_index = self._chosen(options)
            table_layout = self._stream_columns(options)
        except BaseException:
            self._close()
            raise
        # the log may say anything, at any length
        facts = {name: plain(value)[:100] for name, value in received["facts"].items()}
        self.header = facts or None
        if received["problem"]:
            self.problem = f"{path} {received['problem']}"
        notes = self._notes(options, received["remarks"])
        table_layout = replace(table_layout, remarks=(*notes, *table_layout.remarks))
        self._columns = table_layout.used
        self._names = [self._topic.columns[column.index] for column in self._columns]
        names = list(map(plain, self._topic.columns))
        source = RowSource(path, kind, names, f"{kind} {self._topic.name}")
        self.topic = self._topic.name if kind == "bag" else None
        self._begin(source, table_layout, options)

    @property
    def _topic(self) -> Topic:
        return self._topics[self._topic_index]

    def _check_files(self) -> None:
        """Check that a log has regular files only: opening a pipe in it would never return."""
        path = Path(self.path)
        try:
            files = list(path.iterdir()) if path.is_dir() else [path]
            other = [file for file in files if not stat.S_ISREG(file.stat().st_mode) and not file.is_dir()]
        except OSError as error:
            raise self._corrupt(error.strerror or str(error)) from None
        if other:
            raise self._corrupt(f"{other[0].name} is not a regular file")

    def _corrupt(self, why: str) -> RecordingError:
        code = "bag_corrupt" if self._kind == "bag" else "log_corrupt"
        text = f"{self.path} cannot be read as {NOUNS[self._kind]}: {why}"
        return RecordingError(code, text, CURES.get(self._kind, "copy it again from the autopilot"))

    def _receive_bytes(self) -> bytes:
        """Return the next message of the process; raise `RecordingError` if it has ended."""
        try:
            return self._pipe.recv_bytes(LONGEST_MESSAGE)
        except (EOFError, OSError):
            raise self._corrupt("it needs far more time or memory than its size allows") from None

    def _receive(self) -> dict[str, Any]:
        """Return the next message as fields; raise `RecordingError` if the process failed."""
        fields: dict[str, Any] = json.loads(self._receive_bytes())
        if "error" in fields:
            raise self._corrupt(fields["error"])
        return fields

    def _close(self) -> None:
        """End the process."""
        self._pipe.close()
        # not asked to end: a hostile file may keep it busy without end
        self._process.kill()
        self._process.wait()

    def _imus(self) -> list[int]:
        return [k for k, topic in enumerate(self._topics) if {"gyro/x", "accel/x"} & set(topic.map)]

    def _chosen(self, options: ReadOptions) -> int:
        """Return the index of the given topic, else of the best or only one with an IMU."""
        imus = self._imus()
        for is_imu in (_has_format, _has_sensor):
            imus = imus or [k for k, topic in enumerate(self._topics) if is_imu(topic)]
        names = sorted({self._topics[k].name for k in imus})
        topics = " or ".join(option_text(topic=name) for name in names)
        cure = f"choose {topics}" if names else f"choose one of {self._listed()}"
        if options.topic is not None:
            matching = self._named(options.topic)
            if not matching:
                raise RecordingError("unknown_topic", f"{self.path} has no topic {options.topic}", cure)
            # topics of two types may have one name: the one with an IMU
            return min(matching, key=lambda k: k not in imus)
        if not imus:
            raise self._no_imu_topic()
        is_bag = self._kind == "bag"
        if is_bag and len(names) > 1:
            raise RecordingError("several_topics", f"{self.path} has several topics with {IMU}", cure)
        if options.kind is None or is_bag:
            return imus[0]
        return min(imus, key=lambda k: self._topics[k].averaged != (options.kind == "deltas"))

    def _named(self, name: str) -> list[int]:
        """Return the indices of the topics that have a name."""
        # instances have a number, which is left out for the first one
        return [k for k, topic in enumerate(self._topics) if topic.name in (name, f"{name}/0")]

    def _no_imu_topic(self) -> RecordingError:
        """Return the error for a log of which no topic is that of an IMU."""
        wanted = IMU if self._kind == "bag" else "topic with a gyroscope or an accelerometer"
        text = f"{self.path} has no {wanted}; there are {self._listed() or 'no messages'}"
        fields = option_text(topic="TOPIC", columns={"gyro/x": "FIELD:UNIT", "...": ""})
        cure = f"name the fields, {fields}; {option_text(topic='TOPIC')} alone lists them"
        return RecordingError("no_imu_topic", text, cure)

    def _listed(self) -> str:
        """Return the topics with their types."""
        shown = dict.fromkeys(f"{topic.name} ({topic.type})" for topic in self._topics)
        return ", ".join(sorted(shown)[:LISTED]) + (" ..." if len(shown) > LISTED else "")

    def _stream_columns(self, options: ReadOptions) -> ColumnLayout:
        """Return the columns of the stream: those that the type of the messages states, the user names, or "
        "are accepted."""
        topic, given = self._topic, dict(options.columns or {})
        names = list(map(plain, topic.columns))
        if not names:
            raise self._no_definition()
        if options.kind == "deltas" and not topic.averaged:
            text = f"{topic.name} of {self.path} has no averages over its interval"
            raise RecordingError("no_stream", text, f"leave {option('kind')} out")
        known = self._stated_fields()
        is_known = bool({"gyro/x", "accel/x"} & set(known))
        # the head shows what no type states, and whether an acceleration is 1 g in the unit that one states
        rows = self._head(names)
        if is_known and not given:
            names = _names_of_fields(names, known)
        units = ["ns" if name == LOG_TIME else "" for name in names]
        reading = read_columns(names, units, rows, replace(options, columns=known | given), source=topic.type)
        try:
            layout = reading.checked(f"{topic.name} of {self.path}", accept=options.accept).layout()
        except RecordingError as error:
            raise error if error.code == "columns_unclear" else error.of(self.path) from None
        if topic.averaged:
            return replace(layout, kind="deltas")
        return (
            replace(layout, kind=options.kind or "unknown")
            if is_known and not layout.has_increments
            else layout
        )

    def _stated_fields(self) -> dict[str, str]:
        """Return the field and the unit of each channel that the type of the messages states."""
        stated = known_format(type_name=self._topic.type)
        if stated is not None and self._topic_index not in self._imus():
            return parse_map(stated.map)
        # the types of ROS have SI, also where the log process gives no unit
        return {
            channel: plain(text if ":" in text or not channel.startswith("accel") else f"{text}:m/s^2")
            for channel, text in self._topic.map.items()
        }

    def _head(self, names: Sequence[str]) -> Floats:
        """Return the first rows of all columns."""
        self._pipe.send_bytes(
            json.dumps({"topic": self._topic_index, "columns": names, "head": True}).encode()
        )
        if self._receive().get("end"):
            return np.empty((0, len(names)))
        return (
            np.frombuffer(self._receive_bytes(), "<f8").reshape(-1, len(names))[:HEAD_ROWS].astype(np.float64)
        )

    def _no_definition(self) -> RecordingError:
        """Return the error for messages whose fields are not known."""
        topic = self._topic
        text = f"{self.path} has no definition of {topic.type}, the messages of {topic.name}"
        if " in " in topic.type:
            return RecordingError(
                "no_definition", text, "write it with messages in JSON, or as a bag of ROS 2"
            )
        # rosbag2 before Iron keeps none in a .db3
        given = option_text(topic=topic.name, definitions=f"{topic.type.rpartition('/')[2]}.msg")
        cure = f"{given} with the file of its package or the directory, or record it with ros2 bag record -s mcap"
        return RecordingError("no_definition", text, cure)

    def _notes(self, options: ReadOptions, remarks: Any) -> list[str]:
        """Return remarks on the choice of the topic and on the log."""
        topic, notes = self._topic, [plain(text) for text in remarks]
        if self._kind != "bag":
            rate = f" at {topic.rate_hz:.4g} Hz" if topic.rate_hz else ""
            samples = "averages over the interval" if topic.averaged else "point samples"
            others = [self._topics[k].name for k in self._imus() if k != self._topic_index]
            more = (
                f"; {option('topic')} selects another: {', '.join(others)}"
                if others and not options.topic
                else ""
            )
            notes.insert(0, f"{topic.name} is used: {samples}{rate}{more}")
        return [*notes, *([plain(topic.note)] if topic.note else [])]

    def __iter__(self) -> Iterator[list[SampleBlock]]:
        done, total = 0, self._topic.count or None
        try:
            self._pipe.send_bytes(json.dumps({"topic": self._topic_index, "columns": self._names}).encode())
            while not (received := self._receive()).get("end"):
                data = np.frombuffer(self._receive_bytes(), "<f8")
                rows = data.reshape(-1, len(self._names)).astype(np.float64, order="F")
                count = len(rows)
                done += count
                self.fed += received["bytes"]
                self.progress = None if total is None else min(1.0, done / total)
                yield self._blocks(rows, np.arange(done - count + 1, done + 1))
            if total is not None and done < total and self.problem is None:
                self.problem = f"{self.path} is corrupt: {done:,} of its {total:,} messages can be read"
        except BrokenPipeError:
            raise self._corrupt("its reader ended") from None
        finally:
            self._close()
        yield self._finish()

    def no_samples(self) -> RecordingError:
        text = f"{self.path} has no message on {self._topic.name}"
        return RecordingError("no_rows", text, "record it again")


def _names_of_fields(names: Sequence[str], fields: Mapping[str, str]) -> list[str]:
    """Return the names of columns, empty where a column is none of some fields."""
    used = {find(names, part.rpartition(":")[0]) for text in fields.values() for part in text.split("+")}
    # the known fields are all: a name such as x of another field would be taken for an axis
    return [name if k in used else "" for k, name in enumerate(names)]


def _has_format(topic: Topic) -> bool:
    """Return whether the type of the messages of a topic states what they are."""
    return known_format(type_name=topic.type) is not None


def _has_sensor(topic: Topic) -> bool:
    """Return whether the names of the fields of a topic show an inertial sensor."""
    return sum(map(names_sensor, topic.columns)) >= len(AXES)
