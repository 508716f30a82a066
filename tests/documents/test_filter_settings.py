"""Settings for other programs: their numbers do there what the sensor does."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from documents import AGES, COVARIANCES, SETTINGS, aged, filters, text, worst
from reports import LONG_RATE, LONG_S, RATE, with_bound, with_coefficients
from reports import report as make_report

from imumon.documents import document
from imumon.documents.program_settings import numbers_of, settings_document
from imumon.model.coefficients import Estimate
from imumon.model.messages import CAVEATS
from imumon.model.report import Report
from imumon.model.samples import GYRO, ChannelName


def settings(report: Report, form: str) -> dict[str, float]:
    """Return the lines ``name: number`` that are not comments."""
    lines = re.findall(r"^\s*(\w+): ([-+.\de]+)(?:  # .*)?$", text(report, form), re.MULTILINE)
    return {name: float(value) for name, value in lines}


CAMERA = (
    "gyroscope_noise_density",
    "gyroscope_random_walk",
    "accelerometer_noise_density",
    "accelerometer_random_walk",
)
CONTINUOUS = {
    "kalibr": (*CAMERA, "update_rate"),
    "openvins": (*CAMERA, "update_rate"),
    "liosam": ("imuGyrNoise", "imuGyrBiasN", "imuAccNoise", "imuAccBiasN"),
    "orbslam3": ("IMU.NoiseGyro", "IMU.GyroWalk", "IMU.NoiseAcc", "IMU.AccWalk", "IMU.Frequency"),
}
"""Names of the numbers of programs that take densities of continuous time, and the sample rate."""


@pytest.mark.parametrize("form", CONTINUOUS)
def test_densities_and_walks_are_those_of_the_worst_axis(form: str) -> None:
    report = make_report(LONG_S)
    expected = []
    for sensor in ("gyro", "accel"):
        numbers = [filters(report).channels[f"{sensor}/{axis}"] for axis in "xyz"]
        expected += [max(each.white for each in numbers), max(each.walk for each in numbers)]
    shown = [number(text(report, form), name) for name in CONTINUOUS[form]]
    assert shown[:4] == pytest.approx(expected, rel=1e-6)
    assert shown[4:] in ([LONG_RATE], [])


def test_a_walk_that_rests_on_a_bound_is_a_comment_with_the_bound() -> None:
    report = with_bound(make_report(LONG_S), "K", *GYRO)
    bound = "K of [xyz] does not show in this record: it counts with half its 95 % upper bound"
    for form, line in (
        ("kalibr", "gyroscope_random_walk: "),
        ("openvins", "gyroscope_random_walk: "),
        ("px4", "param set EKF2_GYR_B_NOISE "),
        ("kfgins", "gbstd: "),
        ("gtsam", "params.setBiasOmegaCovariance("),
        ("vins", "gyr_w: "),
        ("fastlio", "b_gyr_cov: "),
        ("liosam", "imuGyrBiasN: "),
        ("orbslam3", "IMU.GyroWalk: "),
    ):
        bounded = rf"^ *# {re.escape(line)}.*{bound}, [-.e\d]+$"
        assert re.search(bounded, text(report, form), re.MULTILINE), form
        assert not re.search(bound, text(make_report(LONG_S), form))
    # above the value: on its line it would be part of the value
    assert re.search(
        rf"^# EK3_GBIAS_P_NSE in .*  # {bound}, .*\n# EK3_GBIAS_P_NSE,", text(report, "ardupilot"), re.M
    )
    for program in SETTINGS:
        shown = numbers_of(settings_document(program, report, filters(report)))
        whole = numbers_of(settings_document(program, report, filters(report), bounds=True))
        # only a covariance of a sample rests on N alone
        assert len(shown) < len(whole) or program == "ros"
        assert shown.items() <= whole.items()


@pytest.mark.few
@pytest.mark.parametrize("age", ["nothing", "seconds"])
def test_an_unknown_coefficient_is_never_a_number(age: str) -> None:
    report = aged(age)
    for sensor in ("gyro", "accel"):
        for letter, key in (("N", "noise_density"), ("K", "random_walk")):
            name = {"gyro": "gyroscope", "accel": "accelerometer"}[sensor] + f"_{key}"
            assert (name in settings(report, "kalibr")) == (worst(report, sensor, letter).value is not None)
            if worst(report, sensor, letter).value is None:
                assert f"# {name}: ?" in text(report, "kalibr")


def with_k(report: Report, code: str | None, *, gyro: bool) -> Report:
    """Return the report with gyroscopes whose K is unknown for the reason of this code, or without gyroscopes."""
    some = {n: c for n, c in report.channels.items() if not n.startswith("gyro") or gyro}
    unknown = Estimate(reason_code=code)
    changed = {n: with_coefficients(c, K=unknown) if n.startswith("gyro") else c for n, c in some.items()}
    return replace(report, channels=changed)


@pytest.mark.parametrize(
    ("code", "gyro", "cure"),
    [
        (None, True, "record longer"),
        ("constant", True, "dead or stuck"),
        ("resolution", True, "more digits"),
        (None, False, "holds no gyroscope"),
    ],
)
def test_a_longer_record_is_advised_only_where_it_helps(code: str | None, gyro: bool, cure: str) -> None:
    for form in SETTINGS:
        shown = text(with_k(make_report(), code, gyro=gyro), form)
        assert cure in shown
        assert ("record longer" in shown) == (cure == "record longer")


@pytest.mark.parametrize("form", SETTINGS)
def test_caveats_precede_the_numbers(form: str) -> None:
    report = make_report()
    caveats = tuple(sorted({*CAVEATS} - {"aliased"}))
    one = {"gyro/x": replace(report.channels["gyro/x"], caveats=caveats)}
    of_all = text(replace(report, caveats=caveats), form)
    of_one = text(replace(report, channels=report.channels | one), form)
    assert not [c for c in caveats if f"WARNING: {c.replace('_', ' ')}: " not in of_all]
    assert not [c for c in caveats if f"WARNING: {c.replace('_', ' ')} (gyro x" not in of_one]
    mag = replace(report.channels["gyro/x"], caveats=("vibration",))  # no program takes a magnetometer
    of_mag = replace(report, channels={**report.channels, ChannelName("mag/x"): mag})
    assert "mag x" not in text(of_mag, form)


def test_ros_covariance_is_the_variance_of_a_sample() -> None:
    report = make_report()
    for field, sensor in (("angular_velocity", "gyro"), ("linear_acceleration", "accel")):
        row = re.search(rf"^{field}_covariance: \[(.*)\]", text(report, "ros"), re.MULTILINE)
        assert row
        matrix = np.array([float(v) for v in row[1].split(",")]).reshape(3, 3)
        n = [report.channels[f"{sensor}/{axis}"].coefficients["N"] for axis in "xyz"]
        np.testing.assert_allclose(np.diag(matrix), [(p.value or 0) ** 2 * RATE for p in n if p], rtol=1e-4)
        assert np.count_nonzero(matrix) == 3


@pytest.mark.parametrize(
    ("form", "line", "step_s", "names"),
    [
        ("px4", r"^param set EKF2_(\w+) (\S+)$", 0.010, "GYR_NOISE GYR_B_NOISE ACC_NOISE ACC_B_NOISE"),
        ("ardupilot", r"^EK3_(\w+),(\S+)$", 0.012, "GYRO_P_NSE GBIAS_P_NSE ACC_P_NSE ABIAS_P_NSE"),
    ],
)
def test_the_variance_of_an_autopilot_filter_grows_as_that_of_the_sensor(
    form: str, line: str, step_s: float, names: str
) -> None:
    """Both add (s dt)^2 in a step of dt, to angle or velocity and to the bias: N^2 or K^2 a second."""
    report = make_report(LONG_S)
    values = dict(re.findall(line, text(report, form), re.MULTILINE))
    parts = [(sensor, letter) for sensor in ("gyro", "accel") for letter in "NK"]
    for name, (sensor, letter) in zip(names.split(), parts, strict=True):
        grown = sum((float(values[name]) * step_s) ** 2 for _ in range(round(12.0 / step_s)))
        expected = worst(report, sensor, letter).value or 0.0
        assert grown == pytest.approx(12.0 * expected**2, rel=1e-3)


def number(shown: str, name: str) -> float:
    """Return the value of a line ``name: number``, whatever its indent."""
    found = re.search(rf"^ *{re.escape(name)}: ([-+.\de]+)(?:  # .*)?$", shown, re.MULTILINE)
    assert found, name
    return float(found[1])


def test_a_sample_of_vins_and_fastlio_adds_what_the_sensor_adds() -> None:
    """The steps of their sources, for a second of samples: the variances grow by N^2 and walk^2."""
    report = make_report(LONG_S)
    dt = 1.0 / LONG_RATE
    for sensor, short in (("gyro", "gyr"), ("accel", "acc")):
        white, walk = (worst(report, sensor, letter).value or 0.0 for letter in "NK")
        vins, fastlio = text(report, "vins"), text(report, "fastlio")
        n, w = number(vins, f"{short}_n"), number(vins, f"{short}_w")
        # integration_base.h: V has 0.5 dt twice for the rate and dt for the bias
        assert LONG_RATE * 2.0 * (0.5 * dt * n) ** 2 == pytest.approx(white**2, rel=1e-5)
        assert LONG_RATE * (dt * w) ** 2 == pytest.approx(walk**2, rel=1e-5)
        # esekfom.hpp: (dt f_w) Q (dt f_w)^T
        assert LONG_RATE * dt**2 * number(fastlio, f"{short}_cov") == pytest.approx(white**2, rel=1e-5)
        assert LONG_RATE * dt**2 * number(fastlio, f"b_{short}_cov") == pytest.approx(walk**2, rel=1e-5)


def test_kfgins_drives_its_bias_by_the_walk() -> None:
    """gi_engine.cpp: the process is driven by 2 std^2 / corrtime."""
    report = make_report(LONG_S)
    shown = text(report, "kfgins")
    seconds = number(shown, "corrtime") * 3600.0
    for name, sensor, unit in (("gbstd", "gyro", np.pi / 180.0 / 3600.0), ("abstd", "accel", 1e-5)):
        row = re.search(rf"^  {name}: \[(.*)\]  # ", shown, re.MULTILINE)
        assert row
        for axis, std in zip("xyz", row[1].split(","), strict=True):
            walk = filters(report).channels[f"{sensor}/{axis}"].walk
            assert 2.0 * (float(std) * unit) ** 2 / seconds == pytest.approx(walk**2, rel=1e-4)
    n = report.channels["gyro/x"].coefficients["N"]
    assert float(re.search(r"^  arw: \[([^,]*),", shown, re.MULTILINE)[1]) == pytest.approx(
        n.readable.value, rel=1e-5
    )


def test_robot_localization_has_the_error_of_the_bias_in_the_covariance() -> None:
    """Integrated over the horizon, the samples have the variance of white noise and walk together."""
    report = make_report(LONG_S)
    row = re.search(
        r"^angular_velocity_covariance: \[(.*)\]", text(report, "robot_localization"), re.MULTILINE
    )
    assert row
    made = filters(report).channels["gyro/x"]
    variance = float(row[1].split(",")[0]) / LONG_RATE * 600.0
    assert variance == pytest.approx(made.white**2 * 600.0 + made.walk**2 * 600.0**3 / 3.0, rel=1e-3)


@pytest.mark.parametrize("form", SETTINGS)
def test_every_number_says_what_it_is_and_what_it_rests_on(form: str) -> None:
    report = make_report(LONG_S)
    shown = text(report, form)
    units = ("rad/s*sqrt(Hz)", "m/s^2*sqrt(Hz)")
    assert all(unit in shown for unit in units)
    assert "smallest with NEES <= 1.25 for 1 to 600 s" in shown
    factor = filters(report).channels["gyro/x"].walk_factor
    assert factor is not None
    assert f"{factor:.1f} times K" in shown
    assert len(re.findall(r"rests on \d", shown)) >= (2 if form == "ros" else 4)


@pytest.mark.parametrize("form", [form for form in SETTINGS if form not in COVARIANCES])
def test_a_longer_horizon_needs_other_walks(form: str) -> None:
    report = make_report(LONG_S)
    short, long = (document(report, form, filters(report, h)).decode() for h in (1.0, 20000.0))
    assert "at most 20000 s" in long
    numbers = [
        [line for line in shown.splitlines() if not line.strip().startswith("#")] for shown in (short, long)
    ]
    assert numbers[0] != numbers[1]


@pytest.mark.few
@pytest.mark.parametrize("age", AGES)
def test_gtsam_is_python_and_leaves_no_covariance_of_one(age: str) -> None:
    code = text(aged(age), "gtsam")
    compile(code, "gtsam", "exec")
    assert "params.setIntegrationCovariance(" in code


def test_gtsam_before_4_3_adds_no_uncertainty_of_the_bias_to_each_sample(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """GTSAM 4.2 has 1 rad/s and 1 m/s^2 by default: its rotation is then unknown after a second."""
    for has_it in (True, False):
        calls: dict[str, Any] = {}
        names = ["setAccelerometerCovariance", "setGyroscopeCovariance", "setIntegrationCovariance"]
        names += [
            "setBiasAccCovariance",
            "setBiasOmegaCovariance",
            *(["setBiasAccOmegaInit"] if has_it else []),
        ]
        made = SimpleNamespace(**{name: partial(calls.__setitem__, name) for name in names})
        maker = SimpleNamespace(MakeSharedU=lambda gravity, made=made: made)
        module = SimpleNamespace(PreintegrationCombinedParams=maker)
        monkeypatch.setitem(sys.modules, "gtsam", module)
        exec(text(make_report(LONG_S), "gtsam"), {})
        assert sorted(calls) == sorted(names)
        if has_it:
            np.testing.assert_array_equal(calls["setBiasAccOmegaInit"], np.zeros((6, 6)))
