"""Uplink: one Zenoh session of a daemon, and what is declared on it.

A daemon has one session that listens, and one for each router that it connects to. It is a client of the
router: a router does not forward between two of its peers, because it expects them to connect directly.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import zenoh
from zenoh import ext
from zenoh.handlers import RingChannel

from imumon.bus.bus_error import BusError
from imumon.bus.queryable import EVENTS_KEPT, JSON
from imumon.bus.zenoh_session import LEASE_S, SessionOptions, local_endpoints, open_session, start_listener

_CACHED = {"report": 1, "grade": 1, "event": EVENTS_KEPT}
_DROP = zenoh.CongestionControl.DROP
_BY_NUMBER = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None)
"""Makes subscribers order messages by sequence number. Ordered by time, a subscriber whose clock is behind
the daemon's would get only one message."""

_MAX_QUERIES = 16  # queries in the queue; the oldest gets no reply
_FIND_S = 0.15  # s; time in which a liveliness token of a local daemon arrives
_LEASE_MARGIN_S = 0.5  # s after the lease


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
            session.declare_queryable(f"{root}/**", RingChannel(_MAX_QUERIES)), reply
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


def open_local(
    options: SessionOptions, listen: Sequence[str], connect: Sequence[str], id: str
) -> tuple[zenoh.Session, tuple[str, ...]]:
    """Open the session that listens: on `listen`, or if that is empty on the first free default port.

    Return the session and its endpoints.

    Raises
    ------
    BusError : no endpoint can be used, or another running daemon has this name.
    """
    if listen:
        return open_session(options, listen, connect, access_control=True), tuple(listen)
    in_use: list[str] = []
    for endpoint in local_endpoints():
        try:
            session = open_session(options, [endpoint], connect, access_control=True)
        except BusError as error:
            if error.code != "address_in_use":
                raise
            in_use.append(endpoint)
            continue
        try:
            check_name_is_free(replace(options, mode="peer"), in_use, id)
        except BusError:
            session.close()
            raise
        return session, (endpoint,)
    message = "all of tcp/127.0.0.1:7448 to 7463 are in use"
    raise BusError("no_free_port", message, "choose another with --listen")


def open_uplink(options: SessionOptions, endpoint: str, id: str) -> zenoh.Session:
    """Open a session to a router or another peer.

    Raises
    ------
    imumon.bus.zenoh_session.Unreachable : no connection now.
    BusError : the endpoint cannot be used, or another running daemon has this name there.
    """
    options = replace(options, mode="client")
    check_name_is_free(options, [endpoint], id)
    return open_session(options, (), [endpoint], access_control=True)


def check_name_is_free(options: SessionOptions, endpoints: Iterable[str], id: str) -> None:
    """Raise `BusError` (``name_in_use``) if a running daemon on these endpoints has this name.

    The token of a killed daemon disappears only after its lease: a token counts if it is there after that.
    """
    endpoints = tuple(endpoints)
    if not endpoints:
        return
    with open_session(options, (), endpoints, access_control=False) as session:
        tokens = session.liveliness().declare_subscriber(f"imumon/{id}/alive", RingChannel(8), history=True)
        alive, start = False, time.monotonic()
        while time.monotonic() - start < (LEASE_S + _LEASE_MARGIN_S if alive else _FIND_S):
            while sample := tokens.try_recv():
                alive = sample.kind == zenoh.SampleKind.PUT
            time.sleep(0.01)
        if alive:
            message = f'a daemon named "{id}" is running already'
            raise BusError("name_in_use", message, "stop it or choose another with --id")
