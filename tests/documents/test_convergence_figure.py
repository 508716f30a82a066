"""Plain K is the coefficient itself; the convergence is a figure."""

from __future__ import annotations

import pytest
import reports

from imumon.documents.convergence_figure import convergence_svg
from imumon.model.coefficients import NOISE
from imumon.model.filter_report import FilterReport
from imumon.model.report import Report
from imumon.record.filter_report_builder import filter_report


@pytest.fixture(scope="module")
def sheet() -> Report:
    return reports.long_report()


@pytest.fixture(scope="module")
def filters(sheet: Report) -> FilterReport:
    return filter_report(sheet, 600.0)


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_the_convergence_is_a_figure(sheet: Report, sensor: str) -> None:
    drawn = convergence_svg(sheet, sensor)
    assert all(f">{letter}, " in drawn for letter in NOISE)
