"""Documents of a report: complete, correct and usable for every report."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from commands import imumon
from daemons import Daemon
from reports import LENGTH_S, LONG_RATE, LONG_S, RATE, nothing_yet, with_coefficients
from reports import report as make_report

from imumon.datasheet import FORMS, NoCurve, document, short_record_text
from imumon.datasheet.content import datasheet_content
from imumon.datasheet.csv_table import COLUMNS as CSV_COLUMNS
from imumon.datasheet.elements import DataTable
from imumon.datasheet.figures import PANEL_INCHES, PRINT, svg
from imumon.datasheet.figures import _draw as draw
from imumon.datasheet.filter_figure import filter_svg
from imumon.datasheet.filter_values import FilterValue, worst_axis
from imumon.datasheet.signal_text import baseline_summary, signal_lines
from imumon.datasheet.tables import FULL, coefficient_text, report_table, shown_letters
from imumon.filter_report import FilterReport
from imumon.messages import CAVEATS, FILTER_NOT_KNOWN, uncertainty
from imumon.noise.filter_parameters import filter_parameters
from imumon.noise.synthesis import synthesise
from imumon.pipeline.report_builder import effective_samples
from imumon.report import COEFFICIENTS, Allan, Estimate, Report, from_json, to_json
from imumon.tui.formatting import Notation
from imumon.units import duration, figures, pretty

AGES = {"nothing": 0.0, "seconds": 3.0, "minutes": 200.0, "hours": LENGTH_S, "long": LONG_S}


def aged(name: str) -> Report:
    return nothing_yet() if name == "nothing" else make_report(AGES[name])


_FILTERS: dict[object, FilterReport] = {}


def filters(report: Report, horizon_s: float = 600.0) -> FilterReport:
    """Return the parameters for filters; those of a noise that was seen before are not computed again."""
    seen = [(name, tuple(c.coefficients.items()), c.caveats) for name, c in report.channels.items()]
    key = (horizon_s, tuple(seen))
    if key not in _FILTERS:
        _FILTERS[key] = filter_parameters(report, horizon_s)
    return replace(_FILTERS[key], time=report.time, device=report.device, elapsed_s=report.session.elapsed_s)


_DOCUMENTS: dict[tuple[int, str], tuple[Report, bytes]] = {}


def made(report: Report, form: str) -> bytes:
    """Return a document; one of a report that was documented before is not made again."""
    key = id(report), form
    if key not in _DOCUMENTS:
        _DOCUMENTS[key] = report, document(report, form, filters(report))
    return _DOCUMENTS[key][1]


def text(report: Report, form: str) -> str:
    return made(report, form).decode()


def worst(report: Report, sensor: str, letter: str) -> FilterValue:
    return worst_axis(report, filters(report), sensor, letter)


SETTINGS = [f for f, what in FORMS.items() if what.settings and not what.curves and f != "filter"]
CURVES = [form for form, what in FORMS.items() if what.curves]
COVARIANCES = ("ros", "robot_localization")
FIGURES = ("svg", "pdf-figure", "png")


@pytest.mark.parametrize("age", AGES)
def test_every_form_of_every_age_is_complete(age: str) -> None:
    left_out = (*FIGURES, "pdf", *(CURVES if age != "hours" else ()))  # nothing else has a curve
    shown = {form: text(aged(age), form) for form in FORMS if form not in left_out}
    assert not [form for form, page in shown.items() if not page.endswith("\n")]
    unknown_without_a_text = re.compile(r"\bnan\b|\binf\b|\bNone\b")
    assert not [form for form, page in shown.items() if unknown_without_a_text.search(page)]


@pytest.mark.parametrize("age", ["minutes", "hours"])
def test_a_figure_has_its_format(age: str) -> None:
    assert made(aged(age), "png").startswith(b"\x89PNG\r\n\x1a\n")
    assert made(aged(age), "pdf-figure").startswith(b"%PDF-")
    assert ET.fromstring(made(aged(age), "svg")).tag.endswith("svg")


def svg_text(report: Report) -> str:
    """Return the text of the figure as a file, in the order of its elements."""
    root = ET.fromstring(made(report, "svg"))
    return " ".join("".join(each.itertext()) for each in root.iter() if each.tag.endswith("}text"))


def test_a_figure_names_the_device_the_record_and_every_value() -> None:
    report = make_report()
    shown = svg_text(report)
    for text_ in (
        "VN-100T-CR 0100056785",
        "2 h of uncompensated samples at 20 Hz",
        "2026-03-01T08:00:00.000Z",
    ):
        assert text_ in shown
    for sensor in ("gyro", "accel", "mag"):
        for axis in "xyz":
            for letter, part in report.channels[f"{sensor}/{axis}"].coefficients.items():
                unit = pretty(COEFFICIENTS[letter].units[sensor].unit)
                assert f"{letter} {coefficient_text(part)} {unit}" in shown


def test_the_figure_of_the_page_marks_n_b_and_k() -> None:
    letters = [e.text for e in ET.fromstring(svg(make_report(LONG_S), "gyro")).iter("text")]
    assert {"N", "B", "K"} <= set(letters)


@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="poppler is not installed")
def test_pdftotext_finds_the_numbers(tmp_path: Path) -> None:
    (tmp_path / "x.pdf").write_bytes(made(make_report(), "pdf-figure"))
    done = subprocess.run(
        ["pdftotext", "-layout", tmp_path / "x.pdf", "-"],
        capture_output=True,
        text=True,
        check=True,
        timeout=30,
    )
    for axis in "xyz":
        assert coefficient_text(make_report().channels[f"gyro/{axis}"].coefficients["N"]) in done.stdout


@pytest.mark.skipif(shutil.which("rsvg-convert") is None, reason="rsvg-convert is not installed")
def test_rsvg_draws_the_figure(tmp_path: Path) -> None:
    (tmp_path / "x.svg").write_bytes(made(make_report(), "svg"))
    words = ["rsvg-convert", "-w", "800", tmp_path / "x.svg", "-o", tmp_path / "x.png"]
    subprocess.run(words, check=True, timeout=30)
    assert (tmp_path / "x.png").stat().st_size > 50_000


def test_a_figure_leaves_nothing_in_the_home_directory(tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text(to_json(make_report(200.0)))
    environment = {**os.environ, "HOME": str(tmp_path / "home"), "TMPDIR": str(tmp_path / "tmp")}
    for name in ("MPLCONFIGDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        environment.pop(name, None)
    for name in ("home", "tmp"):
        (tmp_path / name).mkdir()
    words = ["report", str(tmp_path / "report.json"), "-o", str(tmp_path / "x.png")]
    subprocess.run([sys.executable, "-m", "imumon", *words], env=environment, check=True, timeout=60)
    assert (tmp_path / "x.png").stat().st_size > 10_000
    assert list((tmp_path / "home").iterdir()) == list((tmp_path / "tmp").iterdir()) == []


@pytest.mark.parametrize("form", FIGURES)
def test_a_figure_without_a_curve_is_an_error(form: str) -> None:
    with pytest.raises(NoCurve) as raised:
        made(nothing_yet(), form)
    assert raised.value.code == "no_curve"


# ---------------------------------------------------------------- settings to paste


def settings(report: Report, form: str) -> dict[str, float]:
    """Return the lines ``name: number`` that are not comments."""
    lines = re.findall(r"^\s*(\w+): ([-+.\de]+)(?:  # .*)?$", text(report, form), re.MULTILINE)
    return {name: float(value) for name, value in lines}


@pytest.mark.parametrize("form", ["kalibr", "openvins"])
def test_densities_and_walks_are_those_of_the_worst_axis(form: str) -> None:
    report = make_report(LONG_S)
    values = settings(report, form)
    for sensor, name in (("gyro", "gyroscope"), ("accel", "accelerometer")):
        for letter, key in (("N", "noise_density"), ("K", "random_walk")):
            numbers = [filters(report).channels[f"{sensor}/{axis}"] for axis in "xyz"]
            expected = max(number.white if letter == "N" else number.walk for number in numbers)
            assert values[f"{name}_{key}"] == pytest.approx(expected, rel=1e-6)
    assert values["update_rate"] == LONG_RATE


def with_bounded_k(report: Report) -> Report:
    """Return the report with gyroscopes of whose K only a bound is known."""
    channels = dict(report.channels)
    for name in ("gyro/x", "gyro/y", "gyro/z"):
        k = channels[name].coefficients["K"]
        assert k is not None
        bounded = replace(k, status="upper_bound", value=None, low=0.0)
        channels[name] = with_coefficients(channels[name], K=bounded)
    return replace(report, channels=channels)


def test_a_walk_that_rests_on_a_bound_has_a_comment() -> None:
    report = with_bounded_k(make_report(LONG_S))
    bound = "K not seen in this record: made for half its 95 % upper bound"
    for form, line in (
        ("kalibr", "gyroscope_random_walk: "),
        ("openvins", "gyroscope_random_walk: "),
        ("px4", "param set EKF2_GYR_B_NOISE "),
        ("ardupilot", "# EK3_GBIAS_P_NSE in "),  # above the value: on its line it would be part of the value
        ("gtsam", "params.setBiasOmegaCovariance("),
        ("vins", "gyr_w: "),
        ("fastlio", "b_gyr_cov: "),
        ("liosam", "imuGyrBiasN: "),
        ("orbslam3", "IMU.GyroWalk: "),
    ):
        assert re.search(rf"^ *{re.escape(line)}.*  # {bound}$", text(report, form), re.MULTILINE)
        assert bound not in text(make_report(LONG_S), form)


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


@pytest.mark.parametrize("form", [*SETTINGS, *CURVES])
def test_caveats_precede_the_numbers(form: str) -> None:
    report = make_report()
    caveats = tuple(sorted({*CAVEATS} - {"aliased"}))
    one = {"gyro/x": replace(report.channels["gyro/x"], caveats=caveats)}
    of_all = text(replace(report, caveats=caveats), form)
    of_one = text(replace(report, channels=report.channels | one), form)
    assert not [c for c in caveats if f"WARNING: {c.replace('_', ' ')}: " not in of_all]
    assert not [c for c in caveats if f"WARNING: {c.replace('_', ' ')} (gyro x" not in of_one]


@pytest.mark.parametrize("form", ["kalibr", "openvins"])
def test_an_unknown_rate_is_no_number(form: str) -> None:
    report = make_report()
    report = replace(report, device=replace(report.device, sample_rate_hz=None))
    assert "update_rate" not in settings(report, form)
    assert "# update_rate: ?" in text(report, form)


def test_ros_covariance_is_the_variance_of_a_sample() -> None:
    report = make_report()
    for field, sensor in (("angular_velocity", "gyro"), ("linear_acceleration", "accel")):
        row = re.search(rf"^{field}_covariance: \[(.*)\]", text(report, "ros"), re.MULTILINE)
        assert row
        matrix = np.array([float(v) for v in row[1].split(",")]).reshape(3, 3)
        n = [report.channels[f"{sensor}/{axis}"].coefficients["N"] for axis in "xyz"]
        np.testing.assert_allclose(np.diag(matrix), [(p.value or 0) ** 2 * RATE for p in n if p], rtol=1e-4)
        assert np.count_nonzero(matrix) == 3


def test_ros_covariance_of_a_constant_sensor_is_unknown() -> None:
    report = make_report()
    dead = {
        name: replace(report.channels[name], coefficients={}, std=0.0)
        for name in report.channels
        if name[:4] == "gyro"
    }
    report = replace(report, channels=report.channels | dead)
    lines = text(report, "ros").splitlines()
    assert "# angular_velocity_covariance: all zeros, which means unknown" in lines
    assert not any(line.startswith("angular_velocity_covariance") for line in lines)


@pytest.mark.parametrize(
    ("form", "line", "step_s", "names"),
    [
        (
            "px4",
            r"^param set (\w+) (\S+)$",
            0.010,
            ("EKF2_GYR_NOISE", "EKF2_GYR_B_NOISE", "EKF2_ACC_NOISE", "EKF2_ACC_B_NOISE"),
        ),
        (
            "ardupilot",
            r"^(EK3_\w+),(\S+)$",
            0.012,
            ("EK3_GYRO_P_NSE", "EK3_GBIAS_P_NSE", "EK3_ACC_P_NSE", "EK3_ABIAS_P_NSE"),
        ),
    ],
)
def test_the_variance_of_an_autopilot_filter_grows_as_that_of_the_sensor(
    form: str, line: str, step_s: float, names: tuple[str, ...]
) -> None:
    """Both add (s dt)^2 in a step of dt, to angle or velocity and to the bias: N^2 or K^2 a second."""
    report = make_report(LONG_S)
    values = dict(re.findall(line, text(report, form), re.MULTILINE))
    parts = [(sensor, letter) for sensor in ("gyro", "accel") for letter in "NK"]
    for name, (sensor, letter) in zip(names, parts, strict=True):
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


def test_liosam_and_orbslam3_take_continuous_time() -> None:
    report = make_report(LONG_S)
    for sensor, lio, orb in (("gyro", "Gyr", "Gyro"), ("accel", "Acc", "Acc")):
        white, walk = (worst(report, sensor, letter).value for letter in "NK")
        liosam, orbslam3 = text(report, "liosam"), text(report, "orbslam3")
        assert number(liosam, f"imu{lio}Noise") == pytest.approx(white, rel=1e-6)
        assert number(liosam, f"imu{lio}BiasN") == pytest.approx(walk, rel=1e-6)
        assert number(orbslam3, f"IMU.Noise{orb}") == pytest.approx(white, rel=1e-6)
        assert number(orbslam3, f"IMU.{orb}Walk") == pytest.approx(walk, rel=1e-6)
    assert number(orbslam3, "IMU.Frequency") == LONG_RATE


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
    assert n is not None
    assert float(re.search(r"^  arw: \[([^,]*),", shown, re.MULTILINE)[1]) == pytest.approx(  # type: ignore[index]
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


@pytest.mark.parametrize(
    ("form", "units"),
    [
        ("vins", {"acc_n": "m/s^2", "gyr_n": "rad/s", "acc_w": "m/s^3", "gyr_w": "rad/s^2"}),
        ("fastlio", {"acc_cov": "(m/s^2)^2", "gyr_cov": "(rad/s)^2"}),
        ("fastlio", {"b_acc_cov": "(m/s^3)^2", "b_gyr_cov": "(rad/s^2)^2"}),
        ("px4", {"EKF2_GYR_NOISE": "rad/s", "EKF2_ACC_B_NOISE": "m/s^3"}),
        ("ardupilot", {"EK3_GYRO_P_NSE": "rad/s", "EK3_ABIAS_P_NSE": "m/s^3"}),
    ],
)  # fmt: skip
def test_a_number_of_another_unit_than_n_and_walk_names_it(form: str, units: dict[str, str]) -> None:
    lines = [line.strip() for line in text(make_report(LONG_S), form).splitlines()]
    for name, unit in units.items():
        assert re.match(rf"(param set )?{name}\b", lines[lines.index(f"# {name} in {unit}") + 1])


def test_a_setting_names_what_of_the_record_it_does_not_rest_on() -> None:
    report = make_report(LONG_S)
    warm = replace(report, session=replace(report.session, warmup_s=3594.0, excluded_s=6.0))
    length = duration(report.session.elapsed_s)
    assert f"rests on {length} of record, 1 h of them excluded" in text(warm, "kalibr")


def test_a_walk_for_a_bounded_k_has_its_factor_against_half_the_bound() -> None:
    report = with_bounded_k(make_report(LONG_S))
    made = filters(report).channels["gyro/x"]
    assert made.walk_factor is None
    factor = figures(made.walk / made.assumed.K, 2)
    assert f"{made.walk:.4e}, {factor} times K {made.assumed.K:.3e}: half its bound, K <" in text(
        report, "kalibr"
    )


@pytest.mark.parametrize("form", [form for form in SETTINGS if form not in COVARIANCES])
def test_a_longer_horizon_needs_other_walks(form: str) -> None:
    report = make_report(LONG_S)
    short, long = (document(report, form, filters(report, h)).decode() for h in (1.0, 20000.0))
    assert "at most 20000 s" in long
    numbers = [
        [line for line in shown.splitlines() if not line.strip().startswith("#")] for shown in (short, long)
    ]
    assert numbers[0] != numbers[1]


@pytest.mark.parametrize("form", ["vins", "fastlio"])
def test_a_discrete_setting_needs_the_rate(form: str) -> None:
    report = make_report(LONG_S)
    shown = text(replace(report, device=replace(report.device, sample_rate_hz=None)), form)
    assert shown.count(": ? (the sample rate is unknown)") == 4


def test_openvins_gets_every_required_matrix() -> None:
    shown = text(make_report(), "openvins")
    for name, size, diagonal in (
        ("T_i_b", 4, 1.0),
        *((name, 3, 1.0) for name in ("Tw", "R_IMUtoGYRO", "Ta", "R_IMUtoACC")),
        ("Tg", 3, 0.0),
    ):
        rows = re.search(rf"^  {name}:\n((?:    - \[.*\]\n)+)", shown, re.MULTILINE)
        assert rows
        matrix = np.array([[float(v) for v in row.split(",")] for row in re.findall(r"\[(.*)\]", rows[1])])
        np.testing.assert_array_equal(matrix, diagonal * np.eye(size))


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
        monkeypatch.setitem(sys.modules, "gtsam", module)  # type: ignore[arg-type]
        exec(text(make_report(LONG_S), "gtsam"), {})
        assert sorted(calls) == sorted(names)
        if has_it:
            np.testing.assert_array_equal(calls["setBiasAccOmegaInit"], np.zeros((6, 6)))


@pytest.mark.parametrize("form", [*SETTINGS, "md", "html"])
def test_every_form_shows_the_caveats_of_the_stream(form: str) -> None:
    report = make_report()
    report = replace(report, caveats=("aliased", "compensated"))
    shown = text(report, form).lower()
    assert "aliased" in shown
    assert "3.16" in shown
    assert "compensated" in shown


# ---------------------------------------------------------------- the datasheet and its forms


@pytest.mark.parametrize("age", ["minutes", "hours", "long"])
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_the_name_of_a_grade_does_not_cover_a_letter(sensor: str, age: str) -> None:
    """N, B and K end where the limits of the grades end, at the right."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=PANEL_INCHES, layout="constrained")
    panel = figure.subplots()
    draw(panel, aged(age), sensor, PRINT)
    figure.draw_without_rendering()
    boxes = [(t.get_text(), t.get_window_extent()) for t in panel.texts if t.get_text()]
    letters = [box for name, box in boxes if name in COEFFICIENTS]
    grades = [(name, box) for name, box in boxes if name not in COEFFICIENTS]
    assert letters
    assert grades
    assert [name for name, box in grades if any(box.overlaps(letter) for letter in letters)] == []


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_the_predicted_error_of_a_filter_is_shown(sensor: str) -> None:
    report = make_report(LONG_S)
    root = ET.fromstring(filter_svg(filters(report), sensor))
    assert len([line for line in root.iter("path") if "stroke-dasharray" in (line.get("style") or "")]) >= 3
    assert 'class="allan"' in text(report, "html")
    sheet = text(report, "md")
    assert "## For a Kalman filter" in sheet
    assert ("angle error of axis" if sensor == "gyro" else "velocity error of axis") in sheet
    assert filter_svg(filters(nothing_yet()), sensor) == ""
    numbers = {"".join(element.itertext()).strip() for element in root.iter("text")}
    assert {"1", "10", "100"} <= numbers  # as in the figure of the Allan deviation, not powers of ten


@pytest.mark.parametrize("age", AGES)
def test_tables_have_a_cell_for_each_column(age: str) -> None:
    report = aged(age)
    for element in datasheet_content(report, filters(report)).elements:
        if isinstance(element, DataTable):
            assert {len(row) for row in element.rows} <= {len(element.head)}
    lines = text(report, "md").splitlines()
    for k, line in enumerate(lines):
        if line.startswith("|--"):
            width = len(re.findall(r"(?<!\\)\|", line))
            for row in (lines[k - 1], *lines[k + 1 : k + 4]):
                if row.startswith("|"):
                    assert len(re.findall(r"(?<!\\)\|", row)) == width


class Balance(HTMLParser):
    """Open elements, and the resources that a browser would fetch."""

    VOID = ("meta", "br")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.fetched: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        links = [str(v) for k, v in attrs if k in ("src", "href")]
        self.fetched += [v for v in links if not v.startswith("#")] + ([tag] if tag == "script" else [])

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.parametrize("age", AGES)
def test_the_page_is_well_formed_and_fetches_nothing(age: str) -> None:
    page = text(aged(age), "html")
    parser = Balance()
    parser.feed(page)
    assert parser.open == []
    assert parser.fetched == []
    assert "url(#" in page or age in ("nothing", "seconds")
    assert not re.search(r"url\((?!#)|@import|https?:", page)


@pytest.mark.parametrize("sensor", ["gyro", "accel", "mag"])
@pytest.mark.parametrize("age", ["minutes", "hours", "long"])
def test_every_point_of_a_curve_is_drawn_within_the_frame(sensor: str, age: str) -> None:
    report = aged(age)
    root = ET.fromstring(svg(report, sensor))
    width, height = (float(v) for v in (root.get("viewBox") or "").split()[2:])
    for axis in "xyz":
        allan = report.channels[f"{sensor}/{axis}"].allan
        assert allan is not None
        styled = ((use, use.get("style") or "") for use in root.iter("use"))
        marks = [use for use, style in styled if f"stroke: var(--{axis})" in style]
        assert len(marks) == len(allan.tau_s) + 1  # one in the legend
        for mark in marks:
            assert 0.0 <= float(mark.get("x") or -1) <= width
            assert 0.0 <= float(mark.get("y") or -1) <= height


def test_a_figure_is_the_same_every_time() -> None:
    assert svg(make_report(), "gyro") == svg(make_report(), "gyro")


@pytest.mark.parametrize("age", AGES)
def test_csv_is_one_tidy_table(age: str) -> None:
    """Every row has the columns of the header, and a reader without options finds every point and coefficient."""
    report = aged(age)
    shown = text(report, "csv")
    table = list(csv.DictReader(io.StringIO(shown)))
    assert {len(row) for row in csv.reader(io.StringIO(shown))} == {len(CSV_COLUMNS)}
    points = [row for row in table if row["kind"] == "allan"]
    assert len(points) == sum(len(c.allan.tau_s) for c in report.channels.values() if c.allan)
    parts = [row for row in table if row["kind"] == "coefficient"]
    shown_parts = [(row["channel"], row["name"]) for row in parts]
    assert shown_parts == [(n, k) for n, c in report.channels.items() for k in c.coefficients]
    assert not [row for row in table if row["value"] and not row["unit"]]
    counters = {row["name"]: row["unit"] for row in table if row["kind"] == "record"}
    assert [counters[name] for name in ("elapsed_s", "discarded_bytes", "samples")] == ["s", "byte", "1"]
    for row in points[:3]:
        at = [f"{tau}" for tau in report.channels["gyro/x"].allan.tau_s].index(row["tau_s"])  # type: ignore[union-attr]
        assert float(row["value"]) == report.channels["gyro/x"].allan.sigma[at]  # type: ignore[union-attr]
        noise = report.channels["gyro/x"].allan.noise[at]  # type: ignore[union-attr]
        assert row["noise"] == ("" if noise is None else str(noise))
    for row in parts:
        part = report.channels[row["channel"]].coefficients[row["name"]]
        assert (row["value"] or None) == (None if part.value is None else str(part.value))
        assert (row["unit"], row["status"]) == (part.unit, part.status)


def test_pandas_reads_the_csv() -> None:
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    table = pandas.read_csv(io.StringIO(text(make_report(), "csv")))
    n = table[(table.kind == "coefficient") & (table.name == "N") & (table.channel == "gyro/x")]
    assert n.value.iloc[0] == make_report().channels["gyro/x"].coefficients["N"].value  # type: ignore[union-attr]
    assert table[table.kind == "allan"].tau_s.notna().all()


def test_json_is_the_report_itself() -> None:
    report = make_report()
    assert from_json(Report, text(report, "json")) == report


# ---------------------------------------------------------------- on the command line


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten minutes at rest as CSV, with a known N."""
    path = tmp_path_factory.mktemp("recording") / "rest.csv"
    noise = synthesise(24_000, 40.0, N=[6e-5] * 3 + [1.4e-3] * 3, seed=4)
    noise[:, 5] -= 9.8
    np.savetxt(
        path,
        np.column_stack([np.arange(24_000) / 40.0, noise]),
        delimiter=",",
        header="t [s],wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]",
        comments="",
        fmt="%.9g",
    )
    return path


def test_recording_to_report_to_datasheet_and_baseline(recording: Path, tmp_path: Path) -> None:
    saved = tmp_path / "saved.json"
    assert imumon("report", recording, "-o", saved) == ""
    report = from_json(Report, saved.read_text())
    n = report.channels["gyro/x"].coefficients["N"]
    assert n is not None
    assert (n.low or 0.0) < 6e-5 < (n.high or 0.0)
    page = tmp_path / "sheet.html"
    imumon("report", saved, "-o", page)
    assert "rest.csv" in page.read_text()
    assert imumon("report", saved, "--format", "kalibr") == text(report, "kalibr")
    again = json.loads(imumon("replay", recording, "--json", "--baseline", saved))
    assert again["channels"]["gyro/x"]["changes"] == []
    printed = imumon("replay", recording, "--baseline", saved)
    assert printed.endswith("\nnothing changed against the baseline\n")
    half = replace(n, value=6e-5 / 2, low=2.9e-5, high=3.1e-5)
    before = replace(
        report, channels=report.channels | {"gyro/x": with_coefficients(report.channels["gyro/x"], N=half)}
    )
    saved.write_text(to_json(before))
    printed = imumon("replay", recording, "--baseline", saved)
    now = float(re.search(r"^gyro/x: N was 0.103, is (\S+) °/√h \(against the baseline\)$", printed, re.M)[1])  # type: ignore[index]
    assert now == pytest.approx(COEFFICIENTS["N"].units["gyro"].factor * (n.value or 0.0), rel=0.01)
    assert "nothing changed" not in printed


@pytest.mark.parametrize("source", ["recording", "saved"])
def test_filter_parameters_of_a_file(source: str, recording: Path, tmp_path: Path) -> None:
    saved = tmp_path / "saved.json"
    imumon("report", recording, "-o", saved)
    path = recording if source == "recording" else saved
    found = from_json(FilterReport, imumon("report", path, "--format", "filter", "--horizon", "1m"))
    report = from_json(Report, saved.read_text())
    assert found.schema == "imumon.filter/1"
    assert found.horizon_s == 60.0
    assert found.device == report.device
    assert found.channels == filters(report, 60.0).channels


def test_a_short_record_prints_a_warning(recording: Path) -> None:
    for form in ("filter", "kalibr", "vins"):
        done = subprocess.run(
            [sys.executable, "-m", "imumon", "report", recording, "--format", form],
            capture_output=True,
            text=True,
            check=True,
        )
        assert re.fullmatch(
            r"imumon: recorded 10 min: N ±\S+ %, B only bounded, K only bounded; record at least 8 h\n",
            done.stderr,
        )
    assert short_record_text(make_report(LONG_S)) is None or make_report(LONG_S).session.elapsed_s < 8 * 3600


@pytest.mark.parametrize("horizon", ["0", "0.5", "2d", "soon"])
def test_a_horizon_is_from_a_second_to_a_day(horizon: str, recording: Path) -> None:
    imumon("report", recording, "--format", "filter", "--horizon", horizon, code=2)


def test_records_without_common_coefficients_are_not_called_unchanged() -> None:
    unchanged = baseline_summary(make_report(), make_report())
    assert unchanged == "nothing changed against the baseline"
    assert baseline_summary(make_report(), nothing_yet()) not in (None, unchanged)


def test_a_slope_over_temperature_is_shown_only_beyond_noise() -> None:
    report = make_report()
    channel = report.channels["gyro/x"]
    assert channel.drift is not None
    assert channel.drift.per_degC is not None
    assert not any("per degree" in line for line in signal_lines(report))
    for form in ("md", "html"):
        assert f"{channel.drift.per_degC:.2e}" not in text(report, form)
    clear = replace(channel.drift, per_degC=1e-4, per_degC_low=9e-5, per_degC_high=1.1e-4)
    beyond = replace(channel, drift=clear)
    shown = signal_lines(replace(report, channels={"gyro/x": beyond}))
    assert any("gyro/x: follows the temperature by" in line for line in shown)


def test_running_daemon_and_its_saved_state(tmp_path: Path) -> None:
    with Daemon("sim", tmp_path, "--speed", "20", "--seed", "3") as daemon:
        live = daemon.samples(3000)
        shown = imumon("report", "--connect", daemon.endpoint, "--format", "md")
        numbers = imumon("report", "--connect", daemon.endpoint, "--format", "filter")
        assert from_json(FilterReport, numbers).device.id == live.device.id
        assert live.device.serial is not None
        assert live.device.serial in shown
        code, _, _ = daemon.stop()
        assert code == 0
    (state,) = tmp_path.glob("*.state")
    report = from_json(Report, imumon("report", state, "--format", "json"))
    assert report.session.samples >= 3000
    assert report.device.model == live.device.model
    assert report.device.stream == "deltas"
    assert report.channels["gyro/x"].coefficients["N"] is not None
    assert report.channels["gyro/x"].coefficients["N"].status == "measured"
    data = state.read_bytes()
    state.write_bytes(data[:-100])
    assert "damaged" in imumon("report", state, code=1)


def test_a_model_name_is_no_tag() -> None:
    report = make_report(200.0)
    report = replace(report, device=replace(report.device, model="<script>alert(1)</script>", serial='"&|`*'))
    assert "<script" not in text(report, "html")
    assert "alert(1)" in text(report, "html")
    outside_code = text(report, "md").split("```")[0::2]
    assert "<script>" not in "".join(outside_code).replace("\\<", "")


def test_errors_are_one_line(tmp_path: Path, recording: Path) -> None:
    assert "no daemon answers" in imumon("report", "--connect", "tcp/127.0.0.1:1", code=3)
    assert "nowhere" in imumon("report", tmp_path / "nowhere", code=1)
    broken = tmp_path / "broken.json"
    broken.write_text('{"schema": 3')
    assert "broken.json" in imumon("report", broken, code=1)
    imumon("report", recording, "--format", "docx", code=2)
    imumon("report", recording, "--id", "x", code=2)
    assert "cannot write" in imumon("report", recording, "-o", tmp_path / "no" / "a.md", code=1)


def test_the_output_never_overwrites_an_input(recording: Path, tmp_path: Path) -> None:
    own, bag = tmp_path / "own.csv", tmp_path / "bag"
    own.write_bytes(recording.read_bytes())
    bag.mkdir()
    (tmp_path / "linked.csv").symlink_to(own)
    (tmp_path / "same.csv").hardlink_to(own)
    (bag / "part.db3").write_bytes(b"part")
    for read, out in (
        (own, own),
        (own, tmp_path / "linked.csv"),
        (tmp_path / "linked.csv", own),
        (own, tmp_path / "same.csv"),
        (bag, bag / "part.db3"),
    ):
        imumon("report", read, "--format", "md", "-o", out, code=2)
    assert own.read_bytes() == recording.read_bytes()
    assert (bag / "part.db3").read_bytes() == b"part"


def test_the_extension_of_the_output_selects_the_form_or_is_refused(recording: Path, tmp_path: Path) -> None:
    error = imumon("report", recording, "-o", tmp_path / "x.foo", code=2)
    assert all(form in error for form in FORMS)
    assert not (tmp_path / "x.foo").exists()
    imumon("report", recording, "-o", tmp_path / "x.foo", "--format", "csv")
    assert (tmp_path / "x.foo").read_text().startswith("kind,")
    for name, begin in (
        ("x.svg", b"<?xml"),
        ("x.PDF", b"%PDF-"),
        ("imu.yaml", b"# "),
        ("x.htm", b"<!DOCTYPE"),
    ):
        imumon("report", recording, "-o", tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(begin)
    assert "gyroscope_noise_density: " in (tmp_path / "imu.yaml").read_text()
    imumon("report", recording, "-o", tmp_path / "plain")
    assert (tmp_path / "plain").read_text().startswith("# ")


@pytest.mark.parametrize("age", AGES)
def test_the_table_fits_the_terminal_without_truncation(age: str) -> None:
    """A narrow table has uncertainties in percent instead of limits; a pipe gets the full table."""
    report = aged(age)
    full = FULL.width(len(shown_letters(report.channels.values())))
    for width in (80, 95, 100, full):
        lines = report_table(report, width).splitlines()
        rows = lines[lines.index("") : len(lines) - lines[::-1].index("")]
        assert max((len(line) for line in rows), default=0) <= width
        assert "…" not in "".join(lines)
    assert report_table(report) == report_table(report, full)


def test_the_table_explains_its_caveats_and_counts_in_the_singular() -> None:
    table = report_table(replace(make_report(), caveats=("aliased",)))
    assert f"caveat aliased: {CAVEATS['aliased'].line}" in table
    assert f"caveat vibration (accel y): {CAVEATS['vibration'].line}" in table
    assert "1 disturbance," in table


@pytest.mark.parametrize("form", ["text", "md", "html"])
@pytest.mark.parametrize("provisional", [False, True])
def test_tables_and_datasheet_name_both_grades(form: str, provisional: bool) -> None:
    report = make_report()
    grade = replace(report.grade["gyro"], nearest="industrial", meets="consumer", provisional=provisional)
    report = replace(report, grade={"gyro": grade})
    shown = report_table(report) if form == "text" else text(report, form)
    assert "meets consumer, nearest industrial" in shown
    assert ("industrial, provisional" in shown) == provisional


@pytest.mark.parametrize("form", ["text", *SETTINGS, "md"])
def test_every_form_warns_of_an_unknown_filter(form: str) -> None:
    """N of a stream in listen-only mode is too high by a factor that depends on its rate."""
    report = make_report(200.0)

    def shown(**known: object) -> str:
        changed = replace(report, caveats=(), device=replace(report.device, **known))  # type: ignore[arg-type]
        return report_table(changed) if form == "text" else text(changed, form)

    unknown = shown(alias_factor=None, stream="compensated", sample_rate_hz=40.0)
    assert FILTER_NOT_KNOWN in unknown
    assert "2.24" in unknown
    other = shown(
        alias_factor=None, stream="unknown", sample_rate_hz=40.0, model=None, driver=None, id="replay"
    )
    assert FILTER_NOT_KNOWN in other
    assert "VN-100" not in other
    assert FILTER_NOT_KNOWN not in shown(alias_factor=1.0, stream="compensated", sample_rate_hz=40.0)
    assert FILTER_NOT_KNOWN not in shown(alias_factor=None, stream="deltas", sample_rate_hz=40.0)


def test_excluded_seconds_add_up() -> None:
    """Seconds of the magnetometer alone are no part of those that are excluded from all channels."""
    report = make_report()

    def line(seconds: float, **by: float) -> str:
        session = replace(report.session, disturbances=1, excluded_s=seconds, excluded_by=by)
        return report_table(replace(report, session=session)).splitlines()[2]

    assert line(0.0, magnetic=6.5) == "1 disturbance, 6.5 s of the magnetometer alone excluded"
    assert line(5.0, knock=5.0) == "1 disturbance, 5.0 s (knock 5.0 s) excluded"
    both = "1 disturbance, 5.0 s (knock 5.0 s) and 6.5 s of the magnetometer alone excluded"
    assert line(5.0, knock=5.0, magnetic=6.5) == both


def test_the_text_has_the_time_to_the_configured_precision_and_the_loss() -> None:
    report = replace(make_report(), precision={"N": 0.001, "B": 0.15, "K": 0.5})
    gyro = report.channels["gyro/z"]
    channels = {**report.channels, "gyro/z": replace(gyro, time_to={"N": 0.0, "B": 7200.0, "K": 259_200.0})}
    lossy = replace(report.session, recent_loss=0.201)
    lines = report_table(replace(report, channels=channels, session=lossy)).splitlines()
    assert next(line for line in lines if line.startswith("B within ±15%: ")).count("gyro/z in 2 h") == 1
    assert "gyro/z in 3 d" in next(line for line in lines if line.startswith("K within ±50%: "))
    assert "20 % of the samples of the last minute are missing" in lines


def test_axes_move_together_only_beyond_chance() -> None:
    """A few samples, or two random walks, correlate by chance; each pair is listed once."""

    def lines(independent: float | None) -> list[str]:
        report = make_report(200.0)
        channels = dict(report.channels)
        for name, other in (("gyro/x", "gyro/y"), ("gyro/y", "gyro/x")):
            shape = channels[name].distribution
            assert shape is not None
            shape = replace(shape, correlation={other: 0.76}, effective_samples=independent)
            channels[name] = replace(channels[name], distribution=shape)
        shown = signal_lines(replace(report, channels=channels))
        return [line for line in shown if line.startswith("gyro") and "moves together" in line]

    for independent in (None, 4.0, 40.0):
        assert lines(independent) == []
    assert lines(400.0) == ["gyro/x: moves together with gyro/y (+0.76)"]


def test_white_noise_has_as_many_effective_samples_as_samples_and_a_walk_few() -> None:
    tau = tuple(2.0**k for k in range(10))
    white = Allan(tau_s=tau, sigma=tuple(t**-0.5 for t in tau))
    walk = Allan(tau_s=tau, sigma=tuple(t**0.5 for t in tau))
    assert effective_samples(white, 1.0, 1024) == pytest.approx(1024.0)
    assert (effective_samples(walk, 20.0, 1024) or 0.0) < 3.0
    assert effective_samples(None, 1.0, 1024) is None
    assert effective_samples(white, None, 1024) is None


def test_both_tables_name_their_units() -> None:
    heads = [line for line in signal_lines(make_report(200.0)) if "drift per hour" in line]
    assert [head.split("  ")[0] for head in heads] == ["in rad/s", "in m/s²", "in gauss", "in °C", "in kPa"]


def test_wide_limits_are_a_factor() -> None:
    report = make_report()
    k = replace(report.channels["gyro/x"].coefficients["K"], status="measured")
    si = 1.0 / COEFFICIENTS["K"].units["gyro"].factor
    k = replace(k, value=3.5 * si, low=1.0 * si, high=9.0 * si, combined_low=None)
    one = with_coefficients(report.channels["gyro/x"], K=k)
    shown = report_table(replace(report, channels={"gyro/x": one}), 100)
    assert "3.5 ×÷3.0" in shown
    assert uncertainty() in shown
    assert Notation(ascii=True).coefficient(k, None) == ("3.5 x/3.0", "text")
