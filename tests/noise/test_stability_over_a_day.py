"""Stability over a day: a coefficient that is a row of the table and a few lines of the fit."""

from __future__ import annotations

from dataclasses import replace

import pytest
from histories import period
from reports import long_report

from imumon.datasheet.csv_table import csv_table
from imumon.datasheet.tables import report_table
from imumon.history import HistoryStore
from imumon.history.rows import rows
from imumon.history.selection import Selection
from imumon.noise import Estimator, OctaveCascade, synthesise
from imumon.pipeline.report_builder import coefficients
from imumon.report import Report, from_json, to_json
from imumon.tui.panels import detail
from imumon.tui.view_state import ViewState

RATE_HZ, DAYS = 0.1, 10


def test_a_record_of_days_shows_it_everywhere(tmp_path) -> None:
    cascade = OctaveCascade(1, tau0=1.0 / RATE_HZ)
    cascade.update(
        synthesise(round(DAYS * 86400 * RATE_HZ), RATE_HZ, N=1e-5, B=2e-5, K=0.0, seed=3).reshape(-1, 1)
    )
    curve = cascade.result()
    (fit,) = Estimator(averaged=True).fit(curve)
    day = fit.coefficients["D"]
    at = int((curve.tau < 86400.0).sum())
    assert (day.value, day.low, day.high) == (curve.sigma[at, 0], fit.low[at], fit.high[at])
    report = long_report()
    assert "D" not in report.channels["gyro/x"].coefficients
    known = replace(report.channels["gyro/x"], coefficients=coefficients("gyro", fit, {}))
    report = replace(report, channels={**report.channels, "gyro/x": known})
    assert from_json(Report, to_json(report)) == report
    assert "D in °/h" in report_table(report)
    assert "coefficient,gyro/x,D,rad/s" in csv_table(report)
    shown = detail(ViewState(reports={"a": report}, id="a", channel="gyro/x"), 80, 24)
    assert any(text.strip() == "D" for line in shown for text, _ in line)
    made = period(1)
    channel = replace(made.period.channels["gyro/x"], coefficients=fit.coefficients)
    made = replace(made, period=replace(made.period, channels={"gyro/x": channel}))
    with HistoryStore(tmp_path / "a.history.sqlite", write=True) as store:
        store.add([made])
        selected = Selection(since=0.0, until=1e12, step="10m", channels=())
        (row,) = [row for each in store.periods(selected) for row in rows(each, "a")]
    assert row["D"]["value"] == pytest.approx(day.value, rel=1e-6)
