"""Attacks by processes of the same machine that may read: the daemon measures on, in bounded memory.

Every attack was tried against an earlier version; tests/attackers.py has them.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import attackers
import pytest
from attackers import attacking, resident_mb
from bus_actors import Actor, free_endpoint, stage
from daemons import Daemon
from waiting import until

from imumon.bus import Subscriber
from imumon.devices.vn100.emulator import EmulatorSettings, spawn

pytestmark = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")


@contextmanager
def publisher(**settings: object) -> Iterator[tuple[Actor, str, Callable[..., Actor]]]:
    """A daemon of the bus alone, its endpoint, and what starts other actors."""
    with stage() as start:
        address = free_endpoint()
        yield start("daemon", listen=[address], **settings).ready(), address, start


TARGET_MB = 150.0  # MB resident during all attacks at once
FLOODS = (
    attackers.payload,
    *(
        pytest.param(way, marks=pytest.mark.slow)
        for way in (
            attackers.attachment,
            attackers.parameters,
            attackers.small_payload,
            attackers.names,
            attackers.many,
            attackers.forge,
        )
    ),
)


@pytest.mark.parametrize("way", FLOODS, ids=lambda way: way.__name__)
def test_queries_and_messages_take_bounded_memory(way: Callable[..., int]) -> None:
    with publisher(period=1.0) as (daemon, address, _):
        before, most = resident_mb(daemon.process.pid), 0.0
        with attacking(address, "a", 2.0, way) as done:
            end = time.monotonic() + 3.0
            while time.monotonic() < end:
                most = max(most, resident_mb(daemon.process.pid))
                time.sleep(0.02)
        assert done[0] > 5
        assert most - before < 40.0
        assert daemon.request("state")["error"] is None
        with Subscriber([address]) as viewer:
            until(lambda: viewer.reports() and viewer.reports()["a"][0].session.samples >= 3)


def test_a_query_with_data_or_a_long_selector_gets_no_reply() -> None:
    with publisher() as (_, address, _), attackers.session(address) as querier:
        until(lambda: list(querier.get("imumon/a/report", timeout=1.0)))
        for options in ({"payload": b"x"}, {"attachment": b"x"}):
            assert not list(querier.get("imumon/a/report", timeout=1.0, **options))
        assert not list(querier.get(f"imumon/a/report?{'x' * 2000}", timeout=1.0))


@pytest.mark.slow
def test_a_stopped_querier_delays_no_other_subscriber() -> None:
    with publisher(period=0.05, columns=20000) as (_, address, start):
        subscriber = start("subscriber", connect=[address]).ready()
        with attacking(address, "a", 4.0, *[attackers.stopped] * 3):
            time.sleep(1.5)
            first = len(subscriber.messages)
            time.sleep(4.0)
            arrivals = [message["at"] for message in subscriber.messages[first:]]
    assert len(arrivals) > 20
    assert max(b - a for a, b in pairwise(arrivals)) < 1.0


@contextmanager
def _few(endpoint: str, count: int) -> Iterator[None]:
    host, port = endpoint.removeprefix("tcp/").split(":")
    connections = [socket.create_connection((host, int(port))) for _ in range(count)]
    try:
        yield
    finally:
        for connection in connections:
            connection.close()


def test_idle_connections_do_not_keep_a_subscriber_out() -> None:
    with publisher() as (_, address, _), _few(address, 200):
        time.sleep(0.2)
        with Subscriber([address]) as subscriber:
            assert subscriber.wait_report("a", timeout=30.0) is not None


@pytest.mark.slow
def test_1500_idle_connections_do_not_keep_a_subscriber_out(tmp_path: Path) -> None:
    with spawn(EmulatorSettings(seed=1)) as sensor, Daemon(sensor.path, tmp_path, "--id", "a") as daemon:
        daemon.samples(100)
        with attacking(daemon.endpoint, "a", 8.0, attackers.half_open):
            time.sleep(2.0)
            with Subscriber([daemon.endpoint]) as subscriber:
                assert subscriber.wait_report("a", timeout=30.0) is not None
        assert daemon.samples(1000).session.missing == 0
        assert daemon.stop()[0] == 0


def _attack_together(tmp_path: Path, seconds: float) -> None:
    """Attack in every way at once; no sample is lost, memory is bounded, and viewers work."""
    ways = (*attackers.WAYS, attackers.stopped, attackers.stopped)
    with spawn(EmulatorSettings(seed=1)) as sensor, Daemon(sensor.path, tmp_path, "--id", "a") as daemon:
        daemon.samples(100)
        # while the emulator stalls, every sample that it has sent can be counted
        counted = sensor.ask("stall 600")
        time.sleep(2.2)
        first = daemon.samples()
        sensor.ask("stall 0")
        daemon.samples(first.session.samples + 200)
        most = 0.0
        with attacking(daemon.endpoint, "a", seconds, *ways) as done:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                most = max(most, resident_mb(daemon.process.pid))
                time.sleep(0.1)
        print(dict(zip((way.__name__ for way in ways), done, strict=True)), f"{most:.0f} MB")
        assert min(done) > 0
        assert most < TARGET_MB
        before = daemon.viewer.version
        until(lambda: daemon.viewer.version > before)
        command = [sys.executable, "-m", "imumon", "status", "--json", "--connect", daemon.endpoint]
        status = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert status.returncode == 0, status.stderr
        with Subscriber([daemon.endpoint]) as subscriber:
            assert subscriber.wait_report("a", timeout=30.0) is not None
        after = sensor.ask("stall 600")
        time.sleep(0.2)  # the thread that reads has it
        daemon.process.send_signal(signal.SIGTERM)
        last = daemon.wait(lambda r: r.state == "stopped")
        sent = (after["sent"] - after["replies"]) - (counted["sent"] - counted["replies"])
        assert sent > 100 * seconds * 0.9
        assert last.session.samples - first.session.samples == sent
        assert last.session.missing == last.session.bad_checksums == 0
        assert daemon.stop()[0] == 0


@pytest.mark.slow
def test_everything_at_once_for_a_minute(tmp_path: Path) -> None:
    _attack_together(tmp_path, 60.0)
