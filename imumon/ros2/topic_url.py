"""The URL of a topic: what it names, the node in that system, and what to say if the topic is not there."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl

from imumon.ros2.node import NODE_NAME, RosError, RosNode, TopicPublisher
from imumon.ros2.ros_messages import IMU

DEFAULT_ROUTER = "tcp/127.0.0.1:7447"
"""Where the router of ROS 2, `rmw_zenohd`, listens."""
MAX_DOMAIN = 232
"""Highest ROS_DOMAIN_ID (ports of DDS end there)."""
MIDDLEWARE = ("zenoh", "dds")
TOPIC_PARAMETERS = ("accel", "mag", "temperature")
SHOWN_TOPICS = 8
"""Topics that a message lists at most."""
EXAMPLE = "write ros2:/imu/data?domain=0"

_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
_ROUTER = re.compile(r"(tcp|udp|tls|quic|ws)/\S+:\d+|(unixsock-stream|unixpipe)/\S+")


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicUrl:
    """What a URL ``ros2:TOPIC?NAME=VALUE&...`` says.

    Attributes
    ----------
    topic : with a leading slash; empty: not given.
    rmw : middleware, ``zenoh`` or ``dds``.
    domain : ROS_DOMAIN_ID.
    router : Zenoh endpoint of the router.
    accel, mag, temperature : further topics of the same device; empty: not given.
    """

    topic: str
    rmw: str = "zenoh"
    domain: int = 0
    router: str = DEFAULT_ROUTER
    accel: str = ""
    mag: str = ""
    temperature: str = ""

    @property
    def where(self) -> str:
        """The system for messages.

        >>> TopicUrl(topic="/imu").where
        'domain 0 through tcp/127.0.0.1:7447'
        """
        return f"domain {self.domain} " + ("over DDS" if self.rmw == "dds" else f"through {self.router}")


def parse_url(url: str, settings: Any = None) -> TopicUrl:
    """Return the parts of a URL.

    Parameters
    ----------
    settings : the table ``[ros2]``, for what the URL does not say; None: the defaults.

    Raises
    ------
    RosError : the URL is wrong.

    >>> parse_url("ros2:/imu/data?domain=2").domain
    2
    """
    path, _, query = url.removeprefix("ros2:").partition("?")
    names = ("rmw", "domain", "router", *TOPIC_PARAMETERS)
    try:
        given = dict(parse_qsl(query, keep_blank_values=True, strict_parsing=True)) if query else {}
    except ValueError:
        raise RosError("ros2_url_invalid", f"{url}: {query!r} is no list of NAME=VALUE", EXAMPLE) from None
    if unknown := [name for name in given if name not in names]:
        cure = f"use {', '.join(names)}"
        raise RosError("ros2_url_invalid", f"{url}: no parameter {unknown[0]!r}", cure)
    rmw = given.get("rmw", "zenoh")
    if rmw not in MIDDLEWARE:
        raise RosError("ros2_url_invalid", f"{url}: no middleware {rmw!r}", "use rmw=zenoh or rmw=dds")
    domain = given.get("domain", str(getattr(settings, "domain", 0)))
    if not (domain.isascii() and domain.isdigit() and int(domain) <= MAX_DOMAIN):
        raise RosError(
            "ros2_url_invalid", f"{url}: domain {domain!r}", f"use a number from 0 to {MAX_DOMAIN}"
        )
    router = given.get("router", getattr(settings, "router", "") or DEFAULT_ROUTER)
    if not _ROUTER.fullmatch(router):
        raise RosError("ros2_url_invalid", f"{url}: {router!r} is no router", "write router=tcp/HOST:7447")
    topics = {name: topic_name(given[name]) for name in TOPIC_PARAMETERS if name in given}
    topic = topic_name(path) if path else ""
    return TopicUrl(topic=topic, rmw=rmw, domain=int(domain), router=router, **topics)


def topic_name(text: str) -> str:
    """Return the full name of a topic; raise `RosError` if ROS 2 allows no such name.

    >>> topic_name("imu/data")
    '/imu/data'
    """
    if not _TOPIC.fullmatch(text):
        cure = "use letters, digits, _ and /, such as /imu/data"
        raise RosError("ros2_topic_invalid", f"{text!r} is no name of a topic", cure)
    return f"/{text.lstrip('/')}"


def open_node(url: TopicUrl, name: str = NODE_NAME) -> RosNode:
    """Return a node in the system that a URL names.

    Raises
    ------
    RosError : there is no connection, or the middleware is not installed.
    """
    if url.rmw == "dds":
        from imumon.ros2.dds_node import DdsNode

        return DdsNode(url.domain)
    from imumon.ros2.zenoh_node import ZenohNode

    return ZenohNode(url.domain, url.router, name)


def topics_text(publishers: Iterable[TopicPublisher]) -> str | None:
    """Return the topics of an IMU that are published, for a message; None: there are none."""
    topics = sorted({publisher.topic for publisher in publishers if publisher.type == IMU})
    more = f" and {len(topics) - SHOWN_TOPICS} more" if len(topics) > SHOWN_TOPICS else ""
    return ", ".join(topics[:SHOWN_TOPICS]) + more if topics else None


def absent_topic(url: TopicUrl, publishers: set[TopicPublisher]) -> RosError:
    """Return the error of a topic without a publisher: what there is instead, and what may be wrong."""
    others = topics_text(publishers)
    types = sorted({publisher.type for publisher in publishers if publisher.topic == url.topic} - {IMU})
    if types:
        text = f"{url.topic} is a topic of {types[0]}, not of {IMU}"
        cure = f"use one of {others}" if others else "start a driver that publishes an IMU"
        return RosError("ros2_topic_type", text, cure)
    what = f"{url.topic} has no publisher" if url.topic else "no topic is named"
    if others:
        return RosError(
            "ros2_topic_missing", f"{what} in {url.where}; IMU topics: {others}", "name one of them"
        )
    if publishers:
        topics = len({publisher.topic for publisher in publishers})
        text = f"{what} in {url.where}: {topics} topic{'s' * (topics > 1)}, none of them of {IMU}"
        return RosError("ros2_topic_missing", text, "start the driver of the IMU")
    text = f"no ROS 2 publisher is visible in {url.where}"
    if url.rmw == "dds":
        cure = "compare ROS_DOMAIN_ID and ROS_LOCALHOST_ONLY; a system with rmw_zenoh needs rmw=zenoh"
        return RosError("ros2_nothing_visible", text, cure)
    cure = "start the nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp and this router, which forwards nothing between "
    cure += "peers: one without gossip, or behind another router, is invisible; compare ROS_DOMAIN_ID; "
    cure += "most systems run DDS: add rmw=dds to the URL"
    return RosError("ros2_nothing_visible", text, cure)
