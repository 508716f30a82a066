"""A sensor that prints lines: on a pseudo-terminal, to the clients of a TCP server, or as datagrams."""

from __future__ import annotations

import os
import random
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from emulated_sensor import EmulatedSensor
from free_ports import free_port

COLUMNS = "t_us,gx,gy,gz,ax,ay,az"
URL_PARAMETERS = f"?columns={COLUMNS}"


@contextmanager
def datagrams(port: int, data: bytes, host: str = "127.0.0.1", period_s: float = 0.02) -> Iterator[None]:
    """Send the same datagram again and again from an address; none, if it is empty."""
    ending = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board:
            board.bind((host, 0))
            while data and not ending.wait(period_s):
                board.sendto(data, ("127.0.0.1", port))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


class LineSender(EmulatedSensor):
    """Prints `rate_hz` lines a second.

    Attributes
    ----------
    url : value of ``--port`` that reads it.
    port : of its server, or to which it sends datagrams.
    """

    def __init__(self, kind: Literal["pty", "tcp", "udp"], directory: Path, rate_hz: float = 200.0) -> None:
        self._kind, self.port, self.rate_hz = kind, free_port(), rate_hz
        places = {
            "pty": f"{directory / 'board'}",
            "tcp": f"tcp://127.0.0.1:{self.port}",
            "udp": f"udp://:{self.port}",
        }
        self.url = f"lines:{places[kind]}{URL_PARAMETERS}"
        self._server: socket.socket | None = None
        self._client: socket.socket | None = None
        # one: a sender is known by its port
        self._datagrams = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._random, self._inserted = random.Random(1), b""
        super().__init__(directory / "board" if kind == "pty" else None)

    def replug(self) -> None:
        if self._kind == "pty":
            super().replug()
        elif self._kind == "tcp":
            self._server = socket.create_server(("127.0.0.1", self.port))
            self._server.setblocking(False)

    def unplug(self) -> None:
        super().unplug()
        with self._lock:
            for open_socket in (self._client, self._server):
                if open_socket is not None:
                    open_socket.close()
            self._server = self._client = None

    def insert(self, data: bytes) -> None:
        """Print something else before the next line."""
        self._inserted = data

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        self._datagrams.close()

    def step(self) -> None:
        data, self._inserted = self._inserted, b""
        for k in self.due():
            values = ",".join(f"{self._random.gauss(0.0, 1e-3):.6f}" for _ in range(6))
            data += f"{round(k * 1e6 / self.rate_hz)},{values}\n".encode()
        if not data:
            return
        if self._kind == "udp":
            for line in data.splitlines():
                self._datagrams.sendto(line, ("127.0.0.1", self.port))
        elif self._master is not None:
            os.write(self._master, data)
        elif self._server is not None:
            if self._client is None:
                self._client, _ = self._server.accept()
            try:
                self._client.sendall(data)
            except OSError:  # the client has left; another may come
                self._client = None
