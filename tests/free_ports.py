"""Ports of this machine for the tests, each of which is given to one test only.

The kernel gives the port of a closed socket to the next one that asks. A client of an earlier test that connects again
then reaches the server of a later test. The ports here lie below those that the kernel gives, and a file counts them
for all processes.
"""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
from pathlib import Path

FIRST, LAST = 10_000, 32_000
COUNTER = Path(tempfile.gettempdir(), f"ports-given-to-tests-{os.getuid()}")


def free_port() -> int:
    """Return a port of 127.0.0.1 that no server has and no test had, until all ports were given."""
    with COUNTER.open("a+") as counter:
        fcntl.flock(counter, fcntl.LOCK_EX)
        counter.seek(0)
        port = int(counter.read() or FIRST)
        while True:
            port = port + 1 if port < LAST else FIRST
            with socket.socket() as probe:
                try:
                    probe.bind(("127.0.0.1", port))
                except OSError:
                    continue
            counter.truncate(0)
            counter.write(str(port))
            return port


def free_endpoint() -> str:
    """Return an endpoint on loopback that nobody listens on."""
    return f"tcp/127.0.0.1:{free_port()}"
