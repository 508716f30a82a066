"""Last value of every key of a device, as the reply to a ``get``.

Signals are large, so their text is made for a query only. A thread of its own replies to queries for the history: it
is read from the disk, and a querier may ask for replies that wait for its congested link.
"""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from queue import Full, Queue
from typing import TypeAlias

import zenoh

from imumon.bus.zenoh_session import start_listener
from imumon.model.errors import ImumonError
from imumon.model.report import Signal
from imumon.model.report_json import to_json

JSON = "application/json"
EVENTS_KEPT = 100
"""Events that are replied to a ``get`` and cached for advanced subscribers."""

MOST_QUERIES = 16
"""Queries that wait for their reply; one that does not fit gets none."""
MAX_QUEUED = 1024  # events, or tokens, in a queue; the oldest is dropped
_CLOSE_S = 0.2  # s; limits the delay of the exit by a reply that blocks

Signals: TypeAlias = Mapping[str, Callable[[], Signal]]
"""What makes the signal of each channel."""


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
        self._signals: Signals = {}  # of the newest report
        self.answer_history: Callable[[str, str], str] | None = None
        self._due: Queue[Callable[[], None] | None] = Queue(MOST_QUERIES)
        self._replier = start_listener(iter(self._due.get, None), self._reply_due)

    def store(self, name: str, text: str, timestamp: zenoh.Timestamp) -> None:
        """Store a message that is being published under `name`."""
        with self._lock:
            if name == "event":
                self._events.append((text, timestamp))
            else:
                self._last[name] = (text, timestamp)

    def set_signals(self, signals: Signals) -> None:
        """Store what makes the signals of the newest report."""
        with self._lock:
            self._signals = signals

    def messages(self) -> Iterator[tuple[str, str, zenoh.Timestamp]]:
        """Yield name, text and timestamp of every stored message."""
        with self._lock:
            last, events = dict(self._last), list(self._events)
        for name, value in last.items():
            yield name, *value
        for value in events:
            yield "event", *value

    def reply(self, query: zenoh.Query) -> None:
        """Reply to a query for any key, also with wildcards."""
        for name, text, timestamp in self.messages():
            key = f"{self._root}/{name}"
            if query.key_expr.intersects(key):
                query.reply(key, text, encoding=JSON, timestamp=timestamp)
        if (below := self._history_name(query)) is not None:
            with suppress(Full):
                self._due.put_nowait(partial(self._reply_history, query, below))
                return
        with self._lock:
            signals = self._signals
        self._reply_signals(query, signals)

    def close(self) -> None:
        """End the thread that replies; the sessions are closed by then, so it waits for no link."""
        with suppress(Full):
            self._due.put(None, timeout=_CLOSE_S)
        self._replier.join(_CLOSE_S)

    def _history_name(self, query: zenoh.Query) -> str | None:
        """Return the key below ``history`` that a query asks for, empty for itself; a wildcard for all is no query."""
        if self.answer_history is None:
            return None
        name = str(query.key_expr).partition("/history")[2]
        asked = "/history" in str(query.key_expr) and "*" not in name
        return name.removeprefix("/") if asked else None

    def _reply_due(self, reply: Callable[[], None]) -> None:
        with suppress(zenoh.ZError):  # the querier may have gone
            reply()

    def _reply_signals(self, query: zenoh.Query, signals: Signals) -> None:
        for name, signal in signals.items():
            key = f"{self._root}/signal/{name}"
            if query.key_expr.intersects(key):
                query.reply(key, to_json(signal()), encoding=JSON)
        query.drop()

    def _reply_history(self, query: zenoh.Query, name: str) -> None:
        assert self.answer_history is not None
        try:
            text = self.answer_history(name, str(query.parameters))
            query.reply(f"{self._root}/history{f'/{name}' if name else ''}", text, encoding=JSON)
        except Exception as error:  # no query may end the thread
            other = ImumonError("history_failed", str(error), "see the log of the daemon")
            known = error if isinstance(error, ImumonError) else other
            described = {"code": known.code, "message": known.message, "cure": known.cure}
            query.reply_err(json.dumps({"error": described}), encoding=JSON)
        finally:
            query.drop()
