"""Metrics: the newest reports as numbers for Prometheus, over HTTP or in a file.

A scrape is answered from the reports that are there, so it waits for no daemon. An unknown number has no sample: a gap
in a graph, never 0. Counters restart with the record, which Prometheus recognises.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from imumon.model.coefficients import SCALE
from imumon.model.errors import ImumonError, why
from imumon.model.messages import EVENT_LEVELS
from imumon.model.report import Report
from imumon.model.samples import TEMPERATURE
from imumon.model.system_errors import cure_of_writing

if TYPE_CHECKING:
    from prometheus_client.metrics_core import Metric
    from prometheus_client.registry import CollectorRegistry


class MetricsError(ImumonError):
    """The metrics cannot be served or written."""


@dataclass(frozen=True, slots=True)
class Observed:
    """What is known of one device now.

    Attributes
    ----------
    age_s : s since the newest report.
    events : number of events by kind; a kind that is not there did not occur.
    rival : two programs publish the device: these numbers may be those of the other one.
    """

    report: Report
    age_s: float
    events: Mapping[str, int]
    rival: bool = False


class Metrics:
    """The metrics of devices, as a collector of prometheus_client.

    Parameters
    ----------
    observe : returns what is known of each device at the moment.
    """

    def __init__(self, observe: Callable[[], Iterable[Observed]]) -> None:
        self._observe = observe

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics, each with the samples of all devices; prometheus_client calls it for every scrape."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        metrics: dict[str, Any] = {}
        for observed in self._observe():
            rows_of_families = _gauges(observed), _counters(observed)
            for family, rows in zip((GaugeMetricFamily, CounterMetricFamily), rows_of_families, strict=True):
                for name, text, labels, samples in rows:
                    metric = metrics.setdefault(name, family(name, text, labels=["device", *labels]))
                    for *words, value in samples:
                        metric.add_metric([observed.report.device.id, *words], value)
        yield from metrics.values()

    def serve(self, host: str, port: int) -> None:
        """Serve ``http://HOST:PORT/metrics`` in threads until the process ends.

        Raises
        ------
        MetricsError : ``metrics_not_served``, the address is in use or not of this machine.
        """
        from prometheus_client import start_http_server

        try:
            start_http_server(port, host, self._registry())
        except (OSError, OverflowError) as error:  # the latter: no such port
            reason = why(error) if isinstance(error, OSError) else "no such port"
            cure = cure_of_writing(error, "choose another address with --listen")
            raise MetricsError("metrics_not_served", f"{host}:{port}: {reason}", cure) from None

    def write(self, path: str) -> None:
        """Replace a file atomically by the present metrics.

        Raises
        ------
        MetricsError : ``metrics_not_written``.
        """
        from prometheus_client import write_to_textfile

        try:
            write_to_textfile(path, self._registry())
        except OSError as error:
            cure = cure_of_writing(error, "give another --file")
            raise MetricsError("metrics_not_written", f"{path}: {why(error)}", cure) from None

    def _registry(self) -> CollectorRegistry:
        from prometheus_client import CollectorRegistry

        registry = CollectorRegistry(auto_describe=False)
        registry.register(self)
        return registry


Rows: TypeAlias = Iterator[tuple[str, str, tuple[str, ...], list[tuple[Any, ...]]]]
"""Name, help text and labels of metrics, and their samples: a word for each label, and the value."""


def _counters(observed: Observed) -> Rows:
    session = observed.report.session
    yield "imumon_samples", "Samples received in the record", (), [(session.samples,)]
    text = "Samples that the sample clock proves and that did not arrive"
    yield "imumon_missing", text, (), [(session.missing,)]
    text = "Received samples that the guards excluded"
    yield "imumon_excluded_seconds", text, (), [(session.excluded_s,)]
    yield "imumon_bad_checksums", "Messages that failed their checksum", (), [(session.bad_checksums,)]
    # each known kind from 0 on: Prometheus does not see the growth of a counter that begins at 1
    events = [(kind, observed.events.get(kind, 0)) for kind in sorted(EVENT_LEVELS)]
    yield "imumon_events", "Events that were received", ("kind",), events


def _gauges(observed: Observed) -> Rows:
    report, age_s = observed.report, observed.age_s
    channels = report.channels.items()
    yield "imumon_rival", "1 if two programs publish the device, else 0", (), [(float(observed.rival),)]
    text = "Whether the sensor sends samples and its daemon reports them: 1, or 0"
    up = report.state == "running" and age_s <= report.late_s
    yield "imumon_up", text, (), [(float(up),)]
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
        (sensor, name, float(grade.meets == name)) for sensor, grade in report.grade.items() for name in SCALE
    ]
    yield "imumon_grade", text, ("sensor", "grade"), grades
    temperature = report.channels.get(TEMPERATURE)
    if temperature is not None and temperature.last is not None:
        text = "Newest temperature of the sensor"
        yield "imumon_temperature_celsius", text, (), [(temperature.last,)]
    caveats = [(name, caveat, 1.0) for name, channel in channels for caveat in channel.caveats]
    yield "imumon_caveat", "1 for each caveat of a channel", ("channel", "caveat"), caveats
    text = "1 for an alarm whose value is above its limit, 0 for the others"
    alarms = [] if report.session.recent_loss is None else [("loss", float(report.is_lossy))]
    yield "imumon_alarm", text, ("alarm",), alarms
