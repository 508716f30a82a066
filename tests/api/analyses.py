"""Reports that must be equal, without the names and times of the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from imumon.model.ledger import ColumnUse, with_received
from imumon.model.report import RecordingDescription, Report


def _of_rows(ledger: Mapping[str, int]) -> dict[str, int]:
    """Return a ledger without the lines that only a text has: a header is no row of an array."""
    rows = {name: count for name, count in ledger.items() if name not in ("header", "comment", "blank")}
    return with_received(rows)


def _uses(recording: RecordingDescription | None) -> RecordingDescription | None:
    """Return what columns are used for, without their names and their order, which are those of the source."""
    if recording is None:
        return None
    uses = sorted(column.use for column in recording.columns if column.use is not None)
    return RecordingDescription(columns=tuple(ColumnUse(name=use, use=use) for use in uses))


def comparable(report: Report) -> Report:
    """Return a report without what a run, or the name of its source, decides."""
    return replace(
        report,
        time="",
        device=replace(report.device, port=None, source=None, remarks=()),
        session=replace(report.session, received_bytes=0, ledger=_of_rows(report.session.ledger)),
        recording=_uses(report.recording),
        events=tuple(replace(event, time="") for event in report.events),
    )
