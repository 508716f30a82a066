"""Uplink: one Zenoh session of a daemon, and what is declared on it.

A daemon has one session that listens, and one for each router that it connects to. It is a client of the
router: a router does not forward between two of its peers, because it expects them to connect directly.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import zenoh
from zenoh import ext
from zenoh.handlers import RingChannel

from imumon.bus.bus_error import BusError
from imumon.bus.queryable import EVENTS_KEPT, JSON, MOST_QUERIES, LastValues
from imumon.bus.zenoh_session import local_endpoints, open_session, start_listener
from imumon.config import ZenohSettings

_CACHED = {"report": 1, "grade": 1, "event": EVENTS_KEPT}
_DROP = zenoh.CongestionControl.DROP
_BY_NUMBER = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None)
"""Makes subscribers order messages by sequence number. Ordered by time, a subscriber whose clock is behind
the daemon's would get only one message."""

_LOST = "connection lost; trying again"


class Uplink:
    """Publishers of the keys below `root`, a queryable for all of them, and a liveliness token."""

    def __init__(self, session: zenoh.Session, root: str, reply: Callable[[zenoh.Query], None]) -> None:
        self.session = session
        self._root = root
        self._publishers: dict[str, ext.AdvancedPublisher | zenoh.Publisher] = {
            name: ext.declare_advanced_publisher(
                session,
                f"{root}/{name}",
                encoding=JSON,
                congestion_control=_DROP,
                cache=ext.CacheConfig(kept),
                publisher_detection=True,
                sample_miss_detection=_BY_NUMBER,
            )
            for name, kept in _CACHED.items()
        }
        self._listener = start_listener(
            session.declare_queryable(f"{root}/**", RingChannel(MOST_QUERIES)), reply
        )
        self._token = session.liveliness().declare_token(f"{root}/alive")

    def put(self, name: str, text: str, timestamp: zenoh.Timestamp) -> None:
        publisher = self._publishers.get(name)
        if publisher is None:
            publisher = self._publishers[name] = self.session.declare_publisher(
                f"{self._root}/{name}", encoding=JSON, congestion_control=_DROP
            )
        publisher.put(text, timestamp=timestamp)

    def undeclare_token(self) -> None:
        """Notify subscribers that the daemon ends."""
        self._token.undeclare()

    def close(self) -> None:
        self._publishers.clear()  # Zenoh leaks an advanced publisher that outlives its session
        self.session.close()
        self._listener.join()


class Links:
    """The sessions of one daemon: that of this machine, and one for each router. Thread-safe.

    Each message goes to every session exactly once, also to one that is added meanwhile.

    Parameters
    ----------
    local : the session that listens.
    last_values : the last message of each key, which a new session gets first.
    """

    def __init__(self, local: Uplink, last_values: LastValues) -> None:
        self._last_values = last_values
        self._sending = threading.Lock()  # of the next two fields
        self._open = [local]
        self._closed = False
        self._knowing = threading.Lock()  # of the next two fields: who asks never waits for a session
        self._routers: dict[str, Uplink] = {}  # by endpoint
        self._errors: dict[str, str] = {}  # of the last attempt, by endpoint

    def put(self, name: str, text: str, timestamp: zenoh.Timestamp) -> None:
        """Send a message below the root of the keys, and store it."""
        with self._sending:
            self._last_values.store(name, text, timestamp)
            for link in self._open:
                link.put(name, text, timestamp)

    def add(self, endpoint: str, link: Uplink) -> None:
        """Add the session of a router and send it the last value of every key; close it after `close`."""
        with self._sending:
            for name, text, timestamp in self._last_values.messages():
                link.put(name, text, timestamp)
            if self._closed:
                link.close()
                return
            self._open.append(link)
        with self._knowing:
            self._routers[endpoint] = link

    def failed(self, endpoint: str, error: BusError) -> None:
        """Note why there is no session with a router."""
        with self._knowing:
            self._errors[endpoint] = str(error)

    def errors(self) -> dict[str, str | None]:
        """Return why there is no connection to a router, by its endpoint; None: there is one."""
        with self._knowing:
            errors: dict[str, str | None] = dict(self._errors)
            routers = dict(self._routers)
        for endpoint, link in routers.items():
            errors[endpoint] = None if link.session.info.transports() else f"{endpoint}: {_LOST}"
        return errors

    def close(self) -> None:
        """Close all sessions."""
        with self._sending:
            links, self._open, self._closed = self._open, [], True
        for link in links:  # all tokens before the first session whose link may be congested
            link.undeclare_token()
        for link in links:
            link.close()


def open_local(settings: ZenohSettings) -> tuple[zenoh.Session, tuple[str, ...]]:
    """Open the session that listens: on the endpoints of the settings, or without any on the first free default port.

    Return the session and its endpoints.

    Raises
    ------
    BusError : no endpoint can be used.
    """
    if settings.listen:
        return open_session(settings, settings.listen, (), access_control=True), settings.listen
    for endpoint in local_endpoints():
        try:
            return open_session(settings, [endpoint], (), access_control=True), (endpoint,)
        except BusError as error:
            if error.code != "address_in_use":
                raise
    message = "all of tcp/127.0.0.1:7448 to 7463 are in use"
    raise BusError("no_free_port", message, "choose another with --listen")
