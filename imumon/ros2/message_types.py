"""ROS 2 message types: their definitions, DDS names and REP-2016 type hashes.

The definitions are those of common_interfaces and rcl_interfaces, from Humble to Lyrical, without comments.
A type hash identifies a definition: ``RIHS01_`` and the SHA-256 of a JSON text of the fields
(REP-2016, "ROS 2 interface type descriptions"; https://github.com/ros-infrastructure/rep/pull/381). A ROS 2
subscriber receives only what has the hash of its own definition. Humble has no hashes.
"""

from __future__ import annotations

import hashlib
import json
import re
from functools import cache
from typing import NamedTuple

IMU = "sensor_msgs/msg/Imu"
MAGNETIC_FIELD = "sensor_msgs/msg/MagneticField"
TEMPERATURE = "sensor_msgs/msg/Temperature"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"

NO_HASH = "TypeHashNotSupported"
"""Word in place of the hash on Humble."""

DEFINITIONS = {
    IMU: """
        std_msgs/msg/Header header
        geometry_msgs/msg/Quaternion orientation
        float64[9] orientation_covariance
        geometry_msgs/msg/Vector3 angular_velocity
        float64[9] angular_velocity_covariance
        geometry_msgs/msg/Vector3 linear_acceleration
        float64[9] linear_acceleration_covariance""",
    MAGNETIC_FIELD: """
        std_msgs/msg/Header header
        geometry_msgs/msg/Vector3 magnetic_field
        float64[9] magnetic_field_covariance""",
    TEMPERATURE: """
        std_msgs/msg/Header header
        float64 temperature
        float64 variance""",
    "sensor_msgs/msg/FluidPressure": """
        std_msgs/msg/Header header
        float64 fluid_pressure
        float64 variance""",
    DIAGNOSTIC_ARRAY: """
        std_msgs/msg/Header header
        diagnostic_msgs/msg/DiagnosticStatus[] status""",
    "diagnostic_msgs/msg/DiagnosticStatus": """
        byte level
        string name
        string message
        string hardware_id
        diagnostic_msgs/msg/KeyValue[] values""",
    "diagnostic_msgs/msg/KeyValue": """
        string key
        string value""",
    "geometry_msgs/msg/Quaternion": """
        float64 x
        float64 y
        float64 z
        float64 w""",
    "geometry_msgs/msg/Vector3": """
        float64 x
        float64 y
        float64 z""",
    "geometry_msgs/msg/Vector3Stamped": """
        std_msgs/msg/Header header
        geometry_msgs/msg/Vector3 vector""",
    "std_msgs/msg/Header": """
        builtin_interfaces/msg/Time stamp
        string frame_id""",
    "std_msgs/msg/String": """
        string data""",
    "builtin_interfaces/msg/Time": """
        int32 sec
        uint32 nanosec""",
}
"""Fields of each type, one per line: type and name."""

_TYPE_IDS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9,
    "float32": 10, "float64": 11, "bool": 15, "byte": 16, "string": 17,
}  # fmt: skip
"""Numbers of the types in the JSON text of a hash (REP-2016)."""
_NESTED, _FIXED, _SEQUENCE = 1, 48, 144
"""Number of a nested type, and what is added for an array of fixed length and for a sequence."""

_FIELD = re.compile(r"([\w/]+)(?:\[(\d*)\])? (\w+)")


class Field(NamedTuple):
    """Field of a message: `length` is that of an array, 0 for a sequence, None for one value."""

    name: str
    type: str
    length: int | None


@cache
def fields_of(type_name: str) -> tuple[Field, ...]:
    """Return the fields of a type in their order.

    >>> fields_of("std_msgs/msg/String")
    (Field(name='data', type='string', length=None),)
    """
    found = []
    for line in DEFINITIONS[type_name].strip().splitlines():
        match = _FIELD.fullmatch(line.strip())
        assert match is not None
        count = None if match[2] is None else int(match[2] or 0)
        found.append(Field(match[3], match[1], count))
    return tuple(found)


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


def hashed_text(type_name: str) -> str:
    """Return the JSON text whose SHA-256 is the type hash."""
    others = sorted(_referenced(type_name) - {type_name})
    text = {
        "type_description": _described(type_name),
        "referenced_type_descriptions": [_described(name) for name in others],
    }
    return json.dumps(text, separators=(", ", ": "), ensure_ascii=False)


@cache
def type_hash(type_name: str) -> str:
    """Return the type hash of Iron and later.

    >>> type_hash("sensor_msgs/msg/Imu")[:14]
    'RIHS01_7d9a00f'
    """
    return f"RIHS01_{hashlib.sha256(hashed_text(type_name).encode()).hexdigest()}"


def _referenced(type_name: str) -> set[str]:
    """Return a type and all types that occur in it."""
    found = {type_name}
    for field in fields_of(type_name):
        if field.type in DEFINITIONS:
            found |= _referenced(field.type)
    return found


def _described(type_name: str) -> dict[str, object]:
    """Return the description of a type in the JSON text; the order of the keys counts."""
    described = []
    for name, kind, count in fields_of(type_name):
        array = 0 if count is None else (_FIXED if count else _SEQUENCE)
        nested = kind in DEFINITIONS
        described.append(
            {
                "name": name,
                "type": {
                    "type_id": array + (_NESTED if nested else _TYPE_IDS[kind]),
                    "capacity": count or 0,
                    "string_capacity": 0,
                    "nested_type_name": kind if nested else "",
                },
            }
        )
    return {"type_name": type_name, "fields": described}
