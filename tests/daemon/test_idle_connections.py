"""Connections that say nothing: the measurement goes on, and viewers are answered while they stay open."""

from __future__ import annotations

import resource
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from daemons import Daemon, MetricsViewer, scraped, values
from usage import resident_kb

from imumon.bus import Subscriber

COUNT = 2000
"""Connections to the Zenoh port, and as many to `imumon metrics`."""
PAUSE_S = 0.002
"""s between two connections to the metrics: of many at once, its short queue accepts only some."""
CALM_S = 8.0
"""s of the record before and after the connections are opened."""


@contextmanager
def idle(address: str, pause_s: float = 0.0) -> Iterator[None]:
    """Open the connections to ``HOST:PORT``, all at once or with a pause between two, and keep them open."""
    host, _, port = address.rpartition(":")
    with ExitStack() as stack:
        for _ in range(COUNT):
            client = stack.enter_context(socket.socket())
            client.setblocking(False)
            client.connect_ex((host, int(port)))
            time.sleep(pause_s)
        yield


@pytest.mark.slow
def test_idle_connections_cost_no_sample_and_keep_no_viewer_out(tmp_path: Path) -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    settings, state = tmp_path / "config.toml", tmp_path / "state" / "a.state"
    settings.write_text("[state]\nsave_period_s = 2.0\n")
    words = ("--id", "a", "--config", str(settings))
    with Daemon("sim", state.parent, *words) as daemon, MetricsViewer(daemon.endpoint) as metrics:
        calm = daemon.wait(lambda r: r.session.elapsed_s > CALM_S)
        before = resident_kb(daemon.process.pid)
        with idle(daemon.endpoint.removeprefix("tcp/")), idle(metrics.address, PAUSE_S):
            with Subscriber([daemon.endpoint]) as viewer:
                assert viewer.wait_report("a", timeout=60.0) is not None
            assert values(scraped(metrics.address))["imumon_up",] == 1.0
            saved = state.stat().st_mtime
            last = daemon.wait(lambda r: r.session.elapsed_s > calm.session.elapsed_s + 2.0 * CALM_S)
            assert state.stat().st_mtime > saved
            assert last.session.missing == calm.session.missing
            assert resident_kb(daemon.process.pid) - before < 40_000
            code, _, said = daemon.stop()
        assert code == 0, said
