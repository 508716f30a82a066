"""Conformity of a sensor with the limits of its data sheet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evaluations import SHEET, imumon, make_report, replayed, sheet_file, shown
from paths import RECORDINGS, needs_recordings
from reports import with_coefficients

from imumon.api.traceability import evaluated
from imumon.coefficients import COEFFICIENTS
from imumon.noise.uncertainty import probability_at_most, verdict
from imumon.references import SheetError, published, read_sheet, sheet_of_model
from imumon.references.limit_checks import conformity
from imumon.report import Report
from imumon.report_json import to_json


def test_a_verdict_is_guarded_by_the_limits() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        low, value, high = sorted(rng.uniform(1.0, 2.0, 3))
        limit = rng.uniform(0.8, 2.2)
        chance = probability_at_most(limit, value, low, high)
        assert chance is not None
        found = verdict(limit, low, high)
        assert (found == "pass") == (chance >= 0.9749999)
        assert (found == "fail") == (chance < 0.0250001)


@pytest.mark.parametrize("name", sorted(published()))
def test_a_published_sheet_names_its_source_and_edition(name: str) -> None:
    sheet = published()[name]
    assert sheet.models
    assert sheet.edition
    assert sheet.source
    assert read_sheet(name) == sheet


def test_limits_are_converted_from_the_units_of_the_sheet() -> None:
    """0.0035 °/s/√Hz is 0.21 °/√h; a one-sided density is √2 N; in-run stability is 0.664 B."""
    report = make_report()
    n, b = report.channels["gyro/x"].coefficients["N"], report.channels["gyro/x"].coefficients["B"]
    assert n.value is not None
    checks = {(c.channel, c.quantity): c for c in conformity(report, published()["vn-100"]).checks}
    found = checks["gyro/x", "N"]
    assert found.value == pytest.approx(np.degrees(n.value))
    assert found.limit * 60.0 == pytest.approx(0.21)
    other = {(c.channel, c.quantity): c for c in conformity(report, published()["adis16405"]).checks}
    assert other["gyro/x", "density"].value == pytest.approx(np.sqrt(2.0) * np.degrees(n.value))
    assert b.high is not None
    assert other["gyro/x", "floor"].high == pytest.approx(0.664 * np.degrees(b.high), rel=1e-3)


def test_only_the_data_sheet_of_the_measured_model_is_used() -> None:
    report = make_report()
    titles = {
        "VN-100T-CR": "VectorNav VN-100",
        "ADIS16470": "Analog Devices ADIS16470",
        "VN-200": None,
        None: None,
    }
    for model, title in titles.items():
        made = evaluated(replace(report, device=replace(report.device, model=model))).evaluation
        assert (made.conformity.title if made.conformity else None) == title
        text = shown(
            evaluated(replace(report, device=replace(report.device, model=model, id="a", setting_texts={})))
        )
        assert ("## Data sheet: VectorNav VN-100" in text) == (title == "VectorNav VN-100")
        assert "laboratory" not in text
    assert sheet_of_model(None) is None


def test_what_the_stream_does_not_show_is_undecided() -> None:
    report = make_report()
    sheet = published()["vn-100"]

    def verdicts(changed: Report, letter: str) -> set[str]:
        return {
            c.verdict
            for c in conformity(changed, sheet).checks
            if c.quantity == letter and c.channel[:4] == "gyro"
        }

    high = {
        n: with_coefficients(c, N=c.coefficients["N"].scaled(10.0, "rad/s/sqrt(Hz)"))
        for n, c in report.channels.items()
        if n[:4] == "gyro"
    }
    worse = replace(report, channels=report.channels | high)
    assert verdicts(replace(worse, device=replace(report.device, alias_factor=1.0)), "N") == {"fail"}
    assert verdicts(worse, "N") == {"undecided"}
    assert "undecided" in verdicts(replace(report, caveats=("compensated",)), "floor")
    assert "pass" not in verdicts(replace(report, caveats=("compensated",)), "floor")


def test_a_data_sheet_on_the_command_line(recording: Path, tmp_path: Path) -> None:
    n = 6e-5 * COEFFICIENTS["N"].units["gyro"].factor
    for limit, expected in ((2.0 * n, "pass"), (0.5 * n, "fail")):
        sheet = sheet_file(tmp_path, gyro=limit)
        report = replayed(recording, "--datasheet", sheet, "--filter", "20")
        checks = {(c.channel, c.quantity): c for c in report.evaluation.conformity.checks}
        of_gyro = {(f"gyro/{axis}", "N") for axis in "xyz"}
        assert set(checks) == of_gyro | {("accel/x", "floor"), ("accel/y", "floor")}
        assert checks["gyro/x", "N"].verdict == expected
        assert checks["accel/x", "floor"].verdict in ("pass", "undecided")
        page = shown(report)
        assert "Rev. C, 2026" in page
        assert f"| {expected} " in page
    printed = imumon("replay", recording, "--datasheet", sheet)  # a fail that the unknown filter may cause
    assert "data sheet: Acme A1 (A1 data sheet)" in printed
    assert "undecided (the filter of the sensor is unknown: aliasing may raise N)" in printed


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("title = 3", "title is not a text"),
        ("= 1", "sheet"),
        ('title = "a"', "'document' is missing"),
        ('title = "a"\ndocument = "b"', "no [[limit]]"),
        (SHEET.format(gyro=-1.0), "at_most is not a positive number"),
        (SHEET.format(gyro=1.0).replace("deg/sqrt(h)", "deg/h"), "unit of N of gyro is not one of"),
        (SHEET.format(gyro=1.0).replace('"floor"', '"sigma"'), "quantity is not one of"),
        (SHEET.format(gyro=1.0).replace("accel/x", "accel/w"), "is no channel"),
        (SHEET.format(gyro=1.0).replace("typical", "guess"), "basis is not one of"),
        (SHEET.format(gyro=1.0).replace("edition", "edtion"), "unknown field 'edtion'"),
    ],
)
def test_a_fault_of_a_sheet_is_one_line(text: str, fault: str, recording: Path, tmp_path: Path) -> None:
    path = tmp_path / "sheet.toml"
    path.write_text(text)
    with pytest.raises(SheetError) as raised:
        read_sheet(path)
    assert raised.value.code == "datasheet_invalid"
    assert fault in raised.value.message
    assert len(raised.value.message.splitlines()) == 1


def test_a_sheet_that_is_not_of_this_sensor_is_refused(recording: Path, tmp_path: Path) -> None:
    saved = tmp_path / "x.json"
    saved.write_text(to_json(make_report()))
    assert "VN-100T-CR" in imumon("report", saved, "--datasheet", "adis16405", code=2)
    assert "vn-100" in imumon("report", saved, "--datasheet", tmp_path / "nothing.toml", code=2)


@needs_recordings
@pytest.mark.slow
def test_nothing_refers_to_a_device_that_was_not_measured(tmp_path: Path) -> None:
    for name, words, wrong in (
        ("adis16405_1.npz", (), ("VN-100", "laboratory")),
        ("kiran_stat5min.vnymr.txt.gz", ("--rate", "40"), ("ADIS", "laboratory")),
    ):
        saved = tmp_path / "saved.json"
        imumon("report", RECORDINGS / name, *words, "-o", saved)
        for form in ("md", "html", "csv", "svg"):
            text = imumon("report", saved, "--format", form)
            assert not [word for word in wrong if word in text], (name, form)
