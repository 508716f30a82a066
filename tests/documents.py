"""Documents of reports of five ages, each made once."""

from __future__ import annotations

from dataclasses import replace

from reports import LENGTH_S, LONG_S, nothing_yet
from reports import report as make_report

from imumon.documents import FORMS, document
from imumon.documents.filter_values import FilterValue, worst_axis
from imumon.model.filter_report import FilterReport
from imumon.model.report import Report
from imumon.record.filter_report_builder import filter_report

AGES = {"hours": LENGTH_S, "nothing": 0.0, "seconds": 8.0, "minutes": 200.0, "long": LONG_S}
SETTINGS = [f for f, what in FORMS.items() if what.settings and f != "filter"]
COVARIANCES = ("ros", "robot_localization")
FIGURES = ("svg", "png")


def aged(name: str) -> Report:
    return nothing_yet() if name == "nothing" else make_report(AGES[name])


_FILTERS: dict[object, FilterReport] = {}


def filters(report: Report, horizon_s: float = 600.0) -> FilterReport:
    """Return the parameters for filters; those of a noise that was seen before are not computed again."""
    seen = [(name, tuple(c.coefficients.items()), c.caveats) for name, c in report.channels.items()]
    key = (horizon_s, tuple(seen))
    if key not in _FILTERS:
        _FILTERS[key] = filter_report(report, horizon_s)
    return replace(_FILTERS[key], time=report.time, device=report.device, elapsed_s=report.session.elapsed_s)


_DOCUMENTS: dict[tuple[int, str], tuple[Report, bytes]] = {}


def made(report: Report, form: str) -> bytes:
    """Return a document; one of a report that was documented before is not made again."""
    key = id(report), form
    if key not in _DOCUMENTS:
        _DOCUMENTS[key] = report, document(report, form, filters(report))
    return _DOCUMENTS[key][1]


def text(report: Report, form: str) -> str:
    return made(report, form).decode()


def worst(report: Report, sensor: str, letter: str) -> FilterValue:
    return worst_axis(report, filters(report), sensor, letter)


def bare(report: Report) -> Report:
    """Return the report without its curves, for tests of what a page says: figures take most of its time."""
    return replace(report, channels={n: replace(c, allan=None) for n, c in report.channels.items()})


def words(report: Report, form: str) -> str:
    """Return a document without figures."""
    none = FilterReport(time=report.time, device=report.device)
    return document(bare(report), form, none).decode() if form == "html" else text(report, form)
