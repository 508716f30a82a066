"""What the screen saves, and what it says about it."""

from __future__ import annotations

import csv
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import reports
from screen_driver import drive, driven, visible_text
from textual.pilot import Pilot

from imumon.report import Report, from_json
from imumon.tui import export
from imumon.tui.app import ImumonApp
from imumon.tui.view_state import VIEWS, ViewState


def test_an_unknown_grade_is_shown_by_its_name() -> None:
    report = reports.report()
    grade = {name: replace(one, nearest="survey", meets="survey") for name, one in report.grade.items()}
    channels = {
        name: replace(c, grade=replace(c.grade, nearest="survey", meets="survey")) if c.grade else c
        for name, c in report.channels.items()
    }
    source = reports.FakeSource(replace(report, grade=grade, channels=channels))

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        for key in ("1", "2", "3", "4", "5"):
            await pilot.press(key)
            await pilot.pause()
            assert key != "1" or "survey" in visible_text(app).lower()

    drive(source, script)


def test_every_view_can_be_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    source = reports.FakeSource(reports.report())

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        for form in "vcj":
            await pilot.press("s")
            await pilot.pause()
            await pilot.press(form)
        for view in "23457":
            await pilot.press(view)
            app.save_view(tmp_path, "csv")

    drive(source, script)
    files = {path.name for path in tmp_path.iterdir()}
    assert len(files) == 3 + 5
    start = f"imumon-{reports.ID}-"
    svg = (tmp_path / f"{start}overview-20260301T100000.svg").read_text()
    assert svg.startswith("<svg")
    assert "http" not in svg.replace("http://www.w3.org/2000/svg", "").replace(
        "https://www.textualize.io", ""
    )
    table = next(tmp_path.glob("*overview*.csv"))
    rows = list(csv.reader(table.open()))
    allan = source.reports()[reports.ID][0].channels["gyro/x"].allan
    assert float(rows[1][3]) == allan.sigma[0]
    heads = [
        row[0]
        for row in csv.reader(next(tmp_path.glob("*signal*.csv")).open())
        if row and row[0].isidentifier()
    ]
    assert heads == ["time_s", "bin_start", "frequency_hz"]
    saved = from_json(Report, next(tmp_path.glob("*.json")).read_bytes())
    assert saved == source.reports()[reports.ID][0]


def test_the_notification_names_the_saved_file(tmp_path: Path) -> None:
    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        for form in ("json", "csv", "svg"):
            app.clear_notifications()
            app.save_view(tmp_path, form)
            await pilot.pause()
            (note,) = app._notifications
            assert note.message == f"saved {next(tmp_path.glob(f'*.{form}'))}"

    drive(reports.FakeSource(reports.report()), script)


def test_an_unwritable_directory_gives_a_notification(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        app.save_view(Path("/proc/[nowhere]"), "csv")
        await pilot.pause()
        (note,) = app._notifications
        assert note.message.startswith("not saved: ")

    drive(reports.FakeSource(reports.report()), script)


def test_without_a_converter_the_picture_is_kept_as_svg(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "resvg_py", None)

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        app.save_view(tmp_path, "png")
        await pilot.pause()
        (note,) = app._notifications
        assert "pip install '.[png]'" in note.message

    drive(reports.FakeSource(reports.report()), script)
    (only,) = tmp_path.iterdir()
    assert only.suffix == ".svg"


def test_an_empty_state_exports_nothing() -> None:
    for view in VIEWS:
        assert list(export.table_rows(ViewState(view=view))) == []


@driven(size=(150, 40))
async def test_the_headline_keeps_its_limit_and_the_chart_its_units_in_si(
    app: ImumonApp, pilot: Pilot[int]
) -> None:
    assert "; industrial allows 0.2" in visible_text(app)
    await pilot.press("u")
    await pilot.pause()
    shown = visible_text(app)
    assert "N of y, 1.12e-04 rad/s/√Hz; industrial allows 5.82e-05" in shown
    assert "N 8.84e-05 rad/s/√Hz" in shown


def test_a_saved_picture_contains_no_notification(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    async def script(app: ImumonApp, pilot: Pilot[int]) -> None:
        for _ in range(2):
            await pilot.press("s")
            await pilot.pause()
            await pilot.press("v")
            await pilot.pause()
        assert len(app._notifications) == 1

    drive(reports.FakeSource(reports.report()), script)
    (picture,) = tmp_path.glob("*.svg")
    assert "saved" not in picture.read_text()
