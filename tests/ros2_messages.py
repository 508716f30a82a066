"""Messages of ROS 2 as plain data: nested dicts and lists."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import is_dataclass
from typing import Any

import numpy as np

from imumon.model.samples import Item, SampleBlock
from imumon.ros2 import ros_messages
from imumon.ros2.ros_messages import message, type_store


def encode(type_name: str, data: Mapping[str, Any]) -> bytes:
    """Return a message as CDR."""
    return ros_messages.encode(_message(type_name, data))


def _message(type_name: str, data: Mapping[str, Any]) -> Any:
    made = {}
    for name, (_, described) in type_store().fielddefs[type_name][1]:
        inner, value = described, data[name]
        if isinstance(value, Mapping):
            made[name] = _message(inner, value)
        elif isinstance(value, list):
            (_, inner), _ = described
            of_numbers = not isinstance(inner, str)
            made[name] = np.array(value) if of_numbers else [_message(inner, each) for each in value]
        else:
            made[name] = value
    return message(type_name, **made)


def decode(type_name: str, payload: bytes) -> dict[str, Any]:
    """Return the fields of a message."""
    made: dict[str, Any] = _plain(ros_messages.decode(type_name, payload))
    return made


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        known = type_store().fielddefs[value.__msgtype__][1]  # type: ignore[attr-defined]
        return {name: _plain(getattr(value, name)) for name, _ in known}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_plain(each) for each in value] if isinstance(value, list) else value


def header(stamp_ns: int, frame_id: str = "") -> dict[str, Any]:
    """Return the fields of a header."""
    made: dict[str, Any] = {**_plain(ros_messages.header(stamp_ns)), "frame_id": frame_id}
    return made


def samples(items: list[Item]) -> np.ndarray[Any, Any]:
    """Return the values of all blocks."""
    return np.concatenate([item.values for item in items if isinstance(item, SampleBlock)])
