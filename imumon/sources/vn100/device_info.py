"""Device information of a VN-100, from its registers and its stream."""

from __future__ import annotations

import re
from collections.abc import Iterator

from imumon.model.samples import ALIASED, DeviceInfo, Stream
from imumon.sources.vn100 import registers
from imumon.sources.vn100.registers import DATA_REGISTERS, REGISTERS, RegisterNumber
from imumon.sources.vn100.stream_settings import OFF, Texts, alias_factors, parse_output, source

FAMILY = "VN-100"
"""Family of a sensor that does not say its model."""
PROTOCOL = "its messages and registers are read as those of a VN-100"


def family_of(model: str | None) -> str:
    """Return the family of a model.

    >>> family_of("VN-100T-CR"), family_of("VN-210-CR"), family_of("?"), family_of(None)
    ('VN-100', 'VN-210', 'VN-100', 'VN-100')
    """
    match = re.match(r"VN-?(\d{3})", (model or "").upper())
    return f"VN-{match[1]}" if match else FAMILY


def device_info(
    port: str,
    baud: int | None,
    identity: Texts,
    settings: Texts,
    stream: Stream | None,
    rate_hz: float | None,
    remarks: tuple[str, ...],
) -> DeviceInfo:
    """Return what is known of the sensor.

    Parameters
    ----------
    port, baud : of the sensor; baud None where it has no effect.
    identity : registers 1 to 4, empty if they were not read.
    settings : registers that change the data.
    stream : the stream that is characterised; None before its first sample.
    rate_hz : Hz, its rate if that is known from elsewhere.
    remarks : to include.
    """
    facts = {} if stream is None else stream.facts
    rate = nominal_rate(settings, stream) or rate_hz
    factor = _alias_factor(settings, stream, rate)
    model, serial = identity.get(1), identity.get(3)
    family = family_of(model)
    control = _delta_control(settings, stream)
    facts["caveats"] = tuple(_caveats(stream, factor, control))
    doubts = _doubts(identity, stream, factor, control)
    names = {r: f"{r} {REGISTERS[r].name}" for r in sorted(settings)}
    return DeviceInfo(
        id=f"{family.lower().replace('-', '')}-{serial or _slug(port)}",
        kind=family,
        model=model,
        serial=serial,
        firmware=identity.get(4),
        port=port,
        baud=baud,
        sample_rate_hz=rate,
        alias_factor=factor,
        settings={name: settings[r] for r, name in names.items()},
        data_settings=tuple(name for r, name in names.items() if r in DATA_REGISTERS),
        remarks=(*remarks, *doubts),
        **facts,
    )


def _alias_factor(settings: Texts, stream: Stream | None, rate_hz: float | None) -> float | None:
    """Return the larger alias factor of gyroscope and accelerometer; None if one is unknown, or without a stream."""
    if stream is None:
        return None
    factors = alias_factors(stream.kind_of, rate_hz, settings.get(RegisterNumber.IMU_FILTER)).values()
    return None if None in factors else max(filter(None, factors))


def _caveats(stream: Stream | None, alias_factor: float | None, control: str | None) -> Iterator[str]:
    """Yield the caveats of the stream; `control` is that of `_delta_control`."""
    # any field of register 82 but 0 compensates the deltas, or turns them out of the frame of the sensor
    if (stream is not None and stream.kind == "compensated") or (control or "").strip("0,"):
        yield "compensated"
    if control is None:
        yield "unknown_compensation"
    if alias_factor is not None and alias_factor > ALIASED:
        yield "aliased"


def _doubts(
    identity: Texts, stream: Stream | None, alias_factor: float | None, control: str | None
) -> Iterator[str]:
    """Yield what is unknown of the sensor, as remarks."""
    if not identity:
        yield "listen-only: model, serial number and settings are unknown"
    if stream is not None and alias_factor is None:
        yield "the filter or the rate of the sensor is unknown: aliasing may inflate N"
    if family_of(identity.get(1)) != FAMILY:
        yield f"the sensor is a {identity[1]}: {PROTOCOL}"
    if control is None:
        yield f"register {RegisterNumber.DELTA_CONTROL} is unknown: the deltas may be compensated"


def _delta_control(settings: Texts, stream: Stream | None) -> str | None:
    """Return how the sensor compensates increments; empty if the stream has none, None: unknown."""
    return settings.get(RegisterNumber.DELTA_CONTROL) if stream and any(stream.averaged) else ""


def nominal_rate(settings: Texts, stream: Stream | None) -> float | None:
    """Return the rate of a stream by the settings, Hz; None if they do not contain it."""
    if stream is None:
        return None
    if stream.source.startswith("$"):
        text = settings.get(RegisterNumber.OUTPUT_RATE, "")
        return float(text) or None if text.isdigit() else None
    for register in registers.BINARY_OUTPUTS:  # several may be on: the one whose packets these samples are
        text = settings.get(register, OFF)
        parsed = parse_output(text)
        if parsed is not None and parsed[1] and source(text) == stream.source:
            return registers.LOOP_RATE / parsed[1]
    return None


def _slug(port: str) -> str:
    """Return the name of a port in a form that a key may contain.

    >>> _slug("/dev/ttyUSB0"), _slug("socket://10.0.0.2:4001")
    ('ttyusb0', '10-0-0-2-4001')
    """
    return re.sub(r"[^a-z0-9]+", "-", port.rsplit("://")[-1].removeprefix("/dev/").lower()).strip("-")
