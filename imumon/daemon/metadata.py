"""Account of a sensor: what of it stands in a report, in a recording, in the state and in the log."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from imumon import report
from imumon.devices import registry
from imumon.devices.vn100.vn100_session import Vn100Info


def device(name: str, facts: Vn100Info | None) -> report.DeviceDescription:
    """Of a report, under the name that the device has on the bus."""
    if facts is None:
        return report.DeviceDescription(id=name)
    return report.DeviceDescription(
        id=name,
        model=facts.model,
        serial=facts.serial,
        firmware=facts.firmware,
        port=facts.port,
        baud=facts.baud,
        stream=facts.stream,
        sample_rate_hz=facts.sample_rate_hz,
        alias_factor=facts.alias_factor,
        source=facts.source,
        clock=facts.clock,
        settings=facts.settings,
        remarks=facts.remarks,
        driver=registry.DEFAULT_SCHEME,
        setting_texts=registry.setting_texts(registry.driver(), facts.settings),
    )


def header(name: str, facts: Vn100Info, rate_hz: float | None, started: str | None) -> dict[str, Any]:
    """Of a recording that begins now.

    Parameters
    ----------
    rate_hz : of a stream without a clock.
    started : when the record began, which goes on in the next recording after a restart.
    """
    return {
        "time": report.stamp(datetime.now(UTC)),
        "record": started,
        "id": name,
        "driver": registry.DEFAULT_SCHEME,
        "model": facts.model,
        "serial": facts.serial,
        "firmware": facts.firmware,
        "stream": facts.stream,
        "rate_hz": rate_hz,
        "alias_factor": facts.alias_factor,
        "caveats": facts.caveats,
        "settings": dict(facts.settings),
    }


def kept(facts: Vn100Info) -> dict[str, Any]:
    """Of the state, for a report that is made from it alone."""
    names = ("model", "serial", "firmware", "port", "baud", "alias_factor")
    known = {name: getattr(facts, name) for name in names}
    return known | {"driver": registry.DEFAULT_SCHEME, "caveats": list(facts.caveats)}


def who(facts: Vn100Info | None) -> str:
    """In a line for people.

    >>> who(Vn100Info(id="vn100-1", model="VN-100T-CR", serial="0100056785")), who(None)
    ('VN-100T-CR 0100056785', 'the sensor')
    """
    if facts is None or facts.model is None:
        return "the sensor"
    return f"{facts.model} {facts.serial or ''}".strip()
