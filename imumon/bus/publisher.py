"""Publisher: the side of the bus on which a daemon sends.

The caller never waits for the bus: `Publisher.publish` stores the newest report and returns, a thread sends
it, and Zenoh drops messages of a congested link. Events are queued; the queue is bounded and drops the oldest.
Late subscribers get the last values from Zenoh's cache or by a ``get``. Signals (minimum and maximum per time
column) are large and rarely used, so they are sent only in reply to a ``get``.
"""

from __future__ import annotations

import atexit
import threading
from collections import defaultdict, deque
from collections.abc import Callable
from concurrent.futures import Future, wait
from functools import partial

import zenoh

from imumon.bus.bus_error import BusError, Unreachable
from imumon.bus.queryable import MAX_QUEUED, LastValues, Signals
from imumon.bus.uplink import Links, Uplink, open_local
from imumon.bus.zenoh_session import RETRY_S, check_endpoint, clean_id, open_session
from imumon.config import ZenohSettings
from imumon.model.report import Event, Report
from imumon.model.report_json import JsonWriter, joined, members, to_json

CURVES = ("allan", "histogram", "spectrum", "convergence")
"""Fields of a channel that only the report contains; the key of the channel leaves them out."""

_FIRST_ATTEMPT_S = 3.0  # s; limits the delay of the start by a router that drops packets
_CLOSE_S = 0.7  # s; limits the delay of the exit by a congested link


class ReportDocuments:
    """The JSON of each key of a report, of which is encoded again what has changed since the last one."""

    def __init__(self) -> None:
        self._writers: defaultdict[str, JsonWriter] = defaultdict(JsonWriter)  # by channel; "": of the rest

    def of(self, report: Report) -> dict[str, str]:
        """Return the documents of a report by the names of their keys."""
        rest = self._writers[""].texts({k: part for k, part in members(report).items() if k != "channels"})
        whole: list[str] = []
        documents: dict[str, str] = {}
        for name, channel in report.channels.items():
            texts = self._writers[name].texts(channel)
            whole.append(f"{to_json(name)}:{joined(texts.values())}")
            documents[name] = joined([text for key, text in texts.items() if key not in CURVES])
        channels = f'"channels":{joined(whole)}'
        return {"report": joined([*rest.values(), channels]), **documents, "grade": to_json(report.grade)}


class Publisher:
    """Publishes reports and events of one device under ``imumon/{id}``.

    Parameters
    ----------
    id : name of the device; `clean_id` converts it for keys.
    settings : of ``[zenoh]``; None for the defaults. The daemon listens on its endpoints `listen`, without any on the
        first free of tcp/127.0.0.1:7448 to 7463, and connects to routers, which may be absent, with `connect`.

    Attributes
    ----------
    endpoints : where this session listens.

    Raises
    ------
    BusError : an endpoint cannot be used.
    """

    def __init__(self, id: str, settings: ZenohSettings | None = None) -> None:
        settings = settings or ZenohSettings()
        self.id = clean_id(id)
        self._root = f"imumon/{self.id}"
        for endpoint in settings.connect:
            check_endpoint(endpoint)
        self._changed = threading.Condition()  # of the next three fields
        self._newest: tuple[Report, Signals] | None = None
        self._events: deque[Event] = deque(maxlen=MAX_QUEUED)
        self._last_error: str | None = None
        self._last_grade: str | None = None  # of the thread, as is the next
        self._documents = ReportDocuments()
        self._closing = threading.Event()
        self._reported_uplinks: dict[str, str | None] = {}
        self._reported_error: str | None = None
        self._session, self.endpoints = open_local(settings)
        self._last_values = LastValues(self._root)
        self._timestamp = self._session.new_timestamp
        self._links = Links(Uplink(self._session, self._root, self._reply), self._last_values)
        self._thread = threading.Thread(target=self._run, name="imumon-bus", daemon=True)
        self._thread.start()
        atexit.register(self.close)
        self._connect(settings)

    def _connect(self, settings: ZenohSettings) -> None:
        """Start to connect to routers; unreachable ones are tried until the publisher closes."""
        attempts: list[Future[None]] = []
        for endpoint in settings.connect:
            attempts.append(Future())
            run = partial(self._connect_uplink, settings, endpoint, attempts[-1])
            threading.Thread(target=run, name="imumon-uplink", daemon=True).start()
        try:
            for attempt in wait(attempts, _FIRST_ATTEMPT_S).done:
                attempt.result()
        except BusError:
            self.close()
            raise

    def publish(self, report: Report, signals: Signals | None = None) -> None:
        """Send the newest report, and reply with the signals of channels from now on; return at once."""
        with self._changed:
            self._newest = (report, signals or {})
            self._changed.notify()

    def answer_history(self, answer: Callable[[str, str], str]) -> None:
        """Reply to queries for ``history`` and the keys below it.

        Parameters
        ----------
        answer : from the name below ``history`` and the parameters of a query to JSON, or an `ImumonError`.
        """
        self._last_values.answer_history = answer

    def event(self, event: Event) -> None:
        """Send an event; return at once."""
        with self._changed:
            self._events.append(event)
            self._changed.notify()

    @property
    def last_error(self) -> str | None:
        """Why the last message could not be sent; None if it was sent."""
        with self._changed:
            return self._last_error

    def uplink_errors(self) -> dict[str, str | None]:
        """Return why there is no connection to a router, by its endpoint; None: there is one."""
        return self._links.errors()

    def status_changes(self) -> list[tuple[str, bool]]:
        """Return messages, and whether each ends a trouble: changed connections to routers, new send errors."""
        messages, uplinks = [], self.uplink_errors()
        for endpoint, error in uplinks.items():
            if error != self._reported_uplinks.get(endpoint):
                messages.append((error or f"{endpoint}: connected", error is None))
        self._reported_uplinks = uplinks
        reason = self.last_error
        if reason not in (None, self._reported_error):
            self._reported_error = reason
            messages.append((f"a message could not be published: {reason}", False))
        return messages

    def close(self) -> None:
        """Send what is queued and close the sessions, within 1.4 s."""
        with self._changed:
            if self._closing.is_set():
                return
            self._closing.set()
            self._changed.notify()
        atexit.unregister(self.close)
        self._thread.join(_CLOSE_S)
        closing = threading.Thread(target=self._close_links, name="imumon-bus-close", daemon=True)
        closing.start()
        closing.join(_CLOSE_S)

    def _close_links(self) -> None:
        self._links.close()
        self._last_values.close()

    def __enter__(self) -> Publisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        """Send what is queued until the publisher closes and the queue is empty."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._newest or self._events or self._closing.is_set())
                newest, self._newest = self._newest, None
                events = list(self._events)
                self._events.clear()
                if self._closing.is_set() and not newest and not events:
                    return
            for event in events:
                self._attempt(partial(self._send_event, event))
            if newest:
                self._attempt(partial(self._send_report, *newest))

    def _attempt(self, send: Callable[[], None]) -> None:
        """Send; a message that cannot be sent must not end the thread."""
        failure = None
        try:
            send()
        except Exception as error:
            failure = f"{type(error).__name__}: {error}"
        with self._changed:
            self._last_error = failure

    def _send_event(self, event: Event) -> None:
        self._put("event", to_json(event))

    def _send_report(self, report: Report, signals: Signals) -> None:
        texts = self._documents.of(report)
        grade = texts.pop("grade")
        self._last_values.set_signals(signals)
        for name, text in texts.items():
            self._put(name, text)
        if grade != self._last_grade:
            self._put("grade", grade)
            self._last_grade = grade

    def _put(self, name: str, text: str) -> None:
        self._links.put(name, text, self._timestamp())

    def _connect_uplink(self, settings: ZenohSettings, endpoint: str, first: Future[None]) -> None:
        """Connect to a router as soon as it is reachable. Zenoh itself restores a lost connection."""
        while not self._closing.is_set():
            try:
                session = open_session(settings, (), [endpoint], access_control=True, client=True)
            except BusError as error:
                self._links.failed(endpoint, error)
                if not first.done() and not isinstance(error, Unreachable):
                    first.set_exception(error)
                    return
                if not first.done():
                    first.set_result(None)
                self._closing.wait(RETRY_S)
            else:
                self._links.add(endpoint, Uplink(session, self._root, self._reply))
                if not first.done():
                    first.set_result(None)
                return

    def _reply(self, query: zenoh.Query) -> None:
        """Reply to a query; one that fails must not end the thread."""
        try:
            self._last_values.reply(query)
        except Exception as error:
            with self._changed:
                self._last_error = f"{type(error).__name__}: {error}"
