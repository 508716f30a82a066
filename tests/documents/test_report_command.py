"""`imumon report`: what it reads, writes and refuses."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import imumon, run_inside
from daemons import Daemon
from documents import bare, filters, text
from reports import LONG_S, with_coefficients
from reports import report as make_report

from imumon.documents import FORMS, short_record_text
from imumon.model.filter_report import FilterReport
from imumon.model.report import Report, from_json
from imumon.model.report_json import to_json
from imumon.noise.synthesis import synthesise


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two minutes at rest as CSV, with a known N."""
    path = tmp_path_factory.mktemp("recording") / "rest.csv"
    noise = synthesise(4_800, 40.0, N=[6e-5] * 3 + [1.4e-3] * 3, seed=4)
    noise[:, 5] -= 9.8
    np.savetxt(
        path,
        np.column_stack([np.arange(4_800) / 40.0, noise]),
        delimiter=",",
        header="t [s],wx [rad/s],wy [rad/s],wz [rad/s],ax [m/s^2],ay [m/s^2],az [m/s^2]",
        comments="",
        fmt="%.9g",
    )
    return path


@pytest.fixture(scope="module")
def saved(recording: Path) -> Path:
    """The report of the recording."""
    path = recording.with_name("saved.json")
    assert imumon("report", recording, "-o", path) == ""
    return path


def test_recording_to_report_to_datasheet_and_baseline(recording: Path, saved: Path, tmp_path: Path) -> None:
    report = from_json(Report, saved.read_text())
    n = report.channels["gyro/x"].coefficients["N"]
    assert (n.low or 0.0) < 6e-5 < (n.high or 0.0)
    page = tmp_path / "sheet.html"
    imumon("report", saved, "-o", page)
    assert "rest.csv" in page.read_text()
    assert imumon("report", saved, "--format", "kalibr") == text(report, "kalibr")
    again = json.loads(imumon("replay", recording, "--json", "--baseline", saved))
    assert again["channels"]["gyro/x"]["changes"] == []
    printed = imumon("replay", recording, "--baseline", saved)
    assert "\nnothing changed against the baseline\n" in printed
    half = replace(n, value=6e-5 / 2, low=2.9e-5, high=3.1e-5)
    before = replace(
        report, channels=report.channels | {"gyro/x": with_coefficients(report.channels["gyro/x"], N=half)}
    )
    (tmp_path / "before.json").write_text(to_json(before))
    printed = imumon("replay", recording, "--baseline", tmp_path / "before.json")
    grown = re.search(r"^gyro/x: N has grown by (\d+) % against the baseline$", printed, re.M)
    assert grown is not None
    assert int(grown[1]) == pytest.approx(100.0 * ((n.value or 0.0) / 3e-5 - 1.0), abs=1.0)
    assert "nothing changed" not in printed


@pytest.mark.parametrize("source", ["recording", "saved"])
def test_filter_parameters_of_a_file(source: str, recording: Path, saved: Path) -> None:
    path = recording if source == "recording" else saved
    found = from_json(FilterReport, imumon("report", path, "--format", "filter", "--horizon", "1m"))
    report = from_json(Report, saved.read_text())
    assert found.schema == "imumon.filter/1"
    assert found.horizon_s == 60.0
    assert found.device == report.device
    assert found.channels == filters(report, 60.0).channels


def test_a_short_record_prints_a_warning(saved: Path) -> None:
    for form in ("filter", "kalibr", "vins"):
        code, _, errors = run_inside(["report", str(saved), "--format", form])
        assert code == 0
        assert re.fullmatch(
            r"imumon: recorded 2 min: what the record does not show is a comment; record at least 8 h\n",
            errors,
        )
    assert short_record_text(make_report(LONG_S)) is None or make_report(LONG_S).session.elapsed_s < 8 * 3600


def test_running_daemon_and_its_saved_state(tmp_path: Path) -> None:
    with Daemon("sim", tmp_path, "--speed", "10", "--seed", "3") as daemon:
        live = daemon.samples(1000)
        shown = imumon("report", "--connect", daemon.endpoint, "--format", "md")
        numbers = imumon("report", "--connect", daemon.endpoint, "--format", "filter")
        assert from_json(FilterReport, numbers).device.id == live.device.id
        assert live.device.serial is not None
        assert live.device.serial in shown
        code, _, _ = daemon.stop()
        assert code == 0
    (state,) = tmp_path.glob("*.state")
    report = from_json(Report, imumon("report", state, "--format", "json"))
    assert report.session.samples >= 1000
    assert report.device.model == live.device.model
    assert report.device.stream == "deltas"
    assert report.channels["gyro/x"].coefficients["N"].status == "measured"
    kept = tmp_path / "kept report.json"
    imumon("report", state, "-o", kept)
    for saved in (state, kept):
        command = re.search(r"which has no samples: imumon (.*) prints", imumon("replay", saved, code=1))
        assert command is not None
        assert "Noise at rest" in imumon(*shlex.split(command[1]))
    data = state.read_bytes()
    state.write_bytes(data[:-100])
    assert "damaged" in imumon("report", state, code=1)


def test_errors_are_one_line(tmp_path: Path, recording: Path, saved: Path) -> None:
    assert "no daemon answers" in imumon("report", "--connect", "tcp/127.0.0.1:1", code=3)
    assert "nowhere" in imumon("report", tmp_path / "nowhere", code=1)
    broken = tmp_path / "broken.json"
    broken.write_text('{"schema": 3')
    assert "broken.json" in imumon("report", broken, code=1)
    broken.write_text("{}")
    assert "imumon.report/1: Report without time, device, state, session: make" in imumon(
        "report", broken, code=1
    )
    imumon("report", recording, "--format", "docx", code=2)
    imumon("report", recording, "--id", "x", code=2)
    assert "cannot write" in imumon("report", saved, "-o", tmp_path / "no" / "a.md", code=1)


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


def test_the_extension_of_the_output_selects_the_form_or_is_refused(saved: Path, tmp_path: Path) -> None:
    report = from_json(Report, saved.read_text())
    one, no_curve = tmp_path / "one.json", tmp_path / "no_curve.json"
    first = replace(report, channels={"gyro/x": report.channels["gyro/x"]})
    one.write_text(to_json(first))
    no_curve.write_text(to_json(bare(first)))
    error = imumon("report", one, "-o", tmp_path / "x.foo", code=2)
    assert all(form in error for form in FORMS)
    assert not (tmp_path / "x.foo").exists()
    imumon("report", one, "-o", tmp_path / "x.foo", "--format", "csv")
    assert (tmp_path / "x.foo").read_text().startswith("kind,")
    for source, name, begin in (
        (one, "x.svg", b"<?xml"),
        (one, "x.PNG", b"\x89PNG"),
        (one, "imu.yaml", b"# "),
        (no_curve, "x.htm", b"<!DOCTYPE"),
    ):
        imumon("report", source, "-o", tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(begin)
    assert "gyroscope_noise_density: " in (tmp_path / "imu.yaml").read_text()
    imumon("report", no_curve, "-o", tmp_path / "plain")
    assert (tmp_path / "plain").read_text().startswith("# ")
