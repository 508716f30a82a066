"""Keys, liveliness tokens and attachments of rmw_zenoh: how a topic looks on Zenoh.

The formats are those of `docs/design.md` of ros2/rmw_zenoh after its pull request 648. A message has the key
``<domain>/<topic>/<DDS type>/<type hash>`` and an attachment with sequence number, time and publisher. The graph
(`ros2 topic list`) consists of liveliness tokens, one for each node, publisher and subscription.
"""

from __future__ import annotations

import struct
from typing import Literal, NamedTuple, TypeAlias

import xxhash

from imumon.ros2.ros_messages import dds_name, ros_name

_ATTACHMENT = struct.Struct("<qqB16s")
_GID_BYTES = 16
_TOKEN_CHUNKS = 12

EntityKind: TypeAlias = Literal["NN", "MP", "MS", "SS", "SC"]
"""Node, publisher, subscription, service server, service client."""


RELIABLE, SENSOR_DATA = "::,10:,:,:,,", "2::,5:,:,:,,"
"""Quality of service in a token: of ROS 2 topics, and of sensor data (rmw_qos_profile_sensor_data). Its parts are
reliability, durability, history and depth, then what rmw_zenoh does not use; an empty part is the default."""


def topic_key(domain: int, topic: str, type_name: str, hash: str = "*") -> str:
    """Return the key of a topic; ``*`` in place of the hash matches all distributions.

    >>> topic_key(0, "/imu/data", "sensor_msgs/msg/Imu")
    '0/imu/data/sensor_msgs::msg::dds_::Imu_/*'
    """
    return f"{domain}/{topic.strip('/')}/{dds_name(type_name)}/{hash}"


class Entity(NamedTuple):
    """Publisher or subscription of a node, as its token shows it."""

    session: str
    kind: str
    node: str  # with its namespace: /driver
    topic: str  # /imu/data; empty for a node
    type: str  # ROS name: sensor_msgs/msg/Imu; empty for a node
    hash: str


def node_token(domain: int, session: str, node: str) -> str:
    """Return the token of a node.

    >>> node_token(2, "aac3", "listener")
    '@ros2_lv/2/aac3/0/0/NN/%/%/listener'
    """
    return f"@ros2_lv/{domain}/{session}/0/0/NN/%/%/{node}"


def entity_token(
    domain: int,
    session: str,
    node: str,
    kind: EntityKind,
    topic: str,
    type_name: str,
    hash: str,
    qos: str,
    *,
    entity_id: int,
) -> str:
    """Return the token of a publisher or subscription of a node."""
    start = f"@ros2_lv/{domain}/{session}/0/{entity_id}/{kind}/%/%/{node}"
    return f"{start}/{_mangled(topic)}/{dds_name(type_name)}/{hash}/{qos}"


def parse_token(key: str) -> Entity | None:
    """Return what a token shows; None for other keys.

    >>> parse_token("@ros2_lv/2/8b20/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/RIHS01_df/::,7:,:,:,,")
    Entity(session='8b20', kind='MP', node='/talker', topic='/chatter', type='std_msgs/msg/String', hash='RIHS01_df')
    """
    chunks = key.split("/")
    if chunks[0] != "@ros2_lv" or len(chunks) < 9:
        return None
    session, kind, namespace, name = chunks[2], chunks[5], chunks[7].replace("%", "/"), chunks[8]
    node = f"{namespace.rstrip('/')}/{name}"
    if len(chunks) <= _TOKEN_CHUNKS:
        return Entity(session, kind, node, "", "", "")
    return Entity(session, kind, node, chunks[9].replace("%", "/"), ros_name(chunks[10]), chunks[11])


def _mangled(name: str) -> str:
    """Return a name as one chunk of a key."""
    return name.replace("/", "%")


def gid_of(token: str) -> bytes:
    """Return the 16 bytes that identify a publisher: XXH3-128 of its token, low half first.

    rmw_zenoh computes it in the same way (`liveliness_utils.cpp`), so `ros2 topic info -v` shows it.
    """
    digest = xxhash.xxh3_128_intdigest(token.encode())
    return digest.to_bytes(_GID_BYTES, "little")


class Attachment(NamedTuple):
    """What accompanies a message."""

    sequence: int  # from 1, per publisher
    source_ns: int  # ns since the Unix epoch, when it was published
    gid: bytes  # publisher

    def encode(self) -> bytes:
        """Return the 33 bytes.

        >>> Attachment(1, 0, bytes(16)).encode().hex()[:36]
        '010000000000000000000000000000001000'
        """
        return _ATTACHMENT.pack(self.sequence, self.source_ns, _GID_BYTES, self.gid)


def parse_attachment(data: bytes) -> Attachment | None:
    """Return an attachment; None if the bytes are none of rmw_zenoh."""
    if len(data) != _ATTACHMENT.size or data[16] != _GID_BYTES:
        return None
    sequence, source_ns, _, gid = _ATTACHMENT.unpack(data)
    return Attachment(sequence, source_ns, gid)
