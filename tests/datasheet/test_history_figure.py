"""History in the datasheet: a figure on the page, a table in Markdown, nothing without rows or with hostile ones."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import reports
from histories import period, write

from imumon.cli.history_command import stored_days
from imumon.datasheet import document
from imumon.datasheet.history_figure import history_table, series
from imumon.datasheet.tables import MOST_ROWS
from imumon.filter_report import FilterReport
from imumon.history_report import HistoryRow, history_rows


def filters() -> FilterReport:
    report = reports.warming_up()
    return FilterReport(time=report.time, device=report.device)


def stored(folder: Path, days: int) -> list[HistoryRow]:
    begin = time.time() - (days + 1) * 86400.0
    made = [period(k, step_s=86400, begin=begin + 86400.0 * k, noise=1.0 + 0.01 * k) for k in range(days)]
    write(folder, "imu", made)
    return stored_days(folder / "imu.state")


def test_the_page_has_a_figure_and_markdown_a_table(tmp_path: Path) -> None:
    rows = stored(tmp_path, 40)
    page = document(reports.warming_up(), "html", filters(), rows).decode()
    assert 'aria-label="History of N of the gyro"' in page
    assert "<h2>History</h2>" in page
    text = document(reports.warming_up(), "md", filters(), rows).decode()
    assert "## History" in text
    table = history_table("gyro", series(rows, "gyro"))
    assert table.head[1:] == ("x", "y", "z")
    assert len(table.rows) <= MOST_ROWS
    assert float(table.rows[-1][1]) == pytest.approx(float(table.rows[0][1]) * 1.39, rel=0.03)


def test_there_is_none_without_enough_rows(tmp_path: Path) -> None:
    for rows in ([], stored(tmp_path, 2)):
        assert "## History" not in document(reports.warming_up(), "md", filters(), rows).decode()
    assert stored_days(tmp_path / "other.json") == []


@pytest.mark.parametrize(
    "row",
    [
        {}, {"channel": 1}, {"channel": "gyro/x", "time": "soon", "N": {}},
        {"channel": "gyro/x", "time": "2026-01-01", "N": {"value": 1e300, "low": 0, "high": 1e301}},
        {"channel": "gyro/x", "time": "2026-01-01", "N": {"value": "x", "low": 0, "high": 1}},
        {"channel": "gyro/<b>", "time": "2026-01-01", "N": {"value": 1, "low": 0, "high": 2}},
        {"channel": "gyro/x", "time": "2026-01-01", "N": {"value": 3, "low": 4, "high": 2}},
    ],
)  # fmt: skip
def test_a_row_that_is_none(row: dict[str, object]) -> None:
    assert series([*history_rows([row] * 5)], "gyro") == {}
