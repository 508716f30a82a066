"""A sensor beside its data sheet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import imumon
from evaluations import SHEET, make_report, replayed, sheet_file, shown
from reports import with_coefficients

from imumon.api.document_report import document_report
from imumon.documents.references import SheetError, published, read_sheet, sheet_of_model
from imumon.documents.references.comparison import compared
from imumon.model.coefficients import COEFFICIENTS


@pytest.mark.few
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
    values = {(v.channel, v.quantity): v for v in compared(report, published()["vn-100"]).values}
    found = values["gyro/x", "N"]
    assert (found.printed, found.printed_unit, found.unit) == (0.0035, "deg/s/sqrt(Hz)", "rad/s/sqrt(Hz)")
    assert found.value == pytest.approx(np.radians(0.0035))
    other = {(v.channel, v.quantity): v for v in compared(report, published()["adis16405"]).values}
    density, floor = other["gyro/x", "density"], other["gyro/x", "floor"]
    assert density.value == pytest.approx(np.radians(density.printed) / np.sqrt(2.0))
    assert floor.value == pytest.approx(np.radians(floor.printed) / 0.664, rel=1e-3)


def test_only_the_data_sheet_of_the_measured_model_is_used() -> None:
    report = make_report()
    titles = {
        "VN-100T-CR": "VectorNav VN-100",
        "ADIS16470": "Analog Devices ADIS16470",
        "VN-200": None,
        None: None,
    }
    for model, title in titles.items():
        device = replace(report.device, model=model, id="a", setting_texts={})
        made = document_report(replace(report, device=device))
        assert (made.data_sheet.title if made.data_sheet else None) == title
        text = shown(made)
        assert ("data sheet of VectorNav" in text) == (title == "VectorNav VN-100")
        assert ("data sheet" in text) == (title is not None)
        assert "laboratory" not in text
    assert sheet_of_model(None) is None


def test_n_that_aliasing_raises_is_not_said_to_be_above() -> None:
    report, sheet = make_report(), published()["vn-100"]
    high = {
        n: with_coefficients(c, N=c.coefficients["N"].scaled(10.0, "rad/s/sqrt(Hz)"))
        for n, c in report.channels.items()
        if n[:4] == "gyro"
    }

    def gyro_n(alias_factor: float | None) -> set[tuple[bool | None, bool]]:
        device = replace(report.device, alias_factor=alias_factor, stream="uncompensated")
        worse = replace(report, channels=report.channels | high, device=device)
        values = compared(worse, sheet).values
        return {(v.above, v.reason is None) for v in values if v.quantity == "N" and v.channel[:4] == "gyro"}

    assert gyro_n(1.0) == {(True, True)}
    assert gyro_n(2.0) == gyro_n(None) == {(None, False)}


def test_a_data_sheet_on_the_command_line(recording: Path, tmp_path: Path) -> None:
    n = 6e-5 * COEFFICIENTS["N"].units["gyro"].factor
    for limit, above in ((2.0 * n, False), (0.5 * n, True)):
        sheet = sheet_file(tmp_path, gyro=limit)
        report = replayed(recording, "--datasheet", sheet, "--filter", "20")
        values = {(v.channel, v.quantity): v for v in report.data_sheet.values}
        of_gyro = {(f"gyro/{axis}", "N") for axis in "xyz"}
        assert set(values) == of_gyro | {("accel/x", "floor"), ("accel/y", "floor")}
        assert values["gyro/x", "N"].above == above
        page = shown(report)
        assert "Rev. C, 2026" in page
        assert "Above: the whole interval is above" in page
        assert ("; above " in page) == above
    assert "above the data sheet " in imumon("replay", recording, "--datasheet", sheet)
    printed = imumon(
        "replay", recording, "--datasheet", sheet, "--verbose"
    )  # N may be raised: the filter is unknown
    assert "Rev. C, 2026" in printed
    assert "aliasing" in printed


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ('title = 3\ndocument = "b"', "'int' instead of str"),
        ("= 1", "sheet"),
        ('title = "a"', "without document"),
        ('title = "a"\ndocument = "b"', "no [[limit]]"),
        (SHEET.format(gyro=-1.0), "is not positive"),
        (SHEET.format(gyro=1.0).replace("deg/sqrt(h)", "deg/h"), "unit of N of gyro is not one of"),
        (SHEET.format(gyro=1.0).replace('"floor"', '"sigma"'), "quantity is not one of"),
        (SHEET.format(gyro=1.0).replace("accel/x", "accel/w"), "is no channel"),
        (SHEET.format(gyro=1.0).replace("typical", "guess"), "'guess' is not one of maximum, typical"),
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
