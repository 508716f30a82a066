"""Bags for tests: messages of one IMU topic in each format that rosbags writes."""

from __future__ import annotations

import struct
from binascii import crc32
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Message = tuple[int, np.ndarray, np.ndarray]
"""Stamp in ns, angular velocity in rad/s, acceleration in m/s^2."""


def messages(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray) -> list[Message]:
    """Return the messages of samples at some times in s."""
    stamps = 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    return list(zip(stamps.tolist(), gyro, accel, strict=True))


def write_bag(
    path: Path,
    make: Callable[[Any, int], object],
    times: Sequence[int],
    *,
    plugin: str = "SQLITE3",
    kind: str = "sensor_msgs/msg/Imu",
    definition: str = "",
    topic: str = "/imu/data",
) -> Path:
    """Write a bag with a message for each time, in ns, at which it was received.

    Parameters
    ----------
    make : returns a message of the types of a store by its number.
    plugin : storage of rosbag 2, or ``ROS1``: a bag of rosbag 1.
    definition : of the messages, where ROS does not have it.
    """
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros1 = plugin == "ROS1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if definition:
        time = "time" if ros1 else "builtin_interfaces/Time"
        store.register(get_types_from_msg(definition.replace("builtin_interfaces/Time", time), kind))
    writer: Any
    if ros1:
        path = path.with_suffix(".bag")
        writer, serialize = rosbag1.Writer(path), store.serialize_ros1
    else:
        storage = rosbag2.StoragePlugin[plugin]
        writer, serialize = rosbag2.Writer(path, version=9, storage_plugin=storage), store.serialize_cdr
    with writer as bag:
        connection = bag.add_connection(topic, kind, typestore=store)
        for k, received in enumerate(times):
            bag.write(connection, received, bytes(serialize(make(store, k), kind)))
    return path


def write_imu(path: Path, messages: list[Message], plugin: str = "SQLITE3") -> Path:
    received = [stamp + 5_000_000 for stamp, _, _ in messages]
    return write_bag(path, lambda store, k: imu(store, *messages[k]), received, plugin=plugin)


def imu(store: Any, stamp: int, gyro: np.ndarray, accel: np.ndarray) -> object:
    types = store.types
    vector, zeros = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    fields = {name for name, *_ in store.fielddefs["std_msgs/msg/Header"][1]}
    sequence = {"seq": 0} if "seq" in fields else {}  # of ROS 1
    return types["sensor_msgs/msg/Imu"](
        header=types["std_msgs/msg/Header"](stamp=time, frame_id="imu", **sequence),
        orientation=types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        orientation_covariance=zeros,
        angular_velocity=vector(*map(float, gyro)),
        angular_velocity_covariance=zeros,
        linear_acceleration=vector(*map(float, accel)),
        linear_acceleration_covariance=zeros,
    )


def write_checked_mcap(path: Path, messages: list[Message]) -> Path:
    """Write MCAP whose chunks have their CRC, as rosbag2 does: the writer of rosbags leaves it out."""
    file = next(write_imu(path, messages, "MCAP").glob("*.mcap"))
    data, place = bytearray(file.read_bytes()), 8
    while data[place] != 0x0F:  # the end of the data
        (length,) = struct.unpack_from("<Q", data, place + 1)
        if data[place] == 0x06:  # a chunk without compression: times, size, CRC, empty text, size, content
            struct.pack_into("<I", data, place + 33, crc32(data[place + 49 : place + 9 + length]))
        place += 9 + length
    file.write_bytes(data)
    return file
