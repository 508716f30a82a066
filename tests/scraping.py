"""Metrics of a daemon, as Prometheus reads them."""

from __future__ import annotations

import socket
import urllib.request

from prometheus_client.parser import text_string_to_metric_families


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


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
