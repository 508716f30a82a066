"""What the tests of an evaluation share: a command in this process, a report, a document, a data sheet."""

from __future__ import annotations

import io
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from reports import report as report_at

from imumon.cli.main import main
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


def imumon(*words: object, code: int = 0) -> str:
    """Run a command in this process; return its output, or its messages if it is to fail with `code`."""
    out, err = io.TextIOWrapper(io.BytesIO(), "utf-8"), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        assert main([str(word) for word in words]) == code, err.getvalue()
        out.flush()
    return err.getvalue() if code else out.buffer.getvalue().decode()


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
