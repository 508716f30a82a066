"""Relay in front of Zenoh: accepts connections over TCP, and passes on those that speak.

Zenoh accepts whatever connects before it looks at its limits. Connections that say nothing take all descriptors of the
process; Zenoh then accepts none for 0.1 s, the queue of the kernel fills, and a viewer gets no connection. A daemon
therefore listens for Zenoh on a Unix socket in a directory that only this user can enter, and on TCP itself. Bytes are
passed on as they are.

A connection goes through three states, and each has a limit of its own, so that none keeps out those of another:

=============  ==================================================  =====================================
state          until                                               beyond the limit
=============  ==================================================  =====================================
silent         its first message is complete                       the oldest silent one is closed
greeting       Zenoh has replied to its second message             the oldest greeting one is closed
open           one side closes it, or a client takes nothing       Zenoh refuses further sessions
               for `BLOCKED_S`
=============  ==================================================  =====================================

A silent connection costs one descriptor, any other three: the client's, that to the Unix socket, and Zenoh's.

A message of Zenoh over a stream begins with its length: two bytes, the lower one first.
"""

from __future__ import annotations

import os
import re
import selectors
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from imumon.door_limits import OpenConnections, Pace

MOST_FIRST_BYTES = 4096
"""Bytes of the first message of a connection; that of Zenoh 1.10 has 34."""
GREETINGS_HZ, GREETINGS_AT_ONCE = 200.0, 64
"""Connections that are passed on per second over a longer time, and at once; further ones are closed."""
CHUNK_BYTES = 1 << 14
"""Bytes that are read at once, and wait for one client at most."""
BLOCKED_S = 3.0
"""s for which a client may take nothing: Zenoh drops it after its lease of 2 s."""
ACCEPTED_AT_ONCE = 64
"""Connections that are accepted before those that are open are served again."""
POLL_S = 0.25
"""s between two looks for connections that are late."""
NO_FILES_S = 0.02
"""s for which none is accepted where there is no descriptor."""
CLOSE_S = 0.3
"""s that clients have at the end to take the last messages."""
BACKLOG = 4096
"""Connections that may wait in the kernel; the kernel lowers it to its own limit."""

_PREFIX, _SOCKET = "imumon-bus-", "zenoh"
_MOST_PATH = 100
"""Characters of the path of a Unix socket; Linux allows 107, and Zenoh adds ``.lock`` for a file beside it."""
_PROBE_S = 0.1
_PLAIN_TCP = re.compile(r"tcp/(?:\[(?P<v6>[^\]]+)\]|(?P<host>[^:/\[\]]+)):(?P<port>\d+)")


class NoPlace(Exception):
    """There is no directory for the Unix socket: the temporary one cannot be written, or its name is too long."""


class _Side:
    """One end of a connection: its socket, and what the other end has sent for it."""

    def __init__(self, link: _Link, end: socket.socket) -> None:
        self.link, self.socket = link, end
        self.unsent = b""
        self.events = 0  # for which it is registered
        self.progress = 0.0  # when it last took bytes, or had none to take, s


class _Link:
    """A connection of a client, and the one to Zenoh that belongs to it."""

    def __init__(self, client: socket.socket) -> None:
        self.client = _Side(self, client)
        self.zenoh: _Side | None = None
        self.first = b""  # of the first message, as long as it is not complete
        self.asked_twice = False

    def other(self, side: _Side) -> _Side | None:
        return self.zenoh if side is self.client else self.client


class TcpRelay:
    """Listens on TCP endpoints for a Zenoh session that listens on `endpoint`.

    Parameters
    ----------
    endpoints : of Zenoh, such as ``tcp/127.0.0.1:7448``; `relayed` says which can be relayed.
    silent, greeting : most connections in these states.
    greeting_s : time for the greeting, from the acceptance on, s.

    Attributes
    ----------
    endpoint : Unix socket on which the session has to listen.

    Raises
    ------
    NoPlace : for the Unix socket.
    OSError : it cannot listen there; `filename` is the endpoint.
    """

    def __init__(self, endpoints: Sequence[str], silent: int, greeting: int, greeting_s: float) -> None:
        self._silent = OpenConnections[_Link](silent, greeting_s, self._close)
        self._greeting = OpenConnections[_Link](greeting, greeting_s, self._close)
        self._pace = Pace(GREETINGS_HZ, GREETINGS_AT_ONCE)
        self._links: set[_Link] = set()
        self._selector = selectors.DefaultSelector()
        self._listeners: list[socket.socket] = []
        self._ending: float | None = None  # when the thread ends at the latest, s
        self._directory = _private_directory()
        self._path = f"{self._directory}/{_SOCKET}"
        try:
            for endpoint in endpoints:
                self._listeners.append(_listening(endpoint))
        except OSError:
            self._release()
            raise
        self.endpoint = f"unixsock-stream/{self._path}"
        self._thread = threading.Thread(target=self._run, name="imumon-relay", daemon=True)

    def start(self) -> None:
        """Accept connections from now on: the session listens."""
        for listener in self._listeners:
            listener.listen(BACKLOG)
            self._selector.register(listener, selectors.EVENT_READ)
        self._thread.start()

    def close(self) -> None:
        """End, after the session has closed and its clients have its last messages."""
        self._ending = time.monotonic() + CLOSE_S
        for listener in self._listeners:
            with suppress(OSError):
                listener.shutdown(socket.SHUT_RD)  # which wakes the thread
        if self._thread.is_alive():
            self._thread.join(CLOSE_S + 2.0 * POLL_S)
        self._release()

    def _release(self) -> None:
        for listener in self._listeners:
            listener.close()
        self._selector.close()
        shutil.rmtree(self._directory, ignore_errors=True)

    # ------------------------------------------------------------------ thread

    def _run(self) -> None:
        while self._ending is None or (self._links and time.monotonic() < self._ending):
            for key, events in self._selector.select(POLL_S if self._ending is None else 0.02):
                if key.data is None:
                    self._accept(key.fileobj)  # type: ignore[arg-type]
                elif key.data.link in self._links:  # an event before this one may have closed it
                    self._serve(key.data, events)
            now = time.monotonic()
            self._silent.expire(now)
            self._greeting.expire(now)
            for link in [link for link in self._links if _blocked(link, now)]:
                self._close(link)
        for link in list(self._links):
            self._close(link)

    def _accept(self, listener: socket.socket) -> None:
        if self._ending is not None:
            with suppress(KeyError, ValueError):
                self._selector.unregister(listener)
            return
        for _ in range(ACCEPTED_AT_ONCE):
            try:
                client, _ = listener.accept()
            except BlockingIOError:
                return
            except OSError:  # no descriptor, or the client is gone; the others wait in the kernel meanwhile
                self._silent.close_all()
                time.sleep(NO_FILES_S)
                return
            client.setblocking(False)
            with suppress(OSError):
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            link = _Link(client)
            self._links.add(link)
            try:
                self._register(link.client)
            except OSError:  # the kernel has no place for it: the thread must go on for the others
                self._close(link)
                continue
            self._silent.add(link, time.monotonic())
            if link in self._links:
                self._serve(link.client, selectors.EVENT_READ)  # a viewer has sent its first message by now

    def _serve(self, side: _Side, events: int) -> None:
        """Read from a side and write to it, as far as its events say."""
        link = side.link
        try:
            if events & selectors.EVENT_WRITE:
                self._flush(side)
            if events & selectors.EVENT_READ:
                self._read(side)
        except BlockingIOError:
            pass
        except OSError:
            self._close(link)

    def _read(self, side: _Side) -> None:
        link, other = side.link, side.link.other(side)
        if other is not None and other.unsent:
            return
        data = side.socket.recv(CHUNK_BYTES)
        if not data:
            self._close(link)
        elif other is None:
            self._greet(link, data)
        else:
            if side is link.client:
                link.asked_twice = True
            elif link.asked_twice:
                self._greeting.discard(link)
            other.unsent, other.progress = data, time.monotonic()
            self._flush(other)

    def _greet(self, link: _Link, data: bytes) -> None:
        """Connect to Zenoh as soon as the first message is complete."""
        link.first += data
        if len(link.first) < 2:
            return
        length = int.from_bytes(link.first[:2], "little")
        if not 0 < length <= MOST_FIRST_BYTES:
            self._close(link)
        elif 2 + length <= len(link.first):
            if not self._pace.admits(time.monotonic()):
                self._close(link)
                return
            self._silent.discard(link)
            link.zenoh = _Side(link, socket.socket(socket.AF_UNIX))
            link.zenoh.socket.setblocking(False)
            try:
                link.zenoh.socket.connect(self._path)
            except OSError:
                self._close(link)
                return
            self._greeting.add(link, time.monotonic())
            link.zenoh.unsent, link.zenoh.progress, link.first = link.first, time.monotonic(), b""
            self._flush(link.zenoh)

    def _flush(self, side: _Side) -> None:
        """Write what waits for a side; the other side is not read before all is written."""
        try:
            sent = side.socket.send(side.unsent) if side.unsent else 0
        except BlockingIOError:
            sent = 0
        side.unsent = side.unsent[sent:]
        if sent:
            side.progress = time.monotonic()
        self._register(side)
        if (other := side.link.other(side)) is not None:
            self._register(other)

    def _register(self, side: _Side) -> None:
        other = side.link.other(side)
        full = other is not None and other.unsent
        events = (0 if full else selectors.EVENT_READ) | (selectors.EVENT_WRITE if side.unsent else 0)
        if events == side.events:
            return
        if not side.events:
            self._selector.register(side.socket, events, side)
        elif not events:
            self._selector.unregister(side.socket)
        else:
            self._selector.modify(side.socket, events, side)
        side.events = events

    def _close(self, link: _Link) -> None:
        self._links.discard(link)
        self._silent.discard(link)
        self._greeting.discard(link)
        for side in (link.client, link.zenoh):
            if side is not None:
                if side.events:
                    self._selector.unregister(side.socket)
                    side.events = 0
                side.socket.close()


def relayed(endpoint: str) -> bool:
    """Return whether a relay can listen on an endpoint of Zenoh: plain TCP, without options of Zenoh.

    >>> relayed("tcp/127.0.0.1:7448"), relayed("tcp/[::1]:7448"), relayed("tls/127.0.0.1:7448")
    (True, True, False)
    """
    return _PLAIN_TCP.fullmatch(endpoint) is not None


def _blocked(link: _Link, now: float) -> bool:
    """Return whether a side has taken nothing for too long."""
    sides = (link.client, link.zenoh)
    return any(side is not None and side.unsent and now - side.progress > BLOCKED_S for side in sides)


def _private_directory() -> str:
    """Make a directory that only this user can enter; those of killed daemons are removed.

    Raises
    ------
    NoPlace : it cannot be made, or the path of a socket in it is too long.
    """
    try:
        _remove_stale(Path(tempfile.gettempdir()))
        directory = tempfile.mkdtemp(prefix=_PREFIX)
    except OSError as error:
        raise NoPlace from error
    if len(directory) + len(_SOCKET) > _MOST_PATH:
        shutil.rmtree(directory, ignore_errors=True)
        raise NoPlace
    return directory


def _remove_stale(place: Path) -> None:
    """Remove the directories of daemons of this user that were killed: no process listens there."""
    for path in place.glob(f"{_PREFIX}*/{_SOCKET}"):
        try:
            if os.lstat(path.parent).st_uid != os.geteuid():
                continue
            with socket.socket(socket.AF_UNIX) as probe:
                probe.settimeout(_PROBE_S)
                probe.connect(str(path))
        except ConnectionRefusedError:
            shutil.rmtree(path.parent, ignore_errors=True)
        except OSError:
            continue


def _listening(endpoint: str) -> socket.socket:
    """Return a socket that is bound to an endpoint; it does not listen yet."""
    address = _PLAIN_TCP.fullmatch(endpoint)
    assert address
    try:
        host = address["v6"] or address["host"]
        family, kind, protocol, _, name = socket.getaddrinfo(host, address["port"], type=socket.SOCK_STREAM)[
            0
        ]
        listener = socket.socket(family, kind, protocol)
        try:
            listener.setblocking(False)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(name)
            listener.listen(
                1
            )  # a port that another program has bound with the same option is noticed here only
        except OSError:
            listener.close()
            raise
    except OSError as error:
        error.filename = endpoint
        raise
    return listener
