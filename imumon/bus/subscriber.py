"""Viewer: the reading end of the bus, for screens and questions.

It connects to every endpoint it is given (or to all where a daemon of this machine may be), comes back by
itself, and keeps the newest report of each device, the last events, who is alive, and the signal of one
channel that is watched. What arrives is kept as bytes and read when asked for: a screen that looks twice a
second reads twice a second. Whatever is not a report is counted and passed over: strangers share the bus.
"""

from __future__ import annotations

import atexit
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeVar

import zenoh
from zenoh import ext
from zenoh.handlers import RingChannel

from imumon.bus.zenoh_session import SessionOptions, listener, local_endpoints, open_session
from imumon.report import Event, Report, Signal, from_json

_EVENTS_KEPT = 100
_MOST_DEVICES = 1000  # a stranger may invent names; memory is finite
_WAITING = 1024  # messages that may wait to be taken; the oldest give way

T = TypeVar("T", Report, Event, Signal)


class Subscriber:
    """Newest reports of all devices on the bus.

    Parameters
    ----------
    connect : endpoints; None takes those of `settings` (where daemons connect to or listen), else all where a
        daemon of this machine may be.
    settings : `imumon.bus.SessionOptions`, or anything with attributes of the same names; None for the defaults.

    Attributes
    ----------
    version : grows with everything that arrives.
    malformed : messages on our keys that were none of ours.
    """

    def __init__(self, connect: Sequence[str] | None = None, *, settings: object | None = None) -> None:
        options = SessionOptions.of(settings)
        options = replace(options, mode="peer", users_file="")
        given = tuple(connect or ()) or options.connect or tuple(_reachable(e) for e in options.listen)
        self.endpoints = given or local_endpoints()
        self.version = 0
        self.malformed = 0
        self._news = threading.Condition()
        self._fresh: dict[str, tuple[bytes, float]] = {}  # arrived, not yet read
        self._reports: dict[str, tuple[Report, float]] = {}
        self._alive: set[str] = set()
        self._events: dict[str, deque[Event]] = {}
        self._watched: tuple[str, str] | None = None
        self._signal: tuple[Signal, float] | None = None
        self._closed = False
        self._ask = threading.Event()
        self._session = open_session(options, (), self.endpoints, guarded=False)
        alive = self._session.liveliness().declare_subscriber(
            "imumon/*/alive", RingChannel(_WAITING), history=True
        )
        self._threads = (
            listener(alive, self._on_alive),
            listener(self._subscribe("report", 1), self._on_report),
            listener(self._subscribe("event", _EVENTS_KEPT), self._on_event),
            threading.Thread(target=self._follow, name="imumon-signal", daemon=True),
        )
        self._threads[-1].start()
        atexit.register(self.close)

    def _subscribe(self, name: str, kept: int) -> Any:
        """Subscription to one key of all devices, with the last that were published before."""
        history = ext.HistoryConfig(detect_late_publishers=True, max_samples=kept)
        key = f"imumon/*/{name}"
        channel: RingChannel[Any] = RingChannel(_WAITING)
        return ext.declare_advanced_subscriber(
            self._session, key, channel, history=history, allowed_origin=zenoh.Locality.REMOTE
        )

    def reports(self) -> dict[str, tuple[Report, float]]:
        """Newest report of each device by its name, with the monotonic time of its arrival in seconds."""
        with self._news:
            fresh, self._fresh = self._fresh, {}
        read = {id: (self._read(Report, data), moment) for id, (data, moment) in fresh.items()}
        with self._news:
            self._reports.update(
                {id: (report, at) for id, (report, at) in read.items() if report is not None}
            )
            return dict(self._reports)

    def alive(self) -> set[str]:
        """Names of the devices whose daemon lives; how old its data is says only the report."""
        with self._news:
            return set(self._alive)

    def events(self, id: str) -> list[Event]:
        """Last events of a device, newest last."""
        with self._news:
            return list(self._events.get(id, ()))

    def watch(self, id: str, channel: str | None) -> None:
        """Follow the signal of one channel; None: of none."""
        with self._news:
            watched = (id, channel) if channel else None
            if watched == self._watched:
                return
            self._watched, self._signal = watched, None
        self._ask.set()

    def signal(self) -> tuple[Signal, float] | None:
        """Newest signal of the channel that is watched, with the monotonic time of its arrival."""
        with self._news:
            return self._signal

    def connected(self) -> bool:
        """Whether there is a link to anybody."""
        return bool(self._session.info.transports())

    def wait_report(self, id: str | None = None, timeout: float = 2.0) -> Report | None:
        """First report of this device (None: of any), waiting so many seconds for it; None without one."""
        end = time.monotonic() + timeout
        while True:
            with self._news:
                seen = self.version
            reports = self.reports()
            found = next(iter(reports.values()), None) if id is None else reports.get(id)
            if found:
                return found[0]
            with self._news:
                left = end - time.monotonic()
                if left <= 0 or not self._moved(seen, left):
                    return None

    def _moved(self, seen: int, timeout: float) -> bool:
        """Wait until something has arrived since version `seen`; the lock is held."""
        return self._news.wait_for(lambda: self.version != seen, timeout)

    def close(self) -> None:
        atexit.unregister(self.close)
        self._closed = True
        self._ask.set()
        self._session.close()
        for thread in self._threads:
            thread.join(1.0)

    def __enter__(self) -> Subscriber:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _read(self, cls: type[T], data: bytes) -> T | None:
        try:
            return from_json(cls, data)
        except ValueError:
            with self._news:
                self.malformed += 1
            return None

    def _changed(self) -> None:
        self.version += 1
        self._news.notify_all()

    def _on_alive(self, sample: zenoh.Sample) -> None:
        id = _device(sample)
        with self._news:
            if sample.kind == zenoh.SampleKind.DELETE:
                self._alive.discard(id)
            elif len(self._alive) < _MOST_DEVICES:
                self._alive.add(id)
            self._changed()

    def _on_report(self, sample: zenoh.Sample) -> None:
        id = _device(sample)
        with self._news:
            known = id in self._reports or id in self._fresh
            if not known and len(self._reports) + len(self._fresh) >= _MOST_DEVICES:
                return
            self._fresh[id] = (sample.payload.to_bytes(), time.monotonic())
            watched = self._watched is not None and self._watched[0] == id
            self._changed()
        if watched:
            self._ask.set()

    def _on_event(self, sample: zenoh.Sample) -> None:
        id = _device(sample)
        event = self._read(Event, sample.payload.to_bytes())
        with self._news:
            if event is None or (id not in self._events and len(self._events) >= _MOST_DEVICES):
                return
            kept = self._events.setdefault(id, deque(maxlen=_EVENTS_KEPT))
            if event not in kept:  # after a reconnection the history comes again
                kept.append(event)
                self._changed()

    def _follow(self) -> None:
        """Ask for the signal that is watched, as often as its device reports."""
        while True:
            self._ask.wait()
            self._ask.clear()
            if self._closed:
                return
            with self._news:
                watched = self._watched
            if watched is not None:
                with suppress(zenoh.ZError):
                    for reply in self._session.get("imumon/{}/signal/{}".format(*watched), timeout=2.0):
                        self._on_signal(watched, reply)

    def _on_signal(self, watched: tuple[str, str], reply: zenoh.Reply) -> None:
        signal = self._read(Signal, reply.ok.payload.to_bytes()) if reply.ok else None
        with self._news:
            if signal is not None and watched == self._watched:
                self._signal = (signal, time.monotonic())
                self._changed()


def _device(sample: zenoh.Sample) -> str:
    return str(sample.key_expr).split("/")[1]


def _reachable(endpoint: str) -> str:
    """Where to connect to for a daemon that listens on `endpoint` of this machine.

    >>> _reachable("tcp/0.0.0.0:7448"), _reachable("tls/[::]:7448")
    ('tcp/127.0.0.1:7448', 'tls/[::1]:7448')
    """
    return endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
