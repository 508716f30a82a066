"""Figures of the datasheet: every point, letter and name is where it can be read; bias against the temperature."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from documents import FIGURES, aged, made, text
from reports import LONG_S, nothing_yet
from reports import report as make_report
from tables import csv

from imumon.documents import NoCurve
from imumon.documents.convergence_figure import convergence_svg
from imumon.documents.figures import _draw as draw
from imumon.documents.figures import svg
from imumon.documents.plotting import INCHES, figure_style
from imumon.documents.report_texts import coefficient_text
from imumon.documents.temperature_figure import with_error
from imumon.model.coefficients import COEFFICIENTS, NOISE, unit_of
from imumon.model.report import BiasCurve, Report, from_json
from imumon.model.samples import ACCEL, GYRO
from imumon.model.units import pretty
from imumon.noise import synthesise


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


def test_a_coefficient_below_the_frame_is_not_marked() -> None:
    """Its limits may reach into the frame: a bar would begin above its end."""
    report = make_report(LONG_S)
    channels = dict(report.channels)
    for name in ("gyro/x", "gyro/y", "gyro/z"):
        known = channels[name].coefficients
        below = replace(
            known["K"], value=1e-12, low=1e-13, status="measured", combined_low=None, combined_high=None
        )
        channels[name] = replace(channels[name], coefficients={**known, "K": below})
    letters = [e.text for e in ET.fromstring(svg(replace(report, channels=channels), "gyro")).iter("text")]
    assert {"N", "B"} <= set(letters)
    assert "K" not in letters


@pytest.mark.parametrize("form", FIGURES)
def test_a_figure_without_a_curve_is_an_error(form: str) -> None:
    with pytest.raises(NoCurve) as raised:
        made(nothing_yet(), form)
    assert raised.value.code == "no_curve"


@pytest.mark.few
@pytest.mark.parametrize("age", ["minutes", "hours", "long"])
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_the_name_of_a_grade_does_not_cover_a_letter(sensor: str, age: str) -> None:
    """N, B and K end where the limits of the grades end, at the right."""
    from matplotlib.figure import Figure

    with figure_style("imumon"):
        figure = Figure(figsize=INCHES, layout="constrained")
        panel = figure.subplots()
        draw(panel, aged(age), sensor)
    figure.draw_without_rendering()
    boxes = [(t.get_text(), t.get_window_extent()) for t in panel.texts if t.get_text()]
    letters = [box for name, box in boxes if name in COEFFICIENTS]
    grades = [(name, box) for name, box in boxes if name not in COEFFICIENTS]
    assert letters
    assert grades
    assert [name for name, box in grades if any(box.overlaps(letter) for letter in letters)] == []


@pytest.mark.few
@pytest.mark.parametrize("sensor", ["gyro", "accel", "mag"])
@pytest.mark.parametrize("age", ["minutes", "hours", "long"])
def test_every_point_of_a_curve_is_drawn_within_the_frame(sensor: str, age: str) -> None:
    report = aged(age)
    root = ET.fromstring(svg(report, sensor))
    width, height = (float(v) for v in (root.get("viewBox") or "").split()[2:])
    for axis in "xyz":
        allan = report.channels[f"{sensor}/{axis}"].allan
        styled = ((use, use.get("style") or "") for use in root.iter("use"))
        drawn = [(use, style) for use, style in styled if f"stroke: var(--{axis})" in style]
        legend = drawn[-1][0].get("href")  # others are ends of the bars of N, B and K
        marks = [use for use, style in drawn if use.get("href") == legend or "fill-opacity: 0" in style]
        assert len(marks) == len(allan.tau_s) + 1
        for mark in marks:
            assert 0.0 <= float(mark.get("x") or -1) <= width
            assert 0.0 <= float(mark.get("y") or -1) <= height


@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_the_convergence_is_a_figure(sensor: str) -> None:
    drawn = convergence_svg(make_report(LONG_S), sensor)
    assert all(f">{letter}, " in drawn for letter in NOISE)


# ---------------------------------------- bias against the temperature in the documents


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Report]:
    """Return a saved report of a record over 40 degC, which all axes follow, and the report."""
    folder, rate_hz, samples = tmp_path_factory.mktemp("warm"), 10.0, 18_000
    degrees = 50.0 - 40.0 * np.exp(-np.arange(samples) / (0.2 * samples))
    slopes = np.array([2e-5, 2.2e-5, 2.4e-5, 3e-4, 3.3e-4, 3.6e-4])
    noise = synthesise(samples, rate_hz, N=[6e-5] * 3 + [1e-3] * 3, seed=4)
    values = noise + [1e-3, -2e-3, 3e-3, 0.0, 0.0, -9.8] + (degrees - 30.0)[:, None] * slopes
    names = [*(f"{name} (rad/s)" for name in GYRO), *(f"{name} (m/s2)" for name in ACCEL)]
    source = folder / "warm.csv"
    csv(source, ["t (s)", *names, "temperature (degC)"], np.arange(samples) / rate_hz, values, degrees)
    out = folder / "report.json"
    imumon("report", source, "--format", "json", "-o", out)
    return out, from_json(Report, out.read_text())


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        ("small_range", "hardly moves"),
        ("collinear", "like a drift in time"),
        ("implausible", "no temperature of a sensor"),
        ("jumps", "it jumps"),
    ],
)
def test_the_datasheet_says_why_there_is_no_slope(warm: tuple[Path, Report], reason: str, words: str) -> None:
    _, report = warm
    channels = {
        name: replace(channel, bias_curve=BiasCurve(reason=reason)) if channel.bias_curve else channel
        for name, channel in report.channels.items()
    }
    sheet = text(replace(report, channels=channels), "md")
    assert re.search(rf"Gyroscope: no curve, because [^.]*{words}", sheet)


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
