"""What the tests of an evaluation share: a report, a document, a data sheet."""

from __future__ import annotations

from pathlib import Path

from commands import imumon
from reports import report as report_at

from imumon.documents import document
from imumon.model.filter_report import FilterReport
from imumon.model.report import Report, from_json

HZ = 40.0
"""Rate of the recordings that the tests make."""


SHEET = """
title = "Acme A1"
models = ["A1"]
document = "A1 data sheet"
edition = "Rev. C, 2026"

[[limit]]
channels = ["gyro"]
quantity = "N"
at_most = {gyro}
unit = "deg/sqrt(h)"

[[limit]]
channels = ["accel/x", "accel/y"]
quantity = "floor"
at_most = 1000.0
unit = "mg"
basis = "typical"
"""


def make_report() -> Report:
    """Return the report of a quarter of an hour."""
    return report_at(900.0)


def shown(report: Report, form: str = "md") -> str:
    return document(report, form, FilterReport(time=report.time, device=report.device)).decode()


def replayed(*words: object) -> Report:
    return from_json(Report, imumon("replay", *words, "--json"))


def sheet_file(tmp_path: Path, *, gyro: float) -> Path:
    path = tmp_path / "sheet.toml"
    path.write_text(SHEET.format(gyro=gyro))
    return path
