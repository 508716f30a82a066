"""Every door gives the same answer to one question: the grade, whether a number is ready, the numbers of a program."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import reports
from commands import imumon, run_inside
from documents import words
from test_check import plugin, published

from imumon.api.measurement import Measurement
from imumon.cli.wait_condition import WaitCondition
from imumon.documents.program_settings import number_lines, numbers_of
from imumon.model.coefficients import GRADES, NOISE
from imumon.model.messages import grade_text
from imumon.model.readiness import letters_for, ready_text, state_of
from imumon.model.report import Report
from imumon.model.report_json import to_json
from imumon.model.samples import INERTIAL
from imumon.tui.channel_table import SYMBOLS, rows_of
from imumon.tui.export import copied_lines
from imumon.tui.panels import headlines
from imumon.tui.view_state import ViewState

CODES = {"reached": 0, "open": 1, "missed": 2}


@pytest.fixture(scope="module")
def report() -> Report:
    return replace(reports.report(), state="running")


def screen(report: Report) -> str:
    """Return the headline and the table of the screen as text."""
    state = ViewState(reports={report.device.id: report}, id=report.device.id)
    lines = [*headlines(state, 120, 5), *(line for line, _ in rows_of(state, 120))]
    return "\n".join("".join(text for text, _ in line) for line in lines)


def test_each_door_has_the_same_grade(report: Report) -> None:
    with published(report) as place:
        _, status, _ = run_inside(["status", "--connect", place])
        alone = plugin("--connect", place)[0]
        codes = [plugin("--connect", place, "--grade", grade)[0] for grade in GRADES]
    for sensor, grade in report.grade.items():
        for door, text in {
            "status": status,
            "summary": repr(Measurement(report)),
            "datasheet": words(report, "md"),
            "screen": screen(report),
        }.items():
            assert grade_text(grade) in text, (door, sensor)
    for code, required in zip(codes, GRADES, strict=True):
        verdicts = [grade.compared_with(required) for grade in report.grade.values()]
        assert code == max(alone, *(CODES[verdict] for verdict in verdicts)), required
        waited = WaitCondition(grade=required).unmet(report) is None
        assert waited == (set(verdicts) == {"reached"}), required


def test_each_door_has_the_same_ready_coefficients(report: Report) -> None:
    axes = {name: channel for name, channel in report.channels.items() if name.sensor in INERTIAL}
    ready = {letter: [] for letter in NOISE}
    for name, channel in axes.items():
        for letter in NOISE:
            goal = report.precision[letter]
            state = state_of(channel, letter, report.precision)
            wait = WaitCondition(coefficient=letter, precision=goal, channels=(name,))
            assert (wait.unmet(report) is None) == (state == "ready"), (name, letter)
            ready[letter].append(state == "ready")
    marks = screen(report).count(SYMBOLS["ready"][0])
    shown = [c for n, c in report.channels.items() if c.estimates]
    assert marks == sum(state_of(c, letter, report.precision) == "ready" for c in shown for letter in NOISE)
    text = ready_text(report, "kalibr")
    assert text in screen(report)
    assert [f"{letter} yes" in text for letter in letters_for("kalibr")] == [
        all(ready[letter]) for letter in letters_for("kalibr")
    ]


@pytest.mark.few(2)
@pytest.mark.parametrize("program", ["kalibr", "vins", "ros"])
@pytest.mark.parametrize("made", [reports.report, reports.long_report])
def test_each_door_gives_the_same_numbers(made, program: str, tmp_path: Path) -> None:
    report = made()
    saved = tmp_path / "report.json"
    saved.write_text(to_json(report))
    file = imumon("report", saved, "--format", program)
    assert Measurement(report).settings(program) == numbers_of(file)
    assert copied_lines(report, program)[1:] == number_lines(file)
