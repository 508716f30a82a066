"""Bag reader: messages of rosbag 1, rosbag 2 and MCAP.

`sensor_msgs/Imu` has the definition that is known, other types have that of the bag. A topic whose type contains a
`sensor_msgs/Imu` is an IMU, too. Every other field can be named with ``--map``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import MessageDefinitionFormat

from imumon.model.samples import AXES, Floats
from imumon.sources.files.log_process.base import LOG_TIME, Log, Topic, batches
from imumon.sources.files.log_process.message_fields import MessageFields

IMU = "sensor_msgs/msg/Imu"
SENSORS = (("gyro", "angular_velocity", ":rad/s"), ("accel", "linear_acceleration", ""))
"""Fields of `sensor_msgs/Imu` with the units of its definition. An accelerometer shows its unit, and some drivers send
g instead of m/s2: without a unit, this is an error."""


class BagLog(Log):
    """Topics of a bag.

    Parameters
    ----------
    path : file, or directory with ``metadata.yaml``.
    definitions : file ``.msg``, or directory of such files, with types that the bag does not define; None: none.
    """

    def __init__(self, path: Path, definitions: Path | None = None) -> None:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore

        first = path.is_file() and path.open("rb").read(8) == b"#ROSBAG "
        self._reader: Any = rosbag1.Reader(path) if first else rosbag2.Reader(path)
        self._reader.open()
        store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
        self._cdr = not first
        # types that came later are known beside those of the release
        latest = {} if first else dict(get_typestore(Stores.LATEST).fielddefs)
        self._known = {**latest, **store.fielddefs}
        self._digest = store.generate_msgdef(IMU)[1] if first else store.hash_rihs01(IMU)
        self._connections: list[list[Any]] = []  # of each topic
        self._fields: list[MessageFields | None] = []
        if definitions is not None:
            types = {connection.msgtype for connection in self._reader.connections}
            self._known |= given_definitions(definitions, types)
        self.topics = self._topics()

    def _topics(self) -> list[Topic]:
        by_name: dict[tuple[str, str], list[Any]] = {}
        for connection in self._reader.connections:
            by_name.setdefault((connection.topic, connection.msgtype), []).append(connection)
        topics = []
        for (name, kind), connections in by_name.items():
            fields = self._fields_of(connections[0])
            self._connections.append(connections)
            self._fields.append(fields)
            count = sum(connection.msgcount for connection in connections)
            topics.append(_topic(name, kind, count, fields))
        return topics

    def _fields_of(self, connection: Any) -> MessageFields | None:
        """Return the columns of a connection; None if its type cannot be read."""
        types = self._known
        try:
            if connection.msgtype != IMU:
                types = {**types, **_definitions(connection)}
            return MessageFields(types, connection.msgtype, cdr=self._cdr)
        except Exception:  # rosbags has many kinds for a definition that it cannot read
            return None

    def blocks(self, topic: int, columns: Sequence[str]) -> Iterator[tuple[Floats, int]]:
        chosen, fields = self._connections[topic], self._fields[topic]
        assert fields is not None
        if chosen[0].msgtype == IMU and any(c.digest not in ("", self._digest) for c in chosen):
            raise ValueError(f"{chosen[0].topic} has another definition of {IMU}")
        first: dict[str, int] = {}  # ns, first time of each column of times
        for batch, size in batches((stamp, raw) for _, stamp, raw in self._reader.messages(chosen)):
            stamps, messages = zip(*batch, strict=True)
            values, valid = fields.read(messages, [name for name in columns if name != LOG_TIME])
            values[LOG_TIME] = np.array(stamps, dtype=np.int64)[valid]
            out = np.full((len(messages), len(columns)), np.nan)
            for k, name in enumerate(columns):
                column = values[name]
                if column.dtype == np.int64 and len(column):
                    # as a float, a span is exact to the ns, an epoch is not
                    column = column - first.setdefault(name, int(column[0]))
                out[valid, k] = column
            yield out, size


def _definitions(connection: Any) -> dict[str, Any]:
    """Return the definitions of types that a bag holds for a connection."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    form, text = connection.msgdef
    if form == MessageDefinitionFormat.MSG:
        return dict(get_types_from_msg(text, connection.msgtype))
    return dict(get_types_from_idl(text)) if form == MessageDefinitionFormat.IDL else {}


MOST_DEFINITIONS = 5000
"""Files of definitions that are read: a distribution of ROS has some 2,000 messages."""


def given_definitions(path: Path, types: Collection[str]) -> dict[str, Any]:
    """Return the types that a file ``.msg`` defines, or those of a directory, which may be that of a package.

    The package is the directory above ``msg``; without one, it is that of a type of the bag with the name of the file.

    Parameters
    ----------
    types : of the bag.
    """
    from rosbags.typesys import get_types_from_msg

    files = sorted(path.rglob("*.msg"))[:MOST_DEFINITIONS] if path.is_dir() else [path]
    defined: dict[str, Any] = {}
    packages = {kind.rpartition("/")[2]: kind.split("/")[0] for kind in types}
    alone = next(iter(packages.values())) if len(set(packages.values())) == 1 else "unknown"
    for file in files:
        folder = file.resolve().parent
        package = folder.parent.name if folder.name == "msg" else packages.get(file.stem, alone)
        defined |= get_types_from_msg(file.read_text("utf-8", "replace"), f"{package}/msg/{file.stem}")
    return defined


def _topic(name: str, kind: str, count: int, fields: MessageFields | None) -> Topic:
    """Return the description of a topic, with the columns of the first IMU in its type."""
    if fields is None:
        return Topic(name=name, type=kind, count=count)
    columns = [*fields.names, LOG_TIME]
    prefixes = fields.nested(IMU)
    stamps = [column for column in fields.names if column in fields.times]
    note, known = "", {}
    for prefix in prefixes[:1]:
        known = {f"{s}/{a}": f"{prefix}{part}.{a}{unit}" for s, part, unit in SENSORS for a in AXES}
        stamps = [f"{prefix}header.stamp"]
        if len(prefixes) > 1:
            others = ", ".join(prefix.rstrip(".") for prefix in prefixes[1:])
            note = f"{prefix.rstrip('.')} of {kind} is used, and not {others}, unless columns are named"
    stamps.sort(key=lambda column: not column.endswith("header.stamp"))
    known["t"] = f"{[*stamps, LOG_TIME][0]}:ns"
    return Topic(name=name, type=kind, count=count, columns=columns, map=known, note=note)
