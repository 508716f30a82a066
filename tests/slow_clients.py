"""Clients that connect to a door in large numbers, send a byte now and then, and connect again when they are closed."""

from __future__ import annotations

import resource
import socket
import threading
from contextlib import suppress

BYTE_S = 1.5  # between two bytes of one client, s


class SlowClients:
    """So many of them, from a thread of the test, until `stop`.

    Attributes
    ----------
    connections : opened so far.
    """

    def __init__(self, port: int, count: int) -> None:
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        self._address, self._count, self.connections = ("127.0.0.1", port), count, 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        clients: list[socket.socket | None] = [None] * self._count
        while not self._ended.is_set():
            for number, client in enumerate(clients):
                clients[number] = self._sent(client)
            self._ended.wait(BYTE_S)
        for client in clients:
            if client is not None:
                client.close()

    def _sent(self, client: socket.socket | None) -> socket.socket | None:
        """Send a byte; return the client, or a new one in its place."""
        if client is None:
            client = socket.socket()
            client.setblocking(False)
            with suppress(OSError):
                client.connect(self._address)
            self.connections += 1
            return client
        try:
            client.send(b"G")
        except BlockingIOError:  # it is not accepted yet
            return client
        except OSError:
            client.close()
            return None
        return client

    def stop(self) -> None:
        self._ended.set()
        self._thread.join(60)
