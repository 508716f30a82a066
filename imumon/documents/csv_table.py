"""One tidy CSV table: one value per row, SI units, a `kind` column; any reader of CSV needs no options.

Rows differ in their unit, which is therefore a column; columns of one unit have it in their name. Empty cells
are unknown or do not apply.

kind         name                      value
record       counters of the session   seconds, bytes or counts
statistic    mean, std, min, max       of the samples that count
coefficient  its letter                with 95 % limits; only `high` where it is a bound (upper_bound, indistinct)
corrected    N                         without aliasing, by the nominal factor of the sensor, where that is known
allan        sigma                     Allan deviation at tau_s, with limits, model, noise and whether the fit uses it
bias         degree 0, degree 1        bias and slope against the temperature, with limits
sheet        its quantity              of the data sheet (`source`: maximum or typical); `status` above: the interval is
event        kind of the event         length in s at time_s
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from imumon.documents.report_texts import sensor_title, without_aliasing
from imumon.model.coefficients import Estimate
from imumon.model.messages import spreadsheet_cell
from imumon.model.report import Allan, Channel, Report
from imumon.model.samples import ChannelName

COLUMNS = (
    "kind", "channel", "name", "unit", "tau_s", "time_s", "value", "low", "high", "status", "edf", "model",
    "noise", "used", "difference", "source", "combined_low", "combined_high", "device", "caveats",
)  # fmt: skip
STATISTICS = ("mean", "std", "min", "max")
COUNTERS_NOT_SHOWN = ("started", "excluded_by", "ledger")

UNITS_OF_COUNTERS = {"s": "s", "bytes": "byte"}
"""Units of the counters of the session, by the end of their name; others count."""

Row = dict[str, Any]


def csv_table(report: Report) -> str:
    """Return the report as one table."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in table_rows(report):
        writer.writerow({name: spreadsheet_cell(value) for name, value in row.items()})
    return out.getvalue()


def table_rows(report: Report) -> Iterator[Row]:
    """Yield every row of the table, each with all `COLUMNS`; None is unknown or does not apply."""
    for row in _rows(report):
        channel = report.channels.get(ChannelName(row.get("channel") or ""))
        caveats = report.caveats if channel is None else channel.caveats
        row |= {"device": sensor_title(report), "caveats": " ".join(caveats)}
        yield {name: row.get(name) for name in COLUMNS}


def _rows(report: Report) -> Iterator[Row]:
    """Yield every number of the report, without the columns that all rows have."""
    yield from _counter_rows(report)
    for name, channel in report.channels.items():
        yield from ({"channel": name} | row for row in _channel_rows(channel))
        for letter, part in channel.estimates.items():
            row = _coefficient(part) | {"name": letter, "edf": part.dof}
            yield {"kind": "coefficient", "channel": name} | row
            if letter == "N" and (corrected := without_aliasing(report, name, part)) is not None:
                yield {"kind": "corrected", "channel": name} | row | _coefficient(corrected)
    for value in report.data_sheet.values if report.data_sheet is not None else ():
        yield {
            "kind": "sheet", "channel": value.channel, "name": value.quantity, "unit": value.printed_unit,
            "value": value.printed, "status": "above" if value.above else None, "source": value.basis,
        }  # fmt: skip
    for event in report.events:
        if event.elapsed_s is not None:  # others happened without a record
            yield {
                "kind": "event", "channel": event.channel, "name": event.kind, "unit": "s",
                "time_s": event.elapsed_s, "value": event.length_s, "source": event.text,
            }  # fmt: skip


def _counter_rows(report: Report) -> Iterator[Row]:
    """Yield the counters of the session."""
    for counter in fields(report.session):
        if counter.name not in COUNTERS_NOT_SHOWN:
            unit = UNITS_OF_COUNTERS.get(counter.name.rpartition("_")[2], "1")
            yield {
                "kind": "record",
                "name": counter.name,
                "unit": unit,
                "value": getattr(report.session, counter.name),
            }
    for reason, count in report.session.ledger.items():
        yield {"kind": "ledger", "name": reason, "unit": "1", "value": count}


def _coefficient(part: Estimate) -> Row:
    names = ("unit", "value", "low", "high", "status", "combined_low", "combined_high")
    return {name: getattr(part, name) for name in names}


def _channel_rows(channel: Channel) -> Iterator[Row]:
    """Yield the statistics, the bias against the temperature and the Allan deviation of a channel."""
    row: Row
    for name in STATISTICS:
        yield {"kind": "statistic", "name": name, "unit": channel.unit, "value": getattr(channel, name)}
    if (bias := channel.bias_curve) is not None:
        for term in bias.terms:
            yield {"kind": "bias"} | {
                key: getattr(term, key) for key in ("name", "unit", "value", "low", "high")
            }
    if (curve := channel.allan) is not None:
        for row in _points(curve):
            base: Row = {"kind": "allan", "name": "sigma", "unit": channel.unit}
            yield base | row | {"used": int(row["used"])}


def _points(curve: Allan) -> Iterator[Row]:
    """Yield a row for each point of a curve, with those of its columns that the table has."""
    names = [column.name for column in fields(curve) if column.name in (*COLUMNS, "sigma")]
    for point in zip(*(getattr(curve, name) for name in names), strict=True):
        yield dict(zip(("value" if name == "sigma" else name for name in names), point, strict=True))
