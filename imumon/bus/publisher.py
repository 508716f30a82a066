"""Publisher: the daemon's end of the bus.

Nothing here ever waits for a subscriber: `publish` puts the newest report into a slot and returns, a thread
of this file's own sends it, and Zenoh drops rather than blocks when a link is stuck. Events queue up,
bounded and counted. The last value of every key is kept: late subscribers get it from the cache, anybody may
also ask with a plain ``get``. Signals (strips, for drawing) are large and looked at by few, so they are sent
only when asked for.
"""

from __future__ import annotations

import atexit
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import Any

import zenoh

from imumon.bus.queryable import LastValues
from imumon.bus.texts import Texts
from imumon.bus.uplink import Uplink, open_local, open_uplink
from imumon.bus.zenoh_session import (
    RETRY_S,
    BusError,
    SessionOptions,
    Unreachable,
    check_endpoint,
    clean_id,
)
from imumon.report import Event, Report, Signal, to_json

_EVENTS_QUEUED = 1000
_FIRST_ATTEMPT_S = 3.0  # a router that drops packets must not hold up the start for longer
_REASONS = 20  # that are told
_CLOSE_S = 0.7  # a link that is stuck would hold `close` for seconds


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
    listen : endpoints; none: the first free of tcp/127.0.0.1:7448 to 7463; None: those of `settings`.
    connect : endpoints of routers, which may come and go; None: those of `settings`.
    settings : `SessionOptions`, or anything with attributes of the same names; None for the defaults.

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
        options = SessionOptions.of(settings)
        listen = tuple(options.listen if listen is None else listen)
        connect = tuple(options.connect if connect is None else connect)
        self.id = clean_id(id)
        self._root = f"imumon/{self.id}"
        self.last_error: str | None = None
        for endpoint in connect:
            check_endpoint(endpoint)
        self._wake = threading.Condition()
        self._slot: tuple[Report, Mapping[str, Signal] | None] | None = None
        self._queue: deque[Event] = deque()
        self._closing = False
        self._reports = self._replaced = self._sent_events = self._dropped = self._errors = 0
        self._answers = LastValues(self._root)
        self._texts = Texts()
        self._grade: str | None = None
        self._over = threading.Event()
        self._faults: dict[str, str] = {}
        self._uplinks: dict[str, Uplink] = {}
        self._told: dict[str, str | None] = {}  # of the connections
        self._unsent: set[str] = set()  # reasons that were told
        router = options.mode == "router"  # routers find their way among one another in one session
        self._session, self.endpoints = open_local(options, listen, connect if router else (), self.id)
        self._stamp = self._session.new_timestamp
        self._sending = threading.Lock()  # a link that is added gets everything, each message once
        self._links = [Uplink(self._session, self._root, self._answer)]
        self._thread = threading.Thread(target=self._run, name="imumon-bus", daemon=True)
        self._thread.start()
        atexit.register(self.close)
        self._connect(options, () if router else connect)

    def _connect(self, options: SessionOptions, endpoints: Sequence[str]) -> None:
        """Connect to routers; those that are not there now are tried again for ever."""
        attempts: list[Future[None]] = []
        for endpoint in endpoints:
            attempts.append(Future())
            words = (options, endpoint, attempts[-1])
            threading.Thread(target=self._link_up, args=words, name="imumon-uplink", daemon=True).start()
        try:
            for attempt in wait(attempts, _FIRST_ATTEMPT_S).done:
                attempt.result()
        except BusError:
            self.close()
            raise

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
        return self._answers.wanted(within_s)

    @property
    def counts(self) -> Counts:
        with self._wake:
            return Counts(self._reports, self._replaced, self._sent_events, self._dropped, self._errors)

    def uplinks(self) -> dict[str, str | None]:
        """Why there is no connection to a router, by its endpoint; None where there is one."""
        lost = {
            endpoint: None if link.session.info.transports() else f"{endpoint}: connection lost; trying again"
            for endpoint, link in dict(self._uplinks).items()  # a thread adds to it
        }
        return {**self._faults, **lost}

    def troubles(self) -> list[str]:
        """What has become of the connections to routers, once per change, and why something could not be
        sent, each reason once."""
        said, uplinks = [], self.uplinks()
        for endpoint, why in uplinks.items():
            if why != self._told.get(endpoint):
                said.append(why or f"{endpoint}: connected")
        self._told = uplinks
        error = self.last_error
        if error is not None and error not in self._unsent and len(self._unsent) < _REASONS:
            self._unsent.add(error)
            said.append(f"something could not be published: {error}")
        return said

    def close(self) -> None:
        """Send what is pending and leave the bus; takes 1.4 s at most."""
        with self._wake:
            if self._closing:
                return
            self._closing = True
            self._wake.notify()
        self._over.set()
        atexit.unregister(self.close)
        self._thread.join(_CLOSE_S)
        leave = threading.Thread(target=self._leave, name="imumon-bus-close", daemon=True)
        leave.start()
        leave.join(_CLOSE_S)

    def _leave(self) -> None:
        with self._sending:
            links, self._links = self._links, []
        for link in links:  # all of them before the first that is stuck
            link.say_goodbye()
        for link in links:
            link.close()

    def __enter__(self) -> Publisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        while self._send_next():
            pass

    def _send_next(self) -> bool:
        """Wait for something to send and send it, and hold it no longer; False when all is sent and over."""
        with self._wake:
            self._wake.wait_for(lambda: self._slot or self._queue or self._closing)
            slot, self._slot = self._slot, None
            events, self._queue = self._queue, deque()
            if self._closing and not slot and not events:
                return False
        for event in events:
            self._attempt(self._send_event, event)
        if slot:
            self._attempt(self._send_report, *slot)
        return True

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
        self._put("event", to_json(event))
        with self._wake:
            self._sent_events += 1

    def _send_report(self, report: Report, signals: Mapping[str, Signal] | None) -> None:
        self._texts.write(report)
        self._answers.show(signals or {})
        self._put("report", self._texts.report)
        for name, text in self._texts.channels.items():
            self._put(name, text)
        grade = to_json(report.grade)
        if grade != self._grade:
            self._put("grade", grade)
            self._grade = grade
        with self._wake:
            self._reports += 1

    def _put(self, name: str, text: str) -> None:
        stamp = self._stamp()
        with self._sending:
            self._answers.keep(name, text, stamp)
            for link in self._links:
                link.put(name, text, stamp)

    def _link_up(self, options: SessionOptions, endpoint: str, first: Future[None]) -> None:
        """Connect to a router as soon as it is there; lost again, Zenoh comes back by itself."""
        while not self._over.is_set():
            try:
                session = open_uplink(options, endpoint, self.id)
            except BusError as error:
                self._faults[endpoint] = str(error)
                if not first.done() and not isinstance(error, Unreachable):
                    first.set_exception(error)
                    return
            else:
                self._add(endpoint, Uplink(session, self._root, self._answer))
            if not first.done():
                first.set_result(None)
            if endpoint in self._uplinks:
                return
            self._over.wait(RETRY_S)

    def _add(self, endpoint: str, link: Uplink) -> None:
        """Take a link in; what was published before is known there too."""
        with self._sending:
            for name, text, stamp in self._answers.known():
                link.put(name, text, stamp)
            self._uplinks[endpoint] = link
            if self._over.is_set():
                link.close()
            else:
                self._links.append(link)

    def _answer(self, query: zenoh.Query) -> None:
        try:
            self._answers.answer(query)
        except Exception as error:  # a question must not end the thread that answers the next one
            self.last_error = f"{type(error).__name__}: {error}"
