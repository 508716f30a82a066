"""Comparison of a report with the data sheet of its sensor: each published value beside the measured interval.

A value of the sheet is shown beside the coefficient of the stream. Where the report itself says that the stream does
not show the sensor, it is not said to be above: N that aliasing raises, or may raise because the filter is unknown.
"""

from __future__ import annotations

import math

from imumon.documents.references.reference_sheet import QUANTITIES, UNITS, Limit, ReferenceSheet
from imumon.model.messages import filter_not_known
from imumon.model.report import DataSheet, Report, SheetValue
from imumon.model.samples import ALIASED, INERTIAL, ChannelName


def compared(report: Report, sheet: ReferenceSheet) -> DataSheet:
    """Return the values of a sheet for the coefficients that a report has."""
    values = [
        _value(report, name, limit)
        for limit in sheet.limits
        for name in limit.axes
        if name in report.channels and QUANTITIES[limit.quantity][0] in report.channels[name].estimates
    ]
    return DataSheet(
        title=sheet.title,
        document=sheet.document,
        edition=sheet.edition,
        source=sheet.source,
        note=sheet.note,
        values=tuple(values),
    )


def _value(report: Report, name: ChannelName, limit: Limit) -> SheetValue:
    """Return one value of the sheet for one channel."""
    letter, ratio = QUANTITIES[limit.quantity]
    size = limit.at_most / (ratio * UNITS[name.sensor, letter][limit.unit])
    part = report.channels[name].estimates[letter]
    above = (
        None if part.status == "pending" else part.status == "measured" and (part.stated.low or 0.0) > size
    )
    reason = _doubt(report, name.sensor, limit) if letter == "N" and above else None
    return SheetValue(
        channel=name,
        quantity=limit.quantity,
        coefficient=letter,
        printed=limit.at_most,
        printed_unit=limit.unit,
        basis=limit.basis,
        value=size,
        unit=part.unit,
        above=above if reason is None else None,
        reason=reason,
    )


def _doubt(report: Report, sensor: str, limit: Limit) -> str | None:
    """Return why N of the stream may be above that of the sensor; None if nothing raises it."""
    factor = _alias_factor(report, sensor, limit)
    if factor > ALIASED:
        return f"aliasing raises N of this stream {factor:.2f} times, nominally"
    if sensor != "mag" and filter_not_known(report) is not None:
        return "the filter of the sensor is unknown: aliasing may raise N"
    return None


def _alias_factor(report: Report, sensor: str, limit: Limit) -> float:
    """Return the nominal factor by which aliasing raises N of a sensor in this stream; 1: none is known."""
    device = report.device
    factor = (device.alias_factor or 1.0) if sensor in INERTIAL else 1.0
    # a quantity that the sensor reads, unfiltered, more often than it sends it
    if limit.sampled_hz is not None and device.sample_rate_hz:
        factor = max(factor, math.sqrt(limit.sampled_hz / device.sample_rate_hz))
    return factor
