"""A real `imumon metrics` in a process of its own, and its metrics as Prometheus reads them."""

from __future__ import annotations

import os
import signal
import urllib.request
from pathlib import Path

from forked import Forked
from free_ports import free_port
from prometheus_client.parser import text_string_to_metric_families


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
        errors, errors_end = os.pipe()
        with open(os.devnull, "r+") as nothing:
            streams = (nothing.fileno(), nothing.fileno(), errors_end)
            self._process = Forked(("metrics", *where, "--connect", endpoint, *words), streams)
        os.close(errors_end)
        self._errors = os.fdopen(errors)

    def __enter__(self) -> MetricsViewer:
        if self._listens:
            assert self.address in self._errors.readline()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGTERM)
        self._process.wait(60)
        with self._errors:
            assert "Traceback" not in self._errors.read()


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
