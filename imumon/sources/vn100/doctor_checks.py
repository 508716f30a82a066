"""Doctor checks of a VN-100: baud rate, load of the line, and other models of the family."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from imumon.model.samples import DeviceInfo
from imumon.model.units import share_text
from imumon.sources.device import Check, Observation
from imumon.sources.vn100.device_info import FAMILY, PROTOCOL, family_of
from imumon.sources.vn100.registers import LOOP_RATE
from imumon.sources.vn100.stream_settings import divisors

SLOW_HZ = 40.0
"""Hz, rate of the deltas below which a higher baud is recommended: the factory rate."""
HIGH_LOAD = 0.8
"""Share of the baud from which a warning is due: replies and a second stream need the rest."""

IMPOSSIBLE_LOAD = 1.05
"""Share of the baud rate that no serial line can transmit: the port is a pseudo-terminal, or ignores it."""


def checks(observation: Observation, settings: Any) -> Iterator[Check]:
    """Yield the checks that need knowledge of the VN-100.

    Parameters
    ----------
    settings : the table ``[device]``, of which ``baud`` is used.
    """
    info = observation.info
    yield _baud(info, settings.baud)
    if info.model is not None and family_of(info.model) != FAMILY:
        serial = info.serial or "without a serial number"
        text = f"{info.model} {serial}, firmware {info.firmware or 'unknown'}: {PROTOCOL}"
        yield Check("model", "warning", text, "check its filter yourself")
    if observation.messages:
        yield _load(observation)


def _baud(info: DeviceInfo, configured: int | str) -> Check:
    """Check the baud rate against the configured one, and whether the deltas fit it at a useful rate."""
    if info.baud is None:
        return Check("baud", "ok", "has no effect on this port")
    if configured not in ("auto", info.baud):
        text = f"the sensor is at {info.baud} baud, the settings say {configured}"
        return Check("baud", "failed", text, 'set device.baud = "auto"')
    rate = LOOP_RATE / divisors("deltas", info.baud)[0]
    if rate < SLOW_HZ:
        text = f"{info.baud} baud is enough for the deltas at {rate:g} Hz only"
        return Check("baud", "warning", text, "imumon run --set-baud 115200 (until the next power-up)")
    return Check("baud", "ok", f"{info.baud} baud, enough for the deltas at {rate:g} Hz")


def _load(observation: Observation) -> Check:
    """Check how much of the line the sensor uses."""
    # all bytes, damaged ones too: they take their time on the line
    bytes_per_s = observation.bytes / observation.seconds
    baud = observation.info.baud
    if not baud:
        return Check("load", "ok", f"{bytes_per_s:.0f} bytes/s")
    load = bytes_per_s / (baud / 10)  # 8N1: ten bits for a byte
    text = f"{share_text(load)} of {baud} baud"
    if load > IMPOSSIBLE_LOAD:
        return Check("load", "ok", f"{text}: no real serial line, so the baud rate is no limit")
    if load <= HIGH_LOAD:
        return Check("load", "ok", text)
    cure = "request a lower rate, or raise the baud rate with --set-baud"
    return Check("load", "warning", text, cure)
