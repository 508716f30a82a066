"""An IMU topic of ROS 2 as a device: a node that subscribes to it, found, lost and found again.

The device is there as long as the topic has a publisher. A publisher that is silent stays a device: the daemon
reports that nothing arrives. If the publisher is gone, or the router, the device is lost; a publisher that starts
again within a second is the same one, and its stamps show the gap.
"""

from __future__ import annotations

import time
from dataclasses import replace

from imumon.model.ledger import merged
from imumon.model.samples import DeviceCounters, DeviceInfo, Item
from imumon.ros2.node import RosError, RosNode, Subscription
from imumon.ros2.ros_messages import IMU
from imumon.ros2.topic_url import absent_topic, open_node, parse_url
from imumon.sources.device import (
    BATCH_S,
    Device,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DeviceOptions,
    InvalidOption,
)
from imumon.sources.ros2.imu_assembler import TYPES, ImuAssembler

FIND_S = 5.0
"""s to wait for a topic that is absent, before the topics that exist are listed."""
POLL_S = 0.05
"""s between two looks for it."""
RIVAL_S = 30.0
"""s after the last message of another publisher for which there counts as one."""
MOST_NAMED = 4
"""Publishers of the topic that a report names, at most: others choose how many there are."""
GONE_S = 1.0
"""s without a publisher and without a message after which the topic is gone."""


class Ros2Device(Device):
    """One IMU topic.

    Raises
    ------
    InvalidOption : the URL is wrong.
    """

    def __init__(self, options: DeviceOptions) -> None:
        super().__init__()
        try:
            self._url = parse_url(options.url, options.table)
        except RosError as error:
            raise InvalidOption(error.code, error.message, error.cure) from None
        self._port = options.url
        self._node: RosNode | None = None
        self._main: Subscription | None = None
        self._others: dict[str, Subscription] = {}
        self._assembler = ImuAssembler(self._url)
        self._earlier = DeviceCounters()  # of earlier connections
        self._nodes: tuple[str, ...] = ()  # that publish the topic
        self._heard_s = 0.0  # monotonic, of the last message or publisher
        self._items: list[Item] = []  # that arrived while the topic was looked for

    # ------------------------------------------------------------------ start and end

    def open(self) -> DeviceInfo:
        try:
            self._node = open_node(self._url)
            if self._url.topic:
                self._main = self._node.subscribe(self._url.topic, IMU)
            self._others = {
                name: self._node.subscribe(getattr(self._url, name), kind)
                for name, kind in TYPES.items()
                if getattr(self._url, name)
            }
            self._wait_for_topic(self._node)
        except RosError as error:
            self.close()
            raise DeviceNotFound(error.code, error.message, error.cure) from None
        except BaseException:
            self.close()
            raise
        return self.info()

    def _wait_for_topic(self, node: RosNode) -> None:
        """Wait until the topic has a publisher; raise `RosError` with the topics that exist."""
        self.progress(f"looking for {self._url.topic or 'IMU topics'} in {self._url.where}")
        end = time.monotonic() + FIND_S
        while True:
            if self._publishing(node) or self._take():
                self._heard_s = time.monotonic()
                return
            if time.monotonic() >= end or not self._url.topic:
                raise absent_topic(self._url, node.publishers())
            self.wait(POLL_S)

    def _publishing(self, node: RosNode) -> bool:
        """Return whether the graph shows a publisher of the topic."""
        topic_type = (self._url.topic, IMU)
        publishers = [p for p in node.publishers() if (p.topic, p.type) == topic_type]
        if publishers:
            self._nodes = tuple(sorted({p.node for p in publishers if p.node}))
        return bool(publishers)

    def close(self) -> None:
        if self._node is not None:
            self._earlier = self.counters
            self._node.close()
        self._assembler, self._items = ImuAssembler(self._url, self._assembler), []
        self._node = self._main = None
        self._others = {}

    def expected(self) -> DeviceInfo | None:
        # a driver may start after the daemon; without a topic, there is nothing to wait for
        return self.info() if self._url.topic else None

    # ------------------------------------------------------------------ while it streams

    def info(self) -> DeviceInfo:
        stream = self._assembler.stream
        return DeviceInfo(
            id=f"ros2{self._url.topic.replace('/', '-')}",
            kind="ROS 2 topic",
            port=self._port,
            stream="unknown",
            source=f"{IMU} on {self._url.topic}",
            topic=self._url.topic,
            clock=None if stream is None else stream.clock,
            settings={"publisher": ", ".join(self._nodes[:MOST_NAMED])} if self._nodes else {},
            caveats=("unknown_compensation", *(("other_sender",) if self._has_rival() else ())),
            remarks=tuple(self._assembler.remarks),
        )

    def _has_rival(self) -> bool:
        """Return whether another node publishes the topic at present."""
        # the host clock may be set: a time that is ahead of it is none
        return 0.0 <= time.time() - self._assembler.other_heard_s < RIVAL_S

    def read(self, timeout_s: float) -> list[Item]:
        node = self._node
        if node is None:
            raise DeviceError("device_closed", "the device is not open", "open it first")
        self.wait(min(timeout_s, BATCH_S))
        received = self._take()
        items, self._items = self._items, []
        now = time.monotonic()
        if received or self._publishing(node):
            self._heard_s = now
        elif not node.connected or now - self._heard_s > GONE_S:
            items += self._assembler.finish()
            if not items:  # what is left is delivered first; the next read raises this
                raise self._gone(node)
        return items

    def _take(self) -> bool:
        """Take what has arrived; return whether a message of the topic is among it."""
        messages = self._main.take() if self._main is not None else []
        others = {name: topic.take() for name, topic in self._others.items()}
        self._items += self._assembler.add(messages, others, time.time_ns())
        return bool(messages)

    def _gone(self, node: RosNode) -> DeviceLost:
        if not node.connected:
            text = f"the Zenoh router at {self._url.router} is gone"
            return DeviceLost("ros2_router_gone", text, "start it again")
        text = f"{self._url.topic} has no publisher any more"
        return DeviceLost("ros2_publisher_gone", text, "start the driver again")

    def finish(self) -> list[Item]:
        return self._assembler.finish()

    @property
    def counters(self) -> DeviceCounters:
        assembler, earlier = self._assembler, self._earlier
        return replace(
            earlier,
            received_bytes=earlier.received_bytes + assembler.bytes,
            messages=earlier.messages + assembler.messages - assembler.invalid,
            discarded_bytes=earlier.discarded_bytes + assembler.invalid_bytes,
            bad_checksums=earlier.bad_checksums + assembler.invalid,
            overruns=earlier.overruns + assembler.losses,
            other_sender=earlier.other_sender + assembler.other_sender,
            ledger=merged(earlier.ledger, assembler.ledger),
        )
