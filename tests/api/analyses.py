"""Reports that must be equal, without the names and times of the run."""

from __future__ import annotations

from dataclasses import replace

from imumon.report import Report


def comparable(report: Report) -> Report:
    """Return a report without what a run, or the name of its source, decides."""
    return replace(
        report,
        time="",
        device=replace(report.device, port=None, source=None, remarks=()),
        session=replace(report.session, received_bytes=0),
        events=tuple(replace(event, time="") for event in report.events),
        evaluation=None if report.evaluation is None else replace(report.evaluation, provenance=None),
    )
