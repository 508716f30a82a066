"""Grades: the table, nearest and met grades, and the deciding coefficient."""

from dataclasses import replace

import pytest

from imumon.model.coefficients import GRADES, Estimate
from imumon.noise.grading import LIMITS, grade_channel, grade_coefficient, grade_sensor

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
    channels = {axis: grade_channel("gyro", known).coefficients for axis, known in axes(GYRO).items()}
    assert [channels[a]["N"].meets for a in "xyz"] == ["consumer"] * 3
    assert [channels[a]["N"].nearest for a in "xyz"] == ["industrial"] * 3
    assert [channels[a]["B"].meets for a in "xyz"] == ["tactical", "industrial", "tactical"]
    assert [channels[a]["B"].nearest for a in "xyz"] == ["tactical", "industrial", "tactical"]
    gyro, accel = grade_sensor("gyro", axes(GYRO)), grade_sensor("accel", axes(ACCEL))
    assert gyro.nearest == accel.nearest == "industrial"
    assert gyro.meets == accel.meets == "consumer"
    assert gyro.decided_by == ("y", "N")
    assert accel.decided_by == ("z", "N")
    assert not gyro.provisional
    assert not accel.provisional


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
@pytest.mark.parametrize("coefficient", ["N", "B"])
def test_a_limit_itself_meets_its_grade(sensor, coefficient):
    for grade, limit in LIMITS[sensor][coefficient].items():
        assert grade_coefficient(sensor, coefficient, limit).meets == grade
        assert grade_coefficient(sensor, coefficient, limit).nearest == grade
        assert grade_coefficient(sensor, coefficient, limit * 1.001).meets != grade
    assert grade_coefficient(sensor, coefficient, 1e3).meets is None
    assert grade_coefficient(sensor, coefficient, 1e3).nearest == "consumer"


def test_a_bound_decides_only_where_nothing_is_measured():
    loose = bounded(LIMITS["gyro"]["B"]["consumer"])
    channel = grade_channel("gyro", {"N": measured(8.9e-5), "B": loose})
    assert channel.nearest == "industrial"
    assert channel.meets == "consumer"
    headline = grade_sensor("gyro", {"x": {"N": measured(8.9e-5), "B": loose}})
    assert headline.nearest == "industrial"
    assert headline.provisional
    assert headline.reason
    assert channel.coefficients["B"].nearest == "consumer"
    assert grade_sensor("gyro", {"x": {"B": loose}}).nearest == "consumer"
    tight = bounded(LIMITS["gyro"]["B"]["tactical"])
    assert not grade_sensor("gyro", {"x": {"N": measured(8.9e-5), "B": tight}}).provisional
    scattered = replace(measured(8.9e-5), combined_low=8e-5, combined_high=3e-4)
    assert grade_sensor("gyro", {"x": {"N": scattered, "B": tight}}).provisional


def test_the_headline_is_provisional_while_it_can_change():
    wide = measured(LIMITS["gyro"]["N"]["industrial"] * 2, 0.9)
    assert grade_sensor("gyro", {"x": {"N": wide, "B": measured(1e-6)}}).provisional
    half = grade_sensor("gyro", {"x": {"N": measured(8.9e-5), "B": Estimate()}})
    assert half.provisional
    assert half.nearest == "industrial"
    assert half.reason
