"""Report of a document: with the days of the history in its limits, and the data sheet of the sensor beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from imumon.documents.references import SheetError, read_sheet, sheet_of_model
from imumon.documents.references.comparison import compared
from imumon.model.cures import option
from imumon.model.history_report import HistoryRow
from imumon.model.messages import one_warmup
from imumon.model.report import Report
from imumon.sources import registry


def document_report(report: Report, sheet: Any = None, rows: Sequence[HistoryRow] = ()) -> Report:
    """Return a report with the limits that its history widens, and its comparison with a data sheet.

    Parameters
    ----------
    sheet : reference sheet that the user names; None: that of the model, if it is known.
    rows : of the history of the sensor; empty: none is known, and the limits stay as they are.

    Raises
    ------
    SheetError : the sheet is of another device.
    """
    report = replace(report, events=one_warmup(report.events))
    if rows:
        from imumon.history.repeatability import day_scatter
        from imumon.record.combined_limits import with_combined

        report = replace(report, channels=with_combined(report, day_scatter(rows)))
    published = _checked(report, sheet) or _sheet_of_model(report)
    if published is None:
        return report

    return replace(report, data_sheet=compared(report, published))


def _checked(report: Report, sheet: Any) -> Any:

    model = report.device.model
    if sheet is not None and sheet.models and model and not sheet.is_of(model):
        message = f"{option('datasheet')}: it is of {', '.join(sheet.models)}, and the record is of a {model}"
        raise SheetError("datasheet_of_other_device", message, "name the data sheet of this sensor")
    return sheet


def _sheet_of_model(report: Report) -> Any:
    """Return the sheet of the model, of its driver or of imumon; None if the model is unknown or has none."""

    device = report.device
    driver = registry.installed(device.driver)
    path = driver.reference_sheet(device.model) if driver is not None and device.model else None
    return read_sheet(path) if path is not None else sheet_of_model(device.model)
