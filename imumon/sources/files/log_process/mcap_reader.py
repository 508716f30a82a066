"""MCAP reader: messages in JSON of MCAP files that no ROS program has written.

Programs of Foxglove and others write objects of JSON. Their fields are columns by their paths, as those of a text in
JSON, and their names say which of them are a sensor. Messages in another encoding, such as protobuf,
are topics without columns.

A file is a sequence of records: kind, length, content (MCAP specification). Only schemas, channels, messages and chunks
of these are read; the index at its end is not needed.
"""

from __future__ import annotations

import json
import math
import struct
import sys
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from rosbags.rosbag2.storage_mcap import decompress

from imumon.model.samples import Floats
from imumon.sources.files.log_process.base import LOG_TIME, Log, Topic, batches

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END = 0x01, 0x03, 0x04, 0x05, 0x06, 0x0F
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<16xQI")
"""Two times, size and CRC of a chunk, before the name of its compression."""
FIRST_MESSAGES = 32
"""Messages of a topic whose fields are its columns."""

ROS_PROFILES = ("ros1", "ros2")

Channel = tuple[str, str, str]
"""Topic, type and encoding."""


def is_without_ros(path: Path) -> bool:
    """Return whether a file is MCAP of a program that is none of ROS."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return False
        kind, content = next(_records(file), (0, b""))
    return kind == _HEADER and _text(content, 0)[0] not in ROS_PROFILES


class McapLog(Log):
    """Topics of an MCAP file with messages in JSON.

    Parameters
    ----------
    path : of the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        first: dict[Channel, list[dict[str, float]]] = {}
        counts: dict[Channel, int] = {}
        for channel, _, data in self._messages():
            counts[channel] = counts.get(channel, 0) + 1
            some = first.setdefault(channel, [])
            if channel[2] == "json" and len(some) < FIRST_MESSAGES:
                some.append(_fields(data))
        self._channels = list(counts)
        self.topics = [_topic(channel, counts[channel], first[channel]) for channel in self._channels]

    def _messages(self) -> Iterator[tuple[Channel, int, bytes]]:
        """Yield channel, time of the recording, ns, and content of each message."""
        schemas: dict[int, str] = {}
        channels: dict[int, Channel] = {}
        with self._path.open("rb") as file:
            file.seek(len(MAGIC))
            for kind, content in _with_chunks(_records(file)):
                if kind == _SCHEMA:
                    schemas[struct.unpack_from("<H", content)[0]] = _text(content, 2)[0]
                elif kind == _CHANNEL:
                    number, schema = struct.unpack_from("<HH", content)
                    topic, place = _text(content, 4)
                    encoding, _ = _text(content, place)
                    channels[number] = (topic, schemas.get(schema, "no type"), encoding)
                elif kind == _MESSAGE:
                    number, _, logged, _ = _MESSAGE_HEAD.unpack_from(content)
                    if number in channels:
                        yield channels[number], logged, content[_MESSAGE_HEAD.size :]

    def blocks(self, topic: int, columns: Sequence[str]) -> Iterator[tuple[Floats, int]]:
        wanted, origin = self._channels[topic], 0
        for batch, size in batches((logged, data) for of, logged, data in self._messages() if of == wanted):
            origin = origin or batch[0][0]  # as a float, a span is exact to the ns, an epoch is not
            fields = ({**_fields(data), LOG_TIME: float(logged - origin)} for logged, data in batch)
            yield np.array([[each.get(name, math.nan) for name in columns] for each in fields]), size


def _records(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of the records of a file, or of a chunk, up to a cut one."""
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        kind, length = _RECORD.unpack(head)
        content = file.read(min(length, sys.maxsize))
        if len(content) < length or kind == _DATA_END:
            return
        yield kind, content


def _with_chunks(records: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
    """Yield records, those in a chunk in its place."""

    for kind, content in records:
        if kind != _CHUNK:
            yield kind, content
            continue
        size, crc = _CHUNK_HEAD.unpack_from(content)
        compression, place = _text(content, _CHUNK_HEAD.size)
        yield from _records(BytesIO(decompress(content[place + 8 :], compression, size, crc)))


def _text(content: bytes, place: int) -> tuple[str, int]:
    """Return a text and the place behind it."""
    (length,) = struct.unpack_from("<I", content, place)
    return content[place + 4 : place + 4 + length].decode("utf-8", "replace"), place + 4 + length


MOST_FIELDS, LONGEST_LIST = 256, 9
"""Fields of an object, and numbers of a list whose elements are fields: three axes, or a matrix of them."""


def _flat(path: str, value: Any) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a value of JSON by their paths."""
    if isinstance(value, dict):
        for name, inner in list(value.items())[:MOST_FIELDS]:
            yield from _flat(f"{path}.{name}" if path else str(name), inner)
    elif isinstance(value, list):
        for k, inner in enumerate(value[:LONGEST_LIST] if len(value) <= LONGEST_LIST else ()):
            yield from _flat(f"{path}[{k}]", inner)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path, value


def _fields(data: bytes) -> dict[str, float]:
    try:
        value = json.loads(data)
        return dict(_flat("", value)) if isinstance(value, dict) else {}
    except (ValueError, RecursionError):
        return {}


def _topic(channel: Channel, count: int, first: Sequence[dict[str, float]]) -> Topic:
    """Return the description of a topic, with the columns whose names show a sensor."""
    name, kind, encoding = channel
    if encoding != "json":
        return Topic(name=name, type=f"{kind} in {encoding}", count=count)
    names = list(dict.fromkeys(column for fields in first for column in fields))
    return Topic(name=name, type=kind, count=count, columns=[*names, LOG_TIME])
