"""Formats of a datasheet, and how each is made from a report and the parameters for filters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

from imumon.coefficients import NOISE
from imumon.datasheet import figures
from imumon.datasheet.content import datasheet_content, short_content
from imumon.datasheet.csv_table import csv_table
from imumon.datasheet.elements import Document, markdown
from imumon.datasheet.history_figure import HistoryRows
from imumon.datasheet.html import html_page
from imumon.datasheet.program_settings import PROGRAMS, settings_document
from imumon.datasheet.temperature_settings import curves_not_shown
from imumon.filter_report import FilterReport
from imumon.report import Report
from imumon.report_json import to_json
from imumon.samples import AXES, INERTIAL


class DocumentForm(NamedTuple):
    """How a document is made, and what it is."""

    make: Callable[..., str | bytes]
    text: str
    filters: bool = True  # whether it uses the parameters for filters
    binary: bool = False  # whether it must not go to a terminal
    history: bool = False  # whether it shows the history
    settings: bool = False  # whether it holds numbers for other software
    curves: bool = False  # whether these are of the bias against the temperature, else of a filter


def not_measured(report: Report, form: str) -> list[str]:
    """Return the numbers that settings in one of the `FORMS` rest on, and that the report only bounds or lacks."""
    if FORMS[form].curves:
        return curves_not_shown(report)
    letters = PROGRAMS[form].letters if form in PROGRAMS else NOISE
    names = [f"{sensor}/{axis}" for sensor in INERTIAL for axis in AXES]
    return [
        f"{name} {letter}"
        for name in names
        for letter in letters
        if name not in report.channels
        or (part := report.channels[name].coefficients.get(letter)) is None
        or part.status != "measured"
    ]


PAGES: Mapping[str, Callable[[Document], str | bytes]] = {"md": markdown, "html": html_page}
"""What writes the datasheet, by name of the form."""


def short_document(report: Report, form: str, filters: FilterReport, program: str) -> bytes:
    """Return the datasheet on two pages in one of `PAGES`, with the settings of a program; see `document`."""
    data = PAGES[form](short_content(report, filters, program))
    return data if isinstance(data, bytes) else data.encode(errors="replace")


def document(report: Report, form: str, filters: FilterReport, history: HistoryRows = ()) -> bytes:
    """Return the document of a report in one of the `FORMS`.

    Parameters
    ----------
    filters : parameters for filters of this report. They may be without channels where the form does not use them.
    history : rows of the history of the sensor; empty: none is known.

    Raises
    ------
    NoCurve : the format is a figure, and the report has no curve yet.
    NoBiasCurve : the format is of bias curves, and the report has none.
    """
    sheet = FORMS[form].history
    data = FORMS[form].make(report, filters, history) if sheet else FORMS[form].make(report, filters)
    # the name of a file may hold bytes that no encoding has
    return data if isinstance(data, bytes) else data.encode(errors="replace")


def _figure(form: str, text: str) -> DocumentForm:
    return DocumentForm(lambda report, _: figures.figure_file(report, form), text, filters=False, binary=True)


FORMS: Mapping[str, DocumentForm] = {
    "md": DocumentForm(
        lambda r, f, h: markdown(datasheet_content(r, f, h)), "the datasheet as Markdown", history=True
    ),
    "html": DocumentForm(
        lambda r, f, h: html_page(datasheet_content(r, f, h)),
        "the datasheet as one page to print",
        history=True,
    ),
    "svg": _figure("svg", "the Allan curves as a vector figure"),
    "png": _figure("png", "the same figure as a picture"),
    "json": DocumentForm(
        lambda r, _: to_json(r, indent=1) + "\n", "the report itself; --baseline reads it", filters=False
    ),
    "csv": DocumentForm(lambda r, _: csv_table(r), "all numbers as one tidy table", filters=False),
    "filter": DocumentForm(
        lambda _, f: to_json(f, indent=1) + "\n",
        "numbers that keep a Kalman filter consistent, JSON",
        settings=True,
    ),
    **{
        name: DocumentForm(
            partial(settings_document, name),
            program.text,
            filters=bool(program.letters),
            settings=True,
            curves=not program.letters,
        )
        for name, program in PROGRAMS.items()
    },
}
"""Forms of a document by name."""
