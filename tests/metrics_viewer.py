"""A real `imumon metrics` in a process of its own, and its metrics as Prometheus reads them."""

from __future__ import annotations

import signal
import urllib.request
from pathlib import Path

from forked import Captured
from free_ports import free_port
from prometheus_client.parser import text_string_to_metric_families
from waiting import until


class MetricsViewer:
    """`imumon metrics` of the daemon on an endpoint, until the context is left.

    Parameters
    ----------
    file : to write; None: it listens on `address`, and does so when the context begins.
    """

    def __init__(self, endpoint: str, *words: str, file: Path | None = None) -> None:
        self.address = f"127.0.0.1:{free_port()}"
        where = ("--listen", self.address) if file is None else ("--file", str(file))
        self._listens = file is None
        self._process = Captured(("metrics", *where, "--connect", endpoint, *words))

    def __enter__(self) -> MetricsViewer:
        until(lambda: self.address in self._process.err or not self._listens)
        return self

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGTERM)
        self._process.wait(60)
        assert "Traceback" not in self._process.err


def scraped(address: str) -> str:
    with urllib.request.urlopen(f"http://{address}/metrics", timeout=60) as reply:
        return str(reply.read().decode())


def values(text: str) -> dict[tuple[str, ...], float]:
    """Values by name and labels without the device."""
    return {
        (
            sample.name,
            *(value for name, value in sorted(sample.labels.items()) if name != "device"),
        ): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }
