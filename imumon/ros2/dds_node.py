"""ROS 2 node over DDS, with Cyclone DDS for Python: for systems that run another middleware than Zenoh.

ROS 2 maps the topic ``/imu/data`` to the DDS topic ``rt/imu/data`` and ``sensor_msgs/msg/Imu`` to the type
``sensor_msgs::msg::dds_::Imu_`` (https://design.ros2.org/articles/topic_and_service_names.html). Messages are the same
CDR bytes as over Zenoh: the classes here hand them on without decoding.

Two things are missing compared with Zenoh: the interface of Cyclone DDS shows no sequence numbers, so lost messages
count as missing samples only, and DDS knows participants, not nodes.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from typing import Any

from imumon.ros2.node import (
    MOST_ENTITIES,
    QUEUE_MESSAGES,
    Publication,
    Received,
    RosError,
    RosNode,
    Subscription,
    TopicPublisher,
    is_plain,
)
from imumon.ros2.ros_messages import dds_name, ros_name, type_store

PREFIX = "rt/"
"""Begins the DDS topic of each ROS 2 topic."""

_SCALARS: dict[str, Any] = {"bool": bool, "string": str}
"""Types of fields that are those of Python, not of `cyclonedds.idl.types`."""


def _import_dds() -> None:
    """Import Cyclone DDS; raise `RosError` if it is not installed."""
    try:
        import cyclonedds.domain  # noqa: F401
    except ImportError as error:
        text = f"rmw=dds needs Cyclone DDS, which cannot be imported ({error})"
        raise RosError("dds_not_installed", text, "pip install 'imumon[dds]'") from None


@cache
def _dds_class(type_name: str, *, raw: bool) -> Any:
    """Return the class of a type for Cyclone DDS.

    Parameters
    ----------
    raw : its instances hold the bytes of a message in `payload`, not the fields.
    """
    from cyclonedds.idl import make_idl_struct

    _, fields = type_store().fielddefs[type_name]
    kinds = {name: _dds_type(*described) for name, described in fields}
    dds_class: Any = make_idl_struct(dds_name(type_name).rpartition("::")[2], dds_name(type_name), kinds)
    if raw:
        dds_class.deserialize = staticmethod(lambda data, *_, **__: _with_payload(dds_class, bytes(data)))
        dds_class.serialize = lambda self, *_, **__: self.payload
    return dds_class


def _with_payload(dds_class: Any, payload: bytes) -> Any:
    """Return a message of a raw class."""
    message = dds_class.__new__(dds_class)
    message.payload = payload
    return message


def _dds_type(kind: int, described: Any) -> Any:
    """Return the type of a field, which rosbags describes by its kind and its name, or the type and length of items."""
    from cyclonedds import idl
    from rosbags.interfaces import Nodetype

    types: Any = idl.types
    if kind == Nodetype.NAME:
        return _dds_class(described, raw=False)
    if kind == Nodetype.BASE:
        return _SCALARS.get(described[0]) or getattr(types, described[0].replace("byte", "uint8"))
    inner, length = _dds_type(*described[0]), described[1]
    return types.array[inner, length] if kind == Nodetype.ARRAY else types.sequence[inner]


class DdsSubscription(Subscription):
    """Messages of one topic."""

    def __init__(self, node: DdsNode, topic: str, type_name: str) -> None:
        from cyclonedds.core import Policy, Qos
        from cyclonedds.sub import DataReader

        # best effort matches every publisher; the queue keeps what is not taken yet
        qos = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(QUEUE_MESSAGES))
        self._node = node
        self._reader = DataReader(node.participant, node.topic(topic, type_name), qos)

    def take(self) -> list[Received]:
        received = []
        for sample in self._reader.take(QUEUE_MESSAGES):
            info = sample.sample_info
            if info.valid_data:
                publisher = int(info.publication_handle).to_bytes(8, "little", signed=False)
                received.append(Received(sample.payload, None, info.source_timestamp, publisher))
        return received

    def messages(self) -> Iterator[Received]:
        from cyclonedds.core import ReadCondition, SampleState, WaitSet
        from cyclonedds.util import duration

        waiting = WaitSet(self._node.participant)
        waiting.attach(ReadCondition(self._reader, SampleState.NotRead))
        while not self._node.closing.is_set():
            if waiting.wait(duration(milliseconds=200)):
                yield from self.take()


class DdsPublication(Publication):
    """A topic of this node."""

    def __init__(self, node: DdsNode, topic: str, type_name: str) -> None:
        from cyclonedds.core import Policy, Qos
        from cyclonedds.pub import DataWriter
        from cyclonedds.util import duration

        # as the publishers of ROS 2: reliable, keep last 10; never wait for a slow subscriber
        qos = Qos(Policy.Reliability.Reliable(duration(seconds=0)), Policy.History.KeepLast(10))
        self._class = _dds_class(type_name, raw=True)
        self._writer = DataWriter(node.participant, node.topic(topic, type_name), qos)

    def publish(self, payload: bytes, source_ns: int) -> None:
        from cyclonedds.core import DDSException

        with suppress(DDSException):  # a subscriber that is too slow
            self._writer.write(_with_payload(self._class, payload), source_ns)


class DdsNode(RosNode):
    """A participant in one domain.

    Raises
    ------
    RosError : Cyclone DDS is not installed, or finds no network.
    """

    def __init__(self, domain: int) -> None:
        _import_dds()
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
        from cyclonedds.core import DDSException
        from cyclonedds.domain import DomainParticipant

        self.closing = threading.Event()
        self._topics: dict[tuple[str, str], Any] = {}
        try:
            self.participant: Any = DomainParticipant(domain)
            self._graph: Any = BuiltinDataReader(self.participant, BuiltinTopicDcpsPublication)
        except DDSException as error:
            text = f"DDS cannot be used in domain {domain} ({error.msg})"
            raise RosError("dds_failed", text, "check CYCLONEDDS_URI and the network interface") from None

    @property
    def connected(self) -> bool:
        return not self.closing.is_set()

    def publishers(self) -> set[TopicPublisher]:
        from cyclonedds.core import InstanceState

        publishers = set()
        for endpoint in self._graph.read(MOST_ENTITIES):
            info = endpoint.sample_info
            alive = info.valid_data and info.instance_state == InstanceState.Alive
            other = alive and endpoint.participant_key != self.participant.guid
            if (
                other
                and endpoint.topic_name.startswith(PREFIX)
                and is_plain(endpoint.topic_name, endpoint.type_name)
            ):
                topic = endpoint.topic_name.removeprefix(PREFIX[:-1])
                node = f"participant {str(endpoint.participant_key)[:8]}"
                publishers.add(TopicPublisher(topic, ros_name(endpoint.type_name), node))
        return publishers

    def topic(self, topic: str, type_name: str) -> Any:
        """Return the DDS topic; one object for all its readers and writers."""
        from cyclonedds.topic import Topic

        key = (topic, type_name)
        if key not in self._topics:
            name = PREFIX + topic.lstrip("/")
            self._topics[key] = Topic(self.participant, name, _dds_class(type_name, raw=True))
        return self._topics[key]

    def subscribe(self, topic: str, type_name: str) -> Subscription:
        return DdsSubscription(self, topic, type_name)

    def advertise(self, topic: str, type_name: str) -> Publication:
        return DdsPublication(self, topic, type_name)

    def close(self) -> None:
        self.closing.set()
        self._topics.clear()
        self._graph = self.participant = None  # Cyclone DDS deletes what nothing refers to
