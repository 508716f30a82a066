"""Bias against the temperature for flight controllers: their own arithmetic gives the curve of the report."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import imumon

from imumon.coefficients import unit_of
from imumon.datasheet.temperature_figure import with_error
from imumon.noise import synthesise
from imumon.report import Report, from_json
from imumon.report_json import to_json
from imumon.samples import ACCEL, GYRO, Floats

RATE, LENGTH = 10.0, 18_000
TIME = np.arange(LENGTH) / LENGTH
WARMING = 1.0 - np.exp(-TIME / 0.2)
TRUTH = {"gyro": (2e-5, 4e-7, 2e-8), "accel": (3e-4, 1e-5, 0.0)}
"""Terms of degree 1 to 3, SI per degC^n, about the middle."""


def table(path: Path, degrees: Floats, *, terms: bool = True, names: str = "temperature (degC)") -> Path:
    """Write a record whose axes follow a temperature (n,)."""
    noise = synthesise(LENGTH, RATE, N=[6e-5] * 3 + [1e-3] * 3, seed=4)
    known = degrees[np.isfinite(degrees)]
    about = np.nan_to_num(degrees - 0.5 * (known.min() + known.max())) if known.size else 0.0 * degrees
    values = [10.0, *([0.0] * 2), *([0.0] * 2), -9.8]
    effects = [
        np.polynomial.polynomial.polyval(about, (0.0, *(TRUTH[name[:-2]] if terms else ()))) * (1 + 0.1 * k)
        for k, name in enumerate(GYRO + ACCEL)
    ]
    offsets = np.array([1e-3, -2e-3, 3e-3, *values[3:]])
    data = noise + np.stack(effects, axis=1) + offsets
    rows = np.column_stack([np.arange(LENGTH) / RATE, data, degrees])
    heads = [f"{name} (rad/s)" for name in GYRO] + [f"{name} (m/s2)" for name in ACCEL]
    np.savetxt(path, rows, fmt="%.8g", delimiter=",", header=",".join(["t (s)", *heads, names]), comments="")
    return path


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Report]:
    """Return a saved report of a record over 40 degC, and the report."""
    folder = tmp_path_factory.mktemp("warm")
    out = folder / "report.json"
    source = table(folder / "warm.csv", 10.0 + 40.0 * WARMING)
    imumon("report", source, "--format", "json", "-o", out)
    return out, from_json(Report, out.read_text())


def read(text: str, pattern: str) -> dict[str, float]:
    return {name: float(value) for name, value in re.findall(pattern, text, re.MULTILINE)}


def expected(report: Report, name: str) -> tuple[Floats, Floats]:
    """Return the temperatures and the values of the curve of a channel."""
    curve = report.channels[name].bias_curve
    return np.array(curve.degC), np.array(curve.bias)


def test_px4_subtracts_the_curve(warm: tuple[Path, Report]) -> None:
    path, report = warm
    found = read(imumon("report", path, "--format", "px4-tc"), r"^param set (\w+) (\S+)$")
    assert found["TC_G_ENABLE"] == found["TC_A_ENABLE"] == 1
    assert "TC_G0_ID" not in found  # nobody knows it
    fields = ["TMIN", "TMAX", "TREF", *(f"X{power}_{number}" for power in range(4) for number in range(3))]
    assert set(found) == {
        f"TC_{s}{end}" for s in "GA" for end in ("_ENABLE", *(f"0_{each}" for each in fields))
    }
    for letter, sensor in (("G", "gyro"), ("A", "accel")):
        low, high, reference = (found[f"TC_{letter}0_{key}"] for key in ("TMIN", "TMAX", "TREF"))
        assert 9.0 < low < 13.0
        assert 48.0 < high < 51.0
        for number, axis in enumerate("xyz"):
            degrees, curve = expected(report, f"{sensor}/{axis}")
            terms = [found[f"TC_{letter}0_X{power}_{number}"] for power in range(4)]
            own = np.polynomial.polynomial.polyval(degrees - reference, terms)
            curve = curve if sensor == "gyro" else curve - curve[len(curve) // 2]
            assert own == pytest.approx(curve, abs=2e-3 * np.ptp(curve))


def test_ardupilot_reads_the_curve(warm: tuple[Path, Report], tmp_path: Path) -> None:
    mavparm = pytest.importorskip("pymavlink.mavparm", reason="pymavlink is not installed (extra ardupilot)")
    path, report = warm
    out = tmp_path / "tcal.param"
    imumon("report", path, "--format", "ardupilot-tcal", "-o", out)
    found = mavparm.MAVParmDict()
    assert found.load(str(out))
    assert found["INS_TCAL1_ENABLE"] == 1
    fields = [f"{sensor}{power}_{axis}" for sensor in ("ACC", "GYR") for power in (1, 2, 3) for axis in "XYZ"]
    assert set(found) == {f"INS_TCAL1_{each}" for each in ("ENABLE", "TMIN", "TMAX", *fields)}
    assert found["INS_TCAL1_TMIN"] < 13.0 < 48.0 < found["INS_TCAL1_TMAX"]
    for group, sensor in (("ACC", "accel"), ("GYR", "gyro")):
        for axis in "xyz":
            degrees, curve = expected(report, f"{sensor}/{axis}")
            terms = [found[f"INS_TCAL1_{group}{power}_{axis.upper()}"] * 1e-6 for power in (1, 2, 3)]
            own = np.polynomial.polynomial.polyval(degrees - 35.0, (0.0, *terms))
            assert own - own[0] == pytest.approx(curve - curve[0], abs=2e-3 * np.ptp(curve))


@pytest.mark.parametrize(
    ("degrees", "reason"),
    [
        (np.full(LENGTH, 25.0), "hardly moves"),
        (293.15 + 40.0 * WARMING, "no temperature of a sensor"),  # kelvin, of a column that says degC
        (20.0 + 10.0 * TIME, "like a drift in time"),
        (np.where(np.arange(LENGTH) % 500, 20.0 + 40.0 * WARMING, -273.15), "no temperature of a sensor"),
        (np.where(TIME < 0.5, 20.0 + 40.0 * WARMING, 0.0), "it jumps"),
    ],
)
def test_without_a_curve_nothing_is_written(tmp_path: Path, degrees: Floats, reason: str) -> None:
    source = table(tmp_path / "record.csv", degrees, terms=False)
    saved, out = tmp_path / "report.json", tmp_path / "out"
    saved.write_text(imumon("replay", source, "--json"))
    for form in ("px4-tc", "ardupilot-tcal"):
        assert reason in imumon("report", saved, "--format", form, "-o", out, code=1)
        assert not out.exists()
    assert json.loads(saved.read_text())["channels"]["gyro/x"]["drift"]["per_degC"] is None


def test_the_datasheet_has_terms_curve_and_span(warm: tuple[Path, Report]) -> None:
    path, report = warm
    page, sheet = (imumon("report", path, "--format", form) for form in ("html", "md"))
    rows = [
        line for line in imumon("report", path, "--format", "csv").splitlines() if line.startswith("bias,")
    ]
    assert "## Appendix: temperature" in sheet
    for sensor, title in (("gyro", "Gyroscope"), ("accel", "Accelerometer")):
        assert f'aria-label="Bias of the {title.lower()} against the temperature"' in page
        curve = report.channels[f"{sensor}/x"].bias_curve
        factor = unit_of(sensor, "B").factor
        slope = curve.terms[1]
        shown = with_error(slope.value * factor, 0.5 * (slope.high - slope.low) * factor)
        assert shown in page
        assert shown in sheet
        assert f"{curve.degC[0]:.1f} to {curve.degC[-1]:.1f} °C" in page
        own = [row for row in rows if f",{sensor}/x," in row]
        assert len(own) == len(curve.terms)
        assert f",{slope.low},{slope.high}," in own[1]


def test_the_datasheet_says_why_there_is_no_curve(tmp_path: Path) -> None:
    source = table(tmp_path / "record.csv", np.full(LENGTH, 25.0), terms=False)
    assert "Gyroscope: no curve, because the temperature hardly moves" in imumon(
        "report", source, "--format", "md"
    )


def test_a_small_span_and_an_unseen_slope_are_no_facts(tmp_path: Path) -> None:
    source = table(tmp_path / "record.csv", 20.0 + 5.0 * WARMING, terms=False)
    saved = tmp_path / "report.json"
    imumon("report", source, "--format", "json", "-o", saved)
    text = imumon("report", saved, "--format", "px4-tc")
    assert "WARNING" in text
    unseen = re.findall(r"^#   ([xyz]): no slope seen", text, re.MULTILINE)
    found = read(text, r"^param set (\w+) (\S+)$")
    assert unseen
    for axis in unseen[:1]:
        assert found[f"TC_G0_X1_{'xyz'.index(axis)}"] == 0.0


def test_a_sensor_without_an_axis_is_a_comment(warm: tuple[Path, Report], tmp_path: Path) -> None:
    _, report = warm
    channels = {name: each for name, each in report.channels.items() if name != "accel/y"}
    path = tmp_path / "report.json"
    path.write_text(to_json(replace(report, channels=channels)))
    for form, name in (("px4-tc", "TC_A"), ("ardupilot-tcal", "INS_TCAL1_ACC")):
        text = imumon("report", path, "--format", form)
        assert not re.search(rf"^[^#]*{name}", text, re.MULTILINE)
        assert "three axes" in text
