"""Control of the emulator: lines of commands on standard input or on a socket.

Each line is answered by a line of JSON. The end of standard input is the end of the emulator, so that a
parent that is gone takes it along; a client of the socket that is gone takes nothing.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path


class Control:
    """Where commands come from.

    Parameters
    ----------
    where : path of a socket to make, ``-`` for standard input, None for nowhere.

    Attributes
    ----------
    ended : standard input has ended.
    """

    def __init__(self, where: str | None) -> None:
        self._server: socket.socket | None = None
        self._inputs: dict[int, tuple[int, bytearray]] = {}
        self._clients: dict[int, socket.socket] = {}
        self._path = where if where not in (None, "-") else None
        self.ended = False
        if where == "-":
            self._inputs[sys.stdin.fileno()] = (sys.stdout.fileno(), bytearray())
        elif where is not None:
            if Path(where).is_socket():
                Path(where).unlink()
            self._server = socket.socket(socket.AF_UNIX)
            self._server.bind(where)
            self._server.listen()

    @property
    def descriptors(self) -> list[int]:
        return [*self._inputs, *([self._server.fileno()] if self._server is not None else [])]

    def lines(self, ready: list[int]) -> Iterator[tuple[str, int]]:
        """Commands that came, each with the descriptor for its answer."""
        if self._server is not None and self._server.fileno() in ready:
            client, _ = self._server.accept()
            self._clients[client.fileno()] = client
            self._inputs[client.fileno()] = (client.fileno(), bytearray())
        for descriptor in [d for d in self._inputs if d in ready]:
            answer, held = self._inputs[descriptor]
            try:
                data = os.read(descriptor, 4096)
            except OSError:
                data = b""
            if not data:
                del self._inputs[descriptor]
                gone = self._clients.pop(descriptor, None)
                if gone is None:
                    self.ended = True
                else:
                    gone.close()
                continue
            held += data
            *whole, rest = held.split(b"\n")
            held[:] = rest
            for line in filter(None, whole):
                yield line.decode("utf-8", "replace"), answer

    def close(self) -> None:
        for client in self._clients.values():
            client.close()
        if self._server is not None and self._path is not None:
            self._server.close()
            Path(self._path).unlink(missing_ok=True)
