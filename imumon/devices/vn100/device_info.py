"""Facts of a VN-100 and its stream: what a report says of the device, and what cannot be known.

Settings are register values as text; a sensor that is only listened to has told none.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from imumon.devices.vn100.registers import (
    BINARY_OUTPUTS,
    DELTA_CONTROL,
    IMU_FILTER,
    LOOP_RATE,
    OUTPUT_RATE,
    REGISTERS,
)
from imumon.devices.vn100.stream_settings import OFF, Texts, alias_factors, parse_output, source
from imumon.samples import Kind, Stream


@dataclass(frozen=True, slots=True, kw_only=True)
class Vn100Info:
    """What is known of the sensor and its stream; None is unknown, and `remarks` say why.

    Attributes
    ----------
    stream : kind of the samples; None before the first one of a sensor that is only listened to.
    sample_rate_hz : nominal, from the sensor's settings.
    alias_factor : by how much the sensor's filter inflates N, the worse of gyroscope and
        accelerometer; `alias_factors` has both.
    settings : registers that change the data, ``"85 IMU filtering"`` to its text.
    caveats : ``compensated``, ``unknown_compensation`` (increments of which nobody knows), ``aliased``.
    """

    id: str
    model: str | None = None
    serial: str | None = None
    firmware: str | None = None
    port: str | None = None
    baud: int | None = None
    stream: Kind | None = None
    source: str | None = None
    clock: str | None = None
    sample_rate_hz: float | None = None
    alias_factor: float | None = None
    alias_factors: Mapping[str, float | None] = field(default_factory=dict)
    settings: Mapping[str, str] = field(default_factory=dict)
    caveats: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def describe(
    port: str,
    baud: int,
    identity: Texts,
    settings: Texts,
    stream: Stream | None,
    rate_hz: float | None,
    remarks: tuple[str, ...],
) -> Vn100Info:
    """What is known.

    Parameters
    ----------
    port, baud : where it is.
    identity : registers 1 to 4, empty when it was not asked.
    settings : registers that change the data.
    stream : the stream that is characterised, None before its first sample.
    rate_hz : its rate where that is known otherwise.
    remarks : what else there is to say.
    """
    kind = None if stream is None else stream.kind
    rate = nominal_rate(settings, stream) or rate_hz
    factors: Mapping[str, float | None] = {"gyro": None, "accel": None}
    if stream is not None:
        factors = {s: alias_factors(stream.kind_of(s), rate, settings.get(IMU_FILTER))[s] for s in factors}
    known = [factor for factor in factors.values() if factor is not None]
    worst = max(known) if len(known) == len(factors) else None
    model, serial = identity.get(1), identity.get(3)
    said = list(remarks)
    if not identity:
        said.append("only listened to: model, serial number and settings are not known")
    if kind is not None and worst is None:
        said.append("the sensor's filter or rate is not known: aliasing may inflate N")
    if model and not model.upper().startswith("VN-100"):
        said.append(f"the sensor is a {model}: it is treated like a VN-100")
    control = settings.get(DELTA_CONTROL) if stream is not None and any(stream.averaged) else ""
    if control is None:
        said.append(f"register {DELTA_CONTROL} is not known: the deltas may be compensated")
    caveats = {
        "compensated": kind == "compensated" or (control is not None and control.strip("0,") != ""),
        "unknown_compensation": control is None,
        "aliased": worst is not None and worst > 1.001,
    }
    return Vn100Info(
        id=f"vn100-{serial or _slug(port)}",
        model=model,
        serial=serial,
        firmware=identity.get(4),
        port=port,
        baud=baud,
        stream=kind,
        source=None if stream is None else stream.source,
        clock=None if stream is None else stream.clock,
        sample_rate_hz=rate,
        alias_factor=worst,
        alias_factors=factors,
        settings={f"{r} {REGISTERS[r].name}": text for r, text in sorted(settings.items())},
        caveats=tuple(name for name, holds in caveats.items() if holds),
        remarks=tuple(said),
    )


def nominal_rate(settings: Texts, stream: Stream | None) -> float | None:
    """Rate of a stream as far as settings tell, Hz."""
    if stream is None:
        return None
    if stream.source.startswith("$"):
        text = settings.get(OUTPUT_RATE, "")
        return float(text) or None if text.isdigit() else None
    for register in BINARY_OUTPUTS:
        text = settings.get(register, OFF)
        parsed = parse_output(text)
        if parsed is not None and parsed[1] and source(text) == stream.source:
            return LOOP_RATE / parsed[1]
    return None


def _slug(port: str) -> str:
    """Name of a port that may stand in a key.

    >>> _slug("/dev/ttyUSB0"), _slug("socket://10.0.0.2:4001")
    ('ttyusb0', '10-0-0-2-4001')
    """
    return re.sub(r"[^a-z0-9]+", "-", port.rsplit("://")[-1].removeprefix("/dev/").lower()).strip("-")
