"""Link: one session of a daemon and what is declared on it.

A daemon has one session that listens, and one for every router it connects to. To the router it is a client:
between two peers that are connected to it a router passes on nothing, it expects them to meet by themselves.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import zenoh
from zenoh import ext
from zenoh.handlers import RingChannel

from imumon.bus.queryable import EVENTS_KEPT, JSON
from imumon.bus.zenoh_session import (
    LEASE_S,
    BusError,
    SessionOptions,
    listener,
    local_endpoints,
    open_session,
)

_CACHED = {"report": 1, "grade": 1, "event": EVENTS_KEPT}
_DROP = zenoh.CongestionControl.DROP
_BY_NUMBER = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None)
"""Subscribers order messages by number. By time, those whose clock is behind ours would hear one alone."""

_QUESTIONS = 256  # that may wait; the oldest goes unanswered


class Uplink:
    """Publishers of the keys below `root`, a queryable for all of them, and a token of liveliness."""

    def __init__(self, session: zenoh.Session, root: str, answer: Callable[[zenoh.Query], None]) -> None:
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
        self._answering = listener(session.declare_queryable(f"{root}/**", RingChannel(_QUESTIONS)), answer)
        self._token = session.liveliness().declare_token(f"{root}/alive")

    def put(self, name: str, text: str, stamp: zenoh.Timestamp) -> None:
        publisher = self._publishers.get(name)
        if publisher is None:
            publisher = self._publishers[name] = self.session.declare_publisher(
                f"{self._root}/{name}", encoding=JSON, congestion_control=_DROP
            )
        publisher.put(text, timestamp=stamp)

    def say_goodbye(self) -> None:
        """Be alive no more; the session closes in its own time."""
        self._token.undeclare()

    def close(self) -> None:
        self._publishers.clear()  # one with a cache that outlives its session is never freed
        self.session.close()
        self._answering.join()


def open_local(
    options: SessionOptions, listen: Sequence[str], connect: Sequence[str], id: str
) -> tuple[zenoh.Session, tuple[str, ...]]:
    """Session that listens, and where: as told, or on the first free of the usual ports.

    Raises
    ------
    BusError : no address can be had, or a living daemon has the name already.
    """
    if listen:
        return open_session(options, listen, connect, guarded=True), tuple(listen)
    taken: list[str] = []
    for endpoint in local_endpoints():
        try:
            session = open_session(options, [endpoint], connect, guarded=True)
        except BusError as error:
            if "taken" not in str(error):
                raise
            taken.append(endpoint)
            continue
        try:
            refuse_twins(replace(options, mode="peer"), taken, id)
        except BusError:
            session.close()
            raise
        return session, (endpoint,)
    raise BusError("all of tcp/127.0.0.1:7448 to 7463 are taken; choose another with --listen")


def open_uplink(options: SessionOptions, endpoint: str, id: str) -> zenoh.Session:
    """Session to a router or another peer.

    Raises
    ------
    imumon.bus.zenoh_session.Unreachable : nobody answers there now.
    BusError : it cannot be had, or a living daemon has the name there already.
    """
    options = replace(options, mode="client")
    refuse_twins(options, [endpoint], id)
    return open_session(options, (), [endpoint], guarded=True)


def refuse_twins(options: SessionOptions, endpoints: Iterable[str], id: str) -> None:
    """Refuse a name that a living daemon on these endpoints has.

    One that just died may be remembered until its lease is over, so a twin is watched for longer than that.
    """
    endpoints = tuple(endpoints)
    if not endpoints:
        return
    with open_session(options, (), endpoints, guarded=False) as session:
        news = session.liveliness().declare_subscriber(f"imumon/{id}/alive", RingChannel(8), history=True)
        alive, start = False, time.monotonic()
        while time.monotonic() - start < (LEASE_S + 0.5 if alive else 0.15):
            while sample := news.try_recv():
                alive = sample.kind == zenoh.SampleKind.PUT
            time.sleep(0.01)
        if alive:
            raise BusError(f'a daemon named "{id}" is running already; stop it or choose another with --id')
