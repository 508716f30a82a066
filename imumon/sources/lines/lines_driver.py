"""Driver of sensors that print numbers: the interface for other packages, through the registry."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from ipaddress import ip_address
from typing import Any
from urllib.parse import parse_qsl

from imumon.model.samples import FASTEST_HZ, SLOWEST_HZ
from imumon.sources.device import (
    Check,
    Device,
    DeviceDriver,
    DeviceOptions,
    InvalidOption,
    Observation,
    RawDecoder,
)
from imumon.sources.lines.line_columns import SENSORS, LinesUrl, columns_of, read_options
from imumon.sources.ports import BAUD_RATES, FROM

FILTER = "Lines do not say how the sensor filters: see the settings that its program writes."
PARAMETERS = ("columns", "map", "accept", *SENSORS, "baud", "rate", "id", "from")
URL_CURE = "write lines:/dev/ttyACM0, lines:tcp://HOST:PORT, lines:udp://:PORT or lines:-"


class LinesDriver(DeviceDriver):
    """Lines of numbers on a serial port, TCP, UDP or standard input."""

    scheme = "lines"
    title = "sensor that prints lines"
    settings = frozenset({"baud", "rate_hz", "listen_only"})  # it never writes

    def create(self, options: DeviceOptions) -> Device:
        from imumon.sources.lines.lines_device import LinesDevice

        return LinesDevice(options, parse_url(options.url, options.settings))

    def decoder(self, settings: Mapping[str, str] | None = None) -> RawDecoder:
        from imumon.sources.lines.line_decoder import LineDecoder

        return LineDecoder(settings or {})

    def checks(self, observation: Observation, settings: Any) -> Iterator[Check]:
        yield Check("model", "ok", f"columns {observation.info.settings.get('columns', 'not known yet')}")
        for remark in observation.info.remarks:
            cure = "see docs/SENSORS.md: columns=, units and baud= of the URL"
            yield Check("lines", "warning", remark, cure)

    def filter_advice(self, rate_hz: float | None) -> Mapping[str, str]:
        return {"unknown": FILTER}


def parse_url(url: str, device: Any = None) -> LinesUrl:
    """Return the parts of a URL; `device` is the table of settings, which apply where the URL says nothing.

    >>> parse_url("lines:tcp://10.0.0.7:4000?gyro=deg/s&rate=100").path
    'tcp://10.0.0.7:4000'

    Raises
    ------
    InvalidOption : it is wrong.
    """
    path, _, query = url.partition(":")[2].partition("?")
    # `parse_qsl` reads a plus as a blank; in rate=1e+2 it is one
    given = dict(parse_qsl(query.replace("+", "%2B"), keep_blank_values=True))
    if unknown := [name for name in given if name not in PARAMETERS]:
        cure = f"there are {', '.join(PARAMETERS)}"
        raise InvalidOption("lines_parameter_unknown", f"{url} has an unknown parameter {unknown[0]!r}", cure)
    if not path:
        raise InvalidOption("lines_url_invalid", f"{url} names no port", URL_CURE)
    known = getattr(device, "baud", "auto")
    baud = given.get("baud", str(BAUD_RATES[0] if known == "auto" else known))
    rate = given.get("rate", str(getattr(device, "rate_hz", 0.0) or ""))
    if not baud.isdigit() or not 0 < int(baud) < 1e8:
        raise InvalidOption("lines_url_invalid", f"{baud!r} is no baud rate", "write for example baud=115200")
    settings = {name: given[name] for name in ("columns", "map", "accept", *SENSORS) if name in given}
    read_options(settings, None)
    if "columns" in settings:
        columns_of(settings)
    name = re.sub(r"[^a-z0-9]+", "-", path.removeprefix("/dev/").lower()).strip("-") or "stdin"
    if "from" in given:
        path = f"{path}{FROM}{_sender(path, given['from'])}"
    return LinesUrl(
        path, int(baud), _rate(rate) if rate else None, given.get("id") or f"lines-{name}", settings
    )


def _sender(path: str, text: str) -> str:
    """Return the address from which the lines of a port for datagrams come."""
    with suppress(ValueError):
        if path.startswith("udp:"):
            return str(ip_address(text))
    cure = "write for example lines:udp://0.0.0.0:4000?from=192.168.1.20"
    raise InvalidOption("lines_url_invalid", f"from={text} is no address of a sender of datagrams", cure)


def _rate(text: str) -> float:
    try:
        rate_hz = float(text)
    except ValueError:
        rate_hz = 0.0
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise InvalidOption("lines_url_invalid", f"{text!r} is no sample rate", "write for example rate=100")
    return rate_hz
