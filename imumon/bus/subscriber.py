"""Subscriber: the client side of the bus.

It connects to all given endpoints (by default to all default ports of this machine), reconnects by itself,
and keeps the newest report of each device, its last events, which daemons are alive, and the signal of one
selected channel. Reports are stored as bytes and parsed when they are read, so a display that reads twice a
second parses twice a second. Any peer may publish on these keys: messages that are invalid are counted and
ignored, and the number of devices is bounded.
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

from imumon.bus.zenoh_session import SessionOptions, local_endpoints, open_session, start_listener
from imumon.report import Event, Report, Signal, from_json

_MAX_EVENTS = 100  # events of a device. Not critical
_MAX_DEVICES = 1000  # devices; bounds the memory that invented names can take. Not critical
_MAX_QUEUED = 1024  # messages in a queue; the oldest is dropped. Not critical
_SIGNAL_TIMEOUT_S = 2.0  # s; time to wait for the reply with a signal. Not critical

T = TypeVar("T", Report, Event, Signal)


class Subscriber:
    """Newest reports of all devices on the bus.

    Parameters
    ----------
    connect : endpoints; None: those of `settings` (`connect`, else `listen`), else the local defaults.
    settings : `SessionOptions`, or an object with attributes of the same names; None for the defaults.

    Attributes
    ----------
    version : grows with every valid message.
    malformed : number of invalid messages.
    """

    def __init__(self, connect: Sequence[str] | None = None, *, settings: object | None = None) -> None:
        options = SessionOptions.of(settings)
        options = replace(options, mode="peer", users_file="")
        configured = tuple(connect or ()) or options.connect or tuple(map(_loopback, options.listen))
        self.endpoints = configured or local_endpoints()
        self.version = 0
        self.malformed = 0
        self._changed = threading.Condition()
        self._unread: dict[str, tuple[bytes, float]] = {}  # not yet parsed
        self._reports: dict[str, tuple[Report, float]] = {}
        self._alive: set[str] = set()
        self._events: dict[str, deque[Event]] = {}
        self._selected: tuple[str, str] | None = None
        self._signal: tuple[Signal, float] | None = None
        self._closed = False
        self._signal_due = threading.Event()
        self._session = open_session(options, (), self.endpoints, access_control=False)
        queue: RingChannel[Any] = RingChannel(_MAX_QUEUED)
        alive = self._session.liveliness().declare_subscriber("imumon/*/alive", queue, history=True)
        self._threads = (
            start_listener(alive, self._on_alive),
            start_listener(self._subscribe("report", 1), self._on_report),
            start_listener(self._subscribe("event", _MAX_EVENTS), self._on_event),
            threading.Thread(target=self._request_signals, name="imumon-signal", daemon=True),
        )
        self._threads[-1].start()
        atexit.register(self.close)

    def _subscribe(self, name: str, kept: int) -> Any:
        """Subscribe to one key of all devices, with its last `kept` messages from the cache."""
        history = ext.HistoryConfig(detect_late_publishers=True, max_samples=kept)
        key = f"imumon/*/{name}"
        channel: RingChannel[Any] = RingChannel(_MAX_QUEUED)
        return ext.declare_advanced_subscriber(
            self._session, key, channel, history=history, allowed_origin=zenoh.Locality.REMOTE
        )

    def reports(self) -> dict[str, tuple[Report, float]]:
        """Return the newest report of each device by its name, with its arrival, s of the monotonic clock."""
        with self._changed:
            unread, self._unread = self._unread, {}
        parsed = {id: (self._parse(Report, data), arrival) for id, (data, arrival) in unread.items()}
        with self._changed:
            self._reports |= {id: (report, at) for id, (report, at) in parsed.items() if report is not None}
            return dict(self._reports)

    def alive(self) -> set[str]:
        """Return the names of the devices whose daemon is running; `reports` shows the age of the data."""
        with self._changed:
            return set(self._alive)

    def events(self, id: str) -> list[Event]:
        """Return the last events of a device, newest last."""
        with self._changed:
            return list(self._events.get(id, ()))

    def watch(self, id: str, channel: str | None) -> None:
        """Select the channel whose signal is requested with every report; None: no channel."""
        with self._changed:
            selected = (id, channel) if channel else None
            if selected == self._selected:
                return
            self._selected, self._signal = selected, None
        self._signal_due.set()

    def signal(self) -> tuple[Signal, float] | None:
        """Return the newest signal of the selected channel with its arrival, s of the monotonic clock."""
        with self._changed:
            return self._signal

    def connected(self) -> bool:
        """Return whether there is a link to any daemon or router."""
        return bool(self._session.info.transports())

    def wait_report(self, id: str | None = None, timeout: float = 2.0) -> Report | None:
        """Return the newest report of this device (None: of any); None after `timeout` seconds without one."""
        end = time.monotonic() + timeout
        while True:
            version, reports = self.version, self.reports()
            newest = next(iter(reports.values()), None) if id is None else reports.get(id)
            if newest:
                return newest[0]
            remaining = end - time.monotonic()
            if remaining <= 0:
                return None
            with self._changed:
                if self.version == version:
                    self._changed.wait(remaining)

    def close(self) -> None:
        atexit.unregister(self.close)
        self._closed = True
        self._signal_due.set()
        self._session.close()
        for thread in self._threads:
            thread.join(1.0)

    def __enter__(self) -> Subscriber:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _parse(self, cls: type[T], data: bytes) -> T | None:
        try:
            return from_json(cls, data)
        except ValueError:
            with self._changed:
                self.malformed += 1
            return None

    def _notify(self) -> None:
        self.version += 1
        self._changed.notify_all()

    def _on_alive(self, sample: zenoh.Sample) -> None:
        id = _device(sample)
        with self._changed:
            if sample.kind == zenoh.SampleKind.DELETE:
                self._alive.discard(id)
            elif len(self._alive) < _MAX_DEVICES:
                self._alive.add(id)
            self._notify()

    def _on_report(self, sample: zenoh.Sample) -> None:
        id = _device(sample)
        with self._changed:
            known = self._reports.keys() | self._unread.keys()
            if id not in known and len(known) >= _MAX_DEVICES:
                return
            self._unread[id] = (sample.payload.to_bytes(), time.monotonic())
            selected = self._selected is not None and self._selected[0] == id
            self._notify()
        if selected:
            self._signal_due.set()

    def _on_event(self, sample: zenoh.Sample) -> None:
        id = _device(sample)
        event = self._parse(Event, sample.payload.to_bytes())
        with self._changed:
            if event is None or (id not in self._events and len(self._events) >= _MAX_DEVICES):
                return
            kept = self._events.setdefault(id, deque(maxlen=_MAX_EVENTS))
            if event not in kept:  # a reconnection repeats the cached events
                kept.append(event)
                self._notify()

    def _request_signals(self) -> None:
        """Request the signal of the selected channel whenever its device publishes a report."""
        while True:
            self._signal_due.wait()
            self._signal_due.clear()
            if self._closed:
                return
            with self._changed:
                selected = self._selected
            if selected is not None:
                key = "imumon/{}/signal/{}".format(*selected)
                with suppress(zenoh.ZError):
                    for reply in self._session.get(key, timeout=_SIGNAL_TIMEOUT_S):
                        self._on_signal(selected, reply)

    def _on_signal(self, selected: tuple[str, str], reply: zenoh.Reply) -> None:
        signal = self._parse(Signal, reply.ok.payload.to_bytes()) if reply.ok else None
        with self._changed:
            if signal is not None and selected == self._selected:
                self._signal = (signal, time.monotonic())
                self._notify()


def _device(sample: zenoh.Sample) -> str:
    """Return the name of the device in a key."""
    return str(sample.key_expr).split("/")[1]


def _loopback(endpoint: str) -> str:
    """Return the endpoint to connect to for a daemon of this machine that listens on `endpoint`.

    >>> _loopback("tcp/0.0.0.0:7448"), _loopback("tls/[::]:7448")
    ('tcp/127.0.0.1:7448', 'tls/[::1]:7448')
    """
    return endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
