"""Bags for tests: messages of one IMU topic in each format that rosbags writes."""

from __future__ import annotations

import struct
from binascii import crc32
from pathlib import Path

import numpy as np

Message = tuple[int, np.ndarray, np.ndarray]
"""Stamp in ns, angular velocity in rad/s, acceleration in m/s^2."""


def messages(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray) -> list[Message]:
    """Return the messages of samples at some times in s."""
    stamps = 1_700_000_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)
    return list(zip(stamps.tolist(), gyro, accel, strict=True))


def write_bag1(path: Path, messages: list[Message]) -> Path:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    path = path.with_suffix(".bag")
    with Writer(path) as bag:
        connection = bag.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for stamp, gyro, accel in messages:
            data = store.serialize_ros1(imu(store, stamp, gyro, accel, seq=0), "sensor_msgs/msg/Imu")
            bag.write(connection, stamp + 5_000_000, data)
    return path


def write_bag2(
    path: Path, messages: list[Message], plugin: str = "SQLITE3", topic: str = "/imu/data"
) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(path, version=9, storage_plugin=StoragePlugin[plugin]) as bag:
        connection = bag.add_connection(topic, "sensor_msgs/msg/Imu", typestore=store)
        for stamp, gyro, accel in messages:
            data = store.serialize_cdr(imu(store, stamp, gyro, accel), "sensor_msgs/msg/Imu")
            bag.write(connection, stamp + 5_000_000, data)
    return path


def imu(store: object, stamp: int, gyro: np.ndarray, accel: np.ndarray, **more: int) -> object:
    types = store.types  # type: ignore[attr-defined]
    vector, zeros = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return types["sensor_msgs/msg/Imu"](
        header=types["std_msgs/msg/Header"](stamp=time, frame_id="imu", **more),
        orientation=types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
        orientation_covariance=zeros,
        angular_velocity=vector(*map(float, gyro)),
        angular_velocity_covariance=zeros,
        linear_acceleration=vector(*map(float, accel)),
        linear_acceleration_covariance=zeros,
    )


def write_checked_mcap(path: Path, messages: list[Message]) -> Path:
    """Write MCAP whose chunks have their CRC, as rosbag2 does: the writer of rosbags leaves it out."""
    file = next(write_bag2(path, messages, "MCAP").glob("*.mcap"))
    data, place = bytearray(file.read_bytes()), 8
    while data[place] != 0x0F:  # the end of the data
        (length,) = struct.unpack_from("<Q", data, place + 1)
        if data[place] == 0x06:  # a chunk without compression: times, size, CRC, empty text, size, content
            struct.pack_into("<I", data, place + 33, crc32(data[place + 49 : place + 9 + length]))
        place += 9 + length
    file.write_bytes(data)
    return file
