"""Connections that say nothing, to a daemon and to its metrics, and what they cost."""

from __future__ import annotations

import resource
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from daemons import Daemon
from metrics_viewer import MetricsViewer
from scraping import scraped, values
from usage import resident_kb

from imumon.bus import Subscriber

SAVE_S = 2.0
"""Period in which the daemon saves its state, s."""
CALM_S = 8.0
"""s of the record before and after the connections are opened."""
PAUSE_S = 0.002
"""s between two connections to the metrics: of many at once, its short queue accepts only some."""


@dataclass
class Cost:
    """What the connections have cost.

    Attributes
    ----------
    lost : samples that the clock of the sensor proves.
    save_s : longest time since the last save, s.
    viewer_s, metrics_s : until a new viewer, and a scrape, are answered after the connections are open, s.
    memory_mb, metrics_mb : that daemon and metrics take more than before, MB.
    end_s : from SIGTERM to the end of the daemon, with all connections open, s.
    """

    lost: int = 0
    save_s: float = 0.0
    viewer_s: float = 0.0
    metrics_s: float = 0.0
    memory_mb: float = 0.0
    metrics_mb: float = 0.0
    end_s: float = 0.0


@contextmanager
def idle(address: str, count: int, pause_s: float = 0.0) -> Iterator[None]:
    """Open so many connections to ``HOST:PORT``, all at once or with a pause between two, and keep them open."""
    host, _, port = address.rpartition(":")
    with ExitStack() as stack:
        for _ in range(count):
            client = stack.enter_context(socket.socket())
            client.setblocking(False)
            client.connect_ex((host, int(port)))
            time.sleep(pause_s)
        yield


def cost(folder: Path, count: int) -> Cost:
    """Return what `count` connections to the Zenoh port, and as many to `imumon metrics`, cost."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    settings, figures = folder / "config.toml", Cost()
    settings.write_text(f"[state]\nsave_period_s = {SAVE_S}\n")
    words = ("--id", "a", "--config", str(settings))
    with Daemon("sim", folder / "state", *words) as daemon, MetricsViewer(daemon.endpoint) as metrics:
        calm = daemon.wait(lambda r: r.session.elapsed_s > CALM_S)
        before = [resident_kb(process.pid) for process in (daemon.process, metrics.process)]
        with idle(daemon.endpoint.removeprefix("tcp/"), count), idle(metrics.address, count, PAUSE_S):
            figures.viewer_s = _until_a_viewer_is_answered(daemon.endpoint)
            figures.metrics_s = _until_metrics_are_answered(metrics.address)
            last = daemon.samples()
            while last.session.elapsed_s < calm.session.elapsed_s + 2.0 * CALM_S:
                figures.save_s = max(figures.save_s, time.time() - _saved_at(folder / "state"))
                time.sleep(0.05)
                last = daemon.samples()
            now = [resident_kb(process.pid) for process in (daemon.process, metrics.process)]
            figures.memory_mb, figures.metrics_mb = ((b - a) / 1e3 for a, b in zip(before, now, strict=True))
            figures.lost = last.session.missing - calm.session.missing
            begin = time.monotonic()
            code, _, said = daemon.stop()
            figures.end_s = time.monotonic() - begin
        assert code == 0, said
    return figures


def _until_a_viewer_is_answered(endpoint: str) -> float:
    begin = time.monotonic()
    with Subscriber([endpoint]) as viewer:
        assert viewer.wait_report("a", timeout=60.0) is not None
    return time.monotonic() - begin


def _until_metrics_are_answered(address: str) -> float:
    begin = time.monotonic()
    while time.monotonic() - begin < 60.0:
        with suppress(OSError):
            assert values(scraped(address))["imumon_up",] == 1.0
            return time.monotonic() - begin
    raise AssertionError("the metrics are not answered")


def _saved_at(directory: Path) -> float:
    """Return when the state was saved, s since 1970; between two renames, that before is the newest."""
    times = []
    for path in (directory / "a.state", directory / "a.state.1"):
        with suppress(OSError):
            times.append(path.stat().st_mtime)
    return max(times)
