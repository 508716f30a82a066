"""Laws of the readiness: it follows from the limits, times and statuses of the report, and promises nothing else."""

from __future__ import annotations

import typing
from dataclasses import replace

import reports

from imumon.api.measurement import Measurement
from imumon.documents.program_settings import PROGRAMS
from imumon.model.coefficients import NOISE, Estimate
from imumon.model.readiness import (
    USUAL_RECORD_S,
    ProgramName,
    letters_for,
    readiness,
    ready_text,
    seconds_left,
    state_of,
)
from imumon.model.report import Channel, Report
from imumon.model.samples import INERTIAL

GOALS = {"N": 0.01, "B": 0.2, "K": 0.5}


def with_widths(widths: dict[str, float], times: dict[str, float | None], **changes: object) -> Report:
    """Return the long report with these half-widths of its coefficients, and these times, on every inertial axis."""
    report = reports.long_report()
    channels = {
        name: replace(channel, coefficients=with_limits(channel, widths), time_to=times)
        if name.sensor in INERTIAL
        else channel
        for name, channel in report.channels.items()
    }
    return replace(report, channels=channels, **{"state": "running", "precision": GOALS, **changes})  # type: ignore[arg-type]


def with_limits(channel: Channel, widths: dict[str, float]) -> dict[str, Estimate]:
    """Return the coefficients of a channel as measured, with these half-widths as a share of a value of 1."""
    return {
        letter: Estimate(
            value=1.0, low=1.0 - width, high=1.0 + width, combined_low=1.0 - width, combined_high=1.0 + width,
            status="measured", unit="rad/s",
        )
        for letter, width in widths.items()
    }  # fmt: skip


def test_the_slowest_axis_decides_and_what_cannot_be_promised_is_not() -> None:
    report = with_widths({"N": 0.005, "B": 0.3, "K": 1.0}, {"N": 0.0, "B": 780.0, "K": None})
    assert report.session.elapsed_s > USUAL_RECORD_S
    assert ready_text(report, "kalibr") == "ready for kalibr: N yes, K not yet"
    young = replace(report, session=replace(report.session, elapsed_s=3600.0))
    assert ready_text(young, "kalibr") == "ready for kalibr: N yes, K usually after 8 h"
    slow = replace(report.channels["accel/y"], time_to={"N": 5.0, "B": 3600.0, "K": None})
    report = replace(report, channels={**report.channels, "accel/y": slow})
    assert [(item.ready, item.seconds) for item in readiness(report, NOISE)] == [
        (True, None),
        (False, 3600.0),
        (False, None),
    ]


def test_the_mark_follows_from_the_printed_limits_and_not_from_the_time() -> None:
    """The limits hold more than the statistics of the fit, whose time may say 0 before they are narrow enough."""
    report = with_widths({"N": 0.013, "B": 0.204, "K": 0.5}, {"N": 0.0, "B": 500.0, "K": 9.0})
    channel = report.channels["gyro/x"]
    assert [state_of(channel, letter, GOALS) for letter in NOISE] == ["growing", "ready", "ready"]
    assert [seconds_left(channel, letter, GOALS) for letter in NOISE] == [None, 0.0, 0.0]


def test_a_record_that_has_ended_promises_nothing() -> None:
    report = with_widths({"N": 0.005, "K": 1.0}, {"N": 0.0, "K": 780.0}, state="stopped")
    assert ready_text(report, "kalibr") == "ready for kalibr: N yes, K no"


def test_in_time_lapse_the_minutes_are_those_of_the_sensor() -> None:
    report = with_widths({"N": 0.005, "K": 1.0}, {"N": 0.0, "K": 780.0}, speed=60.0)
    assert ready_text(report, "kalibr") == "ready for kalibr: N yes, K in 13 min of sensor time"


def test_what_is_not_measured_has_no_state_of_its_own() -> None:
    channel = reports.long_report().channels["gyro/x"]
    bound = replace(channel.coefficients["K"], status="upper_bound", value=None)
    assert state_of(replace(channel, coefficients={"K": bound}), "K", GOALS) == "bound"
    assert state_of(channel, "Z", GOALS) == "none"


def test_ready_names_exactly_the_coefficients_that_each_program_takes() -> None:
    """A coefficient that is not measured makes a number a comment if, and only if, the program takes it."""
    whole = reports.long_report()
    known, without = dict(whole.channels["gyro/x"].coefficients), {}
    for letter in NOISE:
        bound = replace(known[letter], status="upper_bound", value=None, low=0.0)
        channel = replace(whole.channels["gyro/x"], coefficients={**known, letter: bound})
        without[letter] = Measurement(replace(whole, channels={**whole.channels, "gyro/x": channel}))
    complete = Measurement(whole)
    for program in PROGRAMS:
        numbers = len(complete.settings(program))
        taken = [letter for letter, part in without.items() if len(part.settings(program)) < numbers]
        assert taken == list(letters_for(program)), program
    assert set(typing.get_args(ProgramName)) == set(PROGRAMS)
