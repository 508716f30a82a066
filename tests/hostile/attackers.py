"""Processes that attack a daemon on its endpoint, each in one way, for a number of seconds.

Run as ``python attackers.py WAY ENDPOINT ID SECONDS``. An attacker prints what it did as its last line. It uses
Zenoh or sockets alone, without code of imumon.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zenoh
from paths import TESTS
from zenoh.handlers import RingChannel
from zenoh_sessions import client

ADDRESS_SPACE = 4 << 30  # bytes; an attacker must not take the memory of the machine
BIG = 10_000_000  # bytes
OPEN: deque[Any] = deque(maxlen=1000)  # handlers of queries, which stay open


def repeat(endpoint: str, seconds: float, pause_s: float, act: Callable[[zenoh.Session, int], object]) -> int:
    """Do something again and again; open another session when there is none or the daemon has closed it."""
    end, count, open_session = time.monotonic() + seconds, 0, None
    while time.monotonic() < end:
        try:
            if open_session is None:
                open_session = client(endpoint)
            act(open_session, count)
            count += 1
        except zenoh.ZError:
            open_session = None
        time.sleep(pause_s)
    return count


def ignore(sample: object) -> None:
    pass


def query(open_session: zenoh.Session, selector: str, **options: Any) -> None:
    """Send a query and take no replies. A callback would start a thread for each query."""
    OPEN.append(open_session.get(selector, RingChannel(1), **options))


def payload(endpoint: str, id: str, seconds: float) -> int:
    """Queries for a signal that does not exist, with 10 MB each."""
    data = bytes(BIG)
    key = f"imumon/{id}/signal/x"
    return repeat(endpoint, seconds, 0.005, lambda s, n: query(s, key, payload=data, timeout=60))


def many(endpoint: str, id: str, seconds: float) -> int:
    """Queries without a payload that wait for an hour, as many as possible."""
    key = f"imumon/{id}/signal/x"
    return repeat(endpoint, seconds, 0.0, lambda s, n: query(s, f"{key}{n}", timeout=3600))


def forge(endpoint: str, id: str, seconds: float) -> int:
    """Messages on the keys of the daemon: small ones, and 50 MB now and then."""
    big = bytes(5 * BIG)

    def put(open_session: zenoh.Session, number: int) -> None:
        for name in ("report", "event", "grade", "gyro/x", "alive"):
            open_session.put(f"imumon/{id}/{name}", '{"schema": "imumon.report/1"}')
        if number % 100 == 0:
            open_session.put(f"imumon/{id}/report", big)

    return repeat(endpoint, seconds, 0.005, put)


@contextmanager
def attacking(endpoint: str, id: str, seconds: float, way: Callable[..., int]) -> Iterator[list[int]]:
    """Attack in a way; the yielded list has what the attacker did after the end."""
    command = [sys.executable, str(Path(__file__)), way.__name__, endpoint, id, str(seconds)]
    done: list[int] = []
    path = {**os.environ, "PYTHONPATH": str(TESTS)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=path) as process:
        try:
            yield done
            done.append(int(process.communicate(timeout=seconds + 30.0)[0]))
        finally:
            process.kill()


if __name__ == "__main__":
    name, at, device, duration = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    print(globals()[name](at, device, float(duration)), flush=True)
    os._exit(0)  # the end of a session with open queries may take long
