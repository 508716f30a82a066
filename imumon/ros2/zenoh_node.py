"""ROS 2 node over Zenoh, as rmw_zenoh expects it, with eclipse-zenoh alone.

The session is a client of the router (`rmw_zenohd`). ROS 2 nodes are peers: the router announces each to the others,
and they exchange data directly. It forwards between a client and everybody, but not between two peers
(``peers_failover_brokering`` is off since ros2/rmw_zenoh pull request 341), so a peer that does not take part in
the gossip sees nothing. Liveliness tokens make the node visible to `ros2 node list` and `ros2 topic info`.

A queue in Zenoh, outside Python, holds what arrives: a message costs nothing until it is taken. When the queue is
full, Zenoh stops reading, and the router drops; the sequence numbers show that.
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import zenoh
from zenoh.handlers import FifoChannel

from imumon.ros2.node import (
    MOST_ENTITIES,
    NODE_NAME,
    QUEUE_MESSAGES,
    Publication,
    Received,
    RosError,
    RosNode,
    Subscription,
    TopicPublisher,
    is_plain,
)
from imumon.ros2.ros_messages import NO_HASH, type_hash
from imumon.ros2.topic_keys import (
    RELIABLE,
    SENSOR_DATA,
    Attachment,
    Entity,
    EntityKind,
    entity_token,
    gid_of,
    node_token,
    parse_attachment,
    parse_token,
    topic_key,
)

THREADS = "(rx: (worker_threads: 1), app: (worker_threads: 1))"
"""Threads of Zenoh that receive and that handle, instead of two each: one task that moves between threads wakes them a
thousand times per second at 1 kHz, which is a quarter of the cost of a message."""
MAX_MESSAGE_BYTES = 1 << 20
"""Bytes of a message that is accepted; an Imu has 320."""
RETRY_MS = {"period_init_ms": 500, "period_max_ms": 2000, "period_increase_factor": 1.5}
"""Times between two attempts to connect to a router that is gone."""
ANSWER_S = 1.0
"""s that the router may take to list the graph."""


class ZenohSubscription(Subscription):
    """Messages of one topic, with the attachments of rmw_zenoh."""

    def __init__(self, session: zenoh.Session, key: str, token: zenoh.LivelinessToken) -> None:
        self._subscriber = session.declare_subscriber(key, FifoChannel(QUEUE_MESSAGES))
        self._token = token

    def take(self) -> list[Received]:
        received: list[Received] = []
        with suppress(zenoh.ZError):  # the session is closed
            while len(received) < QUEUE_MESSAGES and (sample := self._subscriber.try_recv()) is not None:
                received.append(_received(sample))
        return received

    def messages(self) -> Iterator[Received]:
        with suppress(zenoh.ZError):
            while True:
                yield _received(self._subscriber.recv())


def _received(sample: zenoh.Sample) -> Received:
    data = None if sample.attachment is None else parse_attachment(sample.attachment.to_bytes())
    if data is None:
        return Received(sample.payload.to_bytes(), None, None, b"")
    return Received(sample.payload.to_bytes(), data.sequence, data.source_ns, data.gid)


class ZenohPublication(Publication):
    """A topic of this node. The key holds the type hash, which Humble does not have: the graph shows which."""

    def __init__(self, node: ZenohNode, topic: str, type_name: str) -> None:
        self._node, self._topic, self._type = node, topic, type_name
        self._hash = ""
        self._count = 0
        self._declare()

    def _declare(self) -> None:
        """Declare publisher and token for the distribution that is there."""
        self._hash = self._node.hash_of(self._type)
        key = topic_key(self._node.domain, self._topic, self._type, self._hash)
        self._publisher = self._node.session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.DROP
        )
        token = self._node.token("MP", self._topic, self._type, self._hash, RELIABLE)
        self._gid = gid_of(token)
        self._token = self._node.session.liveliness().declare_token(token)

    def publish(self, payload: bytes, source_ns: int) -> None:
        if self._hash != self._node.hash_of(self._type):
            self._publisher.undeclare()
            self._token.undeclare()
            self._count = 0
            self._declare()
        self._count += 1
        with suppress(zenoh.ZError):  # the session is closed
            self._publisher.put(payload, attachment=Attachment(self._count, source_ns, self._gid).encode())


class ZenohNode(RosNode):
    """A node in one domain, behind one router.

    Raises
    ------
    RosError : no router answers, or its endpoint is invalid.
    """

    def __init__(self, domain: int, router: str, name: str = NODE_NAME) -> None:
        self.domain, self._name = domain, name
        self._entities = 0
        self._tokens: dict[str, Entity] = {}
        self._humble = False  # an entity has no type hash
        self._lock = threading.Lock()  # of the tokens: topics are published by several threads
        os.environ.setdefault("ZENOH_RUNTIME", THREADS)  # read when the first session of the process opens
        try:
            self.session = zenoh.open(_config(router))
        except zenoh.ZError:  # it has one type for all causes; the endpoint has been checked
            text, cure = f"no Zenoh router at {router}", "start it with: ros2 run rmw_zenoh_cpp rmw_zenohd"
            cure += "; one that runs elsewhere: --port 'ros2:TOPIC?router=tcp/HOST:7447'"
            cure += "; most systems run DDS: --port 'ros2:TOPIC?rmw=dds'"
            raise RosError("ros2_no_router", text, cure) from None
        self._zid = str(self.session.zid())
        liveliness = self.session.liveliness()
        self._node_token = liveliness.declare_token(node_token(domain, self._zid, name))
        graph = f"@ros2_lv/{domain}/**"
        self._changes = liveliness.declare_subscriber(graph, FifoChannel(MOST_ENTITIES), history=True)
        for reply in liveliness.get(graph, timeout=ANSWER_S):
            if reply.ok is not None:
                self._note(str(reply.ok.key_expr))
        self._update()

    def token(self, kind: EntityKind, topic: str, type_name: str, hash: str, qos: str) -> str:
        """Return the token of a new entity of this node."""
        self._entities += 1
        return entity_token(
            self.domain, self._zid, self._name, kind, topic, type_name, hash, qos, entity_id=self._entities
        )

    @property
    def connected(self) -> bool:
        info = self.session.info
        return bool(info.routers_zid() or info.peers_zid())

    def publishers(self) -> set[TopicPublisher]:
        self._update()
        with self._lock:
            return {
                TopicPublisher(entity.topic, entity.type, entity.node)
                for entity in self._tokens.values()
                if entity.kind == "MP"
            }

    def hash_of(self, type_name: str) -> str:
        """Return the hash in the keys of a type: that of the definition, or the word for none on Humble."""
        self._update()
        return NO_HASH if self._humble else type_hash(type_name)

    def _update(self) -> None:
        """Take the changes of the graph."""
        with self._lock, suppress(zenoh.ZError):
            changed = False
            while (sample := self._changes.try_recv()) is not None:
                changed, key = True, str(sample.key_expr)
                if sample.kind == zenoh.SampleKind.DELETE:
                    self._tokens.pop(key, None)
                else:
                    self._note(key)
            if changed:
                self._humble = any(entity.hash == NO_HASH for entity in self._tokens.values())

    def _note(self, key: str) -> None:
        entity = parse_token(key)
        if entity is None or entity.session == self._zid or len(self._tokens) >= MOST_ENTITIES:
            return
        if is_plain(entity.node, entity.topic, entity.type):
            self._tokens[key] = entity

    def subscribe(self, topic: str, type_name: str) -> Subscription:
        hash = self.hash_of(type_name)
        token = self.session.liveliness().declare_token(self.token("MS", topic, type_name, hash, SENSOR_DATA))
        return ZenohSubscription(self.session, topic_key(self.domain, topic, type_name), token)

    def advertise(self, topic: str, type_name: str) -> Publication:
        return ZenohPublication(self, topic, type_name)

    def close(self) -> None:
        with suppress(zenoh.ZError):
            self.session.close()


def _config(router: str) -> zenoh.Config:
    """Return the configuration of a client that talks to one router, and to nothing else."""
    values: dict[str, Any] = {
        "mode": "client",
        "connect/endpoints": [router],
        "connect/timeout_ms": 0,
        "connect/exit_on_failure": True,
        "connect/retry": RETRY_MS,
        "listen/endpoints": [],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": True,
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
    }
    config = zenoh.Config()
    for path, value in values.items():
        config.insert_json5(path, json.dumps(value))
    return config
