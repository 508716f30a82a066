"""ROS 2 messages: names and hashes of their types, and their bytes.

rosbags has the definitions, which are the same from Humble to Lyrical for these types, makes the classes of the
messages and their CDR, and computes the hashes. A type hash identifies a definition (REP-2016, "ROS 2 interface type
descriptions"): a subscriber receives only what has the hash of its own definition. Humble has no hashes.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from imumon.model.errors import ImumonError

IMU = "sensor_msgs/msg/Imu"
MAGNETIC_FIELD = "sensor_msgs/msg/MagneticField"
TEMPERATURE = "sensor_msgs/msg/Temperature"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"

NO_HASH = "TypeHashNotSupported"
"""Word in place of the hash on Humble."""
NO_ESTIMATE = -1.0
"""First covariance of a quantity that the message does not have (comments in Imu.msg)."""


class CdrError(ImumonError):
    """The bytes are no message of the type."""


@cache
def type_store() -> Any:
    """Return the types of rosbags. They take a tenth of a second, which only a user of ROS 2 pays."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def type_hash(type_name: str) -> str:
    """Return the type hash of Iron and later.

    >>> type_hash("sensor_msgs/msg/Imu")[:14]
    'RIHS01_7d9a00f'
    """
    return str(type_store().hash_rihs01(type_name))


def dds_name(type_name: str) -> str:
    """Return the name of a type in DDS and in key expressions.

    >>> dds_name("sensor_msgs/msg/Imu")
    'sensor_msgs::msg::dds_::Imu_'
    """
    package, _, name = type_name.partition("/msg/")
    return f"{package}::msg::dds_::{name}_"


def ros_name(dds_type: str) -> str:
    """Return the ROS name of a DDS type; the text itself if it is none.

    >>> ros_name("sensor_msgs::msg::dds_::Imu_"), ros_name("other")
    ('sensor_msgs/msg/Imu', 'other')
    """
    match = re.fullmatch(r"(\w+)::(msg|srv|action)::dds_::(\w+)_", dds_type)
    return f"{match[1]}/{match[2]}/{match[3]}" if match else dds_type


def message(type_name: str, **fields: Any) -> Any:
    """Return a message with all its fields; arrays of numbers are those of numpy."""
    return type_store().types[type_name](**fields)


def header(stamp_ns: int) -> Any:
    """Return a ``std_msgs/msg/Header``."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    stamp = message("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id="")


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message with a header, ns since the Unix epoch."""
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


def encode(message: Any) -> bytes:
    """Return a message as CDR, little endian."""
    return bytes(type_store().serialize_cdr(message, message.__msgtype__, little_endian=True))


def decode(type_name: str, payload: bytes) -> Any:
    """Return a message of either byte order.

    Raises
    ------
    CdrError : the bytes are too short, or are no message of this type.
    """
    try:
        return type_store().deserialize_cdr(payload, type_name)
    except Exception as error:  # a publisher may send anything
        text = f"no {type_name}: {str(error) or type(error).__name__}"
        raise CdrError("cdr_invalid", text, "check the type of the topic") from None


class ImuMessage(NamedTuple):
    """What a ``sensor_msgs/msg/Imu`` says of the two sensors; None: the message has no estimate of it."""

    stamp_ns: int
    gyro: tuple[float, ...] | None  # rad/s, x y z
    accel: tuple[float, ...] | None  # m/s^2


def imu_message(payload: bytes) -> ImuMessage:
    """Return an Imu message.

    Raises
    ------
    CdrError : the payload is no Imu.
    """
    imu = decode(IMU, payload)
    gyro, accel = imu.angular_velocity, imu.linear_acceleration
    return ImuMessage(
        stamp_ns(imu),
        None if imu.angular_velocity_covariance[0] == NO_ESTIMATE else (gyro.x, gyro.y, gyro.z),
        None if imu.linear_acceleration_covariance[0] == NO_ESTIMATE else (accel.x, accel.y, accel.z),
    )


def with_imu_covariances(
    payload: bytes, gyro: Sequence[float] | None, accel: Sequence[float] | None
) -> bytes:
    """Return an Imu message with other diagonal covariances.

    Parameters
    ----------
    gyro, accel : variances of x, y and z; None: the covariance of the input stays. A quantity without an
        estimate stays without one.

    Raises
    ------
    CdrError : the payload is no Imu.
    """
    imu = decode(IMU, payload)
    for name, variances in (("angular_velocity_covariance", gyro), ("linear_acceleration_covariance", accel)):
        if variances is not None and getattr(imu, name)[0] != NO_ESTIMATE:
            setattr(imu, name, np.diag(np.asarray(variances, np.float64)).ravel())
    return encode(imu)
