"""Answers: the last value of every key, for those who ask with a plain ``get``.

Signals are large and made only for those who ask, so the first question for one waits for the next report.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress

import zenoh

from imumon.report import Signal, to_json

JSON = "application/json"
EVENTS_KEPT = 100
_PATIENCE_S = 3.0  # for a signal that nobody makes
_MOST_PENDING = 256


class LastValues:
    """Keeps what is published below `root`, and answers questions; for any thread."""

    def __init__(self, root: str) -> None:
        self._root = root
        self._lock = threading.Lock()
        self._last: dict[str, tuple[str, zenoh.Timestamp]] = {}
        self._events: deque[tuple[str, zenoh.Timestamp]] = deque(maxlen=EVENTS_KEPT)
        self._signals: Mapping[str, Signal] = {}
        self._asked: dict[str, float] = {}  # channel to when its signal was last asked for
        self._pending: deque[tuple[zenoh.Query, float]] = deque(maxlen=_MOST_PENDING)

    def keep(self, name: str, text: str, stamp: zenoh.Timestamp) -> None:
        """A message that was published."""
        with self._lock:
            if name == "event":
                self._events.append((text, stamp))
            else:
                self._last[name] = (text, stamp)

    def known(self) -> Iterator[tuple[str, str, zenoh.Timestamp]]:
        """Everything kept, as name, text and time."""
        with self._lock:
            last, events = dict(self._last), list(self._events)
        for name, value in last.items():
            yield name, *value
        for value in events:
            yield "event", *value

    def wanted(self, within_s: float) -> frozenset[str]:
        """Channels whose signal was asked for in the last seconds; older questions are forgotten."""
        since = time.monotonic() - within_s
        with self._lock:
            self._asked = {channel: moment for channel, moment in self._asked.items() if moment >= since}
            return frozenset(self._asked)

    def show(self, signals: Mapping[str, Signal]) -> None:
        """Newest signals; questions that waited for them are answered."""
        now = time.monotonic()
        with self._lock:
            self._signals = dict(signals)
            pending = list(self._pending)
            self._pending.clear()
            for query, since in pending:
                if not self._met(query) and now - since < _PATIENCE_S:
                    self._pending.append((query, since))
                    continue
                with suppress(zenoh.ZError):  # who asked is gone
                    self._reply_signals(query)
                query.drop()

    def answer(self, query: zenoh.Query) -> None:
        """Answer a question for any key, wildcards included."""
        for name, text, stamp in self.known():
            key = f"{self._root}/{name}"
            if query.key_expr.intersects(key):
                query.reply(key, text, encoding=JSON, timestamp=stamp)
        with self._lock:
            self._note(query)
            if self._met(query):
                self._reply_signals(query)
                query.drop()
            else:
                self._pending.append((query, time.monotonic()))

    def _note(self, query: zenoh.Query) -> None:
        """Remember whose signal is asked for; the wildcards of those who ask for everything do not count."""
        prefix, asked = f"{self._root}/signal/", str(query.key_expr)
        if "/signal/" in asked:
            named = asked.removeprefix(prefix)
            channels = [n for n in self._last if query.key_expr.intersects(prefix + n)] or [named]
            self._asked.update(dict.fromkeys(channels, time.monotonic()))

    def _met(self, query: zenoh.Query) -> bool:
        """Whether there is a signal for the question, if it is for one."""
        prefix = f"{self._root}/signal/"
        if "/signal/" not in str(query.key_expr):
            return True
        return any(query.key_expr.intersects(prefix + name) for name in self._signals)

    def _reply_signals(self, query: zenoh.Query) -> None:
        for name, signal in self._signals.items():
            key = f"{self._root}/signal/{name}"
            if query.key_expr.intersects(key):
                query.reply(key, to_json(signal), encoding=JSON)
