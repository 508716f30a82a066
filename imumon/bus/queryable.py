"""Last value of every key of a device, as the reply to a ``get``.

Signals are large, so the publisher computes only those that were requested lately: the first query for one
waits for the next report. A thread of its own replies to the queries that waited, and to those for the history: a
querier may ask for replies that wait for its congested link, and the history is read from the disk.
"""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from queue import Full, Queue

import zenoh

from imumon.bus.zenoh_session import start_listener
from imumon.errors import ImumonError
from imumon.report import Signal, to_json

JSON = "application/json"
EVENTS_KEPT = 100
"""Events that are replied to a ``get`` and cached for advanced subscribers."""

SIGNAL_S = 3.0
"""s after which a query for a signal that is not published gets no reply."""
_MAX_PENDING = 32  # queries that wait for a signal; the oldest gets no reply
_CLOSE_S = 0.2  # s; limits the delay of the exit by a reply that blocks
_MAX_SELECTOR = 1024  # characters of a key with parameters; a query with more is not replied to
_MAX_NAME = 64  # characters of a channel that no report had yet; a longer one is not requested


class LastValues:
    """Stores the last message of each key below `root` and replies to queries. Thread-safe.

    Attributes
    ----------
    answer_history : from the name of a key below ``history`` and the parameters of a query to JSON; None: there
        is no history.
    """

    def __init__(self, root: str) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._last: dict[str, tuple[str, zenoh.Timestamp]] = {}
        self._events: deque[tuple[str, zenoh.Timestamp]] = deque(maxlen=EVENTS_KEPT)
        self._signals: Mapping[str, Signal] = {}
        self._requests: dict[str, float] = {}  # monotonic time of the last query for its signal, by channel
        self._pending: deque[tuple[zenoh.Query, float]] = deque(maxlen=_MAX_PENDING)
        self.answer_history: Callable[[str, str], str] | None = None
        self._due: Queue[Callable[[], None] | None] = Queue(_MAX_PENDING)
        self._replier = start_listener(iter(self._due.get, None), self._reply_due)

    def store(self, name: str, text: str, timestamp: zenoh.Timestamp) -> None:
        """Store a message that is being published under `name`."""
        with self._lock:
            if name == "event":
                self._events.append((text, timestamp))
            else:
                self._last[name] = (text, timestamp)

    def messages(self) -> Iterator[tuple[str, str, zenoh.Timestamp]]:
        """Yield name, text and timestamp of every stored message."""
        with self._lock:
            last, events = dict(self._last), list(self._events)
        for name, value in last.items():
            yield name, *value
        for value in events:
            yield "event", *value

    def requested_signals(self, within_s: float) -> frozenset[str]:
        """Return the channels whose signal was requested in the last `within_s` seconds; drop the others."""
        since = time.monotonic() - within_s
        with self._lock:
            self._requests = {channel: at for channel, at in self._requests.items() if at >= since}
            return frozenset(self._requests)

    def set_signals(self, signals: Mapping[str, Signal]) -> None:
        """Store the newest signals and reply to the queries that wait for them."""
        now = time.monotonic()
        with self._lock:
            self._signals = dict(signals)
            waiting = list(self._pending)
            self._pending.clear()
            for query, since in waiting:
                if self._has_signal(query) or now - since >= SIGNAL_S:
                    with suppress(Full):
                        self._due.put_nowait(partial(self._reply_signals, query))
                else:
                    self._pending.append((query, since))

    def reply(self, query: zenoh.Query) -> None:
        """Reply to a query for any key, also with wildcards; drop one with data, which would be kept while it waits."""
        data = query.payload is not None or query.attachment is not None
        if data or len(str(query.selector)) > _MAX_SELECTOR:
            query.drop()
            return
        for name, text, timestamp in self.messages():
            key = f"{self._root}/{name}"
            if query.key_expr.intersects(key):
                query.reply(key, text, encoding=JSON, timestamp=timestamp)
        if (below := self._history_name(query)) is not None:
            try:
                self._due.put_nowait(partial(self._reply_history, query, below))
            except Full:
                query.drop()
            return
        with self._lock:
            self._record_request(query)
            if not self._has_signal(query):
                self._pending.append((query, time.monotonic()))
                return
        self._reply_signals(query)

    def close(self) -> None:
        """End the thread that replies; the sessions are closed by then, so it waits for no link."""
        with suppress(Full):
            self._due.put(None, timeout=_CLOSE_S)
        self._replier.join(_CLOSE_S)

    def _record_request(self, query: zenoh.Query) -> None:
        """Record the channels whose signal is requested; a wildcard for all keys is no request."""
        prefix, expression = f"{self._root}/signal/", str(query.key_expr)
        if "/signal/" in expression:
            name = expression.removeprefix(prefix)
            channels = [n for n in self._last if query.key_expr.intersects(prefix + n)]
            if not channels and len(name) <= _MAX_NAME and len(self._requests) < _MAX_PENDING:
                channels = [name]  # no report had it yet; anyone may write any name, so these are bounded
            self._requests.update(dict.fromkeys(channels, time.monotonic()))

    def _has_signal(self, query: zenoh.Query) -> bool:
        """Return whether a query for a signal can be replied to now; True for any other query."""
        prefix, is_signal = f"{self._root}/signal/", "/signal/" in str(query.key_expr)
        return not is_signal or any(query.key_expr.intersects(prefix + name) for name in self._signals)

    def _reply_due(self, reply: Callable[[], None]) -> None:
        with suppress(zenoh.ZError):  # the querier may have gone
            reply()

    def _history_name(self, query: zenoh.Query) -> str | None:
        """Return the key below ``history`` that a query asks for, empty for itself; a wildcard for all is no query."""
        if self.answer_history is None:
            return None
        name = str(query.key_expr).partition("/history")[2]
        asked = "/history" in str(query.key_expr) and "*" not in name
        return name.removeprefix("/") if asked else None

    def _reply_history(self, query: zenoh.Query, name: str) -> None:
        assert self.answer_history is not None
        try:
            text = self.answer_history(name, str(query.parameters))
            query.reply(f"{self._root}/history{f'/{name}' if name else ''}", text, encoding=JSON)
        except ImumonError as error:
            described = {"code": error.code, "message": error.message, "cure": error.cure}
            query.reply_err(json.dumps({"error": described}), encoding=JSON)
        except Exception as error:  # no query may end the thread
            described = {"code": "history_failed", "message": str(error), "cure": "see the log of the daemon"}
            query.reply_err(json.dumps({"error": described}), encoding=JSON)
        finally:
            query.drop()

    def _reply_signals(self, query: zenoh.Query) -> None:
        """Send the signals. The lock is free: a congested link may block, and the publisher must not wait for it."""
        with self._lock:
            signals = self._signals
        for name, signal in signals.items():
            key = f"{self._root}/signal/{name}"
            if query.key_expr.intersects(key):
                query.reply(key, to_json(signal), encoding=JSON)
        query.drop()
