"""Subscriber: the client side of the bus.

It connects to all given endpoints (by default to all default ports of this machine), reconnects by itself, and keeps
the newest report of each device, its last events, which daemons are alive, and the signal of one selected channel.
Reports are stored as bytes and parsed when they are read, so a display parses those that it draws.

Any peer may publish on these keys. Messages that are invalid or too long, names that are no device names, and
reports of another device than their key are counted and ignored. A session is known by its Zenoh id, which a hostile
program can forge: this prevents mistakes, not attacks.
"""

from __future__ import annotations

import atexit
import json
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, TypeAlias, TypeVar

import zenoh
from zenoh import ext
from zenoh.handlers import RingChannel

from imumon.bus.bus_error import BusError
from imumon.bus.device_states import DeviceState
from imumon.bus.queryable import EVENTS_KEPT, MAX_QUEUED
from imumon.bus.zenoh_session import (
    local_endpoints,
    open_session,
    start_listener,
)
from imumon.config import ZenohSettings
from imumon.model.messages import EVENT_LEVELS
from imumon.model.report import Event, Report, Signal, from_json, is_device_name
from imumon.model.report_json import plain

_MAX_MESSAGE = 1_000_000  # bytes; a report of 11 channels has 72 kB, one of 64 has 0.4 MB
_MAX_EVENT = 20_000  # bytes; a text has at most 4096 characters
_MAX_QUEUED_REPORTS = 64  # reports in the queue, which bounds its bytes
GATHER_S = 0.3
"""s to wait for further daemons, or others of the same name, after the last one has answered."""
_SIGNAL_S = 3.0  # s that the reply with a signal may take
HISTORY_PERIOD_S = 30.0
"""s between two requests of the history that is shown."""

HistoryQuestion: TypeAlias = tuple[str, str, float, str]
"""Device, channel, span in s before now, and step of the rows."""
HistoryAnswer: TypeAlias = tuple[HistoryQuestion, bytes, bytes]
"""The question, and the rows and events of the reply as JSON."""

T = TypeVar("T", Report, Event, Signal)


class Subscriber:
    """Newest reports of all devices on the bus.

    Parameters
    ----------
    connect : endpoints; None: those of `settings` (`connect`, else `listen`), else the local defaults.
    settings : of ``[zenoh]``; None for the defaults.

    Attributes
    ----------
    version : grows with every valid message.
    malformed : number of invalid messages.
    """

    def __init__(
        self,
        connect: Sequence[str] | None = None,
        *,
        settings: ZenohSettings | None = None,
    ) -> None:
        settings = settings or ZenohSettings()
        self.endpoints = tuple(connect or ()) or settings.connect
        if not self.endpoints:
            self.endpoints = tuple(map(_loopback, settings.listen)) or local_endpoints()
            # daemons of this machine refuse a login that they do not ask for
            settings = replace(settings, user="", password="")
        self.version = 0
        self.malformed = 0
        self._changed = threading.Condition()
        self._devices: dict[str, DeviceState] = {}
        self._selected: tuple[str, str] | None = None
        self._signal: tuple[Signal, float] | None = None
        self._closed = False
        self._due = threading.Event()  # something is to be requested
        self._asked: HistoryQuestion | None = None
        self._answer: HistoryAnswer | None = None
        self._session = open_session(settings, (), self.endpoints, access_control=False)
        queue: RingChannel[Any] = RingChannel(MAX_QUEUED)
        alive = self._session.liveliness().declare_subscriber("imumon/*/alive", queue, history=True)
        self._threads = (
            start_listener(alive, self._on_alive),
            start_listener(self._subscribe("report", 1, _MAX_QUEUED_REPORTS), self._on_report),
            start_listener(self._subscribe("event", EVENTS_KEPT, MAX_QUEUED), self._on_event),
            threading.Thread(target=self._request, name="imumon-request", daemon=True),
        )
        self._threads[-1].start()
        atexit.register(self.close)

    def _subscribe(self, name: str, kept: int, queued: int) -> Any:
        """Subscribe to one key of all devices, with its last `kept` messages from the cache."""
        history = ext.HistoryConfig(detect_late_publishers=True, max_samples=kept)
        key = f"imumon/*/{name}"
        channel: RingChannel[Any] = RingChannel(queued)
        return ext.declare_advanced_subscriber(
            self._session, key, channel, history=history, allowed_origin=zenoh.Locality.REMOTE
        )

    def reports(self) -> dict[str, tuple[Report, float]]:
        """Return the newest report of each device by its name, with its arrival, s of the monotonic clock."""
        with self._changed:
            names = list(self._devices)
        reports = {id: self.report(id) for id in names}
        return {id: report for id, report in reports.items() if report is not None}

    def report(self, id: str) -> tuple[Report, float] | None:
        """Return the newest report of a device with its arrival, s of the monotonic clock; None: none."""
        with self._changed:
            device = self._devices.get(id)
            if device is None or device.data is None:
                return device.shown(time.monotonic()) if device is not None else None
            data, arrival, session = device.data, device.arrived_s, device.session
            device.data = None
        report = self._parse_report(id, data)
        with self._changed:
            if report is not None:
                device.report = (report, arrival)
            elif device.session == session:
                device.session = None  # another session may have valid reports
            return device.shown(time.monotonic())

    def alive(self) -> set[str]:
        """Return the names of the devices whose daemon is running; `reports` shows the age of the data."""
        with self._changed:
            return {id for id, device in self._devices.items() if device.alive}

    def events(self, id: str) -> list[Event]:
        """Return the last events of a device, newest last."""
        with self._changed:
            return list(self._devices[id].events) if id in self._devices else []

    def event_counts(self, id: str) -> dict[str, int]:
        """Return how many events of each kind have arrived of a device, also those that its daemon had kept."""
        with self._changed:
            return dict(self._devices[id].event_counts) if id in self._devices else {}

    def rivals(self) -> dict[str, tuple[str, ...]]:
        """Return the devices that several sessions publish now, with their Zenoh ids, that which is shown first."""
        with self._changed:
            rivals = {id: device.rivals(time.monotonic()) for id, device in self._devices.items()}
        return {id: sessions for id, sessions in rivals.items() if sessions}

    def watch(self, id: str, channel: str | None) -> None:
        """Select the channel whose signal is requested with every report; None: no channel."""
        with self._changed:
            selected = (id, channel) if channel else None
            if selected == self._selected:
                return
            self._selected, self._signal = selected, None
        self._due.set()

    def signal(self) -> tuple[Signal, float] | None:
        """Return the newest signal of the selected channel with its arrival, s of the monotonic clock."""
        with self._changed:
            return self._signal

    def history(self, id: str, parameters: str, name: str = "") -> bytes | None:
        """Return the reply to a question about the history of a device, JSON; None: there is no reply.

        Parameters
        ----------
        parameters : of the query, such as ``_time=[now(-2h)..now()];channel=gyro/x``.
        name : of a key below ``history``; empty: the history itself.

        Raises
        ------
        BusError : the daemon refuses the question, with the code of its error.
        """
        key = f"imumon/{id}/history{f'/{name}' if name else ''}"
        with suppress(zenoh.ZError):
            for reply in self._session.get(f"{key}?{parameters}", timeout=10.0):
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
                if reply.err is not None:
                    raise _refusal(reply.err.payload.to_bytes())
        return None

    def watch_history(self, asked: HistoryQuestion | None) -> None:
        """Choose the history that is requested now and every `HISTORY_PERIOD_S`; None: none."""
        if asked == self._asked:
            return
        self._asked = asked
        self._due.set()

    def history_answer(self) -> HistoryAnswer | None:
        """Return the newest replies with their question."""
        return self._answer

    def _request(self) -> None:
        """Request the signal of the selected channel with every report of its device, and the history now and then."""
        requested: tuple[HistoryQuestion | None, float] = None, 0.0
        while not self._closed:
            with self._changed:
                selected, asked = self._selected, self._asked
            if selected is not None:
                self._request_signal(selected)
            now = time.monotonic()
            if asked is not None and (asked != requested[0] or now - requested[1] >= HISTORY_PERIOD_S):
                requested = asked, now
                self._request_history(asked)
            self._due.wait(HISTORY_PERIOD_S)
            self._due.clear()

    def _request_signal(self, selected: tuple[str, str]) -> None:
        key = "imumon/{}/signal/{}".format(*selected)
        with suppress(zenoh.ZError):
            for reply in self._session.get(key, timeout=_SIGNAL_S):
                self._on_signal(selected, reply)

    def _request_history(self, asked: HistoryQuestion) -> None:
        id, channel, span, step = asked
        time_range = f"_time=[now(-{span:.0f}s)..now()]"
        with suppress(BusError, zenoh.ZError):
            rows = self.history(id, f"{time_range};channel={channel};step={step}")
            events = self.history(id, time_range, "event")
            with self._changed:
                self._answer = (asked, rows or b"[]", events or b"[]")
                self._notify()

    def connected(self) -> bool:
        """Return whether there is a link to any daemon or router."""
        return bool(self._session.info.transports())

    def wait_report(self, id: str | None = None, timeout: float = 2.0) -> Report | None:
        """Return the newest report of this device (None: of any); None after `timeout` seconds without one."""
        end = time.monotonic() + timeout
        while True:
            version = self.version
            with self._changed:
                names = list(self._devices) if id is None else [id]
            for name in names:
                if (newest := self.report(name)) is not None:
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
        self._due.set()
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
            self._reject()
            return None

    def _parse_report(self, id: str, data: bytes) -> Report | None:
        """Return a report of this device; None if it is invalid or of another device."""
        report = self._parse(Report, data)
        if report is not None and report.device.id != id:
            self._reject()
            return None
        return report

    def _reject(self) -> None:
        with self._changed:
            self.malformed += 1

    def _notify(self) -> None:
        self.version += 1
        self._changed.notify_all()

    def _device(self, sample: zenoh.Sample, most: int) -> tuple[str, DeviceState] | None:
        """Return the device of a message with its name; None if the message is to be ignored. Call it with the lock."""
        id, device = str(sample.key_expr).split("/")[1], None
        if is_device_name(id) and len(sample.payload) <= most:
            device = self._devices.setdefault(id, DeviceState())
        if device is None:
            self.malformed += 1
            return None
        return id, device

    def _on_alive(self, sample: zenoh.Sample) -> None:
        with self._changed:
            if (sender := self._device(sample, _MAX_EVENT)) is None:
                return
            _, device = sender
            device.alive = sample.kind != zenoh.SampleKind.DELETE
            if not device.alive:
                device.session = None  # the token of the last session of this name has ended
            self._notify()

    def _on_report(self, sample: zenoh.Sample) -> None:
        with self._changed:
            if (sender := self._device(sample, _MAX_MESSAGE)) is None:
                return
            id, device = sender
            session, clock, now = *_origin(sample), time.monotonic()
            claimed = device.session == session
            if not claimed and device.session is not None:
                device.add_rival(session, clock, now)
                if not device.silent(now):
                    return
        data = sample.payload.to_bytes()
        if not claimed and self._parse_report(id, data) is None:
            return  # only a session with valid reports may claim a device
        with self._changed:
            device.session, device.clock = session, clock
            device.data, device.arrived_s = data, now
            selected = self._selected is not None and self._selected[0] == id
            self._notify()
        if selected:
            self._due.set()

    def _on_event(self, sample: zenoh.Sample) -> None:
        with self._changed:
            if (sender := self._device(sample, _MAX_EVENT)) is None:
                return
            id, device = sender
            if device.session not in (None, _origin(sample)[0]):
                return
        event = self._parse(Event, sample.payload.to_bytes())
        with self._changed:
            if event is None:
                return
            if event.device != id:
                self.malformed += 1
            elif event not in device.events:  # a reconnection repeats the cached events
                device.events.append(event)
                if event.kind in EVENT_LEVELS:  # others could be any number
                    device.event_counts[event.kind] += 1
                self._notify()

    def _on_signal(self, selected: tuple[str, str], reply: zenoh.Reply) -> None:
        if reply.ok is None or len(reply.ok.payload) > _MAX_MESSAGE:
            return
        replier = str(reply.replier_id.zid) if reply.replier_id is not None else None
        with self._changed:
            device = self._devices.get(selected[0])
            shown = device.session if device is not None else None
        if None not in (shown, replier) and shown != replier:
            return
        signal = self._parse(Signal, reply.ok.payload.to_bytes())
        with self._changed:
            if signal is not None and signal.channel == selected[1] and selected == self._selected:
                self._signal = (signal, time.monotonic())
                self._notify()


def _origin(sample: zenoh.Sample) -> tuple[str, str]:
    """Return the ids of the session that published a message and of the clock of its timestamp, or empty texts."""
    source, timestamp = sample.source_info, sample.timestamp
    session = str(source.source_id.zid) if source is not None else ""
    return session, str(timestamp.get_id()) if timestamp is not None else ""


def _refusal(data: bytes) -> BusError:
    """Return the error that a daemon replies with."""
    try:
        error = json.loads(data)["error"]
        return BusError(plain(str(error["code"])), plain(str(error["message"])), plain(str(error["cure"])))
    except (ValueError, LookupError, TypeError):  # such as Zenoh's own, without a reply in time
        return BusError("history_failed", "the daemon did not answer the question", "ask for less at once")


def _loopback(endpoint: str) -> str:
    """Return the endpoint to connect to for a daemon of this machine that listens on `endpoint`.

    >>> _loopback("tcp/0.0.0.0:7448"), _loopback("tls/[::]:7448")
    ('tcp/127.0.0.1:7448', 'tls/[::1]:7448')
    """
    return endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
