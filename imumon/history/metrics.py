"""Metrics: the newest report as numbers for Prometheus, over HTTP.

The server answers in threads of its own from the last report, so a scrape never waits for the loop of the daemon. An
unknown number has no sample: a gap in a graph, never 0. Counters restart with the record, which Prometheus
recognises.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

from imumon.alarms import known
from imumon.errors import ImumonError, why
from imumon.messages import EVENT_LEVELS
from imumon.report import GRADES, Event, Report

if TYPE_CHECKING:
    from prometheus_client.metrics_core import Metric

PORTS = 16
"""Ports that are tried, from the configured one on: other daemons on this machine have the first."""
REQUEST_S = 5.0
"""s that a client may take for its request."""


class MetricsError(ImumonError):
    """The metrics cannot be served."""


class MetricsServer:
    """Serve the metrics of one device on ``http://HOST:PORT/metrics``.

    Parameters
    ----------
    listen : host and port, such as ``127.0.0.1:9847``.

    Attributes
    ----------
    address : where it listens, as host and port.

    Raises
    ------
    MetricsError : ``metrics_not_served``, the address is not of this machine, or all `PORTS` are in use.
    """

    def __init__(self, listen: str) -> None:
        from prometheus_client import CollectorRegistry, start_http_server

        self._report: Report | None = None
        self._arrived = time.monotonic()
        # each known kind from 0 on: Prometheus does not see the growth of a counter that begins at 1
        self._events: Counter[str] = Counter(dict.fromkeys(EVENT_LEVELS, 0))
        registry = CollectorRegistry(auto_describe=False)
        registry.register(self)
        host, _, port = listen.rpartition(":")
        host, reason = host.strip("[]"), ""
        for number in range(int(port), min(int(port) + PORTS, 65536)):
            try:
                self._server, self._thread = start_http_server(number, host, registry)
            except OSError as error:
                reason = why(error)
                continue
            self._server.socket.listen()  # the server has let 5 clients wait; further ones tried again after 1 s
            if handler := getattr(self._server, "RequestHandlerClass", None):
                handler.timeout = REQUEST_S
            # a client that stops in its request is no fault of the daemon: the server would print a traceback
            setattr(self._server, "handle_error", lambda request, client: None)  # noqa: B010
            self.address = f"{host}:{number}"
            return
        message = f"metrics cannot be served on {listen} or the next {PORTS - 1} ports: {reason}"
        raise MetricsError("metrics_not_served", message, "choose another address for metrics.listen")

    def update(self, report: Report) -> None:
        """Serve this report from now on."""
        self._report, self._arrived = report, time.monotonic()

    def event(self, event: Event) -> None:
        """Count an event."""
        self._events[event.kind] += 1

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics; the server calls it for every request."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        report, events = self._report, dict(self._events)
        if report is None:
            return
        made = (
            (GaugeMetricFamily, _gauges(report, time.monotonic() - self._arrived)),
            (CounterMetricFamily, _counters(report, events)),
        )
        for family, rows in made:
            for name, text, labels, samples in rows:
                metric = family(name, text, labels=["device", *labels])
                for *words, value in samples:
                    metric.add_metric([report.device.id, *words], value)
                yield metric


Rows: TypeAlias = Iterator[tuple[str, str, tuple[str, ...], list[tuple[Any, ...]]]]
"""Name, help text and labels of metrics, and their samples: a word for each label, and the value."""


def _counters(report: Report, events: Mapping[str, int]) -> Rows:
    session = report.session
    yield "imumon_samples", "Samples received in the record", (), [(session.samples,)]
    text = "Samples that the sample clock proves and that did not arrive"
    yield "imumon_missing", text, (), [(session.missing,)]
    text = "Received samples that the guards excluded"
    yield "imumon_excluded_seconds", text, (), [(session.excluded_s,)]
    yield "imumon_bad_checksums", "Messages that failed their checksum", (), [(session.bad_checksums,)]
    yield "imumon_events", "Events since the start of the daemon", ("kind",), sorted(events.items())


def _gauges(report: Report, age_s: float) -> Rows:
    channels = report.channels.items()
    text = "Whether the sensor sends samples: 1, or 0"
    yield "imumon_up", text, (), [(float(report.state == "running"),)]
    yield "imumon_report_age_seconds", "Age of the report that these numbers are from", (), [(age_s,)]
    text = "Noise coefficients in SI units with their 95 percent limits; an upper bound has no value"
    noise = [
        (name, letter, limit, value)
        for name, channel in channels
        for letter, part in channel.coefficients.items()
        for limit in ("value", "low", "high")
        if (value := getattr(part, limit)) is not None
    ]
    yield "imumon_noise", text, ("channel", "coefficient", "limit"), noise
    means = [(name, channel.mean) for name, channel in channels if channel.mean is not None]
    yield "imumon_mean", "Mean of a channel in its SI unit", ("channel",), means
    text = "1 for the grade of a sensor, 0 for the others"
    grades = [
        (sensor, kind, name, float(getattr(grade, kind) == name))
        for sensor, grade in report.grade.items()
        for kind in ("nearest", "meets")
        for name in GRADES
    ]
    yield "imumon_grade", text, ("sensor", "kind", "grade"), grades
    temperature = report.channels.get("temperature")
    if temperature is not None and temperature.last is not None:
        text = "Newest temperature of the sensor"
        yield "imumon_temperature_celsius", text, (), [(temperature.last,)]
    caveats = [(name, caveat, 1.0) for name, channel in channels for caveat in channel.caveats]
    yield "imumon_caveat", "1 for each caveat of a channel", ("channel", "caveat"), caveats
    text = "1 for an alarm whose value is above its limit, 0 for the others"
    alarms = [(row.name, float(value > limit)) for row, value, limit in known(report)]
    yield "imumon_alarm", text, ("alarm",), alarms
