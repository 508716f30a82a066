"""What the history adds to a document: repeatability between days and power-ups; and the program of a daemon."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from daemons import Daemon
from histories import period, write
from reports import report as report_at

from imumon import __version__
from imumon.api.traceability import commit, evaluated, with_provenance
from imumon.cli.history_command import stored_days
from imumon.cli.main import main
from imumon.datasheet import document
from imumon.devices.vn100.emulator import EmulatorSettings, spawn
from imumon.evaluation import Evaluation, Provenance
from imumon.filter_report import FilterReport
from imumon.history import HistoryStore
from imumon.history.repeatability import day_scatter
from imumon.history.store import SUFFIX, PowerUp
from imumon.history_report import HistoryRow
from imumon.history_report import history_rows as read_rows
from imumon.pipeline.uncertainty_budgets import uncertainty_budgets
from imumon.report import Report, from_json
from imumon.report_json import to_json


def imumon(*words: object) -> str:
    """Return what a command of this process prints."""
    out = io.TextIOWrapper(io.BytesIO(), "utf-8")
    with redirect_stdout(out), redirect_stderr(io.StringIO()):
        assert main([str(word) for word in words]) == 0
        out.flush()
    return out.buffer.getvalue().decode()


def make_report() -> Report:
    """Return the report of a quarter of an hour."""
    return report_at(900.0, scale=2.0)


def shown(report: Report, form: str = "md") -> str:
    return document(report, form, FilterReport(time=report.time, device=report.device)).decode()


def history_rows(folder: Path, noises: Sequence[float]) -> list[HistoryRow]:
    """Return the rows beside a saved state whose N has these factors, one per day."""
    begin = time.time() - (len(noises) + 1) * 86400.0
    days = [period(k, step_s=86400, begin=begin + 86400.0 * k, noise=noise) for k, noise in enumerate(noises)]
    hours = [period(k, step_s=3600, begin=begin + 3600.0 * k) for k in range(24 * len(noises))]
    write(folder, "imu", days + hours)
    return stored_days(folder / "imu.state")


def test_days_of_the_history_are_a_component(tmp_path: Path) -> None:
    factors = 1.0 + 0.1 * np.random.default_rng(1).standard_normal(20)
    rows = history_rows(tmp_path, factors)
    made = evaluated(make_report(), rows=rows).evaluation
    budget = made.budgets["gyro/x"]["N"]
    parts = {each.source: each for each in budget.components}
    n = 1.234567e-4 * factors
    expected = (
        np.var(n, ddof=1) - np.mean((0.01 * n / 1.959964) ** 2) - (parts["scatter"].standard or 0.0) ** 2
    )
    assert parts["repeatability"].standard == pytest.approx(np.sqrt(expected), rel=1e-4)
    assert parts["repeatability"].dof == 19
    assert "20 days" in parts["repeatability"].basis
    alone = uncertainty_budgets(make_report())["gyro/x"]["N"]
    assert budget.combined == pytest.approx(np.hypot(alone.combined, parts["repeatability"].standard))
    assert "repeatability" not in {each.source for each in alone.components}
    text = shown(evaluated(make_report(), rows=rows))
    assert "| repeatability |" in text
    assert "repeatability |" not in shown(evaluated(make_report()))


def test_days_that_scatter_by_their_statistics_alone_add_nothing(tmp_path: Path) -> None:
    made = evaluated(make_report(), rows=history_rows(tmp_path, [1.0, 1.001, 0.999, 1.0])).evaluation
    (part,) = (c for c in made.budgets["gyro/x"]["N"].components if c.source == "repeatability")
    assert part.standard == 0.0
    assert part.basis.endswith("none")


def test_two_days_are_too_few(tmp_path: Path) -> None:
    made = evaluated(make_report(), rows=history_rows(tmp_path, [1.0, 2.0])).evaluation
    (part,) = (c for c in made.budgets["gyro/x"]["N"].components if c.source == "repeatability")
    assert part.standard is None
    assert part.basis == "fewer than 3 days of the history have a value"


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


def test_the_bias_has_a_budget_once_power_ups_are_known() -> None:
    report = make_report()
    channel = report.channels["gyro/x"]
    shape = channel.distribution
    assert shape.bias_low is not None
    assert shape.bias_high is not None
    assert evaluated(report).evaluation.bias_budgets == {}
    few = replace(channel, distribution=replace(shape, turn_on_count=2))
    known = replace(few, distribution=replace(shape, turn_on_count=6, turn_on_std=1e-3))
    short = evaluated(replace(report, channels={"gyro/x": few}))
    assert short.evaluation.bias_budgets == {}  # what a power cycle adds is not known
    assert "the history has only 2 of them" in shown(short)
    annotated = evaluated(replace(report, channels={"gyro/x": known}))
    budget = annotated.evaluation.bias_budgets["gyro/x"]
    assert budget.components[1].standard == 1e-3
    statistics = (shape.bias_high - shape.bias_low) / (2.0 * 1.959964)
    assert budget.combined == pytest.approx(np.hypot(statistics, 1e-3))
    assert budget.coverage == pytest.approx(2.57, abs=0.01)
    text = shown(annotated)
    assert "| gyro/x bias |" in text
    assert "of N, B and K, except" in text
    assert from_json(Report, to_json(annotated)) == annotated
    assert "gyro/x,bias" in shown(annotated, "csv")


def test_a_saved_state_shows_the_history_of_its_directory(tmp_path: Path) -> None:
    """Of a real daemon's directory: days, power-ups; the saved report keeps the budgets."""
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
    (state,) = tmp_path.glob("imu.state*")
    saved = tmp_path / "saved.json"
    imumon("report", state, "-o", saved)
    page = imumon("report", saved, "--format", "md")
    for text in (imumon("report", state, "--format", "md"), page):
        assert "between 8 days of the history" in text
        assert "of N, B and K, except as far as the days of the history show it" in text
    shape = from_json(Report, saved.read_text()).channels["gyro/x"].distribution
    assert (shape.turn_on_count, shape.turn_on_std) == (6, pytest.approx(1e-3 * np.sqrt(3.5)))


def test_a_report_of_a_daemon_names_the_daemon(tmp_path: Path) -> None:
    with spawn(EmulatorSettings(seed=3)) as sensor, Daemon(sensor.path, tmp_path, "--no-guards") as daemon:
        report = daemon.samples(50)
        made = from_json(
            Report, imumon("report", "--connect", daemon.endpoint, "--format", "json")
        ).evaluation
        daemon.stop()
    origin = report.evaluation.provenance
    assert (origin.software, origin.commit) == (f"imumon {__version__}", commit())
    assert (origin.guards, origin.input, origin.input_reason) == (False, None, "a running daemon")
    (state,) = tmp_path.glob("*.state")
    of_state = from_json(Report, imumon("report", state, "--format", "json")).evaluation
    assert of_state.provenance.guards is False
    assert origin.made == report.time
    assert (made.provenance.software, made.provenance.written_by) == (origin.software, None)


def test_a_document_names_the_daemon_and_what_wrote_it() -> None:
    """The daemon is of another revision than the command."""
    origin = Provenance(software="imumon 0.0.9", commit="abc", input_reason="a running daemon", guards=True)
    text = shown(
        with_provenance(replace(make_report(), evaluation=Evaluation(provenance=origin)), None, {}, None)
    )
    for part in ("imumon 0.0.9", "abc", f"written by imumon {__version__}", commit() or "-"):
        assert part in text
