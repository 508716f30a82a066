"""Metadata of a device: what of it is in a report, in a recording and in the saved state."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from imumon import report
from imumon.devices import registry
from imumon.evaluation import Evaluation, Provenance
from imumon.samples import DeviceInfo


def description(name: str, info: DeviceInfo | None) -> report.DeviceDescription:
    """Return the description in a report, under the name that the device has on the bus."""
    if info is None:
        return report.DeviceDescription(id=name)
    return report.DeviceDescription(
        id=name,
        model=info.model,
        serial=info.serial,
        firmware=info.firmware,
        port=info.port,
        baud=info.baud,
        stream=info.stream,
        sample_rate_hz=info.sample_rate_hz,
        alias_factor=info.alias_factor,
        source=info.source,
        topic=info.topic,
        clock=info.clock,
        settings=info.settings,
        remarks=info.remarks,
        driver=info.driver,
        setting_texts=registry.setting_texts(
            registry.driver(info.driver) if info.driver else None, info.settings
        ),
    )


def traced(made: report.Report, provenance: Provenance | None) -> report.Report:
    """Return a report that names the program and the host of the daemon."""
    if provenance is None:
        return made
    return replace(made, evaluation=Evaluation(provenance=replace(provenance, made=made.time)))


def recording_header(
    name: str, info: DeviceInfo, rate_hz: float | None, started: str | None
) -> dict[str, Any]:
    """Return the header of a recording that starts now.

    Parameters
    ----------
    rate_hz : Hz, of a stream without a clock.
    started : when the record began, which continues in the next recording after a restart.
    """
    return {
        "time": report.stamp(datetime.now(UTC)),
        "record": started,
        "driver": info.driver,  # decodes the recording
        "id": name,
        "model": info.model,
        "serial": info.serial,
        "firmware": info.firmware,
        "stream": info.stream,
        "rate_hz": rate_hz,
        "alias_factor": info.alias_factor,
        "caveats": info.caveats,
        "settings": dict(info.settings),
    }


def saved_description(info: DeviceInfo) -> dict[str, Any]:
    """Return what the saved state holds of the device, for a report that is made from it alone."""
    names = ("driver", "model", "serial", "firmware", "port", "baud", "alias_factor")
    return {name: getattr(info, name) for name in names} | {"caveats": list(info.caveats)}
