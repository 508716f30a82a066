"""Metrics: the newest report as numbers for Prometheus, over HTTP.

The server answers in threads of its own from the last report, so a scrape never waits for the loop of the daemon. An
unknown number has no sample: a gap in a graph, never 0. Counters restart with the record, which Prometheus
recognises.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from imumon.alarms import known
from imumon.errors import ImumonError
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
        self._device = ""
        registry = CollectorRegistry(auto_describe=False)
        registry.register(self)
        host, _, port = listen.rpartition(":")
        host, reason = host.strip("[]"), ""
        for number in range(int(port), min(int(port) + PORTS, 65536)):
            try:
                self._server, self._thread = start_http_server(number, host, registry)
            except OSError as error:
                reason = (error.strerror or str(error)).lower()
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
        self._report, self._arrived, self._device = report, time.monotonic(), report.device.id

    def event(self, event: Event) -> None:
        """Count an event."""
        self._events[event.kind] += 1

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics; the server calls it for every request."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        report, device, events = self._report, self._device, dict(self._events)
        if report is None:
            return
        age_s = time.monotonic() - self._arrived

        def gauge(name: str, text: str, *labels: str) -> Any:
            return GaugeMetricFamily(name, text, labels=["device", *labels])

        def counter(name: str, text: str, *labels: str) -> Any:
            return CounterMetricFamily(name, text, labels=["device", *labels])

        up = gauge("imumon_up", "Whether the sensor sends samples: 1, or 0")
        up.add_metric([device], 1.0 if report.state == "running" else 0.0)
        yield up
        age = gauge("imumon_report_age_seconds", "Age of the report that these numbers are from")
        age.add_metric([device], age_s)
        yield age
        session = report.session
        for name, text, value in (
            ("imumon_samples", "Samples received in the record", session.samples),
            (
                "imumon_missing",
                "Samples that the sample clock proves and that did not arrive",
                session.missing,
            ),
            ("imumon_excluded_seconds", "Received samples that the guards excluded", session.excluded_s),
            ("imumon_bad_checksums", "Messages that failed their checksum", session.bad_checksums),
        ):
            total = counter(name, text)
            total.add_metric([device], value)
            yield total
        yield from self._noise(report, device, gauge)
        yield self._grades(report, device, gauge)
        temperature = report.channels.get("temperature")
        if temperature is not None and temperature.last is not None:
            heat = gauge("imumon_temperature_celsius", "Newest temperature of the sensor")
            heat.add_metric([device], temperature.last)
            yield heat
        caveats = gauge("imumon_caveat", "1 for each caveat of a channel", "channel", "caveat")
        for name, channel in report.channels.items():
            for caveat in channel.caveats:
                caveats.add_metric([device, name, caveat], 1.0)
        yield caveats
        alarm = gauge(
            "imumon_alarm", "1 for an alarm whose value is above its limit, 0 for the others", "alarm"
        )
        for row, value, limit in known(report):
            alarm.add_metric([device, row.name], float(value > limit))
        yield alarm
        happened = counter("imumon_events", "Events since the start of the daemon", "kind")
        for kind, count in sorted(events.items()):
            happened.add_metric([device, kind], count)
        yield happened

    def _noise(self, report: Report, device: str, gauge: Any) -> Iterator[Metric]:
        noise = gauge(
            "imumon_noise",
            "Noise coefficients in SI units with their 95 percent limits; an upper bound has no value",
            "channel",
            "coefficient",
            "limit",
        )
        mean = gauge("imumon_mean", "Mean of a channel in its SI unit", "channel")
        for name, channel in report.channels.items():
            if channel.mean is not None:
                mean.add_metric([device, name], channel.mean)
            for letter, part in channel.coefficients.items():
                for limit in ("value", "low", "high"):
                    if (value := getattr(part, limit)) is not None:
                        noise.add_metric([device, name, letter, limit], value)
        yield noise
        yield mean

    def _grades(self, report: Report, device: str, gauge: Any) -> Metric:
        grades = gauge(
            "imumon_grade", "1 for the grade of a sensor, 0 for the others", "sensor", "kind", "grade"
        )
        for sensor, grade in report.grade.items():
            for kind in ("nearest", "meets"):
                for name in GRADES:
                    grades.add_metric([device, sensor, kind, name], float(getattr(grade, kind) == name))
        found: Metric = grades
        return found
