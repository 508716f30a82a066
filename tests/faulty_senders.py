"""Sensors that break the rules of their door: a server that resets, and an MTi with impossible numbers."""

from __future__ import annotations

import itertools
import math
import socket
import struct
import threading
import time
from pathlib import Path

from line_sender import URL_PARAMETERS

from imumon.devices.xsens.mt_emulator import MtEmulator
from imumon.devices.xsens.mt_messages import DataId

IMPOSSIBLE = (math.nan, math.inf, -math.inf, 1e38)


class ResettingServer:
    """A TCP server of lines that resets its connection after so many of them; its clock goes on meanwhile.

    Attributes
    ----------
    failing : whether it resets; until then it sends without end.
    url : value of ``--port`` that reads it.
    connections : accepted so far.
    """

    def __init__(self, lines: int, rate_hz: float = 200.0) -> None:
        self._lines, self._rate_hz, self.connections = lines, rate_hz, 0
        self.failing = True
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.1)
        self.url = f"lines:tcp://127.0.0.1:{self._server.getsockname()[1]}{URL_PARAMETERS}"
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        begin = time.monotonic()
        while not self._ending.is_set():
            try:
                client, _ = self._server.accept()
            except TimeoutError:
                continue
            self.connections += 1
            # without a wait for what is not sent yet: the other end sees a reset, not an end
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            with client:
                first = int((time.monotonic() - begin) * self._rate_hz) + 1
                for k in itertools.count(first):
                    if self.failing and k >= first + self._lines:
                        break
                    if self._ending.wait(max(0.0, begin + k / self._rate_hz - time.monotonic())):
                        return
                    values = ",".join(f"{1e-3 * math.sin(k * (axis + 1)):.6f}" for axis in range(6))
                    try:
                        client.sendall(f"{round(k * 1e6 / self._rate_hz)},{values}\n".encode())
                    except OSError:
                        break

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self._server.close()


class ImpossibleMt(MtEmulator):
    """An MTi of which every tenth packet has a valid checksum and a number that no sensor measures.

    Attributes
    ----------
    impossible : such packets so far, once `failing` is set.
    """

    failing = False
    impossible = 0

    def __init__(self, link: Path) -> None:
        super().__init__(link=link, seed=1)

    def _packet(self, k: int) -> bytes:
        data = super()._packet(k)
        if not self.failing or k % 10:
            return data
        number, self.impossible = struct.pack(">f", IMPOSSIBLE[k // 10 % 4]), self.impossible + 1
        for field in (DataId.DELTA_V, DataId.ACCELERATION, DataId.RATE_OF_TURN):
            name = struct.pack(">HB", field, 12)
            if name in data:
                place = data.index(name) + len(name)
                data = data[:place] + number + data[place + 4 :]
        return data
