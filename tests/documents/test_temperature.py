"""Bias against the temperature in the documents: slope, line and span, or why there is none."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from commands import imumon

from imumon.documents.temperature_figure import with_error
from imumon.model.coefficients import unit_of
from imumon.model.report import Report, from_json
from imumon.model.samples import ACCEL, GYRO, Floats
from imumon.noise import synthesise

RATE, LENGTH = 10.0, 18_000
TIME = np.arange(LENGTH) / LENGTH
WARMING = 1.0 - np.exp(-TIME / 0.2)
TRUTH = {"gyro": 2e-5, "accel": 3e-4}
"""Slopes, SI per degC."""


def table(path: Path, degrees: Floats, *, terms: bool = True, names: str = "temperature (degC)") -> Path:
    """Write a record whose axes follow a temperature (n,)."""
    noise = synthesise(LENGTH, RATE, N=[6e-5] * 3 + [1e-3] * 3, seed=4)
    known = degrees[np.isfinite(degrees)]
    about = np.nan_to_num(degrees - 0.5 * (known.min() + known.max())) if known.size else 0.0 * degrees
    values = [10.0, *([0.0] * 2), *([0.0] * 2), -9.8]
    effects = [about * TRUTH[name[:-2]] * terms * (1 + 0.1 * k) for k, name in enumerate(GYRO + ACCEL)]
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


@pytest.mark.few
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
def test_the_datasheet_says_why_there_is_no_slope(tmp_path: Path, degrees: Floats, reason: str) -> None:
    source, saved = table(tmp_path / "record.csv", degrees, terms=False), tmp_path / "report.json"
    saved.write_text(imumon("replay", source, "--json"))
    assert json.loads(saved.read_text())["channels"]["gyro/x"]["drift"]["per_degC"] is None
    sheet = imumon("report", saved, "--format", "md")
    assert re.search(rf"Gyroscope: no curve, because [^.]*{reason}", sheet)


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
