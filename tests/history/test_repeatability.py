"""What the history adds to a document: repeatability between days and power-ups."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import imumon
from daemons import Daemon
from histories import period, write
from reports import report as report_at

from imumon.cli.history_command import stored_days
from imumon.documents.report_texts import coefficient_text
from imumon.history import HistoryStore
from imumon.history.repeatability import day_scatter
from imumon.history.store import SUFFIX, PowerUp
from imumon.model.history_report import HistoryRow
from imumon.model.history_report import history_rows as read_rows
from imumon.model.report import Report, from_json
from imumon.model.report_json import to_json
from imumon.record.combined_limits import with_combined
from imumon.sources.vn100.emulator import EmulatorSettings, spawn


def make_report() -> Report:
    """Return the report of a quarter of an hour."""
    return report_at(900.0)


def history_rows(folder: Path, noises: Sequence[float]) -> list[HistoryRow]:
    """Return the rows beside a saved state whose N has these factors, one per day."""
    begin = time.time() - (len(noises) + 1) * 86400.0
    days = [period(k, step_s=86400, begin=begin + 86400.0 * k, noise=noise) for k, noise in enumerate(noises)]
    hours = [period(k, step_s=3600, begin=begin + 3600.0 * k) for k in range(24 * len(noises))]
    write(folder, "imu", days + hours)
    return stored_days(folder / "imu.state")


@pytest.mark.few
@pytest.mark.parametrize(
    "wrong",
    [
        {"step": "1h"}, {"complete": False}, {"warming_up": True}, {"samples": 0}, {"samples": "many"},
        {"time": "soon"}, {"channel": 3}, {"N": {"status": "measured", "value": 1e300, "low": 0, "high": 1e301}},
        {"N": {"status": "measured", "value": "x", "low": 0, "high": 1}}, {"N": 4}, {"N": None},
    ],
)  # fmt: skip
def test_a_row_that_is_no_day_does_not_count(tmp_path: Path, wrong: dict[str, Any]) -> None:
    known = [row for row in history_rows(tmp_path, [1.0, 2.0, 3.0, 4.0]) if row.channel == "gyro/x"]
    rows = json.loads(to_json(known))
    assert day_scatter(read_rows(rows))["gyro/x"]["N"].days == 4
    assert day_scatter(read_rows([rows[0] | wrong, *rows[1:]]))["gyro/x"]["N"].days == 3


def test_a_saved_state_shows_the_history_of_its_directory(tmp_path: Path) -> None:
    """Of a real daemon's directory: days, power-ups; the saved report keeps the limits."""
    with spawn(EmulatorSettings(seed=3)) as sensor, Daemon(sensor.path, tmp_path, "--id", "imu") as daemon:
        daemon.samples(400)
        daemon.stop()
    begin = time.time() - 30 * 86400.0
    days = [period(k, step_s=86400, begin=begin + 86400.0 * k, noise=1 + 0.1 * (k % 2)) for k in range(8)]
    with HistoryStore(tmp_path / f"imu{SUFFIX}", write=True) as store:
        store.add(days)
        for k in range(6):
            at = begin + 86400.0 * k
            store.set_power_up(PowerUp(time=at, clock_s=9.0, seen=at + 9.0, means={"gyro/x": 1e-3 * k}))
    state = tmp_path / "imu.state"
    saved = tmp_path / "saved.json"
    imumon("report", state, "-o", saved)
    report = from_json(Report, saved.read_text())
    alone, known = (
        channels["gyro/x"].coefficients["N"].interval for channels in (with_combined(report), report.channels)
    )
    assert known[0] < alone[0] < alone[1] < known[1]
    text = coefficient_text(report.channels["gyro/x"].coefficients["N"])
    assert text in imumon("report", saved, "--format", "md")
    shape = report.channels["gyro/x"].distribution
    assert (shape.turn_on_count, shape.turn_on_std) == (6, pytest.approx(1e-3 * np.sqrt(3.5)))
