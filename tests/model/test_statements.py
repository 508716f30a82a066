"""What is said of a report: readiness, grades and caveats."""

from __future__ import annotations

import typing
from dataclasses import replace

import pytest
import reports

from imumon.api.measurement import Measurement
from imumon.documents.program_settings import PROGRAMS
from imumon.model import messages
from imumon.model.coefficients import GRADES, NOISE, SCALE, Estimate
from imumon.model.grading import LIMITS, grade_at, grade_channel, grade_sensor
from imumon.model.messages import CAVEATS
from imumon.model.readiness import (
    USUAL_RECORD_S,
    ProgramName,
    letters_for,
    readiness,
    ready_text,
    seconds_left,
    state_of,
)
from imumon.model.report import Channel, DecidedBy, NoiseModel, Report, SensorGrade
from imumon.model.samples import GYRO, INERTIAL

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
    report = reports.with_channel(report, "accel/y", time_to={"N": 5.0, "B": 3600.0, "K": None})
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


def test_what_is_not_measured_has_no_state_of_its_own() -> None:
    channel = reports.long_report().channels["gyro/x"]
    bound = replace(channel.coefficients["K"], status="upper_bound", value=None)
    assert state_of(replace(channel, coefficients={"K": bound}), "K", GOALS) == "bound"
    assert state_of(channel, "Z", GOALS) == "none"


def test_ready_names_exactly_the_coefficients_that_each_program_takes() -> None:
    """A coefficient that is not measured makes a number a comment if, and only if, the program takes it."""
    whole = reports.long_report()
    without = {letter: Measurement(reports.with_bound(whole, letter, GYRO[0])) for letter in NOISE}
    complete = Measurement(whole)
    for program in PROGRAMS:
        numbers = len(complete.settings(program))
        taken = [letter for letter, part in without.items() if len(part.settings(program)) < numbers]
        assert taken == list(letters_for(program)), program
    assert set(typing.get_args(ProgramName)) == set(PROGRAMS)


# ---------------------------------------- grades


# SI values of one VN-100, as printed in its static characterisation report
VN100_GYRO = {
    "x": (8.858211836469779e-5, 2.187472354808633e-6),
    "y": (1.118982270722039e-4, 3.558918644938269e-5),
    "z": (9.042853866968627e-5, 1.683075710026665e-6),
}
VN100_ACCEL = {
    "x": (0.001876856697026, 4.102051157211426e-4),
    "y": (0.001896141910733, 0.001026494646724),
    "z": (0.002811394406225, 5.055396828094319e-4),
}


def measured(value: float, width: float = 0.0) -> Estimate:
    return Estimate(value=value, low=value * (1 - width), high=value * (1 + width), status="measured")


def bounded(high: float) -> Estimate:
    return Estimate(low=0.0, high=high, status="upper_bound")


def axes(values):
    return {axis: {"N": measured(n), "B": measured(b)} for axis, (n, b) in values.items()}


def test_limits_agree_with_the_primer():
    table = LIMITS
    assert table["gyro"]["N"]["consumer"] * 3437.747 == pytest.approx(2.0, rel=1e-6)
    assert table["gyro"]["B"]["tactical"] * 206264.806 == pytest.approx(1.0, rel=1e-6)
    assert table["accel"]["B"]["industrial"] / 9.80665e-3 == pytest.approx(1.0, rel=1e-12)
    assert table["accel"]["N"]["navigation"] * 60 == pytest.approx(0.01, rel=1e-12)
    for coefficients in table.values():
        for row in coefficients.values():
            assert tuple(row) == GRADES
            assert list(row.values()) == sorted(row.values())


def test_grades_agree_with_a_published_report():
    assert [grade_at("gyro", "N", VN100_GYRO[axis][0]) for axis in "xyz"] == ["consumer"] * 3
    assert [grade_at("gyro", "B", VN100_GYRO[axis][1]) for axis in "xyz"] == [
        "tactical",
        "industrial",
        "tactical",
    ]
    gyro, accel = grade_sensor("gyro", axes(VN100_GYRO)), grade_sensor("accel", axes(VN100_ACCEL))
    assert gyro.meets == gyro.best == gyro.worst == accel.meets == "consumer"
    assert gyro.decided_by == DecidedBy(axis="y", coefficient="N")
    assert accel.decided_by == DecidedBy(axis="z", coefficient="N")
    assert not gyro.provisional
    assert not accel.provisional


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
@pytest.mark.parametrize("coefficient", ["N", "B"])
def test_a_limit_itself_meets_its_grade(sensor, coefficient):
    for grade, limit in LIMITS[sensor][coefficient].items():
        assert grade_at(sensor, coefficient, limit) == grade
        assert grade_at(sensor, coefficient, limit * 1.001) == SCALE[SCALE.index(grade) + 1]
    assert grade_at(sensor, coefficient, 1e3) == SCALE[-1]


def test_a_bound_counts_until_it_is_small_enough():
    loose = bounded(LIMITS["gyro"]["B"]["consumer"])
    industrial = measured(LIMITS["gyro"]["N"]["industrial"])
    assert grade_channel("gyro", {"N": industrial, "B": loose}) == "consumer"
    grade = grade_sensor("gyro", {"x": {"N": industrial, "B": loose}})
    assert (grade.meets, grade.best, grade.worst) == ("consumer", "industrial", "consumer")
    assert grade.provisional
    assert grade.reason == "B of x is only bounded: the grade may be industrial"
    tight = bounded(LIMITS["gyro"]["B"]["tactical"])
    grade = grade_sensor("gyro", {"x": {"N": industrial, "B": tight}})
    assert (grade.meets, grade.provisional) == ("industrial", False)
    scattered = replace(industrial, combined_low=5e-5, combined_high=3e-4)
    assert grade_sensor("gyro", {"x": {"N": scattered, "B": tight}}).provisional


def test_the_grade_is_provisional_while_it_can_change():
    wide = measured(LIMITS["gyro"]["N"]["industrial"] * 2, 0.9)
    grade = grade_sensor("gyro", {"x": {"N": wide, "B": measured(1e-6)}})
    assert (grade.best, grade.meets, grade.worst) == ("tactical", "consumer", "consumer")
    half = grade_sensor("gyro", {"x": {"N": measured(8.9e-5), "B": Estimate()}})
    assert (half.best, half.meets, half.worst) == ("consumer", "consumer", "below consumer")
    assert half.provisional
    assert half.reason
    poor = grade_sensor("gyro", {"x": {"N": measured(1.0), "B": Estimate()}})
    assert (poor.meets, poor.provisional) == ("below consumer", False)  # B cannot make it better


def test_a_grade_is_compared_with_a_required_one():
    grade = SensorGrade(best="tactical", meets="industrial", worst="consumer")
    assert [grade.compared_with(required) for required in SCALE] == [
        "missed", "open", "open", "reached", "reached",
    ]  # fmt: skip
    assert SensorGrade().compared_with("consumer") == "open"


# ---------------------------------------- texts for caveats, clocks and grades


def test_a_caveat_has_a_line_and_advice() -> None:
    made = reports.report()
    for caveat, meaning in CAVEATS.items():
        assert 0 < len(meaning.line) <= 80
        assert not meaning.line.endswith(".")
        assert messages.advice(made, caveat).endswith(".")


def test_an_oscillation_is_named_with_its_period() -> None:
    made = reports.report()
    channel = replace(
        made.channels["gyro/x"], model=NoiseModel(oscillations_s=(312.0,)), caveats=("oscillation",)
    )
    text = messages.advice(replace(made, channels={GYRO[0]: channel}), "oscillation")
    assert "period 5 min 12 s" in text


def test_caveats_of_the_whole_record_name_no_channel() -> None:
    made = reports.report(caveats=("aliased",))
    assert messages.caveats(made) == {"aliased": [], "vibration": ["accel/y"]}
    aliased, vibration = messages.caveat_lines(made)
    assert aliased == CAVEATS["aliased"].line
    assert vibration == f"accel y: {CAVEATS['vibration'].line}"
