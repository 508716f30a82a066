"""A sensor that prints lines: on a pseudo-terminal, to the clients of a TCP server, or as datagrams."""

from __future__ import annotations

import os
import random
import socket
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal

from free_ports import free_port

COLUMNS = "t_us,gx,gy,gz,ax,ay,az"
URL_PARAMETERS = f"?columns={COLUMNS}"


@contextmanager
def datagrams(port: int, data: bytes, period_s: float = 0.02) -> Iterator[None]:
    """Send the same datagram again and again; none, if it is empty."""
    ending = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board:
            while data and not ending.wait(period_s):
                board.sendto(data, ("127.0.0.1", port))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()


class LineSender:
    """Prints `rate_hz` lines a second, of a clock that continues while it is unplugged.

    Attributes
    ----------
    url : value of ``--port`` that reads it.
    sent : lines so far.
    """

    def __init__(self, kind: Literal["pty", "tcp", "udp"], directory: Path, rate_hz: float = 200.0) -> None:
        self._kind, self._link, self._rate_hz = kind, directory / "board", rate_hz
        self._port = free_port()
        places = {
            "pty": f"{self._link}",
            "tcp": f"tcp://127.0.0.1:{self._port}",
            "udp": f"udp://:{self._port}",
        }
        self.url = f"lines:{places[kind]}{URL_PARAMETERS}"
        self.sent = self._hidden = 0
        self._ending = threading.Event()
        self._lock = threading.Lock()
        self._master: int | None = None
        self._server: socket.socket | None = None
        self._client: socket.socket | None = None
        self._datagrams = socket.socket(
            socket.AF_INET, socket.SOCK_DGRAM
        )  # one: a sender is known by its port
        self._inserted = b""
        self.replug()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def replug(self) -> None:
        with self._lock:
            if self._kind == "pty":
                self._master, slave = os.openpty()
                tty.setraw(slave)
                os.set_blocking(self._master, False)
                self._link.symlink_to(os.ttyname(slave))
                os.close(slave)
            elif self._kind == "tcp":
                self._server = socket.create_server(("127.0.0.1", self._port))
                self._server.setblocking(False)

    def unplug(self) -> None:
        with self._lock:
            for open_socket in (self._client, self._server):
                if open_socket is not None:
                    open_socket.close()
            if self._master is not None:
                os.close(self._master)
                self._link.unlink()
            self._master = self._server = self._client = None

    def lose_samples(self, count: int = 9) -> None:
        self._hidden = count

    def insert(self, data: bytes) -> None:
        """Print something else before the next line."""
        self._inserted = data

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self.unplug()
        self._datagrams.close()

    def _run(self) -> None:
        random_values, begin, made = random.Random(1), time.monotonic(), 0
        while not self._ending.wait(0.005):
            due = int((time.monotonic() - begin) * self._rate_hz)
            lines = []
            for k in range(made, due):
                values = [random_values.gauss(0.0, 1e-3) for _ in range(6)]
                lines.append(",".join([str(round(k * 1e6 / self._rate_hz)), *(f"{v:.6f}" for v in values)]))
            hidden = min(self._hidden, len(lines))
            self._hidden -= hidden
            data, self._inserted = self._inserted, b""
            data += "".join(f"{line}\n" for line in lines[hidden:]).encode()
            made = due
            with self._lock, suppress(OSError):
                self._send(data)
                self.sent += len(lines) - hidden

    def _send(self, data: bytes) -> None:
        if not data:
            return
        if self._kind == "udp":
            for line in data.splitlines():
                self._datagrams.sendto(line, ("127.0.0.1", self._port))
        elif self._master is not None:
            os.write(self._master, data)
        elif self._server is not None:
            if self._client is None:
                self._client, _ = self._server.accept()
            try:
                self._client.sendall(data)
            except OSError:  # the client has left; another may come
                self._client = None
