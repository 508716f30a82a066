"""ROS 2 node: what imumon needs of one, whatever the middleware.

A node lists the publishers of its domain, subscribes to topics and publishes on topics. Messages are CDR bytes with
what the middleware says of them. There is one implementation for each middleware: `zenoh_node`, `dds_node`.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import NamedTuple

from imumon.model.errors import ImumonError

NODE_NAME = "imumon"
MOST_ENTITIES = 1 << 14
"""Publishers, subscriptions and nodes of a domain that are kept."""
QUEUE_MESSAGES = 1 << 14
"""Messages of a topic that may wait: 16 s at 1 kHz, 8 MB."""

_PLAIN = re.compile(r"[\w/:~ ]{0,256}", re.ASCII)


class RosError(ImumonError):
    """The ROS 2 system, or a topic of it, cannot be used."""


class Received(NamedTuple):
    """One message."""

    payload: bytes  # CDR
    sequence: int | None  # of its publisher, from 1; None: the middleware does not say
    source_ns: int | None  # ns since the Unix epoch, when it was published
    publisher: bytes  # identifies its publisher; empty: unknown


class TopicPublisher(NamedTuple):
    """Publisher of a topic."""

    topic: str  # /imu/data
    type: str  # sensor_msgs/msg/Imu
    node: str  # /driver; empty: unknown


def is_plain(*names: str) -> bool:
    """Return whether names from the network have only the characters of ROS names: they are printed.

    >>> is_plain("/imu/data", "sensor_msgs/msg/Imu", ""), is_plain("/imu\\x1b[2J")
    (True, False)
    """
    return all(_PLAIN.fullmatch(name) for name in names)


class Subscription(ABC):
    """Messages of one topic."""

    @abstractmethod
    def take(self) -> list[Received]:
        """Return the messages that have arrived, in order; never wait."""

    @abstractmethod
    def messages(self) -> Iterator[Received]:
        """Yield each message as it arrives, until the node is closed."""


class Publication(ABC):
    """A topic that this node publishes."""

    @abstractmethod
    def publish(self, payload: bytes, source_ns: int) -> None:
        """Publish a message; never wait for a subscriber."""


class RosNode(ABC):
    """A node of a ROS 2 system."""

    @property
    @abstractmethod
    def connected(self) -> bool:
        """Whether there is a connection to the system."""

    @abstractmethod
    def publishers(self) -> set[TopicPublisher]:
        """Return the publishers of other nodes that are known by now."""

    @abstractmethod
    def subscribe(self, topic: str, type_name: str) -> Subscription:
        """Return a new subscription."""

    @abstractmethod
    def advertise(self, topic: str, type_name: str) -> Publication:
        """Return a new publication."""

    @abstractmethod
    def close(self) -> None:
        """Leave the system; closing twice does no harm."""
