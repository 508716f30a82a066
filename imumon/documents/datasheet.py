"""Formats of a datasheet, and how each is made from a report and the parameters for filters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from imumon.documents import figures
from imumon.documents.csv_table import csv_table
from imumon.documents.elements import Document, markdown
from imumon.documents.html import html_page
from imumon.documents.program_settings import PROGRAMS, settings_document
from imumon.documents.sheet import datasheet
from imumon.model.filter_report import FilterReport
from imumon.model.report import Report
from imumon.model.report_json import to_json

DEFAULT_PROGRAM = "kalibr"
"""Program whose settings a datasheet has unless another one is named."""


class DocumentForm(NamedTuple):
    """How a document is made, and what it is."""

    make: Callable[..., str | bytes]
    text: str
    filters: bool = True  # whether it uses the parameters for filters
    binary: bool = False  # whether it must not go to a terminal
    settings: bool = False  # whether it holds numbers for other software


def document(report: Report, form: str, filters: FilterReport, program: str = DEFAULT_PROGRAM) -> bytes:
    """Return the document of a report in one of the `FORMS`.

    Parameters
    ----------
    filters : parameters for filters of this report. They may be without channels where the form does not use them.
    program : whose settings a datasheet has.

    Raises
    ------
    NoCurve : the format is a figure, and the report has no curve yet.
    """
    data = FORMS[form].make(report, filters, program)
    # the name of a file may hold bytes that no encoding has
    return data if isinstance(data, bytes) else data.encode(errors="replace")


def _page(write: Callable[[Document], str], text: str) -> DocumentForm:
    return DocumentForm(lambda report, filters, program: write(datasheet(report, filters, program)), text)


def _figure(form: str, text: str) -> DocumentForm:
    return DocumentForm(
        lambda report, *_: figures.figure_file(report, form), text, filters=False, binary=True
    )


def _settings(name: str) -> DocumentForm:
    return DocumentForm(
        lambda report, filters, _: settings_document(name, report, filters),
        PROGRAMS[name].text,
        settings=True,
    )


PAGES: Mapping[str, DocumentForm] = {
    "html": _page(html_page, "the datasheet as one page, which a browser prints"),
    "md": _page(markdown, "the datasheet as text"),
}
"""Forms of the datasheet by name."""

FORMS: Mapping[str, DocumentForm] = {
    **PAGES,
    "svg": _figure("svg", "the Allan curves as a vector figure"),
    "png": _figure("png", "the same figure as a picture"),
    "json": DocumentForm(
        lambda report, *_: to_json(report, indent=1) + "\n",
        "the report itself; --baseline reads it",
        filters=False,
    ),
    "csv": DocumentForm(lambda report, *_: csv_table(report), "all numbers as one tidy table", filters=False),
    "filter": DocumentForm(
        lambda _, filters, __: to_json(filters, indent=1) + "\n",
        "numbers that keep a Kalman filter consistent, JSON",
        settings=True,
    ),
    **{name: _settings(name) for name in PROGRAMS},
}
"""Forms of a document by name."""
