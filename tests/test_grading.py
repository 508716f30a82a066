"""Grades: the table, the grade with those that its limits allow, and the deciding coefficient."""

from dataclasses import replace

import pytest

from imumon.model.coefficients import GRADES, SCALE, Estimate
from imumon.model.grading import LIMITS, grade_at, grade_channel, grade_sensor
from imumon.model.report import DecidedBy, SensorGrade

# SI values of one VN-100, as printed in its static characterisation report
GYRO = {
    "x": (8.858211836469779e-5, 2.187472354808633e-6),
    "y": (1.118982270722039e-4, 3.558918644938269e-5),
    "z": (9.042853866968627e-5, 1.683075710026665e-6),
}
ACCEL = {
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
    assert [grade_at("gyro", "N", GYRO[axis][0]) for axis in "xyz"] == ["consumer"] * 3
    assert [grade_at("gyro", "B", GYRO[axis][1]) for axis in "xyz"] == ["tactical", "industrial", "tactical"]
    gyro, accel = grade_sensor("gyro", axes(GYRO)), grade_sensor("accel", axes(ACCEL))
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
