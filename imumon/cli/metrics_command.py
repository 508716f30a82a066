"""Command `imumon metrics`: the newest reports as numbers for Prometheus, over HTTP or in a file."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from typing import Any

from imumon.cli import options
from imumon.cli.options import Parser
from imumon.cli.output import print_message

FILE_PERIOD_S = 5.0
"""s between two replacements of the file: node_exporter reads it at each scrape, usually every 15 s."""


def add_metrics(parser: Parser) -> None:
    where = parser.add_mutually_exclusive_group()
    text = "address that Prometheus reads; default: listen of [metrics] in the settings, 127.0.0.1:9847"
    where.add_argument("--listen", type=options.address, metavar="ADDRESS:PORT", help=text)
    text = "write this file instead, for the textfile collector of node_exporter; its name ends in .prom"
    where.add_argument("--file", type=options.file_name, metavar="PATH", help=text)
    text = "device, repeatable; the beginning of its name is enough; default: all"
    parser.add_argument("--id", action="append", metavar="NAME", help=text)


def metrics(arguments: argparse.Namespace) -> int:
    """Serve or write the metrics until a signal ends the process."""
    from imumon.history.metrics import Metrics

    names, arguments.id = arguments.id or [""], None  # the subscriber takes all devices, with one session
    overrides = {"metrics.listen": arguments.listen, "metrics.file": arguments.file}
    settings = options.settings(arguments, overrides).metrics
    file = "" if arguments.listen else settings.file
    with options.subscriber(arguments) as subscriber:
        metrics = Metrics(lambda: _observed(subscriber, names))
        if not file:
            host, _, port = settings.listen.rpartition(":")
            metrics.serve(host.strip("[]"), int(port))
            print_message(f"metrics on http://{settings.listen}/metrics; end with ctrl+c")
        while True:
            if file:
                metrics.write(file)
            time.sleep(FILE_PERIOD_S)


def _observed(subscriber: Any, names: list[str]) -> Iterator[Any]:
    """Yield what is known of each device whose name begins with one of `names`."""
    from imumon.history.metrics import Observed

    now, rivals = time.monotonic(), subscriber.rivals()
    for id, (report, arrived_s) in subscriber.reports().items():
        if id.startswith(tuple(names)):
            yield Observed(report, now - arrived_s, subscriber.event_counts(id), rival=id in rivals)
