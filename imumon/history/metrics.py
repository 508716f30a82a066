"""Metrics: the newest report as numbers for Prometheus, over HTTP.

The server answers in threads of its own from the last report, so a scrape never waits for the loop of the daemon. An
unknown number has no sample: a gap in a graph, never 0. Counters restart with the record, which Prometheus
recognises.

Whoever reaches the port may connect, so that connections, the time and the bytes of a request, and the rate of
requests are bounded (`imumon.door_limits`). What a client does costs the daemon at most `connections` threads with
`REQUEST_BYTES` each, and `RATE_HZ` replies.
"""

from __future__ import annotations

import io
import logging
import re
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from socketserver import ThreadingMixIn
from typing import TYPE_CHECKING, Any, TypeAlias
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

from imumon.alarms import known
from imumon.coefficients import GRADES
from imumon.config.settings import LimitSettings
from imumon.door_limits import OpenConnections, Pace, within_files
from imumon.errors import ImumonError, why
from imumon.messages import EVENT_LEVELS
from imumon.report import Event, Report

if TYPE_CHECKING:
    from prometheus_client.metrics_core import Metric

PORTS = 16
"""Ports that are tried, from the configured one on: other daemons on this machine have the first."""
REQUEST_BYTES = 16384
"""Bytes of the head of a request at most; that of Prometheus has 500."""
RATE_HZ = 50.0
"""Connections per second over a longer time. A reply takes about 3 ms of one core, which the daemon has to share."""
POLL_S = 0.5
"""s after which the server looks for connections whose deadline is over."""
RETRY_S = 0.2
"""s after which a connection is accepted again that found no free descriptor."""
NOTICE_S = 3600.0
"""s between two log lines on clients that were closed."""

log = logging.getLogger(__name__)


class MetricsError(ImumonError):
    """The metrics cannot be served."""


class MetricsServer:
    """Serve the metrics of one device on ``http://HOST:PORT/metrics``.

    Parameters
    ----------
    listen : host and port, such as ``127.0.0.1:9847``.
    limits : of connections and requests; None: the defaults.

    Attributes
    ----------
    address : where it listens, as host and port.

    Raises
    ------
    MetricsError : ``metrics_not_served``, the address is not of this machine, or all `PORTS` are in use.
    """

    def __init__(self, listen: str, limits: LimitSettings | None = None) -> None:
        from prometheus_client import CollectorRegistry, make_wsgi_app
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        self._families = GaugeMetricFamily, CounterMetricFamily
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
                self._server = _BoundedServer(host, number, limits or LimitSettings())
            except OSError as error:
                reason = why(error)
                continue
            self._server.set_app(make_wsgi_app(registry))
            serve = self._server.serve_forever
            threading.Thread(target=serve, args=(POLL_S,), name="imumon-metrics", daemon=True).start()
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
        report, events = self._report, dict(self._events)
        if report is None:
            return
        rows_of_families = _gauges(report, time.monotonic() - self._arrived), _counters(report, events)
        for family, rows in zip(self._families, rows_of_families, strict=True):
            for name, text, labels, samples in rows:
                metric = family(name, text, labels=["device", *labels])
                for *words, value in samples:
                    metric.add_metric([report.device.id, *words], value)
                yield metric


class _BoundedServer(ThreadingMixIn, WSGIServer):
    """Server with a thread for each connection, and limits for all of them."""

    daemon_threads = True  # one that waits for its client must not delay the end of the daemon

    def __init__(self, host: str, port: int, limits: LimitSettings) -> None:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        self.address_family = family
        self._open = OpenConnections[socket.socket](
            within_files(limits.connections), limits.request_s, _shut_down
        )
        self._pace = Pace(RATE_HZ, burst=limits.connections)
        self._said: float | None = None  # when the last log line was written, s
        super().__init__(address[:2], _BoundedHandler)  # type: ignore[arg-type]
        # clients that wait, cost nothing there: the server has let 5 wait, and further ones tried again after 1 s
        self.socket.listen()

    def server_bind(self) -> None:
        """Bind, without asking for the name of the host, which may take long where there is no name server."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_name, self.server_port = self.socket.getsockname()[:2]
        self.setup_environ()

    def get_request(self) -> tuple[socket.socket, Any]:
        time.sleep(self._pace.wait_s(time.monotonic()))
        try:
            return super().get_request()
        except OSError:  # no descriptor: the connection waits, and the server would ask again at once
            time.sleep(RETRY_S)
            raise

    def process_request(self, request: Any, client_address: Any) -> None:
        self._open.add(request, time.monotonic())
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        self._open.discard(request)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Close what is late; the server calls this after each connection, and every `POLL_S`."""
        now = time.monotonic()
        self._open.expire(now)
        if (closed := self._open.closed) and (self._said is None or now - self._said > NOTICE_S):
            self._said, self._open.closed = now, 0
            log.warning("%s", f"metrics: {closed} clients that were too slow or too many are disconnected")

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a client that stops in its request: the server would print a traceback."""

    def server_close(self) -> None:
        super().server_close()
        self._open.close_all()


class _BoundedHandler(WSGIRequestHandler):
    """Handler that reads the head of a request, of bounded size, before it looks at it."""

    def handle(self) -> None:
        head = b""
        while not re.search(rb"\n\r?\n", head):
            data = self.connection.recv(4096)
            if not data or len(head) + len(data) > REQUEST_BYTES:
                return
            head += data
        self.rfile = io.BufferedReader(io.BytesIO(head))
        super().handle()

    def log_message(self, format: str, *words: Any) -> None:
        """Log no requests."""


def _shut_down(connection: socket.socket) -> None:
    """End a connection that a thread reads from or writes to; the thread closes it then."""
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


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
        for letter, part in channel.estimates.items()
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
