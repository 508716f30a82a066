"""Control channel of the emulator: lines of commands on standard input or on a socket.

Each line is answered by a line of JSON. The end of standard input ends the emulator; the end of a socket
connection does not.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path


class Control:
    """Source of commands.

    Parameters
    ----------
    place : path of a socket to create, ``-`` for standard input, None for none.

    Attributes
    ----------
    ended : standard input has ended.
    """

    def __init__(self, place: str | None) -> None:
        self._server: socket.socket | None = None
        self._inputs: dict[int, tuple[int, bytearray]] = {}
        self._clients: dict[int, socket.socket] = {}
        self._path = place if place not in (None, "-") else None
        self.ended = False
        if place == "-":
            self._inputs[sys.stdin.fileno()] = (sys.stdout.fileno(), bytearray())
        elif place is not None:
            if Path(place).is_socket():
                Path(place).unlink()
            self._server = socket.socket(socket.AF_UNIX)
            self._server.bind(place)
            self._server.listen()

    @property
    def descriptors(self) -> list[int]:
        return [*self._inputs, *([self._server.fileno()] if self._server is not None else [])]

    def lines(self, ready: list[int]) -> Iterator[tuple[str, int]]:
        """Yield the commands on the `ready` descriptors, each with the descriptor for its answer."""
        if self._server is not None and self._server.fileno() in ready:
            client, _ = self._server.accept()
            self._clients[client.fileno()] = client
            self._inputs[client.fileno()] = (client.fileno(), bytearray())
        for descriptor in [d for d in self._inputs if d in ready]:
            output, buffer = self._inputs[descriptor]
            data = b""
            with suppress(OSError):
                data = os.read(descriptor, 4096)
            if not data:
                del self._inputs[descriptor]
                closed = self._clients.pop(descriptor, None)
                self.ended |= closed is None
                if closed is not None:
                    closed.close()
            *complete, buffer[:] = (buffer + data).split(b"\n")
            for line in filter(None, complete):
                yield line.decode("utf-8", "replace"), output

    def close(self) -> None:
        for client in self._clients.values():
            client.close()
        if self._server is not None and self._path is not None:
            self._server.close()
            Path(self._path).unlink(missing_ok=True)
