"""Metrics of a daemon, as Prometheus reads them."""

from __future__ import annotations

import urllib.request

from prometheus_client.parser import text_string_to_metric_families


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
