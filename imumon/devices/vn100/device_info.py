"""Device information of a VN-100, from its registers and its stream."""

from __future__ import annotations

import re

from imumon.devices.vn100 import registers
from imumon.devices.vn100.registers import DATA_REGISTERS, REGISTERS, RegisterNumber
from imumon.devices.vn100.stream_settings import OFF, Texts, alias_factors, parse_output, source
from imumon.samples import ALIASED, DeviceInfo, Stream

FAMILY = "VN-100"
"""Family of a sensor that does not say its model."""
PROTOCOL = "its messages and registers are read as those of a VN-100"


def family_of(model: str | None) -> str:
    """Return the family of a model.

    >>> family_of("VN-100T-CR"), family_of("VN-210-CR"), family_of("?"), family_of(None)
    ('VN-100', 'VN-210', 'VN-100', 'VN-100')
    """
    found = re.match(r"VN-?(\d{3})", (model or "").upper())
    return f"VN-{found[1]}" if found else FAMILY


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
    factors: dict[str, float | None] = {"gyro": None, "accel": None}
    if stream is not None:
        factors = alias_factors(stream.kind_of, rate, settings.get(RegisterNumber.IMU_FILTER))
    worst = None if None in factors.values() else max(filter(None, factors.values()))
    model, serial = identity.get(1), identity.get(3)
    family = family_of(model)
    control = _delta_control(settings, stream)
    unknown = {
        "listen-only: model, serial number and settings are unknown": not identity,
        "the filter or the rate of the sensor is unknown: aliasing may inflate N": bool(facts)
        and worst is None,
        f"the sensor is a {model}: {PROTOCOL}": family != FAMILY,
        f"register {RegisterNumber.DELTA_CONTROL} is unknown: the deltas may be compensated": control is None,
    }
    caveats = {
        "compensated": facts.get("stream") == "compensated" or (control or "").strip("0,") != "",
        "unknown_compensation": control is None,
        "aliased": worst is not None and worst > ALIASED,
    }
    facts["caveats"] = tuple(name for name, holds in caveats.items() if holds)
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
        alias_factor=worst,
        settings={name: settings[r] for r, name in names.items()},
        data_settings=tuple(name for r, name in names.items() if r in DATA_REGISTERS),
        remarks=(*remarks, *(remark for remark, holds in unknown.items() if holds)),
        **facts,
    )


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
    for register in registers.BINARY_OUTPUTS:
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
