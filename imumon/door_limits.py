"""Limits of a door: of whatever accepts connections from programs that imumon does not know.

A door without limits belongs to whoever opens most connections: descriptors, threads and processor time go to them,
and a daemon cannot save its state any more. Two rules keep a door open for others:

- A connection has a deadline for its whole request, from its acceptance to the end of the reply. A time limit of each
  read would not do: a client that sends a byte every second never exceeds it.
- The number of connections is bounded. A further one closes the *oldest*, not itself: a client that works ends within
  milliseconds, so that the oldest one hangs. If new ones were refused, the first to fill the door would keep
  all others out.

Time is an argument, and closing is a function that is given: the same rules serve threads and coroutines.
"""

from __future__ import annotations

import resource
import threading
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

RESERVED_FILES = 160
"""Descriptors that no door takes: 100 sessions of Zenoh, and those of port, state, history, recording and libraries."""
SHARE_OF_FILES = 4
"""A door takes this part of the other descriptors at most: there are two, and others may open more."""

LINE_BYTES = 256
"""Bytes of a line that is read from a network: one of a clock and nine channels in full precision has fewer."""

Connection = TypeVar("Connection", bound=Hashable)


class OpenConnections(Generic[Connection]):
    """The connections of one door.

    Parameters
    ----------
    most : connections at once.
    request_s : time that a whole request may take, s.
    close : closes a connection at once, also while another thread reads from it or writes to it. It may be called
        for one that is closed already.

    Attributes
    ----------
    closed : connections that were too old or too many.

    >>> door = OpenConnections(2, 5.0, print)
    >>> for number, now in enumerate((0.0, 1.0, 2.0)):
    ...     door.add(f"connection {number}", now)
    connection 0
    >>> door.expire(6.5)
    connection 1
    >>> len(door), door.closed
    (1, 2)
    """

    def __init__(self, most: int, request_s: float, close: Callable[[Connection], object]) -> None:
        self._most, self._request_s, self._close = most, request_s, close
        self._deadlines: dict[Connection, float] = {}  # the oldest first
        self._lock = threading.Lock()
        self.closed = 0

    def __len__(self) -> int:
        return len(self._deadlines)

    def add(self, connection: Connection, now: float) -> None:
        """Admit a connection at `now` (s); the oldest one is closed if there are too many."""
        with self._lock:
            self._deadlines[connection] = now + self._request_s
            excess = list(self._deadlines)[: max(0, len(self._deadlines) - self._most)]
        self._end(excess)

    def discard(self, connection: Connection) -> None:
        """Forget a connection that has ended, or that has no deadline any more."""
        with self._lock:
            self._deadlines.pop(connection, None)

    def expire(self, now: float) -> None:
        """Close the connections whose deadline is over."""
        with self._lock:
            late = [connection for connection, end in self._deadlines.items() if end <= now]
        self._end(late)

    def close_all(self) -> None:
        """Close all connections, at the end of the door."""
        with self._lock:
            rest = list(self._deadlines)
            self._deadlines.clear()
        for connection in rest:
            self._close(connection)

    def _end(self, connections: list[Connection]) -> None:
        for connection in connections:
            self.discard(connection)
            self.closed += 1
            self._close(connection)


class Pace:
    """The rate at which a door takes what comes: the rest waits in the kernel, where it costs nothing.

    Parameters
    ----------
    rate_hz : connections, or lines, per second.
    burst : those that may come at once.

    >>> pace = Pace(10.0, burst=2)
    >>> [round(pace.wait_s(0.0), 2) for _ in range(4)]
    [0.0, 0.0, 0.1, 0.2]
    """

    def __init__(self, rate_hz: float, burst: int) -> None:
        self._step_s, self._burst_s = 1.0 / rate_hz, (burst - 1) / rate_hz
        self._next = float("-inf")  # time of the next connection at a steady rate, s

    def wait_s(self, now: float, count: float = 1.0) -> float:
        """Return how long to wait before the next `count` are taken, and count them."""
        begin = max(self._next, now - self._burst_s)
        self._next = begin + count * self._step_s
        return max(0.0, begin - now)

    def admits(self, now: float) -> bool:
        """Count one that comes now and return True, or return False: it does not wait, and does not count.

        >>> pace = Pace(10.0, burst=2)
        >>> [pace.admits(now) for now in (0.0, 0.0, 0.0, 0.11, 0.11)]
        [True, True, False, True, False]
        """
        if self._next > now:
            return False
        self.wait_s(now)
        return True


class LinePace:
    """The rate at which lines of a network are read. A line costs as much as `LINE_BYTES` do, if it is shorter.

    Parameters
    ----------
    lines_hz : lines per second.

    >>> pace = LinePace(1000.0)
    >>> [round(pace.wait_s(data, 0.0), 2) for data in (1000 * b"7\\n", 500 * b"\\n", bytes(256_000), b"")]
    [0.0, 0.0, 0.5, 1.5]
    """

    def __init__(self, lines_hz: float) -> None:
        self._pace = Pace(lines_hz, burst=max(1, round(lines_hz)))

    def wait_s(self, data: bytes, now: float) -> float:
        """Return how long to wait before these bytes are taken, and count them."""
        return self._pace.wait_s(now, max(data.count(b"\n"), len(data) / LINE_BYTES))


def within_files(connections: int) -> int:
    """Return how many connections a door may have, of those that are configured, so that the reserve stays free."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return connections
    return max(1, min(connections, (soft - RESERVED_FILES) // SHARE_OF_FILES))
