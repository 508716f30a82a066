"""Laws of the readiness: it follows from the times and statuses of the report, and promises nothing else."""

from __future__ import annotations

import typing
from dataclasses import replace

import pytest
import reports

from imumon.documents.program_settings import PROGRAMS
from imumon.model.coefficients import NOISE
from imumon.model.readiness import ProgramName, letters_for, readiness, ready_text, state_of
from imumon.model.report import Report
from imumon.model.samples import INERTIAL, sensor_of


def with_times(times: dict[str, float | None], **changes: object) -> Report:
    """Return the long report, whose N, B and K are measured, with these times on every inertial axis."""
    report = reports.long_report()
    channels = {
        name: replace(channel, time_to=times) if sensor_of(name) in INERTIAL else channel
        for name, channel in report.channels.items()
    }
    return replace(report, channels=channels, **{"state": "running", **changes})  # type: ignore[arg-type]


def test_the_slowest_axis_decides_and_what_cannot_be_promised_is_not() -> None:
    report = with_times({"N": 0.0, "B": 780.0, "K": None})
    assert ready_text(report, "kalibr", NOISE) == "ready for kalibr: N yes, B in 13 min, K not yet"
    slow = replace(report.channels["accel/y"], time_to={"N": 5.0, "B": 3600.0, "K": None})
    report = replace(report, channels={**report.channels, "accel/y": slow})
    assert [(item.ready, item.seconds) for item in readiness(report, NOISE)] == [
        (False, 5.0),
        (False, 3600.0),
        (False, None),
    ]


def test_a_record_that_has_ended_promises_nothing() -> None:
    report = with_times({"N": 0.0, "B": 780.0, "K": None}, state="stopped")
    assert ready_text(report, "kalibr", NOISE) == "ready for kalibr: N yes, B no, K no"


def test_in_time_lapse_the_minutes_are_those_of_the_sensor() -> None:
    report = with_times({"N": 0.0, "B": 780.0, "K": None}, speed=60.0)
    assert (
        ready_text(report, "kalibr", NOISE)
        == "ready for kalibr: N yes, B in 13 min of sensor time, K not yet"
    )


def test_a_report_without_curves_has_no_readiness() -> None:
    assert ready_text(reports.nothing_yet(), "kalibr", NOISE) == ""


def test_each_coefficient_has_one_state() -> None:
    report = with_times({"N": 0.0, "B": 1.0, "K": None})
    channel = report.channels["gyro/x"]
    assert [state_of(channel, letter) for letter in "NB"] == ["ready", "growing"]
    bound = replace(channel.coefficients["K"], status="upper_bound", value=None)
    assert state_of(replace(channel, coefficients={"K": bound}), "K") == "bound"
    assert state_of(channel, "R" if channel.estimates.get("R") is None else "Z") == "none"


@pytest.mark.parametrize("program", typing.get_args(ProgramName))
def test_the_programs_are_those_of_the_settings_files(program: str) -> None:
    assert letters_for(program) == PROGRAMS[program].letters
