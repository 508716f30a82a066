"""Publisher: the daemon's end of the bus.

Nothing here ever waits for a subscriber: `publish` puts the newest report into a slot and returns, a thread
of this file's own sends it, and Zenoh drops rather than blocks when a link is stuck. Events queue up,
bounded and counted. The last value of every key is kept: late subscribers get it from the cache, anybody may
also ask with a plain ``get``. Signals (histograms, spectra, strips) are large and looked at by few, so they
are sent only when asked for.
"""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import zenoh
from zenoh import ext

from imumon.bus.session import (
    LEASE_S,
    BusError,
    Options,
    check_endpoint,
    clean_id,
    local_endpoints,
    open_session,
)
from imumon.report import Event, Report, Signal, to_dict, to_json

JSON = "application/json"
BULKY = ("allan", "histogram", "spectrum")
"""Parts of a channel that its own key leaves out; the report has them."""

_EVENTS_KEPT = 100
_EVENTS_QUEUED = 1000
_CLOSE_S = 0.7  # a link that is stuck would hold `close` for seconds
_DROP = zenoh.CongestionControl.DROP


@dataclass(frozen=True, slots=True)
class Counts:
    """What the bus did: reports sent, reports replaced by a newer one before they were sent, events sent,
    events that did not fit into the queue, and messages that could not be made or sent."""

    reports: int = 0
    replaced: int = 0
    events: int = 0
    events_dropped: int = 0
    errors: int = 0


class Publisher:
    """Publishes reports and events of one device under ``imumon/{id}``.

    Parameters
    ----------
    id : name of the device; made fit for a key.
    listen, connect : endpoints; None takes those of `settings`. No endpoint to listen on: the first free of
        tcp/127.0.0.1:7448 to 7463.
    settings : `Options`, or anything with attributes of the same names; None for the defaults.

    Attributes
    ----------
    endpoints : where this session listens.
    last_error : why the last message could not be sent, None when it could.

    Raises
    ------
    BusError : an address is taken or refused, or a living daemon has this name already.
    """

    def __init__(
        self,
        id: str,
        *,
        listen: Sequence[str] | None = None,
        connect: Sequence[str] | None = None,
        settings: object | None = None,
    ) -> None:
        options = Options.of(settings)
        listen = tuple(options.listen if listen is None else listen)
        connect = tuple(options.connect if connect is None else connect)
        self.id = clean_id(id)
        self._root = f"imumon/{self.id}"
        self._session, self.endpoints = _open(options, listen, connect, self.id)
        self.last_error: str | None = None
        self._wake = threading.Condition()
        self._slot: tuple[Report, Mapping[str, Signal] | None] | None = None
        self._queue: deque[Event] = deque()
        self._closing = False
        self._reports = self._replaced = self._sent_events = self._dropped = self._errors = 0
        self._lock = threading.Lock()  # guards what a `get` reads
        self._last: dict[str, tuple[str, zenoh.Timestamp]] = {}
        self._events: deque[tuple[str, zenoh.Timestamp]] = deque(maxlen=_EVENTS_KEPT)
        self._signals: dict[str, Signal] = {}
        self._asked: dict[str, float] = {}
        self._grade: str | None = None
        self._publishers: dict[str, ext.AdvancedPublisher | zenoh.Publisher] = {
            name: ext.declare_advanced_publisher(
                self._session,
                f"{self._root}/{name}",
                encoding=JSON,
                congestion_control=_DROP,
                cache=ext.CacheConfig(kept),
                publisher_detection=True,
            )
            for name, kept in (("report", 1), ("grade", 1), ("event", _EVENTS_KEPT))
        }
        self._queryable = self._session.declare_queryable(f"{self._root}/**", self._answer)
        self._token = self._session.liveliness().declare_token(f"{self._root}/alive")
        self._thread = threading.Thread(target=self._run, name="imumon-bus", daemon=True)
        self._thread.start()

    def publish(self, report: Report, signals: Mapping[str, Signal] | None = None) -> None:
        """Hand over the newest report, and by channel what a signal view draws; returns at once."""
        with self._wake:
            self._replaced += self._slot is not None
            self._slot = (report, signals)
            self._wake.notify()

    def event(self, event: Event) -> None:
        """Hand over an event; returns at once."""
        with self._wake:
            if len(self._queue) >= _EVENTS_QUEUED:
                self._queue.popleft()
                self._dropped += 1
            self._queue.append(event)
            self._wake.notify()

    def wanted(self, within_s: float = 5.0) -> frozenset[str]:
        """Channels whose signal somebody asked for lately: only these are worth making."""
        since = time.monotonic() - within_s
        with self._lock:
            return frozenset(channel for channel, moment in self._asked.items() if moment >= since)

    @property
    def counts(self) -> Counts:
        with self._wake:
            return Counts(self._reports, self._replaced, self._sent_events, self._dropped, self._errors)

    def close(self) -> None:
        """Send what is pending and leave the bus; takes a second at most."""
        with self._wake:
            if self._closing:
                return
            self._closing = True
            self._wake.notify()
        self._thread.join(_CLOSE_S)
        leave = threading.Thread(target=self._leave, name="imumon-bus-close", daemon=True)
        leave.start()
        leave.join(_CLOSE_S)

    def _leave(self) -> None:
        self._token.undeclare()
        self._session.close()

    def __enter__(self) -> Publisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._slot or self._queue or self._closing)
                slot, self._slot = self._slot, None
                events, self._queue = self._queue, deque()
                done = self._closing and not slot and not events
            if done:
                return
            for event in events:
                self._attempt(self._send_event, event)
            if slot:
                self._attempt(self._send_report, *slot)

    def _attempt(self, send: Any, *what: Any) -> None:
        """Send; a report that cannot be sent must not end the thread that sends the next one."""
        try:
            send(*what)
            self.last_error = None
        except Exception as error:
            self.last_error = f"{type(error).__name__}: {error}"
            with self._wake:
                self._errors += 1

    def _send_event(self, event: Event) -> None:
        text, stamp = to_json(event), self._session.new_timestamp()
        with self._lock:
            self._events.append((text, stamp))
        self._publishers["event"].put(text, timestamp=stamp)
        with self._wake:
            self._sent_events += 1

    def _send_report(self, report: Report, signals: Mapping[str, Signal] | None) -> None:
        plain = to_dict(report)
        if signals is not None:
            with self._lock:
                self._signals = dict(signals)
        self._put("report", _json(plain))
        for name, channel in plain["channels"].items():
            self._put(name, _json({key: value for key, value in channel.items() if key not in BULKY}))
        grade = _json(plain["grade"])
        if grade != self._grade:
            self._put("grade", grade)
            self._grade = grade
        with self._wake:
            self._reports += 1

    def _put(self, name: str, text: str) -> None:
        publisher = self._publishers.get(name)
        if publisher is None:
            publisher = self._publishers[name] = self._session.declare_publisher(
                f"{self._root}/{name}", encoding=JSON, congestion_control=_DROP
            )
        stamp = self._session.new_timestamp()
        with self._lock:
            self._last[name] = (text, stamp)
        publisher.put(text, timestamp=stamp)

    def _answer(self, query: zenoh.Query) -> None:
        """Answer a ``get`` on any key of ours, wildcards too, with the last value."""
        with query:
            asked = query.key_expr
            with self._lock:
                values = [(f"{self._root}/{name}", *value) for name, value in self._last.items()]
                values += [(f"{self._root}/event", *value) for value in self._events]
                signals = [(f"{self._root}/signal/{name}", name, s) for name, s in self._signals.items()]
                prefix = f"{self._root}/signal/"
                if str(asked).startswith(prefix):
                    self._asked[str(asked).removeprefix(prefix)] = time.monotonic()
            try:
                for key, text, stamp in values:
                    if asked.intersects(key):
                        query.reply(key, text, encoding=JSON, timestamp=stamp)
                for key, _, signal in signals:
                    if asked.intersects(key):
                        query.reply(key, to_json(signal), encoding=JSON)
            except (zenoh.ZError, ValueError) as error:
                self.last_error = f"{type(error).__name__}: {error}"


def _json(plain: Any) -> str:
    return json.dumps(plain, allow_nan=False, ensure_ascii=False, separators=(",", ":"))


def _open(
    options: Options, listen: Sequence[str], connect: Sequence[str], id: str
) -> tuple[zenoh.Session, tuple[str, ...]]:
    """Session of a daemon and where it listens, once nobody else has its name."""
    for endpoint in connect:
        check_endpoint(endpoint)
    if listen:
        _refuse_twins(options, connect, id)
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
            _refuse_twins(options, (*taken, *connect), id)
        except BusError:
            session.close()
            raise
        return session, (endpoint,)
    raise BusError("all of tcp/127.0.0.1:7448 to 7463 are taken; choose another with --listen")


def _refuse_twins(options: Options, endpoints: Sequence[str], id: str) -> None:
    """Refuse a name that a living daemon on these endpoints has.

    One that just died may be remembered until its lease is over, so a twin is watched for longer than that.
    """
    if not endpoints:
        return
    with open_session(replace(options, mode="peer"), [], endpoints, guarded=False) as session:
        tokens: set[str] = set()

        def note(sample: zenoh.Sample) -> None:
            (tokens.add if sample.kind == zenoh.SampleKind.PUT else tokens.discard)(str(sample.key_expr))

        session.liveliness().declare_subscriber(f"imumon/{id}/alive", note, history=True)
        start = time.monotonic()
        while time.monotonic() - start < (LEASE_S + 0.5 if tokens else 0.15):
            time.sleep(0.01)
        if tokens:
            raise BusError(
                f'a daemon named "{id}" is running already; stop it or choose another name with --id'
            )
